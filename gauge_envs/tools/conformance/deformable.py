"""Common parts, scenes and measurements of the checks of cloth, foam, ropes and rods.

Each scene has two or three bodies of a kind that differ in size, material and load. An engine that gives all of them
the same constants fails.

The contract has no forces on nodes, so the load is the weight. Engines differ in damping: a body may oscillate about
its equilibrium or creep towards it. The mean under a Hann window over four periods or more is the equilibrium in both
cases. Each law is fitted with the place of the clamp as a free parameter, because the clamp of a mesh can be off by
one cell.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from gauge_envs.fixtures.parts import box, contact, driven_box, fixed_box, ramp, thrown
from gauge_envs.fixtures.recording import Recording
from gauge_envs.scene import (
    GRAVITY_M_PER_S2,
    Attachment,
    Cloth,
    Deformable,
    Motion,
    Pose,
    Region,
    RigidBody,
    Rod,
    Rope,
    Scene,
    SoftBody,
)
from gauge_envs.scene.drivers import Driver, DriverMotion
from gauge_envs.scene.fabrics import Fabric
from gauge_envs.scene.geometry import FloatArray, Vector, vector
from gauge_envs.scoring.estimators import hann_mean
from gauge_envs.tools.conformance.lab import Lab, Measurement, largest, ratio
from gauge_envs.tools.conformance.model import Tolerance

PLACE_TOLERANCE_M = 1e-5
"""Distance within which a node is on a line; single precision rounds positions to about 0.1 um at 1 m."""

APART_M, LEVEL_M = 0.3, 1.0
"""Distance between the bodies of a scene, and their height."""

UP = (0.0, 0.0, 1.0)
LEVEL = Pose(position_m=(0.0, 0.0, LEVEL_M))

FRAME = fixed_box("frame", (0.0, 0.0, 3.0), (0.1, 0.1, 0.1))
"""Body to which clamped regions are attached. Its place does not matter, so it is far away."""

BYSTANDERS = tuple(
    fixed_box(f"bystander {number}", (2.0, 0.3 * number, 0.5), (0.02, 0.02, 0.02))
    for number in range(5)
)
"""Bodies without contacts, which must not affect other bodies."""


# --- bodies and scenes -----------------------------------------------------------------------------------------------

STRETCH_OVER_SHEAR = 2.7
"""K_s / K_sh of every sheet; an isotropic membrane can have any ratio between 2 and 4 (scene/fabrics.py)."""


def fabric(
    areal_density: float,
    stretch_n_per_m: float,
    bend_n_m: float,
    thickness_m: float = 1e-3,
) -> Fabric:
    """Return a fabric that every engine's membrane can represent; the shear stiffness follows from K_s.

    Args:
        areal_density: Mass per area [kg/m^2].
        stretch_n_per_m: Stretch stiffness K_s [N/m].
        bend_n_m: Bending stiffness K_theta [N m/rad].
        thickness_m: Thickness in contact [m].
    """
    return Fabric(
        stretch_stiffness_n_per_m=stretch_n_per_m,
        shear_stiffness_n_per_m=stretch_n_per_m / STRETCH_OVER_SHEAR,
        bend_stiffness_n_m_per_rad=bend_n_m,
        thickness_m=thickness_m,
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


def placed(body: Deformable, place_m: ArrayLike) -> Deformable:
    """Return a body at another place [m]."""
    pose = replace(body.pose, position_m=vector(place_m))
    return replace(body, pose=pose)


def clamped(
    body: Deformable,
    *regions: Region,
    duration_s: float,
    gravity_m_per_s2: float = GRAVITY_M_PER_S2,
) -> Scene:
    """Return a scene of one deformable body with some regions attached to a fixed body."""
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


def also_attached(scene: Scene, body: RigidBody, region: Region) -> Scene:
    """Return a scene with another rigid body, to which a region of its deformable body is attached."""
    (soft,) = scene.deformables
    more = Attachment(deformable=soft.name, region=region, to=body.name)
    return replace(
        scene,
        bodies=(*scene.bodies, body),
        attachments=(*scene.attachments, more),
    )


RAMP_S, TURN_S, TURN_RAD = 0.5, 0.3, 0.6
SPEED_M_PER_S = 2.0


def side_by_side(scenes: Sequence[Scene], late_s: float) -> Scene:
    """Return the bodies of several clamped scenes in one, numbered and among bystanders.

    Their frame stands still for the duration of the last scene. Then it reaches 2 m/s upward, keeps it, and also turns.
    On a frame with constant velocity, bodies hang as on a frame at rest (Galilei).

    Args:
        scenes: Scenes that `clamped` returns.
        late_s: Time for which the frame has its speed before it turns [s].
    """
    bodies, attachments = [], []
    for number, scene in enumerate(scenes):
        (body,) = scene.deformables
        place_m = np.add(body.pose.position_m, (0.0, APART_M * (number - 1), 0.0))
        name = f"{body.name} {number}"
        bodies.append(replace(placed(body, place_m), name=name))
        attachments += [
            replace(attachment, deformable=name) for attachment in scene.attachments
        ]
    moving_s, turn_s = 3.0 * RAMP_S + late_s, scene.duration_s + RAMP_S + late_s
    rise = ramp(
        SPEED_M_PER_S * (moving_s - RAMP_S),
        start_s=scene.duration_s,
        duration_s=moving_s,
        ramp_s=RAMP_S,
    )
    rotation = ramp(TURN_RAD, start_s=turn_s, duration_s=2.0 * TURN_S, ramp_s=0.15)
    motions = (
        DriverMotion(kind="translate", axis=UP, profiles=(rise,)),
        DriverMotion(kind="rotate", axis=UP, profiles=(rotation,)),
    )
    moves = Driver(body=FRAME.name, motions=motions, provenance="nominal")
    return replace(
        scene,
        bodies=(*BYSTANDERS, replace(FRAME, motion=Motion.KINEMATIC)),
        deformables=tuple(bodies),
        attachments=tuple(attachments),
        drivers=(moves,),
        duration_s=turn_s + TURN_S,
    )


MASS_POINTS = 1e5


def node_masses_kg(body: Deformable, rest_m: FloatArray) -> FloatArray:
    """Return the mass at each node of a uniform body, from its nodes at the start in its frame [m], shape [node_count].

    It is the mass of the points of the body that are nearest to the node, for any mesh.
    """
    size_m = extent_m(body)
    count = round(MASS_POINTS ** (1.0 / np.count_nonzero(size_m)))
    shares = (np.arange(count) + 0.5) / count - 0.5
    axes = [shares * edge_m if edge_m else [0.0] for edge_m in size_m]
    points_m = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 3)
    nearest = cKDTree(rest_m).query(points_m)[1]
    counts = np.bincount(nearest, minlength=len(rest_m))
    return np.asarray(body.mass_kg * counts / len(points_m))


# --- fits ------------------------------------------------------------------------------------------------------------


def coefficient(values: FloatArray, *columns: FloatArray) -> float:
    """Return the coefficient of the first of the columns in a least-squares fit."""
    return float(np.linalg.lstsq(np.column_stack(columns), values, rcond=None)[0][0])


def stiffness(load: float, slope: float, expected: float) -> Measurement:
    """Measure a stiffness from a load and the fitted coefficient of the deformation, load / stiffness.

    Args:
        load: Load in the unit of the stiffness times the unit of the coefficient.
        slope: Coefficient of the deformation; when it is not positive, the stiffness is infinite.
        expected: Expected stiffness.
    """
    measured = load / slope if slope > 0.0 else math.inf
    return Measurement(measured=measured, expected=expected)


@dataclass(frozen=True)
class Equilibrium:
    """A clamped body in equilibrium under its weight.

    Attributes:
        body: The body.
        depth_m: Depth of its clamp [m].
        gravity_m_per_s2: Gravity [m/s^2].
        rest_m: Its nodes at the start, in its frame [m], shape [node_count, 3].
        moved_m: Their displacements along the axes of the world, relative to `FRAME` [m], shape [node_count, 3].
    """

    body: Any
    depth_m: float
    gravity_m_per_s2: float
    rest_m: FloatArray
    moved_m: FloatArray


Law = Callable[[Equilibrium], Measurement]
"""Measures a constant of a body from its equilibrium."""


def equilibrium(
    rollout: Recording, name: str, start_s: float, end_s: float = math.inf
) -> Equilibrium:
    """Return the equilibrium of a body between two times [s]."""
    scene = rollout.scene
    (body,) = (soft for soft in scene.deformables if soft.name == name)
    clamps = [link.region for link in scene.attachments if link.deformable == name]
    nodes_m = rollout.nodes_m[name] - rollout.displacement(FRAME.name)[:, None]
    settled_m = hann_mean(nodes_m[rollout.between(start_s, end_s)])
    return Equilibrium(
        body,
        clamps[0].depth_m,
        scene.gravity_m_per_s2,
        body.pose.to_body(nodes_m[0]),
        settled_m - nodes_m[0],
    )


def droop(hung: Equilibrium) -> float:
    """Return the weight per length of a clamped level body over its stiffness [1/m^3]: D w'' = load (L - s)^2 / 2.

    The fit also determines the place and the slope of the clamp.
    """
    size_m = extent_m(hung.body)
    s_m = hung.rest_m[:, size_m.argmax()] + 0.5 * size_m.max() - hung.depth_m
    free = s_m > -PLACE_TOLERANCE_M
    s, free_m = s_m[free], size_m.max() - hung.depth_m
    # Nodes are weighted by mass, like the load, since a mesh's diagonals make its lines of nodes wavy.
    scale = np.sqrt(node_masses_kg(hung.body, hung.rest_m))[free]
    columns = [(free_m - s) ** 4 / 24.0 * scale, scale, s * scale]
    return coefficient(-hung.moved_m[free, 2] * scale, *columns)


def worst_law(
    rollout: Recording, law: Law, what: str, settled_s: float, still_s: float
) -> Measurement:
    """Measure the worst ratio of a measured to a given constant, of all bodies, at rest and moving.

    Args:
        rollout: Recording of a scene of `side_by_side`.
        law: Measures the constant.
        what: Name of the constant.
        settled_s: Time from which the bodies hang in equilibrium [s].
        still_s: Time until which the frame stands still [s].
    """
    moving_s = still_s + RAMP_S
    windows_s = {
        "at rest": (settled_s, still_s),
        "on the moving frame": (moving_s, moving_s + still_s - settled_s),
    }
    ratios = {}
    for body in rollout.scene.deformables:
        for label, window_s in windows_s.items():
            measurement = law(equilibrium(rollout, body.name, *window_s))
            ratios[f"{body.name} {label}"] = measurement.measured / measurement.expected
    return ratio(ratios, what)


# --- start and attachments -------------------------------------------------------------------------------------------

START: dict[str, Any] = {
    "law": "the nodes span size_m or length_m about the pose",
    "unit": "mm",
    "tolerance": Tolerance("a float's rounding at 1 m is 0.1 um", absolute=0.01),
    "cause": "nodes() returns world positions in metres; size, pose and axis are those of the scene",
}
"""Texts of the checks of nodes at the start."""

START_M, NEXT_M = (-0.33, -0.71, 0.57), (0.4, 0.5, 0.3)
"""Place of the first body, and how far the next is from it."""


def start_error(
    lab: Lab,
    bodies: Sequence[Deformable],
    turn_deg: Vector = (20.0, -35.0, 50.0),
) -> Measurement:
    """Measure the largest distance of the box of the nodes of a body at the start, in its frame, from its size [mm].

    The nodes of a rope or a rod must also be in order.

    Args:
        lab: The lab.
        bodies: The bodies.
        turn_deg: Euler angles of the first body; the second body has twice these angles [deg].
    """
    turned = []
    for number, body in enumerate(bodies):
        place_m = np.add(START_M, np.multiply(number, NEXT_M))
        euler_deg = np.multiply(number + 1, turn_deg)
        pose = Pose.from_euler_deg(vector(place_m), vector(euler_deg))
        turned.append(replace(body, pose=pose))
    scene = Scene(
        bodies=(FRAME, *BYSTANDERS), deformables=tuple(turned), duration_s=0.1
    )
    errors, mistakes = {}, {}
    with lab.running(scene) as simulation:
        for body in turned:
            local_m = body.pose.to_body(simulation.nodes(body.name)[0])
            half_m = 0.5 * extent_m(body)
            edges_m = [local_m.min(axis=0) + half_m, local_m.max(axis=0) - half_m]
            errors[body.name] = 1e3 * float(np.abs(edges_m).max())
            is_line = isinstance(body, Rope | Rod)
            if is_line and (np.diff(local_m @ half_m) <= 0.0).any():
                errors[body.name] = 1e3
                disorder = "the nodes are not in order along the axis"
                mistakes[body.name] = {disorder: 0.0}
    return largest(errors, "mm", mistakes)


ATTACHED: dict[str, Any] = {
    "law": "nodes within Region.depth_m of the side keep their places on the frame, and no others",
    "unit": "mm",
    "tolerance": Tolerance("a tenth of the real trials' scatter", absolute=0.1),
    "cause": "attached nodes lag, hang on soft springs or do not turn with the body, or an attachment is missing",
}
"""Texts of the checks of attached nodes."""

CLAMPED_MM, BEYOND_MM = 0.1, 1.0
"""Largest distance of an attached node from its place, and of an attached node beyond the clamp."""


def attachment_error(rollout: Recording) -> Measurement:
    """Measure the largest distance of an attached node from its place on the frame [mm]; all regions are at high sides.

    If nodes beyond the clamp keep their places, it is the distance of the deepest node from the clamp.
    """
    (moves,) = rollout.scene.drivers
    poses = [moves.pose(FRAME.pose, float(time_s)) for time_s in rollout.times_s]
    errors, mistakes = {}, {}
    for body, attachment in zip(
        rollout.scene.deformables, rollout.scene.attachments, strict=True
    ):
        nodes_m, region = rollout.nodes_m[body.name], attachment.region
        places_m = FRAME.pose.to_body(nodes_m[0])
        carried_m = np.array([pose.to_world(places_m) for pose in poses])
        axis = "xyz".index(region.axis)
        along_m = body.pose.to_body(nodes_m[0])[:, axis]
        depth_m = 0.5 * extent_m(body)[axis] - along_m
        # The mesh may leave out the clamped material, and begin at the end of the clamp.
        inside = depth_m < PLACE_TOLERANCE_M + max(depth_m.min(), region.depth_m)
        off_mm = 1e3 * np.linalg.norm(nodes_m - carried_m, axis=2).max(axis=0)
        errors[body.name] = float(off_mm[inside].max())
        attached_m = depth_m[off_mm < CLAMPED_MM].max(initial=0.0)
        beyond_mm = 1e3 * float(attached_m - region.depth_m)
        if beyond_mm > BEYOND_MM:
            errors[body.name] = beyond_mm
            mistakes[body.name] = {"deeper nodes are attached": 0.0}
    return largest(errors, "mm", mistakes)


# --- contact ---------------------------------------------------------------------------------------------------------

SLAB_M = (0.2, 0.2, 0.04)

REST: dict[str, Any] = {
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


def _paired(
    bodies: Sequence[Deformable], rigid: Sequence[RigidBody], **more: Any
) -> Scene:
    """Return a scene in which deformable and rigid bodies touch."""
    names = [tuple(body.name for body in group) for group in (bodies, rigid)]
    return Scene(
        bodies=tuple(rigid),
        deformables=tuple(bodies),
        contacts=(contact(*names, friction=0.4),),
        **more,
    )


def rest_error(
    lab: Lab, bodies: Sequence[Deformable], duration_s: float
) -> Measurement:
    """Measure the height of bodies over slabs that stand still, in the last quarter of the time [mm]."""
    slabs, laid = [], []
    for number, body in enumerate(bodies):
        place_m = np.array([APART_M * number, 0.0, LEVEL_M])
        make = driven_box if number % 2 else fixed_box
        slabs.append(make(f"slab {number}", vector(place_m), SLAB_M))
        above_m = 0.5 * SLAB_M[2] + _half_height_m(body) + 1e-4
        laid.append(placed(body, place_m + np.multiply(above_m, UP)))
    scene = _paired(laid, slabs, duration_s=duration_s)
    rollout = lab.rollout(scene).cut(0.75 * duration_s, duration_s)
    errors, mistakes = {}, {}
    for body, slab in zip(laid, slabs, strict=True):
        surface_m = 0.0 if isinstance(body, SoftBody) else _half_height_m(body)
        bottom_m = rollout.nodes_m[body.name][:, :, 2].min(axis=1) - surface_m
        error_mm = 1e3 * float(bottom_m.mean() - LEVEL_M - 0.5 * SLAB_M[2])
        case = f"the height of {body.name} on a {slab.motion} slab"
        errors[case] = abs(error_mm)
        falls = "it falls through: the pair has no contact"
        mistakes[case] = {falls: 13.0 + error_mm}
    return largest(errors, "mm", mistakes)


STRIKE: dict[str, Any] = {
    "law": "m v + M w = const",
    "tolerance": Tolerance(
        "no force acts from outside; a mesh has the mass at its nodes to 1 %",
        relative=0.01,
    ),
    "cause": "momentum is gained or lost: the mass of the nodes is not mass_kg, or the contact pushes only one of both",
}
"""Texts of the checks of momentum."""

STRIKES = ((1.0, 0.3), (-2.5, 0.6), (0.3, 0.4))
"""Velocity of the block [m/s], and its mass over that of the body."""

GAP_M, BLOCK_M = 1e-3, 0.03
STRUCK = 9
"""Sample at which a block has struck."""


def momentum_ratio(
    lab: Lab, bodies: Sequence[Deformable], duration_s: float
) -> Measurement:
    """Measure the momentum of bodies and of the blocks that strike them, over the initial momentum of the blocks.

    Momentum sideways adds to 1.
    """
    struck, blocks = [], []
    for number, body in enumerate(bodies):
        speed_m_per_s, share = STRIKES[number % 3]
        y_m = APART_M * number
        struck.append(placed(body, (0.0, y_m, LEVEL_M)))
        apart_m = _half_height_m(body) + 0.5 * BLOCK_M + GAP_M
        block = box(
            f"block {number}",
            (0.0, y_m, LEVEL_M - math.copysign(apart_m, speed_m_per_s)),
            (0.17, 0.12, BLOCK_M),
            mass_kg=share * body.mass_kg,
        )
        blocks.append(thrown(block, (0.0, 0.0, speed_m_per_s)))
    scene = _paired(struck, blocks, duration_s=duration_s, gravity_m_per_s2=0.0)
    rollout = lab.rollout(scene)
    seconds = duration_s - rollout.times_s[STRUCK]
    ratios = {}
    for body, block in zip(struck, blocks, strict=True):
        speed_m_per_s = block.linear_velocity_m_per_s[2]
        block_m = rollout.displacement(block.name)
        nodes_m = rollout.nodes_m[body.name]
        moved_m = nodes_m - nodes_m[0]
        ahead_m = block_m[-1, 2] - moved_m[-1, :, 2].mean()
        if ahead_m / speed_m_per_s > 0.5 * duration_s:
            return Measurement(
                measured=math.nan,
                expected=1.0,
                hint=f"the block passes through {body.name}",
                cause="the pair has no contact",
            )
        masses_kg = node_masses_kg(body, body.pose.to_body(nodes_m[0]))
        moment = masses_kg @ moved_m + block.mass_kg * block_m
        momentum = (moment[-1] - moment[STRUCK]) / seconds
        x, y, z = momentum / (block.mass_kg * speed_m_per_s)
        ratios[body.name] = z
        ratios[f"{body.name}, sideways"] = 1.0 + np.hypot(x, y)
    return ratio(ratios, "the momentum")
