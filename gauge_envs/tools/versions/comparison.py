"""Compare one step of two MuJoCo versions from the same states, and decide which side is right."""

from bisect import bisect_left
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import product
from typing import Any, TypeAlias

import mujoco
import numpy as np
from scipy.spatial import ConvexHull

from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.versions.environments import Arrays, Job, VersionsError, work
from gauge_envs.tools.versions.schema import (
    FieldChange,
    Quantity,
    Release,
    Ruling,
    Side,
    StepComparison,
    StepDifference,
    VersionsVerdict,
)
from gauge_envs.tools.versions.worker import STATE

Contacts: TypeAlias = dict[tuple[int, int], list[float]]
"""Sorted distances of contacts [m] by pair of geoms."""

MIN_LIMIT = 1e-6
"""Smallest relevant difference of accelerations, divided by the larger one. With constraints, the limit is at least
the square root of the solver's tolerance, 1e-4 by default."""

NOISE_FACTOR = 10.0
"""Differences below this multiple of the noise of a state are ignored."""

ROUNDING = 1e-7
"""Largest relative difference of accelerations by rounding."""

DEPTH_TOLERANCE_M = 1e-7
"""Smallest relevant difference of depths [m]; convex solvers stop at 1e-6."""

FIELD_TOLERANCE = 1e-9
"""Smallest relevant relative difference of a compiled number."""

SOLVER_LAW = "the solver reaches the solution of the engine's equations (dense Newton, 1000 iterations)"
SOLVER_LIMIT = 1e-3
"""Smallest relevant distance from this solution, divided by the acceleration."""

DEPTH_LAW = "contact depths of boxes agree with their geometry"
DEPTH_LIMIT = 0.1
"""Smallest relevant relative error of a depth. An engine may choose another face with a nearly equal depth."""

MIN_DEPTH_M = 1e-5
"""Smallest depth to which the law applies [m]; convex solvers have a larger tolerance."""

LAW_RATIO = 10.0
"""A side is right if the error of the other side is more than this multiple of its error."""

MAX_SOLVED = 24
"""Maximum number of states in which both sides also solve their equations exactly."""

ACCELERATIONS = {
    Quantity.SMOOTH: "smooth",
    Quantity.CONSTRAINT: "qacc",
    Quantity.STEP: "step_acc",
}
"""Accelerations of a probe, in the order of computation."""

BOX = float(mujoco.mjtGeom.mjGEOM_BOX)

EXACT = {
    "jacobian": "dense",
    "solver": "newton",
    "iterations": 1000,
    "tolerance": 1e-14,
    "ls_iterations": 200,
    "ls_tolerance": 1e-6,
}
"""Settings with which a side solves its equations exactly."""


def compare(job: Job, before: Side, after: Side) -> StepComparison:
    """Return the differences between two versions on the model of a job.

    Raises:
        VersionsError: The installation of an environment fails, or a version cannot run the model.
    """
    sides = (before, after)
    runs, states = visited_states(job, sides)
    probes = ProbePair(*work("probe", job, sides, states))
    first, second = runs
    differences: list[StepDifference | None] = [None, None]
    rulings: list[Ruling] = []
    if probes.worst:
        indices = (min(probes.worst), probes.worst[0])
        differences = [_difference(probes, index, states, first) for index in indices]
        rulings = list(_rulings(job, sides, probes, states, first))
    unknown = np.union1d(first["unknown fields"], second["unknown fields"])
    rights = {ruling.right for ruling in rulings} - {""}
    return StepComparison(
        subject=job["title"],
        before=before.title,
        after=after.title,
        versions=(str(first["version"]), str(second["version"])),
        verdict=VersionsVerdict.DIFFERENT if probes.worst else VersionsVerdict.SAME,
        states=len(probes.relative),
        differing=len(probes.worst),
        largest=float(np.max(probes.relative)),
        noise=float(np.median(probes.noise)),
        first=differences[0],
        worst=differences[1],
        fields=tuple(field_changes(first, second)),
        unknown_fields=tuple(unknown.tolist()),
        rulings=tuple(rulings),
        right=rights.pop() if len(rights) == 1 else "",
    )


def find_change(job: Job, releases: Sequence[Side]) -> StepComparison:
    """Compare the two neighbouring releases between which a difference appears.

    A release belongs to the end of the range with the nearer accelerations, in the states that both ends visit. If the
    range has several changes, this finds one of them. If the ends do not differ, it compares the ends.

    Args:
        job: Job of the model.
        releases: The releases, oldest first.
    """
    ends = (releases[0], releases[-1])
    _, states = visited_states(job, ends)
    first, last = work("probe", job, ends, states)
    tried: list[Release] = []

    def is_like_last(side: Side) -> bool:
        """Return whether a release is nearer to the last one than to the first one."""
        (probe,) = work("probe", job, [side], states)
        is_new = ProbePair(first, probe).distance > ProbePair(probe, last).distance
        like = "last" if is_new else "first"
        tried.append(Release(release=side.title, like=like))
        return is_new

    neighbours: Sequence[Side] = ends
    if ProbePair(first, last).worst:
        index = bisect_left(
            releases, True, lo=1, hi=len(releases) - 1, key=is_like_last
        )
        neighbours = releases[index - 1 : index + 1]
    return replace(compare(job, *neighbours), tried=tuple(tried))


