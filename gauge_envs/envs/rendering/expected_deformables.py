"""Where deformable bodies are expected to go, before a run; see `expected`."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from gauge_envs.backends.shared.attachments import bonded_soft_bodies
from gauge_envs.scene import Box, Cloth, Deformable, Pose, Rope, Scene, SoftBody

FloatArray = NDArray[np.float64]


def outline_m(body: Deformable) -> FloatArray:
    """Return the corners of a deformable body in its own frame [m], shape [8, 3]."""
    if isinstance(body, SoftBody):
        return body.shape.corners_m
    if isinstance(body, Cloth):
        return Box(size_m=(*body.size_m, 0.0)).corners_m
    return Box(size_m=(body.length_m, 0.0, 0.0) if isinstance(body, Rope) else (0.0, 0.0, body.length_m)).corners_m


def deformable_way(scene: Scene, body: Deformable, carriers: Mapping[str, list[Pose]]) -> list[FloatArray]:
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
            side = _side(body, attachment.region.axis, attachment.region.side)
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


def _side(body: Deformable, axis: str, side: str) -> NDArray[np.bool_]:
    along = outline_m(body)[:, "xyz".index(axis)]
    return np.asarray(along < 0.0 if side == "low" else along > 0.0)


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
