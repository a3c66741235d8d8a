"""Find data folders, read arrays, write files whole, and prepare values for JSON."""

import errno
import io
import os
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib.format import read_array
from numpy.typing import NDArray

NUMBERS = "biuf"
"""Kinds of NumPy types that are numbers: booleans, integers and floats."""


@cache
def data_folder(name: str) -> Path:
    """Return the folder `tasks`, `scoring` or `assets`, inside the installed package or next to it in a checkout."""
    package = Path(__file__).parent
    for folder in (package / "_data" / name, package.parent / name):
        if folder.is_dir():
            return folder
    raise FileNotFoundError(
        f"gauge-envs is installed without its {name!r} folder (expected in {package} or next to it)"
    )


@contextmanager
def os_errors(raised: Callable[[str], Exception]) -> Iterator[None]:
    """Turn an OSError into an error of this package.

    Args:
        raised: Function that returns the error for a cause, as `No such file or directory`.
    """
    try:
        yield
    except OSError as error:
        raise raised(error.strerror or str(error)) from error


# --- texts that may be paths ------------------------------------------------------------------------------------------


def path_exists(text: str | Path) -> bool:
    """Return whether a text of a user is the path of a file or folder.

    In contrast to `Path.exists`, a text that is too long for a path is no path, not an error.
    """
    return os.path.exists(text)  # noqa: PTH110


def is_folder(text: str | Path) -> bool:
    """Return whether a text of a user is the path of a folder; see `path_exists`."""
    return os.path.isdir(text)  # noqa: PTH112


def is_regular_file(text: str | Path) -> bool:
    """Return whether a text of a user is the path of a file with content, not of a folder or a pipe."""
    return os.path.isfile(text)  # noqa: PTH113


# --- reading ---------------------------------------------------------------------------------------------------------


def npz_arrays(
    content: bytes, names: Iterable[str] | None = None
) -> dict[str, NDArray[Any]]:
    """Return arrays of numbers of an NPZ file by name; missing names are skipped.

    Args:
        content: The content of the file.
        names: Arrays to read; None reads all.

    Raises:
        ValueError: The content is not an NPZ file, or an array has other values than numbers.
        Exception: A member is damaged; `gauge_envs.reading.reading` gives it a sentence.
    """
    if not zipfile.is_zipfile(io.BytesIO(content)):
        raise ValueError("it is not a complete ZIP archive, which an NPZ file is")
    arrays = {}
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        members = {member.removesuffix(".npy"): member for member in archive.namelist()}
        for name in members if names is None else names:
            if name in members:
                # A whole member is compared with its checksum.
                array = read_array(io.BytesIO(archive.read(members[name])))
                if array.dtype.kind not in NUMBERS:
                    reason = f"it has {array.dtype} values, expected numbers"
                    raise ValueError(f"{name}: {reason}")
                arrays[name] = array
    return arrays


# --- writing ---------------------------------------------------------------------------------------------------------


def json_ready(value: Any) -> Any:
    """Return a value in plain containers, with None for NaN and infinity."""
    if isinstance(value, Mapping):
        return {str(key): json_ready(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [json_ready(entry) for entry in value]
    if isinstance(value, np.ndarray | np.generic):
        is_number = value.dtype.kind in NUMBERS
        plain = value.tolist()
        return plain if is_number and np.isfinite(value).all() else json_ready(plain)
    return None if isinstance(value, float) and not np.isfinite(value) else value


def check_replaceable(file: Path) -> None:
    """Raise an error if a new file would replace a folder."""
    if file.is_dir():
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(file))


def write_whole(file: Path, content: bytes) -> None:
    """Write a file completely or not at all; a reader sees the old or the new content."""
    with replaced_whole(file) as part:
        part.write_bytes(content)


@contextmanager
def replaced_whole(file: Path) -> Iterator[Path]:
    """Yield a path for the new content of a file, which replaces the file at the end.

    After an error the new content is removed, and the old file is unchanged.
    """
    check_replaceable(file)
    part = file.with_name(f".{file.name}.{os.getpid()}.tmp")
    try:
        yield part
        part.replace(file)
    finally:
        part.unlink(missing_ok=True)
