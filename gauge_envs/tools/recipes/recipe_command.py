"""`gauge recipe`, `gauge recipe fabrics` and `gauge list materials`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gauge_envs.cli import arguments
from gauge_envs.cli.output import Format, Progress, echo, message, print_document
from gauge_envs.errors import ParameterError

if TYPE_CHECKING:
    from gauge_envs.pages.table import Table
    from gauge_envs.scene.fabrics import Fabric
    from gauge_envs.tools.recipes.materials import MaterialPair
    from gauge_envs.tools.recipes.search import Recipe


FABRICS_FAMILY = "TextileFlinging"
"""Family whose task file has the six published fabrics of the benchmark."""

TIMESTEP = "--set timestep_s=0.002"
BODY = {"mass_kg": "--mass 0.5", "timestep_s": TIMESTEP}
"""Example of each required option of contacts, by name."""


def known_fabrics() -> Mapping[str, Fabric]:
    """Return the published fabrics by name."""
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
            help="Pair of gauge list materials, or fabric of gauge recipe fabrics, as satin.",
        ),
    ] = None,
    friction: Annotated[
        float | None, _asked("--friction", "", "Coulomb coefficient, as 0.4.")
    ] = None,
    restitution: Annotated[
        float | None,
        _asked("--restitution", "", "Rebound speed / impact speed, as 0.6."),
    ] = None,
    penetration_m: Annotated[
        float | None, _asked("--penetration", "m", "Largest depth at rest.")
    ] = None,
    stiffness_n_per_m: Annotated[
        float | None, _asked("--stiffness", "N/m", "Weight / depth at rest.")
    ] = None,
    damping_n_s_per_m: Annotated[
        float | None, _asked("--damping", "N s/m", "Damping, with --stiffness.")
    ] = None,
    torsion_m: Annotated[
        float | None,
        _asked("--torsion", "m", "Torque of friction about the normal / normal force."),
    ] = None,
    rolling_m: Annotated[
        float | None,
        _asked("--rolling", "m", "Torque against rolling / normal force."),
    ] = None,
    creep_m_s: Annotated[
        float | None,
        _asked("--creep", "m/s", "Largest speed on a slope of half the friction."),
    ] = None,
    mass_kg: Annotated[
        float | None, _asked("--mass", "kg", "Mass of the body.", "mass of the pair")
    ] = None,
    engine: Annotated[
        str | None,
        arguments.backend("Engine (required); also isaac for a fabric."),
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
            "Settings, as 'solref=0.02 1': report their behaviour.",
            metavar="TEXT",
        ),
    ] = None,
    form: arguments.Form = Format.TEXT,
) -> bool:
    """Find contact settings of an engine for a measured behaviour, and measure what they reach.

    With --explain, report the behaviour of given settings. Contacts are simulated in a slide, a drop, at rest and on a
    slope; fabrics in a hanging and a bending strip. If the engine cannot reach a value, the recipe has the nearest
    value and the reason. Exit code 1: the simulation diverges.
    """
    if engine is None:
        raise ParameterError("--backend is missing: for example --backend mujoco")
    wanted = {
        "friction": friction,
        "restitution": restitution,
        "penetration_m": penetration_m,
        "stiffness_n_per_m": stiffness_n_per_m,
        "damping_n_s_per_m": damping_n_s_per_m,
        "torsion_m": torsion_m,
        "rolling_m": rolling_m,
        "creep_m_s": creep_m_s,
        "mass_kg": mass_kg,
        **_timestep(changes),
    }
    from gauge_envs.tools.recipes.engines import engine_settings
    from gauge_envs.tools.recipes.fabrics import fabric_recipe
    from gauge_envs.tools.recipes.report import recipe_document
    from gauge_envs.tools.recipes.search import explain as explained

    given = {name: value for name, value in wanted.items() if value is not None}
    pair: MaterialPair | str | None = None
    with Progress("simulates", None):
        if explain is not None:
            _check_alone("--explain", [*given, *filter(None, [material])], BODY)
            _check_body(given)
            contact = engine_settings(engine).parsed(explain, given["timestep_s"])
            result = explained(contact, given["mass_kg"])
        elif material in known_fabrics():
            _check_alone("a fabric", given, {"timestep_s": TIMESTEP})
            fabric = known_fabrics()[str(material)]
            pair, result = material, fabric_recipe(fabric, engine, **given)
        else:
            pair, result = _contact(engine, material, given)

    print_document(recipe_document(result, pair), form)
    if form is not Format.JSON:
        # Do not wrap or cut the snippet at the width of the terminal.
        echo(f"\npaste\n{result.snippet}", nl=False)
    return result.diverges


def _timestep(changes: Sequence[str] | None) -> dict[str, float]:
    """Return the time step [s] of `--set`, the only setting that a recipe takes."""
    settings = arguments.parsed_settings(changes) or {}
    for name, value in settings.items():
        if name != "timestep_s" or not isinstance(value, int | float):
            raise ParameterError(
                f"--set {name}={value}: a recipe takes only the time step, for example {TIMESTEP}"
            )
    return settings


def _check_alone(
    subject: str, given: Iterable[str], allowed: Mapping[str, str]
) -> None:
    """Raise an error if a request has options that its subject does not take."""
    if set(given) - allowed.keys():
        raise ParameterError(
            f"{subject} takes only {' and '.join(allowed.values())}: leave out the rest"
        )


def _check_body(given: Mapping[str, float]) -> None:
    """Raise an error if a request lacks the mass or the time step."""
    missing = [example for name, example in BODY.items() if name not in given]
    if missing:
        raise ParameterError(f"the request is incomplete: add {' '.join(missing)}")


def _contact(
    engine: str, material: str | None, given: dict[str, float]
) -> tuple[MaterialPair | None, Recipe]:
    """Return the requested pair of materials, if any, and a recipe for its behaviour or the given behaviour."""
    from gauge_envs.tools.recipes import Aim, engine_settings, find_recipe
    from gauge_envs.tools.recipes.materials import find_material

    settings, pair = engine_settings(engine), None
    if material is not None:
        pair = find_material(material, also=known_fabrics())
        measured = {"mass_kg": pair.mass_kg}
        if pair.friction is not None:
            measured["friction"] = pair.friction
        if "damping_n_s_per_m" not in given:
            measured["restitution"] = pair.restitution
        given = measured | given
    if not given.keys() - {"damping_n_s_per_m", *BODY}:
        raise ParameterError(
            "no behaviour is requested: add --friction 0.4, --restitution 0.6, --penetration or --stiffness"
        )
    _check_body(given)
    return pair, find_recipe(settings, Aim(**given))


def _tested(option: str, unit: str, text: str) -> Any:
    return arguments.measured(
        option, unit, text, arguments.SCENE, is_positive=True, show_default=False
    )


def recipe_fabrics(
    overhang_m: Annotated[
        float | None,
        _tested("--overhang", "m", "Overhang at which a strip droops to 41.5 degrees."),
    ] = None,
    bending_length_m: Annotated[
        float | None,
        _tested("--bending-length", "m", "Half the overhang, in place of it."),
    ] = None,
    stretch_n_per_m: Annotated[
        float | None,
        _tested("--stretch", "N/m", "Slope of force per width over strain."),
    ] = None,
    shear_n_per_m: Annotated[
        float | None,
        _tested("--shear", "N/m", "Slope of force per width over shear strain."),
    ] = None,
    areal_density_kg_per_m2: Annotated[
        float | None, _tested("--mass-per-area", "kg/m2", "Mass per area.")
    ] = None,
    thickness_m: Annotated[
        float | None, _tested("--thickness", "m", "Thickness.")
    ] = None,
    variant: Annotated[
        str | None,
        arguments.experiment("Experiment that --out copies with the tested fabric."),
    ] = None,
    out: Annotated[
        Path | None,
        arguments.target("Task file of the tested fabric (.toml).", show_default=False),
    ] = None,
    form: arguments.Form = Format.TEXT,
) -> None:
    """Show a tested fabric, or the six fabrics, in the constants of every engine.

    The tests are a cantilever (ASTM D1388), a stretched and a sheared strip, a balance and a thickness gauge. Peirce's
    law gives the bending stiffness. With --out, also write the task file of an experiment with the tested fabric.
    """
    from gauge_envs.tools.recipes.fabrics import fabric_of_tests
    from gauge_envs.tools.recipes.report import constants_document, tested_document

    if bool(variant) != bool(out):
        raise ParameterError(
            "a task file needs both: --id StripBending-satin --out denim.toml"
        )

    tests = {
        "--overhang": overhang_m,
        "--stretch": stretch_n_per_m,
        "--shear": shear_n_per_m,
        "--mass-per-area": areal_density_kg_per_m2,
        "--thickness": thickness_m,
    }
    if overhang_m and bending_length_m:
        raise ParameterError("--overhang and --bending-length: give one of the two")
    if bending_length_m:
        tests["--overhang"] = 2.0 * bending_length_m
    given = {name: value for name, value in tests.items() if value is not None}
    if not given and not out:
        print_document(constants_document(known_fabrics()), form)
        return
    missing = [name for name in tests if name not in given]
    if missing:
        raise ParameterError(f"the tests are incomplete: add {', '.join(missing)}")
    fabric = fabric_of_tests(
        bending_length_m=0.5 * given["--overhang"],
        stretch_n_per_m=given["--stretch"],
        shear_n_per_m=given["--shear"],
        areal_density_kg_per_m2=given["--mass-per-area"],
        thickness_m=given["--thickness"],
    )
    print_document(tested_document(fabric), form)
    if variant and out:
        _write_task(variant, fabric, out)


def _write_task(name: str, fabric: Fabric, file: Path) -> None:
    """Write the task file of an experiment with a tested fabric, and say what it has from the published one."""
    from gauge_envs.experiments.task_reader import load_task
    from gauge_envs.experiments.variants import find_variant
    from gauge_envs.pages.document import save_file
    from gauge_envs.tools.recipes.own_task import task_of_fabric

    if file.suffix != ".toml":
        raise ParameterError(f"--out {file}: a task file ends in .toml")
    variant = find_variant(name)
    save_file(file, task_of_fabric(variant, fabric, file))
    own = load_task(file).variants()[0]
    message(f"{file}: {own.name}; its friction is that of {variant.material}")


def list_materials(patterns: Sequence[str]) -> list[Table]:
    """Return the table of the measured pairs."""
    from gauge_envs.tools.recipes.materials import material_pairs
    from gauge_envs.tools.recipes.report import material_table

    tables = [material_table(material_pairs())]
    return arguments.matching(tables, patterns, kind="material")
