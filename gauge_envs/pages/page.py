"""Documents as pages in HTML."""

from collections.abc import Iterable
from importlib.resources import files

from gauge_envs.pages.document import Bullets, Heading, Paragraph, Part, Tone
from gauge_envs.pages.html import Html, element, join, listed
from gauge_envs.pages.table import Column, Facts, Place, Table, grid

CLASSES = {
    Tone.PLAIN: None,
    Tone.ANSWER: "answer",
    Tone.NOTE: "small",
    Tone.WARNING: "note",
    Tone.ERROR: "note",
}
"""Class of a paragraph."""


def page(title: str, parts: Iterable[Part], *, look: str | None = None) -> str:
    """Return a page in HTML with its style.

    Args:
        title: Its title, above the parts and for the browser.
        parts: Its content.
        look: Class of the body.
    """
    style = files("gauge_envs.pages") / "style.css"
    head = element(
        "head",
        element("meta", charset="utf-8"),
        element("title", title),
        element("meta", name="viewport", content="width=device-width, initial-scale=1"),
        element("link", rel="icon", href="data:,"),
        element("style", Html(style.read_text(encoding="utf-8"))),
    )
    content = join(map(as_html, [Heading(title, 1), *parts]), "\n")
    body = element("body", content, class_=look)
    return f"<!DOCTYPE html>\n{element('html', head, body, lang='en')}\n"


def as_html(part: Part) -> Html:
    """Return a part as markup."""
    match part:
        case Heading(text, level):
            return element(f"h{level}", text)
        case Paragraph(text, tone):
            return element("p", text, class_=CLASSES[tone])
        case Bullets(entries, title):
            return join([_title(title), listed(entries)])
        case Facts(pairs):
            return _table(grid(("what", "value"), list(pairs.items())))
        case Table():
            return _table(part)
    return part


def _table(table: Table) -> Html:
    cells = table.placed(Place.CELL)
    titles = [
        element("th", column.label, scope="col", class_=_class(column))
        for column in cells
    ]
    body: list[Html] = []
    last_heading = ""
    for row in table.rows:
        heading = table.heading_of(row)
        if heading != last_heading:
            body.append(_wide_row("th", heading, len(cells)))
            last_heading = heading
        texts = [
            element("td", column.text(row), class_=_class(column)) for column in cells
        ]
        body.append(element("tr", *texts))
        for column in table.placed(Place.BELOW):
            text = column.text(row)
            if text:
                body.append(_wide_row("td", text, len(cells)))
    head = element("thead", element("tr", *titles))
    whole = element("table", head, element("tbody", *body))
    notes = (element("p", note, class_="small") for note in table.notes)
    return join([_title(table.title), element("div", whole, class_="scroll"), *notes])


def _title(text: str) -> Html:
    """Return a title above a table or a list; nothing for an empty one."""
    if not text:
        return Html("")
    return element("h3", text)


def _wide_row(name: str, text: str, width: int) -> Html:
    """Return a row with one cell over all columns."""
    return element("tr", element(name, text, colspan=width), class_="more")


def _class(column: Column) -> str | None:
    """Return the class of a cell of numbers."""
    if column.is_number:
        return "n"
    return None
