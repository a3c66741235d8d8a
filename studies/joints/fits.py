"""What the fits of recorded joints share: trials, batched rollouts, least squares and correlated residuals."""

from __future__ import annotations

import csv
import tomllib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

FloatArray = NDArray[np.float64]
Residuals = Callable[[FloatArray], FloatArray]

HERE = Path(__file__).parent
DATA = HERE.parents[1] / "scoring" / "single_shot"


@dataclass(frozen=True)
class Trial:
    """One recording.

    Attributes:
        name: Name in the source.
        times_s: Times of the frames from 0, shape [T].
        angles_rad: Angles, shape [T, J].
        start_rates: Rates at the first frame [rad/s], shape [J].
        commands: Commanded angles [rad] or torques [N m], shape [T, J]; None where nothing is driven.
        load: Load of each servo [counts], shape [T, J]; None without servos.
    """

    name: str
    times_s: FloatArray
    angles_rad: FloatArray
    start_rates: FloatArray
    commands: FloatArray | None
    load: FloatArray | None = None

    @property
    def interval_s(self) -> float:
        """Time between frames [s]."""
        return float(self.times_s[1])


def trials(name: str) -> list[Trial]:
    """Return the recorded trials of an experiment; even ones are for fits, odd ones judge."""
    sidecar = tomllib.loads((DATA / f"{name}.toml").read_text(encoding="utf-8"))
    with np.load(DATA / f"{name}.npz") as archive:
        data = dict(archive)
    with np.load(HERE / "so101_load.npz") as archive:
        loads = archive["load"].astype(float)
    found = []
    for k, title in enumerate(sidecar["trials"]):
        rows = slice(*data["first"][k : k + 2])
        angles = sidecar["angle_unit_rad"] * data["angle"][rows].astype(float)
        commands = (
            sidecar["command_unit"] * data["command"][rows]
            if "command" in data
            else None
        )
        load = loads[rows] if name == "ServoArm-so101" else None
        times_s = data["interval_s"][k] * np.arange(len(angles))
        found.append(
            Trial(
                title,
                times_s,
                angles,
                data["start_angle_rate"][k].astype(float),
                commands,
                load,
            )
        )
    return found


def rollout(
    acceleration: Callable[[float, FloatArray, FloatArray], FloatArray],
    angles: FloatArray,
    rates: FloatArray,
    frames: int,
    interval_s: float,
    substeps: int,
) -> FloatArray:
    """Integrate copies of a smooth system with the classical Runge-Kutta scheme.

    Args:
        acceleration: Of time, angles and rates, each of the shape of the starts.
        angles: Angles at the start [rad], shape [copies, J].
        rates: Rates at the start [rad/s], shape [copies, J].
        frames: Number of frames to return.
        interval_s: Time between frames [s].
        substeps: Steps between frames.

    Returns:
        Angles [rad], shape [copies, frames, J].
    """
    step = interval_s / substeps
    q, v = np.array(angles), np.array(rates)
    kept = np.empty((len(q), frames, q.shape[1]))
    kept[:, 0] = q
    for frame in range(1, frames):
        for sub in range(substeps):
            time = (frame - 1) * interval_s + sub * step
            a1 = acceleration(time, q, v)
            v2 = v + 0.5 * step * a1
            a2 = acceleration(time + 0.5 * step, q + 0.5 * step * v, v2)
            v3 = v + 0.5 * step * a2
            a3 = acceleration(time + 0.5 * step, q + 0.5 * step * v2, v3)
            v4 = v + step * a3
            a4 = acceleration(time + step, q + step * v3, v4)
            q = q + step * (v + 2.0 * v2 + 2.0 * v3 + v4) / 6.0
            v = v + step * (a1 + 2.0 * a2 + 2.0 * a3 + a4) / 6.0
        kept[:, frame] = q
    return kept


