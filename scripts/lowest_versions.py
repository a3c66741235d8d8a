"""The lowest version of each dependency that pyproject.toml allows, as constraints for pip."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from packaging.requirements import Requirement

__all__ = ["constraints", "requirements"]

PYPROJECT = Path(__file__).parents[1] / "pyproject.toml"


def constraints(pyproject: Path, extras: Sequence[str] = ()) -> list[str]:
    """Return lines `name==version` for a project's direct dependencies, sorted.

    Args:
        pyproject: The project's `pyproject.toml`.
        extras: Extras whose dependencies belong to it.

    Raises:
        ValueError: A requirement has no lower bound.
    """
    project = tomllib.loads(pyproject.read_text(encoding="utf-8"))["project"]
    return sorted(
        {
            _lowest(requirement, pyproject)
            for requirement in requirements(project, extras)
        }
    )


def requirements(
    project: dict[str, Any], extras: Sequence[str]
) -> Iterator[Requirement]:
    """Yield what a project and its extras require; in place of the project itself, what its named extras do.

    Args:
        project: Table `project` of a `pyproject.toml`.
        extras: Names of the extras.
    """
    chosen = [
        project["dependencies"],
        *(project["optional-dependencies"][extra] for extra in extras),
    ]
    for text in (text for group in chosen for text in group):
        requirement = Requirement(text)
        if requirement.name == project["name"]:
            yield from requirements(
                {**project, "dependencies": []}, sorted(requirement.extras)
            )
        else:
            yield requirement


def _lowest(requirement: Requirement, pyproject: Path) -> str:
    for bound in requirement.specifier:
        if bound.operator == ">=":
            return f"{requirement.name}=={bound.version}"
    raise ValueError(
        f"{pyproject}: requirement '{requirement}' has no lower bound; write one as name>=version"
    )
