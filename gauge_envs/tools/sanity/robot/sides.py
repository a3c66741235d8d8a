"""Judge whether the sides of a robot are mirror images, and whether copies of a part are driven alike."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.sanity.robot.finding import (
    Finding,
    also,
    body_name,
    limits_of,
    name_of,
    row,
)
from gauge_envs.tools.sanity.robot.ground_rows import geoms_of, limbs_of
from gauge_envs.tools.sanity.robot.joints import (
    driven_dofs,
    driven_joints,
    home_key,
    placed_bodies,
    position_servos,
    servo_gains,
    springs,
    start,
    torque_limits,
)
from gauge_envs.tools.sanity.robot.mass_rows import box_corners
from gauge_envs.tools.sanity.robot.mujoco_feet import joints_of
from gauge_envs.tools.sanity.robot.robot import (
    Robot,
    acts_on_joints,
    couplings_of,
    once,
)

SAME_PLACE_M = 0.01
"""Distance of a joint from the mirror image of another one up to which they are in the same place [m]."""

IMAGES = ((1.0, -1.0, 1.0), (-1.0, 1.0, 1.0), (-1.0, -1.0, 1.0))
"""Signs of the mirror images of a place, and of its image by half a turn, as of the fingers of grippers."""

NO_IMAGE_M = 1e3
"""Distance that keeps joints from being assigned to each other [m]."""

SYMMETRIC_SHARE = 0.5
"""Share of joints with a mirror image in its place from which on the robot has two like sides."""

FEW_PAIRS = 2
"""Other pairs along an axis from which on they say how the two sides turn."""

DIRECTION, ODD_DIRECTION = "direction of command", 0.3
"""What two joints count that turn alike where all others mirror each other: visible, as some makers choose it."""

POSE = "place in the keyframe"
"""What two joints differ in that the keyframe does not place as mirror images: visible, as it can be on purpose."""

SHAPES = "shapes that touch"
"""Difference of two sides in the boxes around their shapes that touch."""

INERTIA_AXES = "inertia axes"
"""Difference of two sides in how their inertia lies, over its trace."""

FOOT_SHARE = 0.3
"""What the shapes of two feet may differ by counts, over that of other links."""

SHARED = ("largest torque", "kp", "damping", "armature", "frictionloss")
"""Quantities that joints of the same motor share."""

OWN_RANGE = "limits"
"""What two joints differ in that have the same commands, and of which one has another range."""

OF_MOTOR, FEW_MOTORS, FEW_ODD = ("largest torque", "armature"), 3, 2
"""Quantities that tell motors apart, motors whose joints all agree, and odd joints of one that do not, at most."""

FEW_SERVOS, ODD_KP = 5, 0.5
"""Servos from which on all but one say what the last should be, and the difference of its kp over the larger one.

A factor of two is a choice: the first joint of a thumb.
"""

LEAST_SIZE_M = 0.01
"""Radius of a link without geoms [m]."""

FEW_COPIES = 2
"""Other copies of a part that agree, from which on they say what the part should be."""

SAME = 0.01
"""Difference of two numbers over the larger one up to which they are the same."""

ALONG = 0.95
"""Cosine of the angle between two frames, or its opposite, from which on they lie along each other."""

SIDE_BY_SIDE = 0.7
"""Cosine of the angle between the frames of two fingers from which on they are side by side: an eighth of a turn."""

FINGER_M = 0.001
"""Distance of the centre of mass of a finger from the mirror image of another one up to which it is that image [m]."""

ROW_WIDTH = 0.15
"""Width of a row of fingers over its length, at most; hips of Unitree's A1 have 0.26."""

STRAIGHT = 0.9999
"""Cosine of half of an angle, from which on a quaternion turns nothing."""

EXACT = (
    dict.fromkeys(
        ("place", "kp", "largest torque", "torque per control", "spring"), 3.0
    )
    | dict.fromkeys(("axis", "obliqueness"), 2.0)
    | {"trunk": 1.25}
)
"""Factor by which a difference counts more, of quantities that makers state more alike on both sides."""

SHARE_OF = {
    "place": "its distance from the origin of the robot",
    "centre": "the size of the link",
}
"""What the difference of a quantity is a share of, by its first word."""

NOT_SYMMETRIC = (
    "the robot has no two sides that mirror each other, and no copies of a part"
)


