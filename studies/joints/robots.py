"""Whether the interval of the next file holds for robots that are no servo arm: robots.csv.

    python -m studies.joints.robots WORLDS

Each world has four files of one joint, whose numbers scatter by 5 % between files; its load is 5 % off the model's.
Three files are fitted, and the true values of the fourth are sought in the intervals.
"""

import csv
import sys
import time

import mujoco
import numpy as np

from gauge_envs.backends import backend
from gauge_envs.tools.identify import Log, identify
from studies.joints.pendulums import HERE

ROBOTS = {
    "leg": ("0 1 0", "0 0 -.1", 0.35, "1.5e-3 1.5e-3 2e-4", (0.15, 25.0, 0.8, 0.008, 0.006), 0.7),
    "finger": ("1 0 0", "0 0 -.03", 0.04, "2e-5 2e-5 5e-6", (0.01, 1.2, 0.02, 0.02, 2e-4), 0.5),
    "wheel": ("0 0 1", ".01 0 0", 0.5, "1e-3 1e-3 1.6e-3", (0.03, 3.0, 0.12, 0.012, 1e-3), 2.0),
    "tilt": ("0 1 0", ".02 0 .03", 0.25, "2e-4 2e-4 2e-4", (0.02, 2.0, 0.06, 0.03, 5e-4), 0.6),
}  # fmt: skip
"""Axis, centre [m], mass [kg], inertia [kg m^2], numbers (those of `NAMES`, armature), largest command [rad]."""
NAMES = ("dry_friction_n_m", "kp_n_m_per_rad", "kv_n_m_s_per_rad", "delay_s")
XML = (
    '<mujoco><option timestep="{step}" integrator="implicitfast"/><worldbody><body><joint name="j" axis="{axis}" '
    'armature="{armature}" frictionloss="{dry}" solimpfriction="0.9999 0.9999 0.001" solreffriction="0.001 1"/>'
    '<inertial pos="{pos}" mass="{mass}" diaginertia="{inertia}"/></body></worldbody>{rest}</mujoco>'
)
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
    load = mass * (1.0 + random.choice([-0.05, 0.05]))
    place = {"axis": axis, "pos": pos, "inertia": inertia, "armature": law[4]}
    logs, truths = [], []
    for file in range(4):
        dry, kp, kv, delay_s = law[:4] * np.exp(SCATTER * random.standard_normal(4))
        servo = f'<actuator><position joint="j" kp="{kp}" kv="{kv}"/></actuator>'
        xml = XML.format(step=STEP_S, mass=load, dry=dry, rest=servo, **place)
        logs.append(logged(xml, delay_s, reach_rad, 10 * seed + file))
        truths.append((dry, kp, kv, delay_s))
    model = mujoco.MjSpec.from_string(
        XML.format(step=0.002, mass=mass, dry=0.0, rest="", **place)
    )
    start_s = time.process_time()
    found = identify(backend("mujoco"), model, logs[:3], NAMES).settings
    cpu_s = time.process_time() - start_s
    return [
        [robot, seed, one.name, f"{truth:.4g}", f"{one.value:.4g}", f"{one.next_low:.4g}", f"{one.next_high:.4g}",
         f"{one.low:.4g}", f"{one.high:.4g}", f"{cpu_s:.2f}"]
        for one, truth in zip(found, truths[3], strict=True)
    ]  # fmt: skip


if __name__ == "__main__":
    HEADER = "robot world setting fourth_file fitted next_low next_high fit_low fit_high cpu_s"
    with (HERE / "robots.csv").open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(HEADER.split())
        for world in range(int(sys.argv[1])):
            for name in ROBOTS:
                writer.writerows(rows_of(name, world))
