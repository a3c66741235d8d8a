"""Quasi-static push of a rigid body on a table through one sticking point: the law of least friction power.

A slow body moves such that the power of friction is least among all motions that the pusher allows (Goyal, Ruina and
Papadopoulos 1991; Peshkin and Sanderson 1989). The coefficient of friction is a factor of that power, so it cancels:
only where the pressure is decides how the body turns.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

FloatArray = NDArray[np.float64]


def turn_rate(
    point_m: FloatArray,
    velocity: FloatArray,
    supports_m: FloatArray,
    weights: FloatArray,
) -> float:
    """Return the rate of rotation [rad/s] of a body that a point pushes.

    Args:
        point_m: Point of the push in the plane of the table [m], shape [2].
        velocity: Its velocity, which the body has there [m/s], shape [2].
        supports_m: Points on which the body rests [m], shape [S, 2].
        weights: Their shares of the weight, shape [S].
    """
    arms_m = supports_m - point_m
    normals = np.column_stack([-arms_m[:, 1], arms_m[:, 0]])

    def power(rate: float) -> float:
        return float(weights @ np.linalg.norm(velocity + rate * normals, axis=1))

    # The power is convex in the rate, and least where some support rests or moves slower than the pusher.
    bound = (
        4.0 * float(np.linalg.norm(velocity)) / float(np.ptp(supports_m, axis=0).max())
    )
    return float(
        minimize_scalar(
            power, bounds=(-bound, bound), method="bounded", options={"xatol": 1e-10}
        ).x
    )


def ellipsoid_turn_rate(
    point_m: FloatArray, velocity: FloatArray, length_m: float
) -> float:
    """Return the rate of the ellipsoidal limit surface (Lynch, Maekawa and Tanie 1992), in closed form.

    Args:
        point_m: Point of the push from the centre of friction [m], shape [2].
        velocity: Its velocity [m/s], shape [2].
        length_m: Largest moment of friction over the largest force [m].
    """
    moment = point_m[0] * velocity[1] - point_m[1] * velocity[0]
    return float(moment / (length_m**2 + point_m @ point_m))


def turn_of_push(
    offset_m: float, path_m: float, half_edge_m: float, *, steps: int = 300
) -> float:
    """Return the rotation [rad] of a square on its four corners that a point pushes straight on.

    Args:
        offset_m: Distance of the point from the middle of the face, to the left.
        path_m: Path of the point, along the first normal of the face.
        half_edge_m: Half the edge of the square.
        steps: Steps of the path.
    """
    corners_m = half_edge_m * np.array(
        [[-1.0, -1.0], [-1.0, 1.0], [1.0, -1.0], [1.0, 1.0]]
    )
    point_m, weights, angle = np.array([-half_edge_m, offset_m]), np.full(4, 0.25), 0.0
    for _ in range(steps):
        # In the frame of the body, where the point stays, the pusher turns back.
        push = np.array([np.cos(angle), -np.sin(angle)])
        angle += turn_rate(point_m, push, corners_m, weights) * path_m / steps
    return angle
