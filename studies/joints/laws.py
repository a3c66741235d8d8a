"""Laws of friction of the second pendulum, chosen on its even pieces, and what plain laws miss of the SO-101.

    python -m studies.joints.laws

Writes laws.csv, law_values.csv, law_errors.csv, and the rows of the plain laws in so101_judged.csv.
"""

import csv
from collections.abc import Iterable, Sequence

import numpy as np

from gauge_envs.backends import backend
from gauge_envs.tools.identify import Log, identify, one_joint
from gauge_envs.tools.identify.baselines import baselines
from studies.joints.pendulums import HERE, Trial, trials

TITLES = {"command": "angle = command", "lag": "lag", "constant": "constant"}
MASS_KG, LENGTH_M, INERTIA_KG_M2 = 0.147585, 0.147755, 1e-4
"""Load as the authors state it; the inertia is less than theirs, so that the armature can make it up."""


def _log(trial: Trial) -> Log:
    rates = np.gradient(trial.angles_rad, trial.interval_s, axis=0, edge_order=2)
    rates[0] = trial.start_rates
    return Log(
        trial.name, trial.times_s, trial.angles_rad, trial.commands, rate_rad_per_s=rates
    )  # fmt: skip


def _write(name: str, rows: Iterable[Sequence[str | float | None]]) -> None:
    with (HERE / name).open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        for row in rows:
            writer.writerow(
                [one if isinstance(one, str) else f"{one:.4g}" for one in row]
            )


def pendulum() -> None:
    """Compare laws on even pieces, predict the odd ones from their recorded starts, and fit all pieces."""
    logs = [_log(one) for one in trials("JointPendulum-viscous")]
    engine, scene = backend("mujoco"), one_joint(MASS_KG, LENGTH_M, INERTIA_KG_M2)
    even = identify(engine, scene, logs[::2], held_out=logs[1::2])
    laws = [
        (one.name, 1e3 * one.fitted_rad, 1e3 * one.held_out_rad) for one in even.laws
    ]
    _write("laws.csv", [("law", "fitted_mrad", "other_even_piece_mrad"), *laws])
    errors = [
        (
            used,
            name,
            1e3 * float(error[0]),
            1e3 * float(even.plain_rad[name]["cosine"][0]),
            1e3 * float(even.motion_rad[name][0]),
        )
        for used, found in (("even", even.error_rad), ("odd", even.held_out_rad))
        for name, error in found.items()
    ]
    noise = ("sensor", "noise", 1e3 * float(even.noise_rad[0]), "", "")
    plain = ("decaying_cosine_mrad", "constant_mrad")
    header = ("half", "piece", "error_mrad", *plain)
    _write("law_errors.csv", [header, *errors, noise])
    names = [one.name for one in even.settings]
    values = [
        (one.name, one.value, one.next_low, one.next_high, one.low, one.high, *one.of_files)
        for one in identify(engine, scene, logs, names).settings
    ]  # fmt: skip
    ends = ("next_low", "next_high", "fit_low", "fit_high")
    _write(
        "law_values.csv",
        [("name", "value", *ends, *(log.name for log in logs)), *values],
    )


def arm() -> None:
    """Replace the rows of the plain laws: errors over all samples of the odd motions [mrad]."""
    logs = [
        Log(one.name, one.times_s, one.angles_rad, one.commands)
        for one in trials("ServoArm-so101")
    ]
    errors = baselines(logs[::2], logs[1::2])
    for log in logs:
        errors[log.name]["constant"] = log.position_rad.std(axis=0)
    counts = [len(log.times_s) for log in logs[1::2]]
    path = HERE / "so101_judged.csv"
    with path.open(encoding="utf-8", newline="") as stream:
        rows: list[Sequence[str | float | None]] = [
            row for row in csv.reader(stream) if row[0] not in TITLES.values()
        ]
    for law, title in TITLES.items():
        squares = [errors[log.name][law] ** 2 for log in logs[1::2]]
        pooled_mrad = 1e3 * np.sqrt(np.average(squares, axis=0, weights=counts))
        rows.append([title, *map(float, pooled_mrad)])
    _write("so101_judged.csv", rows)


if __name__ == "__main__":
    arm()
    pendulum()
