"""The size of the package and of the guides is a ratchet: a capability may add what it needs, and nothing else."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterable, Iterator
from pathlib import Path

from places import ROOT

PACKAGE = ROOT / "gauge_envs"
DOCS = ROOT / "docs"

MOST_LINES, MOST_CODE_LINES = 89_000, 57_409
"""Of the package with its instruments."""
MOST_CORE_LINES = 44_811
"""Of the package without `tools/`."""
MOST_WORDS, MOST_WORDS_OF_A_PAGE = 50_000, 3_000
"""Of the guides, without generated pages."""

GENERATED = {"api", "environments", "studies", "_build"}
STRING_OR_COMMENT = re.compile(r"""#.*|("{3}|'{3}|["'])(?:\\[\s\S]|(?!\1)[^\\])*\1""")


def statements(node: ast.AST) -> Iterator[ast.AST]:
    """A node and the statements in it, at any depth."""
    yield node
    for inner in ast.iter_child_nodes(node):
        if isinstance(inner, ast.stmt | ast.ExceptHandler | ast.match_case):
            yield from statements(inner)


def code_lines(text: str) -> int:
    """Lines on which a token outside comments and docstrings starts."""
    documented: set[int] = set()
    for node in statements(ast.parse(text)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef | ast.If):
            for inner in node.body:
                match inner:
                    case ast.Expr(value=ast.Constant(value=str())):
                        documented.update(range(inner.lineno, (inner.end_lineno or inner.lineno) + 1))
    code = STRING_OR_COMMENT.sub(lambda found: "" if found[0][0] == "#" else "s" + "\n" * found[0].count("\n"), text)
    return len({number for number, line in enumerate(code.split("\n"), 1) if line.strip()} - documented)


def words(pages: Iterable[Path]) -> int:
    return sum(len(page.read_text(encoding="utf-8").split()) for page in pages)


def texts(folder: Path) -> dict[Path, str]:
    return {file: file.read_text(encoding="utf-8") for file in folder.rglob("*.py")}


def test_code_lines_are_those_of_statements() -> None:
    text = '''"""Module."""

# comment
X = 1
"""X."""


def f() -> int:
    """F.

    More.
    """
    return (
        1
    )
'''
    assert code_lines(text) == 5


def test_the_package_does_not_grow() -> None:
    files = texts(PACKAGE)
    lines = {file: len(text.splitlines()) for file, text in files.items()}
    assert sum(lines.values()) <= MOST_LINES
    assert sum(map(code_lines, files.values())) <= MOST_CODE_LINES
    assert sum(count for file, count in lines.items() if "tools" not in file.parts) <= MOST_CORE_LINES


def test_the_guides_do_not_grow() -> None:
    pages = [page for page in DOCS.rglob("*.md") if not GENERATED & set(page.relative_to(DOCS).parts)]
    assert words(pages) <= MOST_WORDS
    assert {page.name: words([page]) for page in pages if words([page]) > MOST_WORDS_OF_A_PAGE} == {}
