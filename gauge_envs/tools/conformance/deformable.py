"""Parts, scenes and measurements that the checks of cloth, foam, ropes and rods share.

Each scene has three bodies of a kind that differ in size, material and load, so that an engine that gives all of them
the constants of one fails.

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
from gauge_envs.tools.bench.parts import (
    box,
    contact,
    driven_box,
    driver,
    fixed_box,
    ramp,
)
from gauge_envs.tools.bench.recording import Recording
from gauge_envs.tools.conformance.lab import Lab, largest_mm, worst_ratio
from gauge_envs.tools.conformance.model import Measurement, Tolerance

PLACE_TOLERANCE_M = 1e-5
"""Distance within which a node is on a line; single precision rounds positions to about 0.1 um at 1 m."""

APART_M, LEVEL_M = 0.5, 1.0
"""Distance between the bodies of a scene, and their height."""

FRAME = fixed_box("frame", (0.0, 0.0, 3.0), (0.1, 0.1, 0.1))
"""Fixed body to which clamped regions are attached. Its place does not matter, so it is out of reach."""

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


RAMP_S = 0.5


def side_by_side(
    scenes: Mapping[str, Scene], speed_m_per_s: float = 0.0, late_s: float = 0.0
) -> Scene:
    """Return the bodies of several clamped scenes in one, with new names and among bystanders.

    Their frame stands still for the duration of the last scene, and then moves. On a frame with a constant velocity
    bodies hang as on one at rest (Galilei).

    Args:
        scenes: Scenes that `clamped` returns, by the new name of their body.
        speed_m_per_s: Upward speed that the frame reaches within `RAMP_S`; 0 for a fixed frame.
        late_s: Time for which it has this speed [s].
    """
    bodies, attachments = [], []
    for number, (name, scene) in enumerate(scenes.items()):
        (body,) = scene.deformables
        place_m = np.add(body.pose.position_m, (0.0, APART_M * (number - 1), 0.0))
        bodies.append(placed(body, place_m, name))
        attachments += [replace(one, deformable=name) for one in scene.attachments]
    whole = replace(
        scene,
        bodies=(*BYSTANDERS, FRAME),
        deformables=tuple(bodies),
        attachments=tuple(attachments),
    )
    if not speed_m_per_s:
        return whole
    duration_s = RAMP_S + late_s + RAMP_S
    amount_m = speed_m_per_s * (duration_s - RAMP_S)
    start_s = scene.duration_s
    rise = ramp(amount_m, start_s=start_s, duration_s=duration_s, ramp_s=RAMP_S)
    return replace(
        whole,
        bodies=(*BYSTANDERS, replace(FRAME, motion=Motion.KINEMATIC)),
        drivers=(driver(FRAME.name, "translate", (0.0, 0.0, 1.0), rise),),
        duration_s=start_s + RAMP_S + late_s,
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


def worst_law(
    rollout: Recording,
    measure: Callable[[Recording], Measurement],
    what: str,
    *windows_s: tuple[float, float],
) -> Measurement:
    """Measure the ratio of a stiffness to that of the scene that is furthest from 1.

    Args:
        rollout: Recording of one or more bodies on `FRAME`, which may move.
        measure: Measurement of a recording of one body, of which the first sample is at rest.
        what: The stiffness, in words.
        windows_s: Times of the samples behind the first that the measurement gets [s]; one ratio for each.
    """
    ratios = {}
    for body in rollout.scene.deformables:
        scene = replace(rollout.scene, deformables=(body,))
        for start_s, end_s in windows_s:
            part = rollout.between(start_s, end_s)
            samples = np.concatenate([[0], np.arange(part.start, part.stop)])
            nodes_m = rollout.nodes_m[body.name]
            nodes_m = nodes_m - rollout.displacement(FRAME.name)[:, None]
            alone = replace(
                rollout,
                scene=scene,
                times_s=rollout.times_s[samples],
                nodes_m={body.name: nodes_m[samples]},
            )
            found = measure(alone)
            label = f"{body.name} from {start_s:g} s"
            ratios[label] = found.measured / found.expected
    measured, hint = worst_ratio(ratios, what)
    return Measurement(measured=measured, expected=1.0, hint=hint)


# --- start -----------------------------------------------------------------------------------------------------------

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
"""Positions [m] and Euler angles [deg] of the three bodies."""


def start_error(lab: Lab, bodies: Sequence[Deformable]) -> Measurement:
    """Measure the largest distance of the box of the nodes of a body at the start, in its frame, from its size [mm]."""
    turned = []
    for number, one in enumerate(bodies):
        place_m, euler_deg = START_PLACES[number % 3]
        if isinstance(one, SoftBody):
            # Engines mesh boxes along the axes of the world.
            euler_deg = vector(90.0 * np.round(np.divide(euler_deg, 90.0)))
        turned.append(replace(one, pose=Pose.from_euler_deg(place_m, euler_deg)))
    scene = Scene(
        bodies=(FRAME, *BYSTANDERS), deformables=tuple(turned), duration_s=0.1
    )
    errors_mm: dict[str, float] = {}
    with lab.running(scene) as simulation:
        for one in turned:
            local_m = one.pose.to_body(np.asarray(simulation.nodes(one.name)[0], float))
            low_m, high_m = local_m.min(axis=0), local_m.max(axis=0)
            size_m = extent_m(one)
            off_m = np.abs([low_m + 0.5 * size_m, high_m - 0.5 * size_m]).max()
            spans = " by ".join(f"{1e3 * edge:.1f}" for edge in high_m - low_m)
            text = f"{one.name} has its size at another place or orientation"
            if np.abs(high_m - low_m - size_m).max() > 0.1 * off_m:
                text = f"{one.name} spans {spans} mm at the start"
            if off_m > 10.0:
                text = f"{one.name} is far away: positions of nodes are in m"
            along = local_m @ size_m
            if np.count_nonzero(size_m) == 1 and (np.diff(along) <= 0.0).any():
                text = f"the nodes of {one.name} are not in order along its axis"
                off_m = max(off_m, 1.0)
            errors_mm[text] = 1e3 * float(off_m)
    hint = max(errors_mm, key=lambda text: errors_mm[text])
    return Measurement(measured=errors_mm[hint], hint=hint)


# --- attachments -----------------------------------------------------------------------------------------------------

ATTACHED: dict[str, Any] = {
    "law": "position in the driven body's frame = const",
    "source": "contract (scene.Attachment)",
    "unit": "mm",
    "tolerance": Tolerance("a tenth of the real trials' scatter", absolute=0.1),
    "cause": "attached nodes lag or lead, hang on soft springs, or do not turn with the body (scene.Attachment)",
}
"""Texts of the checks of attached nodes."""

CARRIED_S, CARRIED_M, CARRIED_RAD = 1.2, 1.1, 0.6
CLAMPED_M = 1e-4
"""Distance from its place on the driven body within which a node is in the clamp."""


def on_rod(bodies: Sequence[Deformable], axis: Any, depths_m: Sequence[float]) -> Scene:
    """Return bodies whose high ends hang from one driven rod, which moves and turns at once."""
    turn, move = (
        ramp(amount, start_s=0.0, duration_s=CARRIED_S, ramp_s=0.3)
        for amount in (CARRIED_RAD, CARRIED_M)
    )
    pivot_m = (0.0, 0.0, LEVEL_M)
    motions = (
        DriverMotion(
            kind="rotate", axis=(0.0, 0.0, 1.0), profiles=(turn,), point_m=pivot_m
        ),
        DriverMotion(kind="translate", axis=(0.8, -0.36, 0.48), profiles=(move,)),
    )
    hung = []
    for number, body in enumerate(bodies):
        half_m = 0.5 * float(extent_m(body)["xyz".index(axis)])
        place_m = (0.0, 0.15 * (number - 1), LEVEL_M - half_m)
        hung.append(placed(body, place_m))
    return Scene(
        bodies=(driven_box("rod", (0.0, 0.0, LEVEL_M), (0.01, 0.4, 0.01)), *BYSTANDERS),
        deformables=tuple(hung),
        attachments=tuple(
            Attachment(
                deformable=body.name,
                region=Region(axis=axis, side="high", depth_m=depth_m),
                to="rod",
            )
            for body, depth_m in zip(hung, depths_m, strict=True)
        ),
        drivers=(Driver(body="rod", motions=motions, provenance="nominal"),),
        duration_s=CARRIED_S,
    )


def _off_rod_m(rollout: Recording, name: str) -> tuple[FloatArray, FloatArray]:
    """Return the depth of each node below the rod at the start, and its course relative to its place on the rod [m].

    The shapes are [node_count] and [sample_count, node_count, 3].
    """
    (driver,) = rollout.scene.drivers
    start, nodes_m = rollout.scene.body("rod").pose, rollout.nodes_m[name]
    places_m = start.to_body(nodes_m[0])
    poses = [driver.pose(start, float(time_s)) for time_s in rollout.times_s]
    carried_m = np.array([pose.to_world(places_m) for pose in poses])
    return LEVEL_M - nodes_m[0, :, 2], nodes_m - carried_m


def edge_error(rollout: Recording) -> Measurement:
    """Measure the largest distance of the nodes next to the rod from their places on it [mm]."""
    errors_mm: dict[str, float] = {}
    for name, nodes_m in rollout.nodes_m.items():
        depth_m, off_m = _off_rod_m(rollout, name)
        # The mesh may leave out what is clamped, and begin at the end of the clamp.
        edge = depth_m < depth_m.min() + PLACE_TOLERANCE_M
        error_mm = largest_mm(off_m[:, edge])
        carried_m = (nodes_m - off_m)[:, edge]
        text = f"the attached nodes of {name} leave their places on the rod"
        shifted = {
            "late": nodes_m[1:, edge] - carried_m[:-1],
            "early": nodes_m[:-1, edge] - carried_m[1:],
        }
        for word, left_m in shifted.items():
            if largest_mm(left_m) < 0.2 * error_mm:
                text = f"{name} follows the rod one interval (1/180 s) {word}"
        if largest_mm(nodes_m[1] - nodes_m[0]) > 10.0:
            text = f"nodes of {name} jump in the first interval: their order changes"
        elif off_m[-1, edge, 2].max() < -0.5 * rollout.times_s[-1] ** 2:
            text = f"{name} falls off the rod: its attachment is missing"
        errors_mm[text] = error_mm
    hint = max(errors_mm, key=lambda text: errors_mm[text])
    return Measurement(measured=errors_mm[hint], hint=hint)


def clamp_error(rollout: Recording) -> Measurement:
    """Measure how far the clamp of a body ends from the depth of its region, beyond the nodes next to it [mm]."""
    errors_mm: dict[str, float] = {}
    for attachment in rollout.scene.attachments:
        name, asked_m = attachment.deformable, attachment.region.depth_m
        depth_m, off_m = _off_rod_m(rollout, name)
        is_clamped = np.linalg.norm(off_m, axis=2).max(axis=0) < CLAMPED_M
        deepest_m = float(depth_m[is_clamped].max(initial=0.0))
        text = f"a node of {name} at {1e3 * deepest_m:.4g} mm is attached, deeper than"
        errors_mm[f"{text} {1e3 * asked_m:g} mm"] = 1e3 * (deepest_m - asked_m)
        first_m = float(depth_m[~is_clamped].min(initial=math.inf))
        text = (
            f"a node of {name} at {1e3 * first_m:.4g} mm is free, within the clamp of"
        )
        errors_mm[f"{text} {1e3 * asked_m:g} mm"] = 1e3 * (asked_m - first_m)
    hint = max(errors_mm, key=lambda text: errors_mm[text])
    return Measurement(measured=max(0.0, errors_mm[hint]), hint=hint)


# --- contact ---------------------------------------------------------------------------------------------------------

SLAB_M = (0.2, 0.2, 0.04)
MOTIONS = ("fixed", "driven", "free")
"""Names of the slabs on which bodies rest."""

REST: dict[str, Any] = {
    "source": "contact (scene.Contact)",
    "unit": "mm",
    "tolerance": Tolerance("the real trials' scatter is about 1 mm", absolute=1.0),
    "cause": "the thickness or radius in contact is another one, or the contact has a margin (scene.Contact)",
}
"""Texts of the checks of bodies at rest."""


def _half_height_m(body: Deformable) -> float:
    """Return the distance from the middle of a body to its surface below [m]."""
    if isinstance(body, Cloth):
        return 0.5 * body.thickness_m
    if isinstance(body, SoftBody):
        return 0.5 * float(body.shape.size_m[2])
    return body.radius_m


def rest_error(
    lab: Lab, bodies: Sequence[Deformable], duration_s: float
) -> Measurement:
    """Measure the height of bodies over a fixed, a driven and a free slab, in the last quarter of the time [mm]."""
    slabs = [
        make(name, (APART_M * number, 0.0, LEVEL_M), SLAB_M)
        for number, (name, make) in enumerate(
            zip(MOTIONS, (fixed_box, driven_box, box), strict=True)
        )
    ]
    base_m = np.subtract(slabs[-1].pose.position_m, (0.0, 0.0, SLAB_M[2]))
    laid = []
    for number, body in enumerate(bodies):
        height_m = 0.5 * SLAB_M[2] + _half_height_m(body) + 1e-4
        # Two lines lie side by side on a slab.
        aside_m = 0.05 * (number // 3)
        under_m = slabs[number % 3].pose.position_m
        laid.append(placed(body, np.add(under_m, (0.0, aside_m, height_m))))
    stay = ramp(0.0, start_s=0.0, duration_s=0.1, ramp_s=0.03)
    scene = Scene(
        bodies=(*slabs, fixed_box("base", vector(base_m), SLAB_M)),
        deformables=tuple(laid),
        contacts=(
            contact("free", "base", friction=0.5),
            contact(tuple(one.name for one in laid), MOTIONS, friction=0.4),
        ),
        drivers=(driver("driven", "translate", (1.0, 0.0, 0.0), stay),),
        duration_s=duration_s,
    )
    rollout = lab.rollout(scene)
    late = rollout.between(0.75 * duration_s, duration_s)
    errors_mm: dict[str, float] = {}
    for number, body in enumerate(laid):
        slab = MOTIONS[number % 3]
        lowest_m = rollout.nodes_m[body.name][late, :, 2].min(axis=1)
        if not isinstance(body, SoftBody):
            lowest_m = lowest_m - _half_height_m(body)
        top_m = rollout.position(slab)[late, 2] + 0.5 * SLAB_M[2]
        error_mm = 1e3 * float((lowest_m - top_m).mean())
        text = f"{body.name} is {error_mm:.3g} mm off its height on the {slab} slab"
        if error_mm < -13.0:
            text = f"{body.name} falls through the {slab} slab: the pair has no contact"
        errors_mm[text] = error_mm
    hint = max(errors_mm, key=lambda text: abs(errors_mm[text]))
    return Measurement(measured=errors_mm[hint], hint=hint)


STRIKE: dict[str, Any] = {
    "law": "m v + M w = const",
    "source": "Newton",
    "tolerance": Tolerance(
        "no force acts from outside; a mesh has the mass at its nodes to 1 %",
        relative=0.01,
    ),
    "cause": "the mass of the nodes is not mass_kg, or the contact pushes one of the two alone",
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
        below_m = math.copysign(below_m, speed_m_per_s)
        block = box(
            f"block {number}",
            vector(place_m - [0.0, 0.0, below_m]),
            (float(extent_m(body).max()) + 0.02, 0.12, BLOCK_M),
            mass_kg=share * body.mass_kg,
        )
        velocity = (0.0, 0.0, speed_m_per_s)
        blocks.append(replace(block, linear_velocity_m_per_s=velocity))
    names = tuple(one.name for one in struck)
    scene = Scene(
        bodies=tuple(blocks),
        deformables=tuple(struck),
        contacts=(contact(names, tuple(one.name for one in blocks), friction=0.3),),
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
    measured, hint = worst_ratio(ratios, "the momentum")
    return Measurement(measured=measured, expected=1.0, hint=hint)
