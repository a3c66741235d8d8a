"""Constants of many joints, fitted together to several logs."""

from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from gauge_envs.backends.mujoco.messages import mujoco_warnings
from gauge_envs.errors import ParameterError
from gauge_envs.files import write_whole
from gauge_envs.names import first_names
from gauge_envs.pages.document import Document, Paragraph, Tone
from gauge_envs.pages.table import Column, Table
from gauge_envs.tools.replay.causes import Cause, ParameterGroup, candidates
from gauge_envs.tools.replay.fit import (
    THRESHOLDS,
    Fit,
    Problem,
    all_halves,
    fit_values,
    least_residuals,
)
from gauge_envs.tools.replay.judge import (
    YAML,
    judge_document,
    judge_setups,
    load_setups,
)
from gauge_envs.tools.replay.log import LogMap
from gauge_envs.tools.replay.model import Replayer, Setup
from gauge_envs.tools.replay.paste import Change
from gauge_envs.tools.replay.report import fitted_values
from gauge_envs.tools.replay.schema import ConstantsLine, Value

ATTRIBUTES = {"frictionloss": "dry friction", "kv": "kd", "forcerange": "effort limit"}
"""Causes by the name of their attribute in MJCF."""


def fit_logs(
    logs: Sequence[Path],
    model: Path,
    tests: Sequence[Path],
    names: Sequence[str],
    joints: Sequence[str],
    mapped: LogMap,
    write: Path | None = None,
) -> ConstantsLine:
    """Return constants that are fitted to logs, with predictions of other logs.

    Args:
        logs: What is fitted.
        model: MJCF or URDF.
        tests: Logs that the fit does not see; without any, the predictions are of the fitted ones.
        names: Causes or attributes of MJCF, as `armature`.
        joints: Joints, or none for all.
        mapped: Names, signs, units and gains.
        write: MJCF file for the model with the constants, or YAML file for `mujoco.sysid`.

    Raises:
        FileError: A file cannot be used.
        ParameterError: A name is none of the model.
    """
    with mujoco_warnings():
        pairs = load_setups(logs, model, mapped)
        fit, unknown = fit_constants(pairs, names, joints)
        present = load_setups(tests or logs, model, mapped)
        fitted = [(each, fit.change(setup)) for each, setup in present]
        judged = judge_setups([model.name, "fitted"], [present, fitted])
        replayer, setup = pairs[0]
        change = Change(
            before=setup,
            after=fit.shown_setup(setup),
            replayer=replayer,
            file=model,
            given=mapped,
        )
        values = constant_values(fit)
        if write is not None and write.suffix in YAML:
            write_whole(write, parameter_dict(values))
        elif write is not None:
            change.write(write)
    return ConstantsLine(tuple(values), tuple(unknown), tuple(judged), change.lines())


def fit_constants(
    pairs: Sequence[tuple[Replayer, Setup]], names: Sequence[str], joints: Sequence[str]
) -> tuple[Fit, list[str]]:
    """Return a fit of constants that makes the predictions of all logs best, and constants that these do not determine.

    Of each joint, the number whose interval is widest,
    and far wider than its value, keeps the present value, and the others are fitted again.

    Args:
        pairs: The logs.
        names: Causes or attributes of MJCF, as `armature`.
        joints: Joints, or none for all.

    Raises:
        ParameterError: A name is none of the model.
    """
    problems = []
    for replayer, setup in pairs:
        piece_s = min(THRESHOLDS.value_s, 0.25 * replayer.longest_s())
        count = THRESHOLDS.value_count
        problems.append(Problem(replayer, setup, piece_s=piece_s, count=count))
    terms = _terms(problems[0], names, joints)
    unknown: list[str] = []
    while True:
        start = []
        for cause, group in terms:
            present = (cause.present - cause.zero) / cause.scale
            lower = cause.lower(group)
            start.append(np.clip(group.selection.T @ present, lower, cause.far))
        fit = Fit(terms=tuple(terms), numbers=np.concatenate(start))
        numbers = least_residuals(fit, all_halves(problems)).x
        fit = fit_values(replace(fit, numbers=numbers), problems)
        lost = _undetermined(fit)
        if not lost:
            return fit, unknown
        unknown += [f"{cause} of {parameter}" for parameter, cause in lost.items()]
        terms = []
        for cause, group in fit.terms:
            rows = np.argmax(group.selection, axis=0)
            kept = [lost.get(cause.parameters[row]) != cause.name for row in rows]
            if any(kept):
                selection = group.selection[:, kept]
                terms.append((cause, ParameterGroup(group.label, selection)))
        if not terms:
            return problems[0].before, unknown


