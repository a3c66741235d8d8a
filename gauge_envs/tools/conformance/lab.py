"""Build scenes on an engine and record them, through the public contract alone."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from copy import deepcopy
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from gauge_envs.backends import Backend, Simulation
from gauge_envs.backends.base import scene_support
from gauge_envs.backends.settings import settings_record
from gauge_envs.backends.shared.resampled import in_intervals
from gauge_envs.errors import (
    BackendError,
    GaugeError,
    ParameterError,
    UnsupportedSceneError,
)
from gauge_envs.fixtures.recording import Recording, UnsupportedError, raised_at, record
from gauge_envs.names import first_names
from gauge_envs.scene import Contact, Motion, RigidBody, Scene, Sphere
from gauge_envs.scene.diff import scene_changes
from gauge_envs.scene.timing import SAMPLE_INTERVAL_S

T = TypeVar("T")


@dataclass(frozen=True, kw_only=True)
class Measurement:
    """Measured and expected value of a check.

    Attributes:
        measured: The measured value.
        expected: The value of the closed form, in the same unit.
        hint: Meaning of this value, as `it falls through`; may be empty.
        cause: Why the value is wrong, as `the pair has no contact`; empty for the most likely cause of the check.
        width: Largest admissible difference if it depends on the engine; None for the tolerance of the check.
    """

    measured: float
    expected: float = 0.0
    hint: str = ""
    cause: str = ""
    width: float | None = None


class ContractError(GaugeError):
    """The engine breaks the contract of `gauge_envs.backends`, so that nothing can be measured."""


class RejectedSettingsError(UnsupportedError):
    """The engine rejects the settings for a scene."""


class Lab:
    """An engine, on which checks build and run their scenes.

    The engine gets a copy of each scene, so that it cannot change the expected values of the check.

    Args:
        backend: The engine.
        settings: Numerical settings that replace its defaults.

    Attributes:
        effective_settings: Settings of the simulation that was built last.
    """

    def __init__(
        self, backend: Backend, settings: Mapping[str, Any] | None = None
    ) -> None:
        self.backend = backend
        self.settings = settings
        self.effective_settings: dict[str, Any] = {}
        self._given: list[tuple[Scene, Scene]] = []
        self._kept: dict[Callable[[Lab], Any], tuple[Any, Exception | None]] = {}

    def supports(self, scene: Scene) -> bool:
        """Return whether the engine can build a scene.

        Raises:
            ContractError: `supports` raised an error or returned no `Support`.
        """
        return not self._missing(scene)

    def buildable(
        self, cases: Sequence[T], scene_of: Callable[[Sequence[T]], Scene]
    ) -> Sequence[T]:
        """Return the cases that the engine can build, together in one scene; all cases if it can build none."""
        if self.supports(scene_of(cases)):
            return cases
        return [case for case in cases if self.supports(scene_of([case]))] or cases

    def in_any_shape(self, scene: Scene) -> Scene:
        """Return a scene, with balls in place of its dynamic bodies if the engine builds only balls."""
        if self.supports(scene):
            return scene
        bodies = [
            replace(body, shape=Sphere(radius_m=0.03))
            if body.motion is Motion.DYNAMIC
            else body
            for body in scene.bodies
        ]
        return replace(scene, bodies=tuple(bodies))

    def _missing(self, scene: Scene) -> tuple[str, ...]:
        try:
            return scene_support(self.backend, deepcopy(scene)).missing
        except Exception as error:
            names = ", ".join(body.name for body in (*scene.bodies, *scene.deformables))
            raise ContractError(
                f"supports() raised {type(error).__name__}: {error}{raised_at(error)}; it must return a Support for "
                f"every scene, also where pairs contain deformable bodies (here: {names})"
            ) from error

    def build(
        self, scene: Scene, world_count: int | None = None, **changes: Any
    ) -> Simulation:
        """Build a scene; close the simulation after use.

        Args:
            scene: The scene.
            world_count: Number of worlds of a batch; None for `Backend.build`.
            changes: Settings that replace settings of the lab.

        Raises:
            UnsupportedError: The engine reports that it cannot build the scene, or rejects the settings for it (a
                `RejectedSettingsError`).
            ContractError: `build` fails although `supports` was true.
        """
        self.effective_settings = {}
        if missing := self._missing(scene):
            raise UnsupportedError(missing)
        given = deepcopy(scene)
        settings = {**(self.settings or {}), **changes} or None
        try:
            if world_count is None:
                built = self.backend.build(given, settings)
            else:
                built = self.backend.build_worlds(given, world_count, settings)
            _check_simulation(built)
            simulation = in_intervals(built, given)
            settings_record(self.backend.name, simulation.settings)
        except ContractError:
            raise
        except Exception as error:
            if settings and isinstance(error, ParameterError | UnsupportedSceneError):
                # `supports` answers for the default settings; a preset for other scenes is not a fault of the engine.
                raise RejectedSettingsError(
                    (f"the settings are rejected: {error}",)
                ) from error
            raise ContractError(
                f"supports() was true, but build() raised {type(error).__name__}: {error}{raised_at(error)}"
            ) from error
        self.effective_settings = dict(simulation.settings)
        self._given.append((scene, given))
        return simulation

    def last_scene(self) -> str:
        """Return bodies of the scene that was built last, as text, and forget all scenes; empty without a scene."""
        if not self._given:
            return ""
        (scene, _), self._given = self._given[-1], []
        names = [body.name for body in (*scene.bodies, *scene.deformables)]
        return f"; in the scene of {first_names(names, 3)}"

    def check_scenes(self) -> None:
        """Check that the engine did not change the scenes that it received since the last call.

        Raises:
            ContractError: It changed a scene.
        """
        pairs = self._given
        self._given = []
        for scene, given in pairs:
            if changes := "; ".join(map(str, scene_changes(scene, given))):
                raise ContractError(
                    f"the engine changed the scene that it was given: {changes}. A Scene is input: copy what changes"
                )

    @contextmanager
    def running(
        self, scene: Scene, world_count: int | None = None, **changes: Any
    ) -> Iterator[Simulation]:
        """Build a scene, reset it, and close it after use; see `build`."""
        with closing(self.build(scene, world_count, **changes)) as simulation:
            simulation.reset(None, 0)
            yield simulation

    def rollout(
        self,
        scene: Scene,
        seconds: float | None = None,
        *,
        interval_s: float = SAMPLE_INTERVAL_S,
        wrenches: Mapping[str, ArrayLike] = {},
        **changes: Any,
    ) -> Recording:
        """Build a scene, reset it, push and drive it, and record it.

        Args:
            scene: The scene.
            seconds: Time to simulate [s]; None for the duration of the scene.
            interval_s: Time between samples [s].
            wrenches: Constant force and torque on each pushed body [N, N m], shape [6].
            changes: Settings that replace settings of the lab.
        """
        whole_s = scene.duration_s if seconds is None else seconds
        with self.running(scene, **changes) as simulation:
            for name, wrench in wrenches.items():
                push(simulation, name, wrench)
            return record(simulation, scene, whole_s, interval_s=interval_s)

    def run(
        self,
        bodies: Iterable[RigidBody],
        contacts: Iterable[Contact],
        seconds: float,
        **more: Any,
    ) -> Recording:
        """Record bodies with contacts for some seconds; `more` are further arguments of `Scene`."""
        return self.rollout(
            Scene(bodies=(*bodies,), contacts=(*contacts,), duration_s=seconds, **more)
        )

    def once(self, function: Callable[[Lab], T]) -> T:
        """Return the value of a function of the lab, which is called only once.

        Several checks can then read one recording.

        Raises:
            Exception: The exception of the function, at each use.
        """
        if function not in self._kept:
            try:
                self._kept[function] = (function(self), None)
            except Exception as raised:
                self._kept[function] = (None, raised)
        value, error = self._kept[function]
        if error is not None:
            raise error
        return value  # type: ignore[no-any-return]


def _check_simulation(built: Any) -> None:
    """Raise a `ContractError` if `build` returned no simulation, or one whose attributes have another type."""
    if not isinstance(built, Simulation):
        raise ContractError(
            f"build() returned a {type(built).__name__}: return a Simulation"
        )
    for name, value in (("settings", built.settings), ("diverged()", built.diverged())):
        if not isinstance(value, Mapping):
            raise ContractError(
                f"Simulation.{name} is a {type(value).__name__}: make it a mapping"
            )


def push(simulation: Simulation, body: str, wrench: ArrayLike) -> None:
    """Apply a wrench to a body in all worlds; raise `UnsupportedError` if the engine cannot apply wrenches.

    Args:
        simulation: The simulation.
        body: Name of the body.
        wrench: Force [N] and torque [N m], shape [6] or [N, 6].
    """
    wrenches = np.reshape(np.asarray(wrench, float), (-1, 6))
    count = simulation.world_count
    try:
        simulation.apply_wrench(body, np.broadcast_to(wrenches, (count, 6)).copy())
    except BackendError as error:
        raise UnsupportedError((str(error),)) from error


RIGHT = 0.01
"""Largest error of a ratio that a hint calls right."""


def ratio(ratios: Mapping[str, float], what: str) -> Measurement:
    """Measure the ratio that is furthest from 1; a hint names its case and the correct cases."""
    errors = {
        name: abs(value - 1.0) if np.isfinite(value) else np.inf
        for name, value in ratios.items()
    }
    worst = max(errors, key=errors.__getitem__)
    small = min(0.1 * errors[worst], RIGHT)
    right = [name for name, error in errors.items() if error < small]
    hint = f"{what} is {ratios[worst]:.4g} times what it should be for {worst}"
    if len(right) > 3:
        right = [*right[:2], f"{len(right) - 2} others"]
    if right:
        hint += f"; right for {', '.join(right)}"
    return Measurement(measured=ratios[worst], expected=1.0, hint=hint)


def largest(
    errors: Mapping[str, float],
    unit: str = "",
    mistakes: Mapping[str, Mapping[str, float]] = {},
) -> Measurement:
    """Measure the largest of some errors; a hint names its case, and the cause is a known mistake that explains it.

    Args:
        errors: Error of each case.
        unit: Unit of the errors.
        mistakes: Remaining error of a case by the text of each known mistake. A mistake explains an error if 3 % or
            less of it remain.
    """
    worst = max(errors, key=lambda case: np.nan_to_num(errors[case], nan=np.inf))
    error = errors[worst]
    left = mistakes.get(worst, {})
    nearest = min(left, key=left.__getitem__, default="")
    is_explained = nearest in left and left[nearest] <= 0.03 * error
    return Measurement(
        measured=error,
        hint=f"{worst} is off by {error:.3g} {unit}".rstrip(),
        cause=nearest if is_explained else "",
    )


def largest_mm(vectors_m: ArrayLike) -> float:
    """Return the largest length of vectors [m], shape [..., 3], in millimetres."""
    return 1e3 * float(np.linalg.norm(vectors_m, axis=-1).max())