@dataclass(frozen=True, kw_only=True)
class MirrorPair:
    """Two joints of which one is the mirror image of the other.

    Attributes:
        joint: Joint of one side.
        other: That of the other side.
        depth: Number of joints between the world and each.
        apart_m: Distance of one from the mirror image of the other [m]; of hinges, of their axes.
        slide_m: What the anchor of the image is farther along the axis of the other hinge, shape [3].
        distance_m: Distance of the joint from the origin of the robot [m].
        cosine: Cosine of the angle between an axis and the mirror image of the other one.
        along: Axis of the robot to which that of the joint is nearest.
        centres_apart_m: Centre of mass of one link from the mirror image of the other, each seen from its joint [m].
        ranges_rad: Range of each, from the pose of the model [rad or m], shape [2].
        flip: Signs of the mirror image of a place in the frame of the robot, shape [3].
        is_same_part: Whether both state the same numbers, each in its own frame.
        is_aslant: Whether one is turned to the other one, and neither along nor opposite.
    """

    joint: int
    other: int
    depth: int
    apart_m: float
    slide_m: FloatArray
    distance_m: float
    cosine: float
    along: int
    centres_apart_m: FloatArray
    ranges_rad: Mapping[int, FloatArray]
    flip: FloatArray
    is_same_part: bool
    is_aslant: bool

    @property
    def is_turned(self) -> bool:
        """Whether one is the other one, turned, as fingers around a palm: their ranges are the same."""
        return self.is_same_part and self.is_aslant

    @property
    def range_apart_rad(self) -> float:
        """Largest difference of a limit from that of the other side [rad]."""
        mirrored = self.range_of(self.other)
        apart_rad = float(np.abs(mirrored - self.ranges_rad[self.other]).max())
        # Two of one part can bend the same way on purpose, as no mirror images.
        most_rad = 2.0 * limits_of("robot-mirror")[1] if self.is_same_part else np.inf
        return min(apart_rad, most_rad)

    @property
    def is_uneven(self) -> bool:
        """Whether a range has more room on one side of the pose."""
        uneven_rad = abs(float(self.ranges_rad[self.joint].sum()))
        return uneven_rad > limits_of("robot-mirror")[1]

    def range_of(self, joint: int) -> FloatArray:
        """Return the range that a joint has as the mirror image of the other one [rad], shape [2]."""
        (other,) = {self.joint, self.other} - {joint}
        mirrored: FloatArray = self.ranges_rad[other]
        is_opposite = self.cosine < 0.0 and not self.is_turned
        return -mirrored[::-1] if is_opposite else mirrored


@once
def mirror_pairs(robot: Robot) -> list[MirrorPair]:
    """Return the pairs of joints that mirror each other in the plane with most of them; empty without two like sides.

    Joints are assigned to the mirror images of joints behind as many others, so that the sum of distances is least.
    """
    model = robot.model
    data = zero_pose(robot)
    root = 0 if robot.standing is None else robot.standing.body
    frame = data.xmat[root].reshape(3, 3)
    is_own = np.isin(model.jnt_bodyid, robot.bodies)
    joints = np.flatnonzero(is_own & joints_of(model, "HINGE", "SLIDE"))
    if not len(joints):
        return []
    bodies = model.jnt_bodyid[joints]
    anchors_m = (data.xanchor[joints] - data.xpos[root]) @ frame
    is_slide = joints_of(model, "SLIDE")[joints].tolist()
    axes = data.xaxis[joints] @ frame
    centres_m = (data.xipos[bodies] - data.xanchor[joints]) @ frame
    depths = np.array([depth_of(model, int(joint)) for joint in joints])
    is_aside = np.abs(anchors_m) > SAME_PLACE_M
    couplings = couplings_of(model)
    ends = (model.eq_obj1id[couplings], model.eq_obj2id[couplings])
    coupled = {frozenset(two) for two in np.column_stack(ends).tolist()}
    palms = _palms(robot, data)
    is_copy = copies_of(robot, joints)
    best: list[MirrorPair] = []
    best_fit = (0, 0)
    for signs in IMAGES:
        flip = np.array(signs)
        across = int(np.where(flip < 0.0, is_aside.sum(axis=0), -1).argmax())
        away_m = np.linalg.norm(flip * anchors_m[:, None] - anchors_m, axis=-1)
        away_m[depths[:, None] != depths] = NO_IMAGE_M
        itself = np.flatnonzero(is_aside[:, across])
        away_m[itself, itself] = NO_IMAGE_M
        # Two fingers of a hand on one side are no images of each other.
        origins_m = (data.xpos - data.xpos[root]) @ frame
        is_origin_aside = np.abs(origins_m[:, across]) > SAME_PLACE_M
        _, images = linear_sum_assignment(away_m)
        gaps_m = flip * anchors_m - anchors_m[images]
        between_m = flip * centres_m - centres_m[images]
        stated = zip(gaps_m, axes[images], between_m, is_slide, strict=True)
        slides_m = np.array([_slide_m(*of_pair) for of_pair in stated])
        places_m = np.linalg.norm(gaps_m - slides_m, axis=1)
        fits_m = np.linalg.norm(gaps_m + between_m, axis=1)
        pairs = [
            MirrorPair(
                joint=int(joints[one]),
                other=int(joints[other]),
                depth=int(depths[one]),
                apart_m=float(places_m[one]),
                distance_m=float(np.linalg.norm(anchors_m[one])),
                # The mirror image of an axis of rotation is turned once more.
                cosine=float(flip.prod() * flip * axes[one] @ axes[other]),
                along=int(np.abs(axes[one]).argmax()),
                slide_m=slides_m[one],
                centres_apart_m=between_m[one] + slides_m[one],
                ranges_rad={
                    int(j): model.jnt_range[j] - model.qpos0[model.jnt_qposadr[j]]
                    for j in joints[[one, other]]
                },
                flip=flip,
                is_same_part=_is_same_part(model, *joints[[one, other]].tolist()),
                is_aslant=_is_turned(data, *bodies[[one, other]].tolist()),
            )
            for one, other in enumerate(images)
            if one < other
            and images[other] == one
            and is_aside[[one, other], across].all()
            and not (
                anchors_m[one, across] * anchors_m[other, across] > 0.0
                and is_origin_aside[_meeting_body(model, *bodies[[one, other]])]
            )
            and frozenset(joints[[one, other]].tolist()) not in coupled
            and (
                palms.get(int(bodies[one]), -1) != palms.get(int(bodies[other]))
                or (is_copy[one, other] and fits_m[one] <= FINGER_M)
            )
        ]
        alike = int(sum(pair.apart_m <= SAME_PLACE_M for pair in pairs))
        # Arms side by side are mirror images, or copies by half a turn: masses tell.
        off_m = [np.linalg.norm(pair.centres_apart_m) for pair in pairs]
        fit = alike, int(sum(apart_m <= SAME_PLACE_M for apart_m in off_m))
        if alike >= SYMMETRIC_SHARE * len(pairs) and fit > best_fit:
            best, best_fit = pairs, fit
    return best


