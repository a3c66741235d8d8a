"""Find data folders, read files of strangers within limits, write files whole, and prepare values for JSON."""

import errno
import io
import json
import math
import os
import platform
import re
import signal
import subprocess
import sys
import tomllib
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from stat import S_ISREG
from tempfile import TemporaryDirectory, TemporaryFile
from typing import Any

import numpy as np
from numpy.typing import NDArray

MEGABYTE = 10**6

MOST_JSON_CONTAINERS = 1_000_000
"""Largest count of objects and lists of a JSON file; each takes up to 64 bytes of memory, and 3 bytes of the file."""

MOST_TOML_BYTES = 2 * MEGABYTE
"""Largest size of a TOML file."""

NUMBERS = "biuf"
"""Kinds of NumPy's types that are numbers: booleans, integers and floats."""

MOST_KEY_DOTS = 64
"""Largest count of dots in a key of a TOML file; the parser's time grows with the square of the count."""

CHILD_MEMORY = 2000 * MEGABYTE
CHILD_CPU_S = 5
CHILD_WALL_S = 60
CHILD_REFUSED = 3
"""Exit code of a child that prints why it refuses a file."""

CHILD_START = """
import runpy, sys
memory, seconds = int(sys.argv.pop(1)), int(sys.argv.pop(1))
if sys.platform != "win32":
    import resource
    limits = {"DATA": memory, "CPU": seconds, "FSIZE": memory, "CORE": 0}
    for name, limit in limits.items():
        kind = getattr(resource, f"RLIMIT_{name}")
        hard = resource.getrlimit(kind)[1]
        # A limit of the session that is lower cannot be raised.
        lower = limit if hard == resource.RLIM_INFINITY else min(limit, hard)
        resource.setrlimit(kind, (lower, lower))
sys.argv.pop(0)
runpy.run_path(sys.argv[0], run_name="__main__")
"""
"""Program of a child: it limits itself, and then runs a script."""


@cache
def data_folder(name: str) -> Path:
    """Return the folder `tasks`, `scoring` or `assets`, inside the installed package or beside it in a checkout."""
    package = Path(__file__).parent
    for folder in (package / name, package.parent / name):
        if folder.is_dir() and not (folder / "__init__.py").exists():
            return folder
    raise FileNotFoundError(
        f"gauge-envs is installed without its {name!r} folder (looked in {package} and beside it)"
    )


def printable(text: str) -> str:
    """Return the text with escapes for characters that a terminal or a JSON file cannot hold."""
    return "".join(
        char if char.isprintable() else char.encode("unicode_escape").decode()
        for char in text
    )


@contextmanager
def os_errors(raised: Callable[[str], Exception]) -> Iterator[None]:
    """Raise an error of this package in place of an OSError.

    Args:
        raised: Function that returns the error for a cause, as `No such file or directory`.
    """
    try:
        yield
    except OSError as error:
        raise raised(error.strerror or str(error)) from error


# --- files of strangers ----------------------------------------------------------------------------------------------


def read_regular(file: Path, most_bytes: int) -> bytes:
    """Return the content of a regular file of limited size.

    A FIFO, a device or a folder is never opened for reading, and nothing is read of a file that is too large.
    """
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
    try:
        # Opening a device can have effects, so the kind is checked before and after.
        _check_regular(file, file.stat(), most_bytes)
        with os.fdopen(os.open(file, flags), "rb") as stream:
            _check_regular(file, os.fstat(stream.fileno()), most_bytes)
            content = stream.read(most_bytes + 1)
    except ValueError:
        raise OSError(
            errno.EINVAL, "its name holds a null character", str(file)
        ) from None
    if len(content) > most_bytes:
        raise OSError(
            errno.EFBIG,
            f"it is larger than the limit of {most_bytes / MEGABYTE:g} MB",
            str(file),
        )
    return content


def _check_regular(file: Path, status: os.stat_result, most_bytes: int) -> None:
    if not S_ISREG(status.st_mode):
        raise OSError(errno.EINVAL, "it is not a regular file", str(file))
    if status.st_size > most_bytes:
        size, limit = status.st_size / MEGABYTE, most_bytes / MEGABYTE
        raise OSError(
            errno.EFBIG, f"it has {size:.6g} MB, the limit is {limit:g} MB", str(file)
        )


def check_json_size(content: bytes) -> None:
    """Check that a JSON document has few objects and lists, which take twenty times their bytes in memory."""
    count = content.count(b"{") + content.count(b"[")
    if count > MOST_JSON_CONTAINERS:
        raise ValueError(
            f"it has {count} objects and lists, the limit is {MOST_JSON_CONTAINERS}"
        )


def json_document(content: bytes) -> Any:
    """Return the value of a JSON document."""
    check_json_size(content)
    if not content.strip():
        raise ValueError("it is empty")
    text = content.removeprefix(b"\xef\xbb\xbf")
    # A quarter of the time of `json`, which says better what is wrong, and reads UTF-16.
    with suppress(ValueError):
        return _json_reader()(text)
    try:
        return json.loads(text)
    except RecursionError:
        raise ValueError("its objects and lists are nested too deeply") from None


