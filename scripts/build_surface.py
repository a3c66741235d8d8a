"""Write `tests/public_surface.json`: every name that `docs/stability.md` promises to keep.

A test compares the file with the package, so that a change of a public name is a decision in a review.
"""

from __future__ import annotations

import inspect
import json
from collections.abc import Iterator, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

from gauge_envs.cli.app import load_command
from gauge_envs.cli.commands import commands
from gauge_envs.cli.schemas import output_schema, schema_names
from gauge_envs.experiments.task_format import TaskSpec
from gauge_envs.references.band import BandFile
from scripts.generated import ROOT

FILE = ROOT / "tests" / "public_surface.json"

MODULES = (
    "gauge_envs",
    "gauge_envs.scene",
    "gauge_envs.backends",
    "gauge_envs.errors",
    "gauge_envs.tools.conformance",
    "gauge_envs.tools.sanity",
    "gauge_envs.tools.recipes",
    "gauge_envs.tools.video",
)
"""Modules of the API reference."""

CONTRACT = ("Backend", "Simulation")
"""Classes that the package of an engine derives from."""


def contents() -> Mapping[Path, str]:
    """Return the file with its text."""
    return {FILE: json.dumps(surface(), indent=1, ensure_ascii=False) + "\n"}


def surface() -> dict[str, Any]:
    """Return the public names: Python, commands, JSON keys, keys of files, and the contract of engines."""
    return {
        "python": {name: _public_names(name) for name in MODULES},
        "commands": {name: _options(name) for name in sorted(commands())},
        "json": {
            name: {
                "version": version,
                "keys": sorted(set(_keys(output_schema(name)))),
            }
            for name, version in schema_names().items()
        },
        "task file": sorted(set(_keys(TaskSpec.model_json_schema()))),
        "band file": sorted(set(_keys(BandFile.model_json_schema()))),
        "engine": {name: _signatures(name) for name in CONTRACT},
    }


def _public_names(module_name: str) -> dict[str, list[str]]:
    """Return the public names of a module, each with its public members if it is a class."""
    module = import_module(module_name)
    classes = [name for name, value in vars(module).items() if inspect.isclass(value)]
    # The module of errors exports its classes.
    names = getattr(module, "__all__", classes)
    return {name: _members(getattr(module, name)) for name in sorted(names)}


def _members(value: Any) -> list[str]:
    """Return the public members of a class that this package defines; none of another value."""
    if not inspect.isclass(value):
        return []
    members = set()
    for base in value.__mro__:
        if base.__module__.startswith("gauge_envs"):
            members |= {*vars(base), *getattr(base, "__annotations__", ())}
    return sorted(name for name in members if not name.startswith(("_", "model_")))


def _options(command_name: str) -> list[str]:
    """Return the arguments and options of a command."""
    spellings = []
    for parameter in load_command(command_name).params:
        is_option = parameter.param_type_name == "option"
        spellings += parameter.opts if is_option else [parameter.name.upper()]
        spellings += parameter.secondary_opts
    return sorted(spellings)


def _keys(schema: Any, prefix: str = "") -> Iterator[str]:
    """Yield the keys of a JSON Schema, those of nested objects as `outer.inner`; lists add no level."""
    definitions = schema.get("$defs", {})

    def below(part: Any, prefix: str, parents: tuple[str, ...]) -> Iterator[str]:
        if not isinstance(part, dict):
            return
        reference = part.get("$ref", "").rpartition("/")[2]
        if reference and reference not in parents:
            yield from below(definitions[reference], prefix, (*parents, reference))
        for name, inner in part.get("properties", {}).items():
            yield prefix + name
            yield from below(inner, f"{prefix}{name}.", parents)
        yield from below(part.get("items"), prefix, parents)
        yield from below(part.get("additionalProperties"), f"{prefix}*.", parents)
        for union in ("anyOf", "oneOf", "allOf", "prefixItems"):
            for alternative in part.get(union, ()):
                yield from below(alternative, prefix, parents)

    yield from below(schema, prefix, ())


def _signatures(class_name: str) -> dict[str, str]:
    """Return the signature of each public method of a class, without types."""
    cls = getattr(import_module("gauge_envs.backends"), class_name)
    signatures = {}
    for name, member in inspect.getmembers(cls):
        if name.startswith("_"):
            continue
        if not callable(member):
            signatures[name] = "attribute"
            continue
        parameters = inspect.signature(member).parameters.values()
        plain = [
            parameter.replace(annotation=inspect.Parameter.empty)
            for parameter in parameters
        ]
        signatures[name] = str(inspect.Signature(plain))
    return signatures
