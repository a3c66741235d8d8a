"""Leaderboard: a good submission passes, and each planted fault is found with a message that says what it is."""

import hashlib
import io
import json
import os
import re
import shutil
import tarfile
from base64 import urlsafe_b64encode
from collections.abc import Callable
from dataclasses import replace
from importlib.metadata import version as installed_version
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from gauge_envs.errors import ResultFileError
from gauge_envs.evaluation.reference import reference_band
from gauge_envs.evaluation.score import score_trajectory
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.experiments.variants import variants
from gauge_envs.runs.episodes import run_episode
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result import MARKER_DECIMALS, Outcome, RecordedTrajectory
from gauge_envs.runs.result_file import load_result, result_file_name, write_result
from gauge_envs.scene.timing import FRAME_RATE_HZ, SAMPLES_PER_FRAME
from gauge_envs.tools.leaderboard import check_leaderboard, false_scores
from gauge_envs.tools.leaderboard.archive import archived_files
from gauge_envs.tools.leaderboard.reruns import rerun, rerun_sample
from gauge_envs.tools.leaderboard.submission import installed_package
from gauge_envs.tools.leaderboard.trajectory import (
    copied_reference,
    rescored,
    start_values,
)

NAMES = ("SlopeSlider-1-wood", "SlopeSlider-2-wood", "NonsmoothContact-1-wood")

Edit = Callable[[dict[str, Any]], None]


def statement(results, **changes):
    """Text of a submission.toml that leaves out all experiments without a result."""
    values = {
        "engine": "mujoco",
        "package": "mujoco",
        "version": results[0].versions["mujoco"],
        "configuration": "default",
        "submitter": "A vendor",
    } | changes
    present = {result.id for result in results}
    lines = [
        "format = 1",
        *(f"{key} = {json.dumps(text)}" for key, text in values.items()),
        "[left_out]",
    ]
    lines += [
        f'"{variant.name}" = "not run"'
        for variant in variants()
        if variant.id not in present
    ]
    return "\n".join(lines) + "\n"


def write_submission(root, results):
    folder = root / "mujoco" / results[0].versions["mujoco"] / "default"
    (folder / "results").mkdir(parents=True)
    (folder / "submission.toml").write_text(statement(results), encoding="utf-8")
    for result in results:
        write_result(result, folder / "results" / result_file_name(result))
    return folder


@pytest.fixture(scope="module")
def honest(tmp_path_factory):
    """A leaderboard with one good submission."""
    root = tmp_path_factory.mktemp("board")
    write_submission(root, [run_episode(RunRequest(name)) for name in NAMES])
    return root


@pytest.fixture
def board(honest, tmp_path):
    """A copy to plant faults in."""
    return Path(shutil.copytree(honest, tmp_path / "board"))


def submission(board):
    (file,) = board.glob("*/*/*/submission.toml")
    return file.parent


def result_file(board, name="SlopeSlider-2-wood"):
    return submission(board) / "results" / f"{name}.mujoco.calibrated.json"


def edit(file, change):
    content = json.loads(file.read_text(encoding="utf-8"))
    change(content)
    file.write_text(json.dumps(content), encoding="utf-8")


def set_value(place, value):
    def change(content):
        new = value(content) if callable(value) else value
        *path, last = place.split(".")
        for part in path:
            content = content[int(part) if isinstance(content, list) else part]
        content[int(last) if isinstance(content, list) else last] = new

    return change


def texts(check):
    return "\n".join(map(str, check.all_faults))


def only_fault(board):
    """Text of the one fault of a leaderboard."""
    check = check_leaderboard(board)
    assert len(check.all_faults) == 1, texts(check)
    return str(check.all_faults[0])


def sampled(frames):
    """Interpolate between frames."""
    times = np.arange((len(frames) - 1) * SAMPLES_PER_FRAME + 1) / SAMPLES_PER_FRAME
    return np.column_stack(
        [np.interp(times, np.arange(len(frames)), column) for column in frames.T]
    )


