"""Static rules: numbers of a model that contradict each other."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import product
from typing import NamedTuple

import mujoco
import numpy as np

from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.sanity.model_checks.drives import drives, servos, start
from gauge_envs.tools.sanity.robot.robot import (
    Robot,
    acts_on_joints,
    geom_name,
    joints_of,
    name_of,
    random_poses,
    unheld,
)
from gauge_envs.tools.sanity.static_rules.rule import Fault, rule, unit_text
from gauge_envs.tools.sanity.static_rules.sides import mirrored, side_of

# --- keyframes -------------------------------------------------------------------------------------------------------

OUTSIDE = 0.02
"""Share of a range by which a value may lie outside of it, because of rounding."""


def _beyond(value: float, limits: FloatArray) -> tuple[float, str]:
    """Return how far a value is outside of a range, over its span, and the range as a text; 0 for rounding."""
    low, high = limits.tolist()
    share = max(low - value, value - high) / max(high - low, 1e-9)
    return share * (share > OUTSIDE), f"{low:.4g} to {high:.4g}"


@rule(
    "start-range",
    title="keyframe outside of a joint's range",
    source="MuJoCo pushes a joint back into its range with up to any force",
    consequence="Episodes begin with a jump.",
)
def start_range(robot: Robot) -> Iterator[Fault]:
    """Yield hinges and slides that a keyframe puts outside of their range."""
    model = robot.model
    limited = (model.jnt_limited != 0) & joints_of(model, "HINGE", "SLIDE")
    for key, joint in product(range(model.nkey), np.flatnonzero(limited).tolist()):
        value = model.key_qpos[key, model.jnt_qposadr[joint]]
        share, limits = _beyond(value, model.jnt_range[joint])
        if share:
            name, label = name_of(model, "joint", joint), name_of(model, "key", key)
            text = f'keyframe "{label}" puts {name} at {value:.4g}, outside of its range {limits}'
            yield Fault(("key", key), name, text, share)


@rule(
    "start-command",
    title="keyframe outside of a command's range",
    source="MuJoCo clips a control to its range",
    consequence="The servos do not hold the keyframe.",
)
def start_command(robot: Robot) -> Iterator[Fault]:
    """Yield controls of keyframes outside of their range."""
    model = robot.model
    keys = np.flatnonzero(model.key_ctrl.any(axis=1)).tolist()
    for key, number in product(
        keys, np.flatnonzero(model.actuator_ctrllimited).tolist()
    ):
        value = model.key_ctrl[key, number]
        share, limits = _beyond(value, model.actuator_ctrlrange[number])
        if share:
            name, label = name_of(model, "actuator", number), name_of(model, "key", key)
            text = f'keyframe "{label}" commands {name} to {value:.4g}; its ctrlrange is {limits}'
            yield Fault(("key", key), name, text, share)


# --- commands --------------------------------------------------------------------------------------------------------

MAX_OUTSIDE, MIN_COMMANDS = 0.6, 0.05
"""Share of the commands of a servo that may lie outside of its joint's range, and least share of the range."""


@rule(
    "command-range",
    title="commands against the range of the joint",
    source="a servo holds control * gain / stiffness; a joint stops at its range",
    consequence="Most actions of a policy do the same.",
)
def command_range(robot: Robot) -> Iterator[Fault]:
    """Yield servos most of whose commands are outside of the range of their joint, or that reach little of it."""
    model, joints = robot.model, robot.model.actuator_trnid[:, 0]
    is_its = acts_on_joints(model) & servos(model) & (model.actuator_ctrllimited != 0)
    is_its &= (model.actuator_dyntype == mujoco.mjtDyn.mjDYN_NONE) & (
        model.actuator_gear[:, 0] != 0.0
    )
    for number in np.flatnonzero(is_its).tolist():
        joint = int(joints[number])
        if not (model.jnt_limited[joint] and joints_of(model, "HINGE", "SLIDE")[joint]):
            continue
        gain = (
            -model.actuator_gainprm[number, 0]
            / model.actuator_biasprm[number, 1]
            / model.actuator_gear[number, 0]
        )
        first, last = np.sort(model.actuator_ctrlrange[number] * gain)
        low, high = model.jnt_range[joint]
        reached, span = max(0.0, min(last, high) - max(first, low)), last - first
        lost = 1.0 - reached / max(span, 1e-9)
        ratio = span / max(high - low, 1e-9)
        if lost > MAX_OUTSIDE or reached < MIN_COMMANDS * (high - low):
            name = name_of(model, "joint", joint)
            text = f"commands of {name} are {first:.4g} to {last:.4g}, its range is {low:.4g} to {high:.4g}"
            force = np.abs(model.actuator_forcerange[number]).max()
            if force and np.isclose(
                force, np.abs(model.actuator_ctrlrange[number]).max()
            ):
                text += ": a position servo with the range of a motor"
            right = "ctrlrange", np.sort(model.jnt_range[joint] / gain)
            text += unit_text(ratio)
            yield Fault(
                ("actuator", number),
                name,
                text,
                max(lost, ratio),
                reached == 0.0,
                right,
            )


