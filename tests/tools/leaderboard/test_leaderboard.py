"""Leaderboard: its own runs count alone, planted faults are found, and the table compares what can be compared."""

import itertools
import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest
import yaml
from places import ROOT

from gauge_envs import files, load_experiment
from gauge_envs.backends import Repeatability
from gauge_envs.backends.mujoco import BackendMuJoCo
from gauge_envs.evaluation.reference import reference_band
from gauge_envs.files import MEGABYTE
from gauge_envs.pages.text import markdown_text
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
    (folder / "submission.toml").write_text(text)
    return folder


@pytest.fixture(scope="module")
def honest(tmp_path_factory):
    """A leaderboard that has run two configurations of MuJoCo."""
    root = tmp_path_factory.mktemp("board")
    (root / "board.toml").write_text(f"experiments = {json.dumps(NAMES)}\n")
    write_statement(root, "default")
    write_statement(root, "coarse", f"timestep_s = {1 / 900}", standing="shown")
    assert not faults(root, run=True)
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


def faults(board, **options):
    """Return the faults of a leaderboard or a submission."""
    return [
        f"{one.folder}: {fault}"
        for one in check_leaderboard(board, **options)
        for fault in one.faults
    ]


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
        assert not faults(folder)
    (one,) = check_leaderboard(folder, run=True)
    assert not one.faults
    expected = run_episode(RunRequest(NAMES[1]))
    assert one.results[1].trajectory == expected.trajectory
    assert one.results[1].settings == expected.settings
    assert one.results[1].score.rmse == pytest.approx(expected.score.rmse, rel=1e-12)


def test_scores_are_those_of_the_trajectories_and_wall_times_are_left_out(board):
    edit(folder_of(board) / ARCHIVE, lambda result: result["score"].update(rmse=0.5))
    (one,) = check_leaderboard(folder_of(board))
    assert one.results[1].score.rmse == pytest.approx(7.45, abs=0.05)
    assert one.results[1].wall_s is None


def test_a_diverged_episode_has_no_score(board):
    edit(folder_of(board) / ARCHIVE, forge_divergence)
    (one,) = check_leaderboard(folder_of(board))
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
        text = file.read_text()
        assert old in text
        file.write_text(text.replace(old, new))

    return change


def result_with(**values):
    return lambda folder: edit(folder / ARCHIVE, lambda result: result.update(values))


def without_json(folder):
    contents = read_archive(folder / ARCHIVE)
    write_archive(folder / ARCHIVE, contents | {"results/x.json": b"score = 1"})


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
    "another revision": result_with(revision=99),
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
        found = faults(copy)
        assert not any(f"mujoco/{MUJOCO}/coarse" in one for one in found), name
        count = 2 if name == "a configuration twice" else 1
        assert len(found) == count, found
        lines += [f"=== {name} ===", *found]
    text = "\n".join(lines).replace(MUJOCO, "VERSION")
    # The rest of a line is in the words of a library.
    text = re.sub(r": (Input should|String should|Expect)[^\n]*", ": ...", text)
    approved("leaderboard/faults", text)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"version": "4.1.0"}, "needs mujoco 4.1.0; installed here: mujoco = "),
        ({"package": "pytest", "version": pytest.__version__}, "needs pytest"),
        ({"engine": "MuJoCo"}, "unknown backend 'MuJoCo'"),
    ],
)
def test_a_submission_that_cannot_run_here_has_no_results(changes, words, tmp_path):
    write_statement(tmp_path, "default", **changes)
    (tmp_path / "board.toml").write_text('experiments = ["SlopeSlider-1-wood"]')
    (one,) = check_leaderboard(tmp_path, run=True)
    assert words in one.faults[0]
    assert not one.results


def test_an_engine_whose_runs_differ_has_no_rank(board, monkeypatch):
    folder = folder_of(board)
    declared = Repeatability(kind="statistical", start_error=1e-6)
    with monkeypatch.context() as patch:
        patch.setattr(BackendMuJoCo, "repeatability", lambda self, settings: declared)
        (fault,) = faults(folder, run=True)
        assert 'state standing = "shown"' in fault
        assert not faults(folder_of(board, "coarse"), run=True)
    runs = itertools.count()

    def build(self, scene, settings=None):
        gravity = scene.gravity_m_per_s2 + 1e-9 * next(runs)
        return build_alike(self, replace(scene, gravity_m_per_s2=gravity), settings)

    build_alike = BackendMuJoCo.build
    monkeypatch.setattr(BackendMuJoCo, "build", build)
    (fault,) = faults(folder, run=True)
    assert "two runs have different trajectories" in fault


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


