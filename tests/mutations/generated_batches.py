"""Generated faults of batches: what a world takes from another one, loses, gets late, or gets with another factor.

An array of a call has a row for each world. The worlds of a call differ, so that each mistake of a row shows.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from gauge_envs.backends.worlds import SeparateWorlds
from mutations.generated_fields import leaves, rewritten
from mutations.worlds import Batch

FIELDS = (
    "RigidBody.mass_kg",
    "RigidBody.linear_velocity_m_per_s",
    "RigidBody.angular_velocity_rad_per_s",
    "Pose.position_m",
    "Contact.friction",
    "Contact.restitution",
)
"""Fields in which the worlds of a batch may differ."""

Source = Callable[[int, int], int]
"""Number of a world and of all worlds -> number of the world whose value it gets."""
SOURCES: tuple[tuple[str, str, Source], ...] = (
    ("stale", "first-for-all", lambda n, count: 0),
    ("stale", "last-for-all", lambda n, count: count - 1),
    ("stale", "one-before", lambda n, count: max(n - 1, 0)),
    ("swap", "neighbours", lambda n, count: min(n ^ 1, count - 1)),
    ("swap", "reversed", lambda n, count: count - 1 - n),
    ("kth", "last-of-first", lambda n, count: 0 if n == count - 1 else n),
    ("kth", "second-of-first", lambda n, count: 0 if n == 1 else n),
    ("side", "second-half-of-first", lambda n, count: n if n < count // 2 else 0),
    ("side", "odd-of-one-before", lambda n, count: n - n % 2),
    ("crowd", "from-fourth", lambda n, count: n % 4),
)
CHOSEN: tuple[tuple[str, str, Callable[[int, int], bool]], ...] = (
    ("kth", "second", lambda n, count: n == 1),
    ("kth", "last", lambda n, count: n == count - 1),
    ("side", "second-half", lambda n, count: n >= count // 2),
    ("side", "odd", lambda n, count: n % 2 == 1),
    ("crowd", "from-fourth", lambda n, count: n >= 4),
)
"""Worlds that alone have a fault."""


def _of_field(name: str, source: Source) -> Callable[..., Any]:
    """Return a function that builds worlds whose values of a field are those of others."""
    owner, field = name.split(".")

    def worlds(build: Any, scenes: Any) -> Any:
        scenes = list(scenes)
        built = []
        for number, scene in enumerate(scenes):
            other = scenes[source(number, len(scenes))]
            values = iter([value for _, value in leaves(other, owner, field)])
            taken = rewritten(
                scene, owner, field, lambda part, old, v=values: next(v, old)
            )
            built.append(build(taken))
        return SeparateWorlds(built)

    return worlds


def _scaled_field(
    name: str, chosen: Callable[[int, int], bool], factor: float
) -> Callable[..., Any]:
    """Return a function that builds worlds, of which some have a field times a factor."""
    owner, field = name.split(".")

    def scaled(part: Any, value: Any) -> Any:
        if isinstance(value, tuple):
            return tuple((factor * np.array(value)).tolist())
        return factor * value

    def worlds(build: Any, scenes: Any) -> Any:
        scenes = list(scenes)
        built = []
        for number, scene in enumerate(scenes):
            is_wrong = chosen(number, len(scenes))
            wrong = rewritten(scene, owner, field, scaled)
            built.append(build(wrong if is_wrong else scene))
        return SeparateWorlds(built)

    return worlds


def _batch(kind: type[Batch]) -> Callable[..., Any]:
    return lambda build, scenes: kind(SeparateWorlds([build(one) for one in scenes]))


CALLS = {"drive": 19, "command": 1, "wrench": 6}
Change = Callable[[Any, Any, int, Any], Any]
"""Rows, their numbers, number of worlds, rows of the call before -> rows."""


def _call_changes() -> Iterator[tuple[str, str, Change]]:
    for kind, variant, source in SOURCES:

        def taken(rows, numbers, count, before, source=source):
            every = np.array(before)
            every[numbers] = rows
            return every[[source(int(n), count) for n in numbers]]

        yield kind, variant, taken
    for kind, variant, chosen in CHOSEN:

        def weak(rows, numbers, count, before, chosen=chosen):
            return np.array(
                [
                    0.8 * row if chosen(int(n), count) else row
                    for row, n in zip(rows, numbers, strict=True)
                ]
            )

        def late(rows, numbers, count, before, chosen=chosen):
            return np.array(
                [
                    before[n] if chosen(int(n), count) else row
                    for row, n in zip(rows, numbers, strict=True)
                ]
            )

        yield kind, f"{variant}-0.8", weak
        yield kind, f"{variant}-late", late
    yield "mixed", "half", lambda rows, n, c, b: 0.5 * (rows + rows.mean(axis=0))
    yield "scale", "0.9", lambda rows, n, c, b: 0.9 * rows
    yield "drop", "first-call", lambda rows, n, c, b: rows if b.any() else 0.0 * rows
    yield "stale", "one-call", lambda rows, n, c, b: b[n]
    yield "swap", "rows-of-a-call", lambda rows, n, c, b: rows[::-1]


def _call(name: str, change: Change) -> type[Batch]:
    """Return a batch that changes the rows of a call; the pose of driven bodies stays."""

    class Changed(Batch):
        before: Any = None

        def changed(self, rows, numbers):
            count = len(self.worlds)
            rows = np.array(rows, dtype=float)
            if self.before is None:
                self.before = np.zeros((count, rows.shape[1]))
            found = change(rows, numbers, count, self.before)
            self.before = self.before.copy()
            self.before[numbers] = rows
            return found

    def drive(self, body, motions, numbers):
        motions = np.array(motions, dtype=float)
        motions[:, 7:] = self.changed(motions[:, 7:], numbers)
        self.inner.drive(body, motions, numbers)

    def command(self, values, numbers):
        self.inner.command(self.changed(values, numbers), numbers)

    def apply_wrench(self, body, wrenches, numbers):
        self.inner.apply_wrench(body, self.changed(wrenches, numbers), numbers)

    calls = {"drive": drive, "command": command, "wrench": apply_wrench}
    method = "apply_wrench" if name == "wrench" else name
    return type("Calls", (Changed,), {method: calls[name]})


def _states(change: Change) -> type[Batch]:
    """Return a batch that changes the states that it returns."""

    class States(Batch):
        before: Any = None

        def body_states(self, names):
            states = self.inner.body_states(names)
            numbers = np.arange(len(states))
            if self.before is None or self.before.shape != states.shape:
                self.before = states
            found = change(states, numbers, len(states), self.before)
            self.before = states
            return np.array(found)

    return States


def _restarts(source: Callable[[int, int], list[int]], late: bool) -> type[Batch]:
    """Return a batch in which other worlds restart than that which is asked for, at once or in the next interval."""

    class Restarts(Batch):
        waiting: tuple[int, ...] = ()

        def restart(self, number):
            self.waiting += tuple(source(number, len(self.worlds)))
            if not late:
                self._restart()

        def _restart(self):
            for number in self.waiting:
                self.inner.restart(number)
            self.waiting = ()

        def advance(self, seconds):
            self.inner.advance(seconds)
            self._restart()

    return Restarts


def _restart_faults() -> Iterator[tuple[str, str, type[Batch]]]:
    sources: tuple[tuple[str, str, Callable[[int, int], list[int]]], ...] = (
        ("crowd", "all", lambda n, count: list(range(count))),
        ("crowd", "next-too", lambda n, count: [n, (n + 1) % count]),
        ("crowd", "previous-too", lambda n, count: [n, (n - 1) % count]),
        ("swap", "neighbours", lambda n, count: [min(n ^ 1, count - 1)]),
        ("swap", "reversed", lambda n, count: [count - 1 - n]),
        ("stale", "first", lambda n, count: [0]),
        ("drop", "none", lambda n, count: []),
        ("side", "first-half", lambda n, count: [n] if n < count // 2 else []),
        ("side", "even", lambda n, count: [n] if n % 2 == 0 else []),
        ("kth", "but-last", lambda n, count: [n] if n < count - 1 else []),
    )
    for kind, variant, source in sources:
        yield kind, variant, _restarts(source, late=False)
    yield "delay", "next-interval", _restarts(lambda n, count: [n], late=True)


def _resets(chosen: Callable[[int, int], bool]) -> type[Batch]:
    class Resets(Batch):
        is_fresh = True

        def reset(self, seed):
            count = len(self.worlds)
            for number, world in enumerate(self.worlds):
                if self.is_fresh or not chosen(number, count):
                    world.reset(seed)
            self.is_fresh = False

    return Resets


def _advances(chosen: Callable[[int, int], bool], every: int) -> type[Batch]:
    class Advances(Batch):
        calls = 0

        def advance(self, seconds):
            self.calls += 1
            count = len(self.worlds)
            for number, world in enumerate(self.worlds):
                is_lost = chosen(number, count) and self.calls % every == 0
                if not is_lost:
                    world.advance(seconds)

    return Advances


def batch_faults() -> Iterator[tuple[str, str, str, Callable[..., Any]]]:
    """Yield quantity, kind, variant and builder of worlds of the faults of batches."""
    for name in FIELDS:
        for kind, variant, source in SOURCES:
            yield f"batch.{name}", kind, variant, _of_field(name, source)
        for kind, variant, chosen in CHOSEN:
            how = _scaled_field(name, chosen, 0.8)
            yield f"batch.{name}", kind, f"{variant}-0.8", how
    for kind, variant, change in _call_changes():
        for name in CALLS:
            yield f"batch.{name}", kind, variant, _batch(_call(name, change))
        yield "batch.states", kind, variant, _batch(_states(change))
    for kind, variant, batch in _restart_faults():
        yield "batch.restart", kind, variant, _batch(batch)
    for kind, variant, chosen in CHOSEN:
        yield "batch.reset", kind, variant, _batch(_resets(chosen))
        for every in (10, 60):
            batch = _advances(chosen, every)
            yield "batch.advance", kind, f"{variant}-{every}th", _batch(batch)
