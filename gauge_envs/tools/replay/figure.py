"""The figure of a replay: joints over time, and the errors of predictions before and after the best change."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

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

    Left: the log, and predictions from recorded states, before and after. Right: their errors over the time since the
    recorded state.
    """
    problem, change = replay.problem, replay.change
    replayer = problem.replayer
    log = replayer.log
    pieces = replayer.pieces(HORIZON_S, PREDICTIONS, outputs=OUTPUTS)
    setups = {"model": problem.setup}
    if change is not None:
        setups["after the change"] = problem.changed(change)
    errors = {
        name: replayer.predict(setup, pieces)[..., replayer.is_joint]
        for name, setup in setups.items()
    }
    rows = replay.line.joints[:MAX_JOINTS]
    figure = new_figure(10.0, 2.0 * len(rows) + 0.8)
    axes = figure.subplots(len(rows), 2, squeeze=False, width_ratios=(3, 1))
    elapsed_s = np.median(replayer.elapsed_s(pieces), axis=0)
    for (left, right), row in zip(axes, rows, strict=True):
        joint = log.joints.index(row.joint)
        left.plot(
            log.time_s,
            log.position[:, joint],
            color=REAL,
            lw=2.4,
            alpha=0.4,
            label="log",
        )
        for color, (name, error) in zip(OURS, errors.items(), strict=False):
            predicted = log.position[pieces.sample, joint] + error[..., joint]
            lines = left.plot(
                log.time_s[pieces.sample].T, predicted.T, color=color, lw=1.2
            )
            lines[0].set_label(name)
            rms = 1e3 * np.sqrt(np.mean(error[..., joint] ** 2, axis=0))
            right.plot(elapsed_s, rms, color=color, lw=1.4)
        right.axhline(1e3 * row.noise, color=REAL, lw=0.8, ls=":")
        if row.parts_s is not None:
            left.axvline(row.parts_s, color=REAL, lw=0.8, ls=":")
        left.set_ylabel(row.joint, fontsize=8)
        right.set_ylabel("rms [mrad or mm]", fontsize=8)
        tidy_axis(left)
        tidy_axis(right)
    legend_above(axes[0, 0])
    axes[-1, 0].set_xlabel("time [s]")
    axes[-1, 1].set_xlabel("prediction [s]")
    return figure
