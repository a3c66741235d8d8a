"""Evaluate expressions of Python source: names, attributes, arithmetic, literals, and known calls."""

from __future__ import annotations

import ast
import operator
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import PurePath
from typing import Any

from gauge_envs.tools.sanity.python_source.values import (
    BUILTINS,
    COMPARISONS,
    METHODS,
    OPERATORS,
    PLAIN,
    UNKNOWN,
    External,
    Function,
    Instance,
    Module,
    PythonClass,
    Unknown,
)

UNARY: Mapping[type[ast.unaryop], Callable[[Any], Any]] = {ast.Not: operator.not_, ast.USub: operator.neg}


@dataclass
class Frame:
    """Names of a call: its module, its local names, and the function."""

    module: Module
    names: dict[str, Any] = field(default_factory=dict)
    function: Function | None = None


class Expressions(ABC):
    """Evaluates expressions; a subclass knows modules, classes and calls."""

    @abstractmethod
    def module(self, name: str) -> Module | None:
        """Return a module by its dotted name; None when the package has none."""

    @abstractmethod
    def value(self, module: Module, name: str) -> Any:
        """Return the value of a name of a module; `UNKNOWN` when the module does not state it."""

    @abstractmethod
    def member(self, kind: PythonClass, name: str) -> Any:
        """Return a method or an attribute of a class or its bases; `UNKNOWN` when there is none."""

    @abstractmethod
    def bases(self, kind: PythonClass) -> list[PythonClass]:
        """Return a class and its bases in this package, the nearest first."""

    @abstractmethod
    def call(self, called: Any, args: list[Any], kwargs: dict[str, Any]) -> Any:
        """Return the value of a call; `UNKNOWN` when the function is not known."""

    def evaluate(self, node: ast.expr, frame: Frame | Module) -> Any:
        """Return the value of an expression in a module; `UNKNOWN` when it is not stated."""
        frame = Frame(frame) if isinstance(frame, Module) else frame
        try:
            return self._value_of(node, frame)
        except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError):
            return UNKNOWN

    def _value_of(self, node: ast.expr, frame: Frame) -> Any:
        reader = getattr(self, f"_{type(node).__name__.lower()}", None)
        return UNKNOWN if reader is None else reader(node, frame)

    def _constant(self, node: ast.Constant, _: Frame) -> Any:
        return node.value

    def _name(self, node: ast.Name, frame: Frame) -> Any:
        if node.id in frame.names:
            return frame.names[node.id]
        value = self.value(frame.module, node.id)
        return External(node.id) if value is UNKNOWN and node.id in BUILTINS else value

    def _attribute(self, node: ast.Attribute, frame: Frame) -> Any:
        return self._attribute_of(self.evaluate(node.value, frame), node.attr)

    def _binop(self, node: ast.BinOp, frame: Frame) -> Any:
        return _plain(OPERATORS[type(node.op)], self.evaluate(node.left, frame), self.evaluate(node.right, frame))

    def _unaryop(self, node: ast.UnaryOp, frame: Frame) -> Any:
        value = self.evaluate(node.operand, frame)
        if not isinstance(value, PLAIN):
            return UNKNOWN
        return UNARY[type(node.op)](value)

    def _compare(self, node: ast.Compare, frame: Frame) -> Any:
        if len(node.ops) > 1:
            return UNKNOWN
        left, right = self.evaluate(node.left, frame), self.evaluate(node.comparators[0], frame)
        return _plain(COMPARISONS[type(node.ops[0])], left, right)

    def _ifexp(self, node: ast.IfExp, frame: Frame) -> Any:
        test = self.evaluate(node.test, frame)
        return UNKNOWN if test is UNKNOWN else self.evaluate(node.body if test else node.orelse, frame)

    def _tuple(self, node: ast.Tuple, frame: Frame) -> Any:
        return tuple(self.evaluate(one, frame) for one in node.elts)

    def _list(self, node: ast.List, frame: Frame) -> Any:
        return [self.evaluate(one, frame) for one in node.elts]

    def _listcomp(self, node: ast.ListComp, frame: Frame) -> Any:
        """Return a list over known values, by one name and without conditions."""
        one = node.generators[0]
        values = self.evaluate(one.iter, frame)
        if len(node.generators) > 1 or one.ifs or not isinstance(one.target, ast.Name) or not isinstance(values, list):
            return UNKNOWN
        name = one.target.id
        return [self.evaluate(node.elt, Frame(frame.module, {**frame.names, name: value})) for value in values]

    def _dict(self, node: ast.Dict, frame: Frame) -> Any:
        keys = [None if one is None else self.evaluate(one, frame) for one in node.keys]
        values = [self.evaluate(one, frame) for one in node.values]
        return {key: value for key, value in zip(keys, values, strict=True) if isinstance(key, str | int | float)}

    def _subscript(self, node: ast.Subscript, frame: Frame) -> Any:
        return self.evaluate(node.value, frame)[self.evaluate(node.slice, frame)]

    def _joinedstr(self, node: ast.JoinedStr, frame: Frame) -> Any:
        parts = [self.evaluate(one.value, frame) if isinstance(one, ast.FormattedValue) else one for one in node.values]
        values = [part.value if isinstance(part, ast.Constant) else part for part in parts]
        return "".join(map(str, values)) if all(isinstance(one, PLAIN) for one in values) else UNKNOWN

    def _boolop(self, node: ast.BoolOp, frame: Frame) -> Any:
        stops = isinstance(node.op, ast.Or)
        value: Any = UNKNOWN
        for one in node.values:
            value = self.evaluate(one, frame)
            if value is UNKNOWN or bool(value) is stops:
                return value
        return value

    def _attribute_of(self, owner: Any, name: str) -> Any:
        if isinstance(owner, Module):
            return self.module(f"{owner.name}.{name}") or self.value(owner, name)
        if isinstance(owner, External):
            return External(f"{owner.name}.{name}")
        if isinstance(owner, PythonClass):
            return self.member(owner, name)
        if isinstance(owner, Instance):
            if name in owner.attributes:
                return owner.attributes[name]
            found = self.member(owner.kind, name) if isinstance(owner.kind, PythonClass) else UNKNOWN
            if not isinstance(found, Function):
                return found
            method = Function(found.module, found.node, found.owner, owner)
            is_property = any(ast.unparse(one) == "property" for one in found.node.decorator_list)
            return self.call(method, [], {}) if is_property else method
        if isinstance(owner, dict) and name in owner:
            return owner[name]
        if isinstance(owner, PurePath) and name in ("parent", "name", "stem"):
            return getattr(owner, name)
        if any(isinstance(owner, kind) and name in names for kind, names in METHODS.items()):
            method_of = getattr(owner, name)
            return lambda args, kwargs: method_of(*args, **kwargs)
        return UNKNOWN

    def _call(self, node: ast.Call, frame: Frame) -> Any:
        args = [self.evaluate(one, frame) for one in node.args if not isinstance(one, ast.Starred)]
        kwargs = {one.arg: self.evaluate(one.value, frame) for one in node.keywords if one.arg is not None}
        function = node.func
        if isinstance(function, ast.Attribute) and ast.unparse(function.value) == "super()":
            return self._called_super(function.attr, args, kwargs, frame)
        called = self.evaluate(function, frame)
        if isinstance(called, External) and called.name in BUILTINS:
            if any(isinstance(one, Unknown) for one in (*args, *kwargs.values())):
                return UNKNOWN
            return BUILTINS[called.name](*args, **kwargs)
        if isinstance(called, Function) and called.owner is not None and called.bound is None and args:
            called, args = Function(called.module, called.node, called.owner, args[0]), args[1:]
        return self.call(called, args, kwargs)

    def _called_super(self, name: str, args: list[Any], kwargs: dict[str, Any], frame: Frame) -> Any:
        function = frame.function
        if function is None or function.owner is None:
            return UNKNOWN
        for base in self.bases(function.owner)[1:]:
            found = self.member(base, name)
            if isinstance(found, Function):
                return self.call(Function(found.module, found.node, found.owner, function.bound), args, kwargs)
        return UNKNOWN


def _plain(function: Callable[[Any, Any], Any], left: Any, right: Any) -> Any:
    """Return the value of an operation on two known values; `UNKNOWN` otherwise."""
    return function(left, right) if isinstance(left, PLAIN) and isinstance(right, PLAIN) else UNKNOWN