def test_submitters_change_no_table(gauge, honest):
    text = gauge("leaderboard", "table", honest, "--format", "markdown").stdout
    (line,) = (line for line in text.splitlines() if "| coarse |" in line)
    assert "A [red]vendor[/] \\| \\<b>" in line
    assert "Cost" not in text
    assert markdown_text(files.processor()) in line
    rows = records(gauge("leaderboard", "table", honest, "--json").stdout)
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
    shown = file.read_text()
    file.write_text(shown.replace("shown", "reported"))
    text = gauge("leaderboard", "table", board).stdout
    assert "Reported by their submitters" in text
    assert "Other configurations" not in text
    file.write_text(shown.replace("shown", "ranked"))
    found = faults(board)
    assert len(found) == 2
    assert all("one configuration of an engine counts in ranks" in one for one in found)


@pytest.mark.parametrize("outcome", ["failed", "declined"])
def test_what_an_engine_declines_counts_and_what_fails_is_listed_apart(
    outcome, gauge, board
):
    whole = records(gauge("leaderboard", "table", board, "--json").stdout)
    folder = write_statement(board, "one", "timestep_s = 0.001", standing="shown")
    contents = read_archive(folder_of(board) / ARCHIVE)
    result = json.loads(contents[SLIDER]) | {"settings_given": {"timestep_s": 0.001}}
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
    (one,) = check_leaderboard(folder, run=True)
    assert not one.faults and not one.missing
    assert one.declined == ("Funnel-leather",)
    assert [result.id for result in one.results] == ["GAUGE/BouncingBall-rubber"]


def test_a_fault_gives_exit_code_1_and_leaves_the_submission_out(gauge, board):
    result_with(revision=99)(folder_of(board, "coarse"))
    check = gauge("leaderboard", "check", board)
    assert check.exit_code == 1
    assert "run it again" in check.output
    table = gauge("leaderboard", "table", board, "--json")
    assert table.exit_code == 1
    standing = [one for one in records(table.stdout) if one["record"] == "submission"]
    assert [one["configuration"] for one in standing] == ["default"]


@pytest.mark.parametrize("options", [[], ["--json"], ["--format", "markdown"]])
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
    missing = ("SlopeSlider-1-plastic", "SlopeSlider-1-metal")
    for one in check:
        assert "does not ask for 'GAUGE/SlopeSlider-2-wood'" in one.faults[0]
        assert one.missing == missing


@pytest.mark.parametrize(
    "text", ['experiments = ["SlopSlider-*"]', "experiments = 3", "format = 1", "["]
)
def test_a_file_that_states_no_experiments_is_refused(gauge, board, text):
    (board / "board.toml").write_text(text)
    done = gauge("leaderboard", "check", board)
    assert done.exit_code == 2
    said = " ".join(done.output.split())
    assert "expected `experiments`, a list of ids or patterns" in said


# --- the workflow ---


WORKFLOW = yaml.safe_load(
    (ROOT / ".github" / "workflows" / "leaderboard.yml").read_text()
)


def workflow_step(job, identity):
    """Return the commands of a step of the real workflow."""
    steps = WORKFLOW["jobs"][job]["steps"]
    (step,) = (one for one in steps if one.get("id") == identity)
    return step["run"]


HASHES = "scripts/board_hashes.py"
COMMIT = "git add . && git -c user.name=a -c user.email=a@b commit -q -m text"


def bash(commands, tree, **environment):
    """Run commands as the workflow does, in a folder."""
    environment = WORKFLOW["env"] | environment
    path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    return subprocess.run(
        ["bash", "-e", "-c", commands],
        cwd=tree,
        env={**os.environ, "PATH": path, **environment},
        capture_output=True,
        text=True,
        check=False,
    )


