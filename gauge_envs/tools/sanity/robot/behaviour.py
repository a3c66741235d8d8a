"""What a robot does, and whether it is the better for a change."""

from dataclasses import replace
from functools import cached_property

import mujoco
import numpy as np

from gauge_envs.errors import TargetError
from gauge_envs.tools.sanity.model import PhenomenonResult, Settings, Verdict
from gauge_envs.tools.sanity.phenomena.base import facts
from gauge_envs.tools.sanity.robot.finding import OF_DRIVES, judged_row, limits_of
from gauge_envs.tools.sanity.robot.joints import position_servos, servos, start
from gauge_envs.tools.sanity.robot.mended_model import element_names
from gauge_envs.tools.sanity.robot.motions import PUSH_SHARES, hold_pose, pushed_m
from gauge_envs.tools.sanity.robot.remedy import Remedy
from gauge_envs.tools.sanity.robot.robot import GEOM_FIELDS, LENGTHS, Robot, once
from gauge_envs.tools.sanity.robot.rollout import half_step_s
from gauge_envs.tools.sanity.robot.rows import ROWS

ORDER = (
    "robot-maker",
    *("robot-size", "robot-density", "robot-bound", "robot-visual-mass"),
    *("robot-inertia", "robot-gravcomp", "robot-medium"),
    *("robot-range", "robot-unlimited", "robot-command", "robot-mirror"),
    *("robot-sides", "robot-alike", "robot-overlap"),
    *("robot-stops", "robot-coupling"),
    *("robot-wiring", "robot-joined", "robot-solref"),
    *("robot-keyframe", "robot-free"),
    *("robot-feet", "robot-friction", "robot-torsion", "robot-floor-friction"),
    *("floor-tilt", "robot-level", "robot-balance"),
    *("robot-torque", "robot-rotor", "robot-armature", "robot-stiffness"),
    *("robot-damping", "robot-frictionloss", "robot-servo", "robot-sag", "robot-lag"),
    *("robot-ringing", "robot-dry", "robot-holds", "robot-stands", "robot-loads"),
    *("robot-saturation", "robot-slip", "robot-energy"),
)
"""Rows in the order in which they are mended, and those that a change must not make worse.

The scale and the delay of actions are not of the model. A solver that leaves forces is a fault of its release, which a
note of the row names.
"""

OF_BODIES = frozenset(
    {
        *("robot-size", "robot-density", "robot-bound", "robot-visual-mass"),
        *("robot-inertia", "robot-gravcomp", "robot-overlap", "robot-torsion"),
        *("robot-feet", "robot-friction", "robot-floor-friction", "floor-tilt"),
    }
)
"""Rows that joints, actuators and options do not change."""

KEEP_STEPS = OF_DRIVES - {"robot-damping", "robot-ringing"} | {"robot-sides"}
"""Rows whose remedies let no servo become slower."""

OF_CONTACTS = frozenset(
    {
        *("robot-holds", "robot-stands", "robot-loads", "robot-saturation"),
        *("robot-slip", "robot-overlap", "robot-torsion", "robot-friction"),
    }
)
"""Rows that constants of contacts, and the options that only contacts read, change."""

CONTACT_OPTIONS = frozenset({"cone", "impratio", *GEOM_FIELDS})

WITHOUT_TOP = frozenset(
    {"robot-dry", "robot-torque", "robot-stiffness", "robot-holds", "robot-ringing"}
)
"""Rows whose upper limit is none: more is no worse."""

HALF_USED = 0.5
"""Share of a limit up to which a row may change."""

AFTER_A_FALL = frozenset(
    {"robot-stands", "robot-loads", "robot-saturation", "robot-slip", "robot-lag"}
)
"""Rows that a robot shows only once it stands, or stays finite."""

STATED_ANYWAY = {"robot-floor-friction": "robot-friction"}
"""Rows that change because a row is mended: the friction that the model states is met at last."""

WORSE = 1.1
"""Growth of an error, a time or the used share of a limit that counts as worse."""

FAIR_STEP_S = 0.14
"""Half of a step of 0.3 rad in the slowest servo of makers' models [s]."""

