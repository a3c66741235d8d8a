"""Collision groups and constants of contacts. Needs no engine.

Rapier combines the constants of two colliders, and filters pairs by 32 groups. A body gets one collider for each
contact that lists it. Both colliders of a pair then have the constants of the pair, so their average is exact. Two
groups belong to each contact, one for either side. A collider only meets the other side of its own contact.
"""

from dataclasses import dataclass

from gauge_envs.scene import Contact, ContactMode, Scene

LARGEST_CONTACT_COUNT = 16
"""Number of contacts that 32 groups separate."""


@dataclass(frozen=True)
class ColliderLayer:
    """Constants and groups of the collider that a body has for one contact.

    Attributes:
        friction: Coulomb's coefficient of the pair.
        restitution: Restitution of the pair, 0 in sustained contacts.
        memberships: Bits of the groups to which the collider belongs.
        filter: Bits of the groups with which it collides.
    """

    friction: float
    restitution: float
    memberships: int
    filter: int


def colliding_contacts(scene: Scene) -> list[Contact]:
    """Return the contacts of a scene with a pair of bodies that can collide."""
    return [
        contact
        for contact in scene.contacts
        if next(scene.colliding_pairs(contact), None) is not None
    ]


def collider_layers(scene: Scene) -> dict[str, list[ColliderLayer]]:
    """Return the layers of each body, by name; a body without contacts has none."""
    layers: dict[str, list[ColliderLayer]] = {body.name: [] for body in scene.bodies}
    for index, contact in enumerate(colliding_contacts(scene)):
        first, second = 1 << 2 * index, 2 << 2 * index
        restitution = contact.restitution if contact.mode is ContactMode.IMPACT else 0.0
        for name in dict.fromkeys((*contact.first, *contact.second)):
            in_first, in_second = name in contact.first, name in contact.second
            layer = ColliderLayer(
                friction=contact.friction,
                restitution=restitution,
                memberships=first * in_first | second * in_second,
                filter=second * in_first | first * in_second,
            )
            layers[name].append(layer)
    return layers
