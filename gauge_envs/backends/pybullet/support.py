"""Features of a scene that the PyBullet backend does not support. Needs no engine, so it is fast."""

from __future__ import annotations

from collections.abc import Iterator

from gauge_envs.backends.pybullet.contacts import frictions, restitutions
from gauge_envs.errors import UnsupportedSceneError
from gauge_envs.scene import Motion, Scene

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
        if scene.body(joint.body).motion is not Motion.DYNAMIC:
            yield f"{joint.body!r} has a joint and is not dynamic"
    for find in (frictions, restitutions):
        try:
            find(scene)
        except UnsupportedSceneError as error:
            yield str(error)
