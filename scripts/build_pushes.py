"""Build the band of the pushed cube (`scoring/bands/CubePush-light`) and its trials from the facts.

`scoring/facts/cube_push.toml` says where the facts are from.

Trials begin at different times of the recording. Their common time 0 is that of the same path of the hand: a shift in
time, and one of each coordinate, brings the hand closest to its mean over the trials. The cube plays no part in it.

The recorded frame is tilted against the table. The height of the resting cube before and after the push gives the
slope along x; heights here are above the table. The slope along y is unknown, and the cube moves 3 mm along it.

The hand is closed, and no source states the shape of its front. The cube itself measures it: in the frame of the hand,
no point that the cube has passed belongs to the hand, and where both touched, the rearmost passage is the front. Trials
agree within 0.3 mm down to the height at which the cube leaves the tip, and no longer below. Even trials give the
front, odd trials judge.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.ndimage import median_filter
from scipy.optimize import least_squares
from scipy.signal import savgol_filter
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.timing import FRAME_RATE_HZ
from scripts.generated import SCORING, frame_table

NAME = "CubePush-light"
RATE_HZ = 100.0
FRAMES = 33
HALF_EDGE_M = 0.0375

BEFORE = 110
"""Recorded frames before the one at which the hand has advanced by 15 mm."""

START_S = -0.4
"""Start of an episode, at which the hand still stands, in the common time of the trials [s]."""

BEFORE_MOTION = 50
"""First frames of the facts, in which neither the hand nor the cube moves."""

PASSAGE_S = (-0.12, 0.62)
"""Common times of which the passages of the cube give the front of the hand."""

HEIGHTS_M = np.arange(-0.125, -0.1851, -0.0025)
"""Heights of the front of the hand over the origin of its markers [m], from where the cube is first down to the tip."""

BODY_ORIGIN_M = (0.05, 0.0, -0.15)
"""Origin of the body of the hand in the frame of its markers: forward, left and up [m]."""

TOP_M, WIDTH_M, DEPTH_M = 0.04, 0.05, 0.03
"""Nominal top of the hand over the origin of its body, its width, and its depth behind the origin [m]."""

JOINT_M = -0.16
"""Height of the joint of the fingers, where the front is concave, so that it takes two convex pieces [m]."""

DRIVER_INTERVAL_S = 0.02

POSITION_UNIT_M = 1e-5

ALIGN_ERROR_S = 0.0005
"""Standard uncertainty of the common time of a trial [s]: a hand at 0.2 m/s, known to 0.1 mm."""

NOISE_MM = 0.05
"""Standard deviation of the recorded cube at rest along x [mm]."""

SOURCE = (
    "erwincoumans/quantifying-the-reality-gap-in-robotic-manipulation-tasks, commit 2b21d34, "
    "Data/MotionCapture/Experiment3, BSD-3-Clause licence"
)


@dataclass(frozen=True)
class Push:
    """One trial about the push, heights above the table, T frames.

    Attributes:
        name: Name of the recording.
        times_s: Common times of the frames, shape [T].
        cube_m: Centre of the cube, shape [T, 3].
        cube_turn: Rotation vectors of the cube from its start [rad], shape [T, 3].
        hand_m: Origin of the markers of the end effector, shape [T, 3].
        hand_turn: Rotation vectors of the end effector from its mean start over the trials [rad], shape [T, 3].
    """

    name: str
    times_s: FloatArray
    cube_m: FloatArray
    cube_turn: FloatArray
    hand_m: FloatArray
    hand_turn: FloatArray

    @property
    def hand_path(self) -> FloatArray:
        """Origin of the body of the hand [m] and pitch of the hand [rad], shape [T, 4]."""
        arm_m = Rotation.from_rotvec(self.hand_turn).apply(BODY_ORIGIN_M)
        return np.column_stack([self.hand_m + arm_m, self.hand_turn[:, 1]])

    def front_m(self) -> FloatArray:
        """Return the rearmost passage of the rear of the cube at the heights of the front of the hand [m].

        Returns:
            Distances forward of the origin of the markers, shape of `HEIGHTS_M`; infinite where the cube did not pass.
        """
        edges_m = HALF_EDGE_M * np.array([[-1.0, 0.0, -1.0], [-1.0, 0.0, 1.0]])
        hand, cube = (
            Rotation.from_rotvec(self.hand_turn).inv(),
            Rotation.from_rotvec(self.cube_turn),
        )
        low_m, high_m = (
            hand.apply(self.cube_m + cube.apply(edge) - self.hand_m) for edge in edges_m
        )
        rear_m = np.full(len(HEIGHTS_M), np.inf)
        for frame in np.flatnonzero(
            (self.times_s > PASSAGE_S[0]) & (self.times_s < PASSAGE_S[1])
        ):
            low, high = low_m[frame], high_m[frame]
            passed = np.interp(
                HEIGHTS_M,
                [low[2], high[2]],
                [low[0], high[0]],
                left=np.inf,
                right=np.inf,
            )
            rear_m = np.minimum(rear_m, passed)
        return rear_m

    def at(self, values: FloatArray, times_s: FloatArray) -> FloatArray:
        """Return values at other common times."""
        found: FloatArray = CubicSpline(self.times_s, values)(times_s)
        return found


@dataclass(frozen=True)
class Pushes:
    """All trials.

    Attributes:
        facts: Arrays of the facts.
    """

    facts: dict[str, NDArray[np.generic]]

    @cached_property
    def slope(self) -> float:
        """Slope of the table along x in the recorded frame: median over the trials of the rise of the resting cube."""
        x_m = _metres(self.facts["cube_position"][:, :, 0])
        rise_m = self.facts["resting_height_m"] @ [-1.0, 1.0]
        return float(np.median(rise_m / (x_m[:, -1] - x_m[:, 0])))

    @cached_property
    def trials(self) -> list[Push]:
        """The trials, in common time."""
        moved = [self._levelled(trial) for trial in range(len(self.facts["trial"]))]
        shifts_s = np.zeros(len(moved))
        window_s = np.arange(-0.4, 0.4, 1.0 / RATE_HZ)
        for _ in range(3):
            shifted = [
                one.at(one.hand_m[:, [0, 2]], window_s + s)
                for one, s in zip(moved, shifts_s, strict=True)
            ]
            mean = np.mean(shifted, axis=0)
            for trial, one in enumerate(moved):
                fit = least_squares(
                    _misfit,
                    [shifts_s[trial], 0.0, 0.0],
                    args=(one, window_s, mean),
                    x_scale=1e-3,
                )
                shifts_s[trial] = fit.x[0]
            shifts_s -= shifts_s.mean()
        return [
            Push(
                one.name,
                one.times_s - s,
                one.cube_m,
                one.cube_turn,
                one.hand_m,
                one.hand_turn,
            )
            for one, s in zip(moved, shifts_s, strict=True)
        ]

    def front_m(self, first: int = 0) -> FloatArray:
        """Return the front of the hand [m]: the median over every second trial from `first`, shape of `HEIGHTS_M`."""
        return np.median([push.front_m() for push in self.trials[first::2]], axis=0)

    def hand_path(self, times_s: FloatArray, trial: int | None = None) -> FloatArray:
        """Return the path of the hand at common times, the mean over the trials or of one: x y z [m], pitch [rad]."""
        chosen = self.trials if trial is None else [self.trials[trial]]
        return np.mean([push.at(push.hand_path, times_s) for push in chosen], axis=0)

    def cubes_mm(self) -> FloatArray:
        """Return the centres of the cubes at the 30 Hz frames of an episode [mm], shape [trial_count, FRAMES, 3]."""
        times_s = START_S + np.arange(FRAMES) / FRAME_RATE_HZ
        return 1e3 * np.array([push.at(push.cube_m, times_s) for push in self.trials])

    @cached_property
    def _hand_starts(self) -> Rotation:
        """Orientations of the end effector before it moves, one a trial."""
        return Rotation.concatenate(
            [
                _rotations(q[:BEFORE_MOTION]).mean()
                for q in self.facts["hand_quaternion"]
            ]
        )

    def _levelled(self, trial: int) -> Push:
        """Return a trial with heights above the table, at time 0 where the hand has advanced by 15 mm."""
        facts = self.facts
        cube_m, hand_m = (
            _metres(facts[f"{name}_position"][trial]) for name in ("cube", "hand")
        )
        start_m = np.median(cube_m[:BEFORE_MOTION], axis=0)
        for one in (cube_m, hand_m):
            one[:, 2] -= (
                start_m[2] - HALF_EDGE_M + self.slope * (one[:, 0] - start_m[0])
            )
        cube_turns, hand_turns = (
            _rotations(facts[f"{name}_quaternion"][trial]) for name in ("cube", "hand")
        )
        hand_turn = (hand_turns * self._hand_starts.mean().inv()).as_rotvec()
        cube_turn = (cube_turns * cube_turns[:BEFORE_MOTION].mean().inv()).as_rotvec()
        return Push(
            name=str(facts["trial"][trial]),
            times_s=(np.arange(len(cube_m)) - BEFORE) / RATE_HZ,
            # Hidden markers move the cube by up to 2 mm up and 0.5 degrees for single frames.
            cube_m=np.column_stack(
                [cube_m[:, 0], median_filter(cube_m[:, 1:], size=(3, 1))]
            ),
            cube_turn=median_filter(cube_turn, size=(3, 1)),
            hand_m=savgol_filter(hand_m, 5, 2, axis=0),
            hand_turn=savgol_filter(hand_turn, 5, 2, axis=0),
        )


def _metres(counts: NDArray[np.generic]) -> FloatArray:
    return POSITION_UNIT_M * counts.astype(np.float64)


def _rotations(counts: NDArray[np.generic]) -> Rotation:
    return Rotation.from_quat(counts.astype(np.float64), scalar_first=True)


def _misfit(
    parameters: FloatArray, push: Push, times_s: FloatArray, mean_m: FloatArray
) -> FloatArray:
    """Return how far a trial, shifted in time [s] and along x and z [m], is from the mean path of the hand."""
    found: FloatArray = (
        push.at(push.hand_m[:, [0, 2]], times_s + parameters[0])
        - mean_m
        - parameters[1:]
    ).ravel()
    return found


def read_pushes(scoring: Path = SCORING) -> Pushes:
    """Return the trials of the facts."""
    with np.load(scoring / "facts" / "cube_push.npz") as archive:
        return Pushes({name: archive[name] for name in archive.files})


def contents(scoring: Path = SCORING) -> dict[Path, str]:
    """Return the text of every generated file."""
    pushes = read_pushes(scoring)
    cubes_mm = pushes.cubes_mm()[:, :, 0]
    mean, sigma = cubes_mm.mean(axis=0), cubes_mm.std(axis=0, ddof=1)
    error = np.hypot(
        NOISE_MM, ALIGN_ERROR_S * FRAME_RATE_HZ * np.abs(np.gradient(mean))
    )
    names = ["mean.cube.x", "sigma.cube.x", "uncertainty.cube.x"]
    table = frame_table(names, np.column_stack([mean, sigma, error]), decimals=3)
    names = [f"trial.{k + 1}.cube.x" for k in range(len(cubes_mm))]
    singles = frame_table(names, cubes_mm.T, decimals=3)
    sidecar = [
        "# Written by scripts/build_pushes.py; do not edit.",
        'grade = "trials"',
        'sigma_source = "trials"',
        'unit = "mm"',
        f"trial_count = {len(cubes_mm)}",
        'coordinates = ["cube.x"]',
        "projection = [[1, 0, 0]]  # the yaw of the hand, which moves the cube along y, is not known",
        f'source = "{SOURCE}; {len(cubes_mm)} pushes in the common time of the hand"',
    ]
    file_lines = [
        "# Own starts and driven motions of the trials. Written by scripts/build_pushes.py; do not edit.",
        f"times_s = {driver_values(pushes)[0].round(2).tolist()}",
    ]
    hands_m = [
        pushes.hand_path(np.array([START_S]), trial)[0, :3]
        for trial in range(len(cubes_mm))
    ]
    places_m = {
        "cube": [[*(1e-3 * one[0, :2]), HALF_EDGE_M] for one in pushes.cubes_mm()],
        "hand": hands_m,
    }
    for name, several in places_m.items():
        file_lines += [
            f"start_m.{name} = [",
            *(f"    {_numbers(place)}," for place in several),
            "]",
        ]
    file_lines.append("motions.hand = [")
    for trial in range(len(cubes_mm)):
        motions = driver_values(pushes, trial)[1].T[[3, 0, 1, 2]]
        file_lines += [
            "    [",
            *(f"        {_numbers(one)}," for one in motions),
            "    ],",
        ]
    file_lines.append("]")
    return {
        scoring / "trials" / f"{NAME}.toml": "\n".join(file_lines) + "\n",
        scoring / "bands" / f"{NAME}.csv": table,
        scoring / "bands" / f"{NAME}.toml": "\n".join(sidecar) + "\n",
        scoring / "trials" / f"{NAME}.csv": singles,
    }


def _numbers(values: Sequence[float] | FloatArray) -> list[float]:
    """Return metres or radians with seven decimals: a cube that starts 0.1 mm away travels 1.9 mm farther."""
    return [round(float(value), 7) + 0.0 for value in values]


def driver_values(
    pushes: Pushes, trial: int | None = None
) -> tuple[FloatArray, FloatArray]:
    """Return the times of an episode [s] and the path of the hand from its start, mean or of one trial.

    Returns:
        Times, shape [S]; displacements along x, y, z [m] and pitch [rad], shape [S, 4].
    """
    count = round((FRAMES - 1) / FRAME_RATE_HZ / DRIVER_INTERVAL_S)
    times_s = DRIVER_INTERVAL_S * np.arange(count + 1)
    path = pushes.hand_path(START_S + times_s, trial)
    return times_s, path - pushes.hand_path(np.array([START_S]), trial)


def pieces_m(front_m: FloatArray) -> list[FloatArray]:
    """Return the vertices of the two convex pieces of the hand, above and below the joint, in the frame of its body."""
    front = np.column_stack([front_m, HEIGHTS_M]) - [BODY_ORIGIN_M[0], BODY_ORIGIN_M[2]]
    joint = JOINT_M - BODY_ORIGIN_M[2]
    upper, lower = front[front[:, 1] > joint - 1e-9], front[front[:, 1] < joint + 1e-9]
    outlines = (
        [[-DEPTH_M, TOP_M], [upper[0, 0], TOP_M], *upper, [-DEPTH_M, joint]],
        [[-DEPTH_M, joint], *lower, [-DEPTH_M, lower[-1, 1]]],
    )
    pieces = []
    for outline in outlines:
        corners = np.array(outline)[ConvexHull(np.array(outline)).vertices]
        pieces.append(
            np.array(
                [[x, side * 0.5 * WIDTH_M, z] for side in (-1, 1) for x, z in corners]
            )
        )
    return pieces
