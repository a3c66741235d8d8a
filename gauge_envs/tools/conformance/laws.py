"""Closed forms, reference integrations and fits to which the checks compare an engine, and shared measurements."""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from gauge_envs.scene import GRAVITY_M_PER_S2, Pose
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scoring.estimators import slide_friction
from gauge_envs.tools.bench.parts import box_inertia_kg_m2
from gauge_envs.tools.bench.recording import Recording
from gauge_envs.tools.conformance.model import Measurement, Tolerance

PLACE_TOLERANCE_M = 1e-5
"""Distance within which a node is on a line; single precision rounds positions to about 0.1 um at 1 m."""


def torque_free_orientation(
    *,
    start: Rotation,
    spin_rad_per_s: FloatArray,
    moments: FloatArray,
    seconds: float,
) -> Rotation:
    """Return the orientation of a free body after a time, from Euler's equations integrated to 1e-10.

    Args:
        start: Orientation at the start.
        spin_rad_per_s: Angular velocity at the start in the world frame [rad/s], shape [3].
        moments: Principal moments of inertia about the body axes [kg m^2], shape [3].
        seconds: Time of the rotation [s].
    """

    def rate(_: float, state: FloatArray) -> FloatArray:
        w, v, spin = state[0], state[1:4], state[4:]
        quaternion_rate = 0.5 * np.concatenate(
            [[-v @ spin], w * spin + np.cross(v, spin)]
        )
        return np.concatenate(
            [quaternion_rate, -np.cross(spin, moments * spin) / moments]
        )

    first = np.concatenate(
        [start.as_quat(scalar_first=True), start.apply(spin_rad_per_s, inverse=True)]
    )
    last = solve_ivp(
        rate, (0.0, seconds), first, rtol=1e-10, atol=1e-12, method="DOP853"
    ).y[:, -1]
    return Rotation.from_quat(last[:4], scalar_first=True)


def spin_from_orientations(rotations: Rotation, interval_s: float) -> FloatArray:
    """Return angular velocities in the world frame [rad/s] by central differences, shape [sample_count - 2, 3]."""
    return np.asarray(
        (rotations[2:] * rotations[:-2].inv()).as_rotvec() / (2.0 * interval_s)
    )


def cantilever_load_over_stiffness(
    s_m: FloatArray,
    droop_m: FloatArray,
    *,
    length_m: float,
    weights: FloatArray,
) -> float:
    """Return the weight per length over the bending stiffness of a cantilever: D w'' = load (L - s)^2 / 2.

    The fit also determines the place and the slope of the clamp. The clamp of a mesh can be off by up to one cell.

    Args:
        s_m: Distances from the clamp [m], shape [node_count]; nodes in the clamp, at negative distances, are ignored.
        droop_m: Downward displacements [m], same shape.
        length_m: Free length L [m].
        weights: Share of the load at each node, same shape.

    Returns:
        load / D [1/m^3].
    """
    free = s_m > -PLACE_TOLERANCE_M
    s, scale = s_m[free], np.sqrt(weights[free])
    columns = np.column_stack([(length_m - s) ** 4 / 24.0, np.ones(len(s)), s])
    return coefficient(droop_m[free] * scale, columns * scale[:, None])


def coefficient(values: FloatArray, *columns: FloatArray) -> float:
    """Return the coefficient of the first of the columns in a least-squares fit."""
    return float(np.linalg.lstsq(np.column_stack(columns), values, rcond=None)[0][0])


# --- measurements ----------------------------------------------------------------------------------------------------

SLIDE_SLOPE_DEG = 30.0
"""Slope of every slide [deg]."""

NODES: dict[str, Any] = {
    "source": "contract (Simulation.nodes)",
    "unit": "mm",
    "tolerance": Tolerance("a float's rounding at 1 m is 0.1 um", absolute=0.01),
}
"""Texts of the checks of nodes at the start (`bounds_error`)."""