def _slide_m(
    apart_m: FloatArray, axis: FloatArray, centres_m: FloatArray, is_slide: bool
) -> FloatArray:
    """Return the part of a distance of two joints that only says where they are stated [m].

    The anchor of a hinge may be anywhere on its axis, that of a slide anywhere. It is such a part where it brings the
    centres of mass nearer.
    """
    along_m: FloatArray = apart_m if is_slide else (apart_m @ axis) * axis
    nearer = np.linalg.norm(centres_m + along_m) < np.linalg.norm(centres_m)
    return along_m if nearer else np.zeros(3)


def _palms(robot: Robot, data: mujoco.MjData) -> dict[int, int]:
    """Return the palm of each link of fingers, by its body: they are sides only if they are copies and mirror images.

    Fingers are the limbs of a body that does not float, of which some begin with frames that lie along each other:
    three or more in a row, or two of three that have as many joints. Legs of a trunk stand in two rows.
    """
    model, limbs = robot.model, limbs_of(robot)
    roots = [limb[-1] for limb in limbs]
    palms = model.body_weldid[model.body_parentid[roots]]
    counts = np.array([model.body_jntnum[limb].sum() for limb in limbs])
    is_like = (palms[:, None] == palms) & (counts[:, None] == counts)
    frames = data.xmat[roots]
    is_row = is_like & (frames @ frames.T > 1.0 + 2.0 * SIDE_BY_SIDE)
    hands = set()
    for palm, like, of_row in zip(palms.tolist(), is_like, is_row, strict=True):
        fewest = 2 if like.sum() == FEW_COPIES + 1 else FEW_COPIES + 1
        if of_row.sum() < fewest:
            continue
        places_m = data.xpos[roots][of_row]
        off_m = places_m - places_m.mean(axis=0)
        lengths_m = np.linalg.svd(off_m, compute_uv=False)
        if lengths_m[1] <= ROW_WIDTH * lengths_m[0]:
            hands.add(palm)
    floating = model.jnt_bodyid[joints_of(model, "FREE")].tolist()
    hands -= {*floating, *placed_bodies(model)}
    rows = zip(limbs, palms.tolist(), strict=True)
    return {body: palm for limb, palm in rows if palm in hands for body in limb}


def _is_same_part(model: mujoco.MjModel, one: int, other: int) -> bool:
    """Return whether a joint and its link state the numbers of another one, each in its own frame."""
    bodies = model.jnt_bodyid[[one, other]]
    numbers = (
        *(model.jnt_axis[[one, other]], model.jnt_range[[one, other]]),
        *(model.body_ipos[bodies], model.body_inertia[bodies]),
    )
    return all(bool(np.abs(a - b).max() <= SAME * np.abs(a).max()) for a, b in numbers)


