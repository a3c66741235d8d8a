"""Say what a model of a robot leaves unstated."""

import numpy as np

from gauge_envs.tools.sanity.robot.joints import drives
from gauge_envs.tools.sanity.robot.robot import Robot


def unstated(robot: Robot) -> str:
    """Return what a robot with motors does not state, in one sentence; empty where nothing is missing.

    These are properties of real drives, without which a policy meets a better robot than the real one.
    """
    driven = drives(robot)
    if not driven:
        return ""
    missing = []
    if not any(drive.armature for drive in driven):
        missing.append("rotor inertia")
    if not any(np.isfinite(drive.limit) for drive in driven):
        missing.append("torque limit")
    # Versions before MuJoCo 3.5 have no delay.
    if not np.any(getattr(robot.model, "actuator_delay", 0.0)):
        missing.append("delay of actions")
    if not missing:
        return ""
    text = " or ".join(filter(None, [", ".join(missing[:-1]), missing[-1]]))
    return f"The model states no {text}."
