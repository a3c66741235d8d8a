"""What of a scene Newton cannot do. Needs no engine, so that a list of experiments is quick."""

from __future__ import annotations

from collections.abc import Iterator

from gauge_envs.backends.newton.contacts import undoable_contacts
from gauge_envs.backends.newton.settings import SettingsMuJoCoWarp, settings_for
from gauge_envs.scene import Scene, Tether

__all__ = ["undoable"]


def undoable(scene: Scene) -> Iterator[str]:
    """What of a scene Newton cannot do, a sentence each."""
    for joint in scene.joints:
        if isinstance(joint, Tether):
            yield f"{joint.body!r} hangs on a string: Newton's MuJoCo solver has no distance joints"
    for body in scene.deformables:
        yield f"{body.name!r} is a deformable body"
    settings = settings_for(scene)
    if isinstance(settings, SettingsMuJoCoWarp):
        yield from undoable_contacts(scene, settings)
