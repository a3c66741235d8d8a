"""Two releases of an engine on one model: what changed, and which side is right."""

from typing import TYPE_CHECKING

from gauge_envs.registry import lazy_names

if TYPE_CHECKING:
    from gauge_envs.tools.versions.comparison import compare as compare
    from gauge_envs.tools.versions.model import (
        Comparison as Comparison,
        Side as Side,
        Verdict as Verdict,
    )
    from gauge_envs.tools.versions.processes import bench as bench
    from gauge_envs.tools.versions.worker import (
        imbalance as imbalance,
        is_discrete as is_discrete,
    )
else:
    __getattr__, __all__ = lazy_names(
        __name__,
        {
            ".comparison": ["compare"],
            ".model": ["Comparison", "Side", "Verdict"],
            ".processes": ["bench"],
            ".worker": ["imbalance", "is_discrete"],
        },
    )
