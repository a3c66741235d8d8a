"""Find data folders, read and write files, and prepare values for JSON."""

import codecs
import errno
import io
import json
import os
import platform
import re
import sys
import tomllib
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
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


def printable(text: str) -> str:
    """Return the text with escapes for unprintable characters."""
    return "".join(
        char if char.isprintable() else char.encode("unicode_escape").decode()
        for char in text
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


# --- reading ---------------------------------------------------------------------------------------------------------


def text_of(content: bytes) -> str:
    """Return text in UTF-8, with or without a byte-order mark, or in UTF-16 with one.

    Raises:
        ValueError: The content is neither.
    """
    is_wide = content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    try:
        return content.decode("utf-16" if is_wide else "utf-8-sig")
    except UnicodeDecodeError:
        raise ValueError("it is not text in UTF-8; save it as UTF-8") from None


def json_document(content: bytes) -> Any:
    """Return the value of a JSON document; see `text_of` for the encoding.

    Raises:
        ValueError: The content is not JSON.
    """
    return json.loads(text_of(content))


def csv_text(content: bytes) -> io.StringIO:
    """Return CSV with commas; the file may have semicolons, tabs or spaces, and decimal commas with the first two.

    Raises:
        ValueError: The content is not text.
    """
    text = text_of(content)
    header = next((line for line in text.splitlines() if not line.startswith("#")), "")
    separator = next((mark for mark in ";\t" if mark in header), None)
    if separator is not None:
        text = text.replace(",", ".").replace(separator, ",")
    elif "," not in header:
        text = "\n".join(",".join(line.split()) for line in text.splitlines())
    return io.StringIO(text, newline="")


def toml_document(content: bytes) -> dict[str, Any]:
    """Return the tables of a TOML document; see `text_of` for the encoding.

    Raises:
        ValueError: The content is not TOML.
    """
    return tomllib.loads(text_of(content))


def npz_arrays(
    content: bytes, names: Iterable[str] | None = None
) -> dict[str, NDArray[Any]]:
    """Return arrays of numbers of an NPZ file by name; missing names are skipped.

    Args:
        content: The content of the file.
        names: Arrays to read; None reads all.

    Raises:
        ValueError: The content is not an NPZ file, or an array has other values than numbers.
    """
    if not zipfile.is_zipfile(io.BytesIO(content)):
        raise ValueError("it is not a complete ZIP archive, which an NPZ file is")
    with np.load(io.BytesIO(content), allow_pickle=False) as archive:
        wanted = archive.files if names is None else names
        arrays = {name: archive[name] for name in wanted if name in archive.files}
    for name, array in arrays.items():
        if array.dtype.kind not in NUMBERS:
            raise ValueError(f"{name}: it has {array.dtype} values, expected numbers")
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


def processors() -> int:
    """Return the number of processors that this process may use, at most that of `OMP_NUM_THREADS`."""
    count = (
        len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1
    )
    given = os.environ.get("OMP_NUM_THREADS", "")
    return min(count, int(given)) if given.isdecimal() and int(given) else count


@cache
def processor() -> str:
    """Return the machine's architecture, and on Linux its processor, as `x86_64, AMD EPYC`.

    Equal versions may give other last bits on another processor, because libraries select functions by processor.
    """
    cpu_info = ""
    with suppress(OSError):
        cpu_info = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace")
    name = re.search(r"^model name\s*: (.*)", cpu_info, re.MULTILINE)
    return platform.machine() + (f", {name[1].strip()}" if name else "")


@cache
def versions() -> dict[str, str]:
    """Return the versions of gauge-envs, gymnasium, numpy and python; callers must not change the dictionary.

    They are read once, because reading the metadata of packages takes as long as a short episode.
    """
    from importlib.metadata import version

    packages = {name: version(name) for name in ("gauge-envs", "gymnasium", "numpy")}
    return packages | {"python": platform.python_version()}


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


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold the lock of a folder, which only one process can have; the end of the process releases it."""
    with (folder / ".lock").open("a") as stream:
        if sys.platform == "win32":
            import msvcrt

            msvcrt.locking(stream.fileno(), msvcrt.LK_LOCK, 1)
        else:
            import fcntl

            fcntl.flock(stream, fcntl.LOCK_EX)
        yield
