"""Measure ten recipes of contacts and those of six fabrics on each engine, and write their tables in `docs/recipes.md`.

    python scripts/build_recipes.py                   all engines of recipes that are installed
    python scripts/build_recipes.py mujoco rapier     these alone; the other tables stay
    python scripts/build_recipes.py --write-only      the tables of what is measured so far

Each recipe is kept in `results/recipes` as soon as it is measured, and is not measured again with the same versions. So
the script goes on where it stopped, and engines of other environments are added there. Wall times are those of the
machine that runs the script, without the import of the engine.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from gauge_envs.errors import MissingExtraError
from gauge_envs.experiments.task_files import fabrics
from gauge_envs.files import write_whole
from gauge_envs.tools.recipes import Aim, engine_names, engine_settings, find_recipe
from gauge_envs.tools.recipes.fabrics import FABRIC_ENGINES, NOT_SIMULATED, NOTHING_LOST, fabric_recipe

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "recipes.md"
RECORDS = ROOT / "results" / "recipes"

Record = dict[str, Any]

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

FABRIC_HEAD = (
    "| fabric | stretch [N/m] | reached | bend [uN m] | reached | bending length [mm] | reached | wall [s] |\n"
    "| --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: |\n"
)

HEAD = (
    "| friction | reached | restitution | reached | single drops | mass [kg] | step [s] | hop [mm] | depth [mm] "
    "| creep [mm/s] | wall [s] |\n"
    "| ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: |\n"
)


def begin(kind: str) -> str:
    """Return the line of the page above a table."""
    return f"<!-- {kind}, written by scripts/build_recipes.py -->"


def end(kind: str) -> str:
    """Return the line of the page below a table."""
    return f"<!-- end of {kind.removeprefix('recipes of ')} -->"


def records(kind: str) -> list[Record]:
    """Return what was measured of a kind of recipe, the last measurement last."""
    path = RECORDS / f"{kind.replace(' ', '-')}.jsonl"
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()] if path.exists() else []


def measure(kind: str, key: str, asked: Any, versions: dict[str, str], recipe: Callable[[], Record]) -> None:
    """Measure a recipe, unless it was measured with these versions, and keep it.

    Args:
        kind: Kind of recipe.
        key: Key of the record that tells recipes of a kind apart.
        asked: Its value.
        versions: Versions of the engine.
        recipe: Measures the recipe.
    """
    if any(one[key] == asked and one["versions"] == versions for one in records(kind)):
        return
    found = recipe()
    path = RECORDS / f"{kind.replace(' ', '-')}.jsonl"
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a", encoding="utf-8") as file:
        file.write(json.dumps(found) + "\n")
    print(kind, found["asked"], found["reached"], f"{found['wall_s']:.1f} s", file=sys.stderr, flush=True)


def row(record: Record) -> str:
    """Return the recipe of a contact as a row; a value that is missed is bold."""
    asked, reached, detail = record["asked"], record["reached"], record["detail"]
    start = f"| {asked['friction']:g} | {{}} | {asked['restitution']:g} | {{}} | {{}} | {asked['mass_kg']:g} | "
    start += f"{asked['timestep_s']:.3g} | "
    if reached["friction"] is None:
        return start.format("-", "-", "-") + f"- | - | - | {record['wall_s']:.1f} |\n"

    def marked(name: str) -> str:
        return f"**{reached[name]:.3f}**" if name in record["misses"] else f"{reached[name]:.3f}"

    drops = f"{detail['restitution_low']:.2f} to {detail['restitution_high']:.2f}"
    # Rounding of single precision has either sign.
    small = (1e3 * value for value in (detail["hop_m"], reached["penetration_m"], reached["creep_m_s"]))
    shown = " | ".join(f"{value:.2g}" if abs(value) >= 5e-5 else "0" for value in small)
    return start.format(marked("friction"), marked("restitution"), drops) + f"{shown} | {record['wall_s']:.1f} |\n"


def fabric_row(record: Record) -> str:
    """Return the recipe of a fabric as a row; a value that is missed is bold."""
    cells = [record["material"]]
    for name, scale in (("stretch_n_per_m", 1.0), ("bend_n_m", 1e6), ("bending_length_m", 1e3)):
        value = record["reached"][name]
        text = "-" if value is None else f"{scale * value:.4g}"
        cells += [f"{scale * record['asked'][name]:.4g}", f"**{text}**" if name in record["misses"] else text]
    return f"| {' | '.join(cells)} | {record['wall_s']:.1f} |\n"


def contact_text(kind: str) -> str | None:
    """Return the table of an engine's contacts with the reasons of its misses; None without a record."""
    found = {json.dumps(one["asked"]): one for one in records(kind)}
    known = [found[key] for key in (json.dumps(dict(aim.asked())) for aim in AIMS) if key in found]
    if not known:
        return None
    reasons = []
    for one in known:
        if one["misses"] or one["reached"]["friction"] is None:
            asked = one["asked"]
            where = f"friction {asked['friction']:g}, restitution {asked['restitution']:g}"
            reasons.append(f"- {where}, step {asked['timestep_s']:.3g} s: {one['explanation']}\n")
    said = "Misses:\n\n" + "".join(reasons) if reasons else "All asked values are reached.\n"
    return written(known, HEAD + "".join(map(row, known)), said, len(AIMS))


