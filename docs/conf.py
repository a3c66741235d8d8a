"""Configuration of the documentation site: Sphinx, MyST Markdown, Furo."""

from __future__ import annotations

import inspect
import re
import shutil
from importlib.metadata import version as installed_version
from pathlib import Path
from typing import Any

from pydantic import BaseModel
from sphinx.application import Sphinx

project = "gauge-envs"
author = "the gauge-envs authors"
copyright = "the gauge-envs authors; Apache-2.0"
version = release = installed_version("gauge-envs")

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
exclude_patterns = ["_build"]
html_theme = "furo"
html_title = "gauge-envs"
html_show_sphinx = False
html_static_path = ["_static"]

myst_enable_extensions = ["deflist"]
myst_heading_anchors = 4
# Shell and output blocks may hold text that is no program.
highlight_language = "none"

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_default_options = {"members": True}
autodoc_preserve_defaults = True
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True
napoleon_use_rtype = False

# Docstrings write code in single backticks, as Markdown does.
default_role = "code"

# Classes of several modules share a name, and a generated page has its sections below those of the page.
suppress_warnings = ["ref.python", "myst.header"]

PAGES_OF_FILES = {
    "../scoring/README.md": "formulas.md",
    "../assets/README.md": "assets.md",
    "../CONTRIBUTING.md": "contributing.md",
    "../CHANGELOG.md": "changelog.md",
}
"""Files outside `docs/` that the site shows as pages of its own, with the page that includes each."""


NOTES = re.compile(r"\[([^\]]+)\]\((?:\.\./)*examples/(?:\w+/)?README\.md\)")
"""Links to notes beside code, which have no page in the site: their text stays."""

STUDIES = Path(__file__).parents[1] / "studies"
"""Notes that the site shows as pages: copied to `docs/studies/` before each build, as they link to each other."""


def copy_studies(app: Sphinx) -> None:
    """Write a page for the note of each study, with the links that it has in the site."""
    pages = Path(app.srcdir) / "studies"
    shutil.rmtree(pages, ignore_errors=True)
    pages.mkdir()
    for note in STUDIES.rglob("README.md"):
        name = "index" if note.parent == STUDIES else note.parent.name
        text = re.sub(
            r"\]\((?:\.\./)?(\w+)/README\.md",
            r"](\1.md",
            note.read_text(encoding="utf-8"),
        )
        text = re.sub(r"\]\((?:\.\./)+docs/", "](../", text)
        folder = f"../../{note.parent.relative_to(STUDIES.parent)}"
        text = re.sub(
            r"\]\(((?:\.\./)?[\w/-]+\.(?:png|gif|py))\)",
            rf"]({folder}/\1)",
            text.replace("](../README.md", "](index.md"),
        )
        (pages / f"{name}.md").write_text(text, encoding="utf-8")


def link_pages(app: Sphinx, page: str, source: list[str]) -> None:
    """Point links to a file outside `docs/` to the page that shows it; in the repository they lead to the file."""
    text = re.sub(
        r"\]\(((?:\.\./)*)\.\./studies/README\.md", r"](\1studies/index.md", source[0]
    )
    source[0] = re.sub(
        r"\]\(((?:\.\./)*)\.\./studies/(\w+)/README\.md", r"](\1studies/\2.md", text
    )
    for file, target in PAGES_OF_FILES.items():
        depth = "../" * page.count("/")
        source[0] = source[0].replace(f"]({depth}{file}", f"]({depth}{target}")
    source[0] = NOTES.sub(r"\1", source[0])


def link_included(app: Sphinx, file: Path, page: str, content: list[str]) -> None:
    """Point the links of an included file, whose own folder is the checkout, to the pages of studies."""
    text = content[0].replace("](../studies/README.md", "](../docs/studies/index.md")
    text = text.replace("](studies/README.md", "](docs/studies/index.md")
    text = re.sub(
        r"\]\((\.\./)?studies/(\w+)/README\.md", r"](\1docs/studies/\2.md", text
    )
    content[0] = NOTES.sub(r"\1", text)


def list_table(rows: list[str], indent: str) -> list[str]:
    """Turn the lines of a Markdown table into a reStructuredText list table."""
    cells = [
        [cell.strip() for cell in row.strip().strip("|").split("|")] for row in rows
    ]
    lines = [f"{indent}.. list-table::", f"{indent}   :header-rows: 1", ""]
    for row in [cells[0], *cells[2:]]:
        lines += [
            f"{indent}   {'* -' if number == 0 else '  -'} {cell}"
            for number, cell in enumerate(row)
        ]
    return ["", *lines, ""]


def escape_bars(line: str) -> str:
    """Escape the bars of `|x|` outside code, which reStructuredText takes for substitutions."""
    parts = line.split("`")
    return "`".join(
        part if number % 2 else part.replace("|", r"\|")
        for number, part in enumerate(parts)
    )


def read_markdown(
    app: Sphinx, what: str, name: str, described: Any, options: Any, lines: list[str]
) -> None:
    """Rewrite the Markdown of a docstring, in place, for reStructuredText: tables, bars and indented code."""
    if what in ("attribute", "property") and lines:
        # Napoleon takes what is before a colon for the type.
        lines[0] = re.sub(r"^(`[^`]+`): ", r"\1 - ", lines[0])
    result: list[str] = []
    table: list[str] = []
    for number, line in enumerate([*lines, ""]):
        if line.lstrip().startswith("| ") or re.match(r"\s*\|-", line):
            table.append(line)
            continue
        if table:
            result += list_table(table, " " * (len(table[0]) - len(table[0].lstrip())))
            table = []
        after = lines[number + 1 : number + 3]
        starts_code = (
            line.endswith(":")
            and len(after) == 2
            and not after[0]
            and after[1].startswith("    ")
        )
        result.append(escape_bars(line) + (":" if starts_code else ""))
    lines[:] = result


def escape_patterns(
    app: Sphinx, what: str, name: str, described: Any, options: Any, lines: list[str]
) -> None:
    """Escape underscores at the end of words in types, in place: reStructuredText takes `a_` for a reference."""
    lines[:] = [
        re.sub(r"(?<=\w)_(?!\w)", r"\\_", line) if ":vartype" in line else line
        for line in lines
    ]


def leave_out_signature(
    app: Sphinx,
    what: str,
    name: str,
    described: Any,
    options: Any,
    signature: str | None,
    returned: str | None,
) -> tuple[str, str | None] | None:
    """Leave out the signature of a pydantic model: it repeats every attribute."""
    is_model = inspect.isclass(described) and issubclass(described, BaseModel)
    return ("", None) if is_model else None


def setup(app: Sphinx) -> None:
    """Connect the hooks; docstrings are rewritten before napoleon reads their sections."""
    app.add_css_file("narrow.css")
    app.connect("builder-inited", copy_studies)
    app.connect("source-read", link_pages)
    app.connect("include-read", link_included)
    app.connect("autodoc-process-docstring", read_markdown, priority=100)
    app.connect("autodoc-process-docstring", escape_patterns, priority=900)
    app.connect("autodoc-process-signature", leave_out_signature)
