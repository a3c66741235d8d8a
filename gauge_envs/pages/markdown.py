"""Documents as GitHub Markdown."""

from collections.abc import Sequence

from gauge_envs.pages.document import (
    Bullets,
    Heading,
    Paragraph,
    Part,
    Shown,
    document_of,
)
from gauge_envs.pages.table import Column, Facts, Table
from gauge_envs.pages.text import markdown_text


def as_markdown(shown: Shown) -> str:
    """Return a document as GitHub Markdown, with an empty line between its parts."""
    document = document_of(shown)
    parts = document.parts
    if document.markdown is not None:
        parts = document.markdown
    return "\n\n".join(filter(None, map(_markdown, parts))).rstrip() + "\n"


def _markdown(part: Part) -> str:
    """Return a part without an empty line below it; markup is omitted."""
    match part:
        case Heading(text, level):
            return f"{'#' * level} {markdown_text(text)}"
        case Paragraph(text):
            return markdown_text(text)
        case Bullets(entries, title):
            lines = [f"- {line}" for line in entries]
            if title:
                lines[:0] = [f"{title}:", ""]
            return "\n".join(lines)
        case Facts(pairs):
            facts = (markdown_text(f"{key}: {text}") for key, text in pairs.items())
            return "\n".join(f"- {fact}" for fact in facts)
        case Table():
            return _table(part)
    return ""


def _table(table: Table) -> str:
    columns = table.columns
    lines = []
    if table.title:
        lines += [f"**{markdown_text(table.title)}**", ""]
    lines.append(_row([column.label for column in columns]))
    lines.append(f"| {' | '.join(map(_alignment, columns))} |")
    lines += [_row([column.text(row) for column in columns]) for row in table.rows]
    if table.notes:
        lines.append("")
    # Two blanks end a line in Markdown.
    lines += [f"{markdown_text(note)}  " for note in table.notes]
    return "\n".join(lines)


def _row(cells: Sequence[str]) -> str:
    return f"| {' | '.join(map(markdown_text, cells))} |"


def _alignment(column: Column) -> str:
    if column.is_number:
        return "---:"
    return "---"
