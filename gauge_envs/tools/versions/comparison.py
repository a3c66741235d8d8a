"""Compare two versions of an engine on one model: the same states, one step from each."""

from __future__ import annotations

import itertools
import json
import os
import re
import signal
import subprocess
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from gauge_envs.errors import GaugeError
from gauge_envs.tools.versions.environments import made_environment
from gauge_envs.tools.versions.model import (
    Comparison,
    FieldChange,
    PairChange,
    Parting,
    Quantity,
    Ruling,
    Settled,
    Side,
    Verdict,
)
from gauge_envs.tools.versions.overlap import Solid, depth_m
from gauge_envs.tools.versions.subject import read_subject

WORKER = ("-I", "-B", str(Path(__file__).with_name("worker.py")))
"""Arguments of Python for the worker; with `-I` no path of the user's counts, and no module beside the script."""

LEAST_LIMIT = 1e-6
"""Smallest difference of accelerations that counts, over the larger one. With constraints it is the square root of the
solver's tolerance, 1e-4 for the default."""

NOISE_FACTOR = 10.0
"""Differences below this multiple of the noise of a state do not count."""

FIELD_TOLERANCE = 1e-9
"""Relative difference of a compiled number that counts."""

DEPTH_TOLERANCE_M = 1e-7
"""Difference of depths that counts [m]; convex solvers stop at 1e-6."""

END_TOLERANCE_M = 1e-3
"""Least distance between two ends of a body that counts [m]."""

SOLVER_LIMIT = 1e-3
"""Distance from the solution of an engine's own equations that counts, over the acceleration."""

DEPTH_LIMIT = 0.1
"""Miss of a depth that counts, over the depth: of nearly equal ways out an engine may take the second."""

DEEP_ENOUGH_M = 1e-5
"""Depth from which it is judged [m]; less is the tolerance of convex solvers."""

LAW_RATIO = 10.0
"""A side is right if the other one misses the law by more than this multiple."""

SOLVED_STATES = 24
"""States in which both sides also solve their equations to the end."""

EXACT = {
    "jacobian": "dense",
    "solver": "newton",
    "iterations": 1000,
    "tolerance": 1e-14,
    "ls_iterations": 200,
    "ls_tolerance": 1e-6,
}
"""Settings with which a side solves its equations to the end."""

WORKER_LIMIT_S = 3600.0
"""Time of a process [s]."""

Arrays: TypeAlias = Mapping[str, NDArray[Any]]


class VersionsError(GaugeError, RuntimeError):
    """A version cannot run a model; the message names both and the cause."""


@dataclass(frozen=True)
class Observed:
    """What one side computed.

    Attributes:
        side: The side.
        words: The compiled model, and what became of each segment.
        probes: What one step gives from the states of each file.
    """

    side: Side
    words: Mapping[str, Any]
    probes: tuple[Arrays, ...] = ()


