"""Leaderboard: its own runs count alone, planted faults are found, and the table compares what can be compared."""

import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
from importlib.metadata import version
from pathlib import Path

import pytest
import yaml
from places import ROOT

from gauge_envs.files import MEGABYTE
from gauge_envs.runs.episodes import run_episode
from gauge_envs.runs.request import RunRequest
from gauge_envs.tools.leaderboard import check_leaderboard
from gauge_envs.tools.leaderboard.archive import ARCHIVE, read_archive, write_archive

MUJOCO = version("mujoco")
NAMES = ("SlopeSlider-1-wood", "SlopeSlider-2-wood")
SLIDER = "results/SlopeSlider-2-wood.mujoco.calibrated.json"


def write_statement(root, configuration, settings="", **changes):
    values = {
        "engine": "mujoco",
        "package": "mujoco",
        "version": MUJOCO,
        "configuration": configuration,
        "submitter": "A [red]vendor[/] | <b>",
    } | changes
    folder = root / values["engine"] / values["version"] / configuration
    folder.mkdir(parents=True)
    lines = ["format = 1", *(f"{key} = {json.dumps(values[key])}" for key in values)]
    text = "\n".join([*lines, f"settings = {{{settings}}}"])
    (folder / "submission.toml").write_text(text, encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def honest(tmp_path_factory):
    """A leaderboard that has run two configurations of MuJoCo."""
    root = tmp_path_factory.mktemp("board")
    (root / "board.toml").write_text(f"experiments = {json.dumps(NAMES)}\n")
    write_statement(root, "default")
    write_statement(root, "coarse", f"timestep_s = {1 / 900}", standing="shown")
    assert not check_leaderboard(root, run=True).faults
    return root


@pytest.fixture
def board(honest, tmp_path):
    """A copy to plant faults in."""
    return Path(shutil.copytree(honest, tmp_path / "board"))


def folder_of(board, configuration="default"):
    return board / "mujoco" / MUJOCO / configuration


def edit(file, change):
    """Change a result of an archive."""
    contents = read_archive(file)
    (name,) = (one for one in contents if "SlopeSlider-2" in one)
    result = json.loads(contents[name])
    change(result)
    write_archive(file, contents | {name: json.dumps(result).encode()})


def texts(check):
    return "\n".join(map(str, check.faults))


def records(text):
    return [json.loads(line) for line in text.splitlines() if line.startswith("{")]


# --- whose numbers count ---


def forge_trajectory(result):
    for sample in result["trajectory"]["samples"][1:]:
        sample[0] += 1.0


def forge_divergence(result):
    result["outcome"], result["diverged"] = "diverged", True


def forge_settings(result):
    result["settings"]["timestep_s"] = 1e-5


@pytest.mark.parametrize(
    "forge", [forge_trajectory, forge_divergence, forge_settings, None]
)
def test_a_run_replaces_what_a_submitter_sent(forge, board):
    folder = folder_of(board)
    if forge is None:
        (folder / ARCHIVE).write_bytes(b"no archive")
    else:
        edit(folder / ARCHIVE, forge)
        assert not check_leaderboard(folder).faults
    (one,) = check_leaderboard(folder, run=True).submissions
    assert one.ok
    expected = run_episode(RunRequest(NAMES[1]))
    assert one.results[1].trajectory == expected.trajectory
    assert one.results[1].settings == expected.settings
    assert one.results[1].score.rmse == pytest.approx(expected.score.rmse, rel=1e-12)


def test_scores_are_those_of_the_trajectories_and_wall_times_are_left_out(board):
    edit(folder_of(board) / ARCHIVE, lambda result: result["score"].update(rmse=0.5))
    (one,) = check_leaderboard(folder_of(board)).submissions
    assert one.results[1].score.rmse == pytest.approx(7.45, abs=0.05)
    assert one.results[1].wall_s is None


def test_a_diverged_episode_has_no_score(board):
    edit(folder_of(board) / ARCHIVE, forge_divergence)
    (one,) = check_leaderboard(folder_of(board)).submissions
    assert one.results[1].score.rmse is None
    assert not one.missing


def test_equal_results_give_an_archive_of_the_same_bytes(board):
    file = folder_of(board) / ARCHIVE
    before = file.read_bytes()
    write_archive(file, dict(reversed(read_archive(file).items())))
    assert file.read_bytes() == before


# --- faults ---


def restated(old, new):
    """Changes the statement of a submission."""

    def change(folder):
        file = folder / "submission.toml"
        text = file.read_text(encoding="utf-8")
        assert old in text
        file.write_text(text.replace(old, new), encoding="utf-8")

    return change


def result_with(**values):
    return lambda folder: edit(folder / ARCHIVE, lambda result: result.update(values))


def without_json(folder):
    files = read_archive(folder / ARCHIVE)
    write_archive(folder / ARCHIVE, files | {"results/x.json": b"score = 1"})


def twin(folder):
    shutil.copytree(folder, folder.with_name("twin"))
    restated('"default"', '"twin"')(folder.with_name("twin"))


def pipe(folder):
    (folder / ARCHIVE).unlink()
    os.mkfifo(folder / ARCHIVE)


def linked_member(folder):
    with tarfile.open(folder / ARCHIVE, "w:xz") as archive:
        member = tarfile.TarInfo("results/x.json")
        member.type, member.linkname = tarfile.SYMTYPE, "/etc/passwd"
        archive.addfile(member)


def large_member(folder):
    with tarfile.open(folder / ARCHIVE, "w:xz") as archive:
        member = tarfile.TarInfo("results/x.json")
        member.size = 9 * MEGABYTE
        with Path("/dev/zero").open("rb") as zeros:
            archive.addfile(member, zeros)


def content(*, size=None, start=None):
    def change(folder):
        file = folder / ARCHIVE
        file.write_bytes(start or file.read_bytes()[:size])

    return change


FAULTS = {
    "another format": restated("format = 1", "format = 2"),
    "no submitter": restated("submitter", "sender"),
    "no TOML": restated("settings = {", "settings = ["),
    "another folder": restated('configuration = "default"', 'configuration = "fast"'),
    "a path as engine": restated('engine = "mujoco"', 'engine = "../../etc"'),
    "a configuration twice": twin,
    "no results": lambda folder: (folder / ARCHIVE).unlink(),
    "a FIFO": pipe,
    "no archive": content(start=b"PK\x03\x04"),
    "half an archive": content(size=2_000),
    "a link in the archive": linked_member,
    "a large file in the archive": large_member,
    "no JSON": without_json,
    "another engine": result_with(backend="newton"),
    "other parameters": result_with(parameters="effective"),
    "other settings": result_with(settings_given={"timestep_s": 1e-4}),
    "another revision": result_with(revision=2),
    "another version": result_with(versions={"mujoco": "9.9.9"}),
    "another experiment": result_with(id="GAUGE/SlopeSlider-2-metal"),
}
"""What is wrong with a submission, and how it comes about in its folder."""


def test_a_fault_of_a_submission_is_found_and_nothing_else(
    honest, tmp_path, approved, monkeypatch
):
    monkeypatch.setattr(
        "gauge_envs.tools.leaderboard.archive.MAX_TOTAL_BYTES", 8 * MEGABYTE
    )
    lines = []
    for name, plant in FAULTS.items():
        copy = Path(shutil.copytree(honest, tmp_path / name / "board"))
        plant(folder_of(copy))
        check = check_leaderboard(copy)
        sound = [one.folder for one in check.submissions if one.ok]
        assert f"mujoco/{MUJOCO}/coarse" in sound, name
        count = 2 if name == "a configuration twice" else 1
        assert len(check.faults) == count, texts(check)
        lines.append(f"=== {name} ===\n{texts(check)}")
    text = "\n".join(lines).replace(MUJOCO, "VERSION")
    # The rest of a line is in the words of a library.
    text = re.sub(r": (Input should|String should|Expect)[^\n]*", ": ...", text)
    approved("leaderboard/faults", text)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"version": "4.1.0"}, "needs mujoco 4.1.0; installed here is"),
        ({"package": "pytest", "version": pytest.__version__}, "versions.pytest"),
        ({"package": "absent", "version": "1.0"}, "installed here is None"),
        ({"engine": "MuJoCo"}, "unknown backend 'MuJoCo'"),
    ],
)
def test_a_submission_that_cannot_run_here_has_no_results(changes, words, tmp_path):
    write_statement(tmp_path, "default", **changes)
    (tmp_path / "board.toml").write_text('experiments = ["SlopeSlider-1-wood"]')
    check = check_leaderboard(tmp_path, run=True)
    assert words in texts(check)
    assert not check.submissions[0].results


