"""Write `docs/llms.txt`: the pages of the documentation with their first sentences, for language models.

The format is that of https://llmstxt.org: a title, a summary, and lists of links.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from pathlib import Path

from scripts.generated import ROOT

DOCS = ROOT / "docs"
PAGE = DOCS / "llms.txt"
SKILL = ".agents/skills/gauge-envs/SKILL.md"

TREE = re.compile(r"```\{toctree\}\n:caption: (\w+)\n(.*?)```", re.DOTALL)
"""A part of the table of contents of `docs/index.md`, with its title."""

MARKS = re.compile(r"!?\[([^]]*)\]\([^)]*\)|[*`]")
"""Links, which leave their text, and marks of Markdown."""


def first_sentence(text: str) -> str:
    """Return the first sentence of the first paragraph."""
    words = next(
        plain
        for paragraph in text.split("\n\n")
        if (plain := " ".join(MARKS.sub(r"\1", paragraph).split()))
        and plain[0].isalnum()
    )
    return re.split(r"(?<=[a-z0-9)]\.) (?=[A-Z])", words)[0]


def links() -> Iterator[str]:
    """Yield the lines of the lists, in the order of the table of contents."""
    index = (DOCS / "index.md").read_text(encoding="utf-8")
    for caption, names in TREE.findall(index):
        pages = [
            _source(name)
            for name in names.split()
            if name[0].isalpha() and "*" not in name
        ]
        known = [page for page in pages if _is_page(page)]
        if known:
            yield f"\n## {caption}\n"
        for page in known:
            text = page.read_text(encoding="utf-8")
            title, _, below = text[text.index("# ") + 2 :].partition("\n")
            name = os.path.relpath(page, DOCS)
            yield f"- [{MARKS.sub('', title)}]({name}): {first_sentence(below)}"


def _source(name: str) -> Path:
    """Return the file of a page: the site copies the notes of studies, and a checkout may hold no copy."""
    if name == "studies/index":
        return ROOT / "studies" / "README.md"
    return DOCS / f"{name}.md"


def _is_page(page: Path) -> bool:
    """Return whether a file is a page of its own, and not one that shows another file."""
    return "{include}" not in page.read_text(encoding="utf-8")


def contents() -> dict[Path, str]:
    """Return the file."""
    index = (DOCS / "index.md").read_text(encoding="utf-8")
    lines = [
        "# gauge-envs\n",
        f"> {first_sentence(index.partition(chr(10))[2])}\n",
        f"How to check a simulator and mend a model with it: `{SKILL}` of the repository. Every command with `--json` "
        "prints an object a line, and `gauge show COMMAND --schema` its JSON Schema.",
        *links(),
    ]
    return {PAGE: "\n".join(lines) + "\n"}
