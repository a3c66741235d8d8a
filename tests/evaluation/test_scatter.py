"""Scatter of runs beside that of real trials: numbers by hand, size without a fault, and faults that are told."""

import math
from dataclasses import replace

import numpy as np
import pytest

from gauge_envs.errors import UnknownNameError
from gauge_envs.evaluation.metrics.trajectory import trajectory_dtw
from gauge_envs.evaluation.scatter import (
    LEVEL,
    NOT_TESTED,
    TELLS_NOTHING,
    TOLD_SHARE,
    VERDICTS,
    differs,
    is_held,
    published_numbers,
    refused_scatter,
    scatter_ranks,
    scatter_test,
    scatter_text,
)
from gauge_envs.evaluation.scatter_groups import (
    HELD_LATE_S,
    SPREADS,
    TRIAL_COUNT,
    GroupModel,
    Spread,
    delayed,
    drawn_noises,
    dtw_of_pairs,
    group_models,
    group_scores,
    marker_noise,
)
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.pages.document import Paragraph
from gauge_envs.pages.table import Table
from gauge_envs.references.published import published_baselines, published_variants
from gauge_envs.references.scatter import held_rows, scatter_rows
from gauge_envs.runs.episodes import planned_results, run_episodes
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result_file import load_result, write_result
from gauge_envs.runs.scatter import with_scatter
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.jitter import Jitter
from gauge_envs.tools.compare.comparison import compare
from gauge_envs.tools.compare.words import comparison_document
from gauge_envs.tools.run.words import summary_document

FRAMES = 12
TIMES_S = np.arange(6 * FRAMES) / 180
ACCELERATION_MM_PER_S2 = 2700.0
LATE_S = 0.04


def slides(
    count: int, *, seed: int, start_mm: float = 1.0, veer_mm: float = 0.0
) -> FloatArray:
    """Return slides from starts that scatter, shape [count, sample_count, 3].

    Args:
        count: Number of slides.
        seed: Seed of the starts.
        start_mm: Standard deviation of each coordinate of the start.
        veer_mm: Standard deviation of a sideways displacement at the last frame, which grows with time.
    """
    random = np.random.default_rng(seed)
    path = np.zeros((count, len(TIMES_S), 3))
    path[:, :, 0] = 0.5 * ACCELERATION_MM_PER_S2 * TIMES_S**2
    path[:, :, :2] += start_mm * random.standard_normal((count, 1, 2))
    veer = veer_mm * random.standard_normal((count, 1))
    path[:, :, 1] += veer * TIMES_S / TIMES_S[-1]
    return path


def reality(random: np.random.Generator, slid: FloatArray) -> FloatArray:
    """Return the four numbers of trials, each another slide and late."""
    runs = random.choice(len(slid), TRIAL_COUNT, replace=False)[None]
    delays_s = LATE_S * np.abs(random.standard_normal(runs.shape))
    return group_scores(delayed(slid, runs, delays_s, FRAMES))[0]


@pytest.mark.parametrize("width", [3, 20])
def test_dtw_of_pairs_is_that_of_each_pair(width: int) -> None:
    random = np.random.default_rng(0)
    firsts, seconds = random.standard_normal((2, 30, 9, width))
    expected = [trajectory_dtw(a, b) for a, b in zip(firsts, seconds, strict=True)]
    np.testing.assert_allclose(dtw_of_pairs(firsts, seconds), expected, rtol=1e-12)


def test_trials_at_0_0_and_3_mm_are_1_1_and_2_mm_from_their_mean() -> None:
    trials = np.zeros((1, 3, 5, 3))
    trials[0, 2, :, 1] = 3.0
    mean_mm, std_mm = 4.0 / 3.0, math.sqrt(1.0 / 3.0)
    np.testing.assert_allclose(
        group_scores(trials)[0], [mean_mm, std_mm, mean_mm, std_mm], rtol=1e-12
    )


