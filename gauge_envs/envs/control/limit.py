"""Limit of a law in a control task, its uncertainty, and what a policy reached relative to it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from functools import cache
from pathlib import Path
from typing import Any

from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.files import MOST_TOML_BYTES, data_folder, read_regular, toml_document
from gauge_envs.scene import Scene


class Ending(StrEnum):
    """How an episode of a control task ended."""

    HELD = "held"
    """The last frame is reached and the cube has not slipped."""
    SLIPPED = "slipped"
    """The cube moved on its carrier."""
    REACHED = "reached"
    """The ball was at its height, or the cube came to rest at its goal."""
    MISSED = "missed"
    """The last frame is reached, and the ball or the cube has not been where it should."""
    LOST = "lost"
    """The ball or the cube can no longer get where it should."""
    DIVERGED = "diverged"
    """The simulation diverged."""


@dataclass(frozen=True, kw_only=True)
class Limit:
    """The best that a law allows.

    Attributes:
        quantity: The limited quantity, in words.
        unit: Its unit; `1` for a ratio.
        value: The limit, with the constants of the scene.
        sigma: Its standard uncertainty, from that of the measured constants.
        law: The law, in words and symbols.
        sigma_source: Source of the uncertainty.
    """

    quantity: str
    unit: str
    value: float
    sigma: float
    law: str
    sigma_source: str


@dataclass(frozen=True, kw_only=True)
class LimitReport:
    """What a policy reached in an episode, and what the law allows.

    Attributes:
        limit: The best that the law allows.
        reached: What the policy reached, in the limit's unit; 0 if the episode failed.
        ending: How the episode ended.
        time_s: Time of the ending [s].
    """

    limit: Limit
    reached: float
    ending: Ending
    time_s: float

    @property
    def ratio(self) -> float:
        """Reached over the limit; above 1 the policy exploits an error of the simulator."""
        return self.reached / self.limit.value

    @property
    def z(self) -> float:
        """Reached minus the limit, in standard uncertainties of the limit."""
        return (self.reached - self.limit.value) / self.limit.sigma


SLOPE_TRIALS = "slope_slider_30deg_summary.toml"
"""Mean and scatter of the friction of cubes sliding down at 30 degrees, from 19 or 20 real trials of each material."""

SLOPE_TRIALS_OF = "SlopeSlider-2-{material}"
"""Experiment of those trials."""


@cache
def _slope_trials(path: Path) -> dict[str, Any]:
    return toml_document(read_regular(path, MOST_TOML_BYTES))


def pair_friction(scene: Scene, first: str, second: str) -> float:
    """Return the friction coefficient of two bodies of a scene that touch."""
    return next(c.friction for c in scene.contacts if {first, second} <= {*c.first, *c.second})


def friction_uncertainty(material: str) -> float:
    """Return the relative standard uncertainty of a cube's calibrated friction.

    It is the root mean square distance of the friction in single real trials from the calibrated coefficient, over that
    coefficient. The trials are those of SlopeSlider-2, whose accelerations are bundled. The distance includes the
    scatter of trials and the difference of their mean, which is the larger part for wood and plastic.

    Args:
        material: Material of the cube: `wood`, `plastic` or `metal`.
    """
    trials = _slope_trials(data_folder("scoring") / "facts" / SLOPE_TRIALS)[material]
    calibrated = pair_friction(load_experiment(SLOPE_TRIALS_OF.format(material=material)).scene, "cube", "board")
    count, scatter = trials["trial_count"], trials["friction"]["std"]
    variance = scatter**2 * (count - 1) / count + (trials["friction"]["mean"] - calibrated) ** 2
    return math.sqrt(variance) / calibrated
