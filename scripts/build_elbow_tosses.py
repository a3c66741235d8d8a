"""Build the recorded tosses of two hinged blocks (`scoring/single_shot/ElbowToss-blocks`) from the authors' file.

    python scripts/build_elbow_tosses.py SOURCE            writes the files
    python scripts/build_elbow_tosses.py SOURCE --check    fails if a file differs from what SOURCE gives

SOURCE is a NumPy archive with the tosses of ebianchi/dair_pll: `toss`, the number of each row's toss, and `state`,
quaternion w x y z and position of the first block, angle of the hinge, body-frame angular velocity, velocity, and rate
of the hinge.

Stored are positions in counts of 0.1 mm, quaternions in counts of 1/32767, and angles in counts of pi/32767, all below
the noise. Tosses that do not begin in free flight are left out: those with fewer than `LEAST_FLIGHT` frames before the
table, and those whose centre of mass is `MOST_RESIDUAL_M` or more (root mean square) off a parabola with gravity.

Start velocities come from the frames before contact: those of two rigid bodies with a frictionless hinge that pass
closest to the frames, in the sense of a robust least-squares fit of pose and velocities. A toss that repeats an earlier
one (`toss_copies.py`) would be named in the sidecar; there is none. All nuisances are fitted on even trials without
such tosses; odd trials judge.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
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

NAME = "ElbowToss-blocks"
POSITION_UNIT_M = 1e-4
ANGLE_COUNTS = 32767.0 / np.pi

MASS_KG = 0.37
SIZE_M = np.array([0.1, 0.05, 0.05])
ANCHOR_ON_FIRST_M = np.array([-0.035, 0.06, 0.0])
ANCHOR_ON_SECOND_M = np.array([-0.035, 0.0, 0.0])
AXIS = np.array([0.0, 1.0, 0.0])
INERTIA_KG_M2 = MASS_KG / 12.0 * (np.sum(SIZE_M**2) - SIZE_M**2)
"""Moments of inertia of a uniform block."""

CLEAR_M = 0.015
"""Height of the lowest corner above which the blocks count as flying. Recorded heights scatter by several millimetres:
each toss is shifted so that its lowest corner ends at zero."""

LEAST_FLIGHT = 8
MOST_RESIDUAL_M = 3e-3
MOST_FLIGHT = 32
"""Largest number of frames that a start is fitted to."""

FLAT = 0.97
"""Least vertical component of a face normal of a block that lies flat."""

NOISE_M, NOISE_RAD = 2e-4, 5e-3
"""Weights of positions and angles in the fit of a start: about their scatter in flight."""

SOURCE_TEXT = (
    "tosses of two hinged blocks, ebianchi/dair_pll, commit 9a9514e, assets/contactnets_elbow, "
    "without the numbers k with k % 8 = 7"
)

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Toss:
    """One toss as recorded, without corrections."""

    number: int
    positions_m: FloatArray
    rotations: Rotation
    angles_rad: FloatArray
    velocities: FloatArray
    rates_body: FloatArray
    angle_rates: FloatArray

    @property
    def second(self) -> tuple[FloatArray, Rotation]:
        """Positions and orientations of the second block."""
        turned = self.rotations * Rotation.from_rotvec(np.outer(self.angles_rad, AXIS))
        anchor_m = self.positions_m + self.rotations.apply(ANCHOR_ON_FIRST_M)
        return anchor_m - turned.apply(ANCHOR_ON_SECOND_M), turned

    @property
    def centre_m(self) -> FloatArray:
        """Centre of mass of both blocks, shape [T, 3]."""
        return 0.5 * (self.positions_m + self.second[0])

    def corners_m(self) -> FloatArray:
        """Return the corners of each block, shape [2, T, 8, 3]."""
        signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
        blocks = ((self.positions_m, self.rotations), self.second)
        turned = [
            np.einsum("tij,vj->tvi", rotations.as_matrix(), 0.5 * SIZE_M * signs)
            for _, rotations in blocks
        ]
        return np.array(
            [
                place[:, None] + arms
                for (place, _), arms in zip(blocks, turned, strict=True)
            ]
        )

    def lowest_m(self) -> FloatArray:
        """Return the height of the lowest corner of each block, shape [2, T]."""
        lowest: FloatArray = self.corners_m()[..., 2].min(axis=2)
        return lowest

    @property
    def flight(self) -> int:
        """Number of frames before a block is near the table."""
        low = self.lowest_m().min(axis=0) < CLEAR_M
        return int(np.argmax(low)) if low.any() else 0

    def line(self, gravity: float) -> tuple[FloatArray, FloatArray]:
        """Return the centre's velocity at the first frame [m/s], and its residuals from a parabola [m]."""
        times_s = np.arange(self.flight) / RATE_HZ
        straight = self.centre_m[: self.flight].copy()
        straight[:, 2] += 0.5 * gravity * times_s**2
        fit = np.polyfit(times_s, straight, 1)
        return fit[0], straight - np.vander(times_s, 2) @ fit