class Bench:
    """Folder and processes of comparisons on one model.

    Args:
        model: The model file.
        folder: Folder of the files of the processes.
        steps: Steps of each segment.
        seed: Seed of controls and pushes.
        saved: NPZ of saved states, which replace the segments; or None.
        motion: NPZ of the motion of driven bodies; or None.
        title: The model as the user named it; its file by default.
        say: Prints what is installed.
    """

    def __init__(
        self,
        model: Path,
        folder: Path,
        *,
        steps: int,
        seed: int,
        saved: Path | None = None,
        motion: Path | None = None,
        title: str = "",
        say: Callable[[str], object] = print,
    ) -> None:
        self.model = model
        self.title = title or str(model)
        self._folder = folder
        self._motion: dict[str, Any] = {"steps": steps, "seed": seed}
        if saved is not None:
            self._motion["saved"] = str(saved.resolve())
        if motion is not None:
            self._motion["driven"] = str(motion)
        self._say = say
        # Both sides may ask for a number at once.
        self._numbers = itertools.count(1)

    def run(self, side: Side) -> tuple[Observed, Path]:
        """Move the model on one side; return what it compiled, and the file of the states that it visits."""
        words = self.work(side, {"run": self._motion})
        return Observed(side, words), Path(f"{words['out']}.run.npz")

    def probe(
        self, side: Side, files: Sequence[Path], *, has_poses: bool = False
    ) -> Observed:
        """Compute one step from each state of files; with the poses of all geoms if they are wanted."""
        job = {"states": [str(file) for file in files], "has_poses": has_poses}
        words = self.work(side, job)
        probes = tuple(
            _arrays(Path(f"{words['out']}.probe{index}.npz"))
            for index in range(len(files))
        )
        return Observed(side, words, probes)

    def kept(self, rows: dict[str, Any]) -> Path:
        """Write states to a file."""
        file = self._folder / f"states{next(self._numbers)}.npz"
        np.savez(file, **rows)
        return file

    def work(
        self, side: Side, job: Mapping[str, Any], worker: Sequence[str] = WORKER
    ) -> dict[str, Any]:
        """Do a job on a side; return what the worker wrote, and the start `out` of the names of its files."""
        out = self._folder / f"job{next(self._numbers)}"
        whole: dict[str, Any] = {"model": str(self.model.resolve()), **job}
        whole |= {"settings": dict(side.settings), "out": str(out)}
        file = Path(f"{out}.job.json")
        file.write_text(json.dumps(whole), encoding="utf-8")
        self.execute(side, file, worker)
        found: dict[str, Any] = json.loads(
            Path(f"{out}.json").read_text(encoding="utf-8")
        )
        return found | {"out": str(out)}

    def execute(self, side: Side, job: Path, worker: Sequence[str]) -> None:
        """Run a worker on a job in the environment of a side.

        Raises:
            VersionsError: The worker failed; the message has its last line.
        """
        python = side.python
        if python is None:
            python = str(made_environment(side.requirement, self._say).python)
        done = subprocess.run(
            [python, *worker, str(job)],
            capture_output=True,
            text=True,
            errors="replace",
            check=False,
            timeout=WORKER_LIMIT_S,
            stdin=subprocess.DEVNULL,
            env=os.environ | {"OMP_NUM_THREADS": "1", "MUJOCO_GL": "disable"},
        )
        if done.returncode != 0:
            # A traceback ends with the exception, whose message may have several lines.
            *_, last = re.split(r"^(?=\w[\w.]*: )", done.stderr, flags=re.M)
            cause = " ".join(last.split()) or f"it ended with code {done.returncode}"
            if done.returncode < 0:
                cause = f"this release crashes on it ({signal.Signals(-done.returncode).name})"
            raise VersionsError(f"{side.title} cannot run {self.title}: {cause}")


@contextmanager
def bench(subject: str, states: Path | None = None, **options: Any) -> Iterator[Bench]:
    """Open a bench, whose files are removed at the end.

    Args:
        subject: The model, in the words of `read_subject`.
        states: File of its saved states, or None.
        options: Other arguments of `Bench`.
    """
    with TemporaryDirectory(prefix="gauge-versions-") as name:
        folder = Path(name)
        read = read_subject(subject, folder, states)
        yield Bench(
            read.file,
            folder,
            saved=read.states,
            motion=read.motion,
            title=read.title,
            **options,
        )


_READING = threading.Lock()
"""NumPy parses the header of an array with `ast`, which Python 3.11 may break off in two threads at once."""


def _arrays(file: Path) -> dict[str, NDArray[Any]]:
    with _READING, np.load(file) as arrays:
        return {name: np.array(arrays[name]) for name in arrays.files}


