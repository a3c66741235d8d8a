"""The `gauge` command, run on real experiments: output, exit codes, and a clear message for each wrong request."""

import json
import sys

from interruption import interrupt_in_episode
from slide import NAME

from gauge_envs.backends.mujoco.simulation import SimulationMuJoCo


def lines(result):
    return [json.loads(line) for line in result.stdout.splitlines()]


# --- list, show, backends ---


def test_backend_list(gauge):
    assert "mujoco" in gauge("list", "backends").stdout
    assert "mujoco" in [
        one["name"] for one in lines(gauge("list", "backends", "--json"))
    ]


# --- run ---


def test_overrides_are_parsed_and_change_the_score(gauge):
    plain, changed, moved = (
        lines(gauge("run", NAME, "--json", "--parameter", p))[0]
        for p in (
            "calibrated",
            "cube.friction=0.2,cube.mass_kg=0.1",
            "cube.position_m=[0.1,0.4,0.36]",
        )
    )
    assert changed["parameters"] == {"cube.friction": 0.2, "cube.mass_kg": 0.1}
    assert moved["parameters"] == {"cube.position_m": [0.1, 0.4, 0.36]}
    assert len({v["score"]["rmse"] for v in (plain, changed, moved)}) == 3


def test_a_failed_episode_gives_exit_code_1(gauge, monkeypatch):
    monkeypatch.setattr(SimulationMuJoCo, "diverged", lambda _: {0: "it flew away"})
    result = gauge("run", NAME)
    assert result.exit_code == 1
    assert "diverged: SlopeSlider-2-wood: it flew away" in result.stdout


def test_ctrl_c_keeps_what_is_done_and_resume_goes_on(gauge, monkeypatch, tmp_path):
    with monkeypatch.context() as patched:
        interrupt_in_episode(patched, 3)
        stopped = gauge("run", "SlopeSlider-2-*", "--json")
    assert stopped.exit_code == 130
    assert "finished episodes are kept in results; --resume" in stopped.stderr
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
    assert f"{file.name}: not a result file" in result.stderr
    assert json.loads(file.read_text())["outcome"] == "finished"


# --- score, plot ---


def rounded(score):
    return json.loads(json.dumps(score), parse_float=lambda text: f"{float(text):.9g}")


def test_result_files_can_be_scored_again_and_plotted(gauge, tmp_path):
    gauge("run", NAME)
    (file,) = (tmp_path / "results").iterdir()
    (again,) = lines(gauge("score", file, "--json"))
    kept = json.loads(file.read_text())
    # The last digit of an interval may differ between two processes.
    assert rounded(again["score"]) == rounded(kept["score"])
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
