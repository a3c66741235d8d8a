"""Checks of what an engine of another package returns: the first wrong value is an error that names engine and call.

Values that are not finite are errors at the start of a scene. Later they pass, as environments count such an episode as
diverged.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import wraps
from typing import Any

import numpy as np

from gauge_envs.backends.base import Backend
from gauge_envs.backends.settings import settings_record
from gauge_envs.backends.world import Simulation
from gauge_envs.backends.worlds import Worlds
from gauge_envs.errors import BackendError, GaugeError

UNIT_NORM = 1e-3
"""Largest deviation of a quaternion's norm from 1."""

MOVES = ("advance", "restore")
"""Methods after which the state is no longer that of the start."""

ACTIONS = ("drive", "apply_wrench")
"""Other methods that return nothing."""


def with_checks(engine: Backend) -> Backend:
    """Return an engine whose simulations and worlds check what they return.

    Raises:
        BackendError: At a call that fails, or returns something else than the contract states.
    """
    methods: dict[str, type] = {"build": Simulation, "build_file": Simulation}
    if type(engine).build_worlds is not Backend.build_worlds:
        methods["build_worlds"] = Worlds
    for method, kind in methods.items():
        _replace(engine, method, engine.name, lambda built, *_, k=kind: _built(built, k, engine.name))  # fmt: skip
    return engine


Check = Callable[..., Any]
"""Function that returns what a method returned with its arguments, or raises ValueError."""


def _built(built: Any, kind: type, name: str) -> Any:
    """Return a simulation or worlds that check what they return."""
    if not isinstance(built, kind):
        raise ValueError(f"a {type(built).__name__}, expected a {kind.__name__}")
    if kind is Simulation:
        _check_settings(name, built)
    is_at_start = True

    def started(found: Any, *_: Any) -> Any:
        nonlocal is_at_start
        is_at_start = True
        return found

    def moved(found: Any, *_: Any) -> Any:
        nonlocal is_at_start
        is_at_start = False
        return found

    def states(found: Any, names: Sequence[str], *_: Any) -> Any:
        return _states(found, names, is_start=is_at_start)

    checks: dict[str, Check] = {
        "reset": started,
        **dict.fromkeys(MOVES, moved),
        **dict.fromkeys(ACTIONS, lambda found, *_: found),
        "body_states": states,
    }
    if kind is Simulation:
        checks |= {
            "nodes": lambda found, *_: _numbers(found, (None, 3)),
            "sample_positions": lambda *all_: moved(_positions(*all_)),
            "fault": _fault,
        }
    for method, check in checks.items():
        if hasattr(built, method):
            _replace(built, method, name, check)
    return built


def _check_settings(name: str, built: Any) -> None:
    """Raise an error for settings that a result cannot record."""
    settings = getattr(built, "settings", None)
    if not isinstance(settings, Mapping):
        raise ValueError(
            f"a simulation whose settings are a {type(settings).__name__}, expected a mapping"
        )
    settings_record(name, settings)


def _replace(owner: Any, method: str, name: str, check: Check) -> None:
    """Replace a method by one that names the engine in errors, and checks what it returns.

    Args:
        owner: Engine, simulation or worlds.
        method: Name of the method.
        name: Name of the engine.
        check: Its check.
    """
    call = getattr(owner, method)

    @wraps(call)
    def checked(*arguments: Any, **named: Any) -> Any:
        try:
            found = call(*arguments, **named)
        except GaugeError:
            raise
        except Exception as error:
            if method == "nodes" and isinstance(error, KeyError):
                raise  # It has no such body.
            reason = f"{type(error).__name__}: {error}"
            raise BackendError(f"backend {name!r}: {method} raised an error: {reason}") from error  # fmt: skip
        try:
            return check(found, *arguments)
        except ValueError as error:
            raise BackendError(f"backend {name!r}: {method} returned {error}") from None

    setattr(owner, method, checked)


def _numbers(found: Any, shape: tuple[int | None, ...]) -> Any:
    """Return an array of real numbers whose last lengths are those of a shape, where None is any."""
    if type(found) is not np.ndarray:
        raise ValueError(f"a {type(found).__name__}, expected an array")
    ends = found.shape[-len(shape) :]
    fits = len(ends) == len(shape) and all(
        wanted in (None, length) for wanted, length in zip(shape, ends, strict=True)
    )
    if not fits:
        text = ", ".join("n" if one is None else str(one) for one in shape)
        raise ValueError(f"shape {list(found.shape)}, expected [{text}]")
    if found.dtype.kind != "f":
        first = found.flat[0].item() if found.dtype != object else found.flat[0]
        raise ValueError(f"{found.dtype} values, as {first!r}, expected float64")
    return found


def _states(found: Any, names: Sequence[str], *, is_start: bool) -> Any:
    """Return states of bodies, shape [..., body_count, 13]."""
    states = _numbers(found, (len(names), 13))
    if is_start and not np.isfinite(states).all():
        place = tuple(np.argwhere(~np.isfinite(states))[0])
        raise ValueError(
            f"{states[place]} in column {place[-1]} for {names[place[-2]]!r} at the start, expected a finite number"
        )
    norms = np.linalg.norm(states[..., 3:7], axis=-1)
    is_finite = np.isfinite(states[..., 3:7]).all(axis=-1)
    wrong = is_finite & ~(np.abs(norms - 1.0) <= UNIT_NORM)
    if wrong.any():
        place = tuple(np.argwhere(wrong)[0])
        quaternion = states[place][3:7].round(6).tolist()
        raise ValueError(
            f"the quaternion {quaternion} for {names[place[-1]]!r}, whose norm is {norms[place]:.6g}, expected 1"
        )
    return states


def _positions(found: Any, names: Any, count: int, *_: Any) -> Any:
    """Return positions of bodies at several times, shape [count, body_count, 3]."""
    return _numbers(found, (count, len(names), 3))


def _fault(found: Any) -> str | None:
    """Return why an engine gave up, or None."""
    if found is not None and not isinstance(found, str):
        raise ValueError(f"{found!r}, expected a text or None")
    return found