def compare(bench: Bench, before: Side, after: Side) -> Comparison:
    """Return what differs between two versions on the model of a bench.

    Args:
        bench: The bench.
        before: First version.
        after: Second version.

    Raises:
        VersionsError: A version cannot run the model.
        ReleaseError: An environment cannot be made.
    """
    sides = (before, after)
    with ThreadPoolExecutor(2) as pool:
        (one, one_file), (two, two_file) = pool.map(bench.run, sides)
        check_same_shape(bench, one, two)
        files = [one_file, two_file]
        first, second = pool.map(lambda side: bench.probe(side, files), sides)
        visits = [
            Visit(
                gap=Gap(first.probes[index], second.probes[index]),
                states=_arrays(files[index]),
                title=sides[index].title,
                segments=[*(end["segment"] for end in one.words["ends"]), SAVED],
                names=one.words["names"],
            )
            for index in range(2)
        ]
        rulings = [*_law_rulings(visits, sides)]
        worst = _worst_states(visits)
        if worst is not None:
            rulings += _solved_rulings(bench, sides, worst, _common(visits), pool)
    partings = [visit.first() for visit in visits]
    largest = max((visit.worst() for visit in visits), key=_acceleration)
    differing = sum(int(np.sum(visit.gap.differs)) for visit in visits)
    is_identical = all(visit.gap.is_identical for visit in visits)
    verdict = Verdict.IDENTICAL if is_identical else Verdict.SAME
    right = {ruling.right for ruling in rulings if ruling.right}
    fields, new_fields = field_changes(one.words, two.words)
    return Comparison(
        subject=bench.title,
        before=before.title,
        after=after.title,
        versions=(one.words["version"], two.words["version"]),
        verdict=Verdict.DIFFERENT if differing else verdict,
        states=sum(len(visit.gap.relative) for visit in visits),
        differing=differing,
        largest=max(float(np.max(visit.gap.relative)) for visit in visits),
        noise=float(np.median(np.concatenate([visit.gap.noise for visit in visits]))),
        first=next((one for one in partings if one is not None), None),
        worst=largest,
        fields=fields,
        new_fields=new_fields,
        dropped=(tuple(one.words["dropped"]), tuple(two.words["dropped"])),
        pairs=_pair_changes(visits),
        # Without a step that differs, ends differ by chaos alone.
        settled=tuple(_settled(one.words, two.words)) if differing else (),
        rulings=tuple(rulings),
        right=right.pop() if differing and len(right) == 1 else "",
    )


def check_same_shape(bench: Bench, one: Observed, two: Observed) -> None:
    """Check that a state of one side is a state of the other."""
    counts = []
    for side in (one, two):
        counts.append(", ".join(f"{key} {side.words[key]}" for key in SHAPE))
    if counts[0] != counts[1]:
        raise VersionsError(
            f"{bench.title}: {one.side.title} compiles {counts[0]}; {two.side.title} compiles {counts[1]}. "
            "No state fits both."
        )


SAVED = "saved states"
"""States of the user's file, which are behind those of the segments."""

SHAPE = ("nq", "nv", "nu")
"""Sizes of a state."""


# --- one step from the same state ------------------------------------------------------------------------------------

VARIANTS = ("perturbed", "cold")
"""Accelerations from a start 1e-10 apart, and without a warm start."""


class Gap:
    """Differences of what two sides compute from the same states.

    Attributes:
        before, after: What each side computed.
        relative: Difference of the accelerations over the larger one, shape [states].
        noise: What a start 1e-10 apart and a solver without its warm start change, on the quieter side, shape [states].
        limit: Difference that counts, shape [states].
        differs: Where the difference counts, shape [states].
    """

    def __init__(self, before: Arrays, after: Arrays) -> None:
        self.before, self.after = before, after
        self._scale = np.full(len(before["qacc"]), 1e-9)
        for side in (before, after):
            # At rest the acceleration is 0: that without constraints, gravity, remains.
            for name in ("qacc", "smooth", "step_acc"):
                norm = np.linalg.norm(side[name], axis=1)
                self._scale = np.fmax(self._scale, norm)
        self.relative = np.fmax(
            self._over_scale(before["qacc"] - after["qacc"]),
            self._over_scale(before["step_acc"] - after["step_acc"]),
        )
        noises = []
        for side in (before, after):
            changes = [self._over_scale(side["qacc"] - side[name]) for name in VARIANTS]
            noises.append(np.fmax(*changes))
        self.noise = np.fmin(*noises)
        solver_error = np.fmax(before["solver_error"], after["solver_error"])
        self.limit = np.fmax(NOISE_FACTOR * self.noise, LEAST_LIMIT)
        self.limit = np.fmax(self.limit, solver_error)
        warned = before["warnings"] != after["warnings"]
        self.differs = (self.relative > self.limit) | warned

    def _over_scale(self, difference: NDArray[Any]) -> NDArray[Any]:
        # What is no number on one side is as different as can be.
        return np.nan_to_num(np.linalg.norm(difference, axis=1) / self._scale, nan=2.0)

    @property
    def is_identical(self) -> bool:
        """Whether both sides computed the same bits."""
        return all(np.array_equal(self.before[name], self.after[name]) for name in BITS)