def _is_turned(data: mujoco.MjData, one: int, other: int) -> bool:
    """Return whether a link is turned to another one, as the fingers around a palm, and neither along nor opposite."""
    frames = data.xmat[[one, other]].reshape(2, 3, 3)
    cosine = 0.5 * (float(np.trace(frames[0].T @ frames[1])) - 1.0)
    return abs(cosine) <= ALONG


def depth_of(model: mujoco.MjModel, joint: int) -> int:
    """Return the number of joints between the world and a joint."""
    count, dof = 0, int(model.jnt_dofadr[joint])
    while dof >= 0:
        count, dof = count + 1, int(model.dof_parentid[dof])
    return count


def _meeting_body(model: mujoco.MjModel, one: int, other: int) -> int:
    """Return the body nearest to two bodies that carries both."""
    while one != other:
        # A body comes after its parent.
        one, other = sorted((one, other))
        other = int(model.body_parentid[other])
    return one


@row("robot-mirror")
def _mirror(robot: Robot) -> Finding:
    model = robot.model
    driven = set(driven_joints(robot))
    limited = driven & set(np.flatnonzero(model.jnt_limited).tolist())
    pairs = [one for one in mirror_pairs(robot) if {one.joint, one.other} <= limited]
    parts = {name_of(robot, one.other): one.range_apart_rad for one in pairs}
    if not parts:
        return Finding(declined="no two driven hinges with limits mirror each other")
    name = max(parts, key=parts.__getitem__)
    worst = pairs[list(parts).index(name)]
    return Finding(
        value=parts[name],
        parts=parts,
        remark=_ranges_text(robot, worst),
        advice=f"the axis and range of {_both(robot, worst)}: which way does the real one bend?",
    )


def _both(robot: Robot, pair: MirrorPair) -> str:
    """Return the names of two joints of which the model does not say which is wrong."""
    return f"{name_of(robot, pair.joint)} or {name_of(robot, pair.other)}"


def _ranges_text(robot: Robot, pair: MirrorPair) -> str:
    """Return the range of a joint, and that of the mirror image of the other one, in words."""
    stated, mirrored = (
        " to ".join(f"{end:.3g}" for end in ends)
        for ends in (pair.ranges_rad[pair.other], pair.range_of(pair.other))
    )
    names = [name_of(robot, joint) for joint in (pair.other, pair.joint)]
    return f"{names[0]} has {stated} rad, the mirror image of {names[1]} {mirrored} rad"


@row("robot-sides")
def _sides(robot: Robot) -> Finding:
    known = quantities(robot)
    parts: dict[str, float] = {}
    texts: dict[str, str] = {}
    mirrored = (
        (one.joint, one.other, *of_pair)
        for one in mirror_pairs(robot)
        for of_pair in differences(robot, one)
    )
    parts.update(_trunk_shares(robot))
    odd = (*odd_copies(robot), *_odd_servos(robot), *_odd_gains(robot))
    for joint, other, quantity, difference in (*mirrored, *odd):
        name = f"{quantity} of {name_of(robot, joint)} and {name_of(robot, other)}"
        parts[name] = difference
        if quantity == DIRECTION:
            texts[name] = f"not as in {_other_pairs(robot, joint)}"
        elif quantity == OWN_RANGE:
            texts[name] = (
                "both have the same commands, and all other servos have those of the limits of their joint"
            )
        elif quantity in known:
            values = known[quantity][_places(robot, quantity)[[joint, other]]]
            texts[name] = " and ".join(f"{value:.3g}" for value in values)
    if not parts:
        return Finding(declined=NOT_SYMMETRIC)
    worst = max(parts, key=parts.__getitem__)
    value, advice = parts[worst], f"the same for both: {worst}"
    if worst.startswith(DIRECTION):
        advice = (
            "the axis or the gear of one of these joints, unless they are mounted so"
        )
    if worst.startswith(OWN_RANGE):
        name = worst.removeprefix(f"{OWN_RANGE} of ").partition(" and ")[0]
        advice = (
            f"the ctrlrange of {name}, or its range: which is that of the real joint?"
        )
    if worst.startswith(OF_GEOMETRY) and (pair := _first_misplaced(robot)):
        both = f"{name_of(robot, pair.joint)} and {name_of(robot, pair.other)}"
        several = [f"{quantity} of {both}" for quantity in OF_GEOMETRY]
        worst = max(several, key=parts.__getitem__)
        links = " and ".join(
            body_name(robot, int(robot.model.jnt_bodyid[joint]))
            for joint in (pair.joint, pair.other)
        )
        advice = f"pos, quat (w x y z) and inertial of {links}, and the axis of their joints, as mirror images"
    is_trunk = worst.endswith((" ahead", " aside"))
    base = SHARE_OF.get(worst.partition(" of ")[0], "the larger one")
    if is_trunk:
        base, advice = "the distance of its hips", f"the {worst}, between its hips"
    share = parts[worst] / EXACT.get(
        "trunk" if is_trunk else worst.partition(" of ")[0], 1.0
    )
    differs = f"{100.0 * share:.3g} % of {base}"
    remark = f"{worst}: {texts.get(worst, differs)}" if value > 1e-3 else ""
    return Finding(
        value=value,
        parts=parts,
        remark=remark + also(parts, worst, limits_of("robot-sides")[1]),
        advice=advice,
    )