def _undetermined(fit: Fit) -> dict[str, str]:
    """Return the cause whose interval is too wide, by parameter; the one with the widest interval."""
    widest: dict[str, tuple[float, str]] = {}
    for cause, group, fitted, _low, high in fit.intervals():
        width = (high - fitted) / np.maximum(np.abs(fitted), cause.scale)
        for row in np.argmax(group.selection, axis=0).tolist():
            parameter, found = cause.parameters[row], (width[row], cause.name)
            if width[row] > THRESHOLDS.max_width:
                widest[parameter] = max(widest.get(parameter, found), found)
    return {parameter: cause for parameter, (_width, cause) in widest.items()}


def _terms(
    problem: Problem, names: Sequence[str], joints: Sequence[str]
) -> list[tuple[Cause, ParameterGroup]]:
    """Return the causes with a number for each of the joints; a cause without joints has all its numbers."""
    replayer = problem.replayer
    causes = {
        cause.name: cause
        for cause in reversed(candidates(replayer, problem.setup))
        if cause.parameters
    }
    for joint in joints:
        if joint not in replayer.log.joints:
            known = first_names(replayer.log.joints)
            raise ParameterError(f"--joint {joint}: the log has {known}")
    terms = []
    for given in names:
        name = ATTRIBUTES.get(given, given)
        if name not in causes:
            known = first_names(sorted({*causes, *ATTRIBUTES}), 20)
            raise ParameterError(f"--fit {given}: expected some of {known}")
        cause = causes[name]
        chosen = [
            place
            for place, parameter in enumerate(cause.parameters)
            if not joints or parameter in joints or parameter == name
        ]
        selection = np.eye(len(cause.parameters))[:, chosen]
        terms.append((cause, ParameterGroup("each", selection)))
    return terms


def constant_values(fit: Fit) -> list[Value]:
    """Return the fitted values, whose names contain the cause."""
    return [
        replace(value, parameter=f"{interval.cause.name} of {value.parameter}")
        for interval in fit.intervals()
        for value in fitted_values(interval)
    ]


def parameter_dict(values: Sequence[Value]) -> bytes:
    """Return constants as a file that `ParameterDict.load_from_disk` of `mujoco.sysid` reads, bounded by intervals."""
    lines = []
    for value in values:
        nominal = value.fitted if value.present is None else value.present
        # A nominal value outside of the interval widens the bounds.
        ends = [end for end in (value.low, value.high, nominal) if end is not None]
        numbers = {
            "nominal": nominal,
            "min_value": min(ends),
            "max_value": max(ends),
            "value": value.fitted,
        }
        # YAML 1.1 reads an exponent only after a point.
        fields = ", ".join(f"{key}: [{x:.9e}]" for key, x in numbers.items())
        name = f'"{value.parameter}"'
        lines.append(f"{name}: {{name: {name}, {fields}, frozen: false}}\n")
    return "".join(lines).encode()


def constants_document(line: ConstantsLine) -> Document:
    """Return the constants, what the logs do not determine, and the predictions with them."""
    number = "{:.4g}".format
    keys = {"present": "now", "fitted": "fitted", "low": "from", "high": "to"}
    columns = [
        Column(key, title, number, is_number=True) for key, title in keys.items()
    ]
    parts = [
        *judge_document(line.predictions).parts,
        Table(
            title="Constants, with 95 % intervals",
            columns=(Column("parameter", "constant"), *columns),
            rows=line.values,
        ),
    ]
    if line.unknown:
        text = f"The logs do not determine: {', '.join(line.unknown)}."
        parts.append(Paragraph(text, Tone.WARNING))
    return Document(parts=parts, rows=[asdict(line)])
