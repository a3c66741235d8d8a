"""`gauge recipe`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gauge_envs.cli import arguments
from gauge_envs.cli.output import Format, echo, print_document
from gauge_envs.errors import ParameterError
from gauge_envs.tools.recipes.fabrics_command import known_fabrics

if TYPE_CHECKING:
    from gauge_envs.pages.document import Shown


TIMESTEP = "--set timestep_s=0.002"


def _asked(option: str, unit: str, text: str) -> Any:
    return arguments.measured(option, unit, text, arguments.SCENE, show_default=False)


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
        float | None,
        arguments.measured(
            "--mass",
            "kg",
            "Mass of the body.",
            arguments.SCENE,
            show_default="that of the pair",
        ),
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
    backend = _given(engine, "--backend", "--backend mujoco")
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
    numbers = behaviour | _timestep(changes)
    if mass_kg is not None:
        numbers["mass_kg"] = mass_kg
    if explain is not None:
        if material or behaviour:
            raise ParameterError(
                f"--explain states the contact itself and goes with --mass and {TIMESTEP}: leave the others out"
            )
        return _explain(backend, explain, numbers, form)
    if material in known_fabrics():
        if behaviour or "mass_kg" in numbers:
            raise ParameterError(
                f"a fabric goes with {TIMESTEP} alone: leave the others out"
            )
        return _print_fabric(str(material), backend, numbers.get("timestep_s"), form)
    return _print_recipe(backend, material, numbers, form)


def _timestep(changes: Sequence[str] | None) -> dict[str, float]:
    """Return the time step [s] of `--set`, the only setting that a recipe does not find itself."""
    settings = arguments.parsed_settings(changes) or {}
    for name, value in settings.items():
        if name != "timestep_s" or isinstance(value, bool | str):
            raise ParameterError(
                f"--set {name}={value}: a recipe takes the time step alone, as {TIMESTEP}"
            )
    return settings


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
    pair = None if material is None else find_material(material, also=known_fabrics())
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
    if not numbers.keys() - {"damping_n_s_per_m", "mass_kg", "timestep_s"}:
        raise ParameterError(
            "nothing is asked: add --friction 0.4, --restitution 0.6, --penetration or --stiffness"
        )
    _given(numbers.get("mass_kg"), "--mass", "--mass 0.5")
    _given(numbers.get("timestep_s"), "the time step", TIMESTEP)
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

    step_s = _given(numbers.get("timestep_s"), "the time step", TIMESTEP)
    if not step_s > 0.0:
        raise ParameterError(f"timestep_s {step_s:g}: expected a positive number")
    mass_kg = _given(numbers.get("mass_kg"), "--mass", "--mass 2")
    meaning = explain(parsed_contact(engine_settings(engine), text, step_s), mass_kg)
    _print(meaning_document(meaning), meaning.settings.snippet(meaning.mass_kg), form)
    return meaning.found is None


def _print_fabric(
    name: str, engine: str, timestep_s: float | None, form: Format
) -> bool:
    from gauge_envs.tools.recipes.fabrics import fabric_recipe, fabric_snippet
    from gauge_envs.tools.recipes.words import fabric_document

    found = fabric_recipe(name, known_fabrics()[name], engine, timestep_s)
    _print(fabric_document(found), fabric_snippet(found.mapped), form)
    return bool(found.faults and found.versions)
