"""Python environments of releases: made apart from the user's, cached by exact requirement, never used half made."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import time
import venv
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from secrets import token_hex
from threading import Event

from platformdirs import user_cache_path

from gauge_envs.errors import GaugeError
from gauge_envs.files import locked, write_whole
from gauge_envs.tools.versions.causes import NO_INDEX, cause, unreached

RECORD = "environment.json"
"""File of a complete environment."""

ABOUT_MB = 160
"""Size of MuJoCo 3.3.0 with NumPy and pip on Linux [MB]; other releases differ by some 30."""

NUMPY_2_SINCE = (3, 2)
"""First release of MuJoCo whose wheels were built for NumPy 2: those before crash or refuse arrays with it."""

LOOKING = ("-vv", "--no-input", "--retries", "2")
"""Options of pip, which names an index that does not answer only in its details."""

INSTALL_LIMIT_S = 1800.0
"""Time of an installation [s]."""

REMOVAL_LIMIT_S = 5.0
"""Time in which children of an interrupted installation still write [s]."""

QUIET_S = 0.5
"""Time without a new file after which they are taken for ended [s]."""


_is_stopped = Event()
"""Set when the threads of `sides_at_once` begin nothing more."""


class ReleaseError(GaugeError, RuntimeError):
    """An environment cannot be made or used; the message names the requirement and the cause."""


@contextmanager
def sides_at_once() -> Iterator[ThreadPoolExecutor]:
    """Yield two threads, one for each side.

    Ctrl-C reaches the main thread alone, which waits for the others: they would finish what they install.
    """
    pool = ThreadPoolExecutor(2)
    try:
        yield pool
    except BaseException:
        _is_stopped.set()
        raise
    finally:
        pool.shutdown()
        _is_stopped.clear()


def cache_folder() -> Path:
    """Return the folder of cached environments, which need not exist; `GAUGE_CACHE_DIR` states another one."""
    given = os.environ.get("GAUGE_CACHE_DIR")
    base = Path(given) if given else user_cache_path("gauge-envs", appauthor=False)
    return base.expanduser() / "versions"


def environment_folder(requirement: str) -> Path:
    """Return the folder of the environment of a requirement, which need not exist.

    The name has the Python and the platform: a cache in a shared home folder serves several machines.
    """
    python = f"{sys.implementation.cache_tag}-{sys.platform}-{os.uname().machine if hasattr(os, 'uname') else 'any'}"
    return cache_folder() / f"{requirement.replace('==', '-')}-{python}"


def is_made(requirement: str) -> bool:
    """Return whether the environment of a requirement is complete, and its Python is still there."""
    folder = environment_folder(requirement)
    return (folder / RECORD).is_file() and _python(folder).exists()


def made_environment(requirement: str, say: Callable[[str], object] = print) -> Path:
    """Return the interpreter of the environment of a requirement, which is made if it is not in the cache.

    It is made in a folder of its own beside its place, imported once, and renamed. Of two commands at once, the second
    waits.

    Args:
        requirement: Package with an exact version, as `mujoco==3.3.0`.
        say: Prints what is installed, its size, and where it lies.

    Raises:
        ReleaseError: It cannot be made: no such version, no network, no space.
    """
    _check_stopped()
    folder = environment_folder(requirement)
    if not is_made(requirement):
        try:
            with _locked_place(folder):
                # Another command may have made it while this one waited.
                if not is_made(requirement):
                    _make(requirement, folder, say)
        except OSError as error:
            raise ReleaseError(
                f"{requirement}: {folder.parent} cannot hold its environment: {error.strerror or error}. "
                "Free space, or set GAUGE_CACHE_DIR to another folder."
            ) from error
    return _python(folder)


def remove_environment(requirement: str) -> None:
    """Remove the environment of a requirement from the cache."""
    folder = environment_folder(requirement)
    with _locked_place(folder):
        # Without its record nothing takes the rest for an environment.
        (folder / RECORD).unlink(missing_ok=True)
        shutil.rmtree(folder, ignore_errors=True)


def released_versions(
    package: str, python: Path, *, has_candidates: bool = False
) -> list[str]:
    """Return the versions of a package that the index has, the oldest first.

    Args:
        package: Name of the package.
        python: Interpreter whose pip asks the index.
        has_candidates: Whether release candidates count.

    Raises:
        ReleaseError: The index does not answer.
    """
    command = [str(python), "-m", "pip", "index", "versions", *LOOKING]
    if has_candidates:
        command.append("--pre")
    done = _run([*command, package])
    text = done.stdout + done.stderr
    found = re.search(r"Available versions: (.*)", done.stdout)
    # Without the index, pip lists what it finds in folders.
    if done.returncode != 0 or found is None or unreached(text):
        raise ReleaseError(f"{package}: {cause(text, package)}")
    return sorted(found[1].split(", "), key=version_key)


def version_key(version: str) -> tuple[int, ...]:
    """Return the numbers of a version, by which versions sort: a candidate is before its release."""
    release, rest = re.fullmatch(r"([\d.]*\d)(.*)", version).groups()  # type: ignore[union-attr]
    stage = -1 if re.match(r"\.?(a|b|rc|dev)", rest) else 0
    return (*map(int, release.split(".")), stage, *map(int, re.findall(r"\d+", rest)))


# --- making ----------------------------------------------------------------------------------------------------------


def _make(requirement: str, folder: Path, say: Callable[[str], object]) -> None:
    package, _, version = requirement.partition("==")
    packages = [requirement]
    if package == "mujoco" and version_key(version) < NUMPY_2_SINCE:
        packages.append("numpy<2")
    say(f"{' and '.join(packages)}: installed into {folder}, about {ABOUT_MB} MB")
    _remove_leftovers(folder)
    with _removed_on_error(folder.with_name(f".{folder.name}.{token_hex(6)}")) as part:
        if uv := shutil.which("uv"):
            # `--seed` adds pip, which lists the versions of a range.
            made = _run([uv, "venv", "--seed", "--python", sys.executable, str(part)])
            _check(made, requirement)
            install = [uv, "pip", "install", "--python", str(_python(part))]
        else:
            venv.EnvBuilder().create(part)
            pip = [str(_python(part)), "-m", "ensurepip", "--default-pip"]
            _check(_run(pip), requirement)
            install = [str(_python(part)), "-m", "pip", "install", "--no-compile"]
            install += ["--progress-bar", "off", *LOOKING]
        _check(_run([*install, "--only-binary", ":all:", *packages]), requirement)
        _check(_run([str(_python(part)), "-c", f"import {package}"]), requirement)
        size = sum(
            one.lstat().st_size for one in part.rglob("*") if not one.is_symlink()
        )
        record = {"requirement": requirement, "bytes": size}
        write_whole(part / RECORD, json.dumps(record).encode())
        part.rename(folder)
    say(f"{requirement}: {size / 1e6:.0f} MB")


def _python(folder: Path) -> Path:
    windows = folder / "Scripts" / "python.exe"
    return windows if sys.platform == "win32" else folder / "bin" / "python"


def _remove_leftovers(folder: Path) -> None:
    """Remove what processes left that were killed; the lock is held, so nothing of it is in use."""
    for part in folder.parent.glob(f".{folder.name}.*"):
        shutil.rmtree(part, ignore_errors=True)
    # An environment without its record was being removed.
    shutil.rmtree(folder, ignore_errors=True)


@contextmanager
def _locked_place(folder: Path) -> Iterator[None]:
    """Hold the lock of an environment, whose folder need not exist."""
    place = folder.parent / ".locks" / folder.name
    place.mkdir(parents=True, exist_ok=True)
    with locked(place):
        yield


@contextmanager
def _removed_on_error(part: Path) -> Iterator[Path]:
    try:
        yield part
    except BaseException:  # Ctrl-C too.
        deadline_s = time.monotonic() + REMOVAL_LIMIT_S
        gone_since_s = time.monotonic()
        while time.monotonic() < min(gone_since_s + QUIET_S, deadline_s):
            if part.exists():
                shutil.rmtree(part, ignore_errors=True)
                gone_since_s = time.monotonic()
            time.sleep(0.05)
        raise


def _check_stopped() -> None:
    if _is_stopped.is_set():
        raise ReleaseError("stopped, as the other side ended with an error")


def _run(command: Sequence[str]) -> subprocess.CompletedProcess[str]:
    environment = os.environ | {
        "PIP_DISABLE_PIP_VERSION_CHECK": "1",
        "PYTHONNOUSERSITE": "1",
        "LC_ALL": "C.UTF-8",
    }
    # Paths of the user's environment do not belong to this one.
    for name in ("PYTHONPATH", "PYTHONHOME", "PIP_TARGET", "PIP_USER"):
        environment.pop(name, None)
    _check_stopped()
    try:
        return subprocess.run(
            command,
            capture_output=True,
            text=True,
            check=False,
            timeout=INSTALL_LIMIT_S,
            env=environment,
            stdin=subprocess.DEVNULL,
        )
    except subprocess.TimeoutExpired:
        raise ReleaseError(
            f"{command[0]}: no end after {INSTALL_LIMIT_S:g} s"
        ) from None


def _check(done: subprocess.CompletedProcess[str], requirement: str) -> None:
    """Raise the cause of a failed installation."""
    if done.returncode == 0:
        return
    text = done.stdout + done.stderr
    why = f"{requirement}: {cause(text, requirement)}"
    if unreached(text) or re.search(NO_INDEX, text):
        cached = ", ".join(made_requirements()) or "none"
        why += f". Environments that can be used without it: {cached}; --python FILE names one that has MuJoCo"
    raise ReleaseError(why)


def made_requirements() -> list[str]:
    """Return the requirements of the environments in the cache that this Python can use."""
    found = []
    for record in sorted(cache_folder().glob(f"*/{RECORD}")):
        requirement = json.loads(record.read_text(encoding="utf-8"))["requirement"]
        if environment_folder(requirement) == record.parent and is_made(requirement):
            found.append(requirement)
    return found
