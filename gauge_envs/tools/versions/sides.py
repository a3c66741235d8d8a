"""The versions that a user names: `mujoco==3.3.0`, `mujoco`, `mujoco==4.0.0:jacobian=dense`, and ranges."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from gauge_envs.errors import ParameterError
from gauge_envs.tools.versions.environments import (
    made_environment,
    released_versions,
    version_key,
)
from gauge_envs.tools.versions.model import Side

FORM = re.compile(
    r"mujoco(==(?P<first>[\w.]+?)(\.\.(?P<last>[\w.]+))?)?(:(?P<set>.+))?"
)


def read_side(text: str, settings: dict[str, object] | None = None) -> tuple[Side, ...]:
    """Return the version that a text names, or both ends of a range.

    Args:
        text: As `mujoco==3.3.0`, `mujoco==3.1.0..4.0.0`, or `mujoco` for what is installed here.
        settings: Settings behind the colon, read by the caller.
    """
    found = FORM.fullmatch(text.partition(":")[0])
    if found is None:
        raise ParameterError(
            f"{text!r} is no version: expected mujoco==3.3.0, mujoco==3.1.0..4.0.0, or mujoco for what is installed "
            "here; settings may follow, as mujoco==4.0.0:jacobian=dense"
        )
    side = Side(title=text, settings=settings or {})
    if found["first"] is None:
        return (replace(side, python=sys.executable),)
    ends = [found["first"]] + ([found["last"]] if found["last"] else [])
    behind = text[len(found[0]) :]
    return tuple(
        replace(side, title=f"mujoco=={end}{behind}", requirement=f"mujoco=={end}")
        for end in ends
    )


def of_interpreter(python: Path) -> Side:
    """Return the version that an interpreter of the user has."""
    if not python.is_file():
        raise ParameterError(f"--python {python}: there is no such file")
    # An interpreter of a virtual environment is a link, which must not be resolved.
    return Side(title=str(python), python=str(python.absolute()), settings={})


def releases_between(
    first: Side, last: Side, say: Callable[[str], object]
) -> list[Side]:
    """Return the releases from one version to another, both with it, as the package index lists them.

    Raises:
        ReleaseError: The index gives no list.
    """
    environment = made_environment(first.requirement, say)
    ends = [version_key(side.requirement.partition("==")[2]) for side in (first, last)]
    if ends[0] >= ends[1]:
        raise ParameterError(f"{first.title}: the range ends before it begins")
    behind = first.title[len(first.requirement) :]
    found = []
    for version in released_versions("mujoco", environment):
        if ends[0] <= version_key(version) <= ends[1]:
            name = f"mujoco=={version}"
            found.append(replace(first, title=name + behind, requirement=name))
    return found