def replace_samples(board, name, forge):
    """Replace the samples of a result, the later ones included, with the scores that these give."""
    file = result_file(board, name)
    result = load_result(file)
    experiment = load_experiment(result.id)
    samples = forge(result.trajectory.arrays(later=True)[1].copy())
    times_s = np.arange(len(samples)) / (FRAME_RATE_HZ * SAMPLES_PER_FRAME)
    forged = replace(
        result, trajectory=RecordedTrajectory.of(experiment, times_s, samples)
    )
    write_result(replace(forged, score=rescored(forged, experiment).score), file)


def replace_trajectory(board, name, frames):
    """Replace the trajectory of a result by frames, interpolated, with the scores that these give."""
    replace_samples(board, name, lambda samples: sampled(frames))


# --- a good submission -----------------------------------------------------------------------------------------------


def test_a_good_submission_passes(honest):
    check = check_leaderboard(honest)
    assert check.ok, texts(check)
    (one,) = check.submissions
    assert {result.id for result in one.results} == {f"GAUGE/{name}" for name in NAMES}


def test_a_single_submission_can_be_checked(honest):
    assert check_leaderboard(submission(honest)).ok


def test_the_table_has_the_scores_of_the_trajectories_and_no_wall_times(honest):
    (one,) = check_leaderboard(honest).submissions
    for result in one.results:
        stated = load_result(result_file(honest, result.id.removeprefix("GAUGE/")))
        assert result.score.rmse == pytest.approx(stated.score.rmse, rel=1e-12)
        assert stated.wall_s is not None
        assert result.wall_s is None


def test_rerun_has_the_same_bits(honest):
    (one,) = check_leaderboard(honest, rerun_count=2).submissions
    assert [(again.status.value, again.largest_difference) for again in one.reruns] == [
        ("equal", 0.0)
    ] * 2


def test_the_start_follows_from_the_scene_alone(rollout):
    _, trajectory, _ = rollout("SlopeSlider-2-wood")
    assert start_values(load_experiment("SlopeSlider-2-wood")) == pytest.approx(
        trajectory.samples[0], abs=1e-9
    )


# --- planted faults in a result --------------------------------------------------------------------------------------

EDITS = (
    ("score.rmse", 1.25),
    ("score.percentile", 1.0),
    ("score.grade", "law"),
    ("score.withheld", "low quality"),
    ("revision", 2),
    ("versions.mujoco", "9.9.9"),
    ("versions", {}),
    ("backend", "newton"),
    ("parameters", "effective"),
    ("settings_given", {"timestep_s": 1e-4}),
    ("seed", 3),
    ("jitter", {"position_m": 0.001}),
    ("marker_proxy", "node"),
    ("dataset.reference", "imported"),
    ("outcome", "failed"),
    ("id", "GAUGE/CubeToss-1"),
    ("frames", 12),
    ("sim_s", 9.0),
    ("diverged", True),
    ("trajectory.unit", "m"),
    ("trajectory.coordinates", ["x", "y", "z"]),
    ("trajectory.samples.50", [None] * 3),
    ("trajectory.times_s.50", 0.2751),
    ("trajectory.samples.0.0", 1.0),
    ("trajectory.samples.60.0", 9e3),
    ("trajectory.samples.60", lambda content: content["trajectory"]["samples"][62]),
)
"""Places of a result file, and what is written there."""


def stable(text):
    """Faults without the version, words of libraries, and digits that depend on the processor."""
    text = text.replace(installed_version("mujoco"), "VERSION")
    text = re.sub(r": (Input should|String should|Expect)[^\n]*", ": ...", text)
    return re.sub(r"((?:states|gives) \d\.\d\d)[\de.-]*", r"\1", text)


def test_an_edited_result_is_found(board, approved):
    """The approved faults name the file, and its result is in no table."""
    file, lines = result_file(board), []
    content = file.read_text(encoding="utf-8")
    for place, value in EDITS:
        file.write_text(content, encoding="utf-8")
        edit(file, set_value(place, value))
        check = check_leaderboard(board)
        assert not check.ok, place
        ids = {one.id for one in check.submissions[0].results}
        assert "GAUGE/SlopeSlider-2-wood" not in ids, place
        lines.append(f"=== {place} ===\n{texts(check)}")
    approved("leaderboard/edits", stable("\n".join(lines)))


