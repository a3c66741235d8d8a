"""Verification: how well an engine solves the stated scene, in units of what its solution leaves open.

A law or a solved model answers another question than real trials do (ASME V&V 20): not whether a scene is like
reality, but whether an engine solves it. So a distance to them has fields of its own, and is never divided by the
scatter of real trials.

A solved model of cloth or foam is compared by the positions of its markers: they see the motion, where the published
observables of some scenes do not (a swinging sheet stays developable, so that its angle deficits vanish). Mass and
stiffness hardly change a driven motion; they change the force that drives it, which is a further quantity.

Interval. An observed distance d = |x - r| has the error e of the reference r, whose root mean square is the stated
uncertainty u; its correlation over frames and coordinates is not known. d scatters most where a normal e has one
direction, that of the true difference: d = |L + e| with a true distance L. The interval is Neyman's inversion of that:
it holds each L for which d is at least L - 1.96 u, and at most what 95 % of such values are below. It reaches 0 where
d <= 1.96 u. At L = 0 a normal e with any correlation has |e| <= 1.96 u in at least 95 % (Szekely and Bakirov, "Extremal
probabilities for Gaussian quadratic forms", 2003); that other L are covered is tested. An inversion for two directions
or more is shorter, but fails where an engine errs as the reference does (`studies/coverage`).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gauge_envs.references.bands import Band
from gauge_envs.references.grips import GripLoad
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scoring.numerics import normal_probability, rising_root

COVERAGE_FACTOR = 1.96
"""Half width of a 95 % interval over the standard uncertainty."""

LEAST_FROZEN = 5.0
"""Distance of a scene in which nothing moves, in units of u, below which a reference tells nothing. It is a choice."""

MARKER_AXES = 3
"""Coordinates of a marker."""

MOST_NAMED = 4
"""Number of coordinates that are named one by one."""


@dataclass(frozen=True, kw_only=True)
class Verification:
    """Distance of an episode from the solution of the calibrated scene, also where an engine ran another one.

    Attributes:
        grade: Grade of the reference: `law` or `model`.
        quantity: What is compared, as `positions of 63 markers`.
        unit: Unit of the distances.
        distance: Root mean square over the compared frames; over markers too where these are compared.
        distance_95: 95 % interval of the distance from the exact solution; None where the reference is exact.
        uncertainty: Standard uncertainty u of the reference, in the same norm; None where it is exact.
        frozen: Distance of a scene in which nothing moves, in the same norm; of a load, that of no load.
        frames: Number of compared frames; of a load, of windows.
    """

    grade: str
    quantity: str
    unit: str
    distance: float
    distance_95: tuple[float, float] | None
    uncertainty: float | None
    frozen: float
    frames: int

    @property
    def scale(self) -> float:
        """What distances are divided by: u, or 1 where the solution is exact.

        An exact solution has no u, and the motion is no scale: some scenes do not move, as a cube that sticks.
        """
        return self.uncertainty or 1.0

    @property
    def scale_unit(self) -> str:
        """Unit of a distance over `scale`: `u`, or the unit of the distance where the solution is exact."""
        return "u" if self.uncertainty else self.unit

    @property
    def scaled(self) -> float:
        """The distance over `scale`: what tables and ranks show."""
        return self.distance / self.scale

    @property
    def scaled_95(self) -> tuple[float, float] | None:
        """95 % interval of `scaled`; None where the solution is exact."""
        if self.distance_95 is None:
            return None
        low, high = self.distance_95
        return low / self.scale, high / self.scale

    @property
    def verdict(self) -> str:
        """What the distance says, in words."""
        if self.uncertainty is None:
            return "the solution of the calibrated scene is exact: there, the distance is the error"
        if self.frozen < LEAST_FROZEN * self.uncertainty:
            return f"tells nothing: a scene in which nothing moves is within {LEAST_FROZEN:g} u"
        if self.distance <= COVERAGE_FACTOR * self.uncertainty:
            return "no difference from the solution is seen"
        return "differs from the solution"


def verification_band(band: Band | None) -> Band | None:
    """Return the band that verification compares with, that of markers where there is one; None for other grades."""
    if band is None or not band.grade.is_solution:
        return None
    return band.points or band


def verify(
    band: Band | None, *, frames: FloatArray, markers_m: FloatArray | None
) -> Verification | None:
    """Return how far an episode is from the solution of its scene.

    Args:
        band: Reference of the score.
        frames: g(t) at the 30 Hz frames, in the band's unit, shape [frame_count, coordinate_count].
        markers_m: Positions of the markers at the frames [m], shape [frame_count, marker_count, 3]; None if unknown.

    Returns:
        The verification; None for other grades than `law` and `model`, and where markers are compared but unknown.
    """
    compared = verification_band(band)
    if compared is None or band is None:
        return None
    deviation = frame_deviation(band, frames=frames, markers_m=markers_m)
    if deviation is None:
        return None
    errors = point_lengths(deviation, compared)
    count = compared_points(compared)
    if count > 1:
        quantity = f"positions of {count} markers"
    elif len(compared.coordinates) > MOST_NAMED:
        quantity = f"{len(compared.coordinates)} coordinates of g(t)"
    else:
        quantity = ", ".join(compared.coordinates)
    return _verification(
        grade=band.grade.value,
        quantity=quantity,
        unit=compared.unit,
        distance=root_mean_square(errors),
        uncertainty=solution_uncertainty(band),
        frozen=frozen_distance(compared),
        frames=int(np.isfinite(errors).sum()),
    )


def verify_loads(
    loads: Sequence[GripLoad],
    band: Band | None,
    *,
    holders: tuple[str, ...],
    wrenches: FloatArray | None,
) -> tuple[Verification, ...]:
    """Return how far the loads of an episode are from those of the solution of its scene.

    Args:
        loads: The solved loads.
        band: Reference of the score, whose grade they share.
        holders: Names of the bodies that hold cloth or foam.
        wrenches: Their wrenches in the mean over each frame, shape [frame_count, len(holders), 6]; None if unknown.
    """
    if band is None or wrenches is None:
        return ()
    found = []
    for load in loads:
        values = load.values(holders, wrenches)
        if not np.isfinite(values).all():
            continue
        found.append(
            _verification(
                grade=band.grade.value,
                quantity=load.quantity,
                unit=load.unit,
                distance=load_length(values - load.mean),
                uncertainty=load_length(load.uncertainty),
                frozen=load_length(load.mean),
                frames=len(load.windows),
            )
        )
    return tuple(found)


def load_length(values: FloatArray) -> float:
    """Return the length of a load, shape [W, C], root mean square over its windows."""
    return math.sqrt(float(np.square(values).sum(axis=1).mean()))


def _verification(
    *,
    grade: str,
    quantity: str,
    unit: str,
    distance: float,
    uncertainty: float | None,
    frozen: float,
    frames: int,
) -> Verification:
    """Return a verification with the interval of its distance."""
    interval = None
    if uncertainty:
        low, high = inverted_interval(distance / uncertainty)
        interval = low * uncertainty, high * uncertainty
    return Verification(
        grade=grade,
        quantity=quantity,
        unit=unit,
        distance=distance,
        distance_95=interval,
        uncertainty=uncertainty,
        frozen=frozen,
        frames=frames,
    )


def inverted_interval(distance: float) -> tuple[float, float]:
    """Return the 95 % interval of a true distance L from an observed one |L + e|, both in u; see the module.

    Args:
        distance: The observed distance over u, 0 or more.
    """

    def excess(true: float) -> float:
        """Return the chance of a value above the observed one or below the least one of its true distance, less 5 %."""
        above = normal_probability(true - distance)
        above += normal_probability(-true - distance)
        below = normal_probability(-COVERAGE_FACTOR)
        below -= normal_probability(COVERAGE_FACTOR - 2.0 * true)
        return above + max(below, 0.0) - 0.05

    low = 0.0
    if excess(0.0) < 0.0:
        low = rising_root(excess, 0.0, distance)
    return low, distance + COVERAGE_FACTOR


def frame_deviation(
    band: Band, *, frames: FloatArray, markers_m: FloatArray | None
) -> FloatArray | None:
    """Return the motion minus the mean at each frame, shape [frame_count, coordinate_count].

    Args:
        band: The reference; its `points` are compared where it has any.
        frames: g(t) at the first 30 Hz frames, shape [at most frame_count, coordinate_count].
        markers_m: Markers at the same frames [m], shape [at most frame_count, marker_count, 3]; None if unknown.

    Returns:
        The deviation, NaN where the mean or the motion is not known; None where markers are compared but unknown.
    """
    if band.points is None:
        compared, motion = band, band.project(frames)
    elif markers_m is not None and markers_m.size:
        compared, motion = band.points, 1e3 * markers_m.reshape(len(markers_m), -1)
    else:
        return None
    whole = np.full(compared.mean.shape, np.nan)
    count = min(len(motion), len(whole))
    whole[:count] = motion[:count]
    return whole - compared.mean


def compared_points(compared: Band) -> int:
    """Return the number of markers whose positions are the coordinates of a band; 1 for other coordinates."""
    names = compared.coordinates
    is_of_markers = names[0].startswith("marker-") and names[0].endswith(".x")
    return len(names) // MARKER_AXES if is_of_markers else 1


def point_lengths(values: FloatArray, compared: Band) -> FloatArray:
    """Return the length of values at each frame, root mean square over markers where these are compared.

    Args:
        values: Values in the coordinates of the band, shape [frame_count, C].
        compared: The band; its coordinates `marker-0.x` are those of markers.

    Returns:
        Lengths over known coordinates, NaN at frames at which the mean is not known, shape [frame_count].
    """
    known = np.isfinite(compared.mean)
    count = compared_points(compared)
    squares = np.where(known, np.square(values), 0.0).sum(axis=1) / count
    return np.where(known.any(axis=1), np.sqrt(squares), np.nan)


def frozen_distance(compared: Band) -> float:
    """Return the distance of a scene in which nothing moves from the mean of a band."""
    first = int(np.isfinite(compared.mean).any(axis=1).argmax())
    return root_mean_square(
        point_lengths(compared.mean - compared.mean[first], compared)
    )


def solution_uncertainty(band: Band) -> float | None:
    """Return u of the solution that a band of grade `law` or `model` states, over frames; None where it is exact."""
    compared = verification_band(band)
    if compared is None or band.is_exact:
        return None
    return root_mean_square(point_lengths(stated_uncertainty(compared), compared))


def stated_uncertainty(compared: Band) -> FloatArray:
    """Return u of the mean of a solution that is not exact, shape [frame_count, coordinate_count].

    A law of a user's file has a sigma alone.
    """
    return compared.sigma if compared.uncertainty is None else compared.uncertainty


def drawn_spread(band: Band) -> FloatArray:
    """Return what a picture shades about a mean: the scatter of real trials, or u of a solution, 0 if it is exact."""
    if not band.grade.is_solution:
        return band.sigma
    return np.zeros_like(band.mean) if band.is_exact else stated_uncertainty(band)


def root_mean_square(lengths: FloatArray) -> float:
    """Return the root mean square over known frames."""
    return math.sqrt(float(np.nanmean(np.square(lengths))))
