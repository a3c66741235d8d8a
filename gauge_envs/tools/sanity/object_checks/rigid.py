"""Rebound of a ball, which has the restitution that real drops show, so that the check compares the engine alone."""

from dataclasses import replace

import numpy as np

from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.fixtures.recording import Recording
from gauge_envs.scene import RigidBody, Scene, Sphere
from gauge_envs.scoring.estimators import first_bounce
from gauge_envs.tools.sanity.object_checks.check import (
    ObjectCheck,
    Scenario,
    facts,
)
from gauge_envs.tools.sanity.training import Need
from gauge_envs.tools.sanity.verdict import Reality

# --- rebound ---------------------------------------------------------------------------------------------------------

BALL = "BouncingBall-rubber"

DROP_S = 0.85
"""Time beyond the top of the first bounce of a ball that keeps all its speed (0.58 s) [s]."""

CLEAR_M = 0.002
"""Height above which a ball is in flight: more than contact margins, less than the top of a bounce [m]."""

LIFTS_M = (-0.008, -0.004, 0.0, 0.004, 0.008)
"""Changes of the start height [m]. With a large step, the rebound depends on the phase of the step at the impact: in a
step of 0.01 s a ball falls by 28 mm."""


def _real_ratio() -> float:
    return float(facts("bouncing_ball_summary")["rebound_ratio"]["mean"])


def _resting_m(scene: Scene, ball: RigidBody) -> float:
    """Return the height of a ball's centre on the ground [m]."""
    assert isinstance(ball.shape, Sphere)
    return scene.body("ground").pose.position_m[2] + ball.shape.radius_m


def _drop() -> Scenario:
    """Return the drop of five balls side by side instead of one, at different heights and without mutual contacts."""
    scene = load_experiment(BALL, {"ball.restitution": _real_ratio()}).scene
    ball = scene.body("ball")
    x, y, z = ball.pose.position_m
    balls = []
    for index, lift in enumerate(LIFTS_M):
        pose = replace(ball.pose, position_m=(x + 0.2 * index, y, z + lift))
        balls.append(replace(ball, name=f"ball-{index}", pose=pose))
    names = tuple(ball.name for ball in balls)
    touches = tuple(replace(contact, first=names) for contact in scene.contacts)
    bodies = (*balls, scene.body("ground"))
    return Scenario(
        "drop", BALL, DROP_S, replace(scene, bodies=bodies, contacts=touches)
    )


def _ratios(rollout: Recording) -> list[float]:
    """Return the speed of each ball after its first impact over that before; 0 if it stays near the ground."""
    ratios = []
    for ball in rollout.scene.dynamic_bodies:
        heights_m = rollout.position(ball.name)[:, 2] - _resting_m(rollout.scene, ball)
        drop_m = float(heights_m[0])
        bounce = first_bounce(
            rollout.times_s,
            heights_m,
            gravity_m_per_s2=rollout.scene.gravity_m_per_s2,
            released_m=drop_m,
        )
        ratio = 0.0 if bounce is None else bounce.restitution
        ratios.append(ratio if ratio**2 * drop_m > CLEAR_M else 0.0)
    return ratios


def _stuck(rollout: Recording) -> str:
    stuck = _ratios(rollout).count(0.0)
    text = f"{stuck} of {len(LIFTS_M)} drops do not leave the ground again"
    return text if stuck else ""


def rebound() -> ObjectCheck:
    """Return the speed of a ball after an impact over that before."""
    trials = facts("bouncing_ball_summary")
    return ObjectCheck(
        "rebound speed of a ball over its impact speed",
        _drop(),
        "1",
        Reality.measured(
            _real_ratio(),
            trials["rebound_ratio"]["std"],
            trials["trial_count"],
            "real drops (scoring/facts/bouncing_ball_summary.toml); the ball has the restitution that they show",
        ),
        lambda rollout: float(np.mean(_ratios(rollout))),
        _stuck,
        needs=(Need.REBOUND,),
    )
