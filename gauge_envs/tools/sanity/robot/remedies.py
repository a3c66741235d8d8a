"""Find changes of a robot's model that mend its rows, and for which the robot itself is the better.

Rows are mended one after the other, causes before their effects. For each row, changes are tried in a fixed order: the
physical cause, then the solver, then the gains. One is accepted if the row is mended, the robot still holds its pose,
its servos are no slower, and no other row is worse.
"""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import permutations
from typing import Any

import mujoco
import numpy as np

from gauge_envs.errors import TargetError
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.sanity.model import PhenomenonResult, Settings, Verdict
from gauge_envs.tools.sanity.phenomena.base import facts
from gauge_envs.tools.sanity.robot.mended_model import (
    class_words,
    element_names,
    listed,
)
from gauge_envs.tools.sanity.robot.model_rows import (
    FAIR_RAD_PER_S2,
    LEAST_RAD_PER_S2,
    MOST_RAD_PER_S2,
    SERVO_ERROR_RAD,
    dof_of,
    driven_dofs,
    driven_joints,
    foot_load_n,
    judged_row,
    largest_weights_nm,
    leg_nm,
    limits_of,
    loads_nm,
    motors_of,
    of_elements,
    one_sided,
    position_servos,
    servos,
    springs,
    standing_of,
    start,
    stiffness,
)
from gauge_envs.tools.sanity.robot.robot import (
    ELEMENT,
    GEOM_FIELDS,
    LENGTHS,
    Robot,
    enabling,
    once,
    switched_off,
)
from gauge_envs.tools.sanity.robot.rollout import (
    deflecting_nm,
    half_step_s,
    hold_pose,
    lone_half_step_s,
    servo_responses,
)
from gauge_envs.tools.sanity.robot.rows import ROWS
from gauge_envs.tools.sanity.robot.sides import (
    SAME_PLACE_M,
    MirrorPair,
    differences,
    mirror_pairs,
    quantities,
)