BITS = ("qacc", "step_acc", "constraint", "contact_dist", "contact_pair")
"""Results whose bits are compared."""


def distance(one: Observed, two: Observed) -> float:
    """Return the root mean square of the differences of accelerations that count, in all states."""
    squares = []
    for first, second in zip(one.probes, two.probes, strict=True):
        gap = Gap(first, second)
        counted = np.where(gap.differs, np.minimum(gap.relative, 2.0), 0.0)
        squares.append(counted**2)
    return float(np.sqrt(np.mean(np.concatenate(squares))))


@dataclass(frozen=True, kw_only=True)
class Visit:
    """States that one side visits, and what both compute there.

    Attributes:
        gap: The differences.
        states: The states.
        title: Title of the side.
        segments: Names of the segments.
        names: Names of bodies, joints and geoms.
    """

    gap: Gap
    states: Arrays
    title: str
    segments: Sequence[str]
    names: Mapping[str, Sequence[str]]

    def first(self) -> Parting | None:
        """Return where the sides part first; None if they do not."""
        found = np.flatnonzero(self.gap.differs)
        return self._parting(int(found[0])) if len(found) else None

    def worst(self) -> Parting | None:
        """Return where the sides part most; None if they do not."""
        if not np.any(self.gap.differs):
            return None
        return self._parting(
            int(np.argmax(np.where(self.gap.differs, self.gap.relative, -1.0)))
        )

    def _parting(self, index: int) -> Parting:
        gap = self.gap
        name = "qacc" if self._differs(index, "qacc") else "step_acc"
        one, two = gap.before[name][index], gap.after[name][index]
        dof = int(np.argmax(np.abs(np.nan_to_num(one - two, nan=np.inf))))
        quantity, detail = self._cause(index)
        return Parting(
            segment=self.segments[int(self.states["segment"][index])],
            step=int(self.states["step"][index]),
            of=self.title,
            quantity=quantity,
            detail=detail,
            where=self.names["dof"][dof],
            acceleration=float(gap.relative[index]),
            limit=float(gap.limit[index]),
            acceleration_before=float(one[dof]),
            acceleration_after=float(two[dof]),
            contacts_before=int(gap.before["contacts"][index]),
            contacts_after=int(gap.after["contacts"][index]),
            iterations_before=int(gap.before["iterations"][index]),
            iterations_after=int(gap.after["iterations"][index]),
            warnings_before=int(gap.before["warnings"][index]),
            warnings_after=int(gap.after["warnings"][index]),
        )

    def _differs(self, index: int, name: str) -> bool:
        """Return whether accelerations of a kind part at a state by more than rounding."""
        one, two = self.gap.before[name][index], self.gap.after[name][index]
        size = max(float(np.linalg.norm(one)), float(np.linalg.norm(two)))
        return not np.allclose(one, two, rtol=0.0, atol=LEAST_LIMIT / 10.0 * size)

    def _cause(self, index: int) -> tuple[Quantity, str]:
        """Return what parts first in the order of computation, and both values in words."""
        depths = [_depths(side, index) for side in (self.gap.before, self.gap.after)]
        for pair in sorted({*depths[0], *depths[1]}):
            one, two = (found.get(pair, []) for found in depths)
            names = " and ".join(self.names["geom"][geom] for geom in pair)
            if len(one) != len(two):
                return Quantity.CONTACTS, f"{names}: {len(one)} and {len(two)} contacts"
            change = np.abs(np.subtract(one, two))
            if np.max(change) > DEPTH_TOLERANCE_M:
                at = int(np.argmax(change))
                return Quantity.DEPTH, (
                    f"{names}: {-1e3 * one[at]:.4g} and {-1e3 * two[at]:.4g} mm"
                )
        if self._differs(index, "smooth"):
            return Quantity.SMOOTH, "without contacts and limits the accelerations part"
        if self._differs(index, "qacc"):
            iterations = [
                int(side["iterations"][index])
                for side in (self.gap.before, self.gap.after)
            ]
            return Quantity.CONSTRAINT, (
                "the same contacts and forces beside them; the solver took "
                f"{iterations[0]} and {iterations[1]} iterations"
            )
        return Quantity.STEP, "the same accelerations; the velocities after it part"


