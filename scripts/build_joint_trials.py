"""Build the recorded motions of joints (`scoring/single_shot/`) from the files of their authors.

    python scripts/build_joint_trials.py FOLDER            writes the files
    python scripts/build_joint_trials.py FOLDER --check    fails if a file differs from what FOLDER gives

FOLDER holds three NumPy archives: `dynamicslab-pendulums.npz` (encoders of a single and a double pendulum, 1 kHz),
`dfki-torque-pendulum.npz` (position and motor torque of a driven pendulum, 50 to 500 Hz) and `so101-servo-logs.npz`
(command and position of six servos, 50 Hz). Their keys are those of the authors' logs.

Stored are angles and commands in counts of the sidecar's units, at most half the resolution of an encoder apart from
what was recorded. Recordings of 1 kHz are stored at 100 Hz. A measured torque is the mean over the interval after its
frame. Angles are zero where a body hangs, so pi is taken from those of the two free pendulums; the double pendulum's
second angle is stored relative to the first body. A start rate is the slope of a cubic through the first 60 ms.
Trials with even numbers are for fits, those with odd numbers judge. What the sidecar says of the chain follows from the
task file. The loads of the servos, which no experiment needs, go to `studies/joints/so101_load.npz`.
"""

from __future__ import annotations

import argparse
import hashlib
import sys
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from generated import SCORING, same_arrays, same_text
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Archive = Mapping[str, NDArray[np.float64]]

INTERVAL_S = 0.01
START_S = 0.06
"""Length of the recording that a start rate is fitted to [s]."""

PENDULUMS = "dynamicslab-pendulums.npz"
TORQUE = "dfki-torque-pendulum.npz"
ARM = "so101-servo-logs.npz"

LICENCES = {PENDULUMS: "MultiArmPendulum", TORQUE: "TorquePendulum", ARM: "ServoArm"}

DRY_CUTS_S = (60.0, 63.2, 66.4)
"""Limits of the two pieces of the free swing; in the second one it comes to rest."""

TORQUE_PIECES_S = {
    "ddp": (0.0, 6.0),
    "direct_collocation": (0.0, 3.5),
    "energy_shaping": (0.0, 4.2),
    "pd_1nm_torque_limited_swingup_failure": (12.6, 19.0),
}
"""Pieces of the driven pendulum in which no hand moves it.

Left out are two runs whose torque of up to 18 N m changes its sign from frame to frame, so that its mean between frames
is not known, and one in which a hand does the moving.
"""

MOTIONS = (
    "chirp_sweep",
    "backlash_detection",
    "hold_under_gravity",
    "ramp_motion",
    "prbs_excitation",
    "single_joint_elbow",
    "static_holding",
    "slow_precision",
)
"""Motions of the arm in the order of the trials: the even ones move every joint quickly, slowly and under gravity."""

TORQUE_ENCODER_RAD = 0.0029145
"""Step between the angles of the driven pendulum."""

ENCODER_RAD = 2.0 * np.pi / 4096.0

LOAD_UNIT = 0.022814
"""Step between the loads of the logs, in their unit, which is not stated."""


@dataclass(frozen=True)
class Trial:
    """One recording: angles and commands at a constant rate, shape [T, joint_count]; loads where logged."""

    name: str
    interval_s: float
    angles_rad: FloatArray
    start_rates: FloatArray
    commands: FloatArray | None = None
    load: FloatArray | None = None


@dataclass(frozen=True)
class Recording:
    """The trials of an experiment, and what its sidecar says.

    The noise of an angle is that of rounding to the steps of its encoder.
    """

    file: str
    source: str
    task: str
    angle_unit_rad: float
    noise_rad: float
    trials: tuple[Trial, ...]
    command: str | None = None
    command_unit: float | None = None


def start_rates(times_s: FloatArray, angles_rad: FloatArray) -> FloatArray:
    """Return the rates at the first frame [rad/s], shape [joint_count]."""
    first = times_s - times_s[0] <= START_S
    return np.polyfit(times_s[first] - times_s[0], angles_rad[first], 3)[2]


def piece(
    name: str,
    times_s: FloatArray,
    angles_rad: FloatArray,
    limits_s: tuple[float, float],
) -> Trial:
    """Return a part of a recording of 1 kHz at 100 Hz."""
    inside = (times_s >= limits_s[0]) & (times_s < limits_s[1])
    angles = angles_rad[inside]
    return Trial(name, INTERVAL_S, angles[::10], start_rates(times_s[inside], angles))


def dry_pendulum(archive: Archive) -> tuple[Trial, ...]:
    """Return the two pieces of the free swing."""
    times_s, angles = (
        archive["free_swing_time_s"],
        archive["free_swing_angle_rad"][:, None] - np.pi,
    )
    both = pairwise(DRY_CUTS_S)
    return tuple(
        piece(f"free_swing at {low:g} s", times_s, angles, (low, high))
        for low, high in both
    )