def _other_pairs(robot: Robot, joint: int) -> str:
    """Return the names of the first pairs of joints about the same axis as a joint."""
    pairs = mirror_pairs(robot)
    along = next(one.along for one in pairs if joint in (one.joint, one.other))
    others = [
        one
        for one in pairs
        if one.along == along and joint not in (one.joint, one.other)
    ]
    names = [
        f"{name_of(robot, one.joint)} and {name_of(robot, one.other)}" for one in others
    ]
    return ", ".join(names[:3])


def _first_misplaced(robot: Robot) -> MirrorPair | None:
    """Return the pair nearest to the trunk whose links are no mirror images: what is behind them is elsewhere too."""
    high = limits_of("robot-sides")[1]
    for pair in sorted(mirror_pairs(robot), key=lambda one: one.depth):
        found = dict(differences(robot, pair))
        if any(found[quantity] > high for quantity in OF_GEOMETRY):
            return pair
    return None


def _trunk_shares(robot: Robot) -> Iterator[tuple[str, float]]:
    """Yield how far the centre of mass of a trunk is from the middle between its hips, over the distance of these.

    The trunk is all that lies behind no joint with a mirror image. Two hips tell it aside, four ahead too.
    """
    standing, pairs, model = robot.standing, mirror_pairs(robot), robot.model
    if standing is None or not pairs:
        return
    aside = {int(model.jnt_bodyid[j]) for one in pairs for j in (one.joint, one.other)}
    is_aside = np.zeros(model.nbody, bool)
    for body in robot.bodies:
        is_aside[body] = body in aside or is_aside[model.body_parentid[body]]
    trunk = [body for body in robot.bodies if not is_aside[body]]
    mass_kg = model.body_mass[trunk]
    legs = [limb for limb in limbs_of(robot) if set(limb) & set(standing.feet)]
    if len(legs) < 2 or not mass_kg.any():
        return
    data = start(robot)
    frame = data.xmat[standing.body].reshape(3, 3)
    hips_m = data.xpos[[limb[-1] for limb in legs]] @ frame
    centre_m = mass_kg @ data.xipos[trunk] / mass_kg.sum() @ frame
    for axis, word in enumerate(("ahead", "aside")):
        low_m, high_m = hips_m[:, axis].min(), hips_m[:, axis].max()
        if high_m - low_m > 2.0 * SAME_PLACE_M:
            off_m = abs(float(centre_m[axis] - 0.5 * (low_m + high_m)))
            name = f"centre of mass of {body_name(robot, standing.body)} {word}"
            yield name, EXACT["trunk"] * off_m / float(high_m - low_m)


def _places(robot: Robot, quantity: str) -> FloatArray:
    """Return the place of the value of each joint in an array of `quantities`, shape [njnt]."""
    model = robot.model
    return model.jnt_bodyid if quantity in OF_LINKS else model.jnt_dofadr


def copies_of(robot: Robot, joints: NDArray[np.int_]) -> NDArray[np.bool_]:
    """Return which joints carry copies of a link: as deep, of the same mass, inertia and distance of its centre.

    Args:
        robot: The robot.
        joints: The joints, shape [count].

    Returns:
        Whether one is a copy of another one, shape [count, count].
    """
    model = robot.model
    bodies = model.jnt_bodyid[joints]
    known = quantities(robot)
    centres_m = np.linalg.norm(model.body_ipos[bodies] - model.jnt_pos[joints], axis=1)
    # A link of another place that weighs the same by chance is no copy.
    depths = np.array([depth_of(model, int(joint)) for joint in joints], float)
    links = (known["mass"][bodies], known["inertia"][bodies], centres_m, depths)
    is_copy = np.all([apart(one) <= SAME for one in links], axis=0)
    np.fill_diagonal(is_copy, False)
    copies: NDArray[np.bool_] = is_copy
    return copies


