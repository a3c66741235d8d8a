"""A replay and its report: the answer, where model and log part, and what explains it."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from scipy.interpolate import make_interp_spline

from gauge_envs.backends.mujoco.messages import mujoco_warnings
from gauge_envs.pages.document import Document, Paragraph, Part, Tone
from gauge_envs.pages.table import Column, Table
from gauge_envs.tools.replay.causes import ZERO, Cause, candidates
from gauge_envs.tools.replay.conventions import check_fixed_base, find_conventions
from gauge_envs.tools.replay.fit import THRESHOLDS, Fit, Interval, Problem
from gauge_envs.tools.replay.log import FloatArray, Log, LogMap
from gauge_envs.tools.replay.model import (
    UNLIMITED,
    Replayer,
    default_angle,
    joint_names,
    law_setups,
    load_model,
)
from gauge_envs.tools.replay.observation import (
    check_policy,
    compare_commands,
    load_policy,
)
from gauge_envs.tools.replay.paste import Change
from gauge_envs.tools.replay.readers import read_log
from gauge_envs.tools.replay.schema import (
    Explained,
    ExplanationLine,
    JointReport,
    Prediction,
    ReplayVerdict,
    Trial,
    Value,
)
from gauge_envs.tools.replay.search import Explanation, explain

HORIZONS_S = {0.0: 200, 0.1: 150, 0.5: 60}
"""Lengths of the predictions of the table, and their number; the first is one interval of the log."""
NOISE_PIECES = 3
TRIAL_S = 0.5
MAX_ROWS = 12
"""Joints that the text shows, those with the largest error first."""
MAX_CAUSES = 4


@dataclass(frozen=True)
class ReplayResult:
    """What a log and a model say of each other.

    Attributes:
        line: The report.
        problem: The residuals of the log that is explained.
        change: The fit that the report is about; None where the model predicts the log.
    """

    line: ExplanationLine
    problem: Problem
    change: Fit | None

    @property
    def verdict(self) -> ReplayVerdict:
        """What explains the difference."""
        return self.line.verdict


def replay(
    log: Path,
    model: Path,
    against: Path | None = None,
    mapped: LogMap | None = None,
    advance: Callable[[str], None] = lambda _: None,
    policy: Path | None = None,
) -> ReplayResult:
    """Return what explains the difference between a log and a model, or between two logs.

    Args:
        log: The log; the first of two.
        model: MJCF or URDF.
        against: The second log, which is explained.
        mapped: Names, signs, units and gains.
        advance: Called with the name of each cause.
        policy: The policy that drove the robot, in ONNX or TorchScript.

    Raises:
        FileError: A file cannot be used.
        ParameterError: The log and the model do not go together.
    """
    given = mapped or LogMap()
    compiled = load_model(model, given.control)
    files = [log] if against is None else [log, against]

    def read(changed: LogMap) -> list[Log]:
        logs = [read_log(file, joint_names(compiled), changed) for file in files]
        for each in logs:
            check_fixed_base(each, compiled)
        return logs

    with mujoco_warnings():
        mapped, mistakes = find_conventions(lambda m: read(m)[-1], compiled, given)
        logs = read(mapped)
        explanation, misfit = _explain(logs, compiled, advance)
        if mistakes and explanation.verdict is not ReplayVerdict.NOISE:
            # A cause may explain as well what another convention does.
            others = read(given)
            other, misfit_of_other = _explain(others, compiled, advance)
            if misfit > misfit_of_other + THRESHOLDS.min_lead_of_convention:
                logs, explanation, mistakes = others, other, []
        sentences = _policy_side(logs, compiled, policy)
        line = _line(logs, model.name, explanation, mistakes, sentences)
    problem = explanation.problem
    named = explanation.change if line.named else None
    change = Change(
        before=problem.setup,
        after=named.shown_setup(problem.setup) if named else problem.setup,
        replayer=problem.replayer,
        file=model,
        given=given,
    )
    # The answer: mistakes of the log, what is missing in the model, and what is left.
    parts = [f"The log is wrong: {text}." for text in line.mistakes]
    is_read = explanation.verdict is not ReplayVerdict.LOG
    physics = _physics(line) if is_read else ()
    sentence = " ".join([*parts, *line.policy, *physics])
    line = replace(line, sentence=sentence, paste=change.lines())
    return ReplayResult(line, problem, explanation.change)


def _explain(
    logs: Sequence[Log],
    model: mujoco.MjModel,
    advance: Callable[[str], None],
) -> tuple[Explanation, float]:
    """Return what explains the last log, and the misfit that is left."""
    floor = 1.0
    if len(logs) > 1:
        first = Replayer(logs[0], model)
        floor = max(1.0, Problem(first, law_setups(first)[0]).before.error)
    replayer = Replayer(logs[-1], model)
    found: list[Explanation] = []
    for setup in law_setups(replayer):
        problem = Problem(replayer, setup, floor=floor)
        if not all(log.is_usable for log in logs):
            found.append(Explanation(problem, ReplayVerdict.LOG))
            break
        explanation = explain(problem, candidates(replayer, setup), advance)
        found.append(explanation)
        if explanation.verdict in (ReplayVerdict.NOISE, ReplayVerdict.CAUSE):
            break
    # The verdicts stand from a full explanation to none.
    explanation = min(found, key=lambda each: [*ReplayVerdict].index(each.verdict))
    problem = explanation.problem
    setup = (explanation.change or problem.before).change(problem.setup)
    misfit = replayer.misfit(setup, problem.pieces)
    return explanation, float(misfit.sum())


def _policy_side(
    logs: Sequence[Log], model: mujoco.MjModel, policy: Path | None
) -> tuple[str, ...]:
    """Return in what observation and action differ from state and command, a sentence each."""
    log, run = logs[-1], load_policy(policy) if policy else None
    home = np.array([default_angle(model, log, joint) for joint in log.joints])
    found = [*check_policy(log, home, run)]
    if len(logs) > 1 and not found:
        found = [*compare_commands(*logs)]
    return tuple(found)


def _line(
    logs: Sequence[Log],
    model: str,
    explanation: Explanation,
    mistakes: Sequence[str],
    policy: tuple[str, ...],
) -> ExplanationLine:
    """Return the report without its sentence and the lines to paste."""
    problem, several = explanation.problem, explanation.several
    change = explanation.change or problem.before
    *baseline, explained = logs
    alone = [_explained(problem, fit)[0] for fit in explanation.fits]
    together = _explained(problem, several) if several else []
    found = [text for each in logs for text in each.findings]
    for first, *_, last in problem.replayer.left_out:
        begin_s, end_s = explained.time_s[[first, last]]
        found.append(
            f"{begin_s:.3g} to {end_s:.3g} s are unlike the rest, and left out"
        )
    wrong = (text for each in logs for text in each.mistakes)
    verdict = explanation.verdict
    named = together if change is several else alone[:1]
    if not explanation.change or verdict is ReplayVerdict.NOTHING:
        named = []
    if mistakes or [each.cause for each in named] == [ZERO]:
        verdict = ReplayVerdict.LOG
    elif policy and verdict is not ReplayVerdict.LOG:
        verdict = ReplayVerdict.POLICY
    return ExplanationLine(
        log=explained.name,
        baseline=baseline[0].name if baseline else None,
        model=model,
        verdict=verdict,
        sentence="",
        error_over_noise=1.0 + problem.excess(problem.before),
        error_after=1.0 + problem.excess(change),
        baseline_over_noise=problem.floor if baseline else None,
        findings=tuple(dict.fromkeys(found)),
        mistakes=tuple(dict.fromkeys([*mistakes, *wrong])),
        policy=policy,
        trial=_try_change(problem, change),
        joints=_joint_reports(problem, _repeat(logs[0], explained)),
        candidates=tuple(alone),
        indistinguishable=tuple(explanation.indistinguishable),
        named=tuple(named),
        several=tuple(together),
        paste={},
    )


def _try_change(problem: Problem, change: Fit) -> Trial:
    """Return the error of predictions before and after a change, of the joint that is worst before."""
    replayer = problem.replayer
    pieces = replayer.pieces(TRIAL_S, 2 * THRESHOLDS.piece_count, outputs=1)[1::2]
    setups = problem.setup, change.change(problem.setup)
    before, after = (
        _rms(replayer.predict(each, pieces)[:, 0, replayer.is_joint]) for each in setups
    )
    worst = int(np.argmax(before))
    joint = replayer.log.joints[worst]
    is_hinge = replayer.model.joint(joint).type[0] == mujoco.mjtJoint.mjJNT_HINGE.value
    return Trial(
        joint=joint,
        horizon_s=TRIAL_S,
        before=float(before[worst]),
        after=float(after[worst]),
        unit="mrad" if is_hinge else "mm",
    )


def _rms(values: FloatArray) -> Any:
    return np.sqrt(np.mean(values**2, axis=0))


def _joint_reports(
    problem: Problem, repeat: Sequence[float] | None
) -> tuple[JointReport, ...]:
    """Return predictions over each horizon by joint, the worst first."""
    replayer, setup = problem.replayer, problem.setup
    log, is_joint = replayer.log, replayer.is_joint
    predictions = []
    for horizon_s, count in HORIZONS_S.items():
        pieces = replayer.pieces(horizon_s, count, outputs=1)
        few = replayer.pieces(horizon_s, NOISE_PIECES, outputs=1)
        variance = np.diagonal(replayer.covariance(setup, few), axis1=1, axis2=2)
        noise = np.sqrt(np.median(variance[:, is_joint], axis=0))
        rms = _rms(replayer.predict(setup, pieces)[:, 0, is_joint])
        kept = _rms(replayer.keep_velocity(pieces)[:, 0, is_joint])
        moved = np.diff(log.position[pieces], axis=1)[:, 0]
        motion = np.maximum(_rms(moved), 1e-9)
        numbers = np.transpose([rms, rms / noise, rms / motion, kept])
        length_s = horizon_s or log.interval_s
        predictions.append([Prediction(length_s, *row) for row in numbers])
    repeated: Sequence[float | None] = repeat or [None] * len(log.joints)
    columns = (log.joints, log.position_noise, repeated, zip(*predictions, strict=True))
    reports = [JointReport(*row) for row in zip(*columns, strict=True)]
    return tuple(sorted(reports, key=lambda row: -row.predictions[1].over_noise))


def _repeat(first: Log, second: Log) -> Sequence[float] | None:
    """Return the root mean square difference of two logs by joint; None if their commands differ."""
    columns, others = ((log.joints, log.command_names) for log in (first, second))
    if first is second or not first.command_kind or columns != others:
        return None
    common = second.time_s <= first.time_s[-1]
    time_s = second.time_s[common]
    commands = [
        make_interp_spline(log.command_time_s, log.command, k=1)(time_s).ravel()
        for log in (first, second)
    ]
    if np.corrcoef(*commands)[0, 1] < THRESHOLDS.min_correlation:
        return None
    repeated = make_interp_spline(first.time_s, first.position, k=1)(time_s)
    return _rms(repeated - second.position[common]).tolist()


def _explained(problem: Problem, fit: Fit) -> list[Explained]:
    """Return the causes of a fit as they are printed: by name, as the search may find either of two first."""
    explained, step_s = [], problem.replayer.log.command_interval_s
    for interval in sorted(fit.intervals(), key=lambda each: each.cause.name):
        cause, values = interval.cause, tuple(fitted_values(interval))
        text = _text(cause, interval.group.label, values, step_s)
        row = Explained(cause.name, text, problem.share(fit), cause.unit, values)
        explained.append(row)
    return explained


def fitted_values(interval: Interval) -> list[Value]:
    """Return the values of a cause that a fit changes."""
    cause, group, *columns = interval
    rows = np.transpose([cause.present, *columns]).tolist()
    values = []
    for k in np.flatnonzero(group.selection.any(axis=1)).tolist():
        present, fitted, low, high = rows[k]
        changes = low > present or high < present
        now = present if abs(present) < UNLIMITED else None
        ends = (None, None) if np.isnan(low) else (low, high)
        values.append(
            Value(cause.parameters[k], now, fitted, ends[0], ends[1], changes)
        )
    return values


def _text(cause: Cause, label: str, values: Sequence[Value], step_s: float) -> str:
    """Return a cause with its value, as `delay of 2 steps (40 ms)`."""
    name, unit = cause.name, f" {cause.unit}".rstrip()
    if not values:
        return f"{name}: {label}"
    value, numbers = values[0], [each.fitted for each in values]
    if name == "delay":
        steps = f"{value.fitted / step_s:.2g}"
        plural = "" if steps == "1" else "s"
        return f"delay of {steps} step{plural} ({1e3 * value.fitted:.3g} ms)"
    if len(values) == 1:
        now = "no limit" if value.present is None else f"{value.present:.3g}"
        return f"{name} of {value.parameter}: {value.fitted:.3g}{unit} (now {now})"
    if len(values) > 3:
        ends = dict.fromkeys(f"{end:.2g}" for end in (min(numbers), max(numbers)))
        return f"{name} of {label}: {' to '.join(ends)}{unit}"
    texts = [f"{each.parameter} {each.fitted:.3g}" for each in values]
    return f"{name}: {', '.join(texts)}{unit}"


def _physics(line: ExplanationLine) -> Iterator[str]:
    """Yield the sentences about the model."""
    times, trial = np.sqrt(line.error_after), line.trial
    if not line.candidates:
        if (line.baseline_over_noise or 1.0) > 1.5:
            yield f"The model predicts {line.log} as badly as {line.baseline}: the logs do not differ."
        else:
            yield (
                f"The model predicts {line.log} within its noise, and better than constant velocity: the physics "
                "agrees. Compare what the policy sees."
            )
        return
    best, several = line.candidates[0], line.several
    if not line.named:
        texts = f"best: {best.text}, {_percent(best.share)} %"
        if several:
            names = " and ".join(each.cause for each in several)
            texts += f"; together {names}, {_percent(several[-1].share)} %"
        yield f"Nothing in the list explains it ({texts})."
        yield f"The error is {_times(times)} times the noise."
        return
    texts = " and ".join(each.text for each in line.named)
    is_part = line.verdict is ReplayVerdict.PART
    verb = "take" if is_part else "explain"
    verb += "s" * (len(line.named) == 1)
    share = f"{_percent(line.named[0].share)} %{' of the error' if is_part else ''}"
    is_log = line.verdict is ReplayVerdict.LOG and not line.mistakes
    start = "The log is wrong: " if is_log else texts[0].upper()
    yield (
        f"{start}{texts if is_log else texts[1:]} {verb} {share}: {trial.horizon_s:g} s "
        f"prediction of {trial.joint} {_milli(trial.before)} to {_milli(trial.after)} {trial.unit}."
    )
    if is_part:
        yield f"Something outside the list remains: {_times(times)} times the noise."
    elif times > 2.0:
        yield f"{_times(times)} times the noise is left; nothing in the list explains that."


def _times(ratio: float) -> str:
    """Return a ratio with a digit after the point below ten."""
    return f"{ratio:.1f}" if ratio < 9.95 else f"{ratio:.0f}"


def replay_document(line: ExplanationLine) -> Document:
    """Return the answer, a table by joint, a table by cause, and the lines to paste."""
    warnings = [f"Log: {text}." for text in line.findings]
    if line.indistinguishable:
        best = " and ".join(each.cause for each in line.named)
        others = ", ".join(line.indistinguishable)
        warnings.insert(0, f"The log cannot tell {best} from: {others}.")
    numbers = {
        "noise": ("noise", _milli),
        "predictions.0.over_noise": ("1 step /noise", _ratio),
        "predictions.1.rms": ("0.1 s", _milli),
        "predictions.1.over_noise": ("/noise", _ratio),
        "predictions.1.over_motion": ("/motion %", _percent),
        "predictions.1.held_velocity_rms": ("const. vel.", _milli),
        "predictions.2.rms": ("0.5 s", _milli),
        "repeat_rms": ("repeat", _milli),
    }
    if line.joints[0].repeat_rms is None:
        del numbers["repeat_rms"]
    columns = [
        Column(key, title, form, is_number=True)
        for key, (title, form) in numbers.items()
    ]
    parts: list[Part] = [
        Paragraph(line.sentence, Tone.ANSWER),
        *(Paragraph(text, Tone.WARNING) for text in warnings),
        Table(
            title=f"Predictions from recorded states [mrad or mm], worst of {len(line.joints)} joints first",
            columns=(Column("joint", "joint"), *columns),
            rows=line.joints[:MAX_ROWS],
        ),
    ]
    if line.several and len(line.named) != 1:
        parts.append(_cause_table("Together", line.several))
    if line.candidates:
        parts.append(_cause_table("Alone", line.candidates[:MAX_CAUSES]))
    return Document(parts=parts, rows=[asdict(line)])


_ratio = "{:.3g}".format


def _milli(value: float) -> str:
    return _ratio(1e3 * value)


def _percent(share: float) -> str:
    return _ratio(100.0 * min(max(share, 0.0), 1.0))


def _interval(values: Sequence[Value]) -> str:
    """Return the 95 % interval of a cause with a single value."""
    if len(values) != 1 or values[0].low is None:
        return ""
    return f"{values[0].low:.3g} to {values[0].high:.3g}"


def _cause_table(title: str, causes: Sequence[Explained]) -> Table:
    """Return the table by cause."""
    columns = [
        Column("text", "cause"),
        Column("share", "%", _percent, is_number=True),
    ]
    if any(_interval(cause.values) for cause in causes):
        columns.append(Column("values", "95 %", _interval))
    return Table(
        title=f"{title}: share of the error on pieces that no fit has seen",
        columns=tuple(columns),
        rows=causes,
    )