WEAK = 5.0
"""Error at which a servo has its force limit, over the range of its joint; real servos need less than the range."""


@rule(
    "servo-gain",
    title="force of a servo over its limit",
    source="a servo with a gain per degree in place of radians has 1/57.3 of its force",
    consequence="The servo holds a small part of the load of the real one.",
)
def servo_gain(robot: Robot) -> Iterator[Fault]:
    """Yield servos that need an error of many ranges of their joint for their force limit."""
    for drive in drives(robot):
        span = float(np.ptp(robot.model.jnt_range[drive.joint]))
        error = drive.limit / drive.kp if drive.kp else 0.0
        is_weak = np.isfinite(error) and error > WEAK * max(span, 1.0)
        if drive.is_hinge and span and is_weak:
            force, angle = drive.units
            most = f"{drive.kp * span:.2g} of its {drive.limit:.3g} {force}"
            text = f"{drive.name} with kp {drive.kp:.3g} {force}/{angle} makes at most {most} within its range"
            yield Fault(("joint", drive.joint), drive.name, text, error / span)


# --- names -----------------------------------------------------------------------------------------------------------


@rule(
    "names",
    title="an element of another part than its name says",
    source="names of the model's own elements",
    consequence="Actions and observations are exchanged.",
)
def names(robot: Robot) -> Iterator[Fault]:
    """Yield actuators with the name of another joint, and elements that belong to the other side."""
    model = robot.model
    joints = {model.joint(joint).name: joint for joint in range(model.njnt)}
    for kind, number, owner_kind, owner in _references(model):
        name, owner_name = (
            getattr(model, kind)(number).name,
            getattr(model, owner_kind)(owner).name,
        )
        if kind == "actuator" and name and joints.get(name, owner) != owner:
            text = f"actuator {name} drives joint {owner_name}, not joint {name}"
            yield Fault((kind, number), name, text, 2.0, True, ("joint", name))
            continue
        side, owner_side = side_of(name).side, side_of(owner_name).side
        if side and owner_side and side != owner_side:
            text = (
                f"{kind} {name} belongs to {owner_kind} {owner_name}, on the other side"
            )
            yield Fault((kind, number), name, text)


OBJECTS = {
    "BODY": "body",
    "XBODY": "body",
    "JOINT": "joint",
    "GEOM": "geom",
    "SITE": "site",
    "ACTUATOR": "actuator",
    "TENDON": "tendon",
}


def _references(model: mujoco.MjModel) -> Iterator[tuple[str, int, str, int]]:
    """Yield elements and what they belong to: kind and id of both."""
    acts = acts_on_joints(model)
    for number in range(model.nu):
        if acts[number]:
            yield "actuator", number, "joint", int(model.actuator_trnid[number, 0])
    for number in range(model.nsensor):
        kind = mujoco.mjtObj(model.sensor_objtype[number]).name.removeprefix("mjOBJ_")
        if kind in OBJECTS:
            yield "sensor", number, OBJECTS[kind], int(model.sensor_objid[number])
    for kind, bodies in {
        "joint": model.jnt_bodyid,
        "site": model.site_bodyid,
        "geom": model.geom_bodyid,
    }.items():
        for number, body in enumerate(bodies.tolist()):
            yield kind, number, "body", body