# --- the table ---


def test_table_has_intervals_and_no_mean_across_grades(gauge, honest):
    done = gauge("leaderboard", "table", honest, "--json")
    assert done.exit_code == 0, done.output
    found = records(done.stdout)
    standing = [one for one in found if one["record"] == "submission"]
    assert [one["configuration"] for one in standing] == ["default", "coarse"]
    assert [one["standing"] for one in standing] == ["ranked", "shown"]
    # The two experiments have references of two grades, and each mean is over one of them.
    grades = {one["grade"]: one["ids"] for one in found if one["record"] == "grade"}
    assert grades == {
        "trials": ["GAUGE/SlopeSlider-2-wood"],
        "law": ["GAUGE/SlopeSlider-1-wood"],
    }
    scored = [one for one in found if one.get("metric") == "rmse"]
    has_interval = {
        one["grade"]: [
            cell["normalized_95"] is not None for cell in one["configurations"]
        ]
        for one in scored
    }
    # The law is solved exactly, so that its distance has no interval and is over no trials.
    assert has_interval == {"trials": [True], "law": [False]}
    verified = {one["grade"] for one in found if one.get("metric") == "verification"}
    assert verified == {"law"}
    cells = [cell for one in scored for cell in one["configurations"]]
    assert all(cell["wall_s_per_sim_s"] is None for cell in cells)