FAIR_POSE_RAD = 0.1
"""Error of a held pose that is no merit to fall below: servos of makers' models sag by up to 97 mrad [rad]."""

SLIPS, SAFE_PUSH_M = 1.5, 0.005
"""Growth of the displacement by a push that counts as slip, and a displacement that is no slip [m]."""

SHAPES = ("body_", "geom_", "compiler_", "jnt_axis", "jnt_range")
"""Starts of the names of changes that move bodies, or decide what touches."""


class Behaviour:
    """What a robot does, measured when it is asked for.

    Attributes:
        robot: The robot.
    """

    def __init__(self, robot: Robot) -> None:
        self.robot = robot

    def row(self, name: str) -> PhenomenonResult:
        """Return a row of the robot."""
        return judged_row(name, ROWS[name](self.robot))

    @cached_property
    def is_held(self) -> bool:
        """Whether servos hold the robot, so that it has a pose."""
        has_feet = self.robot.standing is not None
        few = has_feet and len(self.robot.standing.feet) < 3  # type: ignore[union-attr]
        return bool(servos(self.robot.model).any()) and not few

    @cached_property
    def pose_error_rad(self) -> float:
        """Largest angle by which a driven hinge is off its command after 2 s [rad]; infinite if the state diverges."""
        motion = hold_pose(self.robot)
        return motion.pose_error_rad if np.isinf(motion.diverged_s) else np.inf


@once
def step_s(robot: Robot, actuator: int) -> float:
    """Return the time of half a step in the whole robot [s]; one that floats is without gravity and contact."""
    model = robot.without(*(("gravity", "contact") if robot.is_floating else ()))
    return half_step_s(model, start(robot, model), actuator)


def tried(before: Behaviour, remedy: Remedy, name: str) -> tuple[Behaviour | None, str]:
    """Return the behaviour after a remedy that is accepted, or why it is not."""
    try:
        model, _ = before.robot.changed(remedy.changes)
    except TargetError as error:
        return None, str(error)
    after = Behaviour(_with_model(before.robot, model, remedy.changes))
    keep_unconcerned(before.robot, after.robot, remedy.changes)
    mended = after.row(name)
    if mended.verdict is not Verdict.INSIDE:
        return None, f"{_change_text(before, after, name)}, not inside"
    refusal = harm(before, after, remedy, name)
    return (None, refusal) if refusal else (after, "")


def _is_of_shape(changes: Settings) -> bool:
    """Return whether changes move bodies, or decide what touches."""
    return "contact" in changes or any(name.startswith(SHAPES) for name in changes)


def keep_unconcerned(before: Robot, after: Robot, changes: Settings) -> None:
    """Give a changed robot the rows that were measured before, and that the changes do not concern."""
    names = frozenset(ROWS)
    if changes and set(changes) <= CONTACT_OPTIONS:
        names -= OF_CONTACTS
    elif changes:
        names = frozenset() if _is_of_shape(changes) else OF_BODIES
    after.known.update({n: before.known[n] for n in names if n in before.known})


def _with_model(robot: Robot, model: mujoco.MjModel, changes: Settings) -> Robot:
    """Return a robot with a changed model; one whose feet may be others, or elsewhere, is read again."""
    spec = robot.spec_after(changes)
    further = {key: value for key, value in changes.items() if key != LENGTHS}
    every = {**robot.changes, **further}
    if not _is_of_shape(changes):
        return replace(robot, model=model, changes=every)
    from gauge_envs.tools.sanity.robot.mujoco_model import mujoco_configuration

    read = mujoco_configuration(model, name="", source="", spec=spec).robot
    assert read is not None
    return replace(
        read,
        pair=robot.pair,
        action_rad=robot.action_rad,
        delay_s=robot.delay_s,
        changes=every,
    )