def _odd_ones(
    values: FloatArray, is_like: NDArray[np.bool_], within: float
) -> Iterator[tuple[int, int, float]]:
    """Yield a place, that of a like one, and the difference of their values, where at least two like ones agree."""
    off = apart(values)
    for place in np.flatnonzero(is_like.sum(axis=1) >= FEW_COPIES).tolist():
        like = np.flatnonzero(is_like[place])
        difference = float(off[place, like[0]])
        if (off[np.ix_(like, like)] <= within).all() and np.isfinite(difference):
            yield place, int(like[0]), difference


def odd_copies(robot: Robot) -> Iterator[tuple[int, int, str, float]]:
    """Yield a joint, a copy, a quantity in which its copies agree, and the difference over the larger one."""
    model = robot.model
    dofs = list(driven_dofs(robot))
    joints = model.dof_jntid[dofs]
    is_copy = copies_of(robot, joints)
    driven = {n: one[dofs] for n, one in quantities(robot).items() if n not in OF_LINKS}
    along = np.abs(model.jnt_axis[joints]).max(axis=1)
    driven["obliqueness"] = np.sqrt(np.maximum(1.0 - along**2, 0.0))
    for quantity, values in driven.items():
        for place, other, difference in _odd_ones(values, is_copy, SAME):
            counts = EXACT.get(quantity, 1.0) * difference
            yield int(joints[place]), int(joints[other]), quantity, counts


def _odd_servos(robot: Robot) -> Iterator[tuple[int, int, str, float]]:
    """Yield a joint, another one, and the quantity in which its servo alone contradicts all the others; visible.

    It is a kp beside the kv of all, or limits of the joint that are not those of its commands, which others share.
    """
    model = robot.model
    motors = [one for one in position_servos(robot) if model.actuator_gear[one, 0]]
    if len(motors) < FEW_SERVOS:
        return
    joints = model.actuator_trnid[motors, 0]
    kp = quantities(robot)["kp"][model.jnt_dofadr]
    for joint, (quantity, other) in odd_motors(robot).items():
        if quantity == "kp" and apart(kp[[joint, other]])[0, 1] > ODD_KP:
            yield joint, other, "kp", ODD_DIRECTION
    commands, ranges = model.actuator_ctrlrange[motors], model.jnt_range[joints]
    gaps = np.abs(commands - ranges).max(axis=1)
    is_odd = gaps > SAME * np.ptp(ranges, axis=1)
    if is_odd.sum() != 1:
        return
    odd = int(is_odd.argmax())
    alike = np.abs(commands - commands[odd]).max(axis=1) <= SAME * gaps[odd]
    copies = np.flatnonzero(alike & ~is_odd)
    if len(copies) >= FEW_COPIES:
        yield int(joints[odd]), int(joints[copies[0]]), OWN_RANGE, ODD_DIRECTION


def _odd_gains(robot: Robot) -> Iterator[tuple[int, int, str, float]]:
    """Yield joints whose gain alone is not that of its motor, by which all other gains were chosen; visible."""
    known, model = quantities(robot), robot.model
    dofs = model.jnt_dofadr[model.actuator_trnid[position_servos(robot), 0]]
    for source in OF_MOTOR:
        motors = [
            dofs[known[source][dofs] == one] for one in np.unique(known[source][dofs])
        ]
        for quantity in ("kp", "damping"):
            several = [known[quantity][motor] for motor in motors if len(motor) > 1]
            even = [one for one in several if (apart(one) <= SAME).all()]
            # The same joints left and right say nothing of their motor.
            gains = {one[0] for one in even if len(one) > 2}
            if len(even) != len(several) - 1 or len(gains) < FEW_MOTORS:
                continue
            motor = next(m for m in motors if (apart(known[quantity][m]) > SAME).any())
            is_like = apart(known[quantity][motor]) <= SAME
            usual = int(is_like.sum(axis=1).argmax())
            odd = motor[~is_like[usual]]
            if len(odd) <= min(FEW_ODD, is_like[usual].sum() - 1):
                other = int(model.dof_jntid[motor[usual]])
                for joint in model.dof_jntid[odd].tolist():
                    yield joint, other, quantity, ODD_DIRECTION


