"""Find contact settings that give a behaviour, by simulation."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

from scipy.optimize import brentq

from gauge_envs.files import json_ready
from gauge_envs.tools.bench.recording import DivergedError
from gauge_envs.tools.recipes.aim import TIMESTEP_RANGE_S, Aim
from gauge_envs.tools.recipes.engines.base import ContactSettings
from gauge_envs.tools.recipes.measure import (
    REACHED,
    Measured,
    divergence_text,
    measured,
    probe_of,
    scatter_texts,
)

RESTITUTION_TOLERANCE = 0.01
"""Error of a restitution that counts as none, as in the conformance checks of rebounds."""

FRICTION_SHARE = 0.005
"""Relative error of a friction that counts as none."""

TURNING_SHARE = 0.01
"""Relative error of torsional and rolling friction that counts as none, as in the conformance checks."""

DEPTH_SHARE = 0.05
"""Relative error of a depth at rest that counts as none, where a stiffness states it."""

CREEP_MARGIN = 1.2
"""Factor on the ratio of impedances that an asked creep needs."""

MOST_TRIALS = 10
"""Most simulations of one search between two values that bracket the target."""

BRACKETS = (0.05, 0.2, 0.5, 1.0)
"""Steps from the start of a search to its end, as shares of the way, until the target is bracketed."""

FINER = (2, 4)
"""Parts of the time step with which the cause of a miss is sought."""

STIFFER = 30.0
"""Largest factor on a stiffness that a search tries."""


@dataclass(frozen=True, kw_only=True)
class Recipe:
    """Settings of one engine and what they give.

    Attributes:
        engine: Name of the engine.
        versions: Versions of its packages.
        aim: The request.
        settings: The settings.
        found: What was measured; None if a simulation diverged.
        explanation: Why values are missed, and what limits those that are reached.
        wall_s: Wall time of the search and the measurement [s], without the start of the engine.
    """

    engine: str
    versions: Mapping[str, str]
    aim: Aim
    settings: ContactSettings
    found: Measured | None
    explanation: str
    wall_s: float

    @property
    def asked(self) -> dict[str, float | None]:
        """Asked values by name; None for what was not asked."""
        friction = self.aim.friction if self.aim.is_friction_asked else None
        asked = {
            "friction": friction,
            "restitution": self.aim.rebound,
            "penetration_m": self.aim.depth_m,
        }
        return {**asked, "creep_m_s": self.aim.creep_m_s, **self.aim.turning}

    @property
    def reached(self) -> dict[str, float | None]:
        """Measured values by name; None for those that were not measured."""
        names = (*REACHED[:-1], *self.aim.turning)
        return {
            name: None if self.found is None else self.found.values[name]
            for name in names
        }

    @property
    def error(self) -> dict[str, float | None]:
        """Reached less asked values by name; None for what was not asked or not measured."""
        reached = self.reached
        return {
            name: None
            if target is None or (value := reached[name]) is None
            else value - target
            for name, target in self.asked.items()
        }

    @property
    def detail(self) -> dict[str, float | None]:
        """What the reached values leave out, by name: the ranges of their means, and the height of hops."""
        found = self.found
        spreads = {
            "friction": "slide",
            "friction_hopping": "hopping",
            "restitution": "rebound",
        }
        values: dict[str, float | None] = {
            "hop_m": None if found is None else found.hop_m,
            "fast_hop_m": None if found is None else found.fast_hop_m,
        }
        for (name, attribute), end in product(spreads.items(), ("low", "high")):
            values[f"{name}_{end}"] = (
                None if found is None else getattr(getattr(found, attribute), end)
            )
        return values

    @property
    def misses(self) -> tuple[str, ...]:
        """Names of the asked values that are not reached; empty after a divergence."""
        return tuple(
            name
            for name in self.asked
            if self.found and _is_missed(self.aim, name, self.found.values[name])
        )

    @property
    def snippet(self) -> str:
        """The settings in the engine's own language, below a comment with the friction of bodies that hold and hop."""
        text = self.settings.snippet(self.aim.mass_kg)
        if self.found is None:
            return text
        holds, hops = self.found.slide.mean, self.found.hopping.mean
        line = f"Friction: {holds:.3g} of bodies that hold contact, {hops:.3g} of plates that can hop."
        return f"{self.settings.comment.format(line)}\n{text}"

    def json(self) -> dict[str, Any]:
        """Return the recipe as one JSON-ready object."""
        settings = self.settings.model_dump(mode="json")
        values = {
            "engine": self.engine,
            "asked": self.aim.asked(),
            "settings": settings,
            "snippet": self.snippet,
            "reached": self.reached,
            "error": self.error,
            "misses": self.misses,
            "detail": self.detail,
            "wall_s": self.wall_s,
            "explanation": self.explanation,
            "versions": dict(self.versions),
        }
        return json_ready(values)


