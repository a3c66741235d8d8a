"""Recipes of fabrics: an engine's constants for a measured fabric, and the stiffness that a simulated strip has."""

import math
import time
from collections.abc import Callable, Mapping
from typing import Any

from gauge_envs.backends.fabric_constants import FabricConstants
from gauge_envs.backends.registry import backend, backend_class, backend_names
from gauge_envs.errors import ParameterError
from gauge_envs.scene import GRAVITY_M_PER_S2, Scene
from gauge_envs.scene.fabrics import Fabric, bending_length_m, plate_bending_stiffness
from gauge_envs.tools.bench.recording import DivergedError
from gauge_envs.tools.conformance import (
    BENT_FREE_M,
    Lab,
    Measurement,
    Recording,
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

CHECKS = {"stretch_n_per_m": "cloth-stretch", "bend_n_m": "cloth-bending"}
"""Conformance checks whose tolerances the strips have, by the measured value."""


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
    versions: Mapping[str, str] = {}
    values: dict[str, float] = {}
    step_s, texts = None, [f"A fall-back sets {text}." for text in mapped.fallbacks]
    texts += [f"The mapping loses {loss}." for loss in mapped.lost]
    if key == ISAAC:
        texts.append("This package does not simulate Isaac Sim.")
    else:
        versions = backend(key).versions()
        changes = {} if timestep_s is None else {"timestep_s": timestep_s}
        lab = Lab(backend(key), {**mapped.settings, **changes})
        free_m = BENT_SHARE * BENT_FREE_M
        bent = cantilever_strip(fabric, free_m, height_m=0.0)
        hung = _strip(lab, hanging_strip(fabric), stretch_stiffness)
        step_s = lab.settings_in_force.get("timestep_s")
        strips = {
            "stretch_n_per_m": hung,
            "bend_n_m": _strip(lab, bent, bending_stiffness, cell_m=free_m / CELLS),
        }
        values = {name: value for name, (value, _) in strips.items() if value == value}
        texts += [
            f"{name}: {reason}."
            for name, (_, reason) in strips.items()
            if name not in values
        ]
    if "bend_n_m" in values:
        weight_n_per_m2 = fabric.areal_density_kg_per_m2 * GRAVITY_M_PER_S2
        length_m = math.cbrt(max(values["bend_n_m"], 0.0) / weight_n_per_m2)
        values["bending_length_m"] = length_m
    targets = _measured_constants(fabric)
    reached = {name: values.get(name) for name in STIFFNESSES}
    misses = [
        name
        for name, check in CHECKS.items()
        if name in values
        and not abs(values[name] - targets[name])
        <= checks((check,))[0].tolerance.width(targets[name])
    ]
    texts += [
        f"{name}: the simulated strip has {values[name]:.4g}, {values[name] / targets[name]:.3g} of what is asked."
        for name in misses
    ]
    return Recipe(
        engine=key,
        asked=targets,
        settings=mapped.constants,
        snippet=fabric_snippet(mapped),
        reached=reached,
        error={name: difference(reached[name], targets[name]) for name in reached},
        misses=misses,
        detail={"mapping_gives": law_of(mapped), "timestep_s": step_s},
        wall_s=time.perf_counter() - start_s,
        explanation=" ".join(texts) or NOTHING_LOST,
        versions=versions,
    )


def _strip(
    lab: Lab, scene: Scene, measure: Callable[[Recording], Measurement], **changes: Any
) -> tuple[float, str]:
    """Return the stiffness of a simulated strip, NaN if it has none, and the reason."""
    try:
        measurement = measure(lab.rollout(scene, **changes))
    except DivergedError as error:
        return math.nan, f"the simulation diverges: {error}"
    return measurement.measured, measurement.hint


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
    lines = (
        f"{name} = {value:.6g}  # {mapped.units[name]}\n"
        for name, value in mapped.constants.items()
    )
    return mapped.snippet or "".join(lines)
