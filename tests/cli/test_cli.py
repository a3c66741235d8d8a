"""The `gauge` command, run on real experiments: output, exit codes, and a clear message for each wrong request."""

import json
import sys

import pytest
from interruption import interrupt_in_episode
from slide import NAME, SLIDE, write_csv
from typer.testing import CliRunner

from gauge_envs.cli.app import app

SOFT = "FoamBending-soft"

METRICS = {
    *(
        "grade",
        "rmse",
        "rmse_normalized",
        "dtw",
        "dtw_normalized",
        "release_offset_s",
        "rmse_aligned_normalized",
    ),
    *("mean_abs_z", "inside_1sigma", "inside_2sigma", "lsd_s", "mte", "pd_s", "el"),
}
KEYS = {
    *(
        "id",
        "backend",
        "parameters",
        "frames",
        "diverged",
        "wall_s",
        "sim_s",
        "settings",
        "versions",
        "seed",
        "score",
    ),
}


@pytest.fixture
def gauge(tmp_path, monkeypatch):
    """Runs the command in an empty folder: gauge("list", "--json") -> result with exit_code, stdout, stderr."""
    monkeypatch.chdir(tmp_path)
    return lambda *arguments: CliRunner(env={"COLUMNS": "160"}).invoke(
        app, list(map(str, arguments))
    )


def lines(result):
    return [json.loads(line) for line in result.stdout.splitlines()]


# --- list, show, backends ---


@pytest.mark.usefixtures("rigid_only")
def test_list_shows_every_experiment(gauge):
    result = gauge("list")
    assert result.exit_code == 0
    assert result.stdout.splitlines()[-1] == "75 ids in 22 families"
    rows = lines(gauge("list", "--json"))
    assert len(rows) == 75
    by_id = {row["id"]: row for row in rows}
    assert by_id["GAUGE/SlopeSlider-2-wood"]["backends"]["mujoco"] == []
    assert "deformable" in by_id[f"GAUGE/{SOFT}"]["backends"]["mujoco"][0]


@pytest.mark.parametrize("pattern", ["SlopeSlider-2-*", "GAUGE/SlopeSlider-2-*"])
def test_list_takes_patterns(gauge, pattern):
    assert gauge("list", pattern).stdout.splitlines()[-1] == "3 ids in 1 family"


@pytest.mark.parametrize(
    "name",
    [
        NAME,
        f"GAUGE/{NAME}",
        "SlopeSlider-3-metal",
        "Pendulum-metal",
        SOFT,
        "Turntable-1-wood",
    ],
)
def test_show_states_constants_and_where_they_are_from(gauge, name):
    text = gauge("show", name, "--format", "wide")
    assert text.exit_code == 0
    for heading in (
        "Bodies",
        "Contacts",
        "Constants",
        "Where the numbers are from",
        "Decisions",
        "Published",
    ):
        assert heading in text.stdout
    (values,) = lines(gauge("show", name, "--json"))
    assert values["provenance"]["constants"] == "metadata"
    assert all(
        one["source"]
        for table in values["constants"].values()
        for one in table.values()
    )
    assert values["parameter_sets"]["calibrated"]
    assert values["baselines"][0]["engines"].keys() == {"isaacsim", "genesis", "newton"}


def test_show_states_grade_trials_and_driver(gauge):
    assert "trials, 20 trials" in gauge("show", NAME).stdout
    assert "Driver of board (video)" in gauge("show", "SlopeSlider-3-metal").stdout
    assert (
        lines(gauge("show", "SlopeSlider-3-wood", "--json"))[0]["drivers"][0][
            "provenance"
        ]
        == "nominal"
    )


def test_backend_list(gauge):
    assert "mujoco" in gauge("list", "backends").stdout
    assert "mujoco" in [
        one["name"] for one in lines(gauge("list", "backends", "--json"))
    ]


# --- run ---


def test_run_prints_scores_beside_the_published_ones(gauge, tmp_path):
    result = gauge("run", "SlopeSlider-2-*", "--out", "out")
    assert result.exit_code == 0
    for text in (
        "SlopeSlider-2-plastic",
        "Isaac Sim",
        "Genesis",
        "Newton",
        "trials",
        "Over real trials",
    ):
        assert text in result.stdout
    assert len(list((tmp_path / "out").iterdir())) == 3
    assert "3 finished; results in out" in result.stderr


