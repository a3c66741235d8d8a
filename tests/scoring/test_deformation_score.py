"""Statistics of deformation beside real ones: the comparison, and what it separates that areas do not."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from pydantic import TypeAdapter

from gauge_envs import load_experiment
from gauge_envs.envs.episode import Trajectory
from gauge_envs.errors import ShapeError, TrajectoryFileError
from gauge_envs.observables.deformation import (
    STATISTICS,
    affine_map,
    marked_solid,
    trial_statistics,
)
from gauge_envs.observables.observer import observe_markers
from gauge_envs.pages.document import Terminal
from gauge_envs.references.deformation import DeformationReference
from gauge_envs.runs.episodes import run_episode
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result_file import load_result, write_result
from gauge_envs.runs.score_file import score_file
from gauge_envs.scoring.deformation import (
    DeformationScore,
    deformation_reference,
    reach_95,
    real_statistics,
    score_deformation,
)
from gauge_envs.scoring.metrics import trajectory_rmse
from gauge_envs.tools.run.words import summary_document

NAME = "FoamStretching-soft"
COARSE = {"preset": "training", "cell_m": 0.05}
"""Step and cells for what holds with any."""
EXPERIMENT = load_experiment(NAME)
REST_M = np.array(EXPERIMENT.scene.markers.positions_m)


def stretched(elongation: float = 0.05, poisson: float = 0.23) -> np.ndarray:
    """Markers of an evenly growing uniaxial stretch [m], shape [30, 28, 3]."""
    grown = np.linspace(0.0, elongation, EXPERIMENT.frame_count)[:, None, None]
    return REST_M * (1 + grown * np.array([-poisson, -poisson, 1.0]))


def areas_of(markers_m: np.ndarray) -> np.ndarray:
    """g(t) of markers, shape [frame_count, face_count]."""
    observable = EXPERIMENT.score.observable
    return observe_markers(markers_m, EXPERIMENT.scene.markers, observable)


def reference_of(
    mean: dict[str, float], sigma: float, *, frames: int = 30
) -> DeformationReference:
    return DeformationReference(
        statistics=tuple(mean),
        markers=None,
        mean=np.tile(list(mean.values()), (frames, 1)),
        sigma=np.full((frames, len(mean)), sigma),
        trial_count=5,
        source="made up",
    )


# The comparison


def test_z_is_the_difference_over_the_uncertainty() -> None:
    reference = reference_of({"strain.zz": 0.03, "volume_ratio": 1.0}, 0.01)
    score = score_deformation(EXPERIMENT, stretched(), reference=reference)
    assert score is not None
    assert (score.grade, score.trial_count, score.source) == (
        "statistics",
        5,
        "made up",
    )
    axial = score["strain.zz"]
    assert (axial.frame, axial.unit) == (29, "1")
    assert axial.simulated == pytest.approx(0.05, abs=1e-12)
    assert (axial.real, axial.uncertainty) == (0.03, 0.01)
    assert axial.z == pytest.approx(2.0)
    z = (np.linspace(0.0, 0.05, 30) - 0.03) / 0.01
    assert axial.z_rms == pytest.approx(np.sqrt(np.mean(z**2)))
    with pytest.raises(KeyError):
        score["strain.xy"]


@pytest.mark.parametrize("trial_count", [1, 2, 10])
def test_the_interval_of_the_difference_covers_as_stated(trial_count: int) -> None:
    """Of 4000 worlds 95 % hold the true difference; one recording has a known error, trials a scatter to estimate."""
    rng, worlds, scatter, truth = np.random.default_rng(5), 4000, 0.01, 0.004
    markers = stretched()
    strain = 0.05
    covered = 0
    for _ in range(worlds):
        trials = strain - truth + scatter * rng.standard_normal(trial_count)
        sigma = scatter if trial_count == 1 else float(trials.std(ddof=1))
        error = strain - float(trials.mean()) - truth
        covered += abs(error) <= reach_95(sigma, trial_count)
    assert covered / worlds == pytest.approx(
        0.95, abs=3.0 * np.sqrt(0.95 * 0.05 / worlds)
    )
    # The score states the same interval, and says what it leaves out.
    reference = replace(
        reference_of({"strain.zz": 0.01}, 0.01), trial_count=trial_count
    )
    score = score_deformation(EXPERIMENT, markers, reference=reference)
    assert score is not None
    statistic = score["strain.zz"]
    reach = reach_95(0.01, trial_count)
    expected = (strain - 0.01 - reach, strain - 0.01 + reach)
    assert statistic.difference_95 == pytest.approx(expected, abs=1e-6)
    (real,) = real_statistics(reference)
    assert (real.value, real.reach_95) == pytest.approx((0.01, reach))
    assert statistic.differs is (trial_count != 2)


def test_unknown_frames_are_left_out_and_a_sigma_of_zero_gives_no_z() -> None:
    reference = reference_of(
        {"strain.zz": 0.03, "volume_ratio": 1.0, "area_ratio": 1.0}, 0.01
    )
    reference.mean[20:, 0] = np.nan
    reference.sigma[:, 1] = 0.0
    score = score_deformation(EXPERIMENT, stretched(), reference=reference)
    assert score is not None
    assert [statistic.name for statistic in score.statistics] == [
        "strain.zz",
        "volume_ratio",
    ]
    assert score["strain.zz"].frame == 19
    assert score["strain.zz"].simulated == pytest.approx(0.05 * 19 / 29)
    assert (score["volume_ratio"].z, score["volume_ratio"].z_rms) == (None, None)


def test_the_simulated_statistics_use_the_markers_of_the_reference() -> None:
    """The twist is known from the +y face alone; its statistics are those of a plane."""
    experiment = load_experiment("FoamTwisting-soft")
    rest_m = np.array(experiment.scene.markers.positions_m)
    markers_m = np.tile(rest_m, (experiment.frame_count, 1, 1))
    markers_m[1:, :14] += 0.05  # the +x face is in no statistic
    score = score_deformation(experiment, markers_m)
    assert score is not None
    assert score["area_ratio"].simulated == pytest.approx(1.0)
    assert score["non_affine"].simulated == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("name", ["SlopeSlider-2-wood", "TextileFlinging-satin"])
def test_other_experiments_have_none(name: str) -> None:
    experiment = load_experiment(name)
    assert deformation_reference(experiment) is None
    assert (
        score_deformation(experiment, np.zeros((experiment.frame_count, 4, 3))) is None
    )


def test_markers_of_another_experiment_are_refused() -> None:
    with pytest.raises(
        ShapeError,
        match=r"markers_m has shape \(30, 27, 3\); FoamStretching-soft needs",
    ):
        score_deformation(EXPERIMENT, stretched()[:, 1:])


def test_a_reference_of_other_frames_is_refused() -> None:
    with pytest.raises(
        ShapeError, match="the reference has 20 frames; FoamStretching-soft needs 30"
    ):
        score_deformation(
            EXPERIMENT,
            stretched(),
            reference=reference_of({"strain.zz": 0.03}, 0.01, frames=20),
        )


def test_a_score_survives_json() -> None:
    score = score_deformation(EXPERIMENT, stretched())
    assert score is not None and score.note is not None
    values = json.loads(json.dumps(score.to_dict()))
    assert values["grade"] == "statistics"
    assert TypeAdapter(DeformationScore).validate_python(values) == score


# Against simulations


@pytest.fixture(scope="module")
def episode(rollout: Callable) -> tuple[Trajectory, dict[str, Any]]:
    """Trajectory and last info of the calibrated foam."""
    _, trajectory, info = rollout(NAME, marker_proxy="material", settings=COARSE)
    return trajectory, info


def test_the_poisson_ratio_is_seen_by_the_volume_and_not_by_the_areas(
    rollout: Callable, episode: tuple[Trajectory, dict[str, Any]]
) -> None:
    """Synthetic trials of the calibrated foam, dots placed 0.8 mm off, 0.1 mm of noise; see docs/scores.md."""
    right = episode[0].markers_m
    wrong = rollout(
        NAME,
        marker_proxy="material",
        settings=COARSE,
        parameters={"foam.poisson_ratio": 0.05},
    )[1].markers_m
    random = np.random.default_rng(8)
    off = 0.8e-3 * random.normal(size=REST_M.shape)
    placed = right + np.einsum("fij,mj->fmi", affine_map(right[0], right).gradient, off)
    trials = placed + 1e-4 * random.normal(size=(10, *right.shape))
    solid = marked_solid(EXPERIMENT.scene)
    values = np.stack([trial_statistics(trial, solid) for trial in trials])
    column = STATISTICS.index("volume_ratio")
    reference = DeformationReference(
        statistics=("volume_ratio",),
        markers=None,
        mean=values.mean(axis=0)[:, [column]],
        sigma=values.std(axis=0, ddof=1)[:, [column]],
        trial_count=10,
        source="synthetic",
    )
    z = [
        score_deformation(EXPERIMENT, found, reference=reference)["volume_ratio"].z
        for found in (right, wrong)
    ]
    assert abs(z[0]) < 2.0 and z[1] > 4.0
    areas = np.stack([areas_of(trial) for trial in trials])
    mean = areas.mean(axis=0)
    baseline = np.mean([trajectory_rmse(trial, mean) for trial in areas])
    scores = [
        trajectory_rmse(areas_of(found), mean) / baseline for found in (right, wrong)
    ]
    # The dots cost six times the scatter, and the wrong foam adds less than a twentieth of that.
    assert min(scores) > 5.0
    assert abs(scores[1] / scores[0] - 1.0) < 0.05


def test_info_and_result_hold_the_statistics(
    episode: tuple[Trajectory, dict[str, Any]], tmp_path: Path
) -> None:
    trajectory, info = episode
    found = info["deformation"]
    assert found == score_deformation(EXPERIMENT, trajectory.markers_m)
    assert info["score"].grade == "law"
    result = run_episode(RunRequest(NAME, marker_proxy="material", settings=COARSE))
    assert result.deformation == found
    write_result(result, tmp_path / "result.json")
    assert load_result(tmp_path / "result.json").deformation == found
    older = json.loads((tmp_path / "result.json").read_text())
    assert older.pop("deformation")["grade"] == "statistics"
    (tmp_path / "older.json").write_text(json.dumps(older))
    assert load_result(tmp_path / "older.json").deformation is None


def test_info_of_a_rigid_body_has_none(rollout: Callable) -> None:
    assert "deformation" not in rollout("SlopeSlider-2-wood")[2]


def test_worlds_of_a_vector_environment_have_them_too(
    episode: tuple[Trajectory, dict[str, Any]],
) -> None:
    envs = gymnasium.make_vec(
        "GAUGE/FoamStretching-soft",
        num_envs=1,
        marker_proxy="material",
        settings=COARSE,
    )
    envs.reset(seed=0)
    actions, over, infos = np.zeros(envs.action_space.shape), False, {}
    while not over:
        *_, truncations, infos = envs.step(actions)
        over = truncations.all()
    assert infos["_deformation"].all()
    assert infos["deformation"][0] == episode[1]["deformation"]
    assert infos["deformation"][0]["strain.zz"].simulated == pytest.approx(
        0.052, abs=0.002
    )


# Files of users


def test_markers_in_a_file_are_compared(tmp_path: Path) -> None:
    markers_m = stretched()
    g = areas_of(markers_m)
    np.savez(tmp_path / "a.npz", g=g, markers_m=markers_m)
    result, _ = score_file(tmp_path / "a.npz", variant=NAME)
    assert result.deformation == score_deformation(EXPERIMENT, markers_m)
    np.savez(tmp_path / "b.npz", g=g)
    assert score_file(tmp_path / "b.npz", variant=NAME)[0].deformation is None


def test_markers_between_frames_are_interpolated(tmp_path: Path) -> None:
    markers_m = stretched()
    g = areas_of(markers_m)
    times_s = np.sort(np.append(np.arange(30) / 30, 0.01))
    late = np.delete(
        np.arange(31), 15
    )  # frame 14 is missing; it lies between its neighbours
    rows = np.searchsorted(np.arange(30) / 30, times_s, side="right") - 1
    np.savez(
        tmp_path / "a.npz",
        time_s=times_s[late],
        g=g[rows][late],
        markers_m=markers_m[rows][late],
    )
    with pytest.raises(TrajectoryFileError, match="no sample at frame 14"):
        score_file(tmp_path / "a.npz", variant=NAME)
    np.savez(tmp_path / "b.npz", time_s=times_s, g=g[rows], markers_m=markers_m[rows])
    result, _ = score_file(tmp_path / "b.npz", variant=NAME)
    assert result.deformation == score_deformation(EXPERIMENT, markers_m)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda m: m[:, 1:],
            r"markers_m: shape is \[30, 27, 3\], expected \[30, 28, 3\]",
        ),
        (
            lambda m: np.where(m > 0.2, np.nan, m),
            "markers_m: a value is not a finite number",
        ),
    ],
)
def test_wrong_markers_in_a_file_are_named(
    tmp_path: Path, change: Callable, message: str
) -> None:
    markers_m = stretched()
    np.savez(tmp_path / "a.npz", g=areas_of(markers_m), markers_m=change(markers_m))
    with pytest.raises(TrajectoryFileError, match=message):
        score_file(tmp_path / "a.npz", variant=NAME)


def test_markers_that_are_observed_need_no_array(tmp_path: Path) -> None:
    beam = load_experiment("CantileverBeam-soft")
    markers_m = np.tile(np.array(beam.scene.markers.positions_m), (90, 1, 1))
    np.savez(tmp_path / "a.npz", g=1e3 * markers_m.reshape(90, -1))
    result, _ = score_file(tmp_path / "a.npz", variant="CantileverBeam-soft")
    assert result.deformation == score_deformation(beam, markers_m)
    assert result.deformation["non_affine"].simulated == pytest.approx(0.0, abs=1e-9)


def test_the_summary_shows_them_apart_from_the_score(tmp_path: Path) -> None:
    from rich.console import Console

    markers_m = stretched()
    np.savez(tmp_path / "a.npz", g=areas_of(markers_m), markers_m=markers_m)
    result, _ = score_file(tmp_path / "a.npz", variant=NAME)
    console = Console(width=120, record=True, file=(tmp_path / "out.txt").open("w"))
    console.print(Terminal(summary_document([result])))
    text = console.export_text()
    assert "Validation by deformation, grade statistics (no part of the score)" in text
    line = next(line for line in text.splitlines() if "strain.zz" in line)
    assert line.split()[:5] == ["strain.zz", "29", "0.0500", "0.0419", "0.0030"]
    assert "which one is not known" in text


@pytest.mark.slow
def test_the_recorded_foam_shears_less_than_the_model() -> None:
    """`scoring/limits.toml` states it: strain.yz is 0.061 in place of 0.024 +- 0.007, and no other strain differs.

    The recording shows soft or hard foam, so this holds for both: the hard model differs more.
    """
    result = run_episode(RunRequest("FoamShearing-soft", marker_proxy="material"))
    assert result.deformation is not None
    shear = result.deformation["strain.yz"]
    assert shear.simulated == pytest.approx(0.061, abs=0.002)
    assert (shear.real, shear.uncertainty) == pytest.approx((0.024, 0.007), abs=5e-4)
    differing = {one.name for one in result.deformation.statistics if one.differs}
    assert differing == {"strain.yz"}
