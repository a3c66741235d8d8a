"""Parts, scenes and measurements that the checks of cloth, foam, ropes and rods share.

Each scene has two or three bodies of a kind that differ in size, material and load, so that an engine that gives all of
them the constants of one fails.

The contract has no forces on nodes, so the load is the weight. Engines differ in damping: a body may oscillate about
its equilibrium or creep towards it. The mean under a Hann window over four periods or more is the equilibrium in both
cases. Each law is fitted with the place of the clamp as a free parameter, since the clamp of a mesh can be off by up
to one cell.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from gauge_envs.scene import (
    GRAVITY_M_PER_S2,
    Attachment,
    Cloth,
    Deformable,
    Motion,
    Pose,
    Region,
    Rope,
    Scene,
    SoftBody,
)
from gauge_envs.scene.drivers import Driver, DriverMotion
from gauge_envs.scene.fabrics import Fabric
from gauge_envs.scene.geometry import FloatArray, vector
from gauge_envs.scoring.estimators import hann_mean
from gauge_envs.tools.bench.parts import (
    box,
    contact,
    driven_box,
    driver,
    fixed_box,
    ramp,
    thrown,
)
from gauge_envs.tools.bench.recording import Recording
from gauge_envs.tools.conformance.lab import Lab, largest, largest_mm, ratio
from gauge_envs.tools.conformance.model import Measurement, Tolerance

PLACE_TOLERANCE_M = 1e-5
"""Distance within which a node is on a line; single precision rounds positions to about 0.1 um at 1 m."""

APART_M, LEVEL_M = 0.3, 1.0
"""Distance between the bodies of a scene, and their height."""

UP = (0.0, 0.0, 1.0)
LEVEL = Pose(position_m=(0.0, 0.0, LEVEL_M))

FRAME = fixed_box("frame", (0.0, 0.0, 3.0), (0.1, 0.1, 0.1))
"""Body to which clamped regions are attached. Its place does not matter, so it is out of reach."""

BYSTANDERS = tuple(
    fixed_box(f"bystander {number}", (2.0, 0.3 * number, 0.5), (0.02, 0.02, 0.02))
    for number in range(5)
)
"""Bodies that touch nothing. What hangs beside them hangs as without them."""


# --- bodies and scenes -----------------------------------------------------------------------------------------------

STRETCH_OVER_SHEAR = 2.7
"""K_s / K_sh of every sheet; an isotropic membrane can have any ratio between 2 and 4 (scene/fabrics.py)."""


def fabric(areal_density: float, stretch_n_per_m: float, bend_n_m: float) -> Fabric:
    """Return a fabric that every engine's membrane can represent; the shear stiffness follows from K_s.

    Args:
        areal_density: Mass per area [kg/m^2].
        stretch_n_per_m: Stretch stiffness K_s [N/m].
        bend_n_m: Bending stiffness K_theta [N m/rad].
    """
    return Fabric(
        stretch_stiffness_n_per_m=stretch_n_per_m,
        shear_stiffness_n_per_m=stretch_n_per_m / STRETCH_OVER_SHEAR,
        bend_stiffness_n_m_per_rad=bend_n_m,
        thickness_m=1e-3,
        areal_density_kg_per_m2=areal_density,
    )


def sheet(made_of: Fabric, pose: Pose, size_m: tuple[float, float]) -> Cloth:
    """Return a sheet of a fabric, warp along the x axis of its frame."""
    mass_kg = made_of.areal_density_kg_per_m2 * size_m[0] * size_m[1]
    return Cloth(
        name="cloth", pose=pose, size_m=size_m, mass_kg=mass_kg, **asdict(made_of)
    )


def extent_m(body: Deformable) -> FloatArray:
    """Return the size of the box of a body's nodes in its frame [m], shape [3]."""
    if isinstance(body, Cloth):
        return np.array([*body.size_m, 0.0])
    if isinstance(body, SoftBody):
        return np.array(body.shape.size_m)
    return body.length_m * np.eye(3)[0 if isinstance(body, Rope) else 2]


def placed(body: Deformable, place_m: ArrayLike, name: str = "") -> Deformable:
    """Return a body at another place [m], perhaps with another name."""
    pose = replace(body.pose, position_m=vector(np.asarray(place_m, float)))
    return replace(body, pose=pose, name=name or body.name)


