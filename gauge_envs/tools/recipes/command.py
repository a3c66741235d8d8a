"""Command that turns measured behaviour into contact settings of an engine, and back."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, TypeVar

import typer

from gauge_envs.cli.arguments import Json
from gauge_envs.cli.output import EXIT_FAILED, echo, print_json_lines, print_table, stdout_console
from gauge_envs.errors import ParameterError

if TYPE_CHECKING:
    from gauge_envs.scene.fabrics import Fabric


T = TypeVar("T")


def recipe(
    engine: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="mujoco, mujoco_warp, newton, physx, pybullet, rapier, drake or genesis."),
    ] = None,
    friction: Annotated[float | None, typer.Option(help="Coefficient of friction, 0.01 to 2.")] = None,
    restitution: Annotated[float | None, typer.Option(help="Rebound over impact speed, 0 to 1.")] = None,
    penetration: Annotated[float | None, typer.Option(help="Largest depth at rest in m.")] = None,
    stiffness: Annotated[float | None, typer.Option(help="Weight over depth at rest [N/m].")] = None,
    damping: Annotated[float | None, typer.Option(help="Damping beside the stiffness [N s/m].")] = None,
    mass: Annotated[float | None, typer.Option(help="Mass of the body in kg.")] = None,
    timestep: Annotated[float | None, typer.Option(help="Time step of the engine in s.")] = None,
    explain: Annotated[
        str | None,
        typer.Option(metavar="TEXT", help="Contact settings of the engine, as 'solref=0.02 1': report what they give."),
    ] = None,
    material: Annotated[
        str | None, typer.Option(metavar="NAME", help="Measured pair or fabric, as wood-on-wood or satin.")
    ] = None,
    list_materials: Annotated[bool, typer.Option("--list-materials", help="List the pairs and fabrics.")] = False,
    json_lines: Json = False,
) -> None:
    """Give contact settings of an engine for a measured behaviour, and the values that they reach in simulation.

    With --explain, report the behaviour of given settings. The settings are simulated in a slide, a drop, at rest and
    on a slope; those of a fabric in a hanging and in a bending strip. Exit code 1 when the simulation diverges. A value
    that the engine cannot reach is no failure: the nearest one is given, with the reason.
    """
    behaviour = (friction, restitution, penetration, stiffness, damping)
    if list_materials:
        _list_materials(json_lines)
    elif explain is not None:
        _refuse("--explain states the contact itself and goes with --mass and --timestep", *behaviour, material)
        _explain(_given(engine, "engine", "mujoco"), explain, mass, timestep, json_lines)
    elif material is not None and material in _fabrics():
        _refuse("a fabric goes with --engine, --timestep and --json", *behaviour, mass)
        _print_fabric(material, _given(engine, "engine", "newton"), timestep, json_lines)
    else:
        _print_recipe(_given(engine, "engine", "mujoco"), behaviour, mass, timestep, material, json_lines)


def _print_snippet(snippet: str) -> None:
    """Print a snippet as it is: a terminal's width must not wrap or cut what is to be pasted."""
    echo(f"\npaste\n{snippet}", nl=False)


def _refuse(text: str, *values: object) -> None:
    """Raise an error if an option is given that does not go with another one."""
    if any(value is not None for value in values):
        raise ParameterError(f"{text}: leave the other options out")


def _print_recipe(
    engine: str,
    behaviour: tuple[float | None, ...],
    mass: float | None,
    timestep: float | None,
    material: str | None,
    json_lines: bool,
) -> None:
    from gauge_envs.tools.recipes import FREE_FRICTION, Aim, engine_settings, find_recipe
    from gauge_envs.tools.recipes.materials import find_material
    from gauge_envs.tools.recipes.words import material_table, recipe_view

    settings = engine_settings(engine)
    friction, restitution, penetration, stiffness, damping = behaviour
    pair = None if material is None else find_material(material, also=_fabrics())
    if pair is not None:
        mass = pair.mass_kg if mass is None else mass
        friction = pair.friction if friction is None else friction
        if restitution is None and damping is None:
            restitution = pair.restitution
    if all(value is None for value in (friction, restitution, penetration, stiffness)):
        raise ParameterError("nothing is asked: add --friction 0.4, --restitution 0.6, --penetration or --stiffness")
    aim = Aim(
        friction=FREE_FRICTION if friction is None else friction,
        is_friction_asked=friction is not None,
        restitution=restitution,
        penetration_m=penetration,
        stiffness_n_per_m=stiffness,
        damping_n_s_per_m=damping,
        mass_kg=_given(mass, "mass", "0.5"),
        timestep_s=_given(timestep, "timestep", "0.002"),
    )
    found = find_recipe(settings, aim)
    if json_lines:
        print_json_lines([found.json() | ({} if pair is None else {"material": dict(vars(pair))})])
    else:
        if pair is not None:
            print_table(material_table((pair,)), json_lines=False)
        stdout_console().print(recipe_view(found))
        _print_snippet(found.settings.snippet(aim.mass_kg))
    if found.found is None:
        raise typer.Exit(EXIT_FAILED)


def _explain(engine: str, text: str, mass: float | None, timestep: float | None, json_lines: bool) -> None:
    from gauge_envs.tools.recipes import engine_settings
    from gauge_envs.tools.recipes.explain import explain, parsed_contact
    from gauge_envs.tools.recipes.words import meaning_view

    step_s = _given(timestep, "timestep", "0.002")
    if not step_s > 0.0:
        raise ParameterError(f"timestep {step_s:g} s: expected a positive number")
    meaning = explain(parsed_contact(engine_settings(engine), text, step_s), _given(mass, "mass", "2"))
    if json_lines:
        print_json_lines([meaning.json()])
    else:
        stdout_console().print(meaning_view(meaning))
        _print_snippet(meaning.settings.snippet(meaning.mass_kg))
    if meaning.found is None:
        raise typer.Exit(EXIT_FAILED)


def _list_materials(json_lines: bool) -> None:
    from gauge_envs.tools.recipes.materials import material_pairs
    from gauge_envs.tools.recipes.words import fabric_table, material_table

    print_table(material_table(material_pairs()), json_lines=json_lines)
    print_table(fabric_table(_fabrics()), json_lines=json_lines)


def _fabrics() -> Mapping[str, Fabric]:
    from gauge_envs.experiments.task_files import fabrics

    return fabrics()


def _print_fabric(name: str, engine: str, timestep: float | None, json_lines: bool) -> None:
    from gauge_envs.tools.recipes.fabrics import fabric_recipe, fabric_snippet
    from gauge_envs.tools.recipes.words import fabric_view

    found = fabric_recipe(name, _fabrics()[name], engine, timestep)
    if json_lines:
        print_json_lines([found.json()])
    else:
        stdout_console().print(fabric_view(found))
        _print_snippet(fabric_snippet(found.mapped))
    if found.faults and found.versions:
        raise typer.Exit(EXIT_FAILED)


def _given(value: T | None, name: str, example: str) -> T:
    """Return the value of an option that the request needs."""
    if value is None:
        raise ParameterError(f"--{name} is missing: add it, as --{name} {example}")
    return value
