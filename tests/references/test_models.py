"""References of grade `model`: the extrapolation, what is written, and that they stay apart from reality."""

from __future__ import annotations

import json

import gymnasium
import numpy as np
import pytest
from episodes import run_to_end
from places import one_of_a_kind

from gauge_envs import load_experiment, reference_band, variants
from gauge_envs.envs.reward import reward_terms
from gauge_envs.errors import ReferenceFileError
from gauge_envs.evaluation.deviation import sampled_frames
from gauge_envs.evaluation.score import score_trajectory
from gauge_envs.evaluation.verification import verify
from gauge_envs.files import data_folder
from gauge_envs.pages.results import reality_lines
from gauge_envs.references import models
from gauge_envs.references.grades import BandGrade
from gauge_envs.references.models import (
    POINT_SIGMA_MM,
    interpolated,
    packed,
    solved_model,
    unpacked,
)
from gauge_envs.tools.catalog.description import description
from scripts import build_models, extrapolation

FOLDER = data_folder("scoring") / "models"
SOLVED = sorted(file.stem for file in FOLDER.glob("*.npz"))
FOAM = "FoamTwisting-soft"


def converging(order, *, factors=(2.0, 1.0, 0.5), scale=0.3):
    """Return an exact motion, and runs with an error of one order."""
    times = np.linspace(0.0, 2.0, 40)
    exact = np.stack([np.sin(times), np.cos(3.0 * times)], axis=1)
    error = scale * np.stack([times, times**2], axis=1)
    return exact, [exact + error * factor**order for factor in factors]


# --- extrapolation ---


@pytest.mark.parametrize("order", [0.6, 1.0, 2.0])
@pytest.mark.parametrize(
    "factors",
    [(2.0, 1.0, 0.5), (5.0 / 3.0, 1.0, 0.5), (2.0, 1.0, 2.0 / 3.0), (1.0, 0.5, 0.25)],
)
def test_richardson_finds_order_and_limit(order, factors):
    exact, runs = converging(order, factors=factors)
    found = extrapolation.extrapolate(runs, factors)
    assert found.order == pytest.approx(order, abs=1e-6)
    base = runs[factors.index(1.0)]
    np.testing.assert_allclose(base + found.correction, exact, atol=1e-9)
    if order <= 1.0:
        # Roache: 1.25 times the distance to the finest run, as two standard uncertainties.
        left = np.linalg.norm(exact - runs[-1])
        assert np.linalg.norm(found.uncertainty) == pytest.approx(0.625 * left, rel=0.1)


def test_runs_that_do_not_converge_are_not_extrapolated():
    exact, runs = converging(1.0)
    noise = np.random.default_rng(0).normal(size=(3, *exact.shape))
    found = extrapolation.extrapolate([exact + one for one in noise], (2.0, 1.0, 0.5))
    assert found.order is None
    np.testing.assert_allclose(found.correction, noise[2] - noise[1], atol=1e-12)
    # Changes that grow with refinement have no order.
    assert extrapolation.extrapolate(runs[::-1], (2.0, 1.0, 0.5)).order is None


def test_two_runs_are_not_extrapolated_and_count_three_times():
    _, runs = converging(2.0, factors=(1.0, 0.5))
    found = extrapolation.extrapolate(runs, (1.0, 0.5))
    assert found.order is None
    change = extrapolation.smoothed(runs[1] - runs[0])
    np.testing.assert_allclose(found.uncertainty, 1.5 * change)


@pytest.mark.parametrize(
    ("orders", "least"), [((1.0, 2.0), 0.95), ((2.0, 3.0), 0.95), ((0.7, 2.0), 0.92)]
)
@pytest.mark.parametrize(
    "factors", [(2.0, 1.0, 0.5), (4.0 / 3.0, 1.0, 0.5), (1.0, 0.5, 0.25)]
)
def test_the_uncertainty_covers_errors_of_two_orders(orders, least, factors):
    """Errors of several orders cancel in parts. The worlds have a seed that the rule was not chosen on."""
    random = np.random.default_rng(7)
    times = np.linspace(0.0, 1.0, 12)[:, None]
    held = []
    for _ in range(300):
        first, second = (
            np.concatenate(
                [random.normal() + 0.0 * times, random.normal() * times], axis=1
            )
            for _ in range(2)
        )
        share = random.uniform(0.05, 1.0)
        runs = [
            first * factor ** orders[0] + share * second * factor ** orders[1]
            for factor in factors
        ]
        found = extrapolation.extrapolate(runs, factors)
        left = np.linalg.norm(runs[factors.index(1.0)] + found.correction)
        held.append(left <= 2.0 * np.linalg.norm(found.uncertainty))
    assert np.mean(held) >= least