ORDER = (
    *("robot-size", "robot-density", "robot-bound", "robot-visual-mass"),
    *("robot-inertia", "robot-gravcomp", "robot-medium"),
    *("robot-range", "robot-unlimited", "robot-command", "robot-mirror"),
    *("robot-sides", "robot-overlap"),
    *("robot-stops", "robot-coupling"),
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

OF_DRIVES = frozenset(
    {
        *("robot-frictionloss", "robot-dry", "robot-armature", "robot-rotor"),
        *("robot-stiffness", "robot-sag", "robot-lag", "robot-torque", "robot-sides"),
    }
)
"""Rows on what drives and brakes joints, whose remedies let no servo become slower."""

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

LARGEST_SAG_RAD = 0.15
"""Largest angle by which the weight may deflect a servo whose gain is scaled [rad]."""

PER_DEGREE = float(np.degrees(1.0))


@dataclass(frozen=True, kw_only=True)
class Remedy:
    """A change of the model that may mend a row.

    Attributes:
        text: The change in the words of a model.
        changes: The same, by names that `Robot.changed` knows.
        scales_gains: Whether it makes servos weaker or stronger at will, so that they must hold what they held.
        rival: Remedy of which the model does not say whether it is the right one instead; None without one.
        fair_step_s: Half of a step of like joints of the robot, slower than which no servo becomes [s].
    """

    text: str
    changes: Settings
    fair_step_s: float = 0.0
    scales_gains: bool = False
    rival: "Remedy | None" = None


@dataclass(frozen=True, kw_only=True)
class Attempt:
    """What became of a remedy.

    Attributes:
        row: Row that it was to mend.
        remedy: The remedy.
        refusal: Why it is none, with the values that were measured; empty for an accepted one.
    """

    row: str
    remedy: Remedy
    refusal: str = ""

    @property
    def line(self) -> str:
        """The remedy, and how far it came."""
        return f"{self.remedy.text} for {self.row}: {self.refusal or 'mends it'}"


@dataclass(frozen=True, kw_only=True)
class Remedies:
    """All remedies of a robot.

    Attributes:
        robot: The robot with all accepted changes.
        attempts: All attempts in the order in which they were made.
        unmended: Why each row that is left has no remedy, by its id.
    """

    robot: Robot
    attempts: tuple[Attempt, ...]
    unmended: Mapping[str, str]

    @property
    def changes(self) -> dict[str, Any]:
        """All accepted changes."""
        found: dict[str, Any] = {}
        for one in self.attempts:
            if not one.refusal:
                found |= one.remedy.changes
        return found

    @property
    def texts(self) -> tuple[str, ...]:
        """All accepted changes in words."""
        texts = (one.remedy.text for one in self.attempts if not one.refusal)
        return tuple(dict.fromkeys(texts))


def find_remedies(robot: Robot, flags: Collection[str]) -> Remedies:
    """Return changes that mend flagged rows of a robot, as measured after each was applied.

    Args:
        robot: The robot.
        flags: Flagged rows; rows without a remedy are left out.
    """
    now, attempts, unmended = Behaviour(robot), [], []
    for name in ORDER:
        if name not in flags or not now.row(name).is_flag:
            continue
        for remedy in REMEDIES.get(name, _stated(name))(now.robot):
            after, refusal = _tried(now, remedy, name)
            rival = remedy.rival
            if after is not None and rival and _tried(now, rival, name)[0]:
                after, refusal = None, f"and so does {rival.text}"
            attempts.append(Attempt(row=name, remedy=remedy, refusal=refusal))
            if after is not None:
                now = after
                break
        else:
            unmended.append(name)
            if name == "robot-size":
                # Nothing else can be judged before the unit of lengths is right.
                break
    # What mends a row may mend one before it too.
    left = [name for name in unmended if now.row(name).is_flag]
    reasons = {name: NO_REMEDY.get(name, NO_NUMBER) for name in left}
    return Remedies(robot=now.robot, attempts=tuple(attempts), unmended=reasons)


# --- whether a robot is better ---------------------------------------------------------------------------------------


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


def _tried(
    before: Behaviour, remedy: Remedy, name: str
) -> tuple[Behaviour | None, str]:
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


SHAPES = ("body_", "geom_", "compiler_", "jnt_axis", "jnt_range")
"""Starts of the names of changes that move bodies, or decide what touches."""


def _is_of_shape(changes: Settings) -> bool:
    """Return whether changes move bodies, or decide what touches."""
    return any(name.startswith(SHAPES) for name in changes)


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
        if other in (name, STATED_ANYWAY.get(name)):
            continue
        if _is_worse(before.row(other), after.row(other)):
            return f"{other} gets worse, {_change_text(before, after, other)}"
    if before.is_held:
        least = 0.0 if remedy.scales_gains else FAIR_POSE_RAD
        was, now = before.pose_error_rad, after.pose_error_rad
        if now > max(WORSE * was + 1e-3, least):
            return f"it holds its pose within {1e3 * now:.3g} mrad instead of {1e3 * was:.3g}"
    fastest_s = 1e-3 * limits_of("robot-lag")[0]
    for actuator in position_servos(before.robot):
        was, now = step_s(before.robot, actuator), step_s(after.robot, actuator)
        # A step that was faster than joints turn, or that a fault of the body made fast, was no merit.
        is_no_merit = was < fastest_s or name not in OF_DRIVES
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


# --- what the robot is made of ---------------------------------------------------------------------------------------


def weights_nm(robot: Robot) -> FloatArray:
    """Return what each degree of freedom must hold of the robot's weight [Nm], shape [nv].

    On a fixed base it is the largest torque of gravity in random poses. Of a robot that stands, each foot carries the
    same share of the weight.
    """
    if not robot.is_floating:
        return largest_weights_nm(robot)
    model, data = robot.model, start(robot)
    load_n = foot_load_n(robot) * np.asarray(robot.up)
    held = data.qfrc_bias - data.qfrc_gravcomp
    for geoms in standing_of(robot).feet.values():
        jacobian = np.zeros((3, model.nv))
        mujoco.mj_jacGeom(model, data, jacobian, None, geoms[0])
        held = held - jacobian.T @ load_n
    return np.abs(held)


# --- remedies of each row --------------------------------------------------------------------------------------------

Finder = Callable[[Robot], Iterator[Remedy]]

REMEDIES: dict[str, Finder] = {}
"""Function that yields the remedies of a row, the preferred ones first."""


def remedies_of(*names: str) -> Callable[[Finder], Finder]:
    """Return a decorator that adds the remedies of rows."""

    def add(function: Finder) -> Finder:
        for name in names:
            REMEDIES[name] = function
        return function

    return add


def _stated(name: str) -> Finder:
    """Return the remedy that a row states itself."""

    def found(robot: Robot) -> Iterator[Remedy]:
        finding = ROWS[name](robot)
        if finding.changes:
            yield Remedy(text=finding.advice, changes=dict(finding.changes))

    return found


def _in_words(robot: Robot, changes: Settings) -> Remedy:
    """Return changes as a remedy in the words of the model's classes."""
    return Remedy(text=class_words(robot, changes), changes=changes)


def _elements(robot: Robot, changes: Settings) -> Iterator[Remedy]:
    """Yield a remedy in the words of the model's classes, unless it changes nothing."""
    if changes:
        yield _in_words(robot, changes)


def _rows(changes: Settings, array: str) -> list[int]:
    """Return the rows of an array of the model that are changed."""
    found = [ELEMENT.fullmatch(name) for name in changes]
    return [int(one[2]) for one in found if one is not None and one[1] == array]


def _rounded(value: float) -> float:
    return float(f"{value:.2g}")


def _from_others(
    values: Mapping[int, float], limits: Mapping[int, float], wrong: Collection[int]
) -> dict[int, float]:
    """Return for each wrong joint the value of the right one whose largest torque is nearest; empty without one."""
    right = [dof for dof in values if dof not in wrong]
    if not right:
        return {}
    return {
        dof: values[min(right, key=lambda one: abs(np.log(limits[one] / limits[dof])))]
        for dof in wrong
    }


def _after(robot: Robot, changes: Settings) -> Behaviour:
    """Return what a robot does after changes."""
    return Behaviour(_with_model(robot, robot.changed(changes)[0], changes))


UNITS_M = {
    "millimetres": 1e-3,
    "centimetres": 1e-2,
    "inches": 0.0254,
    "kilometres": 1e3,
}
"""Units in which lengths may be stated [m]."""


@remedies_of("robot-size")
def _size(robot: Robot) -> Iterator[Remedy]:
    """Yield metres for the unit with which fewest rows are flagged, unless another one does as well."""
    if robot.spec is None:
        return
    flags: list[tuple[float, Remedy]] = []
    for unit, factor in UNITS_M.items():
        text = f"lengths times {factor:g}: every pos, size, fromto and scale of meshes is in {unit}"
        remedy = Remedy(text=text, changes={LENGTHS: factor})
        after = _after(robot, remedy.changes)
        if not after.row("robot-size").is_flag:
            flags.append((sum(after.row(name).is_flag for name in ORDER), remedy))
    yield from _least(flags, 0.0)


@remedies_of("robot-range")
def _range(robot: Robot) -> Iterator[Remedy]:
    if robot.spec is None:
        return
    is_degree = bool(robot.spec.compiler.degree)
    word = "radian" if is_degree else "degree"
    yield Remedy(
        text=f'<compiler angle="{word}"/>',
        changes={"compiler_degree": not is_degree},
    )
    yield from _elements(robot, dict(ROWS["robot-range"](robot).changes))


EITHER_SIDE = "either side can be the wrong one, and the model does not say which"

NO_REMEDY: Mapping[str, str] = {
    "robot-size": "no unit of lengths fits alone: scale every pos, size, fromto and mesh; the rest is judged then",
    "robot-balance": "masses, lengths or the pose can be wrong, and the model does not say which",
    "robot-level": "either leg can be the wrong one, or a foot itself, and the model does not say which",
    "robot-mirror": EITHER_SIDE,
    "robot-sides": EITHER_SIDE,
    "robot-unlimited": "a joint without a range turns as far as the real one, which the model does not say",
}
"""Why no change of a number mends a row for certain, of rows that may have no remedy."""

NO_NUMBER = "no change of a number mends it without harm"
"""The reason for any other row whose remedies fail."""


@remedies_of("robot-mirror")
def _mirror(robot: Robot) -> Iterator[Remedy]:
    """Yield the axis, then the range, of each of two sides, unless that of the other one does as well."""
    model = robot.model
    high = limits_of("robot-mirror")[1]
    pairs = [
        pair
        for pair in mirror_pairs(robot)
        if model.jnt_limited[[pair.joint, pair.other]].all()
        and pair.range_apart_rad > high
    ]
    for field in ("jnt_axis", "jnt_range"):
        sides: list[Remedy] = []
        for several in zip(*[(one.joint, one.other) for one in pairs], strict=True):
            of_side = dict(zip(several, pairs, strict=True))
            changes = {
                f"{field}[{joint}]": 0.0 - model.jnt_axis[joint]
                if field == "jnt_axis"
                else pair.range_of(joint) + model.qpos0[model.jnt_qposadr[joint]]
                for joint, pair in of_side.items()
            }
            sides.append(_in_words(robot, changes))
        for one, rival in permutations(sides, 2):
            yield replace(one, rival=rival)


@remedies_of("robot-balance")
def _balance(robot: Robot) -> Iterator[Remedy]:
    """Yield the other direction of like joints of both legs with which soles lie flattest, unless others do as well."""
    turns: list[tuple[float, Remedy]] = []
    for pair in mirror_pairs(robot):
        changes = {
            f"jnt_axis[{joint}]": 0.0 - robot.model.jnt_axis[joint]
            for joint in (pair.joint, pair.other)
        }
        after = _after(robot, changes)
        if not after.row("robot-balance").is_flag:
            turns.append((_tilt_rad(after.robot), _in_words(robot, changes)))
    # Soles lie flat on the ground.
    yield from _least(turns, FLAT_RAD)


def _least(found: Sequence[tuple[float, Remedy]], apart: float) -> Iterator[Remedy]:
    """Yield the remedy with the least number, and as its rival another one that is at most so far away."""
    for least, remedy in sorted(found, key=lambda one: one[0])[:1]:
        rivals = [one for number, one in found if number <= least + apart]
        others = [one for one in rivals if one is not remedy]
        yield replace(remedy, rival=next(iter(others), None))


FLAT_RAD = 0.05
"""Difference of two tilts of soles that tells which one lies flat [rad]."""


def _tilt_rad(robot: Robot) -> float:
    """Return the largest angle of a foot's geoms from a face or an axis along the vertical [rad]; 0 without feet."""
    standing = robot.standing
    if standing is None:
        return 0.0
    geoms = [geom for several in standing.feet.values() for geom in several]
    upward = np.abs(standing.stance.rotations[geoms].as_matrix()[:, 2]).max(axis=1)
    return float(np.arccos(np.clip(upward.min(), 0.0, 1.0)))


@remedies_of("robot-level")
def _level(robot: Robot) -> Iterator[Remedy]:
    """Yield the place of the first joint that the other leg has elsewhere, for the leg that does not meet the ground.

    Where both legs meet it, or none does, each is the rival of the other.
    """
    apart = [one for one in mirror_pairs(robot) if one.apart_m > SAME_PLACE_M]
    for pair in sorted(apart, key=lambda one: one.depth)[:1]:
        several: list[Remedy] = []
        for joint, other in permutations((pair.joint, pair.other)):
            changes = {
                f"body_pos[{robot.model.jnt_bodyid[joint]}]": _mirrored_m(
                    robot, pair, joint, other
                )
            }
            several.append(_in_words(robot, changes))
        meets = [_meets_ground(_after(robot, one.changes).robot) for one in several]
        if sum(meets) == 1:
            yield several[meets.index(True)]
        else:
            for one, rival in permutations(several):
                yield replace(one, rival=rival)


def _mirrored_m(robot: Robot, pair: MirrorPair, joint: int, other: int) -> FloatArray:
    """Return the place of a joint's body in its parent with which the joint mirrors the other one [m], shape [3]."""
    model, data = robot.model, mujoco.MjData(robot.model)
    mujoco.mj_kinematics(model, data)
    assert robot.standing is not None
    root, body = robot.standing.body, int(model.jnt_bodyid[joint])
    frame = data.xmat[root].reshape(3, 3)
    image_m = frame @ (pair.flip * (frame.T @ (data.xanchor[other] - data.xpos[root])))
    away_m = data.xpos[root] + image_m - data.xanchor[joint]
    parent = data.xmat[model.body_parentid[body]].reshape(3, 3)
    place_m: FloatArray = model.body_pos[body] + parent.T @ away_m
    return np.round(place_m, 6)


def _meets_ground(robot: Robot) -> bool:
    """Return whether the lowest foot touches the ground in the pose in which the robot starts."""
    standing = robot.standing
    if standing is None:
        return False
    feet = {geom for geoms in standing.feet.values() for geom in geoms}
    ground = set(robot.pairs.geoms[robot.foot_rows].ravel().tolist()) - feet
    floor_m = max(float(standing.stance.positions_m[geom][2]) for geom in ground)
    lowest_m = min(float(point[2]) for point in standing.support_m.values())
    return abs(lowest_m - floor_m) < TOUCHING * standing.height_m


TOUCHING = 0.01
"""Distance of a foot from the ground, over the height of the robot, up to which they touch: that of `robot-level`."""


@remedies_of("robot-command")
def _command(robot: Robot) -> Iterator[Remedy]:
    """Yield what the row states; of a gain and a bias that differ, the smaller one for both too."""
    changes, model = dict(ROWS["robot-command"](robot).changes), robot.model
    yield from _elements(robot, changes)
    smaller = {
        a: model.actuator_gainprm[a].copy() for a in _rows(changes, "actuator_biasprm")
    }
    for actuator, gain in smaller.items():
        gain[0] = -model.actuator_biasprm[actuator, 1]
    yield from _elements(robot, of_elements("actuator_gainprm", smaller))


@remedies_of("robot-sides")
def _sides(robot: Robot) -> Iterator[Remedy]:
    """Yield the values of the right side for the wrong one, where most joints behind as many others say which it is."""
    high = limits_of("robot-sides")[1]
    pairs, known = mirror_pairs(robot), quantities(robot)
    changes: dict[str, Any] = {}
    words: list[str] = []
    fair_s = 0.0
    for pair in pairs:
        alike = [one for one in pairs if one.depth == pair.depth]
        joints = [joint for one in alike for joint in (one.joint, one.other)]
        for quantity, difference in differences(robot, pair):
            if difference <= high or quantity not in ADJUSTABLE:
                continue
            values = known[quantity][robot.model.jnt_dofadr]
            middle = float(np.median(values[joints]))
            both = (pair.joint, pair.other)
            wrong = max(both, key=lambda joint: abs(values[joint] - middle))
            (right,) = {*both} - {wrong}
            if len(alike) < 2 or not np.isclose(values[right], middle, rtol=0.05):
                continue
            dofs = robot.model.jnt_dofadr[[wrong, right]]
            changes |= _adjusted(robot, quantity, int(dofs[0]), middle, changes)
            words.append(f"{quantity} {middle:.3g} for {robot.model.joint(wrong).name}")
            fair_s = max(fair_s, _fair_step_s(robot, [int(dofs[1])]))
    if changes:
        yield Remedy(text=" and ".join(words), changes=changes, fair_step_s=fair_s)


def _fair_step_s(robot: Robot, dofs: Collection[int]) -> float:
    """Return the time in which the slowest servo on degrees of freedom covers half of a step [s]; 0 without one."""
    servos_on = [a for a in position_servos(robot) if dof_of(robot, a) in dofs]
    times_s = [step_s(robot, actuator) for actuator in servos_on]
    return max((one for one in times_s if np.isfinite(one)), default=0.0)


ADJUSTABLE = ("armature", "frictionloss", "damping", "kp", "largest torque")
"""Quantities of two sides of which one number of a joint or its actuator is the reason."""


def _adjusted(
    robot: Robot, quantity: str, dof: int, value: float, known: Settings
) -> dict[str, Any]:
    """Return the changes that give a quantity of `quantities` another value on a degree of freedom.

    Args:
        robot: The robot.
        quantity: Its name.
        dof: The degree of freedom.
        value: The value.
        known: Changes that are made already.
    """
    model = robot.model
    if quantity in ("armature", "frictionloss"):
        return {f"dof_{quantity}[{dof}]": value}
    motors = [a for a in motors_of(robot) if dof_of(robot, a) == dof]
    if len(motors) != 1:
        return {}
    (motor,) = motors
    gear = abs(float(model.actuator_gear[motor, 0]))
    if quantity == "largest torque":
        limit_nm = value / gear
        return {f"actuator_forcerange[{motor}]": np.array([-limit_nm, limit_nm])}
    stated = known.get(f"actuator_biasprm[{motor}]", model.actuator_biasprm[motor])
    bias, scaled = np.array(stated), model.actuator_gainprm[motor].copy()
    if quantity == "damping":
        bias[2] = -(value - float(model.dof_damping[dof])) / gear**2
        return {f"actuator_biasprm[{motor}]": bias}
    factor = value / stiffness(model, dof)
    scaled[0] *= factor
    bias[1] *= factor
    return {f"actuator_gainprm[{motor}]": scaled, f"actuator_biasprm[{motor}]": bias}


@remedies_of("robot-coupling")
def _coupling(robot: Robot) -> Iterator[Remedy]:
    """Yield what the row states: another zero, or a stiffer coupling; then the other direction."""
    changes = dict(ROWS["robot-coupling"](robot).changes)
    yield from _elements(robot, changes)
    turned = {n: robot.model.eq_data[n].copy() for n in _rows(changes, "eq_data")}
    for one in turned.values():
        one[1] *= -1.0
    yield from _elements(robot, of_elements("eq_data", turned))


@remedies_of("robot-unlimited")
def _unlimited(robot: Robot) -> Iterator[Remedy]:
    model = robot.model
    yield from _stated("robot-unlimited")(robot)
    joints = driven_joints(robot)
    stated = [
        j for j in joints if not model.jnt_limited[j] and np.ptp(model.jnt_range[j])
    ]
    if stated:
        yield Remedy(
            text=f'limited="true" for {listed(element_names(robot, "joint", stated))}, which state a range',
            changes={f"jnt_limited[{joint}]": 1 for joint in stated},
        )


@remedies_of("robot-torque")
def _torque(robot: Robot) -> Iterator[Remedy]:
    model = robot.model
    both = {}
    for actuator in one_sided(robot).values():
        limit_nm = np.abs(model.actuator_forcerange[actuator]).max()
        signs = np.array([-1.0, 1.0])
        both[actuator] = signs * limit_nm
    yield from _elements(robot, of_elements("actuator_forcerange", both))
    yield from _gears(robot)
    limited = [a for a in motors_of(robot) if model.actuator_forcelimited[a]]
    weights, limits = weights_nm(robot), driven_dofs(robot)
    # In kN m, servos would ask for their largest torque at errors that joints have.
    if all(
        1e3 * limits[dof] <= SERVO_ERROR_RAD * stiffness(model, dof)
        for dof in {dof_of(robot, actuator) for actuator in limited}
    ):
        ranges = {a: 1e3 * model.actuator_forcerange[a] for a in limited}
        yield from _elements(robot, of_elements("actuator_forcerange", ranges))
    changes, least_nm = {}, leg_nm(robot) if robot.is_floating else 0.0
    for actuator in limited:
        dof = dof_of(robot, actuator)
        loss_nm, drag_nm = (
            float(model.dof_frictionloss[dof]),
            6.0 * float(model.dof_damping[dof]),
        )
        fair_nm = 2.0 * float(weights[dof]) + max(10.0 * loss_nm, drag_nm)
        fair_nm = _rounded(max(fair_nm, least_nm))
        if fair_nm > limits[dof]:
            fair = fair_nm / abs(float(model.actuator_gear[actuator, 0]) or 1.0)
            changes[f"actuator_forcerange[{actuator}]"] = np.array([-fair, fair])
    yield from _elements(robot, changes)


def _gears(robot: Robot) -> Iterator[Remedy]:
    """Yield the gear ratio 1 for actuators that state less, which makes a motor weaker."""
    gears = {a: float(robot.model.actuator_gear[a, 0]) for a in motors_of(robot)}
    ones = {
        a: np.sign(g) * np.eye(6)[0] for a, g in gears.items() if 0.0 < abs(g) < 1.0
    }
    yield from _elements(robot, of_elements("actuator_gear", ones))


@remedies_of("robot-rotor")
def _rotor(robot: Robot) -> Iterator[Remedy]:
    limits = loads_nm(robot)
    armatures = {dof: float(robot.model.dof_armature[dof]) for dof in limits}
    bare = [dof for dof in limits if MOST_RAD_PER_S2 * armatures[dof] < limits[dof]]
    strong = [d for d in bare if limits[d] > STRONG * np.median(list(limits.values()))]
    motors = [a for a in motors_of(robot) if dof_of(robot, a) in strong]
    for unit in (1e3, 100.0):
        ranges = {a: robot.model.actuator_forcerange[a] / unit for a in motors}
        yield from _elements(robot, of_elements("actuator_forcerange", ranges))
    found = _from_others(armatures, limits, bare)
    right = set(limits) - set(bare)
    for one in _elements(robot, of_elements("dof_armature", found)):
        yield replace(one, fair_step_s=WORSE * _fair_step_s(robot, right))
    yield from _rotors(robot)


STRONG = 20.0
"""Largest torque, over the middle one of all joints, from which on it can be in N mm or N cm."""


def _rotors(robot: Robot) -> Iterator[Remedy]:
    """Yield armatures for all joints that state none: what the motor accelerates by 1000 and by 300 rad/s^2."""
    limits = loads_nm(robot)
    for rate in (FAIR_RAD_PER_S2, 300.0):
        found = {
            dof: _rounded(limit_nm / rate)
            for dof, limit_nm in limits.items()
            if robot.model.dof_armature[dof] <= 0.0
        }
        yield from _elements(robot, of_elements("dof_armature", found))


@remedies_of("robot-armature")
def _armature(robot: Robot) -> Iterator[Remedy]:
    limits, changes = loads_nm(robot), dict(ROWS["robot-armature"](robot).changes)
    wrong = [dof for dof in limits if dof in _rows(changes, "dof_armature")]
    armatures = {dof: float(robot.model.dof_armature[dof]) for dof in limits}
    others = _from_others(
        {d: a for d, a in armatures.items() if a > 0.0 or d in wrong}, limits, wrong
    )
    yield from _elements(robot, of_elements("dof_armature", others))
    small = {dof: 1e-4 * armatures[dof] for dof in limits}
    rates = [limits[dof] / small[dof] for dof in wrong]
    if LEAST_RAD_PER_S2 < np.median(rates) < 3.0 * FAIR_RAD_PER_S2:
        # Catalogues of motors state kg cm^2.
        yield from _elements(robot, of_elements("dof_armature", small))
    yield from _elements(
        robot, {name: _rounded(float(value)) for name, value in changes.items()}
    )


@remedies_of("robot-damping")
def _damping(robot: Robot) -> Iterator[Remedy]:
    if (robot.model.dof_damping < 0.0).any():
        turned = dict(ROWS["robot-damping"](robot).changes)
        for one in (turned, dict.fromkeys(turned, 0.0)):
            yield from _elements(robot, one)
        return
    yield from _drag(robot, "damping", (PER_DEGREE, 1e3))


@remedies_of("robot-frictionloss")
def _frictionloss(robot: Robot) -> Iterator[Remedy]:
    several = list(_drag(robot, "frictionloss", (100.0, 1e3)))
    yield from several
    # Without a rotor, a joint with less friction can be too fast.
    for rotor in _rotors(robot):
        for one in several:
            changes = {**one.changes, **rotor.changes}
            yield Remedy(text=f"{one.text} and {rotor.text}", changes=changes)


def _drag(robot: Robot, name: str, units: Sequence[float]) -> Iterator[Remedy]:
    """Yield less drag: the share of the torque that other joints lose, another unit, or what the row states."""
    row, limits = f"robot-{name}", loads_nm(robot)
    values = getattr(robot.model, f"dof_{name}")
    changes = dict(ROWS[row](robot).changes)
    wrong = [dof for dof in limits if dof in _rows(changes, f"dof_{name}")]
    shares = {dof: float(values[dof]) / limits[dof] for dof in limits}
    right = [shares[dof] for dof in limits if dof not in wrong and shares[dof] > 0.0]
    if right:
        share = float(np.median(right))
        found = {dof: _rounded(share * limits[dof]) for dof in wrong}
        yield from _elements(robot, of_elements(f"dof_{name}", found))
    for unit in units:
        found = {dof: _rounded(values[dof] / unit) for dof in wrong}
        yield from _elements(robot, of_elements(f"dof_{name}", found))
    yield from _elements(
        robot, {key: _rounded(float(value)) for key, value in changes.items()}
    )


@remedies_of("robot-dry")
def _dry(robot: Robot) -> Iterator[Remedy]:
    off = switched_off(robot.model, "constraint", "frictionloss")
    switched = dict.fromkeys(off, True)
    if off:
        yield Remedy(text=enabling(off), changes=switched)
    yield from _rotor(robot)
    for one in _elements(robot, dict(ROWS["robot-dry"](robot).changes)):
        text = f"{enabling(off)} and {one.text}" if off else one.text
        yield replace(one, text=text, changes=switched | dict(one.changes))


# --- servos ----------------------------------------------------------------------------------------------------------


def gains(
    robot: Robot, actuators: Sequence[int], *, kp: float = 1.0, kv: float = 1.0
) -> Remedy:
    """Return servos with other gains.

    Args:
        robot: The robot.
        actuators: Its servos.
        kp: Factor of the stiffness.
        kv: Factor of the damping of the servo.
    """
    model, changes = robot.model, {}
    factors = np.array([kp, kp, kv] + [1.0] * (model.actuator_biasprm.shape[1] - 3))
    for a in actuators:
        gain = model.actuator_gainprm[a].copy()
        gain[0] *= kp
        changes[f"actuator_gainprm[{a}]"] = gain
        changes[f"actuator_biasprm[{a}]"] = model.actuator_biasprm[a] * factors
    parts = [f"{n} times {v:.3g}" for n, v in (("kp", kp), ("kv", kv)) if v != 1.0]
    if kp == kv:
        parts = [f"kp and kv times {kp:.3g}"]
    every = set(actuators) == set(np.flatnonzero(servos(model)).tolist())
    where = (
        "all servos" if every else listed(element_names(robot, "actuator", actuators))
    )
    return Remedy(text=f"{' and '.join(parts)} for {where}", changes=changes)


def _bears(robot: Robot, actuators: Sequence[int], scale: float) -> bool:
    """Return whether servos with a scaled stiffness still hold the robot's weight."""
    weights = weights_nm(robot)
    dofs = {dof_of(robot, actuator) for actuator in actuators}
    return all(
        scale * stiffness(robot.model, dof) * LARGEST_SAG_RAD >= weights[dof]
        for dof in dofs
    )


def _scaled(
    robot: Robot, actuators: Sequence[int], shares: Sequence[float], power: float
) -> Iterator[Remedy]:
    """Yield smaller gains that still hold the robot's weight; kv is scaled by a power of the factor of kp."""
    for share in shares:
        if _bears(robot, actuators, share):
            remedy = gains(robot, actuators, kp=share, kv=share**power)
            yield replace(remedy, scales_gains=True)


@remedies_of("robot-stiffness")
def _stiff(robot: Robot) -> Iterator[Remedy]:
    low_mrad = limits_of("robot-stiffness")[0]
    limits = driven_dofs(robot)
    stiff = [
        a
        for a in position_servos(robot)
        if 1e3 * limits[dof_of(robot, a)]
        < low_mrad * stiffness(robot.model, dof_of(robot, a))
    ]
    yield from _units(robot, stiff)
    yield from _units(robot, position_servos(robot))
    yield from _scaled(robot, stiff, SHARES, 0.5)


def _units(robot: Robot, actuators: Sequence[int]) -> Iterator[Remedy]:
    """Yield gains that were meant per degree or in N mm."""
    for unit in (PER_DEGREE, 1e3) if actuators else ():
        if _bears(robot, actuators, 1.0 / unit):
            yield gains(robot, actuators, kp=1.0 / unit)
            yield gains(robot, actuators, kp=1.0 / unit, kv=1.0 / unit)


SHARES = (0.5, 0.25, 0.1, 0.05, 0.02, 0.01)
"""Factors of gains that are tried, the largest first."""


def _integrator(robot: Robot) -> dict[str, Any]:
    implicit = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    is_explicit = robot.model.opt.integrator != implicit
    return {"integrator": "implicitfast"} if is_explicit else {}


@remedies_of(
    *("robot-holds", "robot-stands", "robot-loads", "robot-energy", "robot-slip")
)
def _solver(robot: Robot) -> Iterator[Remedy]:
    """Yield the implicit integrator, then shorter steps with it."""
    option = _integrator(robot)
    text = 'integrator="implicitfast"' if option else ""
    if option:
        yield Remedy(text=f"<option {text}/>", changes=option)
    step_s = float(robot.model.opt.timestep)
    for shorter_s in (0.01, 0.005, 0.002, 0.001):
        if 0.1 * step_s <= shorter_s < step_s:
            words = f'timestep="{shorter_s:g}" {text}'.strip()
            yield Remedy(
                text=f"<option {words}/>", changes={"timestep_s": shorter_s} | option
            )


@remedies_of("robot-servo")
def _servo(robot: Robot) -> Iterator[Remedy]:
    if judged_row("robot-stiffness", ROWS["robot-stiffness"](robot)).is_flag:
        yield from _stiff(robot)
    yield from _rotor(robot)
    yield from _solver(robot)
    option = _integrator(robot)
    for one in _scaled(robot, position_servos(robot), SHARES, 1.0):
        text = (
            f'<option integrator="implicitfast"/> and {one.text}'
            if option
            else one.text
        )
        yield replace(one, text=text, changes=option | dict(one.changes))


@remedies_of("robot-sag")
def _sag(robot: Robot) -> Iterator[Remedy]:
    high_mrad = limits_of("robot-sag")[1]
    weights = deflecting_nm(robot)
    sags_mrad = {
        a: 1e3
        * float(weights[dof_of(robot, a)])
        / stiffness(robot.model, dof_of(robot, a))
        for a in position_servos(robot)
    }
    soft = [a for a, sag_mrad in sags_mrad.items() if sag_mrad > high_mrad]
    if not soft:
        return
    joints = [int(robot.model.actuator_trnid[a, 0]) for a in soft]
    sprung = [joint for joint in joints if springs(robot.model)[joint]]
    yield from _elements(
        robot, of_elements("jnt_stiffness", dict.fromkeys(sprung, 0.0))
    )
    yield from _gears(robot)
    every = position_servos(robot)
    for several in (every, soft) if len(soft) < len(every) else (every,):
        yield gains(robot, several, kp=PER_DEGREE)
        yield gains(robot, several, kp=PER_DEGREE, kv=PER_DEGREE)
    scale = _rounded(max(sags_mrad[a] for a in soft) / (0.3 * high_mrad))
    for kv in (1.0, _rounded(scale**0.5), scale):
        yield gains(robot, soft, kp=scale, kv=kv)


@remedies_of("robot-ringing")
def _ringing(robot: Robot) -> Iterator[Remedy]:
    """Yield another unit of kv, then that with which the loop has a damping ratio of 0.7, or of 0.3."""
    low = limits_of("robot-ringing")[0]
    model, responses = robot.model, servo_responses(robot)
    ringing = [
        a for a in position_servos(robot) if responses[dof_of(robot, a)][0] < low
    ]
    yield gains(robot, ringing, kv=PER_DEGREE)
    for ratio in (0.7, 0.3):
        changes = {}
        for a in ringing:
            dof = dof_of(robot, a)
            kp, band_hz = stiffness(model, dof), responses[dof][1]
            # The bandwidth of a loop that rings is 1.55 times its natural frequency.
            natural_per_s = 2.0 * np.pi * band_hz / np.sqrt(1.0 + np.sqrt(2.0))
            bias = model.actuator_biasprm[a].copy()
            gear = float(model.actuator_gear[a, 0])
            bias[2] = -_rounded(2.0 * ratio * kp / natural_per_s / gear**2)
            changes[f"actuator_biasprm[{a}]"] = bias
        yield from _elements(robot, changes)


@remedies_of("robot-lag")
def _lag(robot: Robot) -> Iterator[Remedy]:
    low_ms, high_ms = limits_of("robot-lag")
    alone_ms = {
        a: 1e3 * lone_half_step_s(robot, a, dof_of(robot, a))
        for a in position_servos(robot)
    }
    fast = [a for a, half_ms in alone_ms.items() if half_ms < low_ms]
    slow = [a for a, half_ms in alone_ms.items() if high_ms < half_ms < np.inf]
    if fast:
        yield from _rotor(robot)
        yield from _units(robot, fast)
        scale = min(alone_ms[a] for a in fast) / (1.5 * low_ms)
        shares = [_rounded(scale**2), *SHARES]
        yield from _scaled(robot, fast, shares, 0.5)
    if slow:
        for unit in (PER_DEGREE, 1e3):
            yield gains(robot, slow, kv=1.0 / unit)
        for dof in (dof_of(robot, a) for a in slow[:1]):
            drag = float(robot.model.dof_damping[dof])
            if drag > 0.0:
                yield from _drag(robot, "damping", (PER_DEGREE,))
        scale = _rounded(max(alone_ms[a] for a in slow) / (0.3 * high_ms))
        yield gains(robot, slow, kv=_rounded(1.0 / scale))
        yield gains(robot, slow, kp=scale)