def viscous_pendulum(archive: Archive) -> tuple[Trial, ...]:
    """Return the four pieces of the long swing."""
    return tuple(
        piece(
            name,
            archive[f"{name}_time_s"],
            archive[f"{name}_angle_rate"][:1].T - np.pi,
            (0.0, np.inf),
        )
        for name in (f"single_{k}" for k in range(4))
    )


def double_pendulum(archive: Archive) -> tuple[Trial, ...]:
    """Return the pieces of the double pendulum: first angle, and second one relative to the first body."""
    trials = []
    for name in (f"double_{k}" for k in range(26)):
        upper, lower = archive[f"{name}_state"][:2].astype(float)
        angles = np.stack([upper - np.pi, lower - upper], axis=1)
        trials.append(piece(name, archive[f"{name}_time_s"], angles, (0.0, np.inf)))
    return tuple(trials)


def torque_pendulum(archive: Archive) -> tuple[Trial, ...]:
    """Return the pieces of the driven pendulum, on a grid of 100 Hz."""
    trials = []
    for name, (low, high) in TORQUE_PIECES_S.items():
        times_s, angles, _, torques = archive[name].T
        times_s = times_s - times_s[0]
        grid = np.arange(low, min(high, times_s[-1] - 2.0 * INTERVAL_S), INTERVAL_S)
        # A frame's torque holds until the next one, as the controller sent it.
        impulse = np.concatenate([[0.0], np.cumsum(torques[:-1] * np.diff(times_s))])
        means = (
            np.interp(grid + INTERVAL_S, times_s, impulse)
            - np.interp(grid, times_s, impulse)
        ) / INTERVAL_S
        inside = times_s >= low
        rates = start_rates(times_s[inside], angles[inside, None])
        trials.append(
            Trial(
                name,
                INTERVAL_S,
                np.interp(grid, times_s, angles)[:, None],
                rates,
                means[:, None],
            )
        )
    return tuple(trials)


def servo_arm(archive: Archive) -> tuple[Trial, ...]:
    """Return the motions of the arm at their own rate; all start at rest."""
    trials = []
    for name in MOTIONS:
        times_s = archive[f"{name}_time_s"]
        interval_s = float(np.polyfit(np.arange(len(times_s)), times_s, 1)[0])
        angles = archive[f"{name}_position_rad"].astype(float)
        commands, load = (
            archive[f"{name}_command_rad"].astype(float),
            archive[f"{name}_load"].astype(float),
        )
        trials.append(Trial(name, interval_s, angles, np.zeros(6), commands, load))
    return tuple(trials)


def recordings(folder: Path) -> dict[str, Recording]:
    """Return the recordings of all experiments."""
    archives = {name: dict(np.load(folder / name)) for name in (PENDULUMS, TORQUE, ARM)}
    swings = "dynamicslab/MultiArm-Pendulum, commit e99a7e13 (Kaheman et al., arXiv 2205.06231), MIT licence"
    driven = "dfki-ric-underactuated-lab/torque_limited_simple_pendulum, commit ed17ea2d, BSD-3-Clause licence"
    arm = "isaac-sim2real/sage, commit 4ffd2627, Apache-2.0 licence"
    pendulum = archives[PENDULUMS]
    half_turn, turn = np.pi / 20000.0 / np.sqrt(12.0), ENCODER_RAD / np.sqrt(12.0)
    motor = TORQUE_ENCODER_RAD / np.sqrt(12.0)
    swing = (PENDULUMS, swings, "joint_pendulum")
    return {
        "JointPendulum-dry": Recording(*swing, 1e-5, half_turn, dry_pendulum(pendulum)),
        "JointPendulum-viscous": Recording(
            *swing, 1e-4, half_turn, viscous_pendulum(pendulum)
        ),
        "DoublePendulum-bars": Recording(
            PENDULUMS,
            swings,
            "double_pendulum",
            1e-4,
            half_turn,
            double_pendulum(pendulum),
        ),
        "TorquePendulum-ak80": Recording(
            TORQUE,
            driven,
            "torque_pendulum",
            2e-4,
            motor,
            torque_pendulum(archives[TORQUE]),
            "torque",
            0.001,
        ),
        "ServoArm-so101": Recording(
            ARM,
            arm,
            "servo_arm",
            ENCODER_RAD / 2.0,
            turn,
            servo_arm(archives[ARM]),
            "angle",
            ENCODER_RAD / 4.0,
        ),
    }


def arrays_of(recording: Recording) -> dict[str, NDArray[np.generic]]:
    """Return the arrays of a data file."""
    trials = recording.trials
    arrays: dict[str, NDArray[np.generic]] = {
        "first": np.cumsum(
            [0, *(len(trial.angles_rad) for trial in trials)], dtype=np.int32
        ),
        "interval_s": np.array([trial.interval_s for trial in trials]),
        "angle": counts(
            [trial.angles_rad for trial in trials], recording.angle_unit_rad
        ),
        "start_angle_rate": np.array(
            [trial.start_rates for trial in trials], dtype=np.float32
        ),
    }
    commands = [trial.commands for trial in trials if trial.commands is not None]
    if recording.command_unit is not None:
        arrays["command"] = counts(commands, recording.command_unit)
    return arrays


