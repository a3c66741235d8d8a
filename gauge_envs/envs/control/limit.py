"""What a law allows in a control task, how well its constants are known, and what a policy reached beside it."""

from __future__ import annotations

import math
import tomllib
from dataclasses import dataclass
from enum import StrEnum
from functools import cache
from pathlib import Path

from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.files import data_folder
from gauge_envs.scene import Scene

__all__ = [
    "Ending",
    "Limit",
    "LimitReport",
    "friction_uncertainty",
    "pair_friction",
]


class Ending(StrEnum):
    """How an episode of a control task ended."""

    HELD = "held"
    """The time is over and the cube has not slipped."""
    SLIPPED = "slipped"
    """The cube moved on its carrier."""
    REACHED = "reached"
    """The ball is at the height."""
    MISSED = "missed"
    """The time is over and the ball has not been at the height."""
    DIVERGED = "diverged"
    """The simulation has."""


@dataclass(frozen=True, kw_only=True)
class Limit:
    """The best that a law allows.

    Attributes:
        quantity: What is limited, in words.
        unit: Its unit; `1` for a ratio.
        value: The law's limit, with the constants in force.
        sigma: Its standard uncertainty, from that of the measured constants.
        law: The law, in words and symbols.
        sigma_source: Where the uncertainty is from.
    """

    quantity: str
    unit: str
    value: float
    sigma: float
    law: str
    sigma_source: str


@dataclass(frozen=True, kw_only=True)
class LimitReport:
    """What a policy reached in an episode, beside what the law allows.

    Attributes:
        limit: What the law allows.
        reached: What the policy reached, in the limit's unit; 0 where nothing was achieved.
        ending: How the episode ended.
        time_s: When it ended [s].
    """

    limit: Limit
    reached: float
    ending: Ending
    time_s: float

    @property
    def ratio(self) -> float:
        """Reached over the law's limit; above 1 is reward that reality will not pay."""
        return self.reached / self.limit.value

    @property
    def z(self) -> float:
        """Reached less the limit, in standard uncertainties of the limit."""
        return (self.reached - self.limit.value) / self.limit.sigma


SLOPE_TRIALS = "slope_slider_30deg_summary.toml"
"""Mean and scatter of the friction in 19 or 20 real trials a material of the cubes sliding down at 30 degrees."""

SLOPE_TRIALS_OF = "SlopeSlider-2-{material}"
"""Experiment of those trials."""


@cache
def _slope_trials(path: Path) -> dict:
    return tomllib.loads(path.read_text(encoding="utf-8"))


def pair_friction(scene: Scene, first: str, second: str) -> float:
    """Friction coefficient of two bodies that touch, as a scene has it."""
    return next(c.friction for c in scene.contacts if {first, second} <= {*c.first, *c.second})


def friction_uncertainty(material: str) -> float:
    """Relative standard uncertainty of a cube's calibrated friction.

    It is the root mean square distance of the friction in single real trials (SlopeSlider-2, whose accelerations are
    bundled) from the calibrated coefficient, over that: it holds both the scatter of trials and the difference of
    their mean, which is the larger part for wood and plastic.

    Args:
        material: Material of the cube: `wood`, `plastic` or `metal`.
    """
    trials = _slope_trials(data_folder("scoring") / "facts" / SLOPE_TRIALS)[material]
    calibrated = pair_friction(load_experiment(SLOPE_TRIALS_OF.format(material=material)).scene, "cube", "board")
    count, scatter = trials["trial_count"], trials["friction"]["std"]
    variance = scatter**2 * (count - 1) / count + (trials["friction"]["mean"] - calibrated) ** 2
    return math.sqrt(variance) / calibrated
