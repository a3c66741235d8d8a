"""Changes of a scene's parts, from which faults are made."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from gauge_envs.scene import Motion, RigidBody, Scene, Shape


def change_bodies(change: Callable[[RigidBody], RigidBody]) -> Callable[[Scene], Scene]:
    """Return a fault that changes each body."""
    return lambda scene: replace(
        scene, bodies=tuple(change(one) for one in scene.bodies)
    )


def change_shapes(
    change: Callable[[Shape], Shape], *motions: Motion
) -> Callable[[Scene], Scene]:
    """Return a change of the shapes of bodies that move in one of some ways; of dynamic ones by default."""
    chosen = motions or (Motion.DYNAMIC,)
    return change_bodies(
        lambda one: (
            replace(one, shape=change(one.shape)) if one.motion in chosen else one
        )
    )


def change_contacts(
    *,
    friction: Callable[[float], float] = float,
    restitution: Callable[[float], float] = float,
) -> Callable[[Scene], Scene]:
    """Return a fault that changes the friction or the restitution of each contact."""

    def change(scene: Scene) -> Scene:
        contacts = (
            replace(
                one,
                friction=friction(one.friction),
                restitution=restitution(one.restitution),
            )
            for one in scene.contacts
        )
        return replace(scene, contacts=tuple(contacts))

    return change


def change_deformables(kind: type, **factors: float) -> Callable[[Scene], Scene]:
    """Return a fault that multiplies fields of each deformable body of a kind by factors."""

    def change(scene: Scene) -> Scene:
        changed = [
            replace(
                one,
                **{key: factor * getattr(one, key) for key, factor in factors.items()},
            )
            if isinstance(one, kind)
            else one
            for one in scene.deformables
        ]
        return replace(scene, deformables=tuple(changed))

    return change


def change_joints(kind: type, change: Callable[[Any], Any]) -> Callable[[Scene], Scene]:
    """Return a fault that changes each joint of a kind."""
    return lambda scene: replace(
        scene,
        joints=tuple(
            change(one) if isinstance(one, kind) else one for one in scene.joints
        ),
    )
