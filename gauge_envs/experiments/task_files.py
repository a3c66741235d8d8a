"""Task files: reads and validates them.

Everything that differs between variants is data in `tasks/*.toml`; no Python file holds a number of any experiment.
"""

from __future__ import annotations

import hashlib
import tomllib
from collections.abc import Iterator, Sequence
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from gauge_envs.errors import TaskFileError, UnknownNameError, first_fault
from gauge_envs.experiments.tables import PROVENANCES
from gauge_envs.experiments.task_format import TaskSpec
from gauge_envs.experiments.variants import task_path
from gauge_envs.scene import Plane

__all__ = ["load_task", "task_file_error", "task_sha256", "task_spec"]


def load_task(path: Path) -> TaskSpec:
    """Read and validate one task file.

    Raises:
        TaskFileError: The file does not parse, has an unknown key, a value out of range, a name that nothing
            defines, or a number without provenance; the message names file, key and reason.
    """
    try:
        raw = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise TaskFileError(path, "(file)", str(error)) from error
    try:
        spec = TaskSpec.model_validate(raw)
    except ValidationError as error:
        raise task_file_error(path, error) from error
    _check_names(path, spec)
    _check_constants(path, spec)
    _check_provenance(path, spec, raw)
    return spec


def task_file_error(path: Path, error: ValidationError, prefix: str = "") -> TaskFileError:
    """Return the error of a task file for what pydantic found below a key."""
    key, reason = first_fault(error)
    return TaskFileError(path, ".".join(filter(None, (prefix, key))), reason)


def _check_names(path: Path, spec: TaskSpec) -> None:
    """Every name that the file uses is one that it defines."""

    def check(key: str, name: str, known: Sequence[str]) -> None:
        if not any(fnmatchcase(candidate, name) for candidate in known):
            raise TaskFileError(path, key, f"{name!r} is not defined; known: {', '.join(known)}")

    counted = [f"{n}-{i + 1}" for n, b in spec.bodies.items() if b.count for i in range(b.count)]
    names = [*spec.names, *counted]
    everywhere = ["all", *spec.materials]
    for key, table in [("frames", spec.frames)] + [
        (f"subtasks.{k}.frames", s.frames) for k, s in spec.subtasks.items()
    ]:
        for material in table:
            check(key, material, everywhere)
    for key, initial in [("initial", spec.initial)] + [
        (f"subtasks.{k}.initial", s.initial) for k, s in spec.subtasks.items()
    ]:
        for material, placements in initial.items():
            check(key, material, everywhere)
            for name in placements:
                check(f"{key}.{material}", name, spec.names)
    for k, subtask in spec.subtasks.items():
        for name in [*subtask.bodies, *subtask.motion]:
            check(f"subtasks.{k}", name, spec.names)
    for i, joint in enumerate(spec.joints):
        check(f"joints.{i}.body", joint.body, names)
    for i, attachment in enumerate(spec.attachments):
        check(f"attachments.{i}.deformable", attachment.deformable, names)
        check(f"attachments.{i}.to", attachment.to, names)
    contact_lists = [("contacts", spec.contacts)]
    driver_lists = [("drivers", spec.drivers)]
    for k, subtask in spec.subtasks.items():
        contact_lists.append((f"subtasks.{k}.contacts", subtask.contacts or ()))
        driver_lists.append((f"subtasks.{k}.drivers", subtask.drivers or ()))
    for key, contacts in contact_lists:
        for i, contact in enumerate(contacts):
            for name in [*contact.bodies, *([contact.constants_of] if contact.constants_of else [])]:
                check(f"{key}.{i}", name, names)
            given = contact.friction is not None and contact.restitution is not None
            if contact.constants_of is None and not given:
                raise TaskFileError(path, f"{key}.{i}", "give constants_of, or both friction and restitution")
    for key, drivers in driver_lists:
        for i, driver in enumerate(drivers):
            check(f"{key}.{i}.body", driver.body, list(spec.bodies))
            if isinstance(driver.provenance, dict) and set(driver.provenance) != set(spec.materials):
                raise TaskFileError(path, f"{key}.{i}.provenance", f"name each of {', '.join(spec.materials)} once")
    if spec.markers is not None:
        for name in spec.markers.bodies:
            check("markers.bodies", name, names)


def _check_constants(path: Path, spec: TaskSpec) -> None:
    """Every body has the constants of every material that a variant may ask for, each in range."""
    for name in spec.constants:
        if name not in spec.names:
            raise TaskFileError(path, f"constants.{name}", f"no body of that name; known: {', '.join(spec.names)}")
    for name in spec.names:
        if name in spec.bodies and isinstance(spec.bodies[name].shape, Plane):
            continue
        owner = spec.owner(name)
        needed = [owner.material] if owner.material else list(spec.materials)
        tables = spec.constants.get(name, {})
        for material in needed:
            if material not in tables:
                raise TaskFileError(path, f"constants.{name}.{material}", f"missing material {material!r}")
        for material, table in tables.items():
            for subtask in spec.subtasks or [None]:
                values = spec.constants_of(name, material, subtask)
                try:
                    spec.constants_model(name).model_validate(values)
                except ValidationError as error:
                    raise task_file_error(path, error, f"constants.{name}.{material}") from error
            for key, value in table.items():
                if isinstance(value, dict):
                    for subtask in value:
                        if subtask not in spec.subtasks:
                            raise TaskFileError(path, f"constants.{name}.{material}.{key}", f"no subtask {subtask!r}")


def _number_keys(value: Any, key: str = "") -> Iterator[str]:
    if isinstance(value, dict):
        for name, inner in value.items():
            yield from _number_keys(inner, f"{key}.{name}" if key else name)
    elif isinstance(value, list) and any(isinstance(entry, dict) for entry in value):
        for index, inner in enumerate(value):
            yield from _number_keys(inner, f"{key}.{index}")
    elif isinstance(value, list):
        if not all(isinstance(entry, str) for entry in value):
            yield key
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield key


def _check_provenance(path: Path, spec: TaskSpec, raw: dict[str, Any]) -> None:
    """Every number of the file is covered by a provenance entry of a known kind."""
    for key, provenance in spec.provenance.items():
        if provenance.split(":")[0] not in PROVENANCES:
            raise TaskFileError(
                path, f"provenance.{key}", f"{provenance!r} must start with one of {', '.join(PROVENANCES)}"
            )
    for key in _number_keys({k: v for k, v in raw.items() if k != "provenance"}):
        try:
            spec.provenance_of(key)
        except UnknownNameError as error:
            raise TaskFileError(path, key, "a number without an entry in [provenance]") from error


@cache
def task_sha256(family: str) -> str:
    """Hash of the task file of a family.

    Raises:
        UnknownNameError: No such family.
    """
    return hashlib.sha256(task_path(family).read_bytes()).hexdigest()


@cache
def task_spec(family: str) -> TaskSpec:
    """The validated task file of a family.

    Raises:
        UnknownNameError: No such family.
        TaskFileError: Its file is wrong.
    """
    return load_task(task_path(family))
