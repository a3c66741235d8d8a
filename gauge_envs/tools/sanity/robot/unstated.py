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
    states = {
        "rotor inertia": any(drive.armature for drive in driven),
        "torque limit": any(np.isfinite(drive.limit) for drive in driven),
        # Versions before MuJoCo 3.5 have no delay.
        "delay of actions": np.any(getattr(robot.model, "actuator_delay", 0.0)),
    }
    *first, last = [name for name, is_stated in states.items() if not is_stated] or [""]
    text = " or ".join(filter(None, [", ".join(first), last]))
    return text and f"The model states no {text}."