def clamped(
    body: Deformable,
    *regions: Region,
    duration_s: float,
    gravity_m_per_s2: float = GRAVITY_M_PER_S2,
) -> Scene:
    """Return a scene of one deformable body, of which some regions are attached to a fixed body."""
    return Scene(
        bodies=(FRAME,),
        deformables=(body,),
        attachments=tuple(
            Attachment(deformable=body.name, region=region, to=FRAME.name)
            for region in regions
        ),
        duration_s=duration_s,
        gravity_m_per_s2=gravity_m_per_s2,
    )


RAMP_S, TURN_S, TURN_RAD = 0.5, 0.3, 0.6


def side_by_side(
    scenes: Mapping[str, Scene], speed_m_per_s: float = 0.0, late_s: float = 0.0
) -> Scene:
    """Return the bodies of several clamped scenes in one, with new names and among bystanders.

    Their frame stands still for the duration of the last scene. Then it reaches a speed, keeps it, and turns besides.
    On a frame with a constant velocity bodies hang as on one at rest (Galilei).

    Args:
        scenes: Scenes that `clamped` returns, by the new name of their body.
        speed_m_per_s: Upward speed that the frame reaches within `RAMP_S`; 0 for a fixed frame.
        late_s: Time for which it has this speed before it turns [s].
    """
    bodies, attachments = [], []
    for number, (name, scene) in enumerate(scenes.items()):
        (body,) = scene.deformables
        place_m = np.add(body.pose.position_m, (0.0, APART_M * (number - 1), 0.0))
        bodies.append(placed(body, place_m, name))
        attachments += [replace(one, deformable=name) for one in scene.attachments]
    still_s, moving_s = scene.duration_s, 3.0 * RAMP_S + late_s
    amount_m = speed_m_per_s * (moving_s - RAMP_S)
    rise = ramp(amount_m, start_s=still_s, duration_s=moving_s, ramp_s=RAMP_S)
    turn_s = still_s + RAMP_S + late_s
    turn = ramp(TURN_RAD, start_s=turn_s, duration_s=2.0 * TURN_S, ramp_s=0.15)
    motions = (
        DriverMotion(kind="translate", axis=UP, profiles=(rise,)),
        DriverMotion(kind="rotate", axis=UP, profiles=(turn,)),
    )
    moves = Driver(body=FRAME.name, motions=motions, provenance="nominal")
    motion = Motion.KINEMATIC if speed_m_per_s else Motion.FIXED
    return replace(
        scene,
        bodies=(*BYSTANDERS, replace(FRAME, motion=motion)),
        deformables=tuple(bodies),
        attachments=tuple(attachments),
        drivers=(moves,) if speed_m_per_s else (),
        duration_s=turn_s + TURN_S if speed_m_per_s else still_s,
    )


def node_masses_kg(body: Deformable, nodes_m: FloatArray) -> FloatArray:
    """Return the mass at each node of a uniform body, from its nodes at the start [m], shape [node_count]."""
    local_m, size_m = body.pose.to_body(nodes_m), extent_m(body)
    if isinstance(body, Cloth):
        # The area that is nearest to each node, for any mesh.
        x, y = ((np.arange(400) + 0.5) / 400 * edge - 0.5 * edge for edge in size_m[:2])
        points = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
        nearest = cKDTree(local_m[:, :2]).query(points)[1]
        shares = np.bincount(nearest, minlength=len(local_m)).astype(float)
    else:
        # A node on a face, an edge or a corner of a regular grid has a half, a quarter or an eighth of a cell.
        is_outside = np.abs(local_m) > 0.5 * size_m - PLACE_TOLERANCE_M
        shares = 0.5 ** is_outside[:, size_m > 0.0].sum(axis=1)
    return np.asarray(body.mass_kg * shares / shares.sum())


# --- fits ------------------------------------------------------------------------------------------------------------


def coefficient(values: FloatArray, *columns: FloatArray) -> float:
    """Return the coefficient of the first of the columns in a least-squares fit."""
    return float(np.linalg.lstsq(np.column_stack(columns), values, rcond=None)[0][0])


def stiffness(load: float, slope: float, expected: float) -> Measurement:
    """Measure a stiffness from a load and the fitted coefficient of the deformation, load / stiffness.

    Args:
        load: Load in the unit of the stiffness times that of the coefficient.
        slope: Coefficient of the deformation; when it is not positive, the stiffness is infinite.
        expected: Expected stiffness.
    """
    if not slope > 0.0:
        hint = "its weight does not deform it"
        return Measurement(measured=math.inf, expected=expected, hint=hint)
    return Measurement(measured=load / slope, expected=expected)


