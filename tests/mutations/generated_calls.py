"""Generated faults of what calls pass and return, of the engine's rates, of time and of state."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs.backends import Simulation
from gauge_envs.scene import Motion
from gauge_envs.scene.geometry import vector
from mutations.generated_fields import rounded
from mutations.mutant import Passed

Change = Callable[[np.ndarray, dict[str, Any]], np.ndarray]
"""Returns another vector, from the one that a call passes and its context (`_Calls.changed`)."""


def _times(factor: float, holds: Callable[[np.ndarray, dict[str, Any]], Any]) -> Change:
    """Return a change by a factor where something holds of a vector and its context."""
    return lambda v, c: factor * v if holds(v, c) else v


def _late(time_s: float) -> Callable[..., bool]:
    return lambda v, c: c["time"] > time_s


def _early(time_s: float) -> Callable[..., bool]:
    return lambda v, c: c["time"] < time_s


def _odd(time_s: float) -> Callable[..., bool]:
    return lambda v, c: int(c["time"] / time_s) % 2 == 1


def _above(length: float) -> Callable[..., bool]:
    return lambda v, c: np.linalg.norm(v) > length


def _of_one(factor: float) -> Iterator[tuple[str, str, Change]]:
    """Yield changes of what is the first, the second or the last of its kind."""
    for number, name in ((0, "first"), (1, "second"), (-1, "last")):

        def is_one(v: np.ndarray, c: dict[str, Any], number: int = number) -> bool:
            count = c["count"]
            return count > 1 and c["number"] in (number, number + count)

        yield "kth", name, _times(factor, is_one)


def _of_signs(factor: float) -> Iterator[tuple[str, str, Change]]:
    yield "side", "negative", lambda v, c: np.where(v < 0.0, factor * v, v)
    yield "side", "positive", lambda v, c: np.where(v > 0.0, factor * v, v)


def call_changes(  # noqa: C901  # one branch for each kind of fault
    unit: float,
) -> Iterator[tuple[str, str, Change]]:
    """Yield kind, variant and change of a vector that a call passes, of a usual length."""
    for factor in (0.5, 0.8, 1.25):
        yield "scale", f"{factor:g}", lambda v, c, k=factor: k * v
    for axis in range(3):
        yield (
            "offset",
            f"{axis}",
            lambda v, c, i=axis: v + 0.05 * unit * np.eye(len(v))[min(i, len(v) - 1)],
        )
    for one, other in ((0, 1), (1, 2)):

        def swapped(v, c, one=one, other=other):
            if len(v) <= other:
                return v[::-1]
            found = v.copy()
            found[[one, other]] = v[[other, one]]
            return found

        yield "swap", f"{one}-{other}", swapped
    yield "drop", "all", lambda v, c: 0.0 * v
    for axis in range(3):
        yield (
            "drop",
            f"axis-{axis}",
            lambda v, c, i=axis: np.where(np.arange(len(v)) == i, 0.0, v),
        )
    for cap in (0.3, 1.0):
        yield (
            "saturate",
            f"{cap:g}",
            lambda v, c, m=cap: np.clip(v, -m * unit, m * unit),
        )
    for cap in (0.3, 1.0, 3.0):
        yield "threshold", f"above-{cap:g}", _times(0.5, _above(cap * unit))
    for time_s in (1.0, 2.0):
        yield "threshold", f"after-{time_s:g}", _times(0.5, _late(time_s))
    for name, inverse in (("body", True), ("world", False)):

        def turned(v, c, inverse=inverse):
            return c["rotation"].apply(v, inverse=inverse) if len(v) == 3 else v

        yield "frame", name, turned
    yield "stale", "one-call", lambda v, c: c["before"]
    yield from _of_one(0.7)
    yield from _of_signs(0.5)
    yield "rounded", "4-bits", lambda v, c: rounded(v, 4)
    yield "mixed", "half", lambda v, c: 0.5 * (v + v.mean())
    yield "mixed", "calls", lambda v, c: 0.5 * (v + c["before"])
    for time_s in (0.1, 0.4):
        yield "delay", f"{time_s:g}s", _times(0.0, _early(time_s))
    for time_s in (0.1, 0.5):
        yield "alternates", f"{time_s:g}s", _times(0.7, _odd(time_s))
    for power in (0.7, 1.4):
        yield (
            "power",
            f"{power:g}",
            lambda v, c, p=power: np.sign(v) * unit * (np.abs(v) / unit) ** p,
        )
    yield "crowd", "above-2", _times(0.7, lambda v, c: c["count"] > 2)


class _Calls(Passed):
    """A simulation that counts its time and remembers what was passed before."""

    def begin(self):
        self.time_s, self.before = 0.0, {}

    def reset(self, seed):
        self.time_s, self.before = 0.0, {}
        super().reset(seed)

    def advance(self, seconds):
        super().advance(seconds)
        self.time_s += seconds

    def state(self):
        return super().state(), self.time_s, dict(self.before)

    def restore(self, state):
        super().restore(state[0])
        self.time_s, self.before = state[1], dict(state[2])

    def changed(self, change, key, value, rotation=None, number=0, count=1):
        """Return a changed value of a call."""
        value = np.array(value, dtype=float)
        context = {
            "rotation": rotation or Rotation.identity(),
            "number": number,
            "count": count,
            "time": self.time_s,
        }
        context["before"] = self.before.get(key, value)
        self.before[key] = value
        return np.asarray(change(value, context))


RATES = {
    "velocity": (0, slice(0, 3)),
    "spin": (0, slice(3, 6)),
    "acceleration": (1, slice(0, 3)),
    "spin_acceleration": (1, slice(3, 6)),
}
"""Places of parts of a driven motion in its rates and their changes."""


def drive(part: str, change: Change) -> type[Passed]:
    class Drives(_Calls):
        def drive(self, body, pose, velocity, acceleration):
            names = [
                one.name for one in self.scene.bodies if one.motion is Motion.KINEMATIC
            ]
            where = {
                "rotation": pose.rotation,
                "number": names.index(body),
                "count": len(names),
            }
            rates = [np.array(velocity), np.array(acceleration)]
            if part in RATES:
                place, which = RATES[part]
                rates[place][which] = self.changed(
                    change, body, rates[place][which], **where
                )
            elif part == "position":
                start = np.array(self.scene.body(body).pose.position_m)
                moved = self.changed(
                    change, body, np.array(pose.position_m) - start, **where
                )
                pose = replace(pose, position_m=vector(start + moved))
            else:
                start = self.scene.body(body).pose.rotation
                turned = self.changed(
                    change, body, (pose.rotation * start.inv()).as_rotvec(), **where
                )
                pose = type(pose).from_rotation(
                    pose.position_m, Rotation.from_rotvec(turned) * start
                )
            super().drive(body, pose, *rates)

    return Drives


def wrench(part: str, change: Change) -> type[Passed]:
    class Pushes(_Calls):
        def apply_wrench(self, body, wrench):
            names = [one.name for one in self.scene.dynamic_bodies]
            state = self.inner.body_states([body])[0]
            wrench = np.array(wrench, dtype=float)
            which = slice(0, 3) if part == "force" else slice(3, 6)
            wrench[which] = self.changed(
                change,
                body,
                wrench[which],
                Rotation.from_quat(state[3:7], scalar_first=True),
                names.index(body),
                len(names),
            )
            super().apply_wrench(body, wrench)

    return Pushes


def command(part: str, change: Change) -> type[Passed]:
    class Commands(_Calls):
        def command(self, values):
            super().command(self.changed(change, "command", values))

    return Commands


COLUMNS = {
    "position": slice(0, 3),
    "orientation": slice(3, 7),
    "velocity": slice(7, 10),
    "spin": slice(10, 13),
}


def report(part: str, change: Change) -> type[Passed]:
    if part == "nodes":
        return _nodes(change)

    class Reports(_Calls):
        def body_states(self, names):
            states = super().body_states(names)
            every = [one.name for one in self.scene.bodies]
            for row, name in zip(states, names, strict=True):
                turn = Rotation.from_quat(row[3:7], scalar_first=True)
                where = (turn, every.index(name), len(every))
                if part == "orientation":
                    changed = self.changed(change, name, turn.as_rotvec(), *where)
                    row[3:7] = Rotation.from_rotvec(changed).as_quat(scalar_first=True)
                else:
                    row[COLUMNS[part]] = self.changed(
                        change, name, row[COLUMNS[part]], *where
                    )
            return states

        def sample_positions(self, names, count, interval_s):
            return Simulation.sample_positions(self, names, count, interval_s)

    return Reports


def _nodes(change: Change) -> type[Passed]:
    class Nodes(_Calls):
        def nodes(self, name):
            found = super().nodes(name)
            changed = self.changed(
                lambda v, c: np.array(
                    [
                        change(row, c | {"before": old})
                        for row, old in zip(v, c["before"], strict=True)
                    ]
                ),
                name,
                found,
            )
            return changed if changed.shape == found.shape else found

    return Nodes


def engine(part: str, change: Change) -> type[Passed]:
    """Return a simulation of MuJoCo that changes rates after each interval: of free bodies, or of hinges."""

    class Rates(_Calls):
        def advance(self, seconds):
            super().advance(seconds)
            model, data = self.inner.model, self.inner.data
            bodies = list(self.scene.dynamic_bodies)
            for number, one in enumerate(bodies):
                try:
                    joint = model.joint(one.name)
                except KeyError:
                    continue
                free = joint.type[0] == mujoco.mjtJoint.mjJNT_FREE
                if free == (part == "hinge_rate"):
                    continue
                first = int(joint.dofadr[0])
                rows = (
                    data.qvel[first : first + 1]
                    if not free
                    else data.qvel[first : first + 3]
                    if part == "velocity"
                    else data.qvel[first + 3 : first + 6]
                )
                turn = Rotation.from_quat(
                    data.xquat[model.body(one.name).id], scalar_first=True
                )
                rows[:] = self.changed(
                    change, one.name, rows, turn, number, len(bodies)
                )

    return Rates


def engine_changes(unit: float) -> Iterator[tuple[str, str, Change]]:
    """Yield kind, variant and change of a rate, of a usual size, after each interval."""
    for per_s in (0.05, 0.5):
        yield "scale", f"damped-{per_s:g}", lambda v, c, k=per_s: v * (1.0 - k / 180.0)
    yield "scale", "gains", lambda v, c: v * (1.0 + 0.05 / 180.0)
    yield "offset", "drift", lambda v, c: v + 0.02 * unit / 180.0
    for cap in (0.3, 1.0, 3.0):

        def capped(v, c, most=cap * unit):
            return v * min(1.0, most / max(float(np.linalg.norm(v)), 1e-12))

        yield "saturate", f"{cap:g}", capped
    yield (
        "threshold",
        "slow-frozen-after-2s",
        _times(0.0, lambda v, c: c["time"] > 2.0 and np.linalg.norm(v) < 0.01 * unit),
    )
    yield (
        "threshold",
        "slow-frozen",
        _times(0.0, lambda v, c: np.linalg.norm(v) < 0.003 * unit),
    )
    for cap in (1.0, 2.0):
        yield "threshold", f"damped-above-{cap:g}", _times(0.995, _above(cap * unit))
    yield "threshold", "damped-after-1s", _times(0.999, _late(1.0))
    yield (
        "drop",
        "axis",
        lambda v, c: np.where(np.arange(len(v)) == 1, 0.0, v) if len(v) == 3 else v,
    )
    yield (
        "frame",
        "axis-damped",
        lambda v, c: np.where(np.arange(len(v)) == 0, 0.998 * v, v),
    )
    yield from _of_one(0.998)
    for time_s in (0.1, 0.5):
        yield "alternates", f"damped-{time_s:g}s", _times(0.997, _odd(time_s))
        yield "delay", f"damped-until-{time_s:g}s", _times(0.995, _early(time_s))
    for share in (0.002, 0.02):
        yield (
            "power",
            f"drag-{share:g}",
            lambda v, c, k=share: v * (1.0 - k * np.abs(v) / unit),
        )
    yield from _of_signs(0.998)
    yield "stale", "mean-of-two", lambda v, c: 0.5 * (v + c["before"])


def _advances(change: Any) -> type[Passed]:
    class Advances(_Calls):
        number = 0

        def reset(self, seed):
            self.number = 0
            super().reset(seed)

        def advance(self, seconds):
            step = float(self.settings["timestep_s"])
            asked = change(seconds, self.number, self.time_s, step)
            self.number += 1
            self.time_s += seconds
            if asked > 0.5 * step:
                self.inner.advance(asked)

        def state(self):
            return super().state(), self.number

        def restore(self, state):
            super().restore(state[0])
            self.number = state[1]

    return Advances


def time_faults() -> Iterator[tuple[str, str, type[Passed]]]:
    for kind, variant, change in (
        ("scale", "0.99", lambda s, n, t, step: 0.99 * s),
        ("drop", "every-60th", lambda s, n, t, step: 0.0 if n % 60 == 59 else s),
        ("drop", "every-200th", lambda s, n, t, step: 0.0 if n % 200 == 199 else s),
        ("threshold", "after-2s", lambda s, n, t, step: s - step if t > 2.0 else s),
        ("threshold", "after-1s", lambda s, n, t, step: s - step if t > 1.0 else s),
        ("offset", "one-step-more", lambda s, n, t, step: s + step),
        ("stale", "first-call-alone", lambda s, n, t, step: s if n else s - step),
    ):
        yield kind, variant, _advances(change)


def kept(part: str, when: str, only: str = "") -> type[Passed]:
    """Return a simulation of MuJoCo that keeps or loses a part of its state at a reset or a restore."""
    arrays = {
        "velocity": "qvel",
        "wrench": "xfrc_applied",
        "command": "ctrl",
        "pose": "qpos",
    }

    class Kept(Passed):
        def _apply(self, call, argument):
            array = getattr(self.inner.data, arrays[part])
            before = array.copy()
            call(argument)
            rows = slice(None)
            if only == "last":
                rows = slice(-6, None) if part == "velocity" else slice(-1, None)
            if when.endswith("stale"):
                array[rows] = before[rows]
            else:
                array[rows] = 0.0

        def reset(self, seed):
            if when.startswith("reset"):
                self._apply(self.inner.reset, seed)
            else:
                super().reset(seed)

        def restore(self, state):
            if when.startswith("restore"):
                self._apply(self.inner.restore, state)
            else:
                super().restore(state)

    return Kept


def buffers(what: str) -> type[Passed]:
    class Reused(Passed):
        def begin(self):
            self._given = {}

        def _same(self, key, found):
            if key in self._given and self._given[key].shape == found.shape:
                self._given[key][...] = found
            else:
                self._given[key] = found
            return self._given[key]

        def body_states(self, names):
            found = super().body_states(names)
            return self._same(tuple(names), found) if what == "states" else found

        def nodes(self, name):
            found = super().nodes(name)
            return self._same(name, found) if what == "nodes" else found

    return Reused


def settings(factor: float) -> type[Passed]:
    class Tells(Passed):
        def begin(self):
            self.settings = {
                **self.inner.settings,
                "timestep_s": factor * float(self.inner.settings["timestep_s"]),
            }

    return Tells


class _LastGravity:
    """The gravity of the scene that was built last acts on all simulations."""

    value = None


def gravity_of_last() -> type[Passed]:
    class Shared(Passed):
        def begin(self):
            _LastGravity.value = -self.scene.gravity_m_per_s2

        def advance(self, seconds):
            self.inner.model.opt.gravity[2] = _LastGravity.value
            super().advance(seconds)

    return Shared
