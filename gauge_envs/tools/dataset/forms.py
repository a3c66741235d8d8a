"""Read the content of a trial file: a JSON object in the published form, or CSV with a column for each of its lists.

A JSON file has `FPS`, `translation unit`, and an object of lists `x`, `y`, `z` for each asset. The header of a CSV file
names the same lists `cube.x`, `cube.qw`, `foam.17.x`, and comments `# fps: 30` and `# unit: mm` state rate and unit.
Unit and rate are never inferred from the values: where a file has none, the caller states them (`Stated`). Columns of
other names are not read.
"""

import csv
import re
from dataclasses import dataclass
from typing import Any

from gauge_envs.files import csv_text, json_document
from gauge_envs.tools.dataset.findings import TrialError

RATE, UNIT = "FPS", "translation unit"

KEYS = {"x", "y", "z", "qx", "qy", "qz", "qw"}
"""Names of the lists of an asset."""

COMMENT = re.compile(r"^#\s*(fps|unit)\s*[:=]\s*(\S+)", re.MULTILINE | re.IGNORECASE)


@dataclass(frozen=True, kw_only=True)
class Stated:
    """What a user states for files that do not.

    Attributes:
        unit: `mm`, `cm` or `m`.
        rate_hz: Frames in a second.
    """

    unit: str | None = None
    rate_hz: float | None = None


def published_form(content: bytes, suffix: str, stated: Stated) -> dict[str, Any]:
    """Return the content of a trial file as the object of a published file.

    Args:
        content: The file's bytes.
        suffix: Suffix of the file, in lower case: one of `FORMS`.
        stated: Unit and rate of files that do not state them.
    """
    try:
        values = FORMS[suffix](content)
        if not isinstance(values, dict):
            raise ValueError(f"it is a {type(values).__name__}")
    except (ValueError, csv.Error) as error:
        expected = "a complete file of objects and lists is expected"
        kind = suffix[1:].upper()
        raise TrialError("(file)", f"it is not {kind}: {error}", expected) from None
    return {RATE: stated.rate_hz, UNIT: stated.unit, **values}


def _csv_document(content: bytes) -> dict[str, Any]:
    """Return columns by asset, or by asset and marker, and the rate and unit of the comments."""
    text = csv_text(content).getvalue()
    stated = {
        RATE if name.lower() == "fps" else UNIT: _value(value)
        for name, value in COMMENT.findall(text)
    }
    lines = [line for line in text.splitlines() if line.strip() and line[0] != "#"]
    rows = list(csv.reader(lines))
    if len(rows) < 2 or len(set(map(len, rows))) > 1:
        raise ValueError("a header and rows of equal length are needed")
    if len(set(rows[0])) < len(rows[0]):
        raise ValueError("a column occurs twice")
    document: dict[str, Any] = {}
    for name, *texts in zip(*rows, strict=True):
        *path, key = name.strip().split(".")
        if len(path) in (1, 2) and key in KEYS and path[-1] not in KEYS:
            lists = document
            for part in path:
                lists = lists.setdefault(part, {})
            lists[key] = list(map(_value, texts))
    return document | stated


def _value(text: str) -> float | str | None:
    """Return a number, or None for an empty field; other text is a fault where its column is needed."""
    try:
        return float(text) if text.strip() else None
    except ValueError:
        return text


FORMS = {".json": json_document, ".csv": _csv_document}
"""Readers by suffix; the first form counts where a trial is there in both."""
