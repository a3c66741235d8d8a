"""Laws of friction of two real pendulums: dry against viscous, by likelihood with correlated residuals.

    python -m studies.joints.pendulums

Writes swings.csv (fits), envelope.csv (amplitudes), law_test.csv (likelihood ratios) and envelope.png.
"""

from __future__ import annotations

import csv
import tomllib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray
from scipy.signal import find_peaks, lfilter

from gauge_envs.files import data_folder

FloatArray = NDArray[np.float64]
Residuals = Callable[[FloatArray], FloatArray]

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
) -> Fit:
    """Minimize a sum of squares by Levenberg's and Marquardt's method; the copies of a Jacobian run as one batch.

    Args:
        residuals: Of parameters, shape [copies, P]; returns shape [copies, R].
        guess: Parameters at the start, shape [P].
        steps: Steps of the finite differences, shape [P]; a negative one keeps its parameter at 0 or above.
        rounds: Most iterations.
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
            tried[bounded] = np.maximum(tried[bounded], 0.0)
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


def write(name: str, header: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Write a table beside the scripts; numbers have four significant digits."""
    with (HERE / name).open("w", encoding="utf-8", newline="") as stream:
        table = csv.writer(stream, lineterminator="\n")
        table.writerow(header)
        for row in rows:
            table.writerow(
                [f"{entry:.4g}" if isinstance(entry, float) else entry for entry in row]
            )


STEPS = 10
"""Steps between two frames, of 1 ms."""
EVERY, AR_ORDER = 5, 4
"""Frames from one residual to the next, 50 ms, and order of their filter; closer ones repeat each other."""

BLOCK = 8
"""Residuals of a block of the bootstrap: half a period."""

COPIES = 2000
LAWS = ("dry", "viscous", "both")

DRY, VISCOUS = 2, 3
SCALES = np.array([1e-2, 1e-5, 5e-3, 1e-3, 1e-4, 1e-3])
"""Steps of frequency squared, rest angle, dry and viscous friction over inertia, start angle and rate."""


def simulate(values: FloatArray, frames: int, interval_s: float) -> FloatArray:
    """Return angles [rad] of a pendulum, shape [copies, frames].

    Args:
        values: Per copy: frequency squared [1/s^2], rest angle [rad], dry friction over inertia [rad/s^2], viscous
            friction over inertia [1/s], start angle [rad] and rate [rad/s], shape [copies, 6].
        frames: Number of frames.
        interval_s: Time between them [s].
    """
    stiffness, rest, dry, viscous, angle, rate = values.T

    def acceleration(_: int, q: FloatArray) -> FloatArray:
        return -stiffness * np.sin(q - rest)

    starts = np.stack([angle, rate])
    return swing(acceleration, starts, dry, viscous, frames, interval_s / STEPS, STEPS)


def full(values: FloatArray, law: str) -> FloatArray:
    """Return parameters with the friction that a law lacks set to 0, shape [copies, 6]."""
    found = np.array(values)
    found[:, 2] *= law != "viscous"
    found[:, 3] *= law != "dry"
    return found


def fit_law(trial: Trial, law: str, white: FloatArray, guess: FloatArray) -> Fit:
    """Fit one law to one trial; the residual is whitened."""
    observed, frames = trial.angles_rad[:, 0], len(trial.times_s)

    def residuals(values: FloatArray) -> FloatArray:
        simulated = simulate(full(values, law), frames, trial.interval_s)
        return whitened((simulated - observed)[:, ::EVERY], white)

    steps = SCALES * np.array([1.0, 1.0, -1.0, -1.0, 1.0, 1.0])
    return fit(residuals, guess, steps)


def guess_of(trial: Trial) -> FloatArray:
    """Return a first guess of the parameters."""
    return np.array(
        [65.0, 0.0, 0.05, 0.02, trial.angles_rad[0, 0], trial.start_rates[0]]
    )


def log_ratio(smaller: Fit, larger: Fit) -> float:
    """Return twice the logarithm of the likelihood ratio, for an unknown variance."""
    return len(larger.residual) * float(np.log(smaller.cost / larger.cost))


@dataclass(frozen=True)
class Verdict:
    """Laws fitted to one trial.

    Attributes:
        fits: Fit of each law to plain residuals.
        errors: Standard errors of the parameters of each, from blocks of a period of its residuals.
        ratios: Twice the log likelihood ratio of dry and viscous friction against one law alone.
        chances: Share of copies of the recording, made by one law alone, with a ratio as large.
    """

    fits: dict[str, Fit]
    errors: dict[str, FloatArray]
    ratios: dict[str, float]
    chances: dict[str, float]


