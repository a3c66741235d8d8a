"""Engines side by side: what is a repeat and what a configuration, means and distances against closed forms."""

import json
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.colors import to_hex
from rich.console import Console
from scipy.stats import gmean
from typer.testing import CliRunner

from gauge_envs.analysis.comparison import compare
from gauge_envs.analysis.distance import MOTION_SHARE
from gauge_envs.analysis.scores import METRICS, ScoreSpread, check_metrics
from gauge_envs.cli.app import app
from gauge_envs.errors import UnknownNameError
from gauge_envs.evaluation.score import Score
from gauge_envs.experiments.task_files import task_sha256
from gauge_envs.files import versions
from gauge_envs.references.published import published_baselines
from gauge_envs.report import comparison_markdown, comparison_rows, comparison_view, configuration_labels
from gauge_envs.report.figures.experiment import draw_experiment
from gauge_envs.report.figures.overview import draw_overview, save_comparison
from gauge_envs.report.figures.style import OURS
from gauge_envs.runs.episodes import run_episode
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result import Outcome, RecordedTrajectory, Result
from gauge_envs.runs.result_file import result_file_name, write_result

SLIDER, PLASTIC, FOAM, CRADLE = (
    "SlopeSlider-2-wood",
    "SlopeSlider-2-plastic",
    "SlopeSlider-3-wood",
    "NewtonsCradle-metal",
)
GRADES = {SLIDER: "trials", PLASTIC: "trials", FOAM: "none", CRADLE: "none"}
RATE_HZ = 180


def recorded(motion, *, seconds=1.0):
    """A recorded trajectory of one cube: motion(times) gives x, y, z in mm, or a constant."""
    times = np.arange(round(seconds * RATE_HZ) + 1) / RATE_HZ
    samples = np.broadcast_to(np.asarray(motion(times), dtype=float).T, (len(times), 3))
    return RecordedTrajectory(
        unit="mm",
        coordinates=["cube.x", "cube.y", "cube.z"],
        times_s=times.tolist(),
        samples=[[v if np.isfinite(v) else None for v in row] for row in samples.tolist()],
    )


def still(_):
    return [0.0, 0.0, 0.0]


def along(speed_mm_per_s):
    return lambda times: [speed_mm_per_s * times, 0.0 * times, 0.0 * times]


