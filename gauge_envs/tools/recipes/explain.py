"""What contact settings of an engine mean: the behaviour that they give, by simulation and in closed form."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pydantic import ValidationError

from gauge_envs.errors import ParameterError, first_fault, nearest
from gauge_envs.tools.bench.recording import DivergedError
from gauge_envs.tools.recipes.aim import Aim
from gauge_envs.tools.recipes.engines.base import ContactSettings
from gauge_envs.tools.recipes.measure import NAMES, measured, notes_on
from gauge_envs.tools.recipes.search import Numbers, divergence_text

MEASURED_IN = (
    "Balls drop from 0.2 m onto one contact. A plate of 0.12 m rests on four contacts, creeps on a slope of half the "
    "friction, and slides 10 degrees beyond the friction angle, without turning and free to hop."
)
"""The scenes in words."""


ASSIGNMENT = re.compile(r"\s*(\w+)\s*=\s*([^=]*)(?=\s\w+\s*=|$)")
"""A name, an equals sign, and everything up to the next name."""

VALUE = re.compile(r"[^\s,\"'()\[\]]+")
"""A value between blanks, commas, quotes and brackets."""


@dataclass(frozen=True, kw_only=True)
class Meaning:
    """What given settings of a contact mean, with `--explain`.

    Attributes:
        engine: Name of the engine.
        asked: Mass of the body [kg] and time step [s].
        settings: Settings of the engine.
        snippet: The same in the engine's own language.
        reached: Measured values by name.
        closed_form: What formulas give, by name; null where there are none.
        explanation: What limits the values.
        versions: Versions of the engine's packages.
    """

    engine: str
    asked: Numbers
    settings: Mapping[str, Any]
    snippet: str
    reached: Numbers
    closed_form: Mapping[str, Any] | None
    explanation: str
    versions: Mapping[str, str]


def parsed_contact(
    engine: type[ContactSettings], text: str, timestep_s: float
) -> ContactSettings:
    """Return the settings that a text gives, as `solref=0.02 1 solimp=0.9 0.95 0.001`; others are the engine's.

    Args:
        engine: Class of the engine's settings.
        text: Names and values. Blanks or commas separate values, which may stand in quotes as in XML.
        timestep_s: Time step [s].

    Raises:
        ParameterError: The text has another form, or the engine has no such setting.
    """
    pairs = ASSIGNMENT.findall(text)
    values: dict[str, Any] = {name: VALUE.findall(parts) for name, parts in pairs}
    is_whole = pairs and not ASSIGNMENT.sub("", text).strip()
    if not is_whole or len(values) < len(pairs) or "timestep_s" in values:
        raise ParameterError(
            f"{engine.engine} contact {text!r}: expected names=values, each name once, as 'friction=0.5'"
        )
    for name, parts in values.items():
        values[name] = tuple(parts) if len(parts) > 1 else "".join(parts)
    values["timestep_s"] = timestep_s
    try:
        return engine.model_validate(values)
    except ValidationError as error:
        key, reason = first_fault(error, noun="setting")
        known = [name for name in engine.model_fields if name != "timestep_s"]
        hint = nearest(key if reason == "unknown setting" else "", known)
        place = f"{key!r}: " if key else ""
        raise ParameterError(
            f"{engine.engine} contact: {place}{reason}; {hint}"
        ) from None


def explain(settings: ContactSettings, mass_kg: float) -> Meaning:
    """Simulate contact settings, and compare them with the closed form.

    Args:
        settings: The settings.
        mass_kg: Mass of the body [kg].

    Raises:
        MissingExtraError: The engine is not installed.
        ParameterError: The scenes cannot measure the settings.
    """
    Aim(
        friction=settings.sliding_friction,
        mass_kg=mass_kg,
        timestep_s=settings.timestep_s,
    ).check()
    versions = settings.backend().versions()
    try:
        closed_form = settings.closed_form()
    except ArithmeticError:
        raise ParameterError(
            f"{settings.engine} contact: its equation overflows with these numbers; give them in the engine's units"
        ) from None
    reached: Numbers = dict.fromkeys(NAMES)
    try:
        values = measured(settings, mass_kg)
        names = (*NAMES, "torsion_m", "rolling_m")
        reached = {name: values[name] for name in names if name in values}
        explanation = " ".join([MEASURED_IN, *notes_on(values)])
    except DivergedError as error:
        explanation = divergence_text(error)
    return Meaning(
        engine=settings.engine,
        asked={"mass_kg": mass_kg, "timestep_s": settings.timestep_s},
        settings=settings.model_dump(mode="json"),
        snippet=settings.snippet(),
        reached=reached,
        closed_form=closed_form,
        explanation=explanation,
        versions=versions,
    )