def harm(before: Behaviour, after: Behaviour, remedy: Remedy, name: str = "") -> str:
    """Return what is worse for a robot after a change, with both values; empty when nothing is.

    Args:
        before: Its behaviour before.
        after: Its behaviour after.
        remedy: The change.
        name: Row that is mended.
    """
    for other in ORDER:
        if other in (name, STATED_ANYWAY.get(name), "robot-alike", "robot-maker"):
            # Gains of one joint may change beside those of the others, and published numbers may be the mistake.
            continue
        if name == "robot-size" and not after.row(other).verdict.is_off:
            # In another unit of lengths it was another robot.
            continue
        if _is_worse(before.row(other), after.row(other)):
            return f"{other} gets worse, {_change_text(before, after, other)}"
    was, now = (
        {part.name for part in one.row("robot-sides").parts if part.verdict.is_off}
        for one in (before, after)
    )
    if now - was:
        return f"two sides that are alike would differ: {min(now - was)}"
    return _moved(before, after, remedy) or _slower(before, after, remedy, name)


def _moved(before: Behaviour, after: Behaviour, remedy: Remedy) -> str:
    """Return by how much a robot keeps its pose less well after a change, or slips where it is pushed."""
    if not before.is_held:
        return ""
    least = 0.0 if remedy.scales_gains else FAIR_POSE_RAD
    was, now = before.pose_error_rad, after.pose_error_rad
    if now > max(WORSE * was + 1e-3, least):
        return (
            f"it holds its pose within {1e3 * now:.3g} mrad instead of {1e3 * was:.3g}"
        )
    if not (before.robot.is_floating and CONTACT_OPTIONS & {*remedy.changes}):
        return ""
    pushes_m = (pushed_m(before.robot), pushed_m(after.robot))
    for share, was, now in zip(PUSH_SHARES, *pushes_m, strict=True):
        if not now <= max(SLIPS * was, SAFE_PUSH_M):
            return f"a push of {share:g} of its weight moves it by {1e3 * now:.3g} mm instead of {1e3 * was:.3g}"
    return ""


def _slower(before: Behaviour, after: Behaviour, remedy: Remedy, name: str) -> str:
    """Return which servo is slower after a change that mends a row."""
    fastest_s = 1e-3 * limits_of("robot-lag")[0]
    for actuator in position_servos(before.robot):
        was, now = step_s(before.robot, actuator), step_s(after.robot, actuator)
        # A step that was faster than joints turn, or that a fault of the body made fast, was no merit.
        is_no_merit = was < fastest_s or name not in KEEP_STEPS
        least_s = max(remedy.fair_step_s, FAIR_STEP_S if is_no_merit else 0.0)
        rounding_s = float(before.robot.model.opt.timestep)
        if now > max(WORSE * was + rounding_s, least_s) and not np.isnan(was):
            (servo,) = element_names(before.robot, "actuator", [actuator])
            return f"{servo} takes {1e3 * now:.3g} ms to half a step instead of {1e3 * was:.3g}"
    return ""


def _is_worse(before: PhenomenonResult, after: PhenomenonResult) -> bool:
    """Return whether a row is worse: out of its limits, farther out, or nearer to them in the half next to them."""
    if Verdict.DECLINED in (before.verdict, after.verdict) or after.advisory:
        is_shown = after.phenomenon in AFTER_A_FALL
        return before.verdict is Verdict.DECLINED and after.is_flag and not is_shown
    was, now = _strain(before), _strain(after)
    if not after.verdict.is_off and now <= HALF_USED:
        return False
    return now > WORSE * was or (after.verdict.is_off and not before.verdict.is_off)


def _strain(row: PhenomenonResult) -> float:
    """Return the share of its limit that a row uses, more than 1 outside; infinite where it has no value."""
    if row.configured is None:
        return np.inf
    low, high = limits_of(row.phenomenon)
    value = row.configured
    if value < min(low, 0.0):
        return np.inf
    below = low / max(value, 1e-12)
    return below if row.phenomenon in WITHOUT_TOP else max(below, value / high)


def _change_text(before: Behaviour, after: Behaviour, name: str) -> str:
    """Return the values of a row before and after a change."""
    unit = facts("robot_rows")[name]["unit"]
    values = (before.row(name).configured, after.row(name).configured)
    was, now = ("none" if value is None else f"{value:.3g}" for value in values)
    return f"{was} to {now}{'' if unit == '1' else f' {unit}'}"


def after_changes(robot: Robot, changes: Settings) -> Behaviour:
    """Return what a robot does after changes."""
    return Behaviour(_with_model(robot, robot.changed(changes)[0], changes))
