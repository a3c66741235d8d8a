"""Hinges between two bodies in MuJoCo: MJCF files there and back, states, and the reader of positions."""

import re

import numpy as np
import pytest

from gauge_envs import load_experiment
from gauge_envs.backends.mujoco import BackendMuJoCo
from gauge_envs.errors import AssetError
from gauge_envs.experiments.resolve import load_experiment_from_asset
from gauge_envs.tools.assets.export import write_mjcf

NAME = "ElbowToss-blocks"
BODIES = ("first", "second")


@pytest.fixture
def file(tmp_path):
    write_mjcf(load_experiment(NAME), tmp_path / "elbow.xml")
    return tmp_path / "elbow.xml"


@pytest.fixture
def scene():
    return load_experiment(NAME).scene


def flight(simulation):
    simulation.reset(0)
    states = []
    for _ in range(60):
        simulation.advance(1.0 / 180.0)
        states.append(simulation.body_states(BODIES))
    return np.array(states)


def test_a_file_gives_the_same_scene_and_motion(file, scene):
    engine = BackendMuJoCo()
    read = engine.read_file(file, scene)
    assert read.changes == ()
    assert read.scene == scene
    np.testing.assert_array_equal(
        flight(engine.build_file(file, read.scene)), flight(engine.build(scene))
    )


def test_an_edited_hinge_is_named_and_read(file, scene):
    text = file.read_text()
    edited = re.sub(
        r'(<joint name="second"[^>]* pos=")([^" ]+)',
        lambda m: f"{m[1]}{float(m[2]) + 0.01}",
        text,
    )
    assert edited != text
    file.write_text(edited)
    read = BackendMuJoCo().read_file(file, scene)
    assert any("second" in line and "pos" in line for line in read.changes)
    assert np.linalg.norm(
        np.subtract(read.scene.body_hinges[0].anchor_m, scene.body_hinges[0].anchor_m)
    ) == (pytest.approx(0.01, abs=1e-9))


def test_edited_start_rates_keep_the_hinge_closed(file, scene):
    """A faster root carries the body that hangs on it; the scene accepts the velocities, so the hinge is not torn."""
    text = file.read_text()
    rates = re.search(r'<key name="start"[^>]* qvel="([^"]+)"', text)
    values = [float(one) for one in rates[1].split()]
    values[0] += 1.0
    values[4] += 2.0
    file.write_text(text.replace(rates[1], " ".join(map(str, values))))
    read = BackendMuJoCo().read_file(file, scene).scene
    assert read.body("first").linear_velocity_m_per_s[0] == pytest.approx(values[0])
    assert (
        read.body("second").linear_velocity_m_per_s
        != scene.body("second").linear_velocity_m_per_s
    )


def test_a_body_that_hangs_elsewhere_is_refused(file, scene):
    text = file.read_text()
    block = re.search(r'\s*<body name="second".*?</body>', text, flags=re.DOTALL)
    file.write_text(
        text.replace(block[0], "").replace("</worldbody>", f"{block[0]}\n</worldbody>")
    )
    with pytest.raises(AssetError, match="hangs on 'first'"):
        BackendMuJoCo().read_file(file, scene)


def test_an_experiment_runs_from_its_file(file):
    experiment = load_experiment_from_asset(NAME, file)
    assert not experiment.edited
    assert experiment.scene.body_hinges


def test_positions_are_those_of_states(scene):
    one, other = (BackendMuJoCo().build(scene) for _ in range(2))
    positions = one.sample_positions(BODIES, 5, 1.0 / 180.0)
    for row in positions:
        other.advance(1.0 / 180.0)
        np.testing.assert_allclose(row, other.body_states(BODIES)[:, :3], atol=1e-14)
        np.testing.assert_allclose(
            other.body_states(("second",))[0], other.body_states(BODIES)[1], atol=1e-14
        )
