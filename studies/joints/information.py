"""Which motions tell the shares of motor and load in the laws M4 to M6 of servo benches: information.csv.

    python -m studies.joints.information

Sensitivities of simulated angles to each number of M6 give its Fisher information, with noise of 0.5 mrad and a
standard deviation of 100 % that is assumed before. The table has the differences from M4 over their standard errors.
"""

import csv

import numpy as np

from gauge_envs.backends import backend
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.servo_friction import (
    DIRECTED,
    DIRECTED_STRIBECK,
    QUADRATIC_LOAD,
    TERMS,
)
from gauge_envs.tools.identify import Log, one_joint
from gauge_envs.tools.identify.fit import machine_of
from gauge_envs.tools.identify.problem import Problem
from studies.joints.pendulums import HERE

MASS_KG, LENGTH_M, NOISE_RAD, SAMPLE_S, DURATION_S = 0.3, 0.15, 5e-4, 0.02, 20.0
PASSIVE = {"dry_friction_n_m": 0.05, "armature_kg_m2": 0.02}
SERVO = {"kp_n_m_per_rad": 15.0, "kv_n_m_s_per_rad": 1.0, "delay_s": 0.01}
M6 = dict(
    zip(TERMS["M6"], (0.04, 0.3, 1.0, 0.10, 0.05, 0.05, 0.02, 0.05, 0.08), strict=True)
)
TRUTH = PASSIVE | SERVO | M6
NAMES = list(TRUTH)
PAIRS = {"share": DIRECTED, "slow share": DIRECTED_STRIBECK}
DROPS_RAD = (1.5, 1.2, 0.9, -1.5, -0.9)


def sensitivity(log: Log, mass_kg: float, names: list[str]) -> FloatArray:
    """Return changes of angles by relative changes of all numbers [rad], shape [N, name_count]."""
    machine = machine_of(backend("mujoco"), one_joint(mass_kg, LENGTH_M, 1e-4), log, names, {})  # fmt: skip
    sizes = np.array([[TRUTH[one]] for one in names])
    fixed = np.full(sizes.shape, np.nan)
    problem = Problem(machine, [log], [log.start()], tuple(names), sizes, False, False, fixed)  # fmt: skip
    found = problem.jacobian(np.ones(len(names)))
    table = np.zeros((len(found), len(NAMES)))
    table[:, [NAMES.index(one) for one in names]] = found
    return table


def commanded(command_rad: FloatArray, loads: float) -> FloatArray:
    """Return the sensitivities of a servo that follows commands with so many times the load."""
    times_s = SAMPLE_S * np.arange(command_rad.size)
    still = np.zeros((command_rad.size, 1))
    log = Log("", times_s, still, command_rad=command_rad[:, None])
    return sensitivity(log, loads * MASS_KG, NAMES)


def dropped() -> FloatArray:
    """Return the sensitivities of falls with the motor off, from five angles, 2 s each."""
    names = [one for one in NAMES if one not in SERVO]
    times_s = np.arange(0.0, 2.0, SAMPLE_S)
    tables = []
    for angle_rad in DROPS_RAD:
        still = np.full((times_s.size, 1), angle_rad)
        log = Log("", times_s, still, torque_n_m=np.zeros_like(still))
        tables.append(sensitivity(log, MASS_KG, names))
    return np.vstack(tables)


def told(table: FloatArray) -> list[float]:
    """Return the differences between M6 and M4 over their standard errors: both shares, then both squares."""
    information = table.T @ table / NOISE_RAD**2 + np.eye(len(NAMES))
    covariance = np.linalg.inv(information)
    found = []
    for motor, load in PAIRS.values():
        apart = np.zeros(len(NAMES))
        apart[NAMES.index(motor)], apart[NAMES.index(load)] = M6[motor], -M6[load]
        found.append(abs(apart.sum()) / np.sqrt(apart @ covariance @ apart))
    for name in QUADRATIC_LOAD:
        place = NAMES.index(name)
        found.append(1.0 / np.sqrt(covariance[place, place]))
    return found


def main() -> None:
    """Write the table."""
    times_s = np.arange(0.0, DURATION_S, SAMPLE_S)
    steps = np.repeat(np.random.default_rng(0).uniform(-1.5, 1.5, 20), 50)
    steps[:50] = 0.0
    slow = 1.5 * np.sin(0.2 * np.pi * times_s)
    single = {
        "sine of 10 s": commanded(slow, 1.0),
        "random steps": commanded(steps, 1.0),
        "random steps, three times the load": commanded(steps, 3.0),
        "falls with the motor off": dropped(),
    }
    _, one_load, three_loads, falls = single.values()
    together = {
        "random steps with both loads": np.vstack([one_load, three_loads]),
        "random steps and falls": np.vstack([one_load, falls]),
    }
    with (HERE / "information.csv").open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(["motions", *PAIRS, *QUADRATIC_LOAD])
        for name, table in (single | together).items():
            writer.writerow([name, *(f"{one:.2g}" for one in told(table))])


if __name__ == "__main__":
    main()