# --- mirror parts ----------------------------------------------------------------------------------------------------


class Trait(NamedTuple):
    """A number that mirror parts share.

    Attributes:
        kind: Kind of the element.
        word: What the number is.
        values: Function from a model to the numbers, shape [count].
        ratio: Largest ratio that passes.
    """

    kind: str
    word: str
    values: Callable[[mujoco.MjModel], FloatArray]
    ratio: float = 1.5


def _span(ranges: FloatArray, limited: FloatArray) -> FloatArray:
    return np.ptp(ranges, axis=1) * (limited != 0)


TRAITS = (
    Trait("body", "mass [kg]", lambda m: m.body_mass),
    Trait("body", "inertia [kg m^2]", lambda m: m.body_inertia.sum(axis=1), 2.0),
    Trait(
        "body",
        "distance from its parent [m]",
        lambda m: np.linalg.norm(m.body_pos, axis=1),
        2.0,
    ),
    Trait("joint", "type", lambda m: 1.0 + m.jnt_type),
    Trait("joint", "range", lambda m: _span(m.jnt_range, m.jnt_limited), 1.25),
    Trait(
        "joint", "damping", lambda m: np.atleast_2d(m.dof_damping.T)[0, m.jnt_dofadr]
    ),
    Trait("joint", "frictionloss", lambda m: m.dof_frictionloss[m.jnt_dofadr]),
    Trait("joint", "armature", lambda m: m.dof_armature[m.jnt_dofadr]),
    Trait("joint", "stiffness", lambda m: np.atleast_2d(m.jnt_stiffness.T)[0]),
    Trait(
        "joint",
        "motor limit",
        lambda m: _span(m.jnt_actfrcrange, m.jnt_actfrclimited),
        1.25,
    ),
    Trait("actuator", "gain", lambda m: np.abs(m.actuator_gainprm[:, 0])),
    Trait("actuator", "damping", lambda m: np.abs(m.actuator_biasprm[:, 2])),
    Trait("actuator", "gear", lambda m: np.abs(m.actuator_gear).max(axis=1)),
    Trait(
        "actuator",
        "range of commands",
        lambda m: _span(m.actuator_ctrlrange, m.actuator_ctrllimited),
        1.25,
    ),
    Trait(
        "actuator",
        "force limit",
        lambda m: _span(m.actuator_forcerange, m.actuator_forcelimited),
        1.25,
    ),
    Trait("geom", "friction", lambda m: m.geom_friction[:, 0]),
    Trait("geom", "condim", lambda m: m.geom_condim.astype(float), 1.1),
    Trait(
        "geom",
        "collision",
        lambda m: ((m.geom_contype | m.geom_conaffinity) != 0).astype(float),
    ),
    Trait("geom", "size [m]", lambda m: m.geom_rbound, 2.0),
)


@rule(
    "mirror",
    title="left and right part that differ",
    source="names that differ by the side alone are mirror parts",
    consequence="The robot walks in a circle.",
)
def mirror(robot: Robot) -> Iterator[Fault]:
    """Yield parts whose numbers differ from those of the part on the other side."""
    model = robot.model
    counts = {
        "body": model.nbody,
        "joint": model.njnt,
        "actuator": model.nu,
        "geom": model.ngeom,
    }
    pairs = {kind: mirrored(model, kind, count) for kind, count in counts.items()}
    for trait in TRAITS:
        values = trait.values(model) if counts[trait.kind] else np.zeros(0)
        for left, right in pairs[trait.kind]:
            low, high = sorted((float(values[left]), float(values[right])))
            if high <= trait.ratio * low:
                continue
            texts = [
                f"{name_of(model, trait.kind, n)} {values[n]:.4g}"
                for n in (left, right)
            ]
            ratio = high / max(low, 1e-12)
            text = (
                f"{trait.word} of mirror parts differs: {', '.join(texts)}"
                + unit_text(ratio)
            )
            yield Fault((trait.kind, left), texts[0].split()[0], text, ratio)


