"""Laws M1 to M6 of friction on servo benches: what friction can hold depends on rate and load.

Duclusaud, Passault, Padois and Ly, "Extended Friction Models for the Physics Simulation of Servo Actuators", arXiv
2410.08650. With the motor's torque m, the torque e of everything else, and s = exp(-|rate / r|^a):

    M1  dry                                         M2  M1 + s stribeck
    M3  M1 + l |m - e|                              M4  M3 + s (stribeck + ls |m - e|)
    M5  M2 + |lm m - le e| + s |lms m - les e|      M6  M5 + s q, against a load alone (m e < 0):
                                                        q = qe e^2 where |m| > |e|, else qm m^2

Viscous friction is a number of its own in each. MuJoCo has no such term: what its dry friction can hold is set anew
before each step, from the torques of the step before.
"""

from collections.abc import Callable, Mapping
from math import exp

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
SERVO_FRICTION = tuple(dict.fromkeys(name for law in TERMS.values() for name in law))

Holding = Callable[[float, float, float], float]
"""Torque that friction can hold [N m], from the rate [rad/s] and the torques m and e [N m]."""


def rule(numbers: Mapping[str, float], dry_n_m: float, digits: int = 5) -> str:
    """Return the torque that friction can hold as Python of `rate`, `m`, `e` and `exp`; "" without such a law.

    Args:
        numbers: Numbers of a joint by name.
        dry_n_m: Its dry friction [N m].
        digits: Digits of each number.
    """
    value = {name: f"{numbers.get(name, 0.0):.{digits}g}" for name in SERVO_FRICTION}
    if not any(map(numbers.get, SERVO_FRICTION)):
        return ""

    def loaded(both: str, apart: tuple[str, str]) -> list[str]:
        terms = []
        if numbers.get(both):
            terms.append(f"{value[both]} * abs(m - e)")
        if any(map(numbers.get, apart)):
            terms.append(f"abs({value[apart[0]]} * m - {value[apart[1]]} * e)")
        return terms

    held = [f"{dry_n_m:.{digits}g}", *loaded(LOAD, DIRECTED)]
    if numbers.get(STRIBECK[1]):
        slow = [value[STRIBECK[0]], *loaded(LOAD_STRIBECK, DIRECTED_STRIBECK)]
        if any(map(numbers.get, QUADRATIC_LOAD)):
            motor, external = (value[name] for name in QUADRATIC_LOAD)
            slow.append(
                f"(m * e < 0) * ({external} * e**2 if abs(m) > abs(e) else {motor} * m**2)"
            )
        # The published exponents end at 10, and 99^10 is a number.
        exponent = f"{min(numbers.get(STRIBECK[2], 1.0), 10.0):.{digits}g}"
        fast = f"min(abs(rate / {value[STRIBECK[1]]}), 99) ** {exponent}"
        held.append(f"exp(-({fast})) * ({' + '.join(slow)})")
    return " + ".join(held)


def holding(numbers: Mapping[str, float], dry_n_m: float) -> Holding | None:
    """Return the text of `rule` as a function, so that what is pasted is what was simulated; None without one."""
    text = rule(numbers, dry_n_m, digits=17)
    if not text:
        return None
    found: Holding = eval(f"lambda rate, m, e: {text}", {"exp": exp})
    return found
