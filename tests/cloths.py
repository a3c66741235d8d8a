"""Sheets of the measured fabrics and the elastica under its own weight, for the tests of every engine."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from foam import ORIGIN
from numpy.typing import NDArray
from scipy.integrate import solve_bvp

from gauge_envs import load_experiment
from gauge_envs.backends.shared.attachments import RigidAttachment
from gauge_envs.scene import Cloth, Motion, Pose, Region

FABRICS = ("rayon", "satin", "uniform", "nylon", "oxford", "leather")
CELL_M = 0.025


def fabric(name: str, size_m: tuple[float, float], pose: Pose = ORIGIN) -> Cloth:
    """A sheet of a measured fabric."""
    cloth = load_experiment(f"TextileFlinging-{name}").scene.deformables[0]
    assert isinstance(cloth, Cloth)
    return replace(cloth, size_m=size_m, pose=pose)


def pinned(axis: str, side: str = "low", depth_m: float = 0.0) -> RigidAttachment:
    """An edge that the world holds."""
    region = Region(axis=axis, side=side, depth_m=depth_m)  # type: ignore[arg-type]
    return RigidAttachment(
        region=region, body="frame", motion=Motion.FIXED, pose=ORIGIN
    )


def heavy_elastica_sag_m(
    load_per_bending: float, length_m: float, bare_m: float = 0.0
) -> float:
    """How far the tip of a clamped horizontal strip sinks under its own weight.

    Args:
        load_per_bending: Weight per length over bending stiffness [1/m^3], both of the whole width or of a unit.
        length_m: Length of the strip.
        bare_m: Length next to the clamp that has no weight.
    """

    def slope(
        s: NDArray[np.float64], state: NDArray[np.float64], share: float
    ) -> NDArray[np.float64]:
        beyond = length_m - np.maximum(s, bare_m)
        moment = -share * load_per_bending * beyond * np.cos(state[0])
        return np.vstack([state[1], moment, np.sin(state[0])])

    s, state = np.linspace(0.0, length_m, 200), np.zeros((3, 200))
    for share in np.linspace(0.1, 1.0, 10):
        solution = solve_bvp(
            lambda s, state, share=share: slope(s, state, share),
            lambda start, end: np.array([start[0], end[1], start[2]]),
            s,
            state,
            tol=1e-7,
            max_nodes=20000,
        )
        assert solution.success
        s, state = solution.x, solution.y
    return abs(float(state[2, -1]))
