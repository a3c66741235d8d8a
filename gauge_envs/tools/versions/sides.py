"""The sides that a user names: releases, settings, engines and result files."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import mujoco

from gauge_envs.errors import ParameterError
from gauge_envs.experiments.variants import find_variant, variants
from gauge_envs.registry import engine_points
from gauge_envs.tools.versions.environments import (
    ReleaseError,
    made_environment,
    made_requirements,
    released_versions,
    version_key,
)
from gauge_envs.tools.versions.model import Side

RELEASES = re.compile(r"mujoco==(?P<first>\d[\w.]*?)(\.\.(?P<last>\d[\w.]*))?")

FORMS = (
    "mujoco==3.3.0, mujoco==3.1.0..4.0.0, mujoco for what is installed here, another engine of this package, a result "
    "file .json, or settings as iterations=4; settings may follow a side, as mujoco==4.0.0:jacobian=dense"
)


def read_side(text: str, settings: dict[str, object] | None = None) -> tuple[Side, ...]:
    """Return the side that a text names, or both ends of a range of releases.

    Args:
        text: In one of `FORMS`.
        settings: Settings of it, read by the caller.
    """
    if text.endswith(".json"):
        return (Side(title=text, file=text, settings={}),)
    head, colon, behind = text.partition(":")
    side = Side(title=text, settings=settings or {})
    if found := RELEASES.fullmatch(head):
        return tuple(
            replace(
                side,
                title=f"mujoco=={end}{colon}{behind}",
                requirement=f"mujoco=={end}",
            )
            for end in (found["first"], found["last"])
            if end
        )
    engines = [point.name for point in engine_points()]
    name, equals, _ = head.partition("=")
    # Settings alone are those of what is installed here.
    is_setting = equals and name.isidentifier() and "==" not in head
    engine = "mujoco" if is_setting and name not in engines else head
    if engine not in engines:
        raise ParameterError(
            f"{text!r} is no side: expected {FORMS}; engines: {', '.join(engines)}"
        )
    return (replace(side, engine=engine, python=sys.executable),)


def are_motions(subject: str, sides: Sequence[Side]) -> bool:
    """Return whether whole motions of an experiment are compared: not all sides can compute a step of one MuJoCo model.

    Raises:
        ParameterError: Some sides are releases, and others can only be compared as motions.
    """
    reasons = []
    for side in sides:
        backend_settings = [
            name for name in side.settings if not hasattr(mujoco.MjOption, name)
        ]
        if side.file or side.engine not in ("", "mujoco") or backend_settings:
            reasons.append(side.title)
    releases = [side.title for side in sides if not side.engine and not side.file]
    if reasons and releases:
        raise ParameterError(
            f"{releases[0]} and {reasons[0]}: releases are compared with each other and with mujoco, on its own options"
        )
    if subject in {name for one in variants() for name in (one.name, one.id)}:
        from gauge_envs.experiments.resolve import load_experiment

        scene = load_experiment(find_variant(subject).id).scene
        return bool(reasons or (scene.deformables and not releases))
    if reasons:
        raise ParameterError(
            f"{subject} and {reasons[0]}: on a model, settings are options of MuJoCo, as iterations=4; other "
            "engines, their settings and result files are compared on an id of this suite"
        )
    return False


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

    Without the index they are those of the cache.

    Raises:
        ParameterError: There are fewer than two.
    """
    python = made_environment(first.requirement, say)
    ends = [version_key(side.requirement.partition("==")[2]) for side in (first, last)]
    if ends[0] >= ends[1]:
        raise ParameterError(
            f"{first.title} to {last.title}: a range goes from an older release to a newer one"
        )
    behind = first.title[len(first.requirement) :]
    found = []
    try:
        versions = released_versions("mujoco", python)
    except ReleaseError as error:
        made = [one.partition("==")[2] for one in made_requirements()]
        versions = sorted(made, key=version_key)
        say(f"{error}; releases in the cache: {', '.join(versions)}")
    for version in versions:
        if ends[0] <= version_key(version) <= ends[1]:
            name = f"mujoco=={version}"
            found.append(replace(first, title=name + behind, requirement=name))
    if len(found) < 2:
        known = ", ".join(versions[-8:])
        raise ParameterError(
            f"{first.title} to {last.title}: there are no two releases in this range; the newest are {known}"
        )
    return found
