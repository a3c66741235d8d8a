"""A trajectory that starts elsewhere, or in another unit, is refused in words that fix it; real starts are not."""

import re
from functools import cache

import numpy as np
import pytest
from places import one_of_a_kind
from slide import NAME, RESOLVED, SLIDE, write_csv

from gauge_envs import (
    GaugeEnv,
    beyond_variants,
    load_experiment,
    reference_band,
    score_trajectory,
    variants,
)
from gauge_envs.errors import ShapeError, TrajectoryFileError
from gauge_envs.observables.kinds import Observable
from gauge_envs.runs.score_file import score_file
from gauge_envs.scoring.likely_mistakes import start_values, value_mistake

NAMES = [one.name for one in (*variants(), *beyond_variants())]
LENGTHS = (Observable.POSITION, Observable.MARKER_POSITION)


@cache
def experiment_of(name):
    return load_experiment(name)


@pytest.mark.parametrize("name", one_of_a_kind(NAMES))
def test_the_start_is_accepted_and_another_unit_or_place_is_named(name):
    experiment = experiment_of(name)
    still = np.tile(start_values(experiment), (experiment.frame_count, 1))
    assert value_mistake(experiment, still) is None
    if experiment.score.observable in LENGTHS:
        assert "look like metres" in value_mistake(experiment, 1e-3 * still)
        assert "30 mm. Check the id" in value_mistake(experiment, still + 300.0)
    elif experiment.score.observable is Observable.FACE_AREA:
        assert "look like square metres" in value_mistake(experiment, 1e-6 * still)
        assert "5 times those of the scene" in value_mistake(experiment, 5.0 * still)
    else:
        assert "look like degrees" in value_mistake(experiment, still + 90.0)


@pytest.mark.parametrize("factor", [1.0, 1e-3])
@pytest.mark.parametrize("name", one_of_a_kind(NAMES))
def test_exchanged_axes_are_named(name, factor):
    """The axes of the message turn the file's places into those of the scene."""
    experiment = experiment_of(name)
    if experiment.score.observable not in LENGTHS:
        pytest.skip("no places")
    start = start_values(experiment)
    places = start.reshape(-1, 3)
    for axes in ("x,-z,y", "y,x,z", "-x,-y,z", "z,x,y"):
        columns = [places[:, "xyz".index(axis[-1])] for axis in axes.split(",")]
        signs = [-1.0 if axis.startswith("-") else 1.0 for axis in axes.split(",")]
        file_values = factor * np.stack(columns, axis=1) * signs
        text = value_mistake(experiment, file_values.ravel()[None])
        if text is None or "the values look like" in text:
            continue  # The scene looks the same along these axes.
        recovered = []
        for axis in re.search(r"Write \((.*?)\)", text)[1].split(", "):
            column = file_values[:, "xyz".index(axis[-1])]
            recovered.append(-column if axis.startswith("-") else column)
        assert np.stack(recovered, axis=1) / factor == pytest.approx(places, abs=30.0)
        assert ("the unit looks like metres" in text) is (factor != 1.0)


@pytest.mark.parametrize("name", one_of_a_kind(NAMES))
def test_real_starts_are_accepted(name):
    experiment = experiment_of(name)
    start = start_values(experiment)
    band = reference_band(experiment)
    if band is None:
        pytest.skip("no reference")
    starts = [band.mean[0]]
    if band.trials is not None:
        starts += list(band.trials[:, 0])
    for measured in starts:
        # What was not measured is as in the scene.
        apart = np.nan_to_num(measured - band.projection @ start)
        moved = start + np.linalg.pinv(band.projection) @ apart
        assert value_mistake(experiment, moved[None]) is None


def test_the_engine_starts_where_the_scene_says():
    for name in ("Pendulum-metal", "CantileverBeam-soft", "FoamShearing-hard"):
        observation, _ = GaugeEnv(name).reset(seed=0)
        assert observation["observable"] == pytest.approx(
            start_values(experiment_of(name)), abs=1e-3
        )


def test_files_are_refused_in_words_that_fix_them(tmp_path, approved):
    cases = {"metres": 1e-3 * SLIDE, "elsewhere": SLIDE + np.array([0.0, 0.0, 100.0])}
    lines = []
    for case, values in cases.items():
        with pytest.raises(TrajectoryFileError) as caught:
            score_file(write_csv(tmp_path / f"{case}.csv", values), variant=NAME)
        lines.append(f"{case}\n    {caught.value}")
    approved("scoring/likely_mistakes", "\n".join(lines))


def test_markers_in_millimetres_are_refused(tmp_path):
    experiment = experiment_of("FoamShearing-hard")
    g = np.tile(start_values(experiment), (experiment.frame_count, 1))
    markers = np.tile(experiment.scene.markers.positions_m, (len(g), 1, 1))
    np.savez(tmp_path / "a.npz", g=g, markers_m=markers)
    score_file(tmp_path / "a.npz", variant=experiment.name)
    np.savez(tmp_path / "b.npz", g=g, markers_m=1e3 * markers)
    with pytest.raises(
        TrajectoryFileError, match=r"markers_m: .* look like millimetres"
    ):
        score_file(tmp_path / "b.npz", variant=experiment.name)


def test_the_function_refuses_too_unless_the_values_are_known():
    band = reference_band(RESOLVED)
    times = np.arange(19) / 30
    with pytest.raises(ShapeError, match="look like metres"):
        score_trajectory(RESOLVED, band, times_s=times, values=1e-3 * SLIDE)
    known = score_trajectory(
        RESOLVED, band, times_s=times, values=1e-3 * SLIDE, is_checked=True
    )
    assert known.rmse > 100.0


def test_a_toss_is_scored_by_the_trial_that_it_starts_as(tmp_path):
    name = "CubeToss-acrylic"
    env = GaugeEnv(name)
    env.reset(seed=0, options={"trial": 3})
    terminated = truncated = False
    while not (terminated or truncated):
        _, _, terminated, truncated, _ = env.step(0)
    times_s, values = env.trajectory().dense
    file = write_csv(
        tmp_path / "toss.csv", values, header="time_s,x,y,z", times=times_s
    )
    result, _ = score_file(file, variant=name)
    assert result.jitter == {"trial": 3}
    assert result.score.rmse == pytest.approx(env.score().rmse, rel=1e-3)


def test_a_result_with_scatter_is_scored_again(tmp_path, gauge):
    assert not gauge("run", NAME, "--jitter", "60mm", "--seed", "5").exit_code
    (file,) = tmp_path.glob("results/**/*.json")
    result, _ = score_file(file)
    assert result.score.rmse > 0.0
