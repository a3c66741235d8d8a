"""The bands: complete, consistent with their arrays, equal to closed forms, and read back as an import writes them."""

import json
import math
import os
import shutil
import tomllib
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from swings import swung_rad

from gauge_envs import load_experiment, variants
from gauge_envs.errors import ReferenceFileError, ShapeError
from gauge_envs.references.band import load_band, read_band_file
from gauge_envs.references.convergence import convergence_rows, read_convergence
from gauge_envs.references.imported import ImportFacts, load_imported, write_imported
from gauge_envs.references.published import published_baselines
from gauge_envs.references.tables import scoring_folder
from gauge_envs.references.user_data import DataSource
from gauge_envs.scene import body_mass_properties
from gauge_envs.tools.dataset.statistics import leave_one_out_distances

NAMES = [variant.name for variant in variants()]
BANDS = {name: band for name in NAMES if (band := load_band(name)) is not None}
GRAVITY = 9.80665


def test_72_of_75_ids_have_a_reference_and_each_file_gives_its_kind():
    kinds = Counter(band.kind.value for band in BANDS.values())
    assert kinds == {
        "trials": 4,
        "recording": 2,
        "published": 4,
        "analytic": 28,
        "numerical": 34,
    }
    assert (len(NAMES), len(BANDS)) == (75, 72)
    for name in NAMES:
        content = read_band_file(scoring_folder("bands") / f"{name}.toml")
        assert content.source and (content.kind == "none" or content.licence)
        assert content.unit == load_experiment(name).score.observable.unit


def test_only_references_with_single_trials_are_trials_and_no_published_one_has_any():
    """What has the kind `trials` is measured motion; a mean of published numbers has the kind `published`."""
    for name, band in BANDS.items():
        assert (band.trials is not None) == (band.kind.value == "trials"), name
        assert band.kind.is_real == (band.kind.value in ("trials", "recording"))


@pytest.mark.parametrize("name", BANDS)
def test_the_numbers_of_a_band_follow_from_its_arrays(name):
    band, experiment = BANDS[name], load_experiment(name)
    text = (scoring_folder("bands") / f"{name}.toml").read_text(encoding="utf-8")
    content = tomllib.loads(text)
    count, width = len(band.coordinates), len(experiment.coordinates)
    assert band.mean.shape == (experiment.frame_count, count)
    assert band.projection.shape == (count, width)
    assert f"Band({band.kind}, {len(band.mean)} frames" in repr(band)
    assert not (band.sigma < 0.0).any()
    computed = replace(band, given_uncertainty=None)
    expected_mm = pytest.approx(content["zero_motion_distance"])
    assert computed.zero_motion_distance == expected_mm
    if "the form is exact" in content["source"]:
        assert band.standard_uncertainty == 0.0 and not np.nansum(band.uncertainty)
    elif band.kind.is_solution or band.trials is not None:
        expected_mm = pytest.approx(content["standard_uncertainty"], rel=1e-5)
        assert computed.standard_uncertainty == expected_mm
    # A reference must distinguish a scene without motion. In SlopeSlider-1 the cube does not move.
    if not name.startswith("SlopeSlider-1"):
        assert band.zero_motion_distance > 3.0 * band.standard_uncertainty


def test_the_baseline_is_as_uncertain_as_its_means_without_each_trial():
    """The trials share a mean, so their distances depend on each other: the scatter alone would give half of it."""
    band = BANDS["SlopeSlider-2-plastic"]
    distances = band.trial_rmse_aligned
    count = len(distances)
    means = [
        leave_one_out_distances(np.delete(band.trials, trial, axis=0))[1].mean()
        for trial in range(count)
    ]
    pseudo_values = count * distances.mean() - (count - 1) * np.array(means)
    expected = pseudo_values.std(ddof=1) / math.sqrt(count)
    assert band.baselines_without == pytest.approx(means)
    assert expected > 1.8 * distances.std(ddof=1) / math.sqrt(count)


def test_a_band_with_arrays_of_different_lengths_is_rejected():
    band = BANDS["SlopeSlider-2-wood"]
    assert band.project([[2.0, 7.0, 4.0]]) == pytest.approx(3**0.5 - 2.0)
    for changes in ({"sigma": band.sigma[1:]}, {"coordinates": ("a", "b")}):
        with pytest.raises(ShapeError):
            replace(band, **changes)
    with pytest.raises(ShapeError, match=r"\[frame_count, 3\]"):
        band.project(np.zeros((5, 2)))


# --- closed forms ----------------------------------------------------------------------------------------------------


def frames_s(band):
    return np.flatnonzero(band.known) / 30.0


@pytest.mark.parametrize("name", [name for name in BANDS if "Nonsmooth" in name])
def test_a_free_fall_is_half_g_t_squared(name):
    band, experiment = BANDS[name], load_experiment(name)
    start = experiment.scene.body(experiment.recorded[0]).pose.position_m
    fallen_mm = 500.0 * GRAVITY * frames_s(band) ** 2
    expected = 1e3 * np.array(start) - fallen_mm[:, None] * [0.0, 0.0, 1.0]
    np.testing.assert_allclose(band.mean[band.known], expected, atol=1e-9)