def read_tosses(source: Path) -> list[Toss]:
    """Return the tosses of the source file."""
    with np.load(source) as archive:
        numbers, states = archive["toss"], archive["state"]
    tosses = []
    for number in np.unique(numbers):
        state = states[numbers == number]
        rotations = Rotation.from_quat(state[:, :4], scalar_first=True)
        angles = np.unwrap(state[:, 7])
        tosses.append(
            Toss(
                int(number),
                state[:, 4:7],
                rotations,
                angles,
                state[:, 11:14],
                state[:, 8:11],
                state[:, 14],
            )
        )
    return tosses


def acceleration(tosses: list[Toss]) -> FloatArray:
    """Return the recorded acceleration of the centre of mass in each flight [m/s^2]."""
    found = []
    for toss in tosses:
        if toss.flight >= LEAST_FLIGHT:
            times_s = np.arange(toss.flight) / RATE_HZ
            found.append(
                -2.0 * np.polyfit(times_s, toss.centre_m[: toss.flight, 2], 2)[0]
            )
    return np.array(found)


def in_free_flight(tosses: list[Toss], gravity: float) -> list[Toss]:
    """Return the tosses that begin in free flight."""
    return [
        toss
        for toss in tosses
        if toss.flight >= LEAST_FLIGHT
        and np.sqrt(np.mean(np.sum(toss.line(gravity)[1] ** 2, axis=1)))
        < MOST_RESIDUAL_M
    ]


def model(gravity: float) -> mujoco.MjModel:
    """Return two free blocks with a frictionless hinge and no contacts, steps of a fourth of a frame."""
    inertial = f'mass="{MASS_KG}" diaginertia="{" ".join(map(str, INERTIA_KG_M2))}"'
    first, second = (
        " ".join(map(str, one)) for one in (ANCHOR_ON_FIRST_M, -ANCHOR_ON_SECOND_M)
    )
    return mujoco.MjModel.from_xml_string(f"""
        <mujoco>
          <option gravity="0 0 {-gravity}" timestep="{0.25 / RATE_HZ}" integrator="RK4"/>
          <worldbody>
            <body><freejoint/><inertial pos="0 0 0" {inertial}/>
              <body pos="{first}"><joint axis="0 1 0"/><inertial pos="{second}" {inertial}/></body>
            </body>
          </worldbody>
        </mujoco>""")


@dataclass(frozen=True)
class Start:
    """Fitted start of a toss: velocities, and the residuals of the flight in units of the weights, shape [T, 7]."""

    linear: FloatArray
    angular_body: FloatArray
    angle_rate: float
    residuals: FloatArray


