"""List documented changes of settings that may resolve failed checks, in a fixed order of cost."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import mujoco

from gauge_envs.tools.sanity.verdict import Settings, TrainingConfiguration

ELLIPTIC, MARGIN = {"cone": "elliptic"}, {"contact_margin_m": 0.0}
DAMPED, ACCURATE = {"integrator": "implicitfast"}, {"integrator": "RK4"}
STEP = {"timestep_s": 0.002}

SOFT, FIRM, STIFF = (
    {"contact_solref": (seconds, 1.0)} for seconds in (0.02, 0.01, 0.004)
)
"""Documented, medium and short time constant of contacts of MuJoCo.

A time constant below ten steps makes bodies hop that slide fast; see `harm`.
"""

HARD_SOLIMP, HARDEST_SOLIMP = (
    (ratio, ratio, 0.001, 0.5, 2.0) for ratio in (0.99, 0.999)
)
"""Impedances with which contacts and equalities of MuJoCo yield by a hundredth, or a thousandth, of a free motion."""

HARD, HARDEST = ({"contact_solimp": solimp} for solimp in (HARD_SOLIMP, HARDEST_SOLIMP))

STIFF_EQUALITY = {"equality_solref": STIFF["contact_solref"]}
HARD_EQUALITY = {"equality_solimp": HARDEST_SOLIMP}

SOLVED = {"iterations": 100, "ls_iterations": 50, "tolerance": 1e-8}
"""Iterations of MuJoCo's solvers by default."""

GRIPPING = HARD | {"impratio": 100.0}
"""Contacts that creep by a hundredth of those with `impratio` 1."""

CONTACTS = (SOFT, HARD, HARDEST, FIRM, SOFT | HARD, STIFF, GRIPPING)

RECOMMENDED_MUJOCO: dict[str, Any] = {
    **STEP,
    **DAMPED,
    **ELLIPTIC,
    **HARD,
    **SOFT,
    **MARGIN,
    **SOLVED,
    "impratio": 10.0,
    "refsafe": True,
}
"""Settings that this package recommends for a model of MuJoCo."""

FEW_ITERATIONS = {"iterations": 4, "ls_iterations": 20}
"""Fewest iterations of MuJoCo's Newton solver with which bodies slide by Coulomb's law."""

CANDIDATES: Sequence[Settings] = (
    FEW_ITERATIONS,
    {"refsafe": True},
    MARGIN,
    {"condim": 3},
    *CONTACTS,
    *(ELLIPTIC | contact for contact in ({}, *CONTACTS)),
    ELLIPTIC | {"impratio": 10.0},
    ELLIPTIC | {"impratio": 10.0} | MARGIN,
    DAMPED,
    STEP,
    STEP | DAMPED,
    RECOMMENDED_MUJOCO,
    RECOMMENDED_MUJOCO | FIRM | {"timestep_s": 0.001},
)
"""Changes that are tried, the cheapest first."""

RAISED = ("iterations", "ls_iterations")
"""Settings that a change only raises."""

LOWERED = ("timestep_s", "condim", "tolerance", "sleep_tolerance")
"""Settings that a change only lowers."""

ABSENT = {"contact_margin_m": 0.0, "refsafe": True, "condim": 3}
"""Effective values where a target gives none."""

MODEL_CANDIDATES: Mapping[str, Sequence[Settings]] = {
    "model-constraints": (
        STIFF_EQUALITY,
        HARD_EQUALITY,
        STIFF_EQUALITY | HARD_EQUALITY,
    ),
    "model-overlap": (HARD, HARDEST),
    "model-slip": (HARD, GRIPPING, ELLIPTIC | GRIPPING),
    "model-creep": (SOLVED, HARD, ELLIPTIC | GRIPPING),
    "model-solver": (
        {"jacobian": "dense"},
        SOLVED,
        {"solver": "Newton"},
        SOLVED | {"solver": "Newton"},
    ),
    **dict.fromkeys(
        ("model-spin", "robot-energy", "robot-holds", "robot-drive"),
        (DAMPED, ACCURATE),
    ),
}
"""Changes that may resolve a check of the target's own model, the cheapest first; a smaller step may resolve each."""


OF_RECIPE = ("timestep_s", "integrator", "cone", "impratio", "condim", "contact_")
"""Prefixes of the settings that `gauge recipe` writes."""


def keeps_recipe(model: mujoco.MjModel) -> bool:
    """Return whether a model has lines of `gauge recipe`: a pair whose impedance is constant, as only recipes write."""
    solimp = model.pair_solimp
    is_constant = (solimp[:, 0] == solimp[:, 1]) & (
        solimp[:, 2:] == [0.001, 0.5, 2.0]
    ).all(axis=1)
    return bool(is_constant.any())


def candidates_of(
    configuration: TrainingConfiguration, check: str = ""
) -> list[dict[str, Any]]:
    """Return the changes that differ from the settings of a configuration, without those that a recipe wrote.

    Args:
        configuration: The configuration of a model.
        check: Id of the check of the target's own model that they are for; empty for those of measured objects.
    """
    sets = [configuration.settings, *configuration.contact_sets.values()]
    candidates = MODEL_CANDIDATES.get(check, ())
    if not check:
        candidates = CANDIDATES
        if sets[0].get("iterations", math.inf) < FEW_ITERATIONS["iterations"]:
            # Other changes let a body slide that starts to move, and not one that has rested.
            candidates = [FEW_ITERATIONS | {**change} for change in candidates]
    if candidates:
        step_s = configuration.settings["timestep_s"]
        smaller = [{"timestep_s": step_s * factor} for factor in (0.5, 0.25)]
        candidates = [*candidates, *smaller]
    robot = configuration.robot
    is_kept = OF_RECIPE if robot is not None and keeps_recipe(robot.model) else ()
    new_changes = []
    for changes in candidates:
        new = {
            name: value
            for name, value in changes.items()
            if any(_is_new(name, value, settings) for settings in sets)
            and not name.startswith(is_kept)
        }
        if new and new not in new_changes:
            new_changes.append(new)
    return new_changes


def _is_new(name: str, value: Any, settings: Settings) -> bool:
    """Return whether a value differs from that of a setting, and is no step back."""
    was = settings.get(name, ABSENT.get(name))
    if name in RAISED:
        return bool(value > (math.inf if was is None else was))
    if name in LOWERED:
        return was is None or bool(value < was)
    return (tuple(was) if isinstance(was, list) else was) != value
