"""Mutants: a backend with one planted fault each, which shows what the checks can catch.

    from gauge_envs.backends import backend
    from gauge_envs.checks.conformance.mutations import FAULTS, Mutant, first_failure

    fault = FAULTS["plane-level"]
    print(first_failure(Mutant(backend("mujoco"), fault)))

Most faults change the scene that the wrapped backend builds, or what its simulation returns, so that any backend can
have them. Faults that only an engine itself can have, such as a wrong inertia, are planted in MuJoCo's model.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gauge_envs.backends import Backend, Simulation, Support
from gauge_envs.checks.conformance.model import CheckResult
from gauge_envs.checks.conformance.run import run_checks
from gauge_envs.scene import (
    Air,
    Box,
    Cloth,
    Contact,
    ContactMode,
    ConvexUnion,
    Cylinder,
    Hinge,
    Motion,
    Plane,
    Pose,
    RigidBody,
    Rod,
    Rope,
    Scene,
    Shape,
    SoftBody,
    Sphere,
    Tether,
)
from gauge_envs.scene.geometry import vector
from gauge_envs.scene.hinged import parent_hinges
from gauge_envs.scene.meshes import mass_properties

__all__ = ["FAULTS", "Fault", "Mutant", "Passed", "first_failure"]

Array = NDArray[np.float64]


class Passed(Simulation):
    """A healthy simulation, passed through; fixed bodies report the poses of the original scene.

    Args:
        inner: The simulation.
        scene: The scene that the caller asked for.
    """

    def __init__(self, inner: Simulation, scene: Scene) -> None:
        self.inner: Any = inner
        self.scene = scene
        self.settings = inner.settings
        self._fixed = {one.name for one in scene.bodies if one.motion is Motion.FIXED}

    def reset(self, seed: int) -> None:
        """Pass on."""
        self.inner.reset(seed)

    def drive(self, body: str, pose: Pose, velocity: Array, acceleration: Array) -> None:
        """Pass on."""
        self.inner.drive(body, pose, velocity, acceleration)

    def apply_wrench(self, body: str, wrench: Array) -> None:
        """Pass on."""
        self.inner.apply_wrench(body, wrench)

    def advance(self, seconds: float) -> None:
        """Pass on."""
        self.inner.advance(seconds)

    def body_states(self, names: Sequence[str]) -> Array:
        """Pass on, with the original poses of fixed bodies."""
        states = np.array(self.inner.body_states(names))
        for row, name in zip(states, names, strict=True):
            if name in self._fixed:
                pose = self.scene.body(name).pose
                row[:7] = [*pose.position_m, *pose.quaternion]
        return states

    def nodes(self, name: str) -> Array:
        """Pass on."""
        return np.array(self.inner.nodes(name))

    def track(self, name: str, points_m: Array) -> Callable[[], Array] | None:
        """Pass on."""
        found: Callable[[], Array] | None = self.inner.track(name, points_m)
        return found

    def state(self) -> Any:
        """Pass on."""
        return self.inner.state()

    def restore(self, state: Any) -> None:
        """Pass on."""
        self.inner.restore(state)

    def close(self) -> None:
        """Pass on."""
        self.inner.close()


def _same(scene: Scene) -> Scene:
    return scene


@dataclass(frozen=True, kw_only=True)
class Fault:
    """One deliberate fault, and what a check should say about it.

    Attributes:
        what: The fault, in words.
        caught_by: Id of the first check that fails.
        says: Words of its diagnosis that name the fault.
        scene: What the faulty backend builds instead of a scene.
        simulation: Wrapper of its simulation.
        settings: Numerical settings that are forced upon the backend.
        engine: The only backend that can have the fault; empty for any.
    """

    what: str
    caught_by: str
    says: str
    scene: Callable[[Scene], Scene] = _same
    simulation: type[Passed] = Passed
    settings: Mapping[str, Any] = field(default_factory=dict)
    engine: str = ""


class Mutant(Backend):
    """A backend with a fault.

    Args:
        backend: A healthy backend.
        fault: The fault.
    """

    name = "mutant"

    def __init__(self, backend: Backend, fault: Fault) -> None:
        self.applies_air = backend.applies_air  # type: ignore[misc]  # a class variable of engines
        self.joins_bodies = backend.joins_bodies  # type: ignore[misc]  # a class variable of engines
        self._backend = backend
        self._fault = fault

    def versions(self) -> dict[str, str]:
        """Return the versions of the healthy backend."""
        return self._backend.versions()

    def supports(self, scene: Scene) -> Support:
        """Return what the healthy backend supports."""
        return self._backend.supports(scene)

    def build(self, scene: Scene, settings: Mapping[str, Any] | None = None) -> Simulation:
        """Build the faulty scene in the faulty simulation."""
        inner = self._backend.build(self._fault.scene(scene), {**(settings or {}), **self._fault.settings})
        return self._fault.simulation(inner, scene)


def first_failure(mutant: Mutant, only: Sequence[str] = ()) -> CheckResult | None:
    """Return the result of the first check that fails on a mutant; None when it passes all.

    Args:
        mutant: The mutant.
        only: Ids or patterns of checks; all when empty.
    """
    return next((one for one in run_checks(mutant, only=only) if one.is_bad), None)


# --- faults of scenes ------------------------------------------------------------------------------------------------


def _bodies(change: Callable[[RigidBody], RigidBody]) -> Callable[[Scene], Scene]:
    return lambda scene: replace(scene, bodies=tuple(change(one) for one in scene.bodies))


def _shapes(change: Callable[[Shape], Shape], *motions: Motion) -> Callable[[Scene], Scene]:
    """Return a change of the shapes of bodies that move in one of some ways; of dynamic ones by default."""
    chosen = motions or (Motion.DYNAMIC,)
    return _bodies(lambda one: replace(one, shape=change(one.shape)) if one.motion in chosen else one)


def _contacts(
    *, friction: Callable[[float], float] = float, restitution: Callable[[float], float] = float
) -> Callable[[Scene], Scene]:
    def change(scene: Scene) -> Scene:
        contacts = (
            replace(one, friction=friction(one.friction), restitution=restitution(one.restitution))
            for one in scene.contacts
        )
        return replace(scene, contacts=tuple(contacts))

    return change


def _deformables(kind: type, **factors: float) -> Callable[[Scene], Scene]:
    def change(scene: Scene) -> Scene:
        changed = [
            replace(one, **{key: factor * getattr(one, key) for key, factor in factors.items()})
            if isinstance(one, kind)
            else one
            for one in scene.deformables
        ]
        return replace(scene, deformables=tuple(changed))

    return change


def _joints(kind: type, change: Callable[[Any], Any]) -> Callable[[Scene], Scene]:
    return lambda scene: replace(
        scene, joints=tuple(change(one) if isinstance(one, kind) else one for one in scene.joints)
    )


def _gravity(change: Callable[[float], float]) -> Callable[[Scene], Scene]:
    return lambda scene: replace(scene, gravity_m_per_s2=change(scene.gravity_m_per_s2))


MARGIN_M = 1e-3


def _margin(one: RigidBody) -> RigidBody:
    """Return a fixed or driven body whose surface is 1 mm further out."""
    if one.motion is Motion.DYNAMIC:
        return one
    if isinstance(one.shape, Plane):
        normal = one.pose.rotation.apply([0.0, 0.0, MARGIN_M])
        return replace(one, pose=replace(one.pose, position_m=vector(one.pose.position_m + normal)))
    return replace(one, shape=_grown(one.shape, MARGIN_M))


def _grown(shape: Shape, margin_m: float) -> Shape:
    """Return a shape whose faces are further out; a convex union keeps its lower and lateral faces."""
    if isinstance(shape, Box):
        x, y, z = (size + 2.0 * margin_m for size in shape.size_m)
        return Box(size_m=(x, y, z))
    if isinstance(shape, Sphere):
        return Sphere(radius_m=shape.radius_m + margin_m)
    if isinstance(shape, Cylinder):
        return Cylinder(radius_m=shape.radius_m + margin_m, length_m=shape.length_m + 2.0 * margin_m)
    if isinstance(shape, ConvexUnion):
        top = shape.corners_m[:, 2].max()
        return ConvexUnion(
            pieces_m=tuple(
                tuple((x, y, z + margin_m if z > top - 1e-9 else z) for x, y, z in piece) for piece in shape.pieces_m
            )
        )
    return shape


def _level(one: RigidBody) -> RigidBody:
    if not isinstance(one.shape, Plane):
        return one
    return replace(one, pose=Pose(position_m=one.pose.position_m))


def _plane_at_origin(one: RigidBody) -> RigidBody:
    if not isinstance(one.shape, Plane):
        return one
    return replace(one, pose=replace(one.pose, position_m=(0.0, 0.0, 0.0)))


def _cylinder(radius: float = 1.0, length: float = 1.0) -> Callable[[Shape], Shape]:
    return lambda shape: (
        Cylinder(radius_m=radius * shape.radius_m, length_m=length * shape.length_m)
        if isinstance(shape, Cylinder)
        else shape
    )


def _box_twice(shape: Shape) -> Shape:
    if not isinstance(shape, Box):
        return shape
    x, y, z = (2.0 * size for size in shape.size_m)
    return Box(size_m=(x, y, z))


def _sphere_larger(shape: Shape) -> Shape:
    return Sphere(radius_m=1.05 * shape.radius_m) if isinstance(shape, Sphere) else shape


def _hull(shape: Shape) -> Shape:
    if not isinstance(shape, ConvexUnion):
        return shape
    return ConvexUnion(pieces_m=(tuple(vector(corner) for corner in shape.corners_m),))


def _first_piece(shape: Shape) -> Shape:
    return ConvexUnion(pieces_m=shape.pieces_m[:1]) if isinstance(shape, ConvexUnion) else shape


SLOW_LIMIT_M_PER_S = 0.6
"""Speed limit of the scenes in which nothing is faster than 0.2 m/s; the limit is three times the free fall."""


def _no_slow_rebound(scene: Scene) -> Scene:
    if scene.speed_limit_m_per_s > SLOW_LIMIT_M_PER_S:
        return scene
    return _contacts(restitution=lambda e: 0.0)(scene)


def _all_collide(scene: Scene) -> Scene:
    listed = {frozenset(pair) for contact in scene.contacts for pair in scene.colliding_pairs(contact)}
    names = [one.name for one in scene.bodies]
    more = [
        Contact(first=(first,), second=(second,), friction=0.5, restitution=0.0)
        for index, first in enumerate(names)
        for second in names[:index]
        if frozenset((first, second)) not in listed
    ]
    return replace(scene, contacts=(*scene.contacts, *more))


def _first_contact_only(scene: Scene) -> Scene:
    return replace(scene, contacts=scene.contacts[:1])


def _one_friction(scene: Scene) -> Scene:
    if not scene.contacts:
        return scene
    return _contacts(friction=lambda mu: scene.contacts[-1].friction)(scene)


def _one_restitution(scene: Scene) -> Scene:
    largest = max((one.restitution for one in scene.contacts if one.mode is ContactMode.IMPACT), default=0.0)
    return _contacts(restitution=lambda e: largest)(scene)


def _always_impact(scene: Scene) -> Scene:
    return replace(scene, contacts=tuple(replace(one, mode=ContactMode.IMPACT) for one in scene.contacts))


def _random_friction(scene: Scene) -> Scene:
    return _contacts(friction=lambda mu: mu * float(1.0 + 1e-9 * np.random.default_rng().random()))(scene)


def _random_fabric(scene: Scene) -> Scene:
    return _deformables(Cloth, stretch_stiffness_n_per_m=1.0 + 1e-9 * float(np.random.default_rng().random()))(scene)


def _nothing_fixed(scene: Scene) -> Scene:
    if scene.deformables:
        return scene
    return _bodies(
        lambda one: (
            replace(one, motion=Motion.DYNAMIC)
            if one.motion is Motion.FIXED and not isinstance(one.shape, Plane)
            else one
        )
    )(scene)


def _tilted(axis: tuple[float, float, float], degrees: float) -> tuple[float, float, float]:
    return vector(Rotation.from_euler("x", degrees, degrees=True).apply(axis))


def _warp_along_y(scene: Scene) -> Scene:
    changed = [
        replace(one, size_m=(one.size_m[1], one.size_m[0])) if isinstance(one, Cloth) else one
        for one in scene.deformables
    ]
    return replace(scene, deformables=tuple(changed))


def _edge_only(scene: Scene) -> Scene:
    attachments = [replace(one, region=replace(one.region, depth_m=0.0)) for one in scene.attachments]
    return replace(scene, attachments=tuple(attachments))


def _air(change: Callable[[Air], Air]) -> Callable[[Scene], Scene]:
    return lambda scene: scene if scene.air is None else replace(scene, air=change(scene.air))


class _PumpingAir(Air):
    """Air that drives the cloth along its motion."""

    def forces_n(self, areas_m2: Array, velocities_m_per_s: Array) -> Array:
        return -super().forces_n(areas_m2, velocities_m_per_s)


def _pumping(air: Air) -> Air:
    """Return air of the wrong sign in the scene that checks energy, so that no simpler check sees it first."""
    is_of_energy_check = air.lift_coefficient > 0.0 and air.normal_coefficient > 0.0
    return _PumpingAir(**asdict(air)) if is_of_energy_check else air


def _thick(scene: Scene) -> Scene:
    changed = [
        replace(one, pose=replace(one.pose, position_m=vector(np.add(one.pose.position_m, [0.0, 0.0, 3e-3]))))
        if isinstance(one, Cloth)
        else one
        for one in scene.deformables
    ]
    return replace(scene, deformables=tuple(changed))


# --- faults of what is reported --------------------------------------------------------------------------------------


class _AsIs(Passed):
    """Reports fixed bodies where the engine has them."""

    def body_states(self, names: Sequence[str]) -> Array:
        return np.array(self.inner.body_states(names))


def _reporting(change: Callable[[Array], None]) -> type[Passed]:
    """Return a simulation that reports other states than it has."""

    class Misreported(Passed):
        def body_states(self, names: Sequence[str]) -> Array:
            states = super().body_states(names)
            change(states)
            return states

    return Misreported


def _rotations(states: Array) -> Rotation:
    return Rotation.from_quat(states[:, 3:7], scalar_first=True)


def _scalar_last(states: Array) -> None:
    states[:, 3:7] = np.roll(states[:, 3:7], -1, axis=1)


def _inverse(states: Array) -> None:
    states[:, 4:7] *= -1.0


def _millimetres(states: Array) -> None:
    states[:, :3] *= 1e3


def _spin_in_body(states: Array) -> None:
    states[:, 10:] = _rotations(states).apply(states[:, 10:], inverse=True)


def _velocity_in_body(states: Array) -> None:
    states[:, 7:10] = _rotations(states).apply(states[:, 7:10], inverse=True)


def _spin_in_degrees(states: Array) -> None:
    states[:, 10:] = np.degrees(states[:, 10:])


def _spin_reversed(states: Array) -> None:
    states[:, 10:] *= -1.0


class _VelocityOfCentre(Passed):
    """Reports the velocity of the centre of mass."""

    def body_states(self, names: Sequence[str]) -> Array:
        states = super().body_states(names)
        for row, name in zip(states, names, strict=True):
            centre_m, _ = mass_properties(self.scene.body(name).shape, 1.0)
            row[7:10] += np.cross(row[10:], Rotation.from_quat(row[3:7], scalar_first=True).apply(centre_m))
        return states


class _SceneOrder(Passed):
    """Returns rows in alphabetical order."""

    def body_states(self, names: Sequence[str]) -> Array:
        return super().body_states(sorted(names))


class _NaNMass(Passed):
    """Has a body of mass NaN: its state is NaN from the first step on."""

    stepped = False

    def reset(self, seed: int) -> None:
        self.stepped = False
        super().reset(seed)

    def advance(self, seconds: float) -> None:
        self.stepped = True
        super().advance(seconds)

    def body_states(self, names: Sequence[str]) -> Array:
        states = super().body_states(names)
        for row, name in zip(states, names, strict=True):
            if self.stepped and self.scene.body(name).motion is Motion.DYNAMIC:
                row[:] = np.nan
        return states


class _NodesLag(Passed):
    """Nodes are those of an interval before."""

    def __init__(self, inner: Simulation, scene: Scene) -> None:
        super().__init__(inner, scene)
        self._before: dict[str, Array] = {}

    def reset(self, seed: int) -> None:
        self._before = {}
        super().reset(seed)

    def advance(self, seconds: float) -> None:
        self._before = {one.name: np.array(self.inner.nodes(one.name)) for one in self.scene.deformables}
        super().advance(seconds)

    def nodes(self, name: str) -> Array:
        return self._before[name] if name in self._before else super().nodes(name)


class _NodesShuffled(Passed):
    """Nodes of ropes and rods are in an arbitrary order, always the same."""

    def nodes(self, name: str) -> Array:
        nodes = super().nodes(name)
        one = next(body for body in self.scene.deformables if body.name == name)
        if not isinstance(one, Rope | Rod):
            return nodes
        return np.asarray(nodes[np.random.default_rng(0).permutation(len(nodes))])


class _NodesReversed(Passed):
    """Nodes change their order after the first step."""

    stepped = False

    def reset(self, seed: int) -> None:
        self.stepped = False
        super().reset(seed)

    def advance(self, seconds: float) -> None:
        self.stepped = True
        super().advance(seconds)

    def nodes(self, name: str) -> Array:
        nodes = super().nodes(name)
        return nodes[::-1] if self.stepped else nodes


class _NodesInMillimetres(Passed):
    """Nodes are in mm."""

    def nodes(self, name: str) -> Array:
        return 1e3 * super().nodes(name)


# --- faults of time, driving and state -------------------------------------------------------------------------------


class _OneStepShort(Passed):
    """Simulates one step less in each call."""

    def advance(self, seconds: float) -> None:
        step = float(self.settings["timestep_s"])
        # Engines with one step for each interval of 1/180 s would stand still, so they lose a tenth of the intervals.
        if seconds > 1.5 * step:
            super().advance(seconds - step)


class _OneStepPerCall(Passed):
    """Simulates 1/180 s in each call."""

    def advance(self, seconds: float) -> None:
        super().advance(1.0 / 180.0)


class _ReadsFirst(Passed):
    """Reads positions before it advances."""

    def sample_positions(self, names: Sequence[str], count: int, interval_s: float) -> Array:
        positions = np.empty((count, len(names), 3))
        for row in positions:
            row[:] = self.body_states(names)[:, :3]
            self.advance(interval_s)
        return positions


class _StepsAtBuild(Passed):
    """Has already moved when it is built."""

    def __init__(self, inner: Simulation, scene: Scene) -> None:
        super().__init__(inner, scene)
        self.inner.advance(1.0 / 180.0)


class _Teleport(Passed):
    """Moves driven bodies without a velocity."""

    def drive(self, body: str, pose: Pose, velocity: Array, acceleration: Array) -> None:
        super().drive(body, pose, np.zeros(6), np.zeros(6))


class _NoAcceleration(Passed):
    """Ignores the acceleration of driven bodies."""

    def drive(self, body: str, pose: Pose, velocity: Array, acceleration: Array) -> None:
        super().drive(body, pose, velocity, np.zeros(6))


class _DriveLate(Passed):
    """Drives each body by the interval before."""

    def __init__(self, inner: Simulation, scene: Scene) -> None:
        super().__init__(inner, scene)
        self._before: dict[str, tuple[Pose, Array, Array]] = {}

    def reset(self, seed: int) -> None:
        self._before = {}
        super().reset(seed)

    def drive(self, body: str, pose: Pose, velocity: Array, acceleration: Array) -> None:
        now = (pose, np.array(velocity), np.array(acceleration))
        super().drive(body, *self._before.get(body, now))
        self._before[body] = now

    def state(self) -> Any:
        return super().state(), dict(self._before)

    def restore(self, state: Any) -> None:
        super().restore(state[0])
        self._before = dict(state[1])


class _NoReset(Passed):
    """Does not reset."""

    def reset(self, seed: int) -> None:
        pass


class _StateStaysBehind(Passed):
    """Keeps its state to itself and returns nothing of it."""

    kept: Any = None

    def state(self) -> Any:
        self.kept = super().state()

    def restore(self, state: Any) -> None:
        if self.kept is not None:
            super().restore(self.kept)


class _LiveState(Passed):
    """Returns a state that changes as the simulation goes on."""

    def __init__(self, inner: Simulation, scene: Scene) -> None:
        super().__init__(inner, scene)
        self._given: list[list[Any]] = []

    def advance(self, seconds: float) -> None:
        super().advance(seconds)
        for state in self._given:
            state[0] = super().state()

    def state(self) -> Any:
        self._given.append([super().state()])
        return self._given[-1]

    def restore(self, state: Any) -> None:
        super().restore(state[0])


class _StateDisturbs(Passed):
    """Goes on from its reported state whenever a state is taken."""

    def state(self) -> Any:
        saved = super().state()
        super().advance(1.0 / 180.0)
        return saved


# --- faults of wrenches ----------------------------------------------------------------------------------------------


class _WrenchIgnored(Passed):
    """Ignores wrenches."""

    def apply_wrench(self, body: str, wrench: Array) -> None:
        pass


class _TorqueIgnored(Passed):
    """Ignores torques."""

    def apply_wrench(self, body: str, wrench: Array) -> None:
        super().apply_wrench(body, np.concatenate([wrench[:3], np.zeros(3)]))


class _WrenchInBody(Passed):
    """Takes the wrench in the body frame of the start."""

    def apply_wrench(self, body: str, wrench: Array) -> None:
        rotation = self.scene.body(body).pose.rotation
        super().apply_wrench(body, np.concatenate([rotation.apply(wrench[:3]), rotation.apply(wrench[3:])]))


class _WrenchOnce(Passed):
    """Applies a wrench during one interval only."""

    def __init__(self, inner: Simulation, scene: Scene) -> None:
        super().__init__(inner, scene)
        self._applied: set[str] = set()

    def apply_wrench(self, body: str, wrench: Array) -> None:
        super().apply_wrench(body, wrench)
        self._applied.add(body)

    def advance(self, seconds: float) -> None:
        super().advance(seconds)
        for body in self._applied:
            super().apply_wrench(body, np.zeros(6))
        self._applied = set()


class _ForceAtOrigin(Passed):
    """Applies the force at the body origin."""

    def apply_wrench(self, body: str, wrench: Array) -> None:
        one = self.scene.body(body)
        centre_m, _ = mass_properties(one.shape, 1.0)
        torque = np.cross(-one.pose.rotation.apply(centre_m), wrench[:3])
        super().apply_wrench(body, wrench + np.concatenate([np.zeros(3), torque]))


class _WrenchKept(Passed):
    """Keeps wrenches over a reset."""

    def __init__(self, inner: Simulation, scene: Scene) -> None:
        super().__init__(inner, scene)
        self._applied: dict[str, Array] = {}

    def apply_wrench(self, body: str, wrench: Array) -> None:
        super().apply_wrench(body, wrench)
        self._applied[body] = np.array(wrench)

    def reset(self, seed: int) -> None:
        super().reset(seed)
        for body, wrench in self._applied.items():
            super().apply_wrench(body, wrench)


class _RestoreForgetsWrench(Passed):
    """Drops wrenches when a state is restored."""

    def __init__(self, inner: Simulation, scene: Scene) -> None:
        super().__init__(inner, scene)
        self._applied: set[str] = set()

    def apply_wrench(self, body: str, wrench: Array) -> None:
        super().apply_wrench(body, wrench)
        self._applied.add(body)

    def restore(self, state: Any) -> None:
        super().restore(state)
        for body in self._applied:
            super().apply_wrench(body, np.zeros(6))


class _RollingFriction(Passed):
    """Brakes spheres and cylinders in contact by a torque of 0.01 m g times their radius."""

    def __init__(self, inner: Simulation, scene: Scene) -> None:
        super().__init__(inner, scene)
        touching = {name for contact in scene.contacts for name in (*contact.first, *contact.second)}
        self._levers = {
            one.name: 0.01 * one.mass_kg * scene.gravity_m_per_s2 * one.shape.radius_m
            for one in scene.dynamic_bodies
            if isinstance(one.shape, Sphere | Cylinder) and one.name in touching
        }

    def advance(self, seconds: float) -> None:
        for name, largest in self._levers.items():
            spin = self.inner.body_states([name])[0, 10:]
            # The torque falls to zero below 0.05 rad/s, so that bodies at rest do not jitter.
            torque = -largest * spin / max(float(np.linalg.norm(spin)), 0.05)
            super().apply_wrench(name, np.concatenate([np.zeros(3), torque]))
        super().advance(seconds)


# --- faults of MuJoCo's model ----------------------------------------------------------------------------------------


def _model(change: Callable[[Any, Scene], None]) -> type[Passed]:
    """Return a simulation whose MuJoCo model is changed after it is built."""

    class Changed(Passed):
        def __init__(self, inner: Simulation, scene: Scene) -> None:
            super().__init__(inner, scene)
            change(self.inner.model, scene)
            # MuJoCo keeps the mass matrix of simple bodies as a constant.
            mujoco.mj_setConst(self.inner.model, self.inner.data)

    return Changed


def _dynamic(scene: Scene, kind: type) -> list[RigidBody]:
    return [one for one in scene.dynamic_bodies if isinstance(one.shape, kind)]


def _inertia_times(kind: type, factor: float) -> Callable[[Any, Scene], None]:
    def change(model: Any, scene: Scene) -> None:
        for one in _dynamic(scene, kind):
            model.body(one.name).inertia[:] *= factor

    return change


def _mean_of_vertices(model: Any, scene: Scene) -> None:
    for one in _dynamic(scene, ConvexUnion):
        model.body(one.name).ipos[:] = one.shape.corners_m.mean(axis=0)


def _mean_of_pieces(model: Any, scene: Scene) -> None:
    for one in _dynamic(scene, ConvexUnion):
        assert isinstance(one.shape, ConvexUnion)
        centres = [mass_properties(ConvexUnion(pieces_m=(piece,)), 1.0)[0] for piece in one.shape.pieces_m]
        model.body(one.name).ipos[:] = np.mean(centres, axis=0)


def _damped(model: Any, scene: Scene) -> None:
    model.dof_damping[:] = 1e-4


def _armature(model: Any, scene: Scene) -> None:
    model.dof_armature[:] = 1e-4


def _hanging(change: Callable[[Any, str], None]) -> Callable[[Any, Scene], None]:
    """Return a change of the bodies that hang on other bodies in MuJoCo's model, which gets each of their names."""

    def change_all(model: Any, scene: Scene) -> None:
        for name in parent_hinges(scene.body_hinges):
            change(model, name)

    return change_all


