"""`gauge demo`."""

import webbrowser
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from typing import Annotated

from gauge_envs.cli import arguments
from gauge_envs.cli.output import Progress, echo
from gauge_envs.pages.document import Paragraph, Tone, save_file
from gauge_envs.pages.html import Html, element
from gauge_envs.pages.page import page
from gauge_envs.tools.demo.card import Card, cards

LEGEND = (
    "Grey: real. Orange: simulated and wrong. Blue: simulated and better. MuJoCo {}. "
    "Each command prints the number above it."
)


def demo(
    out: Annotated[Path, arguments.target("Page to write.")] = Path("demo.html"),
    is_opened: Annotated[
        bool,
        arguments.option(
            arguments.OUTPUT, "Open the page in a browser.", "--open/--no-open"
        ),
    ] = True,
) -> None:
    """Measure a ball, constants, a robot's contacts and a policy, and show them on a page.

    It takes about ten seconds. The page is one file and needs no network.
    """
    made: list[Card] = []
    with Progress("cards", 4) as progress:
        for card in cards():
            made.append(card)
            progress.advance(card.title)
            echo(f"{card.title}: {card.text}")
    style = files("gauge_envs.tools.demo") / "demo.css"
    parts = (
        element("style", Html(style.read_text(encoding="utf-8"))),
        element("main", *(card.html() for card in made)),
        Paragraph(LEGEND.format(version("mujoco")), Tone.NOTE),
    )
    file = save_file(out, page("How real is your simulation?", parts))
    echo(file)
    if is_opened:
        webbrowser.open(file.resolve().as_uri())
