"""Ropes and rods in MuJoCo: a chain of point bodies whose distances constraints keep; a rod also resists bending.

Both are one-dimensional flexes, inextensible and without twist. MuJoCo gives them the bending stiffness E I of a
circular section if the flex has a Young's modulus: a rod's is its own, a rope has none.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from gauge_envs.backends.mujoco.flex import FlexPart, Points, attached_points
from gauge_envs.backends.shared.attachments import RigidAttachment
from gauge_envs.backends.shared.lines import attached_ends, points_on_axis
from gauge_envs.errors import ShapeError
from gauge_envs.scene import Rod, Rope

__all__ = [
    "LinePartMuJoCo",
    "add_rod",
    "add_rope",
]

ROPE_SEGMENT_M = 0.01
"""Longest distance between neighbouring nodes of a rope."""

ROD_SEGMENTS = 15
"""Segments of a rod: a clamped one bends under a load at its end as theory says within 0.2 %."""

EDGE_SOLREF = (5e-4, 1.0)
EDGE_SOLIMP = (0.9999, 0.9999, 1e-4, 0.5, 2.0)
"""Constraints that keep the distances. MuJoCo raises the time constant to two steps where these are longer."""

CONTACT_SOLREF = (2e-3, 1.0)
CONTACT_SOLIMP = (0.9999, 0.9999, 0.001, 0.5, 2.0)
"""Contacts. MuJoCo softens contacts in proportion to the lightness of what touches: with its default
impedance two balls of 0.3 kg pull a rope of 5 g right through the beam that it hangs on."""


class LinePartMuJoCo(FlexPart):
    """A rope or a rod of a MuJoCo model.

    Attributes:
        name: Name of the body, and of the flex.
        flex: The flex in the editable model: what of a rope collides. A rod's collides with nothing.
        geoms: Spheres along a rod, which collide instead of its flex; they collide with nothing yet. None for a rope.
        rest_m: World positions of the nodes along the centre line at the start [m], shape [node_count, 3].
    """

    def __init__(
        self,
        flex: mujoco.MjsFlex,
        rest_m: NDArray[np.float64],
        geoms: Sequence[mujoco.MjsGeom],
        points: Points,
    ) -> None:
        self.name = flex.name
        self.flex = flex
        self.rest_m = rest_m
        self.geoms = list(geoms)
        self.points = points

    def complete(self, model: mujoco.MjModel) -> None:
        """Nothing: the editable model expresses all of a line."""

    def nodes(self) -> NDArray[np.float64]:
        """World positions of the nodes now [m], shape [node_count, 3]."""
        return self.points.positions()

    def track(self, points_m: ArrayLike) -> Callable[[], NDArray[np.float64]]:
        """Reader of points in or on the line, which keep their place along it and turn with it, without twist.

        Args:
            points_m: World positions at the start [m], shape [point_count, 3].

        Returns:
            Function without arguments that returns where the points are now [m], shape [point_count, 3].

        Raises:
            ShapeError: A point lies beyond an end.
        """
        span = self.rest_m[-1] - self.rest_m[0]
        length, count = float(np.linalg.norm(span)), len(self.rest_m) - 1
        axis = span / length
        places = (np.asarray(points_m, dtype=np.float64) - self.rest_m[0]) @ axis / length * count
        if not np.all((places > -1e-3) & (places < count + 1e-3)):
            raise ShapeError(f"a point lies beyond an end of {self.name!r}")
        segment = np.clip(np.floor(places).astype(int), 0, count - 1)
        share = (places - segment)[:, None]
        offsets = points_m - (self.rest_m[0] + (places * length / count)[:, None] * axis)

        def read() -> NDArray[np.float64]:
            nodes = self.nodes()
            slopes = np.gradient(nodes, axis=0)
            tangents = (1 - share) * slopes[segment] + share * slopes[segment + 1]
            tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
            centres = (1 - share) * nodes[segment] + share * nodes[segment + 1]
            # Shortest turn from the axis to the tangent (Rodrigues' formula with the cross product as axis).
            turn = np.cross(axis, tangents)
            cosine = tangents @ axis
            along = np.sum(turn * offsets, axis=1) / (1.0 + cosine)
            return centres + cosine[:, None] * offsets + np.cross(turn, offsets) + along[:, None] * turn

        return read


def add_rope(spec: mujoco.MjSpec, rope: Rope, *, glued: Sequence[RigidAttachment]) -> LinePartMuJoCo:
    """Add a rope that collides with nothing yet.

    Args:
        spec: Editable model; it has the rigid bodies already.
        rope: The rope. Its Young's modulus is not used: a rope is inextensible.
        glued: What its ends are glued to; bodies that move must have a free joint.

    Raises:
        UnsupportedSceneError: Something else than its very end is glued.
    """
    ends = attached_ends(rope, glued)
    count = max(2, round(rope.length_m / ROPE_SEGMENT_M))
    rest_m = points_on_axis(rope, np.linspace(-0.5, 0.5, count + 1) * rope.length_m)
    flex = _add_flex(spec, rope, rest_m, rope.mass_kg)
    held = {0 if side == "low" else count: glue for side, glue in ends.items()}
    return LinePartMuJoCo(flex, rest_m, [], _hold(spec, flex, rest_m, held))


def add_rod(
    spec: mujoco.MjSpec, rod: Rod, *, glued: Sequence[RigidAttachment], damping_s: float = 1e-4
) -> LinePartMuJoCo:
    """Add a rod that collides with nothing yet. Glued ends keep their place and direction.

    Bending happens at nodes, each of which stands for half a segment on either side. So the two nodes that hold a
    clamped end lie half a segment before and after the place where the rod leaves the grip.

    Args:
        spec: Editable model; it has the rigid bodies already.
        rod: The rod. Its Poisson ratio is not used: it matters in twist only.
        glued: What its ends are glued to; bodies that move must have a free joint.
        damping_s: Viscous part of the bending moment, as the time by which it multiplies the rate of curvature.

    Raises:
        UnsupportedSceneError: Something else than an end is glued.
    """
    ends = attached_ends(rod, glued)
    low, high = -0.5 * rod.length_m, 0.5 * rod.length_m
    low += ends["low"].region.depth_m if "low" in ends else 0.0
    high -= ends["high"].region.depth_m if "high" in ends else 0.0
    segment = (high - low) / (ROD_SEGMENTS - 0.5 * len(ends))
    start = low - 0.5 * segment if "low" in ends else low
    rest_m = points_on_axis(rod, start + segment * np.arange(ROD_SEGMENTS + 1))
    flex = _add_flex(spec, rod, rest_m, rod.mass_kg * segment * ROD_SEGMENTS / rod.length_m)
    flex.young, flex.damping = rod.young_modulus_pa, damping_s
    held: dict[int, RigidAttachment] = {}
    for side, glue in ends.items():
        held |= dict.fromkeys([0, 1] if side == "low" else [ROD_SEGMENTS - 1, ROD_SEGMENTS], glue)
    points = _hold(spec, flex, rest_m, held)
    geoms = []
    for index, name in enumerate(flex.vertbody):
        if index in held:
            continue
        # At a free end the sphere ends where the rod does; contact forces still act on the node, at the full length.
        inward = {0: rod.radius_m, ROD_SEGMENTS: -rod.radius_m}.get(index, 0.0)
        geom = spec.body(name).add_geom(
            type=mujoco.mjtGeom.mjGEOM_SPHERE,
            name=f"{rod.name}/{index}",
            size=[rod.radius_m, 0.0, 0.0],
            pos=rod.pose.rotation.apply([0.0, 0.0, inward]).tolist(),
            mass=0.0,
            contype=0,
            conaffinity=0,
            solref=list(CONTACT_SOLREF),
            solimp=list(CONTACT_SOLIMP),
        )
        geoms.append(geom)
    return LinePartMuJoCo(flex, rest_m, geoms, points)


def _add_flex(spec: mujoco.MjSpec, line: Rope | Rod, rest_m: NDArray[np.float64], mass_kg: float) -> mujoco.MjsFlex:
    """Chain of point bodies at these places, with joints along the world axes; the first and last are half as heavy."""
    count = len(rest_m) - 1
    flex = spec.worldbody.make_flex(
        line.name,
        type="grid",
        dim=1,
        count=[count + 1, 1, 1],
        spacing=[float(np.linalg.norm(rest_m[1] - rest_m[0])), 1.0, 1.0],
        # Here, and only here, MuJoCo wants neighbouring nodes further apart than the line is thick.
        radius=1e-5,
        equality=1,
    )
    flex.radius = line.radius_m
    for index, (name, place) in enumerate(zip(flex.vertbody, rest_m, strict=True)):
        body = spec.body(name)
        body.pos = place
        body.explicitinertial = True
        body.ipos = [0.0, 0.0, 0.0]
        body.mass = mass_kg / count * (0.5 if index in (0, count) else 1.0)
    flex.contype, flex.conaffinity = 0, 0
    flex.selfcollide = mujoco.mjtFlexSelf.mjFLEXSELF_NONE
    # Priority: MuJoCo would average these with the other geom's, which is far too soft.
    flex.priority = 1
    flex.solref, flex.solimp = list(CONTACT_SOLREF), list(CONTACT_SOLIMP)
    edges = next(equality for equality in spec.equalities if equality.name1 == line.name)
    edges.solref, edges.solimp = list(EDGE_SOLREF), list(EDGE_SOLIMP)
    return flex


def _hold(
    spec: mujoco.MjSpec, flex: mujoco.MjsFlex, rest_m: NDArray[np.float64], held: Mapping[int, RigidAttachment]
) -> Points:
    """Make nodes points of the bodies that they are glued to, instead of bodies of their own."""
    names = list(flex.vertbody)
    flex.vertbody, places = attached_points(names, rest_m, held)
    flex.vert = places.ravel()
    # Only now: deleting a body that a flex uses deletes the flex. Its list of nodes has no use without cells.
    flex.nodebody = []
    for index in held:
        spec.delete(spec.body(names[index]))
    return Points(names, rest_m, held)