def test_families_that_disagree_are_as_uncertain_as_they_are_apart():
    zero, one = np.zeros((20, 2)), np.full((20, 2), 3.0)
    mean, uncertainty, apart = extrapolation.combined(
        [(zero, 0.1 + zero), (one, 0.1 + zero)]
    )
    np.testing.assert_allclose(mean, 1.5)
    np.testing.assert_allclose(apart, 1.5)
    np.testing.assert_allclose(uncertainty, np.hypot(1.5, 0.1))


def test_a_solution_that_others_only_check_is_as_unsure_as_they_do_not_explain():
    first, other = np.zeros((20, 2)), np.full((20, 2), 3.0)
    explained = extrapolation.anchored([(first, 0.1 + first), (other, 3.5 + first)])
    np.testing.assert_allclose(explained[0], first)
    np.testing.assert_allclose(explained[1], 0.1)
    np.testing.assert_allclose(explained[2], 3.0)
    _, uncertainty, _ = extrapolation.anchored(
        [(first, 0.1 + first), (other, 1.0 + first)]
    )
    np.testing.assert_allclose(uncertainty, np.sqrt(0.01 + 9.0 - 1.0))


def test_the_surer_engine_weighs_more():
    zero, one = np.zeros((20, 2)), np.full((20, 2), 1.0)
    mean, uncertainty, apart = extrapolation.combined(
        [(zero, 0.1 + zero), (one, 3.0 + zero)]
    )
    between = 0.25
    weights = 1.0 / np.array([0.01 + between, 9.0 + between])
    np.testing.assert_allclose(mean, weights[1] / weights.sum())
    np.testing.assert_allclose(apart, weights[0] / weights.sum())
    assert (uncertainty > apart).all()


def test_a_reference_ends_where_its_uncertainty_first_exceeds_the_limit():
    uncertainty = np.array([[0.1], [0.2], [0.9], [0.9]])
    assert extrapolation.known_frames(uncertainty, 0.5) == (2, None)
    assert extrapolation.known_frames(uncertainty, 1.0) == (4, None)


def test_a_reference_goes_on_after_a_gap_where_the_motion_has_settled():
    uncertainty = np.full((20, 1), 0.1)
    uncertainty[[3, 5, 8]] = 0.9
    assert extrapolation.known_frames(uncertainty, 0.5) == (20, (3, 9))
    # A short stretch at the end may be chance, as where two oscillations cross.
    uncertainty[15] = 0.9
    assert extrapolation.known_frames(uncertainty, 0.5) == (3, None)


# --- files ---


def test_packing_keeps_values_to_half_a_quantum():
    values = np.cumsum(np.random.default_rng(1).normal(size=(50, 3)), axis=0)
    assert np.abs(unpacked(packed(values, 0.01), 0.01) - values).max() <= 0.005 + 1e-12


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
    assert without <= set(reasons), "run scripts/build_models.py for them"
    name = min(without)
    assert (
        description(load_experiment(name))["reference"]["unsolved"]["reason"]
        == reasons[name].reason
    )


@pytest.mark.parametrize("name", SOLVED)
def test_a_model_covers_a_quarter_and_states_what_it_rests_on(name):
    experiment, model = load_experiment(name), solved_model(name)
    sidecar, band = model.sidecar, model.band
    assert band.grade is BandGrade.MODEL
    assert sidecar.frames == experiment.frame_count
    engines = [one.engine for one in sidecar.engines]
    # An undamped sheet covers the time until which it is determined.
    if models.SHEET not in engines:
        assert max(
            sidecar.solved_frames, sidecar.point_frames or 0
        ) >= extrapolation.LEAST_SPAN * build_models.solved_span(experiment)
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


@pytest.mark.parametrize(
    "name", one_of_a_kind(name for name in SOLVED if name.startswith("Textile"))
)
def test_solvers_of_a_textile_take_its_constants_as_they_are(name):
    pytest.importorskip("newton", reason="extra 'newton' is not installed")
    engines = {one.engine for one in solved_model(name).sidecar.engines}
    assert engines <= set(build_models.engines_of(load_experiment(name)))


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
    assert reference_band(load_experiment(FOAM)).grade is BandGrade.MODEL
    assert reference_band(load_experiment(FOAM, {"foam.young_modulus_pa": 1e5})) is None
