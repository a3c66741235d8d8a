"""The report of a replay: the answer, where model and log part, and what explains it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict

import numpy as np

from gauge_envs.pages.document import Document, Paragraph, Part, Tone
from gauge_envs.pages.table import Column, Table
from gauge_envs.tools.replay.causes import UNLIMITED
from gauge_envs.tools.replay.fit import Fit
from gauge_envs.tools.replay.replay import Replay
from gauge_envs.tools.replay.schema import (
    Explained,
    JointReport,
    ReplayLine,
    Value,
    Verdict,
)
from gauge_envs.tools.replay.snippets import paste_lines

MAX_ROWS = 12
"""Joints that the text shows, those with the largest error first."""
MAX_CAUSES = 4


def replay_line(replay: Replay) -> ReplayLine:
    """Return the report of a replay as it is printed."""
    explanation, log = replay.explanation, replay.logs[-1]
    problem = explanation.problem
    candidates, several, named = (
        tuple(_explained(fit, log.command_interval_s) for fit in fits)
        for fits in (explanation.fits, explanation.several, replay.named)
    )
    has_two = len(replay.logs) > 1
    left = problem.error(
        problem.before if replay.best is None else replay.best.residuals
    )
    return ReplayLine(
        log=log.name,
        baseline=replay.logs[0].name if has_two else None,
        model=replay.model,
        verdict=replay.verdict,
        sentence=_sentence(replay, candidates, several, left),
        error_over_noise=problem.error(problem.before),
        error_after=left,
        baseline_over_noise=problem.floor if has_two else None,
        findings=tuple(
            dict.fromkeys(text for each in replay.logs for text in each.findings)
        ),
        joints=replay.joints,
        conditions=replay.conditions,
        candidates=candidates,
        alike=tuple(dict.fromkeys(fit.cause.name for fit in explanation.alike)),
        several=several,
        paste=paste_lines(named, problem.setup.model.opt.timestep),
    )


def _explained(fit: Fit, command_interval_s: float) -> Explained:
    """Return a fitted cause as it is printed."""
    cause = fit.cause
    is_moved = fit.group.directions.any(axis=1)
    moved = np.flatnonzero(is_moved)
    present = cause.values(cause.present)
    values = []
    for k in moved:
        fitted = float(fit.values(fit.numbers)[k])
        low, high = (
            None if numbers is None else float(fit.values(numbers)[k])
            for numbers in (fit.low, fit.high)
        )
        changes = low is not None and high is not None and not low <= present[k] <= high
        now = float(present[k]) if abs(present[k]) < UNLIMITED else None
        name = cause.parameters[k]
        values.append(
            Value(
                parameter=name,
                present=now,
                fitted=fitted,
                low=low,
                high=high,
                changes=changes,
            )
        )
    text = _text(fit, values, command_interval_s)
    return Explained(
        cause=cause.name,
        text=text,
        share=fit.share,
        unit=cause.measure,
        values=tuple(values),
    )


def _text(fit: Fit, values: Sequence[Value], command_interval_s: float) -> str:
    """Return a cause with its value, as `delay of 2 steps (40 ms)`."""
    name, unit, label = fit.cause.name, fit.cause.measure, fit.group.label
    if not values:
        return f"{name}: {label}"
    value = values[0]
    if name == "delay":
        return f"delay of {value.fitted / command_interval_s:.2g} steps ({1e3 * value.fitted:.3g} ms)"
    if len(values) == 1:
        now = "no limit" if value.present is None else f"{value.present:.3g}"
        return f"{name} of {value.parameter}: {value.fitted:.3g} {unit} (now {now})".replace(
            "  ", " "
        )
    if label.startswith("all"):
        ratios = [each.fitted / each.present for each in values if each.present]
        if len(ratios) == len(values) and np.ptp(ratios) < 1e-6:
            return f"{name} x {ratios[0]:.3g} ({label})"
    if len(values) <= 3:
        return f"{name}: {', '.join(f'{each.parameter} {each.fitted:.3g}' for each in values)} {unit}"
    numbers = [each.fitted for each in values]
    return f"{name} of {label}: {min(numbers):.2g} to {max(numbers):.2g} {unit}"


def _sentence(
    replay: Replay,
    candidates: Sequence[Explained],
    several: Sequence[Explained],
    left: float,
) -> str:
    """Return the answer."""
    log, floor = replay.logs[-1].name, replay.explanation.problem.floor
    remains = (
        f"; what is left is {np.sqrt(left):.0f} times the noise" if left > 4.0 else ""
    )
    if replay.verdict is Verdict.NOISE and floor > 1.5:
        return f"The model predicts {log} as badly as {replay.logs[0].name}: nothing parts the logs{remains}."
    if replay.verdict is Verdict.NOISE:
        return f"The model predicts {log} within its noise: nothing is left to explain."
    best = f"{candidates[0].text} explains {_percent(candidates[0].share)} % of the difference"
    if replay.verdict is Verdict.CAUSE:
        return f"{best}{remains}."
    share = f"{_percent(several[-1].share)} %" if several else ""
    if replay.verdict is Verdict.SEVERAL:
        together = " and ".join(each.text for each in several)
        alone = f"{candidates[0].cause}, {_percent(candidates[0].share)} %"
        return f"{together} together explain {share} of the difference (best alone: {alone}){remains}."
    alone = f"best: {candidates[0].text}, {_percent(candidates[0].share)} %"
    together = " and ".join(each.cause for each in several)
    more = f"; together {together}, {share}" if several else ""
    return f"Nothing in the list explains it ({alone}{more}){remains}."


def replay_document(line: ReplayLine) -> Document:
    """Return the answer, a table by joint, a table by cause, and the lines to paste."""
    parts: list[Part] = [Paragraph(line.sentence, Tone.ANSWER)]
    if line.alike:
        text = f"The log cannot tell {line.candidates[0].cause} from: {', '.join(line.alike)}."
        parts.append(Paragraph(text, Tone.WARNING))
    parts += [Paragraph(f"Log: {text}.", Tone.WARNING) for text in line.findings]
    parts.append(_joint_table(line.joints))
    if len(line.conditions) > 1:
        texts = [f"{name} {value:.3g}" for name, value in line.conditions.items()]
        parts.append(Paragraph(f"Error over noise after 0.1 s: {', '.join(texts)}."))
    if line.several and line.verdict is not Verdict.CAUSE:
        parts.append(_cause_table("Together", line.several))
    if line.candidates:
        parts.append(_cause_table("Alone", line.candidates[:MAX_CAUSES]))
    return Document(parts=parts, rows=[asdict(line)])


def _milli(value: float) -> str:
    return f"{1e3 * value:.3g}"


def _ratio(value: float) -> str:
    return f"{value:.2g}" if value < 10.0 else f"{value:.0f}"


def _percent(share: float) -> str:
    return (
        f"{100.0 * max(share, 0.0):.0f}"
        if share < 0.995
        else f"{100.0 * min(share, 1.0):.4g}"
    )


def _joint_table(joints: Sequence[JointReport]) -> Table:
    """Return the table by joint."""
    left = len(joints) - MAX_ROWS
    numbers = {
        "noise": ("noise", _milli),
        "predictions.0.over_noise": ("1 step /noise", _ratio),
        "predictions.1.rms": ("0.1 s", _milli),
        "predictions.1.over_noise": ("/noise", _ratio),
        "predictions.1.over_motion": ("/motion %", _percent),
        "predictions.1.held_velocity_rms": ("held vel.", _milli),
        "predictions.2.rms": ("0.5 s", _milli),
        "repeat_rms": ("repeat", _milli),
        "parts_s": ("parts at s", _ratio),
    }
    if joints[0].repeat_rms is None:
        del numbers["repeat_rms"]
    columns = [
        Column(key, title, form, is_number=True)
        for key, (title, form) in numbers.items()
    ]
    return Table(
        title="Predictions from recorded states [mrad or mm]",
        columns=(Column("joint", "joint"), *columns, Column("condition", "in")),
        rows=joints[:MAX_ROWS],
        notes=(f"{left} more joints with smaller errors: --format json",)
        if left > 0
        else (),
    )


def _cause_table(title: str, causes: Sequence[Explained]) -> Table:
    """Return the table by cause."""
    rows = []
    for cause in causes:
        value = cause.values[0] if len(cause.values) == 1 else None
        interval = ""
        if value is not None and value.low is not None and value.high is not None:
            interval = f"{value.low:.3g} to {value.high:.3g} {cause.unit}"
        rows.append({"text": cause.text, "share": cause.share, "interval": interval})
    return Table(
        title=f"{title}: share of the error on pieces that no fit has seen",
        columns=(
            Column("text", "cause"),
            Column("share", "%", _percent, is_number=True),
            Column("interval", "95 %"),
        ),
        rows=rows,
    )
