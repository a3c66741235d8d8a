"""Build the bands of cubes that a turntable throws off (`scoring/bands/Turntable-2-*`), by Coulomb's law of friction.

The cube is rigid, and the plate turns as the scene's driver says. At each point of the base, friction is mu times the
pressure, against the sliding there. How pressure spreads under a rigid base is not known. Its moment gives its centre:
mu times the height of the cube's centre away from the middle, towards the sliding. The mean has four points with the
second moment of a uniform pressure, half the width / sqrt(3) from the middle. What four corners would change is part of
the uncertainty. The law ends when a corner of the base leaves the plate.

Coulomb's step at rest is a ramp up to 1 um/s, so that the carried cube lags by less than a micrometre.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

from gauge_envs import load_experiment
from gauge_envs.references.sensitivities import input_uncertainties
from gauge_envs.scene import Box, Cylinder
from gauge_envs.scene.geometry import BoolArray, FloatArray
from gauge_envs.scene.timing import FRAME_RATE_HZ
from scripts.generated import SCORING

MATERIALS = ("wood", "plastic", "metal")
MEASUREMENT_MM = 1.0
"""Nominal uncertainty of a measured coordinate [mm]: the paper states motion capture of millimeter precision."""

RAMP_M_PER_S = 1e-6
"""Speed of sliding below which friction is proportional to it [m/s]."""

CORNERS = np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]])

SOURCE = (
    "cube: carried by the plate until friction is exceeded, then Coulomb sliding of a rigid cube on the turning plate, "
    "until a corner of its base leaves the plate; the plate's motion is nominal, and its uncertainty is not contained; "
    "sigma is that of motion capture, friction, start and spread of the pressure"
)


@dataclass(frozen=True, kw_only=True)
class Slider:
    """A cube on a level turning plate.

    Attributes:
        material: Material of the cube.
        point_m: Distance of the four points of pressure from the middle of the base, along its axes [m].
        height_m: Height of the cube's centre above the plate [m].
        friction_ratio: Friction over the calibrated one.
        shift_m: Shift of the start [m], shape [2].
    """

    material: str
    point_m: float = 0.025 / np.sqrt(3.0)
    height_m: float = 0.025
    friction_ratio: float = 1.0
    shift_m: tuple[float, float] = (0.0, 0.0)

    def positions_mm(self) -> tuple[FloatArray, BoolArray]:
        """Return the positions of the cube's centre [mm], shape [frame_count, 3], and when its base is on the plate."""
        experiment = load_experiment(f"Turntable-2-{self.material}", drivers="bundled")
        scene = experiment.scene
        cube, plate, (driver,) = scene.body("cube"), scene.body("plate"), scene.drivers
        assert isinstance(cube.shape, Box) and isinstance(plate.shape, Cylinder)
        (turning,) = driver.motions
        (contact,) = (
            one for one in scene.contacts if "plate" in (*one.first, *one.second)
        )
        friction = self.friction_ratio * contact.friction
        half_m, gravity = 0.5 * cube.shape.size_m[0], scene.gravity_m_per_s2
        squared_radius_of_gyration = 2.0 * (2.0 * half_m) ** 2 / 12.0
        start, axle = (
            np.array(cube.pose.position_m),
            np.array(plate.pose.position_m)[:2],
        )
        heading = float(cube.pose.rotation.as_rotvec()[2])

        def rate(time_s: float, state: FloatArray) -> list[float]:
            place, velocity, heading, spin = state[:2], state[2:4], state[4], state[5]
            points = self.point_m * CORNERS @ turned(heading)
            omega, arm = turning.rate(time_s), place + points - axle
            sliding = velocity + spin * across(points) - omega * across(arm)
            direction = (
                sliding
                / np.sqrt(np.square(sliding).sum(axis=1) + RAMP_M_PER_S**2)[:, None]
            )
            # Pressure is linear in the place. Its centre is at height * friction / weight, and friction depends on it.
            lever = friction * self.height_m
            moment = lever * (direction.T @ points) / (4.0 * self.point_m**2)
            centre = np.linalg.solve(np.eye(2) - moment, lever * direction.mean(axis=0))
            shares = 0.25 * (1.0 + points @ centre / self.point_m**2)
            pull = -friction * gravity * shares[:, None] * direction
            torque = float((across(points) * pull).sum())
            return [
                *velocity,
                *pull.sum(axis=0),
                spin,
                torque / squared_radius_of_gyration,
            ]

        times_s = np.arange(experiment.frame_count) / FRAME_RATE_HZ
        begin = [*(start[:2] + self.shift_m), 0.0, 0.0, heading, 0.0]
        span = (0.0, float(times_s[-1]))
        found = solve_ivp(
            rate, span, begin, "LSODA", times_s, rtol=1e-9, atol=1e-11, max_step=2e-3
        )
        places = found.y[:2].T
        corners = (
            np.array([half_m * CORNERS @ turned(angle) for angle in found.y[4]])
            + (places - axle)[:, None]
        )
        is_on_plate = (
            np.linalg.norm(corners, axis=2).max(axis=1) <= plate.shape.radius_m
        )
        heights = np.full(len(places), start[2])
        return 1e3 * np.column_stack([places, heights]), np.logical_and.accumulate(
            is_on_plate
        )


