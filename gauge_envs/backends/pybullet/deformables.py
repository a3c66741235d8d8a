"""Ropes and soft bodies in PyBullet.

A rope is a chain of rigid segments on spherical joints, by Featherstone's algorithm. The joints are exact, so a
rope cannot stretch. A dynamic body to which an end is attached is part of the chain, which is one multibody in reduced
coordinates. A soft body consists of linear tetrahedra with Bullet's Neo-Hookean energy, in its deformable world.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs.backends.pybullet.settings import SEGMENT_LIMIT, SOFT_CELL_M
from gauge_envs.backends.pybullet.world import (
    BASE,
    NO_ROTATION,
    Link,
    World,
    pybullet,
    silent,
)
from gauge_envs.backends.shared.attachments import (
    attached_ends,
    places_on_line,
    points_on_axis,
    rigid_attachments,
)
from gauge_envs.backends.shared.cells import grid_points
from gauge_envs.backends.shared.soft_rows import lame_constants
from gauge_envs.backends.simulation import MaterialPoints
from gauge_envs.scene import Cylinder, Motion, Region, Rope, SoftBody
from gauge_envs.scene.geometry import FloatArray, length_of
from gauge_envs.scene.meshes import mass_properties, nodes_in, tetrahedra

SEGMENT_M = 0.0125
"""Default length of a segment [m]."""

SOFT_MARGIN_M = 0.001
"""Distance at which soft bodies touch [m]: with 0.2 mm, a cube passes through the foam."""

GROUND = -1
"""Number of the world as the body of an anchor."""

Read = Callable[[int, int], tuple[Any, ...]]
"""Function of a body and a link that returns their position [units] and quaternion x y z w first."""


@dataclass(frozen=True)
class RopePart:
    """The segments of a rope in PyBullet.

    Attributes:
        name: Name of the rope.
        body: PyBullet's number of the chain.
        links: Links of the segments, from the low to the high end.
        half: Half the length of a segment [units], from its centre to its high end along z. It is negative if z points
            to the low end.
        rest_m: Nodes at the start, from the low to the high end [m], shape [segment_count + 1, 3].
    """

    name: str
    body: int
    links: tuple[int, ...]
    half: float
    rest_m: FloatArray

    def nodes_m(self, read: Read, scale: float) -> FloatArray:
        """Return the nodes, the ends of the segments [m], shape [segment_count + 1, 3]."""
        centres, rotations = self._segments(read)
        arms = rotations.apply([0.0, 0.0, self.half])
        return np.concatenate([centres[:1] - arms[:1], centres + arms]) / scale

    def track(self, points_m: FloatArray, read: Read, scale: float) -> MaterialPoints:
        """Return a reader of material points, each of which moves with its segment."""
        rows, _, _ = places_on_line(self.name, self.rest_m, points_m)
        centres_m = 0.5 * (self.rest_m[rows] + self.rest_m[rows + 1])
        # All segments have the same rotation at the start, along which z points.
        rotation = _along(np.sign(self.half) * (self.rest_m[-1] - self.rest_m[0]))
        offsets_m = rotation.apply(points_m - centres_m, inverse=True)

        def points() -> FloatArray:
            centres, rotations = self._segments(read)
            return (centres[rows] / scale + rotations[rows].apply(offsets_m))[None]

        return points

    def _segments(self, read: Read) -> tuple[FloatArray, Rotation]:
        """Return the centres [units], shape [segment_count, 3], and the rotations of the segments."""
        states = [read(self.body, link) for link in self.links]
        rotations = Rotation.from_quat([state[1] for state in states])
        return np.array([state[0] for state in states]), rotations


def _along(direction: FloatArray) -> Rotation:
    """Return the rotation of the segments of a straight rope, which turns z to a direction."""
    return Rotation.align_vectors([direction / length_of(direction)], [[0, 0, 1]])[0]


def add_rope(world: World, rope: Rope, cell_m: float | None) -> RopePart:
    """Add a rope and the dynamic bodies on its ends, and enter these bodies in `world.handles`.

    The chain starts at a fixed body if the rope has one. A segment has the transverse moment of
    inertia of its cylinder about all axes. Spin about its own axis has no effect on a limp rope, and the small
    inertia about it would make the chain less stable.

    Args:
        world: The world.
        rope: The rope.
        cell_m: Desired length of a segment [m], or None for the default.
    """
    attached = attached_ends(rope, rigid_attachments(world.scene, rope.name))
    ends = {
        side: world.scene.body(attachment.body) for side, attachment in attached.items()
    }
    root, tip = ends.get("low"), ends.get("high")
    is_reversed = tip is not None and (root is None or tip.motion is Motion.FIXED)
    count = max(2, min(SEGMENT_LIMIT, round(rope.length_m / (cell_m or SEGMENT_M))))
    nodes_m = points_on_axis(rope, np.linspace(-0.5, 0.5, count + 1) * rope.length_m)
    start_m, end_m = nodes_m[0], nodes_m[-1]
    if is_reversed:
        root, tip = tip, root
        start_m, end_m = end_m, start_m
    rotation = _along(end_m - start_m)
    length_m = rope.length_m / count
    mass_kg = rope.mass_kg / count
    segment = Cylinder(radius_m=rope.radius_m, length_m=length_m)
    across_kg_m2 = float(mass_properties(segment, mass_kg)[1][0, 0])
    moments = [world.scale**2 * across_kg_m2] * 3
    # In units along z of a segment whose joint is at its start.
    length = np.array([0.0, 0.0, world.scale * length_m])
    centre = 0.5 * length

    place = np.zeros(3), NO_ROTATION
    first = 0
    if root is None:
        # The first segment is the base.
        middle_m = start_m + 0.5 / count * (end_m - start_m)
        base = world.base(middle_m, rotation, mass_kg)
        base_moments = moments
        place = centre, NO_ROTATION
        first = BASE
    elif root.motion is Motion.DYNAMIC:
        frame = world.frames[root.name]
        base = world.base_of(root)
        base_moments = frame.moments
        to_base = (root.pose.rotation * frame.axes).inv()
        arm_m = to_base.apply(start_m - root.pose.to_world(frame.centre_m))
        place = world.scale * arm_m, to_base * rotation
    else:
        base = world.base(start_m, rotation)
        base_moments = []
    segments = range(first, first + count)
    links = []
    ball = pybullet.JOINT_SPHERICAL
    for _ in range(segments.stop):
        link = Link(
            joint=ball, place=place, mass_kg=mass_kg, moments=moments, centre=centre
        )
        links.append(link)
        place = length, NO_ROTATION
    if tip is not None:
        links.append(world.link(tip, ball, end_m, place[0], rotation))
    body = world.add_multibody(base, base_moments, links)

    if root is not None and root.motion is Motion.DYNAMIC:
        world.add_handle(root.name, body, BASE)
    if tip is not None:
        world.add_handle(tip.name, body, len(links) - 1)
    half = float(centre[2])
    if is_reversed:
        segments, half = segments[::-1], -half
    return RopePart(rope.name, body, tuple(segments), half, nodes_m)


# --- soft bodies ------------------------------------------------------------------------------------------------------


def add_soft_body(
    world: World, body: SoftBody, cell_m: float | None, friction: float | None
) -> int:
    """Add a soft body, attach its regions, and return PyBullet's number; rigid bodies exist already.

    Bullet's energy is stable Neo-Hookean. At small strain it equals linear elasticity for mu' = 4/3 mu and
    lambda' = lambda + 5/6 mu.

    Args:
        world: The world.
        body: The soft body.
        cell_m: Desired edge of the cells [m], or None for the default.
        friction: Coefficient of its surface, by which Bullet multiplies that of a rigid body; None without contacts.
    """
    attachments = rigid_attachments(world.scene, body.name)
    regions = [attachment.region for attachment in attachments]
    file = world.folder / f"{body.name}.vtk"
    nodes_m = _write_mesh(file, body, regions, cell_m or SOFT_CELL_M, world.scale)
    shear_pa, lame_pa = lame_constants(body)
    contact: dict[str, float] = {}
    if friction is not None:
        contact = {
            "useFaceContact": 1,
            "frictionCoeff": friction,
            "collisionMargin": world.scale * SOFT_MARGIN_M,
        }
    # Bullet prints the size of the mesh.
    with silent():
        number = world.client.loadSoftBody(
            str(file),
            simFileName=str(file),
            basePosition=np.multiply(world.scale, body.pose.position_m).tolist(),
            baseOrientation=body.pose.rotation.as_quat().tolist(),
            mass=body.mass_kg,
            useNeoHookean=1,
            # A pressure is a force over an area: its number falls with the unit of length.
            NeoHookeanMu=4.0 / 3.0 * shear_pa / world.scale,
            NeoHookeanLambda=(lame_pa + 5.0 / 6.0 * shear_pa) / world.scale,
            NeoHookeanDamping=0.0,
            useSelfCollision=0,
            **contact,
        )
    for attachment in attachments:
        # An anchor keeps the current position of the node in the frame of the body.
        anchor_body = GROUND
        if attachment.motion is not Motion.FIXED:
            anchor_body, _ = world.handles[attachment.body][0]
        for node in nodes_in(nodes_m, attachment.region).tolist():
            world.client.createSoftBodyAnchor(number, node, anchor_body, BASE)
    return int(number)


def _places_m(
    edge_m: float, axis: str, regions: Sequence[Region], cell_m: float
) -> FloatArray:
    """Return the places of nodes along an edge [m], with a layer of cells for each attached region of some depth."""
    depths = {region.side: region.depth_m for region in regions if region.axis == axis}
    end_m = 0.5 * edge_m
    low_m = depths.get("low", 0.0) - end_m
    high_m = end_m - depths.get("high", 0.0)
    count = max(1, round((high_m - low_m) / cell_m))
    inner_m = np.linspace(low_m, high_m, count + 1)
    return np.unique([-end_m, *inner_m, end_m])


def _write_mesh(
    file: Path, body: SoftBody, regions: Sequence[Region], cell_m: float, scale: float
) -> FloatArray:
    """Write a VTK file with the tetrahedra of a soft body and return its nodes in the body frame [m].

    PyBullet takes tetrahedra in no other form.
    """
    x, y, z = (
        _places_m(edge_m, axis, regions, cell_m)
        for edge_m, axis in zip(body.shape.size_m, "xyz", strict=True)
    )
    nodes_m = grid_points(x, y, z)
    cells = tetrahedra((len(x), len(y), len(z)))
    points = [" ".join(map(repr, point)) for point in (scale * nodes_m).tolist()]
    corners = [f"4 {a} {b} {c} {d}" for a, b, c, d in cells.tolist()]
    # 10 is VTK's number of a tetrahedron.
    lines = [
        "# vtk DataFile Version 2.0",
        "soft body",
        "ASCII",
        "DATASET UNSTRUCTURED_GRID",
        f"POINTS {len(points)} double",
        *points,
        f"CELLS {len(corners)} {5 * len(corners)}",
        *corners,
        f"CELL_TYPES {len(corners)}",
        *["10"] * len(corners),
    ]
    file.write_text("\n".join(lines) + "\n")
    return nodes_m
