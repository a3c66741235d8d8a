"""`gauge recipe`, `gauge recipe fabrics` and `gauge list materials`."""

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


FABRICS_FAMILY = "TextileFlinging"
"""Family whose task file has the six calibrated fabrics of the benchmark; other families repeat its constants."""

TIMESTEP = "--set timestep_s=0.002"


def known_fabrics() -> Mapping[str, Fabric]:
    """Return the calibrated fabrics by name."""
    from gauge_envs.experiments.task_files import fabrics

    return fabrics(FABRICS_FAMILY)


def _asked(option: str, unit: str, text: str, default: bool | str = False) -> Any:
    return arguments.measured(option, unit, text, arguments.SCENE, show_default=default)


def recipe(
    material: Annotated[
        str | None,
        typer.Argument(
            metavar="MATERIAL",
            show_default=False,
            help="Pair or fabric, as satin; see gauge list materials.",
        ),
    ] = None,
    friction: Annotated[
        float | None, _asked("--friction", "", "Coulomb coefficient, as 0.4.")
    ] = None,
    restitution: Annotated[
        float | None,
        _asked("--restitution", "", "Rebound over impact speed, as 0.6."),
    ] = None,
    penetration_m: Annotated[
        float | None, _asked("--penetration", "m", "Largest depth at rest.")
    ] = None,
    stiffness_n_per_m: Annotated[
        float | None, _asked("--stiffness", "N/m", "Weight over depth at rest.")
    ] = None,
    damping_n_s_per_m: Annotated[
        float | None, _asked("--damping", "N s/m", "Damping beside the stiffness.")
    ] = None,
    torsion_m: Annotated[
        float | None,
        _asked(
            "--torsion", "m", "Torque of friction about the normal over normal force."
        ),
    ] = None,
    rolling_m: Annotated[
        float | None,
        _asked("--rolling", "m", "Torque against rolling over normal force."),
    ] = None,
    creep_m_s: Annotated[
        float | None,
        _asked("--creep", "m/s", "Largest speed on a slope of half the friction."),
    ] = None,
    mass_kg: Annotated[
        float | None, _asked("--mass", "kg", "Mass of the body.", "that of the pair")
    ] = None,
    engine: Annotated[
        str | None,
        arguments.backend("Engine, which must be given; also isaac for a fabric."),
    ] = None,
    changes: Annotated[
        list[str] | None,
        arguments.option(
            arguments.NUMERICS,
            "Time step of the engine in s, as timestep_s=0.002.",
            "--set",
            metavar=arguments.ASSIGNED,
        ),
    ] = None,
    explain: Annotated[
        str | None,
        arguments.option(
            arguments.SELECTION,
            "Settings, as 'solref=0.02 1': report what they give.",
            metavar="TEXT",
        ),
    ] = None,
    form: arguments.Form = Format.TEXT,
) -> bool:
    """Give contact settings of an engine for a measured behaviour, and what they reach.

    With --explain, report the behaviour of given settings. The settings are simulated in a slide, a drop, at rest and
    on a slope; those of a fabric in a hanging and in a bending strip. Exit code 1 when the simulation diverges. A value
    that the engine cannot reach is no failure: the nearest one is given, with the reason.
    """
    if engine is None:
        raise ParameterError("--backend is missing: add it, as --backend mujoco")
    wanted = {
        "friction": friction,
        "restitution": restitution,
        "penetration_m": penetration_m,
        "stiffness_n_per_m": stiffness_n_per_m,
        "damping_n_s_per_m": damping_n_s_per_m,
        "torsion_m": torsion_m,
        "rolling_m": rolling_m,
        "creep_m_s": creep_m_s,
    }
    behaviour = {name: value for name, value in wanted.items() if value is not None}
    timestep_s = _timestep_s(changes)
    if explain is not None:
        if material or behaviour:
            raise ParameterError(
                f"--explain goes with --mass and {TIMESTEP}: leave the others out"
            )
        return _explain(engine, explain, mass_kg, timestep_s, form)
    if material in known_fabrics():
        if behaviour or mass_kg is not None:
            raise ParameterError(
                f"a fabric goes with {TIMESTEP} alone: leave the others out"
            )
        return _print_fabric(str(material), engine, timestep_s, form)
    return _print_recipe(engine, material, behaviour, mass_kg, timestep_s, form)


