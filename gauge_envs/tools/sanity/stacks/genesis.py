"""Genesis: a `gs.Scene` in this process, or its saved options, `scene.options.model_dump_json()`.

Changes are arguments of a scene, such as `rigid_options=gs.options.RigidOptions(iterations=100)`, and columns of the
solver's `sol_params` for constants of contacts.
"""

from pathlib import Path
from typing import Any

from gauge_envs.errors import first_names
from gauge_envs.files import MEGABYTE, json_document
from gauge_envs.tools.sanity.gauge_probe import is_of
from gauge_envs.tools.sanity.model import (
    ContactGroup,
    Need,
    Settings,
    TrainingConfiguration,
)
from gauge_envs.tools.sanity.scenario import check_settings
from gauge_envs.tools.sanity.stacks.dialect import (
    Dialect,
    Kind,
    Place,
    Setting,
    python_text,
)
from gauge_envs.tools.sanity.stacks.documents import Table, file_value
from gauge_envs.tools.sanity.stacks.reader import Reader, named_content


def _choice(*names: str) -> Kind:
    """Return a choice that a file states by its number, and a program by a constant of Genesis."""

    def read(table: Table, key: str) -> str | None:
        value = table.value(key)
        return (
            value
            if value is None or isinstance(value, str)
            else dict(enumerate(names)).get(table.whole(key) or 0)
        )

    return Kind(read, str)


VALUE, SWITCH = Kind(Table.value), Kind(lambda table, key: bool(table.value(key)))

INTEGRATORS = _choice("Euler", "implicitfast", "approximate_implicitfast")

CONSTANT, CONSTANTS = (
    "sol_params[:, {key}] = {value}",
    "sol_params[:, {key}] = torch.tensor({value})",
)
"""Assignments of one column and of several columns of the solver's constants."""


def _option(
    name: str, kind: Kind = VALUE, *, key: str = "", default: Any = None
) -> Setting:
    """Return an argument of `RigidOptions` with the documented default of Genesis 1.4.5."""
    pattern = "{key}=gs.{key}.{value}" if kind.text is str else ""
    return Setting(name, "rigid", key or name, kind, pattern, default=default)


GENESIS = Dialect(
    name="genesis",
    settings=(
        Setting("precision", "init", "precision", pattern='{key}="{value}"'),
        Setting("timestep_s", "sim", "dt"),
        _option("integrator", INTEGRATORS, default="approximate_implicitfast"),
        _option("constraint_solver", _choice("CG", "Newton"), default="Newton"),
        _option("friction_cone", _choice("pyramidal", "elliptic"), default="pyramidal"),
        _option("contact_resolution", _choice("convex", "signorini")),
        _option("iterations", default=25),
        _option("tolerance"),
        _option("line_search_iterations", key="ls_iterations", default=50),
        _option("line_search_tolerance", key="ls_tolerance", default=1e-2),
        _option("noslip_iterations", default=0),
        _option("impratio"),
        _option("pruning_tolerance", key="contact_pruning_tolerance", default=0.02),
        _option("multi_contact", key="enable_multi_contact", default=True),
        _option("box_box_detection", SWITCH),
        _option("gjk", SWITCH, key="use_gjk_collision"),
        Setting("sustained_timeconst_s", "constants", "0", pattern=CONSTANT),
        Setting("sustained_dampratio", "constants", "1", pattern=CONSTANT),
        Setting("sustained_impedance", "constants", "2:5", pattern=CONSTANTS),
    ),
    other="{key}={value}",
    other_text=python_text,
    places={
        "init": Place(form="gs.init({})"),
        "sim": Place(form="sim_options=gs.options.SimOptions({})"),
        "rigid": Place(form="rigid_options=gs.options.RigidOptions({})"),
        "constants": Place(
            form="sol_params = scene.rigid_solver.get_sol_params(); {}; scene.rigid_solver.set_sol_params(sol_params)",
            joint="; ",
        ),
    },
    default="None",
    gravity="sim_options=gs.options.SimOptions(gravity=({}))",
)

