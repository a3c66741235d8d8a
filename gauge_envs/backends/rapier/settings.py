"""Numerical settings of the Rapier backend: its presets and the choice of a preset for a scene."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from pydantic import Field

from gauge_envs.backends.settings import (
    SteppedSettings,
    load_presets,
    resolve_settings,
)
from gauge_envs.scene import Scene


class SettingsRapier(SteppedSettings):
    """Settings of Rapier. The defaults are Rapier's, unless the text of a setting says otherwise.

    Attributes:
        solver_iterations: Substeps of the solver in a step, Rapier's `num_solver_iterations`.
        pgs_iterations: Gauss-Seidel iterations in a substep, Rapier's `num_internal_pgs_iterations`.
        stabilization_iterations: Iterations that remove the velocity of position corrections after a substep.
        friction_model: `simplified` has one friction constraint for up to four contact points. `coulomb` has one for
            each point, and its friction force is not opposite to the slip.
        contact_frequency_hz: Natural frequency of contacts between moving bodies. A single contact sinks by
            g / (2 pi f)^2.
        contact_damping_ratio: Damping ratio of the same contacts.
        static_contact_frequency_hz: Natural frequency of contacts with fixed and driven bodies.
        static_contact_damping_ratio: Damping ratio of the same contacts.
        allowed_linear_error_m: Penetration that Rapier does not correct.
        max_corrective_velocity_m_per_s: Largest speed at which Rapier corrects a penetration.
        prediction_distance_m: Distance at which contacts are detected.
        contact_clustering: Merge the contact points of a pair that have nearly the same normal.
        contact_recycling: Keep the contact points of a pair that hardly moved.
        recycle_distance_m: Displacement above which contact points are computed anew.
        warmstart_coefficient: Share of the last impulses from which each step starts.
        warmstart_joints: Start impulse joints from their last impulses too.
        friction_in_bias_pass: Solve friction also while positions are corrected.
        max_linear_velocity_m_per_s: Speed to which Rapier limits bodies.
        hinge_joint: `multibody` keeps a hinge in reduced coordinates, `impulse` as a constraint that loses energy.
        hinge_damping_n_m_s: Torque over angular velocity of multibody hinges [N m s].
        sleep: Let bodies at rest sleep.
        ccd: Continuous collision detection of dynamic bodies.
        threads: Threads of the solver. This package's default is 1, because scenes are small.
    """

    solver_iterations: int = Field(default=4, ge=1, le=1000)
    pgs_iterations: int = Field(default=1, ge=1, le=1000)
    stabilization_iterations: int = Field(default=1, ge=0, le=1000)
    friction_model: Literal["simplified", "coulomb"] = "simplified"
    contact_frequency_hz: float = Field(default=30.0, gt=0.0)
    contact_damping_ratio: float = Field(default=10.0, gt=0.0)
    static_contact_frequency_hz: float = Field(default=60.0, gt=0.0)
    static_contact_damping_ratio: float = Field(default=10.0, gt=0.0)
    allowed_linear_error_m: float = Field(default=0.005, ge=0.0)
    max_corrective_velocity_m_per_s: float = Field(default=3.0, gt=0.0)
    prediction_distance_m: float = Field(default=0.02, gt=0.0)
    contact_clustering: bool = True
    contact_recycling: bool = True
    recycle_distance_m: float = Field(default=0.05, ge=0.0)
    warmstart_coefficient: float = Field(default=1.0, ge=0.0, le=1.0)
    warmstart_joints: bool = False
    friction_in_bias_pass: bool = False
    max_linear_velocity_m_per_s: float = Field(default=400.0, gt=0.0)
    hinge_joint: Literal["multibody", "impulse"] = "multibody"
    hinge_damping_n_m_s: float = Field(default=0.1, ge=0.0)
    sleep: bool = True
    ccd: bool = False
    threads: int = Field(default=1, ge=1, le=256)


PRESETS = load_presets(SettingsRapier, __file__)
"""Presets by name. Both are for every scene."""


def settings_for(
    scene: Scene, changes: Mapping[str, Any] | None = None
) -> SettingsRapier:
    """Return the settings of the scene's preset with a user's changes; see `resolve_settings`."""
    return resolve_settings("rapier", PRESETS, preset="default", changes=changes)
