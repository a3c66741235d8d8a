"""Read values that a package states in its Python source, without running or importing it.

Packages of training environments write their settings in Python, and importing them needs their whole stack. Here the
syntax tree is evaluated: names, attributes, arithmetic, literals, and calls of the package's own functions and classes.
Of other packages, only the functions that the caller states are known. Everything else has the value `UNKNOWN`.
"""

import ast
from collections.abc import Callable, Iterator, Mapping
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path, PurePath
from typing import Any

from gauge_envs.errors import TargetError
from gauge_envs.files import MEGABYTE, read_regular
from gauge_envs.tools.sanity.python_source.values import (
    BUILTINS,
    COMPARISONS,
    METHODS,
    OPERATORS,
    PLAIN,
    UNARY,
    UNKNOWN,
    External,
    Frame,
    Function,
    Instance,
    Known,
    Module,
    PythonClass,
    Unknown,
)

MOST_STATEMENTS = 200_000
"""Most statements that are evaluated for one source."""

DEEPEST_CALL = 60
"""Deepest nesting of calls."""

MOST_BYTES = 4 * MEGABYTE
"""Largest size of a file of source."""


class _ReturnError(Exception):
    """Ends a function with its value."""


def package_folder(package: str, title: str, distribution: str) -> Path:
    """Return the folder of an installed package, without importing it.

    Args:
        package: Name of the package.
        title: Its name for people.
        distribution: Name under which it is installed.
    """
    spec = find_spec(package)
    if spec is None or not spec.submodule_search_locations:
        raise TargetError(
            f"{title} is not installed here: pip install --no-deps {distribution} is enough to read its tasks"
        )
    return Path(spec.submodule_search_locations[0])


def package_version(distribution: str) -> str:
    """Return the version of an installed package for people."""
    try:
        return version(distribution)
    except PackageNotFoundError:
        return "of an unknown version"


def source_tree(path: Path) -> ast.Module:
    """Return the syntax tree of a file of an installed package."""
    try:
        return ast.parse(_content(path))
    except (SyntaxError, ValueError) as error:
        raise _unreadable(path, error) from None


def _content(path: Path) -> bytes:
    try:
        return read_regular(path, MOST_BYTES)
    except OSError as error:
        raise _unreadable(path, error) from None


def _unreadable(path: Path, error: Exception) -> TargetError:
    return TargetError(f"{path}: cannot be read: {error}; reinstall its package")


class Source:
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
            package, *parts = name.split(".")
            base = self._folder.joinpath(*parts)
            files = (base.with_suffix(".py"), base / "__init__.py") if package == self._package else ()
            path = next((file for file in files if file.is_file()), None)
            self._modules[name] = None if path is None else Module(name=name, path=path, tree=source_tree(path))
        return self._modules[name]

    def modules(self, folder: str, text: str) -> Iterator[Module]:
        """Yield the modules below a folder of the package whose source holds a text."""
        for path in sorted((self._folder / folder).rglob("*.py")):
            if text.encode() in _content(path):
                parts = path.relative_to(self._folder).with_suffix("").parts
                module = self.module(".".join((self._package, *parts)).removesuffix(".__init__"))
                assert module is not None, "the file is there"
                yield module

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
        match node:
            case ast.FunctionDef() if node.name == name:
                return (Function(module, node),)
            case ast.ClassDef() if node.name == name:
                return (PythonClass(module, node),)
            case ast.Import():
                wholes = {one.asname or one.name.split(".")[0]: one for one in node.names}
                if name in wholes:
                    whole = wholes[name].name if wholes[name].asname else name
                    return (self.module(whole) or External(whole),)
            case ast.ImportFrom():
                return self._bound_from(module, node, name)
            case ast.Assign() | ast.AnnAssign(value=ast.expr()):
                targets = node.targets if isinstance(node, ast.Assign) else [node.target]
                if node.value is not None and any(isinstance(one, ast.Name) and one.id == name for one in targets):
                    return (self.evaluate(node.value, Frame(module)),)
        return None

    def _bound_from(self, module: Module, node: ast.ImportFrom, name: str) -> tuple[Any] | None:
        for one in node.names:
            if name == (one.asname or one.name):
                return (self._imported_from(module, node, one.name),)
            found = self._imported_from(module, node, name) if one.name == "*" else UNKNOWN
            if found is not UNKNOWN and not isinstance(found, External):
                return (found,)
        return None

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

    # --- expressions -------------------------------------------------------------------------------------------------

    def evaluate(self, node: ast.expr, frame: Frame | Module) -> Any:
        """Return the value of an expression in a module; `UNKNOWN` when it is not stated."""
        frame = Frame(frame) if isinstance(frame, Module) else frame
        try:
            reader = getattr(self, f"_{type(node).__name__.lower()}", None)
            return UNKNOWN if reader is None else reader(node, frame)
        except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError):
            return UNKNOWN

    def _constant(self, node: ast.Constant, _: Frame) -> Any:
        return node.value

    def _name(self, node: ast.Name, frame: Frame) -> Any:
        if node.id in frame.names:
            return frame.names[node.id]
        value = self.value(frame.module, node.id)
        return External(node.id) if value is UNKNOWN and node.id in BUILTINS else value

    def _attribute(self, node: ast.Attribute, frame: Frame) -> Any:
        return self.attribute(self.evaluate(node.value, frame), node.attr)

    def _binop(self, node: ast.BinOp, frame: Frame) -> Any:
        return _on_known(OPERATORS[type(node.op)], self.evaluate(node.left, frame), self.evaluate(node.right, frame))

    def _unaryop(self, node: ast.UnaryOp, frame: Frame) -> Any:
        value = self.evaluate(node.operand, frame)
        if not isinstance(value, PLAIN):
            return UNKNOWN
        return UNARY[type(node.op)](value)

    def _compare(self, node: ast.Compare, frame: Frame) -> Any:
        if len(node.ops) > 1:
            return UNKNOWN
        left, right = self.evaluate(node.left, frame), self.evaluate(node.comparators[0], frame)
        return _on_known(COMPARISONS[type(node.ops[0])], left, right)

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

    def _lambda(self, node: ast.Lambda, frame: Frame) -> Any:
        """Return a function whose arguments are not known."""
        return lambda *_: self.evaluate(node.body, frame)

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

    def attribute(self, owner: Any, name: str) -> Any:
        """Return an attribute of a value; of an object, also what a property returns."""
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


def _on_known(function: Callable[[Any, Any], Any], left: Any, right: Any) -> Any:
    """Return the value of an operation on two known values; `UNKNOWN` otherwise."""
    return function(left, right) if isinstance(left, PLAIN) and isinstance(right, PLAIN) else UNKNOWN
