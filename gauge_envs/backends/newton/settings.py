"""Numerical settings of the Newton backend: the presets, and which preset a scene gets.

Newton has many solvers, and each has its own settings. A preset names its solver; it is picked from what the scene
contains, never from how well it scores.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from pydantic import Field

from gauge_envs.backends.presets import SteppedSettings, resolve_settings
from gauge_envs.scene import Scene

__all__ = ["PRESETS", "SettingsMuJoCoWarp", "SettingsNewton", "settings_for"]


class SettingsNewton(SteppedSettings):
    """Settings that every solver has.

    Attributes:
        solver: Newton's name of the solver.
        device: Where it runs: `cpu`, `cuda:0`, ...
    """

    solver: str
    device: str = "cpu"


class SettingsMuJoCoWarp(SettingsNewton):
    """Settings of Newton's MuJoCo solver, MuJoCo Warp in single precision.

    Attributes:
        integrator: Its name of the integrator.
        cone: Friction cone.
        impratio: Ratio of frictional to normal constraint impedance; above 1 it keeps resting bodies from creeping.
        iterations: Cap on solver iterations.
        line_search_iterations: Cap on iterations of each line search.
        tolerance: Solver tolerance.
        sustained_solref: Time constant [s] and damping ratio of sustained contacts.
        sustained_solimp: Impedance of sustained contacts: d0, dwidth, width [m].
        impact_stiffness: Dimensionless stiffness s of impacts, as in the MuJoCo backend: the direct solref of a pair is
            (-s/h^2, -(1+e)/h). Newton's own `restitution` has no effect in this solver.
        impact_solimp: Impedance of impacts; constant in depth, since the rebound would depend on depth otherwise.
        newton_material: Leave stiffness, damping and friction gain of contacts at Newton's own values, whatever the
            four settings above say; the scene's restitution then has no effect.
    """

    solver: Literal["SolverMuJoCo"] = "SolverMuJoCo"
    integrator: Literal["euler", "rk4", "implicitfast"] = "implicitfast"
    cone: Literal["pyramidal", "elliptic"] = "elliptic"
    impratio: float = Field(default=10.0, gt=0.0)
    iterations: int = Field(default=100, ge=1)
    line_search_iterations: int = Field(default=50, ge=1)
    tolerance: float = Field(default=1e-8, ge=0.0)
    sustained_solref: tuple[float, float] = (0.005, 1.0)
    sustained_solimp: tuple[float, float, float] = (0.95, 0.95, 0.001)
    impact_stiffness: float = Field(default=0.002, gt=0.0)
    impact_solimp: tuple[float, float, float] = (0.99, 0.99, 0.001)
    newton_material: bool = False


PRESETS: dict[str, SettingsNewton] = {
    # Chosen on closed forms, not on scores. The angular momentum of a tumbling brick drifts by 0.7 % in half a second,
    # in proportion to the step. A carried body creeps by omega^2 r times half the contact's time constant, as in
    # MuJoCo; a shorter one lets sliding cubes hop higher.
    "rigid": SettingsMuJoCoWarp(preset="rigid", timestep_s=1 / 3600),
    # Newton as it comes, at the rate of the paper's rigid runs; only masses, shapes and friction are the scene's.
    "out_of_box": SettingsMuJoCoWarp(
        preset="out_of_box", timestep_s=1 / 180, cone="pyramidal", impratio=1.0, newton_material=True
    ),
    "impact_chain": SettingsMuJoCoWarp(
        preset="impact_chain", timestep_s=1 / 9000, impact_solimp=(0.9999, 0.9999, 0.001)
    ),
    "contact_free": SettingsMuJoCoWarp(preset="contact_free", timestep_s=1 / 1800, integrator="rk4"),
}


def _preset_name(scene: Scene) -> str:
    if not scene.contacts:
        return "contact_free"
    return "impact_chain" if scene.has_impact_chain else "rigid"


def settings_for(scene: Scene, changes: Mapping[str, Any] | None = None) -> SettingsNewton:
    """Settings of a scene: its preset, with a user's changes put in.

    Raises:
        UnknownNameError: No such preset.
        ParameterError: No such setting, or an impossible value.
    """
    return resolve_settings("Newton", PRESETS, preset=_preset_name(scene), changes=changes)
