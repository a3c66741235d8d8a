"""Rehearse a release: build both archives, check them, and use the wheel as a reader of the README does.

    make release

It ends with the first fault, or with a list of what a release still needs. Nothing is published: the workflow
`release.yml` does that for a tag.
"""

from __future__ import annotations

import hashlib
import re
import sys
import tempfile
import tomllib
import zipfile
from collections.abc import Iterable
from pathlib import Path

from scripts.test_matrix import interpreter, make_environment, run

ROOT = Path(__file__).parents[1]
MAX_WHEEL_MB = 6.0
PYTHONS = ("3.11", "3.13")
"""Lowest and highest Python for which the engines have wheels."""

DATE = re.compile(r"\d{4}-\d\d-\d\d")

ADDRESSES = ("Homepage", "Repository", "Documentation", "Changelog", "Issues")


def main() -> int:
    """Run all steps and print each, then what is left to do; return 1 if anything is."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))[
        "project"
    ]
    with tempfile.TemporaryDirectory() as folder:
        archives = Path(folder) / "dist"
        run(sys.executable, "-m", "build", "--no-isolation", "-o", archives, ROOT)
        run(sys.executable, "-m", "twine", "check", "--strict", *archives.iterdir())
        wheel = next(archives.glob("*.whl"))
        check_contents(wheel)
        for version in PYTHONS:
            use_wheel(wheel, version, Path(folder) / version)
    left = left_to_do(ROOT, project["version"], project["urls"])
    for text in left:
        print(f"left to do: {text}")
    return int(bool(left))


def left_to_do(root: Path, version: str, urls: Iterable[str]) -> list[str]:
    """Return what a release still needs, each with its file.

    The changelog states the date, and the hash of the data that scores depend on: no commit can state its own hash.

    Args:
        root: Folder of the repository.
        version: Version of the project.
        urls: Names of its addresses.
    """
    release = version.partition(".dev")[0]
    changelog = (root / "CHANGELOG.md").read_text(encoding="utf-8")
    _, heading, section = re.split(r"^## (.*)$", changelog, flags=re.MULTILINE)[:3]
    date = heading.removeprefix(f"[{release}] - ")
    provenance = (root / "scoring" / "PROVENANCE.md").read_bytes()
    digest = hashlib.sha256(provenance).hexdigest()
    citation = (root / "CITATION.cff").read_text(encoding="utf-8").splitlines()
    missing = ", ".join(name for name in ADDRESSES if name not in urls)
    is_done = {
        f"pyproject.toml: the version is {version}": version == release,
        f"CHANGELOG.md: [{release}] - DATE in place of {heading}": DATE.fullmatch(date),
        f"CHANGELOG.md: the SHA-256 of scoring/PROVENANCE.md, {digest}": digest
        in section,
        f"CITATION.cff: version: {release}": f"version: {release}" in citation,
        "CITATION.cff: date-released, as in CHANGELOG.md": f"date-released: {date}"
        in citation,
        f"pyproject.toml: [project.urls] lacks {missing}; README.md, docs/getting_started.md, packaging/hub/ and the "
        "badges of notebooks need the same address": not missing,
    }
    return [text for text, is_right in is_done.items() if not is_right]


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
    run(commands / "gauge", "demo", "--no-open", "--out", folder / "demo.html")
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    for code in re.findall(r"```python\n(.*?)```", readme, re.DOTALL):
        run(commands / "python", "-I", "-c", code)
    print(f"Python {version}: demo and README")
