"""Measure ten recipes of contacts and those of six fabrics on each engine: `studies/recipes/`, and `docs/recipes.md`.

Each recipe is kept in `results/recipes` as soon as it is measured, and is not measured again with the same versions. So
the script goes on where it stopped, and engines of other environments are added there. Wall times are those of the
machine that runs the script, without the import of the engine.
"""

from __future__ import annotations

import csv
import io
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from gauge_envs.backends.registry import backend_class
from gauge_envs.errors import MissingExtraError
from gauge_envs.experiments.task_files import fabrics
from gauge_envs.files import write_whole
from gauge_envs.tools.recipes import Aim, engine_names, engine_settings, find_recipe
from gauge_envs.tools.recipes.fabrics import NOTHING_LOST, fabric_recipe
from scripts.generated import (
    ROOT,
    SCORING,
    Request,
    markdown_table,
    page_part,
    read_rows,
    stale_note,
)

PAGE = ROOT / "docs" / "recipes.md"
STUDY = ROOT / "studies" / "recipes"
RECORDS = ROOT / "results" / "recipes"
SCRIPT = f"scripts/{Path(__file__).name}"

Record = dict[str, Any]

CONTACT_COLUMNS = (
    "friction",
    "friction set",
    "friction reached",
    "friction hopping",
    "single plates",
    "restitution",
)
CONTACT_COLUMNS += (
    "restitution reached",
    "single drops",
    "mass [kg]",
    "step [s]",
    "hop [mm]",
    "depth [mm]",
)
CONTACT_COLUMNS += ("creep [mm/s]", "wall [s]", "missed", "explanation")

FABRIC_COLUMNS = (
    "fabric",
    "stretch [N/m]",
    "stretch reached",
    "bend [uN m]",
    "bend reached",
    "bending length [mm]",
)
FABRIC_COLUMNS += ("bending length reached", "wall [s]", "missed", "explanation")

COLUMNS = {
    "contacts": ("engine", "versions", *CONTACT_COLUMNS),
    "fabrics": ("engine", "versions", *FABRIC_COLUMNS),
}
"""Columns of the tables of the study."""

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


