"""Static rules: numbers of a model that contradict each other."""

import re
from collections import defaultdict
from collections.abc import Iterator, Mapping
from itertools import chain, product
from typing import NamedTuple

import mujoco
import numpy as np

from gauge_envs.scene.geometry import FloatArray, IntArray
from gauge_envs.tools.sanity.model_checks.check import Change, Fault, rule, unit_text
from gauge_envs.tools.sanity.model_checks.drives import (
    drives,
    largest_loads,
    servos,
    start,
)
from gauge_envs.tools.sanity.robot.model_text import COUNTS
from gauge_envs.tools.sanity.robot.robot import (
    Place,
    Robot,
    acts_on_joints,
    geom_name,
    joints_of,
    name_of,
    random_poses,
    spec_element,
    unheld,
)
from gauge_envs.tools.sanity.verdict import Severity

WORDS = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+")

LEFT, RIGHT = ("left", "l"), ("right", "r")
"""Words for the sides."""

ENDS = {"f": "front", "r": "rear", "h": "hind", "b": "back"}

CORNERS = {
    code: (side, word)
    for end, word in ENDS.items()
    for side in "lr"
    for code in (end + side, side + end)
}
"""Side and end of the legs of quadrupeds by their codes, such as `FL` and `LF`."""


class Side(NamedTuple):
    """What a name says.

    Attributes:
        side: `l`, `r`, or empty.
        stem: The name without its side.
    """

    side: str
    stem: str


def side_of(name: str) -> Side:
    """Return the side that a name says, and the rest of it; no side for a name with both."""
    sides, stem, words = list[str](), list[str](), WORDS.findall(name)
    for number, word in enumerate(words):
        text, found = word.lower(), ""
        is_code = word.isupper() or number in (0, len(words) - 1)
        if text in LEFT + RIGHT:
            found, text = text[0], "*"
        elif text in CORNERS and is_code:
            found, text = CORNERS[text]
        elif match := re.match(r"(left|right)(..+)", text):
            found, text = text[0], match[2]
        if found:
            sides.append(found)
        stem.append(text)
    return Side(sides[0] if len(set(sides)) == 1 else "", " ".join(stem))


def limb_of(name: str) -> str:
    """Return a name without its side and end: that of the like parts of all legs."""
    words = side_of(name).stem.split()
    return " ".join(word for word in words if word not in ENDS.values())


def mirrored(model: mujoco.MjModel, kind: str) -> list[tuple[int, int]]:
    """Return pairs of elements of a kind whose names differ by the side alone, the left one first."""
    stems: dict[str, dict[str, list[int]]] = defaultdict(lambda: defaultdict(list))
    for number in range(getattr(model, COUNTS.get(kind, f"n{kind}"))):
        name = getattr(model, kind)(number).name
        side = side_of(name)
        if name and side.side:
            stems[side.stem][side.side].append(number)
    return [
        (sides["l"][0], sides["r"][0])
        for sides in stems.values()
        if len(sides["l"]) == len(sides["r"]) == 1
    ]


# --- keyframes -------------------------------------------------------------------------------------------------------

OUTSIDE = 0.05
"""Share of a range by which a value may lie outside of it, as stops are soft."""


def _beyond(value: float, limits: FloatArray) -> tuple[float, str]:
    """Return how far a value is outside of a range, over its span, and the range as a text; 0 within `OUTSIDE`."""
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
    yield from _keyframes(
        model,
        "joint",
        np.flatnonzero(limited),
        (model.key_qpos[:, model.jnt_qposadr], model.jnt_range),
        'keyframe "{}" puts {} at {:.4g}, outside of its range {}',
    )


def _keyframes(
    model: mujoco.MjModel,
    kind: str,
    numbers: IntArray,
    arrays: tuple[FloatArray, FloatArray],
    form: str,
) -> Iterator[Fault]:
    """Yield values of keyframes outside of the limits of their element."""
    values, limits = arrays
    for key, number in product(range(model.nkey), numbers.tolist()):
        share, text = _beyond(values[key, number], limits[number])
        if share:
            name, label = name_of(model, kind, number), name_of(model, "key", key)
            text = form.format(label, name, values[key, number], text)
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
    is_set = model.key_ctrl.any(axis=1)[:, None]
    values = np.where(is_set, model.key_ctrl, model.actuator_ctrlrange[:, 0])
    yield from _keyframes(
        model,
        "actuator",
        np.flatnonzero(model.actuator_ctrllimited),
        (values, model.actuator_ctrlrange),
        'keyframe "{}" commands {} to {:.4g}; its ctrlrange is {}',
    )


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
            yield Fault(
                ("actuator", number),
                name,
                text + unit_text(ratio),
                max(lost, ratio),
                reached == 0.0,
                ("ctrlrange", np.sort(model.jnt_range[joint] / gain)),
            )


