"""Elements of MJCF that were printed, pasted into a model."""

from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np

ELEMENTS = {"frictionloss": "frictionloss", "damping": "damping", "armature": "armature",
            "solimpfriction": "solimp_friction", "solreffriction": "solref_friction"}  # fmt: skip
"""Attributes of `<joint>` that lines may set, and their fields in an `MjsJoint`."""

JOINT = mujoco.mjtTrn.mjTRN_JOINT


def paste(spec: mujoco.MjSpec, lines: str) -> mujoco.MjSpec:
    """Return the model with elements `<joint>` and `<position>`; the first actuator at a joint becomes its servo."""
    for element in ElementTree.fromstring(f"<mujoco>{lines}</mujoco>"):
        values = dict(element.attrib)
        if element.tag == "joint":
            joint = spec.joint(values.pop("name"))
            for name, text in values.items():
                _write(joint, ELEMENTS[name], text)
        elif element.tag == "position":
            target, gains = values["joint"], [float(values["kp"]), float(values["kv"])]
            at_joint = (one for one in spec.actuators if one.trntype == JOINT)
            motor = next((one for one in at_joint if one.target == target), None)
            if motor is None:
                motor = spec.add_actuator(name=f"{target}_servo", target=target, trntype=JOINT)  # fmt: skip
            if motor.biastype != mujoco.mjtBias.mjBIAS_AFFINE:
                # Its range was one of torques.
                motor.ctrllimited = mujoco.mjtLimited.mjLIMITED_FALSE
            # A torque is the force times the gear, and an angle times the gear is what the motor sees.
            gear = float(motor.gear[0])
            kp, kv = (one / gear**2 for one in gains)
            motor.set_to_position(kp=kp, kv=kv)
            for name in {"delay", "nsample", "interp"} & {*values}:
                _write(motor, name, values[name])
            if "forcerange" in values:
                limit = float(values["forcerange"].split()[1]) / abs(gear)
                motor.forcerange = [-limit, limit]
                motor.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
    return spec


def _write(element: Any, name: str, text: str) -> None:
    """Write an attribute of MJCF into a field of an `MjSpec`."""
    if name == "interp":
        element.interp = ("zoh", "linear", "cubic").index(text)
        return
    numbers = [float(one) for one in text.split()]
    before = getattr(element, name)
    if isinstance(before, int):
        setattr(element, name, int(numbers[0]))
    elif np.ndim(before) == 0:
        setattr(element, name, numbers[0])
    else:
        before[: len(numbers)] = numbers
