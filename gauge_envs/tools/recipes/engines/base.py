"""What an engine adds to a recipe: its contact settings, where a search starts, and text that can be pasted."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, ClassVar, Self

from pydantic import BaseModel, ConfigDict, Field, field_validator

from gauge_envs.backends.base import Backend
from gauge_envs.backends.registry import backend
from gauge_envs.tools.recipes.aim import Aim
from gauge_envs.tools.recipes.closed_forms import ContactForm
from gauge_envs.tools.recipes.probes import Build

DIGITS = 6
"""Digits of the numbers of a recipe: those that are simulated are those that are printed."""


class ContactSettings(BaseModel, ABC):
    """Contact settings of one engine, under its own names. Defaults are those of the engine.

    Attributes:
        engine: Name of the engine.
        is_soft: Whether a setting determines the depth at rest.
        aims: Smallest and largest restitution that settings can aim at.
        also: Further names that a text may state in place of fields.
        timestep_s: Time step [s].
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    engine: ClassVar[str]
    is_soft: ClassVar[bool]
    aims: ClassVar[tuple[float, float]] = (0.0, 1.0)
    also: ClassVar[tuple[str, ...]] = ()

    timestep_s: float = Field(gt=0.0)

    @field_validator("*")
    @classmethod
    def _rounded(cls, value: Any, info: Any) -> Any:
        if info.field_name == "timestep_s":
            return value
        if isinstance(value, tuple):
            return tuple(_round(one) for one in value)
        return _round(value)

    @classmethod
    def backend(cls) -> Backend:
        """Return the backend that simulates the settings."""
        return backend(cls.engine)

    @classmethod
    def searched_on(cls) -> type[ContactSettings]:
        """Return the class on whose engine settings are sought; the found ones are measured on this engine."""
        return cls

    @classmethod
    @abstractmethod
    def aimed(cls, aim: Aim) -> Self:
        """Return the settings that are to give a behaviour, by the rule of the backend of this package."""

    @property
    @abstractmethod
    def sliding_friction(self) -> float:
        """Coefficient of friction of the pair."""

    @abstractmethod
    def build(self, mass_kg: float) -> Build:
        """Return the settings through the contract of backends, for a body of a mass [kg]."""

    @abstractmethod
    def snippet(self, mass_kg: float) -> str:
        """Return the settings in the engine's own language, for a body of a mass [kg]."""

    @classmethod
    @abstractmethod
    def limits(cls, quantity: str) -> str:
        """Return what the engine itself limits in `restitution`, `friction` or `penetration_m`; empty for nothing."""

    def other_body(self) -> tuple[str, Self] | None:
        """Return a kind of body on which the same settings rebound differently, and its settings; None for none."""
        return None

    def closed_form(self) -> ContactForm | None:
        """Return the documented closed form; None where the engine documents none."""
        return None


def _round(value: Any) -> Any:
    return float(f"{value:.{DIGITS}g}") if isinstance(value, float) else value


def numbers_text(values: tuple[float, ...]) -> str:
    """Return numbers separated by blanks."""
    return " ".join(f"{value:.{DIGITS}g}" for value in values)
