"""Small faults of Python code: an operator, a boundary, a constant, a condition or a returned value changed."""

from __future__ import annotations

import ast
import copy
from collections.abc import Iterator
from dataclasses import dataclass

SWAPPED: dict[type[ast.AST], tuple[type[ast.AST], ...]] = {
    ast.Add: (ast.Sub,),
    ast.Sub: (ast.Add,),
    ast.Mult: (ast.Div,),
    ast.Div: (ast.Mult,),
    ast.FloorDiv: (ast.Div,),
    ast.Mod: (ast.Mult,),
    ast.Pow: (ast.Mult,),
    ast.BitAnd: (ast.BitOr,),
    ast.BitOr: (ast.BitAnd,),
    ast.And: (ast.Or,),
    ast.Or: (ast.And,),
    ast.Lt: (ast.LtE, ast.GtE),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
}
CALLS = {
    "min": "max",
    "max": "min",
    "minimum": "maximum",
    "maximum": "minimum",
    "any": "all",
    "all": "any",
    "argmin": "argmax",
    "argmax": "argmin",
    "sin": "cos",
    "cos": "sin",
}
# Two arguments whose order matters.
ORDERED = ("arctan2", "cross", "subtract")
# Fields of a node that say how it is written down, and statements that end in a message.
NOT_DRAWN_FIELDS = ("annotation", "returns", "decorator_list", "bases")
NOT_DRAWN = (ast.Raise, ast.Assert, ast.JoinedStr, ast.Import, ast.ImportFrom)
MESSAGES = ("warn", "Field", "Literal", "TypeVar", "cast")


@dataclass(frozen=True)
class Mutant:
    """A fault: bytes `start` to `end` of a file replaced by `text`."""

    path: str
    function: str
    line: int
    # Lines of the changed expression, and those of its statement.
    lines: range
    statement: range
    start: int
    end: int
    text: str
    written: str
    # Whether the line runs when the module is imported.
    at_import: bool
    occurrence: int = 0

    @property
    def name(self) -> str:
        """Return what does not change with the rest of the file."""
        return f"{self.path} {self.function} {self.written} -> {self.text} #{self.occurrence}"


def mutants(path: str, source: str) -> Iterator[Mutant]:
    """Yield all mutants of a file."""
    raw = source.encode()
    starts = [0]
    for line in raw.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    seen: dict[str, int] = {}
    for node, function, statement, at_import in _nodes(ast.parse(source), "", None):
        for target, changed in _changes(node):
            start = starts[target.lineno - 1] + target.col_offset
            end = starts[target.end_lineno - 1] + target.end_col_offset
            text = ast.unparse(changed)
            is_statement = isinstance(target, ast.stmt)
            written = " ".join(raw[start:end].decode().split())
            mutant = Mutant(
                path,
                function,
                target.lineno,
                range(target.lineno, target.end_lineno + 1),
                _lines(statement),
                start,
                end,
                text if is_statement else f"({text})",
                written,
                at_import,
            )
            count = seen[mutant.name] = seen.get(mutant.name, -1) + 1
            yield Mutant(**{**vars(mutant), "occurrence": count})


def _lines(statement: ast.stmt) -> range:
    """Return the lines of a statement without its body."""
    body = getattr(statement, "body", None)
    end = body[0].lineno if isinstance(body, list) else statement.end_lineno + 1
    return range(statement.lineno, max(end, statement.lineno + 1))


def _nodes(
    node: ast.AST, function: str, statement: ast.stmt | None, at_import: bool = True
) -> Iterator[tuple[ast.AST, str, ast.stmt | None, bool]]:
    if isinstance(node, ast.stmt):
        statement = node
    if isinstance(node, ast.FunctionDef | ast.ClassDef):
        function = f"{function}.{node.name}".lstrip(".")
    if statement is not None:
        yield node, function, statement, at_import
    for name, value in ast.iter_fields(node):
        if name in NOT_DRAWN_FIELDS:
            continue
        later = name == "body" and isinstance(node, ast.FunctionDef | ast.Lambda)
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST) and not _is_left_out(child):
                yield from _nodes(child, function, statement, at_import and not later)


