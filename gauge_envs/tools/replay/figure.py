"""The figure of a replay: joints over time, and the errors of predictions before and after the best change."""

from __future__ import annotations

from typing import TYPE_CHECKING

from gauge_envs.pages.figures import OURS, REAL, legend_above, new_figure, tidy_axis
from gauge_envs.tools.replay.report import Replay

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MAX_JOINTS = 4
PREDICTIONS = 40
OUTPUTS = 12
HORIZON_S = 0.25


def replay_figure(replay: Replay) -> Figure:
    """Return a figure with a row for each of the joints that differ most.

    A row has the log, predictions from recorded states before and after the change, and the time at which they part.
    """
    problem, change = replay.problem, replay.change
    replayer, log = problem.replayer, problem.replayer.log
    pieces = replayer.pieces(HORIZON_S, PREDICTIONS, outputs=OUTPUTS)
    times_s, recorded = log.time_s[pieces[:, 1:]], log.position[pieces[:, 1:]]
    curves = {"model": problem.setup}
    if change is not None:
        curves["after the change"] = problem.changed(change)
    errors = [replayer.predict(setup, pieces) for setup in curves.values()]
    rows = replay.line.joints[:MAX_JOINTS]
    figure = new_figure(10.0, 2.0 * len(rows) + 0.8)
    axes = figure.subplots(len(rows), squeeze=False, sharex=True)[:, 0]
    for axis, row in zip(axes, rows, strict=True):
        joint = log.joints.index(row.joint)
        angle = log.position[:, joint]
        axis.plot(log.time_s, angle, color=REAL, lw=2.4, alpha=0.4, label="log")
        for color, name, error in zip(OURS, curves, errors, strict=False):
            predicted = recorded[..., joint] + error[..., replayer.is_joint][..., joint]
            lines = axis.plot(times_s.T, predicted.T, color=color, lw=1.2)
            lines[0].set_label(name)
        if row.parts_s is not None:
            axis.axvline(row.parts_s, color=REAL, lw=0.8, ls=":")
        axis.set_ylabel(f"{row.joint} [rad or m]", fontsize=8)
        tidy_axis(axis)
    legend_above(axes[0])
    axes[-1].set_xlabel("time [s]")
    return figure
