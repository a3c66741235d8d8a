"""HTML elements whose texts are escaped, and the frame that all pages share.

`Html` marks text that is markup. Everything else is text, and `element` escapes it, so that no name in a result file
can become markup.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Sequence
from html import escape
from typing import Any

from gauge_envs.files import printable

Text = str | float | int | None


class Html(str):
    """Markup."""

    __slots__ = ()


VOID = ("br", "col", "input", "link", "meta", "line", "path", "polygon", "polyline", "rect", "circle", "wbr")
"""Elements without content, in HTML and SVG."""

LONGEST_WORD = 34
"""Length up to which a word of a command fits in a line of a phone [characters]."""

STYLE = """
:root { color-scheme: light dark; --text: #1c1c1c; --back: #fff; --quiet: #555; --line: #ddd; --head: #bbb;
  --blue: #e3f1fa; --amber: #fdf3d4; --red: #fbe3d6; --grey: #f1f1f1; }
@media (prefers-color-scheme: dark) { :root { --text: #e8e8e8; --back: #161616; --quiet: #b0b0b0; --line: #3a3a3a;
  --head: #666; --blue: #12324a; --amber: #4a3a08; --red: #56240c; --grey: #2c2c2c; } }
* { box-sizing: border-box; }
body { font: 16px/1.5 system-ui, "Segoe UI", Roboto, "DejaVu Sans", sans-serif; color: var(--text);
  background: var(--back); max-width: 72rem; margin: 1.5rem auto; padding: 0 1rem; overflow-wrap: anywhere; }
h1 { font-size: 1.5rem; line-height: 1.25; margin: 0 0 .8rem; } h2 { font-size: 1.2rem; margin: 2rem 0 .5rem; }
a { color: inherit; text-decoration-color: var(--quiet); }
table { border-collapse: collapse; width: 100%; }
th { text-align: left; font-weight: 600; color: var(--quiet); border-bottom: 2px solid var(--head);
  padding: .3rem .5rem; overflow-wrap: normal; }
td { border-top: 1px solid var(--line); padding: .35rem .5rem; vertical-align: top; }
td:empty { padding: 0; }
tr.more td { border-top: 0; padding-top: 0; color: var(--quiet); }
td.n, th.n { text-align: right; font-variant-numeric: tabular-nums; }
@media (min-width: 761px) { td.n, th.n, td .badge { white-space: nowrap; }
  .phenomena td:first-child { width: 45%; } }
.badge { display: inline-block; border-radius: .25rem; padding: .05rem .5rem; border: 1px solid; }
.inside { background: var(--blue); border-color: #0072b2; }
.visible { background: var(--amber); border-color: #c78a00; }
.wrong { background: var(--red); border-color: #d55e00; font-weight: 600; }
.declined { background: var(--grey); border-color: #999; }
.cure { border-left: 4px solid #0072b2; padding: .4rem .7rem; background: var(--blue); font-weight: 600; margin: 0; }
.note { border-left: 4px solid #c78a00; padding: .1rem .7rem; margin: .4rem 0; background: var(--amber); }
.lead, .small { color: var(--quiet); } .small { font-size: .9rem; margin: .4rem 0; }
.cards { display: grid; grid-template-columns: repeat(auto-fill, minmax(min(24rem, 100%), 1fr)); gap: 1rem;
  align-items: start; }
.card { border: 1px solid var(--line); border-radius: .4rem; padding: .6rem .9rem; min-width: 0;
  content-visibility: auto; contain-intrinsic-size: auto 24rem; }
.card:not([open]) { contain-intrinsic-size: auto 3rem; }
.card > summary { font-weight: 600; color: var(--text); }
.card svg { display: block; width: 100%; max-width: 26rem; height: auto; background: #fff; border-radius: .3rem; }
details { font-size: 1rem; } details details, details table { font-size: .9rem; }
summary { cursor: pointer; color: var(--quiet); }
.wide td { padding: .15rem .4rem; } .wide th { padding: .15rem .4rem; }
@media (max-width: 760px) {
  .stack thead { display: none; }
  .stack tr, .stack td { display: block; }
  .stack tr { border-top: 1px solid var(--line); padding: .5rem 0; }
  .stack td { border: 0; padding: .05rem 0; text-align: left; }
  .stack td[data-label]:not(:empty)::before { content: attr(data-label) ": "; color: var(--quiet); }
  .stack td.n { display: inline-block; margin-right: 1rem; }
  .stack tr.more { border-top: 0; padding-top: 0; }
}
"""
"""Style of a page in one file."""

SITE_STYLE = (
    STYLE
    + """
:root { --c0: #0072b2; --c1: #d55e00; --c2: #009e73; --c3: #b6568f; --c4: #b07a00; --c5: #2b8fc4; --real: #303030;
  --band1: #c4c4c4; --band2: #e3e3e3; --stage: #eef0f3; --floor: #d9dce1; }
@media (prefers-color-scheme: dark) { :root { --c0: #4ba3dc; --c1: #ff8b3d; --c2: #2cc69a; --c3: #e39cc6; --c4: #e6b422;
  --c5: #7cc8f2; --real: #e6e6e6; --band1: #5c5c5c; --band2: #3a3a3a; --stage: #202328; --floor: #33373d; } }
nav { font-size: .9rem; margin-bottom: .6rem; }
nav a { display: inline-block; margin-right: 1rem; padding: .3rem 0; }
nav a[aria-current] { font-weight: 600; text-decoration: none; }
.answer { border-left: 4px solid #0072b2; background: var(--blue); padding: .3rem .8rem; margin: .5rem 0; }
.answer p { margin: .3rem 0; }
.value { font-weight: 600; font-variant-numeric: tabular-nums; white-space: nowrap; }
.quiet { color: var(--quiet); font-size: .85rem; font-weight: 400; } .quiet.block { display: block; }
.hash { display: block; font-size: .8rem; color: var(--quiet); }
.far { background: var(--red); } .near { background: var(--blue); } .even { background: var(--amber); }
.scroll { overflow-x: auto; } .scroll table { overflow-wrap: normal; }
.matrix td, .matrix th { min-width: 8.2rem; } .matrix tr > :first-child { position: sticky; left: 0; min-width: 11rem;
  background: var(--back); font-weight: 400; color: var(--text); border-bottom: 0; border-top: 1px solid var(--line); }
.matrix thead tr > :first-child { border-top: 0; border-bottom: 2px solid var(--head); font-weight: 600; }
.matrix td { border-left: 1px solid var(--line); }
.matrix td .badge { font-size: .78rem; padding: 0 .35rem; white-space: nowrap; }
.key { display: flex; flex-wrap: wrap; gap: .2rem 1rem; padding: 0; margin: .4rem 0; list-style: none;
  font-size: .9rem; }
.swatch { display: inline-block; width: 1.4rem; height: .25rem; vertical-align: middle; margin-right: .35rem; }
.swatch.area { height: .8rem; }
.panels { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(22rem, 100%), 1fr)); gap: .8rem; }
.panels figure > svg, .forest figure > svg { display: block; width: 100%; max-width: 36rem; height: auto; }
.panels figure:only-child { max-width: 36rem; }
figure { margin: 0; min-width: 0; } figcaption { font-size: .85rem; color: var(--quiet); }
svg text { font: 11px system-ui, "Segoe UI", Roboto, "DejaVu Sans", sans-serif; fill: var(--text); }
svg .quiet { fill: var(--quiet); font-size: 11px; } svg .axis { stroke: var(--head); stroke-width: 1; fill: none; }
svg .grid { stroke: var(--line); stroke-width: 1; } svg .real { stroke: var(--real); fill: none; stroke-width: 1.4; }
svg .sigma1 { fill: var(--band1); } svg .sigma2 { fill: var(--band2); } svg .curve { fill: none; stroke-width: 1.6; }
svg .one { stroke: var(--real); stroke-dasharray: 3 3; }
.forest { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(24rem, 100%), 1fr)); gap: 1rem; }
.shares { display: flex; height: 1.1rem; width: 100%; margin: .15rem 0 .5rem; border-radius: .2rem; overflow: hidden; }
.shares span { display: block; height: 100%; }
pre { white-space: pre-wrap; overflow-wrap: anywhere; background: var(--grey); padding: .5rem .7rem;
  border-radius: .3rem; font-size: .85rem; }
code { overflow-wrap: anywhere; } .word { white-space: nowrap; }
td code { display: inline-block; min-width: min(21rem, 70vw); }
.replay { border: 1px solid var(--line); border-radius: .4rem; padding: .6rem; }
.stage { position: relative; } .stage canvas { display: block; width: 100%; border-radius: .3rem;
  background: var(--stage); touch-action: pan-y; }
.stage canvas:focus-visible, .controls :focus-visible { outline: 3px solid #0072b2; outline-offset: 1px; }
.names { position: absolute; inset: 0; pointer-events: none; }
.names span { position: absolute; padding: .1rem .4rem; font-size: .85rem; border-radius: .2rem;
  background: var(--back); opacity: .85; margin: .3rem; border-left: .3rem solid; }
.controls { display: flex; flex-wrap: wrap; align-items: center; gap: .4rem .7rem; margin-top: .5rem; }
.controls input[type=range] { flex: 1 1 10rem; min-width: 8rem; height: 1.6rem; }
.controls input[type=checkbox] { width: 1.1rem; height: 1.1rem; vertical-align: -.15rem; }
.controls output { font-variant-numeric: tabular-nums;
  min-width: 6.5rem; } .controls button, .controls select { font: inherit; padding: .25rem .7rem; min-height: 2.2rem; }
.controls label { white-space: nowrap; } .controls fieldset { border: 0; padding: 0; margin: 0; display: flex;
  flex-wrap: wrap; gap: .3rem .8rem; } .controls legend { float: left; margin-right: .6rem; color: var(--quiet); }
@media (max-width: 760px) { body { margin: .8rem auto; padding: 0 .7rem; } h1 { font-size: 1.3rem; }
  .matrix td, .matrix th { min-width: 7.2rem; padding: .3rem .35rem; } .matrix tr > :first-child { min-width: 7.6rem;
  max-width: 8.6rem; overflow-wrap: break-word; } .scroll { margin: 0 -.7rem; padding: 0 .7rem; } }
"""
)
"""Style of all pages: that of a page in one file, and what matrix, curves and replays need."""


def element(name: str, /, *content: Text | Html, **attributes: Text | bool) -> Html:
    """Return an element; text in it is escaped, and markup is not.

    Args:
        name: Name of the element.
        *content: Texts, numbers and markup; None is nothing.
        **attributes: Attributes; `_` in a name stands for `-`, and a last `_` is left out, as in `class_`. None and
            False leave an attribute out, and True writes it without a value.
    """
    parts = [name]
    for key, value in attributes.items():
        if value is None or value is False:
            continue
        title = key.rstrip("_").replace("_", "-")
        parts.append(title if value is True else f'{title}="{escape(_plain(value))}"')
    start = " ".join(parts)
    if name in VOID and not content:
        return Html(f"<{start}/>")
    return Html(f"<{start}>{join(content)}</{name}>")


def join(parts: Iterable[Text | Html], between: str = "") -> Html:
    """Return texts and markup one after another."""
    texts = (part if isinstance(part, Html) else escape(_plain(part)) for part in parts if part is not None)
    return Html(escape(between).join(texts))


def code(text: str) -> Html:
    """Return a command as code; a narrow screen breaks its lines between words, and not at the hyphens of options."""
    words = (element("span", word, class_="word") if len(word) <= LONGEST_WORD else word for word in text.split(" "))
    return element("code", join(words, " "))


def _plain(value: Text | Html | bool) -> str:
    # Control characters are no part of HTML.
    return printable(value) if isinstance(value, str) else str(value)


def table(
    titles: Sequence[Text | Html],
    rows: Iterable[Sequence[Text | Html]],
    *,
    kind: str = "stack wide",
    number_from: int = 99,
) -> Html:
    """Return a table.

    Args:
        titles: Titles of the columns.
        rows: Cells; on a narrow screen those of a row stand below each other, each with its title.
        kind: Classes of the table.
        number_from: First column of numbers.
    """
    head = join(
        element("th", title, scope="col", class_="n" if index >= number_from else None)
        for index, title in enumerate(titles)
    )
    body = join(
        element(
            "tr",
            *(
                element("td", cell, data_label=str(title) or None, class_="n" if index >= number_from else None)
                for index, (title, cell) in enumerate(zip(titles, row, strict=True))
            ),
        )
        for row in rows
    )
    content = join([element("thead", element("tr", head)), element("tbody", body)])
    return element("div", element("table", content, class_=kind), class_="scroll")


def page(title: str, parts: Iterable[Html], *, here: str, scripts: Sequence[str] = ()) -> str:
    """Return a page of the site.

    Args:
        title: Title of the page.
        parts: Its content.
        here: Its file name, which the navigation marks.
        scripts: Script files in the order in which they run.
    """
    links = (("index.html", "Overview"), ("reproduce.html", "How to reproduce"))
    navigation = join(
        element("a", text, href=file, aria_current="page" if file == here else None) for file, text in links
    )
    loads = join(element("script", Html(""), src=file, defer=True) for file in scripts)
    body = join([element("nav", navigation), element("h1", title), *parts], "\n")
    return (
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>{escape(_plain(title))}</title>'
        '<meta name="viewport" content="width=device-width, initial-scale=1"><link rel="icon" href="data:,">'
        f'<link rel="stylesheet" href="assets/site.css">{loads}</head>\n<body>{body}</body></html>\n'
    )


def script_value(value: Any) -> str:
    """Return a value as JSON that may stand in a script: no `<`, so that no text can end the script."""
    return json.dumps(value, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")


def slug(text: str) -> str:
    """Return a text as a part of a file name: ASCII letters, digits, `-` and `_`."""
    return re.sub(r"[^A-Za-z0-9_-]+", "_", text)[:80] or "_"