@cache
def _json_reader() -> Callable[[bytes], Any]:
    """Return the parser of pydantic, whose import takes longer than most files."""
    from pydantic import TypeAdapter

    return TypeAdapter(Any).validate_json


def csv_text(content: bytes) -> io.StringIO:
    """Return CSV in UTF-8 with commas; spreadsheets write a byte-order mark, or semicolons and decimal commas."""
    text = content.decode("utf-8-sig")
    header = next((line for line in text.splitlines() if not line.startswith("#")), "")
    return io.StringIO(
        text.replace(",", ".").replace(";", ",") if ";" in header else text, newline=""
    )


def toml_document(content: bytes) -> dict[str, Any]:
    """Return the tables of a TOML document."""
    if len(content) > MOST_TOML_BYTES:
        raise ValueError(f"it has {len(content)} bytes, the limit is {MOST_TOML_BYTES}")
    text = content.decode("utf-8")
    dots = max(
        part.count(".")
        for part in re.split(
            r"[\n\r,={}\[\]#]+", text.replace(" ", "").replace("\t", "")
        )
    )
    if dots > MOST_KEY_DOTS:
        raise ValueError(
            f"a key or text has {dots} dots between two delimiters, the limit is {MOST_KEY_DOTS}"
        )
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise ValueError("its tables and arrays are nested too deeply") from None


def npz_names(content: bytes) -> list[str]:
    """Return the names of the arrays of an NPZ file."""
    with _archive(content) as archive:
        return [name.removesuffix(".npy") for name in archive.namelist()]


def npz_arrays(
    content: bytes, names: Iterable[str], most_bytes: int, *, kinds: str = NUMBERS
) -> dict[str, NDArray[Any]]:
    """Return arrays of an NPZ file by name, without the names that it lacks; other arrays are not read.

    Args:
        content: The content of the file.
        names: Arrays to read.
        most_bytes: Limit of the sum of their sizes in memory.
        kinds: Kinds of NumPy's types that the arrays may have.
    """
    arrays: dict[str, NDArray[Any]] = {}
    left = most_bytes
    with _archive(content) as archive:
        known = set(archive.namelist())
        for name in names:
            if f"{name}.npy" in known:
                arrays[name] = _npz_member(archive, name, left, most_bytes, kinds)
                left -= arrays[name].nbytes
    return arrays


@contextmanager
def _archive(content: bytes) -> Iterator[zipfile.ZipFile]:
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            yield archive
    except ValueError:
        raise
    except (
        Exception
    ) as error:  # zipfile, zlib and numpy raise many types for a damaged archive.
        raise ValueError(str(error) or type(error).__name__) from error


def _npz_member(
    archive: zipfile.ZipFile, name: str, left: int, most_bytes: int, kinds: str
) -> NDArray[Any]:
    info = archive.getinfo(f"{name}.npy")
    if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise ValueError(f"{name}: compression {info.compress_type} is not supported")
    header_bytes = 10_240
    if info.file_size > left + header_bytes:
        raise ValueError(
            f"{name}: it has {info.file_size} bytes, the limit of all arrays is {most_bytes}"
        )
    stream = io.BytesIO(archive.read(info))
    major, _ = np.lib.format.read_magic(stream)
    if major not in (1, 2):
        raise ValueError(
            f"{name}: version {major} of the NPY format holds no plain numbers"
        )
    reader = (
        np.lib.format.read_array_header_1_0
        if major == 1
        else np.lib.format.read_array_header_2_0
    )
    shape, is_fortran, dtype = reader(stream)
    if dtype.kind not in kinds:
        raise ValueError(f"{name}: holds {dtype} values, expected numbers")
    data = stream.getbuffer()[stream.tell() :]
    if min(shape, default=0) < 0 or math.prod(shape) * dtype.itemsize != len(data):
        raise ValueError(f"{name}: shape {list(shape)} does not fit {len(data)} bytes")
    return np.frombuffer(bytes(data), dtype=dtype).reshape(
        shape, order="F" if is_fortran else "C"
    )


def child_command(
    script: Path, *arguments: str, cpu_s: int
) -> tuple[list[str], dict[str, str]]:
    """Return command and environment of a script in a child process with limits of memory and time.

    Args:
        script: Script that needs no module of this package.
        arguments: Arguments of the script.
        cpu_s: Limit of its processor time [s].
    """
    command = [
        sys.executable,
        "-P",
        "-c",
        CHILD_START,
        str(CHILD_MEMORY),
        str(cpu_s),
        str(script),
        *arguments,
    ]
    return command, os.environ | {"OMP_NUM_THREADS": "1", "PXR_WORK_THREAD_LIMIT": "1"}


