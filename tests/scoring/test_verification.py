"""Verification: distances by hand, coverage of the interval for errors of any correlation, power of references."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from pydantic import TypeAdapter, ValidationError
from scipy.special import erf

from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.experiments.variants import variants
from gauge_envs.references.band import Band
from gauge_envs.references.kind import Kind
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scoring.reference import reference_band
from gauge_envs.scoring.score import VERIFICATION, Score, Validation
from gauge_envs.scoring.verification import (
    LEAST_FROZEN,
    Verification,
    compared_points,
    inverted_interval,
    solution_uncertainty,
    stated_uncertainty,
    verification_band,
    verify,
)

FRAMES = 40


def solution(uncertainty_mm: FloatArray | None, *, markers: int = 0) -> Band:
    """Return a body, or markers, that move by 100 mm along x in `FRAMES` frames."""
    mean = np.zeros((FRAMES, 3 * max(markers, 1)))
    mean[:, ::3] = np.linspace(0.0, 100.0, FRAMES)[:, None]
    band = Band(
        grade=Kind.NUMERICAL,
        unit="mm",
        coordinates=tuple(
            f"marker-{n // 3}.{'xyz'[n % 3]}" for n in range(mean.shape[1])
        )
        if markers
        else ("x", "y", "z"),
        projection=np.eye(mean.shape[1]),
        mean=mean,
        sigma=np.zeros_like(mean),
        measured=np.ones(FRAMES, dtype=bool),
        trial_count=None,
        source="a test",
        uncertainty=uncertainty_mm,
    )
    return replace(band, points=band) if markers else band


def verified(band: Band, motion_mm: FloatArray) -> Verification:
    markers = None if band.points is None else 1e-3 * motion_mm.reshape(FRAMES, -1, 3)
    found = verify(band, frames=motion_mm, markers_m=markers)
    assert found is not None
    return found


@pytest.mark.parametrize("markers", [0, 5])
def test_a_shift_of_3_mm_is_a_distance_of_3_mm_of_a_body_and_of_each_marker(
    markers: int,
) -> None:
    u_mm = 0.5
    width = 3 * max(markers, 1)
    band = solution(np.full((FRAMES, width), u_mm / np.sqrt(3.0)), markers=markers)
    moved = np.array(band.mean)
    moved[:, 1::3] += 3.0
    found = verified(band, moved)
    assert found.distance == pytest.approx(3.0)
    assert found.uncertainty == pytest.approx(u_mm)
    assert found.scaled == pytest.approx(6.0)
    ends = pytest.approx((3.0 - 1.96 * u_mm, 3.0 + 1.96 * u_mm), rel=1e-4)
    assert found.distance_95 == ends
    # At 3 u the other tail is as good as empty, and the lower end is that of one tail of 5 %.
    moved[:, 1::3] -= 1.5
    low, high = verified(band, moved).distance_95
    assert low == pytest.approx(1.5 - 1.645 * u_mm, rel=1e-3)
    assert high == pytest.approx(1.5 + 1.96 * u_mm)
    assert found.verdict.startswith("differs")
    # The mean square of 100 k / 39 for k = 0 to 39.
    steps = np.arange(FRAMES) / (FRAMES - 1)
    assert found.frozen == pytest.approx(100.0 * np.sqrt(np.mean(steps**2)))


def test_a_frozen_scene_has_the_distance_that_is_stated_and_differs() -> None:
    band = solution(np.full((FRAMES, 15), 1.0), markers=5)
    found = verified(band, np.tile(band.mean[0], (FRAMES, 1)))
    assert found.distance == pytest.approx(found.frozen)
    assert found.verdict.startswith("differs")


def test_a_reference_that_nothing_differs_from_tells_nothing() -> None:
    band = solution(np.full((FRAMES, 3), 50.0))
    found = verified(band, np.array(band.mean))
    assert found.frozen < LEAST_FROZEN * found.uncertainty
    assert found.verdict.startswith("tells nothing")


def test_an_exact_solution_has_no_interval() -> None:
    band = replace(solution(np.full((FRAMES, 3), 1.0)), is_exact=True)
    found = verified(band, np.array(band.mean))
    assert (found.distance, found.distance_95, found.uncertainty) == (0.0, None, None)


def test_markers_are_needed_where_they_are_compared_and_trials_verify_nothing() -> None:
    band = solution(np.ones((FRAMES, 15)), markers=5)
    assert verify(band, frames=np.array(band.mean), markers_m=None) is None
    real = replace(solution(None), grade=Kind.TRIALS)
    assert verify(real, frames=np.array(real.mean), markers_m=None) is None
    assert verify(None, frames=np.array(real.mean), markers_m=None) is None


def test_each_true_distance_is_held_in_95_percent_whatever_the_directions_of_the_error() -> (
    None
):
    """The error has a share of u^2 along the true difference, and the rest across it; by quadrature over the first."""
    observed = np.arange(0.0, 11.0, 0.01)
    ends = np.array([inverted_interval(float(one)) for one in observed])
    assert (ends[observed <= 1.959, 0] == 0.0).all()
    assert (np.diff(ends, axis=0) >= 0.0).all()
    z = np.arange(-6.0, 6.0, 0.005)
    weights = np.exp(-0.5 * z**2) * 0.005 / np.sqrt(2.0 * np.pi)
    for true in (0.0, 0.25, 0.5, 1.0, 1.5, 1.95, 2.0, 3.0, 5.0):
        held = (ends[:, 0] <= true) & (true <= ends[:, 1])
        low, high = observed[held][0], observed[held][-1]
        shares = []
        for along in np.linspace(0.0, 1.0, 11):
            parallel = true + np.sqrt(along) * z
            across = np.sqrt(max(1.0 - along, 1e-12))
            # The chance that the part across the difference leaves the whole between both ends.
            inside = [
                erf(np.sqrt(np.maximum(end**2 - parallel**2, 0.0) / 2.0) / across)
                for end in (low, high)
            ]
            shares.append(float(weights @ (inside[1] - inside[0])))
        # The grid of observed distances moves each end by less than 0.01.
        assert min(shares) >= 0.95 - 0.005
        # With one direction it is 95 %.
        assert shares[-1] == pytest.approx(0.95, abs=0.005)


@pytest.mark.parametrize("shapes", [1, 60])
@pytest.mark.parametrize("true_in_u", [0.0, 1.0, 5.0])
def test_the_interval_holds_the_true_distance_for_errors_in_few_and_many_directions(
    shapes: int, true_in_u: float
) -> None:
    random = np.random.default_rng([7, shapes, int(10 * true_in_u)])
    band = solution(np.full((FRAMES, 3), 1.0 / np.sqrt(3.0)))
    worlds = 600
    inside = 0
    for _ in range(worlds):
        # Errors of the reference along orthonormal shapes with shares of u^2 that sum to 1.
        directions = np.linalg.qr(random.standard_normal((3 * FRAMES, shapes)))[0]
        shares = random.dirichlet(np.ones(shapes))
        parts = np.sqrt(shares) * random.standard_normal(shapes)
        error = (np.sqrt(FRAMES) * directions @ parts).reshape(FRAMES, 3)
        offset = random.standard_normal((FRAMES, 3))
        offset *= true_in_u / np.sqrt(np.square(offset).sum() / FRAMES)
        found = verified(band, np.array(band.mean) + offset - error)
        assert found.distance_95 is not None
        low, high = found.distance_95
        inside += low <= true_in_u <= high
    # Three standard deviations of 600 draws at 95 %.
    assert inside / worlds >= 0.95 - 3.0 * np.sqrt(0.95 * 0.05 / worlds)


LEVELS = (0.0, 0.5, 1.0, 2.0, 5.0)
"""True distances over u."""

WORLDS = 200


def worlds(
    name: str, correlation_frames: float, *, shared: bool
) -> Iterator[tuple[float, tuple[float, float]]]:
    """Yield the true distance over u, and its interval, of an engine that is off at a constant rate."""
    band = reference_band(load_experiment(name))
    compared, u = verification_band(band), solution_uncertainty(band)
    known = np.isfinite(compared.mean).any(axis=1)
    spread = np.nan_to_num(stated_uncertainty(compared)[known])
    count, width = spread.shape
    apart = np.subtract.outer(np.arange(count), np.arange(count)) / correlation_frames
    root = np.linalg.cholesky(np.exp(-0.5 * apart**2) + 1e-6 * np.eye(count))
    norm = np.sqrt(count * compared_points(compared))
    used = np.isfinite(compared.mean[known])
    random = np.random.default_rng(
        [91, *name.encode(), int(correlation_frames), shared]
    )
    for level in LEVELS:
        for _ in range(WORLDS):
            drawn = random.standard_normal((count, 1 if shared else width))
            error = spread * (root @ drawn)
            rate = np.outer(np.linspace(0.0, 1.0, count), random.standard_normal(width))
            rate *= used
            motion = np.nan_to_num(compared.mean)
            motion[known] += rate * level * u * norm / np.linalg.norm(rate) - error
            markers_m = 1e-3 * motion.reshape(-1, width // 3, 3)
            found = verify(
                band,
                frames=motion,
                markers_m=None if band.points is None else markers_m,
            )
            assert found.scaled_95 is not None
            yield level, found.scaled_95


@pytest.mark.parametrize("shared", [True, False])
@pytest.mark.parametrize(
    "correlation_frames",
    [10.0, *(pytest.param(one, marks=pytest.mark.slow) for one in (0.1, 1e4))],
)
@pytest.mark.parametrize("name", ["Turntable-3-wood", "TextileBending-leather"])
def test_the_interval_holds_the_true_distance_for_errors_with_the_stated_shape(
    name: str, correlation_frames: float, shared: bool
) -> None:
    """Errors have the stated u of each frame and coordinate; an engine is off at a constant rate."""
    inside: dict[float, list[bool]] = {}
    for true, (low, high) in worlds(name, correlation_frames, shared=shared):
        inside.setdefault(true, []).append(low <= true <= high)
    for held in inside.values():
        assert np.mean(held) >= 0.95 - 3.0 * np.sqrt(0.95 * 0.05 / len(held))


def test_scores_of_earlier_versions_are_read_without_what_they_divided_by_trials() -> (
    None
):
    """Version 0.2 divided the distance from a law by the scatter of real trials, and named `rmse` the first score. What
    is divided by it stood beside `rmse`."""
    old = {
        "unit": "mm",
        "primary": "rmse",
        "rmse": 0.25,
        "rmse_normalized": 0.125,
        "rmse_normalized_95": [0.0, 0.5],
        "dtw": 0.2,
        "dtw_normalized": 0.1,
        "inside_1sigma": 1.0,
        "mte": 0.9,
        "mte_normalized": 0.97,
    }
    law = Score.from_dict(old | {"grade": "law"})
    # Result files are read by their types, and not by `from_dict`.
    assert law == TypeAdapter(Score).validate_python(old | {"grade": "law"})
    assert (law.rmse, law.dtw, law.mte_normalized) == (0.25, 0.2, 0.97)
    assert law.validation is None
    assert (law.primary, law.primary_normalized) == (VERIFICATION, None)
    trials = Score.from_dict(old | {"grade": "trials"})
    assert (trials.primary, trials.primary_normalized) == ("rmse", 0.125)
    assert trials.validation == Validation(
        rmse_normalized=0.125,
        rmse_normalized_95=(0.0, 0.5),
        dtw_normalized=0.1,
        inside_1sigma=1.0,
    )
    assert Score.from_dict(trials.to_dict()) == trials
    assert Score.from_dict(old | {"grade": "none", "primary": None}).validation is None


def test_a_score_answers_one_question() -> None:
    solved = verified(solution(np.ones((FRAMES, 3))), np.zeros((FRAMES, 3)))
    assert Score(grade="model", unit="mm", verification=solved).primary_normalized
    for grade, given in (
        ("law", {"validation": Validation()}),
        ("trials", {"verification": solved}),
    ):
        with pytest.raises(ValueError, match="has no v"):
            Score(grade=grade, unit="mm", **given)
        with pytest.raises(ValidationError, match="has no v"):
            Score.from_dict({"grade": grade, "unit": "mm"} | given)


def references() -> list[tuple[str, Band]]:
    found = []
    for variant in variants():
        band = reference_band(load_experiment(variant.name))
        if band is not None and verification_band(band) is not None:
            found.append((variant.name, band))
    return found


def test_every_solved_reference_tells_a_scene_in_which_nothing_moves() -> None:
    frozen_in_u = {}
    for name, band in references():
        compared = verification_band(band)
        assert compared is not None
        motion = np.nan_to_num(compared.mean)
        markers = (
            None if band.points is None else 1e-3 * motion.reshape(len(motion), -1, 3)
        )
        found = verify(band, frames=motion, markers_m=markers)
        assert found is not None
        if found.uncertainty is not None:
            frozen_in_u[name] = found.frozen / found.uncertainty
    weak = {name for name, size in frozen_in_u.items() if size < LEAST_FROZEN}
    assert len(frozen_in_u) > 30 and not weak
