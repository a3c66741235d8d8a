"""Whether the interval of the next file holds for robots that are no servo arm: robots.csv, robots_held.csv.

    python -m studies.joints.robots WORLDS

Each world has four files of one joint, whose numbers scatter by 5 % between files; its load is 5 % off the model's.
Three files are fitted, at four times the step with which the files were made. In the intervals are sought what a fit of
the fourth file gives, and its true values.
"""

import csv
import sys
import time
from pathlib import Path

import mujoco
import numpy as np

from gauge_envs.backends import backend
from gauge_envs.tools.identify import Log, identify
from gauge_envs.tools.identify.spread import spread_of

HERE = Path(__file__).parent
ROBOTS = {
    "leg": ("0 1 0", "0 0 -.1", 0.35, "1.5e-3 1.5e-3 2e-4", (0.15, 25.0, 0.8, 0.008, 0.006), 0.7),
    "finger": ("1 0 0", "0 0 -.03", 0.04, "2e-5 2e-5 5e-6", (0.01, 1.2, 0.02, 0.02, 2e-4), 0.5),
    "wheel": ("0 0 1", ".01 0 0", 0.5, "1e-3 1e-3 1.6e-3", (0.03, 3.0, 0.12, 0.012, 1e-3), 2.0),
    "tilt": ("0 1 0", ".02 0 .03", 0.25, "2e-4 2e-4 2e-4", (0.02, 2.0, 0.06, 0.03, 5e-4), 0.6),
    "loop": ("0 1 0", "0 0 -.05", 0.2, "3e-4 3e-4 1e-4", (0.02, 3.0, 0.1, 0.015, 1e-3), 0.6),
}  # fmt: skip
"""Axis, centre [m], mass [kg], inertia [kg m^2], numbers (those of `NAMES`, armature), largest command [rad]."""
NAMES = ("dry_friction_n_m", "kp_n_m_per_rad", "kv_n_m_s_per_rad", "delay_s")
XML = (
    '<mujoco><option timestep="{step}" integrator="implicitfast"/><worldbody><body><joint name="j" axis="{axis}" '
    'armature="{armature}" frictionloss="{dry}" solimpfriction="0.9999 0.9999 0.001" solreffriction="0.001 1"/>'
    '<inertial pos="{pos}" mass="{mass}" diaginertia="{inertia}"/></body></worldbody>{rest}</mujoco>'
)
LOOP = (
    '<mujoco><option timestep="{step}" integrator="implicitfast"/><worldbody><body><joint name="j" axis="{axis}" '
    'armature="{armature}" frictionloss="{dry}" solimpfriction="0.9999 0.9999 0.001" solreffriction="0.001 1"/>'
    '<inertial pos="0 0 -.03" mass=".05" diaginertia="2e-5 2e-5 2e-6"/><body name="coupler" pos="0 0 -.06">'
    '<joint name="knee" axis="0 1 0"/><inertial pos=".05 0 0" mass=".05" diaginertia="2e-6 4e-5 4e-5"/></body></body>'
    '<body name="rocker" pos=".1 0 0"><joint name="rocker" axis="0 1 0"/>'
    '<inertial pos="{pos}" mass="{mass}" diaginertia="{inertia}"/></body></worldbody>'
    '<equality><connect body1="coupler" body2="rocker" anchor=".1 0 0"/></equality>{rest}</mujoco>'
)
"""A parallelogram, whose crank a servo turns and whose rocker carries the load."""
LOAD_ERROR, SEEN = 0.05, 6
SAMPLE_S, STEP_S, COUNT, SETTLE, NOISE_RAD, SCATTER = 0.02, 0.0005, 300, 50, 5e-4, 0.05


def logged(xml: str, delay_s: float, reach_rad: float, seed: int) -> Log:
    """Return a noisy log of random steps after a second at the first command."""
    random = np.random.default_rng(seed)
    command = np.repeat(random.uniform(-reach_rad, reach_rad, 15), 20)
    command[:20] = 0.0
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    angles = []
    for sample in range(-SETTLE, COUNT):
        if sample >= 0:
            angles.append(float(data.qpos[0]))
        for step in range(round(SAMPLE_S / STEP_S)):
            at_s = sample * SAMPLE_S + step * STEP_S - delay_s
            data.ctrl[0] = command[max(int(np.floor(at_s / SAMPLE_S + 1e-9)), 0)]
            mujoco.mj_step(model, data)
    measured = np.array(angles) + NOISE_RAD * random.standard_normal(COUNT)
    times_s = SAMPLE_S * np.arange(COUNT, dtype=np.float64)
    return Log(str(seed), times_s, measured[:, None], command[:, None], joints=("j",))


