"""Errors and warnings of gauge-envs. Each message gives the fault, its place, and the fix."""

from __future__ import annotations

import json
from collections.abc import Iterable
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from typing import Self
from urllib.parse import urlsplit
from urllib.request import url2pathname

from gauge_envs.names import nearest


class GaugeError(Exception):
    """Base of all errors of gauge-envs; the command line prints them without a traceback."""

    @classmethod
    def in_file(cls, file: Path | str, place: str | int | None, reason: str) -> Self:
        """Return the error of a file; see `FileError` for the arguments."""
        where = f"line {place}" if isinstance(place, int) else place
        return cls(": ".join(part for part in (str(file), where, reason) if part))


class ShapeError(GaugeError, ValueError):
    """Arrays have wrong shapes or values."""


class NoRewardWarning(UserWarning):
    """An environment has no reward at some or all frames, or no score, because its reference does not cover it."""


class ActionError(GaugeError, ValueError):
    """An action has the wrong shape, is outside its space, or is not a number."""


class FileError(GaugeError, ValueError):
    """A file is wrong.

    Args:
        file: The file.
        place: Place in the file: a dotted key, a prim path, the name of a body, or the number of a line; empty or None
            for the whole file.
        reason: The fault and the fix.
    """

    def __init__(self, file: Path | str, place: str | int | None, reason: str) -> None:
        super().__init__(str(GaugeError.in_file(file, place, reason)))
        self.file = Path(file)
        self.place = place
        self.reason = reason

    @classmethod
    def in_file(cls, file: Path | str, place: str | int | None, reason: str) -> Self:
        """Return the error of a file."""
        return cls(file, place, reason)


class AssetError(FileError):
    """A USD layer or an MJCF file cannot be used."""


class BackendError(GaugeError, RuntimeError):
    """A backend cannot be loaded, or violates the contract of backends."""


class DatasetError(GaugeError, OSError):
    """Files of the benchmark cannot be downloaded, read or stored: real trials, or inputs of the world-model track."""


class EpisodeError(GaugeError, RuntimeError):
    """Calls of an environment are out of order, such as a step before reset or after the end of an episode."""


class ParameterError(GaugeError, ValueError):
    """The value of an argument does not exist or is impossible."""


class RenderError(GaugeError, RuntimeError):
    """A picture cannot be rendered; usually an OpenGL library is missing."""


class UnsupportedSceneError(GaugeError, RuntimeError):
    """A backend cannot simulate a scene; the message lists unsupported features."""


SOURCE = "./gauge-envs"
"""What pip installs this package from where its origin is unknown: a clone; once an index has it, its name."""


class MissingExtraError(GaugeError, ImportError):
    """An optional dependency is missing; the message has the pip command that installs it.

    Args:
        feature: Feature that needs it, as `backend 'newton'`.
        extra: Extra that installs it.
        cause: Failed import.
        package: Package that defines the extra.
    """

    def __init__(
        self,
        feature: str,
        extra: str,
        cause: ImportError,
        *,
        package: str = "gauge-envs",
    ) -> None:
        super().__init__(
            f"{feature} needs {cause.name or cause}, which is not installed: {install_command(package, extra)}"
        )


def install_command(package: str, extra: str) -> str:
    """Return the command that installs an extra of a package, from the folder or file that it was installed from.

    `direct_url.json` names that place (PEP 610). Without one, it is `SOURCE`, or the name of another package.
    """
    try:
        origin = json.loads(distribution(package).read_text("direct_url.json") or "{}")
    except (PackageNotFoundError, ValueError):
        origin = {}
    source = urlsplit(origin.get("url", ""))
    place = Path(url2pathname(source.path))
    if source.scheme != "file" or not place.exists():
        name = SOURCE if package == "gauge-envs" else package
        return f"pip install '{name}[{extra}]'"
    command = "pip install"
    if origin.get("dir_info", {}).get("editable", False):
        command += " -e"
    return f"{command} '{place}[{extra}]'"


class TargetError(GaugeError, ValueError):
    """The target of a sanity check cannot be read; the message lists possible targets."""


class TaskFileError(FileError):
    """A task file is wrong."""


class SweepFileError(FileError):
    """A sweep file is wrong."""


class ResultFileError(GaugeError, OSError):
    """A result file or folder cannot be written or read back."""


class TrajectoryFileError(GaugeError, ValueError):
    """A trajectory file of a user cannot be scored; the message gives the place and the expected content."""


class VideoError(GaugeError, ValueError):
    """A video or a track cannot be scored; the message gives the expected content."""


class UnknownNameError(GaugeError, LookupError):
    """A name is unknown; the message has the nearest known names.

    Args:
        kind: Kind of the name, as `variant`.
        name: The unknown name.
        known: All known names.
        hint: Text in place of the nearest names; empty for those.
    """

    def __init__(
        self, kind: str, name: str, known: Iterable[str], hint: str = ""
    ) -> None:
        super().__init__(f"unknown {kind} {name!r}; {hint or nearest(name, known)}")
        self.name = name


class ReferenceFileError(FileError):
    """A file of reference data is damaged: a band, published baselines, laws or an import."""
