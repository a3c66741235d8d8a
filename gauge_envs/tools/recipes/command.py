"""`gauge recipe`: contact settings of an engine from measured behaviour, and back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gauge_envs.cli.arguments import FormatOption, matching, split_details
from gauge_envs.cli.output import Format, echo, print_document
from gauge_envs.errors import ParameterError

if TYPE_CHECKING:
    from gauge_envs.pages.document import Shown
    from gauge_envs.pages.table import Table
    from gauge_envs.scene.fabrics import Fabric

EXAMPLES = {
    "friction": "0.4",
    "restitution": "0.6",
    "penetration_m": "0.001",
    "stiffness_n_per_m": "10000",
    "damping_n_s_per_m": "10",
    "mass_kg": "0.5",
    "timestep_s": "0.002",
}
"""An example of each number that a recipe may state."""


def recipe(
    words: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[MATERIAL] [NAME=VALUE]...",
            help="Measured pair or fabric, as wood-on-wood or satin; gauge list materials shows them. Numbers: "
            "friction=0.01 to 2; restitution=0 to 1, rebound over impact speed; penetration_m=, largest depth at rest; "
            "stiffness_n_per_m=, weight over depth at rest; damping_n_s_per_m=, beside the stiffness; mass_kg=, of the "
            "body; timestep_s=, of the engine.",
        ),
    ] = None,
    engine: Annotated[
        str | None,
        typer.Option(
            "--backend",
            help="mujoco, mujoco_warp, newton, physx, pybullet, rapier, drake or genesis; isaac for a fabric.",
        ),
    ] = None,
    explain: Annotated[
        str | None,
        typer.Option(metavar="TEXT", help="Contact settings of the engine, as 'solref=0.02 1': report what they give."),
    ] = None,
    form: FormatOption = Format.TEXT,
) -> bool:
    """Give contact settings of an engine for a measured behaviour, and what they reach.

    With --explain, report the behaviour of given settings. The settings are simulated in a slide, a drop, at rest and
    on a slope; those of a fabric in a hanging and in a bending strip. Exit code 1 when the simulation diverges. A value
    that the engine cannot reach is no failure: the nearest one is given, with the reason.
    """
    names, numbers = split_details(words, dict.fromkeys(EXAMPLES, float))
    if len(names) > 1:
        raise ParameterError(f"{' and '.join(names)}: expected one pair of materials or one fabric")
    backend = _given(engine, "--backend", " mujoco")
    if explain is not None:
        _refuse("--explain states the contact itself and goes with mass_kg and timestep_s", names, numbers, "mass_kg")
        return _explain(backend, explain, numbers, form)
    if names and names[0] in _fabrics():
        _refuse("a fabric goes with timestep_s alone", [], numbers)
        return _print_fabric(names[0], backend, numbers.get("timestep_s"), form)
    return _print_recipe(backend, names[0] if names else None, numbers, form)


def _given(value: Any, name: str, example: str) -> Any:
    """Return a value that the request needs."""
    if value is None:
        raise ParameterError(f"{name} is missing: add it, as {name}{example}")
    return value


def _number(numbers: Mapping[str, float], name: str) -> float:
    return float(_given(numbers.get(name), name, f"={EXAMPLES[name]}"))


def _refuse(text: str, names: Sequence[str], numbers: Mapping[str, float], *also: str) -> None:
    """Raise an error if a word is given that does not go with the request."""
    if names or set(numbers) - {"timestep_s", *also}:
        raise ParameterError(f"{text}: leave the others out")


def _print(document: Shown, snippet: str, form: Format) -> None:
    """Print a result, and a snippet as it is: a terminal's width must not wrap or cut what is to be pasted."""
    print_document(document, form)
    if form is not Format.JSON:
        echo(f"\npaste\n{snippet}", nl=False)


def _print_recipe(engine: str, material: str | None, numbers: dict[str, float], form: Format) -> bool:
    from gauge_envs.tools.recipes import FREE_FRICTION, Aim, engine_settings, find_recipe
    from gauge_envs.tools.recipes.materials import find_material
    from gauge_envs.tools.recipes.words import recipe_document

    settings = engine_settings(engine)
    pair = None if material is None else find_material(material, also=_fabrics())
    if pair is not None:
        defaults = {"mass_kg": pair.mass_kg, "friction": pair.friction}
        if "damping_n_s_per_m" not in numbers:
            defaults["restitution"] = pair.restitution
        numbers = {name: value for name, value in defaults.items() if value is not None} | numbers
    if not set(numbers) - {"mass_kg", "timestep_s", "damping_n_s_per_m"}:
        raise ParameterError(
            "nothing is asked: add friction=0.4, restitution=0.6, penetration_m=... or stiffness_n_per_m=..."
        )
    for name in ("mass_kg", "timestep_s"):
        _number(numbers, name)
    aim = Aim(**({"friction": FREE_FRICTION} | numbers), is_friction_asked="friction" in numbers)
    found = find_recipe(settings, aim)
    _print(recipe_document(found, pair), found.settings.snippet(aim.mass_kg), form)
    return found.found is None


def _explain(engine: str, text: str, numbers: Mapping[str, float], form: Format) -> bool:
    from gauge_envs.tools.recipes import engine_settings
    from gauge_envs.tools.recipes.explain import explain, parsed_contact
    from gauge_envs.tools.recipes.words import meaning_document

    step_s = _number(numbers, "timestep_s")
    if not step_s > 0.0:
        raise ParameterError(f"timestep_s {step_s:g}: expected a positive number")
    meaning = explain(parsed_contact(engine_settings(engine), text, step_s), _number(numbers, "mass_kg"))
    _print(meaning_document(meaning), meaning.settings.snippet(meaning.mass_kg), form)
    return meaning.found is None


def _print_fabric(name: str, engine: str, timestep_s: float | None, form: Format) -> bool:
    from gauge_envs.tools.recipes.fabrics import fabric_recipe, fabric_snippet
    from gauge_envs.tools.recipes.words import fabric_document

    found = fabric_recipe(name, _fabrics()[name], engine, timestep_s)
    _print(fabric_document(found), fabric_snippet(found.mapped), form)
    return bool(found.faults and found.versions)


def _fabrics() -> Mapping[str, Fabric]:
    from gauge_envs.experiments.fabrics import fabrics

    return fabrics()


def recipe_fabrics(form: FormatOption = Format.TEXT) -> None:
    """Show the six fabrics in every engine's constants, and what is lost.

    Each has the stiffness that its constants give.
    """
    from gauge_envs.tools.recipes.words import constants_document

    print_document(constants_document(_fabrics()), form)


def list_materials(patterns: Sequence[str]) -> list[Table]:
    """Return the tables of the measured pairs and fabrics."""
    from gauge_envs.tools.recipes.materials import material_pairs
    from gauge_envs.tools.recipes.words import fabric_table, material_table

    return matching([material_table(material_pairs()), fabric_table(_fabrics())], patterns, kind="material")
