"""Read values that a package states in its Python source, without running or importing it.

Packages of training environments write their settings in Python, and importing them needs their whole stack. Here the
syntax tree is evaluated: names, attributes, arithmetic, literals, and calls of the package's own functions and classes.
Of other packages, only the functions that the caller states are known. Everything else has the value `UNKNOWN`.
"""

from __future__ import annotations

import ast
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gauge_envs.errors import TargetError
from gauge_envs.files import MEGABYTE, read_regular
from gauge_envs.tools.sanity.python_source.expressions import Expressions, Frame
from gauge_envs.tools.sanity.python_source.values import (
    UNKNOWN,
    External,
    Function,
    Instance,
    Known,
    Module,
    PythonClass,
)

MOST_STATEMENTS = 200_000
"""Most statements that are evaluated for one source."""

DEEPEST_CALL = 60
"""Deepest nesting of calls."""


class _ReturnError(Exception):
    """Ends a function with its value."""


class Source(Expressions):
    """Source of a package whose values are read.

    Args:
        folder: Folder of the package.
        package: Its name.
        known: Meaning of functions of other packages, or of functions of this one, by dotted name.
    """

    def __init__(self, folder: Path, package: str, known: Mapping[str, Known] | None = None) -> None:
        self._folder, self._package, self._known = folder, package, dict(known or {})
        self._modules: dict[str, Module | None] = {}
        self._left, self._depth = MOST_STATEMENTS, 0

    # --- modules -----------------------------------------------------------------------------------------------------

    def module(self, name: str) -> Module | None:
        """Return a module by its dotted name; None when the package has none."""
        if name not in self._modules:
            parts = name.split(".")
            base = self._folder.joinpath(*parts[1:]) if parts[0] == self._package else None
            path = (
                None
                if base is None
                else next((p for p in (base.with_suffix(".py"), base / "__init__.py") if p.is_file()), None)
            )
            self._modules[name] = None if path is None else Module(name=name, path=path, tree=_tree(path))
        return self._modules[name]

    def value(self, module: Module, name: str) -> Any:
        """Return the value of a name of a module; `UNKNOWN` when the module does not state it."""
        if name == "__file__":
            return str(module.path)
        if name not in module.values:
            module.values[name] = UNKNOWN
            for node in module.tree.body:
                value = self._bound(module, node, name)
                if value is not None:
                    module.values[name] = value[0]
        return module.values[name]

    def _bound(self, module: Module, node: ast.stmt, name: str) -> tuple[Any] | None:
        """Return the value that a statement gives a name, in a tuple; None when it does not."""
        if isinstance(node, ast.FunctionDef) and node.name == name:
            return (Function(module, node),)
        if isinstance(node, ast.ClassDef) and node.name == name:
            return (PythonClass(module, node),)
        if isinstance(node, ast.Import):
            for one in node.names:
                if (one.asname or one.name.split(".")[0]) == name:
                    return (self._imported(one.name if one.asname else one.name.split(".")[0]),)
        if isinstance(node, ast.ImportFrom):
            for one in node.names:
                if (one.asname or one.name) == name:
                    return (self._imported_from(module, node, one.name),)
        targets = (
            node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
        )
        if any(isinstance(one, ast.Name) and one.id == name for one in targets):
            expression = node.value if isinstance(node, ast.Assign | ast.AnnAssign) else None
            return None if expression is None else (self.evaluate(expression, Frame(module)),)
        return None

    def _imported(self, name: str) -> Any:
        return self.module(name) or External(name)

    def _imported_from(self, module: Module, node: ast.ImportFrom, name: str) -> Any:
        start = node.module or ""
        if node.level:
            is_package = module.path.name == "__init__.py"
            above = module.name.split(".")[: None if node.level == 1 and is_package else -(node.level - is_package)]
            start = ".".join([*above, *([start] if start else [])])
        found = self.module(f"{start}.{name}")
        if found is not None:
            return found
        there = self.module(start)
        return External(f"{start}.{name}") if there is None else self.value(there, name)

    # --- classes -----------------------------------------------------------------------------------------------------

    def member(self, kind: PythonClass, name: str) -> Any:
        """Return a method or an attribute of a class or its bases; `UNKNOWN` when there is none."""
        for one in self.bases(kind):
            for node in one.node.body:
                if isinstance(node, ast.FunctionDef) and node.name == name:
                    return Function(one.module, node, owner=one)
                value = self._bound(one.module, node, name)
                if value is not None:
                    return value[0]
        return UNKNOWN

    def bases(self, kind: PythonClass) -> list[PythonClass]:
        """Return a class and its bases in this package, the nearest first."""
        line: list[PythonClass] = []
        queue = [kind]
        while queue and len(line) < DEEPEST_CALL:
            one = queue.pop(0)
            line.append(one)
            bases = [self.evaluate(base, Frame(one.module)) for base in one.node.bases]
            queue += [base for base in bases if isinstance(base, PythonClass)]
        return line

    def _instance(self, kind: PythonClass, args: list[Any], kwargs: dict[str, Any]) -> Any:
        made = Instance(kind)
        start = self.member(kind, "__init__")
        if isinstance(start, Function):
            self.call(Function(start.module, start.node, start.owner, made), args, kwargs)
            return made
        names = []
        for one in reversed(self.bases(kind)):
            for node in one.node.body:
                if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
                    names.append(node.target.id)
                    made.attributes[node.target.id] = self._field_default(one.module, node.value)
        made.attributes |= dict(zip(dict.fromkeys(names), args, strict=False)) | kwargs
        return made

    def _field_default(self, module: Module, node: ast.expr | None) -> Any:
        """Return the default of a field of a data class."""
        if not (isinstance(node, ast.Call) and ast.unparse(node.func).endswith("field")):
            return UNKNOWN if node is None else self.evaluate(node, Frame(module))
        given = {one.arg: one.value for one in node.keywords}
        if "default" in given:
            return self.evaluate(given["default"], Frame(module))
        factory = self.evaluate(given["default_factory"], Frame(module)) if "default_factory" in given else UNKNOWN
        return self.call(factory, [], {})

    # --- calls -------------------------------------------------------------------------------------------------------

    def call(self, called: Any, args: list[Any], kwargs: dict[str, Any]) -> Any:
        """Return the value of a call; `UNKNOWN` when the function is not known."""
        if isinstance(called, External | Function) and called.name in self._known:
            bound = [called.bound] if isinstance(called, Function) and called.bound is not None else []
            return self._known[called.name]([*bound, *args], kwargs)
        if isinstance(called, External) and called.name == "functools.partial" and args:
            return lambda more, named: self.call(args[0], [*args[1:], *more], {**kwargs, **named})
        if isinstance(called, PythonClass):
            return self._instance(called, args, kwargs)
        if isinstance(called, Function):
            return self._run(called, args, kwargs)
        if callable(called):
            return called(args, kwargs)
        return UNKNOWN

    def _run(self, function: Function, args: list[Any], kwargs: dict[str, Any]) -> Any:
        if self._depth >= DEEPEST_CALL:
            return UNKNOWN
        frame = Frame(function.module, function=function)
        spec = function.node.args
        names = [one.arg for one in (*spec.posonlyargs, *spec.args)]
        for one, default in zip(reversed(names), reversed(spec.defaults), strict=False):
            frame.names[one] = self.evaluate(default, Frame(function.module))
        for named, value in zip(spec.kwonlyargs, spec.kw_defaults, strict=True):
            frame.names[named.arg] = UNKNOWN if value is None else self.evaluate(value, Frame(function.module))
        is_static = any(ast.unparse(one) == "staticmethod" for one in function.node.decorator_list)
        given = [function.bound, *args] if function.bound is not None and not is_static else args
        frame.names |= dict(zip(names, given, strict=False)) | kwargs
        for one in names:
            frame.names.setdefault(one, UNKNOWN)
        self._depth += 1
        try:
            self._block(function.node.body, frame)
        except _ReturnError as done:
            return done.args[0]
        finally:
            self._depth -= 1
        return None

    # --- statements --------------------------------------------------------------------------------------------------

    def _block(self, body: list[ast.stmt], frame: Frame) -> None:
        for node in body:
            self._left -= 1
            if self._left < 0:
                raise TargetError(f"{frame.module.path}: its configuration takes more statements than are evaluated")
            self._statement(node, frame)

    def _statement(self, node: ast.stmt, frame: Frame) -> None:
        if isinstance(node, ast.Return):
            raise _ReturnError(None if node.value is None else self.evaluate(node.value, frame))
        if isinstance(node, ast.Assign):
            value = self.evaluate(node.value, frame)
            for target in node.targets:
                self._assign(target, value, frame)
        elif isinstance(node, ast.AnnAssign) and node.value is not None:
            self._assign(node.target, self.evaluate(node.value, frame), frame)
        elif isinstance(node, ast.Expr):
            self.evaluate(node.value, frame)
        elif isinstance(node, ast.If):
            test = self.evaluate(node.test, frame)
            if test is not UNKNOWN:
                self._block(node.body if test else node.orelse, frame)
        elif isinstance(node, ast.For):
            self._loop(node, frame)
        elif isinstance(node, ast.Import | ast.ImportFrom):
            self._import(node, frame)

    def _loop(self, node: ast.For, frame: Frame) -> None:
        """Evaluate a loop over known values that has no way out but its end."""
        values = self.evaluate(node.iter, frame)
        leaves = any(isinstance(one, ast.Break | ast.Continue) for one in ast.walk(node))
        if leaves or not isinstance(values, list | tuple | dict):
            return
        for value in list(values):
            self._assign(node.target, value, frame)
            self._block(node.body, frame)

    def _import(self, node: ast.Import | ast.ImportFrom, frame: Frame) -> None:
        for one in node.names:
            name = one.asname or one.name.split(".")[0]
            bound = self._bound(frame.module, node, name)
            frame.names[name] = UNKNOWN if bound is None else bound[0]

    def _assign(self, target: ast.expr, value: Any, frame: Frame) -> None:
        match target:
            case ast.Name():
                frame.names[target.id] = value
            case ast.Attribute():
                owner = self.evaluate(target.value, frame)
                if isinstance(owner, Instance):
                    owner.attributes[target.attr] = value
                elif isinstance(owner, dict):
                    owner[target.attr] = value
            case ast.Subscript():
                owner, key = self.evaluate(target.value, frame), self.evaluate(target.slice, frame)
                if isinstance(owner, dict) and isinstance(key, str | int):
                    owner[key] = value
            case ast.Tuple():
                values = value if isinstance(value, tuple | list) else [UNKNOWN] * len(target.elts)
                for one, part in zip(target.elts, values, strict=False):
                    self._assign(one, part, frame)


def _tree(path: Path) -> ast.Module:
    try:
        return ast.parse(read_regular(path, 4 * MEGABYTE))
    except (OSError, SyntaxError, ValueError) as error:
        raise TargetError(f"{path}: cannot be read: {error}; reinstall its package") from None