@once
def odd_motors(robot: Robot) -> dict[int, tuple[str, int]]:
    """Return joints that differ in one number alone from at least two like others: the number, and another joint."""
    dofs = list(driven_dofs(robot))
    joints, found = robot.model.dof_jntid[dofs], {}
    known = {name: quantities(robot)[name][dofs] for name in SHARED}
    high = limits_of("robot-sides")[1]
    unlike = {name: apart(values) > high for name, values in known.items()}
    for name in SHARED:
        others = [unlike[other] for other in SHARED if other != name]
        is_like = ~np.any(others, axis=0)
        np.fill_diagonal(is_like, False)
        # One that a like joint shares is no exception.
        is_like[(is_like & ~unlike[name]).any(axis=1)] = False
        for place, other, _ in _odd_ones(known[name], is_like, high):
            found[int(joints[place])] = name, int(joints[other])
    return found


def apart(values: FloatArray) -> FloatArray:
    """Return the difference of all numbers from each other over the larger one, NaN where one is not finite."""
    sizes = np.abs(values)
    with np.errstate(invalid="ignore"):
        differences = np.abs(values[:, None] - values)
        return differences / np.maximum(np.maximum(sizes[:, None], sizes), 1e-12)


def differences(robot: Robot, pair: MirrorPair) -> Iterator[tuple[str, float]]:
    """Yield quantities of two joints and their links, and what their difference counts."""
    for name, difference in _shares(robot, pair):
        yield name, EXACT.get(name, 1.0) * difference


def _shares(robot: Robot, pair: MirrorPair) -> Iterator[tuple[str, float]]:
    """Yield quantities of two joints and their links, and how they differ over the larger one; 2 for another sign."""
    model = robot.model
    bodies = model.jnt_bodyid[[pair.joint, pair.other]].tolist()
    geoms = [geom for body in bodies for geom in geoms_of(robot, body)]
    next_m = model.body_pos[np.isin(model.body_parentid, bodies)]
    reaches_m = np.linalg.norm(next_m, axis=1)
    size_m = max([2.0 * LEAST_SIZE_M, *(2.0 * model.geom_rbound[geoms]), *reaches_m])
    yield "place", max(pair.apart_m - SAME_PLACE_M, 0.0) / pair.distance_m
    yield "axis", float(np.sqrt(max(1.0 - pair.cosine**2, 0.0)))
    others = [
        one
        for one in mirror_pairs(robot)
        if one.along == pair.along and one.joint != pair.joint
    ]
    # Hips of four legs are two pairs.
    has_copy = any(
        one.depth == pair.depth
        and apart(model.body_mass[[model.jnt_bodyid[one.joint], bodies[0]]])[0, 1]
        <= SAME
        for one in others
    )
    is_alone = not any((one.cosine > 0.0) == (pair.cosine > 0.0) for one in others)
    # A range that mirrors the other one, or a limb that turns alike, explains the axis better than other joints do.
    is_explained = (
        pair.is_uneven and pair.range_apart_rad <= limits_of("robot-mirror")[1]
    )
    limb = {body for one in limbs_of(robot) if {*one} & {*bodies} for body in one}
    of_limb = [
        one for one in mirror_pairs(robot) if model.jnt_bodyid[one.joint] in limb
    ]
    turns = {one.cosine > 0.0 for one in of_limb}
    is_explained |= len(of_limb) > FEW_PAIRS and len(turns) == 1
    is_odd = is_alone and (has_copy or (len(others) >= FEW_PAIRS and not is_explained))
    is_odd &= not pair.is_turned
    yield DIRECTION, ODD_DIRECTION * is_odd
    yield "centre of mass", float(np.linalg.norm(pair.centres_apart_m)) / size_m
    couplings = couplings_of(model)
    followers = {*model.eq_obj1id[couplings], *model.eq_obj2id[couplings]}
    # Of two fingers that a coupling closes, one has the motor.
    follows = bool(followers & {pair.joint, pair.other})
    if pair.apart_m <= SAME_PLACE_M and abs(pair.cosine) > STRAIGHT:
        yield from _images(robot, pair, size_m)
    for name, values in quantities(robot).items():
        if name == "range" or (follows and name in OF_MOTORS):
            # The ranges of two sides are a row of their own.
            continue
        both = values[_places(robot, name)[[pair.joint, pair.other]]]
        difference = float(apart(both)[0, 1])
        if np.isfinite(difference):
            yield name, difference


