"""What the checks compare with: closed forms and independent integrations."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation
from scipy.special import ellipk

from gauge_envs.scene import Box

__all__ = [
    "PLACE_TOLERANCE_M",
    "box_inertia_kg_m2",
    "cantilever_load_over_stiffness",
    "hann_mean",
    "pendulum_period_s",
    "spin_from_orientations",
    "torque_free_orientation",
    "world_inertia_kg_m2",
]

PLACE_TOLERANCE_M = 1e-5
"""Within this a node is on a line: single precision rounds places to about 0.1 um at 1 m."""


def box_inertia_kg_m2(shape: Box, mass_kg: float) -> NDArray[np.float64]:
    """Moments of inertia of a solid box about its own axes, shape [3]."""
    x, y, z = np.square(shape.size_m)
    return mass_kg / 12.0 * np.array([y + z, x + z, x + y])


def world_inertia_kg_m2(moments: NDArray[np.float64], rotation: Rotation) -> NDArray[np.float64]:
    """Inertia tensor in the world frame, shape [..., 3, 3], of principal moments in turned body frames."""
    turn = rotation.as_matrix()
    return np.asarray(np.einsum("...ij,j,...kj->...ik", turn, moments, turn))


def pendulum_period_s(*, length_m: float, gyration_m: float, amplitude_rad: float, gravity_m_per_s2: float) -> float:
    """Exact period of a physical pendulum at a finite amplitude, by the complete elliptic integral.

    Args:
        length_m: Distance of the centre of mass from the axis.
        gyration_m: Radius of gyration about the centre of mass.
        amplitude_rad: Largest angle from the vertical.
        gravity_m_per_s2: Gravity.
    """
    small = np.sqrt((length_m**2 + gyration_m**2) / (gravity_m_per_s2 * length_m))
    return float(4.0 * small * ellipk(np.sin(0.5 * amplitude_rad) ** 2))


def torque_free_orientation(
    *, start: Rotation, spin_rad_per_s: NDArray[np.float64], moments: NDArray[np.float64], seconds: float
) -> Rotation:
    """Orientation of a free body after a time: Euler's equations, integrated to 1e-10.

    Args:
        start: Orientation at the start.
        spin_rad_per_s: Angular velocity at the start in the world frame [rad/s], shape [3].
        moments: Principal moments of inertia about the body axes, shape [3].
        seconds: How long it turns [s].
    """

    def rate(_: float, state: NDArray[np.float64]) -> NDArray[np.float64]:
        w, v, spin = state[0], state[1:4], state[4:]
        turn = 0.5 * np.concatenate([[-v @ spin], w * spin + np.cross(v, spin)])
        return np.concatenate([turn, -np.cross(spin, moments * spin) / moments])

    first = np.concatenate([start.as_quat(scalar_first=True), start.apply(spin_rad_per_s, inverse=True)])
    last = solve_ivp(rate, (0.0, seconds), first, rtol=1e-10, atol=1e-12, method="DOP853").y[:, -1]
    return Rotation.from_quat(last[:4], scalar_first=True)


def spin_from_orientations(rotations: Rotation, interval_s: float) -> NDArray[np.float64]:
    """Angular velocity in the world frame [rad/s] by central differences, shape [sample_count - 2, 3]."""
    return np.asarray((rotations[2:] * rotations[:-2].inv()).as_rotvec() / (2.0 * interval_s))


def cantilever_load_over_stiffness(
    s_m: NDArray[np.float64], droop_m: NDArray[np.float64], *, length_m: float, weights: NDArray[np.float64]
) -> float:
    """Weight per length over bending stiffness of a drooping cantilever, fitted: D w'' = load (L - s)^2 / 2.

    The place and the slope of the clamp are left free in the fit, since a mesh's clamp acts up to a cell away from
    where it should.

    Args:
        s_m: Distances from the clamp, shape [node_count]; those in the clamp, which are negative, are left out.
        droop_m: Downward displacements, same shape.
        length_m: Free length L.
        weights: Share of the load that each node stands for, same shape.

    Returns:
        load / D [1/m^3].
    """
    free = s_m > -PLACE_TOLERANCE_M
    s, scale = s_m[free], np.sqrt(weights[free])
    columns = np.column_stack([(length_m - s) ** 4 / 24.0, np.ones(len(s)), s])
    fit = np.linalg.lstsq(columns * scale[:, None], droop_m[free] * scale, rcond=None)[0]
    return float(fit[0])


def hann_mean(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean over the first axis under a Hann window: the centre of an oscillation, damped or not.

    An oscillation of n whole periods in the window averages to zero for every n of two or more, and one of a broken
    number of periods to less than 1 % from four periods on. A plain mean would leave several per cent.
    """
    weights = np.hanning(len(values) + 2)[1:-1]
    return np.asarray(np.tensordot(weights / weights.sum(), values, axes=1))