def _depths(side: Arrays, index: int) -> dict[tuple[int, int], list[float]]:
    """Return the sorted distances of the contacts of a state [m], by pair of geoms."""
    found: dict[tuple[int, int], list[float]] = {}
    for row in np.flatnonzero(side["contact_state"] == index):
        first, second = side["contact_pair"][row]
        pair = (int(first), int(second))
        found.setdefault(pair, []).append(float(side["contact_dist"][row]))
    return {pair: sorted(distances) for pair, distances in found.items()}


def _acceleration(parting: Parting | None) -> float:
    return -1.0 if parting is None else parting.acceleration


# --- which side is right ---------------------------------------------------------------------------------------------


def _law_rulings(visits: Sequence[Visit], sides: Sequence[Side]) -> Iterator[Ruling]:
    """Yield the laws that hold in every state, where a side misses one."""
    for name, (law, limit) in LAWS.items():
        misses = []
        for side in ("before", "after"):
            values = [getattr(visit.gap, side)[name] for visit in visits]
            misses.append(np.concatenate(values))
        applies = np.isfinite(misses[0]) & np.isfinite(misses[1])
        if np.any(applies):
            worst = [float(np.max(miss[applies])) for miss in misses]
            if max(worst) > limit:
                yield _ruling(law, worst, limit, int(np.sum(applies)), sides)


LAWS = {
    "imbalance": (
        "mass x acceleration = applied + constraint forces, as the engine states them",
        1e-3,
    ),
    "spin": ("the angular momentum of a free body stays, in one step", 1e-6),
}
"""Law of each probed miss, and the miss that counts, as a fraction."""


def _ruling(
    law: str, worst: Sequence[float], limit: float, states: int, sides: Sequence[Side]
) -> Ruling:
    right = ""
    for own, other, side in ((0, 1, sides[0]), (1, 0, sides[1])):
        if worst[other] > max(limit, LAW_RATIO * worst[own]):
            right = side.title
    return Ruling(law=law, before=worst[0], after=worst[1], states=states, right=right)


def _worst_states(visits: Sequence[Visit]) -> dict[str, NDArray[Any]] | None:
    """Return the states in which the sides part most; None if they do not part."""
    relative = np.concatenate([visit.gap.relative for visit in visits])
    differs = np.concatenate([visit.gap.differs for visit in visits])
    order = np.argsort(np.where(differs, -relative, np.inf), kind="stable")
    worst = order[: min(SOLVED_STATES, int(np.sum(differs)))]
    if not worst.size:
        return None
    return {
        name: np.concatenate([visit.states[name] for visit in visits])[worst]
        for name in visits[0].states
    }


def _solved_rulings(
    bench: Bench,
    sides: Sequence[Side],
    states: dict[str, Any],
    common: set[tuple[int, int]],
    pool: ThreadPoolExecutor,
) -> Iterator[Ruling]:
    """Yield by how much each side misses the solution of its own equations, and the depths of its shapes."""
    file = bench.kept(states)
    jobs = [*sides]
    for side in sides:
        jobs.append(replace(side, settings={**side.settings, **EXACT}))
    found = list(pool.map(lambda one: bench.probe(one, [file], has_poses=True), jobs))
    plain = [observed.probes[0] for observed in found]
    worst = []
    for given, solved in ((plain[0], plain[2]), (plain[1], plain[3])):
        worst.append(float(np.max(Gap(given, solved).relative)))
    law = "the solver reaches the solution of the engine's own equations (dense Newton, 1000 iterations)"
    yield _ruling(law, worst, SOLVER_LIMIT, len(states["qpos"]), sides)
    misses = _depth_misses(found[0].words, plain[:2], common)
    if len(misses):
        worst = [float(value) for value in np.max(misses, axis=0)]
        law = "boxes and balls are as deep in each other as their geometry says (separating axes)"
        yield _ruling(law, worst, DEPTH_LIMIT, len(misses), sides)