def test_run_prints_all_columns_with_wide(gauge):
    plain, wide = (
        gauge("run", NAME).stdout,
        gauge("run", NAME, "--format", "wide").stdout,
    )
    assert "shift" in " ".join(wide.splitlines()[:2]) and "shift" not in " ".join(
        plain.splitlines()[:2]
    )
    assert "+0.007 s" in wide and "+0.007 s" not in plain


def test_run_json_has_one_object_a_line_and_nothing_else_on_stdout(gauge):
    result = gauge(
        "run", NAME, "SlopeSlider-1-wood", "--json", "seed=3", "--set", "iterations=50"
    )
    assert result.exit_code == 0
    first, second = lines(result)
    for values in (first, second):
        assert values.keys() >= KEYS
        assert values["score"].keys() >= METRICS
        assert values["diverged"] is False
        assert (values["seed"], values["settings"]["iterations"]) == (3, 50)
    assert first["score"]["lsd_s"] is None
    assert second["score"]["release_offset_s"] is None


def test_overrides_are_parsed_and_change_the_score(gauge):
    plain, changed, moved = (
        lines(gauge("run", NAME, "--json", "--parameters", p))[0]
        for p in (
            "calibrated",
            "cube.friction=0.2,cube.mass_kg=0.1",
            "cube.position_m=[0.1,0.4,0.36]",
        )
    )
    assert changed["parameters"] == {"cube.friction": 0.2, "cube.mass_kg": 0.1}
    assert moved["parameters"] == {"cube.position_m": [0.1, 0.4, 0.36]}
    assert len({v["score"]["rmse"] for v in (plain, changed, moved)}) == 3


@pytest.mark.usefixtures("rigid_only")
def test_declined_experiments_are_reported_and_count_only_when_named(gauge):
    assert gauge("run", "FoamBending-*").exit_code == 0
    named = gauge("run", SOFT, NAME)
    assert named.exit_code == 1
    assert "declined: FoamBending-soft" in named.stdout
    assert "deformable" in named.stdout
    assert "1 declined, 1 finished" in named.stderr
    (values,) = lines(gauge("run", SOFT, "--json"))
    assert values["outcome"] == "declined"
    assert values["score"]["rmse"] is None


def test_a_parameter_set_that_some_lack(gauge):
    result = gauge(
        "run", "BouncingBall-*", "Turntable-1-*", "--parameters", "effective"
    )
    assert result.exit_code == 0
    assert "has no parameter set 'effective'" in result.stdout
    assert "1 finished, 3 declined" in result.stderr


def test_a_failed_episode_gives_exit_code_1(gauge, monkeypatch):
    monkeypatch.setattr(
        "gauge_envs.envs.episode.Episode.fault_of", lambda *_: "it flew away"
    )
    result = gauge("run", NAME)
    assert result.exit_code == 1
    assert "diverged: SlopeSlider-2-wood: it flew away" in result.stdout


def test_ctrl_c_keeps_what_is_done_and_resume_goes_on(gauge, monkeypatch, tmp_path):
    with monkeypatch.context() as patched:
        interrupt_in_episode(patched, 3)
        stopped = gauge("run", "SlopeSlider-2-*", "--json")
    assert stopped.exit_code == 130
    assert "2 results kept in results; --resume continues" in stopped.stderr
    assert len(lines(stopped)) == 2
    assert len(list((tmp_path / "results").iterdir())) == 2
    resumed = gauge("run", "SlopeSlider-2-*", "--json", "--resume")
    assert resumed.exit_code == 0
    assert lines(resumed)[:2] == lines(stopped)