ATTACHED: dict[str, Any] = {
    "law": "position in the driven body's frame = const",
    "source": "contract (scene.Attachment)",
    "unit": "mm",
    "tolerance": Tolerance("a tenth of the real trials' scatter", absolute=0.1),
    "diagnosis": "attached nodes lag or lead by an interval, hang on soft springs, or do not rotate with the body",
}
"""Texts of the checks of attachments (`attachment_error`)."""


def largest_mm(vectors_m: FloatArray) -> float:
    """Return the largest length of vectors [m], shape [..., 3], in millimetres."""
    return 1e3 * float(np.linalg.norm(vectors_m, axis=-1).max())


def inertia_kg_m2(rollout: Recording, name: str) -> FloatArray:
    """Return the inertia tensor of a box in the world [kg m^2], shape [sample_count, 3, 3]."""
    axes = rollout.rotation(name).as_matrix()
    moments = box_inertia_kg_m2(rollout.scene.body(name))
    return np.asarray(np.einsum("tij,j,tkj->tik", axes, moments, axes))


def slide_acceleration(measured: float, friction: float) -> Measurement:
    """Return the measurement of a slide on `SLIDE_SLOPE_DEG`; Coulomb's law gives the expected acceleration [m/s^2]."""
    sine, cosine = (
        np.sin(np.radians(SLIDE_SLOPE_DEG)),
        np.cos(np.radians(SLIDE_SLOPE_DEG)),
    )
    effective = slide_friction(
        measured, math.radians(SLIDE_SLOPE_DEG), gravity_m_per_s2=GRAVITY_M_PER_S2
    )
    rules = {
        "its square: the engine multiplies the values of two bodies": friction**2,
        "its half": 0.5 * friction,
    }
    rule = next(
        (
            f", {text}"
            for text, value in rules.items()
            if abs(effective / value - 1.0) < 0.02
        ),
        "",
    )
    return Measurement(
        measured=measured,
        expected=GRAVITY_M_PER_S2 * (sine - friction * cosine),
        hint=f"it slides as if the friction were {effective:.3g} instead of {friction:.3g}{rule}",
    )


def worst_ratio(ratios: Mapping[str, float], what: str) -> Measurement:
    """Return the ratio that is furthest from 1, with the name of what it belongs to and of those that are right."""
    # Rounded, so that the last bit does not choose among equals.
    errors = {name: float(f"{abs(ratio - 1.0):.9g}") for name, ratio in ratios.items()}
    name = max(errors, key=lambda one: np.nan_to_num(errors[one], nan=np.inf))
    # Beside a ratio without bound one that is 500 times off is not right.
    largest = 0.1 * min(1.0, errors[name])
    right = [one for one, error in errors.items() if error < largest]
    others = f"; right: {', '.join(right)}" if right else "; so are the others"
    return Measurement(
        measured=ratios[name],
        expected=1.0,
        hint=f"{what} {ratios[name]:.4g} times what it should be for {name}{others}",
    )


def furthest(sizes: Mapping[str, float]) -> Measurement:
    """Return the largest of some sizes, with the name of what it belongs to."""
    worst = max(sizes, key=lambda one: sizes[one])
    return Measurement(measured=sizes[worst], hint=f"it is furthest for the {worst}")


def furthest_from(expected: float, values: FloatArray) -> Measurement:
    """Return the value that is furthest from what is expected."""
    worst = float(values[np.abs(values - expected).argmax()])
    return Measurement(measured=worst, expected=expected)


def bounds_error(nodes_m: FloatArray, size_m: tuple[float, ...]) -> Measurement:
    """Measure the largest distance [mm] of the bounding box of nodes from that of a centred body of a size."""
    half = 0.5 * np.array(size_m)
    low_m, high_m = nodes_m.min(axis=0), nodes_m.max(axis=0)
    apart = np.concatenate([low_m + half, high_m - half])
    found, asked = (
        ", ".join(f"{1e3 * edge_m:.4g}" for edge_m in edges_m)
        for edges_m in (high_m - low_m, size_m)
    )
    hint = "its size is right: it has another place or orientation"
    if np.abs(high_m - low_m - size_m).max() > 0.1 * np.abs(apart).max():
        hint = f"its nodes span {found} mm instead of the size of {asked} mm"
    return Measurement(measured=1e3 * float(np.abs(apart).max()), hint=hint)


