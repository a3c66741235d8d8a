"""Readers of Genesis scenes for the sanity check, and the language of their changes."""

import numpy as np
import pytest

pytest.importorskip("genesis", reason="extra 'genesis' is not installed")

import genesis as gs
import torch

from gauge_envs.backends.genesis.engine import EngineLease
from gauge_envs.backends.genesis.model import forget_models
from gauge_envs.tools.sanity.stacks import dialect, reader_of
from gauge_envs.tools.sanity.stacks.genesis import options_settings

LANGUAGE = dialect("genesis")


@pytest.fixture
def engine():
    forget_models()
    lease = EngineLease(64)
    yield
    lease.release()
    forget_models()


def ball_scene(**rigid):
    scene = gs.Scene(
        show_viewer=False,
        sim_options=gs.options.SimOptions(
            dt=0.004, substeps=2, gravity=(0.0, 0.0, -3.7)
        ),
        rigid_options=gs.options.RigidOptions(**rigid),
    )
    scene.add_entity(gs.morphs.Plane())
    scene.add_entity(gs.morphs.Sphere(radius=0.1, pos=(0.0, 0.0, 0.5)))
    return scene


def test_the_options_of_a_scene_are_read(engine):
    scene = ball_scene(
        friction_cone=gs.friction_cone.elliptic, iterations=7, constraint_timeconst=0.03
    )
    read = reader_of(scene).read(scene)
    assert read.backend == "genesis" and read.language == "genesis"
    assert read.gravity_m_per_s2 == (0.0, 0.0, -3.7)
    expected = {
        "timestep_s": 0.002,
        "precision": 64,
        "friction_cone": "elliptic",
        "contact_resolution": "signorini",
        "impratio": 100.0,
        "iterations": 7,
        "sustained_timeconst_s": 0.03,
        "impact_steps": None,
    }
    assert {name: read.settings[name] for name in expected} == expected


def test_a_built_scene_states_the_constants_of_its_geoms(engine):
    scene = ball_scene()
    scene.build()
    ball, ground = 0.04, 0.02
    for geom, timeconst in zip(scene.rigid_solver.geoms, (ground, ball), strict=True):
        geom.set_sol_params([timeconst, 0.5, 0.8, 0.9, 0.002, 0.5, 2.0])
    read = reader_of(scene).read(scene)
    scene.destroy()
    (group,) = read.contact_groups
    assert group.is_used and group.pair_count == 1
    assert group.settings["sustained_timeconst_s"] == pytest.approx(0.03)
    assert group.settings["sustained_dampratio"] == pytest.approx(0.5)
    assert group.settings["sustained_impedance"] == pytest.approx((0.8, 0.9, 0.002))


def test_saved_options_are_those_of_the_scene(engine, tmp_path):
    scene = ball_scene(iterations=7, noslip_iterations=3)
    path = tmp_path / "options.json"
    path.write_text(scene.options.model_dump_json())
    assert "Genesis" in reader_of(path).accepts
    values = {
        "sim": {"dt": 0.004, "substeps": 2},
        "rigid": {
            "iterations": 7,
            "noslip_iterations": 3,
            "friction_cone": 0,
            "contact_resolution": None,
        },
    }
    settings = options_settings(values, 32)
    assert (
        settings["timestep_s"] == 0.002 and settings["contact_resolution"] == "convex"
    )
    assert settings["iterations"] == 7 and settings["noslip_iterations"] == 3


def test_a_settings_file_is_no_file_of_options(tmp_path):
    path = tmp_path / "settings.json"
    path.write_text('{"backend": "mujoco"}')
    assert reader_of(path).accepts.startswith("a settings file")


def test_short_time_constants_are_raised_to_two_steps():
    options = {"sim": {"dt": 0.02}, "rigid": {"constraint_timeconst": None}}
    assert options_settings(options, 32)["sustained_timeconst_s"] == pytest.approx(0.04)


def test_changes_can_be_pasted(engine):
    text = LANGUAGE.paste_text(
        {"timestep_s": 0.001, "friction_cone": "elliptic", "iterations": 100}
    )
    simulation, _, rigid = text.partition(" and ")
    names = {"gs": gs}
    assert eval(f"dict({simulation})", names)["sim_options"].dt == 0.001
    options = eval(f"dict({rigid})", names)["rigid_options"]
    assert (
        options.iterations == 100 and options.friction_cone == gs.friction_cone.elliptic
    )
    scene = ball_scene()
    scene.build()
    constants = LANGUAGE.paste_text(
        {"sustained_timeconst_s": 0.03, "sustained_impedance": (0.95, 0.95, 0.001)}
    )
    exec(constants, {"scene": scene, "torch": torch})
    pasted = np.asarray(scene.rigid_solver.get_sol_params()).reshape(-1, 7)
    scene.destroy()
    assert pasted[:, 0] == pytest.approx(0.03) and pasted[:, 2:4] == pytest.approx(0.95)
    assert LANGUAGE.gravity_text((0.0, 0.0, -9.81)).endswith(
        "SimOptions(gravity=(0, 0, -9.81))"
    )
