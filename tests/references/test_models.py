"""References of grade `model`: what is stored, and that they stay apart from reality."""

from __future__ import annotations

import json

import gymnasium
import numpy as np
import pytest
from episodes import run_to_end

from gauge_envs import load_experiment, reference_band, variants
from gauge_envs.envs.reward import reward_terms
from gauge_envs.errors import ReferenceFileError
from gauge_envs.files import data_folder
from gauge_envs.pages.results import reality_lines
from gauge_envs.references import models
from gauge_envs.references.kind import Kind
from gauge_envs.references.models import (
    POINT_SIGMA_MM,
    interpolated,
    solved_model,
    unpacked,
)
from gauge_envs.runs.episodes import run_episode
from gauge_envs.runs.request import RunRequest
from gauge_envs.scoring.deviation import sampled_frames
from gauge_envs.scoring.score import score_trajectory
from gauge_envs.scoring.verification import verify
from gauge_envs.tools.catalog.description import description

FOLDER = data_folder("scoring") / "models"
SOLVED = sorted(file.stem for file in FOLDER.glob("*.npz"))
FOAM = "FoamTwisting-soft"


# --- files ---


def test_values_are_stored_as_differences_of_whole_counts():
    stored = np.array([[100], [-3], [2]], dtype=np.int32)
    np.testing.assert_allclose(unpacked(stored, 0.01), [[1.0], [0.97], [0.99]])


def test_an_uncertainty_is_interpolated_between_stored_frames():
    line = np.arange(23.0)[:, None]
    np.testing.assert_allclose(interpolated(line[:: models.STRIDE], 21), line[:21])


def test_every_id_without_a_real_reference_or_law_has_a_model_or_a_reason():
    reasons = models.unsolved_scenes()
    assert not set(reasons) & set(SOLVED)
    grades = {
        variant.name: reference_band(load_experiment(variant)) for variant in variants()
    }
    without = {name for name, band in grades.items() if band is None}
    assert without <= set(reasons)
    name = min(without)
    assert (
        description(load_experiment(name))["reference"]["unsolved"]["reason"]
        == reasons[name].reason
    )


@pytest.mark.parametrize("name", SOLVED)
def test_a_model_states_what_it_rests_on(name):
    experiment, model = load_experiment(name), solved_model(name)
    sidecar, band = model.sidecar, model.band
    assert band.kind is Kind.NUMERICAL
    assert sidecar.frames == experiment.frame_count
    engines = [one.engine for one in sidecar.engines]
    known = np.isfinite(band.mean).all(axis=1)
    assert bool(sidecar.ends) == (not known.all())
    assert np.flatnonzero(~known[: sidecar.solved_frames]).tolist() == list(
        range(*(sidecar.gap or (0, 0)))
    )
    assert not known[sidecar.solved_frames :].any()
    assert set(model.others) == (set(engines) if len(engines) > 1 else set())
    assert np.isfinite(band.uncertainty[known]).all()
    assert (band.uncertainty[known] >= 0.0).all()
    for one in sidecar.engines:
        assert {"step"} <= {refinement.parameter for refinement in one.refinements}
    if experiment.scene.deformables:
        assert any(
            "cell" in {r.parameter for r in one.refinements} for one in sidecar.engines
        )


def test_the_mean_of_two_solutions_lies_between_them():
    model = solved_model(FOAM)
    first, second = model.others.values()
    known = slice(0, model.sidecar.solved_frames)
    low, high = np.minimum(first, second)[known], np.maximum(first, second)[known]
    margin = 2.0 * model.sidecar.quantum
    assert (
        (model.band.mean[known] >= low - margin)
        & (model.band.mean[known] <= high + margin)
    ).all()


def test_damage_is_named(tmp_path):
    for file in FOLDER.glob(f"{FOAM}.*"):
        (tmp_path / file.name).write_bytes(file.read_bytes())
    sidecar = json.loads((tmp_path / f"{FOAM}.json").read_text())
    (tmp_path / f"{FOAM}.json").write_text(json.dumps(sidecar | {"solved_frames": 7}))
    with pytest.raises(ReferenceFileError, match=r"has arrays .* expected .*\(7, "):
        models._read(tmp_path / f"{FOAM}.npz", FOAM)
    models._read.cache_clear()
    (tmp_path / f"{FOAM}.json").write_text("{")
    with pytest.raises(ReferenceFileError, match=f"{FOAM}.json"):
        models._read(tmp_path / f"{FOAM}.npz", FOAM)


# --- scores and rewards ---


def played(name, *, backend="mujoco", moved_mm=0.0):
    env = gymnasium.make(f"GAUGE/{name}", backend=backend)
    rewards, info = run_to_end(env)
    trajectory = env.unwrapped.trajectory()
    env.close()
    return info, np.array(rewards), trajectory


@pytest.fixture(scope="module")
def foam():
    return played(FOAM)


