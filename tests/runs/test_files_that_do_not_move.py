"""`gauge score` solves nothing for a file that does not move, or for one of zeros, of any id."""

from pathlib import Path

import numpy as np
import pytest

from gauge_envs.errors import TrajectoryFileError
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.experiments.variants import variants
from gauge_envs.runs.score_file import score_file
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scoring.likely_mistakes import start_values
from gauge_envs.scoring.score import Score

IDS = [one.name for one in variants()]

AT_REST = frozenset(
    {"SlopeSlider-1-wood", "SlopeSlider-1-plastic", "SlopeSlider-1-metal"}
)
"""Scenes whose solution is that nothing moves: a file that does not move is right."""


def scored(
    name: str, folder: Path, values: FloatArray, markers_m: FloatArray | None
) -> Score:
    file = folder / "motion.npz"
    frame_count = load_experiment(name).frame_count
    arrays = {"g": np.tile(values, (frame_count, 1))}
    if markers_m is not None:
        arrays["markers_m"] = np.tile(markers_m, (frame_count, 1, 1))
    np.savez(file, **arrays)
    result, _ = score_file(file, variant=name)
    return result.score


@pytest.mark.slow
@pytest.mark.parametrize("name", IDS)
def test_a_file_that_does_not_move_solves_nothing(name: str, tmp_path: Path) -> None:
    experiment = load_experiment(name)
    markers = experiment.scene.markers
    positions_m = None if markers is None else np.asarray(markers.positions_m)
    score = scored(name, tmp_path, start_values(experiment), positions_m)
    assert (score.verdict == "inside") is (name in AT_REST)


@pytest.mark.slow
@pytest.mark.parametrize("name", IDS)
def test_a_file_of_zeros_solves_nothing(name: str, tmp_path: Path) -> None:
    """Most are refused: their bodies do not start there."""
    experiment = load_experiment(name)
    markers = experiment.scene.markers
    zeros = np.zeros_like(start_values(experiment))
    for positions_m in (
        None,
        None if markers is None else np.zeros_like(markers.positions_m),
    ):
        try:
            score = scored(name, tmp_path, zeros, positions_m)
        except TrajectoryFileError:
            continue
        assert score.verdict != "inside"
