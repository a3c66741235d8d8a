"""Figures of the reward that policies keep in each world, and of a quantity over its uncertain constants."""

from __future__ import annotations

import math
from textwrap import wrap
from typing import TYPE_CHECKING

import numpy as np

from gauge_envs.pages.figures import OURS, REAL, new_figure, tidy_axis
from gauge_envs.pages.text import with_unit
from gauge_envs.tools.transfer.envelope import Envelope
from gauge_envs.tools.transfer.envelope_statistics import EnvelopeReport, is_constant
from gauge_envs.tools.transfer.transfer import FALL_SHARE, TransferReport

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


LONG_NAME = 48
"""Length at which the name of a world continues in a second line [characters]."""

COLUMNS = 3
"""Panels of an envelope in a row."""


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


def draw_envelope(envelope: Envelope, report: EnvelopeReport) -> Figure:
    """Return the picture: the distribution of the quantity, and the quantity over each parameter.

    Args:
        envelope: The points.
        report: Its report.
    """
    rows = math.ceil((1 + len(report.effects)) / COLUMNS)
    figure = new_figure(10.5, 3.1 * rows + 0.5)
    unit = "" if report.unit == "1" else f" [{report.unit}]"
    endings = list(dict.fromkeys((envelope.calibrated_ending, *envelope.endings)))
    colors = dict(zip(endings, OURS, strict=False))
    first = figure.add_subplot(rows, COLUMNS, 1)
    _draw_distribution(first, envelope, report, colors)
    first.set_ylabel(f"{report.quantity}{unit}")
    for place, effect in enumerate(report.effects):
        axis = figure.add_subplot(rows, COLUMNS, place + 2, sharey=first)
        column = envelope.sigmas[:, envelope.parameters.index(effect.parameter)]
        for ending in endings:
            chosen = np.array([one == ending for one in envelope.endings])
            axis.plot(column[chosen], envelope.values[chosen], ".", ms=2.5, alpha=0.5, color=colors[ending])
        axis.axvline(0.0, color=REAL, lw=0.8)
        sigma = with_unit(f"{effect.parameter.std:.2g}", effect.parameter.unit)
        axis.set_xlabel(f"{effect.parameter.name}\nfrom the calibrated value [sigma = {sigma}]", fontsize=8)
        axis.set_title(f"rank correlation {effect.rank_correlation:+.2f}", loc="left", fontsize=8)
        tidy_axis(axis)
    title = f"{report.id}  {report.backend}, {report.samples} samples"
    acted = "" if report.policy == "none" else f"; {report.policy}"
    figure.suptitle(title + acted, x=0.01, ha="left", fontsize=9)
    return figure


def _draw_distribution(axis: Axes, envelope: Envelope, report: EnvelopeReport, colors: dict[str, str]) -> None:
    known = np.isfinite(envelope.values)
    if not is_constant(envelope.values[known]):
        bins = np.histogram_bin_edges(envelope.values[known], bins=40).tolist()
        stacked = [envelope.values[known & np.array([one == ending for one in envelope.endings])] for ending in colors]
        axis.hist(stacked, bins=bins, orientation="horizontal", stacked=True, color=list(colors.values()),
                  label=list(colors))  # fmt: skip
    axis.axhline(report.calibrated, color=REAL, lw=1.2, label="calibrated")
    axis.axhspan(report.low, report.high, color="0.9", zorder=0, label="95 %")
    axis.set_xlabel("number of samples", fontsize=8)
    axis.legend(fontsize=7, frameon=False)
    tidy_axis(axis)
