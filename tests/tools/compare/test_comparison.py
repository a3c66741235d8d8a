"""Compare engines: repeats and configurations, scores, ranks, and distances against closed forms."""

import json
from dataclasses import replace

import numpy as np
import pytest

from gauge_envs.experiments.task_files import task_sha256, task_spec
from gauge_envs.references.published import published_baselines
from gauge_envs.registry import package_versions
from gauge_envs.runs.episodes import run_episode
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result import Outcome, RecordedTrajectory, Result
from gauge_envs.runs.result_file import (
    recorded_experiment,
    result_file_name,
    write_result,
)
from gauge_envs.scoring.estimates import ComparedQuantity
from gauge_envs.scoring.reference import reference_band
from gauge_envs.scoring.score import Score
from gauge_envs.scoring.trajectory import score_trajectory
from gauge_envs.tools.compare.comparison import compare
from gauge_envs.tools.compare.experiment_figure import draw_experiment
from gauge_envs.tools.compare.overview_figure import draw_overview
from gauge_envs.tools.compare.report import comparison_document
from gauge_envs.tools.compare.spool import TrajectorySpool

SLIDER, PLASTIC, FOAM, CRADLE, TURNED = (
    "SlopeSlider-2-wood",
    "SlopeSlider-2-plastic",
    "SlopeSlider-3-wood",
    "NewtonsCradle-metal",
    "Turntable-1-wood",
)
BAR = "FoamTwisting-soft"
KINDS = {SLIDER: "trials", PLASTIC: "trials", FOAM: "none", CRADLE: "none", BAR: "none"}
RATE_HZ = 180


def recorded(speed_mm_per_s, start_mm, seconds):
    """Return the trajectory of a cube that moves along x."""
    times_s = np.arange(round(seconds * RATE_HZ) + 1) / RATE_HZ
    samples = np.zeros((len(times_s), 3))
    samples[:, 0] = start_mm + speed_mm_per_s * times_s
    return RecordedTrajectory(
        unit="mm",
        coordinates=["cube.x", "cube.y", "cube.z"],
        times_s=times_s,
        samples=samples,
    )


def made(
    name=SLIDER,
    *,
    backend="mujoco",
    rmse=None,
    speed=0.0,
    start=0.0,
    seconds=1.0,
    **changes,
):
    """Return a result of an engine; `rmse` is normalized."""
    family = name.split("-")[0]
    score = Score(
        kind=KINDS[name],
        unit="mm",
        rmse_normalized=rmse,
        like_reality=None if rmse is None else "yes" if rmse < 2.0 else "no",
        rmse=None if rmse is None else 18.0 * rmse,
    )
    values = {
        "id": f"GAUGE/{name}",
        "outcome": Outcome.FINISHED,
        "parameters": "published",
        "score": score,
        "task_sha256": task_sha256(family),
        "revision": task_spec(family).revision,
        "backend": backend,
        "versions": {backend: "1.0", **package_versions()},
        "seed": 0,
        "trajectory": recorded(speed, start, seconds),
    }
    return Result(**(values | changes))


def diverged(name=SLIDER, **changes):
    ended = {
        "outcome": Outcome.DIVERGED,
        "diverged": True,
        "diverged_reason": "it left",
    }
    return made(name, **{"backend": "newton", "seconds": 0.5} | ended | changes)


# --- configurations and repeats ---


def test_the_latest_result_of_a_seed_and_the_newest_revision_count():
    old = made(rmse=5.0, created="2026-01-01T00:00:00+00:00")
    new = made(rmse=1.0, created="2026-01-02T00:00:00+00:00")
    comparison = compare([new, old])
    (cell,) = comparison.experiments[0].cells
    assert cell.values("rmse", normalized=True) == [1.0]
    assert "the latest of each counts" in comparison.notes[0]
    newer = replace(new, revision=old.revision + 1, parameters="measured")
    both = compare([old, newer])
    assert [item.parameters for item in both.configurations] == ["measured"]
    assert f"{SLIDER}: results of an older revision are left out" in both.notes[0]


def test_a_configuration_with_a_diverged_repeat_has_no_rank(real):
    end = {"outcome": Outcome.DIVERGED, "diverged": True, "seed": 1}
    comparison = compare([real[SLIDER], replace(real[SLIDER], **end)])
    assert comparison.experiments[0].cells[0].count(Outcome.DIVERGED) == 1
    assert comparison.kinds == ()


def test_results_that_do_not_belong_together_are_reported():
    older = {"mujoco": "1.0", **package_versions(), "gauge-envs": "0.0.1"}
    notes = " ".join(
        compare([made(task_sha256="0" * 64), made(PLASTIC, versions=older)]).notes
    )
    assert f"the task file differs from the installed one: {SLIDER}" in notes
    assert "different versions of gauge-envs: 0.0.1, " in notes
    assert compare([made(), made(PLASTIC)]).notes == ()
    imported = made(seed=1, dataset={"drivers": "imported", "reference": "imported"})
    (note,) = compare([made(), imported]).notes
    assert note.startswith(f"{SLIDER}: the references or the prescribed motions")


