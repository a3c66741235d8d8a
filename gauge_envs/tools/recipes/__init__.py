"""Find contact settings of an engine for a measured behaviour, and the behaviour of settings, by simulation."""

from typing import TYPE_CHECKING

from gauge_envs.registry import lazy_names

if TYPE_CHECKING:
    from gauge_envs.tools.recipes.aim import Aim as Aim
    from gauge_envs.tools.recipes.engines import engine_settings as engine_settings
    from gauge_envs.tools.recipes.probes import Probe as Probe
    from gauge_envs.tools.recipes.search import find_recipe as find_recipe
else:
    __getattr__, __all__ = lazy_names(
        __name__,
        {
            ".aim": ["Aim"],
            ".engines": ["engine_settings"],
            ".probes": ["Probe"],
            ".search": ["find_recipe"],
        },
    )
