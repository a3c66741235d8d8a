"""Engines side by side: what is a repeat and what a configuration, means and distances against closed forms."""

import json
from dataclasses import replace

import approval
import numpy as np
import pytest
from matplotlib.colors import to_hex
from rich.console import Console

from gauge_envs.errors import ResultFileError, UnknownNameError
from gauge_envs.experiments.task_files import task_sha256, task_spec
from gauge_envs.files import versions
from gauge_envs.pages.document import as_rows
from gauge_envs.pages.figures import OURS
from gauge_envs.pages.markdown import as_markdown
from gauge_envs.pages.results import SCORE_METRICS, configuration_labels
from gauge_envs.pages.terminal import Terminal
from gauge_envs.references.published import published_baselines
from gauge_envs.runs.episodes import run_episode
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result import Outcome, RecordedTrajectory, Result
from gauge_envs.runs.result_file import (
    recorded_experiment,
    result_file_name,
    write_result,
)
from gauge_envs.scoring.estimates import Measured
from gauge_envs.scoring.reference import reference_band
from gauge_envs.scoring.score import Score, score_trajectory
from gauge_envs.tools.compare.comparison import compare
from gauge_envs.tools.compare.difference import ScoreSpread
from gauge_envs.tools.compare.distance import MOTION_SHARE
from gauge_envs.tools.compare.experiment_figure import draw_experiment
from gauge_envs.tools.compare.overview_figure import draw_overview
from gauge_envs.tools.compare.words import (
    check_metrics,
    comparison_document,
    comparison_rows,
)

SLIDER, PLASTIC, FOAM, CRADLE = (
    "SlopeSlider-2-wood",
    "SlopeSlider-2-plastic",
    "SlopeSlider-3-wood",
    "NewtonsCradle-metal",
)
KINDS = {SLIDER: "trials", PLASTIC: "trials", FOAM: "none", CRADLE: "none"}
RATE_HZ = 180

TURNED, DRIVEN, SOLVED = (
    "Turntable-1-wood",
    "SlopeSlider-3-metal",
    "SlopeSlider-3-plastic",
)
"""Experiments of the kinds analytic, recording and numerical."""


def recorded(motion, *, seconds=1.0):
    """A recorded trajectory of one cube: motion(times) gives x, y, z in mm, or a constant."""
    times = np.arange(round(seconds * RATE_HZ) + 1) / RATE_HZ
    samples = np.broadcast_to(np.asarray(motion(times), dtype=float).T, (len(times), 3))
    return RecordedTrajectory(
        unit="mm",
        coordinates=["cube.x", "cube.y", "cube.z"],
        times_s=times.tolist(),
        samples=samples,
    )


def still(_):
    return [0.0, 0.0, 0.0]


def along(speed_mm_per_s):
    return lambda times: [speed_mm_per_s * times, 0.0 * times, 0.0 * times]


def made(
    name=SLIDER,
    *,
    backend="mujoco",
    rmse=None,
    motion=still,
    seconds=1.0,
    engine="1.0",
    **changes,
):
    """A result as an engine would leave it; rmse is the normalized one."""
    family = name.split("-")[0]
    score = Score(
        kind=KINDS[name],
        unit="mm",
        primary="rmse",
        rmse_normalized=rmse,
        rmse=None if rmse is None else 18.0 * rmse,
    )
    values = {
        "id": f"GAUGE/{name}",
        "outcome": Outcome.FINISHED,
        "parameters": "calibrated",
        "score": score,
        "task_sha256": task_sha256(family),
        "revision": task_spec(family).revision,
        "backend": backend,
        "frames": round(seconds * 30) + 1,
        "wall_s": 2.0 * seconds,
        "sim_s": seconds,
        "versions": {backend: engine, **versions()},
        "seed": 0,
        "trajectory": recorded(motion, seconds=seconds),
    }
    return Result(**(values | changes))


def diverged(name=SLIDER, *, backend="newton", seconds=0.5, **changes):
    return replace(
        made(name, backend=backend, seconds=seconds),
        outcome=Outcome.DIVERGED,
        diverged=True,
        diverged_reason="a body is 1e6 m away",
        **changes,
    )


def declined(name=SLIDER, *, backend="newton"):
    return replace(
        made(name, backend=backend),
        outcome=Outcome.DECLINED,
        error="it knows no cubes",
        versions=versions(),
        trajectory=None,
        wall_s=None,
        sim_s=0.0,
    )


