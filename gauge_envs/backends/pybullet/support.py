"""Features of a scene that the PyBullet backend does not support. Needs no engine, so it is fast."""

from __future__ import annotations

from collections.abc import Iterator

from gauge_envs.backends.pybullet.contacts import frictions, restitutions
from gauge_envs.errors import UnsupportedSceneError
from gauge_envs.scene import Motion, Scene, Tether

__all__ = ["unsupported_features"]


def unsupported_features(scene: Scene) -> Iterator[str]:
    """Yield one sentence for each feature of a scene that this backend does not support."""
    if scene.deformables:
        names = [body.name for body in scene.deformables]
        yield f"{names[0]!r} is deformable: this backend simulates rigid bodies only"
        return
    jointed: set[str] = set()
    for joint in scene.joints:
        if joint.body in jointed:
            yield f"{joint.body!r} has two joints: this backend builds one joint for each body"
        jointed.add(joint.body)
        body = scene.body(joint.body)
        if body.motion is not Motion.DYNAMIC:
            yield f"{joint.body!r} has a joint and is not dynamic"
        if isinstance(joint, Tether) and body.pose.position_m == joint.anchor_m:
            yield f"{joint.body!r} starts at the anchor of its string, which then has no direction"
        if isinstance(joint, Tether) and not body.starts_at_rest:
            yield f"{joint.body!r} hangs on a string and has a start velocity: this backend starts strings at rest"
    for find in (frictions, restitutions):
        try:
            find(scene)
        except UnsupportedSceneError as error:
            yield str(error)
