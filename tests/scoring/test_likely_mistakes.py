"""Another unit, other axes, another place or another rate is refused in words that mend it; real starts are not."""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from places import one_of_a_kind
from slide import NAME, RESOLVED, SLIDE, coulomb_slide, write_csv

from gauge_envs import (
    GaugeEnv,
    beyond_variants,
    load_experiment,
    reference_band,
    score_trajectory,
    variants,
)
from gauge_envs.errors import (
    GaugeError,
    ShapeError,
    TrajectoryFileError,
)
from gauge_envs.experiments.resolve import shots_of
from gauge_envs.observables.kinds import Observable
from gauge_envs.runs.score_file import score_file
from gauge_envs.scene.jitter import Jitter, can_scatter, perturbed_states
from gauge_envs.scene.states import scene_at
from gauge_envs.scoring.likely_mistakes import (
    DEGREES,
    LATER_FRAMES,
    START_TOLERANCE_MM,
    count_mistake,
    start_values,
    value_mistake,
)

NAMES = [one.name for one in (*variants(), *beyond_variants())]
LENGTHS = (Observable.POSITION, Observable.MARKER_POSITION)


@cache
def experiment_of(name):
    return load_experiment(name)


@pytest.mark.parametrize("name", one_of_a_kind(NAMES))
def test_the_start_is_accepted_and_its_likely_mistakes_are_named(name):
    experiment = experiment_of(name)
    still = np.tile(start_values(experiment), (experiment.frame_count, 1))
    assert value_mistake(experiment, still) is None
    observable = experiment.score.observable
    if observable in LENGTHS:
        _, y, z = np.eye(3)
        cases = {
            "look like metres. Multiply them by 1,000": 1e-3 * still,
            "look like micrometres. Divide them by 1,000": 1e3 * still,
            "look like centimetres. Multiply them by 10": 0.1 * still,
            "x, y, z of the scene, z up, are its x, z, y": still.reshape(
                len(still), -1, 3
            )[:, :, [0, 2, 1]].reshape(still.shape),
            "apart" if len(experiment.coordinates) == 3 else "shifted": still
            + np.tile(300.0 * z, still.shape[1] // 3),
            "y mirrored": still * np.tile(1.0 - 2.0 * y, still.shape[1] // 3),
        }
    elif observable is Observable.FACE_AREA:
        cases = {"look like square metres. Multiply them by 1,000,000": 1e-6 * still}
    else:
        cases = {}
    for words, values in cases.items():
        if np.abs(values - still).max() <= START_TOLERANCE_MM / 6.0:
            continue  # Its axes can be exchanged, or its coordinate is zero.
        found = value_mistake(experiment, values)
        assert found is not None, words
        is_ambiguous = "scene" in words or "mirrored" in words
        assert words in found or (is_ambiguous and "look like" in found), found


@pytest.mark.parametrize("name", [n for n in NAMES if n.startswith("Textile")])
def test_degrees_are_refused_and_radians_are_not(name):
    experiment = experiment_of(name)
    band = reference_band(experiment)
    angles = band.mean @ np.linalg.pinv(band.projection).T
    angles = np.nan_to_num(angles[: experiment.frame_count])
    if np.abs(angles).max() < 1e-3:
        pytest.skip("the cloth stays flat: 57 times nothing is nothing")
    assert value_mistake(experiment, angles, band=band) is None
    assert value_mistake(experiment, 1.3 * angles, band=band) is None
    for amplitude in (0.8, 1.0, 1.3):
        found = value_mistake(experiment, amplitude * DEGREES * angles, band=band)
        assert "look like degrees. Divide them by 57.29578" in found


@pytest.mark.parametrize("name", one_of_a_kind(NAMES))
def test_real_and_scattered_starts_are_accepted(name):
    experiment = experiment_of(name)
    start = start_values(experiment)
    band = reference_band(experiment)
    measured = [] if band is None else [band.mean[0]]
    if band is not None and band.trials is not None:
        measured += list(band.trials[:, 0])
    back = None if band is None else np.linalg.pinv(band.projection)
    for one in measured:
        # What was not measured is as in the scene.
        apart = np.nan_to_num(one - band.projection @ start)
        assert value_mistake(experiment, (start + back @ apart)[None]) is None
    for seed in range(5 if can_scatter(experiment.scene) else 0):
        states = perturbed_states(experiment.scene, Jitter(), seed=seed)
        moved = start_values(
            replace(experiment, scene=scene_at(experiment.scene, states))
        )
        assert value_mistake(experiment, moved[None]) is None


@pytest.mark.parametrize("count", [19, 61, 300])
def test_rates_without_times_are_refused(count):
    for rate_hz in (60, 120, 240):
        for rows in (
            (rate_hz // 30) * (count - 1) + 1,
            (rate_hz // 30) * count,
        ):
            found = count_mistake(rows, count)
            assert f"look like {rate_hz} Hz. Add a column time_s" in found
    for rows in (count, count + 1, min(count + LATER_FRAMES, 2 * count - 2)):
        assert count_mistake(rows, count) is None


def test_the_engine_starts_where_the_scene_says():
    for name in ("Pendulum-metal", "CantileverBeam-soft", "FoamShearing-hard"):
        observation, _ = GaugeEnv(name).reset(seed=0)
        assert observation["observable"] == pytest.approx(
            start_values(experiment_of(name)), abs=1e-3
        )


def test_files_are_refused_in_words_that_mend_them(tmp_path, approved):
    times = np.arange(19) / 30
    fast = np.arange(145) / 240
    turned = "CubeToss-acrylic"
    cases = {
        "metres": (1e-3 * SLIDE, "x,y,z", None),
        "micrometres": (1e3 * SLIDE, "x,y,z", None),
        "y up": (SLIDE[:, [0, 2, 1]], "x,y,z", None),
        "mirrored": (SLIDE * [-1, 1, 1], "x,y,z", None),
        "elsewhere": (SLIDE + np.array([0, 0, 100]), "x,y,z", None),
        "metres, y up": (1e-3 * SLIDE[:, [0, 2, 1]] * [1, 1, -1], "x,y,z", None),
        "240 Hz": (coulomb_slide(fast), "x,y,z", None),
        "too long": (coulomb_slide(np.arange(35) / 30), "x,y,z", None),
        "time": (SLIDE, "time,x,y,z", times),
        "Time [s]": (SLIDE, "Time [s],x,y,z", times),
        "milliseconds": (SLIDE, "time_s,x,y,z", 1e3 * times),
        "numbers of frames": (SLIDE, "time_s,x,y,z", 30 * times),
        "not a number": (SLIDE * [1, np.nan, 1], "x,y,z", None),
    }
    lines = []
    for number, (case, (values, header, stamps)) in enumerate(cases.items()):
        file = write_csv(
            tmp_path / f"{number}.csv", values, header=header, times=stamps
        )
        with pytest.raises(TrajectoryFileError) as caught:
            score_file(file, variant=NAME)
        lines.append(f"{case}\n    {caught.value}")
    assert shots_of(experiment_of(turned)) is not None
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


def test_the_function_refuses_too_unless_the_values_are_known(tmp_path):
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
    while not env.rollout.is_over[0]:
        env.step(0)
    times_s, values = env.trajectory().dense
    file = write_csv(
        tmp_path / "toss.csv", values, header="time_s,x,y,z", times=times_s
    )
    result, _ = score_file(file, variant=name)
    assert result.jitter == {"trial": 3}
    assert result.score.rmse == pytest.approx(env.score().rmse, rel=1e-3)
    values[:, 2] += 3000.0
    far = write_csv(tmp_path / "far.csv", values, header="time_s,x,y,z", times=times_s)
    with pytest.raises(GaugeError, match="apart; real starts are within"):
        score_file(far, variant=name)


def test_a_result_with_scatter_is_scored_again(tmp_path, gauge):
    assert not gauge("run", NAME, "--jitter", "60mm", "--seed", "5").exit_code
    (file,) = tmp_path.glob("results/**/*.json")
    first = np.array(json.loads(file.read_bytes())["trajectory"]["samples"][:1])
    assert value_mistake(RESOLVED, first) is not None
    result, _ = score_file(file)
    assert result.score.rmse > 0.0