def test_markdown_is_written_and_submitters_change_no_table(gauge, honest, tmp_path):
    assert gauge("leaderboard", "table", honest, "--out", tmp_path).exit_code == 0
    text = (tmp_path / "leaderboard.md").read_text(encoding="utf-8")
    (line,) = (line for line in text.splitlines() if "| coarse |" in line)
    assert "A [red]vendor[/] \\| \\<b>" in line
    assert "Cost" not in text
    rows = json.loads((tmp_path / "leaderboard.json").read_text(encoding="utf-8"))
    kinds = {one["record"] for one in rows}
    assert kinds == {"submission", "experiment", "grade"}


def test_one_configuration_of_an_engine_counts_in_ranks(gauge, board):
    """Others are shown, or reported by their submitter, and change no rank of the first."""
    alone = records(gauge("leaderboard", "table", folder_of(board), "--json").stdout)
    found = records(gauge("leaderboard", "table", board, "--json").stdout)
    # The rows of the submission that counts come first, as if there were no other.
    by_name = {one.get("configuration"): one for one in found}
    alone[0]["folder"] = by_name["default"]["folder"]
    assert found[: len(alone)] == alone
    file = folder_of(board, "coarse") / "submission.toml"
    shown = file.read_text(encoding="utf-8")
    file.write_text(shown.replace("shown", "reported"), encoding="utf-8")
    text = gauge("leaderboard", "table", board).stdout
    assert "Reported by their submitters" in text
    assert "Other configurations" not in text
    file.write_text(shown.replace("shown", "ranked"), encoding="utf-8")
    check = check_leaderboard(board)
    assert texts(check).count("one configuration of an engine counts in ranks") == 2
    assert not any(one.ok for one in check.submissions)


