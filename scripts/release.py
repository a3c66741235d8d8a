"""Rehearse a release: build both archives, check them, and use the wheel as a reader of the README does.

    make release

It ends with the first fault. Nothing is published: the workflow `release.yml` does that for a tag.
"""

from __future__ import annotations

import re
import sys
import tempfile
import tomllib
import zipfile
from pathlib import Path

from scripts.test_matrix import interpreter, make_environment, run

ROOT = Path(__file__).parents[1]
MAX_WHEEL_MB = 6.0
PYTHONS = ("3.11", "3.13")
"""Lowest and highest Python for which the engines have wheels."""

DEMO = "SlopeSlider-2-wood,BouncingBall-rubber,NewtonsCradle-metal,Pendulum-metal,Turntable-1-wood"
"""Experiments of `make demo`."""

ADDRESSES = ("Homepage", "Repository", "Documentation", "Changelog", "Issues")


def main() -> int:
    """Run all steps and print each; return 0."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))[
        "project"
    ]
    check_versions(project["version"])
    with tempfile.TemporaryDirectory() as folder:
        archives = Path(folder) / "dist"
        run(sys.executable, "-m", "build", "--no-isolation", "-o", archives, ROOT)
        run(sys.executable, "-m", "twine", "check", "--strict", *archives.iterdir())
        wheel = next(archives.glob("*.whl"))
        check_contents(wheel)
        for version in PYTHONS:
            use_wheel(wheel, version, Path(folder) / version)
    missing = [name for name in ADDRESSES if name not in project["urls"]]
    if missing:
        print(f"left to do: add {', '.join(missing)} to [project.urls]")
    return 0


def check_versions(version: str) -> None:
    """Check that the changelog and the citation have the version; a development version is in neither.

    Raises:
        SystemExit: One of them has another version.
    """
    if "dev" in version:
        print(f"version {version}: not compared with CHANGELOG.md and CITATION.cff")
        return
    patterns = {
        "CHANGELOG.md": rf"^## \[{re.escape(version)}\] - \d{{4}}-\d\d-\d\d$",
        "CITATION.cff": rf"^version: {re.escape(version)}$",
    }
    for name, pattern in patterns.items():
        text = (ROOT / name).read_text(encoding="utf-8")
        if not re.search(pattern, text, re.MULTILINE):
            raise SystemExit(f"{name}: has no line for version {version}")
    print(f"version {version} in pyproject.toml, CHANGELOG.md and CITATION.cff")


def check_contents(wheel: Path) -> None:
    """Check the size of the wheel, its licence files and its data.

    Raises:
        SystemExit: The wheel is too large or lacks a file.
    """
    size_mb = wheel.stat().st_size / 1e6
    if size_mb > MAX_WHEEL_MB:
        raise SystemExit(f"{wheel.name}: {size_mb:.1f} MB, at most {MAX_WHEEL_MB} MB")
    names = zipfile.ZipFile(wheel).namelist()
    needed = {
        "licenses/LICENSE",
        "py.typed",
        "PROVENANCE.md",
        "CubeToss-acrylic.LICENSE",
    }
    absent = {
        ending for ending in needed if not any(name.endswith(ending) for name in names)
    }
    if absent:
        raise SystemExit(f"{wheel.name}: lacks {', '.join(sorted(absent))}")
    print(f"{wheel.name}: {size_mb:.1f} MB, {len(names)} files")


def use_wheel(wheel: Path, version: str, folder: Path) -> None:
    """Install the wheel in a fresh environment, and run the demo and the Python code of the README there."""
    commands = make_environment(
        folder, python=interpreter(version), wheel=wheel, extras=["plot", "sanity"]
    )
    run(commands / "gauge", "run", DEMO, "--out", folder / "results")
    run(commands / "gauge", "plot", folder / "results", "--out", folder / "plots")
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    for code in re.findall(r"```python\n(.*?)```", readme, re.DOTALL):
        run(commands / "python", "-I", "-c", code)
    print(f"Python {version}: demo and README")