WEAK, MAX_MARGIN = 5.0, 100.0
"""Error at which a servo has its limit, over the range of its joint; limit over the weight on it that no motor has."""


@rule(
    "servo-gain",
    title="force of a servo over its limit",
    source="a servo with a gain per degree in place of radians has 1/57.3 of its force",
    consequence="The servo holds a small part of the load of the real one.",
    most=Severity.ADVICE,
)
def servo_gain(robot: Robot) -> Iterator[Fault]:
    """Yield servos that need an error of many ranges of their joint for their force limit."""
    for drive in drives(robot):
        span = float(np.ptp(robot.model.jnt_range[drive.joint]))
        error = drive.limit / drive.kp if drive.kp else 0.0
        is_motor = drive.limit < MAX_MARGIN * largest_loads(robot)[drive.dof]
        is_weak = is_motor and error > WEAK * max(span, 1.0)
        if drive.is_hinge and span and is_weak:
            force, angle = drive.units
            most = f"{drive.kp * span:.2g} of its {drive.limit:.4g} {force}"
            text = f"{drive.name} with kp {drive.kp:.4g} {force}/{angle} makes at most {most} within its range"
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
    references = [*_references(model)]
    owners = {(kind, number): owner for kind, number, _, owner in references}
    mates = {
        (kind, number): pair[1 - pair.index(number)]
        for kind in {kind for kind, *_ in references}
        for pair in mirrored(model, kind)
        for number in pair
    }
    for kind, number, owner_kind, owner in references:
        name = getattr(model, kind)(number).name
        owner_name = getattr(model, owner_kind)(owner).name
        if kind == "actuator" and name and joints.get(name, owner) != owner:
            text = f"actuator {name} drives joint {owner_name}, not joint {name}"
            yield Fault((kind, number), name, text, change=("joint", name))
            continue
        side, owner_side = side_of(name).side, side_of(owner_name).side
        # Without a mirror part, R may be a roll. A left hand may have a left and a right finger.
        mate = owners.get((kind, mates.get((kind, number), -1)))
        is_other = mate not in (None, owner)
        if kind in ("actuator", "sensor"):
            is_other = mate is not None or bool(re.search("left|right", name, re.I))
        if side and owner_side and side != owner_side and is_other:
            text = (
                f"{kind} {name} belongs to {owner_kind} {owner_name}, on the other side"
            )
            yield Fault((kind, number), name, text, is_usual=True)


OBJECTS = ("body", "joint", "geom", "site", "actuator", "tendon")


