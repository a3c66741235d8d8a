"""Compare one step of two MuJoCo versions from the same states, and decide which side is right."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import Any

import mujoco
import numpy as np
from scipy.spatial import ConvexHull

from gauge_envs.cli.output import message
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.versions.environments import (
    Arrays,
    Bench,
    Output,
    VersionsError,
)
from gauge_envs.tools.versions.schema import (
    Comparison,
    FieldChange,
    Parting,
    Quantity,
    Release,
    Ruling,
    Side,
    Verdict,
)

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


def compare(bench: Bench, before: Side, after: Side) -> Comparison:
    """Return the differences between two versions on the model of a bench.

    Raises:
        VersionsError: The installation of an environment fails, or a version cannot run the model.
    """
    sides = (before, after)
    runs, states = _runs(bench, sides)
    gap = Gap(*bench.work("probe", sides, states))
    first, second = (run.description for run in runs)
    verdict = Verdict.SAME
    if np.any(gap.differs):
        verdict = Verdict.DIFFERENT
    elif gap.is_identical:
        verdict = Verdict.IDENTICAL
    partings: list[Parting | None] = [None, None]
    rulings: list[Ruling] = []
    if len(gap.worst):
        indices = (int(np.argmax(gap.differs)), gap.worst[0])
        partings = [_parting(gap, index, states, first["names"]) for index in indices]
        rulings = list(_rulings(bench, sides, gap, states, first["fields"]))
    rights = {ruling.right for ruling in rulings if ruling.right}
    return Comparison(
        subject=bench.title,
        before=before.title,
        after=after.title,
        versions=(first["version"], second["version"]),
        verdict=verdict,
        states=len(gap.relative),
        differing=int(np.sum(gap.differs)),
        largest=float(np.max(gap.relative)),
        noise=float(np.median(gap.noise)),
        first=partings[0],
        worst=partings[1],
        fields=tuple(field_changes(first["fields"], second["fields"], first["names"])),
        new_fields=tuple(sorted({*first["fields"]} ^ {*second["fields"]})),
        dropped=(first["dropped"], second["dropped"]),
        rulings=tuple(rulings),
        right=rights.pop() if len(rights) == 1 else "",
    )


def find_change(
    bench: Bench, releases: Sequence[Side]
) -> tuple[list[Side], list[Release]]:
    """Return the two neighbouring releases between which a difference appears.

    A release belongs to the end of the range with the nearer accelerations, in the states that both ends visit. If the
    range has several changes, this finds one of them.

    Args:
        bench: The bench.
        releases: The releases, oldest first.

    Returns:
        The two releases, or the ends of the range if these do not differ; and the tested releases in their order.
    """
    low, high = 0, len(releases) - 1
    ends = (releases[low], releases[high])
    _, states = _runs(bench, ends)
    first, last = bench.work("probe", ends, states)

    def attempt(side: Side, probe: Output) -> Release:
        """Return the distances of a release from both ends."""
        from_first, from_last = Gap(first, probe).distance, Gap(probe, last).distance
        like = "first" if from_first <= from_last else "last"
        return Release(
            release=side.title, from_first=from_first, from_last=from_last, like=like
        )

    tried = {low: attempt(ends[0], first), high: attempt(ends[1], last)}
    while tried[high].from_first and high - low > 1:
        middle = (low + high) // 2
        side = releases[middle]
        tried[middle] = attempt(side, *bench.work("probe", [side], states))
        message(f"{side.title} is like the {tried[middle].like} release")
        if tried[middle].like == "first":
            low = middle
        else:
            high = middle
    return [releases[low], releases[high]], [tried[index] for index in sorted(tried)]


def _runs(bench: Bench, sides: Sequence[Side]) -> tuple[list[Output], Arrays]:
    """Run the model on both sides, and return the outputs and the states of both sides."""
    runs = bench.work("run", sides)
    before, after = (run.description["sizes"] for run in runs)
    if before != after:
        raise VersionsError(
            f"{bench.title}: {sides[0].title} compiles {before}; {sides[1].title} compiles {after}. No state fits both."
        )
    first, second = (run.arrays for run in runs)
    states = {name: np.concatenate([first[name], second[name]]) for name in first}
    titles = [side.title for side in sides]
    states["of"] = np.repeat(titles, [len(first["step"]), len(second["step"])])
    return runs, states


# --- compiled fields -------------------------------------------------------------------------------------------------


def field_changes(
    before: Mapping[str, Any], after: Mapping[str, Any], names: Mapping[str, list[str]]
) -> Iterator[FieldChange]:
    """Yield the differing compiled fields of two sides: the row with the largest difference, and the number of rows.

    Args:
        before: Fields of the first side.
        after: Fields of the second side.
        names: Names of objects by the prefix of their fields.
    """
    for name in sorted(before.keys() & after.keys()):
        first, second = np.array(before[name]), np.array(after[name])
        if first.shape != second.shape:
            shapes = {"before": first.shape, "after": second.shape}
            yield FieldChange(field=name, where="shape", count=1, **shapes)
            continue
        sizes = np.abs(first - second)
        sizes[np.isclose(first, second, rtol=FIELD_TOLERANCE, atol=1e-12)] = 0.0
        if np.any(sizes):
            row = int(np.unravel_index(np.argmax(sizes), sizes.shape)[0])
            owners = names.get(name.partition("_")[0], [""])
            yield FieldChange(
                field=name,
                where=owners[row] if len(owners) == len(sizes) else f"row {row}",
                count=len(np.unique(np.nonzero(sizes)[0])),
                before=first[row].tolist(),
                after=second[row].tolist(),
            )


# --- one step from the same state ------------------------------------------------------------------------------------


class Gap:
    """Differences between the outputs of two sides from the same states.

    Args:
        before, after: Output of each side.

    Attributes:
        outputs: Output of each side.
        sides: Arrays of each side.
        touching: Sorted distances of contacts [m] by pair of geoms, for each state and side.
        relative: Difference of the accelerations, divided by the larger one, shape [states].
        noise: Change by a velocity difference of 1e-10 or a cold start of the solver, on the quieter side,
            shape [states].
        limit: Smallest relevant difference, shape [states].
        differs: Whether the difference exceeds the limit, shape [states].
        worst: Indices of the states where the difference exceeds the limit, largest difference first.
    """

    def __init__(self, before: Output, after: Output) -> None:
        self.outputs = (before, after)
        self.sides = (before.arrays, after.arrays)
        self.touching = [output.description["touching"] for output in self.outputs]
        # At rest, the acceleration is 0, but the acceleration without constraints is gravity.
        accelerations = [
            *self.pair("qacc"),
            *self.pair("smooth"),
            *self.pair("step_acc"),
        ]
        scale = np.fmax.reduce(np.linalg.norm(accelerations, axis=2), initial=1e-9)
        differences = [np.subtract(*self.pair(name)) for name in ("qacc", "step_acc")]
        distances = np.linalg.norm(differences, axis=2) / scale
        # If one side is NaN, the distance is at its maximum.
        self.relative = np.nan_to_num(distances, nan=2.0).max(axis=0)
        self.noise = np.fmin(*self.pair("noise")) / scale
        limits = [NOISE_FACTOR * self.noise, *self.pair("solver_error")]
        self.limit = np.fmax(np.max(limits, axis=0), MIN_LIMIT)
        self.differs = self.relative > self.limit
        order = np.argsort(-self.relative, kind="stable")
        self.worst = order[self.differs[order]].tolist()

    def pair(self, name: str) -> tuple[FloatArray, FloatArray]:
        """Return an array of both sides."""
        before, after = self.sides
        return before[name], after[name]

    @property
    def is_identical(self) -> bool:
        """Whether both sides compute the same bits."""
        before, after = self.touching
        names = ("qacc", "step_acc")
        return before == after and all(
            np.array_equal(*self.pair(name)) for name in names
        )

    @property
    def distance(self) -> float:
        """Root mean square of the differences above the limit."""
        counted = np.where(self.differs, np.minimum(self.relative, 2.0), 0.0)
        return float(np.sqrt(np.mean(counted**2)))

    def is_close(self, name: str, index: int) -> bool:
        """Return whether both sides agree in a state, up to rounding."""
        first, second = (values[index] for values in self.pair(name))
        size = max(np.linalg.norm(first), np.linalg.norm(second))
        return bool(np.linalg.norm(first - second) <= ROUNDING * size)


def _parting(
    gap: Gap, index: int, states: Arrays, names: Mapping[str, list[str]]
) -> Parting:
    """Return the difference of two sides in a state.

    Args:
        gap: The differences.
        index: The state.
        states: Segment and step of each state; `of` is the side that visits it.
        names: Names of geoms and degrees of freedom.
    """
    quantity, detail = _cause(gap, index, names["geom"])
    kind = "step_acc" if gap.is_close("qacc", index) else "qacc"
    difference = np.abs(np.subtract(*gap.pair(kind))[index])
    dof = int(np.argmax(np.nan_to_num(difference, nan=np.inf)))
    place = {name: states[name][index].item() for name in ("segment", "step", "of")}
    for when, side in zip(("before", "after"), gap.sides, strict=True):
        place[f"acceleration_{when}"] = float(side[kind][index, dof])
        for name in ("contacts", "iterations", "warnings"):
            place[f"{name}_{when}"] = int(side[name][index])
    return Parting(
        quantity=quantity,
        detail=detail,
        where=names["dof"][dof],
        acceleration=float(gap.relative[index]),
        limit=float(gap.limit[index]),
        **place,
    )


def _cause(gap: Gap, index: int, geoms: list[str]) -> tuple[Quantity, str]:
    """Return the quantity that differs first in the order of computation, and both values in words."""
    before, after = (touching[index] for touching in gap.touching)
    for pair in sorted({*before, *after}, key=_geoms):
        first, second = before.get(pair, []), after.get(pair, [])
        title = " and ".join(geoms[geom] for geom in _geoms(pair))
        if len(first) != len(second):
            text = f"{title}: {len(first)} and {len(second)} contacts"
            return Quantity.CONTACTS, text
        changes_m = np.abs(np.subtract(first, second))
        contact = int(np.argmax(changes_m))
        if changes_m[contact] > DEPTH_TOLERANCE_M:
            depths_mm = (-1e3 * first[contact], -1e3 * second[contact])
            return Quantity.DEPTH, "{}: {:.6g} and {:.6g} mm".format(title, *depths_mm)
    if not gap.is_close("smooth", index):
        return Quantity.SMOOTH, "the accelerations without contacts and limits differ"
    if not gap.is_close("qacc", index):
        first, second = gap.pair("iterations")
        counts = f"{first[index]} and {second[index]}"
        text = f"equal contacts, different forces; the solver took {counts} iterations"
        return Quantity.CONSTRAINT, text
    return Quantity.STEP, "equal accelerations; the velocities after the step differ"


def _geoms(pair: str) -> tuple[int, ...]:
    """Return the indices of the geoms of a pair."""
    return tuple(map(int, pair.split()))


# --- laws ------------------------------------------------------------------------------------------------------------


def _rulings(
    bench: Bench,
    sides: Sequence[Side],
    gap: Gap,
    states: Arrays,
    fields: Mapping[str, Any],
) -> Iterator[Ruling]:
    """Yield each applicable law with the error of each side, in the states that differ most.

    Args:
        bench: The bench.
        sides: Both sides.
        gap: Differences of both sides.
        states: The states.
        fields: Compiled fields of the first side.
    """
    worst = gap.worst[:MAX_SOLVED]
    solved = {name: states[name][worst] for name in states}
    exact = [replace(side, settings={**side.settings, **EXACT}) for side in sides]
    outputs = bench.work("probe", exact, solved)
    misses = []
    for output, solution in zip(gap.outputs, outputs, strict=True):
        arrays = {name: output.arrays[name][worst] for name in output.arrays}
        misses.append(Gap(Output(output.description, arrays), solution).relative)
    yield _ruling(SOLVER_LAW, np.array(misses), SOLVER_LIMIT, sides)
    depths = list(_depth_misses(gap, worst, fields))
    if depths:
        yield _ruling(DEPTH_LAW, np.transpose(depths), DEPTH_LIMIT, sides)


def _ruling(
    law: str, misses: FloatArray, limit: float, sides: Sequence[Side]
) -> Ruling:
    """Return the side that satisfies a law, from errors of shape [2, states]."""
    before, after = misses.max(axis=1).tolist()
    right = ""
    if max(before, after) > max(limit, LAW_RATIO * min(before, after)):
        right = sides[int(before > after)].title
    count = misses.shape[1]
    return Ruling(law=law, before=before, after=after, states=count, right=right)


def _depth_misses(
    gap: Gap, states: Sequence[int], fields: Mapping[str, Any]
) -> Iterator[FloatArray]:
    """Yield the relative error of each side in the depth of a pair of boxes."""
    positions_m, rotations = (gap.sides[0][f"geom_x{name}"] for name in ("pos", "mat"))
    for index in states:
        contacts = [touching[index] for touching in gap.touching]
        for pair in sorted({*contacts[0], *contacts[1]}):
            geoms = _geoms(pair)
            if any(fields["geom_type"][geom] != BOX for geom in geoms):
                continue
            boxes = [
                corners_m(
                    fields["geom_size"][geom],
                    positions_m[index, geom],
                    rotations[index, geom].reshape(3, 3),
                )
                for geom in geoms
            ]
            true_m = depth_m(*boxes)
            if true_m > MIN_DEPTH_M:
                depths_m = np.array(
                    [-min(distances_m.get(pair, [0.0])) for distances_m in contacts]
                )
                yield np.abs(depths_m - true_m) / true_m


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
