"""Coordinates over time: profiles of motors, and samples of recordings."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np

from gauge_envs.scene.geometry import NonNegative, Positive

if TYPE_CHECKING:
    from scipy.interpolate import PchipInterpolator


@dataclass(frozen=True, kw_only=True)
class TrapezoidProfile:
    """Trapezoidal speed profile of a motor: constant acceleration, constant speed, constant deceleration.

    Attributes:
        kind: Name of the profile in files.
        start_s: Time at which the motion starts [s].
        duration_s: Time from start to standstill [s].
        accelerate_s: Duration of the acceleration [s]; 0 for a start at full speed.
        brake_s: Duration of the deceleration [s].
        amount: Signed total change of the coordinate [m or rad].
    """

    kind: Literal["trapezoid"] = field(default="trapezoid", repr=False)
    start_s: float
    duration_s: Positive
    accelerate_s: NonNegative
    brake_s: NonNegative
    amount: float

    def __post_init__(self) -> None:
        if self.accelerate_s + self.brake_s > self.duration_s:
            raise ValueError(
                "accelerate_s and brake_s together are longer than duration_s"
            )

    @property
    def cruise_rate(self) -> float:
        """Signed rate between acceleration and deceleration [m/s or rad/s]."""
        return self.amount / (
            self.duration_s - 0.5 * (self.accelerate_s + self.brake_s)
        )

    @property
    def largest_rate(self) -> float:
        """Largest absolute rate [m/s or rad/s]."""
        return abs(self.cruise_rate)

    def value(self, time_s: float) -> float:
        """Return the coordinate at a time, relative to its start [m or rad]."""
        t = min(max(time_s - self.start_s, 0.0), self.duration_s)
        speed_up = min(t, self.accelerate_s)
        # Distance at the cruise rate, minus the distance lost during acceleration and deceleration.
        value = self.cruise_rate * t
        if self.accelerate_s > 0.0:
            value -= self.cruise_rate * (
                speed_up - 0.5 * speed_up**2 / self.accelerate_s
            )
        braking = max(t - (self.duration_s - self.brake_s), 0.0)
        if self.brake_s > 0.0:
            value -= 0.5 * self.cruise_rate * braking**2 / self.brake_s
        return value

    def rate(self, time_s: float) -> float:
        """Return the rate at a time [m/s or rad/s]."""
        t = time_s - self.start_s
        if not 0.0 <= t < self.duration_s:
            return 0.0
        if t < self.accelerate_s:
            return self.cruise_rate * t / self.accelerate_s
        left = self.duration_s - t
        return self.cruise_rate * (left / self.brake_s if left < self.brake_s else 1.0)


@dataclass(frozen=True, kw_only=True)
class CosineProfile:
    """Change by `amount` along half a cosine period, from rest to rest."""

    kind: Literal["cosine"] = field(default="cosine", repr=False)
    start_s: float
    duration_s: Positive
    amount: float

    @property
    def largest_rate(self) -> float:
        """Largest absolute rate [m/s or rad/s]."""
        return 0.5 * np.pi * abs(self.amount) / self.duration_s

    def _angle_rad(self, time_s: float) -> float:
        """Return the phase at a time, from 0 to pi."""
        return np.pi * min(max((time_s - self.start_s) / self.duration_s, 0.0), 1.0)

    def value(self, time_s: float) -> float:
        """Return the coordinate at a time, relative to its start [m or rad]."""
        return 0.5 * self.amount * (1.0 - float(np.cos(self._angle_rad(time_s))))

    def rate(self, time_s: float) -> float:
        """Return the rate at a time [m/s or rad/s]."""
        largest = 0.5 * np.pi * self.amount / self.duration_s
        return largest * float(np.sin(self._angle_rad(time_s)))


@dataclass(frozen=True, kw_only=True)
class SampledProfile:
    """Sampled coordinate with monotone cubic interpolation (no overshoot), constant before and after the samples.

    Attributes:
        kind: Name of the profile in files.
        times_s: Strictly increasing times [s], shape [sample_count].
        values: Coordinate relative to the start pose [m or rad], same shape.
    """

    kind: Literal["sampled"] = field(default="sampled", repr=False)
    times_s: tuple[float, ...]
    values: tuple[float, ...]

    def __post_init__(self) -> None:
        if len(self.times_s) < 2:
            raise ValueError(
                f"times_s has {len(self.times_s)} entries; at least 2 are needed"
            )
        if len(self.values) != len(self.times_s):
            raise ValueError(f"{len(self.times_s)} times but {len(self.values)} values")
        is_late = np.diff(self.times_s) > 0.0
        if not is_late.all():
            before = int(is_late.argmin())
            raise ValueError(
                f"driver time is not increasing: times_s[{before + 1}] = {self.times_s[before + 1]} "
                f"after {self.times_s[before]}"
            )

    @cached_property
    def _curve(self) -> PchipInterpolator:
        # The import takes 0.1 s, and lists of experiments do not need it.
        from scipy.interpolate import PchipInterpolator

        return PchipInterpolator(self.times_s, self.values)

    @cached_property
    def _slope(self) -> PchipInterpolator:
        return self._curve.derivative()

    @property
    def largest_rate(self) -> float:
        """Largest absolute rate [m/s or rad/s]."""
        # The slope of a cubic piece is extreme at its ends or at a root of its derivative. Flat pieces give NaN.
        inside = self._slope.derivative().roots(extrapolate=False)
        return float(
            np.abs(
                self._slope(np.concatenate([self.times_s, inside[np.isfinite(inside)]]))
            ).max()
        )

    def value(self, time_s: float) -> float:
        """Return the coordinate at a time, relative to the start pose [m or rad]."""
        return float(self._curve(min(max(time_s, self.times_s[0]), self.times_s[-1])))

    def rate(self, time_s: float) -> float:
        """Return the rate at a time [m/s or rad/s]; 0 before the first and after the last sample."""
        if not self.times_s[0] <= time_s < self.times_s[-1]:
            return 0.0
        return float(self._slope(time_s))


class _ByKind:
    """Metadata of a union whose `kind` selects the member; this module does not import pydantic at its top."""

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        from pydantic import Field

        return handler.generate_schema(Annotated[source, Field(discriminator="kind")])


Profile = Annotated[TrapezoidProfile | CosineProfile | SampledProfile, _ByKind()]
"""Profile of a coordinate over time."""
