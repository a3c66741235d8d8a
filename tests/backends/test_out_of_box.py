"""The presets `out_of_box` hold what each engine has where a program states nothing, as its own objects tell.

PhysX, PyBullet and Genesis have such tests beside their other ones.
"""

import inspect

import numpy as np
import pytest

from gauge_envs import load_experiment
from gauge_envs.backends import backend

SCENE = load_experiment("SlopeSlider-2-wood").scene


def different(ours, theirs):
    """Values that differ by more than the rounding of single precision, by name."""
    return {
        name: (ours[name], value)
        for name, value in theirs.items()
        if ours[name]
        != (value if isinstance(value, bool | str) else pytest.approx(value, rel=1e-6))
    }


def test_out_of_box_is_a_mujoco_model_that_states_nothing():
    import mujoco

    plain = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><geom size='0.1'/></worldbody></mujoco>"
    )
    built = backend("mujoco").build(SCENE, {"preset": "out_of_box"}).model
    stated = {"gravity"}
    names = {name for name in dir(plain.opt) if not name.startswith("_")} - stated
    wrong = {
        name: (getattr(built.opt, name), getattr(plain.opt, name))
        for name in names
        if not np.array_equal(getattr(built.opt, name), getattr(plain.opt, name))
    }
    assert wrong == {}
    assert (built.pair_solref == plain.geom_solref[0]).all()
    assert (built.pair_solimp == plain.geom_solimp[0]).all()
    assert (built.pair_dim == plain.geom_condim[0]).all()
    assert not built.pair_margin.any() and not built.pair_gap.any()


def test_out_of_box_is_a_rapier_world_that_states_nothing():
    rapier = pytest.importorskip("rapier3d")
    from gauge_envs.backends.rapier.settings import PRESETS

    world = rapier.PhysicsWorld()
    body = world.rigid_bodies[world.add_body(rapier.RigidBody.dynamic(), [])]
    plain = world.integration_parameters
    ours = PRESETS["out_of_box"].model_dump()
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
    assert different(ours, theirs) == {}
    # What the backend states beside the settings.
    assert body.gyroscopic_forces_enabled and plain.length_unit == 1.0


def test_out_of_box_is_a_drake_plant_that_states_nothing():
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
    assert different(ours, theirs) == {}
    assert plain.contact_model.startswith(ours["contact_model"])


@pytest.mark.slow
def test_out_of_box_differs_from_newton_in_its_contacts_alone():
    solvers = pytest.importorskip("newton.solvers")
    from gauge_envs.backends.newton.settings import PRESETS

    ours = PRESETS["out_of_box"].model_dump()
    text = inspect.getdoc(solvers.SolverMuJoCo.__init__) or ""
    assert f'Newton\'s default ("{ours["integrator"]}")' in text
    assert f'Newton\'s default ("{ours["cone"]}")' in text
    assert f"MuJoCo's default ({ours['impratio']})" in text
    assert f"MuJoCo's default ({ours['iterations']})" in text
    assert ours["newton_material"]
    # As the page of the engine states.
    assert (
        inspect.signature(solvers.SolverMuJoCo.__init__)
        .parameters["use_mujoco_contacts"]
        .default
        is True
    )
    assert ours["mujoco_contacts"] is False
