"""Error over cost as the step and the iterations of an engine vary."""

from typing import TYPE_CHECKING

from gauge_envs.registry import door

if TYPE_CHECKING:
    from gauge_envs.tools.cost.model import (
        Family as Family,
        Phenomenon as Phenomenon,
        Point as Point,
        Tradeoff as Tradeoff,
    )
    from gauge_envs.tools.cost.pareto import tradeoff as tradeoff
    from gauge_envs.tools.cost.words import draw_pareto as draw_pareto, pareto_document as pareto_document
else:
    __getattr__, __all__ = door(__name__)
