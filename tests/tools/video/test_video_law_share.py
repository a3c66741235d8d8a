"""The share of its law that a clip reaches."""

from dataclasses import replace

import pytest

pytest.importorskip("cv2")

from clips import driven

from gauge_envs.tools.video import law_share, score_track, video_task


def fall(a_m_s2):
    """Score a fall from rest with an acceleration."""
    track = driven("BouncingBall-rubber", a_m_s2, fps=60.0, release_s=0.0)
    return score_track(track, video_task("BouncingBall-rubber"))


def test_the_share_is_the_smaller_ratio_and_0_of_what_is_refused():
    task = video_task("BouncingBall-rubber")
    shares = [law_share(fall(a), task) for a in (9.81, 0.5 * 9.81, 2.0 * 9.81, 0.0)]
    # In whole pixels the release of the slow fall is a frame later, by 5 % of its acceleration.
    assert shares == pytest.approx([1.0, 0.5, 0.5, 0.0], abs=0.03)
    refused = replace(fall(9.81), is_sound=False)
    assert law_share(refused, task) == 0.0
