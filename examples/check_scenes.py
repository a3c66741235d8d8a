"""Run exported scenes of checks in plain MuJoCo, and write the motion in each as a CSV file beside it.

gauge backend check --export scenes
python examples/check_scenes/run_in_mujoco.py scenes
gauge backend check --judge scenes
"""

import csv
import json
import sys
from pathlib import Path

import mujoco
import numpy as np

STATE = ("x", "y", "z", "qw", "qx", "qy", "qz", "vx", "vy", "vz", "wx", "wy", "wz")


def driven_rows(model, bodies):
    """Return rows of `qpos`, `qvel` and `xfrc_applied` before each interval, by driven body."""
    names = {f"driver/{body}": body for body in bodies}
    rows = {}
    for index in range(model.nnumeric):
        numeric = model.numeric(index)
        if numeric.name in names:
            rows[names[numeric.name]] = numeric.data.reshape(-1, 19)
    return rows


def state(model, data, body):
    """Return position, quaternion, velocity of the origin and angular velocity of a body in the world frame."""
    velocity = np.empty(6)
    index = model.body(body).id
    mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, index, velocity, 0)
    return [*data.xpos[index], *data.xquat[index], *velocity[3:], *velocity[:3]]


def motion(path, run):
    """Yield the rows of the motion in a scene."""
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    for body, wrench in run["wrenches"].items():
        data.body(body).xfrc_applied[:] = wrench
    rows = driven_rows(model, run["bodies"])
    steps = round(run["interval_s"] / model.opt.timestep)
    for sample in range(run["samples"]):
        for stage in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_comVel):
            stage(model, data)
        for body in run["bodies"]:
            yield [sample * run["interval_s"], body, *state(model, data, body)]
        for body, table in rows.items():
            row = table[min(sample, len(table) - 1)]
            data.joint(body).qpos[:], data.joint(body).qvel[:] = row[:7], row[7:13]
            data.body(body).xfrc_applied[:] = row[13:]
        mujoco.mj_step(model, data, nstep=steps)


def run_all(folder):
    """Run all scenes of a folder."""
    runs = json.loads((folder / "checks.json").read_text())["runs"]
    for name, run in runs.items():
        with (folder / f"{name}.csv").open("w", newline="") as stream:
            writer = csv.writer(stream)
            writer.writerow(["time_s", "body", *STATE])
            writer.writerows(motion(folder / f"{name}.xml", run))


if __name__ == "__main__":
    run_all(Path(sys.argv[1]))
