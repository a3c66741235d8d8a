"""Check an environment when it is made, and warn of failed checks."""

import warnings
from collections.abc import Sequence

import gymnasium

from gauge_envs.tools.sanity.report import answer_text
from gauge_envs.tools.sanity.run import check
from gauge_envs.tools.sanity.verdict import Report


class SanityWarning(UserWarning):
    """An environment does not pass all checks."""


_REPORTS: dict[str, Report] = {}
"""Reports of this process by the id of their environment, so that each is checked once."""


class SanityWrapper(gymnasium.Wrapper, gymnasium.utils.RecordConstructorArgs):
    """Check an environment once in each process, and warn with the failed checks and the best fix.

    Attributes:
        report: The report of the check.

    Example:
        >>> import gymnasium
        >>> with warnings.catch_warnings(record=True) as caught:
        ...     env = SanityWrapper(gymnasium.make("Hopper-v5"), only=["creep-wood"])
        >>> [warning.category.__name__ for warning in caught][-1:]
        ['SanityWarning']
    """

    def __init__(self, env: gymnasium.Env, only: Sequence[str] = ()) -> None:
        """Check an environment.

        Args:
            env: The environment, which has a MuJoCo model or is one of this package.
            only: Ids of checks or patterns such as `creep-*`; all when empty.

        Raises:
            TargetError: The environment has no model that can be checked.
        """
        gymnasium.utils.RecordConstructorArgs.__init__(self, only=only)
        super().__init__(env)
        key = f"{env.unwrapped if env.spec is None else env.spec.id} {','.join(only)}"
        if key not in _REPORTS:
            _REPORTS[key] = check(env, only=only)
        self.report = _REPORTS[key]
        if self.report.flags:
            names = ", ".join(self.report.flags)
            fix = self.report.fix
            advice = "" if fix is None else f"; best fix: {fix.line}"
            text = f"{answer_text(self.report)} ({names}){advice}"
            warnings.warn(text, SanityWarning, stacklevel=2)
