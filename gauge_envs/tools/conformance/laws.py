"""Closed forms, reference integrations and fits to which the checks compare an engine."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation
from scipy.special import ellipk

from gauge_envs.scene import GRAVITY_M_PER_S2 as G, Box, RigidBody

PLACE_TOLERANCE_M = 1e-5
"""Distance within which a node is on a line; single precision rounds positions to about 0.1 um at 1 m."""


def box_inertia_kg_m2(body: RigidBody) -> NDArray[np.float64]:
    """Return the moments of inertia of a solid box about its own axes [kg m^2], shape [3]."""
    assert isinstance(body.shape, Box), "the body is a box"
    x, y, z = np.square(body.shape.size_m)
    return body.mass_kg / 12.0 * np.array([y + z, x + z, x + y])


def world_inertia_kg_m2(moments: NDArray[np.float64], rotation: Rotation) -> NDArray[np.float64]:
    """Return the inertia tensor in the world frame [kg m^2], shape [..., 3, 3], of principal moments."""
    matrix = rotation.as_matrix()
    return np.asarray(np.einsum("...ij,j,...kj->...ik", matrix, moments, matrix))


def pendulum_period_s(*, length_m: float, gyration_m: float, amplitude_rad: float, gravity_m_per_s2: float) -> float:
    """Return the exact period [s] of a physical pendulum at a finite amplitude, by the complete elliptic integral.

    Args:
        length_m: Distance of the centre of mass from the axis [m].
        gyration_m: Radius of gyration about the centre of mass [m].
        amplitude_rad: Largest angle from the vertical [rad].
        gravity_m_per_s2: Gravity [m/s^2].
    """
    small = np.sqrt((length_m**2 + gyration_m**2) / (gravity_m_per_s2 * length_m))
    return float(4.0 * small * ellipk(np.sin(0.5 * amplitude_rad) ** 2))


def torque_free_orientation(
    *, start: Rotation, spin_rad_per_s: NDArray[np.float64], moments: NDArray[np.float64], seconds: float
) -> Rotation:
    """Return the orientation of a free body after a time, from Euler's equations integrated to 1e-10.

    Args:
        start: Orientation at the start.
        spin_rad_per_s: Angular velocity at the start in the world frame [rad/s], shape [3].
        moments: Principal moments of inertia about the body axes [kg m^2], shape [3].
        seconds: Time of the rotation [s].
    """

    def rate(_: float, state: NDArray[np.float64]) -> NDArray[np.float64]:
        w, v, spin = state[0], state[1:4], state[4:]
        quaternion_rate = 0.5 * np.concatenate([[-v @ spin], w * spin + np.cross(v, spin)])
        return np.concatenate([quaternion_rate, -np.cross(spin, moments * spin) / moments])

    first = np.concatenate([start.as_quat(scalar_first=True), start.apply(spin_rad_per_s, inverse=True)])
    last = solve_ivp(rate, (0.0, seconds), first, rtol=1e-10, atol=1e-12, method="DOP853").y[:, -1]
    return Rotation.from_quat(last[:4], scalar_first=True)


def friction_of_slide(acceleration_m_per_s2: float, slope_rad: float, lift_m_per_s2: float = 0.0) -> float:
    """Return the coefficient with which Coulomb's law gives an acceleration down a slope: (g sin - a) / (g cos + b).

    Args:
        acceleration_m_per_s2: Acceleration a down the slope.
        slope_rad: Slope [rad].
        lift_m_per_s2: Acceleration b off the slope, which adds to the force on the slope. Means over a time will do, if
            both have the same weights: a body that hops gets its friction from its impacts.
    """
    return (G * math.sin(slope_rad) - acceleration_m_per_s2) / (G * math.cos(slope_rad) + lift_m_per_s2)


def spin_from_orientations(rotations: Rotation, interval_s: float) -> NDArray[np.float64]:
    """Return angular velocities in the world frame [rad/s] by central differences, shape [sample_count - 2, 3]."""
    return np.asarray((rotations[2:] * rotations[:-2].inv()).as_rotvec() / (2.0 * interval_s))


def cantilever_load_over_stiffness(
    s_m: NDArray[np.float64], droop_m: NDArray[np.float64], *, length_m: float, weights: NDArray[np.float64]
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


def coefficient(values: NDArray[np.float64], *columns: NDArray[np.float64]) -> float:
    """Return the coefficient of the first of the columns in a least-squares fit."""
    return float(np.linalg.lstsq(np.column_stack(columns), values, rcond=None)[0][0])


def hann_mean(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the mean over the first axis under a Hann window: the centre of an oscillation, damped or not.

    An oscillation with two or more whole periods in the window averages to zero. With any number of periods from four
    on, less than 1 % is left. A plain mean would leave several per cent.
    """
    weights = np.hanning(len(values) + 2)[1:-1]
    return np.asarray(np.tensordot(weights / weights.sum(), values, axes=1))
