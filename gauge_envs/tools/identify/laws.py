"""Laws of friction that logs are asked to choose from, by the prediction of logs that were not fitted."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.special import stdtrit

from gauge_envs.backends.base import Backend
from gauge_envs.backends.features import Feature
from gauge_envs.errors import UnsupportedSceneError
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.servo_friction import IN_ONE, SERVO_FRICTION, TERMS
from gauge_envs.tools.identify.identified import Law
from gauge_envs.tools.identify.logs import Log
from gauge_envs.tools.identify.rig import BACKLASH, DYNAMICS, SERVO
from gauge_envs.tools.identify.stages import QUADRATIC, Fit, Fitter

LAW_STEPS, LAW_CLOSE = 15, 1e-5
"""Most steps of the fit of a law to one log, which starts from a fit to all of them, and the change that ends it.

A law that starts from a simpler one goes on where that ended: if that was too early, it seems to predict better.
"""

AS_GOOD = 1.05
"""Error over that of another law, up to which a law fits or predicts as well."""

POOR = 2.0
"""Error of fits over that of another law from which a law is out: where files differ, it may still predict best."""

ONE_SIGMA = 0.8413
"""Share of a normal distribution below one standard deviation."""

LAWS = {
    "dry, viscous and quadratic": DYNAMICS,
    "dry and quadratic": (DYNAMICS[0], DYNAMICS[2], QUADRATIC),
    "dry and viscous": DYNAMICS[:3],
    "viscous": (DYNAMICS[1], DYNAMICS[2]),
    "dry": (DYNAMICS[0], DYNAMICS[2]),
}
"""Names that are identified in each law of friction of a joint without a servo; the first law contains the others."""

PLAY_LAW = "backlash"
"""M1 with a play between rotor and link."""

SERVO_NAMES = (DYNAMICS[0], DYNAMICS[2], *SERVO)
"""What is identified of a servo unless names are given; kv holds the viscous friction of its joint."""


def asked_laws(
    engine: Backend, servo: bool, names: Sequence[str] | None
) -> dict[str, tuple[str, ...]]:
    """Return the names of each law of friction that is to be compared, or none where names alone are to be fitted.

    Raises:
        UnsupportedSceneError: The engine does not set friction anew in each step.
    """
    if names is None and not servo:
        return {
            law: terms
            for law, terms in LAWS.items()
            if QUADRATIC not in terms or Feature.QUADRATIC_FRICTION in engine.features
        }
    laws = {**TERMS, PLAY_LAW: (BACKLASH,)}
    asked = [one for one in names or () if one in laws]
    changing = [one for one in names or () if one in (*SERVO_FRICTION, *TERMS)]
    if changing and Feature.SERVO_FRICTION not in engine.features:
        raise UnsupportedSceneError(
            f"backend {engine.name!r}: {', '.join(changing)}: this engine does not build friction by rate and load"
        )
    rest = [one for one in names or () if one not in laws]
    base = SERVO_NAMES if servo else DYNAMICS[:3]
    return {law: tuple(dict.fromkeys([*base, *laws[law], *rest])) for law in asked}


def compare_laws(
    fitter: Fitter,
    logs: Sequence[Log],
    laws: Mapping[str, Sequence[str]],
    fit: Fit,
    progress: Callable[[str], None],
) -> tuple[tuple[Law, ...], list[Fit]]:
    """Fit each law to each log alone, and predict the others from their recorded starts.

    Of one log, the halves stand for logs. A law starts from the best fit of one that it contains, or that contains it.

    Returns:
        The laws, the chosen one first, and its fits. A law predicts worse than another one if the mean logarithm of
        their ratio is above its standard error and 5 % (after Breiman et al., Classification and Regression Trees,
        1984). Out are laws that leave twice what another one leaves of the files that they are fitted to, unless that
        one predicts worse. Of the rest, the chosen one has the fewest terms of those that fit as well as the law that
        predicts best, and predict no worse.
    """
    parts = list(logs)
    if len(parts) == 1:
        parts = list(logs[0].pieces(0.5 * logs[0].duration_s + 1e-9))
    compared: dict[str, tuple[Law, list[Fit], FloatArray]] = {}
    for name, names in laws.items():
        progress(f"law {name}")
        related = [
            fits
            for other, (_, fits, _) in compared.items()
            if _contains(names, laws[other]) or {*names} < {*laws[other]}
        ]
        alone = []
        for row, log in enumerate(parts):
            starts = [fits[row] for fits in related]
            start = min(starts, key=lambda one: one.misfit, default=fit)
            limits: dict[str, Any] = {"tolerance": LAW_CLOSE, "most_steps": LAW_STEPS}
            alone.append(fitter.fit([log], names, first=start, **limits))
        left = [one.problem.residuals(one.unknowns) for one in alone]
        missed = np.array(
            [
                np.sqrt((one.predicted(log) ** 2).mean())
                for fitted_to, one in zip(parts, alone, strict=True)
                for log in parts
                if log is not fitted_to
            ]
        )
        law = Law(
            name=name,
            fitted_rad=float(np.sqrt(np.mean([(one**2).mean() for one in left]))),
            held_out_rad=float(np.sqrt((missed**2).mean())),
        )
        compared[name] = law, alone, missed

    def predicts_worse(name: str, other: str) -> bool:
        ratio = np.log(compared[name][2] / compared[other][2])
        standard_error = ratio.std(ddof=1) / np.sqrt(ratio.size)
        # Two predictions scatter by chance: the quantile of Student's t that is 1 of many.
        standard_error *= stdtrit(ratio.size - 1, ONE_SIGMA)
        return bool(ratio.mean() > max(standard_error, np.log(AS_GOOD)))

    def is_beaten(name: str) -> bool:
        fitted_rad = compared[name][0].fitted_rad
        return any(
            fitted_rad > POOR * law.fitted_rad and not predicts_worse(other, name)
            for other, (law, *_) in compared.items()
        )

    in_question = [name for name in compared if not is_beaten(name)]
    best = min(in_question, key=lambda law: compared[law][0].held_out_rad)
    for name, (law, alone, missed) in compared.items():
        fits = law.fitted_rad <= AS_GOOD * compared[best][0].fitted_rad
        alike = name in in_question and fits and not predicts_worse(name, best)
        compared[name] = replace(law, is_as_good=alike), alone, missed
    chosen = min(
        (name for name, (law, *_) in compared.items() if law.is_as_good),
        key=lambda name: (len(laws[name]), compared[name][0].held_out_rad),
    )
    others = sorted(
        (law for name, (law, *_) in compared.items() if name != chosen),
        key=lambda law: law.held_out_rad,
    )
    return (compared[chosen][0], *others), compared[chosen][1]


def _contains(names: Sequence[str], simpler: Sequence[str]) -> bool:
    """Return whether a law of servo benches has all numbers of a simpler one, or those that are one there."""
    known = {*names} | {IN_ONE[name] for name in names if name in IN_ONE}
    return bool(known & {*SERVO_FRICTION}) and {*simpler} < known
