"""Engine of a sanity check: a backend in this process, or one in another process that may crash, exit or hang."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import TracebackType
from typing import Any, Self, TypeVar, cast

from gauge_envs.backends import Backend, backend, backend_names
from gauge_envs.backends.registry import is_bundled, versions_of
from gauge_envs.errors import GaugeError
from gauge_envs.runs.isolation import CrashError, Worker
from gauge_envs.runs.rollout import DeclinedError, DivergedError, Rollout
from gauge_envs.tools.sanity.scenario import Scenario, run_scenario, settings_in_force

SIMULATION_LIMIT_S = 600.0
"""Default time limit of a simulation in another process [s]."""


def simulation_limit_s(time_limit_s: float | None) -> float:
    """Return the time limit of one simulation in another process [s], from that of a whole check.

    A limit of less than a second would leave no time to start the process.
    """
    return SIMULATION_LIMIT_S if time_limit_s is None else min(max(time_limit_s, 1.0), SIMULATION_LIMIT_S)


Value = TypeVar("Value")
_Run = Callable[[Backend, Scenario, Mapping[str, Any]], Value]


class EngineDiedError(DivergedError):
    """The process of an engine died, or exceeded its time limit."""


class Engine:
    """A backend that runs scenarios. An installed backend of another package runs in another process.

    Args:
        engine: The backend, or the name of an installed one.
        time_limit_s: Time limit of a simulation in another process [s].
    """

    _backend: Backend | None

    def __init__(self, engine: Backend | str, time_limit_s: float = SIMULATION_LIMIT_S) -> None:
        self._worker = Worker(time_limit_s)
        if isinstance(engine, str) and engine in backend_names() and not is_bundled(engine):
            self.name, self._backend = engine, None
            try:
                self.versions = self._worker.call(versions_of, engine)
            except CrashError as error:
                raise CrashError(f"backend {engine!r} cannot be imported: {error}") from None
            return
        self._backend = backend(engine) if isinstance(engine, str) else engine
        self.name, self.versions = self._backend.name, self._backend.versions()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._worker.close()

    def settings_in_force(self, scenario: Scenario, settings: Mapping[str, Any]) -> dict[str, Any]:
        """Return every numerical setting that a scenario would run with."""
        try:
            return self._call(settings_in_force, scenario, settings)
        except EngineDiedError as error:
            raise DeclinedError((str(error),)) from None

    def run(self, scenario: Scenario, settings: Mapping[str, Any]) -> Rollout:
        """Run a scenario and return its rollout."""
        return self._call(run_scenario, scenario, settings)

    def _call(self, function: _Run[Value], scenario: Scenario, settings: Mapping[str, Any]) -> Value:
        if self._backend is not None:
            return function(self._backend, scenario, settings)
        try:
            value, missing, divergence = self._worker.call(_there, function, self.name, scenario, settings)
        except GaugeError as error:
            raise EngineDiedError(str(error)) from None
        if missing is not None:
            raise DeclinedError(missing)
        if divergence is not None:
            raise DivergedError(divergence)
        return cast(Value, value)


def _there(
    function: _Run[Value], name: str, scenario: Scenario, settings: Mapping[str, Any]
) -> tuple[Value | None, tuple[str, ...] | None, str | None]:
    """Return the value of a function of a backend and a scenario, or why it declined or diverged."""
    try:
        return function(backend(name), scenario, settings), None, None
    except DeclinedError as error:
        return None, error.missing, None
    except DivergedError as error:
        return None, None, str(error)
