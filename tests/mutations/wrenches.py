"""Faults of wrenches on bodies."""

import numpy as np

from gauge_envs.scene import Cylinder, Sphere
from gauge_envs.scene.meshes import mass_properties
from mutations.mutant import Passed, fault


class _WrenchOnce(Passed):
    """Applies a wrench during one interval only."""

    def begin(self):
        self._applied = set()

    def apply_wrench(self, body, wrench):
        super().apply_wrench(body, wrench)
        self._applied.add(body)

    def advance(self, seconds):
        super().advance(seconds)
        for body in self._applied:
            super().apply_wrench(body, np.zeros(6))
        self._applied = set()


class _ForceAtOrigin(Passed):
    """Applies the force at the body origin."""

    def apply_wrench(self, body, wrench):
        one = self.scene.body(body)
        centre_m, _ = mass_properties(one.shape, 1.0)
        torque = np.cross(-one.pose.rotation.apply(centre_m), wrench[:3])
        super().apply_wrench(body, wrench + np.concatenate([np.zeros(3), torque]))


class _RollingFriction(Passed):
    """Brakes spheres and cylinders in contact by a torque of 0.01 m g times their radius."""

    def begin(self):
        touching = {
            name
            for contact in self.scene.contacts
            for name in (*contact.first, *contact.second)
        }
        self._levers = {
            one.name: 0.01
            * one.mass_kg
            * self.scene.gravity_m_per_s2
            * one.shape.radius_m
            for one in self.scene.dynamic_bodies
            if isinstance(one.shape, Sphere | Cylinder) and one.name in touching
        }

    def advance(self, seconds):
        for name, largest in self._levers.items():
            spin = self.inner.body_states([name])[0, 10:]
            # The torque falls to zero below 0.05 rad/s, so that bodies at rest do not jitter.
            torque = -largest * spin / max(float(np.linalg.norm(spin)), 0.05)
            super().apply_wrench(name, np.concatenate([np.zeros(3), torque]))
        super().advance(seconds)


class _IgnoredOnHinges(Passed):
    """Ignores wrenches on bodies with a hinge."""

    def apply_wrench(self, body, wrench):
        if body not in self.scene.hung:
            super().apply_wrench(body, wrench)


FAULTS = dict(
    (
        fault(
            "wrench-hinged",
            "wrench ignored on bodies with a hinge",
            "wrench-hinged",
            "ignored on bodies with a hinge",
            simulation=_IgnoredOnHinges,
        ),
        fault(
            "rolling-friction",
            "rolling friction of 0.01",
            "roll-ball",
            "rolling friction were",
            simulation=_RollingFriction,
        ),
        fault(
            "wrench-once",
            "wrench acts for one interval",
            "wrench-force",
            "first interval only",
            simulation=_WrenchOnce,
        ),
        fault(
            "wrench-origin",
            "force acts at the body origin",
            "wrench-centre",
            "the force acts at the body origin",
            simulation=_ForceAtOrigin,
        ),
    )
)
"""Faults by id."""
