"""Install releases into cached Python environments, and run processes in them."""

import json
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import venv
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from platformdirs import user_cache_path

from gauge_envs.cli.output import message
from gauge_envs.errors import GaugeError
from gauge_envs.files import os_errors
from gauge_envs.locks import locked
from gauge_envs.tools.versions.schema import Side

TAG = f"-{sys.implementation.cache_tag}-{sysconfig.get_platform()}"
"""Suffix of an environment: several machines may share the cache in a home folder."""

PYTHON = "Scripts/python.exe" if sys.platform == "win32" else "bin/python"
"""Path of the interpreter in an environment."""

NUMPY_2_SINCE = (3, 2)
"""First release of MuJoCo built for NumPy 2. Older releases crash with NumPy 2."""

# -I excludes the paths of the user's environment.
PIP = ("-I", "-m", "pip", "--no-input", "--disable-pip-version-check")

WORKER = Path(__file__).with_name("worker.py")

PROCESS_VARIABLES = {
    "OMP_NUM_THREADS": "1",
    "MUJOCO_GL": "disable",
    # The folder of the worker has modules with common names; keep it off the path.
    "PYTHONSAFEPATH": "1",
}

Job: TypeAlias = Mapping[str, Any]
"""Job of the worker, as its module describes."""

Arrays: TypeAlias = Mapping[str, NDArray[Any]]
"""Arrays of the worker by name."""


class VersionsError(GaugeError, RuntimeError):
    """An installation fails, or a version cannot run a model; the message names the cause."""


# --- environments ----------------------------------------------------------------------------------------------------


def environment_folder(requirement: str) -> Path:
    """Return the folder of the environment of a requirement, installed or not.

    The variable `GAUGE_CACHE_DIR` replaces the user's cache folder.
    """
    cache = user_cache_path("gauge-envs", appauthor=False)
    folder = Path(os.environ.get("GAUGE_CACHE_DIR") or cache).expanduser()
    return folder / "versions" / f"{requirement.replace('==', '-')}{TAG}"


def version_key(version: str) -> tuple[int, ...]:
    """Return the numbers of a version as a sort key."""
    return tuple(map(int, re.findall(r"\d+", version)))


def make_environment(requirement: str) -> Path:
    """Return the environment folder of a requirement; install it if it is not in the cache.

    A parallel command waits for the installation.

    Args:
        requirement: Package with an exact version, for example `mujoco==3.3.0`.

    Raises:
        VersionsError: The version does not exist, or the network or disk space is missing.
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
    """Install a requirement into a folder; an interrupted installation leaves no folder."""
    package, _, version = requirement.partition("==")
    packages = [requirement]
    if package == "mujoco":
        is_old = version_key(version) < NUMPY_2_SINCE
        # Packages of the user may need the installed NumPy.
        packages.append("numpy<2" if is_old else f"numpy=={np.__version__}")
    message(f"{' and '.join(packages)}: installing into {folder}")
    # An old environment may lack its Python.
    shutil.rmtree(folder, ignore_errors=True)
    with TemporaryDirectory(dir=folder.parent) as parent:
        part = Path(parent) / "environment"
        if uv := shutil.which("uv"):
            # A Python of a Linux distribution may lack `ensurepip`, which venv needs.
            run([uv, "venv", "--seed", "--python", sys.executable, part], requirement)
        else:
            venv.create(part, with_pip=True)
        run(
            [part / PYTHON, *PIP, "install", "--only-binary", ":all:", *packages],
            f"{requirement} cannot be installed; --python FILE uses an existing environment",
        )
        part.rename(folder)


def released_versions(requirement: str) -> list[str]:
    """Return the versions of a package in the package index, oldest first.

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
    """Run a command and return its output.

    Args:
        command: The command.
        problem: Begin of the error message.
        variables: Extra environment variables.

    Raises:
        VersionsError: The command fails; the message has its last error.
    """
    env = {**os.environ, **variables}
    with os_errors(lambda cause: VersionsError(f"{problem}: {command[0]}: {cause}")):
        done = subprocess.run(command, capture_output=True, text=True, env=env)
    # A traceback ends with the exception; its message may have several lines.
    if done.returncode:
        cause = re.split(r"^(?=\w[\w.]*: )", done.stderr, flags=re.M)[-1]
        text = " ".join(cause.split()) or f"exit code {done.returncode}"
        raise VersionsError(f"{problem}: {text}")
    return done.stdout


def run_worker(side: Side, job: Job) -> None:
    """Run the worker on a job, with the packages of a side before the packages of the user.

    Raises:
        VersionsError: The worker fails.
    """
    variables = dict(PROCESS_VARIABLES)
    if side.requirement:
        packages = next(make_environment(side.requirement).rglob("site-packages"))
        paths = filter(None, [str(packages), os.environ.get("PYTHONPATH")])
        variables["PYTHONPATH"] = os.pathsep.join(paths)
    command: list[str | Path] = [
        side.python or sys.executable,
        "-B",
        WORKER,
        json.dumps(job),
    ]
    run(command, f"{side.title} cannot run {job['title']}", variables)


def work(
    task: str, job: Job, sides: Sequence[Side], states: Mapping[str, Any] = {}
) -> list[Arrays]:
    """Run a task of the worker on each side, two sides at a time, and return the arrays of each.

    Args:
        task: The task.
        job: Common entries of the job; `title` is the model or environment, as given by the user.
        sides: The sides.
        states: States of a probe.

    Raises:
        VersionsError: The installation of an environment fails, or a version cannot run the model.
    """
    with TemporaryDirectory(prefix="gauge-versions-") as folder:
        shared = {**job, "task": task, "states": f"{folder}/states.npz"}
        np.savez(shared["states"], **states)
        jobs = [
            {
                **shared,
                "engine": side.engine,
                "settings": side.settings,
                "out": f"{folder}/{index}.npz",
            }
            for index, side in enumerate(sides)
        ]
        with ThreadPoolExecutor(2) as pool:
            list(pool.map(run_worker, sides, jobs))
        outputs: list[Arrays] = []
        # NumPy parses array headers with `ast`, which is not thread-safe in Python 3.11.
        for job in jobs:
            with np.load(job["out"]) as arrays:
                outputs.append(dict(arrays))
        return outputs
