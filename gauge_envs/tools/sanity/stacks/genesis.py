"""Genesis: the saved options of a scene, `scene.options.model_dump_json()`."""

from pathlib import Path
from typing import Any

from gauge_envs.files import json_document
from gauge_envs.tools.sanity.model import (
    Need,
    Settings,
    TrainingConfiguration,
)
from gauge_envs.tools.sanity.scenario import check_settings
from gauge_envs.tools.sanity.stacks.dialect import (
    Dialect,
    Kind,
    Setting,
)
from gauge_envs.tools.sanity.stacks.documents import Table, file_value
from gauge_envs.tools.sanity.stacks.reader import Reader, named_content


def _choice(*names: str) -> Kind:
    """Return a choice that a file states by its number."""

    def read(table: Table, key: str) -> str | None:
        value = table.value(key)
        return (
            value
            if value is None or isinstance(value, str)
            else dict(enumerate(names)).get(table.whole(key) or 0)
        )

    return Kind(read)


VALUE, SWITCH = Kind(Table.value), Kind(lambda table, key: bool(table.value(key)))

INTEGRATORS = _choice("Euler", "implicitfast", "approximate_implicitfast")


def _option(
    name: str, kind: Kind = VALUE, *, key: str = "", default: Any = None
) -> Setting:
    """Return an argument of `RigidOptions` with the documented default of Genesis 1.4.5."""
    return Setting(name, "rigid", key or name, kind, default=default)


GENESIS = Dialect(
    name="genesis",
    settings=(
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
    ),
    gravity="sim_options=gs.options.SimOptions(gravity=({}))",
)

DEFAULT_STEP_S, DEFAULT_TIMECONST_S = 0.01, 0.01
DEFAULT_GRAVITY = (0.0, 0.0, -9.81)
DEFAULT_IMPEDANCE = (0.9, 0.95, 0.001)
PRECISION = 32
"""Bits of numbers by default."""

LEAST_STEPS = 2.0
"""Genesis raises the time constant of a pair of geoms to so many steps."""


def options_settings(options: Settings) -> dict[str, Any]:
    """Return settings of the backend `genesis` for options of a scene.

    Args:
        options: Options by the names of `gs.Scene`'s arguments without `_options`: `sim`, `rigid`.
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
    read["tolerance"] = read["tolerance"] or 1e-5
    read["impratio"] = read["impratio"] or (100.0 if is_elliptic else 1.0)
    timeconst_s = DEFAULT_TIMECONST_S
    if "constraint_timeconst" in rigid.values:
        timeconst_s = rigid.number("constraint_timeconst") or 0.0
    return {
        "preset": "out_of_box",
        "precision": PRECISION,
        "timestep_s": step_s,
        **read,
        "sustained_timeconst_s": max(float(timeconst_s), LEAST_STEPS * step_s),
        "sustained_dampratio": 1.0,
        "sustained_impedance": DEFAULT_IMPEDANCE,
        "impact_steps": None,
    }


def _is_options_file(target: Any) -> bool:
    try:
        values = json_document(named_content(target, (".json",)))
    except ValueError:
        return False
    return isinstance(values, dict) and all(
        isinstance(values.get(part), dict) for part in ("sim", "rigid")
    )


def _read_options(target: Any) -> TrainingConfiguration:
    path = Path(target)
    options = file_value(path, json_document)
    notes = ["options state no precision: judged in single precision, the default"]
    settings = options_settings(options)
    simulation = Table(options["sim"], source=path.name, path="sim")
    gravity = simulation.numbers("gravity", 3) or DEFAULT_GRAVITY
    rigid = options["rigid"]
    inapplicable = {} if any(gravity) else {Need.GRAVITY: "the scene has no gravity"}
    if rigid.get("enable_collision") is False or rigid.get("disable_constraint"):
        inapplicable[Need.CONTACT] = "the scene switches contacts off"
    for name in ("enable_mujoco_compatibility", "use_hibernation"):
        if rigid.get(name):
            notes.append(f"{name} is not carried over")
    check_settings("genesis", settings)
    return TrainingConfiguration(
        name=path.name,
        source=f"options file {path}",
        backend="genesis",
        settings=settings,
        origins=dict.fromkeys(settings, "options"),
        notes=tuple(notes),
        inapplicable=inapplicable,
        gravity_m_per_s2=(gravity[0], gravity[1], gravity[2]),
        language=GENESIS.name,
    )


DIALECTS = (GENESIS,)

READERS = (
    Reader(
        "saved options of a Genesis scene (options.json)",
        _is_options_file,
        _read_options,
        has_geoms=False,
    ),
)
