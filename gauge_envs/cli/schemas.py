"""JSON Schemas of the output of commands with `--json`, derived from the types of the entry points `gauge_envs.lines`.

A type is a dataclass, a typed dictionary, or a union of them where a command prints lines of several kinds.
"""

from __future__ import annotations

import inspect
import re
import types
import typing
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields, is_dataclass
from enum import Enum
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any, Literal, TypeAlias, get_args, get_origin, get_type_hints

import numpy as np

from gauge_envs.cli.commands import LINES_GROUP, all_commands
from gauge_envs.errors import UnknownNameError
from gauge_envs.registry import installed_points

DIALECT = "https://json-schema.org/draft/2020-12/schema"

LINE = "One line of stdout, a JSON object; an empty output has no line."

NULLS = "null in place of a number: it is not known, does not apply, or is not finite."

RESULT_FILE = "result-file"
"""Name of the schema of the result files of `gauge run`."""

RESULT_FILE_VERSION = 7

PLAIN: Mapping[Any, Mapping[str, Any]] = {
    Any: {},
    object: {},
    None: {"type": "null"},
    type(None): {"type": "null"},
    bool: {"type": "boolean"},
    int: {"type": "integer"},
    str: {"type": "string"},
    Path: {"type": "string"},
    # JSON has no NaN and no infinity: `gauge_envs.files.json_ready` writes null.
    float: {"type": ["number", "null"]},
}
"""Schema of each type without parts."""

Schema: TypeAlias = dict[str, Any]


@dataclass(frozen=True, eq=False)
class Form:
    """Printed form of a dataclass, if it differs from all attributes: `Annotated[Report, Form(...)]`.

    Attributes:
        without: Omitted attributes.
        properties: Added properties of the class.
        more: Class whose keys are added, or None.
    """

    without: tuple[str, ...] = ()
    properties: tuple[str, ...] = ()
    more: Any = None


WHOLE = Form()
"""All attributes of a class."""


def schema_names() -> dict[str, int]:
    """Return the version of each schema by its name, in the order of `gauge --help`."""
    lines = _line_types()
    versions = {
        name: command.info.version
        for name, command in all_commands().items()
        if name in lines
    }
    return versions | {RESULT_FILE: RESULT_FILE_VERSION}


def _line_types() -> dict[str, EntryPoint]:
    """Return the entry points of the types of a line, by the name of the command."""
    return {point.name: point for point in installed_points(LINES_GROUP)}


def output_schema(name: str) -> Schema:
    """Return the JSON Schema of an output line of a command with `--json`, or of a result file.

    Args:
        name: Words of the command, as `backend check`; or `list KIND`, or `result-file`.

    Raises:
        UnknownNameError: There is no such schema.
    """
    versions = schema_names()
    if name not in versions:
        raise UnknownNameError("schema", name, versions)
    schema = schema_of(_line_types()[name].load())
    title, about = f"gauge {name} --json", [schema.pop("description", ""), LINE, NULLS]
    if name == RESULT_FILE:
        title = "Result file"
        about.remove(LINE)
    return {
        "$schema": DIALECT,
        "$id": f"urn:gauge-envs:{name.replace(' ', '-')}:{versions[name]}",
        "title": title,
        "description": " ".join(filter(None, about)),
        **schema,
    }


def schema_of(hint: Any) -> Schema:
    """Return the JSON Schema of a type.

    Raises:
        TypeError: The type has none.
    """
    if hint in PLAIN:
        return dict(PLAIN[hint])
    origin, parts = get_origin(hint), get_args(hint)
    if origin is typing.Annotated:
        plain_hint, form = _formed(hint)
        # Limits of pydantic do not change the keys.
        return schema_of(plain_hint) if form is WHOLE else _object(plain_hint, form)
    if origin is not None:
        return _of_parts(origin, parts)
    if isinstance(hint, type) and issubclass(hint, Enum):
        return {"enum": [member.value for member in hint]}
    if is_dataclass(hint) or typing.is_typeddict(hint) or hasattr(hint, "model_fields"):
        return _object(hint, WHOLE)
    raise TypeError(f"{hint}: a type that has no JSON Schema")