@rule(
    "mirror-axis",
    title="left and right joint that turn differently",
    source="a mirror image of a hinge turns about the mirrored axis, through the mirrored range",
    consequence="One leg bends the other way.",
)
def mirror_axis(robot: Robot) -> Iterator[Fault]:
    """Yield hinges that are neither a copy nor the mirror image of the one on the other side."""
    model, data = robot.model, mujoco.MjData(robot.model)
    mujoco.mj_kinematics(model, data)
    for left, right in mirrored(model, "joint", model.njnt):
        if (
            not joints_of(model, "HINGE")[[left, right]].all()
            or not model.jnt_limited[[left, right]].all()
        ):
            continue
        if _same_turns(model, model.jnt_axis[left], model.jnt_axis[right], left, right):
            continue
        # The axis of a turn is a pseudovector: a mirror keeps its component along the normal, and turns the others.
        normal = data.xanchor[left] - data.xanchor[right]
        normal /= max(float(np.linalg.norm(normal)), 1e-9)
        image = 2.0 * (data.xaxis[left] @ normal) * normal - data.xaxis[left]
        if (
            _same_turns(model, image, data.xaxis[right], left, right)
            or not normal.any()
        ):
            continue
        first, second = name_of(model, "joint", left), name_of(model, "joint", right)
        axes = [
            f"{np.round(data.xaxis[n], 2).tolist()} {model.jnt_range[n].round(3).tolist()}"
            for n in (left, right)
        ]
        text = f"{first} and {second} are no mirror image: axis and range {axes[0]} and {axes[1]}"
        yield Fault(("joint", left), first, text)


def _same_turns(
    model: mujoco.MjModel, first: FloatArray, second: FloatArray, left: int, right: int
) -> bool:
    """Return whether two joints turn about one axis through ranges whose middles agree."""
    cosine = float(first @ second)
    low, high = model.jnt_range[left] * np.sign(cosine)
    apart = abs(0.5 * (low + high) - model.jnt_range[right].mean())
    return abs(cosine) > 0.9 and bool(
        apart <= 0.25 * np.ptp(model.jnt_range[[left, right]], axis=1).max()
    )


# --- the start -------------------------------------------------------------------------------------------------------

MAX_DEPTH_M, MAX_DEPTH = 0.005, 0.05
"""Overlap at the start [m], and over the size of the smaller body, above which contacts push bodies apart."""


@rule(
    "start-overlap",
    title="bodies that overlap where they start",
    source="rigid parts do not overlap; without a keyframe, parts of a robot count where they do in half of all poses",
    consequence="Contacts throw them apart in the first steps.",
)
def start_overlap(robot: Robot) -> Iterator[Fault]:
    """Yield pairs of bodies, objects and the ground included, that overlap in the first pose."""
    model, depths_m = robot.model, _overlaps_m(robot.model, start(robot))
    trees = model.body_treeid[model.geom_bodyid]
    usual = dict.fromkeys(depths_m, POSES)
    if depths_m and not model.nkey:
        poses = [_overlaps_m(model, data) for data in random_poses(model, POSES)]
        usual = {pair: sum(pair in pose for pose in poses) for pair in depths_m}
    for (first, second), depth_m in depths_m.items():
        is_robot = int(model.geom_bodyid[second]) in robot.bodies
        # Code raises a robot without a keyframe above the ground, and moves its joints.
        is_raised = robot.standing is not None and trees[first] < 0 and not model.nkey
        if is_robot and (is_raised or 2 * usual[first, second] < POSES):
            continue
        size_m = model.geom_rbound[second]
        label = " and ".join(geom_name(model, geom) for geom in (second, first))
        text = f"{label} overlap by {1e3 * depth_m:.3g} mm where they start"
        yield Fault(("geom", second), label, text, depth_m / max(size_m, 1e-6))


POSES = 32
"""Random poses in which the overlap of two parts is checked."""


