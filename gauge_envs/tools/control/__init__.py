"""Control tasks with a true optimum from a law: a policy that earns more exploits an error of the simulator."""

from typing import TYPE_CHECKING

from gauge_envs.registry import lazy_names

if TYPE_CHECKING:
    from gauge_envs.tools.control.env import (
        ControlEnv as ControlEnv,
        ControlVectorEnv as ControlVectorEnv,
        Policy as Policy,
        play_paid as play_paid,
    )
    from gauge_envs.tools.control.ids import (
        document as document,
        names as names,
        summary as summary,
    )
    from gauge_envs.tools.control.task import LimitReport as LimitReport
    from gauge_envs.tools.control.trained import stored_policy as stored_policy
else:
    __getattr__, __all__ = lazy_names(
        __name__,
        {
            ".env": ["ControlEnv", "ControlVectorEnv", "Policy", "play_paid"],
            ".ids": ["document", "names", "summary"],
            ".task": ["LimitReport"],
            ".trained": ["stored_policy"],
        },
    )
