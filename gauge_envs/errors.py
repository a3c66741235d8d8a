"""Errors of gauge-envs. Each message says what was wrong, where, and what would be right."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches
from pathlib import Path

__all__ = [
    "ActionError",
    "AssetError",
    "BackendError",
    "DatasetError",
    "EpisodeError",
    "GaugeError",
    "MissingExtraError",
    "ParameterError",
    "ReferenceFileError",
    "RenderError",
    "ResultFileError",
    "ShapeError",
    "TargetError",
    "TaskFileError",
    "TrajectoryFileError",
    "UnknownNameError",
    "UnsupportedSceneError",
]


class GaugeError(Exception):
    """Base of every error that gauge-envs raises on purpose; the command line prints it without a traceback."""


class ShapeError(GaugeError, ValueError):
    """Arrays that must agree in shape do not, or hold values that the function cannot use."""


class ActionError(GaugeError, ValueError):
    """An action has the wrong shape, lies outside its space, or is not a number."""


class AssetError(GaugeError, ValueError):
    """An asset cannot be used: names the file, the place in it (prim path, body or key) and the reason.

    Args:
        file: The USD, MJCF or experiment file.
        place: Prim path, name of a body, or key; empty where the file as a whole is meant.
        reason: What is wrong, and what would be right.
    """

    def __init__(self, file: Path | str, place: str, reason: str) -> None:
        super().__init__(": ".join(part for part in (str(file), place, reason) if part))
        self.file = Path(file)
        self.place = place
        self.reason = reason


class BackendError(GaugeError, RuntimeError):
    """A backend cannot be loaded, or does not keep the contract."""


class DatasetError(GaugeError, OSError):
    """The dataset of real trials cannot be downloaded, read or stored; the message names the place and the cause."""


class EpisodeError(GaugeError, RuntimeError):
    """An environment was used out of order: a step before reset, or after the episode's end."""


class ParameterError(GaugeError, ValueError):
    """A parameter set or a single override names something that the scene does not have, or an impossible value."""


class RenderError(GaugeError, RuntimeError):
    """A picture cannot be made, usually because the machine lacks an OpenGL library."""


class UnsupportedSceneError(GaugeError, RuntimeError):
    """A backend declines a scene; the message carries the backend's own reasons."""


class MissingExtraError(GaugeError, ImportError):
    """An optional dependency is missing; the message names the pip command that installs it.

    Args:
        feature: What needs it, as `backend 'newton'`.
        extra: Extra of the package that brings it.
        cause: The import that failed.
        package: Package that has the extra.
    """

    def __init__(self, feature: str, extra: str, cause: ImportError, *, package: str = "gauge-envs") -> None:
        super().__init__(
            f"{feature} needs {cause.name or cause}, which is not installed: pip install '{package}[{extra}]'"
        )


class TargetError(GaugeError, ValueError):
    """What the sanity check is asked to check cannot be read; the message names it and what can be."""


class TaskFileError(GaugeError, ValueError):
    """A task file is wrong: names the file, the key and the reason."""

    def __init__(self, file: Path | str, key: str, reason: str) -> None:
        super().__init__(f"{file}: {key}: {reason}")
        self.file = Path(file)
        self.key = key
        self.reason = reason


class ResultFileError(GaugeError, OSError):
    """A result file or folder cannot be written or read back."""


class TrajectoryFileError(GaugeError, ValueError):
    """A trajectory file brought by a user cannot be scored: names file, place and what was expected."""


class UnknownNameError(GaugeError, LookupError):
    """A name is not one of the known ones; the message offers the nearest."""

    def __init__(self, kind: str, name: str, known: Iterable[str]) -> None:
        names = sorted(known)
        near = [n for n in names if n.startswith(name)][:6] or get_close_matches(name, names, n=3, cutoff=0.5)
        more = f" and {len(names) - 12} more" if len(names) > 12 else ""
        hint = f"did you mean {', '.join(near)}?" if near else f"known: {', '.join(names[:12]) or 'none'}{more}"
        super().__init__(f"unknown {kind} {name!r}; {hint}")
        self.name = name


class ReferenceFileError(GaugeError, ValueError):
    """A data file in `scoring/` is damaged: names the file, the line where there is one, and the reason."""

    def __init__(self, file: Path, line: int | None, reason: str) -> None:
        super().__init__(f"{file}: {reason}" if line is None else f"{file}: line {line}: {reason}")
        self.file = file
        self.line = line
        self.reason = reason
