"""`gauge recipe`: contact settings of an engine from measured behaviour, and back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gauge_envs.cli import arguments
from gauge_envs.cli.output import Format, echo, print_document
from gauge_envs.errors import ParameterError

if TYPE_CHECKING:
    from gauge_envs.pages.document import Shown
    from gauge_envs.pages.table import Table
    from gauge_envs.scene.fabrics import Fabric

HELD = ("torsion_m", "rolling_m", "creep_m_s")

BEHAVIOUR = (
    *HELD,
    "friction",
    "restitution",
    "penetration_m",
    "stiffness_n_per_m",
    "damping_n_s_per_m",
)

NUMBERS = (*BEHAVIOUR, "mass_kg", "timestep_s")


FABRICS_FAMILY = "TextileFlinging"
"""Family whose task file has the six calibrated fabrics of the benchmark; other families repeat its constants."""


def recipe(
    words: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[MATERIAL] [NAME=VALUE]...",
            help="Pair or fabric, as satin; see gauge list materials.",
        ),
    ] = None,
    engine: Annotated[
        str | None,
        typer.Option(
            "--backend", help="Engine; also mujoco_warp, and isaac for a fabric."
        ),
    ] = None,
    explain: Annotated[
        str | None,
        typer.Option(
            metavar="TEXT", help="Settings, as 'solref=0.02 1': report what they give."
        ),
    ] = None,
    form: arguments.Form = Format.TEXT,
) -> bool:
    """Give contact settings of an engine for a measured behaviour, and what they reach.

    Details: friction=0.4; restitution=0.6, rebound over impact speed; penetration_m=, largest depth at rest;
    stiffness_n_per_m=, weight over depth at rest; damping_n_s_per_m=, beside the stiffness; torsion_m= and rolling_m=,
    torque over normal force; creep_m_s=, largest creep; mass_kg=0.5, of the body; timestep_s=0.002, of the engine.

    With --explain, report the behaviour of given settings. The settings are simulated in a slide, a drop, at rest and
    on a slope; those of a fabric in a hanging and in a bending strip. Exit code 1 when the simulation diverges. A value
    that the engine cannot reach is no failure: the nearest one is given, with the reason.
    """
    names, numbers = arguments.split_details(words, **dict.fromkeys(NUMBERS, float))
    if len(names) > 1:
        raise ParameterError(
            f"{' and '.join(names)}: expected one pair of materials or one fabric"
        )
    backend = _given(engine, "--backend", "--backend mujoco")
    material = names[0] if names else None
    behaviour = [name for name in BEHAVIOUR if name in numbers]
    if explain is not None:
        if names or behaviour:
            raise ParameterError(
                "--explain states the contact itself and goes with mass_kg and timestep_s: leave the others out"
            )
        return _explain(backend, explain, numbers, form)
    if material in _fabrics():
        if behaviour or "mass_kg" in numbers:
            raise ParameterError(
                "a fabric goes with timestep_s alone: leave the others out"
            )
        return _print_fabric(str(material), backend, numbers.get("timestep_s"), form)
    return _print_recipe(backend, material, numbers, form)


def _given(value: Any, name: str, example: str) -> Any:
    """Return a value that the request needs."""
    if value is None:
        raise ParameterError(f"{name} is missing: add it, as {example}")
    return value


def _print(document: Shown, snippet: str, form: Format) -> None:
    """Print a result, and a snippet as it is: a terminal's width must not wrap or cut what is to be pasted."""
    print_document(document, form)
    if form is not Format.JSON:
        echo(f"\npaste\n{snippet}", nl=False)


def _print_recipe(
    engine: str, material: str | None, numbers: dict[str, float], form: Format
) -> bool:
    from gauge_envs.tools.recipes import (
        FREE_FRICTION,
        Aim,
        engine_settings,
        find_recipe,
    )
    from gauge_envs.tools.recipes.materials import find_material
    from gauge_envs.tools.recipes.words import recipe_document

    settings = engine_settings(engine)
    pair = None if material is None else find_material(material, also=_fabrics())
    if pair is not None:
        measured = {
            "mass_kg": pair.mass_kg,
            "friction": pair.friction,
            "restitution": pair.restitution,
        }
        if "damping_n_s_per_m" in numbers:
            del measured["restitution"]
        numbers = {
            name: value for name, value in measured.items() if value is not None
        } | numbers
    if not any(name in numbers for name in BEHAVIOUR[:-1]):
        raise ParameterError(
            "nothing is asked: add friction=0.4, restitution=0.6, penetration_m= or stiffness_n_per_m"
        )
    _given(numbers.get("mass_kg"), "mass_kg", "mass_kg=0.5")
    _given(numbers.get("timestep_s"), "timestep_s", "timestep_s=0.002")
    aim = Aim(
        **({"friction": FREE_FRICTION} | numbers),
        is_friction_asked="friction" in numbers,
    )
    found = find_recipe(settings, aim)
    _print(recipe_document(found, pair), found.snippet, form)
    return found.found is None


def _explain(
    engine: str, text: str, numbers: Mapping[str, float], form: Format
) -> bool:
    from gauge_envs.tools.recipes import engine_settings
    from gauge_envs.tools.recipes.explain import explain, parsed_contact
    from gauge_envs.tools.recipes.words import meaning_document

    step_s = _given(numbers.get("timestep_s"), "timestep_s", "timestep_s=0.002")
    if not step_s > 0.0:
        raise ParameterError(f"timestep_s {step_s:g}: expected a positive number")
    mass_kg = _given(numbers.get("mass_kg"), "mass_kg", "mass_kg=2")
    meaning = explain(parsed_contact(engine_settings(engine), text, step_s), mass_kg)
    _print(meaning_document(meaning), meaning.settings.snippet(meaning.mass_kg), form)
    return meaning.found is None


def _print_fabric(
    name: str, engine: str, timestep_s: float | None, form: Format
) -> bool:
    from gauge_envs.tools.recipes.fabrics import fabric_recipe, fabric_snippet
    from gauge_envs.tools.recipes.words import fabric_document

    found = fabric_recipe(name, _fabrics()[name], engine, timestep_s)
    _print(fabric_document(found), fabric_snippet(found.mapped), form)
    return bool(found.faults and found.versions)


def _fabrics() -> Mapping[str, Fabric]:
    from gauge_envs.experiments.task_files import fabrics

    return fabrics(FABRICS_FAMILY)


def recipe_fabrics(form: arguments.Form = Format.TEXT) -> None:
    """Show the six fabrics in every engine's constants, and what is lost.

    Each has the stiffness that its constants give.
    """
    from gauge_envs.tools.recipes.words import constants_document

    print_document(constants_document(_fabrics()), form)


def list_materials(patterns: Sequence[str]) -> list[Table]:
    """Return the tables of the measured pairs and fabrics."""
    from gauge_envs.tools.recipes.materials import material_pairs, published_pairs
    from gauge_envs.tools.recipes.words import (
        fabric_table,
        material_table,
        published_table,
    )

    tables = [
        material_table(material_pairs()),
        published_table(published_pairs()),
        fabric_table(_fabrics()),
    ]
    return arguments.matching(tables, patterns, kind="material")
