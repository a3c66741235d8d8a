"""Contact constants of pairs in PhysX, whose materials belong to shapes. Needs no engine.

PhysX combines the materials of two shapes; SAPIEN leaves the rule at the mean. A body therefore has a copy of its shape
for each pair of constants in its contacts, with these constants as its material: the mean of equal values is exact.
Collision groups let a copy touch only copies with the same constants, of bodies that have a contact.
"""

from collections import Counter
from collections.abc import Iterator

from gauge_envs.scene import Contact, ContactMode, Scene

Constants = tuple[float, float]
"""Material of a shape: coefficients of friction, static and dynamic, and of restitution."""

CONTACTS_PER_CONSTANTS = 32
"""Largest number of contacts with the same constants: each has a bit of PhysX's collision groups."""


def constants_of(contact: Contact, *, sustained_restitution: bool) -> Constants:
    """Return the material of a contact.

    Args:
        contact: The contact.
        sustained_restitution: Whether a sustained contact keeps its restitution.
    """
    bounces = sustained_restitution or contact.mode is ContactMode.IMPACT
    return contact.friction, contact.restitution if bounces else 0.0


def groups_of_bodies(
    scene: Scene, *, sustained_restitution: bool
) -> dict[str, dict[Constants, list[int]]]:
    """Return the collision groups of the copies of each body's shape, by the material of the copy.

    Groups are the four words that SAPIEN expects. Bit k of the first word is set if the body is in the
    first group of contact k with these constants; the second word holds the second groups. Two shapes collide if a bit
    of one shape's first word is in the other shape's second word. The last word holds a number of the constants; shapes
    with different numbers never collide.
    """
    numbers: dict[Constants, int] = {}
    used: Counter[Constants] = Counter()
    groups: dict[str, dict[Constants, list[int]]] = {b.name: {} for b in scene.bodies}
    for contact in scene.contacts:
        constants = constants_of(contact, sustained_restitution=sustained_restitution)
        number = numbers.setdefault(constants, len(numbers))
        for word, names in enumerate((contact.first, contact.second)):
            for name in names:
                words = groups[name].setdefault(constants, [0, 0, 0, number << 16])
                words[word] |= 1 << used[constants]
        used[constants] += 1
    return groups


def unsupported_contacts(scene: Scene) -> Iterator[str]:
    """Yield one sentence for each kind of contact constants that PhysX cannot take."""
    for contact in scene.contacts:
        if contact.restitution > 1.0:
            names = f"{contact.first[0]!r} and {contact.second[0]!r}"
            yield f"{names} rebound with a restitution of {contact.restitution:.6g}: PhysX takes at most 1"
            break
    # Without restitution of sustained contacts, more of them have the same constants.
    used = Counter(constants_of(c, sustained_restitution=False) for c in scene.contacts)
    if used and max(used.values()) > CONTACTS_PER_CONSTANTS:
        yield (
            f"{max(used.values())} contacts have the same friction and restitution: PhysX's collision groups hold "
            f"{CONTACTS_PER_CONSTANTS}; join groups of bodies"
        )
