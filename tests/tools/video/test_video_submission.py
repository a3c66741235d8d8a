"""Submissions of video labs: what they lack is named, and they rank between real trials and a still picture."""

from dataclasses import replace

import pytest

pytest.importorskip("cv2")

from clips import driven

from gauge_envs.errors import ReferenceFileError
from gauge_envs.tools.video import score_track, video_task, video_tasks
from gauge_envs.tools.video.prompts import COMMIT
from gauge_envs.tools.video.submission import (
    FILE,
    SEEDS,
    law_share,
    ranking,
    submission_faults,
)

SUBMISSION = (
    f'model = "mine"\nprompts = "{COMMIT}"\nsettings = "50"\nseeds = [1, 2, 3, 4]\n'
)


def submitted(folder):
    """Write four clips of each task, with nothing to see, and return them by task."""
    (folder / FILE).write_text(SUBMISSION)
    clips = {}
    for task in video_tasks():
        (folder / task.id).mkdir()
        files = [folder / task.id / f"seed_{seed}.csv" for seed in range(1, SEEDS + 1)]
        for file in files:
            file.write_text(str(file))
        clips[task.id] = files
    return clips


def test_a_submission_that_lacks_a_clip_or_has_one_twice_is_named(tmp_path):
    clips = submitted(tmp_path)
    assert submission_faults(tmp_path, clips) == []
    first, second, *_ = clips["Pendulum-metal"]
    second.write_bytes(first.read_bytes())
    del clips["Turntable-2-wood"]
    text = SUBMISSION.replace(COMMIT, "another").replace("[1, 2, 3, 4]", "[1, 1]")
    (tmp_path / FILE).write_text(text)
    found = " ".join(submission_faults(tmp_path, clips))
    for words in (
        "prompts is another",
        "seeds has 1 numbers, not 4",
        "Turntable-2-wood has 0 clips, not 4",
        "seed_2.csv of Pendulum-metal is Pendulum-metal/seed_1.csv again",
    ):
        assert words in found
    (tmp_path / FILE).write_text(SUBMISSION + "price = 1\n")
    with pytest.raises(
        ReferenceFileError, match=r"submission\.toml: price: unknown key"
    ):
        submission_faults(tmp_path, clips)


def fall(a_m_s2):
    """Score a fall from rest with an acceleration."""
    track = driven("BouncingBall-rubber", a_m_s2, fps=60.0, release_s=0.0)
    return score_track(track, video_task("BouncingBall-rubber"))


def test_a_law_that_is_met_ranks_before_trials_and_a_still_picture_last(tmp_path):
    task = video_task("BouncingBall-rubber")
    shares = [law_share(fall(a), task) for a in (9.81, 0.5 * 9.81, 2.0 * 9.81, 0.0)]
    # In whole pixels the release of the slow fall is a frame later, by 5 % of its acceleration.
    assert shares == pytest.approx([1.0, 0.5, 0.5, 0.0], abs=0.03)
    refused = replace(fall(9.81), is_sound=False)
    assert law_share(refused, task) == law_share(None, task) == 0.0
    clips = {tmp_path / str(seed): fall(9.81) for seed in range(SEEDS)}
    table = ranking({("one", task.id): clips}, ["one"])
    rows = {row["model"]: row for row in table.rows}
    assert list(rows) == ["real trials", "one", "still picture"]
    # One of nine tasks was filmed.
    assert rows["one"]["law"] == pytest.approx(1.0 / 9.0, abs=1e-3)
    assert rows["one"]["refused"] == rows["one"]["spread"] == 0.0
