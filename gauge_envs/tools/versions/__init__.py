"""Compare two releases of an engine on one model: what changed, and which side is right."""

from typing import TYPE_CHECKING

from gauge_envs.registry import lazy_names

if TYPE_CHECKING:
    from gauge_envs.tools.versions.comparison import compare as compare
    from gauge_envs.tools.versions.schema import (
        Comparison as Comparison,
        Side as Side,
        Verdict as Verdict,
    )
    from gauge_envs.tools.versions.subject import bench as bench
else:
    __getattr__, __all__ = lazy_names(
        __name__,
        {
            ".comparison": ["compare"],
            ".schema": ["Comparison", "Side", "Verdict"],
            ".subject": ["bench"],
        },
    )