def test_bodies_at_rest_are_as_far_from_their_mean_as_normal_starts() -> None:
    # An offset from the mean of n has the variance (1 - 1 / n) sigma^2 in x and y; its length is Rayleigh distributed.
    at_rest = np.repeat(slides(4000, seed=1)[:, :1], 12, axis=1)
    runs = np.arange(4000).reshape(200, TRIAL_COUNT)
    scores = group_scores(delayed(at_rest, runs, np.zeros(runs.shape), 2))
    expected_mm = math.sqrt(0.5 * math.pi * (1.0 - 1.0 / TRIAL_COUNT))
    assert scores[:, 0].mean() == pytest.approx(expected_mm, rel=0.03)
    np.testing.assert_allclose(scores[:, :2], scores[:, 2:], rtol=1e-9)


def test_a_late_body_rests_and_then_moves_as_one_in_time() -> None:
    slid = slides(1, seed=0, start_mm=0.0)
    late_s = 0.05
    late = delayed(slid, np.array([0]), np.array([late_s]), FRAMES)[0, :, 0]
    since_s = np.maximum(np.arange(FRAMES) / 30 - late_s, 0.0)
    # Linear between samples, a parabola is wrong by a h^2 / 8 at most.
    tolerance_mm = ACCELERATION_MM_PER_S2 / 180**2 / 8
    expected_mm = 0.5 * ACCELERATION_MM_PER_S2 * since_s**2
    np.testing.assert_allclose(late, expected_mm, atol=1.01 * tolerance_mm)


@pytest.mark.parametrize("seed_count", [1, pytest.param(4, marks=pytest.mark.slow)])
def test_the_size_is_5_percent_and_a_fault_is_told(seed_count: int) -> None:
    right_p, wrong_p = [], []
    for seed in range(seed_count):
        samples = {
            share: slides(40, seed=seed, start_mm=share, veer_mm=2.0 * share)
            for share in SPREADS
        }
        models = group_models(samples, FRAMES, seed=seed).values()
        random = np.random.default_rng(100 + seed)
        right = slides(200, seed=1000 + seed, veer_mm=2.0)
        wrong = slides(200, seed=2000 + seed, veer_mm=20.0)
        for _ in range(40):
            for slid, found in ((right, right_p), (wrong, wrong_p)):
                one = reality(random, slid)
                found.append([model.answer(one, "").p_value for model in models])
    refused = np.mean([one[SPREADS.index(1.0)] < LEVEL for one in right_p])
    # Three standard deviations of a binomial share.
    scatter = 3.0 * math.sqrt(LEVEL * (1.0 - LEVEL) / len(right_p))
    assert max(LEVEL - scatter, 0.0) < refused < LEVEL + scatter
    assert np.mean([differs(one) is True for one in right_p]) < 0.07
    assert np.mean([differs(one) is True for one in wrong_p]) > 0.9


def test_the_spread_of_the_release_is_found() -> None:
    model = GroupModel(slides(40, seed=0), FRAMES)
    random = np.random.default_rng(7)
    slid = slides(200, seed=1)
    answers = [model.answer(reality(random, slid), "") for _ in range(60)]
    found_s = np.median([one.release_s for one in answers])
    assert found_s == pytest.approx(LATE_S, rel=0.15)
    inside = [one.release_95_s[0] <= LATE_S <= one.release_95_s[1] for one in answers]
    assert np.mean(inside) > 0.85


def test_one_answer_is_a_verdict_and_two_are_none() -> None:
    assert differs([0.2, 0.05]) is False
    assert differs([0.01, 0.049]) is True
    assert differs([0.01, 0.05]) is None


