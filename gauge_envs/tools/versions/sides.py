"""The two sides of a comparison: releases, interpreters, engines with settings, and result files."""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence
from pathlib import Path

import mujoco

from gauge_envs.cli import arguments
from gauge_envs.errors import ParameterError
from gauge_envs.experiments.variants import variants
from gauge_envs.registry import engine_points
from gauge_envs.tools.versions.environments import (
    make_environment,
    released_versions,
    version_key,
)
from gauge_envs.tools.versions.schema import Side

RELEASES = re.compile(r"[\w-]+==(\d[\w.]*?)(?:\.\.(\d[\w.]*))?")

PACKAGES = {
    "mujoco": "mujoco",
    "newton": "newton",
    "genesis": "genesis-world",
    "rapier": "rapier3d",
    "physx": "sapien",
    "pybullet": "pybullet",
}
"""Package on the index of each engine whose releases are compared."""

FORMS = (
    "mujoco==3.3.0, mujoco==3.1.0..4.0.0, mujoco for what is installed here, another engine of this package or its "
    "release, a result file .json, or settings as iterations=4; settings may follow a side, as "
    "mujoco==4.0.0:jacobian=dense"
)


def read_sides(text: str) -> list[Side]:
    """Return the side that a text names, or both ends of a range of releases.

    Args:
        text: In one of `FORMS`.

    Raises:
        ParameterError: The text names no side.
    """
    if text.endswith(".json"):
        return [Side(title=text, file=text, settings={})]
    engines = [point.name for point in engine_points()]
    head, _, changes = text.partition(":")
    name = re.split("=+", head)[0]
    if "=" in head and "==" not in head and name.isidentifier() and name not in engines:
        # Settings alone belong to what is installed here.
        head, changes = "mujoco", text
    values = arguments.split_values(changes) if changes else []
    settings = arguments.parsed_settings(values) or {}
    if head in engines:
        python = sys.executable
        return [Side(title=text, engine=head, python=python, settings=settings)]
    release = RELEASES.fullmatch(head)
    engine = {PACKAGES[each]: each for each in PACKAGES}.get(name, name)
    if release is None or engine not in PACKAGES:
        raise ParameterError(
            f"{text!r} is no side: expected {FORMS}; engines: {', '.join(engines)}"
        )
    return [
        Side(
            title=f"{name}=={version}{text[len(head) :]}",
            requirement=f"{PACKAGES[engine]}=={version}",
            engine="" if engine == "mujoco" else engine,
            settings=settings,
        )
        for version in filter(None, release.groups())
    ]


def interpreter_side(python: Path) -> Side:
    """Return the version that an interpreter of the user has."""
    # The interpreter of a virtual environment is a link, which must not be resolved.
    return Side(title=str(python), python=str(python.absolute()), settings={})


def is_suite_id(subject: str) -> bool:
    """Return whether a subject is an id of this suite."""
    return any(subject in (variant.name, variant.id) for variant in variants())


def compares_motions(subject: str, sides: Sequence[Side]) -> bool:
    """Return whether whole motions of an experiment are compared: a side cannot compute a step of a MuJoCo model.

    Raises:
        ParameterError: One side needs whole motions, and the other side or the subject has none.
    """
    needs_motion = [
        side.title
        for side in sides
        if side.file
        or side.engine not in ("", "mujoco")
        or not all(hasattr(mujoco.MjOption, name) for name in side.settings)
    ]
    releases = [side.title for side in sides if not side.engine and not side.file]
    is_suite = is_suite_id(subject)
    if needs_motion and (releases or not is_suite):
        raise ParameterError(
            f"{subject} and {needs_motion[0]}: other engines, their settings and result files are compared with each "
            "other on an id of this suite; releases of MuJoCo are compared with each other and with mujoco, on its own "
            "options, as iterations=4"
        )
    if needs_motion or releases or not is_suite:
        return bool(needs_motion)
    from gauge_envs.experiments.resolve import load_experiment

    scene = load_experiment(subject).scene
    return bool(scene.deformables or scene.drivers)


def releases_between(sides: Sequence[Side]) -> list[Side]:
    """Return the releases from one version to another, both included, as the package index lists them.

    Raises:
        ParameterError: There are fewer than two.
        VersionsError: The index does not answer.
    """
    first, last = sides
    package, _, lowest = first.requirement.partition("==")
    highest = last.requirement.partition("==")[2]
    python = make_environment(first.requirement)
    versions = released_versions(package, python)
    settings = first.title[len(first.requirement) :]
    releases = [
        side
        for version in versions
        for side in read_sides(f"{package}=={version}{settings}")
        if version_key(lowest) <= version_key(version) <= version_key(highest)
    ]
    if len(releases) < 2:
        raise ParameterError(
            f"{first.title} to {last.title}: expected a range from an older to a newer release; the newest are "
            f"{', '.join(versions[-8:])}"
        )
    return releases
