"""Figure of a reward or a score over the measured uncertainty of its constants."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from gauge_envs.pages.figures import OURS, REAL, new_figure, tidy_axis
from gauge_envs.pages.text import with_unit
from gauge_envs.tools.transfer.envelope import Envelope
from gauge_envs.tools.transfer.envelope_statistics import EnvelopeReport, is_constant

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


COLUMNS = 3


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
