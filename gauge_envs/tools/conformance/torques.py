"""Say which constant alone explains how a body turns on a hinge, as its motion shows the torque on it.

A body with the inertia I about its hinge, whose weight has the torque W, turns by

    (I + armature) rate' = W - dry sign(rate) - viscous rate
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from gauge_envs.scene import Hinge
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.meshes import mass_properties
from gauge_envs.tools.bench.recording import Recording

UNITS = {
    "dry friction of its hinge": "N m",
    "viscous friction of its hinge": "N m s/rad",
    "armature of its hinge": "kg m^2",
    "inertia": "kg m^2",
    "mass": "kg",
    "gravity": "m/s^2",
}
DRY, VISCOUS, ARMATURE, INERTIA, MASS, GRAVITY = UNITS
"""Constants that a fault may change, with their units."""

SHARES = np.geomspace(0.02, 12.0, 281)
"""Shares of a constant that are tried, beside none and the opposite."""
BODY = (INERTIA, MASS, GRAVITY)
LEAST_TURN_RAD = 0.05
"""Rotation from which on a hinge shows its torques."""
LEAST, LEFT, MANY = 2e-3, 0.1, 0.9
"""Share of the torques that may be unexplained, of that which a cause leaves, and of the samples that say so."""


class _Turning:
    """Motion of a body on a hinge with the constants of the scene: angles from the start [rad], shape [T]."""

    def __init__(self, rollout: Recording, hinge: Hinge) -> None:
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
            tensor = body.inertia_kg_m2 * np.eye(3)
        arms_m = (rollout.position(body.name) + turns.apply(centre_m) - hinge.anchor_m)[
            1:-1
        ]
        # Torque of a weight of 1 N.
        self.levers_m = np.cross(arms_m, [0.0, 0.0, -1.0]) @ axis
        inner = turns[0].apply(axis, inverse=True)
        self.about_hinge_m2 = float(np.square(np.cross(arms_m[0], axis)).sum())
        self.follows_mass = body.inertia_kg_m2 is None
        self.mass_kg = body.mass_kg
        self.values = {
            DRY: 0.0,
            VISCOUS: 0.0,
            ARMATURE: 0.0,
            INERTIA: float(inner @ tensor @ inner),
            MASS: body.mass_kg,
            GRAVITY: scene.gravity_m_per_s2,
        }

    def torques_n_m(self, **changed: float) -> dict[str, FloatArray]:
        """Return all torques on the body, with that of its inertia, for the constants of the scene but for changes."""
        values = self.values | changed
        inertia = values[INERTIA] + values[ARMATURE]
        inertia += values[MASS] * self.about_hinge_m2
        if self.follows_mass:
            inertia += values[INERTIA] * (values[MASS] / self.mass_kg - 1.0)
        return {
            "weight": values[MASS] * values[GRAVITY] * self.levers_m,
            "dry": -values[DRY] * np.sign(self.rates),
            "viscous": -values[VISCOUS] * self.rates,
            "inertia": -inertia * self.accelerations,
        }

    def left_n_m(self, **changed: float) -> FloatArray:
        """Return the torque that no term explains [N m], shape [T]; nothing where dry friction may hold the body."""
        moves = np.abs(self.rates) > 0.02 * np.abs(self.rates).max()
        return np.abs(sum(self.torques_n_m(**changed).values()))[moves]

    def best(self, name: str, size: float, floor: Any) -> tuple[float, float]:
        """Return the least torque that another value of a constant leaves [N m], and that value.

        Args:
            name: Name of the constant.
            size: Torque that is not explained [N m].
            floor: Torque that is left where the value does not act [N m].
        """

        def left_n_m(value: float) -> float:
            left = np.minimum(self.left_n_m(**{name: value}), floor)
            return float(np.quantile(left, MANY))

        stated = self.values[name]
        if name in BODY:
            # Without inertia nothing is left to explain.
            tried = stated * SHARES[SHARES > 2.0 * LEFT]
        else:
            effect = np.abs(self.left_n_m(**{name: 1.0}) - self.left_n_m())
            tried = SHARES * size / max(float(np.quantile(effect, MANY)), 1e-12)
        with np.errstate(invalid="ignore"):
            best = min(tried, key=left_n_m)
        # A constant that is a hundredth off is known to a ten-thousandth, or another one would explain more.
        for span in (0.025, 0.001):
            near = best * np.linspace(1.0 - span, 1.0 + span, 51)
            best = min((best, *near), key=left_n_m)
        return left_n_m(best), float(best)


def wrong_torques(rollout: Recording) -> Iterator[str]:
    """Yield for each hinge on which a body turns otherwise the constants that explain it alone."""
    scene = rollout.scene
    bound = {name for one in scene.contacts for name in one.first + one.second}
    for name, hinge in scene.hinges.items():
        if name in bound:
            continue
        least = 10.0 * LEAST if scene.contacts else LEAST
        if cause := _cause(_Turning(rollout, hinge), least):
            yield f"the {hinge.body} turns as if the {cause}"


def _cause(turning: _Turning, least: float) -> str:
    """Return the constants of which another value leaves a tenth of the torque that is not explained.

    Args:
        turning: The motion.
        least: Share of the largest torque from which on one is not explained.
    """
    unexplained = turning.left_n_m()
    if len(unexplained) < 8 or np.ptp(turning.angles) < LEAST_TURN_RAD:
        return ""
    size = float(np.quantile(unexplained, MANY))
    terms = turning.torques_n_m()
    largest = max(np.quantile(np.abs(one), MANY) for one in terms.values())
    # What changes no rate is rounding.
    gained = size * np.ptp(turning.times_s) / turning.values[INERTIA]
    if size < least * largest or gained < least * np.abs(turning.rates).max():
        return ""
    for when, floor in (("", np.inf), (" for part of the time", unexplained)):
        found = {name: turning.best(name, size, floor) for name in turning.values}
        limit = min(2.0 * min(found.values())[0] + 0.01 * size, LEFT * size)
        alike = {name: value for name, (left, value) in found.items() if left < limit}
        texts = [
            f"{name} were {alike[name]:.3g} {UNITS[name]} instead of {turning.values[name]:.3g}"
            for name in alike
        ]
        if texts:
            return f"{', or the '.join(texts)}{when}"
    return ""
