"""Write `newest_versions.txt`: the newest version of each dependency with which the tests have passed.

python -m scripts versions    after the tests have passed, in the environment that ran them

It is a file of constraints for pip: `pip install -c scripts/newest_versions.txt -e ".[dev]"` installs what was tested.
A dependency that is not installed keeps its line.
"""

from __future__ import annotations

import tomllib
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from scripts.lowest_versions import PYPROJECT, requirements

FILE = Path(__file__).with_suffix(".txt")


def newest() -> dict[str, str]:
    """Return the versions in the file by name of the dependency."""
    lines = FILE.read_text(encoding="utf-8").splitlines() if FILE.is_file() else []
    return dict(line.split("==") for line in lines)


def main() -> None:
    """Write the versions of all dependencies that are installed, and keep those of the others."""
    project = tomllib.loads(PYPROJECT.read_text(encoding="utf-8"))["project"]
    found = newest()
    for requirement in requirements(project, sorted(project["optional-dependencies"])):
        try:
            installed = version(requirement.name)
        except PackageNotFoundError:
            continue
        # A build for one kind of device, as 2.13.0+cpu, is the same version.
        found[requirement.name] = installed.partition("+")[0]
    FILE.write_text(
        "".join(f"{name}=={found[name]}\n" for name in sorted(found)), encoding="utf-8"
    )