def _references(model: mujoco.MjModel) -> Iterator[tuple[str, int, str, int]]:
    """Yield elements and what they belong to: kind and id of both."""
    for number in np.flatnonzero(acts_on_joints(model)).tolist():
        yield "actuator", number, "joint", int(model.actuator_trnid[number, 0])
    for number in range(model.nsensor):
        kind = mujoco.mjtObj(model.sensor_objtype[number]).name.lower()
        kind = kind.removeprefix("mjobj_").removeprefix("x")
        if kind in OBJECTS:
            yield "sensor", number, kind, int(model.sensor_objid[number])
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
        key: Its attribute in the compiled model.
        ratio: Largest ratio that passes.
        change: Attribute of MJCF in which an odd part gets the value of its mirror; empty for none.
    """

    kind: str
    word: str
    key: str
    ratio: float = 1.5
    change: str = ""


TRAITS = (
    Trait("body", "mass [kg]", "mass", change="mass"),
    Trait("body", "inertia [kg m^2]", "inertia", 2.0),
    Trait("joint", "type", "type", 1.1),
    Trait("joint", "range", "range", 1.25, "range"),
    *(
        Trait("joint", key, key, change=key)
        for key in ("damping", "frictionloss", "armature", "stiffness")
    ),
    Trait("joint", "motor limit", "actfrcrange", 1.25, "actuatorfrcrange"),
    Trait("actuator", "gain", "gainprm"),
    Trait("actuator", "damping", "biasprm"),
    Trait("actuator", "gear", "gear", change="gear"),
    Trait("actuator", "range of commands", "ctrlrange", 1.25, "ctrlrange"),
    Trait("actuator", "force limit", "forcerange", 1.25, "forcerange"),
    Trait("geom", "friction", "friction", change="friction"),
    Trait("geom", "condim", "condim", 1.1, "condim"),
    Trait("geom", "collision", "contype", change="contype"),
)


def _size(model: mujoco.MjModel, trait: Trait, number: int) -> float:
    """Return the size of an attribute of an element: the span of a range, which is 0 without a limit."""
    key, element = trait.key, getattr(model, trait.kind)(number)
    if key == "actfrcrange":
        is_limited = bool(model.jnt_actfrclimited[number])
        return float(np.ptp(model.jnt_actfrcrange[number])) * is_limited
    value = np.atleast_1d(getattr(element, key))
    if key.endswith("range"):
        is_limited = bool(getattr(element, key.replace("range", "limited"))[0])
        return float(np.ptp(value)) * is_limited
    if key == "contype":
        return float((value | element.conaffinity).any())
    parts = {"gainprm": slice(1), "biasprm": slice(2, 3), "friction": slice(1)}
    return float(np.linalg.norm(value[parts.get(key, slice(None))]))


@rule(
    "mirror",
    title="left and right part that differ",
    source="names that differ by the side alone are mirror parts",
    consequence="The robot walks in a circle.",
)
def mirror(robot: Robot) -> Iterator[Fault]:
    """Yield parts of the robot whose numbers differ from those of the part on the other side."""
    model = robot.model
    owners = {"joint": model.jnt_bodyid, "geom": model.geom_bodyid}
    owners["body"] = np.arange(model.nbody)
    for trait in TRAITS:
        pairs, owner = mirrored(model, trait.kind), owners.get(trait.kind)
        values = {n: _size(model, trait, n) for n in chain(*pairs)}
        for pair in pairs:
            low, high = sorted(values[n] for n in pair)
            # Walls, cameras and objects are no mirror parts of a robot.
            is_part = owner is None or np.isin(owner[[*pair]], robot.bodies).all()
            if high <= trait.ratio * low or not is_part:
                continue
            texts = [f"{name_of(model, trait.kind, n)} {values[n]:.4g}" for n in pair]
            ratio = high / max(low, 1e-12)
            unit = unit_text(ratio)
            text = f"{trait.word} of left and right differs: {', '.join(texts)}{unit}"
            odd, change = _like_mirror(robot, trait, values, pair)
            name = name_of(model, trait.kind, odd)
            yield Fault(
                (trait.kind, odd), name, text, ratio, change=change, is_usual=not unit
            )


def _like_mirror(
    robot: Robot, trait: Trait, values: Mapping[int, float], pair: tuple[int, int]
) -> tuple[int, Change | None]:
    """Return the part that differs from its mirror and from the like parts of other legs, and its correction."""
    stems = {n: limb_of(getattr(robot.model, trait.kind)(n).name) for n in values}
    others = [values[n] for n in values if stems[n] == stems[pair[0]] and n not in pair]
    if others and trait.change and robot.spec is not None:
        usual = float(np.median(others))
        for odd, right in (pair, pair[::-1]):
            if np.isclose(values[right], usual) and not np.isclose(values[odd], usual):
                element = spec_element(robot.spec, trait.kind, right)
                return odd, (trait.change, getattr(element, trait.key))
    return pair[0], None


SIDEWAYS = 0.9
"""Cosine from which on the line between mirror joints is along an axis of the world, and a joint is a roll."""


@rule(
    "mirror-axis",
    title="left and right joint that turn differently",
    source="a mirror image of a hinge turns about the mirrored axis, through the mirrored range",
    consequence="One leg bends the other way.",
    most=Severity.ADVICE,
)
def mirror_axis(robot: Robot) -> Iterator[Fault]:
    """Yield hinges that are neither a copy nor the mirror image of the one on the other side."""
    model, data = robot.model, mujoco.MjData(robot.model)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    limited = joints_of(model, "HINGE") & (model.jnt_limited != 0)
    for left, right in mirrored(model, "joint"):
        if not limited[[left, right]].all():
            continue
        if _same_turns(model, model.jnt_axis[left], model.jnt_axis[right], left, right):
            continue
        # The axis of a turn is a pseudovector: a mirror keeps its component along the normal, and turns the others.
        normal = data.xanchor[left] - data.xanchor[right]
        normal /= max(float(np.linalg.norm(normal)), 1e-9)
        # Limbs whose first pose is no mirror image, and rolls about a limb, may have any zero.
        roots = model.jnt_bodyid[[left, right]]
        arm, other = data.subtree_com[roots] - data.xanchor[[left, right]]
        apart = arm - 2.0 * (arm @ normal) * normal - other
        most = np.linalg.norm(arm) * np.array([SIDEWAYS, 1.0 - SIDEWAYS])
        is_unknown = np.abs(normal).max() < SIDEWAYS
        is_unknown |= abs(arm @ data.xaxis[left]) > most[0]
        is_unknown |= float(np.linalg.norm(apart)) > most[1]
        image = 2.0 * (data.xaxis[left] @ normal) * normal - data.xaxis[left]
        if _same_turns(model, image, data.xaxis[right], left, right) or is_unknown:
            continue
        first, second = name_of(model, "joint", left), name_of(model, "joint", right)
        axes = [
            f"{np.round(data.xaxis[n], 2).tolist()} {model.jnt_range[n].round(3).tolist()}"
            for n in (left, right)
        ]
        text = f"{first} and {second} turn differently: axis and range {axes[0]} and {axes[1]}"
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
    poses = [
        _overlaps_m(model, data) for data in random_poses(model, POSES * bool(depths_m))
    ]
    usual = {
        pair for pair in depths_m if 2 * sum(map(pair.__eq__, chain(*poses))) >= POSES
    }
    for (first, second), depth_m in depths_m.items():
        is_robot, is_usual = (
            int(model.geom_bodyid[second]) in robot.bodies,
            (first, second) in usual,
        )
        # Code raises a robot without a keyframe above the ground, and moves its joints.
        is_raised = robot.standing is not None and trees[first] < 0
        if is_robot and not model.nkey and (is_raised or not is_usual):
            continue
        label = " and ".join(geom_name(model, geom) for geom in (second, first))
        text = f"{label} overlap by {1e3 * depth_m:.3g} mm where they start"
        changed, change = ("body", 0), None
        if trees[first] < 0:
            lift_m = max(depths_m[pair] for pair in depths_m if trees[pair[0]] < 0)
            changed, change = _lifted(robot, int(trees[second]), lift_m)
        elif is_robot and is_usual:
            bodies = model.geom_bodyid[[first, second]].tolist()
            names = [model.body(body).name for body in bodies]
            change = ("exclude", names) if all(names) else None
        ratio = depth_m / max(model.geom_rbound[second], 1e-6)
        yield Fault(("geom", second), label, text, ratio, False, change, changed)


def _lifted(robot: Robot, tree: int, lift_m: float) -> tuple[Place, Change | None]:
    """Return the keyframe of the start and its position with a free tree of bodies higher."""
    model, pose = robot.model, robot.stance.qpos.copy()
    keys = np.flatnonzero((model.key_qpos == pose).all(axis=1))
    joint = model.body_jntadr[model.tree_bodyadr[tree]]
    if not len(keys) or not joints_of(model, "FREE")[joint]:
        return ("key", 0), None
    place = model.jnt_qposadr[joint]
    pose[place : place + 3] += lift_m * np.asarray(robot.up)
    return ("key", int(keys[0])), ("qpos", pose)


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
    title="tendons outside of their range at the start",
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
            text = (
                f"tendon {name} starts at {length:.4g}, outside of its range {limits}"
            )
            yield Fault(("tendon", tendon), name, text, share)


@rule(
    "touch",
    title="free bodies that can touch nothing fixed",
    source="contype, conaffinity, pairs and excludes of the model",
    consequence="They fall through the floor.",
)
def touch(robot: Robot) -> Iterator[Fault]:
    """Yield free trees of bodies without thrusters that no pair of geoms stops, though the model has a floor."""
    model, pairs = robot.model, robot.pairs
    solid = (model.geom_contype | model.geom_conaffinity) != 0
    fixed = model.body_weldid[model.geom_bodyid] == 0
    if not (solid & fixed).any() or not model.opt.gravity.any():
        return
    ends = model.body_treeid[model.geom_bodyid[pairs.geoms]]
    # Parts of a robot that touch each other do not stop it.
    stopped = np.unique(ends[ends[:, 0] != ends[:, 1]])
    lifted = model.jnt_bodyid[model.dof_jntid[robot.driven_dofs]]
    for body in unheld(model):
        tree = model.body_treeid[body]
        is_marker = (
            tree not in robot.driven_trees
            and not solid[model.body_treeid[model.geom_bodyid] == tree].any()
        )
        if is_marker or tree in stopped or body in lifted or model.body_gravcomp[body]:
            continue
        name = name_of(model, "body", body)
        text = f"{name} is free and none of its geoms can touch another body: it falls through the floor"
        yield Fault(("body", body), name, text, is_error=True)
