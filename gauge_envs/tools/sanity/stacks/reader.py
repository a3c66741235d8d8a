"""Define a reader: one kind of target, how it is recognized, and how its configuration is read."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

from gauge_envs.errors import TargetError
from gauge_envs.tools.sanity.model import TrainingConfiguration

GeomPair: TypeAlias = tuple[str, str]
"""Names of two geoms of a model."""


class NotATargetError(TargetError):
    """No reader knows the target; the message is completed with what can be given."""


@dataclass(frozen=True)
class Reader:
    """One kind of target.

    Attributes:
        accepts: What a user gives, with an example, for messages: `a model file (.xml, .mjcf, .urdf)`.
        matches: Function that returns whether a target is of this kind, without side effects. It may look into a file,
            and must not raise an error.
        read: Function that returns the configuration of a target of this kind. When `has_geoms`, it also gets a pair of
            geoms, or None. It raises `TargetError` for what it cannot read.
        has_geoms: Whether a target of this kind may have geoms from which a user chooses a pair.
    """

    accepts: str
    matches: Callable[[Any], bool]
    read: Callable[..., TrainingConfiguration]
    has_geoms: bool = True


def named_content(target: Any, suffixes: tuple[str, ...]) -> bytes:
    """Return the content of the file that a target names; empty where it names no readable file with such a suffix."""
    with suppress(OSError):
        if has_suffix(*suffixes)(target):
            return Path(target).read_bytes()
    return b""


def has_suffix(*suffixes: str) -> Callable[[Any], bool]:
    """Return a function that returns whether a target is the name of a file with one of some suffixes."""
    return lambda target: (
        isinstance(target, str | Path) and Path(target).suffix.lower() in suffixes
    )