def fabric_text(kind: str) -> str | None:
    """Return the table of an engine's fabrics with what its mapping loses; None without a record."""
    found = {one["material"]: one for one in records(kind)}
    known = [found[name] for name in fabrics() if name in found]
    if not known:
        return None
    losses = [f"- {one['material']}: {one['explanation']}\n" for one in known if one["explanation"] != NOTHING_LOST]
    said = "".join(losses) or "All simulated values are within the tolerances, and the mapping loses nothing.\n"
    return written(known, FABRIC_HEAD + "".join(map(fabric_row, known)), said, len(fabrics()))


def written(known: Sequence[Record], table: str, said: str, count: int) -> str:
    """Return a table with the versions of its engine, and how many recipes are not measured."""
    versions = ", ".join(f"{name} {number}" for name, number in known[-1]["versions"].items())
    left = f" {len(known)} of {count} were measured." if len(known) < count else ""
    return f"Measured with {versions}.{left}\n\n{table}\n{said}"


def measure_engine(engine: str) -> None:
    """Measure all requests on an engine that were not measured yet.

    Raises:
        MissingExtraError: The engine is not installed.
    """
    settings = engine_settings(engine)
    versions = settings.backend().versions()
    for aim in AIMS:
        measure(
            f"recipes of {engine}",
            "asked",
            dict(aim.asked()),
            versions,
            lambda aim=aim: find_recipe(settings, aim).json(),  # type: ignore[misc]
        )
    if engine in FABRIC_ENGINES and engine not in NOT_SIMULATED:
        for name, fabric in fabrics().items():
            measure(
                f"fabrics of {engine}",
                "material",
                name,
                versions,
                lambda name=name, fabric=fabric: fabric_recipe(name, fabric, engine).json(),  # type: ignore[misc]
            )


def write(kind: str, text: str | None) -> bool:
    """Write a table in the page, which is read again each time, as others may have been written in between."""
    if text is None:
        return True
    pattern = re.compile(f"{re.escape(begin(kind))}.*?{re.escape(end(kind))}", flags=re.DOTALL)
    new = f"{begin(kind)}\n\n{text}\n{end(kind)}"
    page, count = pattern.subn(lambda _: new, PAGE.read_text(encoding="utf-8"))
    if count != 1:
        print(f"{PAGE}: expected the lines {begin(kind)!r} and {end(kind)!r} once", file=sys.stderr)
        return False
    write_whole(PAGE, page.encode())
    return True


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure the engines of the command line, and write their tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("engines", nargs="*", default=list(engine_names()), metavar="ENGINE")
    parser.add_argument("--write-only", action="store_true", help="write the tables of what is measured so far")
    given = parser.parse_args(arguments)
    for engine in given.engines:
        try:
            if not given.write_only:
                measure_engine(engine)
        except MissingExtraError as error:
            print(f"{engine}: not measured: {error}", file=sys.stderr)
            continue
        contacts, cloth = f"recipes of {engine}", f"fabrics of {engine}"
        if not (write(contacts, contact_text(contacts)) and write(cloth, fabric_text(cloth))):
            return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