def _of_parts(origin: Any, parts: tuple[Any, ...]) -> Schema:
    """Return the schema of a type with parts, as `Mapping[str, float]`."""
    if origin in (typing.NotRequired, typing.Required):
        return schema_of(parts[0])
    if origin is Literal:
        return {"enum": list(parts)}
    if origin in (typing.Union, types.UnionType):
        return _any_of(map(schema_of, parts))
    # Newer versions of NumPy declare `NDArray` as an alias with a value.
    origin = get_origin(getattr(origin, "__value__", None)) or origin
    if origin is np.ndarray:
        return {"type": "array"}
    if origin is tuple and Ellipsis not in parts:
        count = {"minItems": len(parts), "maxItems": len(parts)}
        return {"type": "array", "prefixItems": [*map(schema_of, parts)]} | count
    if issubclass(origin, Mapping):
        return {"type": "object", "additionalProperties": schema_of(parts[1])}
    return {"type": "array", "items": schema_of(parts[0])}


def _object(cls: Any, form: Form) -> Schema:
    """Return the schema of a class, with descriptions from its docstring."""
    hints = get_type_hints(cls, include_extras=True)
    names = [*hints]
    if is_dataclass(cls):
        # A field outside of comparisons is not in a file.
        names = [field.name for field in fields(cls) if field.compare]
    described = descriptions(cls)
    properties: dict[str, Schema] = {}
    for name in names:
        if name not in form.without and not name.startswith(("_", "model_")):
            properties[name] = schema_of(hints[name])
    for name in (*form.properties, *getattr(cls, "PRINTED", ())):
        getter = getattr(cls, name).fget
        properties[name] = schema_of(get_type_hints(getter)["return"])
        described[name] = (inspect.getdoc(getter) or "").partition("\n")[0]
    for name in properties.keys() & described.keys():
        properties[name]["description"] = described[name]
    optional = getattr(cls, "__optional_keys__", ())
    required = [name for name in properties if name not in optional]
    if form.more is not None:
        more = _object(*_formed(form.more))
        properties |= more["properties"]
        required += more["required"]
    text = (inspect.getdoc(cls) or "").partition("\n\n")[0]
    return {
        "type": "object",
        "description": " ".join(text.split()),
        "properties": properties,
        "required": required,
        "additionalProperties": False,
    }


def _formed(hint: Any) -> tuple[Any, Form]:
    """Return a class and its printed form."""
    parts = get_args(hint) if get_origin(hint) is typing.Annotated else (hint,)
    return parts[0], next((part for part in parts if isinstance(part, Form)), WHOLE)


def _any_of(schemas: Iterable[Schema]) -> Schema:
    """Return the schema of a union; for types without parts, it is a list of names."""
    distinct: list[Schema] = []
    for schema in schemas:
        if schema not in distinct:
            distinct.append(schema)
    if any(set(schema) != {"type"} for schema in distinct):
        return {"anyOf": distinct}
    names: dict[str, None] = {}
    for schema in distinct:
        names |= dict.fromkeys(np.atleast_1d(schema["type"]).tolist())
    return {"type": list(names)}


def descriptions(cls: Any, section: str = "Attributes") -> dict[str, str]:
    """Return the descriptions of names in a section of the docstrings of a class and its bases.

    Args:
        cls: The class.
        section: Heading of the section.
    """
    described: dict[str, str] = {}
    for base in reversed(inspect.getmro(cls) if isinstance(cls, type) else (cls,)):
        text = inspect.cleandoc(base.__doc__ or "").partition(f"{section}:\n")[2]
        # An entry is `name: text`, or `name, name: text`; its further lines are indented.
        text = text.partition("\n\n")[0]
        for names, entry in re.findall(
            r"^    (\w+(?:, \w+)*): (.*(?:\n {8}.*)*)", text, re.M
        ):
            for name in names.split(", "):
                described[name] = " ".join(entry.split())
    return described