def restated(old, new):
    """Changes the statement of a submission."""

    def change(folder):
        file = folder / "submission.toml"
        text = file.read_text(encoding="utf-8")
        assert old in text
        file.write_text(text.replace(old, new), encoding="utf-8")

    return change


def result_of(folder):
    return folder / "results" / "SlopeSlider-2-wood.mujoco.calibrated.json"


def sparse(size_bytes, count=1):
    """Adds results of a size that take no room."""

    def change(folder):
        for number in range(count):
            with (folder / "results" / f"{number}.json").open("wb") as stream:
                stream.truncate(size_bytes)

    return change


def twin(folder):
    shutil.copytree(folder, folder.with_name("twin"))
    restated('"default"', '"twin"')(folder.with_name("twin"))


def archived_beside(folder):
    members = result_members(folder)
    shutil.copytree(folder / "results", folder / "kept")
    write_archive(folder, members)
    (folder / "kept").rename(folder / "results")


def linked_results(folder):
    (folder / "results").rename(folder.parents[3] / "elsewhere")
    (folder / "results").symlink_to(folder.parents[3] / "elsewhere")


def other_versions(folder):
    edit(result_of(folder), set_value("versions.mujoco-warp", "1.0"))


LEFT_OUT = "[left_out]"
FAULTS = {
    "no JSON": lambda folder: result_of(folder).write_text("score = 1"),
    "another name": lambda folder: result_of(folder).rename(
        folder / "results" / "best.json"
    ),
    "two results of one": lambda folder: shutil.copy(
        result_of(folder),
        folder / "results" / "SlopeSlider-2-wood.mujoco.calibrated.seed-1.json",
    ),
    "no result": lambda folder: result_of(folder).unlink(),
    "other versions": other_versions,
    "a link": lambda folder: (folder / "results/x.json").symlink_to(folder),
    "linked results": linked_results,
    "a linked configuration": lambda folder: folder.with_name("x").symlink_to(folder),
    "a linked version": lambda folder: (folder.parents[1] / "x").symlink_to(folder),
    "a linked engine": lambda folder: (folder.parents[2] / "x").symlink_to(folder),
    "a file of 1 GB": sparse(10**9),
    "many large files": sparse(31 * 10**6, 9),
    "a FIFO": lambda folder: os.mkfifo(folder / "results/pipe.json"),
    "a script": lambda folder: (folder / "results/run.sh").touch(),
    "a hidden file": lambda folder: (folder / "results/.x.json").touch(),
    "a module": lambda folder: (folder / "setup.py").touch(),
    "no statement": lambda folder: (folder / "submission.toml").unlink(),
    "an archive beside files": archived_beside,
    "a configuration twice": twin,
    "another format": restated("format = 1", "format = 2"),
    "no submitter": restated('submitter = "A vendor"', ""),
    "an unknown key": restated("format = 1", "format = 1\nscore = 3"),
    "no TOML": restated(LEFT_OUT, "[left_out"),
    "an unknown pattern": restated(LEFT_OUT, f'{LEFT_OUT}\n"Sphere*" = "error"'),
    "left out with a result": restated(LEFT_OUT, f'{LEFT_OUT}\n"Slope*" = "error"'),
    "another folder": restated('configuration = "default"', 'configuration = "fast"'),
    **{
        f"engine {name[:9]!r}": restated('engine = "mujoco"', f'engine = "{name}"')
        for name in ("../../etc", "..", "a/b", ".hidden", "", "x" * 65)
    },
}
"""What is wrong with a submission, and how it comes about in its folder."""


def test_a_fault_of_a_submission_is_found_and_nothing_else(honest, tmp_path, approved):
    lines = []
    for number, (name, plant) in enumerate(FAULTS.items()):
        copy = shutil.copytree(honest, tmp_path / str(number) / "board")
        plant(submission(copy))
        check = check_leaderboard(copy)
        assert not check.ok, name
        faults = texts(check).replace(str(tmp_path / str(number)), "FOLDER")
        lines.append(f"=== {name} ===\n{faults}")
    approved("leaderboard/faults", stable("\n".join(lines)))