def made(name=SLIDER, *, backend="mujoco", rmse=None, motion=still, seconds=1.0, engine="1.0", **changes):
    """A result as an engine would leave it; rmse is the normalized one."""
    family = name.split("-")[0]
    score = Score(grade=GRADES[name], unit="mm", rmse_normalized=rmse, rmse=None if rmse is None else 18.0 * rmse)
    values = {
        "id": f"GAUGE/{name}",
        "outcome": Outcome.FINISHED,
        "parameters": "calibrated",
        "score": score,
        "task_sha256": task_sha256(family),
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
        console.print(comparison_view(compare(results), metrics or tuple(METRICS)))
    return capture.get()


def cells(results, metric="rmse"):
    """Texts of the row of a metric, a column a configuration."""
    comparison = compare(results)
    markdown = comparison_markdown(comparison, [metric])
    row = next(line for line in markdown.splitlines() if line.startswith("| SlopeSlider"))
    return [cell.strip() for cell in row.strip("|").split("|")][4:-3]


# --- configurations and repeats ---


@pytest.mark.parametrize(("values", "mean", "std"), [([3.0], 3.0, None), ([1.0, 2.0, 3.0], 2.0, 1.0)])
def test_spread_is_mean_and_sample_deviation(values, mean, std):
    assert ScoreSpread.of(values) == ScoreSpread(mean=mean, std=std, count=len(values))
    assert ScoreSpread.of([]) is None


def test_results_that_differ_in_their_seed_alone_are_one_cell():
    comparison = compare([made(rmse=value, seed=seed) for seed, value in enumerate([1.0, 2.0, 3.0])])
    ((cell,),) = [one.cells for one in comparison.experiments]
    assert [result.seed for result in cell.results] == [0, 1, 2]
    assert cell.spread(METRICS["rmse"], normalized=True) == ScoreSpread(mean=2.0, std=1.0, count=3)
    assert cells([made(rmse=value, seed=seed) for seed, value in enumerate([1.0, 2.0, 3.0])]) == ["2.00 +- 1.00 (3)"]


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


def test_labels_state_a_single_configuration_in_full_and_leave_out_what_all_share():
    fine = {"settings_given": {"timestep_s": 0.5}}
    assert configuration_labels(compare([made(**fine)]).configurations) == ["mujoco, calibrated, timestep_s=0.5"]
    both = compare([made(**fine), made(backend="newton", **fine)])
    assert configuration_labels(both.configurations) == ["mujoco", "newton"]
    assert "All: calibrated, timestep_s=0.5." in printed([made(**fine), made(backend="newton", **fine)])


def test_labels_that_round_to_the_same_are_stated_in_full():
    steps = [made(settings_given={"timestep_s": step}) for step in (0.125, 0.125 + 2**-20)]
    labels = configuration_labels(compare(steps).configurations)
    assert sorted(labels) == ["mujoco, timestep_s=0.125", "mujoco, timestep_s=0.12500095367431641"]


def test_of_two_results_of_one_seed_the_latest_counts():
    old = made(rmse=5.0, created="2026-01-01T00:00:00+00:00")
    new = made(rmse=1.0, created="2026-01-02T00:00:00+00:00")
    comparison = compare([new, old])
    assert cells([new, old]) == ["1.00"]
    assert "the latest of each counts" in comparison.notes[0]


def test_results_that_do_not_belong_together_are_reported():
    stale = made(task_sha256="0" * 64)
    older = made(PLASTIC, versions={"mujoco": "1.0", **versions(), "gauge-envs": "0.0.1"})
    notes = " ".join(compare([stale, older]).notes)
    assert "another task file than the installed one: SlopeSlider-2-wood" in notes
    assert "different versions of gauge-envs: 0.0.1, " in notes
    assert compare([made(), made(PLASTIC)]).notes == ()


# --- scores ---


def test_cells_say_why_there_is_no_score():
    results = [made(rmse=0.5), diverged(), made(backend="other")]
    assert cells(results) == ["0.50", "diverged", "no score"]
    assert cells([made(rmse=0.5), made(PLASTIC, backend="newton", rmse=1.0)]) == ["0.50", "-"]
    assert cells([made(rmse=0.5), declined()]) == ["0.50", "declined"]


def test_repeats_that_diverged_are_counted_and_leave_the_cell_unscored_in_the_summary():
    results = [made(backend="newton", rmse=1.0), made(backend="newton", rmse=3.0, seed=1), diverged(seed=2)]
    assert cells(results) == ["2.00 +- 1.41 (2), 1 diverged"]
    (summary,) = compare(results).summaries()
    assert (summary.ran, summary.scored, summary.diverged, summary.geometric_mean) == (1, 0, 1, None)


def test_a_raw_score_without_baseline_is_stated_in_its_unit():
    assert cells([made(score=Score(grade="trials", unit="mm", rmse=12.5))]) == ["12.50 mm"]


def test_a_declined_result_without_versions_joins_the_configuration_that_ran():
    comparison = compare([declined(), made(PLASTIC, backend="newton", rmse=1.0)])
    assert len(comparison.configurations) == 1
    (summary,) = comparison.summaries()
    assert (summary.ran, summary.not_run) == (1, 1)


def test_event_metrics_and_energy_loss_stand_beside_the_published_ones():
    score = Score(grade="none", unit="mm", lsd_s=0.19, lsd_normalized=0.5, mte=0.2, mte_normalized=0.215)
    rows = {row["metric"]: row for row in comparison_rows(compare([made(CRADLE, score=score)]))}
    assert rows.keys() == {"lsd", "mte"}
    assert rows["lsd"]["real"]["mean"] == 0.38
    assert rows["lsd"]["configurations"][0]["raw"]["mean"] == 0.19
    assert rows["mte"]["published"] == {"isaacsim": 0.2, "genesis": None, "newton": 0.26}


def test_wall_time_is_over_simulated_time():
    results = [made(wall_s=3.0, seconds=1.0), made(wall_s=5.0, seconds=1.0, seed=1), made(PLASTIC, wall_s=None)]
    comparison = compare(results)
    assert [one.cells[0].wall_s_per_sim_s for one in comparison.experiments] == [4.0, None]
    assert comparison.summaries()[0].wall_s_per_sim_s == 4.0


def test_summary_is_the_geometric_mean_over_what_all_have_scored():
    ours = [made(rmse=2.0), made(PLASTIC, rmse=8.0), made(FOAM)]
    comparison = compare([*ours, made(backend="newton", rmse=3.0), made(PLASTIC, backend="newton", rmse=12.0)])
    first, second = comparison.summaries()
    assert (first.geometric_mean, second.geometric_mean) == (pytest.approx(4.0), pytest.approx(6.0))
    assert (first.ran, first.scored, second.ran) == (3, 2, 2)
    genesis = [published_baselines(name)["rmse"].engines["genesis"] for name in (SLIDER, PLASTIC)]
    assert comparison.published_geometric_mean("genesis") == pytest.approx(gmean(genesis))
    narrowed = compare([*ours, made(backend="newton", rmse=3.0)])
    assert [one.geometric_mean for one in narrowed.summaries()] == [pytest.approx(2.0), pytest.approx(3.0)]


def test_a_perfect_score_makes_the_geometric_mean_zero_without_a_warning():
    (summary,) = compare([made(rmse=0.0), made(PLASTIC, rmse=1.0)]).summaries()
    assert summary.geometric_mean == 0.0


def test_nothing_in_common():
    text = printed([made(rmse=1.0), made(PLASTIC, backend="newton", rmse=1.0)])
    assert "none is scored by all" in text
    assert "Where engines disagree" not in text


def test_one_configuration_is_shown_beside_what_was_published():
    text = printed([made(rmse=0.41)])
    for word in ("0.41", "Isaac Sim", "1.23", "18 +- 15.89 mm", "One configuration", "mujoco: mujoco 1.0", "Table 5"):
        assert word in text


def test_nothing_to_compare():
    assert "no results to compare" in printed([])
    assert comparison_rows(compare([])) == []


# --- distances ---


def distance(*results):
    (experiment,) = compare(results).experiments
    (far,) = experiment.distances
    return far


def test_a_constant_distance():
    far = distance(made(FOAM), made(FOAM, backend="newton", motion=lambda _: [3.0, 4.0, 0.0]))
    assert far.rms.mean == pytest.approx(5.0)
    assert (far.motion_rms, far.frames, far.apart_at_s) == (0.0, 31, None)
    assert far.threshold == published_baselines(FOAM)["rmse"].mean
    assert far.threshold_is_scatter


def test_drifting_apart_crosses_the_published_scatter_of_real_trials_when_it_should():
    # 60 mm/s apart reach the published 24.27 mm after 0.4045 s, so at the 13th frame, 0.4333 s.
    far = distance(made(FOAM), made(FOAM, backend="newton", motion=along(60.0)))
    assert far.threshold == 24.27
    assert far.apart_at_s == pytest.approx(13 / 30)
    frames = np.arange(31) / 30
    assert far.rms.mean == pytest.approx(60.0 * np.sqrt(np.mean(frames**2)))
    assert far.motion_rms == pytest.approx(60.0 * np.sqrt(np.mean(frames**2) / 2))


def test_without_a_published_scatter_the_threshold_is_a_share_of_the_motion():
    # x = v t and 1.1 v t: apart by 5 % of the mean square of both ways once 0.1 v t is.
    far = distance(made(CRADLE, motion=along(100.0)), made(CRADLE, backend="newton", motion=along(110.0)))
    ways = np.concatenate([np.arange(31) / 30 * speed for speed in (100.0, 110.0)])
    threshold = MOTION_SHARE * np.sqrt(np.mean(ways**2))
    assert not far.threshold_is_scatter
    assert far.threshold == pytest.approx(threshold)
    assert far.apart_at_s == pytest.approx(np.ceil(threshold / 10.0 * 30) / 30)
    text = printed([made(CRADLE, motion=along(100.0)), made(CRADLE, backend="newton", motion=along(110.0))])
    assert "Where engines disagree" in text
    assert "* not published: 5% of the motion" in text


def test_only_common_finite_frames_count():
    def explodes(times):
        return [np.where(times > 0.3, np.inf, 10.0), 0.0 * times, 0.0 * times]

    lost = diverged(FOAM)
    far = distance(made(FOAM, seconds=2.0), replace(lost, trajectory=recorded(explodes, seconds=0.5)))
    assert (far.rms.mean, far.frames, far.diverged) == (10.0, 10, True)


def test_no_distance_where_one_did_not_run_or_recorded_something_else():
    assert compare([made(FOAM), declined(FOAM)]).experiments[0].distances == ()
    other = made(FOAM, backend="newton")
    renamed = replace(other.trajectory, coordinates=["ball.x", "ball.y", "ball.z"])
    assert compare([made(FOAM), replace(other, trajectory=renamed)]).experiments[0].distances == ()


def test_repeats_are_compared_seed_by_seed():
    def start(x):
        return lambda _: [x, 0.0, 0.0]

    ours = [made(FOAM, seed=seed, motion=start(100.0 * seed)) for seed in (1, 2, 3)]
    theirs = [made(FOAM, backend="newton", seed=seed, motion=start(100.0 * seed + seed)) for seed in (1, 2, 3)]
    far = distance(*ours, *theirs)
    assert (far.rms.mean, far.rms.std, far.rms.count) == (2.0, 1.0, 3)
    apart = distance(ours[0], ours[1], theirs[2])
    assert (apart.rms.mean, apart.rms.count) == ((203.0 + 103.0) / 2, 2)


# --- output ---


def test_json_has_one_object_an_experiment_and_metric():
    results = [made(rmse=1.0), made(rmse=2.0, seed=1), diverged(), made(FOAM), made(FOAM, backend="newton")]
    rows = json.loads(json.dumps(comparison_rows(compare(results)), allow_nan=False))
    keys = [(row["id"], row["metric"]) for row in rows]
    assert len(set(keys)) == len(keys) == 4
    first = next(row for row in rows if row["id"] == f"GAUGE/{SLIDER}" and row["metric"] == "rmse")
    mujoco, newton = first["configurations"]
    assert (mujoco["label"], mujoco["seeds"], mujoco["outcomes"]) == ("mujoco", [0, 1], ["finished", "finished"])
    assert mujoco["normalized"]["values"] == [1.0, 2.0]
    assert mujoco["versions"]["mujoco"] == "1.0"
    assert (newton["normalized"], newton["reasons"]) == (None, ["a body is 1e6 m away"])
    assert first["published"] == {"isaacsim": 1.23, "genesis": 0.53, "newton": 1.71}
    apart = next(row for row in rows if row["id"] == f"GAUGE/{FOAM}")["distances"]
    assert (apart[0]["first"], apart[0]["second"]) == ("mujoco", "newton")


def test_markdown_tables_are_whole():
    results = [made(rmse=1.0, settings_given={"a_b": 1}), diverged(), made(FOAM), made(FOAM, backend="newton")]
    lines = comparison_markdown(compare(results)).splitlines()
    tables = [line for line in lines if line.startswith("|")]
    blocks = "\n".join(line if line.startswith("|") else "" for line in lines).split("\n\n")
    counts = [{row.count("|") for row in block.split("\n") if row} for block in blocks]
    assert len(tables) > 6
    assert all(len(count) <= 1 for count in counts)
    assert any(r"a\_b" in line for line in tables)


def test_metrics_are_checked_and_kept_in_order():
    assert check_metrics([]) == tuple(METRICS)
    assert check_metrics(["dtw", "rmse", "dtw"]) == ("dtw", "rmse")
    with pytest.raises(UnknownNameError, match="did you mean rmse"):
        check_metrics(["rsme"])


# --- pictures ---


def test_repeats_are_lines_of_one_colour_and_configurations_keep_theirs():
    repeats = [made(backend="newton", rmse=1.0, seed=seed, motion=along(10.0 * seed)) for seed in range(3)]
    among = [made(PLASTIC, rmse=1.0), *repeats]
    figure = draw_experiment(repeats, among=among)
    curves = [line for line in figure.axes[0].get_lines() if to_hex(line.get_color()) in OURS and len(line.get_xdata())]
    assert len(curves) == 3
    assert {to_hex(line.get_color()) for line in curves} == {OURS[1]}
    texts = [text.get_text() for text in figure.axes[0].get_legend().get_texts()]
    assert "newton, 3 repeats" in texts


def test_engines_without_a_reference_get_a_panel_of_their_distance():
    figure = draw_experiment([made(FOAM), made(FOAM, backend="newton", motion=along(60.0))])
    panel = next(axis for axis in figure.axes if "distance" in axis.get_ylabel())
    heights = max(panel.get_lines(), key=lambda line: len(line.get_ydata())).get_ydata()
    assert heights == pytest.approx(60.0 * np.arange(31) / 30)
    assert not any("distance" in axis.get_ylabel() for axis in draw_experiment([made(FOAM)]).axes)


def test_overview_has_every_score_where_it_belongs():
    figure = draw_overview(compare([made(rmse=0.41), diverged(), made(PLASTIC, backend="newton", rmse=2.0)]))
    (axis,) = figure.axes
    places = {float(line.get_xdata()[0]) for line in axis.get_lines() if len(line.get_xdata())}
    assert {0.41, 2.0, 1.23, 0.53, 1.71, 0.48, 0.82, 0.51, 1.0} <= places
    assert axis.get_xscale() == "log"
    assert [tick.get_text() for tick in axis.get_yticklabels()] == [f"{SLIDER}  (trials)", f"{PLASTIC}  (trials)"]
    assert draw_overview(compare([made(rmse=0.41)]), metric="el") is None


def test_pictures_of_a_comparison(tmp_path):
    results = [made(rmse=0.41), diverged(), declined(PLASTIC), made(FOAM), made(CRADLE)]
    names = {path.name for path in save_comparison(results, tmp_path / "plots")}
    assert names == {f"{SLIDER}.png", f"{FOAM}.png", f"{CRADLE}.png", "overview.png"}
    assert all((tmp_path / "plots" / name).stat().st_size > 10_000 for name in names)


# --- the command ---


@pytest.fixture
def gauge(tmp_path, monkeypatch):
    """Runs the command in an empty folder: gauge("compare", "--json") -> result with exit_code, stdout, stderr."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "results").mkdir()
    return lambda *arguments: CliRunner(env={"COLUMNS": "240"}).invoke(app, list(map(str, arguments)))


def write(folder, *results):
    for result in results:
        write_result(result, folder / "results" / result_file_name(result))


def test_two_settings_of_a_real_engine(gauge, tmp_path):
    fine, coarse = (run_episode(RunRequest(SLIDER, settings=given)) for given in (None, {"timestep_s": 1 / 900}))
    write(tmp_path, fine, coarse, run_episode(RunRequest("Turntable-2-wood")), replace(fine, backend="newton", seed=4))
    result = gauge("compare", "--out", "plots")
    assert result.exit_code == 0
    for text in ("timestep_s", "0.41", "Isaac Sim", "Summary", "wall s/sim s"):
        assert text in result.stdout
    assert sorted(path.name for path in (tmp_path / "plots").iterdir()) == [
        f"{SLIDER}.png",
        "Turntable-2-wood.png",
        "overview.png",
    ]
    rows = [json.loads(line) for line in gauge("compare", "--json", "--metric", "rmse").stdout.splitlines()]
    assert [row["metric"] for row in rows] == ["rmse", "rmse"]
    values = [one["normalized"] for one in rows[0]["configurations"]]
    assert values[0]["mean"] == fine.score.rmse_normalized
    assert values[1]["mean"] == coarse.score.rmse_normalized
    far = {(one["first"], one["second"]): one["rms"]["mean"] for one in rows[0]["distances"]}
    assert far["mujoco", "newton"] == 0.0
    assert far["mujoco", "mujoco, timestep_s=0.001111"] > 0.0


def test_a_damaged_file_is_skipped_with_a_note_and_exit_code_1(gauge, tmp_path):
    write(tmp_path, made(rmse=0.41))
    (tmp_path / "results" / "cut.json").write_text("{")
    result = gauge("compare", "--markdown")
    assert result.exit_code == 1
    assert "cut.json: not a result file" in result.stderr
    assert result.stdout.startswith("**Scores")
    assert "| 0.41 |" in result.stdout
    only = gauge("compare", "results/cut.json")
    assert only.exit_code == 1
    assert "no results to compare" in only.stdout


def test_a_file_that_is_given_twice_counts_once(gauge, tmp_path):
    write(tmp_path, made(rmse=0.41))
    (row, *_) = gauge("compare", "results", "results", "--json", "--metric", "rmse").stdout.splitlines()
    assert json.loads(row)["configurations"][0]["normalized"]["count"] == 1
    assert json.loads(row)["notes"] == []


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nowhere"], "holds no result files"),
        ([], "holds no result files"),
        (["--metric", "rsme"], "unknown metric 'rsme'; did you mean rmse"),
        (["--json", "--markdown"], "exclude each other"),
    ],
)
def test_wrong_requests_get_a_message_and_exit_code_2(gauge, arguments, message):
    result = gauge("compare", *arguments)
    assert result.exit_code == 2
    assert message in " ".join(result.stderr.split())
    assert result.stdout == ""
