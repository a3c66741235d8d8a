"""Measure ten recipes on each engine, and write their tables in `docs/recipes.md`.

    python scripts/build_recipes.py                   all engines of recipes that are installed
    python scripts/build_recipes.py mujoco rapier     these alone; the other tables stay

Wall times are those of the machine that runs the script, without the import of the engine.
"""

from __future__ import annotations

import argparse
import re
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from gauge_envs.checks.recipes import Aim, Recipe, engine_names, engine_settings, find_recipe
from gauge_envs.errors import MissingExtraError
from gauge_envs.files import write_whole

PAGE = Path(__file__).parents[1] / "docs" / "recipes.md"

AIMS = (
    Aim(friction=0.1, restitution=0.0, mass_kg=0.05, timestep_s=0.002),
    Aim(friction=0.2, restitution=0.3, mass_kg=0.1, timestep_s=0.002),
    Aim(friction=0.4, restitution=0.6, mass_kg=0.5, timestep_s=0.002),
    Aim(friction=0.5, restitution=0.8, mass_kg=1.0, timestep_s=0.002),
    Aim(friction=0.8, restitution=0.2, mass_kg=2.0, timestep_s=0.005),
    Aim(friction=1.0, restitution=0.5, mass_kg=0.5, timestep_s=0.005),
    Aim(friction=0.3, restitution=0.9, mass_kg=0.2, timestep_s=0.001),
    Aim(friction=0.6, restitution=0.1, mass_kg=10.0, timestep_s=0.01),
    Aim(friction=1.5, restitution=0.4, mass_kg=0.02, timestep_s=0.001),
    Aim(friction=0.4, restitution=0.7, mass_kg=50.0, timestep_s=1.0 / 60.0),
)
"""The ten requests: from a light to a heavy body, from a short to a long step."""

HEAD = (
    "| friction | reached | restitution | reached | single drops | mass [kg] | step [s] | hop [mm] | depth [mm] "
    "| creep [mm/s] | wall [s] |\n"
    "| ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: |\n"
)


def begin(engine: str) -> str:
    """Return the line of the page above an engine's table."""
    return f"<!-- recipes of {engine}, written by scripts/build_recipes.py -->"


def end(engine: str) -> str:
    """Return the line of the page below an engine's table."""
    return f"<!-- end of {engine} -->"


def row(recipe: Recipe, wall_s: float) -> str:
    """Return a recipe as a row; a value that is missed is bold."""
    aim, found = recipe.aim, recipe.found
    start = f"| {aim.friction:g} | {{}} | {aim.restitution:g} | {{}} | {{}} | {aim.mass_kg:g} | {aim.timestep_s:.3g} | "
    if found is None:
        return start.format("-", "-", "-") + f"- | - | - | {wall_s:.1f} |\n"

    def marked(name: str, value: float) -> str:
        return f"**{value:.3f}**" if name in recipe.misses else f"{value:.3f}"

    rebound = found.rebound
    texts = (
        marked("friction", found.slide.friction),
        marked("restitution", rebound.mean),
        f"{rebound.low:.2f} to {rebound.high:.2f}",
    )
    # Rounding of single precision has either sign.
    small = (1e3 * value for value in (found.slide.lift_m, found.rest.penetration_m, found.creep_m_s))
    shown = " | ".join(f"{value:.2g}" if abs(value) >= 5e-5 else "0" for value in small)
    return start.format(*texts) + f"{shown} | {wall_s:.1f} |\n"


def table(engine: str) -> str:
    """Measure all requests on an engine, and return its table with the reasons of its misses."""
    settings = engine_settings(engine)
    versions = ", ".join(f"{name} {number}" for name, number in settings.backend().versions().items())
    find_recipe(settings, AIMS[2])  # Kernels are compiled and modules imported before times count.
    rows, reasons = [], []
    for aim in AIMS:
        start = time.perf_counter()
        recipe = find_recipe(settings, aim)
        rows.append(row(recipe, time.perf_counter() - start))
        if recipe.misses or recipe.found is None:
            asked = f"friction {aim.friction:g}, restitution {aim.restitution:g}, step {aim.timestep_s:.3g} s"
            reasons.append(f"- {asked}: {recipe.explanation}\n")
        print(engine, rows[-1], end="", file=sys.stderr, flush=True)
    found = "Misses:\n\n" + "".join(reasons) if reasons else "All asked values are reached.\n"
    return f"{begin(engine)}\n\nMeasured with {versions}.\n\n{HEAD}{''.join(rows)}\n{found}\n{end(engine)}"


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure the engines of the command line, and write their tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("engines", nargs="*", default=list(engine_names()), metavar="ENGINE")
    for engine in parser.parse_args(arguments).engines:
        try:
            written = table(engine)
        except MissingExtraError as error:
            print(f"{engine}: not measured: {error}", file=sys.stderr)
            continue
        # The page is read again for each engine, as others may have been written in between.
        pattern = re.compile(f"{re.escape(begin(engine))}.*?{re.escape(end(engine))}", flags=re.DOTALL)
        text, count = pattern.subn(lambda _, new=written: new, PAGE.read_text(encoding="utf-8"))
        if count != 1:
            print(f"{PAGE}: expected the lines {begin(engine)!r} and {end(engine)!r} once", file=sys.stderr)
            return 1
        write_whole(PAGE, text.encode())
    return 0


if __name__ == "__main__":
    sys.exit(main())
