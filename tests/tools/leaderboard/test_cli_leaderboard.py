"""The leaderboard commands: exit codes, the combined table, and what it leaves out."""

import json
import shutil
from pathlib import Path

import pytest

from gauge_envs.runs.episodes import run_episode
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result_file import result_file_name, write_result

NAMES = ("SlopeSlider-1-wood", "SlopeSlider-2-wood")


def write_submission(root, configuration, results, settings):
    engine = results[0].backend
    version = results[0].versions["mujoco"]
    folder = root / str(engine) / version / configuration
    (folder / "results").mkdir(parents=True)
    lines = [
        "format = 1",
        f'engine = "{engine}"',
        'package = "mujoco"',
        f'version = "{version}"',
        f'configuration = "{configuration}"',
        'submitter = "A [red]vendor[/] | <b>"',
        f"settings = {settings}",
    ]
    (folder / "submission.toml").write_text("\n".join(lines), encoding="utf-8")
    for result in results:
        write_result(result, folder / "results" / result_file_name(result))


@pytest.fixture(scope="module")
def board(tmp_path_factory):
    """A leaderboard of two configurations of MuJoCo."""
    root = tmp_path_factory.mktemp("board")
    (root / "board.toml").write_text(
        f"experiments = {json.dumps(NAMES)}\n", encoding="utf-8"
    )
    write_submission(
        root, "default", [run_episode(RunRequest(name)) for name in NAMES], "{}"
    )
    coarse = {"timestep_s": 1 / 900}
    write_submission(
        root,
        "coarse",
        [run_episode(RunRequest(name, settings=coarse)) for name in NAMES],
        f"{{timestep_s = {1 / 900}}}",
    )
    return root


def records(text):
    return [json.loads(line) for line in text.splitlines() if line.startswith("{")]


def test_check_passes_and_runs_a_sample_again(gauge, board):
    done = gauge("leaderboard", "check", board, "--rerun", 1, "--json")
    assert done.exit_code == 0, done.output
    kinds = [one["record"] for one in records(done.stdout)]
    assert kinds == ["submission", "rerun"] * 2
    assert {
        one["largest_difference"]
        for one in records(done.stdout)
        if one["record"] == "rerun"
    } == {0.0}


def test_table_has_intervals_and_no_mean_across_grades(gauge, board):
    done = gauge("leaderboard", "table", board, "--json")
    assert done.exit_code == 0, done.output
    found = records(done.stdout)
    assert [one["configuration"] for one in found if one["record"] == "submission"] == [
        "coarse",
        "default",
    ]
    grades = [one for one in found if one["record"] == "grade"]
    # The two experiments have references of two grades, and each mean is over one of them.
    assert {one["grade"]: one["ids"] for one in grades} == {
        "trials": ["GAUGE/SlopeSlider-2-wood"],
        "law": ["GAUGE/SlopeSlider-1-wood"],
    }
    scored = [
        one
        for one in found
        if one["record"] == "experiment" and one["metric"] == "rmse"
    ]
    # The law is solved exactly, so that its distance has no interval and is over no trials.
    has_interval = {
        one["grade"]: [
            cell["normalized_95"] is not None for cell in one["configurations"]
        ]
        for one in scored
    }
    assert has_interval == {"trials": [True, True], "law": [False, False]}
    assert {one["grade"] for one in found if one.get("metric") == "verification"} == {
        "law"
    }
    assert all(
        cell["wall_s_per_sim_s"] is None
        for one in scored
        for cell in one["configurations"]
    )


def test_markdown_is_written_and_submitters_change_no_table(gauge, board, tmp_path):
    assert gauge("leaderboard", "table", board, "--out", tmp_path).exit_code == 0
    text = (tmp_path / "leaderboard.md").read_text(encoding="utf-8")
    (line,) = (line for line in text.splitlines() if "| coarse |" in line)
    assert "A [red]vendor[/] \\| \\<b>" in line
    assert "Cost" not in text
    content = json.loads((tmp_path / "leaderboard.json").read_text(encoding="utf-8"))
    assert {one["record"] for one in content} == {
        "submission",
        "experiment",
        "grade",
        "pair",
    }


