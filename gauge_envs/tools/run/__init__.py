"""Run experiments and score them; score trajectories from files."""

from typing import TYPE_CHECKING

from gauge_envs.registry import lazy_names

if TYPE_CHECKING:
    from gauge_envs.tools.run.schema import RunLine as RunLine
else:
    __getattr__, __all__ = lazy_names(
        __name__,
        {
            ".schema": ["RunLine"],
        },
    )
