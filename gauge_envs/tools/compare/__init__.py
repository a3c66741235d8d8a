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
    from gauge_envs.tools.compare.ranks import (
        PUBLISHED as PUBLISHED,
        KindComparison as KindComparison,
        KindScore as KindScore,
    )
    from gauge_envs.tools.compare.tables import (
        mean_rank_text as mean_rank_text,
    )
    from gauge_envs.tools.compare.words import short_tables as short_tables
    from gauge_envs.tools.compare.yardstick import (
        choose_yardstick as choose_yardstick,
        coordinate_words as coordinate_words,
        is_aligned as is_aligned,
        judging_band as judging_band,
    )
else:
    __getattr__, __all__ = lazy_names(
        __name__,
        {
            ".comparison": ["Cell", "Comparison", "ExperimentComparison", "compare"],
            ".ranks": ["PUBLISHED", "KindComparison", "KindScore"],
            ".tables": ["mean_rank_text"],
            ".words": ["short_tables"],
            ".yardstick": [
                "choose_yardstick",
                "coordinate_words",
                "is_aligned",
                "judging_band",
            ],
        },
    )
