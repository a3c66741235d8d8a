"""Figure of the reward that policies keep in each world."""

from __future__ import annotations

from textwrap import wrap
from typing import TYPE_CHECKING

from gauge_envs.pages.figures import OURS, REAL, new_figure, tidy_axis
from gauge_envs.tools.transfer.transfer import FALL_SHARE, TransferReport

if TYPE_CHECKING:
    from matplotlib.figure import Figure


LONG_NAME = 48
"""Length at which the name of a world continues in a second line [characters]."""


def draw_transfer(report: TransferReport) -> Figure:
    """Return the picture of kept rewards: a point with its interval for each world."""
    rows = (report.training, *report.others)
    names = ["\n".join(wrap(row.world.name, LONG_NAME, break_on_hyphens=False)) for row in rows]
    # Two lines of a name need more height than one world has.
    figure = new_figure(9.0, 0.28 * len(rows) + 0.12 * sum("\n" in name for name in names) + 1.6)
    axis = figure.add_subplot()
    for place, row in enumerate(rows):
        color = REAL if place == 0 else OURS[1] if row.falls else OURS[0]
        kept = row.kept
        if kept.low is not None and kept.high is not None:
            axis.plot([100 * kept.low, 100 * kept.high], [place, place], color=color, lw=2.0, solid_capstyle="round")
        axis.plot(100 * kept.value, place, "o", color=color, ms=6)
        allowed = 100 * min(1.0, row.allowed)
        axis.plot([allowed, allowed], [place - 0.4, place + 0.4], color="#707070", lw=1.2)
    axis.set_yticks(range(len(rows)), names, fontsize=8)
    axis.set_ylim(len(rows) - 0.5, -0.5)
    lowest = min([0.0, *(row.kept.value if row.kept.low is None else row.kept.low for row in rows)])
    axis.set_xlim(100 * lowest - 5, None)
    axis.set_xlabel("reward kept [% of the promise]", loc="left", fontsize=9)
    note = f"bar: what the law allows there; orange: below {100 * FALL_SHARE:.0f} % of it"
    figure.suptitle(f"{report.task}   {note}", x=0.01, ha="left", fontsize=9)
    tidy_axis(axis)
    return figure
