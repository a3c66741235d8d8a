"""Build the recorded tosses of a cube (`scoring/single_shot/CubeToss-acrylic`) from the file of their authors.

    python scripts/build_tosses.py SOURCE            writes the files
    python scripts/build_tosses.py SOURCE --check    fails if a file differs from what SOURCE gives

SOURCE is a NumPy archive with the processed tosses of DAIRLab/contact-nets: `toss`, the number of each row's toss, and
`state`, position, quaternion w x y z, velocity and body-frame angular velocity. Lengths are over the half width.

Stored are positions in counts of 0.02 mm and quaternions in counts of 1/32767, both below the noise. Velocities at the
first frame come from the frames before contact: a parabola with the known acceleration of gravity through the scaled
positions, and a constant rate of rotation, which a body of three equal moments has in free flight. Recorded velocities
are backward differences, hence late by half an interval and noisier. All nuisances are fitted on even trials; odd
trials judge.

The sidecar names tosses that repeat an earlier one (`toss_copies.py`). The even ones among them take part in the fit of
the nuisances, so that starts stay what they were before these tosses were known: the script prints what the fit gives
without them.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from toss_copies import copies
from toss_files import (
    QUATERNION_COUNTS,
    RATE_HZ,
    REST_FRAMES,
    median_error,
    sidecar_head,
    slope_error,
    spread,
    write_or_check,
)

from gauge_envs.scene.scene import GRAVITY_M_PER_S2

NAME = "CubeToss-acrylic"
HALF_WIDTH_M = 0.0524
POSITION_UNIT_M = 2e-5
CLEAR_M = 0.004
"""Height of the lowest corner above which a cube counts as flying, about its deepest recorded penetration."""

LEAST_FLIGHT = 8
"""Frames of flight from which on an acceleration is fitted."""

SOURCE_TEXT = (
    "processed tosses of an acrylic cube, DAIRLab/contact-nets, commit c3dc21c, data/tosses_processed, "
    "without the numbers k with k % 8 = 7"
)

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Toss:
    """One toss as recorded: SI units, without corrections."""

    number: int
    positions_m: FloatArray
    rotations: Rotation
    velocities: FloatArray
    rates_body: FloatArray

    @property
    def corners_m(self) -> FloatArray:
        """Corners of the cube, shape [T, 8, 3]."""
        signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
        turned: FloatArray = np.einsum(
            "tij,vj->tvi", self.rotations.as_matrix(), HALF_WIDTH_M * signs
        )
        return self.positions_m[:, None] + turned

    @property
    def flight(self) -> int:
        """Number of frames before the cube is near the table."""
        low = self.corners_m[:, :, 2].min(axis=1) < CLEAR_M
        return int(np.argmax(low)) if low.any() else len(low)

    def flight_times_s(self, least: int = 0) -> FloatArray:
        """Return the times of the flying frames [s]; at least `least` of them."""
        return np.arange(max(self.flight, least)) / RATE_HZ


def read_tosses(source: Path) -> list[Toss]:
    """Return the tosses of the source file."""
    with np.load(source) as archive:
        numbers, states = archive["toss"], archive["state"]
    tosses = []
    for number in np.unique(numbers):
        state = states[numbers == number]
        rotations = Rotation.from_quat(state[:, 3:7], scalar_first=True)
        scaled = HALF_WIDTH_M * state[:, [0, 1, 2, 7, 8, 9]]
        tosses.append(
            Toss(int(number), scaled[:, :3], rotations, scaled[:, 3:], state[:, 10:13])
        )
    return tosses


def nuisances(fit: list[Toss]) -> dict[str, float]:
    """Return the nuisances, fitted on some trials."""
    flights = [toss for toss in fit if toss.flight >= LEAST_FLIGHT]
    fall, residuals, turning, lags = [], [], [], []
    for toss in flights:
        times_s = toss.flight_times_s()
        count = len(times_s)
        line = np.polyfit(times_s, toss.positions_m[:count], 2)
        fall.append(-2.0 * line[0, 2])
        fitted = np.vander(times_s, 3) @ line
        residuals.append(
            (toss.positions_m[:count] - fitted) * np.sqrt(count / (count - 3.0))
        )
        lags.append((toss.velocities[0, 2] - line[1, 2]) / fall[-1])
        turned = (toss.rotations[:count] * toss.rotations[0].inv()).as_rotvec()
        rate = np.polyfit(times_s, turned, 1)
        turning.append(
            (turned - np.vander(times_s, 2) @ rate) * np.sqrt(count / (count - 2.0))
        )
    accelerations = np.array(fall)
    scale = GRAVITY_M_PER_S2 / float(np.median(accelerations))
    rest_m = np.array(
        [scale * toss.positions_m[-REST_FRAMES:, 2].mean() for toss in fit]
    )
    upward = np.array([np.abs(toss.rotations[-1].as_matrix()[2]).max() for toss in fit])
    noise_m = scale * spread(np.concatenate(residuals).ravel())
    noise_rad = spread(np.concatenate(turning).ravel())
    errors = [slope_error(len(toss.flight_times_s(4))) for toss in fit]
    return {
        "length_scale": scale,
        "length_scale_std_error": scale * median_error(accelerations),
        "height_offset_m": HALF_WIDTH_M - float(np.median(rest_m)),
        "velocity_lag_s": float(np.median(lags)),
        "position_noise_m": noise_m,
        "rotation_noise_deg": float(np.degrees(noise_rad)),
        "rest_height_std_m": spread(rest_m),
        "rest_tilt_deg": float(
            np.degrees(np.sqrt(np.mean(np.arccos(np.minimum(upward, 1.0)) ** 2)))
        ),
        "start_velocity_std_m_per_s": noise_m * float(np.median(errors)),
        "start_angular_velocity_std_rad_per_s": noise_rad * float(np.median(errors)),
    }


def start_of(toss: Toss, scale: float) -> tuple[FloatArray, FloatArray]:
    """Return velocity [m/s] in the world and angular velocity [rad/s] in the body frame at the first frame."""
    times_s = toss.flight_times_s(least=4)
    count = len(times_s)
    straight = scale * toss.positions_m[:count]
    straight[:, 2] += 0.5 * GRAVITY_M_PER_S2 * np.square(times_s)
    # In the axes of the body, which are those of the world at the first frame turned by its orientation.
    turned = (toss.rotations[0].inv() * toss.rotations[:count]).as_rotvec()
    return np.polyfit(times_s, straight, 1)[0], np.polyfit(times_s, turned, 1)[0]


def arrays_of(tosses: list[Toss], scale: float) -> dict[str, NDArray[np.generic]]:
    """Return the arrays of the data file."""
    starts = [start_of(toss, scale) for toss in tosses]
    quaternions = np.concatenate(
        [toss.rotations.as_quat(scalar_first=True) for toss in tosses]
    )
    return {
        "source_number": np.array([toss.number for toss in tosses], dtype=np.int16),
        "first": np.cumsum(
            [0, *(len(toss.positions_m) for toss in tosses)], dtype=np.int32
        ),
        "position": np.round(
            np.concatenate([t.positions_m for t in tosses]) / POSITION_UNIT_M
        ).astype(np.int16),
        "quaternion": np.round(quaternions * QUATERNION_COUNTS).astype(np.int16),
        "start_velocity": np.array([linear for linear, _ in starts], dtype=np.float32),
        "start_angular_velocity_body": np.array(
            [angular for _, angular in starts], dtype=np.float32
        ),
    }


def sidecar_text(
    source: Path, count: int, repeats: dict[int, int], found: dict[str, float]
) -> str:
    """Return the text of the sidecar."""
    head = sidecar_head(
        source,
        script="build_tosses.py",
        name=NAME,
        body="cube",
        trial_count=count,
        position_unit_m=POSITION_UNIT_M,
        origin=SOURCE_TEXT,
        copies=repeats,
    )
    lines = [
        *head,
        "[nuisances]",
        *(f"{name} = {value:.6g}" for name, value in found.items()),
    ]
    return "\n".join(lines) + "\n"


def generate(source: Path) -> tuple[dict[str, NDArray[np.generic]], str]:
    """Return the arrays of the data file and the text of the sidecar."""
    tosses = read_tosses(source)
    repeats = copies([toss.corners_m for toss in tosses])
    found = nuisances(tosses[::2])
    without = nuisances(
        [
            toss
            for trial, toss in enumerate(tosses)
            if trial % 2 == 0 and trial not in repeats
        ]
    )
    for name, value in found.items():
        print(f"{name}: {value:.6g}, without copies {without[name]:.6g}")
    # The text rounds the scale, and the start velocities contain it.
    scale = float(f"{found['length_scale']:.6g}")
    return arrays_of(tosses, scale), sidecar_text(source, len(tosses), repeats, found)


def main() -> int:
    """Write the files, or check that they are current."""
    return write_or_check(
        generate,
        name=NAME,
        script="build_tosses.py",
        what="Build the recorded tosses of a cube.",
    )


if __name__ == "__main__":
    sys.exit(main())
