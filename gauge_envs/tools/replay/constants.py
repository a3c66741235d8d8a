"""Constants of many joints, fitted together to several logs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from scipy.optimize import approx_fprime, least_squares
from scipy.stats import t as student

from gauge_envs.errors import ParameterError
from gauge_envs.names import first_names
from gauge_envs.pages.document import Document, Paragraph, Tone
from gauge_envs.pages.table import Column, Table
from gauge_envs.tools.replay.causes import Cause, ParameterGroup, candidates
from gauge_envs.tools.replay.fit import THRESHOLDS, Fit, Problem
from gauge_envs.tools.replay.judge import judge_document, judge_setups, load_setups
from gauge_envs.tools.replay.log import FloatArray, LogMap
from gauge_envs.tools.replay.model import quiet_engine, uses_degrees
from gauge_envs.tools.replay.paste import Change
from gauge_envs.tools.replay.report import fitted_values
from gauge_envs.tools.replay.schema import ConstantsLine, Value

ATTRIBUTES = {"frictionloss": "dry friction", "kv": "kd", "forcerange": "effort limit"}
"""Causes by the name of their attribute in MJCF."""
MAX_WIDTH = 1.0
"""Half of the 95 % interval of a number, over the present or typical value, up to which the logs determine it."""


@dataclass(frozen=True)
class Constants:
    """Constants that were fitted.

    Attributes:
        fit: The fit, with the numbers that the logs determine.
        values: Them, and the present values of the others.
        unknown: Numbers that the logs do not determine.
    """

    fit: Fit
    values: Sequence[Value]
    unknown: Sequence[str]


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
        write: MJCF file for the model with the constants.

    Raises:
        FileError: A file cannot be used.
        ParameterError: A name is none of the model.
    """
    with quiet_engine():
        problems = [Problem(*pair) for pair in load_setups(logs, model, mapped)]
        found = fit_constants(problems, names, joints)
        present = load_setups(tests or logs, model, mapped)
        fitted = []
        for replayer, setup in present:
            for (cause, group), numbers in found.fit.split(found.fit.numbers):
                setup = cause.change(setup, group, numbers)
            fitted.append((replayer, setup))
        judged = judge_setups([model.name, "fitted"], [present, fitted])
        change = Change(
            before=problems[0].setup,
            after=problems[0].shown_setup(found.fit),
            replayer=problems[0].replayer,
            in_degrees=uses_degrees(model),
            given=mapped,
            mapped=mapped,
        )
        if write is not None:
            change.write(model, write)
    return ConstantsLine(
        tuple(found.values), tuple(found.unknown), tuple(judged), change.lines()
    )


def fit_constants(
    problems: Sequence[Problem], names: Sequence[str], joints: Sequence[str]
) -> Constants:
    """Return constants of joints that make the predictions of all logs best, by least squares.

    A number whose interval is wider than its value keeps the present value, and the others are fitted again.

    Args:
        problems: The logs.
        names: Causes or attributes of MJCF, as `armature`.
        joints: Joints, or none for all.

    Raises:
        ParameterError: A name is none of the model.
    """
    terms = _terms(problems[0], names, joints)
    unknown: list[str] = []
    while True:
        fit = Fit(
            terms=tuple(terms),
            numbers=np.concatenate([_start(*term) for term in terms]),
            training=np.zeros(0),
            slopes=np.zeros(0),
        )
        fit = _minimize(problems, fit)
        width = np.asarray(fit.half_width)
        if (width < MAX_WIDTH).all():
            return Constants(fit, _values(fit), unknown)
        kept = []
        for (cause, group), widths in fit.split(width):
            known = widths < MAX_WIDTH
            for column in group.selection.T[~known]:
                parameter = cause.parameters[int(np.argmax(column))]
                unknown.append(f"{cause.name} of {parameter}")
            if known.any():
                columns = group.selection[:, known]
                kept.append((cause, ParameterGroup(group.label, columns)))
        if not kept:
            return Constants(problems[0].before, (), unknown)
        terms = kept


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


def _start(cause: Cause, group: ParameterGroup) -> FloatArray:
    """Return the numbers of the present values, inside of the bounds, shape [p]."""
    numbers = (cause.present - cause.zero) / cause.scale
    lower = cause.lower(group)
    return np.clip(group.selection.T @ numbers, lower, cause.far)


def _minimize(problems: Sequence[Problem], fit: Fit) -> Fit:
    """Return the least squares over all pieces of all logs, with intervals."""

    def residuals(numbers: FloatArray) -> FloatArray:
        rows = [
            problem.residuals(fit, numbers, half)
            for problem in problems
            for half in (0, 1)
        ]
        return np.concatenate(rows).ravel()

    def slopes(numbers: FloatArray) -> FloatArray:
        return approx_fprime(numbers, residuals, THRESHOLDS.slope_step)

    found = least_squares(
        residuals,
        fit.numbers,
        slopes,
        bounds=(np.minimum(fit.lower, fit.numbers), fit.upper),
        ftol=THRESHOLDS.min_gain,
        max_nfev=THRESHOLDS.max_predictions,
    )
    freedom = len(found.fun) - len(found.x)
    # Residuals of a model that is not perfect are correlated in a piece: each piece counts once.
    pieces = sum(len(problem.pieces) for problem in problems)
    variance = 2.0 * found.cost / freedom * len(found.fun) / pieces
    spread = np.sqrt(np.diag(np.linalg.pinv(found.jac.T @ found.jac)))
    half = student.ppf(0.975, pieces) * spread * np.sqrt(max(variance, 1.0))
    return replace(fit, numbers=found.x, half_width=half)


def _values(fit: Fit) -> list[Value]:
    """Return the fitted values, whose names contain the cause."""
    return [
        replace(value, parameter=f"{interval.cause.name} of {value.parameter}")
        for interval in fit.intervals()
        for value in fitted_values(interval)
    ]


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
