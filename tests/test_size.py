"""The size of the package and of the guides is a ratchet: a capability may add what it needs, and nothing else."""

from __future__ import annotations

import ast
import io
import tokenize
from collections.abc import Iterable
from pathlib import Path

from places import ROOT

PACKAGE = ROOT / "gauge_envs"
DOCS = ROOT / "docs"

MOST_LINES, MOST_CODE_LINES = 82_000, 53_000
"""Of the package with its instruments."""
MOST_CORE_LINES = 45_000
"""Of the package without `tools/`."""
MOST_WORDS, MOST_WORDS_OF_A_PAGE = 50_000, 3_000
"""Of the guides, without generated pages."""

GENERATED = {"api", "environments", "studies", "_build"}
NO_CODE = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENDMARKER,
}


def code_lines(text: str) -> int:
    """Lines that hold a token outside comments and docstrings."""
    documented: set[int] = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef | ast.If):
            for inner in node.body:
                match inner:
                    case ast.Expr(value=ast.Constant(value=str())):
                        documented.update(range(inner.lineno, (inner.end_lineno or inner.lineno) + 1))
    tokens = tokenize.generate_tokens(io.StringIO(text).readline)
    return len({token.start[0] for token in tokens if token.type not in NO_CODE} - documented)


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