def committed(board, tree):
    """Return a repository with a copy of a leaderboard."""
    shutil.copytree(board, tree / "leaderboard", symlinks=True)
    (tree / "scripts").mkdir()
    shutil.copy(ROOT / HASHES, tree / "scripts")
    begin = f"python {HASHES} write && git init -q && {COMMIT}"
    assert bash(begin, tree).returncode == 0
    return tree


def changed_folders(tree, base="HEAD^1"):
    """Run the step of the real workflow that finds what to run, after a change of a repository was committed."""
    output = tree / ".git" / "output"
    step = workflow_step("changed", "changed")
    done = bash(step, tree, GITHUB_OUTPUT=str(output), BASE=base)
    assert done.returncode == 0, done.stderr
    name, _, folders = output.read_text().strip().partition("=")
    assert name == "folders"
    return json.loads(folders)


needs_jq = pytest.mark.skipif(shutil.which("jq") is None, reason="jq is not installed")


@needs_jq
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
    tree = committed(honest, tmp_path)
    file = tree / "leaderboard" / changed.replace("VERSION", MUJOCO)
    with file.open("a") as stream:
        stream.write("#")
    assert bash(COMMIT, tree).returncode == 0
    assert changed_folders(tree) == [
        f"leaderboard/mujoco/{MUJOCO}/{name}" for name in run
    ]


STUBS = """
python() { if test "$1" = -m; then echo "$@" >&2; else command "$PYTHON" "$@"; fi; }
"""
"""Commands of the workflow that install."""

GAUGE_STUB = 'gauge() { echo "$@"; }\n'


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
    text = file.read_text().replace("settings = {}", "")
    file.write_text(f"{text}[settings]\n{settings}\n")
    step = STUBS + GAUGE_STUB + workflow_step("run", "run")
    done = bash(step, tmp_path, FOLDER=str(folder), PYTHON=sys.executable)
    assert done.returncode == 0, done.stderr
    option = " --run" if is_run else ""
    assert done.stdout == f"leaderboard check {folder}{option}\n"
    assert (f"mujoco=={MUJOCO}" in done.stderr) == is_run


# --- forgeries ---


def real_mean(before, experiment, late=0):
    """Return samples with the real mean in place of the coordinates that it has, some frames late."""
    mean = np.nan_to_num(reference_band(load_experiment(experiment)).mean)
    after = before.copy()
    count = min(len(mean), len(before)) - late
    after[late : late + count, : mean.shape[1]] = mean[:count]
    return after


def samples(change):
    """Changes the trajectory in the archive of MuJoCo's submission."""

    def forge(board):
        def changed(result):
            before = np.array(result["trajectory"]["samples"])
            after = change(before, result["id"])
            result["trajectory"]["samples"] = after.tolist()

        edit(folder_of(board) / ARCHIVE, changed)

    return forge


def values(**changes):
    return lambda board: result_with(**changes)(folder_of(board))


def stated(**changes):
    """Adds a submission with an archive of another one."""

    def forge(board):
        folder = write_statement(board, "more", **changes)
        shutil.copy(folder_of(board) / ARCHIVE, folder)

    return forge


def left_out(board):
    file = folder_of(board) / ARCHIVE
    contents = read_archive(file)
    del contents[SLIDER]
    outcome = json.dumps({NAMES[1]: "declined"}).encode()
    write_archive(file, contents | {"left_out.json": outcome})


def many(board):
    for index in range(8):
        step_s = 1 / 1800 + index * 1e-9
        write_statement(board, f"more{index}", f"timestep_s = {step_s}")


def reported(board):
    file = folder_of(board) / "submission.toml"
    with file.open("a") as stream:
        stream.write('\nstanding = "reported"\n')


def linked(board):
    """The results are a link to a file of the repository, which nothing may write."""
    file = folder_of(board) / ARCHIVE
    file.rename(board / "kept")
    file.symlink_to(board / "kept")


def climbing(board):
    file = folder_of(board) / ARCHIVE
    write_archive(file, read_archive(file) | {"../../../../out.json": b"{}"})


def deeper(board):
    shutil.copytree(folder_of(board), folder_of(board) / "inner")