def start_of(toss: Toss, scale: float, flying: mujoco.MjModel) -> Start:
    """Return the start of a toss."""
    count = min(toss.flight, MOST_FLIGHT)
    places, rotations, angles = (
        scale * toss.positions_m[:count],
        toss.rotations[:count],
        toss.angles_rad[:count],
    )
    data = mujoco.MjData(flying)

    def residuals(values: FloatArray) -> FloatArray:
        mujoco.mj_resetData(flying, data)
        data.qpos[:3] = places[0] + values[:3]
        data.qpos[3:7] = (rotations[0] * Rotation.from_rotvec(values[3:6])).as_quat(
            scalar_first=True
        )
        data.qpos[7], data.qvel[:] = angles[0] + values[6], values[7:]
        states = np.empty((count, 8))
        for state in states:
            state[:] = data.qpos
            mujoco.mj_step(flying, data, 4)
        turned = (
            rotations.inv() * Rotation.from_quat(states[:, 3:7], scalar_first=True)
        ).as_rotvec()
        apart = [
            (states[:, :3] - places) / NOISE_M,
            turned / NOISE_RAD,
            (states[:, 7:] - angles[:, None]) / NOISE_RAD,
        ]
        return np.concatenate(apart, axis=1).ravel()

    few = 6
    times_s = np.arange(few) / RATE_HZ
    straight = places[:few] + 0.5 * GRAVITY_M_PER_S2 * np.outer(
        times_s**2, [0.0, 0.0, 1.0]
    )
    turned = (rotations[0].inv() * rotations[:few]).as_rotvec()
    guess = [
        np.polyfit(times_s, one, 1)[0] for one in (straight, turned, angles[:few, None])
    ]
    scales = np.concatenate(
        [np.full(3, 1e-3), np.full(4, 1e-2), np.full(3, 0.1), np.full(4, 0.3)]
    )
    found = least_squares(
        residuals,
        np.concatenate([np.zeros(7), *guess]),
        x_scale=scales,
        loss="soft_l1",
        max_nfev=20,
    )
    left = residuals(found.x).reshape(count, 7)
    return Start(found.x[7:10], found.x[10:13], float(found.x[13]), left)


def rest_errors(toss: Toss, scale: float) -> tuple[list[float], list[float]]:
    """Return how much too high blocks lie that rest flat on the table [m], and how much they lean [rad]."""
    heights, tilts = [], []
    lowest = toss.lowest_m()[:, -1]
    for (places, rotations), low in zip(
        ((toss.positions_m, toss.rotations), toss.second), lowest, strict=True
    ):
        up = np.abs(rotations[-1].as_matrix()[2])
        axis = int(np.argmax(up))
        # A block that stands on the other one is as high as half an edge and more.
        if up[axis] > FLAT and low < 0.25 * SIZE_M.min():
            heights.append(scale * places[-REST_FRAMES:, 2].mean() - 0.5 * SIZE_M[axis])
            tilts.append(float(np.arccos(min(up[axis], 1.0))))
    return heights, tilts


def nuisances(fit: list[Toss], begun: list[Start], scale: float) -> dict[str, float]:
    """Return the nuisances, fitted on some trials."""
    fall = acceleration(fit)
    rest = [rest_errors(toss, scale) for toss in fit]
    heights, tilts = (
        np.concatenate([np.array(pair[place]) for pair in rest]) for place in (0, 1)
    )
    residuals = np.concatenate([start.residuals for start in begun])
    errors = float(
        np.median([slope_error(min(toss.flight, MOST_FLIGHT)) for toss in fit])
    )
    noise_m, noise_rad = (
        NOISE_M * spread(residuals[:, :3].ravel()),
        NOISE_RAD * spread(residuals[:, 3:6].ravel()),
    )
    noise_angle_rad = NOISE_RAD * spread(residuals[:, 6])
    lags = [
        (scale * toss.velocities[0] - start.linear)[2] / GRAVITY_M_PER_S2
        for toss, start in zip(fit, begun, strict=True)
    ]
    return {
        "length_scale": scale,
        "length_scale_std_error": scale * median_error(fall),
        "height_offset_m": -float(np.median(heights)),
        "velocity_lag_s": max(0.0, float(np.median(lags))),
        "position_noise_m": noise_m,
        "rotation_noise_deg": float(np.degrees(noise_rad)),
        "rest_height_std_m": spread(heights),
        "rest_tilt_deg": float(np.degrees(np.sqrt(np.mean(tilts**2)))),
        "start_velocity_std_m_per_s": noise_m * errors,
        "start_angular_velocity_std_rad_per_s": noise_rad * errors,
        "angle_noise_deg": float(np.degrees(noise_angle_rad)),
        "start_angle_rate_std_rad_per_s": noise_angle_rad * errors,
    }