def visited_states(job: Job, sides: Sequence[Side]) -> tuple[list[Arrays], Arrays]:
    """Run the model on both sides, and return the outputs and the states of both sides."""
    runs = work("run", job, sides)
    before, after = (run["sizes"] for run in runs)
    if before != after:
        raise VersionsError(
            f"{job['title']}: {sides[0].title} compiles {before}; {sides[1].title} compiles {after}. No state fits "
            "both."
        )
    names = ("step", "segment", *STATE)
    states = {name: np.concatenate([run[name] for run in runs]) for name in names}
    return runs, states


# --- compiled fields -------------------------------------------------------------------------------------------------


def field_changes(before: Arrays, after: Arrays) -> Iterator[FieldChange]:
    """Yield the differing compiled fields of two sides: the row with the largest difference, and the number of rows."""
    for name in sorted(before.keys() & after.keys()):
        first, second = before[name], after[name]
        if not name.startswith("field ") or first.shape != second.shape:
            continue
        is_same = np.isclose(first, second, rtol=FIELD_TOLERANCE, atol=1e-12)
        rows = np.unique(np.nonzero(~is_same)[0])
        if len(rows):
            sizes = np.abs(first - second)[rows].reshape(len(rows), -1).max(axis=1)
            row = int(rows[np.argmax(sizes)])
            yield FieldChange(
                field=name.removeprefix("field "),
                row=row,
                count=len(rows),
                before=first[row].tolist(),
                after=second[row].tolist(),
            )


# --- one step from the same state ------------------------------------------------------------------------------------


class ProbePair:
    """Probes of two sides from the same states, and their differences.

    Args:
        before, after: Arrays of each side.

    Attributes:
        sides: Arrays of each side.
        relative: Difference of the accelerations, divided by the larger one, shape [states].
        noise: Change by a velocity difference of 1e-10 or a cold start of the solver, on the quieter side,
            shape [states].
        worst: Indices of the states where the difference exceeds the limit, largest difference first.
    """

    def __init__(self, before: Arrays, after: Arrays) -> None:
        self.sides = (before, after)
        names = ("qacc", "step_acc", "smooth")
        # Shape [sides, names, states, nv].
        values = np.array([[side[name] for name in names] for side in self.sides])
        # At rest, the acceleration is 0, but the acceleration without constraints is gravity.
        sizes = np.linalg.norm(values, axis=3)
        scale = np.fmax.reduce(sizes, axis=(0, 1), initial=1e-9)
        distances = np.linalg.norm(values[0, :2] - values[1, :2], axis=2) / scale
        # If one side is NaN, the distance is at its maximum.
        self.relative = np.nan_to_num(distances, nan=2.0).max(axis=0)
        self.noise = np.fmin(before["noise"], after["noise"]) / scale
        limits = [
            NOISE_FACTOR * self.noise,
            before["solver_error"],
            after["solver_error"],
        ]
        limit = np.max(limits, axis=0, initial=MIN_LIMIT)
        order = np.argsort(-self.relative, kind="stable")
        self.worst = order[(self.relative > limit)[order]].tolist()

    @property
    def distance(self) -> float:
        """Root mean square of the differences above the limit."""
        counted = np.minimum(self.relative[self.worst], 2.0)
        return float(np.sqrt(np.sum(counted**2) / len(self.relative)))

    def contacts(self, index: int) -> list[Contacts]:
        """Return the contacts of each side in a state."""
        pairs: list[Contacts] = []
        for side in self.sides:
            distances_m: Contacts = defaultdict(list)
            rows = side["contacts"]
            for _, first, second, distance_m in rows[rows[:, 0] == index].tolist():
                distances_m[int(first), int(second)].append(distance_m)
            pairs.append(distances_m)
        return pairs


