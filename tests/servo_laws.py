"""Laws M2 to M6 of servo benches in closed form: torques at which a loaded joint breaks away, and how it coasts."""

import numpy as np

from gauge_envs.scene.servo_friction import TERMS

# Of the weight: dry; by rate; by load, by those of the motor and of the weight; the squares over the weight.
C, S, L, LS, LM, LE, LMS, LES, QM, QE = 0.05, 0.04, 0.08, 0.03, 0.06, 0.1, 0.02, 0.03, 0.05, 0.07  # fmt: skip


def numbers_of(law, weight_n_m, scale=0.1):
    """Return the numbers of a law with a rate r [rad/s] beside its dry friction, `C` of the weight."""
    by_rate = (S * weight_n_m, scale, 1.0)
    squares = (QM / weight_n_m, QE / weight_n_m)
    values = {
        "M2": by_rate,
        "M3": (L,),
        "M4": (*by_rate, L, LS),
        "M5": (*by_rate, LM, LE, LMS, LES),
        "M6": (*by_rate, LM, LE, LMS, LES, *squares),
    }
    return dict(zip(TERMS[law], values[law], strict=True))


# Down, for M6: u + c + s + (lm + lms) u + (le + les) + qm u^2 = 1, as friction can hold u - 1.
BREAKAWAY = {
    "M2": (1 + C + S, 1 - C - S),
    "M3": ((1 + C + L) / (1 - L), (1 - C - L) / (1 + L)),
    "M4": ((1 + C + S + L + LS) / (1 - L - LS), (1 - C - S - L - LS) / (1 + L + LS)),
    "M5": ((1 + C + S + LE + LES) / (1 - LM - LMS), (1 - C - S - LE - LES) / (1 + LM + LMS)),
    "M6": (
        (1 + C + S + LE + LES + QE) / (1 - LM - LMS),
        max(np.roots([QM, 1 + LM + LMS, C + S + LE + LES - 1])),
    ),
}  # fmt: skip
"""Torques of a motor over the weight of a level arm at which the arm rises, and at which it sinks."""


def coasting_rate(law, weight_n_m, motor_n_m, inertia_kg_m2, scale, rate, times_s):
    """Return the rate of a joint without a load that a motor brakes [rad/s], shape of the times [s].

    I w' = -a - b exp(-w / r) has a u + b = (a u0 + b) exp(-a t / (I r)) with u = exp(w / r).
    """
    steady, slow = C * weight_n_m + motor_n_m, 0.0
    if law != "M3":
        slow = S * weight_n_m
    if law in ("M3", "M4"):
        steady += L * motor_n_m
    if law == "M4":
        slow += LS * motor_n_m
    if law in ("M5", "M6"):
        steady += LM * motor_n_m
        slow += LMS * motor_n_m
    start = np.exp(rate / scale)
    decay = np.exp(-steady * times_s / (inertia_kg_m2 * scale))
    return scale * np.log(((steady * start + slow) * decay - slow) / steady)


JOINT = (
    '<mujoco><option timestep="{step}" integrator="implicitfast"/><worldbody><body><joint name="elbow" axis="{axis}" '
    'armature="{armature}" frictionloss="{dry}" solimpfriction="0.9999 0.9999 0.001" solreffriction="0.001 1"/>'
    '<inertial pos="{pos}" mass="{mass}" diaginertia="{inertia}"/></body></worldbody>{rest}</mujoco>'
)
"""An arm of one joint in MJCF."""
LEVEL = {"axis": "0 1 0", "pos": "0.2 0 0", "mass": 0.5, "inertia": "1e-3 1e-3 1e-3", "armature": 0.005}  # fmt: skip
