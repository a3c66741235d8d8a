"""Conformance checks: a healthy engine passes every check, and a planted fault is named by the check that should."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import mutations
import numpy as np
import pytest
from mutation_cases import ALSO
from numpy.typing import NDArray
from scipy.integrate import quad
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from gauge_envs.backends import Backend, Simulation, Support, backend, registry
from gauge_envs.cli.app import app
from gauge_envs.errors import ParameterError, UnknownNameError, UnsupportedSceneError
from gauge_envs.pages.document import as_markdown
from gauge_envs.scene import Box, Cloth, Contact, Hinge, Motion, Pose, RigidBody, Rod, Scene, SoftBody
from gauge_envs.scene.meshes import mass_properties
from gauge_envs.tools.conformance import CheckResult, Status, checks, run_checks
from gauge_envs.tools.conformance.forces import EULER_DEG, _frame_hint
from gauge_envs.tools.conformance.laws import hann_mean, pendulum_period_s, torque_free_orientation
from gauge_envs.tools.conformance.words import findings_document

MUJOCO = backend("mujoco")

# --- backends with one fault each ---


class Wrapped(Simulation):
    """A healthy simulation, passed through."""

    def __init__(self, inner: Simulation, scene: Scene) -> None:
        self.inner: Any = inner
        self.scene = scene
        self.settings = inner.settings

    def reset(self, seed: int) -> None:
        self.inner.reset(seed)

    def drive(self, body: str, pose: Pose, velocity: NDArray[np.float64], acceleration: NDArray[np.float64]) -> None:
        self.inner.drive(body, pose, velocity, acceleration)

    def advance(self, seconds: float) -> None:
        self.inner.advance(seconds)

    def body_states(self, names: Sequence[str]) -> NDArray[np.float64]:
        return self.inner.body_states(names)

    def apply_wrench(self, body: str, wrench: NDArray[np.float64]) -> None:
        self.inner.apply_wrench(body, wrench)

    def nodes(self, name: str) -> NDArray[np.float64]:
        return self.inner.nodes(name)

    def state(self) -> Any:
        return self.inner.state()

    def restore(self, state: Any) -> None:
        self.inner.restore(state)

    def close(self) -> None:
        self.inner.close()


@dataclass(frozen=True)
class Faulty(Backend):
    """MuJoCo with a fault: in the scene that it builds, or in the simulation that it returns."""

    scene: Callable[[Scene], Scene] = lambda scene: scene
    simulation: type[Wrapped] = Wrapped
    name = "faulty"

    def versions(self) -> dict[str, str]:
        return {"faulty": "1.0"}

    def supports(self, scene: Scene) -> Support:
        return MUJOCO.supports(scene)

    def build(self, scene: Scene, settings: Mapping[str, Any] | None = None) -> Simulation:
        return self.simulation(MUJOCO.build(self.scene(scene), settings), scene)


def with_contacts(**changes: Callable[[float], float]) -> Callable[[Scene], Scene]:
    def change(scene: Scene) -> Scene:
        contacts = [
            replace(one, **{key: value(getattr(one, key)) for key, value in changes.items()}) for one in scene.contacts
        ]
        return replace(scene, contacts=tuple(contacts))

    return change


def with_deformables(kind: type, **factors: float) -> Callable[[Scene], Scene]:
    def change(scene: Scene) -> Scene:
        bodies = [
            replace(one, **{key: factor * getattr(one, key) for key, factor in factors.items()})
            if isinstance(one, kind)
            else one
            for one in scene.deformables
        ]
        return replace(scene, deformables=tuple(bodies))

    return change


def with_velocities(change: Callable[[RigidBody], dict[str, Any]]) -> Callable[[Scene], Scene]:
    def changed(scene: Scene) -> Scene:
        return replace(
            scene, bodies=tuple(body if body.starts_at_rest else replace(body, **change(body)) for body in scene.bodies)
        )

    return changed


class LosesVelocityAtReset(Wrapped):
    """The start velocities are written by `build` only."""

    def reset(self, seed: int) -> None:
        self.inner.reset(seed)
        self.inner.data.qvel[:] = 0.0


def velocity_of_centre(body: RigidBody) -> dict[str, Any]:
    """Give the centre of mass the velocity that the scene states for the origin."""
    arm = body.pose.rotation.apply(mass_properties(body.shape, body.mass_kg)[0])
    linear = np.subtract(body.linear_velocity_m_per_s, np.cross(body.angular_velocity_rad_per_s, arm))
    return {"linear_velocity_m_per_s": tuple(linear.tolist())}


def with_states(change: Callable[[NDArray[np.float64]], None]) -> type[Wrapped]:
    """Simulation that reports other states than it has."""

    class Misreported(Wrapped):
        def body_states(self, names: Sequence[str]) -> NDArray[np.float64]:
            states = np.array(self.inner.body_states(names))
            change(states)
            return states

    return Misreported


def spin_reversed(states: NDArray[np.float64]) -> None:
    states[:, 10:] *= -1.0


def spin_in_body_frame(states: NDArray[np.float64]) -> None:
    states[:, 10:] = Rotation.from_quat(states[:, 3:7], scalar_first=True).apply(states[:, 10:], inverse=True)


def scalar_last(states: NDArray[np.float64]) -> None:
    states[:, 3:7] = np.roll(states[:, 3:7], -1, axis=1)


def in_millimetres(states: NDArray[np.float64]) -> None:
    states[:, :3] *= 1e3


def velocity_of_another_point(states: NDArray[np.float64]) -> None:
    arm = Rotation.from_quat(states[:, 3:7], scalar_first=True).apply([0.05, 0.03, 0.015])
    states[:, 7:10] += np.cross(states[:, 10:], arm)


class ResetKeepsVelocity(Wrapped):
    def reset(self, seed: int) -> None:
        velocity = self.inner.data.qvel.copy()
        self.inner.reset(seed)
        self.inner.data.qvel[:] = velocity


class NoReset(Wrapped):
    def reset(self, seed: int) -> None:
        pass


class RestoreForgetsVelocity(Wrapped):
    def restore(self, state: Any) -> None:
        self.inner.restore(state)
        self.inner.data.qvel[:] = 0.0


class StateStaysBehind(Wrapped):
    """Keeps its state to itself, and returns nothing of it."""

    kept: Any = None

    def state(self) -> None:
        self.kept = self.inner.state()

    def restore(self, state: None) -> None:
        if self.kept is not None:
            self.inner.restore(self.kept)


class Explosion(Wrapped):
    """Gains energy all the time, and stays finite."""

    def advance(self, seconds: float) -> None:
        self.inner.advance(seconds)
        self.inner.data.qvel[:] *= 1.02


class Blast(Wrapped):
    """Bodies that fall over are thrown off with a speed that the scene cannot give, yet finite."""

    def advance(self, seconds: float) -> None:
        self.inner.advance(seconds)
        speed = np.abs(self.inner.data.qvel)
        self.inner.data.qvel[speed > 1.0] *= 1.5


class FrozenCylinder(Wrapped):
    """Reports a body that it has left out as if it stood still."""

    def body_states(self, names: Sequence[str]) -> NDArray[np.float64]:
        states = np.zeros((len(names), 13))
        for row, name in zip(states, names, strict=True):
            if name != "cylinder":
                row[:] = self.inner.body_states([name])[0]
            else:
                pose = self.scene.body(name).pose
                row[:7] = [*pose.position_m, *pose.quaternion]
        return states


class SceneOrder(Wrapped):
    def body_states(self, names: Sequence[str]) -> NDArray[np.float64]:
        return self.inner.body_states(sorted(names))


class Teleport(Wrapped):
    def drive(self, body: str, pose: Pose, velocity: NDArray[np.float64], acceleration: NDArray[np.float64]) -> None:
        self.inner.drive(body, pose, np.zeros(6), np.zeros(6))


class Lag(Wrapped):
    """Nodes are those of an interval before."""

    def advance(self, seconds: float) -> None:
        self.before = {one.name: self.inner.nodes(one.name).copy() for one in self.scene.deformables}
        self.inner.advance(seconds)

    def nodes(self, name: str) -> NDArray[np.float64]:
        return self.before[name] if hasattr(self, "before") else self.inner.nodes(name)


class DriverLags(Wrapped):
    """Gets each interval's motion an interval later."""

    def drive(self, body: str, pose: Pose, velocity: NDArray[np.float64], acceleration: NDArray[np.float64]) -> None:
        before = getattr(self, "before", None) or (body, pose, velocity, acceleration)
        self.before = (body, pose, velocity, acceleration)
        self.inner.drive(*before)