def law_test(trial: Trial, rng: np.random.Generator) -> Verdict:
    """Fit all laws to a trial, and test each single law by copies of the recording where it alone is true.

    Residuals of a copy are blocks of the whitened ones. Its fits are linear, about the values that made it.
    """
    plain = {
        law: fit_law(trial, law, np.ones(1), guess_of(trial))
        for law in ("dry", "viscous")
    }
    best = min(plain.values(), key=lambda one: one.cost)
    plain["both"] = fit_law(trial, "both", np.ones(1), best.values)
    errors = {law: errors_of(plain[law], rng) for law in LAWS}
    white = ar_filter(plain["both"].residual, AR_ORDER)
    fits = {
        law: fit_law(trial, law, white, plain[law].values) for law in ("dry", "viscous")
    }
    best = min(fits.values(), key=lambda one: one.cost)
    starts = (plain["both"].values, best.values)
    fits["both"] = min(
        (fit_law(trial, "both", white, one) for one in starts), key=lambda one: one.cost
    )
    ratios = {law: log_ratio(fits[law], fits["both"]) for law in ("dry", "viscous")}
    innovations = fits["both"].residual - fits["both"].residual.mean()
    chances = {}
    for law, other in (("dry", VISCOUS), ("viscous", DRY)):
        values = full(fits[law].values[None], law)[0]
        slopes = slopes_at(trial, white, values)
        copies = np.array([blocks(innovations, rng) for _ in range(COPIES)]).T
        alone = np.delete(slopes, other, axis=1)
        # A negative friction is none, so that the larger model is no better then.
        added = np.linalg.lstsq(slopes, copies, rcond=None)[0][other] > 0.0
        costs = [
            np.square(copies - one @ np.linalg.lstsq(one, copies, rcond=None)[0]).sum(
                axis=0
            )
            for one in (alone, slopes)
        ]
        drawn = np.where(added, len(copies) * np.log(costs[0] / costs[1]), 0.0)
        chances[law] = float(
            (1 + np.count_nonzero(drawn >= ratios[law])) / (1 + COPIES)
        )
    return Verdict(plain, errors, ratios, chances)


def errors_of(found: Fit, rng: np.random.Generator) -> FloatArray:
    """Return standard errors of parameters, shape [6]: blocks of residuals are drawn, and fits are linear."""
    drawn = np.array([blocks(found.residual, rng, 2 * BLOCK) for _ in range(200)])
    return np.std(np.linalg.pinv(found.jacobian) @ drawn.T, axis=1)


def slopes_at(trial: Trial, white: FloatArray, values: FloatArray) -> FloatArray:
    """Return the derivatives of whitened angles by all parameters, shape [R, 6]."""
    moved = np.maximum(
        values + np.diag(SCALES), np.array([0.0, -np.inf, 0.0, 0.0, -np.inf, -np.inf])
    )
    both = simulate(np.vstack([values, moved]), len(trial.times_s), trial.interval_s)
    return (
        whitened(both[1:, ::EVERY], white) - whitened(both[:1, ::EVERY], white)
    ).T / SCALES


