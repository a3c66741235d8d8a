"""Drops: balls that fall on level ground, and the restitution of their first bounce."""

from __future__ import annotations

import math
from collections.abc import Mapping

from gauge_envs.scene import Contact, RigidBody, Scene
from gauge_envs.scoring.estimators import Bounce, first_bounce
from gauge_envs.tools.bench.parts import ball, ground
from gauge_envs.tools.bench.recording import Recording

RADIUS_M = 0.03
"""Radius of the balls [m]."""


def balls_above_ground(
    drops_m: Mapping[str, float], *, spacing_m: float, mass_kg: float = 0.1
) -> list[RigidBody]:
    """Return balls side by side along x, each at a height [m] of its lowest point over the ground, by name."""
    return [
        ball(
            name,
            (spacing_m * index, 0.0, RADIUS_M + drop_m),
            radius_m=RADIUS_M,
            mass_kg=mass_kg,
        )
        for index, (name, drop_m) in enumerate(drops_m.items())
    ]


def fall_s(drop_m: float, gravity_m_per_s2: float) -> float:
    """Return the time of a fall from rest [s]: sqrt(2 h / g)."""
    return math.sqrt(2.0 * drop_m / gravity_m_per_s2)


def drop_scene(
    bodies: list[RigidBody],
    contacts: tuple[Contact, ...],
    *,
    seconds: float,
    gravity: float,
) -> Scene:
    """Return a scene of bodies that drop on level ground.

    Args:
        bodies: The bodies.
        contacts: Their contacts with `ground`.
        seconds: Duration [s].
        gravity: Gravity [m/s^2].
    """
    return Scene(
        bodies=(*bodies, ground()),
        contacts=contacts,
        duration_s=seconds,
        gravity_m_per_s2=gravity,
    )


def bounce_of(rollout: Recording, name: str) -> Bounce | None:
    """Return the first bounce of a body that is let go at rest over level ground at height 0; None if it never falls.

    Args:
        rollout: The rollout.
        name: Name of the body, whose origin is at `RADIUS_M` where it touches the ground.
    """
    heights_m = rollout.position(name)[:, 2] - RADIUS_M
    released_m = rollout.scene.body(name).pose.position_m[2] - RADIUS_M
    return first_bounce(
        rollout.times_s,
        heights_m,
        gravity_m_per_s2=rollout.scene.gravity_m_per_s2,
        released_m=released_m,
    )
