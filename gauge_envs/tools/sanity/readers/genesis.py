"""Read Genesis scenes: a `gs.Scene` in this process, or its saved options, `scene.options.model_dump_json()`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gauge_envs.errors import TargetError
from gauge_envs.files import MEGABYTE, json_document, read_regular
from gauge_envs.tools.sanity.model import ContactGroup, Need, TrainingConfiguration
from gauge_envs.tools.sanity.readers.reader import GeomPair, Reader, check_settings

MOST_OPTIONS_BYTES = MEGABYTE
"""Largest size of a file of options."""

NAMES: Mapping[str, Mapping[int, str]] = {
    "integrator": {0: "Euler", 1: "implicitfast", 2: "approximate_implicitfast"},
    "constraint_solver": {0: "CG", 1: "Newton"},
    "friction_cone": {0: "pyramidal", 1: "elliptic"},
    "contact_resolution": {0: "convex", 1: "signorini"},
}
"""Names of Genesis's choices by their numbers in a file."""

DEFAULTS: Mapping[str, Any] = {
    "integrator": "approximate_implicitfast",
    "constraint_solver": "Newton",
    "iterations": 25,
    "tolerance": None,
    "ls_iterations": 50,
    "ls_tolerance": 1e-2,
    "noslip_iterations": 0,
    "friction_cone": "pyramidal",
    "contact_resolution": None,
    "impratio": None,
    "contact_pruning_tolerance": 0.02,
    "enable_multi_contact": True,
    "box_box_detection": False,
    "use_gjk_collision": False,
    "constraint_timeconst": 0.01,
}
"""Documented defaults of Genesis 1.4.5's `RigidOptions`."""

DEFAULT_STEP_S = 0.01
DEFAULT_GRAVITY = (0.0, 0.0, -9.81)
DEFAULT_IMPEDANCE = (0.9, 0.95, 0.001)
DEFAULT_SHAPE = (0.5, 2.0)
"""Midpoint and power of the impedance curve, which this package's settings do not carry."""

LEAST_STEPS = 2.0
"""Genesis raises the time constant of a pair of geoms to so many steps."""


def options_settings(options: Mapping[str, Any], precision: int) -> dict[str, Any]:
    """Return settings of the backend `genesis` for options of a scene.

    Args:
        options: Options by the names of `gs.Scene`'s arguments without `_options`: `sim`, `rigid`.
        precision: Bits of floating-point numbers.
    """
    simulation, rigid = options.get("sim") or {}, {**DEFAULTS, **(options.get("rigid") or {})}
    # The rigid solver inherits the simulation's step, which substeps divide, or has a shorter one of its own.
    shared_s = (simulation.get("dt") or DEFAULT_STEP_S) / (simulation.get("substeps") or 1)
    step_s = min(rigid.get("dt") or shared_s, shared_s)
    chosen = {name: _name(name, rigid[name]) for name in NAMES}
    is_elliptic = chosen["friction_cone"] == "elliptic"
    if chosen["contact_resolution"] is None:
        is_signorini = is_elliptic and chosen["constraint_solver"] == "Newton"
        chosen["contact_resolution"] = "signorini" if is_signorini else "convex"
    return {
        "preset": "out_of_box",
        "precision": precision,
        "timestep_s": float(step_s),
        **chosen,
        "iterations": rigid["iterations"],
        "tolerance": rigid["tolerance"] or (1e-5 if precision == 32 else 1e-8),
        "line_search_iterations": rigid["ls_iterations"],
        "line_search_tolerance": rigid["ls_tolerance"],
        "noslip_iterations": rigid["noslip_iterations"],
        "impratio": rigid["impratio"] or (100.0 if is_elliptic else 1.0),
        "pruning_tolerance": rigid["contact_pruning_tolerance"],
        "multi_contact": rigid["enable_multi_contact"],
        "box_box_detection": bool(rigid["box_box_detection"]),
        "gjk": bool(rigid["use_gjk_collision"]),
        **_contact_settings(rigid["constraint_timeconst"] or 0.0, 1.0, DEFAULT_IMPEDANCE, float(step_s)),
    }


def _name(kind: str, value: Any) -> str | None:
    if value is None or isinstance(value, str):
        return value
    return NAMES[kind].get(int(value))


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
    options: Mapping[str, Any],
    *,
    name: str,
    source: str,
    precision: int,
    groups: tuple[ContactGroup, ...] = (),
    notes: tuple[str, ...] = (),
) -> TrainingConfiguration:
    settings = options_settings(options, precision)
    contact = dict(next((group.settings for group in groups if group.is_used), {}))
    gravity = tuple(map(float, (options.get("sim") or {}).get("gravity") or DEFAULT_GRAVITY))
    rigid = options.get("rigid") or {}
    inapplicable = {} if any(gravity) else {Need.GRAVITY: "the scene has no gravity"}
    if rigid.get("enable_collision") is False or rigid.get("disable_constraint"):
        inapplicable[Need.CONTACT] = "the scene switches contacts off"
    if rigid.get("enable_mujoco_compatibility"):
        notes += ("enable_mujoco_compatibility is not carried over",)
    if rigid.get("use_hibernation"):
        notes += ("use_hibernation is not carried over; the experiments' bodies do not sleep",)
    check_settings("genesis", settings | contact)
    return TrainingConfiguration(
        name=name,
        source=source,
        backend="genesis",
        settings=settings | contact,
        origins=dict.fromkeys(settings, "options") | dict.fromkeys(contact, "sol_params of the geoms"),
        contact_groups=groups,
        notes=notes,
        inapplicable=inapplicable,
        gravity_m_per_s2=(gravity[0], gravity[1], gravity[2]),
        language="genesis",
    )