@pytest.mark.parametrize("outcome", ["failed", "declined"])
def test_what_an_engine_declines_counts_and_what_fails_is_listed_apart(
    outcome, gauge, board
):
    whole = records(gauge("leaderboard", "table", board, "--json").stdout)
    folder = write_statement(board, "one", "timestep_s = 0.001", standing="shown")
    files = read_archive(folder_of(board) / ARCHIVE)
    result = json.loads(files[SLIDER]) | {"settings_given": {"timestep_s": 0.001}}
    kept = {SLIDER: result, "left_out.json": {NAMES[0]: outcome}}
    write_archive(
        folder / ARCHIVE, {key: json.dumps(kept[key]).encode() for key in kept}
    )
    done = gauge("leaderboard", "table", board, "--json")
    assert done.exit_code == 0, done.output
    found = records(done.stdout)
    (row,) = (one for one in found if one.get("configuration") == "one")
    key = "missing" if outcome == "failed" else "declined"
    assert row[key] == [NAMES[0]]
    assert ("label" in row) == (outcome == "declined")
    others = [one for one in found if one["record"] != "submission"]
    before = [one for one in whole if one["record"] != "submission"]
    assert (others == before) == (outcome == "failed")


def test_an_engine_declines_a_scene_that_it_cannot_build(tmp_path):
    pytest.importorskip("rapier3d")
    stated = {"package": "rapier3d", "version": version("rapier3d")}
    folder = write_statement(tmp_path, "default", engine="rapier", **stated)
    names = ["BouncingBall-rubber", "Funnel-leather"]
    (tmp_path / "board.toml").write_text(f"experiments = {json.dumps(names)}")
    (one,) = check_leaderboard(folder, run=True).submissions
    assert one.ok and not one.missing
    assert one.declined == ("Funnel-leather",)
    assert [result.id for result in one.results] == ["GAUGE/BouncingBall-rubber"]


def test_a_fault_gives_exit_code_1_and_leaves_the_submission_out(gauge, board):
    result_with(revision=2)(folder_of(board, "coarse"))
    check = gauge("leaderboard", "check", board)
    assert check.exit_code == 1
    assert "run it again" in check.output
    table = gauge("leaderboard", "table", board, "--json")
    assert table.exit_code == 1
    standing = [one for one in records(table.stdout) if one["record"] == "submission"]
    assert [one["configuration"] for one in standing] == ["default"]


@pytest.mark.parametrize(
    "options", [[], ["--json"], ["--format", "markdown"], ["--out", "site"]]
)
def test_a_leaderboard_without_a_valid_submission_has_an_empty_table(
    options, tmp_path, gauge
):
    folder = tmp_path / "board" / "mujoco" / "1.0" / "default"
    folder.mkdir(parents=True)
    (folder / "submission.toml").write_text("format = 2")
    result = gauge("leaderboard", "table", "board", *options)
    assert result.exit_code == 1 and isinstance(result.exception, SystemExit)
    assert "left out:" in result.stderr


def test_a_folder_without_a_submission_gives_exit_code_2(gauge, tmp_path):
    done = gauge("leaderboard", "check", tmp_path / "absent")
    assert done.exit_code == 2
    assert "holds no submission" in done.output


def test_a_leaderboard_asks_for_the_experiments_of_its_file(gauge, board):
    assert "2 of 2" in gauge("leaderboard", "check", board).output
    # A submission alone is checked against the file of its leaderboard.
    assert "2 of 2" in gauge("leaderboard", "check", folder_of(board)).output
    (board / "board.toml").write_text('experiments = ["SlopeSlider-1-*"]\n')
    check = check_leaderboard(board)
    assert "SlopeSlider-2-wood', which the leaderboard does not ask for" in texts(check)
    missing = ("SlopeSlider-1-plastic", "SlopeSlider-1-metal")
    assert [one.missing for one in check.submissions] == [missing] * 2


