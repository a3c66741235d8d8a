"""Write `tests/public_surface.json`: every name that `docs/stability.md` promises to keep.

A test compares the file with the package, so that a change of a public name is a decision in a review.
"""

from __future__ import annotations

import inspect
import json
import re
from collections.abc import Iterator, Mapping
from importlib import import_module
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

from gauge_envs import beyond_variants, variants
from gauge_envs.cli import output
from gauge_envs.cli.app import load_command
from gauge_envs.cli.commands import COMMANDS_GROUP, LINES_GROUP, commands
from gauge_envs.cli.schemas import output_schema, schema_names
from gauge_envs.experiments.task_format import TaskSpec
from gauge_envs.references.band import ARRAYS, MARKER_ARRAYS, BandFile
from gauge_envs.registry import ENGINES_GROUP
from gauge_envs.tools import control
from scripts.generated import ROOT

FILE = ROOT / "tests" / "public_surface.json"

GUIDES = {
    "gymnasium.make": "gauge_envs.envs.arguments:EnvArguments.__init__",
    "gymnasium.make_vec": "gauge_envs.envs.vector:GaugeVectorEnv.__init__",
    "scored_vector_env": "gauge_envs.envs.vector:scored_vector_env",
    "ScoreEpisodes": "gauge_envs.envs.vector:ScoreEpisodes.__init__",
    "dm_env": "gauge_envs.envs.dm_env:load",
    "read_log": "gauge_envs.tools.replay:read_log",
}
"""Functions of the guides that are not on an API page; `GaugeEnv` there has the other options of `gymnasium.make`."""


def contents() -> Mapping[Path, str]:
    """Return the file with its text."""
    return {FILE: json.dumps(surface(), indent=1, ensure_ascii=False) + "\n"}


def surface() -> dict[str, Any]:
    """Return the public names: environments, Python, commands, exit codes, JSON, files, and groups of plug-ins."""
    ids = [variant.id for variant in (*variants(), *beyond_variants())]
    return {
        "environments": ids + [f"GAUGE/{name}" for name in control.names()],
        "guides": {
            name: _signature(EntryPoint(name, place, "").load())
            for name, place in GUIDES.items()
        },
        "python": {name: _public_names(name) for name in _modules()},
        "commands": {name: _options(name) for name in sorted(commands())},
        "exit codes": {
            name: code for name, code in vars(output).items() if name.startswith("EXIT")
        },
        "json": {
            name: {
                "version": version,
                "keys": sorted(set(_keys(output_schema(name)))),
            }
            for name, version in schema_names().items()
        },
        "task file": sorted(set(_keys(TaskSpec.model_json_schema()))),
        "band file": sorted(set(_keys(BandFile.model_json_schema()))),
        "band arrays": [*ARRAYS, *MARKER_ARRAYS],
        "entry points": [ENGINES_GROUP, COMMANDS_GROUP, LINES_GROUP],
    }


def _modules() -> list[str]:
    """Return the modules of the API reference, without those of task files, whose keys are stored."""
    pages = (ROOT / "docs" / "api").glob("*.md")
    texts = [page.read_text("utf-8") for page in pages if page.stem != "task_format"]
    return sorted(re.findall(r"automodule:: (\S+)", "".join(texts)))


def _public_names(module_name: str) -> dict[str, Any]:
    """Return the public names of a module with their descriptions."""
    module = import_module(module_name)
    # The module of errors exports its classes.
    classes = [
        name
        for name, value in vars(module).items()
        if inspect.isclass(value) and value.__module__ == module_name
    ]
    names = getattr(module, "__all__", classes)
    return {name: _described(getattr(module, name)) for name in sorted(names)}


def _described(value: Any) -> Any:
    """Return the signature of a function, the public members of a class with theirs, or `value`."""
    if not inspect.isclass(value):
        return _signature(value)
    names = set()
    for base in value.__mro__:
        if base.__module__.startswith("gauge_envs"):
            names |= {*vars(base), *inspect.get_annotations(base)}
    return {
        name: _signature(getattr(value, name, None))
        for name in sorted(names)
        if name == "__init__" or not name.startswith(("_", "model_"))
    }


def _signature(value: Any) -> str:
    """Return the parameters of a function without types; `value` for anything else."""
    if not (callable(value) and inspect.isroutine(inspect.unwrap(value))):
        return "value"
    parameters = inspect.signature(value).parameters.values()
    plain = [
        parameter.replace(annotation=inspect.Parameter.empty)
        for parameter in parameters
    ]
    # A default value without a name has an address of the memory.
    return re.sub(r" at 0x\w+", "", str(inspect.Signature(plain)))


def _options(command_name: str) -> list[str]:
    """Return the arguments and options of a command."""
    spellings = []
    for parameter in load_command(command_name).params:
        is_option = parameter.param_type_name == "option"
        spellings += parameter.opts if is_option else [parameter.name.upper()]
        spellings += parameter.secondary_opts
    return sorted(spellings)


def _keys(schema: Any, prefix: str = "") -> Iterator[str]:
    """Yield the keys of a JSON Schema, those of nested objects as `outer.inner`, and listed values as `key = value`."""
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
        for value in part.get("enum", ()):
            yield f"{prefix.removesuffix('.')} = {value}"
        yield from below(part.get("items"), prefix, parents)
        yield from below(part.get("additionalProperties"), f"{prefix}*.", parents)
        for union in ("anyOf", "oneOf", "allOf", "prefixItems"):
            for alternative in part.get(union, ()):
                yield from below(alternative, prefix, parents)

    yield from below(schema, prefix, ())
