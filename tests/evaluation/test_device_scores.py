"""Scores of kernels are those of NumPy, on Warp's CPU device."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from gauge_envs.backends.base import Recording
from gauge_envs.errors import BackendError, ShapeError
from gauge_envs.evaluation import worlds
from gauge_envs.evaluation.reference import reference_band
from gauge_envs.evaluation.worlds import score_recording, score_worlds
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.experiments.variants import variants
from gauge_envs.observables.kinds import Observable
from gauge_envs.references.bands import Band
from gauge_envs.scene.timing import SAMPLE_INTERVAL_S, SAMPLES_PER_FRAME

wp = pytest.importorskip("warp")
recordings = pytest.importorskip("gauge_envs.backends.newton.recordings")

Record = Callable[[Any], Recording]
COUNT = 33
LATER = 10 * SAMPLES_PER_FRAME


def scored_ids() -> list[str]:
    """All experiments of rigid bodies without drivers that have a band."""
    found = []
    for variant in variants():
        name = variant.name
        experiment = load_experiment(name)
        passive = (
            not experiment.scene.drivers
            and not experiment.scene.deformables
            and experiment.trial is None
        )
        if (
            passive
            and experiment.score.observable is Observable.POSITION
            and reference_band(experiment) is not None
        ):
            found.append(name)
    return found


def recorded(experiment: Experiment, band: Band) -> tuple[np.ndarray, np.ndarray]:
    """Positions [m] near the band with own releases and rates, shape [sample_count, COUNT, 1, 3], and sample counts."""
    random = np.random.default_rng(5)
    frames = SAMPLES_PER_FRAME * np.arange(len(band.mean))
    needed = (experiment.frame_count - 1) * SAMPLES_PER_FRAME + 1
    numbers = np.arange(needed + LATER)
    positions = np.empty((len(numbers), COUNT, 1, 3))
    back = np.linalg.pinv(band.projection)
    for world in range(COUNT):
        release, rate = random.normal(0.0, 20.0), random.normal(1.0, 0.05)
        columns = [
            np.interp(rate * (numbers - release), frames, np.nan_to_num(one))
            for one in band.mean.T
        ]
        noise = random.normal(0.0, 2.0, (len(numbers), 3))
        positions[:, world, 0] = 1e-3 * (
            np.column_stack(columns) @ back.T + noise + random.normal(0.0, 3.0, 3)
        )
    counts = np.full(COUNT, len(numbers))
    # Worlds that end early after the last frame, one that lacks its last frame, and one that diverged.
    counts[2:8] = needed + random.integers(0, LATER, 6)
    counts[8], counts[9] = needed - 1, 0
    return positions, counts


def on_the_host(
    experiment: Experiment, band: Band, positions: np.ndarray, counts: np.ndarray
) -> dict[str, np.ndarray]:
    values = 1e3 * positions.reshape(len(positions), COUNT, -1).transpose(1, 0, 2)
    missing = np.arange(len(positions)) >= counts[:, None]
    return score_worlds(
        experiment,
        band,
        times_s=SAMPLE_INTERVAL_S * np.arange(len(positions)),
        values=np.where(missing[:, :, None], np.nan, values),
    )


def on_host(positions: Any) -> Recording:
    return Recording(device="cpu", positions_m=positions, states=None)


def on_device(positions: np.ndarray) -> Recording:
    return Recording(
        device="cpu",
        positions_m=wp.from_numpy(positions),
        states=None,
        kernels=recordings.WarpKernels(),
    )


def assert_same(one: dict[str, np.ndarray], other: dict[str, np.ndarray]) -> None:
    assert one.keys() == other.keys()
    for key, values in one.items():
        np.testing.assert_allclose(
            values, other[key], rtol=1e-9, atol=1e-9, err_msg=key
        )


def test_the_ids_are_those_of_passive_rigid_bodies() -> None:
    assert len(scored_ids()) == 17


@pytest.mark.parametrize("name", scored_ids())
def test_kernels_give_the_scores_of_numpy(name: str) -> None:
    experiment = load_experiment(name)
    band = reference_band(experiment)
    positions, counts = recorded(experiment, band)
    kernels = score_recording(
        experiment, band, recording=on_device(positions), rows=[0], sample_counts=counts
    )
    host = on_the_host(experiment, band, positions, counts)
    assert_same(kernels, host)
    # Some laws end before the last frame, which is then not needed.
    assert np.flatnonzero(np.isnan(kernels["rmse"])).tolist() == (
        [8, 9] if np.isfinite(band.mean[-1]).any() else [9]
    )


def test_arrays_on_the_cpu_are_scored_without_kernels() -> None:
    """NumPy's, and those of a library that hands them over by DLPack."""
    experiment = load_experiment("SlopeSlider-2-wood")
    band = reference_band(experiment)
    positions, counts = recorded(experiment, band)
    host = on_the_host(experiment, band, positions, counts)

    class Handed:
        def __dlpack__(self, **options: object) -> object:
            return positions.__dlpack__(**options)

        def __dlpack_device__(self) -> tuple[int, int]:
            return positions.__dlpack_device__()

    for array in (positions, Handed()):
        found = score_recording(
            experiment, band, recording=on_host(array), rows=[0], sample_counts=counts
        )
        assert all(
            np.array_equal(values, host[key], equal_nan=True)
            for key, values in found.items()
        )