def printed(results, *metrics):
    console = Console(width=300)
    with console.capture() as capture:
        console.print(
            Terminal(
                comparison_document(compare(results), metrics or tuple(SCORE_METRICS)),
                wide=True,
            )
        )
    return capture.get()


def cells(results, metric="rmse"):
    """Texts of the row of a metric, a column a configuration."""
    comparison = compare(results)
    markdown = as_markdown(comparison_document(comparison, [metric]))
    title = f"| {SCORE_METRICS[metric].title} |"
    row = next(line for line in markdown.splitlines() if title in line)
    return [cell.strip() for cell in row.strip("|").split("|")][4:-3]


# --- configurations and repeats ---


def test_results_that_differ_in_their_seed_alone_are_one_cell():
    comparison = compare(
        [made(rmse=value, seed=seed) for seed, value in enumerate([1.0, 2.0, 3.0])]
    )
    ((cell,),) = [one.cells for one in comparison.experiments]
    assert [result.seed for result in cell.results] == [0, 1, 2]
    assert cell.spread("rmse", normalized=True) == ScoreSpread(
        mean=2.0, std=1.0, count=3
    )
    assert cells(
        [made(rmse=value, seed=seed) for seed, value in enumerate([1.0, 2.0, 3.0])]
    ) == ["2.00 +- 1.00 (3)"]


@pytest.mark.parametrize(
    ("changes", "label"),
    [
        ({"backend": "newton"}, "newton"),
        ({"parameters": "effective"}, "mujoco, effective"),
        ({"parameters": {"cube.friction": 0.25}}, "mujoco, cube.friction=0.25"),
        ({"settings_given": {"timestep_s": 1 / 900}}, "mujoco, timestep_s=0.001111"),
        ({"engine": "2.0"}, "mujoco, mujoco 2.0"),
    ],
)
def test_whatever_else_differs_makes_another_configuration(changes, label):
    comparison = compare([made(**changes), made(), made(seed=1)])
    labels = configuration_labels(comparison.configurations)
    assert label in labels
    assert len(labels) == len(set(labels)) == 2
    assert labels[0] in ("mujoco", "mujoco, mujoco 1.0")


def test_a_jittered_start_is_another_configuration_than_the_nominal_one():
    jittered = {"jitter": {"position_m": 0.001, "angle_rad": 0.01}}
    comparison = compare([made(seed=1, **jittered), made(), made(seed=2, **jittered)])
    assert configuration_labels(comparison.configurations) == [
        "mujoco",
        "mujoco, jitter position_m=0.001 angle_rad=0.01",
    ]
    assert [len(cell.results) for cell in comparison.experiments[0].cells] == [1, 2]


def test_the_label_of_a_single_configuration_is_full_and_others_leave_out_what_all_share():
    fine = {"settings_given": {"timestep_s": 0.5}}
    assert configuration_labels(compare([made(**fine)]).configurations) == [
        "mujoco, calibrated, timestep_s=0.5"
    ]
    both = compare([made(**fine), made(backend="newton", **fine)])
    assert configuration_labels(both.configurations) == ["mujoco", "newton"]
    assert "All configurations: calibrated, timestep_s=0.5." in printed(
        [made(**fine), made(backend="newton", **fine)]
    )


def test_labels_that_round_to_the_same_are_stated_in_full():
    steps = [
        made(settings_given={"timestep_s": step}) for step in (0.125, 0.125 + 2**-20)
    ]
    labels = configuration_labels(compare(steps).configurations)
    assert sorted(labels) == [
        "mujoco, timestep_s=0.125",
        "mujoco, timestep_s=0.12500095367431641",
    ]


def test_of_two_results_of_one_seed_the_latest_counts():
    old = made(rmse=5.0, created="2026-01-01T00:00:00+00:00")
    new = made(rmse=1.0, created="2026-01-02T00:00:00+00:00")
    comparison = compare([new, old])
    assert cells([new, old]) == ["1.00"]
    assert "the latest of each counts" in comparison.notes[0]


def test_results_that_do_not_belong_together_are_reported():
    stale = made(task_sha256="0" * 64)
    older = made(
        PLASTIC, versions={"mujoco": "1.0", **versions(), "gauge-envs": "0.0.1"}
    )
    notes = " ".join(compare([stale, older]).notes)
    assert "another task file than the installed one: SlopeSlider-2-wood" in notes
    assert "different versions of gauge-envs: 0.0.1, " in notes
    assert compare([made(), made(PLASTIC)]).notes == ()