def swing(
    acceleration: Callable[[int, FloatArray], FloatArray],
    starts: FloatArray,
    dry: FloatArray,
    viscous: FloatArray,
    frames: int,
    step_s: float,
    every: int,
) -> FloatArray:
    """Integrate copies of one joint with friction by steps of drift, kick, friction, drift.

    Friction is solved in a step: a dry one stops the joint where it can, and a joint that it stops stays.

    Args:
        acceleration: Of the frame and the angles [rad/s^2], without friction.
        starts: Angle [rad] and rate [rad/s] at the start, shape [2, copies].
        dry: Deceleration by dry friction [rad/s^2], shape [copies].
        viscous: Viscous friction over inertia [1/s], shape [copies].
        frames: Number of frames to return.
        step_s: Time step [s].
        every: Steps between frames.

    Returns:
        Angles [rad], shape [copies, frames].
    """
    q, v = np.array(starts)
    kept = np.empty((frames, len(q)))
    kept[0] = q
    decay, stop = np.exp(-viscous * step_s), dry * step_s
    for frame in range(1, frames):
        for _ in range(every):
            q = q + 0.5 * step_s * v
            v = v * decay + step_s * acceleration(frame - 1, q)
            v = v - np.clip(v, -stop, stop)
            q = q + 0.5 * step_s * v
        kept[frame] = q
    return kept.T


@dataclass(frozen=True)
class Fit:
    """Result of a least-squares fit: values, sum of squares, Jacobian and residuals."""

    values: FloatArray
    cost: float
    jacobian: FloatArray
    residual: FloatArray

    def errors(self) -> FloatArray:
        """Return standard errors for white residuals."""
        spread = self.cost / (len(self.residual) - len(self.values))
        return np.sqrt(
            spread
            * np.maximum(np.diag(np.linalg.pinv(self.jacobian.T @ self.jacobian)), 0.0)
        )


def fit(
    residuals: Residuals,
    guess: FloatArray,
    steps: FloatArray,
    rounds: int = 30,
    least: float = 0.0,
) -> Fit:
    """Minimize a sum of squares by Levenberg's and Marquardt's method; the copies of a Jacobian run as one batch.

    Args:
        residuals: Of parameters, shape [copies, P]; returns shape [copies, R].
        guess: Parameters at the start, shape [P].
        steps: Steps of the finite differences, shape [P].
        rounds: Most iterations.
        least: Smallest value of a parameter whose step is negative: such a one is no less than this.
    """
    bounded, steps = steps < 0.0, np.abs(steps)
    values, damping = np.array(guess, dtype=float), 1e-3
    rows = residuals(values + np.vstack([np.zeros_like(steps), np.diag(steps)]))
    for _ in range(rounds):
        base, jacobian = rows[0], (rows[1:] - rows[0]).T / steps
        cost = float(base @ base)
        normal, slope = jacobian.T @ jacobian, jacobian.T @ base
        improved = False
        for _ in range(8):
            change = np.linalg.solve(
                normal + damping * np.diag(np.diag(normal) + 1e-12), -slope
            )
            tried = values + change
            tried[bounded] = np.maximum(tried[bounded], least)
            new = residuals(tried + np.vstack([np.zeros_like(steps), np.diag(steps)]))
            new_cost = float(new[0] @ new[0])
            if np.isfinite(new_cost) and new_cost < cost:
                improved, damping = True, damping / 5.0
                break
            damping *= 5.0
        if not improved:
            break
        values, rows = tried, new
        if cost - new_cost < 1e-7 * cost:
            break
    base = rows[0]
    return Fit(values, float(base @ base), (rows[1:] - base).T / steps, base)


def ar_filter(residual: FloatArray, order: int) -> FloatArray:
    """Return the autoregressive filter 1, -a1, ... that makes a residual white (least squares), shape [order + 1]."""
    lagged = np.stack(
        [residual[order - k - 1 : len(residual) - k - 1] for k in range(order)], axis=1
    )
    return np.concatenate(
        [[1.0], -np.linalg.lstsq(lagged, residual[order:], rcond=None)[0]]
    )


def whitened(residual: FloatArray, white: FloatArray) -> FloatArray:
    """Return filtered residuals without the first ones, which the filter does not reach; time is the last axis."""
    return lfilter(white, [1.0], residual, axis=-1)[..., len(white) - 1 :]


def coloured(innovations: FloatArray, white: FloatArray) -> FloatArray:
    """Return the residual that a filter would have whitened."""
    return lfilter([1.0], white, innovations, axis=-1)


def write(name: str, header: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Write a table beside the scripts; numbers have four significant digits."""
    with (HERE / name).open("w", encoding="utf-8", newline="") as stream:
        table = csv.writer(stream, lineterminator="\n")
        table.writerow(header)
        for row in rows:
            table.writerow(
                [f"{entry:.4g}" if isinstance(entry, float) else entry for entry in row]
            )
