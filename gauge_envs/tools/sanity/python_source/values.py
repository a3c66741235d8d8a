"""Define the values that are read from Python source, and the operations on them."""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from pathlib import Path, PurePath
from typing import Any, TypeAlias

Known: TypeAlias = Callable[[list[Any], dict[str, Any]], Any]
"""Meaning of a function: from positional and keyword arguments to its value."""


class Config(dict[str, Any]):
    """A dictionary whose keys are attributes too, as those of `ml_collections`."""

    def lock(self) -> Config:
        """Return the configuration itself; keys cannot be added to a locked one, which matters to writers only."""
        return self

    unlock = lock


OPERATORS: Mapping[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.FloorDiv: operator.floordiv,
    ast.Mod: operator.mod,
}

COMPARISONS: Mapping[type[ast.cmpop], Callable[[Any, Any], Any]] = {
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.In: lambda a, b: a in b,
    ast.NotIn: lambda a, b: a not in b,
    ast.Is: operator.is_,
    ast.IsNot: operator.is_not,
}

UNARY: Mapping[type[ast.unaryop], Callable[[Any], Any]] = {ast.Not: operator.not_, ast.USub: operator.neg}

PLAIN = (bool, int, float, str, bytes, list, tuple, dict, set, PurePath, type(None))
"""Types whose values are known as a whole."""

METHODS: Mapping[type, frozenset[str]] = {
    str: frozenset({"startswith", "endswith", "lower", "upper", "format", "join", "split", "strip"}),
    dict: frozenset({"get", "pop", "copy", "keys", "values", "items", "update"}),
    list: frozenset({"append", "extend", "copy"}),
    PurePath: frozenset({"as_posix"}),
    Config: frozenset({"lock", "unlock"}),
}
"""Methods without side effects outside of the value."""

MOST_NUMBERS = 1000
"""Most numbers of a range."""


def _numbers(*args: int) -> list[int]:
    """Return the numbers of `range`, the first `MOST_NUMBERS` of them."""
    return list(range(*args)[:MOST_NUMBERS])


BUILTINS: Mapping[str, Callable[..., Any]] = {
    "range": _numbers,
    "enumerate": lambda values: list(enumerate(values)),
    **{
        one.__name__: one
        for one in (str, int, float, bool, len, max, min, abs, round, tuple, list, dict, set, sorted, sum)
    },
}


class Unknown:
    """Value that the source does not state in a way that is evaluated."""

    def __repr__(self) -> str:
        """Return its name."""
        return "UNKNOWN"


UNKNOWN = Unknown()

DEEPEST_VALUE = 40
"""Deepest nesting of values that `plain` returns."""


@dataclass(frozen=True)
class External:
    """Name of another package, such as `functools.partial`."""

    name: str


@dataclass
class Module:
    """A module of the package.

    Attributes:
        name: Dotted name.
        path: Its file.
        tree: Its syntax tree.
        values: Values of its names that are known so far.
    """

    name: str
    path: Path
    tree: ast.Module
    values: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class PythonClass:
    """A class of the package."""

    module: Module
    node: ast.ClassDef


@dataclass(frozen=True)
class Function:
    """A function of the package; a method knows its class, and its object when it is bound."""

    module: Module
    node: ast.FunctionDef
    owner: PythonClass | None = None
    bound: Any = None

    @property
    def name(self) -> str:
        """Dotted name."""
        parts = [self.module.name, *([] if self.owner is None else [self.owner.node.name]), self.node.name]
        return ".".join(parts)


@dataclass
class Instance:
    """An object of a class of the package."""

    kind: PythonClass | External
    attributes: dict[str, Any] = field(default_factory=dict)


@dataclass
class Frame:
    """Names of a call: its module, its local names, and the function."""

    module: Module
    names: dict[str, Any] = field(default_factory=dict)
    function: Function | None = None


def plain(value: Any, depth: int = 0) -> Any:
    """Return a value of a source, or of an object in this process, in plain containers.

    Functions and classes become their names. What is not known, or has no plain form, becomes None.
    """
    if depth > DEEPEST_VALUE or value is None or isinstance(value, bool | int | float | str):
        return None if depth > DEEPEST_VALUE else value
    if isinstance(value, Function):
        return value.name
    if isinstance(value, PythonClass):
        return f"{value.module.name}.{value.node.name}"
    if isinstance(value, Instance):
        value = value.attributes
    elif is_dataclass(value) and not isinstance(value, type):
        value = {one.name: getattr(value, one.name, None) for one in fields(value)}
    elif hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {key: plain(one, depth + 1) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [plain(one, depth + 1) for one in value]
    if callable(value):
        return f"{getattr(value, '__module__', '')}.{getattr(value, '__qualname__', '')}"
    return value if isinstance(value, bool | int | float | str) else None


def source_path(args: list[Any], _: dict[str, Any]) -> Any:
    """Return the path of a text, as a known function of a source."""
    return Path(args[0]) if args and isinstance(args[0], str | Path) else UNKNOWN
