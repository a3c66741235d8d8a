"""Figure of error budgets."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from gauge_envs.errors import ShapeError
from gauge_envs.pages.figures import ENGINES, OURS, new_figure, tidy_axis
from gauge_envs.pages.results import result_label
from gauge_envs.pages.text import score_text, short_id
from gauge_envs.runs.result import Result
from gauge_envs.tools.diagnose.model import BudgetStage, Diagnosis

if TYPE_CHECKING:
    from matplotlib.figure import Figure


STAGE_COLORS = {BudgetStage.RELEASE: OURS[5], BudgetStage.OFFSET: OURS[2], BudgetStage.RATE: OURS[4]}
"""Colours of the parts, as on the pages of `gauge report`."""


def draw_diagnoses(pairs: Sequence[tuple[Result, Diagnosis]]) -> Figure:
    """Return the picture of error budgets: a bar for each result, with the shares of its squared error.

    Args:
        pairs: Results with their budgets, one or more, all with the parts in the same order.
    """
    if not pairs:
        raise ShapeError("error budgets of one result or more are needed, got none")
    figure = new_figure(10.0, 0.42 * len(pairs) + 1.9)
    axis = figure.add_subplot()
    for place, (_, diagnosis) in enumerate(pairs):
        left = 0.0
        for part in diagnosis.parts:
            label = part.stage.value if place == 0 else None
            axis.barh(place, 100.0 * part.share, left=left, color=STAGE_COLORS[part.stage], height=0.72, label=label)
            left += 100.0 * part.share
        rest = "rest" if place == 0 else None
        axis.barh(place, 100.0 * diagnosis.rest.share, left=left, color=ENGINES[0], height=0.72, label=rest)
        axis.text(101.0, place, _error_text(diagnosis), va="center", fontsize=8, color="#404040")
    names = [f"{short_id(diagnosis.id)}\n{result_label(result)}" for result, diagnosis in pairs]
    axis.set_yticks(range(len(pairs)), names, fontsize=8)
    axis.set_ylim(len(pairs) - 0.5, -0.5)
    axis.set_xlim(0.0, 128.0)
    axis.set_xticks(range(0, 101, 20))
    order = ", then ".join(part.stage.value for part in pairs[0][1].parts)
    shares = f"share of the squared error that is gone with {order} [%]"
    ends = "at the right: RMSE before and after, over the mean of the real trials or with its unit"
    axis.set_xlabel(f"{shares}\n{ends}", loc="left", fontsize=9)
    tidy_axis(axis)
    axis.grid(visible=False, axis="y")
    axis.tick_params(axis="y", length=0)
    axis.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=4, fontsize=8, frameon=False)
    return figure


def _error_text(diagnosis: Diagnosis) -> str:
    before, after, unit = diagnosis.rmse_normalized, diagnosis.rest.rmse_normalized, ""
    if before is None or after is None:
        before, after, unit = diagnosis.rmse, diagnosis.rest.rmse, f" {diagnosis.unit}"
    return f"{score_text(before)} to {score_text(after)}{unit}"
