"""Collisions of two bodies: momentum and relative speed."""

from __future__ import annotations

from collections.abc import Callable

from gauge_envs.runs.rollout import Rollout
from gauge_envs.scene import Scene
from gauge_envs.tools.conformance.lab import Lab, recorded
from gauge_envs.tools.conformance.model import Measurement, Tolerance
from gauge_envs.tools.conformance.scene_parts import ball, contact, driven_box, driver, ramp

# The contract has no start velocities, so a driven plate accelerates the first ball, then brakes and loses contact.

LEFT_KG, RIGHT_KG, RESTITUTION = 0.1, 0.2, 0.6
PUSH_M_PER_S = 0.5
BEFORE_S, AFTER_S = 0.42, 0.75


@recorded("a driven plate pushes a ball of 0.1 kg at 0.5 m/s against a resting one of 0.2 kg; no gravity")
def _collision(lab: Lab) -> Rollout:
    return _collide(lab, 1.0)


@recorded("a driven plate pushes a ball of 0.1 kg at 0.1 m/s against a resting one of 0.2 kg; no gravity")
def _slow_collision(lab: Lab) -> Rollout:
    return _collide(lab, 5.0)


def _collide(lab: Lab, slowdown: float) -> Rollout:
    """Record two balls, one of which a driven plate pushes; all times are longer by a factor."""
    stroke = ramp(0.1, start_s=0.0, duration_s=0.3 * slowdown, ramp_s=0.1 * slowdown)
    scene = Scene(
        bodies=(
            ball("left", (0.0, 0.0, 1.0), radius_m=0.02, mass_kg=LEFT_KG),
            ball("right", (0.25, 0.0, 1.0), radius_m=0.02, mass_kg=RIGHT_KG),
            driven_box("plate", (-0.03, 0.0, 1.0), (0.02, 0.1, 0.1)),
        ),
        contacts=(
            contact("left", "plate", friction=0.0),
            contact("left", "right", friction=0.0, restitution=RESTITUTION),
        ),
        drivers=(driver("plate", "translate", (1.0, 0.0, 0.0), stroke),),
        duration_s=slowdown,
        gravity_m_per_s2=0.0,
    )
    return lab.rollout(scene)


def _speeds(rollout: Rollout, time_s: float) -> tuple[float, float]:
    """Return the speeds of both balls at a time [s] of the fast collision."""
    sample = rollout.sample_at(time_s * rollout.scene.duration_s)
    return float(rollout.velocity("left")[sample, 0]), float(rollout.velocity("right")[sample, 0])


def _collided(rollout: Rollout, expected: float, measure: Callable[[float, float, float], float]) -> Measurement:
    """Measure a collision by the first ball's speed before it and both speeds after it, if the second one rested."""
    push = PUSH_M_PER_S / rollout.scene.duration_s
    (before, still), (left, right) = _speeds(rollout, BEFORE_S), _speeds(rollout, AFTER_S)
    if abs(before) > 0.2 * push and abs(still) < 0.01 * push:
        return Measurement(measured=measure(before, left, right), expected=expected)
    hint = f"before the collision the balls move at {before:.3g} and {still:.3g} m/s instead of {push:g} and 0"
    return Measurement(measured=float("nan"), expected=expected, hint=hint)


def _relative_speed(rollout: Rollout) -> Measurement:
    return _collided(rollout, RESTITUTION, lambda before, left, right: (right - left) / before)


@_collision.check(
    "pushed-ball",
    title="driven plate pushes",
    measures="speed of a ball after a driven plate has pushed it and braked",
    law="v = largest speed of the plate",
    source="no restitution, no friction",
    unit="m/s",
    tolerance=Tolerance(relative=0.02, rationale="a stiff contact may release some elastic energy; 2 % is 1 cm/s"),
    diagnosis="the driven body moves without velocity, or the contact sticks or rebounds",
)
def _pushed_ball(rollout: Rollout) -> Measurement:
    return Measurement(measured=_speeds(rollout, BEFORE_S)[0], expected=PUSH_M_PER_S)


@_collision.check(
    "collision-momentum",
    title="two balls, momentum",
    measures="momentum of two floating balls of different mass after their collision, over that before",
    law="m1 v1 + m2 v2 = const",
    source="Newton",
    tolerance=Tolerance(absolute=1e-3, rationale="only rounding and damping can change it"),
    diagnosis="the masses are not the scene's, bodies are damped, or the contact acts on one body only",
)
def _collision_momentum(rollout: Rollout) -> Measurement:
    return _collided(rollout, 1.0, lambda before, left, right: (LEFT_KG * left + RIGHT_KG * right) / (LEFT_KG * before))


@_collision.check(
    "collision-rebound",
    title="two balls, relative speed",
    measures="relative speed of the two balls after their collision, over that before",
    law="v2' - v1' = e (v1 - v2)",
    source="Newton's law of restitution",
    tolerance=Tolerance(
        absolute=0.01,
        rationale="each ball of a cradle passes on (1 + e) / 2 of its speed: this is 0.5 % for each collision",
    ),
    diagnosis="restitution is not that of the pair, or depends on the masses, which is possible for a damped contact",
)
def _collision_rebound(rollout: Rollout) -> Measurement:
    return _relative_speed(rollout)


@_slow_collision.check(
    "collision-slow",
    title="two balls, slow collision",
    measures="relative speed of the two balls after their collision, over that before",
    law="v2' - v1' = e (v1 - v2) at any speed",
    source="Newton's law of restitution",
    tolerance=Tolerance(absolute=0.01, rationale="as for the fast collision"),
    diagnosis="the engine has a threshold speed below which bodies do not rebound: set it to 0",
)
def _collision_slow(rollout: Rollout) -> Measurement:
    return _relative_speed(rollout)