def test_a_damaged_result_is_reported_on_resume(gauge, tmp_path):
    gauge("run", NAME)
    (file,) = (tmp_path / "results").iterdir()
    file.write_text("{")
    result = gauge("run", NAME, "--resume")
    assert result.exit_code == 0
    assert f"{file.name}.damaged" in result.stderr
    assert json.loads(file.read_text())["outcome"] == "finished"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["run"], "give ids, or patterns as '*'"),
        (["run", "SlopeSlider-2-gold"], "did you mean SlopeSlider-2-wood"),
        (["run", "SlopSlider-2-woo*"], "did you mean SlopeSlider-2-wood"),
        (["run", "Sloper*"], "did you mean SlopeSlider-*, SlopeContact-*"),
        (["run", "GAUGE/SlopeSlider-9-wood"], "unknown experiment"),
        (["show", "SlopeSlider"], "unknown experiment"),
        (["list", "X*"], "unknown experiment"),
        (
            ["run", NAME, "--backend", "mujoko"],
            "unknown backend 'mujoko'; did you mean mujoco",
        ),
        (
            ["run", NAME, "--parameters", "nonsense"],
            "has no parameter set 'nonsense'; known: calibrated",
        ),
        (["run", NAME, "--parameters", "cube.friction=-1"], "cube.friction"),
        (["run", NAME, "--parameters", "cube.friction"], "has no parameter set"),
        (["run", NAME, "--parameters", "cube.colour=1"], "has no constant 'colour'"),
        (["run", NAME, "--parameters", "cube.friction="], "expected NAME=VALUE"),
        (["run", NAME, "--set", "timestep_s"], "expected NAME=VALUE"),
        (["run", NAME, "--set", "nope=1"], "MuJoCo setting 'nope'"),
        (["run", NAME, "--out", "/proc/nowhere"], "results cannot be written there"),
        (["run", NAME, "seed=-1"], "seed: "),
        (["score", "no.csv", "--id", NAME], "cannot be read"),
        (["score", "no.csv"], "states no id"),
        (["score", "no.csv", "--id", "Nothing-2"], "unknown experiment"),
        (["plot", "nowhere"], "holds no result files"),
    ],
)
def test_wrong_requests_get_a_message_and_exit_code_2(gauge, arguments, message):
    result = gauge(*arguments)
    assert result.exit_code == 2
    assert message in " ".join(result.stderr.split())
    assert "Traceback" not in result.output
    assert result.stdout == ""


# --- score, plot ---


def test_score_of_a_file(gauge, tmp_path):
    file = write_csv(tmp_path / "slide.csv", SLIDE)
    result = gauge("score", file, "--id", NAME)
    assert result.exit_code == 0
    assert "0.41" in result.stdout
    assert "Over real trials" in result.stdout
    (values,) = lines(gauge("score", file, "--id", NAME, "--json"))
    assert values.keys() >= KEYS
    assert (
        values["backend"],
        values["wall_s"],
        values["settings"],
        values["seed"],
    ) == (None, None, {}, None)
    assert "gauge-envs" in values["versions"]
    assert values["score"]["rmse_normalized"] == pytest.approx(0.41, abs=0.005)


def test_a_flawed_file_gets_a_message_and_exit_code_2(gauge, tmp_path):
    (tmp_path / "bad.csv").write_text("1,2,3\n1,nan,3\n")
    result = gauge("score", "bad.csv", "--id", NAME)
    assert result.exit_code == 2
    assert (
        "bad.csv: line 2: cube.y is 'nan', expected a finite number [mm]"
        in result.stderr
    )


def test_result_files_can_be_scored_again_and_plotted(gauge, tmp_path):
    gauge("run", NAME)
    (file,) = (tmp_path / "results").iterdir()
    assert (
        lines(gauge("score", file, "--json"))[0]["score"]
        == json.loads(file.read_text())["score"]
    )
    assert gauge("plot").stdout.strip() == f"plots/{NAME}.png"
    (tmp_path / "results" / "cut.json").write_text("{")
    partly = gauge("plot", "results", "--out", "again")
    assert partly.exit_code == 1
    assert "cut.json: not a result file" in partly.stderr
    assert (tmp_path / "again" / f"{NAME}.png").exists()


def test_plots_without_matplotlib_name_the_extra(gauge, monkeypatch):
    gauge("run", NAME)
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    result = gauge("plot")
    assert result.exit_code == 2
    assert "pip install 'gauge-envs[plot]'" in result.stderr
