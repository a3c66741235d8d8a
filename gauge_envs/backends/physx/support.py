"""Features of a scene that the PhysX backend does not support. Needs no engine, so it is fast."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

from gauge_envs.backends.physx.contacts import unsupported_contacts
from gauge_envs.scene import Hinge, Motion, Scene

__all__ = ["unsupported_features"]


def unsupported_features(scene: Scene) -> Iterator[str]:
    """Yield one sentence for each kind of unsupported feature of a scene."""
    if scene.deformables:
        others = len(scene.deformables) - 1
        more = f" (and {others} more)" if others else ""
        yield (
            f"{scene.deformables[0].name!r}{more} is deformable: SAPIEN contains PhysX's rigid bodies only; its "
            "cloth and soft bodies need a GPU and Isaac Sim"
        )
    hinges = Counter(joint.body for joint in scene.joints if isinstance(joint, Hinge))
    for name, count in hinges.items():
        if count > 1:
            yield f"{name!r} hangs on {count} hinges: this backend builds one hinge per body"
            break
    for name in hinges:
        if scene.body(name).motion is not Motion.DYNAMIC:
            yield f"{name!r} hangs on a hinge and is {scene.body(name).motion.value}: only dynamic bodies have hinges"
            break
    yield from unsupported_contacts(scene)
