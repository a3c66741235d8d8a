"""Python environments of releases in a cache, and the processes that run a model in them."""

from __future__ import annotations

import itertools
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import venv
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from platformdirs import user_cache_path

from gauge_envs.errors import GaugeError
from gauge_envs.files import locked
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.versions.schema import Side

TAG = f"-{sys.implementation.cache_tag}-{sys.platform}-{os.uname().machine if hasattr(os, 'uname') else 'any'}"
"""End of the name of an environment: a cache in a shared home folder serves several machines."""

NUMPY_2_SINCE = (3, 2)
"""First release of MuJoCo whose wheels were built for NumPy 2. Older ones crash with it."""

PIP = ("-m", "pip", "--no-input", "--disable-pip-version-check", "--retries", "2")

UNREACHED = "connection broken|Failed to fetch|network was disabled|Could not fetch URL"
"""Messages of pip and uv on an index that does not answer."""

WORKER = Path(__file__).with_name("worker.py")

Arrays: TypeAlias = Mapping[str, FloatArray]
Say: TypeAlias = Callable[[str], object]
"""Prints a message."""


class VersionsError(GaugeError, RuntimeError):
    """An environment cannot be made, or a version cannot run a model; the message names both and the cause."""


# --- environments ----------------------------------------------------------------------------------------------------


def environment_folder(requirement: str) -> Path:
    """Return the folder of the environment of a requirement, which need not exist.

    The variable `GAUGE_CACHE_DIR` replaces the user's cache folder.
    """
    cache = user_cache_path("gauge-envs", appauthor=False)
    folder = Path(os.environ.get("GAUGE_CACHE_DIR") or cache).expanduser()
    return folder / "versions" / f"{requirement.replace('==', '-')}{TAG}"


def version_key(version: str) -> tuple[int, ...]:
    """Return the numbers of a version, by which versions sort."""
    return tuple(map(int, re.findall(r"\d+", version)))


def make_environment(requirement: str, say: Say = print) -> Path:
    """Return the interpreter of the environment of a requirement, and install it if it is not in the cache.

    It is installed into a folder next to its final place, and renamed. A second command waits.

    Args:
        requirement: Package with an exact version, as `mujoco==3.3.0`.
        say: Prints what is installed.

    Raises:
        VersionsError: There is no such version, no network, or no space.
    """
    place = "Scripts/python.exe" if sys.platform == "win32" else "bin/python"
    python = environment_folder(requirement) / place
    try:
        # Another command may make it while this one waits.
        if not python.exists():
            with _locked_folder(requirement) as folder:
                if not python.exists():
                    _install(requirement, folder, place, say)
    except OSError as error:
        raise VersionsError(
            f"{requirement}: {error}; free space, or set GAUGE_CACHE_DIR to another folder"
        ) from error
    return python


def remove_environment(requirement: str) -> None:
    """Remove the environment of a requirement from the cache."""
    with _locked_folder(requirement) as folder:
        shutil.rmtree(folder, ignore_errors=True)


@contextmanager
def _locked_folder(requirement: str) -> Iterator[Path]:
    """Hold the lock of an environment, and yield its folder."""
    folder = environment_folder(requirement)
    lock = folder.parent / ".locks" / folder.name
    lock.mkdir(parents=True, exist_ok=True)
    with locked(lock):
        yield folder


def _install(requirement: str, folder: Path, place: str, say: Say) -> None:
    """Install a requirement into a folder, with its interpreter at a place; the caller has the lock."""
    packages = [requirement]
    package, _, version = requirement.partition("==")
    if package == "mujoco" and version_key(version) < NUMPY_2_SINCE:
        packages.append("numpy<2")
    say(f"{' and '.join(packages)}: installed into {folder}")
    # Folders of killed commands, and an environment whose Python is gone.
    for leftover in (folder, *folder.parent.glob(f".{folder.name}.*")):
        shutil.rmtree(leftover, ignore_errors=True)
    with TemporaryDirectory(
        prefix=f".{folder.name}.", dir=folder.parent, ignore_cleanup_errors=True
    ) as name:
        part = Path(name) / "environment"
        if uv := shutil.which("uv"):
            # The seed has pip, which lists the releases of a range.
            _run([uv, "venv", "--seed", "--python", sys.executable, part], requirement)
            install = [uv, "pip", "install", "--python", str(part / place)]
        else:
            venv.create(part, with_pip=True)
            install = [str(part / place), *PIP, "install"]
        _run([*install, "--only-binary", ":all:", *packages], requirement)
        part.rename(folder)