def test_a_partial_submission_is_listed_apart_and_changes_no_comparison(
    gauge, board, tmp_path
):
    copy = Path(shutil.copytree(board, tmp_path / "board"))
    whole = records(gauge("leaderboard", "table", copy, "--json").stdout)
    partial = {"timestep_s": 1 / 540}
    write_submission(
        copy,
        "one",
        [run_episode(RunRequest(NAMES[1], settings=partial))],
        f"{{timestep_s = {1 / 540}}}",
    )
    (statement,) = copy.glob("*/*/one/submission.toml")
    statement.write_text(
        f'{statement.read_text(encoding="utf-8")}\n[left_out]\n"{NAMES[0]}" = "error"\n',
        encoding="utf-8",
    )
    done = gauge("leaderboard", "table", copy, "--json")
    found = records(done.stdout)
    assert done.exit_code == 0, done.output
    assert [one["configuration"] for one in found if one["record"] == "submission"] == [
        "coarse",
        "default",
        "one",
    ]
    assert [one for one in found if one["record"] != "submission"] == [
        one for one in whole if one["record"] != "submission"
    ]
    assert "Partial submissions" in gauge("leaderboard", "table", copy).output


def test_a_fault_gives_exit_code_1_and_leaves_the_submission_out(
    gauge, board, tmp_path
):
    copy = tmp_path / "board"
    for file in board.rglob("*.*"):
        if file.is_file():
            target = copy / file.relative_to(board)
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(file.read_bytes())
    (file,) = copy.glob("*/*/coarse/results/SlopeSlider-2*.json")
    content = json.loads(file.read_text(encoding="utf-8"))
    content["score"]["rmse"] = 0.5
    file.write_text(json.dumps(content), encoding="utf-8")
    check = gauge("leaderboard", "check", copy)
    assert check.exit_code == 1
    assert "score.rmse" in check.output
    assert "the file states 0.5, its trajectory gives" in check.output
    table = gauge("leaderboard", "table", copy, "--json")
    assert table.exit_code == 1
    submissions = [
        one for one in records(table.stdout) if one["record"] == "submission"
    ]
    assert [one["configuration"] for one in submissions] == ["default"]


def test_a_missing_folder_gives_exit_code_2(gauge, tmp_path):
    done = gauge("leaderboard", "check", tmp_path / "absent")
    assert done.exit_code == 2
    assert "cannot be listed" in done.output


@pytest.mark.parametrize(
    "options", [[], ["--json"], ["--format", "markdown"], ["--out", "site"]]
)
def test_a_leaderboard_without_a_valid_submission_has_an_empty_table(
    options, tmp_path, monkeypatch, gauge
):
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "board" / "mujoco" / "1.0" / "default"
    folder.mkdir(parents=True)
    (folder / "submission.toml").write_text("format = 2")
    result = gauge("leaderboard", "table", "board", *options)
    assert result.exit_code == 1 and isinstance(result.exception, SystemExit)
    assert "left out:" in result.stderr


def test_a_leaderboard_asks_for_the_experiments_of_its_file(gauge, board, tmp_path):
    copy = Path(shutil.copytree(board, tmp_path / "board"))
    file = copy / "board.toml"
    assert "2 of 2" in gauge("leaderboard", "check", copy).output
    # A submission alone is checked against the file of its leaderboard.
    assert gauge("leaderboard", "check", next(copy.glob("*/*/default"))).exit_code == 0
    file.write_text('experiments = ["SlopeSlider-1-*"]\n', encoding="utf-8")
    done = gauge("leaderboard", "check", copy, "--json")
    faults = [one["reason"] for one in records(done.stdout) if one["record"] == "fault"]
    assert done.exit_code == 1
    assert (
        "is 'GAUGE/SlopeSlider-2-wood', which is not one of the 3 experiments of the leaderboard"
        in faults
    )
    assert any(
        "no result and no reason for SlopeSlider-1-plastic, SlopeSlider-1-metal" in one
        for one in faults
    )


@pytest.mark.parametrize(
    "text", ['experiments = ["SlopSlider-*"]', "experiments = 3", "format = 1", "["]
)
def test_a_file_that_states_no_experiments_is_refused(gauge, board, tmp_path, text):
    copy = Path(shutil.copytree(board, tmp_path / "board"))
    (copy / "board.toml").write_text(text, encoding="utf-8")
    done = gauge("leaderboard", "check", copy)
    assert done.exit_code == 2
    assert "expected `experiments`, a list of ids or patterns" in " ".join(
        done.output.split()
    )
