"""Frames of bodies: Bullet has that of the centre of mass, along the principal axes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation


@dataclass(frozen=True)
class Handle:
    """A body in PyBullet.

    Attributes:
        body: PyBullet's number of the body.
        link: Number of its link; -1 is the base.
        offset_m: Position of Bullet's frame, which is that of the centre of mass, in the body frame [m].
        turn: Rotation from Bullet's frame to the body frame.
    """

    body: int
    link: int
    offset_m: NDArray[np.float64]
    turn: Rotation


@dataclass(frozen=True)
class Frame:
    """Mass properties of a body.

    Attributes:
        centre_m: Centre of mass in the body frame [m].
        axes: Rotation from the principal axes, which Bullet's frame has, to the body frame.
        moments: Principal moments of inertia [kg units^2].
    """

    centre_m: NDArray[np.float64]
    axes: Rotation
    moments: list[float]