class Stretched(Wrapped):
    """Nodes are 2 % further from the world's origin than they are."""

    def nodes(self, name: str) -> NDArray[np.float64]:
        return 1.02 * self.inner.nodes(name)


class Damped(Wrapped):
    def __init__(self, inner: Simulation, scene: Scene) -> None:
        super().__init__(inner, scene)
        self.inner.model.dof_damping[:] = 1e-4


class OneStepPerCall(Wrapped):
    def advance(self, seconds: float) -> None:
        self.inner.advance(1 / 180)


class ReadsBeforeAdvance(Wrapped):
    def sample_positions(self, names: Sequence[str], count: int, interval_s: float) -> NDArray[np.float64]:
        positions = np.empty((count, len(names), 3))
        for row in positions:
            row[:] = self.inner.body_states(names)[:, :3]
            self.inner.advance(interval_s)
        return positions


class StepsAtBuild(Wrapped):
    def __init__(self, inner: Simulation, scene: Scene) -> None:
        super().__init__(inner, scene)
        self.inner.advance(1 / 180)


class TiltedGravity(Wrapped):
    def __init__(self, inner: Simulation, scene: Scene) -> None:
        super().__init__(inner, scene)
        self.inner.model.opt.gravity[:2] = 0.1


class StartsTurning(Wrapped):
    def reset(self, seed: int) -> None:
        self.inner.reset(seed)
        self.inner.data.qvel[3] = 0.01