def cantilever_load_over_stiffness(
    s_m: FloatArray, droop_m: FloatArray, *, length_m: float, weights: FloatArray
) -> float:
    """Return the weight per length over the bending stiffness of a cantilever [1/m^3]: D w'' = load (L - s)^2 / 2.

    The fit also determines the place and the slope of the clamp.

    Args:
        s_m: Distances from the clamp [m], shape [node_count]; nodes in the clamp, at negative distances, are ignored.
        droop_m: Downward displacements [m], same shape.
        length_m: Free length L [m].
        weights: Share of the load at each node, same shape.
    """
    free = s_m > -PLACE_TOLERANCE_M
    s, scale = s_m[free], np.sqrt(weights[free])
    columns = np.column_stack([(length_m - s) ** 4 / 24.0, np.ones(len(s)), s])
    return coefficient(droop_m[free] * scale, columns * scale[:, None])


Law = Callable[[Recording, str, float, float], Measurement]
"""Measures a constant of a body, by its name, from its equilibrium between two times [s]."""


def equilibrium(
    rollout: Recording, name: str, start_s: float, end_s: float
) -> tuple[Any, float, FloatArray, FloatArray]:
    """Return a body, the depth of its clamp, and its nodes at the start and in equilibrium, in its frame [m].

    The displacement of `FRAME` is left out.
    """
    scene = rollout.scene
    (body,) = (one for one in scene.deformables if one.name == name)
    clamps = [one.region for one in scene.attachments if one.deformable == name]
    nodes_m = rollout.nodes_m[name] - rollout.displacement(FRAME.name)[:, None]
    settled_m = hann_mean(nodes_m[rollout.between(start_s, end_s)])
    rest_m, now_m = body.pose.to_body(nodes_m[0]), body.pose.to_body(settled_m)
    return body, clamps[0].depth_m, rest_m, now_m


def worst_law(
    rollout: Recording, law: Law, what: str, *windows_s: tuple[float, float]
) -> Measurement:
    """Measure the ratio of a constant to that of the scene that is furthest from 1, of all bodies and windows."""
    ratios = {}
    for body in rollout.scene.deformables:
        for start_s, end_s in windows_s:
            found = law(rollout, body.name, start_s, end_s)
            label = f"{body.name} from {start_s:g} s"
            ratios[label] = found.measured / found.expected
    return ratio(ratios, what)


# --- start and attachments -------------------------------------------------------------------------------------------

START: dict[str, Any] = {
    "law": "the nodes span size_m or length_m about the pose",
    "source": "contract (Simulation.nodes)",
    "unit": "mm",
    "tolerance": Tolerance("a float's rounding at 1 m is 0.1 um", absolute=0.01),
    "cause": "nodes() returns world positions in metres; size, pose and axis are those of the scene",
}
"""Texts of the checks of nodes at the start."""

START_PLACES = (
    ((-0.33, -0.71, 0.57), (20.0, -35.0, 50.0)),
    ((0.47, 0.13, 1.31), (-70.0, 25.0, 80.0)),
    ((-0.11, 0.83, -0.39), (130.0, 40.0, -20.0)),
)
"""Positions [m] and Euler angles [deg] of three bodies."""


def start_error(lab: Lab, bodies: Sequence[Deformable]) -> Measurement:
    """Measure the largest distance of the box of the nodes of a body at the start, in its frame, from its size [mm].

    The nodes of a rope or a rod must also be in order.
    """
    turned = []
    for number, body in enumerate(bodies):
        place_m, euler_deg = START_PLACES[number % 3]
        if isinstance(body, SoftBody):
            # Engines mesh boxes along the axes of the world.
            euler_deg = vector(90.0 * np.round(np.divide(euler_deg, 90.0)))
        turned.append(replace(body, pose=Pose.from_euler_deg(place_m, euler_deg)))
    scene = Scene(
        bodies=(FRAME, *BYSTANDERS), deformables=tuple(turned), duration_s=0.1
    )
    cases = {}
    with lab.running(scene) as simulation:
        for body in turned:
            local_m = body.pose.to_body(simulation.nodes(body.name)[0])
            low_m, high_m = local_m.min(axis=0), local_m.max(axis=0)
            half_m = 0.5 * extent_m(body)
            off_mm = 1e3 * float(np.abs([low_m + half_m, high_m - half_m]).max())
            size_mm = 1e3 * float(np.abs(high_m - low_m - 2.0 * half_m).max())
            mistakes = {"": off_mm, "size right, place or orientation wrong": size_mm}
            along_m = local_m @ half_m
            if np.count_nonzero(half_m) == 1 and (np.diff(along_m) <= 0.0).any():
                mistakes = {"": 1e3, "the nodes are not in order along the axis": 0.0}
            spans = " by ".join(f"{1e3 * edge:.1f}" for edge in high_m - low_m)
            cases[f"{body.name}, which spans {spans} mm,"] = mistakes
    return largest(cases, "mm")