def _is_missed(aim: Aim, name: str, value: float | None) -> bool:
    assert value is not None, "it was measured"
    if name == "friction":
        return (
            aim.is_friction_asked
            and not abs(value - aim.friction) <= FRICTION_SHARE * aim.friction
        )
    if name == "restitution":
        return (
            aim.rebound is not None
            and not abs(value - aim.rebound) <= RESTITUTION_TOLERANCE
        )
    if name == "creep_m_s":
        return aim.creep_m_s is not None and not value <= aim.creep_m_s
    if name in aim.turning:
        return not abs(value - aim.turning[name]) <= TURNING_SHARE * aim.turning[name]
    if aim.depth_m is None:
        return False
    if aim.stiffness_n_per_m is None:
        return not value <= aim.depth_m
    return not abs(value - aim.depth_m) <= DEPTH_SHARE * aim.depth_m


def find_recipe(engine: type[ContactSettings], aim: Aim) -> Recipe:
    """Return the settings of an engine that come nearest to a behaviour, with what they give.

    The rule of the engine's backend is the first proposal. What it misses is sought along one number of it, first the
    depth of a soft contact, then restitution. The coefficient of friction is the asked one, that of sliding contacts.

    Args:
        engine: Class of the engine's settings.
        aim: The behaviour.

    Raises:
        MissingExtraError: The engine is not installed.
    """
    versions = engine.backend().versions()
    start = time.perf_counter()
    settings, found = engine.aimed(aim), None
    try:
        settings = engine.model_validate(
            _searched(engine, aim).model_dump() | aim.turning
        )
        found = measured(settings, aim.mass_kg, friction=aim.friction)
        if (
            aim.creep_m_s is not None
            and found.creep_m_s > aim.creep_m_s
            and "impratio" in engine.model_fields
        ):
            # Creep is inversely proportional to it.
            values = settings.model_dump()
            values["impratio"] *= CREEP_MARGIN * found.creep_m_s / aim.creep_m_s
            settings = engine.model_validate(values)
            found = measured(settings, aim.mass_kg, friction=aim.friction)
        text = ""
    except DivergedError as error:
        text = divergence_text(error)
    recipe = Recipe(
        engine=engine.engine,
        versions=versions,
        aim=aim,
        settings=settings,
        found=found,
        explanation=text,
        wall_s=0.0,
    )
    if found is not None:
        recipe = replace(recipe, explanation=_explanation(engine, recipe, found))
    return replace(recipe, wall_s=time.perf_counter() - start)


def _searched(engine: type[ContactSettings], aim: Aim) -> ContactSettings:
    """Return settings after the searches for what the proposal misses, along one number of the aim each."""
    target, asked_m, stiffness, rebound = (
        aim,
        aim.depth_m,
        aim.stiffness_n_per_m,
        aim.rebound,
    )

    def reached(changed: Aim, name: str) -> float:
        return _reached(engine.aimed(changed), aim, name)

    def stiffer(factor: float) -> Aim:
        return (
            aim
            if factor == 1.0
            else aim.changed(stiffness_n_per_m=factor * (stiffness or 0.0))
        )

    def rebounding(value: float) -> Aim:
        return target if value == rebound else target.changed(restitution=value)

    if engine.is_soft and stiffness is not None and asked_m is not None:
        ends = (1.0 / STIFFER, STIFFER)
        factor = _root(
            lambda factor: 1.0 - reached(stiffer(factor), "penetration_m") / asked_m,
            1.0,
            *ends,
            DEPTH_SHARE,
        )
        target = stiffer(factor)
    if rebound is not None:
        ends, tolerance = engine.aims, RESTITUTION_TOLERANCE
        value = _root(
            lambda value: reached(rebounding(value), "restitution") - rebound,
            rebound,
            *ends,
            tolerance,
        )
        target = rebounding(value)
    return engine.aimed(target)


