"""Find contact settings that give a behaviour: a closed form first, then a search on the simulated value."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from scipy.optimize import brentq

from gauge_envs.tools.bench.recording import DivergedError
from gauge_envs.tools.recipes.aim import RANGES, Aim
from gauge_envs.tools.recipes.engines.base import ContactSettings, rounded
from gauge_envs.tools.recipes.measure import NAMES, measured, notes_on
from gauge_envs.tools.recipes.probes import Probe

RESTITUTION_TOLERANCE = 0.01
"""Error of a restitution that counts as none, as in the conformance checks of rebounds."""

FRICTION_SHARE, TURNING_SHARE, DEPTH_SHARE = 0.005, 0.01, 0.05
"""Relative error that counts as none, of a friction, of torsional and rolling friction, and of the depth at rest that a
stiffness gives."""

SHARES = {
    "friction": FRICTION_SHARE,
    "penetration_m": DEPTH_SHARE,
    "torsion_m": TURNING_SHARE,
    "rolling_m": TURNING_SHARE,
}

CREEP_MARGIN = 1.2
"""Factor on the ratio of impedances that an asked creep needs."""

MAX_TRIALS = 10
"""Most simulations of one search between two values that bracket the target."""

BRACKETS = (0.05, 0.2, 0.5, 1.0)
"""Steps from the start of a search to its end, as shares of the way, until the target is bracketed."""

FINER = (2, 4)
"""Parts of the time step with which the cause of a miss is sought."""

MAX_STIFFENING = 30.0
"""Largest factor on a stiffness that a search tries."""

Numbers = Mapping[str, float | None]
"""Values by name; None for what was not asked, does not apply or was not measured."""


@dataclass(frozen=True, kw_only=True)
class Recipe:
    """Settings of an engine for a contact or a fabric, and what they reach in simulation.

    Attributes:
        engine: Name of the engine.
        asked: What was asked, by name; null for what was not.
        settings: Settings of the engine.
        snippet: The same in the engine's own language.
        reached: Measured values by name.
        error: Reached less asked values.
        misses: Names of the asked values that are not reached.
        detail: What the reached values leave out.
        wall_s: Wall time of the simulations [s].
        explanation: Why a value is not reached.
        versions: Versions of the engine's packages.
    """

    engine: str
    asked: Numbers
    settings: Mapping[str, Any]
    snippet: str
    reached: Numbers
    error: Numbers
    misses: Sequence[str]
    detail: Mapping[str, Any]
    wall_s: float
    explanation: str
    versions: Mapping[str, str]


def find_recipe(engine: type[ContactSettings], aim: Aim) -> Recipe:
    """Return the settings of an engine that come nearest to a behaviour, with what they give.

    A closed form of the engine is the first proposal. What it misses is sought along one number of it, first the depth
    of a soft contact, then the restitution. The coefficient of friction is the asked one.

    Args:
        engine: Class of the engine's settings.
        aim: The behaviour.

    Raises:
        MissingExtraError: The engine is not installed.
        ParameterError: The scenes cannot measure the behaviour.
    """
    aim.check()
    versions = engine.backend().versions()
    start_s = time.perf_counter()
    targets = aim.targets
    settings, values = engine.aimed(aim), dict[str, Any]()
    snippet = settings.snippet()
    try:
        settings, values = _measured_settings(engine, aim)
        snippet = _commented_snippet(settings, values)
        explanation = _explanation(settings, aim, values)
    except DivergedError as error:
        explanation = divergence_text(error)
    reached = {name: values.get(name) for name in [*NAMES[:-1], *targets]}
    return Recipe(
        engine=engine.engine,
        asked=asdict(aim),
        settings=settings.model_dump(mode="json"),
        snippet=snippet,
        reached=reached,
        error={
            name: difference(reached[name], target) for name, target in targets.items()
        },
        misses=_misses(aim, reached),
        detail={name: value for name, value in values.items() if name not in reached},
        wall_s=time.perf_counter() - start_s,
        explanation=explanation,
        versions=versions,
    )


def difference(value: float | None, target: float | None) -> float | None:
    """Return a value less its target; None without one of them."""
    return None if value is None or target is None else value - target


def _measured_settings(
    engine: type[ContactSettings], aim: Aim
) -> tuple[ContactSettings, dict[str, Any]]:
    """Return the settings that come nearest to an aim, and what they give.

    Creep is inversely proportional to MuJoCo's ratio of impedances, where an engine has one.

    Raises:
        DivergedError: A simulation diverged.
    """
    settings = _searched(engine, aim)
    values = measured(settings, aim.mass_kg, friction=aim.sliding_friction)
    impratio = getattr(settings, "impratio", None)
    if impratio and aim.creep_m_s and values["creep_m_s"] > aim.creep_m_s:
        impratio *= CREEP_MARGIN * values["creep_m_s"] / aim.creep_m_s
        settings = settings.model_copy(update={"impratio": rounded(impratio)})
        values = measured(settings, aim.mass_kg, friction=aim.sliding_friction)
    return settings, values


def _commented_snippet(settings: ContactSettings, values: Mapping[str, Any]) -> str:
    """Return a snippet below a comment with the friction of bodies that hold contact and that hop."""
    holds, hops = values["friction"], values["friction_hopping"]
    text = f"Friction: {holds:.3g} of bodies that hold contact, {hops:.3g} of plates that can hop."
    return f"{settings.comment(text)}\n{settings.snippet()}"


def _misses(aim: Aim, values: Numbers) -> list[str]:
    """Return the names of the values that an aim asks for and that are not reached."""
    return [
        name
        for name, target in aim.targets.items()
        if target is not None
        and (value := values.get(name)) is not None
        and _is_missed(aim, name, target, value)
    ]


def _is_missed(aim: Aim, name: str, target: float, value: float) -> bool:
    """Return whether a value is too far from its target; a depth and a creep may be smaller than asked."""
    is_limit = name == "penetration_m" and aim.stiffness_n_per_m is None
    if is_limit or name == "creep_m_s":
        return not value <= target
    tolerance = SHARES[name] * target if name in SHARES else RESTITUTION_TOLERANCE
    return not abs(value - target) <= tolerance


def divergence_text(error: DivergedError) -> str:
    """Return why nothing was measured, and what to change."""
    return f"The simulation diverges: {error}. Choose a shorter time step or a softer contact."


# --- search ----------------------------------------------------------------------------------------------------------


def _searched(engine: type[ContactSettings], aim: Aim) -> ContactSettings:
    """Return settings after the searches for what the proposal misses, along one number of the aim each."""
    target, stiffness, rebound = aim, aim.stiffness_n_per_m, aim.rebound

    def stiffer(value: float) -> Aim:
        return replace(aim, stiffness_n_per_m=value)

    def depth_error(value: float) -> float:
        depth_m = _reached(engine.aimed(stiffer(value)), aim, "penetration_m")
        return 1.0 - depth_m / (aim.depth_m or 1.0)

    def rebounding(value: float) -> Aim:
        if value == rebound:
            return target
        return replace(target, restitution=value, damping_n_s_per_m=None)

    def rebound_error(value: float) -> float:
        restitution = _reached(engine.aimed(rebounding(value)), aim, "restitution")
        return restitution - (rebound or 0.0)

    if engine.is_soft and stiffness is not None:
        ends = (stiffness / MAX_STIFFENING, stiffness * MAX_STIFFENING)
        target = stiffer(_root(depth_error, stiffness, ends, DEPTH_SHARE))
    if rebound is not None:
        ends = engine.restitution_range
        value = _root(rebound_error, rebound, ends, RESTITUTION_TOLERANCE)
        target = rebounding(value)
    return engine.aimed(target)


SCENES: Mapping[str, Callable[[Probe], dict[str, Any]]] = {
    "friction": Probe.slide,
    "restitution": Probe.drop,
    "penetration_m": Probe.rest,
}
"""Scene of each value that a search or a shorter step is for."""


def _reached(settings: ContactSettings, aim: Aim, name: str) -> float:
    """Return what settings reach in one quantity, by its scene alone."""
    friction = aim.sliding_friction
    probe = Probe(settings=settings, mass_kg=aim.mass_kg, friction=friction)
    return float(SCENES[name](probe)[name])


def _root(
    error: Callable[[float], float],
    start: float,
    ends: tuple[float, float],
    tolerance: float,
) -> float:
    """Return the start where its error is within the tolerance, or else what a search for a smaller error finds.

    The error grows with its argument, as a rule and with noise.
    """
    errors: dict[float, float] = {}

    def error_of(value: float) -> float:
        """Return an error, which is zero once it is small, so that the search ends."""
        if value not in errors:
            errors[value] = error(value)
        return 0.0 if abs(errors[value]) < 0.5 * tolerance else errors[value]

    first, last = error_of(start), start
    if abs(errors[start]) < tolerance:
        return start
    end = ends[0] if first > 0.0 else ends[1]
    for share in BRACKETS:
        value = start + share * (end - start)
        if error_of(value) * first <= 0.0:
            low, high = sorted((last, value))
            brentq(error_of, low, high, xtol=1e-5, maxiter=MAX_TRIALS, disp=False)
            break
        last = value
    return min(errors, key=lambda value: abs(errors[value]))


# --- explanation -----------------------------------------------------------------------------------------------------


def _explanation(settings: ContactSettings, aim: Aim, values: Mapping[str, Any]) -> str:
    """Return why values are missed, with a simulation of the suspected cause."""
    misses = _misses(aim, values)
    texts = [] if misses else ["All asked values are reached."]
    for name in misses:
        texts.append(f"{name}: the settings reach {values[name]:.3g}.")
        if name in settings.limits:
            texts.append(f"{settings.limits[name]}.")
        is_rigid = name == "penetration_m" and not settings.is_soft
        if name in SCENES and not is_rigid:
            texts.append(_step_text(type(settings), aim, name))
    return " ".join([*texts, *notes_on(values)])


def _step_text(engine: type[ContactSettings], aim: Aim, name: str) -> str:
    """Return whether a shorter time step reaches a value that is missed, on the engine of the search."""
    text = ""
    for part in FINER:
        finer = replace(aim, timestep_s=aim.timestep_s / part)
        if finer.timestep_s < RANGES["timestep_s"][0]:
            break
        step = f"time step of {finer.timestep_s:.3g} s"
        try:
            value = _reached(_searched(engine, finer), finer, name)
        except DivergedError:
            return f"With a {step} the simulation diverges."
        if name not in _misses(finer, {name: value}):
            return f"A {step} reaches {value:.3g}."
        text = f"A {step} does not reach it either ({value:.3g})."
    return text