@pytest.mark.parametrize(
    ("p_values", "ranks"),
    [
        # No difference, a difference, an answer that hangs on the starts, no test.
        ([[0.5, 0.5], [0.01, 0.01], [0.5, 0.01], None], [1, 2, None, None]),
        ([[0.01, 0.01], [0.5, 0.5], [0.6, 0.7]], [3, 1, 1]),
        ([[0.5, 0.5], [0.9, 0.9]], [None, None]),
        ([[0.01, 0.01], [0.02, 0.01], [0.5, 0.01]], [None, None, None]),
    ],
)
def test_only_different_verdicts_are_ranked(
    p_values: list[list[float] | None], ranks: list[int | None]
) -> None:
    empty = refused_scatter(load_experiment("SlopeContact-plastic"), "a test")
    answers = [
        None
        if group is None
        else replace(
            empty,
            spreads=tuple(
                Spread(
                    starts="",
                    release_s=0.0,
                    release_95_s=(0.0, 0.0),
                    simulated=empty.real,
                    p_value=p_value,
                )
                for p_value in group
            ),
        )
        for group in p_values
    ]
    assert scatter_ranks(answers) == ranks
    mute = [None if one is None else replace(one, tells=False) for one in answers]
    assert scatter_ranks(mute) == [None] * len(answers)


def test_repeats_as_many_as_trials_have_a_scatter(tmp_path) -> None:
    request = RunRequest("SlopeSlider-1-wood", repeats=TRIAL_COUNT, jitter=Jitter())
    results = run_episodes(request)
    scatter = results[0].scatter
    assert scatter is not None
    line = published_baselines("SlopeSlider-1-wood")
    assert scatter.real[:2] == (line["rmse"].mean, line["rmse"].std)
    # The cube holds, so its scatter is that of the starts: 1 mm in both directions of the board.
    by_starts = {one.starts: one for one in scatter.spreads}
    expected_mm = math.sqrt(0.5 * math.pi * (1.0 - 1.0 / TRIAL_COUNT))
    for starts, share in (("x 0.5", 0.5), ("x 1", 1.0), ("x 2", 2.0)):
        simulated_mm = by_starts[starts].simulated[0]
        assert simulated_mm == pytest.approx(share * expected_mm, rel=0.3)
    file = tmp_path / "one.json"
    write_result(results[0], file)
    assert load_result(file).scatter == scatter
    fewer = run_episodes(RunRequest("SlopeSlider-1-wood", repeats=2, jitter=Jitter()))
    assert fewer[0].scatter is None
    (table,) = (
        part
        for part in summary_document(results).parts
        if isinstance(part, Table) and part.title.endswith("as real trials do?")
    )
    assert [row["real_dtw"] for row in table.rows] == ["0.59 (0.28) mm"]
    comparison = comparison_document(compare(results))
    cells = [
        one["scatter"]
        for row in comparison.rows
        for one in row.get("configurations", [])
        if "scatter" in one
    ]
    assert cells
    assert all(cell["verdict"] == scatter.verdict for cell in cells)


def test_an_impossible_unit_and_no_published_scatter_have_no_answer() -> None:
    request = RunRequest("TextileBending-satin", repeats=TRIAL_COUNT, jitter=Jitter())
    planned = planned_results(request)
    assert with_scatter(request, planned) == planned
    with pytest.raises(UnknownNameError):
        refused_scatter(load_experiment("Pendulum-metal"), "")


def test_noise_of_markers_changes_areas_by_half_the_root_of_their_squared_sides() -> (
    None
):
    experiment = load_experiment("FoamStretching-soft")
    markers = experiment.scene.markers
    assert markers is not None
    places_m = np.asarray(markers.positions_m)
    noise = marker_noise(experiment, np.repeat(places_m[None], 20, axis=0))
    # The gradient of an area by a corner is half the opposite side.
    corners_mm = 1e3 * places_m[np.asarray(markers.faces)]
    sides_mm = np.linalg.norm(corners_mm - np.roll(corners_mm, 1, axis=1), axis=2)
    expected = 0.5 * np.sqrt(np.square(sides_mm).sum(axis=1))
    np.testing.assert_allclose(noise.std(axis=(0, 1)), expected, rtol=0.08)