SCENE_OPTIONS = (
    *(one.key for one in GENESIS.settings if one.place == "rigid"),
    *("constraint_timeconst", "dt", "enable_collision", "disable_constraint"),
    *("enable_mujoco_compatibility", "use_hibernation"),
)
"""Options of the rigid solver that are read of a scene."""

DEFAULT_STEP_S, DEFAULT_TIMECONST_S = 0.01, 0.01
DEFAULT_GRAVITY = (0.0, 0.0, -9.81)
DEFAULT_IMPEDANCE = (0.9, 0.95, 0.001)
DEFAULT_SHAPE = (0.5, 2.0)
"""Midpoint and power of the impedance curve, which this package's settings do not carry."""

LEAST_STEPS = 2.0
"""Genesis raises the time constant of a pair of geoms to so many steps."""


def options_settings(options: Settings, precision: int) -> dict[str, Any]:
    """Return settings of the backend `genesis` for options of a scene.

    Args:
        options: Options by the names of `gs.Scene`'s arguments without `_options`: `sim`, `rigid`.
        precision: Bits of floating-point numbers.
    """
    simulation, rigid = (
        Table(options.get(part) or {}, source="options", path=part)
        for part in ("sim", "rigid")
    )
    # The rigid solver inherits the simulation's step, which substeps divide, or has a shorter one of its own.
    shared_s = (simulation.number("dt") or DEFAULT_STEP_S) / (
        simulation.number("substeps") or 1
    )
    step_s = min(rigid.number("dt") or shared_s, shared_s)
    read = {name: value for name, value, _ in GENESIS.read({"rigid": rigid})}
    is_elliptic = read["friction_cone"] == "elliptic"
    if read["contact_resolution"] is None:
        is_signorini = is_elliptic and read["constraint_solver"] == "Newton"
        read["contact_resolution"] = "signorini" if is_signorini else "convex"
    read["tolerance"] = read["tolerance"] or (1e-5 if precision == 32 else 1e-8)
    read["impratio"] = read["impratio"] or (100.0 if is_elliptic else 1.0)
    is_stated = "constraint_timeconst" in rigid.values
    timeconst_s = (
        (rigid.number("constraint_timeconst") or 0.0)
        if is_stated
        else DEFAULT_TIMECONST_S
    )
    contact = _contact_settings(timeconst_s, 1.0, DEFAULT_IMPEDANCE, step_s)
    return {
        "preset": "out_of_box",
        "precision": precision,
        "timestep_s": step_s,
        **read,
        **contact,
    }


def _contact_settings(
    timeconst_s: float, dampratio: float, impedance: tuple[float, ...], step_s: float
) -> dict[str, Any]:
    return {
        "sustained_timeconst_s": max(float(timeconst_s), LEAST_STEPS * step_s),
        "sustained_dampratio": float(dampratio),
        "sustained_impedance": tuple(float(value) for value in impedance),
        "impact_steps": None,
    }


def _configuration(
    options: Settings,
    *,
    name: str,
    source: str,
    precision: int,
    groups: tuple[ContactGroup, ...] = (),
    notes: tuple[str, ...] = (),
) -> TrainingConfiguration:
    settings = options_settings(options, precision)
    contact = dict(next((group.settings for group in groups if group.is_used), {}))
    simulation = Table(options.get("sim") or {}, source=source, path="sim")
    gravity = simulation.numbers("gravity", 3) or DEFAULT_GRAVITY
    rigid = options.get("rigid") or {}
    inapplicable = {} if any(gravity) else {Need.GRAVITY: "the scene has no gravity"}
    if rigid.get("enable_collision") is False or rigid.get("disable_constraint"):
        inapplicable[Need.CONTACT] = "the scene switches contacts off"
    if rigid.get("enable_mujoco_compatibility"):
        notes += ("enable_mujoco_compatibility is not carried over",)
    if rigid.get("use_hibernation"):
        notes += (
            "use_hibernation is not carried over; the experiments' bodies do not sleep",
        )
    check_settings("genesis", settings | contact)
    return TrainingConfiguration(
        name=name,
        source=source,
        backend="genesis",
        settings=settings | contact,
        origins=dict.fromkeys(settings, "options")
        | dict.fromkeys(contact, "sol_params of the geoms"),
        contact_groups=groups,
        notes=notes,
        inapplicable=inapplicable,
        gravity_m_per_s2=(gravity[0], gravity[1], gravity[2]),
        language=GENESIS.name,
    )


