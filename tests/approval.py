"""Approved outputs: text of a command that a person has read, kept in `tests/approved` and compared by each test run.

A text is the same if its words and spaces are, and its numbers within the last place that is printed. What depends on
the machine and not on the product is replaced by a name first: folders, versions of packages, seconds of the clock,
lines of progress, spaces at the ends of lines.
"""

from __future__ import annotations

import difflib
import json
import re
import shlex

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

ROUNDING = 1e-12
"""Largest number that may be nothing but rounding."""

MACHINE = (
    (r'"versions": \{[^{}]*\}', '"versions": {...}'),
    (
        r'"(wall_s|cpu_s|created|processor|task_sha256)": ("[^"]*"|[-+\d.e]+)',
        r'"\1": ...',
    ),
    (r"\b(gauge-envs|gymnasium|mujoco|numpy|python) \d+(\.\w+)+", r"\1 VERSION"),
    (r"^\d+/\d+ \S+ on \S+: \w+.*\n", ""),
    (r" +$", ""),
)
"""Patterns of what a machine adds to an output, with what stands in its place."""


def without_machine(text, folders):
    """Return a text in which names stand for folders and for all that depends on the machine."""
    for name, folder in folders.items():
        if folder != folder.parent:
            text = text.replace(str(folder), name)
    for pattern, name in MACHINE:
        text = re.sub(pattern, name, text, flags=re.MULTILINE)
    return f"{text.strip()}\n"


def difference(name, text, *, approve):
    """Return the lines in which a text differs from the approved one, or write it if it is to be approved."""
    file = FOLDER / f"{name}.txt"
    stored = file.read_text() if file.is_file() else ""
    if same_text(_without_empty_lines(stored), _without_empty_lines(text)):
        return ""
    if approve:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
        return ""
    lines = difflib.unified_diff(
        stored.splitlines(),
        text.splitlines(),
        f"approved/{name}.txt",
        "now",
        lineterm="",
    )
    return "\n".join(lines)


def _without_empty_lines(text):
    """Return a text without empty lines, of which versions of rich print different numbers."""
    return re.sub(r"\n{2,}", "\n", text)


def refused_commands(gauge, *commands):
    """Return what commands answer that cannot be met, each after its line; none prints a result."""
    answers = []
    for command in commands:
        result = gauge(*shlex.split(command))
        assert (result.exit_code, result.stdout) == (2, ""), result.output
        answers.append(f"$ gauge {command}\n{result.stderr.strip()}\n")
    return "\n".join(answers)


def refused_calls(error, calls):
    """Return the messages of calls that raise an error, each after its name."""
    messages = []
    for name, call in calls.items():
        with pytest.raises(error) as caught:
            call()
        messages.append(f"{name}: {type(caught.value).__name__}: {caught.value}")
    return "\n".join(messages)


def readable(result):
    """Return the exit code and the streams of a command; JSON has an indent and four digits."""
    parts = [f"exit code {result.exit_code}"]
    for stream in (result.stdout, result.stderr):
        lines = [_readable_json(line) for line in stream.splitlines()]
        parts.append("\n".join(lines))
    return "\n---\n".join(parts)


def _readable_json(line):
    if not line.startswith("{"):
        return line
    return json.dumps(
        json.loads(line, parse_float=_four_digits), indent=1, ensure_ascii=False
    )


def _four_digits(text):
    """Round a number; what only rounding has left over is zero."""
    number = float(text)
    return float(f"{number:.4g}") if abs(number) > ROUNDING else 0.0
