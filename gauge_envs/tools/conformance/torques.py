"""Say which constant alone explains how a body turns on a hinge, as its motion shows the torque on it.

A body with the inertia I about its hinge, whose weight has the torque W, turns by

    (I + armature) rate' = motor + W - dry sign(rate) - viscous rate
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from gauge_envs.runs.rollout import Rollout
from gauge_envs.scene import Hinge
from gauge_envs.scene.meshes import mass_properties
from gauge_envs.scene.motors import Servo, TorqueMotor

Array = NDArray[np.float64]

UNITS = {
    "kp of its servo": "N m/rad",
    "kv of its servo": "N m s/rad",
    "torque limit of its servo": "N m",
    "delay of its motor": "s",
    "share of its motor's torque": "",
    "dry friction of its hinge": "N m",
    "viscous friction of its hinge": "N m s/rad",
    "armature of its hinge": "kg m^2",
    "inertia": "kg m^2",
    "mass": "kg",
    "gravity": "m/s^2",
}
KP, KV, LIMIT, DELAY, SHARE, DRY, VISCOUS, ARMATURE, INERTIA, MASS, GRAVITY = UNITS
"""Constants that a fault may change, with their units."""

SHARES = np.geomspace(0.02, 12.0, 281)
"""Shares of a constant that are tried, beside none."""
LEAST, LEFT, MANY = 0.01, 0.1, 0.9
"""Share of the torques that may be unexplained, of that which a cause leaves, and of the samples that say so."""


class _Turning:
    """Motion of a body on a hinge with the constants of the scene: angles from the start [rad], shape [T]."""

    def __init__(self, rollout: Rollout, hinge: Hinge) -> None:
        scene = rollout.scene
        body, axis = scene.body(hinge.body), np.array(hinge.axis)
        turns, interval_s = rollout.rotation(body.name), rollout.interval_s
        steps = (turns[1:] * turns[:-1].inv()).as_rotvec() @ axis
        self.angles = np.concatenate([[0.0], np.cumsum(steps)])[1:-1]
        self.rates = 0.5 * (steps[1:] + steps[:-1]) / interval_s
        self.accelerations = np.diff(steps) / interval_s**2
        self.times_s = rollout.times_s[1:-1]
        centre_m, tensor = mass_properties(body.shape, body.mass_kg)
        if body.inertia_kg_m2 is not None:
            stated = np.array(body.inertia_kg_m2)
            is_tensor = stated.ndim == 1
            tensor = (
                stated[[[0, 3, 4], [3, 1, 5], [4, 5, 2]]]
                if is_tensor
                else stated * np.eye(3)
            )
        arms_m = (rollout.position(body.name) + turns.apply(centre_m) - hinge.anchor_m)[
            1:-1
        ]
        # Torque of a weight of 1 N.
        self.levers_m = np.cross(arms_m, [0.0, 0.0, -1.0]) @ axis
        inner = turns[0].apply(axis, inverse=True)
        across_m2 = np.square(arms_m[0]).sum() - (arms_m[0] @ axis) ** 2
        self.about_hinge_m2 = float(across_m2)
        self.follows_mass = body.inertia_kg_m2 is None
        self.mass_kg = body.mass_kg
        self.motor = motor = hinge.motor
        terms = hinge.dynamics
        self.values = {
            DRY: terms.dry_friction_n_m,
            VISCOUS: terms.viscous_friction_n_m_s_per_rad,
            ARMATURE: terms.armature_kg_m2,
            INERTIA: float(inner @ tensor @ inner),
            MASS: body.mass_kg,
            GRAVITY: scene.gravity_m_per_s2,
        }
        if motor is not None:
            self.values[DELAY] = motor.delay_s
        if isinstance(motor, Servo):
            self.values[KP] = motor.kp_n_m_per_rad
            self.values[KV] = motor.kv_n_m_s_per_rad
            self.values[LIMIT] = motor.torque_limit_n_m or np.inf
        elif motor is not None:
            self.values[SHARE] = 1.0

    def torques_n_m(self, **changed: float) -> dict[str, Array]:
        """Return all torques on the body, with that of its inertia, for the constants of the scene but for changes."""
        values = self.values | changed
        inertia = values[INERTIA] + values[ARMATURE]
        inertia += values[MASS] * self.about_hinge_m2
        if self.follows_mass:
            inertia += values[INERTIA] * (values[MASS] / self.mass_kg - 1.0)
        return {
            "motor": self._motor_n_m(values),
            "weight": values[MASS] * values[GRAVITY] * self.levers_m,
            "dry": -values[DRY] * np.sign(self.rates),
            "viscous": -values[VISCOUS] * self.rates,
            "inertia": -inertia * self.accelerations,
        }

    def _motor_n_m(self, values: dict[str, float]) -> Array:
        motor = self.motor
        if motor is None:
            return np.zeros_like(self.rates)
        asked = motor.command.values_at(np.maximum(self.times_s - values[DELAY], 0.0))
        if isinstance(motor, TorqueMotor):
            return np.asarray(values[SHARE] * asked)
        torque = values[KP] * (asked - self.angles) - values[KV] * self.rates
        return np.clip(torque, -values[LIMIT], values[LIMIT])

    def left_n_m(self, **changed: float) -> Array:
        """Return the torque that no term explains [N m], shape [T]; nothing where dry friction may hold the body."""
        moves = np.abs(self.rates) > 0.02 * np.abs(self.rates).max()
        return np.abs(sum(self.torques_n_m(**changed).values()))[moves]


def wrong_torques(rollout: Rollout) -> Iterator[str]:
    """Yield for each hinge on which a body turns otherwise the constants that explain it alone."""
    scene = rollout.scene
    bound = {name for one in scene.contacts for name in one.first + one.second}
    bound |= {name for one in scene.body_hinges for name in (one.first, one.second)}
    bound |= {one.body for one in scene.guides}
    for hinge in scene.joints:
        if not isinstance(hinge, Hinge) or hinge.body in bound or hinge.limits_rad:
            continue
        terms = hinge.dynamics
        if (
            terms.backlash_rad
            or terms.quadratic_friction_n_m_s2_per_rad2
            or terms.servo
        ):
            continue
        if cause := _cause(_Turning(rollout, hinge)):
            yield f"the {hinge.body} turns as if the {cause}"


def _cause(turning: _Turning) -> str:
    """Return the constants of which another value leaves a tenth of the torque that is not explained."""
    unexplained = turning.left_n_m()
    if len(unexplained) < 8:
        return ""
    size = float(np.quantile(unexplained, MANY))
    largest = max(
        np.quantile(np.abs(one), MANY) for one in turning.torques_n_m().values()
    )
    if not size > LEAST * largest:
        return ""
    for when, floor in (("", np.inf), (" for part of the time", unexplained)):
        found = {}
        for name, stated in turning.values.items():
            unit = stated if 0.0 < stated < np.inf else _unit(turning, name, size)
            # Without inertia nothing is left to explain.
            shares = SHARES[SHARES > LEFT] if name in (INERTIA, MASS) else [0, *SHARES]
            tried = {}
            for value in np.multiply(unit, shares):
                left = np.minimum(turning.left_n_m(**{name: value}), floor)
                tried[float(value)] = float(np.quantile(left, MANY))
            best = min(tried, key=lambda value: tried[value])
            found[name] = tried[best], best
        least = min(left for left, _ in found.values())
        if least < LEFT * size:
            alike = [
                f"{name} were {value:.3g} {UNITS[name]} instead of {turning.values[name]:.3g}"
                for name, (left, value) in found.items()
                if left < min(2.0 * least + 0.01 * size, LEFT * size)
            ]
            return f"{', or the '.join(alike)}{when}"
    return ""


def _unit(turning: _Turning, name: str, size: float) -> float:
    """Return a value of a constant that the scene leaves out with which it explains a torque [N m]."""
    if name == LIMIT:
        return float(np.abs(turning.torques_n_m()["motor"]).max())
    if name == DELAY:
        return 0.05
    effect = np.abs(turning.left_n_m(**{name: 1.0}) - turning.left_n_m())
    return size / max(float(np.quantile(effect, MANY)), 1e-12)