# --- a scene in this process -----------------------------------------------------------------------------------------


def _read_scene(scene: Any) -> TrainingConfiguration:
    """Return the configuration of a scene; a built one also states the constants of its geoms.

    Judging needs an engine of the same precision, which Genesis has once per process.
    """
    import genesis as gs

    precision = 64 if gs.tc_float.itemsize == 8 else 32
    options = {
        "sim": {
            name: getattr(scene.options.sim, name)
            for name in ("dt", "substeps", "gravity")
        },
        "rigid": {name: getattr(scene.options.rigid, name) for name in SCENE_OPTIONS},
    }
    groups, notes = (
        _groups(scene, options_settings(options, precision))
        if scene.is_built
        else ((), ())
    )
    return _configuration(
        options,
        name="gs.Scene",
        source="gs.Scene",
        precision=precision,
        groups=groups,
        notes=notes,
    )


def _groups(
    scene: Any, settings: Settings
) -> tuple[tuple[ContactGroup, ...], tuple[str, ...]]:
    """Return the constants with which moving geoms meet the ground, or any geom without a ground."""
    geoms = [
        geom for geom in scene.rigid_solver.geoms if geom.contype or geom.conaffinity
    ]
    values = (
        scene.rigid_solver.get_sol_params().cpu().numpy().astype(float).reshape(-1, 7)
    )
    constants = {geom: values[geom.idx] for geom in geoms}
    ground = [geom for geom in geoms if geom.link.is_fixed]
    moving = [geom for geom in geoms if not geom.link.is_fixed]
    counted: dict[tuple[float, ...], list[str]] = {}
    for one in moving:
        for other in ground or moving:
            if one is not other:
                mixed = 0.5 * (constants[one] + constants[other])
                counted.setdefault(tuple(mixed.round(9).tolist()), []).append(
                    one.link.name
                )
    groups = []
    for mixed, names in sorted(counted.items(), key=lambda item: -len(item[1])):
        several = first_names([*dict.fromkeys(names)], 1)
        group = ContactGroup(
            geoms=f"{'ground' if ground else 'bodies'} with {several}",
            pair_count=len(names),
            constants={"solref": list(mixed[:2]), "solimp": list(mixed[2:])},
            is_used=True,
            settings=_contact_settings(
                mixed[0], mixed[1], mixed[2:5], settings["timestep_s"]
            ),
        )
        groups.append(group)
    shapes = {mixed[5:] for mixed in counted}
    notes = (
        ()
        if shapes <= {DEFAULT_SHAPE}
        else ("midpoint and power of the impedance are not carried over",)
    )
    return tuple(groups), notes


# --- saved options ---------------------------------------------------------------------------------------------------


def _is_options_file(target: Any) -> bool:
    try:
        values = json_document(named_content(target, (".json",), MEGABYTE))
    except ValueError:
        return False
    return isinstance(values, dict) and all(
        isinstance(values.get(part), dict) for part in ("sim", "rigid")
    )


def _read_options(target: Any) -> TrainingConfiguration:
    path = Path(target)
    note = "options state no precision: judged in single precision, Genesis's default"
    values = file_value(path, json_document)
    return _configuration(
        values,
        name=path.name,
        source=f"options file {path}",
        precision=32,
        notes=(note,),
    )


DIALECTS = (GENESIS,)

READERS = (
    Reader(
        "a gs.Scene",
        lambda target: is_of(target, "genesis", "Scene"),
        _read_scene,
        has_geoms=False,
    ),
    Reader(
        "saved options of a Genesis scene (options.json)",
        _is_options_file,
        _read_options,
        has_geoms=False,
    ),
)
