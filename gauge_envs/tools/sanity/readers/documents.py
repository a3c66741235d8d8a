"""Read files that a user names."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from gauge_envs.errors import TargetError
from gauge_envs.files import os_errors, path_exists
from gauge_envs.text import text_of


def file_text(path: Path) -> str:
    """Return the text of a file in UTF-8, or in UTF-16 with a byte-order mark, as Windows writes it.

    Raises:
        TargetError: The file is not there, is empty, or is no text.
    """
    if not path_exists(path):
        raise TargetError(f"{path}: there is no such file")
    with os_errors(lambda cause: TargetError(f"{path}: cannot be read: {cause}")):
        content = path.read_bytes()
    try:
        text = text_of(content)
    except ValueError as error:
        raise TargetError(f"{path}: {error}") from None
    if not text.strip():
        raise TargetError(f"{path}: is empty")
    return text


def file_value(path: Path, parse: Callable[[str], Any]) -> Any:
    """Return the value of a file, by a function that raises `ValueError` for what it cannot parse."""
    text = file_text(path)
    try:
        return parse(text)
    except ValueError as error:
        raise TargetError(f"{path}: {error}") from None
