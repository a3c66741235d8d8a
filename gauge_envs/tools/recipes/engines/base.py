"""What an engine adds to a recipe: its contact settings, where a search starts, and text that can be pasted."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Annotated, Any, ClassVar, Self, TypeVar

from pydantic import BaseModel, ConfigDict, Field, create_model, field_validator

from gauge_envs.backends.base import Backend
from gauge_envs.backends.registry import backend
from gauge_envs.backends.settings import Native, SteppedSettings, native_settings
from gauge_envs.scene import ContactMode
from gauge_envs.tools.recipes.aim import Aim
from gauge_envs.tools.recipes.closed_forms import ContactForm, MuJoCoContact
from gauge_envs.tools.recipes.probes import (
    BALL_COUNT,
    DROP_M,
    PLATE_CONTACTS,
    Build,
    creep_slope_rad,
)

DIGITS = 6
"""Digits of the numbers of a recipe: those that are simulated are those that are printed."""


class ContactSettings(BaseModel, ABC):
    """Contact settings of one engine, under its own names. Defaults are those of the engine.

    Attributes:
        engine: Name of the engine.
        is_soft: Whether a setting determines the depth at rest.
        aims: Smallest and largest restitution that settings can aim at.
        also: Further names that a text may state in place of fields.
        friction_field: Field that is the coefficient of friction of the pair.
        preset: Preset of the backend on which the settings are built.
        natives: Names of settings of the backend, by the fields that state them.
        template: The settings in the engine's own language, with fields in braces.
        separator: Text between the numbers of a tuple in the engine's own language.
        comment: A comment in the engine's own language, with braces for its text.
        limits: What the engine itself limits in `restitution`, `friction` or `penetration_m`.
        timestep_s: Time step [s].
        torsion_m: Torsional friction [m].
        rolling_m: Rolling friction [m].
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    engine: ClassVar[str]
    is_soft: ClassVar[bool]
    aims: ClassVar[tuple[float, float]] = (0.0, 1.0)
    also: ClassVar[tuple[str, ...]] = ()
    friction_field: ClassVar[str] = "friction"
    preset: ClassVar[str] = "out_of_box"
    natives: ClassVar[Mapping[str, str]] = {}
    template: ClassVar[str]
    separator: ClassVar[str] = ", "
    comment: ClassVar[str] = "# {}"
    limits: ClassVar[Mapping[str, str]]

    timestep_s: float = Field(gt=0.0)
    torsion_m: float = Field(default=0.0, ge=0.0)
    rolling_m: float = Field(default=0.0, ge=0.0)

    @field_validator("*")
    @classmethod
    def _rounded(cls, value: Any, info: Any) -> Any:
        if info.field_name == "timestep_s":
            return value
        if isinstance(value, tuple):
            return tuple(_round(one) for one in value)
        return _round(value)

    @classmethod
    def of(cls, **values: Any) -> Self:
        """Return settings with some values; the others are those of the engine."""
        return cls.model_validate(values)

    @classmethod
    def backend(cls) -> Backend:
        """Return the backend that simulates the settings."""
        return backend(cls.engine)

    @classmethod
    @abstractmethod
    def aimed(cls, aim: Aim) -> Self:
        """Return the settings that are to give a behaviour, by the rule of the backend of this package."""

    @property
    def sliding_friction(self) -> float:
        """Coefficient of friction of the pair."""
        return float(getattr(self, self.friction_field))

    def build(self, mass_kg: float) -> Build:
        """Return the settings through the contract of backends, for a body of a mass [kg]."""
        given = {setting: getattr(self, name) for name, setting in self.natives.items()}
        # A coefficient of restitution is that of impacts; where there is none, contacts rebound by their constants.
        restitution = getattr(self, "restitution", None)
        return Build(
            friction=self.sliding_friction,
            restitution=restitution or 0.0,
            turning={"torsion_m": self.torsion_m, "rolling_m": self.rolling_m},
            mode=ContactMode.SUSTAINED if restitution is None else ContactMode.IMPACT,
            settings={"preset": self.preset, **given, **self.further(mass_kg)},
        )

    def further(self, mass_kg: float) -> Mapping[str, Any]:
        """Return settings of the backend that no field states alone, for a body of a mass [kg]."""
        return {}

    def snippet(self, mass_kg: float) -> str:
        """Return the settings in the engine's own language, for a body of a mass [kg]."""
        return self.template.format(**self.texts())

    def texts(self) -> dict[str, str]:
        """Return the values of the fields as texts of the template."""
        texts = {name: _text(value, self.separator) for name, value in self}
        return texts | {"timestep_s": f"{self.timestep_s:.9g}"}

    def other_body(self) -> tuple[str, Self] | None:
        """Return a kind of body on which the same settings rebound differently, and its settings; None for none."""
        return None

    def constraint(self) -> MuJoCoContact | None:
        """Return the contact equation of the engine, if it is MuJoCo's; None where the engine documents none."""
        return None

    def closed_form(self) -> ContactForm | None:
        """Return what the engine's contact equation gives for one coordinate; None without an equation."""
        constraint = self.constraint()
        if constraint is None:
            return None
        slope = creep_slope_rad(self.sliding_friction)
        return constraint.form(
            contact_count=PLATE_CONTACTS,
            slope_rad=slope,
            drop_m=DROP_M,
            phase_count=BALL_COUNT,
        )


Class = TypeVar("Class", bound=ContactSettings)


def stated_by(preset: SteppedSettings) -> Callable[[type[Class]], type[Class]]:
    """Return a decorator for the contact settings of an engine, of which fields are settings of its backend.

    A field with the native name of a setting states it. Without a default of its own, it has the setting's type and
    limits, and the value of the preset.
    """
    settings = native_settings(type(preset))

    def decorate(cls: type[Class]) -> type[Class]:
        natives = {
            name: settings[name]
            for name in cls.model_fields
            if name in settings and name != "timestep_s"
        }
        fields: dict[str, Any] = {}
        for name, setting in natives.items():
            if cls.model_fields[name].is_required():
                field = type(preset).model_fields[setting]
                fields[name] = (
                    Annotated[(field.annotation, *field.metadata, Native(name))],
                    getattr(preset, setting),
                )
        made = create_model(
            cls.__name__,
            __base__=cls,
            __module__=cls.__module__,
            __doc__=cls.__doc__,
            **fields,
        )
        made.natives = natives
        return made

    return decorate


def _round(value: Any) -> Any:
    return float(f"{value:.{DIGITS}g}") if isinstance(value, float) else value


def _text(value: Any, separator: str) -> str:
    if isinstance(value, tuple):
        return separator.join(_text(one, separator) for one in value)
    return (
        f"{value:.{DIGITS}g}"
        if isinstance(value, float)
        else str(int(value) if isinstance(value, bool) else value)
    )
