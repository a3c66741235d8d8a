"""Engines, parameters and settings side by side: scores and ranks within each kind of reference."""

from typing import TYPE_CHECKING

from gauge_envs.registry import lazy_names

if TYPE_CHECKING:
    from gauge_envs.tools.compare.comparison import (
        Cell as Cell,
        Comparison as Comparison,
        ExperimentComparison as ExperimentComparison,
        compare as compare,
    )
    from gauge_envs.tools.compare.experiment_figure import (
        draw_experiment as draw_experiment,
    )
    from gauge_envs.tools.compare.ranks import (
        KindComparison as KindComparison,
        KindScore as KindScore,
    )
    from gauge_envs.tools.compare.reference import (
        coordinate_words as coordinate_words,
        judging_band as judging_band,
    )
    from gauge_envs.tools.compare.report import (
        distance_tables as distance_tables,
        mean_rank_text as mean_rank_text,
        short_tables as short_tables,
    )
else:
    __getattr__, __all__ = lazy_names(
        __name__,
        {
            ".comparison": ["Cell", "Comparison", "ExperimentComparison", "compare"],
            ".experiment_figure": ["draw_experiment"],
            ".ranks": ["KindComparison", "KindScore"],
            ".report": ["distance_tables", "mean_rank_text", "short_tables"],
            ".reference": [
                "coordinate_words",
                "judging_band",
            ],
        },
    )
