"""Files with identified numbers: the model that was given, mended, and a log as `mujoco.sysid` reads it."""

import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np

from gauge_envs.errors import ParameterError
from gauge_envs.experiments.scene_source import read_bytes
from gauge_envs.tools.identify.identified import Identified
from gauge_envs.tools.identify.logs import Log
from gauge_envs.tools.identify.paste import paste
from gauge_envs.tools.identify.stack_logs import CONTROL, SENSED

SENSOR, CONTROLLED = 0, 5
"""Kinds of signals in `mujoco.sysid.SignalType`: those of sensors and of controls."""
IN_URDF = {
    "damping": "viscous_friction_n_m_s_per_rad",
    "friction": "dry_friction_n_m",
}
"""Attributes of `<dynamics>`, and the numbers that they state."""


def mended_mjcf(spec: mujoco.MjSpec, found: Identified) -> mujoco.MjSpec:
    """Return a model with the pasted lines; what no attribute states is in its comment."""
    lines = found.lines.splitlines()
    spec = paste(spec.copy(), "\n".join(one for one in lines if "<!--" not in one))
    notes = [one[5:-4] for one in lines if "<!--" in one]
    spec.comment = "\n".join([spec.comment, *notes]).strip()
    return spec


def place_assets(spec: mujoco.MjSpec, folder: Path) -> None:
    """Let a model that is written into another folder find its meshes, height fields and textures."""
    kinds = {"meshdir": (*spec.meshes, *spec.hfields), "texturedir": spec.textures}
    for name, assets in kinds.items():
        if any(one.file for one in assets):
            before = Path(spec.modelfiledir) / getattr(spec, name)
            if not Path(getattr(spec, name)).is_absolute():
                setattr(spec, name, os.path.relpath(before, folder))
    # A model is compiled as it is written, and its folders count from this one.
    spec.modelfiledir = str(folder.resolve())


def mended_urdf(
    text: str, found: Identified, before: Path = Path(), after: Path = Path()
) -> str:
    """Return a URDF with friction and limits of effort; a comment has the numbers that URDF does not know.

    Args:
        text: The URDF.
        found: What was identified.
        before: Folder from which its relative file names count.
        after: Folder from which they count in what is returned.
    """
    builder = ElementTree.TreeBuilder(insert_comments=True)
    root = ElementTree.fromstring(text, ElementTree.XMLParser(target=builder))
    for mesh in root.iterfind(".//mesh"):
        name = mesh.get("filename", "")
        if "://" not in name and not Path(name).is_absolute():
            mesh.set("filename", os.path.relpath(before / name, after))
    for name, numbers in zip(found.names, found.joints, strict=True):
        (joint,) = root.iterfind(f"joint[@name='{name}']")
        left = {key: f"{value:.5g}" for key, value in numbers.items() if value}
        for tag, keys in {
            "dynamics": IN_URDF,
            "limit": {"effort": "torque_limit_n_m"},
        }.items():
            stated = {key: left.pop(one) for key, one in keys.items() if one in left}
            if stated:
                element = joint.find(tag)
                element = ElementTree.SubElement(joint, tag) if element is None else element  # fmt: skip
                element.attrib.update(stated)
        rest = ", ".join(f"{key} = {value}" for key, value in left.items())
        joint.append(ElementTree.Comment(f" URDF does not state {rest or 'more'} "))
    return ElementTree.tostring(root, encoding="unicode")


def sensed(spec: mujoco.MjSpec, joints: Sequence[str]) -> mujoco.MjSpec:
    """Return a model with a sensor of the angle of each joint, which `mujoco.sysid` needs."""
    position = mujoco.mjtSensor.mjSENS_JOINTPOS
    there = {one.objname for one in spec.sensors if one.type == position}
    for joint in joints:
        if joint not in there:
            spec.add_sensor(
                name=f"{joint}_pos",
                type=position,
                objtype=mujoco.mjtObj.mjOBJ_JOINT,
                objname=joint,
            )
    return spec