ATTACHED: dict[str, Any] = {
    "law": "nodes within Region.depth_m of the side keep their places on the frame, and no others",
    "source": "contract (scene.Attachment, scene.Region)",
    "unit": "mm",
    "tolerance": Tolerance("a tenth of the real trials' scatter", absolute=0.1),
    "cause": "attached nodes lag, hang on soft springs or do not turn with the body, or an attachment is missing",
}
"""Texts of the checks of attached nodes."""

CLAMPED_MM, BEYOND_MM = 0.1, 1.0
"""Distance from its place within which a node is attached, and that beyond the clamp within which it may be."""


def attachment_error(rollout: Recording) -> Measurement:
    """Measure the largest distance of an attached node from its place on the frame [mm].

    Where nodes beyond the clamp keep their places, it is the distance of the deepest of them from the clamp.
    """
    (moves,) = rollout.scene.drivers
    poses = [moves.pose(FRAME.pose, float(time_s)) for time_s in rollout.times_s]
    cases = {}
    for body, attachment in zip(
        rollout.scene.deformables, rollout.scene.attachments, strict=True
    ):
        nodes_m, region = rollout.nodes_m[body.name], attachment.region
        places_m = FRAME.pose.to_body(nodes_m[0])
        carried_m = np.array([pose.to_world(places_m) for pose in poses])
        axis = "xyz".index(region.axis)
        along_m = body.pose.to_body(nodes_m[0])[:, axis]
        along_m = along_m if region.side == "low" else -along_m
        depth_m = along_m + 0.5 * extent_m(body)[axis]
        # The mesh may leave out what is clamped, and begin at the end of the clamp.
        first_m = depth_m.min() + PLACE_TOLERANCE_M
        inside = depth_m < max(first_m, region.depth_m + PLACE_TOLERANCE_M)
        off_mm = 1e3 * np.linalg.norm(nodes_m - carried_m, axis=2).max(axis=0)
        late = (nodes_m[1:] - carried_m[:-1])[:, inside]
        clamp = f"{body.name}, clamped over {1e3 * region.depth_m:g} mm,"
        cases[clamp] = {
            "": float(off_mm[inside].max()),
            "nodes follow an interval (1/180 s) late": largest_mm(late),
            "the edge follows, and deeper nodes are free": float(
                off_mm[depth_m < first_m].max()
            ),
        }
        beyond_m = depth_m[off_mm < CLAMPED_MM].max(initial=0.0) - region.depth_m
        if 1e3 * beyond_m > BEYOND_MM:
            cases[clamp] = {"": 1e3 * float(beyond_m), "deeper nodes are attached": 0.0}
    return largest(cases, "mm")


# --- contact ---------------------------------------------------------------------------------------------------------

SLAB_M = (0.2, 0.2, 0.04)
SLABS = {"fixed": fixed_box, "driven": driven_box, "free": box}

REST: dict[str, Any] = {
    "source": "contact (scene.Contact)",
    "unit": "mm",
    "tolerance": Tolerance("the real trials' scatter is about 1 mm", absolute=1.0),
    "cause": "the thickness or radius in contact is another one, or the contact has a margin (scene.Contact)",
}
"""Texts of the checks of bodies at rest."""


def _half_height_m(body: Any) -> float:
    """Return the distance from the middle of a body to its surface below [m]."""
    if isinstance(body, Cloth):
        return 0.5 * body.thickness_m
    is_solid = isinstance(body, SoftBody)
    return 0.5 * float(body.shape.size_m[2]) if is_solid else float(body.radius_m)


