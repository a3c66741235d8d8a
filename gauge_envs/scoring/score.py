"""The score of an episode: how far its motion is from the reference, and why."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from textwrap import indent, wrap
from typing import Any, ClassVar

from gauge_envs.references.kind import Kind
from gauge_envs.references.metrics import METRICS
from gauge_envs.scoring.answers import Answer, DistanceCause
from gauge_envs.scoring.estimates import ComparedQuantity

FROM_SOLUTION = "solution_distance"
"""Value of `Score.primary` for a solution."""

EVENT_WORDS = {
    "lsd": "longest rest",
    "mte": "momentum transfer",
    "pd": "period",
    "el": "energy loss",
}
"""Words for the events of the paper, by name."""

MAX_LINE = 112
"""Longest line of numbers in `repr` [characters]."""

Interval = tuple[float, float]


@dataclass(frozen=True, kw_only=True, repr=False)
class Score:
    """Distances of an episode from its references, and what they mean. A field is None if it does not apply.

    | field | unit | meaning |
    | --- | --- | --- |
    | `kind` | | a `Kind`, as `trials`, `published` or `analytic`: what the reference motion is |
    | `unit` | | unit of g(t) |
    | `distance_unit` | | unit of `distance`: mm for solutions of cloth and foam, whose markers are compared |
    | `solves` | | whether the motion solves the scene: `yes`, `no`, `cannot tell`; None without a solution |
    | `like_reality` | | whether motion and events are like real ones; None if nothing real is known |
    | `solution_distance` | `distance_unit` | distance from the solution, or from the exact motion of a scene |
    | `solution_motion` | `distance_unit` | root mean square displacement of that solution |
    | `primary_interval` | 1 | 95 % interval of the primary distance over that of real trials, or over the motion |
    | `exact` | 1 | the primary ratio of the exact motion with the same constants, at the same times |
    | `cause` | | `none`, `constants`, `engine` or `both` (`DistanceCause`): what causes the distance from real trials |
    | `rmse` | unit | E_RMSE of the paper |
    | `rmse_normalized` | 1 | `rmse` over the published mean of real trials |
    | `dtw`, `dtw_normalized` | unit, 1 | E_DTW of the paper, and over the published mean of real trials |
    | `time_offset_s` | s | time shift with the smallest RMSE; positive if the real object is released later |
    | `rmse_aligned` | unit | RMSE after that shift |
    | `rmse_aligned_normalized` | 1 | `rmse_aligned` over the mean of the same distance of real trials |
    | `real_limit` | unit | primary distance within which one more real trial lies with a probability of 95 % |
    | `compared_frames` | | frames at which `distance` compares: those with known markers for cloth and foam |
    | `events` | each | `lsd`, `mte`, `pd`, `el` and recorded events, by name (`ComparedQuantity`) |
    | `estimates` | each | friction, restitution, ringing of this motion and of real trials (`ComparedQuantity`) |
    | `refused` | | why the reference cannot score this motion, one sentence |
    """

    PRINTED: ClassVar[tuple[str, ...]] = ("primary", "distance", "primary_normalized")
    """Properties that `to_dict` adds to the fields."""

    kind: str
    unit: str
    distance_unit: str = ""
    solves: Answer | None = None
    like_reality: Answer | None = None
    solution_distance: float | None = None
    solution_motion: float | None = None
    primary_interval: Interval | None = None
    exact: float | None = None
    cause: DistanceCause | None = None
    rmse: float | None = None
    rmse_normalized: float | None = None
    dtw: float | None = None
    dtw_normalized: float | None = None
    time_offset_s: float | None = None
    rmse_aligned: float | None = None
    rmse_aligned_normalized: float | None = None
    real_limit: float | None = None
    compared_frames: int | None = None
    events: Mapping[str, ComparedQuantity] = field(default_factory=dict, hash=False)
    estimates: Mapping[str, ComparedQuantity] = field(default_factory=dict, hash=False)
    refused: str | None = None

    @property
    def primary(self) -> str | None:
        """Distance that reports show first: `rmse`, `rmse_aligned` or `solution_distance`."""
        if Kind(self.kind).is_solution:
            return FROM_SOLUTION
        if self.rmse_aligned is not None:
            return "rmse_aligned"
        return None if self.rmse is None else "rmse"

    @property
    def distance(self) -> float | None:
        """The primary distance in `distance_unit`; None without one."""
        value: float | None = getattr(self, self.primary) if self.primary else None
        return value

    @property
    def primary_normalized(self) -> float | None:
        """The primary distance over that of real trials, or over the motion of a solution."""
        if self.primary is None:
            return None
        if self.primary != FROM_SOLUTION:
            value: float | None = getattr(self, f"{self.primary}_normalized")
            return value
        if self.solution_distance is None or not self.solution_motion:
            return None
        return self.solution_distance / self.solution_motion

    def summary(self) -> str:
        """Return both answers in one sentence, with the numbers that they follow from."""
        text = f"{self._solution_text}; {self._reality_text}"
        if self.refused is not None:
            text = f"no distance, because {self.refused}"
            if self.like_reality is not None:
                text += f"; {self._reality_text}"
        return f"{text[0].upper()}{text[1:]}."

    @property
    def _solution_text(self) -> str:
        """The first answer, as `solves the scene (0.034 mm of 27)`."""
        words = {
            Answer.YES: "solves the scene",
            Answer.NO: "does not solve the scene",
            Answer.CANNOT_TELL: "cannot tell whether it solves the scene",
        }
        if self.solves is None or self.solution_distance is None:
            return "no solution of the scene is known"
        distance, motion = _text(self.solution_distance), _text(self.solution_motion)
        return f"{words[self.solves]} ({distance} {self.distance_unit} of {motion})"

    @property
    def _reality_text(self) -> str:
        """The second answer, as `unlike reality: 3.33 mm, 4.95 times as far as real trials`."""
        words = {
            Answer.YES: "like reality",
            Answer.NO: "unlike reality",
            Answer.CANNOT_TELL: "cannot tell whether it is like reality",
            None: "nothing real to compare with",
        }
        parts = []
        if self.primary != FROM_SOLUTION and self.distance is not None:
            parts.append(f"{_text(self.distance)} {self.distance_unit}")
            if self.primary_normalized is not None:
                parts.append(self._scaled_text(self.primary_normalized))
        parts += self._measured_texts[:2]
        return ": ".join(filter(None, (words[self.like_reality], ", ".join(parts))))

    @property
    def _measured_texts(self) -> list[str]:
        """Events and estimates, each with its real value."""
        measured = {**self.events, **self.estimates}
        return [_compared_text(name, quantity) for name, quantity in measured.items()]

    def _scaled_text(self, ratio: float) -> str:
        """Return the distance over that of real trials in words."""
        owner = "published trials" if self.kind == Kind.PUBLISHED else "real trials"
        text = f"{_text(ratio)} times as far as {owner}"
        if self.primary_interval is not None:
            low, high = (_text(end) for end in self.primary_interval)
            text += f" [{low}, {high}]"
        if self.exact is not None:
            text += f", an exact solver {_text(self.exact)}"
        return text

    def __repr__(self) -> str:
        """Return at most ten lines; `to_dict` has all numbers."""
        left_out = ("events", "estimates", "refused")
        numbers = (
            f"{name}={_value_text(value)}"
            for name, value in vars(self).items()
            if name not in left_out and value is not None
        )
        rows = wrap(", ".join(numbers), MAX_LINE)
        lines = [self.summary(), *rows, "; ".join(self._measured_texts[:8])]
        inner = indent("\n".join(filter(None, lines)), "    ")
        return f"Score(\n{inner}\n)"

    def to_dict(self) -> dict[str, Any]:
        """Return a JSON-ready dictionary of fields and `PRINTED`, with `over_real` of each event and estimate."""
        values = {
            key: list(value) if isinstance(value, tuple) else value
            for key, value in asdict(self).items()
        }
        for key in ("events", "estimates"):
            values[key] = {
                name: asdict(measured) | {"over_real": measured.over_real}
                for name, measured in getattr(self, key).items()
            }
        for name in self.PRINTED:
            values[name] = getattr(self, name)
        return values


def _text(value: float | None) -> str:
    """Return a number with three digits."""
    if value is None:
        return "-"
    if 0.0 < abs(value) < 5e-4:
        return "0.000"
    return f"{value:.3g}" if abs(value) < 1000.0 else f"{value:.0f}"


def _value_text(value: Any) -> str:
    """Return a number with three digits, an interval, or a word."""
    if isinstance(value, tuple):
        return f"({', '.join(_text(end) for end in value)})"
    return _text(value) if isinstance(value, float) else str(value)


def _compared_text(name: str, quantity: ComparedQuantity) -> str:
    """Return a quantity with its real value, as `friction 0.273 (real 0.257 +- 0.006)`."""
    unit = "" if quantity.unit == "1" else f" {quantity.unit}"
    text = f"{EVENT_WORDS.get(name, name)} "
    if quantity.value is None:
        text += "does not happen"
    else:
        text += f"{_text(quantity.value)}{unit}"
    if quantity.real is None:
        return text
    # The published energy loss is an ideal, not a value of real trials.
    owner = "real" if name not in METRICS or METRICS[name].is_normalized else "ideal"
    real = _text(quantity.real)
    if quantity.real_uncertainty is not None:
        real += f" +- {quantity.real_uncertainty:.2g}{unit}"
    return f"{text} ({owner} {real})"