def _hinge_tilted(model: Any, name: str) -> None:
    joint = model.joint(name)
    joint.axis[:] = _tilted(vector(joint.axis), 3.0)


def _hinge_shifted(model: Any, name: str) -> None:
    side = np.cross(model.joint(name).axis, [0.3, -0.5, 0.8])
    model.joint(name).pos += 2e-3 * side / np.linalg.norm(side)


def _hinge_heavy(model: Any, name: str) -> None:
    model.body(name).inertia[:] *= 1.5


def _hinge_damped(model: Any, name: str) -> None:
    model.joint(name).damping[:] = 1e-3


class _HangingWeightless(Passed):
    """Bodies that hang on other bodies feel no gravity."""

    def reset(self, seed: int) -> None:
        super().reset(seed)
        for name in parent_hinges(self.scene.body_hinges):
            weight = self.scene.body(name).mass_kg * self.scene.gravity_m_per_s2
            self.inner.apply_wrench(name, np.array([0.0, 0.0, weight, 0.0, 0.0, 0.0]))


class _HingeBackwards(Passed):
    """Starts hinges between bodies in the other direction."""

    def reset(self, seed: int) -> None:
        super().reset(seed)
        for name in parent_hinges(self.scene.body_hinges):
            self.inner.data.qvel[self.inner.model.joint(name).dofadr[0]] *= -1.0


