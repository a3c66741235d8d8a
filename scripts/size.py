"""Print the size of each room in units that line breaks cannot change, and how dense its lines are.

python scripts/size.py            this checkout
python scripts/size.py FOLDER     another one

Python counts by tokens outside comments and docstrings, and TOML, JavaScript, CSS and HTML by words. Nothing tests the
numbers: a limit on lines makes lines denser.
"""

from __future__ import annotations

import ast
import io
import sys
import tokenize
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
FOLDERS = ("gauge_envs", "tests", "studies", "scripts", "benchmarks", "examples")
WORD_SUFFIXES = (".toml", ".js", ".css", ".html")
LAYOUT_TOKENS = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENDMARKER,
}
CORE_BACKENDS = ("mujoco", "shared")


@dataclass
class Room:
    """What was counted in the files of a room."""

    tokens: int = 0
    code_lines: int = 0
    lines: int = 0
    characters: int = 0
    comments: int = 0
    comprehensions: int = 0
    conditional_expressions: int = 0
    packed_assignments: int = 0

    def add(self, file: Path) -> None:
        """Count a file."""
        text = file.read_text(encoding="utf-8", errors="replace")
        if file.suffix == ".py":
            self._add_python(text)
        elif file.suffix in WORD_SUFFIXES and ".min." not in file.name:
            self.tokens += len(text.split())

    def _add_python(self, text: str) -> None:
        tree = ast.parse(text)
        documentation = set(_docstring_lines(tree))
        code_lines: set[int] = set()
        for token in tokenize.generate_tokens(io.StringIO(text).readline):
            if token.type == tokenize.COMMENT:
                self.comments += 1
            if token.type not in LAYOUT_TOKENS and token.start[0] not in documentation:
                self.tokens += 1
                code_lines.add(token.start[0])
        self.code_lines += len(code_lines)
        written = [line for line in text.splitlines() if line.strip()]
        self.lines += len(written)
        self.characters += sum(map(len, written))
        for node in ast.walk(tree):
            self.comprehensions += isinstance(
                node, ast.ListComp | ast.SetComp | ast.DictComp | ast.GeneratorExp
            )
            self.conditional_expressions += isinstance(node, ast.IfExp)
            is_packed = isinstance(node, ast.Assign) and isinstance(
                node.value, ast.Tuple
            )
            self.packed_assignments += is_packed and isinstance(
                node.targets[0], ast.Tuple
            )


def _docstring_lines(tree: ast.Module) -> Iterator[int]:
    """Yield the numbers of the lines of strings that are statements."""
    for node in ast.walk(tree):
        body = getattr(node, "body", [])
        for statement in body if isinstance(body, list) else []:
            match statement:
                case ast.Expr(value=ast.Constant(value=str())):
                    yield from range(statement.lineno, statement.end_lineno + 1)


def room_of(parts: tuple[str, ...]) -> str:
    """Return the name of the room of a file, from the parts of its path in the repository."""
    if parts[0] != "gauge_envs":
        return parts[0]
    depth = 3 if parts[1] in ("tools", "backends") and len(parts) > 3 else 2
    return "/".join(parts[: min(depth, len(parts) - 1)])


def rooms(root: Path) -> dict[str, Room]:
    """Return what was counted in each room of a checkout, the largest first."""
    found: dict[str, Room] = {}
    for folder in FOLDERS:
        for file in (root / folder).rglob("*"):
            if file.is_file() and "__pycache__" not in file.parts:
                found.setdefault(room_of(file.relative_to(root).parts), Room()).add(
                    file
                )
    return dict(sorted(found.items(), key=lambda entry: -entry[1].tokens))


def main(arguments: list[str]) -> None:
    """Print the table."""
    root = Path(arguments[0]) if arguments else ROOT
    found = rooms(root)
    print("  tokens  tokens/line  room")
    for name, room in found.items():
        density = (
            f"{room.tokens / room.code_lines:11.1f}" if room.code_lines else " " * 11
        )
        print(f"{room.tokens:8}  {density}  {name}")
    totals: Counter[str] = Counter()
    package = Room()
    for name, room in found.items():
        if name.startswith("gauge_envs"):
            totals[
                "tools"
                if "/tools" in name
                else "engines"
                if _is_guest_engine(name)
                else "core"
            ] += room.tokens
            for field in vars(room):
                setattr(package, field, getattr(package, field) + getattr(room, field))
    parts = ", ".join(f"{name} {count}" for name, count in totals.items())
    print(
        f"package {package.tokens}: {parts}; {package.tokens / package.code_lines:.1f} tokens on a line of code"
    )
    comments = _per(package.comments, package, 100)
    print(
        f"mean width of a line {package.characters / package.lines:.1f}; comments in 100 lines {comments}"
    )
    print(
        f"in 1,000 lines: comprehensions {_per(package.comprehensions, package, 1000)}, conditional expressions "
        f"{_per(package.conditional_expressions, package, 1000)}, packed assignments "
        f"{_per(package.packed_assignments, package, 1000)}"
    )


def _is_guest_engine(name: str) -> bool:
    return (
        name.startswith("gauge_envs/backends/")
        and name.rpartition("/")[2] not in CORE_BACKENDS
    )


def _per(count: int, room: Room, lines: int) -> str:
    return f"{lines * count / room.lines:.1f}"


if __name__ == "__main__":
    main(sys.argv[1:])
