"""Rules for the task files of the package that no scene needs: order, names, materials and origins of numbers."""

import re
import tomllib
from typing import get_args

from gauge_envs.experiments.tables import Provenance
from gauge_envs.experiments.task_format import NOT_STATED, TaskSpec
from gauge_envs.experiments.task_reader import load_task

ORDER = list(TaskSpec.model_fields)


def faults_of(path):
    """What is wrong with a task file; an error of the package where it cannot be read or built."""
    spec, raw = load_task(path), tomllib.loads(path.read_text())
    return [
        *order_faults(path, spec, raw),
        *material_faults(spec),
        *provenance_faults(spec, raw),
    ]


def order_faults(path, spec, raw):
    if list(raw) != sorted(raw, key=ORDER.index):
        yield "the tables have another order than in docs/adding_an_experiment.md"
    if path.stem != re.sub(r"(?<!^)(?=[A-Z])", "_", spec.family).lower():
        yield "the file is not named after its family"


def material_faults(spec):
    """No table names a material or a subtask that is not defined."""
    materials, subtasks = {"all", *spec.materials}, {*spec.subtasks}
    for table in (spec, *spec.subtasks.values()):
        for name in {*table.frames, *table.initial} - materials:
            yield f"no material {name!r}"
    for body, tables in spec.constants.items():
        for constants in tables.values():
            for value in constants.values():
                named = set(value) if isinstance(value, dict) else set()
                yield from (
                    f"constants.{body}: no subtask {name!r}"
                    for name in named - subtasks
                )


def provenance_faults(spec, raw):
    """An entry of a known kind covers every number."""
    for key, origin in spec.provenance.items():
        if origin.partition(":")[0] not in get_args(Provenance):
            yield f"provenance.{key}: {origin!r} is of no known kind"
    stated = {key: raw[key] for key in raw if key not in ("provenance", "revision")}
    for key in number_keys(stated):
        if spec.provenance_of(key) == NOT_STATED:
            yield f"{key}: a number without an entry in [provenance]"


def number_keys(value, key=""):
    """Dotted keys of the numbers and lists of numbers of a table."""
    if isinstance(value, dict):
        for name, inner in value.items():
            yield from number_keys(inner, f"{key}.{name}" if key else name)
    elif isinstance(value, list) and any(isinstance(one, dict) for one in value):
        for index, inner in enumerate(value):
            yield from number_keys(inner, f"{key}.{index}")
    elif not isinstance(value, str | bool) and not (
        isinstance(value, list) and all(isinstance(one, str) for one in value)
    ):
        yield key