class Armature(Wrapped):
    def __init__(self, inner: Simulation, scene: Scene) -> None:
        super().__init__(inner, scene)
        self.inner.model.dof_armature[:] = 1e-4


class CentreOfMassElsewhere(Wrapped):
    def __init__(self, inner: Simulation, scene: Scene) -> None:
        super().__init__(inner, scene)
        self.inner.model.body("brick").ipos[0] += 0.005


class HalfTheTime(Wrapped):
    def advance(self, seconds: float) -> None:
        self.inner.advance(0.5 * seconds)


class DrivenInDegrees(Wrapped):
    def drive(self, body: str, pose: Pose, velocity: NDArray[np.float64], acceleration: NDArray[np.float64]) -> None:
        velocity, acceleration = np.array(velocity), np.array(acceleration)
        velocity[3:], acceleration[3:] = np.degrees(velocity[3:]), np.degrees(acceleration[3:])
        self.inner.drive(body, pose, velocity, acceleration)


def scalar_first_read_last(scene: Scene) -> Scene:
    bodies = []
    for one in scene.bodies:
        x, y, z, w = one.pose.quaternion
        bodies.append(replace(one, pose=replace(one.pose, quaternion=(w, x, y, z))))
    return replace(scene, bodies=tuple(bodies))


def hinge_moved(scene: Scene) -> Scene:
    joints = [replace(one, anchor_m=(one.anchor_m[0] + 1e-3, *one.anchor_m[1:])) for one in scene.joints]
    return replace(scene, joints=tuple(joints))


def shorter_string(scene: Scene) -> Scene:
    return replace(scene, joints=tuple(replace(one, length_m=0.2) for one in scene.joints))


def nothing_is_fixed(scene: Scene) -> Scene:
    bodies = [replace(one, motion=Motion.DYNAMIC) if one.motion is Motion.FIXED else one for one in scene.bodies]
    return replace(scene, bodies=tuple(bodies))


def random_fabric(scene: Scene) -> Scene:
    return with_deformables(Cloth, stretch_stiffness_n_per_m=1.0 + 1e-9 * np.random.default_rng().random())(scene)


def all_collide(scene: Scene) -> Scene:
    names = tuple(one.name for one in scene.bodies)
    return replace(scene, contacts=(Contact(first=names, second=names, friction=0.5, restitution=0.0),))


def random_friction(scene: Scene) -> Scene:
    return with_contacts(friction=lambda value: value * float(1.0 + 1e-9 * np.random.default_rng().random()))(scene)


def without_cylinder(scene: Scene) -> Scene:
    return replace(scene, bodies=tuple(one for one in scene.bodies if one.name != "cylinder"))


def heavier_left_ball(scene: Scene) -> Scene:
    bodies = [replace(one, mass_kg=1.5 * one.mass_kg) if one.name == "left" else one for one in scene.bodies]
    return replace(scene, bodies=tuple(bodies))


