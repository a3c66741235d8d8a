"""Checks of a leaderboard: folders of result files that vendors of engines submit.

    gauge leaderboard check leaderboard/

A submission is one configuration of one version of an engine:

    leaderboard/<engine>/<version>/<configuration>/
        submission.toml         what was run, by whom, and why experiments are left out
        README.md               optional
        results.tar.xz          result files of `gauge run`, one for each experiment; or a folder `results`

No number of a submission is believed. Scores are computed anew from the trajectory in each file, and a sample of the
episodes can be run again. `docs/leaderboard.md` states each rule.
"""

from typing import TYPE_CHECKING

from gauge_envs.registry import door

if TYPE_CHECKING:
    from gauge_envs.tools.leaderboard.check import (
        LeaderboardCheck as LeaderboardCheck,
        SubmissionCheck as SubmissionCheck,
        check_leaderboard as check_leaderboard,
    )
    from gauge_envs.tools.leaderboard.reruns import Rerun as Rerun
    from gauge_envs.tools.leaderboard.submission import (
        Fault as Fault,
        Statement as Statement,
    )
    from gauge_envs.tools.leaderboard.trajectory import false_scores as false_scores
else:
    __getattr__, __all__ = door(__name__)
