"""Base class of contact settings: parse, propose, simulate, and print as a snippet."""

import re
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from typing import Annotated, Any, ClassVar, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from gauge_envs.backends.base import Backend
from gauge_envs.backends.registry import backend
from gauge_envs.errors import ParameterError
from gauge_envs.tools.recipes.aim import Aim
from gauge_envs.validation import first_fault

PAIR = re.compile(r"\s*(\w+)\s*=((?:(?!\w+\s*=).)*)", re.DOTALL)
"""Name before an equals sign, and the text until the next name."""

VALUE = re.compile(r"[^\s,\"'()\[\]]+")
"""Value between blanks, commas, quotes and brackets."""

NonNegative = Annotated[float, Field(ge=0.0)]


def rounded(value: Any) -> Any:
    """Return a number, or a tuple of numbers, rounded to the six digits of a snippet."""
    if isinstance(value, tuple):
        return tuple(map(rounded, value))
    return float(f"{value:g}") if isinstance(value, float) else value


def numbers(values: Iterable[float], separator: str = " ") -> str:
    """Return the text of numbers in a snippet."""
    return separator.join(f"{value:g}" for value in values)


class ContactSettings(BaseModel, ABC):
    """Contact settings of one engine, with its names and defaults.

    If the engine has a coefficient of restitution, it is the field `restitution`. Otherwise contact constants determine
    rebounds.

    Attributes:
        engine: Name of the engine.
        is_soft: Whether a setting determines the depth at rest.
        restitution_range: Smallest and largest restitution of settings.
        friction_field: Field with the coefficient of friction of the pair.
        preset: Preset of the backend that the settings modify.
        natives: Settings of the backend, by field.
        limits: Why the engine misses `restitution`, `friction` or `penetration_m`.
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
        """Return the settings in a text such as `solref=0.02 1 solimp=0.9 0.95 0.001`; the rest have defaults.

        Args:
            text: Names and values. Blanks or commas separate values; quotes are allowed, as in XML.
            timestep_s: Time step [s].

        Raises:
            ParameterError: The text has a wrong form, or a setting does not exist.
        """
        if not PAIR.match(text):
            raise ParameterError(
                f"{cls.engine} contact {text!r}: expected names=values, for example 'friction=0.5'"
            )
        values: dict[str, Any] = {"timestep_s": timestep_s}
        for name, part in PAIR.findall(text):
            matches = VALUE.findall(part)
            values[name] = tuple(matches) if len(matches) > 1 else "".join(matches)
        try:
            return cls.model_validate(values)
        except ValidationError as error:
            key, reason = first_fault(error, noun="setting")
            settings = ", ".join(cls.model_fields)
            raise ParameterError(
                f"{cls.engine} contact: {key!r}: {reason}; settings: {settings}"
            ) from None

    @classmethod
    def aimed(cls, aim: Aim) -> Self:
        """Return the proposed settings for a behaviour, by a closed form."""
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
        """Return the remaining fields for a behaviour, by a closed form."""

    @abstractmethod
    def snippet(self) -> str:
        """Return the settings in the language of the engine."""

    @property
    def sliding_friction(self) -> float:
        """Coefficient of friction of the pair."""
        return float(getattr(self, self.friction_field))

    def gripping(self) -> Self | None:
        """Return settings with more friction in impacts, at a price; None if the engine has none."""
        return None

    @property
    def gripping_text(self) -> str:
        """What `gripping` changed, in the language of the engine."""
        return ""

    def backend_settings(self, mass_kg: float) -> dict[str, Any]:
        """Return the settings of the backend for a body with this mass [kg]."""
        given = {setting: getattr(self, name) for name, setting in self.natives.items()}
        return {"preset": self.preset, **given}
