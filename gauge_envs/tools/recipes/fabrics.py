"""Recipes of fabrics: an engine's constants for a measured fabric, and the stiffness that a simulated strip has."""

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from gauge_envs.backends.fabric_constants import FabricConstants
from gauge_envs.backends.registry import backend, backend_class, backend_names
from gauge_envs.errors import ParameterError
from gauge_envs.files import json_ready
from gauge_envs.scene import GRAVITY_M_PER_S2
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
from gauge_envs.tools.usd import surface_constants

NOT_SIMULATED = {
    "isaac": "Isaac Sim is not run by this package, so that nothing is simulated"
}
"""Engines that are not simulated, with the reason."""

NOTHING_LOST = "Stretch and bending stiffness are reached in simulation, and shear by the law of the engine."

BENT_SHARE = 0.2
"""Free length of the cantilever over that of the conformance check, so that a soft fabric swings within a second."""

CELLS = 6
"""Cells along the free length, as in the conformance check."""


@dataclass(frozen=True, kw_only=True)
class FabricRecipe:
    """Constants of one engine for one fabric, and what they give.

    Attributes:
        engine: Name of the engine.
        versions: Versions of its packages; empty if it is not simulated.
        name: Name of the fabric.
        mapped: The engine's constants, with what the mapping loses.
        stretch_n_per_m: K_s of a simulated strip that hangs [N/m]; None if it was not simulated.
        bend_n_m: Bending stiffness per width of a simulated cantilever [N m]; None if it was not simulated.
        timestep_s: Time step of the engine [s]; None if it was not simulated.
        faults: What went wrong in a simulation.
        wall_s: Wall time of the simulations [s].
    """

    engine: str
    versions: Mapping[str, str] = field(default_factory=dict)
    name: str
    mapped: FabricConstants
    stretch_n_per_m: float | None = None
    bend_n_m: float | None = None
    timestep_s: float | None = None
    faults: tuple[str, ...] = ()
    wall_s: float = 0.0

    @property
    def asked(self) -> dict[str, float]:
        """Measured constants by name, and the bending length (D / (areal density g))^(1/3) [m]."""
        fabric = self.mapped.fabric
        return {
            "stretch_n_per_m": fabric.stretch_stiffness_n_per_m,
            "shear_n_per_m": fabric.shear_stiffness_n_per_m,
            "bend_n_m": plate_bending_stiffness(
                hinge_stiffness_n_m_per_rad=fabric.bend_stiffness_n_m_per_rad
            ),
            "bending_length_m": bending_length_m(fabric),
            "areal_density_kg_per_m2": fabric.areal_density_kg_per_m2,
            "thickness_m": fabric.thickness_m,
        }

    @property
    def reached(self) -> dict[str, float | None]:
        """Stiffness of the simulated strips by name; None for what was not simulated."""
        length = None
        if self.bend_n_m is not None and self.bend_n_m > 0.0:
            length = math.cbrt(
                self.bend_n_m
                / (self.mapped.fabric.areal_density_kg_per_m2 * GRAVITY_M_PER_S2)
            )
        values = (self.stretch_n_per_m, None, self.bend_n_m, length)
        return dict(
            zip(
                ("stretch_n_per_m", "shear_n_per_m", "bend_n_m", "bending_length_m"),
                values,
                strict=True,
            )
        )

    @property
    def mapping_gives(self) -> dict[str, float]:
        """Stiffness of the engine's law at small strain, without a simulation."""
        return {
            "stretch_n_per_m": self.mapped.stretch_stiffness_n_per_m,
            "shear_n_per_m": self.mapped.shear_stiffness_n_per_m,
        }

    @property
    def error(self) -> dict[str, float | None]:
        """Reached less asked values by name; None for what was not simulated."""
        found = self.reached
        return {
            key: None if value is None else value - self.asked[key]
            for key, value in found.items()
        }

    @property
    def misses(self) -> tuple[str, ...]:
        """Simulated values beyond the tolerances of the conformance checks of cloth."""
        found: list[str] = []
        for key, name in (
            ("stretch_n_per_m", "cloth-stretch"),
            ("bend_n_m", "cloth-bending"),
        ):
            value, target = self.reached[key], self.asked[key]
            width = checks((name,))[0].tolerance.width(target)
            if value is not None and not abs(value - target) <= width:
                found.append(key)
        return tuple(found)

    @property
    def explanation(self) -> str:
        """What the mapping loses, what a strip misses, and what is not simulated."""
        texts = [f"A fall-back sets {fallback}." for fallback in self.mapped.fallbacks]
        texts += [f"The mapping loses {loss}." for loss in self.mapped.lost]
        for key in self.misses:
            value = self.reached[key]
            assert value is not None, "a miss was simulated"
            ratio = value / self.asked[key]
            texts.append(
                f"{key}: the simulated strip has {value:.4g}, {ratio:.3g} of what is asked."
            )
        texts += [f"{fault}." for fault in self.faults]
        return " ".join(texts) or NOTHING_LOST

    def json(self) -> dict[str, Any]:
        """Return the recipe as one JSON-ready object, with the names of a contact's recipe."""
        return json_ready(
            {
                "engine": self.engine,
                "material": self.name,
                "asked": self.asked,
                "settings": self.mapped.constants,
                "snippet": fabric_snippet(self.mapped),
                "reached": self.reached,
                "error": self.error,
                "misses": self.misses,
                "detail": {
                    "mapping_gives": self.mapping_gives,
                    "timestep_s": self.timestep_s,
                },
                "wall_s": self.wall_s,
                "explanation": self.explanation,
                "versions": dict(self.versions),
            }
        )


