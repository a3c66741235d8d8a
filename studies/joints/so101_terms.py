"""Do Stribeck friction, friction by load, or play lower the error of an SO-101 on motions that were not fitted?

    python studies/joints/so101_terms.py

Each law starts from `so101_constants.csv`; all its constants are fitted again on the same motions. MuJoCo has none of
the three terms: they are computed in each step. Writes so101_terms.csv.
"""

from __future__ import annotations

import csv
from collections.abc import Callable
from dataclasses import replace

import mujoco
import numpy as np
from fits import HERE, FloatArray, Trial, trials, write
from so101 import (
    CHIRP_S,
    FIELDS,
    JOINTS,
    LOADED,
    STEPS,
    SUBSTEPS,
    Servos,
    commands,
    part,
    same,
    shared,
)

ROUNDS = 6
Step = Callable[[Servos, FloatArray, mujoco.MjModel, mujoco.MjData], None]


def coulomb(
    servos: Servos, own: FloatArray, model: mujoco.MjModel, data: mujoco.MjData
) -> None:
    """Leave the constant friction."""


def stribeck(
    servos: Servos, own: FloatArray, model: mujoco.MjModel, data: mujoco.MjData
) -> None:
    """At rest friction is larger by a share, which falls to 1/e at a rate [rad/s]."""
    model.dof_frictionloss[:] = servos.dry * (
        1.0 + own[0] * np.exp(-np.square(data.qvel / own[1]))
    )


def load(
    servos: Servos, own: FloatArray, model: mujoco.MjModel, data: mujoco.MjData
) -> None:
    """Friction grows by a share of the mean of the servo's torque and that of the weight, which the gears carry."""
    model.dof_frictionloss[:] = servos.dry + own[0] * 0.5 * np.abs(
        data.qfrc_actuator + data.qfrc_bias
    )


def play(
    servos: Servos, own: FloatArray, model: mujoco.MjModel, data: mujoco.MjData
) -> None:
    """The servo exerts no torque within an angle from its command [rad], and counts from there."""
    error = data.ctrl - data.qpos
    data.ctrl[:] = data.qpos + np.sign(error) * np.maximum(np.abs(error) - own[0], 0.0)


LAWS: dict[str, tuple[Step, tuple[float, ...]]] = {
    "as identified": (coulomb, ()),
    "Stribeck": (stribeck, (0.3, 0.1)),
    "load": (load, (0.05,)),
    "play": (play, (0.005,)),
}
"""Each law, and where the fit of its own constants starts."""


def off_rad(law: Step, servos: Servos, own: FloatArray, trial: Trial) -> FloatArray:
    """Return simulated minus recorded angles [rad], shape [frames, 6]; a law's own constants have shape [count, 6]."""
    model, control = servos.model(trial.interval_s), commands(trial, servos.delay)
    data = mujoco.MjData(model)
    data.qpos[:] = trial.angles_rad[0]
    mujoco.mj_forward(model, data)
    angles = [trial.angles_rad[0]]
    for step, values in enumerate(control[: (len(trial.times_s) - 1) * SUBSTEPS]):
        data.ctrl[:] = values
        law(servos, own, model, data)
        mujoco.mj_step(model, data)
        if step % SUBSTEPS == SUBSTEPS - 1:
            angles.append(data.qpos.copy())
    return np.stack(angles) - trial.angles_rad


def fitted(
    law: Step, servos: Servos, own: FloatArray, fit: list[Trial]
) -> tuple[Servos, FloatArray]:
    """Return all constants after rounds of damped least squares; each joint keeps the step that improves it."""
    count = len(FIELDS) + len(own)
    steps = np.concatenate([STEPS, np.full(len(own), 0.1)])
    damping = np.full(6, 1e-2)

    def changed(
        now: Servos, own: FloatArray, moves: FloatArray
    ) -> tuple[Servos, FloatArray]:
        for k, field in enumerate(FIELDS):
            value = getattr(now, field)
            new = (
                np.clip(value + moves[k], 0.0, 0.2)
                if field == "delay"
                else value * np.exp(moves[k])
            )
            now = replace(now, **{field: new})
        return shared(now), own * np.exp(moves[len(FIELDS) :])

    def rows(now: Servos, own: FloatArray) -> FloatArray:
        moved = [
            (now, own),
            *(changed(now, own, np.outer(one, np.ones(6))) for one in np.diag(steps)),
        ]
        return np.stack(
            [
                np.concatenate([off_rad(law, *one, trial) for trial in fit])
                for one in moved
            ]
        )

    here = rows(servos, own)
    for _ in range(ROUNDS):
        slopes, cost = (
            (here[1:] - here[0]) / steps[:, None, None],
            np.square(here[0]).sum(axis=0),
        )
        moves = np.zeros((count, 6))
        for j in range(6):
            free = [k for k in range(count) if k or LOADED[j]]
            slope = slopes[free, :, j]
            normal = slope @ slope.T
            normal += damping[j] * np.diag(np.diag(normal) + 1e-9)
            moves[free, j] = -np.linalg.solve(normal, slope @ here[0][:, j])
        bounds = np.where(np.arange(count) == FIELDS.index("delay"), 0.02, 0.7)[:, None]
        tried, terms = changed(servos, own, np.clip(moves, -bounds, bounds))
        there = rows(tried, terms)
        better = np.square(there[0]).sum(axis=0) < cost
        damping = np.where(better, damping / 4.0, damping * 6.0)
        kept = {
            field: np.where(better, getattr(tried, field), getattr(servos, field))
            for field in FIELDS
        }
        servos, own = replace(servos, **kept), np.where(better, terms, own)
        here = np.where(better, there, here)
        print(
            1e3 * np.sqrt(np.square(here[0]).mean(axis=0)).round(5), better, flush=True
        )
    return servos, own


def main() -> None:
    """Fit each law on even motions, judge it on the odd ones, and write both errors and its own constants."""
    with (HERE / "so101_constants.csv").open(encoding="utf-8") as file:
        table = {
            (row["joint"], row["constant"]): float(row["value"])
            for row in csv.DictReader(file)
        }
    given = {
        field: np.array([table[joint, field] for joint in JOINTS]) for field in FIELDS
    }
    motions = trials("ServoArm-so101")
    fit, judge = [part(motions[0], 0.0, CHIRP_S), *motions[2::2]], motions[1::2]
    found = []
    for name, (law, starts) in LAWS.items():
        own = np.array([same(start) for start in starts]).reshape(-1, 6)
        servos, own = fitted(law, Servos(**given, kv=same(0.0)), own, fit)
        for half, some in (("fit", fit), ("judge", judge)):
            errors = np.concatenate(
                [off_rad(law, servos, own, trial) for trial in some]
            )
            found.append(
                (name, half, *map(float, 1e3 * np.sqrt(np.square(errors).mean(axis=0))))
            )
        found += [
            (name, f"constant {k + 1}", *map(float, values))
            for k, values in enumerate(own)
        ]
        print(name, found[-1])
        write("so101_terms.csv", ("law", "what", *JOINTS), found)


if __name__ == "__main__":
    main()