def test_an_older_revision_is_compared_only_with_its_own():
    old = [made(rmse=5.0), made(rmse=6.0, backend="newton")]
    newer = old[0].revision + 1
    new = made(rmse=1.0, revision=newer, parameters="effective")
    both = compare([*old, new])
    assert [one.parameters for one in both.configurations] == ["effective"]
    assert (
        "SlopeSlider-2-wood: results of an older revision are left out; compare them apart"
        in both.notes
    )
    assert cells(old) == ["5.00", "6.00"]
    with pytest.raises(
        ResultFileError,
        match=f"has revision {newer}, and the installed package revision {newer - 1}: use gauge-envs",
    ):
        recorded_experiment(new)


# --- scores ---


def test_cells_say_why_there_is_no_score():
    results = [made(rmse=0.5), diverged(), made(backend="other")]
    assert cells(results) == ["0.50", "diverged", "no score"]
    assert cells([made(rmse=0.5), made(PLASTIC, backend="newton", rmse=1.0)]) == [
        "0.50",
        "-",
    ]
    assert cells([made(rmse=0.5), declined()]) == ["0.50", "declined"]


def test_repeats_that_diverged_are_counted_and_leave_the_cell_unscored_in_the_summary():
    results = [
        made(backend="newton", rmse=1.0),
        made(backend="newton", rmse=3.0, seed=1),
        diverged(seed=2),
    ]
    assert cells(results) == ["2.00 +- 1.41 (2), 1 diverged"]
    comparison = compare(results)
    (summary,) = comparison.summaries()
    assert (summary.ran, summary.scored, summary.diverged) == (1, 0, 1)
    assert comparison.kinds == ()


def test_a_raw_score_without_baseline_is_stated_in_its_unit():
    assert cells(
        [made(score=Score(kind="trials", unit="mm", primary="rmse", rmse=12.5))]
    ) == ["12.50 mm"]


def test_a_declined_result_without_versions_joins_the_configuration_that_ran():
    comparison = compare([declined(), made(PLASTIC, backend="newton", rmse=1.0)])
    assert len(comparison.configurations) == 1
    (summary,) = comparison.summaries()
    assert (summary.ran, summary.not_run) == (1, 1)


def test_rankings_can_leave_out_what_this_package_corrects(tmp_path, gauge):
    # Rapier has no corrections, and out_of_box leaves MuJoCo as it is delivered; MuJoCo's default preset is corrected.
    for result in (
        made(),
        made(backend="rapier"),
        made(settings_given={"preset": "out_of_box"}),
    ):
        write_result(result, tmp_path / result_file_name(result))
    every, left = (
        gauge("compare", tmp_path, "--format", "json", *words)
        for words in ([], ["--no-corrected"])
    )
    labels = [
        [
            one["label"]
            for one in json.loads(run.stdout.splitlines()[0])["configurations"]
        ]
        for run in (every, left)
    ]
    assert labels == [
        ["mujoco", "mujoco, preset=out_of_box", "rapier"],
        ["mujoco, preset=out_of_box", "rapier"],
    ]
    assert "left out: 1 result with corrections by this package" in left.stderr
    assert "left out" not in every.stderr


def test_nothing_to_compare():
    assert "no results to compare" in printed([])
    assert comparison_rows(compare([])) == []
    assert as_rows(comparison_document(compare([]))) == []


# --- kinds ---


@pytest.fixture(scope="module")
def real():
    """Results of MuJoCo of every kind, by variant."""
    return {
        name: replace(run_episode(RunRequest(name)), wall_s=1.0)
        for name in (SLIDER, PLASTIC, TURNED, DRIVEN, SOLVED)
    }


def altered(result, scale, **changes):
    """A result whose displacements are scaled, scored again."""
    trajectory = result.trajectory
    start = trajectory.samples[0]
    moved = replace(
        trajectory,
        samples=start + scale * (trajectory.samples - start),
        later_samples=start + scale * (trajectory.later_samples - start),
    )
    experiment = recorded_experiment(result)
    times_s, values = moved.arrays(later=True)
    band = reference_band(experiment)
    score = score_trajectory(experiment, band, times_s=times_s, values=values)
    return replace(result, trajectory=moved, score=score, **changes)