def test_arrays_on_a_gpu_need_kernels() -> None:
    class OnGPU:
        def __dlpack_device__(self) -> tuple[int, int]:
            return 2, 0

    experiment = load_experiment("SlopeSlider-2-wood")
    with pytest.raises(BackendError, match="kernels"):
        score_recording(
            experiment,
            reference_band(experiment),
            recording=on_host(OnGPU()),
            rows=[0],
            sample_counts=np.ones(1, int),
        )


@pytest.mark.parametrize(
    "fault",
    ["one world shifted", "row of the band", "release offset", "range of shifts"],
)
def test_planted_faults_are_found(fault: str, monkeypatch: pytest.MonkeyPatch) -> None:
    experiment = load_experiment("SlopeSlider-2-wood")
    band = reference_band(experiment)
    positions, counts = recorded(experiment, band)
    host = on_the_host(experiment, band, positions, counts)
    if fault == "one world shifted":
        positions[:-1, 20] = positions[1:, 20].copy()
    elif fault == "row of the band":
        mean = band.mean.copy()
        mean[[5, 6]] = mean[[6, 5]]
        band = replace(band, mean=mean)
    elif fault == "release offset":
        monkeypatch.setattr(worlds, "SAMPLE_INTERVAL_S", SAMPLE_INTERVAL_S * 1.001)
    else:
        counts[2:8] += 1
    kernels = score_recording(
        experiment, band, recording=on_device(positions), rows=[0], sample_counts=counts
    )
    with pytest.raises(AssertionError):
        assert_same(kernels, host)


def test_the_observed_body_is_chosen_among_several() -> None:
    experiment = load_experiment("SlopeSlider-2-wood")
    band = reference_band(experiment)
    positions, counts = recorded(experiment, band)
    among = np.ascontiguousarray(
        np.concatenate([positions + 1.0, positions, positions - 1.0], axis=2)
    )
    one, other = (
        score_recording(
            experiment,
            band,
            recording=on_device(array),
            rows=[row],
            sample_counts=counts,
        )
        for array, row in ((positions, 0), (among, 1))
    )
    assert all(np.array_equal(one[key], other[key], equal_nan=True) for key in one)


@pytest.mark.parametrize("change", ["worlds", "length", "bodies"])
def test_positions_of_another_shape_are_refused(change: str) -> None:
    experiment = load_experiment("SlopeSlider-2-wood")
    band = reference_band(experiment)
    positions, counts = recorded(experiment, band)
    rows = [0, 0] if change == "bodies" else [0]
    positions = positions[:50].copy() if change == "length" else positions
    counts = counts[1:] if change == "worlds" else counts
    with pytest.raises(ShapeError, match="are needed"):
        score_recording(
            experiment,
            band,
            recording=on_device(positions),
            rows=rows,
            sample_counts=counts,
        )


@pytest.mark.parametrize("record", [on_host, on_device])
@pytest.mark.parametrize(
    ("rows", "kind", "reason"),
    [
        ([7], np.float64, "numbers of the"),
        ([-1], np.float64, "numbers of the"),
        ([0], np.float32, "64-bit floats"),
    ],
)
def test_a_kernel_reads_only_the_positions(
    record: Record, rows: list[int], kind: type, reason: str
) -> None:
    experiment = load_experiment("SlopeSlider-2-wood")
    band = reference_band(experiment)
    positions, counts = recorded(experiment, band)
    with pytest.raises(ShapeError, match=reason):
        score_recording(
            experiment,
            band,
            recording=record(positions.astype(kind)),
            rows=rows,
            sample_counts=counts,
        )