def _gravity_tilted(model: Any, scene: Scene) -> None:
    model.opt.gravity[:2] = 0.1


class _ResetKeepsVelocity(Passed):
    """Keeps velocities over a reset."""

    def reset(self, seed: int) -> None:
        velocity = self.inner.data.qvel.copy()
        super().reset(seed)
        self.inner.data.qvel[:] = velocity


class _RestoreForgetsVelocity(Passed):
    """Drops velocities when a state is restored."""

    def restore(self, state: Any) -> None:
        super().restore(state)
        self.inner.data.qvel[:] = 0.0


class _RestoreForgetsWarmStart(Passed):
    """Drops the solver's warm start when a state is restored."""

    def restore(self, state: Any) -> None:
        super().restore(state)
        self.inner.data.qacc_warmstart[:] = 0.0


class _GainsEnergy(Passed):
    """Gains 2 % of speed in each interval."""

    def advance(self, seconds: float) -> None:
        super().advance(seconds)
        self.inner.data.qvel[:] *= 1.02


def _fault(id: str, what: str, caught_by: str, says: str, **how: Any) -> tuple[str, Fault]:
    return id, Fault(what=what, caught_by=caught_by, says=says, **how)


FAULTS: dict[str, Fault] = dict(
    (
        _fault("margin", "collision margin of 1 mm left in", "contact-listed", "margin", scene=_bodies(_margin)),
        _fault(
            "cylinder-length",
            "cylinder with half the length",
            "inertia-cylinder",
            "radius and length were 20, 45 mm",
            scene=_shapes(_cylinder(length=0.5)),
        ),
        _fault(
            "cylinder-radius",
            "cylinder with half the radius",
            "inertia-cylinder",
            "radius and length were 10, 90 mm",
            scene=_shapes(_cylinder(radius=0.5)),
        ),
        _fault(
            "cylinder-support",
            "fixed cylinder with half the length",
            "rest-box",
            "on each support that is wrong: cylinder",
            scene=_shapes(_cylinder(length=0.5), Motion.FIXED),
        ),
        _fault(
            "plane-level", "leaning plane taken as level", "roll-ball", "leaning plane is level", scene=_bodies(_level)
        ),
        _fault(
            "rolling-friction",
            "rolling friction of 0.01",
            "roll-ball",
            "rolling friction were",
            simulation=_RollingFriction,
        ),
        _fault(
            "box-inertia",
            "inertia of a box times 1.5",
            "inertia-box",
            "1.5, 1.5 and 1.5 times",
            simulation=_model(_inertia_times(Box, 1.5)),
            engine="mujoco",
        ),
        _fault(
            "union-inertia",
            "inertia of a convex union times 2",
            "inertia-union",
            "2, 2 and 2 times",
            simulation=_model(_inertia_times(ConvexUnion, 2.0)),
            engine="mujoco",
        ),
        _fault(
            "union-centre",
            "centre of a union at the mean of its vertices",
            "swing-union",
            "at the mean of the vertices",
            simulation=_model(_mean_of_vertices),
            engine="mujoco",
        ),
        _fault("wrench-ignored", "wrench ignored", "wrench-force", "the wrench is ignored", simulation=_WrenchIgnored),
        _fault(
            "slow-restitution",
            "restitution off below 0.2 m/s",
            "rebound-slow",
            "threshold speed",
            scene=_no_slow_rebound,
        ),
        _fault("gravity-1-percent", "gravity 1 % high", "free-fall", "gravity", scene=_gravity(lambda g: 1.01 * g)),
        _fault("gravity-upward", "gravity upward", "free-fall", "sign of gravity", scene=_gravity(lambda g: -g)),
        _fault(
            "gravity-own",
            "gravity of the engine",
            "gravity-of-scene",
            "gravity from the scene",
            scene=_gravity(lambda g: 9.81),
        ),
        _fault(
            "gravity-tilted",
            "gravity tilted",
            "free-fall-drift",
            "gravity is tilted",
            simulation=_model(_gravity_tilted),
            engine="mujoco",
        ),
        _fault(
            "friction-of-another-pair",
            "friction of the last pair for all pairs",
            "slide-of-pair",
            "own friction",
            scene=_one_friction,
        ),
        _fault(
            "friction-mean",
            "friction by the mean instead of the product",
            "slide",
            "how the friction of two surfaces is combined",
            scene=_contacts(friction=lambda mu: 0.5 * (mu + 1.0)),
        ),
        _fault(
            "friction-low",
            "friction 20 % low",
            "slide",
            "friction were 0.24",
            scene=_contacts(friction=lambda mu: 0.8 * mu),
        ),
        _fault("friction-none", "no friction", "slide", "friction were", scene=_contacts(friction=lambda mu: 0.0)),
        _fault(
            "restitution-none",
            "no restitution",
            "rebound-0.2",
            "restitution",
            scene=_contacts(restitution=lambda e: 0.0),
        ),
        _fault(
            "restitution-high",
            "restitution 0.02 high",
            "rebound-0.2",
            "restitution",
            scene=_contacts(restitution=lambda e: e + 0.02 if e else 0.0),
        ),
        _fault(
            "restitution-shared",
            "largest restitution for all pairs",
            "rebound-of-pair",
            "its own restitution",
            scene=_one_restitution,
        ),
        _fault(
            "restitution-sustained",
            "restitution of sustained pairs",
            "rebound-sustained",
            "no effect on a pair of the mode SUSTAINED",
            scene=lambda scene: _always_impact(scene) if any(one.restitution for one in scene.contacts) else scene,
        ),
        _fault(
            "mass-high",
            "masses 10 % high",
            "wrench-force",
            "mass were 1.1",
            scene=_bodies(lambda one: replace(one, mass_kg=1.1 * one.mass_kg)),
        ),
        _fault(
            "mass-of-one",
            "mass of one body 1.5 times too large",
            "collision-momentum",
            "masses are not the scene's",
            scene=_bodies(lambda one: replace(one, mass_kg=1.5 * one.mass_kg) if one.name == "left" else one),
        ),
        _fault(
            "box-half-sizes",
            "full sizes of a box taken for half sizes",
            "inertia-box",
            "edges were 200, 120, 60 mm",
            scene=_shapes(_box_twice),
        ),
        _fault(
            "sphere-larger", "sphere 5 % larger", "contact-listed", "radius is too large", scene=_shapes(_sphere_larger)
        ),
        _fault(
            "union-hull",
            "convex hull of a union",
            "inertia-union",
            "the convex hull of all pieces",
            scene=_shapes(_hull),
        ),
        _fault(
            "union-first-piece",
            "first piece of a union only",
            "inertia-union",
            "the first of its pieces",
            scene=_shapes(_first_piece),
        ),
        _fault(
            "union-unweighted",
            "pieces of a union weighted equally",
            "swing-union",
            "mean of the pieces' centres",
            simulation=_model(_mean_of_pieces),
            engine="mujoco",
        ),
        _fault(
            "plane-origin",
            "plane through the world origin",
            "rest-box",
            "on each support that is wrong: plane",
            scene=_bodies(_plane_at_origin),
        ),
        _fault(
            "quaternion-order",
            "quaternion x, y, z, w",
            "start-orientation",
            "x, y, z, w",
            simulation=_reporting(_scalar_last),
        ),
        _fault(
            "quaternion-inverse",
            "quaternion world to body",
            "start-orientation",
            "inverse",
            simulation=_reporting(_inverse),
        ),
        _fault("millimetres", "positions in mm", "start-position", "in mm", simulation=_reporting(_millimetres)),
        _fault(
            "velocity-frame",
            "velocity in the body frame",
            "velocity-of-origin",
            "body frame",
            simulation=_reporting(_velocity_in_body),
        ),
        _fault(
            "velocity-point",
            "velocity of the centre of mass",
            "velocity-of-origin",
            "velocity of the centre of mass",
            simulation=_VelocityOfCentre,
        ),
        _fault(
            "spin-frame",
            "angular velocity in the body frame",
            "angular-velocity",
            "body frame",
            simulation=_reporting(_spin_in_body),
        ),
        _fault(
            "spin-degrees",
            "angular velocity in degrees per second",
            "pendulum-energy",
            "in degrees",
            simulation=_reporting(_spin_in_degrees),
        ),
        _fault(
            "spin-sign",
            "angular velocity reversed",
            "angular-velocity",
            "wrong sign",
            simulation=_reporting(_spin_reversed),
        ),
        _fault(
            "order-of-names", "rows in alphabetical order", "order-of-names", "order asked for", simulation=_SceneOrder
        ),
        _fault("nan-mass", "mass of a body NaN", "finite", "mass", simulation=_NaNMass),
        _fault("step-short", "one step less in each call", "time", "count steps", simulation=_OneStepShort),
        _fault("step-per-call", "1/180 s in each call", "time", "one step for each call", simulation=_OneStepPerCall),
        _fault(
            "reads-first",
            "sample_positions reads before it advances",
            "sample-positions",
            "advance first",
            simulation=_ReadsFirst,
        ),
        _fault("steps-at-build", "build makes a step", "start-position", "step", simulation=_StepsAtBuild),
        _fault("teleport", "driven bodies without velocity", "driven-velocity", "no velocity", simulation=_Teleport),
        _fault(
            "drive-acceleration",
            "acceleration of driven bodies ignored",
            "carry-line",
            "drive() gives is ignored",
            simulation=_NoAcceleration,
        ),
        _fault("drive-late", "driven bodies one interval late", "driven-path", "late", simulation=_DriveLate),
        _fault("no-reset", "reset does nothing", "reset-start", "does not restore", simulation=_NoReset),
        _fault(
            "reset-velocity",
            "reset keeps velocities",
            "reset-start",
            "velocities are kept",
            simulation=_ResetKeepsVelocity,
            engine="mujoco",
        ),
        _fault("reset-wrench", "reset keeps wrenches", "wrench-reset", "reset must clear", simulation=_WrenchKept),
        _fault(
            "restore-velocity",
            "restore forgets velocities",
            "restore",
            "velocities",
            simulation=_RestoreForgetsVelocity,
            engine="mujoco",
        ),
        _fault(
            "restore-warm-start",
            "restore forgets warm starts",
            "restore-impact",
            "warm starts",
            simulation=_RestoreForgetsWarmStart,
            engine="mujoco",
        ),
        _fault(
            "restore-wrench", "restore forgets wrenches", "restore-wrench", "wrench", simulation=_RestoreForgetsWrench
        ),
        _fault(
            "state-behind",
            "state stays in the simulation, so that a copy shares nothing",
            "restore",
            "in a copy",
            simulation=_StateStaysBehind,
        ),
        _fault(
            "state-live", "state that changes as the simulation goes on", "restore", "copies", simulation=_LiveState
        ),
        _fault(
            "state-disturbs", "state() advances the simulation", "restore", "after state()", simulation=_StateDisturbs
        ),
        _fault("random", "random numbers without a seed", "determinism", "random numbers", scene=_random_friction),
        _fault("torque-ignored", "torque ignored", "inertia-box", "torque", simulation=_TorqueIgnored),
        _fault("wrench-body", "wrench in the body frame", "wrench-frame", "world frame", simulation=_WrenchInBody),
        _fault(
            "wrench-once", "wrench acts for one interval", "wrench-force", "first interval only", simulation=_WrenchOnce
        ),
        _fault(
            "wrench-origin",
            "force acts at the body origin",
            "wrench-centre",
            "the force acts at the body origin",
            simulation=_ForceAtOrigin,
        ),
        _fault(
            "hinge-axis",
            "axis of the hinge tilted by 3 degrees",
            "hinge-radius",
            "axis is tilted",
            scene=_joints(Hinge, lambda one: replace(one, axis=_tilted(one.axis, 3.0))),
        ),
        _fault(
            "hinge-anchor",
            "anchor of the hinge 2 mm off",
            "pendulum-period",
            "hinge's position",
            scene=_joints(Hinge, lambda one: replace(one, anchor_m=(one.anchor_m[0] + 2e-3, *one.anchor_m[1:]))),
        ),
        _fault(
            "hinge-damping",
            "damped joints and bodies",
            "pendulum-period",
            "damping",
            simulation=_model(_damped),
            engine="mujoco",
        ),
        _fault(
            "armature",
            "armature of joints and bodies",
            "pendulum-period",
            "armature",
            simulation=_model(_armature),
            engine="mujoco",
        ),
        _fault(
            "no-joints",
            "no hinges and strings",
            "pendulum-period",
            "hinge is missing",
            scene=lambda scene: replace(scene, joints=()),
        ),
        _fault(
            "hinged-missing",
            "no hinges between bodies",
            "hinged-closed",
            "the hinge is missing",
            scene=lambda scene: replace(scene, body_hinges=()),
        ),
        _fault(
            "hinged-axis",
            "axis of a hinge between bodies tilted by 3 degrees",
            "hinged-closed",
            "the axis in the frame of each body",
            simulation=_model(_hanging(_hinge_tilted)),
            engine="mujoco",
        ),
        _fault(
            "hinged-anchor",
            "anchor of a hinge between bodies 2 mm off",
            "hinged-closed",
            "the anchor",
            simulation=_model(_hanging(_hinge_shifted)),
            engine="mujoco",
        ),
        _fault(
            "hinged-weightless",
            "no gravity on a body that hangs on another one",
            "hinged-fall",
            "gravity acts on both",
            simulation=_HangingWeightless,
        ),
        _fault(
            "hinged-inertia",
            "inertia of a body that hangs on another one times 1.5",
            "hinged-momentum",
            "the inertia of both",
            simulation=_model(_hanging(_hinge_heavy)),
            engine="mujoco",
        ),
        _fault(
            "hinged-damping",
            "hinges between bodies are damped",
            "hinged-energy",
            "damping",
            simulation=_model(_hanging(_hinge_damped)),
            engine="mujoco",
        ),
        _fault(
            "hinged-backwards",
            "hinges between bodies start in the other direction",
            "hinged-angle",
            "it turns the other way",
            simulation=_HingeBackwards,
            engine="mujoco",
        ),
        _fault(
            "tether-length",
            "string 5 % long",
            "tether-length",
            "315",
            scene=_joints(Tether, lambda one: replace(one, length_m=1.05 * one.length_m)),
        ),
        _fault(
            "tether-short",
            "string 20 % short",
            "tether-slack",
            "shorter than its length_m",
            scene=_joints(Tether, lambda one: replace(one, length_m=0.7 * one.length_m)),
        ),
        _fault(
            "no-contacts",
            "no contacts",
            "contact-listed",
            "does not collide",
            scene=lambda scene: replace(scene, contacts=()),
        ),
        _fault(
            "first-contact",
            "first contact of a scene only",
            "slide",
            "has no contact",
            scene=_first_contact_only,
        ),
        _fault("all-collide", "all bodies collide", "contact-unlisted", "collision filter", scene=_all_collide),
        _fault(
            "nothing-fixed",
            "fixed bodies move",
            "fixed-body-stays",
            "must be static",
            scene=_nothing_fixed,
            simulation=_AsIs,
        ),
        _fault(
            "soft-contacts",
            "contacts ten times too slow",
            "contact-listed",
            "so soft",
            settings={"sustained_solref": (0.2, 1.0)},
            engine="mujoco",
        ),
        _fault(
            "gains-energy",
            "2 % more speed in each interval",
            "time",
            "each call changes its speed",
            simulation=_GainsEnergy,
            engine="mujoco",
        ),
        _fault(
            "cloth-stretch",
            "stretch stiffness of cloth times 1.3",
            "cloth-stretch",
            "stretches 0.7",
            scene=_deformables(Cloth, stretch_stiffness_n_per_m=1.3),
        ),
        _fault(
            "cloth-shear",
            "shear stiffness of cloth times 1.35",
            "cloth-shear",
            "shear",
            scene=_deformables(Cloth, shear_stiffness_n_per_m=1.35),
        ),
        _fault(
            "cloth-bending",
            "bending stiffness of cloth times 2",
            "cloth-bending",
            "bends 0.",
            scene=_deformables(Cloth, bend_stiffness_n_m_per_rad=2.0),
        ),
        _fault(
            "cloth-limp",
            "no bending stiffness of cloth",
            "cloth-bending",
            "bends",
            scene=_deformables(Cloth, bend_stiffness_n_m_per_rad=0.05),
        ),
        _fault(
            "cloth-mass",
            "mass per area of cloth times 1.3",
            "cloth-stretch",
            "mass of the nodes",
            scene=_deformables(Cloth, mass_kg=1.3, areal_density_kg_per_m2=1.3),
        ),
        _fault("cloth-sides", "warp and weft of cloth exchanged", "cloth-start", "warp along x", scene=_warp_along_y),
        _fault(
            "cloth-friction",
            "friction of cloth 20 % low",
            "cloth-slide",
            "friction were 0.24",
            scene=lambda scene: _contacts(friction=lambda mu: 0.8 * mu)(scene) if scene.deformables else scene,
        ),
        _fault("cloth-height", "cloth 3 mm too high", "cloth-start", "centred on its pose", scene=_thick),
        _fault("cloth-random", "random fabric", "cloth-determinism", "random numbers", scene=_random_fabric),
        _fault(
            "no-attachments",
            "attachments missing",
            "cloth-pinned-edge",
            "attachment is missing",
            scene=lambda scene: replace(scene, attachments=()),
        ),
        _fault(
            "attachment-depth", "attachments at the edge only", "cloth-bending", "a clamp of 50 mm", scene=_edge_only
        ),
        _fault("nodes-lag", "nodes one interval late", "cloth-pinned-edge", "late", simulation=_NodesLag),
        _fault(
            "nodes-shuffled", "nodes of a rope in another order", "rope-nodes", "in order", simulation=_NodesShuffled
        ),
        _fault(
            "nodes-reversed",
            "nodes change their order",
            "cloth-pinned-edge",
            "order changes",
            simulation=_NodesReversed,
        ),
        _fault("nodes-millimetres", "nodes in mm", "cloth-start", "in mm", simulation=_NodesInMillimetres),
        _fault(
            "air-ignored",
            "air ignored",
            "air-terminal",
            "no effect",
            scene=lambda scene: replace(scene, air=None),
        ),
        _fault(
            "air-doubled",
            "drag without the factor 1/2, or areas counted twice",
            "air-terminal",
            "2 times",
            scene=_air(lambda air: replace(air, density_kg_per_m3=2.0 * air.density_kg_per_m3)),
        ),
        _fault(
            "air-wind",
            "wind from the other side",
            "air-pressure",
            "against the wind",
            scene=_air(lambda air: replace(air, wind_m_per_s=vector(np.negative(air.wind_m_per_s)))),
        ),
        _fault(
            "air-friction",
            "friction of one side of the cloth",
            "air-friction",
            "counts both sides",
            scene=_air(lambda air: replace(air, tangential_coefficient=0.5 * air.tangential_coefficient)),
        ),
        _fault(
            "air-lift",
            "no lift",
            "air-lift",
            "perpendicular",
            scene=_air(lambda air: replace(air, lift_coefficient=0.0)),
        ),
        _fault(
            "air-pumps",
            "forces of the air along the motion, where there is lift as well as drag and no wind",
            "air-energy",
            "wrong sign",
            scene=_air(_pumping),
        ),
        _fault(
            "foam-young",
            "Young's modulus of foam 10 % high",
            "foam-tension",
            "stretches 0.9",
            scene=_deformables(SoftBody, young_modulus_pa=1.1),
        ),
        _fault(
            "foam-poisson",
            "Poisson's ratio of foam 0",
            "foam-poisson",
            "nu = 0",
            scene=_deformables(SoftBody, poisson_ratio=0.0),
        ),
        _fault(
            "foam-mass",
            "mass of foam times 1.3",
            "foam-tension",
            "mass of the nodes",
            scene=_deformables(SoftBody, mass_kg=1.3),
        ),
        _fault(
            "rope-length", "rope 3 % long", "rope-length", "another length", scene=_deformables(Rope, length_m=1.03)
        ),
        _fault(
            "rod-young",
            "Young's modulus of a rod 20 % high",
            "rod-bending",
            "bends 0.83",
            scene=_deformables(Rod, young_modulus_pa=1.2),
        ),
        _fault(
            "rod-radius", "radius of a rod 10 % high", "rod-bending", "radius", scene=_deformables(Rod, radius_m=1.1)
        ),
        _fault(
            "rod-mass",
            "mass of a rod times 1.3",
            "rod-bending",
            "mass of the nodes",
            scene=_deformables(Rod, mass_kg=1.3),
        ),
    )
)
"""Faults by id: rigid ones first, then deformable ones."""
