"""Read files that a user names."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from gauge_envs.errors import TargetError
from gauge_envs.reading import reading
from gauge_envs.text import filled_text


def file_text(path: Path) -> str:
    """Return the content of a file.

    Raises:
        TargetError: The file is not there, is empty, or is no text.
    """
    with reading(path, TargetError) as content:
        return filled_text(content)


def file_value(path: Path, parse: Callable[[bytes], Any]) -> Any:
    """Return the value of a file, by a function that parses its content."""
    with reading(path, TargetError) as content:
        return parse(content)
