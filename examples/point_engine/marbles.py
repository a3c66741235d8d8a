"""A physics engine that holds all worlds in arrays: balls that fly, bounce and roll on fixed planes, in NumPy."""

from collections.abc import Iterator, Mapping, Sequence
from importlib.metadata import version
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gauge_envs.backends import ArraySimulation, ArrayWorlds, Backend, ReplayedSimulation, Simulation, Support
from gauge_envs.backends.settings import SteppedSettings, resolve_settings
from gauge_envs.scene import ContactMode, Motion, Plane, Scene, Sphere

Array = NDArray[np.float64]
PRESETS = {"default": SteppedSettings(preset="default", timestep_s=1 / 1800)}


class BackendMarbles(Backend):
    """Balls that may touch one fixed plane each."""

    name = "marbles"
    worlds_mix_constants = True

    def versions(self) -> dict[str, str]:
        """Version of the package of this file."""
        return {"point-engine": version("point-engine")}

    def supports(self, scene: Scene) -> Support:
        """Spheres, planes that face upward, and one contact for each sphere."""
        return Support(tuple(dict.fromkeys(_lacking(scene))))

    def build(self, scene: Scene, settings: Mapping[str, Any] | None = None) -> Simulation:
        """Build one world."""
        return ReplayedSimulation(ArraySimulation(self.build_worlds([scene], settings)))

    def build_worlds(self, scenes: Sequence[Scene], settings: Mapping[str, Any] | None = None) -> "MarbleWorlds":
        """Build all worlds at once."""
        return MarbleWorlds(scenes, resolve_settings("marbles", PRESETS, preset="default", changes=settings))


def _lacking(scene: Scene) -> Iterator[str]:
    if scene.deformables or scene.joints or any(body.motion is Motion.KINEMATIC for body in scene.bodies):
        yield "only free and fixed rigid bodies are simulated"
        return
    if not all(isinstance(body.shape, Sphere) for body in scene.dynamic_bodies):
        yield "a moving body is no sphere"
    partners = [(one, other) for contact in scene.contacts for one, other in scene.colliding_pairs(contact)]
    for one, other in partners:
        plane = scene.body(other if scene.body(one).motion is Motion.DYNAMIC else one)
        if not isinstance(plane.shape, Plane) or plane.pose.rotation.as_matrix()[2, 2] <= 0.0:
            yield f"{one!r} and {other!r} touch, and balls touch only planes that face upward"
    if len(partners) > len({name for pair in partners for name in pair if scene.body(name).motion is Motion.DYNAMIC}):
        yield "a ball may touch more than one plane"