def _images(
    robot: Robot, pair: MirrorPair, size_m: float
) -> Iterator[tuple[str, float]]:
    """Yield how the inertia, shapes that touch, and places in the keyframe, of two joints are no mirror images."""
    model, data = robot.model, zero_pose(robot)
    root = 0 if robot.standing is None else robot.standing.body
    frame, touching = data.xmat[root].reshape(3, 3), np.unique(robot.pairs.geoms)
    boxes_m, tensors = [], []
    for joint, flip, slide_m in (
        (pair.joint, pair.flip, pair.slide_m),
        (pair.other, np.ones(3), np.zeros(3)),
    ):
        body = int(model.jnt_bodyid[joint])
        axes = frame.T @ data.ximat[body].reshape(3, 3) * flip[:, None]
        inertia = model.body_inertia[body]
        tensors.append((axes * inertia) @ axes.T / max(inertia.sum(), 1e-12))
        geoms = [geom for geom in geoms_of(robot, body) if geom in touching]
        corners_m = box_corners(model, geoms) @ data.xmat[body].reshape(3, 3).T
        corners_m = (corners_m + data.xpos[body] - data.xanchor[joint]) @ frame * flip
        corners_m += slide_m
        if geoms:
            boxes_m.append([corners_m.min(axis=0), corners_m.max(axis=0)])
    if len(boxes_m) == 2:
        first_m, second_m = np.array(boxes_m)
        if robot.standing and body in robot.standing.feet:
            size_m = FOOT_SHARE * float(np.ptp(first_m, axis=0).max())
        yield SHAPES, float(np.abs(first_m - second_m).max()) / size_m
    yield INERTIA_AXES, float(np.abs(tensors[0] - tensors[1]).max())
    places = model.jnt_qposadr[[pair.joint, pair.other]]
    # Of turned copies, as two arms, each has a pose of its own.
    if model.nkey and pair.flip.prod() < 0.0:
        first, second = model.key_qpos[home_key(model), places] - model.qpos0[places]
        yield POSE, min(abs(first - np.sign(pair.cosine) * second), ODD_DIRECTION)


@once
def zero_pose(robot: Robot) -> mujoco.MjData:
    """Return a robot where its model places it."""
    data = mujoco.MjData(robot.model)
    mujoco.mj_kinematics(robot.model, data)
    mujoco.mj_comPos(robot.model, data)
    return data


OF_GEOMETRY = ("place", "axis", "centre of mass")
"""Differences of two sides in how their links are placed."""

OF_LINKS = frozenset({"mass", "inertia", "collisions", "friction", "size", "softness"})
"""Quantities of links; the others are of joints."""

OF_MOTORS = frozenset(
    {"kp", "damping", "largest torque", "torque per control", "command", "filter"}
)
"""Quantities that a joint has through its motor."""


@once
def quantities(robot: Robot) -> dict[str, FloatArray]:
    """Return what two sides share, by its name: of each body, shape [nbody], or of each degree of freedom, shape [nv].

    Damping is that of the joint and of its servo. A value that is not finite is not compared.
    """
    model = robot.model
    collisions, friction = np.zeros(model.nbody), np.full(model.nbody, np.nan)
    size_m, softness_s = np.zeros(model.nbody), np.full(model.nbody, np.nan)
    touching = np.unique(robot.pairs.geoms)
    for body in robot.bodies:
        geoms = [geom for geom in geoms_of(robot, body) if geom in touching]
        if geoms:
            collisions[body] = 1.0
            has_friction = model.geom_condim[geoms] > 1
            friction[body] = (model.geom_friction[geoms, 0] * has_friction).min()
            size_m[body] = np.cbrt(model.geom_aabb[geoms, 3:].prod(axis=1).max())
            softness_s[body] = model.geom_solref[geoms, 0].max()
    is_range = model.jnt_limited[model.dof_jntid] != 0
    return {
        "mass": model.body_mass,
        "inertia": model.body_inertia.sum(axis=1),
        "collisions": collisions,
        "friction": friction,
        "size": size_m,
        "softness": softness_s,
        "range": np.ptp(model.jnt_range[model.dof_jntid], axis=1) * is_range,
        "spring": springs(model)[model.dof_jntid],
        "torque per control": _of_motors(robot, np.abs(model.actuator_gainprm[:, 0])),
        "command": _of_motors(robot, np.ptp(model.actuator_ctrlrange, axis=1)),
        "filter": _of_motors(robot, model.actuator_dynprm[:, 0]),
        "kp": servo_gains(model, 1),
        "damping": model.dof_damping + servo_gains(model, 2),
        "armature": model.dof_armature,
        "frictionloss": model.dof_frictionloss,
        "largest torque": torque_limits(model),
    }


def _of_motors(robot: Robot, values: FloatArray) -> FloatArray:
    """Return a number of the actuators, times their gears, on each degree of freedom, shape [nv]."""
    model = robot.model
    found = np.zeros(model.nv)
    is_on_joint = acts_on_joints(model)
    scaled = np.abs(model.actuator_gear[:, 0]) * values
    dofs = model.jnt_dofadr[model.actuator_trnid[is_on_joint, 0]]
    np.add.at(found, dofs, scaled[is_on_joint])
    return found
