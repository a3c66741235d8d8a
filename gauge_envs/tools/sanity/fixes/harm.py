"""Find the harm of a change: hops of sliding cubes, rebound and friction of impacts, a model that jumps or falls.

A soft contact damps the sliding speed like the normal speed. Where it stops a body within a step, friction mu lifts a
body of speed v with mu v. The body then hops by mu^2 v^2 / (2 g): 54 mm at 4 m/s. At a step of 2 ms, a time constant of
two steps hops by 58 mm. MuJoCo's default of ten steps hops by 5 mm, and this package's preset by 1 mm.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence

import mujoco
import numpy as np

from gauge_envs.fixtures.drop import RADIUS_M
from gauge_envs.fixtures.parts import ball, box, contact, ground, thrown
from gauge_envs.scene import GRAVITY_M_PER_S2 as G, Scene
from gauge_envs.tools.sanity.model_checks.ground import FELL
from gauge_envs.tools.sanity.model_checks.runs import has_diverged, rest, start_data
from gauge_envs.tools.sanity.object_checks.check import Scenario, lowest_m
from gauge_envs.tools.sanity.object_checks.measure import Measurements
from gauge_envs.tools.sanity.robot.robot import Robot
from gauge_envs.tools.sanity.training import Settings, TrainingConfiguration
from gauge_envs.tools.sanity.verdict import PartOutcome, SanityVerdict

FRICTION = 0.257
"""Friction of the measured wooden cube (scoring/facts/slope_slider_30deg_summary.toml)."""

IMPACT_M_PER_S, IMPACT_S = 2.0, 0.1
"""Speed of impacts along the normal [m/s], and time after which they are over [s]."""

SLOW_M_PER_S, FAST_M_PER_S = 1.0, 4.0
"""Initial speeds of cubes [m/s]. Hops grow with the square of the speed."""

CUBES = [
    thrown(
        box(
            f"{speed} m/s, {edge} m",
            (0.0, speed + 10.0 * edge, 0.5 * edge),
            (edge,) * 3,
            mass_kg=kg,
        ),
        (speed, 0.0, 0.0),
    )
    for speed, edge, kg in (
        (SLOW_M_PER_S, 0.02, 0.05),
        (SLOW_M_PER_S, 0.1, 5.0),
        (FAST_M_PER_S, 0.02, 5.0),
        (FAST_M_PER_S, 0.1, 0.05),
    )
]
"""Cubes side by side: mass [kg] matters to springs of a fixed stiffness, and height [m] to bodies that tip."""

NAMES = tuple(cube.name for cube in CUBES)

BALLS = [
    thrown(
        ball(f"{along} m/s along", (0.0, -1.0 - along, RADIUS_M + 0.01), mass_kg=0.5),
        (along, 0.0, -IMPACT_M_PER_S),
    )
    for along in (1.0, 2.0, 6.0)
]
"""Balls that meet the ground at 27, 45 and 72 degrees from the normal."""

SLIDE_S = 0.6
"""Simulated time [s]: all hops reach their top in it, and the slower cubes stop after 0.4 s."""

SLIDE = Scenario(
    "slide-hop",
    "SlopeSlider-2-wood",
    SLIDE_S,
    Scene(
        bodies=(*CUBES, *BALLS, ground()),
        contacts=(
            contact(
                (*NAMES, *(ball.name for ball in BALLS)), "ground", friction=FRICTION
            ),
        ),
        duration_s=SLIDE_S,
    ),
    released=NAMES,
)

MIN_HOP_MM, HOP_SCATTER = 5.0, 2.0
"""Hop of a quarter of the smaller cube [mm]; and ratio within which hops scatter for one time constant, with either
cone and with `impratio` 1 to 100."""

SAME_REBOUND, USUAL_REBOUND = 0.1, 0.3
"""Change of a rebound that does not count, and a rebound that does not: MuJoCo's defaults have 0.13."""

SAME_FRICTION, USUAL_FRICTION = 0.1, 0.25
"""The same for the error of friction in impacts over Coulomb's; MuJoCo's defaults have 0.16."""

STOP_M, STOP_TOLERANCE = SLOW_M_PER_S**2 / (2.0 * FRICTION * G), 0.1
"""Coulomb's stopping distance v^2 / (2 mu g) of the slower cubes [m], and its relative tolerance: the friction of real
cubes scatters by up to 8 % (slope_slider_30deg)."""


def hop_mm(measurements: Measurements, settings: Settings) -> float:
    """Return the largest height that cubes gain while they slide with some settings [mm].

    It is infinite where the simulation diverges or a slower cube does not stop where it must, and NaN where it is not
    measured.
    """
    rollout = measurements.rollout(SLIDE, settings)
    if isinstance(rollout, PartOutcome):
        return math.nan if rollout.verdict is SanityVerdict.NOT_MEASURED else math.inf
    stops_m = [rollout.displacement(name)[-1, 0] for name in NAMES[:2]]
    if not np.allclose(stops_m, STOP_M, rtol=STOP_TOLERANCE):
        return math.inf
    heights_m = [lowest_m(rollout, cube.name, cube.shape.corners_m) for cube in CUBES]
    return 1e3 * max(float((height - height[0]).max()) for height in heights_m)


