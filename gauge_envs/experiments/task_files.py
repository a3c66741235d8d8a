"""Read and validate task files.

Everything that differs between variants is data in `tasks/*.toml`. No Python file holds a number of an experiment.
"""

import hashlib
from collections.abc import Iterator, Sequence
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from gauge_envs.errors import TaskFileError, UnknownNameError, first_fault
from gauge_envs.experiments.scene_builder import SceneBuilder
from gauge_envs.experiments.tables import PROVENANCES
from gauge_envs.experiments.task_format import ClothConstants, SubtaskSpec, TaskSpec
from gauge_envs.experiments.variants import (
    Variant,
    beyond_variants,
    task_path,
    unreadable_task_files,
    variants,
)
from gauge_envs.files import toml_document
from gauge_envs.scene import Plane
from gauge_envs.scene.fabrics import Fabric


def load_task(path: Path) -> TaskSpec:
    """Read and validate one task file.

    Raises:
        TaskFileError: The file is not TOML, or has an unknown key, a value out of range, an undefined name, a number
            without provenance, or a scene that cannot be built.
    """
    try:
        raw = toml_document(path.read_bytes())
    except OSError as error:
        raise TaskFileError(
            path, None, f"cannot be read: {error.strerror or error}"
        ) from error
    except ValueError as error:
        raise TaskFileError(path, None, str(error)) from error
    try:
        spec = TaskSpec.model_validate(raw)
    except ValidationError as error:
        raise task_file_error(path, error) from error
    _check_names(path, spec)
    _check_constants(path, spec)
    _check_provenance(path, spec, raw)
    _check_scenes(path, spec)
    return spec


def _check_scenes(path: Path, spec: TaskSpec) -> None:
    """Check that the scene of every variant can be built."""
    for subtask in spec.subtasks or [None]:
        for material in spec.materials:
            variant = Variant(spec.family, subtask, material)
            try:
                SceneBuilder(path, spec, variant, {}).build()
            except TaskFileError:
                raise
            except (ValueError, LookupError, StopIteration) as error:
                cause = (
                    f"no {error}"
                    if isinstance(error, KeyError)
                    else str(error) or type(error).__name__
                )
                raise TaskFileError(
                    path,
                    None,
                    f"the scene of {variant.name} cannot be built: {cause}",
                ) from error


def task_file_faults() -> dict[str, TaskFileError]:
    """Return the errors of all wrong task files, by family; by path for a file whose family cannot be read."""
    faults = {str(error.file): error for error in unreadable_task_files()}
    for family in dict.fromkeys(
        variant.family for variant in (*variants(), *beyond_variants())
    ):
        try:
            task_spec(family)
        except TaskFileError as error:
            faults[family] = error
    return faults


def task_file_error(
    path: Path, error: ValidationError, prefix: str = ""
) -> TaskFileError:
    """Return the error of a task file for what pydantic found below a key."""
    key, reason = first_fault(error)
    return TaskFileError(path, ".".join(filter(None, (prefix, key))), reason)


def _check_names(path: Path, spec: TaskSpec) -> None:
    """Check that the file defines every name that it uses."""
    for key, name, known in (*_names_of_tables(spec), *_names_of_parts(spec)):
        if not any(fnmatchcase(candidate, name) for candidate in known):
            raise TaskFileError(
                path, key, f"{name!r} is not defined; known: {', '.join(known)}"
            )
    for prefix, table in _tables(spec):
        for i, driver in enumerate(table.drivers or ()):
            if isinstance(driver.provenance, dict) and set(driver.provenance) != set(
                spec.materials
            ):
                raise TaskFileError(
                    path,
                    f"{prefix}drivers.{i}.provenance",
                    f"name each of {', '.join(spec.materials)} once",
                )


def _tables(spec: TaskSpec) -> list[tuple[str, TaskSpec | SubtaskSpec]]:
    """Return the file's own table and those of its subtasks, each with the prefix of its keys."""
    return [
        ("", spec),
        *((f"subtasks.{name}.", subtask) for name, subtask in spec.subtasks.items()),
    ]


UsedName = tuple[str, str, Sequence[str]]
"""Key that holds a name, the name, and the names that are defined for it."""


def _scene_names(spec: TaskSpec) -> list[str]:
    counted = [
        f"{n}-{i + 1}"
        for n, b in spec.bodies.items()
        if b.count
        for i in range(b.count)
    ]
    return [*spec.names, *counted]


