"""Find contact settings for a behaviour, and the behaviour of settings.

A closed form of the engine proposes settings, and a search corrects them by simulations.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from gauge_envs.fixtures.recording import DivergedError
from gauge_envs.scene import GRAVITY_M_PER_S2
from gauge_envs.tools.recipes.aim import Aim
from gauge_envs.tools.recipes.engines.base import ContactSettings, rounded
from gauge_envs.tools.recipes.probes import NAMES, Probe, measured

SHARES = {
    "friction": 0.005,
    "impact_friction": 0.05,
    "penetration_m": 0.05,
    "torsion_m": 0.01,
    "rolling_m": 0.01,
}
"""Largest accepted relative errors; the error of the depth at rest applies to a requested stiffness."""

TOLERANCES = {"restitution": 0.01, "slip_restitution": 0.05, "creep_m_s": 0.0}
"""Largest accepted errors of the other values; the restitution as in the conformance checks of rebounds."""

CREEP_MARGIN = 1.2
"""Safety factor on the ratio of impedances for a requested creep."""

MAX_TRIALS = 8
"""Maximum number of simulations of a search."""

MAX_STIFFENING = 3.0
"""Largest change of a stiffness between two trials, as a factor."""

Numbers = Mapping[str, float | None]
"""Values by name; None if not requested, not applicable or not measured."""


@dataclass(frozen=True, kw_only=True)
class Recipe:
    """Settings of an engine for a contact or a fabric, and the simulated values.

    Attributes:
        engine: Name of the engine.
        asked: Requested values by name; null without a request.
        settings: Settings of the engine.
        snippet: Settings in the language of the engine.
        reached: Simulated values by name.
        error: Reached minus requested values.
        misses: Names of the requested values that are not reached.
        explanation: Why values are not reached.
        versions: Versions of the engine's packages.
    """

    engine: str
    asked: Numbers
    settings: Mapping[str, Any]
    snippet: str
    reached: Numbers
    error: Numbers
    misses: Sequence[str]
    explanation: str
    versions: Mapping[str, str]

    @property
    def diverges(self) -> bool:
        """Whether a simulation diverges: it then lacks values."""
        return bool(self.versions) and None in self.reached.values()


def find_recipe(engine: type[ContactSettings], aim: Aim) -> Recipe:
    """Return the settings of an engine that are nearest to a behaviour, with the simulated values.

    A closed form of the engine is the first proposal. A search corrects first the stiffness of a soft contact, then the
    restitution. The coefficient of friction equals the requested one.

    Args:
        engine: Class of the engine's settings.
        aim: The behaviour.

    Raises:
        MissingExtraError: The engine is not installed.
        ParameterError: The scenes cannot measure the behaviour.
    """
    aim.check()
    try:
        settings = _searched(engine, aim)
    except DivergedError:
        settings = engine.aimed(aim)
    return _simulated(settings, aim)


def explain(settings: ContactSettings, mass_kg: float) -> Recipe:
    """Return the simulated behaviour of contact settings.

    Args:
        settings: The settings.
        mass_kg: Mass of the body [kg].

    Raises:
        MissingExtraError: The engine is not installed.
        ParameterError: The scenes cannot measure the settings.
    """
    aim = Aim(mass_kg=mass_kg, timestep_s=settings.timestep_s)
    replace(aim, friction=settings.sliding_friction).check()
    return _simulated(settings, aim)


def _simulated(settings: ContactSettings, aim: Aim) -> Recipe:
    """Return the recipe of settings for an aim."""
    versions = settings.backend().versions()
    values, misses = dict[str, float](), list[str]()
    try:
        values = measured(settings, aim.mass_kg)
        misses = _misses(aim, values)
        explanation = _explanation(settings, aim, misses, values)
    except DivergedError as error:
        explanation = f"The simulation diverges: {error}. Choose a shorter time step or a softer contact."
    return Recipe(
        engine=settings.engine,
        asked=asdict(aim),
        settings=settings.model_dump(mode="json"),
        snippet=settings.snippet(),
        reached={**dict.fromkeys(NAMES), **values},
        error={
            name: difference(values.get(name), target)
            for name, target in aim.targets.items()
        },
        misses=misses,
        explanation=explanation,
        versions=versions,
    )


def difference(value: float | None, target: float | None) -> float | None:
    """Return a value minus its target; None if either is missing."""
    return None if value is None or target is None else value - target


def _misses(aim: Aim, values: Mapping[str, float]) -> list[str]:
    """Return the names of the requested values that are not reached.

    Creep and allowed depth may be smaller than requested.
    """
    limits = {"creep_m_s"}
    if aim.stiffness_n_per_m is None:
        limits.add("penetration_m")
    misses = []
    for name, target in aim.targets.items():
        if target is None:
            continue
        error = values[name] - target
        tolerance = SHARES.get(name, 0.0) * target or TOLERANCES[name]
        if error > 0.0 if name in limits else abs(error) > tolerance:
            misses.append(name)
    return misses


def _explanation(
    settings: ContactSettings,
    aim: Aim,
    misses: Sequence[str],
    values: Mapping[str, float],
) -> str:
    """Return the values that are missed and why; empty without a request."""
    if not any(aim.targets.values()):
        return ""
    if not misses:
        return "All requested values are reached."
    texts = []
    for name in misses:
        target = aim.targets[name]
        assert target is not None, "a value without a target is no miss"
        text = f"{name} {values[name]:.3g} (asked {target:.3g})"
        if name in settings.limits:
            text += f": {settings.limits[name]}"
        texts.append(text)
    text = f"Not reached: {'; '.join(texts)}."
    other = settings.gripping() if "impact_friction" in misses else None
    return text if other is None else f"{text} {_price(other, aim)}".strip()


def _price(settings: ContactSettings, aim: Aim) -> str:
    """Return what other settings reach, and how high a sliding plate then hops; empty if they miss it too."""
    probe = Probe(settings=settings, mass_kg=aim.mass_kg)
    values = probe.impact() | probe.hop()
    error = values["impact_friction"] / aim.sliding_friction - 1.0
    if abs(error) > SHARES["impact_friction"]:
        return ""
    return (
        f"With {settings.gripping_text} the impact friction is {values['impact_friction']:.3g}, but a ball that slips "
        f"rebounds with {values['slip_restitution']:.3g}, and a plate at 4 m/s hops by {values['hop_m']:.2g} m."
    )


# --- search ----------------------------------------------------------------------------------------------------------


def _searched(engine: type[ContactSettings], aim: Aim) -> ContactSettings:
    """Return the settings that are nearest to an aim.

    Creep is inversely proportional to MuJoCo's ratio of impedances, if the engine has it.

    Raises:
        DivergedError: A simulation diverged.
    """
    settings = engine.aimed(_rebounding(engine, _stiffened(engine, aim)))
    impratio = getattr(settings, "impratio", None)
    if impratio and aim.creep_m_s:
        probe = Probe(settings=settings, mass_kg=aim.mass_kg)
        ratio = probe.creep()["creep_m_s"] / aim.creep_m_s
        if ratio > 1.0:
            scaled = rounded(CREEP_MARGIN * ratio * impratio)
            settings = settings.model_copy(update={"impratio": scaled})
    return settings


def _stiffened(engine: type[ContactSettings], aim: Aim) -> Aim:
    """Return an aim with a corrected stiffness, so that a soft contact has the requested depth at rest.

    The depth is nearly inversely proportional to the stiffness.
    """
    stiffness_n_per_m = aim.stiffness_n_per_m
    if stiffness_n_per_m is None or not engine.is_soft:
        return aim
    asked_depth_m = aim.mass_kg * GRAVITY_M_PER_S2 / stiffness_n_per_m
    trials = {}
    for _ in range(MAX_TRIALS):
        candidate = replace(aim, stiffness_n_per_m=stiffness_n_per_m)
        probe = Probe(settings=engine.aimed(candidate), mass_kg=aim.mass_kg)
        ratio = probe.rest()["penetration_m"] / asked_depth_m
        trials[abs(ratio - 1.0)] = candidate
        # The search for the restitution slightly changes the depth.
        if abs(ratio - 1.0) < 0.5 * SHARES["penetration_m"]:
            break
        stiffness_n_per_m *= min(max(ratio, 1.0 / MAX_STIFFENING), MAX_STIFFENING)
    return trials[min(trials)]


def _rebounding(engine: type[ContactSettings], aim: Aim) -> Aim:
    """Return an aim with a corrected restitution, so that the simulation has the requested restitution.

    Each trial corrects the restitution by the last error, or halves the remaining range.
    """
    asked = aim.rebound
    if asked is None:
        return aim
    restitution, candidate, trials = asked, aim, dict[float, Aim]()
    low, high = engine.restitution_range
    for _ in range(MAX_TRIALS):
        probe = Probe(settings=engine.aimed(candidate), mass_kg=aim.mass_kg)
        error = probe.drop()["restitution"] - asked
        trials[abs(error)] = candidate
        if not abs(error) >= TOLERANCES["restitution"]:
            break
        if error > 0.0:
            high = restitution
        else:
            low = restitution
        restitution -= error
        if not low < restitution < high:
            restitution = 0.5 * (low + high)
        candidate = replace(aim, restitution=restitution, damping_n_s_per_m=None)
    return trials[min(trials)]
