"""Contact constants of pairs in PhysX, whose materials belong to shapes. Needs no engine.

PhysX combines the materials of two shapes; SAPIEN leaves the rule at the mean. A body therefore has a copy of its shape
for each pair of constants in its contacts, with these constants as its material: the mean of equal values is exact.
Collision groups let a copy touch only copies with the same constants, of bodies that have a contact.
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

from gauge_envs.scene import Contact, ContactMode, Scene

CONTACTS_PER_CONSTANTS = 32
"""Largest number of contacts with the same constants: each has a bit of PhysX's collision groups."""


@dataclass(frozen=True)
class Constants:
    """Material of a shape: coefficient of friction, static and dynamic, and of restitution."""

    friction: float
    restitution: float


@dataclass(frozen=True)
class Groups:
    """Collision groups of a shape: two shapes collide if a bit of one's `first` is in the other's `second`.

    Attributes:
        first: Bit k is set if the body is in the first group of contact k with these constants.
        second: Bit k is set if the body is in the second group of contact k.
        layer: Number of the constants; shapes of different layers never collide.
    """

    first: int
    second: int
    layer: int

    @property
    def words(self) -> list[int]:
        """The four words that SAPIEN expects."""
        return [self.first, self.second, 0, self.layer << 16]


def constants_of(contact: Contact, *, sustained_restitution: bool) -> Constants:
    """Return the material of a contact.

    Args:
        contact: The contact.
        sustained_restitution: Whether a sustained contact keeps its restitution.
    """
    bounces = sustained_restitution or contact.mode is ContactMode.IMPACT
    return Constants(contact.friction, contact.restitution if bounces else 0.0)


def groups_of_bodies(
    scene: Scene, *, sustained_restitution: bool
) -> dict[str, dict[Constants, Groups]]:
    """Return the collision groups of each copy of each body's shape; a body without contacts has none."""
    layers: dict[Constants, int] = {}
    used: Counter[Constants] = Counter()
    groups: dict[str, dict[Constants, Groups]] = {}
    for contact in scene.contacts:
        constants = constants_of(contact, sustained_restitution=sustained_restitution)
        layer = layers.setdefault(constants, len(layers))
        bit = 1 << used[constants]
        used[constants] += 1
        for name in dict.fromkeys((*contact.first, *contact.second)):
            shapes = groups.setdefault(name, {})
            known = shapes.get(constants, Groups(0, 0, layer))
            first = known.first | (bit if name in contact.first else 0)
            second = known.second | (bit if name in contact.second else 0)
            shapes[constants] = Groups(first, second, layer)
    return groups


def unsupported_contacts(scene: Scene) -> Iterator[str]:
    """Yield one sentence for each kind of contact constants that PhysX cannot take."""
    for contact in scene.contacts:
        if contact.restitution > 1.0:
            names = f"{contact.first[0]!r} and {contact.second[0]!r}"
            yield f"{names} rebound with a restitution of {contact.restitution:.6g}: PhysX takes at most 1"
            break
    for sustained_restitution in (False, True):
        used = Counter(
            constants_of(c, sustained_restitution=sustained_restitution)
            for c in scene.contacts
        )
        if used and max(used.values()) > CONTACTS_PER_CONSTANTS:
            yield (
                f"{max(used.values())} contacts have the same friction and restitution: PhysX's collision groups hold "
                f"{CONTACTS_PER_CONSTANTS}; join groups of bodies"
            )
            break
