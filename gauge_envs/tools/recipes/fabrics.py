"""Convert measured fabrics to engine constants, and measure the bending stiffness of a simulated strip."""

import math

from gauge_envs.backends.fabric_constants import FabricConstants
from gauge_envs.backends.registry import backend, backend_class, backend_names
from gauge_envs.errors import ParameterError
from gauge_envs.fixtures.recording import DivergedError
from gauge_envs.formats.usd import surface_constants
from gauge_envs.scene import GRAVITY_M_PER_S2
from gauge_envs.scene.fabrics import Fabric, bending_length_m
from gauge_envs.tools.conformance import (
    BENT_FREE_M,
    Lab,
    bending_stiffness,
    cantilever_strip,
)
from gauge_envs.tools.recipes.search import Recipe, difference

ISAAC = "isaac"
"""Engine with a mapping but without a simulation: this package does not run Isaac Sim."""

NOTHING_LOST = "The engine's law has the stretch and shear stiffness; a simulated strip has the bending stiffness."

BENT_SHARE = 0.2
"""Free length of the cantilever, divided by the length of the conformance check: soft fabrics swing within 1 s."""

CELLS = 6
"""Cells along the free length, as in the conformance check."""

BEND_TOLERANCE = 0.2
"""Largest accepted relative error of the bending stiffness, as in the conformance checks."""


def fabric_of_tests(
    *,
    bending_length_m: float,
    stretch_n_per_m: float,
    shear_n_per_m: float,
    areal_density_kg_per_m2: float,
    thickness_m: float,
) -> Fabric:
    """Return a fabric from its tests.

    The bending stiffness per width is B = w c^3, with weight per area w and bending length c (Peirce 1930; ASTM D1388).

    Args:
        bending_length_m: c, half the overhang at which a strip droops to 41.5 degrees.
        stretch_n_per_m: Slope of force per width over strain, with free transverse edges.
        shear_n_per_m: Slope of force per width over engineering shear strain.
        areal_density_kg_per_m2: Mass per area.
        thickness_m: Thickness.

    Raises:
        ParameterError: A value is not positive.
    """
    weight_n_per_m2 = areal_density_kg_per_m2 * GRAVITY_M_PER_S2
    return Fabric(
        stretch_stiffness_n_per_m=stretch_n_per_m,
        shear_stiffness_n_per_m=shear_n_per_m,
        # On a square grid of hinges, K_theta is B, see `Fabric`.
        bend_stiffness_n_m_per_rad=weight_n_per_m2 * bending_length_m**3,
        thickness_m=thickness_m,
        areal_density_kg_per_m2=areal_density_kg_per_m2,
    )


def fabric_constants(fabric: Fabric) -> dict[str, FabricConstants]:
    """Return the constants of a fabric for each engine with a mapping, by name of the engine."""
    constants = {ISAAC: surface_constants(fabric)}
    for name in backend_names():
        mapped = backend_class(name).fabric_constants(fabric)
        if mapped is not None:
            constants[name] = mapped
    return constants


def fabric_recipe(
    fabric: Fabric, engine: str, timestep_s: float | None = None
) -> Recipe:
    """Return a fabric in the constants of an engine, with the stiffness by its law and of a simulated strip.

    Args:
        fabric: Measured constants of the fabric.
        engine: Name of the engine.
        timestep_s: Time step [s]; None for the default of the backend, which depends on the fabric.

    Raises:
        MissingExtraError: The engine is not installed.
        ParameterError: The engine has no mapping of fabrics.
    """
    known = fabric_constants(fabric)
    if engine not in known:
        raise ParameterError(
            f"engine {engine!r} has no mapping of fabrics: choose one of {', '.join(known)}"
        )
    mapped = known[engine]
    targets = {
        "stretch_n_per_m": fabric.stretch_stiffness_n_per_m,
        "shear_n_per_m": fabric.shear_stiffness_n_per_m,
        "bend_n_m": fabric.bend_stiffness_n_m_per_rad,
        "bending_length_m": bending_length_m(fabric),
    }
    reached = {
        **dict.fromkeys(targets),
        "stretch_n_per_m": mapped.stretch_stiffness_n_per_m,
        "shear_n_per_m": mapped.shear_stiffness_n_per_m,
    }
    texts = [f"A fall-back sets {text}." for text in mapped.fallbacks]
    texts += [f"The mapping loses {loss}." for loss in mapped.lost]
    versions = {}
    if engine == ISAAC:
        texts.append("This package does not simulate Isaac Sim.")
    else:
        versions = backend(engine).versions()
        changes = {} if timestep_s is None else {"timestep_s": timestep_s}
        lab = Lab(backend(engine), {**mapped.settings, **changes})
        try:
            reached |= _bending(lab, fabric)
        except DivergedError as cause:
            texts.append(f"The bent strip has no stiffness: {cause}.")
    error = {name: difference(reached[name], targets[name]) for name in reached}
    misses = []
    if abs(error["bend_n_m"] or 0.0) > BEND_TOLERANCE * targets["bend_n_m"]:
        misses.append("bend_n_m")
        texts.append("The simulated strip misses the bending stiffness.")
    assignments = (
        f"{name} = {value:.6g}  # {mapped.units[name]}\n"
        for name, value in mapped.constants.items()
    )
    return Recipe(
        engine=engine,
        asked=targets,
        settings=mapped.constants,
        snippet=mapped.snippet or "".join(assignments),
        reached=reached,
        error=error,
        misses=misses,
        explanation=" ".join(texts) or NOTHING_LOST,
        versions=versions,
    )


def _bending(lab: Lab, fabric: Fabric) -> dict[str, float]:
    """Return bending stiffness and bending length of a simulated cantilever.

    Raises:
        DivergedError: The simulation diverges or does not settle.
    """
    free_m = BENT_SHARE * BENT_FREE_M
    strip = cantilever_strip(fabric, free_m, height_m=0.0)
    measurement = bending_stiffness(lab.rollout(strip, cell_m=free_m / CELLS))
    stiffness_n_m = measurement.measured
    if not math.isfinite(stiffness_n_m):
        raise DivergedError(measurement.hint)
    weight_n_per_m2 = fabric.areal_density_kg_per_m2 * GRAVITY_M_PER_S2
    length_m = math.cbrt(max(stiffness_n_m, 0.0) / weight_n_per_m2)
    return {"bend_n_m": stiffness_n_m, "bending_length_m": length_m}