def _names_of_tables(spec: TaskSpec) -> Iterator[UsedName]:
    """Yield the names that the file and its subtasks use in tables of the same form."""
    names, materials = _scene_names(spec), ["all", *spec.materials]
    for prefix, table in _tables(spec):
        yield from (
            (f"{prefix}frames", material, materials) for material in table.frames
        )
        for material, placements in table.initial.items():
            yield f"{prefix}initial", material, materials
            yield from (
                (f"{prefix}initial.{material}", name, spec.names) for name in placements
            )
        for i, contact in enumerate(table.contacts or ()):
            used = [*contact.bodies, *filter(None, [contact.constants_of])]
            yield from ((f"{prefix}contacts.{i}", name, names) for name in used)
        for i, driver in enumerate(table.drivers or ()):
            yield f"{prefix}drivers.{i}.body", driver.body, list(spec.bodies)


def _names_of_parts(spec: TaskSpec) -> Iterator[UsedName]:
    """Yield the names that subtasks, joints, attachments and markers use."""
    names = _scene_names(spec)
    for key, subtask in spec.subtasks.items():
        yield from (
            (f"subtasks.{key}", name, spec.names)
            for name in (*subtask.bodies, *subtask.motion)
        )
    for i, joint in enumerate(spec.joints):
        yield f"joints.{i}.body", joint.body, names
    for i, attachment in enumerate(spec.attachments):
        yield f"attachments.{i}.deformable", attachment.deformable, names
        yield f"attachments.{i}.to", attachment.to, names
    if spec.markers is not None:
        yield from (("markers.bodies", name, names) for name in spec.markers.bodies)


def _check_constants(path: Path, spec: TaskSpec) -> None:
    """Check that every body has the constants of every material that a variant may ask for, each in range."""
    for name in spec.constants:
        if name not in spec.names:
            raise TaskFileError(
                path,
                f"constants.{name}",
                f"no body of that name; known: {', '.join(spec.names)}",
            )
    for name in spec.names:
        if name in spec.bodies and isinstance(spec.bodies[name].shape, Plane):
            continue
        own_material = spec.owner(name).material
        tables = spec.constants.get(name, {})
        for material in [own_material] if own_material else spec.materials:
            if material not in tables:
                raise TaskFileError(
                    path,
                    f"constants.{name}.{material}",
                    f"missing material {material!r}",
                )
        for material in tables:
            _check_constants_of(path, spec, name, material)


def _check_constants_of(path: Path, spec: TaskSpec, name: str, material: str) -> None:
    for subtask in spec.subtasks or [None]:
        try:
            spec.constants_model(name).model_validate(
                spec.constants_of(name, material, subtask)
            )
        except ValidationError as error:
            raise task_file_error(
                path, error, f"constants.{name}.{material}"
            ) from error
    for key, value in spec.constants[name][material].items():
        unknown = (
            [subtask for subtask in value if subtask not in spec.subtasks]
            if isinstance(value, dict)
            else []
        )
        if unknown:
            raise TaskFileError(
                path, f"constants.{name}.{material}.{key}", f"no subtask {unknown[0]!r}"
            )


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
    """Check that a provenance entry of a known kind covers every number of the file."""
    for key, provenance in spec.provenance.items():
        if provenance.split(":")[0] not in PROVENANCES:
            raise TaskFileError(
                path,
                f"provenance.{key}",
                f"{provenance!r} must start with one of {', '.join(PROVENANCES)}",
            )
    for key in _number_keys(
        {k: v for k, v in raw.items() if k not in ("provenance", "revision")}
    ):
        try:
            spec.provenance_of(key)
        except UnknownNameError as error:
            raise TaskFileError(
                path, key, "a number without an entry in [provenance]"
            ) from error


@cache
def task_sha256(family: str) -> str:
    """Return the hash of the task file of a family."""
    return hashlib.sha256(task_path(family).read_bytes()).hexdigest()


@cache
def task_spec(family: str) -> TaskSpec:
    """Return the validated task file of a family."""
    return load_task(task_path(family))


# --- fabrics ----------------------------------------------------------------------------------------------------------


def fabrics(family: str) -> dict[str, Fabric]:
    """Return the calibrated fabrics of a family, by name."""
    spec = task_spec(family)
    return {
        material: Fabric.of(
            ClothConstants.model_validate(spec.constants_of(cloth, material, None))
        )
        for cloth in spec.cloths
        for material in spec.constants[cloth]
    }
