"""Test the built wheel on several Python versions, one of them with the lowest dependencies that the project allows.

    python -m scripts matrix 3.12:lowest 3.13:newest --tests tests/cli tests/scene --rigid-tests tests/scene

Each entry makes a fresh environment, installs the wheel with the extras `plot`, `sanity` and `usd`, and without any
engine but MuJoCo, runs the conformance checks of MuJoCo, and runs the tests from a copy that holds no sources of the
package. The lowest MuJoCo has no deformable bodies. An entry with the lowest dependencies runs `--rigid-tests` with it,
and the other tests with the lowest MuJoCo that has them. A version without an interpreter is skipped with a message;
PYTHON3_12=/path/to/python names an interpreter that is not on the PATH.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from gauge_envs.backends.mujoco.versions import FAULTY_SPARSE, UNSTEADY_BOXES
from scripts.lowest_versions import PYPROJECT, constraints

ROOT = PYPROJECT.parent
EXTRAS = ("plot", "sanity", "usd")
"""Extras that the tests below need; what works without them is the matter of `tests/test_core_alone.py`."""
TEST_TOOLS = ("hypothesis", "jsonschema", "pytest")
COPIED = (
    "benchmarks",
    "docs",
    "examples",
    "leaderboard",
    "scoring",
    "scripts",
    "studies",
    "tests",
    "README.md",
    "pyproject.toml",
)
RESOLUTIONS = ("newest", "lowest")
LOWEST_WITH_DEFORMABLES = "mujoco==4.0.0"
PUBLISHED = ROOT / "scoring" / "conformance.json"
"""Results of all checks; the first column is that of MuJoCo's defaults, with a release of `FAULTY_SPARSE`."""
CONFORMANCE_LIMIT_S = 300.0
"""Time limit of the conformance checks of MuJoCo [s]; they take 8 s."""


@dataclass(frozen=True)
class Entry:
    """A Python version, as `3.12`, and which versions of the dependencies it is tested with."""

    python: str
    resolution: str

    @classmethod
    def parse(cls, text: str) -> Entry:
        """Read `3.12:lowest`."""
        python, _, resolution = text.partition(":")
        if resolution not in RESOLUTIONS:
            raise argparse.ArgumentTypeError(
                f"{text!r}: write VERSION:{' or VERSION:'.join(RESOLUTIONS)}"
            )
        return cls(python, resolution)

    def __str__(self) -> str:
        return f"Python {self.python}, {self.resolution} dependencies"


def interpreter(version: str) -> Path | None:
    """Find a working interpreter of a version: the variable, the PATH, then what pyenv holds."""
    for candidate in _candidates(version):
        found = subprocess.run(
            [
                candidate,
                "-c",
                "import sys, venv; print('%d.%d' % sys.version_info[:2])",
            ],
            capture_output=True,
            text=True,
            check=False,
        )
        if found.returncode == 0 and found.stdout.strip() == version:
            return Path(candidate)
    return None


def _candidates(version: str) -> Iterator[str]:
    named = os.environ.get(f"PYTHON{version.replace('.', '_')}")
    names = (named, f"python{version}", "python3", sys.executable)
    yield from (path for name in names if name and (path := shutil.which(name)))
    pyenv = Path(os.environ.get("PYENV_ROOT") or Path.home() / ".pyenv")
    yield from (
        str(path) for path in sorted(pyenv.glob(f"versions/{version}.*/bin/python"))
    )


def build_wheel(out: Path) -> Path:
    """Build the wheel of this checkout into a folder."""
    _run(
        [
            sys.executable,
            "-m",
            "build",
            "--wheel",
            "--no-isolation",
            "--outdir",
            str(out),
            str(ROOT),
        ]
    )
    return next(out.glob("*.whl"))


def make_environment(
    folder: Path,
    *,
    python: Path,
    wheel: Path,
    extras: Sequence[str],
    lowest: bool = False,
) -> Path:
    """Make an environment that holds the wheel and what it requires, and nothing else.

    Args:
        folder: Where to make it.
        python: Interpreter of the environment.
        wheel: The built wheel.
        extras: Extras of the project to install with it.
        lowest: Whether direct dependencies have the lowest version that the project allows.

    Returns:
        The folder of the environment's commands.
    """
    _run([str(python), "-m", "venv", str(folder)])
    chosen = f"{wheel}[{','.join(extras)}]" if extras else str(wheel)
    lines = constraints(PYPROJECT, extras) if lowest else []
    bounds = folder / "constraints.txt"
    bounds.write_text("\n".join(lines), encoding="utf-8")
    _run(
        [
            str(folder / "bin" / "python"),
            "-m",
            "pip",
            "install",
            "--quiet",
            "-c",
            str(bounds),
            chosen,
        ]
    )
    return folder / "bin"


def _variables() -> dict[str, str]:
    """Return the environment variables without those of Python.

    Where PYTHONPATH leads to another copy of the same version, pip installs nothing and succeeds.
    """
    return {
        name: value
        for name, value in os.environ.items()
        if not name.startswith("PYTHON")
    }


