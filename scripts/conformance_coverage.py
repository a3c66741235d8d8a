"""What the checks cover, recorded while they run: pairs that collide, speeds of driven bodies, and calls.

A cell has the number of checks; an empty one is a scene that no check builds.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar, get_args

import numpy as np

from gauge_envs.backends import Backend, Simulation, backend as find_backend
from gauge_envs.pages.html import element
from gauge_envs.pages.table import Column, Table
from gauge_envs.scene import Deformable, Motion, RigidBody, Scene, Shape
from gauge_envs.tools.conformance.lab import Lab
from gauge_envs.tools.conformance.model import checks
from gauge_envs.tools.conformance.run import run_check

T = TypeVar("T")
SOLIDS = [one.__name__ for one in get_args(Shape) if one.__name__ != "Plane"]
SOFT = [one.__name__ for one in get_args(Deformable)]
OTHERS = [f"{shape}, {motion}" for shape in SOLIDS for motion in Motion]
JOINED = "on a hinge or string"
LIMITS = (1e-9, 0.005, 0.05, 0.5, 5.0, np.inf)
SPEEDS = ("0", "to 0.005", "to 0.05", "to 0.5", "to 5", "above 5")
DRIVES = {"moves [m/s]": slice(7, 10), "turns [rad/s]": slice(10, 13)}
CALLS = (
    *("reset", "reset with starts", "drive", "apply_wrench", "advance", "body_states"),
    *("nodes", "track", "contact_forces", "diverged", "build_worlds"),
)


def _shape(one: Any) -> str:
    return type(one.shape if isinstance(one, RigidBody) else one).__name__


def _other(one: Any) -> str:
    return _shape(one) + (f", {one.motion}" if isinstance(one, RigidBody) else "")


@dataclass(eq=False)
class _Log:
    """Scene of a simulation, its calls with the bodies that they name, and the top speeds of its driven bodies."""

    scene: Scene
    calls: set[tuple[str, str]] = field(default_factory=set)
    speeds: dict[tuple[str, str], float] = field(default_factory=dict)

    def add(self, call: str, *args: Any, **_: Any) -> None:
        """Note a call."""
        names = [one.name for one in (*self.scene.bodies, *self.scene.deformables)]
        if args and call not in ("reset", "advance"):
            names = np.ravel(args[0]).tolist()
        if call == "reset" and args and args[0] is not None:
            call = "reset with starts"
        self.calls |= {(call, name) for name in names}
        for kind, part in DRIVES.items() if call == "drive" else ():
            speed = float(np.linalg.norm(args[1][:, part], axis=-1).max())
            self.speeds[kind, names[0]] = max(
                speed, self.speeds.get((kind, names[0]), 0)
            )

    def seen(self) -> Iterator[tuple[str, str, str]]:
        """Yield table, row and column of each part."""
        scene = self.scene
        several = {one.name: one for one in (*scene.bodies, *scene.deformables)}
        for contact in scene.contacts:
            for first, second in scene.colliding_pairs(contact):
                for one, other in ((first, second), (second, first)):
                    yield "pairs", _other(several[other]), _shape(several[one])
        for (kind, _), speed in self.speeds.items():
            yield "drives", kind, SPEEDS[int(np.searchsorted(LIMITS, speed))]
        joined = {joint.body for joint in scene.joints}
        for call, name in self.calls:
            motion = getattr(several[name], "motion", Motion.DYNAMIC)
            is_dynamic = motion is Motion.DYNAMIC
            yield "calls", call, _shape(several[name]) if is_dynamic else motion
            if name in joined:
                yield "calls", call, JOINED


class _Watched:
    """A simulation whose calls are noted."""

    def __init__(self, inner: Simulation, log: _Log) -> None:
        self._inner, self._log = inner, log

    def __getattr__(self, name: str) -> Any:
        value = getattr(self._inner, name)

        def noted(*args: Any, **kwargs: Any) -> Any:
            self._log.add(name, *args, **kwargs)
            return value(*args, **kwargs)

        return noted if name in CALLS else value


class _WatchingLab(Lab):
    """A lab that logs its simulations; those of a shared recording belong to each check that reads it."""

    def __init__(self, backend: Backend) -> None:
        super().__init__(backend)
        self.logs: set[_Log] = set()
        self._shared: dict[Callable[[Lab], Any], set[_Log]] = {}

    def build(
        self, scene: Scene, world_count: int | None = None, **changes: Any
    ) -> Any:
        """Build a scene and log it."""
        log = _Log(scene)
        simulation = _Watched(super().build(scene, world_count, **changes), log)
        self.logs.add(log)
        if (world_count or 1) > 1:
            log.add("build_worlds")
        return simulation

    def once(self, function: Callable[[Lab], T]) -> T:
        """Return the value of a function, with what it built."""
        before, self.logs = self.logs, self._shared.setdefault(function, set())
        try:
            return super().once(function)
        finally:
            before |= self.logs
            self.logs = before


def _cell(ids: Sequence[str]) -> Any:
    return element("span", len(ids), title=", ".join(ids)) if ids else "-"


def _table(
    title: str, rows: Sequence[str], columns: Sequence[str], found: dict[Any, list[str]]
) -> Table:
    heads = [
        Column(
            str(index),
            name,
            lambda ids: str(len(ids) or "-"),
            is_number=True,
            html=_cell,
        )
        for index, name in enumerate(columns, 1)
    ]
    cells = [[row, *(found.get((row, one), []) for one in columns)] for row in rows]
    return Table(
        columns=(Column("0", ""), *heads), rows=cells, title=title, look="matrix"
    )


def coverage_tables(
    backend: Backend | str = "mujoco", only: Sequence[str] = ()
) -> tuple[Table, ...]:
    """Run checks on an engine, and return which pairs, drives and calls how many of them cover.

    Args:
        backend: An engine that builds all scenes.
        only: Ids or patterns of checks; all when empty.
    """
    lab = _WatchingLab(find_backend(backend) if isinstance(backend, str) else backend)
    found: dict[str, dict[Any, list[str]]] = {"pairs": {}, "drives": {}, "calls": {}}
    for one in checks(only):
        lab.logs = set()
        run_check(lab, one)
        for table, *cell in {part for log in lab.logs for part in log.seen()}:
            found[table].setdefault(tuple(cell), []).append(one.id)
    others = [*OTHERS, f"Plane, {Motion.FIXED}", *SOFT]
    kinds = [*SOLIDS, JOINED, Motion.KINEMATIC, Motion.FIXED, *SOFT]
    return (
        _table("Pairs that collide", others, [*SOLIDS, *SOFT], found["pairs"]),
        _table("Top speeds of driven bodies", [*DRIVES], SPEEDS, found["drives"]),
        _table("Calls by body", CALLS, kinds, found["calls"]),
    )
