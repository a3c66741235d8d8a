"""Faults of what a simulation reports: poses, velocities, nodes."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gauge_envs.scene import Motion, Rod, Rope
from gauge_envs.scene.meshes import mass_properties
from mutations.mutant import Passed, fault

Array = NDArray[np.float64]


def _reporting(change):
    """Return a simulation that reports other states than it has."""

    class Misreported(Passed):
        def body_states(self, names):
            states = super().body_states(names)
            change(states)
            return states

    return Misreported


def _scalar_last(states):
    states[:, 3:7] = np.roll(states[:, 3:7], -1, axis=1)


def _inverse(states):
    states[:, 4:7] *= -1.0


def _millimetres(states):
    states[:, :3] *= 1e3


def _spin_in_degrees(states):
    states[:, 10:] = np.degrees(states[:, 10:])


def _spin_reversed(states):
    states[:, 10:] *= -1.0


def _quaternion_grown(states):
    fast = np.linalg.norm(states[:, 10:], axis=1) > 50.0
    states[fast, 3:7] *= 1.001


class _VelocityOfCentre(Passed):
    """Reports the velocity of the centre of mass."""

    def body_states(self, names):
        states = super().body_states(names)
        for row, name in zip(states, names, strict=True):
            centre_m, _ = mass_properties(self.scene.body(name).shape, 1.0)
            row[7:10] += np.cross(
                row[10:],
                Rotation.from_quat(row[3:7], scalar_first=True).apply(centre_m),
            )
        return states


class _SceneOrder(Passed):
    """Returns rows in alphabetical order."""

    def body_states(self, names):
        return super().body_states(sorted(names))


class _Stepped(Passed):
    """Knows whether it has made a step."""

    stepped = False

    def reset(self, seed):
        self.stepped = False
        super().reset(seed)

    def advance(self, seconds):
        self.stepped = True
        super().advance(seconds)


class _NaNMass(_Stepped):
    """Has a body of mass NaN: its state is NaN from the first step on."""

    def body_states(self, names):
        states = super().body_states(names)
        for row, name in zip(states, names, strict=True):
            if self.stepped and self.scene.body(name).motion is Motion.DYNAMIC:
                row[:] = np.nan
        return states


class _StateLate(Passed):
    """States are those of an interval before."""

    _before: Mapping[str, Array] = {}

    def reset(self, seed):
        self._before = {}
        super().reset(seed)

    def advance(self, seconds):
        names = [one.name for one in self.scene.bodies]
        self._before = dict(zip(names, super().body_states(names), strict=True))
        super().advance(seconds)

    def body_states(self, names):
        return (
            np.array([self._before[name] for name in names])
            if self._before
            else super().body_states(names)
        )

    def state(self):
        return super().state(), self._before

    def restore(self, state):
        super().restore(state[0])
        self._before = state[1]


class _NodesDrift(Passed):
    """Nodes sink by 0.1 mm/s relative to what holds them."""

    time_s = 0.0

    def advance(self, seconds):
        super().advance(seconds)
        self.time_s += seconds

    def nodes(self, name):
        return super().nodes(name) - [0.0, 0.0, 1e-4 * self.time_s]


class _NodesLag(Passed):
    """Nodes are those of an interval before."""

    def begin(self):
        self._before = {}

    def reset(self, seed):
        self._before = {}
        super().reset(seed)

    def advance(self, seconds):
        self._before = {
            one.name: np.array(self.inner.nodes(one.name))
            for one in self.scene.deformables
        }
        super().advance(seconds)

    def nodes(self, name):
        return self._before[name] if name in self._before else super().nodes(name)


class _NodesShuffled(Passed):
    """Nodes of ropes and rods are in an arbitrary order, always the same."""

    def nodes(self, name):
        nodes = super().nodes(name)
        one = next(body for body in self.scene.deformables if body.name == name)
        if not isinstance(one, Rope | Rod):
            return nodes
        return np.asarray(nodes[np.random.default_rng(0).permutation(len(nodes))])


class _NodesReversed(_Stepped):
    """Nodes change their order after the first step."""

    def nodes(self, name):
        nodes = super().nodes(name)
        return nodes[::-1] if self.stepped else nodes


class _NodesInMillimetres(Passed):
    """Nodes are in mm."""

    def nodes(self, name):
        return 1e3 * super().nodes(name)


def _forces(change):
    """Return a simulation that reports other contact forces, of shape [pair_count, 3]."""

    class Forces(Passed):
        def contact_forces(self, pairs):
            read = self.inner.contact_forces(pairs)
            return lambda: change(read())

    return Forces


FAULTS = dict(
    (
        fault(
            "force-of-half-the-points",
            "contact forces of half of the points",
            "force-rest",
            "all points of a pair add up",
            simulation=_forces(lambda forces: 0.5 * forces),
        ),
        fault(
            "force-without-friction",
            "normal forces alone",
            "force-slide",
            "the friction is left out",
            simulation=_forces(lambda forces: forces * (0.0, 0.0, 1.0)),
        ),
        fault(
            "quaternion-order",
            "quaternion x, y, z, w",
            "start-orientation",
            "x, y, z, w",
            simulation=_reporting(_scalar_last),
        ),
        fault(
            "quaternion-inverse",
            "quaternion world to body",
            "start-orientation",
            "inverse",
            simulation=_reporting(_inverse),
        ),
        fault(
            "millimetres",
            "positions in mm",
            "start-position",
            "in mm",
            simulation=_reporting(_millimetres),
        ),
        fault(
            "velocity-point",
            "velocity of the centre of mass",
            "velocity-of-origin",
            "velocity of the centre of mass",
            simulation=_VelocityOfCentre,
        ),
        fault(
            "spin-degrees",
            "angular velocity in degrees per second",
            "pendulum-energy",
            "in degrees",
            simulation=_reporting(_spin_in_degrees),
        ),
        fault(
            "spin-sign",
            "angular velocity reversed",
            "angular-velocity",
            "wrong sign",
            simulation=_reporting(_spin_reversed),
        ),
        fault(
            "order-of-names",
            "rows in alphabetical order",
            "order-of-names",
            "order asked for",
            simulation=_SceneOrder,
        ),
        fault("nan-mass", "mass of a body NaN", "finite", "mass", simulation=_NaNMass),
        fault(
            "state-late",
            "states one interval late",
            "time",
            "one interval late",
            simulation=_StateLate,
        ),
        fault(
            "nodes-lag",
            "nodes one interval late",
            "cloth-pinned-edge",
            "late",
            simulation=_NodesLag,
        ),
        fault(
            "attachments-drift",
            "attached nodes drift by 0.1 mm/s",
            "cloth-held",
            "an attachment drifts",
            simulation=_NodesDrift,
        ),
        fault(
            "nodes-shuffled",
            "nodes of a rope in another order",
            "rope-nodes",
            "in order",
            simulation=_NodesShuffled,
        ),
        fault(
            "nodes-reversed",
            "nodes change their order",
            "cloth-pinned-edge",
            "order changes",
            simulation=_NodesReversed,
        ),
        fault(
            "nodes-millimetres",
            "nodes in mm",
            "cloth-start",
            "in mm",
            simulation=_NodesInMillimetres,
        ),
        fault(
            "quaternion-grown",
            "quaternions of fast bodies are 0.1 % too long",
            "orientation-unit",
            "length of quaternions drift",
            simulation=_reporting(_quaternion_grown),
        ),
    )
)
"""Faults by id."""