def as_newton(result, **changes):
    """The same result under another engine's name."""
    return replace(
        result, backend="newton", versions={"newton": "1.0", **versions()}, **changes
    )


def under_two_names(real, *names):
    return [one for name in names for one in (real[name], as_newton(real[name]))]


def kind(comparison, name):
    return next(one for one in comparison.kinds if one.name == name)


def test_each_kind_has_its_own_means_and_nothing_else_changes_them(real):
    trials, others = (
        under_two_names(real, SLIDER, PLASTIC),
        under_two_names(real, TURNED, DRIVEN, SOLVED),
    )
    alone, together = compare(trials), compare([*others, *trials])
    names = ["trials", "recording", "analytic", "numerical"]
    assert [one.name for one in together.kinds] == names
    assert kind(alone, "trials") == kind(together, "trials")
    ours = kind(together, "trials").scores[0]
    aligned = [real[name].score.rmse_aligned_normalized for name in (SLIDER, PLASTIC)]
    assert ours.mean.value == pytest.approx(np.mean(aligned))
    assert ours.mean_rank.value == 1.5
    for name, solved in (("analytic", TURNED), ("numerical", SOLVED)):
        assert kind(together, name).ids == (f"GAUGE/{solved}",)
        mean = kind(together, name).scores[0].mean
        assert mean.value == pytest.approx(real[solved].score.over_uncertainty)


def test_published_engines_stand_beside_raw_scores_of_trials_alone(real):
    comparison = compare(list(real.values()))
    rows = {
        (row["id"], row["metric"]): row["published"]
        for row in comparison_rows(comparison)
    }
    assert (
        rows[f"GAUGE/{SLIDER}", "rmse"] == published_baselines(SLIDER)["rmse"].engines
    )
    assert rows[f"GAUGE/{SLIDER}", "rmse_aligned"] is None
    assert {rows[f"GAUGE/{name}", "rmse"] for name in (TURNED, DRIVEN, SOLVED)} == {
        None
    }


def test_published_constants_are_not_ranked_against_other_ones(real):
    changed = replace(real[SLIDER], parameters="effective")
    other = as_newton(altered(changed, 1.5))
    found = compare([real[SLIDER], as_newton(real[SLIDER]), changed, other]).kinds
    assert [one.name for one in found] == ["trials", "trials, effective"]
    assert [len(one.scores) for one in found] == [2, 2]
    text = printed([real[SLIDER], as_newton(real[SLIDER]), changed, other])
    assert "trials, effective, 1 experiment" in text


def test_only_experiments_that_all_have_scored_are_ranked(real):
    third = altered(real[SLIDER], 1.1, settings_given={"timestep_s": 0.001})
    both = [
        real[SLIDER],
        real[PLASTIC],
        as_newton(real[SLIDER]),
        as_newton(real[PLASTIC]),
    ]
    one = kind(compare([*both, third]), "trials")
    assert one.ids == (f"GAUGE/{SLIDER}",)


def test_identical_trajectories_tie(real):
    comparison = compare(under_two_names(real, *real))
    assert len(comparison.kinds) == 4
    for one in comparison.kinds:
        for experiment in one.experiments:
            ranks = [rank.value for rank in experiment.ranks.values()]
            assert ranks == [1.5, 1.5]


def test_a_large_difference_ranks(real):
    wrong = {name: as_newton(altered(real[name], 1.5)) for name in (SLIDER, PLASTIC)}
    comparison = compare([*wrong.values(), real[SLIDER], real[PLASTIC]])
    trials = kind(comparison, "trials")
    assert [score.mean_rank.interval_95 for score in trials.scores] == [(1, 1), (2, 2)]


def test_repeats_are_paired_by_seed_and_averaged(real):
    scales = {1: 0.9, 2: 1.0, 3: 1.1}
    ours = [altered(real[SLIDER], scale, seed=seed) for seed, scale in scales.items()]
    theirs = [as_newton(result) for result in ours[1:]]
    ranks = [one.mean_rank for one in kind(compare([*ours, *theirs]), "trials").scores]
    assert [(one.value, one.interval_95) for one in ranks] == [(1.5, (1, 2))] * 2
    (score, *_) = kind(compare(ours), "trials").scores
    mean = np.mean([result.score.primary_normalized for result in ours])
    assert score.mean.value == pytest.approx(mean)
    # Over one experiment, a mean has the interval of the cell that shows the same score.
    (one,) = compare(ours).experiments
    assert score.mean.interval_95 == one.cells[0].interval_95(one.primary)
    # Repeats that differ widen the interval: their scatter is part of the uncertainty of the mean.
    (alone, *_) = kind(compare(ours[1:2]), "trials").scores
    widths = [
        one.mean.interval_95[1] - one.mean.interval_95[0] for one in (score, alone)
    ]
    assert widths[0] > widths[1]


