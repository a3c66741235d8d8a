"""A leaderboard: configurations of engines that anybody submits, and the results that its own machine computes.

    gauge leaderboard check leaderboard/ --run

A submission is one configuration of one version of an engine:

    leaderboard/<engine>/<version>/<configuration>/
        submission.toml         what is run, and by whom it was submitted
        results.tar.xz          result files, one for each experiment, written by `--run`

No number of a submitter is read. `docs/leaderboard.md` states each rule.
"""

from typing import TYPE_CHECKING

from gauge_envs.registry import door

if TYPE_CHECKING:
    from gauge_envs.tools.leaderboard.check import (
        SubmissionCheck as SubmissionCheck,
        check_leaderboard as check_leaderboard,
    )
    from gauge_envs.tools.leaderboard.submission import (
        Statement as Statement,
    )
else:
    __getattr__, __all__ = door(__name__)
