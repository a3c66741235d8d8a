"""Test the built wheel on several Python versions, one of them with the lowest dependencies that the project allows.

    python -m scripts matrix 3.12:lowest 3.13:newest --tests tests/cli tests/scene --rigid-tests tests/scene

Each entry makes a fresh environment and installs the wheel with the extras `plot`, `sanity` and `usd`. The only engine
is MuJoCo. The entry runs its conformance checks, and the tests from a copy without sources of the package. The lowest
MuJoCo has no deformable bodies. An entry with the lowest dependencies runs `--rigid-tests` with it, and the other tests
with the lowest MuJoCo that has them. PYTHON3_12=/path/to/python names an interpreter that is not on the PATH.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from gauge_envs.backends.mujoco.versions import UNSTEADY_BOXES
from scripts.lowest_versions import PYPROJECT, constraints

ROOT = PYPROJECT.parent
EXTRAS = ("plot", "sanity", "usd")
"""Extras that the tests need; `tests/test_core_alone.py` tests the package without them."""

TEST_TOOLS = ("hypothesis", "jsonschema", "pytest")
COPIED = (
    "benchmarks",
    "docs",
    "examples",
    "scoring",
    "scripts",
    "studies",
    "tests",
    "README.md",
    "pyproject.toml",
)
LOWEST_WITH_DEFORMABLES = "mujoco==4.0.0"

PUBLISHED = ROOT / "scoring" / "conformance.json"


def interpreter(version: str) -> str:
    """Return a working interpreter of a version: from the variable, from the PATH, or from pyenv.

    Raises:
        SystemExit: There is none.
    """
    variable = f"PYTHON{version.replace('.', '_')}"
    pyenv = Path(os.environ.get("PYENV_ROOT") or Path.home() / ".pyenv")
    candidates = [
        os.environ.get(variable) or f"python{version}",
        *map(str, sorted(pyenv.glob(f"versions/{version}.*/bin/python"))),
    ]
    for candidate in candidates:
        # A shim of pyenv on the PATH may not run.
        command = [candidate, "-c", "import venv"]
        if (
            shutil.which(candidate)
            and not subprocess.run(command, capture_output=True, check=False).returncode
        ):
            return candidate
    raise SystemExit(f"no python{version}: install it, or set {variable}")


def build_wheel(out: Path) -> Path:
    """Build the wheel of this checkout into a folder."""
    run(sys.executable, "-m", "build", "--wheel", "--no-isolation", "-o", out, ROOT)
    return next(out.glob("*.whl"))


def make_environment(
    folder: Path,
    *,
    python: str | Path,
    wheel: Path,
    extras: Sequence[str],
    lowest: bool = False,
) -> Path:
    """Make an environment with only the wheel and its requirements.

    Args:
        folder: Where to make it.
        python: Interpreter of the environment.
        wheel: The built wheel.
        extras: Extras of the project to install with it.
        lowest: Whether direct dependencies have the lowest version that the project allows.

    Returns:
        The folder of the environment's commands.
    """
    run(python, "-m", "venv", folder)
    chosen = f"{wheel}[{','.join(extras)}]" if extras else str(wheel)
    bounds = folder / "constraints.txt"
    lines = constraints(PYPROJECT, extras) if lowest else []
    bounds.write_text("\n".join(lines), encoding="utf-8")
    _pip(folder / "bin", "install", "-c", bounds, chosen)
    return folder / "bin"


def _pip(commands: Path, *words: str | Path) -> None:
    action, *rest = words
    run(commands / "python", "-m", "pip", action, "--quiet", *rest)


def _variables() -> dict[str, str]:
    """Return the environment variables without those of Python.

    Where PYTHONPATH leads to another copy of the same version, pip installs nothing and succeeds.
    """
    return {
        name: value
        for name, value in os.environ.items()
        if not name.startswith("PYTHON")
    }


def run(*words: str | Path) -> str:
    """Return the output of a command.

    Raises:
        SystemExit: The command failed.
    """
    command = [str(word) for word in words]
    done = subprocess.run(
        command, capture_output=True, text=True, check=False, env=_variables()
    )
    if done.returncode:
        raise SystemExit(f"{' '.join(command)} failed:\n{done.stdout}\n{done.stderr}")
    return done.stdout.strip()


def _published_failures() -> set[str]:
    """Return the checks that MuJoCo's default configuration fails in the published table."""
    columns = json.loads(PUBLISHED.read_text(encoding="utf-8"))["columns"]
    (column,) = (
        column
        for column in columns
        if (column["backend"], column["name"]) == ("mujoco", "default")
    )
    results = column["results"].items()
    return {check for check, result in results if result["status"] == "fail"}