def rest_error(
    lab: Lab, bodies: Sequence[Deformable], duration_s: float
) -> Measurement:
    """Measure the height of bodies over a fixed, a driven and a free slab, in the last quarter of the time [mm]."""
    slabs = [
        make(name, (APART_M * number, 0.0, LEVEL_M), SLAB_M)
        for number, (name, make) in enumerate(SLABS.items())
    ]
    base_m = np.subtract(slabs[-1].pose.position_m, (0.0, 0.0, SLAB_M[2]))
    laid = []
    for number, body in enumerate(bodies):
        above_m = 0.5 * SLAB_M[2] + _half_height_m(body) + 1e-4
        # Two lines lie side by side on a slab.
        offset_m = (0.0, 0.05 * (number // 3), above_m)
        laid.append(placed(body, np.add(slabs[number % 3].pose.position_m, offset_m)))
    stay = ramp(0.0, start_s=0.0, duration_s=0.1, ramp_s=0.03)
    scene = Scene(
        bodies=(*slabs, fixed_box("base", vector(base_m), SLAB_M)),
        deformables=tuple(laid),
        contacts=(
            contact("free", "base", friction=0.5),
            contact(tuple(one.name for one in laid), tuple(SLABS), friction=0.4),
        ),
        drivers=(driver("driven", "translate", UP, stay),),
        duration_s=duration_s,
    )
    rollout = lab.rollout(scene).cut(0.75 * duration_s, duration_s)
    cases = {}
    for number, body in enumerate(laid):
        slab = slabs[number % 3].name
        surface_m = 0.0 if isinstance(body, SoftBody) else _half_height_m(body)
        bottom_m = rollout.nodes_m[body.name][:, :, 2].min(axis=1) - surface_m
        top_m = rollout.position(slab)[:, 2] + 0.5 * SLAB_M[2]
        error_mm = 1e3 * float((bottom_m - top_m).mean())
        cases[f"the height of {body.name} on the {slab} slab"] = {
            "": abs(error_mm),
            "it falls through: the pair has no contact": 13.0 + error_mm,
        }
    return largest(cases, "mm")


STRIKE: dict[str, Any] = {
    "law": "m v + M w = const",
    "source": "Newton",
    "tolerance": Tolerance(
        "no force acts from outside; a mesh has the mass at its nodes to 1 %",
        relative=0.01,
    ),
    "cause": "the mass of the nodes is not mass_kg, or the contact pushes only body or block",
}
"""Texts of the checks of momentum."""

STRIKES = ((1.0, 0.3), (-2.5, 0.6), (0.3, 0.4))
"""Velocity of the block [m/s], and its mass over that of the body."""

GAP_M, BLOCK_M = 1e-3, 0.03
STRIKE_WINDOWS_S = ((0.05, 0.6), (1.05, 1.3))


def momentum_ratio(
    lab: Lab, bodies: Sequence[Deformable], duration_s: float
) -> Measurement:
    """Measure the momentum of bodies and of the free blocks that strike them, over that of the blocks at the start."""
    struck, blocks = [], []
    for number, body in enumerate(bodies):
        speed_m_per_s, share = STRIKES[number % 3]
        place_m = np.array([0.0, APART_M * (number - 1), LEVEL_M])
        struck.append(placed(body, place_m))
        below_m = _half_height_m(body) + 0.5 * BLOCK_M + GAP_M
        block = box(
            f"block {number}",
            vector(place_m - math.copysign(below_m, speed_m_per_s) * np.array(UP)),
            (float(extent_m(body).max()) + 0.02, 0.12, BLOCK_M),
            mass_kg=share * body.mass_kg,
        )
        blocks.append(thrown(block, (0.0, 0.0, speed_m_per_s)))
    names = (tuple(one.name for one in struck), tuple(one.name for one in blocks))
    scene = Scene(
        bodies=tuple(blocks),
        deformables=tuple(struck),
        contacts=(contact(*names, friction=0.3),),
        duration_s=duration_s,
        gravity_m_per_s2=0.0,
    )
    rollout = lab.rollout(scene)
    ratios = {}
    for body, block in zip(struck, blocks, strict=True):
        speed_m_per_s = block.linear_velocity_m_per_s[2]
        block_m = rollout.displacement(block.name)[:, 2]
        nodes_m = rollout.nodes_m[body.name]
        moved_m = (nodes_m - nodes_m[0])[:, :, 2]
        ahead_m = block_m[-1] - moved_m[-1].mean()
        if ahead_m / speed_m_per_s > 0.5 * duration_s:
            hint = f"the block passes through {body.name}: the pair has no contact"
            return Measurement(measured=math.nan, expected=1.0, hint=hint)
        moment = moved_m @ node_masses_kg(body, nodes_m[0]) + block.mass_kg * block_m
        for start_s, end_s in STRIKE_WINDOWS_S:
            first, last = rollout.sample_at(start_s), rollout.sample_at(end_s)
            if last > first:
                seconds = rollout.times_s[last] - rollout.times_s[first]
                momentum = float((moment[last] - moment[first]) / seconds)
                label = f"{body.name} from {start_s:g} s"
                ratios[label] = momentum / (block.mass_kg * speed_m_per_s)
    return ratio(ratios, "the momentum")
