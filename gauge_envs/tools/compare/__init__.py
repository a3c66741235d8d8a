"""Engines, parameters and settings side by side: scores and ranks within each kind of reference."""

from gauge_envs.tools.compare.comparison import (
    Cell as Cell,
    ExperimentComparison as ExperimentComparison,
    ScoreComparison as ScoreComparison,
    compare as compare,
)
from gauge_envs.tools.compare.experiment_figure import (
    draw_experiment as draw_experiment,
)
from gauge_envs.tools.compare.overview_figure import draw_overview as draw_overview
from gauge_envs.tools.compare.reference import judging_band as judging_band
from gauge_envs.tools.compare.report import (
    compared_parts as compared_parts,
    short_tables as short_tables,
)
