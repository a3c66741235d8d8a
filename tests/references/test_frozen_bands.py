"""The frozen references: complete, consistent, and equal to closed forms that are integrated here."""

import math
import tomllib

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from gauge_envs import load_experiment, variants
from gauge_envs.errors import ReferenceFileError
from gauge_envs.references.band import load_band, stated_of
from gauge_envs.references.imported import ImportFacts, load_imported, write_imported
from gauge_envs.references.kind import Kind
from gauge_envs.references.tables import scoring_folder
from gauge_envs.references.user_data import DataSource
from gauge_envs.scene.geometry import rotation_matrices
from gauge_envs.scene.meshes import body_mass_properties

NAMES = [one.name for one in variants()]
SCORED = [name for name in NAMES if load_band(name) is not None]
GRAVITY = 9.80665


def test_62_of_75_ids_have_a_reference_and_each_file_says_what_it_is():
    kinds = {name: load_band(name).kind for name in SCORED}
    assert (len(NAMES), len(SCORED)) == (75, 62)
    count = {kind.value: list(kinds.values()).count(kind) for kind in Kind}
    assert count == {
        "trials": 8,
        "recording": 2,
        "analytic": 22,
        "numerical": 30,
        "none": 0,
    }
    for name in NAMES:
        stated = stated_of(scoring_folder("bands") / f"{name}.toml")
        assert stated.source and (stated.kind == "none" or stated.licence)
        assert stated.unit == load_experiment(name).score.observable.unit


@pytest.mark.parametrize("name", SCORED)
def test_numbers_of_the_toml_file_are_those_of_the_arrays(name):
    band = load_band(name)
    text = (scoring_folder("bands") / f"{name}.toml").read_text(encoding="utf-8")
    stated = tomllib.loads(text)
    assert band.zero_motion_distance == pytest.approx(stated["zero_motion_distance"])
    assert band.mean.shape == (load_experiment(name).frame_count, len(band.coordinates))
    assert band.projection.shape[1] == len(load_experiment(name).coordinates)
    compared = band.compared
    spread = compared.sigma if compared.uncertainty is None else compared.uncertainty
    if "exact" in stated["source"]:
        assert band.standard_uncertainty == pytest.approx(math.sqrt(3.0))
    elif band.kind.is_solution:
        assert band.standard_uncertainty == pytest.approx(compared.length(spread))
    # What a frozen scene is told from: else a reference says nothing. A cube that holds does not move.
    if not name.startswith("SlopeSlider-1"):
        assert band.zero_motion_distance > 3.0 * band.standard_uncertainty


# --- closed forms ----------------------------------------------------------------------------------------------------


def frames_s(band):
    return np.flatnonzero(band.known) / 30.0


@pytest.mark.parametrize("name", [one for one in SCORED if "Nonsmooth" in one])
def test_a_free_fall_is_half_g_t_squared(name):
    band, scene = load_band(name), load_experiment(name).scene
    body = load_experiment(name).recorded[0]
    start_mm = 1e3 * np.array(scene.body(body).pose.position_m)
    fallen_mm = 500.0 * GRAVITY * frames_s(band) ** 2
    expected = start_mm - fallen_mm[:, None] * [0.0, 0.0, 1.0]
    np.testing.assert_allclose(band.mean[band.known], expected, atol=1e-9)


def test_the_pendulum_swings_as_the_integrated_one():
    """I phi'' = -m g l sin(phi) about the hinge, with the moment of inertia of the body's shape."""
    experiment, band = load_experiment("Pendulum-metal"), load_band("Pendulum-metal")
    (joint,) = experiment.scene.joints
    body = experiment.scene.body(joint.body)
    arm_m = np.array(body.pose.position_m) - joint.anchor_m
    length_m = np.linalg.norm(arm_m)
    axis = np.array(joint.axis)
    rotation = rotation_matrices(np.array([body.pose.quaternion]))[0]
    _, about_centre = body_mass_properties(body)
    inertia = rotation @ about_centre @ rotation.T
    about_hinge = axis @ inertia @ axis + body.mass_kg * length_m**2
    square_rate = body.mass_kg * GRAVITY * length_m / about_hinge
    sideways = np.cross(axis, [0.0, 0.0, -1.0])
    start_rad = math.atan2(arm_m @ sideways, -arm_m[2])

    def slopes(_, state):
        return [state[1], -square_rate * math.sin(state[0])]

    times_s = frames_s(band)
    swing = solve_ivp(
        slopes,
        (0.0, times_s[-1]),
        [start_rad, 0.0],
        "DOP853",
        times_s,
        rtol=1e-12,
        atol=1e-13,
    )
    angle = swing.y[0][:, None]
    path = np.sin(angle) * sideways - np.cos(angle) * [0.0, 0.0, 1.0]
    expected = 1e3 * (np.array(joint.anchor_m) + length_m * path)
    np.testing.assert_allclose(band.mean[band.known], expected, atol=1e-6)


@pytest.mark.parametrize("name", [one for one in SCORED if "Turntable-1" in one])
def test_a_carried_cube_turns_with_the_plate(name):
    experiment, band = load_experiment(name), load_band(name)
    (turn,) = experiment.scene.drivers[0].motions
    centre_mm = 1e3 * np.array(turn.point_m)
    start = 1e3 * np.array(experiment.scene.body("cube").pose.position_m) - centre_mm
    angles = [turn.value(time_s) * np.sign(turn.axis[2]) for time_s in frames_s(band)]
    cosine, sine = np.cos(angles), np.sin(angles)
    x = start[0] * cosine - start[1] * sine
    y = start[0] * sine + start[1] * cosine
    expected = np.stack([x, y, np.full_like(x, start[2])], axis=1) + centre_mm
    np.testing.assert_allclose(band.mean, expected, atol=1e-6)


# --- imports ---------------------------------------------------------------------------------------------------------


def test_an_import_is_the_same_pair_of_files_and_is_read_where_it_is_asked_for(
    tmp_path, monkeypatch
):
    monkeypatch.setenv("GAUGE_DATA_DIR", str(tmp_path))
    name = "SlopeSlider-2-wood"
    bundled = load_band(name)
    facts = ImportFacts(
        variant=name,
        left_out=0,
        files=("a.json",),
        files_sha256="0" * 64,
        task_sha256="1" * 64,
        metrics={},
        drivers=(),
    )
    write_imported(bundled, {}, facts)
    assert {file.name for file in (tmp_path / "trials").iterdir()} == {
        f"{name}.toml",
        f"{name}.npz",
    }
    imported = load_band(name, DataSource.IMPORTED)
    assert imported is not bundled and load_band(name) is bundled
    np.testing.assert_array_equal(imported.trials, bundled.trials)
    np.testing.assert_array_equal(imported.projection, bundled.projection)
    assert load_imported(name).facts == facts
    (tmp_path / "trials" / f"{name}.npz").write_bytes(b"nothing")
    (tmp_path / "trials" / f"{name}.toml").write_text(
        (tmp_path / "trials" / f"{name}.toml").read_text() + "\n"
    )
    with pytest.raises(ReferenceFileError, match=rf"{name}\.npz"):
        load_band(name, DataSource.IMPORTED)


@pytest.mark.parametrize("name", SCORED)
def test_arrays_of_a_band_fit_each_other(name):
    band = load_band(name)
    width = len(load_experiment(name).coordinates)
    assert band.projection.shape == (len(band.coordinates), width)
    assert band.measured.shape == band.mean.shape[:1]
    assert not (band.sigma < 0.0).any()