def child_refusal(
    script: Path, *arguments: str, content: bytes = b"", cpu_s: int = CHILD_CPU_S
) -> str | None:
    """Return why a file of a stranger must not be loaded; None if a script loads it within limits.

    The script loads the file as the library does, in a child process with limits of memory and time. It exits normally
    also for a file that is wrong, and with `CHILD_REFUSED` after it printed a reason. Temporary files are removed.

    Args:
        script: Script that needs no module of this package.
        arguments: Arguments of the script.
        content: Standard input of the script.
        cpu_s: Limit of its processor time [s].
    """
    command, environment = child_command(script, *arguments, cpu_s=cpu_s)
    try:
        with TemporaryDirectory() as folder, TemporaryFile() as output:
            done = subprocess.run(
                command,
                input=content,
                stdout=output,
                stderr=subprocess.DEVNULL,
                timeout=CHILD_WALL_S,
                env=environment | {"TMPDIR": folder},
                check=False,
            )
            output.seek(0)
            printed = output.read()
    except subprocess.TimeoutExpired:
        return f"loading it takes more than {CHILD_WALL_S} s"
    except OSError as error:
        return f"no child process can be started to test it: {error.strerror or error}"
    if done.returncode == 0:
        return None
    if done.returncode == CHILD_REFUSED:
        return printed.decode(errors="replace").strip()
    out_of_time = (getattr(signal, "SIGXCPU", 0), getattr(signal, "SIGKILL", 0))
    if -done.returncode in out_of_time:
        return f"loading it takes more than {cpu_s} s of processor time"
    limit = CHILD_MEMORY // MEGABYTE
    return (
        f"loading it needs more than {limit} MB of memory, or the library crashes on it"
    )


# --- writing ---------------------------------------------------------------------------------------------------------


def json_ready(value: Any) -> Any:
    """Return a value in plain containers, with None for NaN and infinity, which JSON lacks."""
    if isinstance(value, Mapping):
        return {str(key): json_ready(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [json_ready(entry) for entry in value]
    if isinstance(value, np.ndarray | np.generic):
        is_number = value.dtype.kind in "biuf"
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


VECTORS = ("avx512f", "avx2", "avx", "asimd")
"""Vector instructions that libraries choose between, by their names in Linux, the widest first."""


@cache
def processor() -> str:
    """Return the machine's architecture, and on Linux its processor and widest vectors, as `x86_64, AMD EPYC, avx512f`.

    Equal versions may give other last bits on another one: libraries choose their functions by its instructions.
    """
    stated = ""
    with suppress(OSError):
        stated = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace")
    name = re.search(r"^model name\s*: (.*)", stated, re.MULTILINE)
    flags = re.search(r"^(?:flags|Features)\s*: (.*)", stated, re.MULTILINE)
    known = flags[1].split() if flags else []
    vectors = next((one for one in VECTORS if one in known), "")
    parts = (platform.machine(), name[1].strip() if name else "", vectors)
    return ", ".join(filter(None, parts))


def versions() -> dict[str, str]:
    """Return the versions of gauge-envs, gymnasium, numpy and python."""
    return dict(_versions())


@cache
def _versions() -> dict[str, str]:
    """Return the versions, read once: reading the metadata of packages takes as long as a short episode."""
    from importlib.metadata import version

    packages = {name: version(name) for name in ("gauge-envs", "gymnasium", "numpy")}
    return packages | {"python": platform.python_version()}


def check_replaceable(file: Path) -> None:
    """Check that a new file may take the place of what is there."""
    if file.is_dir():
        raise OSError(errno.EISDIR, os.strerror(errno.EISDIR), str(file))
    if file.exists() and not file.is_file():
        raise OSError(errno.EINVAL, "it is not a regular file", str(file))


def write_whole(file: Path, content: bytes) -> None:
    """Write a file whole or not at all: a reader finds the old content or the new one."""
    with replaced_whole(file) as part, part.open("xb") as stream:
        stream.write(content)
        stream.flush()
        os.fsync(stream.fileno())


def write_texts(folder: Path, texts: Iterable[tuple[str, str]]) -> list[Path]:
    """Write texts by their paths below a folder, and return the paths of the files."""
    written = []
    for name, text in texts:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8", newline="\n")
        written.append(path)
    return written


@contextmanager
def replaced_whole(file: Path) -> Iterator[Path]:
    """Yield a path beside a file for its new content, which takes the place of the file at the end.

    After an error the new content is removed, and an older file is unchanged. A device or a FIFO is never replaced:
    root could otherwise put a file in the place of `/dev/null`.
    """
    from secrets import token_hex

    check_replaceable(file)
    part = file.with_name(f".{file.name}.{token_hex(8)}.tmp")
    try:
        yield part
        part.replace(file)
    finally:
        part.unlink(missing_ok=True)


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold the lock of a folder, which one process at a time has; the end of a process releases it."""
    with (folder / ".lock").open("a") as stream:
        if sys.platform == "win32":
            import msvcrt

            msvcrt.locking(stream.fileno(), msvcrt.LK_LOCK, 1)
        else:
            import fcntl

            fcntl.flock(stream, fcntl.LOCK_EX)
        yield
