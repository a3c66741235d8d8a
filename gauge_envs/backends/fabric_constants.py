"""Constants of a measured fabric in an engine's own terms, with their fallbacks and losses.

Each engine has another membrane and another hinge. The mapping of an engine lies in its folder and matches the response
at small strain (paper, section "Textile parameters mapping").
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from gauge_envs.scene.fabrics import Fabric


@dataclass(frozen=True, kw_only=True)
class FabricConstants:
    """Constants of a fabric in one engine.

    Attributes:
        engine: Name of the engine.
        fabric: The measured fabric.
        constants: Constants under the engine's names.
        units: Unit of each constant; "1" for a pure number.
        stretch_stiffness_n_per_m: Force per width over strain of the mapped fabric at small strain, transverse edges
            free, by the law of the engine.
        shear_stiffness_n_per_m: Force per width over engineering shear strain of the mapped fabric, likewise.
        snippet: The constants in the engine's own language; empty to list them.
        replaced: Names of the constants that a fallback sets.
        fallbacks: Description of each fallback and its reason.
        has_shear_constant: Whether a constant of the engine determines the shear stiffness.
        settings: Settings of the backend with which its engine takes these constants as they are.
    """

    engine: str
    fabric: Fabric
    constants: dict[str, float]
    units: dict[str, str]
    stretch_stiffness_n_per_m: float
    shear_stiffness_n_per_m: float
    snippet: str = ""
    replaced: tuple[str, ...] = ()
    fallbacks: tuple[str, ...] = ()
    has_shear_constant: bool = True
    settings: Mapping[str, Any] = field(default_factory=dict)

    @property
    def lost(self) -> tuple[str, ...]:
        """Description of each measured stiffness that the engine does not reproduce, with its error."""
        shear = self.shear_stiffness_n_per_m
        measured = self.fabric.shear_stiffness_n_per_m
        if self.has_shear_constant and math.isclose(shear, measured, rel_tol=1e-9):
            return ()
        reason = "" if self.has_shear_constant else "no such constant, "
        return (
            f"shear: {reason}{shear:.4g} N/m instead of {measured:.4g} ({shear / measured - 1.0:+.0%})",
        )