def test_a_score_that_is_not_of_its_trajectory_is_not_ranked(real):
    score = real[SLIDER].score
    stale = replace(real[SLIDER], score=replace(score, rmse_aligned_normalized=0.3))
    comparison = compare([stale, as_newton(real[SLIDER])])
    assert len(kind(comparison, "trials").scores) == 1
    assert any("another reference or motion" in note for note in comparison.notes)


def test_a_refused_score_is_its_sentence_and_has_no_rank(real):
    moon = {"scene.gravity_m_per_s2": 1.62}
    sentence = "no score: the trials reference is of the real scene, and this one differs: gravity"
    refused = Score(kind="trials", unit="mm", refused=sentence)
    other = replace(real[SLIDER], parameters=moon, score=refused)
    comparison = compare([real[SLIDER], other])
    assert f"{SLIDER}: {sentence}" in comparison.notes
    assert [len(one.scores) for one in comparison.kinds] == [1]
    row = comparison_rows(comparison, ["rmse"])[0]["configurations"]
    assert [one["reasons"] for one in row] == [[None], [sentence]]
    assert [one["verdicts"] for one in row] == [["outside"], ["no reference"]]


def test_a_trajectory_that_does_not_fit_the_experiment_is_not_ranked():
    comparison = compare([made(rmse=0.5, seconds=0.1)])
    assert comparison.kinds == ()
    assert any("another reference or motion" in note for note in comparison.notes)


def test_results_of_two_references_are_not_averaged(real):
    imported = as_newton(
        real[SLIDER], dataset={"drivers": "bundled", "reference": "imported"}
    )
    comparison = compare(
        [
            real[SLIDER],
            replace(imported, score=replace(imported.score, kind="recording")),
        ]
    )
    assert comparison.kinds == ()
    assert any("references of kind" in note for note in comparison.notes)


def test_the_primary_metric_has_its_interval_and_an_event_has_its_ratio():
    score = Score(
        kind="trials",
        unit="mm",
        primary="rmse",
        rmse=9.0,
        rmse_95=(4.5, 27.0),
        rmse_normalized=0.5,
        events={"mte": Measured(value=0.4, unit="1", real=0.8)},
    )
    assert cells([made(score=score)]) == ["0.50 [0.25, 1.50]"]
    assert cells([made(score=score)], "mte") == ["0.50"]


# --- distances ---


def distance(*results):
    (experiment,) = compare(results).experiments
    (far,) = experiment.distances
    return far


def test_drifting_apart_crosses_the_published_scatter_of_real_trials_when_it_should():
    # 60 mm/s apart reach the published 24.27 mm after 0.4045 s, so at the 13th frame, 0.4333 s.
    far = distance(made(FOAM), made(FOAM, backend="newton", motion=along(60.0)))
    assert far.threshold == 24.27
    assert far.apart_at_s == pytest.approx(13 / 30)
    frames = np.arange(31) / 30
    assert far.rms.mean == pytest.approx(60.0 * np.sqrt(np.mean(frames**2)))
    assert far.motion_rms == pytest.approx(60.0 * np.sqrt(np.mean(frames**2) / 2))


def test_without_a_published_scatter_the_threshold_is_a_share_of_the_motion():
    # x = v t and 1.1 v t: apart by 5 % of the mean square of both motions once 0.1 v t is.
    far = distance(
        made(CRADLE, motion=along(100.0)),
        made(CRADLE, backend="newton", motion=along(110.0)),
    )
    positions = np.concatenate([np.arange(31) / 30 * speed for speed in (100.0, 110.0)])
    threshold = MOTION_SHARE * np.sqrt(np.mean(positions**2))
    assert not far.threshold_is_scatter
    assert far.threshold == pytest.approx(threshold)
    assert far.apart_at_s == pytest.approx(np.ceil(threshold / 10.0 * 30) / 30)
    text = printed(
        [
            made(CRADLE, motion=along(100.0)),
            made(CRADLE, backend="newton", motion=along(110.0)),
        ]
    )
    assert "Where engines disagree" in text
    assert "* not published: 5% of the motion" in text


