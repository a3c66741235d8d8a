"""Texts of names, numbers and lists that all documents share."""

import re
from collections.abc import Mapping, Sequence
from typing import Any

from gauge_envs.references.kind import Kind
from gauge_envs.references.metrics import METRICS
from gauge_envs.text import printable

METRIC_TITLES = {key: metric.title for key, metric in METRICS.items()}

MAX_ENTRIES = 4
"""Largest number of entries of a list that are written."""

MAX_NAMES = 6
"""Largest number of names that are all written."""
KIND_NOTES = {
    Kind.TRIALS: "mean and standard deviation of the real trials at each frame",
    Kind.RECORDING: "one recorded real trial, with the published scatter",
    Kind.PUBLISHED: "mean and scatter computed from published numbers of real trials; no motion was measured",
    Kind.ANALYTIC: "closed form of the scene of the task file. The score is the error of the engine",
    Kind.NUMERICAL: "refined solution of the scene of the task file. The score is the error of the engine",
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
    if abs(value) < 1000.0:
        return f"{value:.3g}"
    return f"{value:.0f}"


def pairs_text(values: Mapping[str, Any], *, skip: Sequence[str] = ()) -> str:
    """Return `key = value, key = value`, without some keys."""
    shown = {key: value for key, value in values.items() if key not in skip}
    return ", ".join(f"{key} = {value_text(value)}" for key, value in shown.items())


def value_text(value: Any) -> str:
    """Return a value as people write it: rounded numbers, the first few entries of a list."""
    if isinstance(value, float):
        return f"{value:.10g}"
    if isinstance(value, Mapping):
        return f"({pairs_text(value)})"
    if isinstance(value, list):
        texts = [value_text(entry) for entry in value[:MAX_ENTRIES]]
        if len(value) > MAX_ENTRIES:
            texts.append(f"... {len(value)} in all")
        return f"[{', '.join(texts)}]"
    return str(value)


def short_id(name: str) -> str:
    """Return the id of an experiment without `GAUGE/`."""
    return name.removeprefix("GAUGE/")


def shortened(names: Sequence[str]) -> str:
    """Return names in a line; if there are more than six, the first three and the last."""
    if len(names) <= MAX_NAMES:
        return ", ".join(names)
    return f"{', '.join(names[:3])}, ... {names[-1]} ({len(names)})"


def plus_minus_text(mean: float, std: float | None, unit: str) -> str:
    """Return `mean +- std unit`."""
    text = f"{mean:g}"
    if std is not None:
        text += f" +- {std:g}"
    return with_unit(text, unit)


def with_unit(text: str, unit: str) -> str:
    """Return a text with its unit; the unit `1` is not written."""
    if unit == "1":
        return text
    return f"{text} {unit}"


def counted(number: int, noun: str) -> str:
    """Return a number with its noun: `1 check`, `2 checks`."""
    if number == 1:
        return f"{number} {noun}"
    return f"{number} {noun}s"


def score_text(value: float | None) -> str:
    """Return a score to two decimals, or to two digits below 0.1; 0.000 below 0.0005; a dash for None."""
    if value is None:
        return "-"
    if 0.0 < abs(value) < 5e-4:
        return "0.000"
    if abs(value) < 0.1:
        return f"{value:.2g}"
    if abs(value) < 100.0:
        return f"{value:.2f}"
    return f"{value:.3g}"


def interval_text(value: float | None, interval: Sequence[float] | None) -> str:
    """Return a score with its 95 % interval, `0.41 [0.17, 1.43]`; a dash for None."""
    if value is None or interval is None:
        return score_text(value)
    low, high = map(score_text, interval)
    return f"{score_text(value)} [{low}, {high}]"


def quantity_text(value: float) -> str:
    """Return a number with three digits; only tiny and huge numbers have an exponent."""
    size = abs(value)
    if 1e3 <= size < 1e5:
        return f"{value:.0f}"
    if 0.0 < size < 1e-3:
        return f"{value:.1e}"
    return f"{value:.3g}"


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
