"""Faults of time, driven bodies, and saved states."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gauge_envs.backends import Simulation
from gauge_envs.scene import Pose, Scene
from mutations.mutant import Fault, Passed, fault

Array = NDArray[np.float64]


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


class _HalfTheTime(Passed):
    """Simulates half the time."""

    def advance(self, seconds: float) -> None:
        super().advance(0.5 * seconds)


class _ReadsFirst(Passed):
    """Reads positions before it advances."""

    def sample_positions(
        self, names: Sequence[str], count: int, interval_s: float
    ) -> Array:
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

    def drive(
        self, body: str, pose: Pose, velocity: Array, acceleration: Array
    ) -> None:
        super().drive(body, pose, np.zeros(6), np.zeros(6))


class _NoAcceleration(Passed):
    """Ignores the acceleration of driven bodies."""

    def drive(
        self, body: str, pose: Pose, velocity: Array, acceleration: Array
    ) -> None:
        super().drive(body, pose, velocity, np.zeros(6))


class _DrivenInDegrees(Passed):
    """Takes the rates of driven bodies for degrees."""

    def drive(
        self, body: str, pose: Pose, velocity: Array, acceleration: Array
    ) -> None:
        velocity, acceleration = np.array(velocity), np.array(acceleration)
        velocity[3:], acceleration[3:] = (
            np.degrees(velocity[3:]),
            np.degrees(acceleration[3:]),
        )
        super().drive(body, pose, velocity, acceleration)


class _DriveSwapped(Passed):
    """Exchanges x and y of the angular velocity and acceleration of driven bodies."""

    def drive(
        self, body: str, pose: Pose, velocity: Array, acceleration: Array
    ) -> None:
        order = [0, 1, 2, 4, 3, 5]
        super().drive(
            body, pose, np.asarray(velocity)[order], np.asarray(acceleration)[order]
        )


class _DriveLate(Passed):
    """Drives each body by the interval before."""

    def __init__(self, inner: Simulation, scene: Scene) -> None:
        super().__init__(inner, scene)
        self._before: dict[str, tuple[Pose, Array, Array]] = {}

    def reset(self, seed: int) -> None:
        self._before = {}
        super().reset(seed)

    def drive(
        self, body: str, pose: Pose, velocity: Array, acceleration: Array
    ) -> None:
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


FAULTS: dict[str, Fault] = dict(
    (
        fault(
            "step-short",
            "one step less in each call",
            "time",
            "count steps",
            simulation=_OneStepShort,
        ),
        fault(
            "step-per-call",
            "1/180 s in each call",
            "time",
            "one step for each call",
            simulation=_OneStepPerCall,
        ),
        fault(
            "half-time",
            "half the time",
            "free-fall",
            "simulates 0.5 times the time",
            simulation=_HalfTheTime,
        ),
        fault(
            "driven-degrees",
            "rates of driven bodies in degrees",
            "driven-path",
            "turns 57.3 times as far",
            simulation=_DrivenInDegrees,
        ),
        fault(
            "reads-first",
            "sample_positions reads before it advances",
            "sample-positions",
            "advance first",
            simulation=_ReadsFirst,
        ),
        fault(
            "steps-at-build",
            "build makes a step",
            "start-position",
            "step",
            simulation=_StepsAtBuild,
        ),
        fault(
            "teleport",
            "driven bodies without velocity",
            "driven-velocity",
            "no velocity",
            simulation=_Teleport,
        ),
        fault(
            "drive-acceleration",
            "acceleration of driven bodies ignored",
            "driven-flick",
            "acceleration that drive() gives",
            simulation=_NoAcceleration,
        ),
        fault(
            "drive-swapped",
            "x and y of a driven body's angular velocity exchanged",
            "driven-flick",
            "exchanges axes",
            simulation=_DriveSwapped,
        ),
        fault(
            "drive-late",
            "driven bodies one interval late",
            "driven-path",
            "late",
            simulation=_DriveLate,
        ),
        fault(
            "no-reset",
            "reset does nothing",
            "reset-start",
            "does not restore",
            simulation=_NoReset,
        ),
        fault(
            "state-behind",
            "state stays in the simulation, so that a copy shares nothing",
            "restore",
            "in a copy",
            simulation=_StateStaysBehind,
        ),
        fault(
            "state-live",
            "state that changes as the simulation goes on",
            "restore",
            "copies",
            simulation=_LiveState,
        ),
        fault(
            "state-disturbs",
            "state() advances the simulation",
            "restore",
            "after state()",
            simulation=_StateDisturbs,
        ),
    )
)
"""Faults by id."""