# --- kinds ---


@pytest.fixture(scope="module")
def real():
    """Return results of MuJoCo, by variant."""
    return {name: run_episode(RunRequest(name)) for name in (SLIDER, PLASTIC, TURNED)}


def altered(result, scale, **changes):
    """Return a result with scaled displacements and a new score."""
    trajectory = result.trajectory
    start = trajectory.samples[0]
    moved = replace(trajectory, samples=start + scale * (trajectory.samples - start))
    experiment = recorded_experiment(result)
    times_s, values = moved.arrays()
    band = reference_band(experiment)
    score = score_trajectory(experiment, band, times_s=times_s, values=values)
    return replace(result, trajectory=moved, score=score, **changes)


def as_newton(result, **changes):
    """Return the same result under the name of another engine."""
    engine = {"backend": "newton", "versions": {"newton": "1.0", **package_versions()}}
    return replace(result, **engine, **changes)


def ranks(kind):
    return [mean.interval_95 for mean in kind.mean_ranks.values()]


def answer(results):
    return comparison_document(compare(results)).parts[0].text


def test_kinds_are_ranked_apart_and_equal_motions_tie(real):
    both = [*real.values(), *map(as_newton, real.values())]
    trials, analytic = compare(both).kinds
    assert [trials.kind, analytic.kind] == ["trials", "analytic"]
    assert trials.ids == (f"GAUGE/{SLIDER}", f"GAUGE/{PLASTIC}")
    assert ranks(trials) == ranks(analytic) == [(1, 2), (1, 2)]
    shared = "Same on 3 of 3 experiments."
    assert answer(both) == shared
    # Only the wide report has mean ranks of fewer than three experiments.
    document = comparison_document(compare(both))
    ranks_title = "Mean rank within each kind of reference"
    assert ranks_title not in [part.title for part in document.parts[1:]]
    assert ranks_title in [part.title for part in document.markdown[1:]]


def test_a_large_difference_ranks(real):
    wrong = as_newton(altered(real[SLIDER], 1.5))
    (trials,) = compare([wrong, real[SLIDER], real[PLASTIC]]).kinds
    # The mean rank is over experiments that all configurations have scored.
    assert trials.ids == (f"GAUGE/{SLIDER}",)
    assert ranks(trials) == [(1, 1), (2, 2)]
    swapped = compare([altered(real[SLIDER], 1.5), as_newton(real[SLIDER])])
    *_, table = comparison_document(swapped, is_wide=True).parts
    assert [row["label"] for row in table.rows] == ["newton", "mujoco"]
    third = replace(wrong, backend="rapier", versions={"rapier": "1.0"})
    results = [real[SLIDER], wrong, third, *map(as_newton, [real[TURNED]])]
    best = "Closest: mujoco on 1 of 1 experiment."
    assert answer(results) == best
    assert answer([real[SLIDER]]).startswith("No ranks")


def test_a_score_that_differs_from_its_trajectory_is_not_ranked(real):
    score = replace(real[SLIDER].score, rmse_aligned_normalized=0.3)
    comparison = compare([replace(real[SLIDER], score=score), as_newton(real[SLIDER])])
    assert len(comparison.kinds[0].mean_ranks) == 1
    assert "another reference or motion" in comparison.notes[0]


# --- distances ---


def distance(*results):
    # The command keeps trajectories in a file.
    spool = TrajectorySpool()
    kept = [spool.put(result) for result in results]
    assert all(result.trajectory is None for result in kept)
    (experiment,) = compare(kept, spool.read).experiments
    (far,) = experiment.distances
    return far


def test_a_drift_exceeds_the_published_scatter_of_real_trials_at_the_expected_time():
    # A drift of 60 mm/s exceeds the published 24.27 mm after 0.4045 s: at frame 13, 0.4333 s.
    far = distance(made(FOAM), made(FOAM, backend="newton", speed=60.0))
    assert far.threshold == 24.27
    assert far.apart_at_s == pytest.approx(13 / 30)
    frames = np.arange(31) / 30
    assert far.rms.mean == pytest.approx(60.0 * np.sqrt(np.mean(frames**2)))
    assert far.motion_rms == pytest.approx(60.0 * np.sqrt(np.mean(frames**2) / 2))


def test_without_a_published_scatter_the_threshold_is_a_share_of_the_motion():
    # The distance of x = v t and x = 1.1 v t is 0.1 v t.
    far = distance(
        made(CRADLE, speed=100.0), made(CRADLE, backend="newton", speed=110.0)
    )
    positions = np.concatenate([np.arange(31) / 30 * speed for speed in (100.0, 110.0)])
    threshold = 0.05 * np.sqrt(np.mean(positions**2))
    assert (far.threshold, far.threshold_is_scatter) == (
        pytest.approx(threshold),
        False,
    )
    assert far.apart_at_s == pytest.approx(np.ceil(threshold / 10.0 * 30) / 30)