def test_a_score_of_markers_is_that_of_the_rounded_ones_in_its_file(honest, tmp_path):
    """A file rounds markers; a distance that rounding does not explain is still found."""
    experiment = load_experiment("FoamBending-soft")
    band = reference_band(experiment)
    count = experiment.frame_count
    times_s = np.arange((count - 1) * SAMPLES_PER_FRAME + 1) / (
        SAMPLES_PER_FRAME * FRAME_RATE_HZ
    )
    values = np.full((len(times_s), len(experiment.coordinates)), 250.0)
    # Rounding takes the last digit away from every coordinate alike.
    known_mm = np.nan_to_num(band.points.mean).round(MARKER_DECIMALS) + 0.30004
    markers_m = 1e-3 * known_mm.reshape(count, -1, 3)
    made = load_result(result_of(submission(honest)))
    score = score_trajectory(
        experiment,
        band,
        times_s=times_s,
        values=values,
        markers_m=markers_m,
        backend="mujoco",
        is_checked=True,
    )
    trajectory = RecordedTrajectory.of(experiment, times_s, values, markers_m)
    result = replace(
        made,
        id=experiment.id,
        revision=experiment.revision,
        score=score,
        trajectory=trajectory,
        deformation=None,
    )
    file = tmp_path / "result.json"
    write_result(result, file)
    assert not false_scores(load_result(file))
    edit(file, set_value("score.verification.distance", 0.9))
    (fault,) = false_scores(load_result(file))
    assert fault.startswith("score.verification.distance: the file states 0.9")


def test_scores_of_another_version_of_gauge_envs_are_computed_anew(board):
    for file in (submission(board) / "results").iterdir():
        edit(file, set_value("versions.gauge-envs", "0.0.1"))
    edit(result_file(board), set_value("score.rmse", 1.25))
    (one,) = check_leaderboard(board).submissions
    assert one.ok
    assert "made with gauge-envs 0.0.1" in one.notes[0]
    (slider,) = (
        result for result in one.results if result.id == "GAUGE/SlopeSlider-2-wood"
    )
    assert slider.score.rmse == pytest.approx(7.45, abs=0.05)


# --- forged trajectories with consistent scores ----------------------------------------------------------------------


def reference_frames(name):
    """The honest start, moved along the real mean."""
    experiment = load_experiment(name)
    band = reference_band(experiment)
    moved = (band.mean - band.mean[0]) @ np.linalg.pinv(band.projection).T
    return start_values(experiment) + moved


def test_a_copy_of_the_real_mean_is_found(board):
    replace_trajectory(
        board, "SlopeSlider-2-wood", reference_frames("SlopeSlider-2-wood")
    )
    assert "follows the real mean within" in only_fault(board)


def test_a_copy_of_a_real_trial_is_found():
    experiment = load_experiment("BouncingBall-rubber")
    band = reference_band(experiment)
    assert band.trials is not None
    number = int(np.argmax(np.isfinite(band.trials).all(axis=(1, 2))))
    # The trial is known in the coordinates of the band alone.
    frames = band.trials[number] @ np.linalg.pinv(band.projection).T
    assert f"follows real trial {number} within" in str(
        copied_reference(sampled(frames), experiment)
    )


def test_an_honest_trajectory_is_no_copy(honest):
    result = load_result(result_file(honest))
    frames = result.trajectory.arrays()[1]
    experiment = load_experiment(result.id)
    assert copied_reference(frames, experiment) is None
    # Half way to the mean is still ten times further than a copy; a thousandth of the way is one.
    near = sampled(reference_frames("SlopeSlider-2-wood"))
    assert copied_reference(near + 0.5 * (frames - near), experiment) is None
    assert copied_reference(near + 0.001 * (frames - near), experiment) is not None


def test_a_forged_trajectory_with_its_own_scores_is_found_by_a_rerun(board):
    file = result_file(board)
    result = load_result(file)
    frames = result.trajectory.arrays()[1][::SAMPLES_PER_FRAME]
    replace_trajectory(
        board,
        "SlopeSlider-2-wood",
        0.7 * frames + 0.3 * reference_frames("SlopeSlider-2-wood"),
    )
    assert check_leaderboard(board).ok
    check = check_leaderboard(board, rerun_count=3)
    assert "run again: different" in texts(check)
    assert "SlopeSlider-2-wood" in texts(check)


