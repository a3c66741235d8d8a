"""Recipes of fabrics: an engine's constants for a measured fabric, and the stiffness that a simulated strip has."""

import math
import time
from collections.abc import Mapping
from typing import Any, NamedTuple

from gauge_envs.backends.fabric_constants import FabricConstants
from gauge_envs.backends.registry import backend, backend_class, backend_names
from gauge_envs.errors import ParameterError
from gauge_envs.scene import GRAVITY_M_PER_S2, Scene
from gauge_envs.scene.fabrics import Fabric, bending_length_m, plate_bending_stiffness
from gauge_envs.tools.bench.recording import DivergedError
from gauge_envs.tools.conformance import (
    BENT_FREE_M,
    Lab,
    bending_stiffness,
    cantilever_strip,
    checks,
    hanging_strip,
    stretch_stiffness,
)
from gauge_envs.tools.recipes.search import Recipe, difference
from gauge_envs.tools.usd import surface_constants

ISAAC = "isaac"
"""Engine whose constants are printed; this package does not run Isaac Sim."""

NOTHING_LOST = "Simulated strips reach the stretch and bending stiffness, the engine's law the shear stiffness."

BENT_SHARE = 0.2
"""Free length of the cantilever over that of the conformance check, so that a soft fabric swings within a second."""

CELLS = 6
"""Cells along the free length, as in the conformance check."""

STIFFNESSES = ("stretch_n_per_m", "shear_n_per_m", "bend_n_m", "bending_length_m")
"""Names of the measured constants that a simulation can give."""

STRIPS = {
    "stretch_n_per_m": (stretch_stiffness, "cloth-stretch"),
    "bend_n_m": (bending_stiffness, "cloth-bending"),
}
"""Measure of each strip, and the conformance check whose tolerance it has, by the measured value."""


def fabric_constants(fabric: Fabric) -> dict[str, FabricConstants]:
    """Return a fabric in the constants of each engine that has a mapping, simulated or not, by name of the engine."""
    constants = {ISAAC: surface_constants(fabric)}
    for name in backend_names():
        mapped = backend_class(name).fabric_constants(fabric)
        if mapped is not None:
            constants[name] = mapped
    return constants


def fabric_recipe(
    name: str, fabric: Fabric, engine: str, timestep_s: float | None = None
) -> Recipe:
    """Return a fabric in an engine's constants, and the stiffness that simulated strips have with them.

    Args:
        name: Name of the fabric.
        fabric: Its measured constants.
        engine: Name of the engine.
        timestep_s: Time step [s]; None for the default of the engine's backend, which depends on the fabric.

    Raises:
        MissingExtraError: The engine is not installed.
        ParameterError: The engine has no mapping of fabrics.
    """
    key = ISAAC if engine == "isaac_sim" else engine
    known = fabric_constants(fabric)
    if key not in known:
        raise ParameterError(
            f"engine {engine!r} has no mapping of fabrics: choose one of {', '.join(known)}"
        )
    mapped = known[key]
    start_s = time.perf_counter()
    targets = _measured_constants(fabric)
    texts = [f"A fall-back sets {text}." for text in mapped.fallbacks]
    texts += [f"The mapping loses {loss}." for loss in mapped.lost]
    versions: Mapping[str, str] = {}
    strips: dict[str, Strip] = {}
    step_s = None
    if key == ISAAC:
        texts.append("This package does not simulate Isaac Sim.")
    else:
        versions = backend(key).versions()
        changes = {} if timestep_s is None else {"timestep_s": timestep_s}
        lab = Lab(backend(key), {**mapped.settings, **changes})
        hung = hanging_strip(fabric)
        strips["stretch_n_per_m"] = _strip(lab, hung, targets, "stretch_n_per_m")
        step_s = lab.settings_in_force.get("timestep_s")
        free_m = BENT_SHARE * BENT_FREE_M
        bent = cantilever_strip(fabric, free_m, height_m=0.0)
        strips["bend_n_m"] = _strip(
            lab, bent, targets, "bend_n_m", cell_m=free_m / CELLS
        )
    reached = dict.fromkeys(STIFFNESSES) | {
        name: strip.stiffness for name, strip in strips.items()
    }
    if reached["bend_n_m"] is not None:
        weight_n_per_m2 = fabric.areal_density_kg_per_m2 * GRAVITY_M_PER_S2
        length_m = math.cbrt(max(reached["bend_n_m"], 0.0) / weight_n_per_m2)
        reached["bending_length_m"] = length_m
    return Recipe(
        engine=key,
        asked=targets,
        settings=mapped.constants,
        snippet=fabric_snippet(mapped),
        reached=reached,
        error={name: difference(reached[name], targets[name]) for name in reached},
        misses=[name for name, strip in strips.items() if strip.is_missed],
        detail={"mapping_gives": law_of(mapped), "timestep_s": step_s},
        wall_s=time.perf_counter() - start_s,
        explanation=" ".join(
            [*texts, *(strip.text for strip in strips.values())]
        ).strip()
        or NOTHING_LOST,
        versions=versions,
    )


class Strip(NamedTuple):
    """Stiffness of a simulated strip, None if it diverges or moves on, whether it is missed, and why."""

    stiffness: float | None
    is_missed: bool = False
    text: str = ""


def _strip(
    lab: Lab, scene: Scene, targets: Mapping[str, float], name: str, **changes: Any
) -> Strip:
    """Return the stiffness of a simulated strip, with the tolerance of the conformance check."""
    measure, check = STRIPS[name]
    try:
        measurement = measure(lab.rollout(scene, **changes))
    except DivergedError as error:
        return Strip(None, text=f"{name}: the simulation diverges: {error}.")
    stiffness, target = measurement.measured, targets[name]
    if not math.isfinite(stiffness):
        return Strip(None, text=f"{name}: {measurement.hint}.")
    if abs(stiffness - target) <= checks((check,))[0].tolerance.width(target):
        return Strip(stiffness)
    ratio = stiffness / target
    text = f"{name}: the simulated strip has {stiffness:.4g}, {ratio:.3g} of what is asked."
    return Strip(stiffness, True, text)


def _measured_constants(fabric: Fabric) -> dict[str, float]:
    """Return measured constants by name, and the bending length (D / (areal density g))^(1/3) [m]."""
    hinge = fabric.bend_stiffness_n_m_per_rad
    return {
        "stretch_n_per_m": fabric.stretch_stiffness_n_per_m,
        "shear_n_per_m": fabric.shear_stiffness_n_per_m,
        "bend_n_m": plate_bending_stiffness(hinge_stiffness_n_m_per_rad=hinge),
        "bending_length_m": bending_length_m(fabric),
        "areal_density_kg_per_m2": fabric.areal_density_kg_per_m2,
        "thickness_m": fabric.thickness_m,
    }


def law_of(mapped: FabricConstants) -> dict[str, float]:
    """Return the stiffness of the engine's law at small strain, without a simulation, by name [N/m]."""
    return {
        "stretch_n_per_m": mapped.stretch_stiffness_n_per_m,
        "shear_n_per_m": mapped.shear_stiffness_n_per_m,
    }


def fabric_snippet(mapped: FabricConstants) -> str:
    """Return the constants of a fabric in the engine's own language."""
    assignments = (
        f"{name} = {value:.6g}  # {mapped.units[name]}\n"
        for name, value in mapped.constants.items()
    )
    return mapped.snippet or "".join(assignments)
