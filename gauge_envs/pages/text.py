"""Texts of names, numbers and lists that all documents share."""

import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from gauge_envs.references.kind import Kind
from gauge_envs.references.metrics import METRICS
from gauge_envs.text import printable

METRIC_TITLES = {key: metric.title for key, metric in METRICS.items()}

KIND_NOTES = {
    Kind.TRIALS: "mean and standard deviation of the real trials at each frame",
    Kind.RECORDING: "one recorded real trial, with the published scatter",
    Kind.ANALYTIC: "closed form of the calibrated scene. The score is the error of the engine",
    Kind.NUMERICAL: "refined solution of the calibrated scene. The score is the error of the engine",
    Kind.NONE: "no reference motion; events may have real values",
}


def event_title(name: str) -> str:
    """Return the name of an event or estimate as words without the unit: `lag_mm` is `lag`."""
    words = re.sub(r"_(m_per_s2|deg|mm|hz|s)$", "", name).replace("_", " ")
    return METRIC_TITLES.get(name, words)


def digits_text(value: float | None) -> str:
    """Return a number with three digits; a dash for None."""
    if value is None:
        return "-"
    return f"{value:.3g}" if abs(value) < 1000.0 else f"{value:.0f}"


def pairs_text(values: Mapping[str, Any], *, skip: Sequence[str] = ()) -> str:
    """Return `key = value, key = value`, without some keys."""
    return ", ".join(
        f"{key} = {value_text(value)}"
        for key, value in values.items()
        if key not in skip
    )


def value_text(value: Any) -> str:
    """Return a value as people write it: rounded numbers, the first few entries of a list."""
    if isinstance(value, float):
        return f"{value:.10g}"
    if isinstance(value, Mapping):
        return f"({pairs_text(value)})"
    if isinstance(value, list):
        return f"[{', '.join(map(value_text, value[:4]))}{f', ... {len(value)} in all' if len(value) > 4 else ''}]"
    return str(value)


def short_id(name: str) -> str:
    """Return the id of an experiment without `GAUGE/`."""
    return name.removeprefix("GAUGE/")


def shortened(names: Sequence[str]) -> str:
    """Return names in a line; if there are more than six, the first three and the last."""
    return (
        ", ".join(names)
        if len(names) <= 6
        else f"{', '.join(names[:3])}, ... {names[-1]} ({len(names)})"
    )


def plus_minus_text(mean: float, std: float | None, unit: str) -> str:
    """Return `mean +- std unit`."""
    return with_unit(f"{mean:g}" + ("" if std is None else f" +- {std:g}"), unit)


def with_unit(text: str, unit: str) -> str:
    """Return a text with its unit; the unit `1` is not written."""
    return text if unit == "1" else f"{text} {unit}"


def counted(number: int, noun: str) -> str:
    """Return a number with its noun: `1 check`, `2 checks`."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


def score_text(value: float | None) -> str:
    """Return a score to two decimals, or to two digits below 0.1; a dash for None."""
    if value is None:
        return "-"
    return (
        f"{value:.2f}"
        if 0.1 <= abs(value) < 100
        else f"{value:.2g}"
        if abs(value) < 0.1
        else f"{value:.3g}"
    )


def interval_text(
    value: float | None,
    interval: Sequence[float] | None,
    text: Callable[[float | None], str] = score_text,
) -> str:
    """Return a score with its 95 % interval, `0.41 [0.17, 1.43]`; a dash for None."""
    ends = (
        ""
        if value is None or interval is None
        else f" [{text(interval[0])}, {text(interval[1])}]"
    )
    return text(value) + ends


def quantity_text(value: float) -> str:
    """Return a number with three digits; only tiny and huge numbers have an exponent."""
    size = abs(value)
    if 1e3 <= size < 1e5:
        return f"{value:.0f}"
    return f"{value:.3g}" if size >= 1e-3 or size == 0.0 else f"{value:.1e}"


class Markdown(str):
    """Text with intended Markdown; all other texts are escaped."""

    __slots__ = ()


def markdown_text(text: str) -> str:
    """Return a text in one line with escaped Markdown."""
    if isinstance(text, Markdown):
        return text
    plain = printable(" ".join(text.split()))
    # A bracket alone, as in an interval, stays. It starts a link only if a bracket follows.
    return re.sub(r"([|*_<`\\]|\](?=[(\[])|!(?=\[))", r"\\\1", plain)
