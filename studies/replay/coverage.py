"""Plant a cause, alone or beside one that is not fitted, and count how often its 95 % interval has the planted value.

Usage: `python studies/replay/coverage.py {alone,cause,outside} FIRST LAST`, with seeds FIRST to LAST - 1: the cause is
alone, or beside another cause, or beside what no cause is. Neither is fitted.
"""

from __future__ import annotations

import copy
import sys
import tempfile
from pathlib import Path

import numpy as np
from planted import NOISE, OUTSIDE, Robot, chain, record, same, with_cause, with_servos

from gauge_envs.backends.mujoco.messages import mujoco_warnings
from gauge_envs.tools.replay import LogMap, read_log
from gauge_envs.tools.replay.causes import candidates
from gauge_envs.tools.replay.constants import constant_values, fit_constants
from gauge_envs.tools.replay.model import Replayer, build_setup

FITTED = (
    "armature",
    "dry friction",
    "damping",
    "kp",
    "kd",
    "action scale",
    "action offset",
    "delay",
)
MAX_UNKNOWN = 0.5
"""Largest change of the motion by what is not fitted, over that by what is."""


def main() -> None:
    """Run the seeds, and print each cause with its error in half-widths, and the fraction inside of the intervals."""
    kind, first, last = sys.argv[1], *map(int, sys.argv[2:4])
    errors: list[float] = []
    for seed in range(first, last):
        try:
            found = errors_of(kind, seed)
        except ValueError as error:
            print(seed, error)
            continue
        errors += found
        sys.stdout.flush()
    inside = np.abs(errors) < 1.0
    print(f"{kind}: {inside.sum()} of {len(errors)}, {100.0 * inside.mean():.0f} %")
    print(f"median error {np.median(np.abs(errors)):.2f} half-widths")


def errors_of(kind: str, seed: int) -> list[float]:
    """Return fitted minus planted values of a seed, over the half-widths of their intervals."""
    rng = np.random.default_rng([seed, len(kind)])
    spec = with_servos(chain(rng), rng)
    plain = Robot(copy.copy(spec.compile()))
    name = FITTED[seed % len(FITTED)]
    robot, size = with_cause(name, plain, rng)
    planted, unknown = robot, "nothing"
    if kind != "alone":
        others = [other for other in FITTED if not same(name, other)]
        unknown = str(rng.choice([*OUTSIDE] if kind == "outside" else others))
        robot, _ = with_cause(unknown, robot, rng, 4.0 * NOISE, MAX_UNKNOWN * size)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "log.npz"
        joints = [joint.name for joint in spec.joints]
        np.savez(file, joints=joints, **record(robot, rng))
        log = read_log(file, joints, LogMap())
    truth, present = (build_setup(each.model, log) for each in (planted, plain))
    truth.scale[:], truth.offset[:] = planted.scale, planted.offset
    # A command acts from the next physics step on.
    truth.delay_s[:] = np.ceil(planted.delay_s / truth.step_s - 1e-6) * truth.step_s
    replayer = Replayer(log, plain.model)
    with mujoco_warnings():
        fit, _ = fit_constants([(replayer, present)], [name], ())
        causes = {each.name: each for each in candidates(replayer, truth)}
    found = []
    for value in constant_values(fit):
        place = [*causes[name].parameters].index(value.parameter.split(" of ")[-1])
        true = causes[name].present[place]
        # Nothing is planted at the other joints: their intervals count too.
        found.append((value.fitted - true) / (0.5 * (value.high - value.low)))
        print(
            f"{value.parameter} {true:.3g}, {value.low:.3g} to {value.high:.3g};",
            end=" ",
        )
    print(seed, name, "beside", unknown, *(f"{each:.2f}" for each in found))
    return found


if __name__ == "__main__":
    main()
