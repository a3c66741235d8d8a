"""All rows on the target's own model: each module registers its rows as it is imported."""

from gauge_envs.tools.sanity.rows import ROWS

__all__ = ["ROWS"]