def test_only_common_finite_frames_count():
    def explodes(times):
        return [np.where(times > 0.3, np.inf, 10.0), 0.0 * times, 0.0 * times]

    lost = diverged(FOAM)
    far = distance(
        made(FOAM, seconds=2.0),
        replace(lost, trajectory=recorded(explodes, seconds=0.5)),
    )
    assert (far.rms.mean, far.frames, far.diverged) == (10.0, 10, True)


def test_no_distance_where_one_did_not_run_or_recorded_something_else():
    assert compare([made(FOAM), declined(FOAM)]).experiments[0].distances == ()
    other = made(FOAM, backend="newton")
    renamed = replace(other.trajectory, coordinates=["ball.x", "ball.y", "ball.z"])
    assert (
        compare([made(FOAM), replace(other, trajectory=renamed)])
        .experiments[0]
        .distances
        == ()
    )


def test_repeats_are_compared_seed_by_seed():
    def start(x):
        return lambda _: [x, 0.0, 0.0]

    ours = [made(FOAM, seed=seed, motion=start(100.0 * seed)) for seed in (1, 2, 3)]
    theirs = [
        made(FOAM, backend="newton", seed=seed, motion=start(100.0 * seed + seed))
        for seed in (1, 2, 3)
    ]
    far = distance(*ours, *theirs)
    assert (far.rms.mean, far.rms.std, far.rms.count) == (2.0, 1.0, 3)
    apart = distance(ours[0], ours[1], theirs[2])
    assert (apart.rms.mean, apart.rms.count) == ((203.0 + 103.0) / 2, 2)


# --- output ---


def test_metrics_are_checked_and_kept_in_order():
    assert check_metrics([]) == tuple(SCORE_METRICS)
    assert check_metrics(["dtw", "rmse", "dtw"]) == ("dtw", "rmse")
    with pytest.raises(UnknownNameError, match="did you mean rmse"):
        check_metrics(["rsme"])


# --- pictures ---


def test_repeats_are_lines_of_one_colour_and_configurations_keep_theirs():
    repeats = [
        made(backend="newton", rmse=1.0, seed=seed, motion=along(10.0 * seed))
        for seed in range(3)
    ]
    among = [made(PLASTIC, rmse=1.0), *repeats]
    figure = draw_experiment(repeats, among=among)
    curves = [
        line
        for line in figure.axes[0].get_lines()
        if to_hex(line.get_color()) in OURS and len(line.get_xdata())
    ]
    assert len(curves) == 3
    assert {to_hex(line.get_color()) for line in curves} == {OURS[1]}
    texts = [text.get_text() for text in figure.axes[0].get_legend().get_texts()]
    assert "newton, 3 repeats" in texts


def test_engines_without_a_reference_get_a_panel_of_their_distance():
    # A cube of another friction is not the one that was solved.
    other = {
        "parameters": {"cube.friction": 0.2},
        "score": Score(kind="numerical", unit="mm", refused="no score: it differs"),
    }
    figure = draw_experiment(
        [made(FOAM, **other), made(FOAM, backend="newton", motion=along(60.0), **other)]
    )
    panel = next(axis for axis in figure.axes if "distance" in axis.get_ylabel())
    heights = max(panel.get_lines(), key=lambda line: len(line.get_ydata())).get_ydata()
    assert heights == pytest.approx(60.0 * np.arange(31) / 30)
    alone = draw_experiment([made(FOAM, motion=along(60.0), **other)]).axes[0]
    (moved,) = alone.get_lines()
    assert moved.get_ydata() == pytest.approx(60.0 * np.arange(31) / 30)


def test_rounding_errors_do_not_fill_a_panel():
    figure = draw_experiment([made(FOAM, motion=along(60.0))])
    panels = [axis for axis in figure.axes if "%" in axis.get_title(loc="left")]
    limits = [axis.get_ylim() for axis in panels]
    assert len(limits) == 3
    widest = max(high - low for low, high in limits)
    assert all(high - low >= 0.019 * widest for low, high in limits)


def places_of(axis):
    """Places of the dots of a panel."""
    return {
        float(line.get_xdata()[0]) for line in axis.get_lines() if len(line.get_xdata())
    }