def sysid_trajectory(spec: mujoco.MjSpec, log: Log) -> Mapping[str, Any]:
    """Return the arrays of a file of `mujoco.sysid.SystemTrajectory`; signals without data are 0 and have no name.

    Args:
        spec: A model with a sensor of the angle and an actuator of each joint.
        log: A log of servos or motors.
    """
    model = spec.compile()
    given = log.command_rad if log.command_rad is not None else log.torque_n_m
    if given is None:
        raise ParameterError(f"{log.name}: a free swing has no control of mujoco.sysid")
    values = {"position": log.position_rad, "rate": log.rate_rad_per_s}
    sensors: dict[str, tuple[int, list[int]]] = {}
    controls: dict[str, tuple[int, list[int]]] = {}
    measured = np.zeros((len(log.times_s), model.nsensordata))
    commanded = np.zeros((len(log.times_s), model.nu))
    data = mujoco.MjData(model)
    rates = log.start()[1]
    for place, name in enumerate(log.joints):
        joint = model.joint(name)
        data.qpos[joint.qposadr] = log.position_rad[0, place]
        data.qvel[joint.dofadr] = rates[place]
        for number in range(model.nsensor):
            column = values.get(SENSED.get(int(model.sensor_type[number]), ""))
            if column is not None and model.sensor_objid[number] == joint.id:
                address = int(model.sensor_adr[number])
                measured[:, address] = column[:, place]
                sensors[model.sensor(number).name] = SENSOR, [address]
        for motor in range(model.nu):
            is_joint = model.actuator_trntype[motor] == mujoco.mjtTrn.mjTRN_JOINT
            if is_joint and model.actuator_trnid[motor, 0] == joint.id:
                commanded[:, motor] = given[:, place]
                controls[model.actuator(motor).name + CONTROL] = CONTROLLED, [motor]
    if len(controls) < len(log.joints):
        raise ParameterError(
            f"{log.name}: the model has no actuator with a name at each joint, but {', '.join(controls) or 'none'}"
        )
    full = mujoco.mjtState.mjSTATE_FULLPHYSICS
    state = np.zeros(mujoco.mj_stateSize(model, full))
    mujoco.mj_getState(model, data, state, full)
    return {
        "control_times": log.times_s,
        "control_data": commanded,
        "control_signal_mapping": np.asarray(json.dumps(controls)),
        "sensordata_times": log.times_s,
        "sensordata_data": measured,
        "sensordata_signal_mapping": np.asarray(json.dumps(sensors)),
        "initial_state": state,
    }


def check_files(files: Mapping[str, Path], scene: Any, source: str) -> None:
    """Raise ParameterError unless the files of `write_files` can be made of a model, before anything is identified."""
    if files and not isinstance(scene, mujoco.MjSpec):
        raise ParameterError("--out mends the MJCF or URDF of --scene: name one")
    if ".urdf" in files and Path(source).suffix.lower() != ".urdf":
        raise ParameterError(f"--out {files['.urdf']}: {source} is no URDF")


def write_files(
    files: Mapping[str, Path],
    scene: mujoco.MjSpec,
    source: str,
    found: Identified,
    log: Log,
) -> None:
    """Write a mended MJCF or URDF, and a log for `mujoco.sysid`, by suffix.

    Args:
        files: Paths by suffix.
        scene: Model of an MJCF or a URDF file.
        source: That file.
        found: What was identified.
        log: The log of the file for `mujoco.sysid`.
    """
    mended = mended_mjcf(scene, found)
    if ".npz" in files:
        sensed(mended, found.names)
        np.savez(files[".npz"], **sysid_trajectory(mended, log))
    if ".xml" in files:
        place_assets(mended, files[".xml"].parent)
        files[".xml"].write_text(mended.to_xml(), encoding="utf-8")
    if ".urdf" in files:
        text = read_bytes(Path(source)).decode("utf-8")
        folders = Path(source).parent, files[".urdf"].parent
        text = mended_urdf(text, found, *folders)
        files[".urdf"].write_text(text, encoding="utf-8")
