"""Phenomena of real objects in GAUGE's experiments, each with a number, its scatter and its source."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gauge_envs.tools.sanity.phenomena.base import Phenomenon
    from gauge_envs.tools.sanity.robot.foot import FootGeometry

_TABLES = tomllib.loads(
    (Path(__file__).parent / "phenomena.toml").read_text(encoding="utf-8")
)

RIGID: Mapping[str, Sequence[str]] = _TABLES["rigid"]
"""Module, function and argument of the phenomena of rigid bodies by id, in their order."""

GRASP: Mapping[str, Sequence[str]] = _TABLES["grasp"]
"""The same for grasps; checked where a model has a hand, or by name."""

SLOW: Mapping[str, Sequence[str]] = _TABLES["slow"]
"""The same for checks that take longer, of a wall and deformable bodies; checked by name alone."""


@cache
def phenomenon(name: str, foot: FootGeometry | None = None) -> Phenomenon:
    """Return a phenomenon by its id.

    Args:
        name: The id.
        foot: Foot of the target, for checks that need one; the foot of a small quadruped if None.
    """
    module, function, *arguments = {**RIGID, **GRASP, **SLOW}[name]
    make = getattr(import_module(f"{__name__}.{module}"), function)
    feet = () if foot is None else (foot,)
    made: Phenomenon = make(*arguments, *feet)
    return replace(made, id=name, needs_foot=module == "foot")


def phenomena(*, include_deformables: bool = False) -> tuple[Phenomenon, ...]:
    """Return all phenomena of rigid bodies, and with `include_deformables` of grasps, a wall and deformables."""
    more = (*GRASP, *SLOW) if include_deformables else ()
    return tuple(map(phenomenon, (*RIGID, *more)))
