"""Laws M1 to M6 of friction on servo benches: what friction can hold depends on rate and load.

Duclusaud, Passault, Padois and Ly, "Extended Friction Models for the Physics Simulation of Servo Actuators", arXiv
2410.08650. With the motor's torque m, the torque e of everything else, and s = exp(-|rate / r|^a):

    M1  dry                                         M2  M1 + s stribeck
    M3  M1 + l |m - e|                              M4  M3 + s (stribeck + ls |m - e|)
    M5  M2 + |lm m - le e| + s |lms m - les e|      M6  M5 + s q, against a load alone (m e < 0):
                                                        q = qe e^2 where |m| > |e|, else qm m^2

Viscous friction is a number of its own in each. No engine has such a term: what friction can hold is set anew before
each step.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from math import exp
from typing import NamedTuple

from gauge_envs.scene.geometry import NonNegative

STRIBECK = ("stribeck_friction_n_m", "stribeck_rate_rad_per_s", "stribeck_exponent")
LOAD, LOAD_STRIBECK = "load_friction", "load_stribeck_friction"
DIRECTED = ("motor_load_friction", "external_load_friction")
DIRECTED_STRIBECK = (
    "motor_load_stribeck_friction",
    "external_load_stribeck_friction",
)
QUADRATIC_LOAD = ("motor_load_squared_per_n_m", "external_load_squared_per_n_m")

TERMS = {
    "M1": (),
    "M2": STRIBECK,
    "M3": (LOAD,),
    "M4": (*STRIBECK, LOAD, LOAD_STRIBECK),
    "M5": (*STRIBECK, *DIRECTED, *DIRECTED_STRIBECK),
    "M6": (*STRIBECK, *DIRECTED, *DIRECTED_STRIBECK, *QUADRATIC_LOAD),
}
"""Numbers of each law beside dry and viscous friction."""
IN_ONE = {
    **dict.fromkeys(DIRECTED, LOAD),
    **dict.fromkeys(DIRECTED_STRIBECK, LOAD_STRIBECK),
}
"""Numbers of M5 and M6 that are one number in M4, which is so a case of both."""
SERVO_FRICTION = tuple(dict.fromkeys(name for law in TERMS.values() for name in law))


@dataclass(frozen=True, kw_only=True)
class ServoFriction:
    """What the dry friction of a servo's joint gains with load and loses with its rate: M2 to M6 of this module.

    Attributes:
        stribeck_friction_n_m: Friction at rest beside the dry one [N m].
        stribeck_rate_rad_per_s: The rate r [rad/s]; 0 leaves out all that a rate takes away.
        stribeck_exponent: The exponent a, at most 10.
        load_friction: The share l of the load.
        load_stribeck_friction: The share ls.
        motor_load_friction: The share lm of the motor's torque.
        external_load_friction: The share le of all other torques.
        motor_load_stribeck_friction: The share lms.
        external_load_stribeck_friction: The share les.
        motor_load_squared_per_n_m: The factor qm [1/(N m)].
        external_load_squared_per_n_m: The factor qe [1/(N m)].
    """

    stribeck_friction_n_m: NonNegative = 0.0
    stribeck_rate_rad_per_s: NonNegative = 0.0
    stribeck_exponent: NonNegative = 1.0
    load_friction: NonNegative = 0.0
    load_stribeck_friction: NonNegative = 0.0
    motor_load_friction: NonNegative = 0.0
    external_load_friction: NonNegative = 0.0
    motor_load_stribeck_friction: NonNegative = 0.0
    external_load_stribeck_friction: NonNegative = 0.0
    motor_load_squared_per_n_m: NonNegative = 0.0
    external_load_squared_per_n_m: NonNegative = 0.0

    def holding(self, dry_n_m: float) -> "Holding":
        """Return what friction can hold beside a dry friction [N m]; see `holding`."""
        return holding(asdict(self), dry_n_m) or (lambda rate, m, e: dry_n_m)


Holding = Callable[[float, float, float], float]
"""Torque that friction can hold [N m], from the rate [rad/s] and the torques m and e [N m]."""


class Share(NamedTuple):
    """One addend of what friction can hold.

    Attributes:
        names: Names of its numbers.
        text: The addend as Python of these numbers, in their order, and of `m` and `e`.
        torque_n_m: The same as a function of the numbers, m and e.
    """

    names: tuple[str, ...]
    text: str
    torque_n_m: Callable[[Sequence[float], float, float], float]


def _of_load(numbers: Sequence[float], m: float, e: float) -> float:
    return numbers[0] * abs(m - e)


def _of_both(numbers: Sequence[float], m: float, e: float) -> float:
    return abs(numbers[0] * m - numbers[1] * e)


def _of_squares(numbers: Sequence[float], m: float, e: float) -> float:
    if m * e >= 0.0:
        return 0.0
    return numbers[1] * e**2 if abs(m) > abs(e) else numbers[0] * m**2


STEADY = (
    Share((LOAD,), "{0} * abs(m - e)", _of_load),
    Share(DIRECTED, "abs({0} * m - {1} * e)", _of_both),
)
"""Addends at every rate."""
SLOW = (
    Share(STRIBECK[:1], "{0}", lambda numbers, m, e: numbers[0]),
    Share((LOAD_STRIBECK,), "{0} * abs(m - e)", _of_load),
    Share(DIRECTED_STRIBECK, "abs({0} * m - {1} * e)", _of_both),
    Share(
        QUADRATIC_LOAD,
        "(m * e < 0) * ({1} * e**2 if abs(m) > abs(e) else {0} * m**2)",
        _of_squares,
    ),
)
"""Addends that a rate takes away, by the factor s."""
FASTEST, STEEPEST = 99.0, 10.0
"""Largest rate over r, and largest exponent: the published exponents end at 10, and 99^10 is a number."""

Present = list[tuple[Share, list[float]]]


def _present(shares: Sequence[Share], numbers: Mapping[str, float]) -> Present:
    """Return the addends that a joint has, with their numbers."""
    valued = [(one, [numbers.get(name, 0.0) for name in one.names]) for one in shares]
    return [(one, values) for one, values in valued if any(values)]


def _addends(numbers: Mapping[str, float]) -> tuple[Present, Present, float, float]:
    """Return the addends at every rate and those that a rate takes away, r [rad/s] and the exponent."""
    rate = numbers.get(STRIBECK[1], 0.0)
    slow = _present(SLOW, numbers) if rate else []
    return (
        _present(STEADY, numbers),
        slow,
        rate,
        min(numbers.get(STRIBECK[2], 1.0), STEEPEST),
    )


def rule(numbers: Mapping[str, float], dry_n_m: float) -> str:
    """Return the torque that friction can hold as Python of `rate`, `m`, `e` and `exp`; "" without such a law.

    Args:
        numbers: Numbers of a joint by name.
        dry_n_m: Its dry friction [N m].
    """
    steady, slow, scale, exponent = _addends(numbers)
    if not steady and not slow:
        return ""

    def written(shares: Present) -> list[str]:
        return [
            one.text.format(*(f"{value:.5g}" for value in values))
            for one, values in shares
        ]

    addends = [f"{dry_n_m:.5g}", *written(steady)]
    if slow:
        fast = f"min(abs(rate / {scale:.5g}), {FASTEST:g}) ** {exponent:.5g}"
        addends.append(f"exp(-({fast})) * ({' + '.join(written(slow))})")
    return " + ".join(addends)


def holding(numbers: Mapping[str, float], dry_n_m: float) -> Holding | None:
    """Return the torque that friction can hold as a function; None without a law beyond dry and viscous friction."""
    steady, slow, scale, exponent = _addends(numbers)
    if not steady and not slow:
        return None

    def holding_n_m(rate: float, m: float, e: float) -> float:
        total = dry_n_m
        for one, values in steady:
            total += one.torque_n_m(values, m, e)
        if slow:
            share = exp(-(min(abs(rate / scale), FASTEST) ** exponent))
            for one, values in slow:
                total += share * one.torque_n_m(values, m, e)
        return total

    return holding_n_m
