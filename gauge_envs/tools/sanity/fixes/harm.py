"""Find the harm of a change: hops of sliding cubes, rebound and friction of impacts, a model that jumps or falls.

A soft contact damps the sliding speed like the normal speed. Where it stops a body within a step, friction mu lifts a
body of speed v with mu v. The body then hops by mu^2 v^2 / (2 g): 54 mm at 4 m/s.
"""

import math
import time
from collections.abc import Sequence
from functools import cache

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs.scene import GRAVITY_M_PER_S2 as G
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.sanity.model_checks.at_rest import RESTING_MM_PER_S
from gauge_envs.tools.sanity.model_checks.ground import FELL
from gauge_envs.tools.sanity.model_checks.runs import has_diverged, rest, start_data
from gauge_envs.tools.sanity.pair_bench import FAST_M_PER_S, Bench, Touch
from gauge_envs.tools.sanity.robot.robot import Robot
from gauge_envs.tools.sanity.verdict import Settings, TrainingConfiguration

FRICTION, MASS_KG = 0.257, 0.5
"""Friction of the measured wooden cube (scoring/facts/slope_slider_30deg_summary.toml), and mass of the block [kg]."""

BLOCK = """<mujoco>
  <worldbody>
    <geom name="ground" type="plane" size="0 0 1"/>
    <body pos="0 0 0.05">
      <joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/><joint type="slide"/>
      <geom name="block" type="box" size="0.05 0.05 0.05" mass="{}"/>
    </body>
  </worldbody>
  <contact><pair geom1="ground" geom2="block" friction="{} {}"/></contact>
</mujoco>"""
"""A block that does not turn. Mass and size change nothing: MuJoCo softens contacts by the inverse weight of bodies."""

MIN_HOP_MM, HOP_SCATTER = 5.0, 2.0
"""Hop of a quarter of a cube of 2 cm [mm]; and ratio within which hops scatter for one time constant, with either
cone and with `impratio` 1 to 100."""

SAME_REBOUND, USUAL_REBOUND = 0.1, 0.3
"""Change of a rebound that does not count, and a rebound that does not: MuJoCo's defaults have 0.12."""

SAME_FRICTION, USUAL_FRICTION = 0.1, 0.25
"""The same for the error of friction in impacts over Coulomb's; MuJoCo's defaults have 0.03."""


@cache
def _block() -> Bench:
    """Return the block on a level ground, with MuJoCo's defaults."""
    model = mujoco.MjModel.from_xml_string(BLOCK.format(MASS_KG, FRICTION, FRICTION))
    level = Rotation.identity()
    touch = Touch(0, 1, MASS_KG, MASS_KG * G, 0.0, level, level, np.zeros(3))
    return Bench(model, touch, FRICTION)


def block(settings: Settings) -> Bench:
    """Return the bench of a block that slides and falls with some settings."""
    return _block().changed(settings)


def changes_rebound(
    before: float, after: float, solref: Sequence[float] = (0.02, 1.0)
) -> bool:
    """Return whether a change takes a rebound that contacts mean, or adds one.

    Args:
        before: Restitution before the change.
        after: Restitution after it.
        solref: The contact's before it; with critical damping, no rebound is meant.
    """
    is_meant = solref[0] <= 0.0 or solref[1] < 1.0
    is_lost = is_meant and after < before - SAME_REBOUND
    return is_lost or after > max(USUAL_REBOUND, before + SAME_REBOUND)


def contact_harm(before: TrainingConfiguration, after: TrainingConfiguration) -> bool:
    """Return whether sliding bodies hop more, impacts rebound otherwise, or friction in them is farther from Coulomb's.

    Each set of contact constants is compared with that of the same geoms, or the first one.
    """
    sets = before.contact_sets
    for geoms, settings in after.contact_sets.items():
        former = sets.get(geoms, next(iter(sets.values())))
        old, new = block(former), block(settings)
        if hops_more(old.hop_mm(FAST_M_PER_S), new.hop_mm(FAST_M_PER_S)):
            return True
        (rebound, ratios), (new_rebound, new_ratios) = old.impacts(), new.impacts()
        solref = former.get("contact_solref", (0.02, 1.0))
        if changes_rebound(rebound, new_rebound, solref):
            return True
        error, new_error = (
            max(abs(ratio - 1.0) for ratio in each.values())
            for each in (ratios, new_ratios)
        )
        if new_error > max(USUAL_FRICTION, error + SAME_FRICTION):
            return True
    return False


def hops_more(before_mm: float, after_mm: float) -> bool:
    """Return whether sliding bodies hop visibly more after a change."""
    return after_mm > max(MIN_HOP_MM, HOP_SCATTER * before_mm)


# --- the target's own model ------------------------------------------------------------------------------------------

SPEED_BLOCKS, BLOCK_S = 4, 0.25
"""Number and shortest time [s] of the blocks in which the speed of a model is measured; the fastest one counts."""

SETTLING_MM_PER_S = 50.0
"""Speed of a body with motors that settles [mm/s]; HalfCheetah's limbs swing on their springs with up to 30 mm/s."""


def motion_harm(before: Robot, after: Robot) -> bool:
    """Return whether a change throws a model up, moves what rested, or lets its robot fall within 2 s."""
    if not before.model.nv:
        return False
    rise_mm, speeds, stands = _motion(before)
    new_rise_mm, new_speeds, still_stands = _motion(after)
    is_driven = np.isin(before.model.body_treeid, [*before.driven_trees])
    limits = np.where(is_driven, SETTLING_MM_PER_S, RESTING_MM_PER_S)
    moves = np.any((speeds < RESTING_MM_PER_S) & (new_speeds > limits))
    return bool(moves or hops_more(rise_mm, new_rise_mm) or stands > still_stands)


def _motion(robot: Robot) -> tuple[float, FloatArray, bool]:
    """Return how a model moves from its start, with the controls of its keyframe.

    Returns:
        The largest rise of the centre of mass of a tree of bodies [mm], the speeds of bodies at the end [mm/s], and
        whether the robot stands then.
        The rise is at least the depth of the overlap at the start, and infinite for a state that diverges.
    """
    run = rest(robot)
    if np.isfinite(run.diverged_s):
        return math.inf, np.full(robot.model.nbody, np.inf), False
    depth_m = -float(start_data(robot.model).contact.dist.min(initial=0.0))
    rise_m = (run.heights_m - run.heights_m[0]).max(initial=depth_m)
    stands, standing = False, robot.standing
    if standing is not None:
        tree = robot.model.body_treeid[standing.body]
        first_m, last_m = run.heights_m[[0, -1], tree] - standing.ground_m
        stands = bool(last_m > FELL * first_m)
    return 1e3 * rise_m, run.speeds_mm_per_s, stands


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