@pytest.mark.slow
def test_default_settings_are_as_far_off_as_their_refinement_says(foam):
    score, sidecar = foam[0]["score"], solved_model(FOAM).sidecar
    own = next(one for one in sidecar.engines if one.engine == "mujoco")
    assert score.grade == "model"
    assert score.rmse <= own.correction + sidecar.families_apart + 1e-3
    # The solution without MuJoCo's own part is Newton's.
    assert score.rmse_without["mujoco"] == pytest.approx(
        score.rmse, abs=2.0 * sidecar.families_apart
    )
    assert score.rmse_without["mujoco"] != score.rmse_without["newton"]
    assert score.release_offset_s is None
    assert score.validation is None


def test_words_say_model_and_never_real(foam):
    lines = list(reality_lines("x", foam[0]["score"]))
    assert len(lines) == 1 + len(foam[0]["score"].also_verified)
    assert all("solves its scene to" in line and "real" not in line for line in lines)


def test_a_frozen_foam_is_told_and_a_copied_solution_is_none(foam):
    """The markers of the first frame for all frames differ by the stated distance; those of the reference do not."""
    experiment = load_experiment(FOAM)
    band, trajectory = reference_band(experiment), foam[2]
    frozen = np.repeat(trajectory.markers_m[:1], len(trajectory.markers_m), axis=0)
    found = verify(band, frames=trajectory.frames, markers_m=frozen)
    assert found.distance == pytest.approx(found.frozen, rel=0.01)
    assert found.distance_95[0] > 0.0
    copied = np.nan_to_num(1e-3 * band.points.mean).reshape(frozen.shape)
    assert verify(band, frames=trajectory.frames, markers_m=copied).distance < 1e-9


def test_a_fault_larger_than_the_uncertainty_is_seen(foam):
    """A motion that is 30 % too large has an interval that excludes what the right one scores."""
    experiment = load_experiment(FOAM)
    band, trajectory = reference_band(experiment), foam[2]
    times_s, values = trajectory.dense
    wrong = values[0] + 1.3 * (values - values[0])
    found = score_trajectory(
        experiment,
        band,
        times_s=times_s,
        values=wrong,
        markers_m=trajectory.markers_m[0]
        + 1.3 * (trajectory.markers_m - trajectory.markers_m[0]),
    )
    right = foam[0]["score"].verification
    assert found.verification.distance_95[0] > right.distance
    assert sampled_frames(experiment, times_s, wrong).shape == band.mean.shape


def test_the_reward_is_of_marker_positions_where_g_is_not(foam):
    _, rewards, trajectory = foam
    band = reference_band(load_experiment(FOAM))
    assert band.unit == "mm^2"
    points_mm = 1e3 * trajectory.markers_m.reshape(len(trajectory.markers_m), -1)
    # A foam's reward is bounded, and its scale is at least the motion.
    mean = band.points.mean
    motion = np.sqrt(np.nanmean(np.square(mean - mean[0])))
    scale = np.fmax(band.points.sigma, band.points.uncertainty)
    scale = np.fmax(scale, motion)
    distance = np.abs((points_mm - mean) / scale).mean(axis=1)
    expected = -distance / (1.0 + distance)
    known = np.isfinite(expected)
    np.testing.assert_allclose(rewards[known[1:]], expected[1:][known[1:]], rtol=1e-9)
    assert (scale[known] >= POINT_SIGMA_MM).all()
    assert (rewards[known[1:]] < 0.0).all()
    assert rewards.min() > -1.0


def test_a_reward_divides_by_the_larger_of_sigma_and_uncertainty():
    band = reference_band(load_experiment(FOAM)).points
    _, mean, weight = reward_terms(band)
    frame = 10
    scale = np.maximum(band.sigma[frame], band.uncertainty[frame])
    np.testing.assert_allclose(weight[frame] * len(scale) * scale, 1.0)
    assert mean.shape == weight.shape


def test_another_scene_has_no_model():
    assert reference_band(load_experiment(FOAM)).grade is Kind.NUMERICAL
    assert reference_band(load_experiment(FOAM, {"foam.young_modulus_pa": 1e5})) is None


@pytest.mark.slow
@pytest.mark.parametrize("name", ["FoamBending-soft", "FoamBending-hard"])
@pytest.mark.parametrize(
    ("engine", "settings", "limit_mm"),
    [
        ("mujoco", {}, 0.15),
        ("mujoco", {"preset": "training"}, 0.15),
        ("mujoco", {"cell_m": 0.0167}, 0.08),
        ("newton", {}, 0.2),
    ],
)
def test_engines_press_foam_as_the_block_is(name, engine, settings, limit_mm):
    """A layer of 0.5 mm in MuJoCo shows 0.25 mm, one of 1 mm in Newton 0.37; contacts faster than two steps 0.35."""
    pytest.importorskip(engine)
    result = run_episode(RunRequest(name, backend=engine, settings=settings))
    verified = result.score.verification
    assert verified.quantity == "positions of 14 markers"
    assert verified.distance < limit_mm
