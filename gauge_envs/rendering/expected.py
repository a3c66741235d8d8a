"""Where bodies are expected to go, before a run: what the camera of a picture frames.

The estimates are coarse: a driven body follows its driver, a swing is as high on the other side, a free body flies
until the floor, a loose cloth falls by half its size. No engine runs for them.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs.backends.shared.attachments import bonded_soft_bodies
from gauge_envs.evaluation.reference_path import ReferencePath
from gauge_envs.scene import (
    Box,
    Cloth,
    Deformable,
    Hinge,
    Motion,
    Plane,
    Pose,
    RigidBody,
    Rope,
    Scene,
    SoftBody,
    Tether,
)
from gauge_envs.scene.geometry import FloatArray, vector

STILL_RAD = 1e-3
"""Largest angle from hanging at which bodies hang still [rad]."""
STEPS = 13
"""Moments at which a motion is looked at."""
RESTS_WITHIN_M = 0.01
"""Largest gap to a body below at which a body counts as resting on it [m]."""
LEVEL_SHARE = 0.15
"""Smallest level part of the longest way at which a motion has a plane that is seen from the side."""
SURROUNDINGS = (0.4, 0.12)
"""Share of the size of the action within which a still body is shown whole, and within which a part of it is shown."""
BEYOND = 1.1
"""How much further than the reference a simulated body may go, at the end of its way."""
ACTION_REACH_M, ACTION_REACH_RAD = 0.3, 0.6
"""Longest way of a body that actions alone move which is looked at."""
FLIGHT_LIMIT_S = 2.0
"""Longest flight that is looked at [s]."""


@dataclass
class Expected:
    """What a camera has to show.

    Attributes:
        points_m: Points that must be in the picture [m], shape [point_count, 3].
        places_m: Places of what moves, for what still bodies may hide [m], shape [place_count, 3].
        across: Level unit vector across the motion, shape [2]; None if the motion has no plane.
        movers: Names of the bodies that move.
    """

    points_m: FloatArray
    places_m: FloatArray
    across: FloatArray | None
    movers: frozenset[str]


def expected_motion(scene: Scene, reference: ReferencePath | None = None) -> Expected:
    """Return where the bodies of a scene are expected to go.

    Args:
        scene: The scene.
        reference: Places of the reference, or None. A body with a place follows it, also a driven one.
    """
    # The corners of each body at several moments, each of shape [moment_count, corner_count, 3].
    ways: list[FloatArray] = []
    carriers = {driver.body: _driven_poses(scene, driver.body, reference) for driver in scene.drivers}
    for name, poses in carriers.items():
        ways.append(np.array([pose.to_world(scene.body(name).shape.corners_m) for pose in poses]))
    swing, supports = _swings(scene), _supports(scene)
    for body in scene.dynamic_bodies:
        ways.append(np.array(_way_of(scene, body, carriers, swing, reference, supports.get(body.name))))
    for soft in scene.deformables:
        ways.append(np.array(_deformable_way(scene, soft, carriers)))
    action = np.concatenate([way.reshape(-1, 3) for way in ways]) if ways else np.zeros((0, 3))
    movers = frozenset({*carriers, *(body.name for body in scene.dynamic_bodies)})
    if not len(action):
        still = [_corners(body) for body in scene.bodies if not isinstance(body.shape, Plane)]
        action = np.concatenate(still) if still else np.zeros((1, 3))
    return Expected(
        points_m=np.concatenate([action, _surroundings(scene, action, movers)]),
        places_m=action,
        across=_across(ways, scene),
        movers=movers,
    )


def _way_of(
    scene: Scene,
    body: RigidBody,
    carriers: Mapping[str, list[Pose]],
    swing: Mapping[str, list[FloatArray]],
    reference: ReferencePath | None,
    below: RigidBody | None,
) -> list[FloatArray]:
    """Return the corners of a dynamic body at several moments."""
    start = _corners(body)
    if body.name in swing:
        return swing[body.name]
    if reference is not None and body.name in reference.names:
        places = reference.places_m[:, reference.names.index(body.name)]
        places = places[np.isfinite(places).all(axis=1)]
        if len(places):
            picked = places[np.linspace(0, len(places) - 1, min(STEPS, len(places))).round().astype(int)]
            away = [place - body.pose.position_m for place in picked]
            # A simulation may go further than reality.
            away.append(BEYOND * away[-1])
            return [np.concatenate([start, _around(start)]) + shift for shift in (np.zeros(3), *away)]
    if below is not None and below.name in carriers:
        return _carried(body, below, carriers[below.name])
    if below is not None and below.motion is Motion.FIXED and body.starts_at_rest:
        return [start, start + _slide(body, below)]
    if below is not None and body.starts_at_rest:
        return [start, start + _toppled(scene, start, swing)]
    return _flight(scene, body, start)


# --- driven, hanging, flying ---


def _driven_poses(scene: Scene, name: str, reference: ReferencePath | None) -> list[Pose]:
    """Return the poses of a driven body over the episode; of one that actions alone move, the ends of a short way."""
    driver = next(driver for driver in scene.drivers if driver.body == name)
    start = scene.body(name).pose
    if reference is not None and name in reference.names:
        places = reference.places_m[:, reference.names.index(name)]
        return [start, *(replace(start, position_m=vector(place)) for place in places)]
    if any(motion.profiles for motion in driver.motions):
        times = np.linspace(0.0, scene.duration_s, 4 * STEPS)
        return [driver.pose(start, float(time)) for time in times]
    poses = [start]
    for index, motion in enumerate(driver.motions):
        most = ACTION_REACH_M if motion.kind == "translate" else ACTION_REACH_RAD
        reach = min(motion.residual_rate * scene.duration_s, most)
        for side in (-reach, reach):
            offsets = np.zeros(len(driver.motions))
            offsets[index] = side
            poses.append(driver.pose(start, 0.0, offsets))
    return poses


def _carried(body: RigidBody, carrier: RigidBody, poses: list[Pose]) -> list[FloatArray]:
    """Return the way of a body that rests on a driven one: it is carried, and leaves its upper side by its own size."""
    local = carrier.pose.to_body(_corners(body))
    carried = [pose.to_world(local) for pose in poses]
    size = np.ptp(_corners(body), axis=0).max()
    shift = np.zeros(3)
    turned = max(_tilt(pose) for pose in poses)
    if turned > np.radians(5.0):
        # It slides down to the lower end of the tilted carrier.
        steepest = max(poses, key=_tilt)
        corners = steepest.to_world(carrier.shape.corners_m)
        shift = corners[corners[:, 2] <= corners[:, 2].min() + 0.02].mean(axis=0) - steepest.to_world(local).mean(
            axis=0
        )
        shift[2] += 0.5 * size
        carried.append(steepest.to_world(local) + shift)
    elif any((pose.rotation * poses[0].rotation.inv()).magnitude() > 0.2 for pose in poses):
        # A turning carrier throws it off sideways, in a direction that nobody knows.
        centre, radius = np.array(carrier.pose.position_m), 0.5 * np.ptp(carrier.shape.corners_m[:, 0])
        for angle in np.linspace(0.0, 2.0 * np.pi, 8, endpoint=False):
            away = radius * np.array([np.cos(angle), np.sin(angle), 0.0])
            carried.append(centre + away + (_corners(body) - _corners(body).mean(axis=0)) + [0.0, 0.0, 0.5 * size])
    return carried


def _tilt(pose: Pose) -> float:
    return float(np.arccos(np.clip(pose.rotation.as_matrix()[2, 2], -1.0, 1.0)))


def _swings(scene: Scene) -> dict[str, list[FloatArray]]:
    """Return the way of each body on a hinge or string to the world: as high on the other side; none if all hang still.

    A body that hangs at rest is expected to swing as far as the one that may strike it.
    """
    arms: dict[str, tuple[Hinge | Tether, FloatArray, float]] = {}
    for joint in scene.joints:
        arm = np.subtract(scene.body(joint.body).pose.position_m, joint.anchor_m)
        axis = np.array(joint.axis) if isinstance(joint, Hinge) else np.cross(arm, (0.0, 0.0, -1.0))
        length = float(np.linalg.norm(axis))
        axis = axis / length if length > 1e-6 else np.zeros(3)
        down = np.array([0.0, 0.0, -1.0]) - axis * -axis[2]
        flat = arm - axis * (axis @ arm)
        angle = float(np.arctan2(axis @ np.cross(down, flat), down @ flat))
        arms[joint.body] = joint, axis, angle
    leader = max(arms.values(), key=lambda one: abs(one[2]), default=None)
    if leader is None or abs(leader[2]) < STILL_RAD:
        return {}
    ways = {}
    for name, (joint, axis, angle) in arms.items():
        around = axis if axis.any() else leader[1]
        largest = abs(leader[2])
        corners = _corners(scene.body(name)) - joint.anchor_m
        turns = np.linspace(-largest, largest, 2 * STEPS) - angle
        ways[name] = [joint.anchor_m + Rotation.from_rotvec(turn * around).apply(corners) for turn in turns]
    return ways


def _flight(scene: Scene, body: RigidBody, start: FloatArray) -> list[FloatArray]:
    """Return the way of a body that nothing holds, until the floor; there it may tumble by its own size."""
    velocity, gravity = np.array(body.linear_velocity_m_per_s), scene.gravity_m_per_s2
    drop = max(float(start[:, 2].min()) - scene.floor_height_m, 0.0)
    lasts = (velocity[2] + np.sqrt(velocity[2] ** 2 + 2.0 * gravity * drop)) / gravity
    lasts = min(lasts, scene.duration_s, FLIGHT_LIMIT_S)
    times = np.linspace(0.0, lasts, STEPS)
    fallen = [velocity * time - [0.0, 0.0, 0.5 * gravity * time**2] for time in times]
    return [np.concatenate([start, _around(start)]) + shift for shift in fallen]


def _around(corners: FloatArray) -> FloatArray:
    """Return the ends of the ball around a body: a body that tumbles may turn a corner anywhere [m], shape [4, 3]."""
    centre = corners.mean(axis=0)
    radius = float(np.linalg.norm(corners - centre, axis=1).max())
    return centre + radius * np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0]])


def _toppled(scene: Scene, start: FloatArray, swing: Mapping[str, list[FloatArray]]) -> FloatArray:
    """Return how far a body of a pile is thrown, away from the ball that swings into it: as far as the pile is high."""
    height = max(float(start[:, 2].min()) - scene.floor_height_m, 0.0)
    if not swing:
        return np.array([0.0, 0.0, -height])
    way = max(swing.values(), key=lambda one: float(np.ptp(np.array(one)[:, :, 2])))
    level = (way[-1] - way[0]).mean(axis=0) * [1.0, 1.0, 0.0]
    return np.asarray(1.5 * height * level / max(float(np.linalg.norm(level)), 1e-9) - [0.0, 0.0, height])


def _slide(body: RigidBody, below: RigidBody) -> FloatArray:
    """Return the displacement of a body from its place to the lower end of a leaning body below it [m], shape [3]."""
    corners = _corners(below)
    lowest = corners[corners[:, 2] <= corners[:, 2].min() + 0.25 * np.ptp(corners[:, 2])].mean(axis=0)
    top = below.pose.rotation.as_matrix()[:, int(np.argmin(np.ptp(below.shape.corners_m, axis=0)))]
    if abs(top[2]) > np.cos(np.radians(5.0)):
        return np.zeros(3)
    way = lowest - np.array(body.pose.position_m)
    return np.asarray(way - top * (way @ top))


def _supports(scene: Scene) -> dict[str, RigidBody]:
    """Return the body that each dynamic body rests on, by the boxes around both; none for a body that rests on none."""
    solid = [body for body in scene.bodies if not isinstance(body.shape, Plane)]
    corners = [_corners(body) for body in solid]
    lows = np.array([one.min(axis=0) for one in corners])
    highs = np.array([one.max(axis=0) for one in corners])
    found = {}
    for index, body in enumerate(solid):
        if body.motion is not Motion.DYNAMIC:
            continue
        near = (np.maximum(lows - highs[index], lows[index] - highs) <= RESTS_WITHIN_M).all(axis=1)
        near &= lows[:, 2] < lows[index, 2] - 1e-6
        best = RESTS_WITHIN_M
        for other in np.flatnonzero(near):
            # In the frame of the other body, so that a leaning board counts.
            local, box = solid[other].pose.to_body(corners[index]), solid[other].shape.corners_m
            gap = float(np.maximum(local.min(axis=0) - box.max(axis=0), box.min(axis=0) - local.max(axis=0)).max())
            if gap <= best:
                found[body.name], best = solid[other], gap
                if gap <= 1e-6:
                    break
    return found


# --- deformable bodies ---


def outline_m(body: Deformable) -> FloatArray:
    """Return the corners of a deformable body in its own frame [m], shape [8, 3]."""
    if isinstance(body, SoftBody):
        return body.shape.corners_m
    if isinstance(body, Cloth):
        return Box(size_m=(*body.size_m, 0.0)).corners_m
    return Box(size_m=(body.length_m, 0.0, 0.0) if isinstance(body, Rope) else (0.0, 0.0, body.length_m)).corners_m


def _deformable_way(scene: Scene, body: Deformable, carriers: Mapping[str, list[Pose]]) -> list[FloatArray]:
    """Return outlines that a deformable body is expected to have, each of shape [8, 3], from the start on.

    Args:
        scene: The scene.
        body: The body.
        carriers: Poses of each driven body over the episode.
    """
    start = body.pose.to_world(outline_m(body))
    held = [a for a in scene.attachments if a.deformable == body.name]
    moment = [start]
    sides = {(a.region.axis, a.region.side) for a in held}
    for attachment in held:
        if attachment.to in carriers:
            poses = carriers[attachment.to]
            along = outline_m(body)[:, "xyz".index(attachment.region.axis)]
            side = np.asarray(along < 0.0 if attachment.region.side == "low" else along > 0.0)
            moved = poses[0].to_body(start[side])
            for pose in poses:
                place = start.copy()
                place[side] = pose.to_world(moved)
                if len(sides) == 1:
                    place[~side] += pose.to_world(moved).mean(axis=0) - start[side].mean(axis=0)
                moment.append(place)
    if isinstance(body, Cloth):
        moment += _cloth_falls(scene, body, start, len(sides), moment[-1])
    if isinstance(body, SoftBody):
        moment += _drooped(scene, body, start)
    return moment


def _cloth_falls(scene: Scene, body: Cloth, start: FloatArray, held: int, last: FloatArray) -> list[FloatArray]:
    """Return outlines of a cloth that falls, swings on from a held edge, or sags between two."""
    size = max(body.size_m)
    if held == 0:
        lowered = min(0.5 * size, max(float(start[:, 2].min()) - scene.floor_height_m, 0.0))
        inner = start.mean(axis=0) + 0.75 * (start - start.mean(axis=0))
        return [inner - [0.0, 0.0, lowered]]
    if held == 1 and np.ptp(start[:, 2]) > 0.5 * size:
        moved = (last - start).mean(axis=0)
        way = float(np.linalg.norm(moved[:2]))
        if way < 1e-6:
            return []
        # The free edge swings on by about a third of the cloth.
        over = start + moved
        over[over[:, 2] < over[:, 2].mean()] += [*(0.35 * size * moved[:2] / way), 0.0]
        return [over]
    if held == 2:
        gap = last.reshape(-1, 3)
        chord = float(np.linalg.norm(np.ptp(gap[:, :2], axis=0)))
        full = float(np.linalg.norm(np.ptp(start[:, :2], axis=0)))
        # Arc and chord of a shallow curve: length = chord + 8 sag^2 / (3 chord).
        sag = np.sqrt(max(3.0 * chord * (full - chord) / 8.0, 0.0))
        return [last - [0.0, 0.0, float(sag)]]
    return []


def _drooped(scene: Scene, body: SoftBody, start: FloatArray) -> list[FloatArray]:
    """Return the outline of a block in a level bar that is held at one end alone: the bar sinks.

    The end of a bar of length L, mass m, stiffness E and second moment of area I sinks by m g L^3 / (8 E I) at rest and
    by twice as much when it is let go (Euler and Bernoulli). A soft one sinks by less: the bar keeps its length.
    """
    bar = next(row for row in bonded_soft_bodies(scene) if body in row)
    names = {one.name for one in bar}
    grips = [a for a in scene.attachments if a.deformable in names and a.to not in names]
    if len(grips) != 1:
        return []
    held = next(one for one in bar if one.name == grips[0].deformable)
    axis = "xyz".index(grips[0].region.axis)
    along = held.pose.rotation.as_matrix()[:, axis] * (1.0 if grips[0].region.side == "low" else -1.0)
    corners = np.concatenate([one.pose.to_world(outline_m(one)) for one in bar]) @ along
    length = float(np.ptp(corners))
    height = min(np.delete(np.array(held.shape.size_m), axis))
    width = max(np.delete(np.array(held.shape.size_m), axis))
    weight = scene.gravity_m_per_s2 * sum(one.mass_kg for one in bar)
    stiffness = min(one.young_modulus_pa for one in bar) * width * height**3 / 12.0
    share = np.hypot(*along[:2])
    sinks = float(share) * min(2.0 * weight * length**3 / (8.0 * stiffness), 0.6 * length)
    outline = start.copy()
    outline[:, 2] -= sinks * ((start @ along - corners.min()) / length) ** 2
    return [outline]


# --- what surrounds the action, and its plane ---


def _corners(body: RigidBody) -> FloatArray:
    return body.pose.to_world(body.shape.corners_m)


def _surroundings(scene: Scene, action: FloatArray, movers: frozenset[str]) -> FloatArray:
    """Return the corners of still bodies and the anchors of joints near the action, as far as they are near."""
    points = [np.array([joint.anchor_m for joint in scene.joints]).reshape(-1, 3)]
    low, high = action.min(axis=0), action.max(axis=0)
    size = float(np.linalg.norm(high - low))
    whole, part = (share * size for share in SURROUNDINGS)
    for body in scene.bodies:
        if body.name in movers or isinstance(body.shape, Plane):
            continue
        corners = _corners(body)
        if (corners.min(axis=0) > high + part).any() or (corners.max(axis=0) < low - part).any():
            continue
        is_near = (corners > low - whole).all() and (corners < high + whole).all()
        points.append(corners if is_near else np.clip(corners, low - part, high + part))
    return np.concatenate(points)


def _across(ways: list[FloatArray], scene: Scene) -> FloatArray | None:
    """Return the level direction across the motion, shape [2]; None if nothing moves sideways.

    A hinge or string states it by its axis. Else it follows from the longest level way of a corner.
    """
    for joint in scene.joints:
        arm = np.subtract(scene.body(joint.body).pose.position_m, joint.anchor_m)
        axis = np.array(joint.axis) if isinstance(joint, Hinge) else np.cross(arm, (0.0, 0.0, -1.0))
        if np.hypot(*axis[:2]) > 1e-3:
            return np.asarray(axis[:2] / np.hypot(*axis[:2]))
    moved = [way - way[0] for way in ways if len(way) > 1]
    if not moved:
        return None
    steps = np.concatenate([one.mean(axis=1) for one in moved])
    level = steps[:, :2]
    longest, total = np.linalg.norm(level, axis=1).max(), np.linalg.norm(steps, axis=1).max()
    if longest < LEVEL_SHARE * total or longest < 1e-3:
        return None
    _, spread, directions = np.linalg.svd(level, full_matrices=False)
    # A round way, as of a turntable, has no plane.
    if spread[1] > 0.5 * spread[0]:
        return None
    along = directions[0]
    return np.array([-along[1], along[0]])
