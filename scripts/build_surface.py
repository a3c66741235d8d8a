"""Write `tests/public_surface.json`: every name that `docs/stability.md` promises to keep.

A test compares the file with the package, so that a change of a public name is a decision in a review.
"""

from __future__ import annotations

import hashlib
import inspect
import json
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import fields
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import gauge_envs
from gauge_envs import Score, beyond_variants, variants
from gauge_envs.backends import Backend, Simulation
from gauge_envs.cli import output
from gauge_envs.cli.app import load_command
from gauge_envs.cli.commands import PLUGINS_GROUP, commands
from gauge_envs.cli.schemas import output_schema, schema_names
from gauge_envs.experiments.task_format import TaskSpec
from gauge_envs.references.band import ARRAYS, MARKER_ARRAYS, BandFile
from gauge_envs.registry import ENGINES_GROUP
from gauge_envs.tools import control
from scripts.generated import ROOT

FILE = ROOT / "tests" / "public_surface.json"

FUNCTIONS = {
    "gymnasium.make": "gauge_envs.envs.env:GaugeEnv.__init__",
    "gymnasium.make_vec": "gauge_envs.envs.vector:GaugeVectorEnv.__init__",
    "ScoreEpisodes": "gauge_envs.envs.vector:ScoreEpisodes.__init__",
    "dm_env.load": "gauge_envs.envs.dm_env:load",
    "control.names": "gauge_envs.tools.control:names",
    "conformance.run_checks": "gauge_envs.tools.conformance:run_checks",
    "recipes.engine_settings": "gauge_envs.tools.recipes:engine_settings",
    "recipes.find_recipe": "gauge_envs.tools.recipes:find_recipe",
    "replay.read_log": "gauge_envs.tools.replay:read_log",
    "sanity.SanityWrapper": "gauge_envs.tools.sanity:SanityWrapper.__init__",
    "sanity.check": "gauge_envs.tools.sanity:check",
    "video.read_track": "gauge_envs.tools.video:read_track",
    "video.score_track": "gauge_envs.tools.video:score_track",
    "video.video_task": "gauge_envs.tools.video:video_task",
}
"""Functions that the guides call, outside `gauge_envs`."""


def contents() -> Mapping[Path, str]:
    """Return the file with its text."""
    return {FILE: json.dumps(surface(), indent=1, ensure_ascii=False) + "\n"}


def surface() -> dict[str, Any]:
    """Return the public names: environments, Python, engines, commands, exit codes, JSON, files, groups of plug-ins."""
    ids = [variant.id for variant in (*variants(), *beyond_variants())]
    return {
        "environments": ids + [f"GAUGE/{name}" for name in control.names()],
        "functions": {
            name: _signature(EntryPoint(name, place, "").load())
            for name, place in FUNCTIONS.items()
        },
        "gauge_envs": {
            name: _signature(getattr(gauge_envs, name)) for name in gauge_envs.__all__
        },
        "score": [field.name for field in fields(Score)],
        "engines": {
            contract.__name__: _members(contract) for contract in (Backend, Simulation)
        },
        "commands": {name: _options(name) for name in sorted(commands())},
        "exit codes": {
            name: code for name, code in vars(output).items() if name.startswith("EXIT")
        },
        "json": {
            name: f"version {version}, keys {_digest(_keys(output_schema(name)))}"
            for name, version in schema_names().items()
        },
        "result file": sorted(output_schema("result-file")["properties"]),
        "task file": sorted(set(_keys(TaskSpec.model_json_schema()))),
        "band file": sorted(set(_keys(BandFile.model_json_schema()))),
        "band arrays": [*ARRAYS, *MARKER_ARRAYS],
        "entry points": [ENGINES_GROUP, PLUGINS_GROUP],
    }


def _members(contract: type) -> dict[str, str]:
    """Return the public members of a class with their parameters."""
    names = {*vars(contract), *inspect.get_annotations(contract)}
    return {
        name: _signature(getattr(contract, name, None))
        for name in sorted(names)
        if not name.startswith("_")
    }


def _signature(value: Any) -> str:
    """Return the parameters of a function without types; `class` or `value` for anything else."""
    if inspect.isclass(value):
        return "class"
    if not (callable(value) and inspect.isroutine(inspect.unwrap(value))):
        return "value"
    parameters = inspect.signature(value).parameters.values()
    plain = [
        parameter.replace(annotation=inspect.Parameter.empty)
        for parameter in parameters
    ]
    # A default value without a name has an address of the memory.
    return re.sub(r" at 0x\w+", "", str(inspect.Signature(plain)))


def _digest(keys: Iterable[str]) -> str:
    """Return a short text that changes with the keys of a schema, whose version then increases."""
    return hashlib.sha256("\n".join(sorted(set(keys))).encode()).hexdigest()[:12]


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
