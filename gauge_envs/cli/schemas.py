"""JSON Schema of what commands print with `--json`: each follows from the type that `cli/commands.py` names.

A type is a dataclass, a typed dictionary, or a union of them where a command prints lines of several kinds.
"""

from __future__ import annotations

import inspect
import re
import types
import typing
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, fields, is_dataclass
from enum import Enum
from pathlib import Path
from typing import Any, Literal, TypeAlias, get_args, get_origin, get_type_hints

import numpy as np

from gauge_envs.cli.commands import Command, all_commands
from gauge_envs.errors import UnknownNameError

DIALECT = "https://json-schema.org/draft/2020-12/schema"

DESCRIPTION = (
    "One line of stdout, a JSON object; an empty output has no line. null in place of a number: it is not known, does "
    "not apply, or is not finite."
)

RESULT_FILE = Command(
    "result-file", "run.command:run", line="run.lines:ResultFile", version=7
)
"""What `gauge run` writes."""

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
    """How a dataclass is printed, where that is not as all of its attributes: in `Annotated[Report, Form(...)]`.

    Attributes:
        without: Attributes that are left out.
        properties: Properties of the class that are added.
        more: Class whose keys are added, or None.
    """

    without: tuple[str, ...] = ()
    properties: tuple[str, ...] = ()
    more: Any = None


WHOLE = Form()
"""All attributes of a class."""


def schema_names() -> dict[str, int]:
    """Return the version of each schema by its name, in the order of `gauge --help`."""
    return {name: one.version for name, one in _outputs().items()}


def _outputs() -> dict[str, Command]:
    """Return the commands that print JSON, and the command whose files are results."""
    found = {name: one for name, one in all_commands().items() if one.line}
    return found | {RESULT_FILE.name: RESULT_FILE}


def output_schema(name: str) -> Schema:
    """Return the JSON Schema of a line that a command prints with `--json`, or of a result file.

    Args:
        name: Words of the command, as `backend check`; or `list KIND`, or `result-file`.

    Raises:
        UnknownNameError: There is no such schema.
    """
    known = _outputs()
    if name not in known:
        raise UnknownNameError("schema", name, known)
    output = known[name]
    is_file = name == RESULT_FILE.name
    return {
        "$schema": DIALECT,
        "$id": f"urn:gauge-envs:{name.replace(' ', '-')}:{output.version}",
        "title": "Result file" if is_file else f"gauge {name} --json",
        "description": DESCRIPTION.partition(". ")[2] if is_file else DESCRIPTION,
    } | schema_of(output.line_type())


def schema_of(line: Any) -> Schema:
    """Return the JSON Schema of a type, with those of the classes in it below `$defs`."""
    walk = _Walk()
    whole = walk.schema(line)
    return whole | ({"$defs": walk.definitions} if walk.definitions else {})