def rows_of(robot: str, seed: int) -> list[list[object]]:
    """Return a row for each number of a world."""
    axis, pos, mass, inertia, numbers, reach_rad = ROBOTS[robot]
    random = np.random.default_rng([seed, list(ROBOTS).index(robot)])
    law = np.array(numbers) * random.uniform(0.7, 1.4, 5)
    load = mass * (1.0 + random.choice([-LOAD_ERROR, LOAD_ERROR]))
    form = LOOP if robot == "loop" else XML
    place = {"axis": axis, "pos": pos, "inertia": inertia, "armature": law[4]}
    logs, truths = [], []
    for file in range(4):
        dry, kp, kv, delay_s = law[:4] * np.exp(SCATTER * random.standard_normal(4))
        servo = f'<actuator><position joint="j" kp="{kp}" kv="{kv}"/></actuator>'
        xml = form.format(step=STEP_S, mass=load, dry=dry, rest=servo, **place)
        logs.append(logged(xml, delay_s, reach_rad, 10 * seed + file))
        truths.append((dry, kp, kv, delay_s))
    model = mujoco.MjSpec.from_string(
        form.format(step=0.002, mass=mass, dry=0.0, rest="", **place)
    )
    start_s = time.process_time()
    engine = backend("mujoco")
    found = identify(engine, model, logs[:3], NAMES).settings
    cpu_s = time.process_time() - start_s
    fourth = identify(engine, model, logs[3:], NAMES).settings
    rows: list[list[object]] = []
    for one, next_one, truth in zip(found, fourth, truths[3], strict=True):
        values, stds = (np.array(list(x)) for x in (one.of_files, one.of_files_std))
        known = 0.0 if one.name == "delay_s" else LOAD_ERROR
        wide = spread_of(values, stds, known)
        ends = (
            *(truth, next_one.value, one.value, one.next_low, one.next_high),
            *(wide.low, wide.high, one.low, one.high),
        )
        rows.append(
            [robot, seed, half_of(seed), one.name, *map("{:.4g}".format, ends), f"{cpu_s:.1f}"]
        )  # fmt: skip
    return rows


def half_of(seed: int) -> str:
    """Return the half of a world: the first six showed why intervals miss, and the others judge."""
    return "seen" if seed < SEEN else "judge"


def counted() -> list[list[object]]:
    """Return how many values each interval of robots.csv holds, for each half and setting."""
    with (HERE / "robots.csv").open(encoding="utf-8", newline="") as stream:
        table = list(csv.DictReader(stream))
    rows: list[list[object]] = []
    for half in ("seen", "judge"):
        for name in (*NAMES, "all"):
            some = [
                one
                for one in table
                if one["half"] == half and name in (one["setting"], "all")
            ]
            shares: list[object] = [half, name, len(some)]
            for target in ("fourth_fit", "fourth_true"):
                for ends in ("next", "load", "fit"):
                    inside = [
                        float(one[f"{ends}_low"]) <= float(one[target]) <= float(one[f"{ends}_high"])
                        for one in some
                    ]  # fmt: skip
                    shares.append(sum(inside))
            rows.append(shares)
    return rows


if __name__ == "__main__":
    HEADER = (
        "robot world half setting fourth_true fourth_fit fitted next_low next_high load_low load_high fit_low fit_high "
        "cpu_s"
    )
    TABLE = HERE / "robots.csv"
    if not TABLE.is_file():
        TABLE.write_text(HEADER.replace(" ", ",") + "\n", encoding="utf-8")
    # Worlds in the table are done: a run goes on where one stopped.
    with TABLE.open("r+", encoding="utf-8", newline="") as stream:
        done = {(row["robot"], row["world"]) for row in csv.DictReader(stream)}
        writer = csv.writer(stream, lineterminator="\n")
        for world in range(int(sys.argv[1])):
            for name in ROBOTS:
                if (name, str(world)) not in done:
                    writer.writerows(rows_of(name, world))
                    stream.flush()
    HELD = (
        "half setting count fit_by_next fit_by_load fit_by_least_squares true_by_next true_by_load "
        "true_by_least_squares"
    )
    with (HERE / "robots_held.csv").open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(HELD.split())
        writer.writerows(counted())
