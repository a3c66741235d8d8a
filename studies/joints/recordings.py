"""Recorded trials of joints: pendulums and the SO-101."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gauge_envs.files import data_folder
from gauge_envs.scene.geometry import FloatArray

HERE = Path(__file__).parent
DATA = data_folder("scoring") / "single_shot"


@dataclass(frozen=True)
class Trial:
    """One recording.

    Attributes:
        name: Name in the source.
        times_s: Times of the frames from 0, shape [T].
        angles_rad: Angles, shape [T, J].
        start_rates: Rates at the first frame [rad/s], shape [J].
        commands: Commanded angles [rad] or torques [N m], shape [T, J]; None where nothing is driven.
    """

    name: str
    times_s: FloatArray
    angles_rad: FloatArray
    start_rates: FloatArray
    commands: FloatArray | None

    @property
    def interval_s(self) -> float:
        """Time between frames [s]."""
        return float(self.times_s[1])


def trials(name: str) -> list[Trial]:
    """Return the recorded trials of an experiment; even ones are for fits, odd ones judge."""
    sidecar = tomllib.loads((DATA / f"{name}.toml").read_text(encoding="utf-8"))
    with np.load(DATA / f"{name}.npz") as archive:
        data = dict(archive)
    found = []
    for k, title in enumerate(sidecar["trials"]):
        rows = slice(*data["first"][k : k + 2])
        angles = sidecar["angle_unit_rad"] * data["angle"][rows].astype(float)
        commands = (
            sidecar["command_unit"] * data["command"][rows]
            if "command" in data
            else None
        )
        times_s = data["interval_s"][k] * np.arange(len(angles))
        found.append(
            Trial(
                title,
                times_s,
                angles,
                data["start_angle_rate"][k].astype(float),
                commands,
            )
        )
    return found
