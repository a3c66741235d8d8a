"""A replay: logs and a model in, what explains their difference out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from gauge_envs.tools.replay.causes import Candidates
from gauge_envs.tools.replay.fit import Explanation, Fit, Problem, explain
from gauge_envs.tools.replay.log import FloatArray, Log, LogMap, read_log
from gauge_envs.tools.replay.model import build_setup, joint_names, load_model
from gauge_envs.tools.replay.predict import Replayer
from gauge_envs.tools.replay.schema import JointReport, Prediction, Verdict

HORIZONS_S = {0.0: 400, 0.1: 300, 0.5: 120}
"""Lengths of the predictions of the table, and their number; the first is one interval of the log."""
NOISE_PIECES = 4
LEAVES = 4.0
"""Error over noise at which a prediction has left the noise, twice in a row."""
MIN_CORRELATION = 0.99
"""Correlation of the commands from which on a second log is a repeat of the first."""


@dataclass(frozen=True)
class Replay:
    """What a log and a model say of each other.

    Attributes:
        model: Name of the model.
        logs: The logs; the last one is explained.
        explanation: The fits.
        joints: A row a joint, the largest error over noise first.
        conditions: Error over noise of predictions of 0.1 s by condition.
    """

    model: str
    logs: tuple[Log, ...]
    explanation: Explanation
    joints: tuple[JointReport, ...]
    conditions: dict[str, float]

    @property
    def verdict(self) -> Verdict:
        """What explains the difference."""
        if not self.explanation.fits:
            return Verdict.NOISE
        if self.explanation.has_cause:
            return Verdict.CAUSE
        return Verdict.SEVERAL if self.explanation.has_several else Verdict.NOTHING

    @property
    def named(self) -> tuple[Fit, ...]:
        """The causes that are named."""
        by_verdict = {
            Verdict.CAUSE: self.explanation.fits[:1],
            Verdict.SEVERAL: self.explanation.several,
        }
        return by_verdict.get(self.verdict, ())

    @property
    def best(self) -> Fit | None:
        """The fit that explains the most: the last of several, or a cause alone."""
        fits = (*self.explanation.fits[:1], *self.explanation.several[-1:])
        return max(fits, key=lambda fit: fit.share, default=None)


def replay(
    log: Path,
    model: Path,
    against: Path | None = None,
    mapped: LogMap | None = None,
    advance: Callable[[str], None] = lambda _: None,
) -> Replay:
    """Return what explains the difference between a log and a model, or between two logs.

    Args:
        log: The log; the first of two.
        model: MJCF or URDF.
        against: The second log, which is explained.
        mapped: Names, signs, units and gains.
        advance: Called with the name of each cause.

    Raises:
        FileError: A file cannot be used.
        ParameterError: The log and the model do not go together.
    """
    mapped = mapped or LogMap()
    compiled = load_model(model)
    logs = [
        read_log(file, joint_names(compiled), mapped)
        for file in filter(None, (log, against))
    ]
    problems = []
    for each in logs:
        setup = build_setup(compiled, each, mapped.control)
        problems.append(Problem(Replayer(each, setup.model), setup))
    problem = problems[-1]
    if against is not None:
        problem.floor = max(1.0, problems[0].error(problems[0].before))
    causes = Candidates(problem.replayer, problem.setup).causes()
    # A trial may make the simulation unstable; its error says so.
    mujoco.set_mju_user_warning(lambda _: None)
    try:
        explanation = explain(problem, causes, advance)
    finally:
        mujoco.set_mju_user_warning(None)
    joints, conditions = _joint_reports(problem, _repeat(logs))
    return Replay(model.name, tuple(logs), explanation, joints, conditions)


def _rms(values: FloatArray) -> FloatArray:
    return np.sqrt(np.mean(values**2, axis=0))


def _joint_reports(
    problem: Problem, repeat: FloatArray | None
) -> tuple[tuple[JointReport, ...], dict[str, float]]:
    """Return predictions over each horizon by joint, and the error over noise by condition."""
    replayer, setup = problem.replayer, problem.setup
    log, base = replayer.log, replayer.base_dofs
    predictions: list[list[Prediction]] = [[] for _ in log.joints]
    for horizon_s, count in HORIZONS_S.items():
        pieces = replayer.pieces(horizon_s, count, outputs=1)
        few = replayer.pieces(horizon_s, NOISE_PIECES, outputs=1)
        variance = np.diagonal(replayer.covariance(setup, few), axis1=1, axis2=2)
        noise = np.sqrt(np.median(variance, axis=0))[base:]
        error = replayer.predict(setup, pieces)[:, -1, base:]
        held = _rms(replayer.held_velocity(pieces)[:, -1])
        motion = _rms(log.position[pieces.sample[:, -1]] - log.position[pieces.start])
        rms = _rms(error)
        for joint, rows in enumerate(predictions):
            rows.append(
                Prediction(
                    horizon_s=horizon_s or log.interval_s,
                    rms=float(rms[joint]),
                    over_noise=float(rms[joint] / noise[joint]),
                    over_motion=float(rms[joint] / max(motion[joint], 1e-9)),
                    held_velocity_rms=float(held[joint]),
                )
            )
        if horizon_s == 0.1:
            ratio, starts = np.abs(error / noise), pieces.start
    conditions = replayer.conditions(setup, starts)[0]
    is_far = (ratio[:-1] > LEAVES) & (ratio[1:] > LEAVES)
    reports = []
    for joint, name in enumerate(log.joints):
        first = int(np.argmax(is_far[:, joint]))
        parts = bool(is_far[first, joint])
        reports.append(
            JointReport(
                joint=name,
                noise=float(log.position_noise[joint]),
                parts_s=float(log.time_s[starts[first]]) if parts else None,
                condition=str(conditions[first, joint]) if parts else "",
                repeat_rms=None if repeat is None else float(repeat[joint]),
                predictions=tuple(predictions[joint]),
            )
        )
    reports.sort(key=lambda row: -row.predictions[1].over_noise)
    by_condition = {
        str(name): float(_rms(ratio[conditions == name]))
        for name in np.unique(conditions)
    }
    return tuple(reports), by_condition


def _repeat(logs: Sequence[Log]) -> FloatArray | None:
    """Return the root mean square difference of two logs with the same commands, shape [J]; None otherwise."""
    first, second = logs[0], logs[-1]
    if first is second or not first.command_kind or first.joints != second.joints:
        return None
    times = second.time_s[second.time_s <= first.time_s[-1]]

    def at(time_s: FloatArray, values: FloatArray) -> FloatArray:
        return np.column_stack(
            [np.interp(times, time_s, column) for column in values.T]
        )

    commands = np.stack([at(log.command_time_s, log.command).ravel() for log in logs])
    if np.asarray(np.corrcoef(commands))[0, 1] < MIN_CORRELATION:
        return None
    return _rms(at(first.time_s, first.position) - at(second.time_s, second.position))
