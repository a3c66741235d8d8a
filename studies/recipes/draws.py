"""Draw contacts, and judge each recipe in the plain engine: friction and rebound of glancing impacts, and hops.

    PYTHONPATH=.:tests/tools/recipes python -m studies.recipes.draws ENGINE FIRST_SEED LAST_SEED

A miss is silent if the plain engine differs by more than the tolerance and the recipe does not name the value. Newton,
Drake and Genesis have no plain loop, and are judged by the recipe's own simulations.
"""

import sys

import numpy as np
from plain_loops import LOOPS, hop, impacts, rebound

from gauge_envs.tools.recipes import Aim, engine_settings, find_recipe

FRICTION_SHARE, RESTITUTION_WIDTH = 0.1, 0.05
"""Tolerances of friction in impacts, relative, and of the rebound of a ball that slips."""


def drawn(seed: int) -> tuple[Aim, float]:
    """Return a contact, and the size of the judge's bodies over those of the recipe."""
    random = np.random.default_rng(seed)
    aim = Aim(
        friction=round(float(random.uniform(0.1, 1.2)), 2),
        restitution=round(float(random.uniform(0.0, 0.9)), 2),
        mass_kg=float(f"{10 ** random.uniform(-2, 1.5):.2g}"),
        timestep_s=float(random.choice([0.001, 0.002, 0.004, 0.005])),
    )
    return aim, float(f"{10 ** random.uniform(-0.3, 0.5):.2g}")


def judged(engine: str, seed: int) -> None:
    """Print a row: the contact, what the recipe misses, its values and those of the plain engine, and silent misses."""
    aim, scale = drawn(seed)
    recipe = find_recipe(engine_settings(engine), aim)
    asked = (aim.friction, aim.restitution, aim.mass_kg, scale, aim.timestep_s)
    reached = [
        recipe.reached[n] for n in ("impact_friction", "slip_restitution", "hop_m")
    ]
    silent, plain = [], []
    if engine in LOOPS:
        contact = LOOPS[engine], recipe.snippet
        body = aim.mass_kg, aim.timestep_s
        ratios, slip = impacts(*contact, aim.friction, *body, scale)
        means = ratios.mean(axis=1)
        worst = max(means, key=lambda ratio: abs(ratio - 1.0))
        drop = rebound(*contact, *body)
        rise_m = hop(*contact, *body, scale)
        plain = [*means, slip, drop, rise_m]
        wrong = {
            "impact_friction": abs(worst - 1.0) > FRICTION_SHARE,
            "slip_restitution": abs(slip - aim.restitution) > RESTITUTION_WIDTH,
            "restitution": abs(drop - aim.restitution) > RESTITUTION_WIDTH,
        }
        silent = [name for name in wrong if wrong[name] and name not in recipe.misses]
    numbers = " ".join(
        f"{value:.4g}" for value in (*asked, *reached, *plain) if value is not None
    )
    print(
        engine, seed, numbers, "misses", *recipe.misses, "silent", *silent, flush=True
    )


if __name__ == "__main__":
    for seed in range(int(sys.argv[2]), int(sys.argv[3]) + 1):
        judged(sys.argv[1], seed)
