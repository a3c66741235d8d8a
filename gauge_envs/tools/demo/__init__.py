"""Show what the package measures on one page: an engine, its constants, the contacts of a robot, and a policy."""

from typing import TYPE_CHECKING

from gauge_envs.registry import lazy_names

if TYPE_CHECKING:
    from gauge_envs.tools.demo.card import cards as cards
    from gauge_envs.tools.demo.measure import (
        creep as creep,
        drop as drop,
        real_drops as real_drops,
    )
else:
    __getattr__, __all__ = lazy_names(
        __name__,
        {".card": ["cards"], ".measure": ["creep", "drop", "real_drops"]},
    )