def other_folder(board):
    edit(folder_of(board, "coarse") / ARCHIVE, forge_trajectory)


def page(board):
    (board / "leaderboard.md").write_text("| mujoco | 1 |")


def fewer(board):
    (board / "board.toml").write_text('experiments = ["SlopeSlider-1-wood"]')


def moved(board):
    (folder_of(board) / ARCHIVE).rename(board / "kept.tar.xz")


def twin_link(board):
    folder_of(board, "link").symlink_to("default")


def engine_link(board):
    (board / "newton").symlink_to("mujoco")


def own_hash(board):
    """The list of hashes has that of the forged results."""
    edit(folder_of(board) / ARCHIVE, forge_trajectory)
    bash(f"python {HASHES} write", board.parent)


def own_module(board):
    (board.parent / "tomllib.py").write_text("def load(file): return {}")
    reported(board)


def own_attributes(board):
    """What is checked out differs from what the pull request shows."""
    text = "submission.toml working-tree-encoding=UTF-16\n"
    (board / ".gitattributes").write_text(text)


def option_as_package(board):
    restated('package = "mujoco"', 'package = "-h"')(folder_of(board))


def twice_in_archive(board):
    """A second file of the same experiment has a better score."""
    file = folder_of(board) / ARCHIVE
    contents = read_archive(file)
    result = json.loads(contents[SLIDER])
    result["trajectory"]["samples"] = [[0.0, 0.0, 0.0]] * 9
    write_archive(file, contents | {"results/z.json": json.dumps(result).encode()})


def endless(board):
    file = folder_of(board) / "submission.toml"
    text = file.read_text()
    file.write_text(text.replace("{}", '{ timestep_s = "1e-9" }'))


def older_list(board):
    (board / "computed.sha256").unlink()
    edit(folder_of(board) / ARCHIVE, forge_trajectory)


FORGERIES = {
    # The eighteen with which a board of submitted trajectories was deceived.
    "one result is the real mean, a frame late": (
        samples(lambda x, name: real_mean(x, name, late=1)),
        "void",
    ),
    "the real mean": (samples(real_mean), "void"),
    "2 % slower": (samples(lambda x, _: x[:1] + 0.98 * (x - x[:1])), "void"),
    "with noise": (
        samples(lambda x, _: x + np.random.default_rng(0).normal(0, 0.1, x.shape)),
        "void",
    ),
    "98 % of the way to the mean": (
        samples(lambda x, name: 0.02 * x + 0.98 * real_mean(x, name)),
        "void",
    ),
    "a quarter of the step under the name default": (
        values(settings={"timestep_s": 1 / 7200}),
        "void",
    ),
    "tuned friction": (values(asset={"edited": True}), "void"),
    "another engine's trajectory": (
        lambda board: shutil.copy(
            folder_of(board, "coarse") / ARCHIVE, folder_of(board)
        ),
        "void",
    ),
    "called diverged": (values(outcome="diverged", diverged=True), "void"),
    "a version that does not exist": (stated(version="99.0.0"), "red"),
    "a package more": (values(versions={"mujoco": MUJOCO, "more": "1"}), "void"),
    "capitals in the engine": (stated(engine="MuJoCo"), "red"),
    "a dot behind the engine": (stated(engine="mujoco."), "red"),
    "eight more of an engine": (many, "red"),
    "fewer experiments": (fewer, "other ids"),
    "the folder of another one": (other_folder, "void"),
    "a score in the file": (values(score={"grade": "trials", "rmse": 0.0}), "void"),
    "no file but the result changes": (
        lambda board: (folder_of(board) / ARCHIVE).write_bytes(b"PK"),
        "void",
    ),
    # Ten more.
    "called declined": (left_out, "void"),
    "called reported": (reported, "unranked"),
    "a page by hand": (page, "void"),
    "a link in place of the results": (linked, "void"),
    "a name that climbs": (climbing, "void"),
    "a submission in a submission": (deeper, "void"),
    "another package": (stated(package="pip", version=version("pip")), "red"),
    "the folder of another version": (
        lambda board: restated(MUJOCO, "0.0.1")(folder_of(board)),
        "red",
    ),
    "an engine as a path": (
        lambda board: restated('"mujoco"', '"../mujoco"')(folder_of(board)),
        "red",
    ),
    "results removed": (
        lambda board: (folder_of(board) / ARCHIVE).unlink(),
        "void",
    ),
    # Ten more.
    "results moved away": (moved, "void"),
    "a link to a submission": (twin_link, "red"),
    "a link to an engine": (engine_link, "red"),
    "the hash of forged results": (own_hash, "void"),
    "a module beside the workflow": (own_module, "unranked"),
    "another text in the checkout": (own_attributes, "void"),
    "an option as a package": (option_as_package, "red"),
    "an experiment twice": (twice_in_archive, "void"),
    "a step that is a text": (endless, "red"),
    "no hashes": (older_list, "void"),
}
"""How a pull request forges a board, and what becomes of it: nothing (`void`), no merge (`red`), or what it states."""