def stiffness(load: float, slope: float, expected: float, verb: str) -> Measurement:
    """Measure a stiffness from a load and the fitted coefficient of the deformation.

    Args:
        load: Load in the unit of the expected stiffness times that of the coefficient.
        slope: Coefficient of the deformation; when it is not positive, the stiffness is infinite.
        expected: Expected stiffness.
        verb: Kind of deformation, such as `bends`.
    """
    if not slope > 0.0:
        return Measurement(
            measured=float("inf"),
            expected=expected,
            hint="its weight does not deform it",
        )
    ratio = expected * slope / load
    hint = f"it {verb} {ratio:.3g} times as much as it should"
    return Measurement(measured=float(load / slope), expected=expected, hint=hint)


def passive_energy_gain(
    nodes_m: FloatArray,
    times_s: FloatArray,
    mass_shares: FloatArray,
    gravity: float,
) -> Measurement:
    """Measure the largest gain [%] of kinetic and potential energy of a falling body, over the released energy.

    Args:
        nodes_m: Nodes, z upward [m], shape [sample_count, node_count, 3].
        times_s: Times of the samples [s], shape [sample_count].
        mass_shares: Share of the mass at each node, shape [node_count].
        gravity: Gravity [m/s^2].
    """
    speed = np.gradient(nodes_m, times_s, axis=0)
    potential = gravity * (nodes_m[:, :, 2] - nodes_m[0, :, 2]) @ mass_shares
    total = potential + 0.5 * np.square(speed).sum(axis=2) @ mass_shares
    return Measurement(
        measured=100.0 * float(total.max() / max(-potential.min(), 1e-12)), expected=0.0
    )


def driver_poses(rollout: Recording) -> list[Pose]:
    """Return the pose that the scene's only driver prescribes at each sample."""
    (driver,) = rollout.scene.drivers
    start = rollout.scene.body(driver.body).pose
    return [driver.pose(start, float(time_s)) for time_s in rollout.times_s]


def driver_error(rollout: Recording, points_m: FloatArray) -> Measurement:
    """Measure the largest distance [mm] of points from where the scene's only driver would carry them.

    Args:
        rollout: The rollout.
        points_m: World positions of the points [m], shape [sample_count, point_count, 3].
    """
    (driver,) = rollout.scene.drivers
    places = rollout.scene.body(driver.body).pose.to_body(points_m[0])
    prescribed = np.array([pose.to_world(places) for pose in driver_poses(rollout)])

    error = largest_mm(points_m - prescribed)
    shifted = {
        "it comes one interval (1/180 s) late": largest_mm(
            points_m[1:] - prescribed[:-1]
        ),
        "it comes one interval (1/180 s) early": largest_mm(
            points_m[:-1] - prescribed[1:]
        ),
    }
    hint = next((text for text, left in shifted.items() if left < 0.2 * error), "")
    return Measurement(measured=error, expected=0.0, hint=hint)


def attachment_error(rollout: Recording, name: str) -> Measurement:
    """Measure the largest distance [mm] of a hanging body's upper nodes from their places on the driven body."""
    nodes = rollout.nodes_m[name]
    attached = nodes[0, :, 2] > nodes[0, :, 2].max() - PLACE_TOLERANCE_M
    found = driver_error(rollout, nodes[:, attached])
    jump_mm = largest_mm(nodes[1] - nodes[0])
    fallen_mm = 1e3 * float((nodes[0] - nodes[-1])[attached, 2].mean())
    free_mm = 500.0 * rollout.scene.gravity_m_per_s2 * float(rollout.times_s[-1]) ** 2
    if jump_mm > 10.0:
        return replace(
            found,
            hint=f"nodes jump by {jump_mm:.3g} mm in the first interval: their order changes",
        )
    if fallen_mm > 0.5 * free_mm:
        return replace(found, hint="the body falls: the attachment is missing")
    return found
