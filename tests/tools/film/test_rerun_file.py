"""Recordings for the Rerun viewer, read back: bodies, cloth, markers, ghost and plots are those of the result."""

import sys
from dataclasses import replace

import numpy as np
import pytest

from gauge_envs.errors import MissingExtraError
from gauge_envs.evaluation.reference import reference_band
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.runs.episodes import run_episode
from gauge_envs.runs.replay import ReplayError
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result import RecordedTrajectory
from gauge_envs.scene.timing import SAMPLES_PER_FRAME
from gauge_envs.tools.film.rerun_file import write_rerun

NAME = "SlopeSlider-2-wood"


@pytest.fixture(scope="module")
def slider():
    return run_episode(RunRequest(NAME))


def read(file):
    """Columns of each chunk of a recording that has a time, by path."""
    reader = pytest.importorskip(
        "rerun.chunk", reason="extra 'rerun' is not installed"
    ).RrdReader(file)
    found = {}
    for chunk in reader.stream():
        if not chunk.is_static:
            batch = chunk.to_record_batch()
            # Times are whole nanoseconds, which Python's durations do not hold.
            rows = {"time": batch.column("time").to_numpy(zero_copy_only=False)}
            rows |= {
                name: batch.column(name).to_pylist()
                for name in batch.schema.names
                if ":" in name
            }
            found.setdefault(chunk.entity_path, []).append(rows)
    return found


def column(chunks, name):
    """Values of a component in the order of their times; each row holds one value."""
    rows = [
        (time, value[0])
        for chunk in chunks
        for time, value in zip(
            chunk["time"],
            chunk[next(key for key in chunk if key.endswith(name))],
            strict=True,
        )
    ]
    return np.array([value for _, value in sorted(rows, key=lambda row: row[0])])


def test_without_rerun_the_error_names_the_extra(slider, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(MissingExtraError, match=r"gauge-envs\[rerun\]"):
        write_rerun(slider, tmp_path / "a.rrd")


def test_the_recording_has_the_bodies_of_the_result(slider, tmp_path):
    pytest.importorskip("rerun", reason="extra 'rerun' is not installed")
    found = read(write_rerun(slider, tmp_path / "folder" / "a.rrd"))
    positions_m = column(found["/world/bodies/cube"], "Transform3D:translation")
    # Views are 60 a second, samples 180.
    assert positions_m == pytest.approx(
        1e-3 * slider.trajectory.arrays()[1][::3], abs=1e-7
    )
    band = reference_band(load_experiment(NAME))
    ghost_mm = 1e3 * column(found["/world/mean/cube"], "Transform3D:translation")
    assert band.project(ghost_mm) == pytest.approx(band.mean, abs=1e-3)


def test_the_plots_have_the_scored_coordinates_and_two_sigma(slider, tmp_path):
    pytest.importorskip("rerun", reason="extra 'rerun' is not installed")
    found = read(write_rerun(slider, tmp_path / "a.rrd"))
    band = reference_band(load_experiment(NAME))
    assert band is not None and slider.trajectory is not None
    simulated = column(found["/g/downhill/simulated"], "Scalars:scalars")
    assert simulated == pytest.approx(band.project(slider.trajectory.arrays()[1])[:, 0])
    low, high = (
        column(found[f"/g/downhill/{name}"], "Scalars:scalars")
        for name in ("low", "high")
    )
    assert high - low == pytest.approx(4.0 * band.sigma[:, 0])
    assert 0.5 * (high + low) == pytest.approx(band.mean[:, 0])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "body"),
    [("TextileBending-oxford", "cloth"), ("FoamCompressing-soft", "foam")],
)
def test_deformable_bodies_and_markers_are_recorded(name, body, tmp_path):
    pytest.importorskip("rerun", reason="extra 'rerun' is not installed")
    result = run_episode(RunRequest(name))
    found = read(write_rerun(result, tmp_path / "a.rrd"))
    frames = load_experiment(name).frame_count
    meshes = [
        path
        for path, chunks in found.items()
        if any("Mesh3D" in key for chunk in chunks for key in chunk)
    ]
    assert len(meshes) == len(load_experiment(name).scene.deformables), body
    for path in (*meshes, "/world/markers"):
        assert sum(len(chunk["time"]) for chunk in found[path]) == frames


def test_a_result_that_the_engine_does_not_repeat_is_refused(slider, tmp_path):
    pytest.importorskip("rerun", reason="extra 'rerun' is not installed")
    times_s, samples = slider.trajectory.arrays(later=True)
    samples[5 * SAMPLES_PER_FRAME] += 0.5
    forged = replace(
        slider,
        trajectory=RecordedTrajectory.of(load_experiment(NAME), times_s, samples),
    )
    with pytest.raises(ReplayError, match=r"differs from the result by up to 0\.5 mm"):
        write_rerun(forged, tmp_path / "a.rrd")
    assert not (tmp_path / "a.rrd").exists()
