"""Which friction of joints this package computes, in place of an engine that has no term for it; see `resisted`."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import wraps
from typing import Any

from gauge_envs.backends.base import Backend
from gauge_envs.scene import BodyHinge, Hinge, Scene


def without_laws(scene: Scene, *, quadratic: bool = True) -> Scene:
    """Return a scene without the friction that this module computes, the same object if it has none.

    Args:
        scene: The scene.
        quadratic: Whether quadratic friction is among it.
    """

    def plain(joint: Any) -> Any:
        if not isinstance(joint, Hinge | BodyHinge):
            return joint
        terms = joint.dynamics
        if terms.servo:
            terms = replace(terms, servo=None, dry_friction_n_m=0.0)
        if quadratic and terms.quadratic_friction_n_m_s2_per_rad2:
            terms = replace(terms, quadratic_friction_n_m_s2_per_rad2=0.0)
        return joint if terms is joint.dynamics else replace(joint, dynamics=terms)

    joints = tuple(map(plain, scene.joints))
    inner = tuple(map(plain, scene.body_hinges))
    if joints == scene.joints and inner == scene.body_hinges:
        return scene
    return replace(scene, joints=joints, body_hinges=inner)


def with_joint_laws(*, quadratic: bool = True) -> Callable[[Any], Any]:
    """Return a decorator of `Backend.build` and `Backend.build_worlds` that adds the friction of this module.

    Scenes with such friction advance one after another.

    Args:
        quadratic: Whether the engine has no quadratic friction.
    """

    def decorator(build: Any) -> Any:
        @wraps(build)
        def built(
            engine: Backend, scene: Scene | Sequence[Scene], settings: Any = None
        ) -> Any:
            if not isinstance(scene, Scene):
                if any(
                    without_laws(one, quadratic=quadratic) is not one for one in scene
                ):
                    return Backend.build_worlds(engine, scene, settings)
                return build(engine, scene, settings)
            plain = without_laws(scene, quadratic=quadratic)
            inner = build(engine, plain, settings)
            if plain is scene:
                return inner
            from gauge_envs.backends.shared.resisted import ResistedSimulation

            return ResistedSimulation(scene, inner, drags=quadratic)

        return built

    return decorator
