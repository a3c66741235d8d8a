"""A pendulum on a geared motor: constants from half of the runs, errors on the others.

    python studies/joints/torque.py

Writes torque_runs.csv (constants of each run alone, and of the two for fits) and torque_errors.csv (errors of the
latter on all runs).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from fits import Fit, FloatArray, Trial, fit, swing, trials, write

STEPS = 5
"""Steps between two frames, of 2 ms."""

NAMES = ("inertia_kg_m2", "gravity_n_m", "dry_n_m", "viscous_n_m_s", "offset_n_m")
SCALES = np.array([1e-3, 2e-2, -5e-3, -2e-3, 5e-3])
"""Steps of the constants; friction is not negative."""

GUESS = np.array([0.2, 3.8, 0.15, 0.01, 0.0])
CHECKED_S = (1.0, 2.0, 3.0)


def simulate(values: FloatArray, starts: FloatArray, trial: Trial) -> FloatArray:
    """Return angles [rad], shape [copies, frames].

    Args:
        values: Inertia, gravity torque at the horizontal, dry and viscous friction, offset; shape [copies, 5].
        starts: Angle and rate at the start, shape [copies, 2].
        trial: Run with the torque.
    """
    assert trial.commands is not None
    torques = trial.commands[:, 0]
    inertia, gravity, dry, viscous, offset = values.T

    def acceleration(frame: int, q: FloatArray) -> FloatArray:
        return (torques[frame] - offset - gravity * np.sin(q)) / inertia

    frames = len(trial.times_s)
    return swing(
        acceleration,
        starts.T,
        dry / inertia,
        viscous / inertia,
        frames,
        trial.interval_s / STEPS,
        STEPS,
    )


@dataclass(frozen=True)
class Piece:
    """Part of a run between two times, from which a simulation starts anew."""

    run: Trial
    first: int
    last: int

    @property
    def trial(self) -> Trial:
        """The part as a run of its own."""
        part = slice(self.first, self.last)
        angles, commands = self.run.angles_rad[part], self.run.commands[part]
        times = self.run.times_s[: self.last - self.first]
        rates = (
            np.polyfit(times[:9], angles[:9], 3)[2]
            if self.first
            else self.run.start_rates
        )
        return Trial(self.run.name, times, angles, rates, commands)


def pieces(run: Trial, length_s: float) -> list[Trial]:
    """Return the run in pieces: an upright pendulum forgets no error of its start, so long ones tell less."""
    count = round(length_s / run.interval_s)
    return [
        Piece(run, first, first + count).trial
        for first in range(0, len(run.times_s) - count + 1, count)
    ]


def fit_pieces(parts: list[Trial]) -> Fit:
    """Fit shared constants, and the start of each piece."""

    def residuals(values: FloatArray) -> FloatArray:
        columns = []
        for k, part in enumerate(parts):
            starts = values[:, 5 + 2 * k : 7 + 2 * k]
            columns.append(
                simulate(values[:, :5], starts, part) - part.angles_rad[:, 0]
            )
        return np.concatenate(columns, axis=1)

    starts = [
        entry
        for part in parts
        for entry in (part.angles_rad[0, 0], part.start_rates[0])
    ]
    steps = np.concatenate([SCALES, np.tile([1e-3, 1e-2], len(parts))])
    return fit(residuals, np.concatenate([GUESS, starts]), steps, rounds=12, least=1e-6)


def errors(values: FloatArray, run: Trial) -> list[float]:
    """Return the error of a rollout from the recorded start after some times, and over all pieces of 1 s [mrad rms]."""
    start = np.array([[run.angles_rad[0, 0], run.start_rates[0]]])
    off = simulate(values[None, :5], start, run)[0] - run.angles_rad[:, 0]
    found = [
        1e3 * float(np.sqrt(np.mean(np.square(off[run.times_s <= time]))))
        for time in CHECKED_S
    ]
    offs = []
    for part in pieces(run, 1.0):
        start = np.array([[part.angles_rad[0, 0], part.start_rates[0]]])
        offs.append(simulate(values[None, :5], start, part)[0] - part.angles_rad[:, 0])
    return [*found, 1e3 * float(np.sqrt(np.mean(np.square(offs))))]


def constants(found: Fit) -> list[float]:
    """Return the constants of a fit, each with its standard error for white residuals."""
    return [
        float(entry)
        for pair in zip(found.values[:5], found.errors()[:5], strict=True)
        for entry in pair
    ]


def rms_of(found: Fit) -> float:
    """Return the residual of a fit [mrad rms]."""
    return 1e3 * float(np.sqrt(np.mean(np.square(found.residual))))


def main() -> None:
    """Fit and write the tables."""
    runs = trials("TorquePendulum-ak80")
    rows = []
    for k, run in enumerate(runs):
        found = fit_pieces(pieces(run, 1.0))
        rows.append(
            (run.name, "judge" if k % 2 else "fit", *constants(found), rms_of(found))
        )
    header = [entry for name in NAMES for entry in (name, f"{name}_error")]
    parts = [part for run in runs[::2] for part in pieces(run, 1.0)]
    shared = fit_pieces(parts)
    columns = (*(f"after_{time:g}_s_mrad" for time in CHECKED_S), "pieces_mrad")
    judged = [
        (run.name, "judge" if k % 2 else "fit", *errors(shared.values, run))
        for k, run in enumerate(runs)
    ]
    write("torque_errors.csv", ("run", "half", *columns), judged)
    rows.append(("all runs of the fit", "fit", *constants(shared), rms_of(shared)))
    write("torque_runs.csv", ("run", "half", *header, "pieces_mrad"), rows)


if __name__ == "__main__":
    main()
