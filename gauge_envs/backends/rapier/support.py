"""Features of a scene that the Rapier backend does not support. Needs no engine, so it is fast."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

from gauge_envs.backends.rapier.contacts import LARGEST_CONTACT_COUNT, colliding_contacts
from gauge_envs.scene import Cloth, Compound, Hinge, Rod, Rope, Scene


def unsupported_features(scene: Scene) -> Iterator[str]:
    """Yield one sentence for each feature of a scene that this backend does not support."""
    compound = next((body.name for body in scene.bodies if isinstance(body.shape, Compound)), None)
    if compound is not None:
        yield f"{compound!r} is a compound of solids, and this backend builds one solid or convex pieces for each body"
    kinds: dict[str, list[str]] = {}
    for body in scene.deformables:
        kind = "cloth" if isinstance(body, Cloth) else "a line" if isinstance(body, Rope | Rod) else "soft"
        kinds.setdefault(kind, []).append(body.name)
    for kind, names in kinds.items():
        more = f" (and {len(names) - 1} more)" if len(names) > 1 else ""
        yield f"{names[0]!r}{more} is {kind}, and this backend builds rigid bodies only"
    counts = Counter(joint.body for joint in scene.joints)
    hinged = [joint.body for joint in scene.joints if isinstance(joint, Hinge) and counts[joint.body] > 1]
    if hinged:
        yield f"{hinged[0]!r} hangs on {counts[hinged[0]]} joints, and this backend builds a hinge as the only joint"
    count = len(colliding_contacts(scene))
    if count > LARGEST_CONTACT_COUNT:
        yield (
            f"the scene has {count} kinds of contact, and the 32 collision groups of Rapier separate "
            f"{LARGEST_CONTACT_COUNT}"
        )
