"""Recipes: contact settings of an engine for a measured behaviour, and back, by simulation."""

from typing import TYPE_CHECKING

from gauge_envs.tools import door

if TYPE_CHECKING:
    from gauge_envs.tools.recipes.aim import FREE_FRICTION, Aim
    from gauge_envs.tools.recipes.engines import engine_names, engine_settings
    from gauge_envs.tools.recipes.measure import Measured, measured
    from gauge_envs.tools.recipes.probes import Probe, Rest, Spread
    from gauge_envs.tools.recipes.search import Recipe, find_recipe

__all__ = [
    "FREE_FRICTION",
    "Aim",
    "Measured",
    "Probe",
    "Recipe",
    "Rest",
    "Spread",
    "engine_names",
    "engine_settings",
    "find_recipe",
    "measured",
]

if not TYPE_CHECKING:  # With it, a type checker would accept any name.
    __getattr__ = door(__name__, "aim", "engines", "probes", "measure", "search")
