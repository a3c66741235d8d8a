"""Features of a scene that the Genesis backend does not support. Needs no engine, so it is fast."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

from gauge_envs.backends.genesis.contacts import unsupported_contacts
from gauge_envs.backends.genesis.deformables import unsupported_deformables
from gauge_envs.backends.genesis.settings import SettingsGenesis
from gauge_envs.errors import UnsupportedSceneError
from gauge_envs.scene import Hinge, Motion, Scene


def check_support(scene: Scene, settings: SettingsGenesis) -> None:
    """Raise an error if a scene has features that given settings do not support."""
    missing = tuple(unsupported_features(scene, settings))
    if missing:
        raise UnsupportedSceneError(
            f"Genesis preset {settings.preset!r} does not support this scene: {'; '.join(missing)}"
        )


def unsupported_features(scene: Scene, settings: SettingsGenesis) -> Iterator[str]:
    """Yield one sentence for each kind of unsupported feature of a scene."""
    hinges = Counter(joint.body for joint in scene.joints if isinstance(joint, Hinge))
    for name, count in hinges.items():
        if count > 1:
            yield f"{name!r} hangs on {count} hinges: this backend builds one hinge per body"
            break
    for joint in scene.joints:
        if scene.body(joint.body).motion is not Motion.DYNAMIC:
            motion = scene.body(joint.body).motion.value
            yield f"{joint.body!r} hangs on a {type(joint).__name__} and is {motion}: only dynamic bodies have joints"
            break
    yield from unsupported_contacts(scene, settings)
    yield from unsupported_deformables(scene, settings)
