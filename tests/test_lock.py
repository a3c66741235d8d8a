"""`scripts/lock.txt` has a version of every package of the test environment, for pip and uv."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tomllib
from collections.abc import Sequence
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from places import ROOT

from scripts.lowest_versions import PYPROJECT, requirements

LOCK = ROOT / "scripts" / "lock.txt"

INSTALL = {
    "pip": ([sys.executable, "-m", "venv", "{venv}"], ["{python}", "-m", "pip"]),
    "uv": (["uv", "venv", "--python", sys.executable, "{venv}"], ["uv", "pip"]),
}
"""Commands that create an environment and install into it."""


def locked() -> dict[str, list[str]]:
    """Return the versions in the lock by name; a package may have one for each version of Python."""
    versions: dict[str, list[str]] = {}
    for line in LOCK.read_text().splitlines():
        requirement = Requirement(line)
        (version,) = requirement.specifier
        versions.setdefault(requirement.name, []).append(version.version)
    return versions


def test_the_lock_has_versions_that_the_project_allows() -> None:
    versions = locked()
    project = tomllib.loads(PYPROJECT.read_text())["project"]
    for requirement in requirements(project, ["dev"]):
        allowed = versions[requirement.name.replace("_", "-").lower()]
        assert all(requirement.specifier.contains(version) for version in allowed), (
            requirement
        )


@pytest.mark.slow
@pytest.mark.parametrize("tool", INSTALL)
def test_the_wheel_installs_with_the_lock(tool: str, tmp_path: Path) -> None:
    if not shutil.which(tool) and tool == "uv":
        pytest.skip("uv is not installed")
    places = {"venv": tmp_path / "venv", "python": tmp_path / "venv" / "bin" / "python"}

    def run(words: Sequence[str], *more: str) -> str:
        command = [word.format(**places) for word in words]
        done = subprocess.run(
            [*command, *more], capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    make, install = INSTALL[tool]
    run(make)
    python = ["--python", str(places["python"])] if tool == "uv" else []
    run([*install, "install"], *python, "-c", str(LOCK), f"{ROOT}[plot]")
    program = "import numpy; print(numpy.__version__)"
    assert run(["{python}"], "-c", program).strip() in locked()["numpy"]
    gauge = [str(places["venv"] / "bin" / "gauge")]
    assert "0 of 1 are like reality" in run(gauge, "run", "BouncingBall-rubber")