def between_frames(samples):
    """Honest frames, and the real mean between them, where an aligned score reads."""
    frames = np.arange(len(samples)) % SAMPLES_PER_FRAME == 0
    real = reference_frames("SlopeSlider-2-wood")
    path = CubicSpline(np.arange(len(real)), real)(
        np.arange(len(samples)) / SAMPLES_PER_FRAME
    )
    return np.where(frames[:, None], samples, path)


def noisy(samples):
    """A replayed real trial with a noise of 2 mm."""
    band = reference_band(load_experiment("SlopeSlider-2-wood"))
    assert band.trials is not None
    trial = band.trials[int(np.argmax(np.isfinite(band.trials).all(axis=(1, 2))))]
    moved = samples[0] + sampled((trial - trial[0]) @ np.linalg.pinv(band.projection).T)
    moved[1:] += np.random.default_rng(0).normal(scale=2.0, size=moved[1:].shape)
    return moved


def slower(samples):
    """The motion of an engine with more friction, as a patched plug-in gives it."""
    return samples[0] + 0.9 * (samples - samples[0])


def smoothed(samples):
    """A tenth of the way toward the real mean."""
    real = reference_frames("SlopeSlider-2-wood")
    path = CubicSpline(np.arange(len(real)), real)(
        np.arange(len(samples)) / SAMPLES_PER_FRAME
    )
    return 0.9 * samples + 0.1 * path


def later(samples):
    """Another course after the last frame, which the alignment reads."""
    count = SAMPLES_PER_FRAME * 10
    return np.concatenate(
        [samples[:-count], samples[-count:] + np.linspace(0.0, 5.0, count)[:, None]]
    )


def first_samples(samples):
    """A start that is kept, and a jump right after it."""
    return np.concatenate([samples[:1], samples[1:] + 3.0])


@pytest.mark.parametrize("forge", [noisy, slower, smoothed, later, first_samples])
def test_a_forgery_that_files_do_not_show_is_found_by_a_rerun(forge, board):
    replace_samples(board, "SlopeSlider-2-wood", forge)
    assert check_leaderboard(board).ok
    assert "run again: different" in texts(check_leaderboard(board, rerun_count=3))


def test_the_mean_between_honest_frames_is_a_copy_and_no_rerun(board):
    replace_samples(board, "SlopeSlider-2-wood", between_frames)
    assert "follows the real mean within" in texts(check_leaderboard(board))
    experiment = load_experiment("SlopeSlider-2-wood")
    forged = load_result(result_file(board))
    honest_frames = load_result(result_file(board)).trajectory.arrays()[1][
        ::SAMPLES_PER_FRAME
    ]
    assert copied_reference(sampled(honest_frames), experiment) is None
    compared, own = rerun(forged)
    assert (compared.status.value, own is None) == ("different", False)


def test_the_table_has_the_numbers_of_the_episode_that_was_run_again(board, honest):
    replace_samples(
        board,
        "SlopeSlider-2-wood",
        lambda samples: np.concatenate([samples[:1], samples[1:] + 1e-3]),
    )
    (stated,) = check_leaderboard(board).submissions
    (again,) = check_leaderboard(board, rerun_count=3).submissions
    (true,) = check_leaderboard(honest).submissions
    place = [result.id for result in true.results].index("GAUGE/SlopeSlider-2-wood")
    assert again.ok
    assert stated.results[place].score.rmse != true.results[place].score.rmse
    assert again.results[place].score.rmse == true.results[place].score.rmse


def test_a_package_that_is_not_of_the_engine_is_found(board):
    file = submission(board) / "submission.toml"
    result = load_result(result_file(board))
    text = file.read_text(encoding="utf-8").replace(
        'package = "mujoco"', 'package = "numpy"'
    )
    file.write_text(
        text.replace(
            f'version = "{result.versions["mujoco"]}"',
            f'version = "{result.versions["numpy"]}"',
        ),
        encoding="utf-8",
    )
    assert "is no package of the engine, whose packages are mujoco" in texts(
        check_leaderboard(board)
    )


