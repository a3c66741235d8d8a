"""Every log of the package in one table: its law, what files differ by, errors beside plain laws, and sensor noise.

    python -m studies.joints.every_log

Writes logs.csv and the table of the README. Laws are chosen on even files and reported on all; errors of odd ones are
predictions from their recorded starts. Other scripts of this study write the constants of machines with many joints.
"""

import csv
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from gauge_envs.backends import backend
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.identify import Identified, Log, identify, one_joint, read_log
from gauge_envs.tools.identify.baselines import baselines
from gauge_envs.tools.identify.spread import sensor_noise_rad
from studies.joints.arm import logs, pasted, replayed
from studies.joints.recordings import HERE, Trial, trials

HEADER = ("log", "half", "law", "between files", "error [mrad]", "plain law [mrad]", "sensor noise [mrad]")  # fmt: skip
START, END = (
    "<!-- logs, written by studies.joints.every_log -->",
    "<!-- end of logs -->",
)
EXAMPLE = Path("examples/joint_swing.csv")
SHORT = {
    "dry_friction_n_m": ("dry", 1e3, "mN m"),
    "viscous_friction_n_m_s_per_rad": ("viscous", 1e3, "mN m s"),
    "quadratic_friction_n_m_s2_per_rad2": ("drag", 1e6, "uN m s^2"),
}
"""Short name of a number, factor and unit."""
MASS_KG, LENGTH_M, INERTIA_KG_M2 = 0.147585, 0.147755, 1e-4
"""Load as the authors state it; the inertia is less than theirs, so that the armature can make it up."""
Row = tuple[str, ...]


def _log(trial: Trial) -> Log:
    rates = np.gradient(trial.angles_rad, trial.interval_s, axis=0, edge_order=2)
    rates[0] = trial.start_rates
    return Log(
        trial.name, trial.times_s, trial.angles_rad, trial.commands, rate_rad_per_s=rates
    )  # fmt: skip


def table(name: str) -> list[dict[str, str]]:
    """Return a table of this study."""
    with (HERE / name).open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def ends_of(found: Identified) -> str:
    """Return the interval of the next file of each number of friction; "one file" without several."""
    shown = []
    for one in found.settings:
        if one.name in SHORT and len(one.of_files):
            name, factor, unit = SHORT[one.name]
            shown.append(
                f"{name} {factor * one.next_low:.3g} to {factor * one.next_high:.3g} {unit}"
            )
    return "; ".join(shown) or "one file"


def pendulum(title: str, logs: Sequence[Log], *, spread: bool) -> Iterator[Row]:
    """Yield the rows of a pendulum of one joint, whose law is chosen on its even files."""
    engine, scene = backend("mujoco"), one_joint(MASS_KG, LENGTH_M, INERTIA_KG_M2)
    even = identify(engine, scene, logs[::2], held_out=logs[1::2])
    everything = even
    if spread:
        names = [one.name for one in even.settings]
        everything = identify(engine, scene, logs, names)
    errors = even.error_rad | even.held_out_rad
    for place, log in enumerate(logs):
        plain = {"constant": log.position_rad.std(), "cosine": even.plain_rad[log.name]["cosine"][0]}  # fmt: skip
        best = min(plain, key=lambda law: float(plain[law]))
        yield (
            f"{title} {place}",
            "odd" if place % 2 else "even",
            even.laws[0].name,
            ends_of(everything),
            f"{1e3 * float(errors[log.name][0]):.2g}",
            f"{best} {1e3 * float(plain[best]):.3g}",
            f"{1e3 * float(even.noise_rad[0]):.2g}",
        )


def noise_mrad(angles_rad: FloatArray) -> str:
    """Return the noise of the sensors of some joints [mrad], from third differences, which fast motions raise."""
    found = [1e3 * sensor_noise_rad(column) for column in angles_rad.T]
    return f"{min(found):.2g} to {max(found):.2g}"


def chains() -> Iterator[Row]:
    """Yield the rows of both driven and free pendulums of two joints."""
    pieces = [one for one in table("double_pieces.csv") if one["time_s"] == "2.5"]
    recorded = trials("DoublePendulum-bars")
    for half, used in (("even", "fit"), ("odd", "judge")):
        errors = [float(one["error_mrad"]) for one in pieces if one["half"] == used]
        some = recorded[half == "odd" :: 2]
        motion = [1e3 * float(one.angles_rad.std(axis=0).max()) for one in some]
        yield (
            f"DoublePendulum-bars, {len(errors)} pieces", half, "viscous", "13 pieces: double_pieces.csv",
            f"{min(errors):.2g} to {max(errors):.2g} after 2.5 s", f"constant {min(motion):.3g} to {max(motion):.3g}",
            noise_mrad(some[0].angles_rad),
        )  # fmt: skip
    runs = {one.name: one for one in trials("TorquePendulum-ak80")}
    values = [1e3 * float(one["dry_n_m"]) for one in table("torque_runs.csv")]
    for one in table("torque_errors.csv"):
        run = runs[one["run"]]
        yield (
            f"TorquePendulum, {one['run']}", "odd" if one["half"] == "judge" else "even", "dry and viscous",
            f"dry {min(values):.3g} to {max(values):.3g} mN m in single runs", f"{one['after_2_s_mrad']} after 2 s",
            f"constant {1e3 * float(run.angles_rad.std()):.3g}", noise_mrad(run.angles_rad),
        )  # fmt: skip


def arm() -> Iterator[Row]:
    """Yield the rows of the servo arm: the range of six joints."""
    motions = logs()
    plain = baselines(motions[::2], motions[1::2])
    errors_rad = replayed(pasted(), motions)
    dry = [one for one in table("arm_constants.csv") if one["constant"] == "dry_friction_n_m"]  # fmt: skip
    spread = ", ".join(f"{float(one['next_low']):.2g} to {float(one['next_high']):.2g}" for one in dry)  # fmt: skip
    for place, log in enumerate(motions):
        lag = 1e3 * plain[log.name]["lag"]
        yield (
            f"ServoArm-so101, {log.name}", "odd" if place % 2 else "even", "M1 with a servo",
            f"dry {spread} N m", " ".join(f"{1e3 * value:.2g}" for value in errors_rad[log.name]),
            f"lag {' '.join(f'{value:.2g}' for value in lag)}", noise_mrad(log.position_rad),
        )  # fmt: skip


def main() -> None:
    """Write the table."""
    rows = [
        *pendulum("JointPendulum-dry", [_log(one) for one in trials("JointPendulum-dry")], spread=True),
        *pendulum("JointPendulum-viscous", [_log(one) for one in trials("JointPendulum-viscous")], spread=True),
        *pendulum(str(EXAMPLE), [read_log(EXAMPLE)], spread=False),
        *chains(),
        *arm(),
    ]  # fmt: skip
    with (HERE / "logs.csv").open("w", encoding="utf-8", newline="") as stream:
        csv.writer(stream, lineterminator="\n").writerows([HEADER, *rows])
    lines = [f"| {' | '.join(one)} |" for one in (HEADER, ["---"] * len(HEADER), *rows)]
    readme = HERE / "README.md"
    before, _, rest = readme.read_text(encoding="utf-8").partition(START)
    after = rest.partition(END)[2]
    text = "\n".join([f"{before}{START}\n", *lines, f"\n{END}{after}"])
    readme.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
