"""Approved outputs: text of a command that a person has read, kept in `tests/approved` and compared by each test run.

A text is the same if its words and spaces are, and its numbers within the last place that is printed. What depends on
the machine and not on the product is replaced by a name first: folders, versions of packages, seconds of the clock,
spaces at the ends of lines.
"""

from __future__ import annotations

import difflib
import json
import re
import shlex
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest
from places import ROOT

from scripts.generated import same_text

FOLDER = ROOT / "tests" / "approved"

TERMINAL = {
    "COLUMNS": "160",
    "TERM": "dumb",
    "NO_COLOR": "1",
    "FORCE_COLOR": None,
    "PYTHONWARNINGS": None,
}
"""Environment variables of a command, so that its output has no colours and one width."""

MACHINE = (
    (r'"versions": \{[^{}]*\}', '"versions": {...}'),
    (r'"(wall_s|cpu_s|created|task_sha256)": ("[^"]*"|[-+\d.e]+)', r'"\1": ...'),
    (r"gauge-envs \d+\.\d+[\w.+-]*", "gauge-envs VERSION"),
    (r" +$", ""),
)
"""Patterns of what a machine adds to an output, with what stands in its place."""


def without_machine(text: str, folders: Mapping[str, Path]) -> str:
    """Return a text in which names stand for folders and for all that depends on the machine."""
    for name, folder in folders.items():
        if folder != folder.parent:
            text = text.replace(str(folder), name)
    for pattern, name in MACHINE:
        text = re.sub(pattern, name, text, flags=re.MULTILINE)
    return f"{text.strip()}\n"


def difference(name: str, text: str, *, approve: bool) -> str:
    """Return the lines in which a text differs from the approved one, or write it if it is to be approved."""
    file = FOLDER / f"{name}.txt"
    stored = file.read_text(encoding="utf-8") if file.is_file() else ""
    if same_text(stored, text):
        return ""
    if approve:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text, encoding="utf-8")
        return ""
    lines = difflib.unified_diff(
        stored.splitlines(),
        text.splitlines(),
        f"approved/{name}.txt",
        "now",
        lineterm="",
    )
    return "\n".join(lines)


def refused_commands(gauge: Callable[..., Any], *commands: str) -> str:
    """Return what commands answer that cannot be met, each after its line; none prints a result."""
    answers = []
    for command in commands:
        result = gauge(*shlex.split(command))
        assert (result.exit_code, result.stdout) == (2, ""), result.output
        answers.append(f"$ gauge {command}\n{result.stderr.strip()}\n")
    return "\n".join(answers)


def refused_calls(
    error: type[Exception], calls: Mapping[str, Callable[[], object]]
) -> str:
    """Return the messages of calls that raise an error, each after its name."""
    messages = []
    for name, call in calls.items():
        with pytest.raises(error) as caught:
            call()
        messages.append(f"{name}: {type(caught.value).__name__}: {caught.value}")
    return "\n".join(messages)


def readable(result: Any) -> str:
    """Return the exit code and the streams of a command; JSON has an indent and four digits."""
    parts = [f"exit code {result.exit_code}"]
    for stream in (result.stdout, result.stderr):
        lines = [_readable_json(line) for line in stream.splitlines()]
        parts.append("\n".join(lines))
    return "\n---\n".join(parts)


def _readable_json(line: str) -> str:
    if not line.startswith("{"):
        return line
    values = json.loads(line, parse_float=lambda text: float(f"{float(text):.4g}"))
    return json.dumps(values, indent=1, ensure_ascii=False)