def test_only_common_finite_frames_count():
    lost = diverged(FOAM, start=10.0)
    lost.trajectory.samples[RATE_HZ * 3 // 10 + 1 :] = np.nan
    far = distance(made(FOAM, seconds=2.0), lost)
    assert (far.rms.mean, far.frames, far.diverged) == (10.0, 10, True)
    result = made(FOAM, backend="newton")
    renamed = replace(result.trajectory, coordinates=["ball.x", "ball.y", "ball.z"])
    results = [made(FOAM), replace(result, trajectory=renamed)]
    assert compare(results).experiments[0].distances == ()


def test_cloth_and_foam_are_compared_by_their_markers():
    """One of two markers moves by 100 and by 104 mm; g(t) is the curvature, which is the same."""
    results = []
    for backend, way_mm in (("mujoco", 100.0), ("newton", 104.0)):
        result = made(FOAM, backend=backend)
        places_mm = np.zeros((31, 6))
        places_mm[1:, 0] = way_mm
        trajectory = replace(result.trajectory, unit="rad", markers_mm=places_mm)
        results.append(replace(result, trajectory=trajectory))
    far = distance(*results)
    # The first frame is the start, at rest.
    moving = np.sqrt(30 / 31)
    assert (far.unit, far.frames, far.threshold_is_scatter) == ("mm", 31, False)
    assert far.rms.mean == pytest.approx(4.0 * moving / np.sqrt(2.0))
    mean_square = (100.0**2 + 104.0**2) / 2.0
    assert far.motion_rms == pytest.approx(np.sqrt(mean_square / 2.0) * moving)
    assert far.share_text == "3.92 %"


# --- the command ---


def write(folder, *results):
    for result in results:
        write_result(result, folder / result_file_name(result))


def test_the_tables_show_each_outcome(gauge, tmp_path):
    loss = ComparedQuantity(value=0.19, unit="s", real=0.38)
    write(
        tmp_path,
        made(rmse=0.41),
        made(rmse=0.61, seed=1),
        made(rmse=5.0, settings_given={"iterations": 5}),
        diverged(),
        made(FOAM),
        made(FOAM, backend="newton", speed=60.0),
        made(CRADLE, score=Score(kind="none", unit="mm", events={"lsd": loss})),
    )
    (tmp_path / "cut.json").write_text("{")
    # The folder is given twice; each file counts once.
    result = gauge("compare", ".", ".", "--format", "markdown", "--metric=rmse,lsd")
    assert result.exit_code == 1
    assert "cut.json: not a result file" in result.stderr
    text = result.stdout
    for cell in (
        "| 0.51 +- 0.14 (2) |",
        r"| 5.00 \* |",
        "| mujoco, iterations=5 |",
        "| diverged |",
        "| LSD | 0.50 |",
        "All configurations: published",
    ):
        assert cell in text
    far = next(line for line in text.splitlines() if ": newton" in line)
    assert "| 24.3 mm | 0.43 s |" in far


def test_results_are_chosen_by_id_engine_and_correction(gauge, tmp_path):
    # Rapier has no corrections, nor does the preset out_of_box. The default preset of MuJoCo is corrected.
    plain = made(settings_given={"preset": "out_of_box"})
    write(tmp_path, made(), made(backend="rapier"), plain)
    result = gauge("compare", ".", "--json", "--no-corrected")
    first = json.loads(result.stdout.splitlines()[0])
    labels = [item["label"] for item in first["configurations"]]
    assert labels == ["mujoco, preset=out_of_box", "rapier"]
    assert gauge("compare", ".", "--only", "Slope*", "-b", "mujoco").exit_code == 0
    for words, name in (
        ([".", "--only", "Slope*,NoSuch-*"], "'NoSuch-*'"),
        ([".", "-b", "mujoco,newton"], "'newton'"),
        ([".", "--metric=rsme"], "'rsme'"),
        (["nowhere"], "nowhere"),
    ):
        rejected = gauge("compare", *words)
        assert rejected.exit_code == 2
        assert name in rejected.stderr


def test_a_picture_of_foam_in_mm_has_no_published_distance_of_faces():
    results = []
    for backend in ("mujoco", "newton"):
        result = made(BAR, backend=backend)
        markers_mm = np.zeros((31, 84))
        trajectory = replace(result.trajectory, markers_mm=markers_mm)
        score = replace(result.score, refused="no score: the scene differs")
        results.append(replace(result, trajectory=trajectory, score=score))
    axis = draw_experiment(results).axes[0]
    assert axis.get_ylabel() == "distance [mm]"
    assert len(axis.get_lines()) == 1


def test_the_overview_shows_published_engines_only_with_raw_scores_of_trials(real):
    primary, raw, solved = (
        {
            float(line.get_xdata()[0])
            for line in axis.get_lines()
            if len(line.get_xdata())
        }
        for axis in draw_overview(compare([real[SLIDER], real[TURNED]])).axes
    )
    score = real[SLIDER].score
    assert score.rmse_aligned_normalized in primary
    assert score.rmse_normalized in raw
    assert real[TURNED].score.primary_normalized in solved - primary
    published = set(published_baselines(SLIDER)["rmse"].engines.values())
    assert published <= raw - primary