def _run(command: list[str], limit_s: float | None = None) -> None:
    done = subprocess.run(
        command,
        capture_output=True,
        text=True,
        check=False,
        timeout=limit_s,
        env=_variables(),
    )
    if done.returncode:
        raise SystemExit(f"{' '.join(command)} failed:\n{done.stdout}\n{done.stderr}")


def _check(commands: Path, out: Path) -> None:
    """Run the conformance checks of MuJoCo; end where others than the published ones fail."""
    command = [str(commands / "gauge"), "backend", "check", "mujoco", "--out", str(out)]
    done = subprocess.run(
        command,
        capture_output=True,
        text=True,
        check=False,
        timeout=CONFORMANCE_LIMIT_S,
        env=_variables(),
    )
    failed, release = _failed(out) if out.exists() else (set(), "")
    expected, _ = _failed(PUBLISHED)
    if release not in FAULTY_SPARSE:
        expected.discard("solver-pile")
    if release in UNSTEADY_BOXES:
        expected.add("tower-stands")
    if failed != expected:
        raise SystemExit(
            f"{' '.join(command)}: {failed} failed, not {expected}:\n{done.stdout}\n{done.stderr}"
        )


def _failed(file: Path) -> tuple[set[str], str]:
    """Return the checks that the first column of a file fails, and its release of MuJoCo."""
    column = json.loads(file.read_text(encoding="utf-8"))["columns"][0]
    failed = {
        name
        for name, finding in column["findings"].items()
        if finding["status"] not in ("pass", "declined")
    }
    return failed, column["versions"].get("mujoco", "")


def _test(
    entry: Entry,
    python: Path,
    wheel: Path,
    tests: Sequence[str],
    rigid_tests: Sequence[str],
    folder: Path,
) -> int:
    start = time.perf_counter()
    is_lowest = entry.resolution == "lowest"
    commands = make_environment(
        folder / "venv", python=python, wheel=wheel, extras=EXTRAS, lowest=is_lowest
    )
    _run([str(commands / "python"), "-m", "pip", "install", "--quiet", *TEST_TOOLS])
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
    installed_s = time.perf_counter() - start
    print(
        f"{entry}: installed in {installed_s:.0f} s; {_versions(commands / 'python')}",
        flush=True,
    )
    _check(commands, folder / "checks.json")
    print(
        f"{entry}: MuJoCo conforms after {time.perf_counter() - start - installed_s:.0f} s",
        flush=True,
    )
    code = 0
    if is_lowest:
        code = _pytest(commands, rigid_tests, checkout)
        # MuJoCo 4 consists of several packages; pip would remove their files with the single older one afterwards.
        _run(
            [
                str(commands / "python"),
                "-m",
                "pip",
                "uninstall",
                "--quiet",
                "--yes",
                "mujoco",
            ]
        )
        _run(
            [
                str(commands / "python"),
                "-m",
                "pip",
                "install",
                "--quiet",
                LOWEST_WITH_DEFORMABLES,
            ]
        )
        print(f"{entry}: goes on with {_versions(commands / 'python')}", flush=True)
    code = _pytest(commands, tests, checkout) or code
    print(
        f"{entry}: pytest exits with {code} after {time.perf_counter() - start - installed_s:.0f} s",
        flush=True,
    )
    return code


def _pytest(commands: Path, tests: Sequence[str], checkout: Path) -> int:
    # The command `pytest`, unlike `python -m pytest`, leaves the working directory out of the path.
    command = [str(commands / "pytest"), *tests]
    return subprocess.run(
        command, cwd=checkout, check=False, env=_variables()
    ).returncode


def _versions(python: Path) -> str:
    script = (
        "import sys; from pathlib import Path; from importlib.metadata import version; import gauge_envs\n"
        "assert Path(gauge_envs.__file__).is_relative_to(sys.prefix), gauge_envs.__file__\n"
        "print(', '.join(f'{name} {version(name)}' for name in ('gymnasium', 'mujoco', 'numpy', 'scipy', 'usd-core')))"
    )
    done = subprocess.run(
        [str(python), "-I", "-c", script], capture_output=True, text=True, check=True
    )
    return done.stdout.strip()


def main(
    entries: Sequence[Entry], tests: Sequence[str], rigid_tests: Sequence[str]
) -> int:
    """Test every entry; returns 1 when tests of one fail."""
    failed, skipped = [], []
    with tempfile.TemporaryDirectory(prefix="gauge-test-matrix-") as temporary:
        wheel = build_wheel(Path(temporary) / "dist")
        for number, entry in enumerate(entries):
            python = interpreter(entry.python)
            if python is None:
                skipped.append(entry)
                variable = f"PYTHON{entry.python.replace('.', '_')}"
                print(
                    f"{entry}: SKIPPED, no interpreter python{entry.python}; install one or set {variable}",
                    flush=True,
                )
                continue
            folder = Path(temporary) / str(number)
            folder.mkdir()
            if _test(entry, python, wheel, tests, rigid_tests, folder):
                failed.append(entry)
    done = [entry for entry in entries if entry not in failed and entry not in skipped]
    for word, those in (("passed", done), ("failed", failed), ("skipped", skipped)):
        for entry in those:
            print(f"{word}: {entry}")
    return int(bool(failed))
