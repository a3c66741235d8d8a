"""What an environment refuses: unknown arguments, copies, and calls of two threads at once."""

from __future__ import annotations

import functools
import inspect
import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NoReturn, Self, TypeVar, cast

from gauge_envs.errors import EpisodeError, GaugeError, UnknownNameError

if TYPE_CHECKING:
    from gauge_envs.envs.rollout import Rollout

Call = TypeVar("Call", bound=Callable[..., Any])


class GuardedEnv:
    """Base of the environments; an engine's memory allows neither copies nor two threads.

    Attributes:
        rollout: The current episodes.
        closed: Whether the environment is closed.

    Raises:
        UnknownNameError: There is no such argument.
    """

    rollout: Rollout
    closed: bool = False
    _name: str
    _turn: threading.RLock

    def __new__(cls, *_: Any, **arguments: Any) -> Self:
        """Check the names of the arguments."""
        parameters = inspect.signature(cls.__init__).parameters
        is_open = any(value.kind is value.VAR_KEYWORD for value in parameters.values())
        for name in arguments:
            if name not in parameters and not is_open:
                kind = f"argument of {cls.__name__}"
                raise UnknownNameError(kind, name, [*parameters][1:])
        env = super().__new__(cls)
        env._turn = threading.RLock()
        return env

    def __getstate__(self) -> NoReturn:
        """Raise an error, which `pickle` and `copy` reach.

        Raises:
            GaugeError: Always.
        """
        raise GaugeError(
            f"{type(self).__name__} cannot be copied or pickled: make it again with gymnasium.make(env.spec)"
        )

    def _check_open(self, call: str) -> None:
        if self.closed:
            raise EpisodeError(
                f"{self._name}: {call} after close; make the environment again"
            )

    def _check_started(self, call: str) -> None:
        self._check_open(call)
        if not self.rollout.has_begun:
            raise EpisodeError(f"{self._name}: call reset before {call}")


def one_thread(call: Call) -> Call:
    """Return a method that raises an `EpisodeError` while another thread is in such a method of the environment."""

    @functools.wraps(call)
    def guarded(self: GuardedEnv, *args: Any, **kwargs: Any) -> Any:
        if not self._turn.acquire(blocking=False):
            raise EpisodeError(
                f"{call.__name__}: another thread uses this environment; make one for each thread"
            )
        try:
            return call(self, *args, **kwargs)
        finally:
            self._turn.release()

    return cast("Call", guarded)