def _common(visits: Sequence[Visit]) -> set[tuple[int, int]]:
    """Return the pairs of geoms that touch on both sides; a release may leave other pairs out on purpose."""
    touching = []
    for side in ("before", "after"):
        rows = [getattr(visit.gap, side)["contact_pair"] for visit in visits]
        touching.append({(int(one), int(two)) for one, two in np.concatenate(rows)})
    return touching[0] & touching[1]


def _depth_misses(
    words: Mapping[str, Any], sides: Sequence[Arrays], common: set[tuple[int, int]]
) -> NDArray[np.float64]:
    """Return by how much each side misses the depth of each pair of boxes and balls, over it, shape [pair, side]."""
    kinds, sizes = words["fields"]["geom_type"], np.array(words["fields"]["geom_size"])
    misses = []
    for index in range(len(sides[0]["qacc"])):
        depths = [_depths(side, index) for side in sides]
        for pair in sorted({*depths[0], *depths[1]} & common):
            one, two = (
                _solid(kinds[geom], sizes[geom], sides[0], index, geom) for geom in pair
            )
            if one is None or two is None:
                continue
            true_m = depth_m(one, two)
            if true_m > DEEP_ENOUGH_M:
                stated = [-min(found.get(pair, [0.0])) for found in depths]
                misses.append(np.abs(np.array(stated) - true_m) / true_m)
    return np.array(misses)


def _solid(
    kind: str, size: NDArray[np.float64], side: Arrays, index: int, geom: int
) -> Solid | None:
    """Return the box or ball that a geom is at a state; None for another shape."""
    is_ball = kind == "mjGEOM_SPHERE"
    if not is_ball and kind != "mjGEOM_BOX":
        return None
    return Solid(
        half_sizes_m=np.zeros(3) if is_ball else size,
        radius_m=float(size[0]) if is_ball else 0.0,
        position_m=side["geom_xpos"][index, geom],
        rotation=side["geom_xmat"][index, geom].reshape(3, 3),
    )


# --- the compiled model ----------------------------------------------------------------------------------------------


def field_changes(
    one: Mapping[str, Any], two: Mapping[str, Any]
) -> tuple[tuple[FieldChange, ...], tuple[str, ...]]:
    """Return the compiled fields that differ, and the names of those that one side alone has.

    Args:
        one: What the worker wrote of the first side.
        two: What it wrote of the second side.
    """
    before, after = one["fields"], two["fields"]
    changes = []
    for name in before:
        if name in after and (change := _field_change(name, before, after, one)):
            changes.append(change)
    return tuple(changes), tuple(sorted({*before} ^ {*after}))


def _field_change(
    name: str,
    before: Mapping[str, Any],
    after: Mapping[str, Any],
    words: Mapping[str, Any],
) -> FieldChange | None:
    one, two = np.array(before[name]), np.array(after[name])
    if one.shape != two.shape:
        return FieldChange(
            field=name, where="", count=1, before=before[name], after=after[name]
        )
    if one.dtype.kind == "f" or two.dtype.kind == "f":
        differs = ~np.isclose(
            one, two, rtol=FIELD_TOLERANCE, atol=1e-12, equal_nan=True
        )
        size = np.abs(np.subtract(one, two, dtype=float))
    else:
        differs = one != two
        size = differs.astype(float)
    if not np.any(differs):
        return None
    if name.startswith("opt.") or one.ndim == 0:
        where, count, values = "", 1, (one, two)
    else:
        rows = np.any(differs.reshape(len(one), -1), axis=1)
        sizes = np.where(differs, size, -1.0).reshape(len(one), -1)
        at = int(np.argmax(np.max(sizes, axis=1)))
        kind = next((kind for kind in words["owners"] if name.startswith(kind)), "")
        owners = words["names"].get(words["owners"].get(kind, ""), [])
        where = owners[at] if len(owners) == len(one) else f"row {at}"
        count, values = int(np.sum(rows)), (one[at], two[at])
    return FieldChange(
        field=name,
        where=where,
        count=count,
        before=values[0].tolist(),
        after=values[1].tolist(),
    )


