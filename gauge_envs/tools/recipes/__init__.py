"""Find contact settings of an engine for a measured behaviour, and the behaviour of settings, by simulation."""

from typing import TYPE_CHECKING

from gauge_envs.registry import lazy_names

if TYPE_CHECKING:
    from gauge_envs.tools.recipes.aim import FREE_FRICTION as FREE_FRICTION, Aim as Aim
    from gauge_envs.tools.recipes.engines import (
        engine_names as engine_names,
        engine_settings as engine_settings,
    )
    from gauge_envs.tools.recipes.probes import (
        Probe as Probe,
        measured as measured,
    )
    from gauge_envs.tools.recipes.search import (
        Recipe as Recipe,
        find_recipe as find_recipe,
    )
else:
    __getattr__, __all__ = lazy_names(
        __name__,
        {
            ".aim": ["FREE_FRICTION", "Aim"],
            ".engines": ["engine_names", "engine_settings"],
            ".probes": ["Probe", "measured"],
            ".search": ["Recipe", "find_recipe"],
        },
    )
