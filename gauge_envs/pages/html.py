"""HTML elements with escaped texts.

`Html` marks markup. All else is text, which `element` escapes, so that no name in a result file becomes markup.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable
from html import escape
from typing import Any

from gauge_envs.text import printable

Text = str | float | int | None


class Html(str):
    """Markup; only pages show it as a part of a document."""

    __slots__ = ()


VOID = ("br", "img", "input", "link", "meta", "wbr")
"""Elements without content."""


def element(name: str, /, *content: Text | Html, **attributes: Text | bool) -> Html:
    """Return an element; its text is escaped, and its markup is not.

    Args:
        name: Name of the element.
        *content: Texts, numbers and markup; None is empty.
        **attributes: Attributes; `_` in a name stands for `-`, and a trailing `_` is dropped, as in `class_`. None and
            False omit an attribute, and True writes it without a value.
    """
    parts = [name]
    for key, value in attributes.items():
        title = key.rstrip("_").replace("_", "-")
        if value is True:
            parts.append(title)
        elif value is not None and value is not False:
            parts.append(f'{title}="{escape(_plain(value))}"')
    start = " ".join(parts)
    if name in VOID and not content:
        return Html(f"<{start}/>")
    return Html(f"<{start}>{join(content)}</{name}>")


def join(parts: Iterable[Text | Html], between: str = "") -> Html:
    """Return the concatenation of texts and markup."""
    texts: list[str] = []
    for part in parts:
        if isinstance(part, Html):
            texts.append(part)
        elif part is not None:
            texts.append(escape(_plain(part)))
    return Html(escape(between).join(texts))


def _plain(value: Text) -> str:
    # HTML does not allow control characters.
    return printable(str(value))


def listed(lines: Iterable[Text | Html]) -> Html:
    """Return a list with an entry for each line."""
    return element("ul", *(element("li", line) for line in lines))


def folded(summary: str, *content: Html) -> Html:
    """Return content that unfolds below its summary."""
    return element("details", element("summary", summary), *content)


def script_value(value: Any) -> str:
    """Return a value as JSON for a script; it has no `<`, so no text can end the script."""
    return json.dumps(value, allow_nan=False, separators=(",", ":")).replace(
        "<", "\\u003c"
    )


def slug(text: str) -> str:
    """Return a text as a part of a file name: ASCII letters, digits, `-` and `_`."""
    return re.sub(r"[^A-Za-z0-9_-]+", "_", text)[:80] or "_"
