"""The best path through candidates: what dynamic programming keeps and what it leaves out."""

from __future__ import annotations

import numpy as np
import pytest

from gauge_envs.tools.video.follow import Sight, best_path


def sight(x: float, likeness: float) -> Sight:
    return Sight(x_px=x, y_px=0.0, likeness=likeness, size_ratio=1.0)


@pytest.mark.parametrize("decoys", [1, 3])
def test_a_likelier_place_far_away_is_left_out(decoys: int) -> None:
    frames = [[sight(4.0 * number, 0.7)] for number in range(20)]
    for number in range(8, 8 + decoys):
        frames[number].append(sight(150.0, 0.95))
    path = best_path(frames, np.zeros(2), 50.0)
    assert [one.x_px for one in path] == [4.0 * number for number in range(20)]


def test_a_gap_is_bridged_and_stays_empty() -> None:
    frames = [[sight(4.0 * number, 0.7)] if not 6 <= number < 12 else [] for number in range(20)]
    path = best_path(frames, np.zeros(2), 50.0)
    assert [number for number, one in enumerate(path) if not np.isfinite(one.x_px)] == list(range(6, 12))


def test_nothing_is_found_where_there_is_no_candidate() -> None:
    assert all(one.likeness == 0.0 for one in best_path([[], [], []], np.zeros(2), 50.0))
