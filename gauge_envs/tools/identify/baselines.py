"""What servos do by laws without a model of the joint: the least that an identified model has to beat."""

from collections.abc import Sequence

import numpy as np
from scipy.optimize import minimize

from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.identify.logs import Log

FIRST_LAG = (1.0, 0.0, 0.02, 0.05, 0.01)
"""First guess of the five numbers of a lag; see `lagged`."""
LAG_STEPS = (0.05, 0.05, 0.05, 0.05, 0.02)
"""First steps of the search, in the units of the numbers."""


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


def baselines(logs: Sequence[Log], held_out: Sequence[Log]) -> dict[str, FloatArray]:
    """Return errors of two plain laws in logs of servos [rad], by name of the log, shape [2, J] each.

    The first law is that the angle is the command, the second a lag of five numbers (`lagged`), fitted to `logs` alone.

    Args:
        logs: Logs to fit.
        held_out: Logs that are only predicted.
    """

    def error(log: Log, joint: int, lag: Sequence[float]) -> FloatArray:
        assert log.command_rad is not None
        measured = log.position_rad[:, joint]
        command = log.command_rad[:, joint]
        return lagged(log.times_s, command, float(measured[0]), lag) - measured

    def misfit(lag: FloatArray, joint: int) -> float:
        if lag[2:].min() < 0.0:
            return float("inf")
        numbers = lag.tolist()
        return float(sum((error(log, joint, numbers) ** 2).sum() for log in logs))

    everything = (*logs, *held_out)
    errors = {log.name: np.zeros((2, log.position_rad.shape[1])) for log in everything}
    for joint in range(logs[0].position_rad.shape[1]):
        first = np.array(FIRST_LAG)
        simplex = np.vstack([first, first + np.diag(LAG_STEPS)])
        found = minimize(
            misfit,
            first,
            args=(joint,),
            method="Nelder-Mead",
            options={"initial_simplex": simplex, "xatol": 1e-3, "fatol": 1e-3 * misfit(first, joint)},
        )  # fmt: skip
        for log in everything:
            assert log.command_rad is not None
            follows = log.command_rad[:, joint] - log.position_rad[:, joint]
            for row, left in enumerate((follows, error(log, joint, found.x))):
                errors[log.name][row, joint] = np.sqrt((left**2).mean())
    return errors