def test_the_pendulum_equals_an_integrated_pendulum():
    """I phi'' = -m g l sin(phi) about the hinge, with the moment of inertia of the body's shape."""
    scene, band = load_experiment("Pendulum-metal").scene, BANDS["Pendulum-metal"]
    (joint,) = scene.joints
    body = scene.body(joint.body)
    arm_m = np.array(body.pose.position_m) - joint.anchor_m
    length_m = np.linalg.norm(arm_m)
    axis = np.array(joint.axis)
    _, about_centre = body_mass_properties(body)
    of_axis = axis @ body.pose.matrix @ about_centre @ body.pose.matrix.T @ axis
    inertia = of_axis + body.mass_kg * length_m**2
    sideways = np.cross(axis, [0.0, 0.0, -1.0])
    angle = swung_rad(
        frames_s(band),
        math.atan2(arm_m @ sideways, -arm_m[2]),
        square_rate=body.mass_kg * GRAVITY * length_m / inertia,
    )[:, None]
    path = np.sin(angle) * sideways - np.cos(angle) * [0.0, 0.0, 1.0]
    expected = 1e3 * (np.array(joint.anchor_m) + length_m * path)
    np.testing.assert_allclose(band.mean[band.known], expected, atol=1e-6)


@pytest.mark.parametrize("name", [name for name in BANDS if "Turntable-1" in name])
def test_a_carried_cube_turns_with_the_plate(name):
    scene, band = load_experiment(name).scene, BANDS[name]
    (rotation,) = scene.drivers[0].motions
    centre_mm = 1e3 * np.array(rotation.point_m)
    start = 1e3 * np.array(scene.body("cube").pose.position_m) - centre_mm
    angles = [
        rotation.value(time_s) * np.sign(rotation.axis[2]) for time_s in frames_s(band)
    ]
    cosine, sine = np.cos(angles), np.sin(angles)
    x = start[0] * cosine - start[1] * sine
    y = start[0] * sine + start[1] * cosine
    expected = np.stack([x, y, np.full_like(x, start[2])], axis=1) + centre_mm
    np.testing.assert_allclose(band.mean, expected, atol=1e-6)


# --- files -----------------------------------------------------------------------------------------------------------


@pytest.fixture
def written(tmp_path, monkeypatch):
    """Import the bundled trials of a slide, and return their name, band, facts and file."""
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
    (file,) = (tmp_path / "trials").iterdir()
    return name, bundled, facts, file


def test_an_import_is_read_as_written_and_only_on_request(written):
    name, bundled, facts, file = written
    imported = load_band(name, DataSource.IMPORTED)
    assert imported is not bundled and load_band(name) is bundled
    for array in ("trials", "projection", "mean", "sigma", "measured"):
        np.testing.assert_array_equal(getattr(imported, array), getattr(bundled, array))
    assert load_imported(name).facts == facts
    other = file.with_name("SlopeSlider-2-metal.npz")
    shutil.copy(file, other)
    with pytest.raises(ReferenceFileError, match="it is the import of Slope"):
        load_imported(other.stem)


def test_a_flipped_bit_of_an_import_is_an_error_of_its_id_alone(written, gauge):
    """An import is one file whose arrays have checksums, so a flipped bit is harmless or is found."""
    name, bundled, facts, file = written
    content = file.read_bytes()
    faults = []
    for place in np.linspace(0, len(content) - 1, 200).astype(int):
        damaged = bytearray(content)
        damaged[place] ^= 1 << place % 8
        file.write_bytes(damaged)
        os.utime(file, ns=(place, place))
        try:
            imported = load_imported(name)
        except ReferenceFileError as error:
            faults.append(str(error))
            continue
        assert imported.facts == facts
        np.testing.assert_array_equal(imported.band.mean, bundled.mean)
    assert len(faults) > 150
    for fault in faults:
        assert f"{name}.npz" in fault
        assert fault.endswith(f"gauge data import DIR {name} renews it")
    file.write_bytes(content[:-40])
    done = gauge("list", "references", "SlopeSlider-2-*", "--json")
    faults = {
        row["id"]: row["fault"] for row in map(json.loads, done.stdout.split("\n")[:-1])
    }
    assert len(faults) == 3
    assert [key for key, fault in faults.items() if fault] == [f"GAUGE/{name}"]


@pytest.mark.parametrize("engine", ["mujoco", "newton"])
def test_convergence_halves_a_step_and_is_relative_to_the_published_scatter(engine):
    rows = read_convergence(scoring_folder("convergence") / f"{engine}.csv")
    assert rows
    for (name, setting), row in rows.items():
        assert name in NAMES
        assert row.unit == load_experiment(name).score.observable.unit
        assert setting == "training" or row.refined == pytest.approx(
            0.5 * row.default, rel=1e-3
        )
        if row.share is not None:
            scatter = published_baselines(name)["rmse"].mean
            assert row.share == pytest.approx(row.rms / scatter, rel=2e-3)
        shown = convergence_rows(engine, f"GAUGE/{name}")[setting]
        assert shown == row.model_dump()
    assert convergence_rows("another", "SlopeSlider-2-wood") == {}