class MarbleWorlds(ArrayWorlds):
    """States [world_count, body_count, 13], and the constants of the plane of each body."""

    def __init__(self, scenes: Sequence[Scene], settings: SteppedSettings) -> None:
        super().__init__(settings.model_dump(mode="json"), len(scenes))
        self.step_s = settings.timestep_s
        self.rows = {body.name: row for row, body in enumerate(scenes[0].bodies)}
        shape = len(scenes), len(self.rows)
        self.starts, self.gravity = np.zeros((*shape, 13)), np.zeros((*shape, 3))
        # A body without a contact has a plane without a normal, which it never reaches.
        self.normals, self.points = np.zeros((*shape, 3)), np.zeros((*shape, 3))
        self.radii, self.frictions, self.restitutions = np.ones(shape), np.zeros(shape), np.zeros(shape)
        for world, scene in enumerate(scenes):
            for row, body in enumerate(scene.bodies):
                spin = body.linear_velocity_m_per_s, body.angular_velocity_rad_per_s
                self.starts[world, row] = np.concatenate([body.pose.position_m, body.pose.quaternion, *spin])
                self.gravity[world, row, 2] = -scene.gravity_m_per_s2 * (body.motion is Motion.DYNAMIC)
            for contact in scene.contacts:
                for pair in scene.colliding_pairs(contact):
                    ball, plane = sorted(map(scene.body, pair), key=lambda body: body.motion is not Motion.DYNAMIC)
                    place = world, self.rows[ball.name]
                    self.normals[place] = plane.pose.rotation.as_matrix()[:, 2]
                    self.points[place] = plane.pose.position_m
                    self.radii[place] = np.ptp(ball.shape.corners_m[:, 2]) / 2.0
                    self.frictions[place] = contact.friction
                    self.restitutions[place] = contact.restitution * (contact.mode is ContactMode.IMPACT)
        self.reset(0)

    def reset(self, seed: int) -> None:
        """Return all worlds to their starts."""
        self.states = self.starts.copy()

    def advance(self, seconds: float) -> None:
        """Simulate an interval in equal steps."""
        for _ in range(count := int(np.ceil(seconds / self.step_s - 1e-9))):
            self._step(seconds / count)

    def _step(self, seconds: float) -> None:
        gravity = np.concatenate([self.gravity, np.zeros_like(self.gravity)], axis=2)
        gap = np.sum((self.states[..., :3] - self.points) * self.normals, axis=2) - self.radii
        speed, pull = (np.sum(one * self.normals, axis=2) for one in (self.states[..., 7:10], self.gravity))
        root = np.sqrt(np.maximum(speed**2 - 2.0 * pull * np.maximum(gap, 0.0), 0.0))
        with np.errstate(divide="ignore", invalid="ignore"):
            sinks = 2.0 * np.maximum(gap, 0.0) / (root - speed)
            rises = np.where(pull < 0.0, (speed + root) / -pull, np.inf)
        flight = np.clip(np.where(speed < 0.0, sinks, rises), 0.0, seconds)
        self._move(gravity, flight)
        left, twist = seconds - flight, self.states[..., 7:]
        # A ball whose hop would be shorter than a step stays, and its weight presses on the plane.
        hops = -2.0 * self.restitutions * np.sum(twist[..., :3] * self.normals, axis=2) > -pull * seconds
        hit = self._hit(twist, self.restitutions * hops)
        pressed = self._hit(hit + gravity * left[..., None], 0.0 * left)
        mean = np.divide(pressed - hit, left[..., None], out=np.zeros_like(hit), where=left[..., None] > 0.0)
        self.states[..., 7:] = np.where((left > 0.0)[..., None], hit, twist)
        self._move(np.where(hops[..., None], gravity, mean), left)

    def _hit(self, twist: Array, restitution: Array) -> Array:
        """Return velocities after Coulomb's impulse on a solid sphere, for all balls."""
        arm = -self.radii[..., None] * self.normals
        approach = -np.sum(twist[..., :3] * self.normals, axis=2, keepdims=True)
        push = (1.0 + restitution[..., None]) * approach
        drag = -2.0 / 7.0 * (twist[..., :3] + approach * self.normals + np.cross(twist[..., 3:], arm))
        size = np.linalg.norm(drag, axis=2, keepdims=True) + 1e-300
        drag *= np.minimum(1.0, self.frictions[..., None] * push / size)
        spin = 2.5 / self.radii[..., None] ** 2 * np.cross(arm, drag)
        return twist + np.concatenate([push * self.normals + drag, spin], axis=2)

    def _move(self, acceleration: Array, seconds: Array) -> None:
        """Accelerate all bodies uniformly, each for its own time."""
        travel = (self.states[..., 7:] + 0.5 * acceleration * seconds[..., None]) * seconds[..., None]
        turned = Rotation.from_rotvec(travel[..., 3:].reshape(-1, 3))
        turned *= Rotation.from_quat(self.states[..., 3:7].reshape(-1, 4), scalar_first=True)
        self.states[..., :3] += travel[..., :3]
        self.states[..., 3:7] = turned.as_quat(scalar_first=True).reshape(*seconds.shape, 4)
        self.states[..., 7:] += acceleration * seconds[..., None]

    def body_states(self, names: Sequence[str]) -> Array:
        """Return states, shape [world_count, len(names), 13]."""
        return self.states[:, [self.rows[name] for name in names]]

    def close(self) -> None:
        """Nothing is held outside memory."""