def impacts(measurements: Measurements, settings: Settings) -> tuple[float, float]:
    """Return the rebound of a steep impact, and the largest relative error of friction in impacts at three angles.

    A ball that arrives without spin at the tangential speed v loses min(mu N, 2/7 m v). NaN where not measured.
    """
    rollout = measurements.rollout(SLIDE, settings)
    if isinstance(rollout, PartOutcome):
        return math.nan, math.nan
    last, errors = rollout.sample_at(IMPACT_S), []
    for each in BALLS:
        start, *_, end = rollout.velocity(each.name)[: last + 1]
        pressed = end[2] - start[2] + G * rollout.times_s[last]
        allowed = min(FRICTION * pressed, 2.0 / 7.0 * start[0])
        errors.append(abs((start[0] - end[0]) / allowed - 1.0))
    steep = rollout.velocity(BALLS[0].name)[: last + 1, 2]
    return float(steep.max()) / IMPACT_M_PER_S, max(errors)


def changes_rebound(
    before: float, after: float, solref: Sequence[float] = (0.02, 1.0)
) -> bool:
    """Return whether a change takes a rebound that contacts mean, or adds one; False where one was not measured.

    Args:
        before: Restitution before the change.
        after: Restitution after it.
        solref: The contact's before it; with critical damping, no rebound is meant.
    """
    is_meant = solref[0] <= 0.0 or solref[1] < 1.0
    is_lost = is_meant and after < before - SAME_REBOUND
    return is_lost or after > max(USUAL_REBOUND, before + SAME_REBOUND)


def contact_harm(
    measurements: Measurements,
    before: TrainingConfiguration,
    after: TrainingConfiguration,
) -> bool:
    """Return whether sliding bodies hop more, impacts rebound otherwise, or friction in them is farther from Coulomb's.

    Each set of contact constants is compared with that of the same geoms, or the first one.
    """
    for geoms, settings in after.contact_sets.items():
        sets = before.contact_sets
        former = sets.get(geoms, next(iter(sets.values())))
        if hops_more(*(hop_mm(measurements, each) for each in (former, settings))):
            return True
        (rebound, error), (new_rebound, new_error) = (
            impacts(measurements, each) for each in (former, settings)
        )
        solref = former.get("contact_solref", (0.02, 1.0))
        if changes_rebound(rebound, new_rebound, solref):
            return True
        if new_error > max(USUAL_FRICTION, error + SAME_FRICTION):
            return True
    return False


def hops_more(before_mm: float, after_mm: float) -> bool:
    """Return whether sliding bodies hop visibly more after a change; False where a hop was not measured."""
    return after_mm > max(MIN_HOP_MM, HOP_SCATTER * before_mm)


# --- the target's own model ------------------------------------------------------------------------------------------

SPEED_BLOCKS, BLOCK_S = 4, 0.25
"""Number and shortest time [s] of the blocks in which the speed of a model is measured; the fastest one counts."""


def motion_harm(before: Robot, after: Robot) -> str:
    """Return how a change throws a model up from its start, or lets its robot fall; empty if it does not."""
    if not before.model.nv:
        return ""
    rise_mm, stands = _motion(before)
    new_rise_mm, stands_then = _motion(after)
    if hops_more(rise_mm, new_rise_mm):
        return f"the model jumps {new_rise_mm:.3g} mm from its start"
    if stands and not stands_then:
        return "the robot falls within 2 s, before it stands"
    return ""


def _motion(robot: Robot) -> tuple[float, bool]:
    """Return how a model moves from its start, with the controls of its keyframe.

    Returns:
        The largest rise of the centre of mass of a tree of bodies [mm], and whether the robot stands at the end.
        The rise is at least the depth of the overlap at the start, and infinite for a state that diverges.
    """
    run = rest(robot, is_refined=False)
    if np.isfinite(run.diverged_s):
        return math.inf, False
    depth_m = -float(start_data(robot.model).contact.dist.min(initial=0.0))
    rise_m = float((run.heights_m - run.heights_m[0]).max(initial=depth_m))
    stands, standing = False, robot.standing
    if standing is not None:
        tree = robot.model.body_treeid[standing.body]
        first_m, last_m = run.heights_m[[0, -1], tree] - standing.ground_m
        stands = bool(last_m > FELL * first_m)
    return 1e3 * rise_m, stands


def speed_ratio(before: Robot, after: Robot) -> float | None:
    """Return the simulated time of a model in a second of the processor with a change, over that without.

    None where one of both states diverges, as a state that is reset costs another time.
    """
    models = before.model, after.model
    runs = [(model, start_data(model), list[float]()) for model in models]
    for _ in range(SPEED_BLOCKS):
        for model, data, speeds in runs:
            started, before_s, spent_s = time.process_time(), data.time, 0.0
            while spent_s < BLOCK_S:
                mujoco.mj_step(model, data, nstep=10)
                spent_s = time.process_time() - started
            if has_diverged(data):
                return None
            speeds.append((data.time - before_s) / spent_s)
    slow, fast = (max(speeds) for _, _, speeds in runs)
    return fast / slow