def fabric_constants(fabric: Fabric) -> dict[str, FabricConstants]:
    """Return a fabric in the constants of each engine that has a mapping, simulated or not, by name of the engine."""
    found = {"isaac": surface_constants(fabric)}
    for name in backend_names():
        mapped = backend_class(name).fabric_constants(fabric)
        if mapped is not None:
            found[name] = mapped
    return found


def fabric_recipe(
    name: str, fabric: Fabric, engine: str, timestep_s: float | None = None
) -> FabricRecipe:
    """Return a fabric in an engine's constants, and the stiffness that simulated strips have with them.

    Args:
        name: Name of the fabric.
        fabric: Its measured constants.
        engine: Name of the engine.
        timestep_s: Time step [s]; None for the default of the engine's backend, which depends on the fabric.
    """
    key = "isaac" if engine == "isaac_sim" else engine
    known = fabric_constants(fabric)
    if key not in known:
        raise ParameterError(
            f"engine {engine!r} has no mapping of fabrics: choose one of {', '.join(known)}"
        )
    mapped = known[key]
    if key in NOT_SIMULATED:
        return FabricRecipe(
            engine=key, name=name, mapped=mapped, faults=(NOT_SIMULATED[key],)
        )
    simulated = backend(key)
    given = dict(mapped.settings) | (
        {} if timestep_s is None else {"timestep_s": timestep_s}
    )
    start = time.perf_counter()
    free_m = BENT_SHARE * BENT_FREE_M
    hung, bent = hanging_strip(fabric), cantilever_strip(fabric, free_m, height_m=0.0)
    faults: list[str] = []
    values: dict[str, float] = {}
    steps: list[float] = []
    for quantity, scene, cell, measure in (
        ("stretch_n_per_m", hung, {}, stretch_stiffness),
        ("bend_n_m", bent, {"cell_m": free_m / CELLS}, bending_stiffness),
    ):
        lab = Lab(simulated, given | cell)
        try:
            found = measure(lab.rollout(scene))
        except DivergedError as error:
            faults.append(f"{quantity}: the simulation diverges: {error}")
        else:
            if math.isfinite(found.measured):
                values[quantity] = found.measured
            else:
                faults.append(
                    f"{quantity}: the strip was simulated for {scene.duration_s:.3g} s, and {found.hint}"
                )
        steps.append(float(lab.settings_in_force.get("timestep_s", math.nan)))
    return FabricRecipe(
        engine=key,
        versions=simulated.versions(),
        name=name,
        mapped=mapped,
        timestep_s=steps[0],
        faults=tuple(faults),
        wall_s=time.perf_counter() - start,
        **values,
    )


def fabric_snippet(mapped: FabricConstants) -> str:
    """Return the constants of a fabric in the engine's own language."""
    lines = (
        f"{name} = {value:.6g}  # {mapped.units[name]}\n"
        for name, value in mapped.constants.items()
    )
    return mapped.snippet or "".join(lines)