def released_versions(package: str, python: Path) -> list[str]:
    """Return the versions of a package in the index of the pip of an interpreter, the oldest first.

    Raises:
        VersionsError: The index does not answer.
    """
    text = _run([python, *PIP, "index", "versions", package], package)
    versions = text.partition("Available versions: ")[2].splitlines()[0]
    return sorted(versions.split(", "), key=version_key)


def _run(command: Sequence[str | Path], requirement: str) -> str:
    """Return what pip or uv prints; a failure raises its cause."""
    # Paths of the user's environment do not belong to the new one.
    foreign = ("PYTHONPATH", "PYTHONHOME", "PIP_TARGET", "PIP_USER")
    variables = {name: os.environ[name] for name in os.environ if name not in foreign}
    done = subprocess.run(command, capture_output=True, text=True, env=variables)
    text = done.stdout + done.stderr
    if re.search(UNREACHED, text):
        raise VersionsError(
            f"{requirement}: the package index does not answer; --python FILE names an interpreter that has MuJoCo"
        )
    if done.returncode:
        cause = text.strip().splitlines()[-1]
        if offered := re.search(r"\(from versions: (\S.*)\)", text):
            newest = ", ".join(offered[1].split(", ")[-5:])
            cause += f"; the newest versions are {newest}"
        raise VersionsError(f"{requirement}: {cause}")
    return text


# --- processes -------------------------------------------------------------------------------------------------------


def run_process(
    command: Sequence[str | Path], title: str, variables: dict[str, str]
) -> None:
    """Run a command, and wait for it.

    Args:
        command: Interpreter and arguments.
        title: What fails, for messages.
        variables: Variables that are added to the environment.

    Raises:
        VersionsError: It failed; the message has the last line of its error.
    """
    fixed = {"OMP_NUM_THREADS": "1", "MUJOCO_GL": "disable"}
    variables = os.environ | fixed | variables
    try:
        done = subprocess.run(command, capture_output=True, text=True, env=variables)
    except OSError as error:
        raise VersionsError(f"{title}: it cannot be started: {error}") from error
    # A traceback ends with the exception, whose message may have several lines.
    message = re.split(r"^(?=\w[\w.]*: )", done.stderr, flags=re.M)[-1]
    if done.returncode < 0:
        signal_name = signal.Signals(-done.returncode).name
        message = f"this release crashes on it ({signal_name})"
    if done.returncode:
        raise VersionsError(f"{title}: {' '.join(message.split())}")


class Output(NamedTuple):
    """What a worker wrote: a description of the model, arrays, and the file of the arrays."""

    description: Mapping[str, Any]
    arrays: Arrays
    file: str


@dataclass(kw_only=True)
class Bench:
    """A model, and the folder of the files of its workers.

    Attributes:
        title: The model as the user named it.
        folder: Folder of the files of the workers.
        job: Entries of every job.
        say: Prints what is installed.
    """

    title: str
    folder: Path
    job: Mapping[str, Any]
    say: Say = print
    _numbers: Iterator[int] = field(default_factory=itertools.count)

    def work(self, sides: Sequence[Side], **job: Any) -> list[Output]:
        """Do a job on each side, two sides at a time.

        Raises:
            VersionsError: An environment cannot be made, or a version cannot run the model.
        """
        for side in sides:
            if side.requirement:
                make_environment(side.requirement, self.say)
        names = [self.folder / f"job{next(self._numbers)}" for _ in sides]
        for side, name in zip(sides, names, strict=True):
            job |= {"settings": dict(side.settings), "out": str(name)}
            name.with_suffix(".job").write_text(json.dumps({**self.job, **job}))
        with ThreadPoolExecutor(2) as pool:
            list(pool.map(self.execute, sides, names))
        outputs = []
        # NumPy parses the headers of arrays with `ast`, which is not safe in threads of Python 3.11.
        for name in names:
            description = json.loads(
                name.with_suffix(".json").read_text(encoding="utf-8")
            )
            with np.load(f"{name}.npz") as arrays:
                outputs.append(Output(description, dict(arrays), f"{name}.npz"))
        return outputs

    def execute(self, side: Side, name: Path) -> None:
        """Run the worker on a job in the environment of a side."""
        # With -I, neither the user's paths nor modules next to the worker count.
        python = side.python or make_environment(side.requirement)
        command = [python, "-I", "-B", WORKER, name.with_suffix(".job")]
        title = f"{side.title} cannot run {self.title}"
        run_process(command, title, {})
        if not name.with_suffix(".npz").is_file():
            raise VersionsError(
                f"{title}: it ends without a result, as it is no Python"
            )