def test_the_noise_of_markers_is_found_beside_late_and_misplaced_ones() -> None:
    random = np.random.default_rng(5)
    noise = random.standard_normal((60, FRAMES, 12))
    samples = np.zeros((140, 6 * FRAMES, 12))
    # Motions and starts of less than the noise.
    samples[:, :, :3] = 0.01 * slides(140, seed=4, start_mm=10.0)
    model = GroupModel(samples[:40], FRAMES, noise=noise, seed=1)
    real_mm, found_mm, refused = 0.12, [], 0
    for _ in range(40):
        runs = random.choice(np.arange(40, 140), TRIAL_COUNT, replace=False)[None]
        delays_s = HELD_LATE_S * np.abs(random.standard_normal(runs.shape))
        trials = delayed(samples, runs, delays_s, FRAMES)
        trials += real_mm * noise[drawn_noises(random, noise, 1)]
        one = model.answer(group_scores(trials)[0], "")
        found_mm.append(one.noise_mm)
        refused += one.p_value < LEVEL
        assert one.release_s == HELD_LATE_S
    assert np.median(found_mm) == pytest.approx(real_mm, rel=0.1)
    assert refused <= 6


def test_each_published_scatter_has_an_answer_and_that_of_held_bodies_tells_no_engine() -> (
    None
):
    answers: dict[str, set[str]] = {"scatter": set(), "held": set(), "unit": set()}
    for name in published_variants():
        experiment = load_experiment(name)
        if published_numbers(experiment.baselines) is None:
            continue
        if experiment.impossible_scores:
            answers["unit"].add(name)
        else:
            answers["held" if is_held(experiment) else "scatter"].add(name)
    assert answers["scatter"] == set(scatter_rows())
    untested = answers["held"] - set(held_rows())
    assert {scatter_text(load_experiment(name)) for name in untested} <= {NOT_TESTED}
    assert [len(one) for one in answers.values()] == [27, 20, 6]
    for name, row in held_rows().items():
        assert scatter_text(load_experiment(name)).endswith(TELLS_NOTHING)
        told = {fault: share or 0.0 for fault, share in row.told.items()}
        assert told.pop("none") <= LEVEL, name
        del told["frozen"]
        assert max(told.values()) < TOLD_SHARE, name


@pytest.mark.slow
def test_repeats_of_held_foam_have_the_stored_answer() -> None:
    request = RunRequest("FoamStretching-soft", repeats=TRIAL_COUNT, jitter=Jitter())
    scatter = run_episodes(request)[0].scatter
    assert scatter is not None and not scatter.tells
    assert scatter.verdict.endswith(TELLS_NOTHING)
    row = held_rows()["FoamStretching-soft"]
    middle = next(one for one in scatter.spreads if one.starts == "x 1")
    assert middle.noise_mm == pytest.approx(row.noise_mm, rel=0.2)


def test_the_verdict_is_that_of_all_assumptions() -> None:
    experiment = load_experiment("SlopeContact-plastic")
    # Slides that never collide cannot scatter as the published trials do, which end in a collision.
    samples = {share: slides(40, seed=3, start_mm=0.01 * share) for share in SPREADS}
    found = scatter_test(experiment, samples)
    assert [one.starts for one in found.spreads] == ["x 0.5", "x 1", "x 2", "uneven"]
    assert found.differs is differs([one.p_value for one in found.spreads])
    assert found.verdict == VERDICTS[found.differs]


@pytest.mark.parametrize(("count", "is_told"), [(5, True), (10, False)])
def test_an_interval_of_few_trials_is_printed_with_what_it_lacks(count, is_told):
    (result,) = run_episodes(RunRequest("SlopeSlider-2-wood"))
    found = replace(result.score.validation, trial_count=count)
    few = replace(result, score=replace(result.score, validation=found))
    lines = [
        part.text
        for part in summary_document([few]).parts
        if isinstance(part, Paragraph)
    ]
    assert any("86 to 98 %" in line for line in lines) is is_told
