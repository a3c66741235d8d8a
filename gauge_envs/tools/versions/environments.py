"""Python environments of releases in a cache, and the processes that run a model in them."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import sysconfig
import venv
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from platformdirs import user_cache_path

from gauge_envs.cli.output import message
from gauge_envs.errors import GaugeError
from gauge_envs.files import locked, os_errors
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.versions.schema import Side

TAG = f"-{sys.implementation.cache_tag}-{sysconfig.get_platform()}"
"""End of the name of an environment: a cache in a shared home folder serves several machines."""

PYTHON = "Scripts/python.exe" if sys.platform == "win32" else "bin/python"
"""Place of the interpreter in an environment."""

NUMPY_2_SINCE = (3, 2)
"""First release of MuJoCo whose wheels were built for NumPy 2. Older ones crash with it."""

# With -I, paths of the user's environment do not belong to the new one.
PIP = ("-I", "-m", "pip", "--no-input", "--disable-pip-version-check", "--retries", "2")

UNREACHED = "connection broken|Failed to fetch|network was disabled|Could not fetch URL"
"""Messages of pip and uv on an index that does not answer."""

WORKER = Path(__file__).with_name("worker.py")

Arrays: TypeAlias = Mapping[str, FloatArray]


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


def make_environment(requirement: str) -> Path:
    """Return the interpreter of the environment of a requirement, and install it if it is not in the cache.

    A second command waits.

    Args:
        requirement: Package with an exact version, as `mujoco==3.3.0`.

    Raises:
        VersionsError: There is no such version, no network, or no space.
    """
    python = environment_folder(requirement) / PYTHON
    with (
        os_errors(
            lambda cause: VersionsError(
                f"{requirement}: {cause}; set GAUGE_CACHE_DIR to a folder with space"
            )
        ),
        _locked_folder(requirement) as folder,
    ):
        if not python.exists():
            _install(requirement, folder)
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


def _install(requirement: str, folder: Path) -> None:
    """Install a requirement next to a folder, and move it there; the caller has the lock."""
    packages = [requirement]
    package, _, version = requirement.partition("==")
    if package == "mujoco" and version_key(version) < NUMPY_2_SINCE:
        packages.append("numpy<2")
    message(f"{' and '.join(packages)}: installed into {folder}")
    part = folder.with_name(f".{folder.name}")
    # What a killed command left, and an environment whose Python is gone.
    for leftover in (folder, part):
        shutil.rmtree(leftover, ignore_errors=True)
    try:
        install: list[str | Path] = [part / PYTHON, *PIP, "install"]
        if uv := shutil.which("uv"):
            # The seed has pip, which lists the releases of a range.
            _run([uv, "venv", "--seed", "--python", sys.executable, part], requirement)
            install = [uv, "pip", "install", "--python", part / PYTHON]
        else:
            venv.create(part, with_pip=True)
        _run([*install, "--only-binary", ":all:", *packages], requirement)
        part.rename(folder)
    finally:
        shutil.rmtree(part, ignore_errors=True)


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
    done = subprocess.run(command, capture_output=True, text=True)
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
    command: Sequence[str | Path], title: str, variables: Mapping[str, str]
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
    variables = {**os.environ, **fixed, **variables}
    try:
        done = subprocess.run(command, capture_output=True, text=True, env=variables)
    except OSError as error:
        raise VersionsError(f"{title}: it cannot be started: {error}") from error
    # A traceback ends with the exception, whose message may have several lines.
    cause = re.split(r"^(?=\w[\w.]*: )", done.stderr, flags=re.M)[-1]
    if done.returncode < 0:
        signal_name = signal.Signals(-done.returncode).name
        cause = f"this release crashes on it ({signal_name})"
    if done.returncode:
        raise VersionsError(f"{title}: {' '.join(cause.split())}")


class Output(NamedTuple):
    """What a worker wrote: a description of the model, and arrays."""

    description: Mapping[str, Any]
    arrays: Arrays


@dataclass(kw_only=True)
class Bench:
    """A model that is compared.

    Attributes:
        title: The model as the user named it.
        job: Entries of every job.
    """

    title: str
    job: Mapping[str, Any]

    def work(
        self, task: str, sides: Sequence[Side], states: Arrays | None = None
    ) -> list[Output]:
        """Do a task on each side, two sides at a time.

        Args:
            task: Task of the worker.
            sides: The sides.
            states: States of a probe.

        Raises:
            VersionsError: An environment cannot be made, or a version cannot run the model.
        """
        for side in sides:
            if side.requirement:
                make_environment(side.requirement)
        with TemporaryDirectory(prefix="gauge-versions-") as folder:
            files = [Path(folder) / f"{index}.job" for index in range(len(sides))]
            job = {**self.job, "task": task, "states": f"{folder}/states.npz"}
            if states is not None:
                np.savez(job["states"], allow_pickle=False, **states)
            for side, file in zip(sides, files, strict=True):
                job |= {"settings": side.settings, "out": str(file.with_suffix(""))}
                file.write_text(json.dumps(job))
            with ThreadPoolExecutor(2) as pool:
                list(pool.map(self.execute, sides, files))
            # NumPy parses the headers of arrays with `ast`, which is not safe in threads of Python 3.11.
            return list(map(_output, files))

    def execute(self, side: Side, file: Path) -> None:
        """Run the worker on a job in the environment of a side."""
        python = side.python or make_environment(side.requirement)
        # With -I, neither the user's paths nor modules next to the worker count.
        command = [python, "-I", "-B", WORKER, file]
        run_process(command, f"{side.title} cannot run {self.title}", {})


def _output(file: Path) -> Output:
    """Return what a worker wrote for the job of a file."""
    description = json.loads(file.with_suffix(".json").read_text())
    with np.load(file.with_suffix(".npz")) as arrays:
        return Output(description, dict(arrays))