def _timestep_s(changes: Sequence[str] | None) -> float | None:
    """Return the time step [s] of `--set`, the only setting that a recipe does not find itself."""
    timestep_s = None
    for name, value in (arguments.parsed_settings(changes) or {}).items():
        if name != "timestep_s" or not isinstance(value, int | float):
            raise ParameterError(
                f"--set {name}={value}: a recipe takes the time step alone, as {TIMESTEP}"
            )
        timestep_s = value
    return timestep_s


def _given(value: float | None, example: str) -> float:
    """Return a value that the request needs."""
    if value is None:
        raise ParameterError(f"the request is incomplete: add {example}")
    return value


def _print(document: Shown, snippet: str, form: Format) -> None:
    """Print a result, and a snippet as it is: a terminal's width must not wrap or cut what is to be pasted."""
    print_document(document, form)
    if form is not Format.JSON:
        echo(f"\npaste\n{snippet}", nl=False)


def _print_recipe(
    engine: str,
    material: str | None,
    behaviour: dict[str, float],
    mass_kg: float | None,
    timestep_s: float | None,
    form: Format,
) -> bool:
    from gauge_envs.tools.recipes import Aim, engine_settings, find_recipe
    from gauge_envs.tools.recipes.materials import find_material
    from gauge_envs.tools.recipes.report import recipe_document

    settings, pair = engine_settings(engine), None
    if material is not None:
        pair = find_material(material, also=known_fabrics())
        mass_kg = pair.mass_kg if mass_kg is None else mass_kg
        if pair.friction is not None:
            behaviour = {"friction": pair.friction, **behaviour}
        if "damping_n_s_per_m" not in behaviour:
            behaviour = {"restitution": pair.restitution, **behaviour}
    if not behaviour.keys() - {"damping_n_s_per_m"}:
        raise ParameterError(
            "nothing is asked: add --friction 0.4, --restitution 0.6, --penetration or --stiffness"
        )
    aim = Aim(
        **behaviour,
        mass_kg=_given(mass_kg, "--mass 0.5"),
        timestep_s=_given(timestep_s, TIMESTEP),
    )
    result = find_recipe(settings, aim)
    _print(recipe_document(result, pair), result.snippet, form)
    return not result.detail


def _explain(
    engine: str,
    text: str,
    mass_kg: float | None,
    timestep_s: float | None,
    form: Format,
) -> bool:
    from gauge_envs.tools.recipes import engine_settings
    from gauge_envs.tools.recipes.explain import explain, parsed_contact
    from gauge_envs.tools.recipes.report import meaning_document

    step_s, body_kg = _given(timestep_s, TIMESTEP), _given(mass_kg, "--mass 2")
    meaning = explain(parsed_contact(engine_settings(engine), text, step_s), body_kg)
    _print(meaning_document(meaning), meaning.snippet, form)
    return meaning.reached["friction"] is None


def _print_fabric(
    name: str, engine: str, timestep_s: float | None, form: Format
) -> bool:
    from gauge_envs.tools.recipes.fabrics import fabric_recipe
    from gauge_envs.tools.recipes.report import recipe_document

    result = fabric_recipe(name, known_fabrics()[name], engine, timestep_s)
    _print(recipe_document(result, name), result.snippet, form)
    reached = result.reached
    is_incomplete = None in (reached["stretch_n_per_m"], reached["bend_n_m"])
    return bool(result.versions) and is_incomplete


def recipe_fabrics(form: arguments.Form = Format.TEXT) -> None:
    """Show the six fabrics in every engine's constants, and what is lost.

    Each has the stiffness that its constants give.
    """
    from gauge_envs.tools.recipes.report import constants_document

    print_document(constants_document(known_fabrics()), form)


def list_materials(patterns: Sequence[str]) -> list[Table]:
    """Return the tables of the measured pairs and fabrics."""
    from gauge_envs.tools.recipes.materials import material_pairs, published_pairs
    from gauge_envs.tools.recipes.report import (
        fabric_table,
        material_table,
        published_table,
    )

    tables = [
        material_table(material_pairs()),
        published_table(published_pairs()),
        fabric_table(known_fabrics()),
    ]
    return arguments.matching(tables, patterns, kind="material")
