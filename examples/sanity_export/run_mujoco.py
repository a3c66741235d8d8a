"""Run the scenes of `gauge sanity export DIR` in plain MuJoCo: python run_mujoco.py DIR [SCENE ...].

It needs MuJoCo, numpy and the folder alone. To check your own training, replace the options and the contact constants
of the model in `World` by yours.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import mujoco
import numpy as np


class World:
    """One scene in MuJoCo.

    Args:
        folder: Folder of the scene.
        scene: Its entry in the manifest.
    """

    def __init__(self, folder: Path, scene: dict[str, Any]) -> None:
        self.model = mujoco.MjModel.from_xml_path(str(folder / scene["mjcf"]))
        self.data = mujoco.MjData(self.model)
        if self.model.nkey:
            mujoco.mj_resetDataKeyframe(self.model, self.data, 0)

    @property
    def step_s(self) -> float:
        """Time step [s]."""
        return float(self.model.opt.timestep)

    def state(self, name: str) -> list[float]:
        """Return position [m], quaternion (w, x, y, z) and velocity [m/s] of a body."""
        model, data, velocity = self.model, self.data, np.empty(6)
        for update in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_comVel):
            update(model, data)
        body = model.body(name).id
        mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, body, velocity, 0)
        return [*data.xpos[body].tolist(), *data.xquat[body].tolist(), *velocity[3:].tolist()]

    def drive(self, name: str, numbers: list[float]) -> None:
        """Set pose (7), velocity (6) and acceleration (6) of a driven body, which has a free joint and a large mass."""
        pose, velocity, acceleration = np.split(np.array(numbers), [7, 13])
        joint = self.data.joint(name)
        joint.qpos = pose
        # MuJoCo has the angular velocity of a free joint in the body's frame.
        back = pose[3:] * [1.0, -1.0, -1.0, -1.0]
        mujoco.mju_rotVecQuat(velocity[3:], velocity[3:].copy(), back)
        joint.qvel = velocity
        self.data.body(name).xfrc_applied = self.model.body(name).mass * acceleration

    def step(self, count: int) -> None:
        """Simulate steps."""
        mujoco.mj_step(self.model, self.data, nstep=count)


if __name__ == "__main__":
    sys.path.insert(0, sys.argv[1])
    from gauge_loop import run

    run(sys.argv[1], World, only=sys.argv[2:])
