"""Convert measured fabrics to engine constants, and measure the stiffness of simulated strips."""

import math
import time
from collections.abc import Mapping
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
    bending_stiffness,
    cantilever_strip,
    hanging_strip,
    stretch_stiffness,
)
from gauge_envs.tools.recipes.search import Recipe, difference
from gauge_envs.tools.usd import surface_constants

ISAAC = "isaac"
"""Engine with a mapping but without a simulation: this package does not run Isaac Sim."""

NOTHING_LOST = "Simulated strips have the stretch and bending stiffness; the engine's law has the shear stiffness."

BENT_SHARE = 0.2
"""Free length of the cantilever, divided by the length of the conformance check: soft fabrics swing within 1 s."""

CELLS = 6
"""Cells along the free length, as in the conformance check."""

STIFFNESSES = ("stretch_n_per_m", "shear_n_per_m", "bend_n_m", "bending_length_m")
"""Names of the constants that a simulation can measure."""

TOLERANCES = {"stretch_n_per_m": 0.02, "bend_n_m": 0.2}
"""Largest accepted relative error of a strip, as in the conformance checks."""


def fabric_constants(fabric: Fabric) -> dict[str, FabricConstants]:
    """Return the constants of a fabric for each engine with a mapping, by name of the engine."""
    constants = {ISAAC: surface_constants(fabric)}
    for name in backend_names():
        mapped = backend_class(name).fabric_constants(fabric)
        if mapped is not None:
            constants[name] = mapped
    return constants


def fabric_recipe(
    name: str, fabric: Fabric, engine: str, timestep_s: float | None = None
) -> Recipe:
    """Return a fabric in the constants of an engine, and the stiffness of simulated strips.

    Args:
        name: Name of the fabric.
        fabric: Measured constants of the fabric.
        engine: Name of the engine.
        timestep_s: Time step [s]; None for the default of the backend, which depends on the fabric.

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
    reached: dict[str, float | None] = dict.fromkeys(STIFFNESSES)
    texts = [f"A fall-back sets {text}." for text in mapped.fallbacks]
    texts += [f"The mapping loses {loss}." for loss in mapped.lost]
    versions: Mapping[str, str] = {}
    step_s = None
    if key == ISAAC:
        texts.append("This package does not simulate Isaac Sim.")
    else:
        versions = backend(key).versions()
        changes = {} if timestep_s is None else {"timestep_s": timestep_s}
        lab = Lab(backend(key), {**mapped.settings, **changes})
        strips, notes = _strips(lab, fabric)
        reached |= strips
        texts += notes
        # The last simulation is the hanging strip.
        step_s = lab.effective_settings.get("timestep_s")
    error = {name: difference(reached[name], targets[name]) for name in reached}
    misses = [
        name
        for name, share in TOLERANCES.items()
        if abs(error[name] or 0.0) > share * targets[name]
    ]
    texts += [f"{name}: the simulated strip misses this value." for name in misses]
    assignments = (
        f"{name} = {value:.6g}  # {mapped.units[name]}\n"
        for name, value in mapped.constants.items()
    )
    law = {
        "stretch_n_per_m": mapped.stretch_stiffness_n_per_m,
        "shear_n_per_m": mapped.shear_stiffness_n_per_m,
    }
    return Recipe(
        engine=key,
        asked=targets,
        settings=mapped.constants,
        snippet=mapped.snippet or "".join(assignments),
        reached=reached,
        error=error,
        misses=misses,
        detail={"mapping_gives": law, "timestep_s": step_s},
        wall_s=time.perf_counter() - start_s,
        explanation=" ".join(texts) or NOTHING_LOST,
        versions=versions,
    )


def _strips(lab: Lab, fabric: Fabric) -> tuple[dict[str, float], list[str]]:
    """Return the stiffness of simulated strips, and reasons for strips that diverge or do not settle."""
    free_m = BENT_SHARE * BENT_FREE_M
    bent = cantilever_strip(fabric, free_m, height_m=0.0)
    strips: tuple[tuple[str, Scene, Any, dict[str, Any]], ...] = (
        ("bend_n_m", bent, bending_stiffness, {"cell_m": free_m / CELLS}),
        ("stretch_n_per_m", hanging_strip(fabric), stretch_stiffness, {}),
    )
    reached, texts = dict[str, float](), []
    for name, scene, measure, changes in strips:
        try:
            measurement = measure(lab.rollout(scene, **changes))
        except DivergedError as error:
            texts.append(f"{name}: the simulation diverges: {error}.")
            continue
        if math.isfinite(measurement.measured):
            reached[name] = measurement.measured
        else:
            texts.append(f"{name}: {measurement.hint}.")
    if "bend_n_m" in reached:
        weight_n_per_m2 = fabric.areal_density_kg_per_m2 * GRAVITY_M_PER_S2
        length_m = math.cbrt(max(reached["bend_n_m"], 0.0) / weight_n_per_m2)
        reached["bending_length_m"] = length_m
    return reached, texts


def _measured_constants(fabric: Fabric) -> dict[str, float]:
    """Return the measured constants by name, with the bending length (D / (areal density g))^(1/3) [m]."""
    hinge = fabric.bend_stiffness_n_m_per_rad
    return {
        "stretch_n_per_m": fabric.stretch_stiffness_n_per_m,
        "shear_n_per_m": fabric.shear_stiffness_n_per_m,
        "bend_n_m": plate_bending_stiffness(hinge_stiffness_n_m_per_rad=hinge),
        "bending_length_m": bending_length_m(fabric),
        "areal_density_kg_per_m2": fabric.areal_density_kg_per_m2,
        "thickness_m": fabric.thickness_m,
    }
