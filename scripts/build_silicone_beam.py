"""Build the bands of the silicone beam (`scoring/bands/SiliconeBeam-*`) from the facts.

The facts are heights of the three markers at the end of the beam, 100 Hz; `scoring/facts/silicone_beam.toml` says where
they are from. The beam is level before it is let go.

The end of a straight beam starts to fall like a free body, with or without a load: its curvature is 0, so nothing holds
it but the clamp. The time of the release follows from the depth of the first frames after it. Each release is
interpolated at 30 Hz from that time on. The band is the mean of the two releases of a load. Its sigma is their pooled
standard deviation over all frames: two releases tell no scatter frame by frame.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.scene import GRAVITY_M_PER_S2
from gauge_envs.scene.timing import FRAME_RATE_HZ
from scripts.generated import SCORING, frame_table

RATE_HZ = 100.0
FRAMES = 76
HELD_FRAMES = 20
"""Frames before the release that the facts hold."""

RELEASE_STD_S = 0.002
"""Standard uncertainty of the time of a release [s]: spread of the times that its first frames give."""

NOISE_MM = 0.03
"""Standard deviation of a height while the beam is held [mm]."""

COLUMNS = ("load", "release", "frame", "top_mm", "right_mm", "left_mm")
SOURCE = "srl-ethz/diffPD_sim2real, commit 825e7b7, python/realbeam_experiments/Measurement_data, MIT licence"


@dataclass(frozen=True)
class Release:
    """One release as recorded.

    Attributes:
        heights_mm: Heights of the markers at the top and the two sides of the end [mm], shape [frame_count, 3].
    """

    heights_mm: FloatArray

    def depth_mm(self) -> FloatArray:
        """Return the height of the end's centre line over its held one [mm], shape [frame_count]; negative below it."""
        end = self.heights_mm[:, 1:].mean(axis=1)
        return end - end[: HELD_FRAMES - 8].mean()

    def start_s(self) -> tuple[float, float]:
        """Return the time of the release after the first frame, and the spread of the frames that it is from [s]."""
        depth_m = -1e-3 * self.depth_mm()
        falling = np.flatnonzero((depth_m > 2e-4) & (depth_m < 4.5e-3))
        falling = falling[falling < HELD_FRAMES + 5]
        times_s = falling / RATE_HZ - np.sqrt(2.0 * depth_m[falling] / GRAVITY_M_PER_S2)
        return float(times_s.mean()), float(times_s.std())

    def at_frames(self) -> FloatArray:
        """Return the height of the end over its held one at the 30 Hz frames after the release [mm]."""
        times_s = np.arange(len(self.heights_mm)) / RATE_HZ
        return CubicSpline(times_s, self.depth_mm())(
            self.start_s()[0] + np.arange(FRAMES) / FRAME_RATE_HZ
        )


def releases(facts: Path) -> dict[str, list[Release]]:
    """Return the two releases of each load."""
    heights: dict[tuple[str, str], list[list[float]]] = {}
    with facts.open(encoding="utf-8", newline="") as stream:
        for row in csv.DictReader(stream):
            heights.setdefault((row["load"], row["release"]), []).append(
                [float(row[name]) for name in COLUMNS[3:]]
            )
    found: dict[str, list[Release]] = {}
    for (load, _), values in heights.items():
        found.setdefault(load, []).append(Release(np.array(values)))
    return found


def contents(scoring: Path = SCORING) -> dict[Path, str]:
    """Return the text of every generated file."""
    files = {}
    for load, both in releases(scoring / "facts" / "silicone_beam.csv").items():
        variant = f"SiliconeBeam-{load}-silicone"
        # The end starts at a height of 200 mm in the task.
        ends = 200.0 + np.array([release.at_frames() for release in both])
        mean = ends.mean(axis=0)
        sigma = float(
            np.sqrt(np.square(ends - mean).sum() / (ends.shape[1] * (len(ends) - 1)))
        )
        uncertainty = np.hypot(
            NOISE_MM, RELEASE_STD_S * FRAME_RATE_HZ * np.gradient(mean)
        )
        files[scoring / "bands" / f"{variant}.csv"] = frame_table(
            ["mean.end.z", "uncertainty.end.z"],
            np.column_stack([mean, uncertainty]),
            decimals=4,
        )
        files[scoring / "bands" / f"{variant}.toml"] = sidecar_text(sigma)
        names = [f"trial.{k + 1}.end.z" for k in range(len(both))]
        files[scoring / "trials" / f"{variant}.csv"] = frame_table(
            names, ends.T, decimals=4
        )
    return files


def sidecar_text(sigma: float) -> str:
    """Return the text of the sidecar of a band."""
    return "\n".join(
        [
            "# Written by scripts/build_silicone_beam.py; do not edit.",
            'grade = "trials"',
            'sigma_source = "trials"',
            f"sigma = {sigma:.4f}  # pooled over all frames and both releases",
            'unit = "mm"',
            "trial_count = 2",
            'coordinates = ["end.z"]',
            "projection = [[0, 0, 0, 0, 0, 0.5, 0, 0, 0.5]]  # mean height of the two markers at the sides",
            f'source = "{SOURCE}; two releases"',
            "",
        ]
    )