def turned(angle: float) -> FloatArray:
    """Return the matrix that turns rows about z."""
    return np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])


def across(rows: FloatArray) -> FloatArray:
    """Return rows turned by a right angle about z."""
    return np.column_stack([-rows[:, 1], rows[:, 0]])


def uncertainty_mm(material: str, mean: FloatArray) -> FloatArray:
    """Return the standard uncertainty of a coordinate at each frame [mm], shape [frame_count, 3]."""
    inputs = input_uncertainties()
    friction, start_m = inputs.friction.relative[material], inputs.start.std
    changed = [
        (
            Slider(material=material, friction_ratio=1.0 + friction),
            Slider(material=material, friction_ratio=1.0 - friction),
        ),
        (Slider(material=material, shift_m=(start_m, 0.0)),),
        (Slider(material=material, shift_m=(0.0, start_m)),),
        (Slider(material=material, point_m=0.025),),
    ]
    squares = [
        np.mean([np.square(one.positions_mm()[0] - mean) for one in pair], axis=0)
        for pair in changed
    ]
    return np.asarray(
        np.maximum.accumulate(
            np.sqrt(MEASUREMENT_MM**2 + np.sum(squares, axis=0)), axis=0
        )
    )


def contents(scoring: Path = SCORING) -> dict[Path, str]:
    """Return the files of the bands with their text."""
    files = {}
    for material in MATERIALS:
        mean, is_known = Slider(material=material).positions_mm()
        uncertainty = uncertainty_mm(material, mean)
        header = [
            f"{quantity}.{axis}"
            for quantity in ("mean", "uncertainty")
            for axis in "xyz"
        ]
        rows = [",".join(["frame", "time_s", "measured", *header])]
        for frame in np.flatnonzero(is_known):
            numbers = [f"{value:.3f}" for value in (*mean[frame], *uncertainty[frame])]
            rows.append(
                ",".join([str(frame), f"{frame / FRAME_RATE_HZ:.6f}", "1", *numbers])
            )
        table = scoring / "bands" / f"Turntable-2-{material}.csv"
        files[table] = "\n".join(rows) + "\n"
        files[table.with_suffix(".toml")] = "\n".join(
            [
                f"# Written by scripts/{Path(__file__).name}; do not edit.",
                'grade = "law"',
                'sigma_source = "measurement"',
                'unit = "mm"',
                f"frames = {len(mean)}",
                'coordinates = ["x", "y", "z"]',
                "normalized_by_baseline = false",
                f'source = "{SOURCE}"',
                "",
            ]
        )
    return files