def test_overview_has_every_score_where_it_belongs():
    comparison = compare(
        [made(rmse=0.41), diverged(), made(PLASTIC, backend="newton", rmse=2.0)]
    )
    figure = draw_overview(comparison, metric="rmse")
    (axis,) = figure.axes
    assert {0.41, 2.0, 1.23, 0.53, 1.71, 0.48, 0.82, 0.51, 1.0} <= places_of(axis)
    assert axis.get_xscale() == "log"
    assert [tick.get_text() for tick in axis.get_yticklabels()] == [
        f"{SLIDER}  (trials)",
        f"{PLASTIC}  (trials)",
    ]
    assert draw_overview(compare([made(rmse=0.41)]), metric="el") is None


def test_overview_shows_intervals_and_published_engines_beside_raw_trials_alone(real):
    figure = draw_overview(compare([real[SLIDER], real[TURNED]]))
    primary, raw, solved = figure.axes
    score = real[SLIDER].score
    assert score.rmse_aligned_normalized in places_of(primary)
    # The distance from a solution has an axis of its own, over u.
    assert real[TURNED].score.over_uncertainty in places_of(solved)
    assert "over u" in solved.get_xlabel()
    assert score.rmse_normalized in places_of(raw)
    published = {
        name: set(published_baselines(name)["rmse"].engines.values())
        for name in (SLIDER, TURNED)
    }
    assert published[SLIDER] <= places_of(raw)
    assert not published[SLIDER] & places_of(primary)
    assert not published[TURNED] & places_of(raw)
    bars = [
        tuple(path.vertices[:, 0])
        for bar in primary.collections
        for path in bar.get_paths()
    ]
    assert any(
        bar == pytest.approx(score.primary_interval) for bar in bars if len(bar) == 2
    )


# --- the command ---


def write(folder, *results):
    for result in results:
        write_result(result, folder / result_file_name(result))


LOSS = Score(
    kind="none",
    unit="mm",
    events={
        "lsd": Measured(value=0.19, unit="s", real=0.38),
        "mte": Measured(value=0.2, unit="1", real=1.0),
    },
)
MADE = (
    made(rmse=0.41),
    made(rmse=0.61, seed=1),
    made(rmse=5.0, settings_given={"a_b": 1}),
    diverged(),
    declined(PLASTIC),
    made(FOAM),
    made(FOAM, backend="newton", motion=along(60.0)),
    made(CRADLE, score=LOSS, motion=along(100.0)),
    made(CRADLE, backend="newton", motion=along(110.0)),
)
"""One result of each outcome, a repeat, another setting, and engines that drift apart."""


def test_the_output_is_the_approved_one(gauge, approved, tmp_path):
    write(tmp_path, *MADE)
    result = gauge("compare", ".")
    assert result.exit_code == 1
    approved("compare/compare", approval.readable(result))


def test_ranks_are_the_approved_ones(gauge, approved, tmp_path, real):
    wrong = as_newton(altered(real[SLIDER], 1.5))
    write(tmp_path, real[SLIDER], real[PLASTIC], real[TURNED], wrong)
    write(tmp_path, as_newton(real[PLASTIC]), as_newton(real[TURNED]))
    result = gauge("compare", ".", "--json", "--metric=rmse")
    approved("compare/real-json", approval.readable(result))


def test_a_damaged_file_is_skipped(gauge, tmp_path):
    write(tmp_path, made(rmse=0.41))
    (tmp_path / "cut.json").write_text("{")
    # A file that is given twice counts once.
    result = gauge("compare", ".", ".", "--json", "--metric=rmse")
    assert result.exit_code == 1
    assert "cut.json: not a result file" in result.stderr
    first = json.loads(result.stdout.splitlines()[0])
    assert first["configurations"][0]["normalized"]["count"] == 1


def test_a_choice_that_matches_no_result_is_refused(gauge, tmp_path):
    write(tmp_path, made())
    assert gauge("compare", ".", "--only", "Slope*", "-b", "mujoco").exit_code == 0
    for words in (["--only", "Slope*,NoSuch-*"], ["-b", "mujoco,newton"]):
        refused = gauge("compare", ".", *words)
        assert refused.exit_code == 2
        assert f"{words[1].partition(',')[2]!r}" in refused.stderr


def test_wrong_requests_are_refused(gauge, approved):
    commands = ("compare nowhere", "compare", "compare --metric=rsme")
    approved("compare/refused", approval.refused_commands(gauge, *commands))