def records(kind: str) -> list[Record]:
    """Return what was measured of a kind of recipe, the last measurement last."""
    path = RECORDS / f"{kind.replace(' ', '-')}.jsonl"
    return (
        [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
        if path.exists()
        else []
    )


def keep(
    kind: str,
    key: str,
    asked: Any,
    versions: dict[str, str],
    recipe: Callable[[], Record],
) -> None:
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
    print(
        kind,
        found["asked"],
        found["reached"],
        f"{found['wall_s']:.1f} s",
        file=sys.stderr,
        flush=True,
    )


def contact_row(record: Record) -> list[str]:
    """Return the cells of a contact; values that were not found are `-`."""
    asked, reached, detail = record["asked"], record["reached"], record["detail"]
    friction, hopping, plates, restitution, drops, small = (
        "-",
        "-",
        "-",
        "-",
        "-",
        ["-", "-", "-"],
    )
    if reached["friction"] is not None:
        friction, restitution = (
            f"{reached['friction']:.4f}",
            f"{reached['restitution']:.3f}",
        )
        hopping = f"{reached['friction_hopping']:.3f}"
        plates = f"{detail['friction_hopping_low']:.3f} to {detail['friction_hopping_high']:.3f}"
        drops = f"{detail['restitution_low']:.2f} to {detail['restitution_high']:.2f}"
        # Rounding of single precision has either sign.
        values = (
            1e3 * value
            for value in (
                detail["hop_m"],
                reached["penetration_m"],
                reached["creep_m_s"],
            )
        )
        small = [f"{value:.2g}" if abs(value) >= 5e-5 else "0" for value in values]
    missed = "all" if friction == "-" else ", ".join(record["misses"])
    stated = f"{record['settings'][engine_settings(record['engine']).friction_field]:g}"
    start = [f"{asked['friction']:g}", stated, friction, hopping, plates]
    start += [f"{asked['restitution']:g}", restitution, drops]
    start += [
        f"{asked['mass_kg']:g}",
        f"{asked['timestep_s']:.3g}",
        *small,
        f"{record['wall_s']:.1f}",
    ]
    return [*start, missed, record["explanation"] if missed else ""]


def fabric_row(record: Record) -> list[str]:
    """Return the cells of a fabric; values that were not found are `-`."""
    cells, missed = [record["material"]], []
    for name, title, scale in (
        ("stretch_n_per_m", "stretch", 1.0),
        ("bend_n_m", "bend", 1e6),
        ("bending_length_m", "bending length", 1e3),
    ):
        value = record["reached"][name]
        cells += [
            f"{scale * record['asked'][name]:.4g}",
            "-" if value is None else f"{scale * value:.4g}",
        ]
        missed += [title] if value is None or name in record["misses"] else []
    lost = "" if record["explanation"] == NOTHING_LOST else record["explanation"]
    return [*cells, f"{record['wall_s']:.1f}", ", ".join(missed), lost]


def rows_of(kind: str, engine: str) -> list[list[str]]:
    """Return the rows of an engine that were measured, in the order of the requests."""
    if kind == "contacts":
        by_asked = {
            json.dumps(one["asked"]): one for one in records(f"recipes of {engine}")
        }
        known = [
            by_asked[key]
            for key in (json.dumps(dict(aim.asked())) for aim in AIMS)
            if key in by_asked
        ]
        cells = [contact_row(one) for one in known]
    else:
        by_name = {one["material"]: one for one in records(f"fabrics of {engine}")}
        known = [
            by_name[name] for name in fabrics("TextileFlinging") if name in by_name
        ]
        cells = [fabric_row(one) for one in known]
    versions = (
        ", ".join(f"{name} {number}" for name, number in known[-1]["versions"].items())
        if known
        else ""
    )
    return [[engine, versions, *row] for row in cells]


def table(kind: str) -> list[dict[str, str]]:
    """Return the rows of a table of the study."""
    return read_rows(STUDY / f"{kind}.csv")


def with_rows(kind: str, engine: str) -> str:
    """Return the text of a table of the study in which the measured rows of an engine take the place of older ones."""
    found = rows_of(kind, engine)
    others = (row for row in table(kind) if row["engine"] != engine or not found)
    kept = [[row.get(name, "") for name in COLUMNS[kind]] for row in others]
    stream = io.StringIO()
    rows = sorted([*kept, *found], key=lambda row: list(engine_names()).index(row[0]))
    csv.writer(stream, lineterminator="\n").writerows([COLUMNS[kind], *rows])
    return stream.getvalue()


def summary() -> str:
    """Return the generated part of the page: how many recipes each engine reached, and what it missed."""
    contacts, cloth = table("contacts"), table("fabrics")
    lines = []
    for engine in dict.fromkeys(row["engine"] for row in contacts):
        cells = [engine]
        for rows in (contacts, cloth):
            of_engine = [row for row in rows if row["engine"] == engine]
            cells.append(
                f"{sum(not row['missed'] for row in of_engine)} of {len(of_engine)}"
                if of_engine
                else ""
            )
        rows = [row for row in contacts if row["engine"] == engine]
        for name, digits in (
            ("friction reached", 2),
            ("friction hopping", 1),
            ("single plates", 1),
        ):
            # A range begins with its smallest value.
            errors = [
                100.0 * (float(row[name].split()[0]) / float(row["friction"]) - 1.0)
                for row in rows
            ]
            cells.append(
                f"{max(errors, key=abs) if digits == 2 else min(errors):+.{digits}f} %"
            )
        walls = [float(row["wall [s]"]) for row in contacts if row["engine"] == engine]
        lines.append([*cells, f"{min(walls):.2g} to {max(walls):.3g}"])
    misses = [
        f"- {row['engine']}, friction {row['friction']}, restitution {row['restitution']}, {row['mass [kg]']} kg, step "
        f"{row['step [s]']} s: friction {row['friction reached']}, restitution {row['restitution reached']}"
        for row in contacts
        if row["missed"]
    ]
    head = ("engine", "contacts within the tolerance", "fabrics within the tolerance")
    head += (
        "friction of bodies that hold, largest error",
        "of plates that hop, lowest mean",
        "lowest plate",
    )
    head += ("wall time of a contact [s]",)
    return "\n".join(
        [
            *stale_note("recipes-data"),
            *markdown_table(head, lines),
            "",
            "Contacts outside the tolerance:",
            "",
            *misses,
        ]
    )


def measure_engine(engine: str) -> None:
    """Measure all requests on an engine that were not measured yet.

    Raises:
        MissingExtraError: The engine is not installed.
    """
    settings = engine_settings(engine)
    versions = settings.backend().versions()
    for aim in AIMS:
        keep(
            f"recipes of {engine}",
            "asked",
            dict(aim.asked()),
            versions,
            lambda aim=aim: find_recipe(settings, aim).json(),  # type: ignore[misc]
        )
    if (
        backend_class(engine).fabric_constants(fabrics("TextileFlinging")["satin"])
        is not None
    ):
        for name, fabric in fabrics("TextileFlinging").items():
            keep(
                f"fabrics of {engine}",
                "material",
                name,
                versions,
                lambda name=name, fabric=fabric: fabric_recipe(
                    name, fabric, engine
                ).json(),  # type: ignore[misc]
            )


def contents(scoring: Path = SCORING) -> dict[Path, str]:
    """Return the page with its generated part replaced."""
    return page_part(PAGE, "recipes", SCRIPT, summary())


def measure(request: Request) -> None:
    """Measure the recipes of engines that are installed; the rows of others stay."""
    for engine in request.engines or engine_names():
        try:
            measure_engine(engine)
        except MissingExtraError as error:
            print(f"{engine}: not measured: {error}", file=sys.stderr)
            continue
        for kind in COLUMNS:
            write_whole(STUDY / f"{kind}.csv", with_rows(kind, engine).encode())
