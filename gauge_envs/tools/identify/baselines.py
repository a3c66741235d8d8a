"""What joints do by laws without a model: the least that an identified model has to beat."""

from collections.abc import Callable, Sequence

import numpy as np
from scipy.optimize import least_squares, minimize

from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.identify.logs import Log

Predicted = Callable[[Log], FloatArray]
"""The angle of a joint at the times of a log [rad], shape [N]."""
FIRST_LAG = (1.0, 0.0, 0.02, 0.05, 0.01)
"""First guess of the five numbers of a lag; see `lagged`."""
LAG_STEPS = (0.05, 0.05, 0.05, 0.05, 0.02)
"""First steps of the search, in the units of the numbers."""

LAG_SAMPLE_S = 0.005
"""Time between the samples to which a lag is fitted, where logs have more [s]."""


def lagged(
    times_s: FloatArray, command_rad: FloatArray, start_rad: float, lag: Sequence[float]
) -> FloatArray:
    """Return the angle of a lag with play, at the times of its commands [rad], shape [N].

    The angle approaches gain * command + offset, exponentially with a time constant, and stops at the edge of the play
    about it. A command stays until the next one.

    Args:
        times_s: Times of the commands [s], shape [N].
        command_rad: Commanded angles [rad], shape [N].
        start_rad: Angle at the first time [rad].
        lag: Gain; offset [rad]; delay [s]; time constant [s]; half of the play [rad].
    """
    gain, offset_rad, delay_s, constant_s, play_rad = lag
    rows = np.searchsorted(times_s, times_s[:-1] - delay_s, side="right") - 1
    targets = gain * command_rad[np.maximum(rows, 0)] + offset_rad
    shares = 1.0 - np.exp(-np.diff(times_s) / max(constant_s, 1e-9))
    angle, angles = start_rad, [start_rad]
    for target, share in zip(targets.tolist(), shares.tolist(), strict=True):
        miss = target - angle
        if miss > play_rad:
            angle += share * (miss - play_rad)
        elif miss < -play_rad:
            angle += share * (miss + play_rad)
        angles.append(angle)
    return np.array(angles)


def baselines(
    logs: Sequence[Log], held_out: Sequence[Log]
) -> dict[str, dict[str, FloatArray]]:
    """Return errors of plain laws [rad], by log and law, shape [J] each; their numbers are fitted to `logs` alone.

    Of servos, `command` is the command itself and `lag` a lag of five numbers (`lagged`). Of joints that swing freely,
    `cosine` is a decaying one of three numbers (`decaying`). Each log starts as it was recorded.

    Args:
        logs: Logs to fit.
        held_out: Logs that are only predicted.
    """
    everything = (*logs, *held_out)
    errors: dict[str, dict[str, FloatArray]] = {log.name: {} for log in everything}
    laws: dict[str, Callable[[Sequence[Log], int], Predicted]] = {}
    if logs[0].command_rad is not None:
        laws = {"command": _command, "lag": _lag}
    elif logs[0].torque_n_m is None:
        laws = {"cosine": _cosine}
    for name, law in laws.items():
        follow = [law(logs, joint) for joint in range(logs[0].position_rad.shape[1])]
        for log in everything:
            left = [
                one(log) - log.position_rad[:, joint]
                for joint, one in enumerate(follow)
            ]
            errors[log.name][name] = np.sqrt((np.array(left) ** 2).mean(axis=1))
    return errors


def _command(_: Sequence[Log], joint: int) -> Predicted:
    def angle(log: Log) -> FloatArray:
        assert log.command_rad is not None
        return log.command_rad[:, joint]

    return angle


def _lag(logs: Sequence[Log], joint: int) -> Predicted:
    """Fit a lag to a joint of logs, at samples up to `LAG_SAMPLE_S` apart."""
    thin = [log.thinned(LAG_SAMPLE_S) for log in logs]

    def angle(log: Log, lag: Sequence[float]) -> FloatArray:
        assert log.command_rad is not None
        start_rad = float(log.position_rad[0, joint])
        return lagged(log.times_s, log.command_rad[:, joint], start_rad, lag)

    def misfit(lag: FloatArray) -> float:
        if lag[2:].min() < 0.0:
            return float("inf")
        numbers = lag.tolist()
        left = (angle(log, numbers) - log.position_rad[:, joint] for log in thin)
        return float(sum((one**2).sum() for one in left))

    first = np.array(FIRST_LAG)
    simplex = np.vstack([first, first + np.diag(LAG_STEPS)])
    found = minimize(
        misfit,
        first,
        method="Nelder-Mead",
        options={"initial_simplex": simplex, "xatol": 1e-3, "fatol": 1e-3 * misfit(first)},
    )  # fmt: skip
    return lambda log: angle(log, found.x.tolist())


def decaying(log: Log, joint: int, numbers: Sequence[float]) -> FloatArray:
    """Return the angle of a linear oscillator from the recorded start of a log [rad], shape [N].

    Args:
        log: The log.
        joint: Number of the joint.
        numbers: Angle at rest [rad]; decay of the amplitude [1/s]; frequency [rad/s].
    """
    rest_rad, decay, frequency = numbers
    angle, rate = (one[joint] for one in log.start())
    times_s = log.times_s - log.times_s[0]
    swing = (angle - rest_rad) * np.cos(frequency * times_s)
    swing += (
        (rate + decay * (angle - rest_rad)) / frequency * np.sin(frequency * times_s)
    )
    return np.asarray(rest_rad + np.exp(-decay * times_s) * swing)


def _cosine(logs: Sequence[Log], joint: int) -> Predicted:
    """Fit a decaying cosine to a joint of logs, from the frequency at which the first one crosses its mean."""
    first = logs[0]
    about = first.position_rad[:, joint] - first.position_rad[:, joint].mean()
    crossings = max(int((np.diff(np.sign(about)) != 0).sum()), 1)
    guess = [
        float(first.position_rad[:, joint].mean()),
        0.1,
        np.pi * crossings / first.duration_s,
    ]

    def residuals(numbers: FloatArray) -> FloatArray:
        left = [
            decaying(log, joint, numbers.tolist()) - log.position_rad[:, joint]
            for log in logs
        ]
        return np.concatenate(left)

    found = least_squares(residuals, guess, x_scale=np.maximum(np.abs(guess), 0.1))
    return lambda log: decaying(log, joint, found.x.tolist())