def test_what_an_engine_declines_is_no_part_and_what_it_builds_is(board):
    (one,) = check_leaderboard(board).submissions
    assert one.is_partial
    assert len(one.unverified) == len(variants()) - len(NAMES)
    folder = submission(board)
    for file in sorted((folder / "results").iterdir()):
        edit(file, set_value("backend", "rapier"))
        file.rename(file.with_name(file.name.replace(".mujoco.", ".rapier.")))
    file = folder / "submission.toml"
    file.write_text(
        file.read_text(encoding="utf-8").replace(
            'engine = "mujoco"', 'engine = "rapier"'
        ),
        encoding="utf-8",
    )
    (board / "mujoco").rename(board / "rapier")
    (other,) = check_leaderboard(board).submissions
    assert other.ok and other.is_partial
    assert "GAUGE/SlopeSlider-2-metal" in other.unverified
    assert "GAUGE/TextileBending-satin" not in other.unverified


def test_a_forged_setting_in_force_is_found_by_a_rerun(board):
    edit(result_file(board), set_value("settings.timestep_s", 0.001))
    assert check_leaderboard(board).ok
    assert "settings in force differ: timestep_s" in texts(
        check_leaderboard(board, rerun_count=3)
    )


def test_a_small_difference_of_a_rerun_is_stated_and_passes(board):
    file = result_file(board)
    result = load_result(file)
    experiment = load_experiment(result.id)
    times_s, samples = result.trajectory.arrays(later=True)
    samples[1:] += 1e-3
    moved = replace(
        result, trajectory=RecordedTrajectory.of(experiment, times_s, samples)
    )
    write_result(replace(moved, score=rescored(moved, experiment).score), file)
    check = check_leaderboard(board, rerun_count=3)
    assert check.ok, texts(check)
    (again,) = (
        one
        for one in check.submissions[0].reruns
        if one.id == "GAUGE/SlopeSlider-2-wood"
    )
    assert again.status.value == "close"
    assert "versions are equal, so the processor" in again.cause


@pytest.mark.parametrize(
    ("forge", "status"), [(lambda samples: samples, "close"), (slower, "different")]
)
def test_the_bound_of_an_engine_that_does_not_repeat_is_measured(
    forge, status, board, monkeypatch
):
    """Runs end up to 4 mm apart, four times what is allowed to an engine that repeats its bits."""
    chance = np.random.default_rng(3)

    def drifting(samples):
        return (
            samples + np.linspace(0.0, chance.uniform(0.0, 4.0), len(samples))[:, None]
        )

    def jittery(requests, **_):
        results = []
        for result in map(run_episode, requests):
            times_s, samples = result.trajectory.arrays(later=True)
            moved = RecordedTrajectory.of(
                load_experiment(result.id), times_s, drifting(samples)
            )
            results.append(replace(result, trajectory=moved))
        return results

    replace_samples(
        board, "SlopeSlider-2-wood", lambda samples: drifting(forge(samples))
    )
    result = load_result(result_file(board))
    assert rerun(result)[0].status.value == "different"
    monkeypatch.setattr("gauge_envs.tools.leaderboard.reruns.run_many", jittery)
    compared, _ = rerun(result)
    assert compared.status.value == status, str(compared)
    assert "runs of this engine differ by up to" in compared.cause


@pytest.fixture
def toy(tmp_path, monkeypatch):
    """The module of an installed package `toy`, which pins the package `toy-core`."""
    for name, line in {
        "toy": "Requires-Dist: toy-core==1.0\nRequires-Dist: numpy>=1\n",
        "toy-core": "",
    }.items():
        folder = tmp_path / f"{name.replace('-', '_')}-1.0.dist-info"
        folder.mkdir()
        (folder / "METADATA").write_text(
            f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n{line}"
        )
        (tmp_path / f"{name}.py").write_text(f"NAME = '{name}'\n")
        digest = (
            urlsafe_b64encode(
                hashlib.sha256((tmp_path / f"{name}.py").read_bytes()).digest()
            )
            .decode()
            .rstrip("=")
        )
        (folder / "RECORD").write_text(
            f"{name}.py,sha256={digest},1\n{folder.name}/METADATA,sha256=x,1\n"
        )
    monkeypatch.syspath_prepend(tmp_path)
    installed_package.cache_clear()
    return tmp_path / "toy-core.py"


