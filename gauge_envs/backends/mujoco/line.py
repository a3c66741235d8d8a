"""Ropes and rods in MuJoCo: chains of point bodies; a rod resists stretch and bending.

Both are one-dimensional flexes without twist. If a flex has a Young's modulus, MuJoCo gives it the bending stiffness
E I of a circular section. A rod has the Young's modulus of the scene; a rope has none, and is inextensible.

A soft constraint on the distance of neighbours gives a rod its stretch stiffness E A. It is implicit, so that no wave
along the rod limits the time step; only the static stretch is that of the rod.
"""

import math
from collections.abc import Callable, Mapping, Sequence

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from gauge_envs.backends.mujoco.flex import (
    DAMPING_S,
    STIFF_SOLIMP,
    FlexPart,
    Points,
    make_firm,
)
from gauge_envs.backends.mujoco.settings import ROPE_CELL_M
from gauge_envs.backends.shared.attachments import (
    RigidAttachment,
    attached_ends,
    places_on_line,
    points_on_axis,
)
from gauge_envs.scene import Rod, Rope
from gauge_envs.scene.geometry import FloatArray, length_of

ROD_SEGMENTS = 15
"""Default number of segments of a rod; a clamped rod with a load at its end then deflects within 0.2 % of theory."""

EDGE_SOLREF = (5e-4, 1.0)
EDGE_SOLIMP = (0.9999, 0.9999, 1e-4, 0.5, 2.0)
"""Constants of the distance constraints of a rope. MuJoCo raises a time constant below two time steps to these."""

CONTACT_SOLREF = (2e-3, 1.0)
"""Time constant [s] and damping ratio of contacts."""


class LinePartMuJoCo(FlexPart):
    """A rope or a rod of a MuJoCo model; its nodes lie along the centre line.

    Attributes:
        geoms: Spheres along a rod that collide instead of its flex; empty for a rope.
    """

    def __init__(
        self,
        flex: mujoco.MjsFlex,
        rest_m: FloatArray,
        points: Points,
        geoms: Sequence[mujoco.MjsGeom] = (),
    ) -> None:
        super().__init__(flex, rest_m, points)
        self.geoms = list(geoms)

    def track(self, points_m: ArrayLike) -> Callable[[], FloatArray]:
        """Return a reader of material points in or on the line; each moves with its cross-section, without twist."""
        segment, share, offsets_m = places_on_line(self.name, self.rest_m, points_m)
        span_m = self.rest_m[-1] - self.rest_m[0]
        axis = span_m / length_of(span_m)

        def between(values: FloatArray) -> FloatArray:
            """Return the values of nodes at the points."""
            return (1 - share) * values[segment] + share * values[segment + 1]

        def read() -> FloatArray:
            nodes_m = self.nodes()
            centres_m = between(nodes_m)
            tangents = between(np.gradient(nodes_m, axis=0))
            tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
            # Rodrigues' formula: with n = a x t and c = a.t, the shortest rotation from the axis a to the tangent t
            # takes r to c r + n x r + (n.r) n / (1 + c).
            normals = np.cross(axis, tangents)
            cosine = tangents @ axis
            along = np.sum(normals * offsets_m, axis=1) / (1.0 + cosine)
            return (
                centres_m
                + cosine[:, None] * offsets_m
                + np.cross(normals, offsets_m)
                + along[:, None] * normals
            )

        return read


def add_rope(
    spec: mujoco.MjSpec,
    rope: Rope,
    *,
    attachments: Sequence[RigidAttachment],
    cell_m: float | None,
) -> LinePartMuJoCo:
    """Add a rope without contacts.

    Args:
        spec: Editable model that contains the rigid bodies.
        rope: The rope. Its Young's modulus is unused, because a rope is inextensible.
        attachments: Attachments of its ends; moving bodies need a free joint.
        cell_m: Desired distance between neighbouring nodes [m]; None gives `ROPE_CELL_M`.
    """
    ends = attached_ends(rope, attachments)
    count = max(2, round(rope.length_m / (cell_m or ROPE_CELL_M)))
    rest_m = points_on_axis(rope, np.linspace(-0.5, 0.5, count + 1) * rope.length_m)
    flex = _add_flex(spec, rope, rest_m, rope.mass_kg)
    node_of = {"low": 0, "high": count}
    attached = {node_of[side]: attachment for side, attachment in ends.items()}
    return LinePartMuJoCo(flex, rest_m, _attach_nodes(spec, flex, rest_m, attached))