class _Walk:
    """Schemas of a type and of all types in it."""

    def __init__(self) -> None:
        self.definitions: dict[str, Schema] = {}
        self._names: dict[Any, str] = {}

    def schema(self, hint: Any) -> Schema:
        """Return the schema of a type; that of a class is a reference."""
        if hint in PLAIN:
            return dict(PLAIN[hint])
        origin, parts = get_origin(hint), get_args(hint)
        if origin is typing.Annotated:
            one, form = _formed(hint)
            # Limits of pydantic say nothing of the keys.
            return self.schema(one) if form is WHOLE else self._reference(one, form)
        if origin is not None:
            return self._of_parts(origin, parts)
        if isinstance(hint, type) and issubclass(hint, Enum):
            return {"enum": [one.value for one in hint]}
        return self._reference(hint, WHOLE)

    def _of_parts(self, origin: Any, parts: tuple[Any, ...]) -> Schema:
        """Return the schema of a type with parts, as `Mapping[str, float]`."""
        if origin in (typing.NotRequired, typing.Required):
            return self.schema(parts[0])
        if origin is Literal:
            return {"enum": list(parts)}
        if origin in (typing.Union, types.UnionType):
            return _any_of(self.schema(part) for part in parts)
        if origin is np.ndarray:
            return {"type": "array"}
        if origin is tuple and Ellipsis not in parts:
            items = [self.schema(part) for part in parts]
            count = {"minItems": len(items), "maxItems": len(items)}
            return {"type": "array", "prefixItems": items} | count
        if issubclass(origin, Mapping):
            return {"type": "object", "additionalProperties": self.schema(parts[1])}
        if issubclass(origin, Iterable):
            return {"type": "array", "items": self.schema(parts[0])}
        raise TypeError(f"{origin}: a type that has no JSON Schema")

    def _reference(self, one: Any, form: Form) -> Schema:
        """Return a reference to the schema of a class, which is made at its first use."""
        if not (
            is_dataclass(one)
            or typing.is_typeddict(one)
            or hasattr(one, "model_fields")
        ):
            raise TypeError(f"{one}: a type that has no JSON Schema")
        key = (one, form)
        if key not in self._names:
            name, number = one.__name__, 2
            while name in self.definitions:
                name, number = f"{one.__name__}{number}", number + 1
            self._names[key] = name
            self.definitions[name] = {}
            self.definitions[name] = self._object(one, form)
        return {"$ref": f"#/$defs/{self._names[key]}"}

    def _object(self, one: Any, form: Form) -> Schema:
        hints = get_type_hints(one, include_extras=True)
        names = [field.name for field in fields(one)] if is_dataclass(one) else [*hints]
        described = _descriptions(one)
        properties: dict[str, Schema] = {}
        for name in names:
            if name not in form.without and not name.startswith(("_", "model_")):
                properties[name] = self.schema(hints[name])
        for name in (*form.properties, *getattr(one, "PRINTED", ())):
            getter = getattr(one, name).fget
            properties[name] = self.schema(get_type_hints(getter)["return"])
            described[name] = (inspect.getdoc(getter) or "").partition("\n")[0]
        optional: Collection[str] = getattr(one, "__optional_keys__", ())
        text = (inspect.getdoc(one) or "").partition("\n\n")[0]
        made: Schema = {
            "type": "object",
            "description": " ".join(text.split()),
            "properties": {
                name: schema
                | ({"description": described[name]} if name in described else {})
                for name, schema in properties.items()
            },
            "required": [name for name in properties if name not in optional],
            "additionalProperties": False,
        }
        if form.more is not None:
            more = self._object(*_formed(form.more))
            made["properties"] |= more["properties"]
            made["required"] += more["required"]
        return made


def _formed(hint: Any) -> tuple[Any, Form]:
    """Return a class, and how it is printed."""
    parts = get_args(hint) if get_origin(hint) is typing.Annotated else (hint,)
    return parts[0], next((one for one in parts if isinstance(one, Form)), WHOLE)


def _any_of(schemas: Iterable[Schema]) -> Schema:
    """Return the schema of a union; that of types without parts is a list of names."""
    found: list[Schema] = []
    for one in schemas:
        found += [one] if one not in found else []
    if all(set(one) == {"type"} for one in found):
        listed = [one["type"] for one in found]
        names = [n for one in listed for n in (one if isinstance(one, list) else [one])]
        return {"type": list(dict.fromkeys(names))}
    return {"anyOf": found}


def _descriptions(one: Any) -> dict[str, str]:
    """Return what the docstrings of a class and its bases say of each attribute."""
    found: dict[str, str] = {}
    for base in reversed(inspect.getmro(one) if isinstance(one, type) else (one,)):
        text = inspect.cleandoc(base.__doc__ or "").partition("Attributes:\n")[2]
        for entry in re.findall(r"^    (\w+(?:, \w+)*): (.*(?:\n {8}.*)*)", text, re.M):
            for name in entry[0].split(", "):
                found[name] = " ".join(entry[1].split())
    return found