# --- a scene in this process -----------------------------------------------------------------------------------------


def _is_scene(target: Any) -> bool:
    kind = type(target)
    return kind.__name__ == "Scene" and kind.__module__ == "genesis.engine.scene"


def _read_scene(scene: Any, _: GeomPair | None) -> TrainingConfiguration:
    """Return the configuration of a scene; a built one also states the constants of its geoms.

    Judging needs an engine of the same precision, which Genesis has once per process.
    """
    import genesis as gs

    precision = 64 if gs.tc_float.itemsize == 8 else 32
    options = {
        "sim": {name: getattr(scene.options.sim, name) for name in ("dt", "substeps", "gravity")},
        "rigid": {name: getattr(scene.options.rigid, name) for name in (*DEFAULTS, "dt")},
    }
    for name in ("enable_collision", "disable_constraint", "enable_mujoco_compatibility", "use_hibernation"):
        options["rigid"][name] = getattr(scene.options.rigid, name)
    groups, notes = _groups(scene, options_settings(options, precision)) if scene.is_built else ((), ())
    return _configuration(options, name="gs.Scene", source="gs.Scene", precision=precision, groups=groups, notes=notes)


def _groups(scene: Any, settings: Mapping[str, Any]) -> tuple[tuple[ContactGroup, ...], tuple[str, ...]]:
    """Return the constants with which moving geoms meet the ground, or any geom without a ground."""
    geoms = [geom for geom in scene.rigid_solver.geoms if geom.contype or geom.conaffinity]
    values = scene.rigid_solver.get_sol_params().cpu().numpy().astype(float).reshape(-1, 7)
    constants = {geom: values[geom.idx] for geom in geoms}
    ground = [geom for geom in geoms if geom.link.is_fixed]
    moving = [geom for geom in geoms if not geom.link.is_fixed]
    counted: dict[tuple[float, ...], list[str]] = {}
    for one in moving:
        for other in ground or moving:
            if one is not other:
                mixed = 0.5 * (constants[one] + constants[other])
                counted.setdefault(tuple(mixed.round(9).tolist()), []).append(one.link.name)
    groups = []
    for mixed, names in sorted(counted.items(), key=lambda item: -len(item[1])):
        first, *others = dict.fromkeys(names)
        groups.append(
            ContactGroup(
                geoms=f"{'ground' if ground else 'bodies'} with {first}"
                + (f" and {len(others)} more" if others else ""),
                pair_count=len(names),
                constants={"solref": list(mixed[:2]), "solimp": list(mixed[2:])},
                is_used=True,
                settings=_contact_settings(mixed[0], mixed[1], mixed[2:5], settings["timestep_s"]),
            )
        )
    shapes = {mixed[5:] for mixed in counted}
    notes = () if shapes <= {DEFAULT_SHAPE} else ("midpoint and power of the impedance are not carried over",)
    return tuple(groups), notes


# --- saved options ---------------------------------------------------------------------------------------------------


def _is_options_file(target: Any) -> bool:
    if not isinstance(target, str | Path) or Path(target).suffix.lower() != ".json":
        return False
    try:
        values = json_document(read_regular(Path(target), MOST_OPTIONS_BYTES))
    except (OSError, ValueError):
        return False
    return isinstance(values, dict) and isinstance(values.get("sim"), dict) and isinstance(values.get("rigid"), dict)


def _read_options(path: Path) -> TrainingConfiguration:
    try:
        values = json_document(read_regular(path, MOST_OPTIONS_BYTES))
    except OSError as error:
        raise TargetError(f"{path}: cannot be read: {error.strerror or error}") from None
    except ValueError as error:
        raise TargetError(f"{path}: {error}") from None
    note = "options state no precision: judged in single precision, Genesis's default"
    return _configuration(values, name=path.name, source=f"options file {path}", precision=32, notes=(note,))


GENESIS_SCENE = Reader(
    name="genesis-scene",
    accepts="a gs.Scene",
    matches=_is_scene,
    read=_read_scene,
)
"""Reader of Genesis scenes."""

GENESIS_OPTIONS = Reader(
    name="genesis-options",
    accepts="saved options of a Genesis scene (options.json)",
    matches=_is_options_file,
    read=lambda target, _: _read_options(Path(target)),
)
"""Reader of files that `scene.options.model_dump_json()` wrote."""
