"""An engine with one planted fault, which shows that a conformance check can fail."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from gauge_envs.backends import Backend, LoopedSimulation, Simulation
from gauge_envs.scene import Cloth, Motion, Plane, Pose, Scene
from gauge_envs.scene.states import nominal_states


class Passed(Simulation):
    """A healthy simulation; fixed bodies report the poses of the original scene.

    Args:
        inner: The simulation.
        scene: The scene that the caller asked for.
    """

    def __init__(self, inner, scene):
        self.inner = inner
        self.settings = inner.settings
        self.world_count = inner.world_count
        self.scene = scene
        self._fixed = {one.name for one in scene.bodies if one.motion is Motion.FIXED}

    def reset(self, starts=None, seed=0):
        self.inner.reset(starts, seed)

    def drive(self, body, targets):
        self.inner.drive(body, targets)

    def advance(self, seconds):
        self.inner.advance(seconds)

    def body_states(self, names):
        states = np.array(self.inner.body_states(names))
        for row, name in enumerate(names):
            if name in self._fixed:
                pose = self.scene.body(name).pose
                states[:, row, :7] = [*pose.position_m, *pose.quaternion]
        return states

    def nodes(self, name):
        return np.array(self.inner.nodes(name))

    def apply_wrench(self, body, wrenches):
        self.inner.apply_wrench(body, wrenches)

    def contact_forces(self, pairs):
        return self.inner.contact_forces(pairs)

    def track(self, name, points_m):
        return self.inner.track(name, points_m)

    def close(self):
        self.inner.close()


@dataclass(frozen=True, kw_only=True)
class Fault:
    """A fault of an engine.

    Attributes:
        caught_by: Id of a check that fails.
        says: Words of its diagnosis.
        scene: What the engine builds instead of a scene.
        simulation: Wrapper of its simulation.
        worlds: How it joins the simulations of several worlds.
    """

    caught_by: str = ""
    says: str = ""
    scene: Callable[[Scene], Scene] = lambda scene: scene
    simulation: type[Passed] = Passed
    worlds: type[LoopedSimulation] = LoopedSimulation


class Faulty(Backend):
    """An engine with a fault.

    Args:
        healthy: The engine without it.
        planted: The fault.
    """

    name = "faulty"

    def __init__(self, healthy, planted):
        self.features = healthy.features
        self.healthy = healthy
        self.planted = planted

    def versions(self):
        return self.healthy.versions()

    def supports(self, scene):
        return self.healthy.supports(scene)

    def build(self, scene, settings=None):
        inner = self.healthy.build(self.planted.scene(scene), settings)
        return self.planted.simulation(inner, scene)

    def build_worlds(self, scene, world_count, settings=None):
        worlds = [self.build(scene, settings) for _ in range(world_count)]
        return self.planted.worlds(worlds)


# --- changes of a scene ---


def change_bodies(change):
    """Return a fault of each body."""
    return lambda scene: replace(
        scene, bodies=tuple(change(one) for one in scene.bodies)
    )


def change_contacts(**changes):
    """Return a fault of numbers of each contact."""

    def change(scene):
        contacts = [
            replace(one, **{key: do(getattr(one, key)) for key, do in changes.items()})
            for one in scene.contacts
        ]
        return replace(scene, contacts=tuple(contacts))

    return change


def _level(body):
    if not isinstance(body.shape, Plane):
        return body
    return replace(body, pose=Pose(position_m=body.pose.position_m))


def _scalar_last(body):
    x, y, z, w = body.pose.quaternion
    return replace(body, pose=replace(body.pose, quaternion=(w, x, y, z)))


def _stiff_cloth(scene):
    deformables = [
        replace(one, stretch_stiffness_n_per_m=1.3 * one.stretch_stiffness_n_per_m)
        if isinstance(one, Cloth)
        else one
        for one in scene.deformables
    ]
    return replace(scene, deformables=tuple(deformables))


# --- changes of a simulation ---


class _HalfTime(Passed):
    def advance(self, seconds):
        super().advance(0.5 * seconds)


class _DrivesLate(Passed):
    def __init__(self, inner, scene):
        super().__init__(inner, scene)
        self._before = {}

    def reset(self, starts=None, seed=0):
        self._before = {}
        super().reset(starts, seed)

    def drive(self, body, targets):
        now = np.array(targets)
        super().drive(body, self._before.get(body, now))
        self._before[body] = now


class _NoReset(Passed):
    def reset(self, starts=None, seed=0):
        pass


class _NaNMass(Passed):
    """Reports states of NaN from the first step on."""

    has_stepped = False

    def reset(self, starts=None, seed=0):
        self.has_stepped = False
        super().reset(starts, seed)

    def advance(self, seconds):
        self.has_stepped = True
        super().advance(seconds)

    def body_states(self, names):
        states = super().body_states(names)
        for row, name in enumerate(names):
            if self.has_stepped and self.scene.body(name).motion is Motion.DYNAMIC:
                states[:, row] = np.nan
        return states


class _IgnoresStarts(Passed):
    """Starts some rows and columns of the states as the scene says."""

    rows = slice(None)
    columns = slice(None)

    def reset(self, starts=None, seed=0):
        if starts is not None:
            starts = starts.copy()
            part = np.s_[:, self.rows, self.columns]
            starts[part] = nominal_states(self.scene)[None][part]
        super().reset(starts, seed)


class _StartsAtRest(_IgnoresStarts):
    columns = slice(7, 13)


class _StartsClothInPlace(_IgnoresStarts):
    rows = slice(1, None)


class _StartsAsFirst(LoopedSimulation):
    def reset(self, starts=None, seed=0):
        if starts is not None:
            starts = np.repeat(starts[:1], self.world_count, axis=0)
        super().reset(starts, seed)


class _DrivesAsFirst(LoopedSimulation):
    def drive(self, body, targets):
        super().drive(body, np.repeat(targets[:1], self.world_count, axis=0))


class _PushesAsFirst(LoopedSimulation):
    def apply_wrench(self, body, wrenches):
        super().apply_wrench(body, np.repeat(wrenches[:1], self.world_count, axis=0))


class _StartsAsBefore(LoopedSimulation):
    """Starts each episode as the one before."""

    before = None

    def reset(self, starts=None, seed=0):
        super().reset(starts if self.before is None else self.before, seed)
        self.before = None if starts is None else starts.copy()


FAULTS = {
    "gravity-upward": Fault(
        caught_by="free-fall",
        says="-1 times the gravity",
        scene=lambda scene: replace(scene, gravity_m_per_s2=-scene.gravity_m_per_s2),
    ),
    "friction-low": Fault(
        caught_by="slide",
        says="friction were 0.24",
        scene=change_contacts(friction=lambda friction: 0.8 * friction),
    ),
    "restitution-none": Fault(
        caught_by="rebound-0.5",
        says="restitution",
        scene=change_contacts(restitution=lambda restitution: 0.0),
    ),
    "plane-level": Fault(
        caught_by="roll-ball",
        says="leaning plane is level",
        scene=change_bodies(_level),
    ),
    "quaternion-order": Fault(
        caught_by="start-orientation",
        says="scalar first",
        scene=change_bodies(_scalar_last),
    ),
    "cloth-stretch": Fault(
        caught_by="cloth-stretch", says="stretches 0.7", scene=_stiff_cloth
    ),
    "half-time": Fault(
        caught_by="free-fall",
        says="simulates 0.5 times the time",
        simulation=_HalfTime,
    ),
    "drive-late": Fault(caught_by="driven-path", says="late", simulation=_DrivesLate),
    "no-reset": Fault(
        caught_by="reset-start", says="does not restore", simulation=_NoReset
    ),
    "nan-mass": Fault(caught_by="finite", says="mass", simulation=_NaNMass),
    "starts-nowhere": Fault(
        caught_by="starts-free",
        says="largest in the velocity of the ball",
        simulation=_IgnoresStarts,
    ),
    "starts-at-rest": Fault(
        caught_by="starts-free",
        says="largest in the velocity of the ball",
        simulation=_StartsAtRest,
    ),
    "hinge-at-rest": Fault(
        caught_by="starts-hinge",
        says="largest in the velocity of the brick",
        simulation=_StartsAtRest,
    ),
    "cloth-in-place": Fault(
        caught_by="starts-cloth",
        says="largest in the nodes of the cloth",
        simulation=_StartsClothInPlace,
    ),
    "worlds-start-as-first": Fault(
        caught_by="worlds-single", says="world", worlds=_StartsAsFirst
    ),
    "worlds-start-as-before": Fault(
        caught_by="worlds-reset", says="world", worlds=_StartsAsBefore
    ),
    "worlds-drive-as-first": Fault(
        caught_by="worlds-single", says="world", worlds=_DrivesAsFirst
    ),
    "worlds-push-as-first": Fault(
        caught_by="worlds-wrench", says="world", worlds=_PushesAsFirst
    ),
}
"""Faults by name."""
