"""Faults of time, driven bodies, and saved states."""

from __future__ import annotations

from typing import Any

import numpy as np

from mutations.mutant import Passed, fault


def _advancing(change):
    """Return a simulation that advances by another time, a function of the asked time and the timestep [s]."""

    class Advances(Passed):
        def advance(self, seconds):
            changed_s = change(seconds, float(self.settings["timestep_s"]))
            if changed_s:
                super().advance(changed_s)

    return Advances


def _one_step_short(seconds, step_s):
    # Engines with one step for each interval of 1/180 s would stand still, so they lose a tenth of the intervals.
    return seconds - step_s if seconds > 1.5 * step_s else 0.0


def _driving(change):
    """Return a simulation that gives driven bodies another velocity and acceleration, each shape [6]."""

    class Drives(Passed):
        def drive(self, body, pose, velocity, acceleration):
            changed = change(np.array(velocity), np.array(acceleration))
            super().drive(body, pose, *changed)

    return Drives


def _in_degrees(rates):
    return np.concatenate([rates[:3], np.degrees(rates[3:])])


class _ReadsFirst(Passed):
    """Reads positions before it advances."""

    def sample_positions(self, names, count, interval_s):
        positions = np.empty((count, len(names), 3))
        for row in positions:
            row[:] = self.body_states(names)[:, :3]
            self.advance(interval_s)
        return positions


class _StepsAtBuild(Passed):
    """Has already moved when it is built."""

    def begin(self):
        self.inner.advance(1.0 / 180.0)


class _DriveLate(Passed):
    """Drives each body by the interval before."""

    def begin(self):
        self._before = {}

    def reset(self, seed):
        self._before = {}
        super().reset(seed)

    def drive(self, body, pose, velocity, acceleration):
        now = (pose, np.array(velocity), np.array(acceleration))
        super().drive(body, *self._before.get(body, now))
        self._before[body] = now

    def state(self):
        return super().state(), dict(self._before)

    def restore(self, state):
        super().restore(state[0])
        self._before = dict(state[1])


class _NoReset(Passed):
    """Does not reset."""

    def reset(self, seed):
        pass


class _StateStaysBehind(Passed):
    """Keeps its state to itself and returns nothing of it."""

    kept: Any = None

    def state(self):
        self.kept = super().state()

    def restore(self, state):
        if self.kept is not None:
            super().restore(self.kept)


class _LiveState(Passed):
    """Returns a state that changes as the simulation goes on."""

    def begin(self):
        self._given = []

    def advance(self, seconds):
        super().advance(seconds)
        for state in self._given:
            state[0] = super().state()

    def state(self):
        self._given.append([super().state()])
        return self._given[-1]

    def restore(self, state):
        super().restore(state[0])


class _StateDisturbs(Passed):
    """Goes on from its reported state whenever a state is taken."""

    def state(self):
        saved = super().state()
        super().advance(1.0 / 180.0)
        return saved


FAULTS = dict(
    (
        fault(
            "step-short",
            "one step less in each call",
            "time",
            "count steps",
            simulation=_advancing(_one_step_short),
        ),
        fault(
            "step-per-call",
            "1/180 s in each call",
            "time",
            "one step for each call",
            simulation=_advancing(lambda asked, step: 1.0 / 180.0),
        ),
        fault(
            "half-time",
            "half the time",
            "free-fall",
            "simulates 0.5 times the time",
            simulation=_advancing(lambda asked, step: 0.5 * asked),
        ),
        fault(
            "driven-degrees",
            "rates of driven bodies in degrees",
            "driven-path",
            "turns 57.3 times as far",
            simulation=_driving(lambda *rates: map(_in_degrees, rates)),
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