def add_rod(
    spec: mujoco.MjSpec,
    rod: Rod,
    *,
    attachments: Sequence[RigidAttachment],
    cell_m: float | None,
) -> LinePartMuJoCo:
    """Add a rod without contacts. Attached ends keep their position and direction.

    The rod bends at its nodes, and each node represents half a segment on either side. The two nodes of a clamped end
    therefore lie half a segment before and after the point where the rod leaves the grip.

    Args:
        spec: Editable model that contains the rigid bodies.
        rod: The rod. Its Poisson ratio is unused, because it only affects twist.
        attachments: Attachments of its ends; moving bodies need a free joint.
        cell_m: Desired length of the segments [m]; None gives `ROD_SEGMENTS` segments.
    """
    ends = attached_ends(rod, attachments)
    depths_m = {side: end.region.depth_m for side, end in ends.items()}
    low = depths_m.get("low", 0.0) - 0.5 * rod.length_m
    high = 0.5 * rod.length_m - depths_m.get("high", 0.0)
    count = ROD_SEGMENTS
    if cell_m is not None:
        count = max(4, round((high - low) / cell_m + 0.5 * len(ends)))
    segment = (high - low) / (count - 0.5 * len(ends))
    start = low
    if "low" in ends:
        start -= 0.5 * segment
    rest_m = points_on_axis(rod, start + segment * np.arange(count + 1))
    flex = _add_flex(spec, rod, rest_m, rod.mass_kg * segment * count / rod.length_m)
    flex.young, flex.damping = rod.young_modulus_pa, DAMPING_S
    stretch_s = _stretch_time_constant_s(rod, segment, count=count, clamps=len(ends))
    if spec.option.integrator == getattr(mujoco.mjtIntegrator, "mjINT_DISCRETE", None):
        # It takes positions at the end of the step, which lengthens the time constant by one step.
        stretch_s -= spec.option.timestep
    # A stiffer rod stretches too much at this step: MuJoCo has no shorter time constant.
    stretch_s = max(stretch_s, 2.0 * spec.option.timestep)
    _distances(spec, rod).solref = [stretch_s, 1.0]
    clamped = {"low": (0, 1), "high": (count - 1, count)}
    attached: dict[int, RigidAttachment] = {}
    for side, attachment in ends.items():
        attached |= dict.fromkeys(clamped[side], attachment)
    points = _attach_nodes(spec, flex, rest_m, attached)
    geoms = []
    for index, name in enumerate(flex.vertbody):
        if index in attached:
            continue
        # At a free end the sphere stays within the rod; contact forces still act on the node, at the full length.
        inward = {0: rod.radius_m, count: -rod.radius_m}.get(index, 0.0)
        geom = spec.body(name).add_geom(
            type=mujoco.mjtGeom.mjGEOM_SPHERE,
            name=f"{rod.name}/{index}",
            size=[rod.radius_m, 0.0, 0.0],
            pos=rod.pose.rotation.apply([0.0, 0.0, inward]).tolist(),
            mass=0.0,
            contype=0,
            conaffinity=0,
            solref=list(CONTACT_SOLREF),
            solimp=list(STIFF_SOLIMP),
        )
        geoms.append(geom)
    return LinePartMuJoCo(flex, rest_m, points, geoms)


def _stretch_time_constant_s(
    rod: Rod, segment_m: float, *, count: int, clamps: int
) -> float:
    """Return the time constant that gives the distances of a rod the stretch stiffness E A [s].

    A static force f stretches a soft constraint by x = f R / k, with R = (1 - d) A / d and k = 1 / (d T^2). T is the
    time constant and d a constant impedance (MuJoCo, "Computation", solver parameters). MuJoCo estimates A as the mean
    inverse mass of the two nodes: 1 / m along the rod, and 1.5 / m at a free end, whose node has half the mass. So
    E A_section / l = k / R gives T, with the mean of A over the rod. Half a segment at a clamp cannot stretch, and the
    other segments stretch more by that amount.

    Args:
        rod: The rod.
        segment_m: Distance l of neighbouring nodes [m].
        count: Number of segments, including segments whose two nodes are clamped.
        clamps: Number of clamped ends.
    """
    node_kg = rod.mass_kg * segment_m / rod.length_m
    yielding = count - clamps
    free_ends = 2 - clamps
    inverse_mass = (1.0 + 0.5 * free_ends / yielding) / node_kg
    impedance = EDGE_SOLIMP[0]
    regularization = (1.0 - impedance) / impedance * inverse_mass
    section_m2 = math.pi * rod.radius_m**2
    stiffness_n_per_m = rod.young_modulus_pa * section_m2 / segment_m
    stiffness_n_per_m *= yielding / (count - 0.5 * clamps)
    return 1.0 / math.sqrt(impedance * stiffness_n_per_m * regularization)


def _distances(spec: mujoco.MjSpec, line: Rope | Rod) -> mujoco.MjsEquality:
    """Return the constraint on the distances of a line's neighbouring nodes."""
    return next(
        constraint for constraint in spec.equalities if constraint.name1 == line.name
    )


def _add_flex(
    spec: mujoco.MjSpec, line: Rope | Rod, rest_m: FloatArray, mass_kg: float
) -> mujoco.MjsFlex:
    """Add a chain of point bodies with slide joints along the world axes; the end bodies have half the mass."""
    count = len(rest_m) - 1
    flex = spec.worldbody.make_flex(
        line.name,
        type="grid",
        dim=1,
        count=[count + 1, 1, 1],
        spacing=[length_of(rest_m[1] - rest_m[0]), 1.0, 1.0],
        # Only this function of MuJoCo requires a node spacing above the thickness; the true radius follows below.
        radius=1e-5,
        equality=1,
    )
    flex.radius = line.radius_m
    masses_kg = np.full(len(rest_m), mass_kg / count)
    masses_kg[[0, -1]] *= 0.5
    for name, place, mass in zip(flex.vertbody, rest_m, masses_kg, strict=True):
        body = spec.body(name)
        body.pos = place
        body.explicitinertial = True
        body.ipos = [0.0, 0.0, 0.0]
        body.mass = mass
    make_firm(flex, CONTACT_SOLREF)
    edges = _distances(spec, line)
    edges.solref, edges.solimp = list(EDGE_SOLREF), list(EDGE_SOLIMP)
    return flex


def _attach_nodes(
    spec: mujoco.MjSpec,
    flex: mujoco.MjsFlex,
    rest_m: FloatArray,
    attached: Mapping[int, RigidAttachment],
) -> Points:
    """Replace the bodies of attached nodes by points of their rigid bodies."""
    points = Points(list(flex.vertbody), rest_m, attached)
    flex.vertbody, flex.vert = points.carriers()
    # A line needs no `nodebody`, which refers to the bodies of attached nodes.
    flex.nodebody = []
    points.delete_attached(spec)
    return points
