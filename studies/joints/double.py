"""A free double pendulum: constants from half of the pieces, errors on the others, and how long a start tells.

    python studies/joints/double.py

Writes double_constants.csv, double_pieces.csv (errors over time) and double_spread.csv (growth of a start's error).
"""

from __future__ import annotations

import numpy as np
from fits import FloatArray, Trial, fit, rollout, trials, write

SUBSTEPS = 4
SLIP = 0.05
"""Rate at which the smoothed dry friction has 76 % of its torque [rad/s]; no piece comes to rest."""

NAMES = (
    "coupling",
    "inertia_2",
    "gravity_1",
    "gravity_2",
    "viscous_1",
    "viscous_2",
    "dry_1",
    "dry_2",
)
AUTHORS = np.array([0.4912, 0.5566, 58.95, 27.90, 0.04197, 0.00177, 0.0, 0.0])
"""The same from the authors' estimates: all are over the inertia of the upper body, with the lower one at its end."""

SCALES = np.array([1e-3, 1e-3, 0.05, 0.05, -1e-3, -1e-3, -2e-3, -2e-3])
ENSEMBLE = 32
FIRST = 7
"""Frames that a start rate is fitted to."""

CHECKED_S = (0.5, 1.0, 1.5, 2.0, 2.5)


def simulate(
    values: FloatArray, starts: FloatArray, frames: int, interval_s: float
) -> FloatArray:
    """Return both angles, the second relative to the first body [rad], shape [copies, frames, 2].

    Args:
        values: Constants, shape [copies, 8].
        starts: Angles and rates, both relative, shape [copies, 4].
        frames: Number of frames.
        interval_s: Time between them [s].
    """
    coupling, inertia, gravity_1, gravity_2, viscous_1, viscous_2, dry_1, dry_2 = (
        values.T
    )

    def acceleration(_: float, q: FloatArray, v: FloatArray) -> FloatArray:
        one, two = q[:, 0], q[:, 0] + q[:, 1]
        rate, both = v[:, 0], v[:, 0] + v[:, 1]
        mixed, turned = coupling * np.cos(one - two), coupling * np.sin(one - two)
        lower = -viscous_2 * v[:, 1] - dry_2 * np.tanh(v[:, 1] / SLIP)
        upper = -viscous_1 * rate - dry_1 * np.tanh(rate / SLIP) - lower
        torque_1 = upper - turned * both * both - gravity_1 * np.sin(one)
        torque_2 = lower + turned * rate * rate - gravity_2 * np.sin(two)
        determinant = inertia - mixed * mixed
        first = (inertia * torque_1 - mixed * torque_2) / determinant
        second = (torque_2 - mixed * torque_1) / determinant
        return np.stack([first, second - first], axis=1)

    return rollout(
        acceleration, starts[:, :2], starts[:, 2:], frames, interval_s, SUBSTEPS
    )


def start_of(trial: Trial) -> FloatArray:
    """Return the recorded start, shape [4]."""
    return np.concatenate([trial.angles_rad[0], trial.start_rates])


def identify(
    pieces: list[Trial], guess: FloatArray
) -> tuple[FloatArray, FloatArray, float]:
    """Return constants, their standard errors for white residuals, and the residual [mrad rms]; starts are free."""
    observed = np.concatenate([piece.angles_rad.ravel() for piece in pieces])
    frames, interval_s = len(pieces[0].times_s), pieces[0].interval_s

    def residuals(values: FloatArray) -> FloatArray:
        starts = values[:, 8:].reshape(-1, 4)
        constants = np.repeat(values[:, :8], len(pieces), axis=0)
        return (
            simulate(constants, starts, frames, interval_s).reshape(len(values), -1)
            - observed
        )

    steps = np.concatenate([SCALES, np.tile([1e-4, 1e-4, 1e-3, 1e-3], len(pieces))])
    first = np.concatenate([guess, *(start_of(piece) for piece in pieces)])
    found = fit(residuals, first, steps, rounds=8)
    return (
        found.values[:8],
        found.errors()[:8],
        1e3 * float(np.sqrt(found.cost / len(observed))),
    )


def start_spread(trial: Trial) -> FloatArray:
    """Return standard errors of the recorded start: of an angle, and of the slope of a cubic through its frames."""
    times_s, angles = trial.times_s[:FIRST], trial.angles_rad[:FIRST]
    powers = np.vander(times_s, 4)
    spread = np.sqrt(
        np.square(angles - powers @ np.linalg.lstsq(powers, angles, rcond=None)[0]).sum(
            axis=0
        )
        / (FIRST - 4)
    )
    return np.concatenate(
        [spread, spread * np.sqrt(np.linalg.inv(powers.T @ powers)[2, 2])]
    )


def main() -> None:
    """Fit, judge and write the tables."""
    rng = np.random.default_rng(0)
    pieces = trials("DoublePendulum-bars")
    constants, errors, residual = identify(pieces[::2], AUTHORS)
    odd, _, odd_residual = identify(pieces[1::2], AUTHORS)
    columns = (constants, errors, AUTHORS, odd)
    rows = [
        (name, *map(float, row)) for name, *row in zip(NAMES, *columns, strict=True)
    ]
    write(
        "double_constants.csv",
        ("constant", "value", "error", "authors", "odd_pieces"),
        [*rows, ("residual_mrad", residual, 0.0, 0.0, odd_residual)],
    )
    judged = []
    spreads = np.median([start_spread(piece) for piece in pieces], axis=0)
    for k, piece in enumerate(pieces):
        frames, interval_s = len(piece.times_s), piece.interval_s
        drawn = start_of(piece) + spreads * rng.standard_normal((ENSEMBLE, 4))
        starts = np.vstack([start_of(piece), start_of(piece), drawn])
        values = np.vstack([constants, AUTHORS, np.tile(constants, (ENSEMBLE, 1))])
        angles = simulate(values, starts, frames, interval_s)
        off = 1e3 * np.abs(angles[:2] - piece.angles_rad)
        spread = 1e3 * angles[2:].std(axis=0)
        for time in CHECKED_S:
            until = piece.times_s <= time
            both = [
                float(np.sqrt(np.mean(np.square(one[until]))))
                for one in (off[0], off[1], spread)
            ]
            judged.append((k, "judge" if k % 2 else "fit", time, *both))
    write(
        "double_pieces.csv",
        (
            "piece",
            "half",
            "time_s",
            "error_mrad",
            "authors_error_mrad",
            "start_spread_mrad",
        ),
        judged,
    )
    means = []
    for time in CHECKED_S:
        taken = np.array(
            [row[3:] for row in judged if row[1] == "judge" and row[2] == time]
        )
        means.append((time, *map(float, np.median(taken, axis=0))))
    write(
        "double_spread.csv",
        ("time_s", "error_mrad", "authors_error_mrad", "start_spread_mrad"),
        means,
    )
    print(spreads)


if __name__ == "__main__":
    main()
