"""Error over cost as the step and the iterations of an engine vary."""

from typing import TYPE_CHECKING

from gauge_envs.tools import door

if TYPE_CHECKING:
    from gauge_envs.tools.cost.model import Family, Phenomenon, Point, Tradeoff
    from gauge_envs.tools.cost.pareto import tradeoff
    from gauge_envs.tools.cost.words import draw_pareto, pareto_document

__all__ = ["Family", "Phenomenon", "Point", "Tradeoff", "draw_pareto", "pareto_document", "tradeoff"]

if not TYPE_CHECKING:  # With it, a type checker would accept any name.
    __getattr__ = door(__name__, "model", "pareto", "words")
