"""Collisions of two bodies: momentum and relative speed."""

from __future__ import annotations

from gauge_envs.runs.rollout import Rollout
from gauge_envs.scene import GRAVITY_M_PER_S2, Box, Contact, ContactMode, Motion, Pose, Scene
from gauge_envs.tools.conformance.lab import Lab
from gauge_envs.tools.conformance.model import Measurement, Tolerance
from gauge_envs.tools.conformance.registry import check
from gauge_envs.tools.conformance.scene_parts import ball, body, driver, ramp

G = GRAVITY_M_PER_S2

# The contract has no start velocities, so a driven plate accelerates the first ball, then brakes and loses contact.

LEFT_KG, RIGHT_KG, RESTITUTION = 0.1, 0.2, 0.6
PUSH_M_PER_S = 0.5
BEFORE_S, AFTER_S = 0.42, 0.75
SLOWDOWN = 5.0


def _collision(lab: Lab) -> Rollout:
    return _collide(lab, 1.0)


def _slow_collision(lab: Lab) -> Rollout:
    return _collide(lab, SLOWDOWN)


def _collide(lab: Lab, slowdown: float) -> Rollout:
    """Record two balls, one of which a driven plate pushes; all times are longer by a factor."""
    plate = body(
        "plate", Box(size_m=(0.02, 0.1, 0.1)), Pose(position_m=(-0.03, 0.0, 1.0)), mass_kg=1.0, motion=Motion.KINEMATIC
    )
    stroke = ramp(0.1, start_s=0.0, duration_s=0.3 * slowdown, ramp_s=0.1 * slowdown)
    scene = Scene(
        bodies=(
            ball("left", (0.0, 0.0, 1.0), radius_m=0.02, mass_kg=LEFT_KG),
            ball("right", (0.25, 0.0, 1.0), radius_m=0.02, mass_kg=RIGHT_KG),
            plate,
        ),
        contacts=(
            Contact(first=("left",), second=("plate",), friction=0.0, restitution=0.0),
            Contact(first=("left",), second=("right",), friction=0.0, restitution=RESTITUTION, mode=ContactMode.IMPACT),
        ),
        drivers=(driver("plate", "translate", (1.0, 0.0, 0.0), stroke),),
        duration_s=slowdown,
        gravity_m_per_s2=0.0,
    )
    return lab.rollout(scene, slowdown)


def _speeds(rollout: Rollout, time_s: float) -> tuple[float, float]:
    sample = rollout.sample_at(time_s)
    return float(rollout.velocity("left")[sample, 0]), float(rollout.velocity("right")[sample, 0])


def _not_pushed(left: float, right: float, push: float = PUSH_M_PER_S) -> str:
    """Return why the collision cannot be measured; empty when the first ball moves and the second one rests."""
    if abs(left) > 0.2 * push and abs(right) < 0.01 * push:
        return ""
    return f"before the collision the balls move at {left:.3g} and {right:.3g} m/s instead of {push:g} and 0"


@check(
    "pushed-ball",
    title="driven plate pushes",
    scene="a driven plate pushes a ball of 0.1 kg at 0.5 m/s against a resting one of 0.2 kg; no gravity",
    measures="speed of a ball after a driven plate has pushed it and braked",
    law="v = largest speed of the plate",
    source="no restitution, no friction",
    unit="m/s",
    tolerance=Tolerance(relative=0.02, rationale="a stiff contact may release some elastic energy; 2 % is 1 cm/s"),
    diagnosis="the driven body moves without velocity, or the contact sticks or rebounds",
)
def _pushed_ball(lab: Lab) -> Measurement:
    return Measurement(measured=_speeds(lab.once(_collision), BEFORE_S)[0], expected=PUSH_M_PER_S)


@check(
    "collision-momentum",
    title="two balls, momentum",
    scene="a driven plate pushes a ball of 0.1 kg at 0.5 m/s against a resting one of 0.2 kg; no gravity",
    measures="momentum of two floating balls of different mass after their collision, over that before",
    law="m1 v1 + m2 v2 = const",
    source="Newton",
    unit="1",
    tolerance=Tolerance(absolute=1e-3, rationale="only rounding and damping can change it"),
    diagnosis="the masses are not the scene's, bodies are damped, or the contact acts on one body only",
)
def _collision_momentum(lab: Lab) -> Measurement:
    rollout = lab.once(_collision)
    (before, still), (left, right) = _speeds(rollout, BEFORE_S), _speeds(rollout, AFTER_S)
    if hint := _not_pushed(before, still):
        return Measurement(measured=float("nan"), expected=1.0, hint=hint)
    return Measurement(measured=(LEFT_KG * left + RIGHT_KG * right) / (LEFT_KG * before), expected=1.0)


@check(
    "collision-rebound",
    title="two balls, relative speed",
    scene="a driven plate pushes a ball of 0.1 kg at 0.5 m/s against a resting one of 0.2 kg; no gravity",
    measures="relative speed of the two balls after their collision, over that before",
    law="v2' - v1' = e (v1 - v2)",
    source="Newton's law of restitution",
    unit="1",
    tolerance=Tolerance(
        absolute=0.01,
        rationale="each ball of a cradle passes on (1 + e) / 2 of its speed: this is 0.5 % for each collision",
    ),
    diagnosis="restitution is not that of the pair, or depends on the masses, which is possible for a damped contact",
)
def _collision_rebound(lab: Lab) -> Measurement:
    return _relative_speed(lab.once(_collision), 1.0)


def _relative_speed(rollout: Rollout, slowdown: float) -> Measurement:
    (before, still) = _speeds(rollout, BEFORE_S * slowdown)
    (left, right) = _speeds(rollout, AFTER_S * slowdown)
    if hint := _not_pushed(before, still, PUSH_M_PER_S / slowdown):
        return Measurement(measured=float("nan"), expected=RESTITUTION, hint=hint)
    return Measurement(measured=(right - left) / before, expected=RESTITUTION)


@check(
    "collision-slow",
    title="two balls, slow collision",
    scene="a driven plate pushes a ball of 0.1 kg at 0.1 m/s against a resting one of 0.2 kg; no gravity",
    measures="relative speed of the two balls after their collision, over that before",
    law="v2' - v1' = e (v1 - v2) at any speed",
    source="Newton's law of restitution",
    unit="1",
    tolerance=Tolerance(absolute=0.01, rationale="as for the fast collision"),
    diagnosis="the engine has a threshold speed below which bodies do not rebound: set it to 0",
)
def _collision_slow(lab: Lab) -> Measurement:
    return _relative_speed(lab.once(_slow_collision), SLOWDOWN)