def _check(commands: Path) -> None:
    """Run the conformance checks of MuJoCo; end where others than the expected ones fail."""
    program = "from importlib.metadata import version; print(version('mujoco'))"
    release = run(commands / "python", "-I", "-c", program)
    print(f"MuJoCo {release}", flush=True)
    command = [commands / "gauge", "backend", "check", "mujoco", "--format", "json"]
    done = subprocess.run(
        command, capture_output=True, text=True, check=False, env=_variables()
    )
    results = [json.loads(line) for line in done.stdout.splitlines()]
    failed = {row["check"] for row in results if row["status"] in ("fail", "error")}
    unsteady = ("rest-heights", "rest-still", "slide-straight", "tower-stands")
    expected = _published_failures()
    if release in UNSTEADY_BOXES:
        expected |= set(unsteady)
    if not results or failed != expected:
        raise SystemExit(
            f"checks that failed: {sorted(failed)}, expected: {sorted(expected)}\n{done.stderr}"
        )


def _test(
    commands: Path,
    folder: Path,
    tests: Sequence[str],
    rigid_tests: Sequence[str],
    *,
    lowest: bool,
) -> int:
    _pip(commands, "install", *TEST_TOOLS)
    checkout = folder / "checkout"
    checkout.mkdir()
    for name in COPIED:
        source = ROOT / name
        if source.is_dir():
            # Tests that run beside this one write bytecode.
            ignored = shutil.ignore_patterns("__pycache__")
            shutil.copytree(source, checkout / name, ignore=ignored)
        else:
            shutil.copy(source, checkout / name)
    _check(commands)
    code = 0
    if lowest:
        code = _pytest(commands, rigid_tests, checkout)
        # MuJoCo 4 consists of several packages; pip would remove their files with the single older one afterwards.
        _pip(commands, "uninstall", "--yes", "mujoco")
        _pip(commands, "install", LOWEST_WITH_DEFORMABLES)
    return _pytest(commands, tests, checkout) or code


def _pytest(commands: Path, tests: Sequence[str], checkout: Path) -> int:
    # The command `pytest`, unlike `python -m pytest`, leaves the working directory out of the path.
    command = [str(commands / "pytest"), *tests]
    return subprocess.run(
        command, cwd=checkout, check=False, env=_variables()
    ).returncode


def main(
    entries: Sequence[str], tests: Sequence[str], rigid_tests: Sequence[str]
) -> int:
    """Test every entry, as `3.12:lowest` or `3.13:newest`; return 1 when tests of one fail."""
    failed = 0
    with tempfile.TemporaryDirectory(prefix="gauge-test-matrix-") as temporary:
        wheel = build_wheel(Path(temporary) / "dist")
        for entry in entries:
            version, _, resolution = entry.partition(":")
            folder = Path(temporary) / version
            folder.mkdir()
            lowest = resolution == "lowest"
            commands = make_environment(
                folder / "venv",
                python=interpreter(version),
                wheel=wheel,
                extras=EXTRAS,
                lowest=lowest,
            )
            code = _test(commands, folder, tests, rigid_tests, lowest=lowest)
            print(f"{entry}: {'failed' if code else 'passed'}", flush=True)
            failed |= code
    return int(bool(failed))