def _overlaps_m(
    model: mujoco.MjModel, data: mujoco.MjData
) -> dict[tuple[int, int], float]:
    """Return the depth of the contacts that push bodies apart, the moving geom last [m]."""
    depths_m: dict[tuple[int, int], float] = {}
    trees = model.body_treeid[model.geom_bodyid]
    for contact in data.contact:
        first, second = sorted(contact.geom.tolist(), key=lambda geom: trees[geom])
        if first < 0 or contact.exclude:
            continue
        size_m = min(filter(None, model.geom_rbound[[first, second]]), default=0.0)
        if -contact.dist > max(MAX_DEPTH_M, MAX_DEPTH * size_m):
            depths_m[first, second] = max(
                -contact.dist, depths_m.get((first, second), 0.0)
            )
    return depths_m


@rule(
    "start-tendon",
    title="tendons and couplings outside of their range at the start",
    source="lengths of the model in its first pose",
    consequence="Episodes begin with a jump.",
)
def start_tendon(robot: Robot) -> Iterator[Fault]:
    """Yield limited tendons whose first length is outside of their range."""
    model, data = robot.model, start(robot)
    for tendon in np.flatnonzero(model.tendon_limited).tolist():
        length = data.ten_length[tendon]
        share, limits = _beyond(length, model.tendon_range[tendon])
        if share:
            name = name_of(model, "tendon", tendon)
            is_fixed = (
                model.wrap_type[model.tendon_adr[tendon]] == mujoco.mjtWrap.mjWRAP_JOINT
            )
            unit = "of its joints" if is_fixed else "m"
            text = f"tendon {name} starts at {length:.4g} {unit}, outside of its range {limits}"
            yield Fault(("tendon", tendon), name, text, share)


@rule(
    "start-coupling",
    title="couplings that the start does not meet",
    source="an equality of joints is a polynomial of the second one",
    consequence="Episodes begin with a jump.",
)
def start_coupling(robot: Robot) -> Iterator[Fault]:
    """Yield joints whose first position is off that of their coupling, by a share of their range."""
    model, begin = robot.model, start(robot).qpos
    is_coupling = (model.eq_type == mujoco.mjtEq.mjEQ_JOINT) & (model.eq_active0 != 0)
    for number in np.flatnonzero(is_coupling & (model.eq_obj2id >= 0)).tolist():
        joint, other = int(model.eq_obj1id[number]), int(model.eq_obj2id[number])
        place, leader = model.jnt_qposadr[[joint, other]]
        lead = begin[leader] - model.qpos0[leader]
        coupled = np.polyval(model.eq_data[number, 4::-1], lead) + model.qpos0[place]
        off, span = abs(coupled - begin[place]), np.ptp(model.jnt_range[joint]) or 1.0
        if off > MAX_OFF * span:
            name = name_of(model, "joint", joint)
            text = f"{name} starts {off:.2g} off its coupling; its range is {span:.3g}"
            yield Fault(("equality", number), name, text, float(off / span))


MAX_OFF = 0.1
"""Distance of a joint from its coupling at the start, over its range."""


@rule(
    "touch",
    title="free bodies that can touch nothing fixed",
    source="contype, conaffinity, pairs and excludes of the model",
    consequence="They fall through the floor.",
)
def touch(robot: Robot) -> Iterator[Fault]:
    """Yield free trees of bodies that no pair of geoms stops, though the model has a floor."""
    model, pairs = robot.model, robot.pairs
    solid = (model.geom_contype | model.geom_conaffinity) != 0
    fixed = model.body_weldid[model.geom_bodyid] == 0
    if not (solid & fixed).any() or not model.opt.gravity.any():
        return
    stopped = np.unique(model.body_treeid[model.geom_bodyid[pairs.geoms]])
    moved = robot.driven_trees
    for body in unheld(model):
        tree = model.body_treeid[body]
        is_marker = (
            tree not in moved
            and not solid[model.body_treeid[model.geom_bodyid] == tree].any()
        )
        if is_marker or tree in stopped or model.body_gravcomp[body]:
            continue
        name = name_of(model, "body", body)
        text = f"{name} is free and none of its geoms can touch anything: it falls through the floor"
        yield Fault(("body", body), name, text, is_error=True)
