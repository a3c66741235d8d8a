"""Engines, parameters and settings side by side: scores, ranks and pairs within each grade of reference."""

from typing import TYPE_CHECKING

from gauge_envs.tools import door

if TYPE_CHECKING:
    from gauge_envs.tools.compare.comparison import Cell, Comparison, ExperimentComparison, compare
    from gauge_envs.tools.compare.grades import GradeComparison, GradeScore, PairComparison, compare_grade
    from gauge_envs.tools.compare.words import comparison_document, verdict_text

__all__ = [
    "Cell",
    "Comparison",
    "ExperimentComparison",
    "GradeComparison",
    "GradeScore",
    "PairComparison",
    "compare",
    "compare_grade",
    "comparison_document",
    "verdict_text",
]

if not TYPE_CHECKING:  # With it, a type checker would accept any name.
    __getattr__ = door(__name__, "comparison", "grades", "words")
