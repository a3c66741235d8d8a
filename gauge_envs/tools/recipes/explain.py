"""What contact settings of an engine mean: the behaviour that they give, by simulation and in closed form."""

import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from typing import Any

from pydantic import ValidationError

from gauge_envs.errors import ParameterError, first_fault, nearest
from gauge_envs.files import json_ready
from gauge_envs.tools.bench.recording import DivergedError
from gauge_envs.tools.recipes.aim import (
    FRICTION_RANGE,
    MASS_RANGE_KG,
    TIMESTEP_RANGE_S,
    check_measurable,
)
from gauge_envs.tools.recipes.closed_forms import ContactForm
from gauge_envs.tools.recipes.engines.base import ContactSettings
from gauge_envs.tools.recipes.measure import (
    REACHED,
    Measured,
    divergence_text,
    measured,
    scatter_texts,
)

MEASURED_IN = (
    "Drops from 0.2 m onto one contact; a plate of 0.12 m rests on four, creeps on a slope of half the friction, and "
    "slides 10 degrees beyond the friction angle, without turning and free to hop."
)
"""The scenes in words."""

ASSIGNMENT = re.compile(
    r"([A-Za-z_]\w*)\s*=\s*(?:\"([^\"]*)\"|'([^']*)'|(.*?))(?=\s+[A-Za-z_]\w*\s*=|$)"
)
"""One setting: a name, an equals sign, and values up to the next name; quotes as in XML are allowed."""

MOST_CHARACTERS = 1000
"""Longest text of settings; the time of the pattern grows with the square of it."""


@dataclass(frozen=True, kw_only=True)
class Meaning:
    """What settings give.

    Attributes:
        engine: Name of the engine.
        versions: Versions of its packages.
        mass_kg: Mass of the body [kg].
        settings: The settings.
        found: What was measured; None if a simulation diverged.
        closed_form: The documented closed form; None where the engine documents none.
        explanation: What the numbers are, or why the simulation diverged.
    """

    engine: str
    versions: Mapping[str, str]
    mass_kg: float
    settings: ContactSettings
    found: Measured | None
    closed_form: ContactForm | None
    explanation: str

    @property
    def reached(self) -> dict[str, float | None]:
        """Measured values by name; None for those that were not measured."""
        return dict.fromkeys(REACHED) if self.found is None else self.found.values

    @property
    def expected(self) -> dict[str, float | None] | None:
        """Values of the closed form by the same names; None without one."""
        form = self.closed_form
        return (
            None
            if form is None
            else {"friction": self.settings.sliding_friction, **asdict(form)}
        )

    def json(self) -> dict[str, Any]:
        """Return the meaning as one JSON-ready object."""
        return json_ready(
            {
                "engine": self.engine,
                "asked": {
                    "mass_kg": self.mass_kg,
                    "timestep_s": self.settings.timestep_s,
                },
                "settings": self.settings.model_dump(mode="json"),
                "snippet": self.settings.snippet(self.mass_kg),
                "reached": self.reached,
                "closed_form": self.expected,
                "explanation": self.explanation,
                "versions": dict(self.versions),
            }
        )


def parsed_contact(
    engine: type[ContactSettings], text: str, timestep_s: float
) -> ContactSettings:
    """Return the settings that a text states, as `solref=0.02 1 solimp=0.9 0.95 0.001`; others are the engine's.

    Args:
        engine: Class of the engine's settings.
        text: Names and values; values are separated by blanks or commas, and may stand in quotes.
        timestep_s: Time step [s].
    """
    if len(text) > MOST_CHARACTERS:
        raise ParameterError(
            f"{engine.engine} contact: {len(text)} characters, at most {MOST_CHARACTERS} are read"
        )
    found: dict[str, Any] = {}
    for name, quoted, single, bare in ASSIGNMENT.findall(text.strip()):
        if name in found:
            raise ParameterError(
                f"{engine.engine} contact {text!r}: {name} is stated twice"
            )
        found[name] = _values(quoted or single or bare)
    known = [
        *(name for name in engine.model_fields if name != "timestep_s"),
        *engine.also,
    ]
    left = ASSIGNMENT.sub("", text.strip()).strip()
    if not found or left:
        raise ParameterError(
            f"{engine.engine} contact {text!r}: expected settings as name=values; settings: {', '.join(known)}"
        )
    if "timestep_s" in found:
        raise ParameterError(
            "the time step stands beside the settings: timestep_s=0.002"
        )
    try:
        return engine.model_validate({**found, "timestep_s": timestep_s})
    except ValidationError as error:
        key, reason = first_fault(error, noun="setting")
        where = f"{key!r}: " if key else ""
        hint = (
            nearest(key, known)
            if reason == "unknown setting"
            else f"settings: {', '.join(known)}"
        )
        raise ParameterError(
            f"{engine.engine} contact: {where}{reason}; {hint}"
        ) from None


def _values(text: str) -> Any:
    """Return a number, a text, or several of them, as a text states them."""

    def value(part: str) -> int | float | str:
        for kind in (int, float):
            with suppress(ValueError):
                return kind(part)
        return part

    parts = tuple(
        value(part) for part in re.split(r"[\s,]+", text.strip("[]() \t")) if part
    )
    return parts[0] if len(parts) == 1 else parts


def explain(settings: ContactSettings, mass_kg: float) -> Meaning:
    """Simulate contact settings, and put the closed form beside them.

    Args:
        settings: The settings.
        mass_kg: Mass of the body [kg].
    """
    what = "contacts are"
    check_measurable("mass", mass_kg, MASS_RANGE_KG, " kg", what=what)
    check_measurable("timestep", settings.timestep_s, TIMESTEP_RANGE_S, " s", what=what)
    check_measurable("friction", settings.sliding_friction, FRICTION_RANGE, what=what)
    versions = settings.backend().versions()
    try:
        form = settings.closed_form()
    except ArithmeticError:
        raise ParameterError(
            f"{settings.engine} contact: its equation overflows with these numbers; state them in the engine's units"
        ) from None
    found: Measured | None = None
    try:
        found = measured(settings, mass_kg)
        text = " ".join([MEASURED_IN, *scatter_texts(found)])
    except DivergedError as error:
        text = divergence_text(error)
    return Meaning(
        engine=settings.engine,
        versions=versions,
        mass_kg=mass_kg,
        settings=settings,
        found=found,
        closed_form=form,
        explanation=text,
    )
