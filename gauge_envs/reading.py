"""Read files of users. Each error of a reader becomes one sentence with the name of the file."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from gauge_envs.errors import FileError, GaugeError, MissingExtraError
from gauge_envs.text import printable
from gauge_envs.validation import first_fault

MAX_REASON = 400
"""Longest reason of a reader [characters]."""


def content_of(file: Path) -> bytes:
    """Return the content of a file.

    Raises:
        OSError: The file cannot be read, or is a folder, a pipe or a device.
    """
    mode = os.stat(file).st_mode  # noqa: PTH116
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        raise OSError("it is a pipe or a device: give a file")
    return file.read_bytes()


@contextmanager
def reading(
    file: Path, kind: type[GaugeError], noun: str = "", hint: str = ""
) -> Iterator[bytes]:
    """Yield the content of a file, and turn each error of the block into one that names the file.

    Args:
        file: The file.
        kind: Type of the error.
        noun: What the file should be, as `a result file`; empty for none.
        hint: What to do; empty for nothing.

    Raises:
        GaugeError: The file cannot be read, or the block raised an error.
    """
    fix = hint and f"; {hint}"
    try:
        content = content_of(file)
    except (OSError, ValueError) as error:
        cause = getattr(error, "strerror", None) or error
        raise kind.in_file(file, None, f"cannot be read: {cause}{fix}") from error
    with faults_of(file, kind, noun, hint):
        yield content


@contextmanager
def faults_of(
    file: Path | str, kind: type[GaugeError], noun: str = "", hint: str = ""
) -> Iterator[None]:
    """Turn each error of the block into one that names a file; see `reading` for the arguments.

    Readers of damaged files raise errors of any type, such as `zlib.error`, `RecursionError` or `SyntaxError`. Errors
    of the type `kind`, and of other files, pass unchanged.
    """
    try:
        yield
    except (kind, FileError, MissingExtraError):
        raise
    except Exception as error:
        place, reason = _fault(error)
        expected, fix = noun and f"not {noun}: ", hint and f"; {hint}"
        raise kind.in_file(file, place, f"{expected}{reason}{fix}") from error


def _fault(error: Exception) -> tuple[str, str]:
    """Return the place, which may be empty, and the reason of an error of a reader."""
    from pydantic import ValidationError

    if isinstance(error, ValidationError):
        place, reason = map(one_line, first_fault(error))
        return place, reason
    reason = one_line(str(error))
    if isinstance(error, KeyError):
        return "", f"no {reason}"
    if isinstance(error, OSError | ValueError | GaugeError) and reason:
        return "", reason
    return "", f"it is damaged ({type(error).__name__}: {reason})"


def one_line(text: str) -> str:
    """Return a text of a reader, which may quote a damaged file, on one line."""
    return printable(" ".join(text.split()))[:MAX_REASON]