def test_the_hash_of_a_package_has_the_files_of_its_release(toy):
    first, changed = installed_package("toy")
    assert len(first) == 64 and changed == ()
    toy.write_text("GRAVITY = 0.0\n")
    installed_package.cache_clear()
    second, changed = installed_package("toy")
    assert second != first and changed == ("toy-core.py",)
    toy.unlink()
    installed_package.cache_clear()
    assert installed_package("toy")[1] == ("toy-core.py",)


def test_an_editable_installation_has_no_list_of_files(toy):
    record = toy.parent / "toy-1.0.dist-info" / "RECORD"
    record.write_text("__editable__.toy-1.0.pth,sha256=x,1\n" + record.read_text())
    assert installed_package("toy") == ("", ())
    assert installed_package("absent") == ("", ())


def test_the_check_says_whether_the_files_of_the_engine_are_those_of_its_release(
    board, monkeypatch
):
    file = submission(board) / "submission.toml"
    text = file.read_text(encoding="utf-8")

    def notes(stated, installed=("b" * 64, ())):
        monkeypatch.setattr(
            "gauge_envs.tools.leaderboard.check.installed_package", lambda _: installed
        )
        file.write_text(
            text.replace("[left_out]", f'package_sha256 = "{stated}"\n[left_out]'),
            encoding="utf-8",
        )
        check = check_leaderboard(board)
        assert check.ok, texts(check)
        return "\n".join(check.submissions[0].notes)

    assert notes("b" * 64) == ""
    assert f'are not stated; add package_sha256 = "{"b" * 64}"' in notes("")
    assert f"are not those installed here, {'b' * 64}" in notes("a" * 64)
    assert "has no list of its files, as an editable installation" in notes(
        "a" * 64, ("", ())
    )
    assert "differs from its release in 1 file, as mujoco/x.so" in notes(
        "b" * 64, ("b" * 64, ("mujoco/x.so",))
    )


def test_an_engine_that_is_not_installed_cannot_be_run_again(board):
    folder = submission(board)
    text = (
        (folder / "submission.toml")
        .read_text(encoding="utf-8")
        .replace('engine = "mujoco"', 'engine = "absent"')
    )
    for file in sorted((folder / "results").iterdir()):
        edit(file, set_value("backend", "absent"))
        file.rename(file.with_name(file.name.replace(".mujoco.", ".absent.")))
    (folder / "submission.toml").write_text(text, encoding="utf-8")
    (board / "mujoco").rename(board / "absent")
    assert check_leaderboard(board).ok
    assert "run again: not run: unknown backend 'absent'" in texts(
        check_leaderboard(board, rerun_count=1)
    )


def test_the_sample_follows_from_content_and_salt(honest):
    (one,) = check_leaderboard(honest).submissions
    many = [replace(one.results[0], id=str(number)) for number in range(60)]

    def ids(content, salt=""):
        return [
            result.id
            for result in rerun_sample(many, 5, content_sha256=content, salt=salt)
        ]

    assert ids("a") == ids("a")
    assert len(set(ids("a"))) == 5
    assert ids("a") != ids("b")
    assert ids("a") != ids("a", "salt")
    assert len(rerun_sample(many, 100, content_sha256="a")) == 60


def test_a_diverged_result_has_no_scores(board):
    def diverge(content):
        content.update(
            outcome="diverged",
            diverged=True,
            diverged_reason="cube",
            frames=4,
            sim_s=0.1,
        )
        content["trajectory"].update(later_times_s=[], later_samples=[])
        for key in ("times_s", "samples"):
            content["trajectory"][key] = content["trajectory"][key][:19]

    edit(result_file(board), diverge)
    assert "score.rmse: the file states 7.4" in texts(check_leaderboard(board))
    edit(
        result_file(board),
        lambda content: content.update(score={"grade": "trials", "unit": "mm"}),
    )
    (one,) = check_leaderboard(board).submissions
    assert one.ok
    assert [result.outcome for result in one.results].count(Outcome.DIVERGED) == 1


