"""Figures by matplotlib: shared colours and axes, and export to files and pages."""

from __future__ import annotations

from base64 import b64encode
from io import BytesIO
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any

from gauge_envs.optional import needs_extra
from gauge_envs.pages.document import save_file
from gauge_envs.pages.html import Html, element
from gauge_envs.text import printable

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


OURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
"""Colours of results by Okabe and Ito, which colour-blind readers distinguish."""


def color_of(index: int) -> tuple[str, bool]:
    """Return the colour of a configuration, and whether its lines are dashed, which starts at the seventh."""
    return OURS[index % len(OURS)], index % (2 * len(OURS)) >= len(OURS)


REAL = "#303030"

LEGEND_WIDTH, KEY_WIDTH = 100, 6
"""Width of a legend above a panel, and width of its lines and gaps [characters]."""

MAX_LABEL_WIDTH = 90
"""Largest width of a line in the name of a curve [characters]."""


def new_figure(width: float, height: float) -> Figure:
    """Return an empty figure of a size [inch]."""
    with needs_extra("plotting", "plot"):
        from matplotlib.figure import Figure
    return Figure(figsize=(width, height), layout="constrained")


def save_png(figure: Figure, path: Path) -> Path:
    """Write a figure as PNG and return its path."""
    return save_file(path, _drawn(figure, "png"))


def embedded(figure: Figure, description: str) -> Html:
    """Return a figure as an SVG picture inside the page."""
    data = b64encode(_drawn(figure, "svg")).decode("ascii")
    source = f"data:image/svg+xml;base64,{data}"
    image = element("img", src=source, alt=description)
    return element("figure", image)


def _drawn(figure: Figure, form: str) -> bytes:
    """Return the content of a picture file, `png` or `svg`."""
    from matplotlib import rc_context
    from matplotlib.text import Text

    for text in figure.findobj(Text):
        if not isinstance(text, Text):
            continue
        # A dollar sign in the name of an experiment must not start a formula. Ticks get their formulas later.
        if "$" in text.get_text():
            text.set_parse_math(False)
        lines = text.get_text().split("\n")
        text.set_text("\n".join(map(printable, lines)))
    stream = BytesIO()
    # The same results give the same file, so it has no date and no random names.
    metadata = {"Date": None} if form == "svg" else {}
    with rc_context({"svg.hashsalt": "gauge-envs"}):
        figure.savefig(stream, format=form, dpi=120, metadata=metadata)
    return stream.getvalue()


def tidy_axis(axis: Axes) -> None:
    """Remove the upper and right border, and draw a grid behind the curves."""
    axis.spines[["top", "right"]].set_visible(False)
    axis.grid(color="#ececec", lw=0.7)
    axis.set_axisbelow(True)


def legend_above(axis: Axes) -> None:
    """Put the legend above the curves, with bold lines for faint curves."""
    handles, texts = axis.get_legend_handles_labels()
    labels = [fill(text, MAX_LABEL_WIDTH) for text in texts]
    # A legend that is wider than its panel would make the panel narrower.
    lines = "\n".join(labels).split("\n")
    longest = max(map(len, lines))
    columns = min(3, max(1, LEGEND_WIDTH // (longest + KEY_WIDTH)))
    place: dict[str, Any] = {
        "loc": "lower left",
        "bbox_to_anchor": (0.0, 1.0),
        "borderpad": 0.2,
    }
    legend = axis.legend(
        handles, labels, fontsize=8, frameon=False, ncols=columns, **place
    )
    for line in legend.get_lines():
        line.set(alpha=1.0, linewidth=max(1.4, line.get_linewidth()))
