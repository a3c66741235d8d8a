"""Find the pairs of joints of a robot of which one is the mirror image of the other."""

from collections.abc import Mapping
from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.optimize import linear_sum_assignment

from gauge_envs.scene.geometry import FloatArray, length_of
from gauge_envs.tools.sanity.robot.copies import FEW_COPIES, SAME, copies_of, depth_of
from gauge_envs.tools.sanity.robot.finding import (
    limits_of,
)
from gauge_envs.tools.sanity.robot.ground_rows import limbs_of
from gauge_envs.tools.sanity.robot.joints import (
    placed_bodies,
)
from gauge_envs.tools.sanity.robot.mujoco_feet import joints_of
from gauge_envs.tools.sanity.robot.robot import (
    Robot,
    ancestors,
    coupled_pairs,
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

ALONG = 0.95
"""Cosine of the angle between two frames, or its opposite, from which on they lie along each other."""

SIDE_BY_SIDE = 0.7
"""Cosine of the angle between the frames of two fingers from which on they are side by side: an eighth of a turn."""

FINGER_M = 0.001
"""Distance of the centre of mass of a finger from the mirror image of another one up to which it is that image [m]."""

ROW_WIDTH = 0.15
"""Width of a row of fingers over its length, at most; hips of Unitree's A1 have 0.26."""


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
    lines = [ancestors(model, body) for body in bodies.tolist()]
    is_aside = np.abs(anchors_m) > SAME_PLACE_M
    coupled = {frozenset(two) for two in coupled_pairs(model).tolist()}
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
                distance_m=length_of(anchors_m[one]),
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
                and is_origin_aside[max(lines[one] & lines[other], default=0)]
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


@once
def zero_pose(robot: Robot) -> mujoco.MjData:
    """Return a robot where its model places it."""
    data = mujoco.MjData(robot.model)
    mujoco.mj_kinematics(robot.model, data)
    mujoco.mj_comPos(robot.model, data)
    return data
