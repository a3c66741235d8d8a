"""How often the law of friction that is chosen is the true one: choice.csv.

    python -m studies.joints.choice FIRST LAST

The five robots of `robots` swing or spin freely, with one to three files, whose numbers scatter by 5 %. A swing loses 6
to 20 % of its amplitude in the first half swing, by terms of friction of like shares. Beside the choice: the law that
predicts best, and the one with the fewest terms of those that fit within 5 % of the best.
"""

import csv
import sys
from pathlib import Path

import mujoco
import numpy as np

from gauge_envs.backends import backend
from gauge_envs.tools.identify import Log, identify
from gauge_envs.tools.identify.laws import AS_GOOD, LAWS
from studies.joints.robots import LOOP, ROBOTS, STEP_S, XML

FILE = Path(__file__).parent / "choice.csv"
HEADER = ("robot", "world", "files", "true", "chosen", "best_prediction", "best_fit")
TRUE = {
    "dry": (1, 0, 0),
    "viscous": (0, 1, 0),
    "dry and viscous": (1, 1, 0),
    "dry and quadratic": (1, 0, 1),
    "dry, viscous and quadratic": (1, 1, 1),
}
"""Whether a law has dry, viscous and quadratic friction."""


def rest_and_stiffness(
    model: mujoco.MjModel, moved: np.ndarray
) -> tuple[float, float, float]:
    """Return the angle at rest [rad], the weight's stiffness [N m/rad] and the inertia [kg m^2] of a joint."""
    data = mujoco.MjData(model)
    grid = np.linspace(-np.pi, np.pi, 721)
    heights = []
    for angle in grid:
        data.qpos[:] = angle * moved
        mujoco.mj_forward(model, data)
        heights.append(float(np.sum(model.body_mass * data.xipos[:, 2])))
    rest = float(grid[int(np.argmin(heights))]) if np.ptp(heights) > 1e-9 else 0.0
    torques = []
    for angle in (rest + 1e-3, rest - 1e-3):
        data.qpos[:] = angle * moved
        mujoco.mj_forward(model, data)
        torques.append(float(data.qfrc_bias @ moved))
    momentum = np.zeros(model.nv)
    mujoco.mj_mulM(model, data, momentum, moved)
    return rest, max((torques[0] - torques[1]) / 2e-3, 0.0), float(momentum @ moved)


def world(robot: str, seed: int) -> tuple[str, list[Log], mujoco.MjSpec]:
    """Return the true law, the logs and the model of a world."""
    axis, pos, mass, inertia, numbers, _ = ROBOTS[robot]
    random = np.random.default_rng([seed, list(ROBOTS).index(robot), 77])
    law = list(TRUE)[random.integers(5)]
    form = LOOP if robot == "loop" else XML
    place = {"axis": axis, "pos": pos, "inertia": inertia, "mass": mass}
    xml = {"dry": 0.0, "rest": "", "armature": numbers[4], **place}
    model = mujoco.MjModel.from_xml_string(form.format(step=STEP_S, **xml))
    # In the parallelogram the coupler turns back.
    moved = np.array([1.0, -1.0, 1.0] if robot == "loop" else [1.0])
    rest, stiffness, about_joint = rest_and_stiffness(model, moved)
    noise_rad = 10 ** random.uniform(-4, -3.3)
    share = random.uniform(0.3, 1.0, 3) * np.array(TRUE[law])
    share /= share.sum()
    loss = random.uniform(0.06, 0.2)
    # By swings of 0.9 rad, or a spin of 12 rad/s that ends after 6 s.
    is_swing = stiffness > 1e-6
    if is_swing:
        root = np.sqrt(stiffness * about_joint)
        torques = [0.45 * stiffness, 2.0 * root / np.pi, 3.0 * about_joint / 3.6]
        friction = loss * share * torques
    else:
        friction = share * about_joint * 2.0 / np.array([1.0, 12.0, 144.0])
    logs = []
    for file in range(1 + seed % 3):
        scatter = np.exp(0.05 * random.standard_normal(3))
        start, rate, duration_s = 0.0, 0.0, 5.0
        if is_swing:
            start = random.uniform(0.5, 1.2)
            duration_s = min(12.0 * np.pi * np.sqrt(about_joint / stiffness), 6.0)
        else:
            rate = random.uniform(8, 16)
        dry, viscous, drag = friction * scatter
        model.dof_frictionloss[0], model.dof_damping[0] = dry, viscous
        model.dof_dampingpoly[0, 0] = drag
        mujoco.mj_setConst(model, mujoco.MjData(model))
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:] = (rest + start) * moved, rate * moved
        every = round(max(0.01, duration_s / 500) / STEP_S)
        count = int(duration_s / (every * STEP_S))
        angles = []
        for _ in range(count):
            angles.append(float(data.qpos[0]))
            mujoco.mj_step(model, data, nstep=every)
        measured = np.array(angles) + noise_rad * random.standard_normal(count)
        times_s = every * STEP_S * np.arange(count)
        logs.append(Log(str(file), times_s, measured[:, None], joints=("j",)))
    return law, logs, mujoco.MjSpec.from_string(form.format(step=0.002, **xml))


if __name__ == "__main__":
    if not FILE.is_file():
        FILE.write_text(",".join(HEADER) + "\n", encoding="utf-8")
    with FILE.open("a", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        for number in range(int(sys.argv[1]), int(sys.argv[2])):
            for name in ROBOTS:
                true, files, spec = world(name, number)
                laws = identify(backend("mujoco"), spec, files).laws
                best = min(laws, key=lambda law: law.held_out_rad).name
                least = AS_GOOD * min(law.fitted_rad for law in laws)
                near = [law for law in laws if law.fitted_rad <= least]
                fits = min(near, key=lambda law: (len(LAWS[law.name]), law.fitted_rad))
                writer.writerow([name, number, len(files), true, laws[0].name, best, fits.name])  # fmt: skip
                stream.flush()