def arrays_of(
    tosses: list[Toss], starts: list[Start]
) -> dict[str, NDArray[np.generic]]:
    """Return the arrays of the data file."""
    quaternions = np.concatenate(
        [toss.rotations.as_quat(scalar_first=True) for toss in tosses]
    )
    angles = np.concatenate(
        [(toss.angles_rad + np.pi) % (2.0 * np.pi) - np.pi for toss in tosses]
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
        "angle": np.round(angles * ANGLE_COUNTS).astype(np.int16)[:, None],
        # Rounded, so that processors that differ in the last digits give the same file.
        "start_velocity": np.array([start.linear for start in starts])
        .round(4)
        .astype(np.float32),
        "start_angular_velocity_body": np.array(
            [start.angular_body for start in starts]
        )
        .round(3)
        .astype(np.float32),
        "start_angle_rate": np.array([[start.angle_rate] for start in starts])
        .round(3)
        .astype(np.float32),
    }


def sidecar_text(
    source: Path, count: int, repeats: dict[int, int], found: dict[str, float]
) -> str:
    """Return the text of the sidecar."""
    head = sidecar_head(
        source,
        script="build_elbow_tosses.py",
        name=NAME,
        body="first",
        trial_count=count,
        position_unit_m=POSITION_UNIT_M,
        origin=SOURCE_TEXT,
        copies=repeats,
    )
    lines = [
        *head,
        "[[hung]]",
        'body = "second"',
        'on = "first"',
        f"anchor_on_m = {ANCHOR_ON_FIRST_M.tolist()}",
        f"anchor_m = {ANCHOR_ON_SECOND_M.tolist()}",
        f"axis = {AXIS.tolist()}",
        "",
        "[nuisances]",
        *(f"{name} = {value:.4g}" for name, value in found.items()),
    ]
    return "\n".join(lines) + "\n"


def generate(source: Path) -> tuple[dict[str, NDArray[np.generic]], str]:
    """Return the arrays of the data file and the text of the sidecar."""
    recorded = read_tosses(source)
    tosses = in_free_flight(recorded, float(np.median(acceleration(recorded))))
    print(f"{len(tosses)} of {len(recorded)} tosses begin in free flight")
    # The text rounds the scale, and the start velocities contain it.
    repeats = copies([np.concatenate(toss.corners_m(), axis=1) for toss in tosses])
    fit = [trial for trial in range(0, len(tosses), 2) if trial not in repeats]
    scale = float(
        f"{GRAVITY_M_PER_S2 / float(np.median(acceleration([tosses[trial] for trial in fit]))):.4g}"
    )
    flying = model(GRAVITY_M_PER_S2)
    starts = [start_of(toss, scale, flying) for toss in tosses]
    found = nuisances(
        [tosses[trial] for trial in fit], [starts[trial] for trial in fit], scale
    )
    return arrays_of(tosses, starts), sidecar_text(source, len(tosses), repeats, found)


def main() -> int:
    """Write the files, or check that they are current."""
    return write_or_check(
        generate,
        name=NAME,
        script="build_elbow_tosses.py",
        what="Build the recorded tosses of two hinged blocks.",
        # Processors differ in the last digits of the fitted starts.
        fitted=2e-3,
    )


if __name__ == "__main__":
    sys.exit(main())
