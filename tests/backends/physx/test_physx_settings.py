"""Settings and presets of the PhysX backend, and the one engine of a process."""

import numpy as np
import pytest

pytest.importorskip("sapien")

from sapien import physx

from gauge_envs import (
    load_experiment,
    reference_band,
    score_trajectory,
    variants,
)
from gauge_envs.backends import backend
from gauge_envs.backends.physx.settings import PRESETS
from gauge_envs.errors import BackendError
from gauge_envs.references.published import published_baselines
from gauge_envs.runs.episodes import run_episode
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result import Outcome

PHYSX = backend("physx")
BALL = load_experiment("BouncingBall-rubber").scene


def test_versions_name_sapien_and_its_physx():
    versions = PHYSX.versions()
    assert versions["sapien"].startswith("3.0.")
    assert "physx-5." in versions["physx"]


def test_out_of_box_has_sapiens_own_values():
    ours = PRESETS["out_of_box"]
    scene, shape, body = (
        physx.get_scene_config(),
        physx.get_shape_config(),
        physx.PhysxRigidDynamicComponent(),
    )
    pairs = {
        "solver": (ours.solver, "TGS" if scene.enable_tgs else "PGS"),
        "bounce": (ours.bounce_threshold_m_per_s, scene.bounce_threshold),
        "friction": (
            ours.friction_every_iteration,
            scene.enable_friction_every_iteration,
        ),
        "manifolds": (ours.persistent_manifolds, scene.enable_pcm),
        "determinism": (ours.enhanced_determinism, scene.enable_enhanced_determinism),
        "ccd": (ours.continuous_detection, scene.enable_ccd),
        "contact offset": (ours.contact_offset_m, shape.contact_offset),
        "rest offset": (ours.rest_offset_m, shape.rest_offset),
        "position iterations": (
            ours.position_iterations,
            body.solver_position_iterations,
        ),
        "velocity iterations": (
            ours.velocity_iterations,
            body.solver_velocity_iterations,
        ),
        "sleep": (ours.sleep_threshold_m2_per_s2, body.sleep_threshold),
        "linear damping": (ours.linear_damping_per_s, body.linear_damping),
        "angular damping": (ours.angular_damping_per_s, body.angular_damping),
        "linear speed": (ours.max_linear_velocity_m_per_s, body.max_linear_velocity),
        "angular speed": (
            ours.max_angular_velocity_rad_per_s,
            body.max_angular_velocity,
        ),
        "depenetration": (
            ours.max_depenetration_velocity_m_per_s,
            body.max_depenetration_velocity,
        ),
    }
    wrong = {
        name: (one, other)
        for name, (one, other) in pairs.items()
        if one
        != (other if isinstance(other, bool | str) else pytest.approx(other, rel=1e-6))
    }
    assert wrong == {}


def test_settings_reach_the_engine():
    settings = {
        "preset": "isaac",
        "position_iterations": 7,
        "rest_offset_m": 0.001,
        "patch_radius_m": 0.002,
    }
    simulation = PHYSX.build(BALL, settings)
    model = simulation._model
    body = model.parts["ball"].component
    (shape,) = body.collision_shapes
    assert (body.solver_position_iterations, body.solver_velocity_iterations) == (7, 1)
    assert (
        shape.contact_offset,
        shape.rest_offset,
        shape.patch_radius,
    ) == pytest.approx((0.02, 0.001, 0.002))
    assert (model.system.config.bounce_threshold, model.system.config.enable_tgs) == (
        0.5,
        True,
    )
    assert not model.system.config.enable_friction_every_iteration
    assert simulation.settings["rest_offset_m"] == 0.001
    simulation.close()


def test_the_defaults_of_sapien_do_not_change():
    before = physx.get_scene_config().__getstate__()
    PHYSX.build(BALL, {"bounce_threshold_m_per_s": 0.3, "solver": "PGS"}).close()
    after = physx.get_scene_config().__getstate__()
    assert np.array_equal(before[0], after[0]) and before[1:] == after[1:]


@pytest.mark.slow
def test_simulations_with_other_tolerances_do_not_share_a_process():
    first = PHYSX.build(BALL)
    with pytest.raises(
        BackendError, match=r"one engine per process.*Close the other one first"
    ):
        PHYSX.build(BALL, {"preset": "isaac"})
    first.close()
    second = PHYSX.build(BALL, {"preset": "isaac"})
    with pytest.raises(BackendError, match="one engine per process"):
        PHYSX.build(BALL)
    second.close()
    PHYSX.build(BALL).close()


def test_the_engine_takes_the_tolerances_of_each_simulation():
    """A pyramid that tips shows them: it ends elsewhere, and the same tolerances end at the same bits in any order."""
    scene = load_experiment("NonsmoothContact-3-plastic").scene
    ends = {}
    for length_m in (0.1, 1.0, 0.1, 1.0):
        simulation = PHYSX.build(scene, {"tolerance_length_m": length_m})
        simulation.advance(0.5)
        ends.setdefault(length_m, set()).add(
            simulation.body_states(["wedge"]).tobytes()
        )
        simulation.close()
    assert [len(found) for found in ends.values()] == [1, 1]
    assert ends[0.1] != ends[1.0]


def test_a_closed_simulation_says_so():
    simulation = PHYSX.build(BALL)
    simulation.close()
    simulation.close()
    with pytest.raises(BackendError, match="closed"):
        simulation.body_states(["ball"])


def late_score(request, steps_late):
    """Return the score of an undriven experiment whose frames are read some steps of 1/180 s late."""
    trajectory, experiment = run_episode(request).trajectory, request.experiment()
    times_s = np.array([*trajectory.times_s, *trajectory.later_times_s])
    values = np.array([*trajectory.samples, *trajectory.later_samples])
    return score_trajectory(
        experiment,
        reference_band(experiment),
        times_s=times_s[: len(times_s) - steps_late],
        values=values[steps_late:],
        is_checked=True,
    )


@pytest.mark.parametrize(
    ("name", "parameters"),
    [
        ("BouncingBall-rubber", "calibrated"),
        ("SlopeSlider-2-metal", "calibrated"),
        ("SlopeSlider-2-wood", {"cube.friction": 0.262758}),
        ("SlopeSlider-2-plastic", {"cube.friction": 0.5 * (0.275018 + 0.262758)}),
    ],
)
def test_published_scores_of_isaac_sim_follow_if_frames_are_late(name, parameters):
    """docs/engines/physx.md: the published score within 3 %, and not without the late step."""
    published = published_baselines(name)["rmse"].engines["isaacsim"]
    request = RunRequest(
        name, backend="physx", parameters=parameters, settings={"preset": "paper"}
    )
    late, on_time = late_score(request, 1), late_score(request, 0)
    assert on_time.rmse_normalized == run_episode(request).score.rmse_normalized
    assert late.rmse_normalized == pytest.approx(published, rel=0.03)
    assert on_time.rmse_normalized != pytest.approx(published, rel=0.03)


@pytest.mark.slow
@pytest.mark.parametrize("preset", ["default", "out_of_box"])
def test_every_rigid_experiment_finishes(preset):
    outcomes = {}
    for name in (variant.name for variant in variants()):
        if PHYSX.supports(load_experiment(name).scene):
            outcomes[name] = run_episode(
                RunRequest(name, backend="physx", settings={"preset": preset})
            ).outcome
    assert len(outcomes) == 30
    assert {
        name for name, outcome in outcomes.items() if outcome is not Outcome.FINISHED
    } == set()
