"""Build scenes of shared parts on a backend and record them, through the public contract alone."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import asdict, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from gauge_envs.backends import Backend, LoopedSimulation, Simulation
from gauge_envs.backends.base import scene_support
from gauge_envs.backends.settings import settings_record
from gauge_envs.backends.shared.resampled import in_intervals
from gauge_envs.errors import (
    BackendError,
    GaugeError,
    ParameterError,
    UnsupportedSceneError,
)
from gauge_envs.scene import (
    GRAVITY_M_PER_S2,
    Attachment,
    Cloth,
    Deformable,
    Motion,
    Pose,
    Region,
    Scene,
)
from gauge_envs.scene.drivers import Driver, DriverMotion
from gauge_envs.scene.fabrics import Fabric
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.timing import SAMPLE_INTERVAL_S
from gauge_envs.tools.bench.parts import driven_box, fixed_box, ramp
from gauge_envs.tools.bench.recording import DeclinedError, Recording, raised_at, record

T = TypeVar("T")


class RefusedSettingsError(ParameterError):
    """The backend refuses the given settings, so that no check can run."""


class BuildError(GaugeError):
    """`build` raised an exception although `supports` was true."""


class Lab:
    """A backend, on which checks build and run their scenes.

    Args:
        backend: The backend.
        settings: Numerical settings that replace its defaults.

    Attributes:
        settings: Numerical settings that replace the defaults of the backend.
        settings_in_force: Settings of the simulation that was built last.
        rollouts: What the present check has recorded.
    """

    def __init__(
        self, backend: Backend, settings: Mapping[str, Any] | None = None
    ) -> None:
        self.backend = backend
        self.settings_in_force: dict[str, Any] = {}
        self.settings = settings
        self.rollouts: list[Recording] = []
        self._kept: dict[
            Callable[[Lab], Any], tuple[Any, Exception | None, dict[str, Any]]
        ] = {}

    def build(self, scene: Scene, **changes: Any) -> Simulation:
        """Build a scene; close the simulation after use.

        Args:
            scene: The scene.
            changes: Settings that replace those of the lab.

        Raises:
            DeclinedError: The backend reports that it cannot build the scene, or not with the given settings.
            BuildError: The backend reports that it can build the scene, and fails.
            RefusedSettingsError: The backend refuses the given settings.
        """
        self.settings_in_force = {}
        support = scene_support(self.backend, scene)
        if not support:
            raise DeclinedError(support.missing)
        try:
            settings = {**(self.settings or {}), **changes} or None
            simulation = in_intervals(self.backend.build(scene, settings), scene)
            settings_record(self.backend.name, simulation.settings)
        except Exception as error:
            if self.settings and isinstance(error, UnsupportedSceneError):
                # `supports` answers for the default settings; a preset for other scenes is no fault of the backend.
                raise DeclinedError((str(error),)) from error
            if changes and isinstance(error, ParameterError):
                raise DeclinedError((str(error),)) from error
            if self.settings and isinstance(error, ParameterError):
                raise RefusedSettingsError(str(error)) from error
            raise BuildError(
                f"supports() was true, but build() raised {type(error).__name__}: {error}{raised_at(error)}"
            ) from error
        self.settings_in_force = dict(simulation.settings)
        return simulation

    @contextmanager
    def running(self, scene: Scene, **changes: Any) -> Iterator[Simulation]:
        """Build a scene, reset it, and close it after use; see `build`."""
        with closing(self.build(scene, **changes)) as simulation:
            simulation.reset(None, 0)
            yield simulation

    def started(self, scene: Scene) -> Scene:
        """Return a scene as a batch of worlds starts it."""
        return scene

    def first_supported(self, *scenes: Scene) -> Scene:
        """Return the first scene that the backend can build, or the last one when it can build none."""
        return next(
            (scene for scene in scenes if scene_support(self.backend, scene)),
            scenes[-1],
        )

    def rollout(
        self,
        scene: Scene,
        seconds: float | None = None,
        *,
        interval_s: float = SAMPLE_INTERVAL_S,
        wrenches: Mapping[str, ArrayLike] = {},
    ) -> Recording:
        """Build a scene, reset it, push and drive it, and record it.

        Args:
            scene: The scene.
            seconds: Time to simulate [s]; None for the duration of the scene.
            interval_s: Time between samples [s].
            wrenches: Force and torque on each body that is pushed all the time [N, N m], shape [6].
        """
        whole_s = scene.duration_s if seconds is None else seconds
        with self.running(scene) as simulation:
            for name, wrench in wrenches.items():
                push(simulation, name, wrench)
            found = record(simulation, scene, whole_s, interval_s=interval_s)
        self.rollouts.append(found)
        return found

    def once(self, function: Callable[[Lab], T]) -> T:
        """Return the value of a function of the lab, which is called at its first use only.

        Several checks can thus read one rollout.

        Raises:
            Exception: The exception of the function, at each use.
        """
        if function not in self._kept:
            self._kept[function] = self._attempt(function)
        value, error, self.settings_in_force = self._kept[function]
        if error is not None:
            raise error
        if isinstance(value, Recording):
            self.rollouts.append(value)
        return value  # type: ignore[no-any-return]

    def _attempt(
        self, function: Callable[[Lab], Any]
    ) -> tuple[Any, Exception | None, dict[str, Any]]:
        """Return the value or the exception of a function, and the settings that were in force."""
        try:
            return function(self), None, self.settings_in_force
        except Exception as error:
            return None, error, self.settings_in_force


class DisturbedLab(Lab):
    """A lab in which no run repeats another one: each build and reset starts a disturbed scene.

    Args:
        lab: The lab whose backend and settings it has.
        start_error: Size of the disturbance; see `Repeatability`.
    """

    def __init__(self, lab: Lab, start_error: float) -> None:
        super().__init__(lab.backend, lab.settings)
        self._start_error = start_error
        self._random = np.random.default_rng(0)

    def build(self, scene: Scene, **changes: Any) -> Simulation:
        """Build a scene; see `Lab.build`."""
        build = super().build
        return _DisturbedSimulation(lambda: build(self.started(scene), **changes))

    def started(self, scene: Scene) -> Scene:
        """Return a scene with other starts of its free bodies and another gravity."""
        joined = {one.body for one in scene.joints}
        bodies = []
        for body in scene.bodies:
            if body.motion is Motion.DYNAMIC and body.name not in joined:
                body = replace(body, pose=self._moved(body.pose))
            bodies.append(body)
        gravity = scene.gravity_m_per_s2 * (1.0 + self._errors()[0])
        return replace(scene, bodies=tuple(bodies), gravity_m_per_s2=gravity)

    def _moved(self, pose: Pose) -> Pose:
        turn = Rotation.from_rotvec(self._errors())
        position = np.array(pose.position_m) + self._errors()
        return Pose.from_rotation(tuple(position.tolist()), turn * pose.rotation)

    def _errors(self) -> FloatArray:
        signs = self._random.choice([-1.0, 1.0], 3)
        return self._start_error * signs


class _DisturbedSimulation(LoopedSimulation):
    """A simulation that is built anew at each reset.

    Args:
        build: Function that builds the simulation.
    """

    def __init__(self, build: Callable[[], Simulation]) -> None:
        self._build = build
        super().__init__([build()])

    def reset(self, starts: FloatArray | None = None, seed: int = 0) -> None:
        """Build the simulation anew and reset it."""
        self.close()
        super().__init__([self._build()])
        super().reset(starts, seed)


def push(simulation: Simulation, body: str, wrench: ArrayLike) -> None:
    """Apply a wrench to a body in all worlds; raise `DeclinedError` if the engine applies none.

    Args:
        simulation: The simulation.
        body: Name of the body.
        wrench: Force [N] and torque [N m], shape [6] or [N, 6].
    """
    try:
        simulation.apply_wrench(body, np.reshape(np.asarray(wrench, float), (-1, 6)))
    except BackendError as error:
        raise DeclinedError((str(error),)) from error


# --- parts of scenes -------------------------------------------------------------------------------------------------

STRETCH_OVER_SHEAR = 2.7
"""K_s / K_sh of every sheet; an isotropic membrane can have any ratio between 2 and 4 (scene/fabrics.py)."""


def fabric(areal_density: float, stretch_n_per_m: float, bend_n_m: float) -> Fabric:
    """Return a fabric that every engine's membrane can represent; the shear stiffness follows from K_s.

    Args:
        areal_density: Mass per area [kg/m^2].
        stretch_n_per_m: Stretch stiffness K_s [N/m].
        bend_n_m: Bending stiffness K_theta [N m/rad].
    """
    return Fabric(
        stretch_stiffness_n_per_m=stretch_n_per_m,
        shear_stiffness_n_per_m=stretch_n_per_m / STRETCH_OVER_SHEAR,
        bend_stiffness_n_m_per_rad=bend_n_m,
        thickness_m=1e-3,
        areal_density_kg_per_m2=areal_density,
    )


def sheet(made_of: Fabric, pose: Pose, size_m: tuple[float, float]) -> Cloth:
    """Return a sheet of a fabric, warp along the x axis of its frame."""
    mass_kg = made_of.areal_density_kg_per_m2 * size_m[0] * size_m[1]
    return Cloth(
        name="cloth", pose=pose, size_m=size_m, mass_kg=mass_kg, **asdict(made_of)
    )


LIGHT_FABRIC = fabric(0.2, 110.0, 1e-4)
"""Fabric of sheets whose stiffness does not matter."""


FRAME = fixed_box("frame", (0.0, 0.0, 3.0), (0.1, 0.1, 0.1))
"""Fixed body to which clamped regions are attached. Its place does not matter, so it is out of reach."""


def clamped(
    deformable: Deformable,
    *regions: Region,
    duration_s: float,
    gravity_m_per_s2: float = GRAVITY_M_PER_S2,
) -> Scene:
    """Return a scene of one deformable body, of which some regions are attached to a fixed body."""
    return Scene(
        bodies=(FRAME,),
        deformables=(deformable,),
        attachments=tuple(
            Attachment(deformable=deformable.name, region=region, to=FRAME.name)
            for region in regions
        ),
        duration_s=duration_s,
        gravity_m_per_s2=gravity_m_per_s2,
    )


STRIP_ON_ROD = "a strip of cloth that hangs from a driven rod, which moves by 0.2 m and turns by 0.6 rad"


def strip_on_rod() -> Scene:
    """Return a strip that hangs from a driven rod; the rod moves by 0.2 m and rotates by 0.6 rad within 0.4 s."""
    pose = Pose.from_euler_deg((0.0, 0.0, 1.0), (0.0, -90.0, 0.0))
    cloth = sheet(LIGHT_FABRIC, pose, (0.15, 0.1))
    top = 1.0 + 0.5 * 0.15
    turn, move = (
        ramp(amount, start_s=0.0, duration_s=0.4, ramp_s=0.15) for amount in (0.6, 0.2)
    )
    motions = (
        DriverMotion(
            kind="rotate",
            axis=(0.0, 0.0, 1.0),
            profiles=(turn,),
            point_m=(0.0, 0.0, top),
        ),
        DriverMotion(kind="translate", axis=(1.0, 0.0, 0.0), profiles=(move,)),
    )
    return Scene(
        bodies=(driven_box("rod", (0.0, 0.0, top + 0.02), (0.01, 0.12, 0.01)),),
        deformables=(cloth,),
        attachments=(
            Attachment(
                deformable="cloth", region=Region(axis="x", side="high"), to="rod"
            ),
        ),
        drivers=(Driver(body="rod", motions=motions, provenance="nominal"),),
        duration_s=1.0,
    )
