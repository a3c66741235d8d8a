"""Errors and warnings of gauge-envs. Each message gives the fault, its place, and the fix."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from difflib import get_close_matches
from enum import StrEnum
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from pydantic import ValidationError

Choice = TypeVar("Choice", bound=StrEnum)


class GaugeError(Exception):
    """Base of all errors of gauge-envs; the command line prints them without a traceback."""


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
        where = f"line {place}" if isinstance(place, int) else place
        super().__init__(": ".join(part for part in (str(file), where, reason) if part))
        self.file = Path(file)
        self.place = place
        self.reason = reason


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
            f"{feature} needs {cause.name or cause}, which is not installed: pip install '{package}[{extra}]'"
        )


@contextmanager
def needs_extra(feature: str, extra: str) -> Iterator[None]:
    """Turn a failed import into an error that names the extra to install.

    Args:
        feature: Feature that needs it, as `plotting`.
        extra: Extra of this package.

    Raises:
        MissingExtraError: A package is not installed.
    """
    try:
        yield
    except MissingExtraError:
        raise
    except ImportError as error:
        raise MissingExtraError(feature, extra, error) from error


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


def nearest(name: str, known: Iterable[str]) -> str:
    """Return a sentence with the known names nearest to an unknown one, or with some known names."""
    names = sorted(known)
    matches = [n for n in names if fnmatchcase(n, name)]
    if matches:
        return f"one name is expected, as {matches[0]}, and no pattern"
    heads = {f"{n.partition('-')[0]}-*" for n in names} if "*" in name else ()
    near = (
        [n for n in names if n.casefold() == name.casefold()]
        or [n for n in names if n.startswith(name)][:6]
        or get_close_matches(name, [*names, *heads], n=3, cutoff=0.5)
    )
    return (
        f"did you mean {', '.join(near)}?" if near else f"known: {first_names(names)}"
    )


def first_names(names: Sequence[str], max_count: int = 12) -> str:
    """Return names in a line: the first ones and the number of further ones; `none` without names."""
    more = f" and {len(names) - max_count} more" if len(names) > max_count else ""
    return ", ".join(names[:max_count]) + more if names else "none"


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


def chosen(kind: type[Choice], value: str, name: str) -> Choice:
    """Return the member of a closed set for the value of an argument.

    Args:
        kind: The set.
        value: The value.
        name: Name of the argument, as `drivers`.

    Raises:
        ParameterError: The set has no such member; the message lists its members.
    """
    if value not in tuple(kind):
        raise ParameterError(
            f"{name} {value!r}: choose {' or '.join(repr(member.value) for member in kind)}"
        )
    return kind(value)


def first_fault(error: ValidationError, *, noun: str = "key") -> tuple[str, str]:
    """Return the place and the reason of the first fault in an error of pydantic.

    Args:
        error: Error of pydantic.
        noun: Noun for a field of the model, as `key` or `setting`.

    Returns:
        Dotted path of the field, as `score.metrics.0`, empty for the whole model; and the reason, with the value if it
        is short.
    """
    fault = error.errors(include_url=False)[0]
    place = ".".join(map(str, fault["loc"]))
    if fault["type"] in ("extra_forbidden", "unexpected_keyword_argument"):
        return place, f"unknown {noun}"
    if fault["type"] == "missing":
        return place, f"missing {noun}"
    if fault["type"] == "union_tag_not_found":
        return f"{place}.{fault['ctx']['discriminator'].strip(chr(39))}".lstrip(
            "."
        ), f"missing {noun}"
    value = fault["input"]
    # Python cannot print integers of thousands of digits.
    is_short = isinstance(value, float | str) or (
        isinstance(value, int) and value.bit_length() <= 200
    )
    given = repr(value) if is_short else ""
    shown = f" (given: {given})" if 0 < len(given) <= 60 else ""
    return place, fault["msg"].removeprefix("Value error, ") + shown