def ranked_rows(tree):
    """Return what the table has of the ranked submissions."""
    rows = records(bash("gauge leaderboard table --json", tree).stdout)
    return [
        one
        for one in rows
        if one["record"] != "submission" or one["standing"] == "ranked"
    ]


def merged(tree, folders):
    """Run the steps of the real workflow that run submissions and write the table; return whether all succeeded."""
    for folder in folders:
        step = STUBS + workflow_step("run", "run")
        done = bash(step, tree, FOLDER=folder, PYTHON=sys.executable)
        if done.returncode:
            return False
        computed = tree / "computed" / folder.replace("/", "-")
        computed.mkdir(parents=True)
        shutil.copy(tree / folder / ARCHIVE, computed)
        # Each job has a checkout of its own, so that the table starts with what was sent.
        bash(f"git checkout -q -- '{folder}'", tree)
    summary = str(tree / ".git" / "summary")
    environment = {"FOLDERS": json.dumps(folders), "GITHUB_STEP_SUMMARY": summary}
    return not bash(workflow_step("table", "table"), tree, **environment).returncode


@pytest.fixture(scope="module")
def honest_rows(honest, tmp_path_factory):
    return ranked_rows(committed(honest, tmp_path_factory.mktemp("tree")))


@needs_jq
@pytest.mark.parametrize("is_reported", [False, True])
def test_results_that_were_not_computed_here_do_not_count(
    is_reported, honest, tmp_path
):
    """A run may fail after the merge, and a submission that was reported may be ranked by a later change."""
    tree = committed(honest, tmp_path)
    edit(folder_of(tree / "leaderboard") / ARCHIVE, forge_trajectory)
    if is_reported:
        reported(tree / "leaderboard")
    assert merged(tree, []) == is_reported
    assert (folder_of(tree / "leaderboard") / ARCHIVE).exists() == is_reported
    if is_reported:
        restated('"reported"', '"ranked"')(folder_of(tree / "leaderboard"))
    assert not merged(tree, [])


@needs_jq
@pytest.mark.slow
@pytest.mark.parametrize("name", FORGERIES)
@pytest.mark.parametrize("commits", [1, 2])
def test_a_forgery_changes_no_rank(name, commits, honest, honest_rows, tmp_path):
    """The real steps of the workflow run on a copy of the board; a merge may bring several commits."""
    if commits == 2 and name != "the real mean":
        pytest.skip("one forgery is enough to see whether all commits are read")
    tree = committed(honest, tmp_path)
    forge, expected = FORGERIES[name]
    forge(tree / "leaderboard")
    more = f" && touch leaderboard/notes && {COMMIT}" if commits == 2 else ""
    assert bash(COMMIT + more, tree).returncode == 0
    is_merged = merged(tree, changed_folders(tree, f"HEAD~{commits}"))
    assert is_merged == (expected != "red")
    page = tree / "leaderboard" / "leaderboard.md"
    found = ranked_rows(tree)
    if expected == "void":
        assert found == honest_rows
        assert "| mujoco | 1 |" not in page.read_text()
    if expected == "unranked":
        assert not any(one["record"] == "submission" for one in found)
        assert "Reported by their submitters" in page.read_text()
    if name == "a link in place of the results":
        kept = (tree / "leaderboard" / "kept").read_bytes()
        assert kept == (folder_of(honest) / ARCHIVE).read_bytes()