@pytest.mark.parametrize(
    "text", ['experiments = ["SlopSlider-*"]', "experiments = 3", "format = 1", "["]
)
def test_a_file_that_states_no_experiments_is_refused(gauge, board, text):
    (board / "board.toml").write_text(text, encoding="utf-8")
    done = gauge("leaderboard", "check", board)
    assert done.exit_code == 2
    said = " ".join(done.output.split())
    assert "expected `experiments`, a list of ids or patterns" in said


# --- the workflow ---


def workflow_step(job, identity):
    """Return the commands of a step of the real workflow."""
    workflow = (ROOT / ".github" / "workflows" / "leaderboard.yml").read_text()
    steps = yaml.safe_load(workflow)["jobs"][job]["steps"]
    (step,) = (one for one in steps if one.get("id") == identity)
    return step["run"]


def changed_folders(tree, changed):
    """Run the step of the real workflow that finds what to run, after a file of a repository changed."""
    step = workflow_step("changed", "changed")
    commit = "git -c user.name=a -c user.email=a@b commit -q -m text"
    output = tree / "output"
    change = f"echo '#' >> 'leaderboard/{changed}'; git add .; {commit}"
    commands = f"git init -q; git add .; {commit}; {change}; {step}"
    environment = {**os.environ, "GITHUB_OUTPUT": str(output)}
    subprocess.run(
        ["bash", "-e", "-c", commands], cwd=tree, check=True, env=environment
    )
    name, _, folders = output.read_text().strip().partition("=")
    assert name == "folders"
    return json.loads(folders)


@pytest.mark.skipif(shutil.which("jq") is None, reason="jq is not installed")
@pytest.mark.parametrize(
    ("changed", "run"),
    [
        ("mujoco/VERSION/default/results.tar.xz", ["default"]),
        ("mujoco/VERSION/coarse/submission.toml", ["coarse"]),
        ("mujoco/VERSION/coarse/notes.txt", ["coarse"]),
        ("board.toml", ["coarse", "default"]),
        ("README.txt", []),
    ],
)
def test_the_workflow_runs_every_submission_that_a_change_touches(
    changed, run, honest, tmp_path
):
    shutil.copytree(honest, tmp_path / "leaderboard")
    found = changed_folders(tmp_path, changed.replace("VERSION", MUJOCO))
    assert found == [f"leaderboard/mujoco/{MUJOCO}/{name}" for name in run]


STUBS = """
python() { if test "$1" = -m; then echo "$@" >&2; else command "$PYTHON" "$@"; fi; }
gauge() { echo "$@"; }
"""
"""Commands of the workflow that install and run."""


@pytest.mark.parametrize(
    ("settings", "standing", "is_run"),
    [
        ("", "ranked", True),
        ("", "shown", True),
        ("", "reported", False),
        # The same words within another value state nothing.
        ('name = """\nstanding = "reported"\n"""', "ranked", True),
    ],
)
def test_the_workflow_runs_all_that_is_not_stated_as_reported(
    settings, standing, is_run, tmp_path
):
    write_statement(tmp_path / "leaderboard", "one", standing=standing)
    folder = Path("leaderboard/mujoco") / MUJOCO / "one"
    file = tmp_path / folder / "submission.toml"
    text = file.read_text(encoding="utf-8").replace("settings = {}", "")
    file.write_text(f"{text}[settings]\n{settings}\n", encoding="utf-8")
    done = subprocess.run(
        ["bash", "-e", "-c", STUBS + workflow_step("run", "run")],
        cwd=tmp_path,
        check=True,
        capture_output=True,
        text=True,
        env={**os.environ, "FOLDER": str(folder), "PYTHON": sys.executable},
    )
    option = " --run" if is_run else ""
    assert done.stdout == f"leaderboard check {folder}{option}\n"
    assert (f"mujoco=={MUJOCO}" in done.stderr) == is_run