def _difference(
    probes: ProbePair, index: int, states: Arrays, model: Arrays
) -> StepDifference:
    """Return the first differing quantity of two sides in a state, in the order of computation.

    Args:
        probes: The probes of both sides.
        index: The state.
        states: Segment and step of each state.
        model: Description of the model, with the names of geoms and degrees of freedom.
    """
    quantity, places, values = next(
        (quantity, places, values)
        for quantity, places, values, tolerance in _quantities(probes, index, model)
        # NaN differs.
        if not np.linalg.norm(np.subtract(*values)) <= tolerance
    )
    changes = np.abs(np.subtract(*values))
    place = int(np.argmax(np.nan_to_num(changes, nan=np.inf)))
    return StepDifference(
        segment=str(states["segment"][index]),
        step=int(states["step"][index]),
        quantity=quantity,
        where=str(places[place]),
        before=float(values[0][place]),
        after=float(values[1][place]),
    )


def _quantities(
    probes: ProbePair, index: int, model: Arrays
) -> Iterator[tuple[Quantity, Sequence[str], Any, float]]:
    """Yield each quantity of a state, in the order of computation: places, values of both sides, and tolerance."""
    contacts = probes.contacts(index)
    pairs = sorted({*contacts[0], *contacts[1]})
    places = [" and ".join(model["names geom"][[*pair]]) for pair in pairs]
    counts = [[len(side[pair]) for pair in pairs] for side in contacts]
    yield Quantity.CONTACTS, places, counts, 0.0
    depths_m = [[-min(side[pair]) for pair in pairs] for side in contacts]
    yield Quantity.DEPTH, places, depths_m, DEPTH_TOLERANCE_M
    for quantity, name in ACCELERATIONS.items():
        values = [side[name][index] for side in probes.sides]
        size = np.max(np.linalg.norm(values, axis=1))
        yield quantity, model["names dof"].tolist(), values, ROUNDING * size


# --- laws ------------------------------------------------------------------------------------------------------------


def _rulings(
    job: Job,
    sides: Sequence[Side],
    probes: ProbePair,
    states: Arrays,
    model: Arrays,
) -> Iterator[Ruling]:
    """Yield each applicable law with the error of each side, in the states that differ most.

    Args:
        job: Job of the model.
        sides: Both sides.
        probes: The probes of both sides.
        states: The states.
        model: Description of the model, with its compiled fields.
    """
    worst = probes.worst[:MAX_SOLVED]
    solved = {name: states[name][worst] for name in states}
    exact = [replace(side, settings={**side.settings, **EXACT}) for side in sides]
    errors = []
    for side, solution in zip(
        probes.sides, work("probe", job, exact, solved), strict=True
    ):
        probed = {name: side[name][worst] for name in side if name != "contacts"}
        errors.append(ProbePair(probed, solution).relative)
    depths = np.transpose(list(_depth_errors(probes, worst, model)))
    laws = ((SOLVER_LAW, SOLVER_LIMIT, errors), (DEPTH_LAW, DEPTH_LIMIT, depths))
    for law, limit, values in laws:
        if not len(values):
            continue
        first, second = np.max(values, axis=1).tolist()
        is_decided = max(first, second) > max(limit, LAW_RATIO * min(first, second))
        yield Ruling(
            law=law,
            before=first,
            after=second,
            states=len(values[0]),
            right=sides[int(first > second)].title if is_decided else "",
        )


def _depth_errors(
    probes: ProbePair, states: Sequence[int], model: Arrays
) -> Iterator[FloatArray]:
    """Yield the relative error of each side in the depth of a pair of boxes."""
    poses = probes.sides[0]
    for index in states:
        contacts = probes.contacts(index)
        for pair in sorted({*contacts[0], *contacts[1]}):
            if np.any(model["field geom_type"][[*pair]] != BOX):
                continue
            boxes = [
                corners_m(
                    model["field geom_size"][geom],
                    poses["geom_xpos"][index, geom],
                    poses["geom_xmat"][index, geom].reshape(3, 3),
                )
                for geom in pair
            ]
            true_m = depth_m(*boxes)
            if true_m > MIN_DEPTH_M:
                depths_m = [-min(side[pair], default=0.0) for side in contacts]
                yield np.abs(np.subtract(depths_m, true_m)) / true_m


def depth_m(first: FloatArray, second: FloatArray) -> float:
    """Return the depth of two convex bodies in each other [m]; negative without contact.

    The Minkowski difference of touching bodies contains the origin. The depth is the distance from the origin to the
    nearest face (Cameron 1997).

    Args:
        first: Corners of the first body [m], shape [n, 3].
        second: Corners of the second body [m], shape [m, 3].
    """
    differences_m = (first[:, None] - second[None]).reshape(-1, 3)
    return -float(np.max(ConvexHull(differences_m).equations[:, 3]))


def corners_m(
    half_sizes_m: FloatArray, center_m: FloatArray, rotation: FloatArray
) -> FloatArray:
    """Return the corners of a box [m], shape [8, 3]; the columns of the rotation are its axes."""
    corners = half_sizes_m * np.array([*product((-1.0, 1.0), repeat=3)])
    return center_m + corners @ rotation.T
