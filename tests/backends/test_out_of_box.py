"""The preset `out_of_box` has each engine's defaults, as the engine's objects report them.

PhysX, PyBullet and Genesis have such tests in their files.
"""

import numpy as np
import pytest

from gauge_envs import load_experiment
from gauge_envs.backends import backend


def check(ours, theirs):
    """Compare settings with an engine's values, which may have single precision."""
    for name, value in theirs.items():
        is_number = not isinstance(value, bool | str)
        expected = pytest.approx(value, rel=1e-6) if is_number else value
        assert ours[name] == expected, name


def test_out_of_box_has_mujocos_defaults():
    import mujoco

    plain = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><geom size='0.1'/></worldbody></mujoco>"
    )
    scene = load_experiment("SlopeSlider-2-wood").scene
    built = backend("mujoco").build(scene, {"preset": "out_of_box"}).model
    for name in dir(plain.opt):
        if not name.startswith("_") and name != "gravity":
            ours, theirs = getattr(built.opt, name), getattr(plain.opt, name)
            assert np.array_equal(ours, theirs), name
    assert (built.pair_solref == plain.geom_solref[0]).all()
    assert (built.pair_solimp == plain.geom_solimp[0]).all()
    assert (built.pair_dim == plain.geom_condim[0]).all()
    assert not built.pair_margin.any() and not built.pair_gap.any()


def test_out_of_box_has_rapiers_defaults():
    rapier = pytest.importorskip("rapier3d")
    from gauge_envs.backends.rapier.settings import PRESETS

    world = rapier.PhysicsWorld()
    body = world.rigid_bodies[world.add_body(rapier.RigidBody.dynamic(), [])]
    plain = world.integration_parameters
    theirs = {
        "solver_iterations": plain.num_solver_iterations,
        "pgs_iterations": plain.num_internal_pgs_iterations,
        "stabilization_iterations": plain.num_internal_stabilization_iterations,
        "friction_model": str(plain.friction_model).rsplit(".", 1)[-1].lower(),
        "contact_frequency_hz": plain.contact_softness.natural_frequency,
        "contact_damping_ratio": plain.contact_softness.damping_ratio,
        "static_contact_frequency_hz": plain.static_contact_softness.natural_frequency,
        "static_contact_damping_ratio": plain.static_contact_softness.damping_ratio,
        "allowed_linear_error_m": plain.normalized_allowed_linear_error,
        "max_corrective_velocity_m_per_s": plain.normalized_max_corrective_velocity,
        "prediction_distance_m": plain.normalized_prediction_distance,
        "contact_clustering": plain.contact_clustering,
        "contact_recycling": plain.contact_recycling,
        "recycle_distance_m": plain.normalized_contact_recycle_distance,
        "warmstart_coefficient": plain.warmstart_coefficient,
        "warmstart_joints": plain.warmstart_joints,
        "friction_in_bias_pass": plain.friction_in_bias_pass,
        "max_linear_velocity_m_per_s": plain.normalized_max_linear_velocity,
        "ccd": body.ccd_enabled,
    }
    check(PRESETS["out_of_box"].model_dump(), theirs)
    # Further assumptions of the adapter.
    assert body.gyroscopic_forces_enabled and plain.length_unit == 1.0


def test_out_of_box_has_drakes_defaults():
    plant = pytest.importorskip("pydrake.multibody.plant")
    from gauge_envs.backends.drake.settings import PRESETS

    plain = plant.MultibodyPlantConfig()
    ours = PRESETS["out_of_box"].model_dump()
    theirs = {
        "approximation": plain.discrete_contact_approximation,
        "stiction_speed_m_per_s": plain.stiction_tolerance,
        "near_rigid_threshold": plain.sap_near_rigid_threshold,
        "drake_material": True,
    }
    check(ours, theirs)
    assert plain.contact_model.startswith(ours["contact_model"])
