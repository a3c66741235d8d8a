"""Engines, parameters and settings side by side: scores, ranks and pairs within each grade of reference."""

from typing import TYPE_CHECKING

from gauge_envs.tools import door

if TYPE_CHECKING:
    from gauge_envs.tools.compare.comparison import Cell, Comparison, ExperimentComparison, compare
    from gauge_envs.tools.compare.grades import DIFFERENT, PUBLISHED, GradeComparison, GradeScore, PairComparison
    from gauge_envs.tools.compare.words import comparison_document, deciding_text, mean_rank_text, p_text, verdict_text

__all__ = [
    "DIFFERENT",
    "PUBLISHED",
    "Cell",
    "Comparison",
    "ExperimentComparison",
    "GradeComparison",
    "GradeScore",
    "PairComparison",
    "compare",
    "comparison_document",
    "deciding_text",
    "mean_rank_text",
    "p_text",
    "verdict_text",
]

if not TYPE_CHECKING:  # With it, a type checker would accept any name.
    __getattr__ = door(__name__, "comparison", "grades", "words")