def _is_left_out(node: ast.AST) -> bool:
    match node:
        case ast.Call(func=ast.Name(id=name) | ast.Attribute(attr=name)):
            return name in MESSAGES
        case ast.Subscript(value=ast.Name(id=name)):
            return name in MESSAGES
        case ast.Assign(targets=[ast.Name(id=name)]):
            return name.startswith("__")
        case ast.If(test=ast.Name(id="TYPE_CHECKING")):
            return True
        case _:
            return isinstance(node, NOT_DRAWN)


def _with(node: ast.AST, **fields: object) -> ast.AST:
    changed = copy.copy(node)
    for name, value in fields.items():
        setattr(changed, name, value)
    return changed


def _changes(node: ast.AST) -> Iterator[tuple[ast.AST, ast.AST]]:
    """Yield the part of a node that is replaced, and by what."""
    yield from _changed_operators(node)
    yield from _changed_statements(node)
    match node:
        case ast.Constant(value=bool(value)):
            yield node, ast.Constant(not value)
        case ast.Constant(value=int(value)):
            # Mostly a power or an index, which stays one.
            yield node, ast.Constant(value - 1 if value > 1 else value + 1)
        case ast.Constant(value=float(value)):
            yield node, ast.Constant(2 * value if value else 1.0)
        case ast.Call(func=ast.Name(id=name)):
            yield from _changed_calls(node, name, "id")
        case ast.Call(func=ast.Attribute(attr=name)):
            yield from _changed_calls(node, name, "attr")


def _changed_operators(node: ast.AST) -> Iterator[tuple[ast.AST, ast.AST]]:
    match node:
        case ast.BinOp() if _is_text_or_path(node):
            return
        case ast.BinOp(op=op) | ast.AugAssign(op=op) | ast.BoolOp(op=op):
            for other in SWAPPED.get(type(op), ()):
                yield node, _with(node, op=other())
        case ast.Compare(ops=[op]):
            for other in SWAPPED[type(op)]:
                yield node, _with(node, ops=[other()])
        case ast.UnaryOp(op=ast.Not() | ast.USub(), operand=operand):
            yield node, operand


def _changed_statements(node: ast.AST) -> Iterator[tuple[ast.AST, ast.AST]]:
    match node:
        case ast.If(test=test) | ast.While(test=test) | ast.IfExp(test=test):
            if not isinstance(test, ast.Compare | ast.UnaryOp):
                yield test, ast.UnaryOp(ast.Not(), test)
        case ast.Return(value=ast.AST() as value):
            if not isinstance(value, ast.Constant):
                yield node, ast.Return(ast.Constant(None))
        case ast.Expr(value=ast.Call() as call) if not _is_left_out(call):
            yield node, ast.Pass()


def _is_text_or_path(node: ast.BinOp) -> bool:
    """Return whether any change would fail at once: parts of a text, of a path or of a type."""
    for side in (node.left, node.right):
        match side:
            case ast.JoinedStr() | ast.Constant(value=str() | None):
                return True
            case ast.Name(id=name) | ast.Attribute(attr=name):
                words = name.lower().split("_")
                if name[0].isupper() and name != name.upper():
                    return True
                if {"path", "folder", "root", "out", "directory"} & set(words):
                    return True
    return False


def _changed_calls(
    node: ast.Call, name: str, field: str
) -> Iterator[tuple[ast.AST, ast.AST]]:
    if name in CALLS:
        yield node, _with(node, func=_with(node.func, **{field: CALLS[name]}))
    if name == "abs" and len(node.args) == 1:
        yield node, node.args[0]
    if name in ORDERED and len(node.args) == 2:
        yield node, _with(node, args=node.args[::-1])