# --- archives of results ---------------------------------------------------------------------------------------------

Member = tuple[str, bytes, bytes]


def write_archive(folder, members):
    """Write `results.tar.xz` in place of the results of a submission: name, kind and content of each member."""
    shutil.rmtree(folder / "results", ignore_errors=True)
    with tarfile.open(folder / "results.tar.xz", "w:xz") as archive:
        for name, kind, content in members:
            member = tarfile.TarInfo(name)
            member.type, member.size, member.linkname = kind, len(content), "/etc/x"
            archive.addfile(member, io.BytesIO(content))


def result_members(folder):
    return [
        (f"results/{file.name}", tarfile.REGTYPE, file.read_bytes())
        for file in sorted((folder / "results").iterdir())
    ]


def test_an_archive_is_checked_as_its_files_are(board, honest):
    write_archive(submission(board), result_members(submission(board)))
    assert check_leaderboard(board) == check_leaderboard(honest)
    (again,) = check_leaderboard(board, rerun_count=1).submissions
    assert again.ok and again.reruns[0].status.value == "equal"


def test_a_wrong_score_in_an_archive_is_found(board):
    edit(result_file(board), set_value("score.rmse", 1.25))
    write_archive(submission(board), result_members(submission(board)))
    assert f"results/{result_file(board).name}: score.rmse: " in only_fault(board)


A = ("results/a.json", tarfile.REGTYPE, b"{}")
ARCHIVES = [
    ("path", [("../a.json", *A[1:])], "../a.json is unexpected in it"),
    ("folder", [("results/b/a.json", *A[1:])], "results/b/a.json is unexpected"),
    ("hidden", [("results/.a.json", *A[1:])], "results/.a.json is unexpected in it"),
    ("suffix", [("results/a.sh", *A[1:])], "results/a.sh is unexpected in it"),
    ("link", [(A[0], tarfile.SYMTYPE, b"")], "results/a.json is unexpected in it"),
    ("hard link", [(A[0], tarfile.LNKTYPE, b"")], "results/a.json is unexpected in it"),
    ("device", [(A[0], tarfile.CHRTYPE, b"")], "results/a.json is unexpected in it"),
    ("twice", [A, A], "results/a.json is in it twice"),
]


@pytest.mark.parametrize(
    ("members", "words"),
    [row[1:] for row in ARCHIVES],
    ids=[row[0] for row in ARCHIVES],
)
def test_an_archive_of_anything_else_is_refused(members, words, board):
    write_archive(submission(board), members)
    assert f"results.tar.xz: {words}" in texts(check_leaderboard(board))


def test_nothing_of_an_archive_beyond_the_limits_is_unpacked(board, monkeypatch):
    write_archive(submission(board), [A])
    content = (submission(board) / "results.tar.xz").read_bytes()
    assert archived_files(content, 10**6) == {A[0]: A[2]}
    with pytest.raises(ValueError, match="one xz stream of at most 0 MB is expected"):
        archived_files(content, 10**4)
    monkeypatch.setattr("gauge_envs.tools.leaderboard.archive.MAX_RESULT_BYTES", 1)
    with pytest.raises(ValueError, match=r"results/a.json has 0 MB, the limit is 0 MB"):
        archived_files(content, 10**6)


@pytest.mark.parametrize("share", [0.0, 0.5, 0.99])
def test_a_damaged_archive_is_refused(share, board):
    write_archive(submission(board), result_members(submission(board)))
    file = submission(board) / "results.tar.xz"
    content = file.read_bytes()
    file.write_bytes(content[: int(share * len(content))])
    assert "results.tar.xz: " in texts(check_leaderboard(board))
    file.write_bytes(b"x" + content)
    assert "results.tar.xz: not a tar archive" in texts(check_leaderboard(board))


# --- folders and files -----------------------------------------------------------------------------------------------


def test_an_empty_folder_is_no_leaderboard(tmp_path):
    with pytest.raises(ResultFileError, match="holds no submission"):
        check_leaderboard(tmp_path)
