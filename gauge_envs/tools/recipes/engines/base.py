"""What an engine adds to a recipe: its contact settings, their first proposal, and a snippet to paste."""

import re
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from typing import Annotated, Any, ClassVar, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from gauge_envs.backends.base import Backend
from gauge_envs.backends.registry import backend
from gauge_envs.errors import ParameterError, first_fault
from gauge_envs.tools.recipes.aim import Aim

NAME = re.compile(r"(\w+)\s*=")
"""A name before an equals sign."""

VALUE = re.compile(r"[^\s,\"'()\[\]]+")
"""A value between blanks, commas, quotes and brackets."""

NonNegative = Annotated[float, Field(ge=0.0)]


def rounded(value: Any) -> Any:
    """Return a number to six digits, which is what a snippet prints, or a tuple of such numbers."""
    if isinstance(value, tuple):
        return tuple(map(rounded, value))
    return float(f"{value:g}") if isinstance(value, float) else value


def numbers(values: Iterable[float], separator: str = " ") -> str:
    """Return numbers as a snippet prints them."""
    return separator.join(f"{value:g}" for value in values)


class ContactSettings(BaseModel, ABC):
    """Contact settings of one engine, under its own names. Defaults are those of the engine.

    A field `restitution` is a coefficient of the engine. Without one, contacts rebound by their constants.

    Attributes:
        engine: Name of the engine.
        is_soft: Whether a setting determines the depth at rest.
        restitution_range: Smallest and largest restitution that settings can aim at.
        friction_field: Field that is the coefficient of friction of the pair.
        preset: Preset of the backend on which the settings are built.
        natives: Settings of the backend, by the fields that state them.
        limits: What the engine itself limits in `restitution`, `friction` or `penetration_m`.
        timestep_s: Time step [s].
        torsion_m: Torsional friction [m].
        rolling_m: Rolling friction [m].
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    engine: ClassVar[str]
    is_soft: ClassVar[bool]
    restitution_range: ClassVar[tuple[float, float]] = (0.0, 1.0)
    friction_field: ClassVar[str] = "friction"
    preset: ClassVar[str] = "out_of_box"
    natives: ClassVar[Mapping[str, str]] = {}
    limits: ClassVar[Mapping[str, str]]

    timestep_s: float = Field(gt=0.0)
    torsion_m: NonNegative = 0.0
    rolling_m: NonNegative = 0.0

    @field_validator("*")
    @classmethod
    def _rounded(cls, value: Any, info: Any) -> Any:
        return value if info.field_name == "timestep_s" else rounded(value)

    @classmethod
    def backend(cls) -> Backend:
        """Return the backend that simulates the settings."""
        return backend(cls.engine)

    @classmethod
    def parsed(cls, text: str, timestep_s: float) -> Self:
        """Return the settings that a text gives, as `solref=0.02 1 solimp=0.9 0.95 0.001`; others are the engine's.

        Args:
            text: Names and values. Blanks or commas separate values, which may stand in quotes as in XML.
            timestep_s: Time step [s].

        Raises:
            ParameterError: The text has another form, or the engine has no such setting.
        """
        start, *parts = NAME.split(text)
        values: dict[str, Any] = {}
        for name, part in zip(parts[::2], parts[1::2], strict=True):
            found = VALUE.findall(part)
            values[name] = tuple(found) if len(found) > 1 else "".join(found)
        is_repeated = 2 * len(values) < len(parts)
        if not parts or start.strip() or is_repeated:
            raise ParameterError(
                f"{cls.engine} contact {text!r}: expected names=values, each name once, as 'friction=0.5'"
            )
        try:
            return cls.model_validate({**values, "timestep_s": timestep_s})
        except ValidationError as error:
            key, reason = first_fault(error, noun="setting")
            settings = ", ".join(cls.model_fields)
            raise ParameterError(
                f"{cls.engine} contact: {key!r}: {reason}; settings: {settings}"
            ) from None

    @classmethod
    def aimed(cls, aim: Aim) -> Self:
        """Return the settings that are to give a behaviour, by a closed form."""
        return cls.model_validate(
            {
                "timestep_s": aim.timestep_s,
                "torsion_m": aim.torsion_m or 0.0,
                "rolling_m": aim.rolling_m or 0.0,
                cls.friction_field: aim.sliding_friction,
                **cls.constants(aim),
            }
        )

    @classmethod
    @abstractmethod
    def constants(cls, aim: Aim) -> dict[str, Any]:
        """Return the other fields for a behaviour, by a closed form."""

    @abstractmethod
    def snippet(self) -> str:
        """Return the settings in the engine's own language."""

    @property
    def sliding_friction(self) -> float:
        """Coefficient of friction of the pair."""
        return float(getattr(self, self.friction_field))

    def backend_settings(self, mass_kg: float) -> dict[str, Any]:
        """Return the settings of the backend, for a body of a mass [kg]."""
        given = {setting: getattr(self, name) for name, setting in self.natives.items()}
        return {"preset": self.preset, **given}