FAULTS: dict[str, tuple[Faulty, str, str]] = {
    # name: backend, the check that must fail, what its diagnosis must say
    "friction 20 % low": (
        Faulty(with_contacts(friction=lambda mu: 0.8 * mu)),
        "slide",
        "friction were 0.24 instead",
    ),
    "friction 20 % high": (Faulty(with_contacts(friction=lambda mu: 1.2 * mu)), "slide", "friction were 0.36 instead"),
    "friction of the engine": (Faulty(with_contacts(friction=lambda mu: 0.3)), "slide-of-pair", "each pair of bodies"),
    "no static friction": (Faulty(with_contacts(friction=lambda mu: 0.0)), "hold", "creeps"),
    "friction of both bodies multiplied": (Faulty(with_contacts(friction=lambda mu: mu**2)), "slide", "its square"),
    "half the time": (Faulty(simulation=HalfTheTime), "free-fall", "simulates 0.5 times the time"),
    "gravity twice": (
        Faulty(lambda scene: replace(scene, gravity_m_per_s2=2.0 * scene.gravity_m_per_s2)),
        "free-fall",
        "gravity acts twice",
    ),
    "quaternion in another order inside": (
        Faulty(scalar_first_read_last),
        "inertia-box",
        "w, x, y, z was read as x, y, z, w",
    ),
    "scalar last, spin": (Faulty(simulation=with_states(scalar_last)), "angular-velocity", "another order inside"),
    "driven in degrees": (Faulty(simulation=DrivenInDegrees), "driven-path", "turns 57.3 times as far"),
    "spin in the body frame, start": (
        Faulty(simulation=with_states(spin_in_body_frame)),
        "start-velocity-reset",
        "the reported angular velocity is in the body frame",
    ),
    "plane that holds": (Faulty(with_contacts(friction=lambda mu: 5.0)), "slide-plane", "friction holds the brick"),
    "gravity upward": (
        Faulty(lambda scene: replace(scene, gravity_m_per_s2=-scene.gravity_m_per_s2)),
        "free-fall",
        "falls upward: the sign of gravity",
    ),
    "gravity of the engine": (
        Faulty(lambda scene: replace(scene, gravity_m_per_s2=9.81)),
        "gravity-of-scene",
        "gravity from the scene",
    ),
    "spin reversed": (Faulty(simulation=with_states(spin_reversed)), "angular-velocity", "wrong sign"),
    "spin in the body frame": (Faulty(simulation=with_states(spin_in_body_frame)), "angular-velocity", "body frame"),
    "spin reversed, orientation": (Faulty(simulation=with_states(spin_reversed)), "spin-orientation", "sign or frame"),
    "velocity of another point": (
        Faulty(simulation=with_states(velocity_of_another_point)),
        "velocity-of-origin",
        "velocity of the centre of mass",
    ),
    "scalar last": (Faulty(simulation=with_states(scalar_last)), "start-orientation", "x, y, z, w"),
    "millimetres": (Faulty(simulation=with_states(in_millimetres)), "start-position", "in mm"),
    "reset keeps velocity": (Faulty(simulation=ResetKeepsVelocity), "reset-start", "velocities are kept"),
    "reset keeps velocity, trajectory": (
        Faulty(simulation=ResetKeepsVelocity),
        "reset-course",
        "does not restore velocities",
    ),
    "no reset": (Faulty(simulation=NoReset), "reset-start", "does not restore all positions"),
    "no reset of cloth": (Faulty(simulation=NoReset), "cloth-reset", "positions and velocities of the nodes"),
    "restore forgets velocity": (Faulty(simulation=RestoreForgetsVelocity), "restore", "velocities"),
    "restore forgets velocity of cloth": (Faulty(simulation=RestoreForgetsVelocity), "cloth-restore", "velocities"),
    "state stays behind": (Faulty(simulation=StateStaysBehind), "copy", "must be picklable"),
    "state of cloth stays behind": (Faulty(simulation=StateStaysBehind), "cloth-copy", "must be picklable"),
    "random": (Faulty(random_friction), "determinism", "random numbers"),
    "order of the scene": (Faulty(simulation=SceneOrder), "order-of-names", "order asked for"),
    "one step a call": (Faulty(simulation=OneStepPerCall), "time", "count steps"),
    "reads before it advances": (Faulty(simulation=ReadsBeforeAdvance), "sample-positions", "advance first"),
    "a body left out": (Faulty(without_cylinder, FrozenCylinder), "all-bodies-move", "the cylinder fell 0 m"),
    "finite explosion": (Faulty(simulation=Explosion), "pile-energy", "makes energy"),
    "finite explosion of a drop": (Faulty(simulation=Explosion), "drop-energy", "finite all the time"),
    "finite explosion, speed": (Faulty(simulation=Blast), "pile-bounds", "makes energy"),
    "finite explosion of cloth": (Faulty(simulation=Explosion), "cloth-energy", "makes energy"),
    "no restitution": (Faulty(with_contacts(restitution=lambda e: 0.0)), "rebound-0.5", "restitution enters"),
    "no restitution between balls": (
        Faulty(with_contacts(restitution=lambda e: 0.0)),
        "collision-rebound",
        "not that of the pair",
    ),
    "wrong mass": (Faulty(heavier_left_ball), "collision-momentum", "masses are not the scene's"),
    "no contacts": (Faulty(lambda scene: replace(scene, contacts=())), "contact-listed", "does not collide"),
    "all collide": (Faulty(all_collide), "contact-unlisted", "held by"),
    "teleport": (Faulty(simulation=Teleport), "driven-velocity", "teleported"),
    "teleport carries nothing": (Faulty(simulation=Teleport), "carry-line", "must have a velocity"),
    "damped hinge": (Faulty(simulation=Damped), "pendulum-energy", "damped"),
    "damped spin": (Faulty(simulation=Damped), "spin-momentum", "angular damping"),
    "driver lags": (Faulty(simulation=DriverLags), "driven-path", "one interval (1/180 s) late"),
    "no joints": (Faulty(lambda scene: replace(scene, joints=())), "tether-length", "missing"),
    "stretch 10 % off": (
        Faulty(with_deformables(Cloth, stretch_stiffness_n_per_m=0.9)),
        "cloth-stretch",
        "stretches 1.1",
    ),
    "shear of springs": (
        Faulty(with_deformables(Cloth, shear_stiffness_n_per_m=1.35)),
        "cloth-shear",
        "shear constant",
    ),
    "bending twice": (Faulty(with_deformables(Cloth, bend_stiffness_n_m_per_rad=2.0)), "cloth-bending", "bends 0.4"),
    "attached edge lags": (Faulty(simulation=Lag), "cloth-pinned-edge", "one interval (1/180 s) late"),
    "attached face lags": (Faulty(simulation=Lag), "foam-pinned-face", "one interval (1/180 s) late"),
    "modulus 10 % off": (Faulty(with_deformables(SoftBody, young_modulus_pa=1.1)), "foam-tension", "stretches 0.9"),
    "no Poisson contraction": (
        Faulty(with_deformables(SoftBody, poisson_ratio=0.0)),
        "foam-poisson",
        "nothing contracts",
    ),
    "friction of cloth 20 % low": (
        Faulty(with_contacts(friction=lambda mu: 0.8 * mu)),
        "cloth-slide",
        "friction were 0.24 instead",
    ),
    "no contacts of cloth": (Faulty(lambda scene: replace(scene, contacts=())), "cloth-rests", "falls through"),
    "cloth in another place": (Faulty(simulation=Stretched), "cloth-start", "nodes are world positions"),
    "foam in another place": (Faulty(simulation=Stretched), "foam-start", "nodes are world positions"),
    "rope stretches": (Faulty(simulation=Stretched), "rope-length", "too soft"),
    "finite explosion of a rope": (Faulty(simulation=Explosion), "rope-energy", "makes energy"),
    "steps at build": (Faulty(simulation=StepsAtBuild), "start-rest", "must not step"),
    "tilted gravity": (Faulty(simulation=TiltedGravity), "free-fall-drift", "tilted"),
    "tilted gravity, slide": (Faulty(simulation=TiltedGravity), "slide-straight", "turns"),
    "starts turning": (Faulty(simulation=StartsTurning), "free-fall-turn", "convention"),
    "armature": (Faulty(simulation=Armature), "pendulum-period", "armature"),
    "centre of mass elsewhere": (Faulty(simulation=CentreOfMassElsewhere), "solid-spin-centre", "centre of mass"),
    "start velocity ignored": (
        Faulty(with_velocities(lambda body: {"linear_velocity_m_per_s": (0.0, 0.0, 0.0)})),
        "start-velocity",
        "starts at rest",
    ),
    "start velocity in mm/s": (
        Faulty(
            with_velocities(
                lambda body: {"linear_velocity_m_per_s": tuple(1e-3 * v for v in body.linear_velocity_m_per_s)}
            )
        ),
        "start-velocity",
        "in mm/s",
    ),
    "start spin in the body frame": (
        Faulty(
            with_velocities(
                lambda body: {
                    "angular_velocity_rad_per_s": tuple(body.pose.rotation.apply(body.angular_velocity_rad_per_s))
                }
            )
        ),
        "start-spin",
        "in the body frame",
    ),
    "start velocity of the centre of mass": (
        Faulty(with_velocities(velocity_of_centre)),
        "start-velocity-of-origin",
        "to the centre of mass",
    ),
    "start velocity lost at reset": (
        Faulty(simulation=LosesVelocityAtReset),
        "start-velocity-reset",
        "at rest after the reset",
    ),
    "hinge moved": (Faulty(hinge_moved), "hinge-radius", "joint"),
    "shorter string": (Faulty(shorter_string), "tether-slack", "pushes"),
    "nothing is fixed": (Faulty(nothing_is_fixed), "fixed-body-stays", "must be static"),
    "teleport pushes": (Faulty(simulation=Teleport), "pushed-ball", "without velocity"),
    "teleport does not turn": (Faulty(simulation=Teleport), "carry-turn", "must have a velocity"),
    "friction low on a plate": (Faulty(with_contacts(friction=lambda mu: 0.8 * mu)), "carry-slip", "of the pair"),
    "pile falls through": (Faulty(lambda scene: replace(scene, contacts=())), "pile-sinks", "tunnel"),
    "random fabric": (Faulty(random_fabric), "cloth-determinism", "random numbers"),
    **{
        f"restitution high, {e}": (Faulty(with_contacts(restitution=lambda e: e + 0.01)), f"rebound-{e}", "restitution")
        for e in (0.2, 0.75, 0.95)
    },
    "stiff rod": (Faulty(with_deformables(Rod, young_modulus_pa=1.2)), "rod-bending", "bends 0.83"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_planted_fault_is_named(fault: str) -> None:
    engine, name, diagnosis = FAULTS[fault]
    (finding,) = run_checks(engine, only=[name])
    assert finding.status is Status.FAIL, finding
    assert diagnosis in finding.diagnosis


@pytest.mark.parametrize(
    ("words", "wrong"),
    [
        ("along the axes of the world", lambda right: Rotation.identity()),
        ("from the world to the body", lambda right: right.inv()),
        ("x, y, z, w was read as w, x, y, z", lambda right: Rotation.from_quat(right.as_quat(), scalar_first=True)),
        ("", lambda right: right * Rotation.from_rotvec([0.0, 0.0, 0.3])),
    ],
)
def test_the_wrong_frame_of_an_inertia_is_named(words: str, wrong: Callable[[Rotation], Rotation]) -> None:
    own = np.diag([1.5e-4, 3.6e-4, 4.5e-4])
    frame = wrong(Rotation.from_euler("xyz", EULER_DEG, degrees=True)).as_matrix()
    found = _frame_hint(frame @ own @ frame.T, own)
    assert words in found and bool(words) == bool(found)


def test_every_check_can_fail() -> None:
    planted = {name for _, name, _ in FAULTS.values()} | {fault.caught_by for fault in mutations.FAULTS.values()}
    assert planted | set(ALSO) == {check.id for check in checks()}


def test_deformable_laws_read_the_same_at_any_damping() -> None:
    """MuJoCo's integrator damps in proportion to its step, here by a factor of ten."""
    laws = ["cloth-stretch", "cloth-shear", "cloth-bending", "rod-bending"]
    damped, swinging = (
        {one.check: one.measured for one in run_checks("mujoco", settings={"timestep_s": step}, only=laws)}
        for step in (1 / 180, 1 / 1800)
    )
    assert damped == pytest.approx(swinging, rel=0.01)


def test_every_check_passes_on_a_healthy_engine() -> None:
    findings = list(run_checks("mujoco"))
    assert [finding.check for finding in findings] == [check.id for check in checks()]
    assert not [finding for finding in findings if finding.status is not Status.PASS]


# --- how it runs ---


class Declines(Faulty):
    def supports(self, scene: Scene) -> Support:
        return Support(("it knows no cloth",) if scene.deformables else ())


class KnowsBallsOnly(Faulty):
    def supports(self, scene: Scene) -> Support:
        return Support(tuple(f"{one.name!r} is a box" for one in scene.bodies if isinstance(one.shape, Box)))


class CannotBuild(Faulty):
    def build(self, scene: Scene, settings: Mapping[str, Any] | None = None) -> Simulation:
        if scene.deformables:
            raise KeyError("mesh")
        return super().build(scene, settings)


class NotFinite(Wrapped):
    def body_states(self, names: Sequence[str]) -> NDArray[np.float64]:
        return np.full((len(names), 13), np.nan)


class RaisesInAdvance(Wrapped):
    def advance(self, seconds: float) -> None:
        raise KeyError("brick")


def test_an_error_of_the_engine_has_its_place() -> None:
    (finding,) = run_checks(Faulty(simulation=RaisesInAdvance), only=["free-fall"])
    assert finding.status is Status.ERROR
    assert "KeyError: 'brick' (advance, test_conformance.py, line" in finding.diagnosis


def test_what_is_declined_is_no_failure_and_has_its_reasons() -> None:
    findings = {one.check: one for one in run_checks(Declines(), only=["cloth-stretch", "free-fall"])}
    assert findings["free-fall"].status is Status.PASS
    declined = findings["cloth-stretch"]
    assert (declined.status, declined.missing, declined.is_bad) == (Status.DECLINED, ("it knows no cloth",), False)
    assert declined.measured is None


def test_repeatability_is_checked_on_an_engine_that_knows_little() -> None:
    findings = list(
        run_checks(KnowsBallsOnly(), only=["reset-*", "determinism", "restore", "contact-*", "rebound-0.5"])
    )
    assert {one.status for one in findings} == {Status.PASS}
    (reset,) = run_checks(KnowsBallsOnly(simulation=NoReset), only=["reset-start"])
    assert reset.status is Status.FAIL


def test_an_exception_is_a_finding_and_the_others_go_on() -> None:
    findings = {one.check: one for one in run_checks(CannotBuild(), only=["cloth-s*", "free-fall"])}
    assert findings["free-fall"].status is Status.PASS
    for name in ("cloth-start", "cloth-stretch", "cloth-shear"):
        assert findings[name].status is Status.ERROR
        assert "supports() was true, but build() raised KeyError: 'mesh'" in findings[name].diagnosis


def test_what_is_not_finite_says_when() -> None:
    (finding,) = run_checks(Faulty(simulation=NotFinite), only=["free-fall"])
    assert finding.status is Status.ERROR
    assert "after 0 s 'brick' is not finite" in finding.diagnosis


def test_findings_are_json() -> None:
    findings = list(run_checks(Faulty(with_deformables(Cloth, stretch_stiffness_n_per_m=0.5)), only=["cloth-stretch"]))
    values = json.loads(json.dumps(findings[0].to_dict(), allow_nan=False))
    assert values["status"] == "fail"
    assert values["measured"] == pytest.approx(55.0, rel=0.03)
    assert values["versions"] == {"faulty": "1.0"}
    assert values["settings"]["preset"] == "cloth"


def test_settings_reach_the_backend() -> None:
    (finding,) = run_checks("mujoco", settings={"timestep_s": 1 / 900}, only=["free-fall"])
    assert finding.settings["timestep_s"] == 1 / 900


def test_settings_that_the_backend_refuses_end_the_run() -> None:
    with pytest.raises(ParameterError, match="unknown setting"):
        list(run_checks("mujoco", settings={"timestep": 1e-3}, only=["free-fall*"]))


def test_unknown_names_are_refused_before_anything_runs() -> None:
    with pytest.raises(UnknownNameError, match="free-fall"):
        run_checks("mujoco", only=["free-fal"])
    with pytest.raises(UnknownNameError, match="backend"):
        run_checks("mujko")


def test_every_check_says_what_it_is() -> None:
    for check in checks():
        for text in (check.title, check.scene, check.measures, check.law, check.source, check.unit, check.diagnosis):
            assert text
        assert check.tolerance.rationale
        assert check.id == check.id.lower().replace(" ", "-").replace("_", "-")


def test_an_id_is_used_once() -> None:
    first = checks()[0]
    from gauge_envs.tools.conformance import check

    with pytest.raises(ParameterError, match=first.id):
        check(
            first.id,
            title="",
            scene="",
            measures="",
            law="",
            source="",
            unit="",
            tolerance=first.tolerance,
            diagnosis="",
        )(first.measure)


# --- the command ---


@pytest.fixture
def gauge(monkeypatch: pytest.MonkeyPatch) -> Callable[..., Any]:
    """Runs the command; `faulty` is an installed backend whose friction is 20 % low and which knows no cloth."""
    broken = Declines(with_contacts(friction=lambda mu: 0.8 * mu))
    known = registry.backend
    monkeypatch.setattr(
        "gauge_envs.tools.conformance.run.find_backend", lambda name: broken if name == "faulty" else known(name)
    )
    return lambda *arguments: CliRunner(env={"COLUMNS": "160"}).invoke(app, ["backend", "check", *arguments])


ONLY = ("--only", "slide", "--only", "cloth-stretch")


def test_a_check_among_the_backends_is_named(gauge: Callable[..., Any]) -> None:
    result = gauge("mujoco", "--only", "free-fall", "slide")
    assert result.exit_code == 2
    assert "'slide' is a check and no backend: repeat the option, as --only slide" in result.output


def test_command_compares_backends(gauge: Callable[..., Any]) -> None:
    result = gauge("mujoco", "faulty", *ONLY)
    assert result.exit_code == 1
    rows = [line for line in result.stdout.splitlines() if line.startswith(("slide", "cloth-stretch"))]
    assert "pass" in rows[0]
    assert "FAIL" in rows[0]
    assert "declined" in rows[1]
    assert "as if the friction were 0.24 instead of 0.3" in " ".join(result.stdout.split())
    assert "it knows no cloth (cloth-stretch)" in result.stdout
    assert "mujoco: mujoco" in result.stdout
    assert "timestep_s" in result.stdout


def test_command_succeeds_where_nothing_fails(gauge: Callable[..., Any]) -> None:
    assert gauge("mujoco", "--only", "free-fall").exit_code == 0
    assert gauge("faulty", "--only", "cloth-stretch").exit_code == 0


def test_command_writes_json_lines(gauge: Callable[..., Any]) -> None:
    result = gauge("mujoco", "faulty", "--json", *ONLY)
    rows = [json.loads(line) for line in result.stdout.splitlines()]
    assert [(row["backend"], row["check"], row["status"]) for row in rows] == [
        ("mujoco", "slide", "pass"),
        ("mujoco", "cloth-stretch", "pass"),
        ("faulty", "slide", "fail"),
        ("faulty", "cloth-stretch", "declined"),
    ]


def test_command_writes_markdown(gauge: Callable[..., Any]) -> None:
    result = gauge("mujoco", "--format", "markdown", "--only", "free-fall")
    assert result.exit_code == 0
    assert result.stdout.splitlines()[0] == "| check | law | expected | mujoco |"
    assert result.stdout.splitlines()[2].startswith("| free fall (free-fall) | a = g | 9.807 +- 0.0098 m/s^2 |")


@pytest.mark.parametrize("arguments", [("nope",), ("mujoco", "--only", "nope")])
def test_command_refuses_unknown_names(gauge: Callable[..., Any], arguments: tuple[str, ...]) -> None:
    result = gauge(*arguments)
    assert result.exit_code == 2
    assert "unknown" in result.stderr


def test_checks_are_listed_with_their_scenes() -> None:
    result = CliRunner(env={"COLUMNS": "160"}).invoke(app, ["list", "checks", "rest-*"])
    assert result.exit_code == 0
    assert "rest-lying-cylinder" in result.stdout
    assert "fixed plane, box, sphere, cylinder" in " ".join(result.stdout.split())
    rows = [json.loads(line) for line in CliRunner().invoke(app, ["list", "checks", "--json"]).stdout.splitlines()]
    assert [row["id"] for row in rows] == [check.id for check in checks()]
    assert all(row["scene"] and row["measures"] and row["law"] for row in rows)


def test_command_needs_a_backend(gauge: Callable[..., Any]) -> None:
    result = gauge("--only", "free-fall")
    assert result.exit_code == 2
    assert "gauge backend check mujoco" in result.stderr


def test_command_reports_progress_without_a_terminal(
    gauge: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("gauge_envs.tools.conformance.command.LINE_INTERVAL_S", 0.0)
    result = gauge("mujoco", "--only", "free-fall", "--only", "hold")
    assert "1/2 mujoco: free-fall" in result.stderr
    assert "2/2 mujoco: hold" in result.stderr


def test_checks_that_fail_for_the_same_reason_have_one_line() -> None:
    broken = mutations.Mutant(MUJOCO, mutations.FAULTS["nan-mass"])
    results = list(run_checks(broken, only=["finite", "free-fall*", "slide*"]))
    text = as_markdown(findings_document(results))
    assert "see the check" not in text
    assert "more are not finite, see finite: free-fall" in text


def test_bars_in_laws_do_not_break_the_markdown_table() -> None:
    finding = next(run_checks("mujoco", only=["hinge-radius"]))
    assert isinstance(finding, CheckResult)
    assert "\\|r - anchor\\| = l" in as_markdown(findings_document([finding]))


class OfPendulum(Faulty):
    """MuJoCo with settings that fit scenes with a hinge only."""

    def build(self, scene: Scene, settings: Mapping[str, Any] | None = None) -> Simulation:
        if settings and not any(isinstance(joint, Hinge) for joint in scene.joints):
            raise UnsupportedSceneError("the preset is for scenes with a hinge")
        return super().build(scene, None)


def test_scenes_of_the_benchmark_that_the_settings_do_not_fit_are_left_out() -> None:
    (result,) = run_checks(OfPendulum(), settings={"preset": "hinge"}, only=["restore-benchmark-rigid"])
    assert result.status is Status.PASS
    (declined,) = run_checks(OfPendulum(), settings={"preset": "hinge"}, only=["restore-benchmark-soft"])
    assert declined.status is Status.DECLINED
    assert declined.missing == ("the preset is for scenes with a hinge",)


# --- what it compares with ---


def test_pendulum_period_is_the_integral_over_a_quarter_swing() -> None:
    amplitude, length, gyration = np.radians(100.0), 0.3, 0.05
    # Energy gives the angular speed; sin(theta / 2) = sin(amplitude / 2) sin(phi) removes the singularity at the end.
    k = np.sin(0.5 * amplitude)
    quarter, _ = quad(lambda phi: 1.0 / np.sqrt(1.0 - (k * np.sin(phi)) ** 2), 0.0, 0.5 * np.pi)
    expected = 4.0 * quarter * np.sqrt((length**2 + gyration**2) / (9.8 * length))
    measured = pendulum_period_s(length_m=length, gyration_m=gyration, amplitude_rad=amplitude, gravity_m_per_s2=9.8)
    assert measured == pytest.approx(expected, rel=1e-9)


def test_torque_free_symmetric_top_precesses_steadily() -> None:
    """Closed form: it turns with L / I1 about L, and with (1 - I3 / I1) times its own axial spin about its axis."""
    moments, spin = np.array([2.0, 2.0, 3.0]), np.array([0.7, 0.0, 1.1])
    turned = torque_free_orientation(start=Rotation.identity(), spin_rad_per_s=spin, moments=moments, seconds=2.0)
    momentum = moments * spin
    about_momentum = Rotation.from_rotvec(2.0 * momentum / moments[0])
    about_axis = Rotation.from_rotvec([0.0, 0.0, 2.0 * (1.0 - moments[2] / moments[0]) * spin[2]])
    assert (turned * (about_momentum * about_axis).inv()).magnitude() < 1e-8


@pytest.mark.parametrize("damping_per_s", [0.0, 1.0, 5.0, 60.0])
@pytest.mark.parametrize("periods", [4.0, 4.3, 6.5])
def test_the_centre_of_an_oscillation_does_not_depend_on_its_damping(damping_per_s: float, periods: float) -> None:
    times = np.linspace(0.2, 0.8, 109)
    swing = np.exp(-damping_per_s * times) * np.cos(2.0 * np.pi * periods / 0.6 * times + 0.4)
    assert hann_mean(1.0 - swing) == pytest.approx(1.0, abs=0.01)