def counts(values: list[FloatArray], unit: float) -> NDArray[np.int16]:
    """Return all values in counts of a unit, shape [T, joint_count]; joint by joint in memory, which packs better."""
    return np.asfortranarray(np.round(np.concatenate(values) / unit).astype(np.int16))


def sidecar_text(folder: Path, recording: Recording) -> str:
    """Return the text of a sidecar."""
    digest = hashlib.sha256((folder / recording.file).read_bytes()).hexdigest()
    task = tomllib.loads(
        (SCORING.parent / "tasks" / f"{recording.task}.toml").read_text(
            encoding="utf-8"
        )
    )
    hung = chain(task)
    # The farthest centre of mass moves most, by all angles before it.
    reach_m = sum(
        float(np.linalg.norm(np.subtract(one["anchor_m"], one["anchor_on_m"])))
        for one in hung[1:]
    )
    reach_m += float(np.linalg.norm(hung[-1]["anchor_m"]))
    lines = [
        "# Written by scripts/build_joint_trials.py; do not edit.",
        'body = "world"',
        f"trial_count = {len(recording.trials)}",
        f"trials = {[trial.name for trial in recording.trials]}".replace("'", '"'),
        f"angle_unit_rad = {recording.angle_unit_rad!r}",
        *([f'command = "{recording.command}"'] if recording.command else []),
        *(
            [f"command_unit = {recording.command_unit!r}"]
            if recording.command_unit
            else []
        ),
        f"position_noise_m = {recording.noise_rad * reach_m:.3g}",
        'fit = "even"',
        f'source = "{recording.source}"',
        f'source_sha256 = "{digest}"',
        f'licence = "{LICENCES[recording.file]}.LICENSE"',
    ]
    for one in hung:
        lines += ["", "[[hung]]", f'body = "{one["body"]}"', f'on = "{one["on"]}"']
        lines += [f"{key} = {one[key]}" for key in ("anchor_on_m", "anchor_m", "axis")]
    return "\n".join(lines) + "\n"


def chain(task: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the hung bodies of a task whose bodies have the axes of the world where all angles are 0."""
    starts = {}
    for name, start in task["initial"]["all"].items():
        hangs = np.subtract(
            start.get("hangs_from_m", (0.0, 0.0, 0.0)),
            (0.0, 0.0, start.get("length_m", 0.0)),
        )
        starts[name] = np.array(start.get("position_m", hangs))
    first, *_ = task["joints"]
    anchor = first.get(
        "anchor_m", task["initial"]["all"][first["body"]].get("hangs_from_m")
    )
    hinges = [("world", first["body"], np.array(anchor), first["axis"])]
    hinges += [
        (*one["bodies"], np.array(one["anchor_m"]), one["axis"])
        for one in task.get("body_hinges", ())
    ]
    starts["world"] = np.zeros(3)
    return [
        {
            "body": body,
            "on": on,
            "anchor_on_m": np.round(anchor_m - starts[on], 7).tolist(),
            "anchor_m": np.round(anchor_m - starts[body], 7).tolist(),
            "axis": axis,
        }
        for on, body, anchor_m, axis in hinges
    ]


def loads(recording: Recording) -> dict[str, NDArray[np.generic]]:
    """Return the loads of the servos in counts, shape [T, 6]."""
    return {
        "load": counts(
            [trial.load for trial in recording.trials if trial.load is not None],
            LOAD_UNIT,
        )
    }


def main() -> int:
    """Write the files, or check that they are current."""
    parser = argparse.ArgumentParser(
        description="Build the recorded motions of joints."
    )
    parser.add_argument("folder", type=Path, help="folder of the authors' archives")
    parser.add_argument(
        "--check",
        action="store_true",
        help="write nothing; fail if a file is not current",
    )
    options = parser.parse_args()
    stale = []
    files: dict[Path, tuple[dict[str, NDArray[np.generic]], str | None]] = {}
    for name, recording in recordings(options.folder).items():
        files[SCORING / "single_shot" / f"{name}.npz"] = (
            arrays_of(recording),
            sidecar_text(options.folder, recording),
        )
        if recording.file == ARM:
            files[SCORING.parent / "studies" / "joints" / "so101_load.npz"] = (
                loads(recording),
                None,
            )
    for file, (arrays, text) in files.items():
        if not options.check:
            if text is not None:
                file.with_suffix(".toml").write_text(
                    text, encoding="utf-8", newline="\n"
                )
            np.savez_compressed(file, **arrays)
            continue
        with np.load(file) as stored:
            same = same_arrays(dict(stored), arrays)
        if not same or (
            text is not None
            and not same_text(file.with_suffix(".toml").read_text("utf-8"), text)
        ):
            stale.append(file)
    for file in stale:
        print(
            f"{file} is not current: run python scripts/build_joint_trials.py FOLDER",
            file=sys.stderr,
        )
    return 1 if stale else 0


if __name__ == "__main__":
    sys.exit(main())
