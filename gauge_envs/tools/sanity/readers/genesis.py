"""Genesis: the options of a scene, in a probe file or as `scene.options.model_dump_json()` writes them."""

from collections.abc import Callable
from typing import Any

from gauge_envs.tools.sanity.readers.dialect import (
    Dialect,
    NestedTable,
    joined,
    not_carried_over,
    python_text,
    settings_of,
)
from gauge_envs.tools.sanity.readers.settings import checked_configuration
from gauge_envs.tools.sanity.training import Need, Settings, TrainingConfiguration


def _choice(*names: str) -> Callable[[NestedTable, str], Any]:
    """Return a function that reads a choice, which a file gives by its name or number."""

    def read(table: NestedTable, key: str) -> Any:
        value = table.value(key)
        return names[value] if isinstance(value, int) else value

    return read


CHOICES = {
    "integrator": ("Euler", "implicitfast", "approximate_implicitfast"),
    "solver": ("CG", "Newton"),
    "cone": ("pyramidal", "elliptic"),
    "resolution": ("convex", "signorini"),
}

SETTINGS = """
integrator             rigid integrator                integrator "approximate_implicitfast"
constraint_solver      rigid constraint_solver         solver     "Newton"
friction_cone          rigid friction_cone             cone       "pyramidal"
contact_resolution     rigid contact_resolution        resolution
iterations             rigid iterations                value      25
tolerance              rigid tolerance                 value      1e-5
line_search_iterations rigid ls_iterations             value      50
line_search_tolerance  rigid ls_tolerance              value      0.01
noslip_iterations      rigid noslip_iterations         value      0
impratio               rigid impratio                  value
pruning_tolerance      rigid contact_pruning_tolerance value      0.02
multi_contact          rigid enable_multi_contact      value      true
box_box_detection      rigid box_box_detection         value      false
gjk                    rigid use_gjk_collision         value      false
"""
"""Arguments of `RigidOptions`, with the documented defaults of Genesis 1.4.5."""

GENESIS = Dialect(
    name="genesis",
    settings=settings_of(
        SETTINGS, {kind: (_choice(*names), None, "") for kind, names in CHOICES.items()}
    ),
    pattern="{key}={value}",
    text=python_text,
    join=joined(" and "),
)

DEFAULT_STEP_S, DEFAULT_TIMECONST_S = 0.01, 0.01
DEFAULT_GRAVITY = (0.0, 0.0, -9.81)
DEFAULT_IMPEDANCE = (0.9, 0.95, 0.001)
PRECISION = 32
"""Bits of numbers by default."""

UNKNOWN_TO_BACKEND = {"enable_mujoco_compatibility": False, "use_hibernation": False}
"""Flags of `RigidOptions` that no experiment gets, with their defaults."""

MIN_STEPS = 2.0
"""Number of steps to which Genesis raises the time constant of a pair of geoms."""


def options_settings(simulation: NestedTable, rigid: NestedTable) -> dict[str, Any]:
    """Return settings of the backend `genesis` for the options `sim` and `rigid` of a scene."""
    # The rigid solver inherits the simulation's step, which substeps divide, or has a shorter one of its own.
    shared_s = (simulation.number("dt") or DEFAULT_STEP_S) / (
        simulation.number("substeps") or 1
    )
    step_s = min(rigid.number("dt") or shared_s, shared_s)
    settings = GENESIS.read({"rigid": rigid})
    read = {name: value for name, (value, _) in settings.items()}
    is_elliptic = read["friction_cone"] == "elliptic"
    is_signorini = is_elliptic and read["constraint_solver"] == "Newton"
    timeconst_s = DEFAULT_TIMECONST_S
    if "constraint_timeconst" in rigid.values:
        timeconst_s = rigid.number("constraint_timeconst") or 0.0
    return {
        "preset": "out_of_box",
        "precision": PRECISION,
        "timestep_s": step_s,
        "contact_resolution": "signorini" if is_signorini else "convex",
        "impratio": 100.0 if is_elliptic else 1.0,
        **read,
        "sustained_timeconst_s": max(timeconst_s, MIN_STEPS * step_s),
        "sustained_dampratio": 1.0,
        "sustained_impedance": DEFAULT_IMPEDANCE,
        "impact_steps": None,
    }


def genesis_configuration(
    options: Settings, *, name: str, source: str
) -> TrainingConfiguration:
    """Return the training configuration of a scene.

    Args:
        options: Options by the names of `gs.Scene`'s arguments without `_options`: `sim`, `rigid`.
        name: Name of the configuration.
        source: Description of where it is from.
    """
    table = NestedTable(options, source=name)
    simulation, rigid = table.part("sim"), table.part("rigid")
    settings = options_settings(simulation, rigid)
    inapplicable = {}
    if rigid.value("enable_collision") is False or rigid.value("disable_constraint"):
        inapplicable[Need.CONTACT] = "the scene switches contacts off"
    return checked_configuration(
        name,
        "genesis",
        {key: (value, "options") for key, value in settings.items()},
        source=source,
        notes=(
            "options have no precision: checked in single precision, the default",
            *not_carried_over(rigid, UNKNOWN_TO_BACKEND),
        ),
        inapplicable=inapplicable,
        gravity_m_per_s2=simulation.numbers("gravity", 3) or DEFAULT_GRAVITY,
        language=GENESIS.name,
    )