def blocks(
    values: FloatArray, rng: np.random.Generator, length: int = BLOCK
) -> FloatArray:
    """Return as many values, in blocks that are drawn with replacement."""
    starts = rng.integers(0, len(values) - length, len(values) // length + 1)
    return np.concatenate([values[first : first + length] for first in starts])[
        : len(values)
    ]


def peaks(trial: Trial, rest: float) -> FloatArray:
    """Return times and amplitudes of the turning points, parabolas through three frames, shape [count, 2]."""
    q = trial.angles_rad[:, 0] - rest
    found = []
    for k in find_peaks(np.abs(q), height=0.004, distance=25)[0]:
        near = slice(max(k - 4, 0), k + 5)
        c2, c1, c0 = np.polyfit(trial.times_s[near] - trial.times_s[k], q[near], 2)
        found.append((trial.times_s[k] - 0.5 * c1 / c2, abs(c0 - 0.25 * c1 * c1 / c2)))
    return np.array(found)


def held_out_mrad(values: FloatArray, law: str, trial: Trial) -> float:
    """Return the error of a law on another trial from its recorded start [mrad rms]."""
    start = np.array([trial.angles_rad[0, 0], trial.start_rates[0]])
    given = full(np.concatenate([values[:4], start])[None], law)
    simulated = simulate(given, len(trial.times_s), trial.interval_s)[0]
    return 1e3 * float(np.sqrt(np.mean(np.square(simulated - trial.angles_rad[:, 0]))))


def picture(
    joints: dict[str, list[Trial]], rests: dict[str, float], fits: dict[str, Fit]
) -> None:
    """Draw amplitudes over time, and what the two laws alone give."""
    figure, axes = plt.subplots(1, 2, figsize=(9, 3.4), layout="constrained")
    for axis, (name, swings) in zip(axes, joints.items(), strict=True):
        found = fits[name]
        for k, trial in enumerate(swings):
            begin = sum(float(one.times_s[-1]) + one.interval_s for one in swings[:k])
            turning = peaks(trial, rests[name])
            axis.plot(
                begin + turning[:, 0],
                turning[:, 1],
                "k.",
                label="recorded" if k == 0 else None,
            )
        time = np.linspace(0.0, begin + float(swings[-1].times_s[-1]), 200)
        first = peaks(swings[0], rests[name])[0]
        stiffness, dry, viscous = (
            found["both"].values[0],
            found["dry"].values[DRY],
            found["viscous"].values[VISCOUS],
        )
        linear = first[1] - 2.0 * dry / np.sqrt(stiffness) / np.pi * (time - first[0])
        axis.plot(time, np.maximum(linear, 0.0), label="dry: linear")
        axis.plot(
            time,
            first[1] * np.exp(-0.5 * viscous * (time - first[0])),
            "--",
            label="viscous: exponential",
        )
        axis.set(
            xlabel="time [s]",
            ylabel="amplitude [rad]",
            title=f"JointPendulum-{name}",
            ylim=(0.0, None),
        )
        axis.legend()
    figure.savefig(HERE / "envelope.png", dpi=110)


def main() -> None:
    """Fit, test and write the tables."""
    rng = np.random.default_rng(0)
    joints = {name: trials(f"JointPendulum-{name}") for name in ("dry", "viscous")}
    swings, tests, envelope, first = [], [], [], {}
    for name, pieces in joints.items():
        for k, trial in enumerate(pieces):
            verdict = law_test(trial, rng)
            first.setdefault(name, verdict.fits)
            for law in LAWS:
                found = verdict.fits[law]
                values, errors = full(found.values[None], law)[0], verdict.errors[law]
                stiffness, rest, dry, viscous = values[:4]
                fitted = (
                    simulate(values[None], len(trial.times_s), trial.interval_s)[0]
                    - trial.angles_rad[:, 0]
                )
                held = (
                    held_out_mrad(found.values, law, pieces[k + 1])
                    if k % 2 == 0
                    else float("nan")
                )
                period, loss = 2.0 * np.pi / np.sqrt(stiffness), 4e3 * dry / stiffness
                fitted_mrad = 1e3 * float(np.sqrt(np.mean(np.square(fitted))))
                frictions = (dry, errors[DRY], viscous, errors[VISCOUS], loss)
                swings.append(
                    (
                        f"{name}-{k}",
                        law,
                        period,
                        1e3 * rest,
                        *frictions,
                        fitted_mrad,
                        held,
                    )
                )
            for law in ("dry", "viscous"):
                tests.append(
                    (f"{name}-{k}", law, verdict.ratios[law], verdict.chances[law])
                )
            turning = peaks(trial, float(verdict.fits["both"].values[1]))
            whole = turning[2:, 1], turning[:-2, 1], turning[2:, 0] - turning[:-2, 0]
            envelope += [
                (f"{name}-{k}", a, 1e3 * (a - b), t)
                for b, a, t in zip(*whole, strict=True)
            ]
    frictions = (
        "dry_rad_per_s2",
        "dry_error",
        "viscous_per_s",
        "viscous_error",
        "dry_loss_a_cycle_mrad",
    )
    write(
        "swings.csv",
        (
            "trial",
            "law",
            "period_s",
            "rest_mrad",
            *frictions,
            "fit_mrad",
            "next_trial_mrad",
        ),
        swings,
    )
    write("law_test.csv", ("trial", "law_alone", "likelihood_ratio", "chance"), tests)
    write(
        "envelope.csv",
        ("trial", "amplitude_rad", "loss_in_the_cycle_mrad", "period_s"),
        envelope,
    )
    picture(
        joints,
        {name: float(fits["both"].values[1]) for name, fits in first.items()},
        first,
    )


if __name__ == "__main__":
    main()
