"""Whether the interval of the next file holds for robots that are no servo arm: robots.csv, robots_held.csv.

    python -m studies.joints.robots FIRST END SECONDS

Each world has four files of one joint, whose numbers scatter by 5 % between files; its load is 5 % off the model's.
Three files are fitted, at four times the step with which the files were made. In the intervals are sought what a fit of
the fourth file gives, and its true values. The plain baseline is SciPy's least squares over MuJoCo, each file alone
from the robot's own numbers: mean and 1.96 standard deviations of the files. A run goes on where one stopped, and
starts no world after SECONDS.
"""

import csv
import sys
import time
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from gauge_envs.backends import backend
from gauge_envs.tools.identify import Log, identify
from gauge_envs.tools.identify.spread import NORMAL_95, spread_of

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
LOAD_ERROR, FIT_STEP_S = 0.05, 0.002
SAMPLE_S, STEP_S, COUNT, SETTLE, NOISE_RAD, SCATTER = 0.02, 0.0005, 300, 50, 5e-4, 0.05


def simulated(
    xml: str, step_s: float, delay_s: float, command_rad: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the angles [rad] of a log, shape [N], after a second at the first command; a delay is part of a step."""
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    held_rad = np.concatenate((np.full(SETTLE + 1, command_rad[0]), command_rad))
    edges_s = SAMPLE_S * np.arange(-SETTLE - 1, len(command_rad) + 1)
    integral = np.concatenate(([0.0], np.cumsum(SAMPLE_S * held_rad)))
    steps = round(SAMPLE_S / step_s)
    at_s = step_s * np.arange(-SETTLE * steps, len(command_rad) * steps + 1) - delay_s
    controls_rad = np.diff(np.interp(at_s, edges_s, integral)) / step_s
    angles = []
    for step, control_rad in enumerate(controls_rad):
        if step % steps == 0:
            angles.append(float(data.qpos[0]))
        data.ctrl[0] = control_rad
        mujoco.mj_step(model, data)
    return np.array(angles[SETTLE:])


def world_xml(
    robot: str,
    step_s: float,
    mass_kg: float,
    armature: float,
    numbers: NDArray[np.float64],
) -> str:
    """Return the MJCF of a robot with its numbers, those of `NAMES`."""
    axis, pos, _, inertia, _, _ = ROBOTS[robot]
    dry, kp, kv, _ = numbers
    rest = (
        f'<actuator><position joint="j" kp="{kp}" kv="{kv}"/></actuator>' if kp else ""
    )
    form = LOOP if robot == "loop" else XML
    return form.format(
        step=step_s,
        mass=mass_kg,
        axis=axis,
        pos=pos,
        inertia=inertia,
        armature=armature,
        dry=dry,
        rest=rest,
    )


def plain_fit(robot: str, armature: float, log: Log) -> NDArray[np.float64]:
    """Return the numbers of a log by SciPy, which starts at those of `ROBOTS`."""
    _, _, mass_kg, _, own, _ = ROBOTS[robot]
    start = np.array(own[:4])
    command_rad, measured_rad = log.command_rad[:, 0], log.position_rad[:, 0]

    def missed_rad(scaled: NDArray[np.float64]) -> NDArray[np.float64]:
        numbers = start * scaled
        xml = world_xml(robot, FIT_STEP_S, mass_kg, armature, numbers)
        return simulated(xml, FIT_STEP_S, numbers[3], command_rad) - measured_rad

    found = least_squares(
        missed_rad, np.ones(4), bounds=(0.01, 10.0), diff_step=1e-3, max_nfev=30
    )
    return start * found.x


def rows_of(robot: str, seed: int) -> list[list[object]]:
    """Return a row for each number of a world."""
    mass_kg, own, reach_rad = (ROBOTS[robot][place] for place in (2, 4, 5))
    random = np.random.default_rng([seed, list(ROBOTS).index(robot)])
    law = np.array(own) * random.uniform(0.7, 1.4, 5)
    load_kg = mass_kg * (1.0 + random.choice([-LOAD_ERROR, LOAD_ERROR]))
    times_s = SAMPLE_S * np.arange(COUNT, dtype=np.float64)
    logs, truths = [], []
    for file in range(4):
        numbers = law[:4] * np.exp(SCATTER * random.standard_normal(4))
        command_rad = np.repeat(random.uniform(-reach_rad, reach_rad, 15), 20)
        command_rad[:20] = 0.0
        xml = world_xml(robot, STEP_S, load_kg, law[4], numbers)
        angles_rad = simulated(xml, STEP_S, numbers[3], command_rad)
        angles_rad += NOISE_RAD * random.standard_normal(COUNT)
        logs.append(
            Log(
                str(file),
                times_s,
                angles_rad[:, None],
                command_rad[:, None],
                joints=("j",),
            )
        )
        truths.append(numbers)
    model = mujoco.MjSpec.from_string(
        world_xml(robot, FIT_STEP_S, mass_kg, law[4], np.zeros(4))
    )
    engine = backend("mujoco")
    start_s = time.process_time()
    found = identify(engine, model, logs[:3], NAMES).settings
    fitted_s = time.process_time()
    plain = np.array([plain_fit(robot, law[4], log) for log in logs[:3]])
    plain_s = time.process_time() - fitted_s
    plain_mean, plain_half = plain.mean(axis=0), NORMAL_95 * plain.std(axis=0, ddof=1)
    fourth = identify(engine, model, logs[3:], NAMES).settings
    rows: list[list[object]] = []
    for place, one in enumerate(found):
        values, stds = np.array(one.of_files), np.array(one.of_files_std)
        wide = spread_of(values, stds, 0.0 if one.name == "delay_s" else LOAD_ERROR)
        ends = (
            *(
                truths[3][place],
                fourth[place].value,
                one.value,
                one.next_low,
                one.next_high,
            ),
            *(wide.low, wide.high, one.low, one.high),
            *(
                plain_mean[place] - plain_half[place],
                plain_mean[place] + plain_half[place],
            ),
        )
        seconds = fitted_s - start_s, plain_s
        rows.append(
            [
                robot,
                seed,
                one.name,
                *map("{:.4g}".format, ends),
                *map("{:.1f}".format, seconds),
            ]
        )
    return rows


def counted() -> list[list[object]]:
    """Return how many values each interval of robots.csv holds, of each robot and setting, and mean CPU seconds."""
    with (HERE / "robots.csv").open(encoding="utf-8", newline="") as stream:
        table = list(csv.DictReader(stream))
    rows: list[list[object]] = []
    for key in (*ROBOTS, *NAMES, ""):
        some = [one for one in table if key in (one["robot"], one["setting"], "")]
        shares: list[object] = [key or "all", len(some)]
        for target in ("fourth_fit", "fourth_true"):
            for ends in ("next", "load", "fit", "plain"):
                shares.append(
                    sum(
                        float(one[f"{ends}_low"])
                        <= float(one[target])
                        <= float(one[f"{ends}_high"])
                        for one in some
                    )
                )
        for column in ("cpu_s", "plain_cpu_s"):
            shares.append(f"{np.mean([float(one[column]) for one in some]):.2f}")
        rows.append(shares)
    return rows


if __name__ == "__main__":
    first, end, limit_s = (int(one) for one in sys.argv[1:])
    stop_s = time.monotonic() + limit_s
    TABLE = HERE / "robots.csv"
    if not TABLE.is_file():
        HEADER = (
            "robot world setting fourth_true fourth_fit fitted next_low next_high load_low load_high fit_low fit_high "
            "plain_low plain_high cpu_s plain_cpu_s"
        )
        TABLE.write_text(HEADER.replace(" ", ",") + "\n", encoding="utf-8")
    with TABLE.open("r+", encoding="utf-8", newline="") as stream:
        done = {(row["robot"], row["world"]) for row in csv.DictReader(stream)}
        writer = csv.writer(stream, lineterminator="\n")
        for world in range(first, end):
            for name in ROBOTS:
                if (name, str(world)) not in done and time.monotonic() < stop_s:
                    writer.writerows(rows_of(name, world))
                    stream.flush()
    HELD = "of count"
    for target in ("fit", "true"):
        for ends in ("next", "load", "least_squares", "plain"):
            HELD += f" {target}_by_{ends}"
    HELD += " cpu_s plain_cpu_s"
    with (HERE / "robots_held.csv").open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(HELD.split())
        writer.writerows(counted())
