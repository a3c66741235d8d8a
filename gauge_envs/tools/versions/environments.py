"""Python environments of releases in a cache, and the processes that run a side in them."""

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
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
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

WORKER = Path(__file__).with_name("worker.py")

PROCESS_VARIABLES = {
    "OMP_NUM_THREADS": "1",
    "MUJOCO_GL": "disable",
    # The folder of the worker has modules with common names.
    "PYTHONSAFEPATH": "1",
}

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
    """Return the folder of the environment of a requirement, and install it if it is not in the cache.

    A second command waits.

    Args:
        requirement: Package with an exact version, as `mujoco==3.3.0`.

    Raises:
        VersionsError: There is no such version, no network, or no space.
    """
    folder = environment_folder(requirement)
    advice = "set GAUGE_CACHE_DIR to a folder with space"
    with os_errors(lambda cause: VersionsError(f"{requirement}: {cause}; {advice}")):
        folder.parent.mkdir(parents=True, exist_ok=True)
        with locked(folder.parent):
            if not (folder / PYTHON).exists():
                _install(requirement, folder)
    return folder


def remove_environment(requirement: str) -> None:
    """Remove the environment of a requirement from the cache."""
    shutil.rmtree(environment_folder(requirement), ignore_errors=True)


def _install(requirement: str, folder: Path) -> None:
    """Install a requirement next to a folder, and move it there."""
    package, _, version = requirement.partition("==")
    packages = [requirement]
    if package == "mujoco":
        is_old = version_key(version) < NUMPY_2_SINCE
        # Other packages of the user may need the NumPy that is installed here.
        packages.append("numpy<2" if is_old else f"numpy=={np.__version__}")
    message(f"{' and '.join(packages)}: installed into {folder}")
    # The Python of an old environment may be gone.
    shutil.rmtree(folder, ignore_errors=True)
    with TemporaryDirectory(dir=folder.parent) as parent:
        part = Path(parent) / "environment"
        install: list[str | Path] = [part / PYTHON, *PIP, "install"]
        if uv := shutil.which("uv"):
            # The seed has pip, which lists the releases of a range.
            run([uv, "venv", "--seed", "--python", sys.executable, part], requirement)
            install = [uv, "pip", "install", "--python", part / PYTHON]
        else:
            venv.create(part, with_pip=True)
        install += ["--only-binary", ":all:", *packages]
        run(install, f"{requirement} cannot be installed; --python FILE names one")
        part.rename(folder)


def released_versions(requirement: str) -> list[str]:
    """Return the versions of the package of a requirement in the package index, the oldest first.

    Raises:
        VersionsError: The index does not answer.
    """
    python = make_environment(requirement) / PYTHON
    package = requirement.partition("==")[0]
    text = run([python, *PIP, "index", "versions", package], package)
    versions = text.partition("Available versions: ")[2].splitlines()[0]
    return sorted(versions.split(", "), key=version_key)


# --- processes -------------------------------------------------------------------------------------------------------


def run(
    command: Sequence[str | Path], problem: str, variables: Mapping[str, str] = {}
) -> str:
    """Return what a command prints.

    Args:
        command: The command.
        problem: What its failure means.
        variables: Variables that are added to the environment.

    Raises:
        VersionsError: It failed; the message has the last error that it prints.
    """
    env = {**os.environ, **variables}
    with os_errors(lambda cause: VersionsError(f"{problem}: {command[0]}: {cause}")):
        done = subprocess.run(command, capture_output=True, text=True, env=env)
    # A traceback ends with the exception, whose message may have several lines.
    cause = re.split(r"^(?=\w[\w.]*: )", done.stderr, flags=re.M)[-1]
    if done.returncode < 0:
        cause = f"it crashes ({signal.Signals(-done.returncode).name})"
    if done.returncode:
        raise VersionsError(f"{problem}: {' '.join(cause.split())}")
    return done.stdout


def run_python(side: Side, words: Sequence[str | Path], title: str) -> None:
    """Run Python with the packages of a side before those of the user, and wait for it.

    Args:
        side: The side.
        words: Arguments of Python.
        title: What runs, for messages.

    Raises:
        VersionsError: It failed.
    """
    variables = dict(PROCESS_VARIABLES)
    if side.requirement:
        base = str(make_environment(side.requirement))
        bases = {"base": base, "platbase": base}
        packages = sysconfig.get_path("platlib", "venv", bases)
        paths = filter(None, [packages, os.environ.get("PYTHONPATH")])
        variables["PYTHONPATH"] = os.pathsep.join(paths)
    command = [side.python or sys.executable, "-B", *words]
    run(command, f"{side.title} cannot run {title}", variables)


class Output(NamedTuple):
    """What a worker wrote: a description of the model, and arrays."""

    description: Mapping[str, Any]
    arrays: Arrays


@dataclass(kw_only=True)
class Bench:
    """What is compared: a model or an environment.

    Attributes:
        title: Its name, as the user gave it.
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
        with TemporaryDirectory(prefix="gauge-versions-") as folder:
            shared = {**self.job, "task": task, "states": f"{folder}/states.npz"}
            np.savez(shared["states"], allow_pickle=False, **(states or {}))
            jobs = [
                {**shared, "settings": side.settings, "out": f"{folder}/{index}.npz"}
                for index, side in enumerate(sides)
            ]
            with ThreadPoolExecutor(2) as pool:
                list(pool.map(self.execute, sides, jobs))
            # NumPy parses the headers of arrays with `ast`, which is not safe in threads of Python 3.11.
            return [_output(job["out"]) for job in jobs]

    def execute(self, side: Side, job: Mapping[str, Any]) -> None:
        """Run the worker on a job in the environment of a side."""
        run_python(side, [WORKER, json.dumps(job)], self.title)


def _output(file: str) -> Output:
    """Return what a worker wrote into a file."""
    with np.load(file) as stored:
        arrays = dict(stored)
    return Output(json.loads(str(arrays.pop("description"))), arrays)