# --- contacts and ends -----------------------------------------------------------------------------------------------


def _pair_changes(visits: Sequence[Visit]) -> tuple[PairChange, ...]:
    """Return the pairs of geoms whose contacts differ in number or depth, the one that differs most first."""
    found: dict[tuple[int, int], list[dict[str, Any]]] = {}
    for which, visit in enumerate(visits):
        for place, side in enumerate((visit.gap.before, visit.gap.after)):
            rows = zip(
                side["contact_pair"],
                side["contact_state"],
                side["contact_dist"],
                strict=True,
            )
            for (first, second), state, dist in rows:
                empty = [{"states": set(), "count": 0, "depth": 0.0} for _ in range(2)]
                entry = found.setdefault((int(first), int(second)), empty)[place]
                entry["states"].add((which, int(state)))
                entry["count"] += 1
                entry["depth"] = max(entry["depth"], -float(dist))
    total = sum(len(visit.gap.relative) for visit in visits)
    changes = []
    for (first, second), (one, two) in found.items():
        is_deeper = abs(one["depth"] - two["depth"]) > 10.0 * DEPTH_TOLERANCE_M
        if one["count"] != two["count"] or is_deeper:
            geoms = visits[0].names["geom"]
            changes.append(
                PairChange(
                    pair=(geoms[first], geoms[second]),
                    states=total,
                    states_before=len(one["states"]),
                    states_after=len(two["states"]),
                    contacts_before=one["count"],
                    contacts_after=two["count"],
                    depth_before_m=one["depth"],
                    depth_after_m=two["depth"],
                )
            )
    changes.sort(key=lambda one: -abs(one.contacts_before - one.contacts_after))
    return tuple(changes)


def _settled(one: Mapping[str, Any], two: Mapping[str, Any]) -> Iterator[Settled]:
    """Yield the segments that end differently, by more than what chaos makes of nothing."""
    for before, after in zip(one["ends"], two["ends"], strict=True):
        ends = [np.array(side["positions_m"]) for side in (before, after)]
        difference = np.linalg.norm(ends[0] - ends[1], axis=1)
        noise = 0.0
        for side in (before, after):
            change = np.subtract(side["perturbed_positions_m"], side["positions_m"])
            noise = np.fmax(noise, np.max(np.linalg.norm(change, axis=1)))
        body = int(np.argmax(np.nan_to_num(difference, nan=np.inf)))
        if difference[body] <= max(END_TOLERANCE_M, NOISE_FACTOR * noise):
            continue
        moved = []
        for side in (before, after):
            start_m, end_m = side["first_positions_m"][body], side["positions_m"][body]
            moved.append(float(np.linalg.norm(np.subtract(end_m, start_m))))
        yield Settled(
            segment=before["segment"],
            body=one["names"]["body"][body],
            difference_m=float(difference[body]),
            noise_m=float(noise),
            moved_before_m=moved[0],
            moved_after_m=moved[1],
            depth_before_m=before["depths_m"][body],
            depth_after_m=after["depths_m"][body],
            speed_before_m_per_s=before["speeds"][body],
            speed_after_m_per_s=after["speeds"][body],
            end_before=_end(before, body, moved[0]),
            end_after=_end(after, body, moved[1]),
        )


EXPLODING_SPEED = 100.0
"""Velocity that no body of a robot's scene has [m/s or rad/s]."""

DEEP_M = 5e-3
"""Depth of a contact beyond which a body is inside another one [m]."""

FALL_M = 0.03
"""Way down that is a fall [m]."""

STANDING_M, STANDING_M_PER_S = 1e-2, 0.1
"""Displacement [m] and speed [m/s] of a body that stands."""


def _end(end: Mapping[str, Any], body: int, moved_m: float) -> str:
    is_bad = any(name.startswith("mjWARN_BAD") for name in end["warnings"])
    if is_bad or not end["largest_speed"] < EXPLODING_SPEED:
        return "explodes"
    if end["fallen_m"][body] > FALL_M:
        return "falls"
    if end["depths_m"][body] > DEEP_M:
        return "penetrates"
    is_still = moved_m < STANDING_M and end["speeds"][body] < STANDING_M_PER_S
    return "stands" if is_still else "moves"
