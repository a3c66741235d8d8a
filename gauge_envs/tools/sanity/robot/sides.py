"""Judge whether the sides of a robot are mirror images, and whether copies of a part are driven alike."""

from collections.abc import Iterator

import numpy as np

from gauge_envs.scene.geometry import FloatArray, length_of
from gauge_envs.tools.sanity.robot.copies import (
    EXACT,
    OF_LINKS,
    OF_MOTORS,
    OWN_RANGE,
    SAME,
    VISIBLE,
    apart,
    odd_copies,
    odd_gains,
    odd_servos,
    quantities,
)
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
    driven_joints,
    home_key,
    start,
)
from gauge_envs.tools.sanity.robot.mass_rows import box_corners
from gauge_envs.tools.sanity.robot.mirror import (
    SAME_PLACE_M,
    MirrorPair,
    mirror_pairs,
    zero_pose,
)
from gauge_envs.tools.sanity.robot.robot import (
    Robot,
    coupled_pairs,
)

FEW_PAIRS = 2
"""Other pairs along an axis from which on they say how the two sides turn."""

DIRECTION = "direction of command"
"""What two joints differ in that turn alike where all others mirror each other: visible, as some makers choose it."""

POSE = "place in the keyframe"
"""What two joints differ in that the keyframe does not place as mirror images: visible, as it can be on purpose."""

SITES = "sites"
"""What two links differ in of whose sites one alone is no mirror image: visible."""

TEXTS = {
    SITES: "not mirror images",
    DIRECTION: "unlike in all other pairs of joints about this axis",
    OWN_RANGE: "both have the same commands or limits, and all other servos have those of the limits of their joint",
}
"""What is said of a difference instead of its numbers."""

SHAPES = "shapes that touch"
"""Difference of two sides in the boxes around their shapes that touch."""

INERTIA_AXES = "inertia axes"
"""Difference of two sides in how their inertia lies, over its trace."""

FOOT_SHARE = 0.3
"""What the shapes of two feet may differ by counts, over that of other links."""

LEAST_SIZE_M = 0.01
"""Radius of a link without geoms [m]."""

STRAIGHT = 0.9999
"""Cosine of half of an angle, from which on a quaternion turns nothing."""

SHARE_OF = {
    "place": "its distance from the origin of the robot",
    "centre": "the size of the link",
}
"""What the difference of a quantity is a share of, by its first word."""

NOT_SYMMETRIC = (
    "the robot has no two sides that mirror each other, and no copies of a part"
)

OF_GEOMETRY = ("place", "axis", "centre of mass")
"""Differences of two sides in how their links are placed."""

PROVEN = ("mass", "inertia", "collisions", "kp", "largest torque", "torque per control")
"""What two sides share in real robots; how joints rub and yield is identified joint by joint."""


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
    both = _both(robot, worst.joint, worst.other, "or")
    return Finding(
        value=parts[name],
        parts=parts,
        remark=_ranges_text(robot, worst),
        advice=f"the axis and range of {both}: which way does the real one bend?",
    )


def _both(robot: Robot, joint: int, other: int, word: str = "and") -> str:
    """Return the names of two joints."""
    return f"{name_of(robot, joint)} {word} {name_of(robot, other)}"


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
    several = [(one, dict(differences(robot, one))) for one in mirror_pairs(robot)]
    mirrored = (
        (one.joint, one.other, *of_pair)
        for one, shares in several
        for of_pair in shares.items()
    )
    parts.update(_trunk_shares(robot))
    high = limits_of("robot-sides")[1]
    # Links that are mirror images in place, axis and centre of mass should have one mass, and like motors.
    proven = {
        f"{quantity} of {_both(robot, one.joint, one.other)}"
        for one, shares in several
        if all(shares[quantity] <= high for quantity in OF_GEOMETRY)
        for quantity in PROVEN
    }
    odd = (*odd_copies(robot), *odd_servos(robot), *odd_gains(robot))
    for joint, other, quantity, difference in (*mirrored, *odd):
        name = f"{quantity} of {_both(robot, joint, other)}"
        parts[name] = difference
        if quantity in TEXTS:
            texts[name] = TEXTS[quantity]
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
        both = _both(robot, pair.joint, pair.other)
        worst = max(
            (f"{quantity} of {both}" for quantity in OF_GEOMETRY), key=parts.__getitem__
        )
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
        remark=remark + also(parts, worst, high),
        advice=advice,
        is_usual=worst not in proven,
    )


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
    yield DIRECTION, VISIBLE * is_odd
    yield "centre of mass", length_of(pair.centres_apart_m) / size_m
    followers = {*coupled_pairs(model).ravel().tolist()}
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
    """Yield how the inertia, shapes that touch, sites and keyframe places of two joints are no mirror images."""
    model, data = robot.model, zero_pose(robot)
    root = 0 if robot.standing is None else robot.standing.body
    frame, touching = data.xmat[root].reshape(3, 3), np.unique(robot.pairs.geoms)
    boxes_m, tensors, sites_m = [], [], []
    for joint, flip, slide_m in (
        (pair.joint, pair.flip, pair.slide_m),
        (pair.other, np.ones(3), np.zeros(3)),
    ):
        body = int(model.jnt_bodyid[joint])
        axes = frame.T @ data.ximat[body].reshape(3, 3) * flip[:, None]
        inertia = model.body_inertia[body]
        tensors.append((axes * inertia) @ axes.T / max(inertia.sum(), 1e-12))
        places_m = data.site_xpos[model.site_bodyid == body] - data.xanchor[joint]
        sites_m.append(places_m @ frame * flip + slide_m)
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
    first_m, second_m = sites_m
    if len(first_m) == len(second_m) > 0:
        away_m = np.linalg.norm(first_m[:, None] - second_m, axis=-1).min(axis=1)
        yield SITES, VISIBLE * ((away_m > SAME_PLACE_M).sum() == 1)
    yield INERTIA_AXES, float(np.abs(tensors[0] - tensors[1]).max())
    places = model.jnt_qposadr[[pair.joint, pair.other]]
    # Of turned copies, as two arms, each has a pose of its own.
    if model.nkey and pair.flip.prod() < 0.0:
        first, second = model.key_qpos[home_key(model), places] - model.qpos0[places]
        yield POSE, min(abs(first - np.sign(pair.cosine) * second), VISIBLE)