def _reached(settings: ContactSettings, aim: Aim, name: str) -> float:
    """Return what settings reach in one quantity, by its scene alone."""
    probe, build = probe_of(settings, aim.mass_kg), settings.build(aim.mass_kg)
    if name == "friction":
        return probe.slide(build, aim.friction).mean
    return (
        probe.drop(build).mean
        if name == "restitution"
        else probe.rest(build).penetration_m
    )


def _root(
    error: Callable[[float], float],
    start: float,
    low: float,
    high: float,
    tolerance: float,
) -> float:
    """Return the start where its error is within the tolerance, or else what a search for a smaller error finds.

    The error grows with its argument, as a rule and with noise.
    """
    tried: dict[float, float] = {}

    def seen(value: float) -> float:
        if value not in tried:
            tried[value] = error(value)
        # Within the tolerance the search ends.
        return 0.0 if abs(tried[value]) < 0.5 * tolerance else tried[value]

    last, first = start, seen(start)
    if abs(first) < tolerance:
        return start
    end = low if first > 0.0 else high
    for share in BRACKETS:
        value = start + share * (end - start)
        if value != last and seen(value) * first <= 0.0:
            if seen(value) != 0.0:
                brentq(
                    seen,
                    *sorted((last, value)),
                    xtol=1e-5,
                    maxiter=MOST_TRIALS,
                    disp=False,
                )
            break
        last = value
    return min(tried, key=lambda value: abs(tried[value]))


# --- explanation -----------------------------------------------------------------------------------------------------


def _explanation(engine: type[ContactSettings], recipe: Recipe, found: Measured) -> str:
    """Return why values are missed, with a simulation of the suspected cause."""
    aim = recipe.aim
    texts = []
    for name in recipe.misses:
        reached, error = recipe.reached[name], recipe.error[name]
        unit = " m" if name == "penetration_m" else ""
        texts.append(
            f"{name}: {reached:.3g}{unit} is reached, {error:+.2g} from what is asked."
        )
        if limit := engine.limits.get(name):
            texts.append(f"{limit[0].upper()}{limit[1:]}.")
        if name in ("friction", "restitution") or (
            name == "penetration_m" and engine.is_soft
        ):
            texts.append(_step_text(engine, aim, name))
    if aim.rebound and (other := recipe.settings.other_body()) is not None:
        text, settings = other
        mean = _reached(settings, aim, "restitution")
        texts.append(f"{text} the same settings give a restitution of {mean:.3f}.")
    texts += scatter_texts(found)
    return " ".join(
        texts if recipe.misses else ["All values that are asked are reached.", *texts]
    )


def _step_text(engine: type[ContactSettings], aim: Aim, name: str) -> str:
    """Return whether a shorter time step reaches a value that is missed, on the engine of the search."""
    text = ""
    for part in FINER:
        step_s = aim.timestep_s / part
        if step_s < TIMESTEP_RANGE_S[0]:
            break
        finer = aim.changed(timestep_s=step_s)
        try:
            value = _reached(_searched(engine, finer), finer, name)
        except DivergedError:
            return f"With a time step of {step_s:.3g} s the simulation diverges."
        if not _is_missed(finer, name, value):
            return f"With a time step of {step_s:.3g} s the same search reaches {value:.3g}."
        text = f"A time step of {step_s:.3g} s does not reach it either ({value:.3g})."
    return text
