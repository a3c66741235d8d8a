"""Scenes of what tasks lost with an upgrade, as numbers with a truth: `python checks.py`. Needs MuJoCo and NumPy alone.

It runs in the environment of a release, and prints a JSON object: the number of each check, and of those that the
release cannot run, why.
"""

import json
from typing import Any

import mujoco
import numpy as np

GRAVITY = 9.81
"""MuJoCo's default gravity [m/s^2]."""


def scene(body: str, option: str = "") -> tuple[Any, Any]:
    """Return a model and its data."""
    text = f'<mujoco><option {option}/><worldbody><geom name="floor" type="plane" size="3 3 .1"/>{body}</mujoco>'
    model = mujoco.MjModel.from_xml_string(text)
    return model, mujoco.MjData(model)


def box(name: str, x_m: float, z_m: float, size: str, more: str = "") -> str:
    """Return a free box."""
    return (
        f'<body name="{name}" pos="{x_m} 0 {z_m}"><freejoint/>'
        f'<geom name="{name}" type="box" size="{size}" {more}/></body>'
    )


def stepped(model: Any, data: Any, seconds: float) -> None:
    """Step the model for a time."""
    for _ in range(round(seconds / model.opt.timestep)):
        mujoco.mj_step(model, data)


def depth_mm(model: Any, data: Any) -> float:
    """Return the depth of the deepest contact at the start [mm]."""
    mujoco.mj_forward(model, data)
    return float(-1e3 * np.min(data.contact.dist, initial=0.0))


def stack_weight() -> float:
    """Three stacked boxes of 1 kg rest on a table: the floor carries their weight, as a fraction of it."""
    boxes = "".join(
        box(f"b{i}", 0.0, 0.049 + 0.099 * i, ".05 .05 .05", 'mass="1"')
        for i in range(3)
    )
    model, data = scene(boxes + "</worldbody>")
    stepped(model, data, 2.0)
    mujoco.mj_forward(model, data)
    force, total = np.zeros(6), 0.0
    for index in range(data.ncon):
        contact = data.contact[index]
        if 0 in (contact.geom1, contact.geom2):
            mujoco.mj_contactForce(model, data, index, force)
            total += force[0]
    return total / (3.0 * GRAVITY)


def drawer_m() -> float:
    """A drawer of 1 kg with dry friction of 2 N is pulled by 3 N for 1 s: a t^2 / 2 = 0.5 m."""
    joint = '<joint name="d" type="slide" axis="1 0 0" frictionloss="2"/>'
    body = f'<body pos="0 0 1">{joint}<geom size=".1" mass="1"/></body>'
    model, data = scene(
        body + '</worldbody><actuator><motor joint="d"/></actuator>',
        'timestep="0.0005"',
    )
    data.ctrl[0] = 3.0
    stepped(model, data, 1.0)
    return float(data.qpos[0])


def grip_slip_mm() -> float:
    """Two pads press a box of 0.1 kg with 20 N and friction 1: twenty times its weight in grip, so it stays for 2 s."""
    pad = (
        '<body name="{0}" pos="{1} 0 .3"><joint name="{0}" type="slide" axis="{2} 0 0"/>'
        '<geom type="box" size=".01 .02 .03" mass=".1"/></body>'
    )
    bodies = pad.format("l", -0.041, 1) + pad.format("r", 0.041, -1)
    bodies += box("held", 0.0, 0.3, ".03 .03 .03", 'mass=".1"')
    actuators = '<actuator><motor joint="l"/><motor joint="r"/></actuator>'
    model, data = scene(
        bodies + "</worldbody>" + actuators, 'cone="elliptic" impratio="10"'
    )
    data.ctrl[:] = 20.0
    stepped(model, data, 2.0)
    return float(1e3 * (0.3 - data.qpos[4]))


def pad_depth_mm() -> float:
    """A box that is put 1 mm into another, face on face, touches it 1 mm deep."""
    fixed = '<geom type="box" size=".1 .1 .1" pos="0 0 .5"/>'
    return depth_mm(
        *scene(fixed + box("b", 0.0, 0.649, ".05 .05 .05") + "</worldbody>")
    )


def edge_depth_mm() -> float:
    """Two square bars, each turned by 45 degrees about its axis, cross edge on edge, 2 mm into each other."""
    height_m = 0.5 + 2 * 0.05 * np.sqrt(2.0) - 0.002
    fixed = '<geom type="box" size=".3 .05 .05" pos="0 0 .5" euler="45 0 0"/>'
    bar = f'<body pos="0 0 {height_m}"><freejoint/><geom type="box" size=".05 .3 .05" euler="0 45 0"/></body>'
    return depth_mm(*scene(fixed + bar + "</worldbody>"))


def deep_ball_mm() -> float:
    """A ball of 50 mm with its centre 30 mm below the face of a large box is 80 mm deep."""
    fixed = '<geom type="box" size=".3 .3 .3" pos="0 0 .5"/>'
    ball = '<body pos="0 0 .77"><freejoint/><geom size=".05"/></body>'
    return depth_mm(*scene(fixed + ball + "</worldbody>"))


def plate_depth_mm() -> float:
    """A plate (cylinder) that is put 1 mm into a table (box) touches it 1 mm deep."""
    table = '<geom type="box" size=".4 .3 .02" pos="0 0 .4"/>'
    plate = '<body pos=".1 .05 .425"><freejoint/><geom type="cylinder" size=".08 .006"/></body>'
    return depth_mm(*scene(table + plate + "</worldbody>"))


def mesh_tilt_deg() -> float:
    """A mesh block of 0.2 kg lies on a mesh plate, off the middle, for 2 s: it does not turn."""
    corners = [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    meshes = ""
    for name, size in (("plate", (0.3, 0.3, 0.05)), ("block", (0.05, 0.04, 0.03))):
        vertex = " ".join(
            str(s * c) for corner in corners for s, c in zip(size, corner, strict=True)
        )
        meshes += f'<mesh name="{name}" vertex="{vertex}"/>'
    fixed = '<geom type="mesh" mesh="plate" pos="0 0 .5"/>'
    block = '<body pos=".1 .05 .5799"><freejoint/><geom type="mesh" mesh="block" mass=".2"/></body>'
    model, data = scene(fixed + block + f"</worldbody><asset>{meshes}</asset>")
    stepped(model, data, 2.0)
    return float(np.degrees(2.0 * np.arccos(min(1.0, abs(data.qpos[3])))))


def thin_shelf_contacts() -> float:
    """A crate that is deep in a thin shelf touches it: at its four corners."""
    shelf = '<geom type="box" size=".2 .2 .002" pos="0 0 .2"/>'
    model, data = scene(
        shelf + box("crate", 0.0, 0.225, ".05 .05 .05") + "</worldbody>"
    )
    mujoco.mj_forward(model, data)
    return float(data.ncon)


def servo_error_mrad() -> float:
    """A servo arm with kp 20, kv 4 and inertia 0.1 kg m^2, after a step of 1 rad: from its closed form at 0.3 s."""
    body = '<body pos="0 0 1"><joint name="j" axis="0 0 1" armature=".1"/><geom size=".01" mass="1e-6"/></body>'
    servo = '<actuator><general joint="j" gainprm="20" biastype="affine" biasprm="0 -20 -4"/></actuator>'
    model, data = scene(
        body + "</worldbody>" + servo, 'integrator="implicitfast" timestep="0.0002"'
    )
    data.ctrl[0] = 1.0
    stepped(model, data, 0.3)
    decay, root = 4.0 / 0.2, np.sqrt(20.0 / 0.1 - (4.0 / 0.2) ** 2 + 0j)
    shape = np.cos(root * data.time) + decay / root * np.sin(root * data.time)
    return float(1e3 * (data.qpos[0] - (1.0 - np.exp(-decay * data.time) * shape.real)))


def spin_energy_percent() -> float:
    """A free brick without gravity turns about its middle axis for 2 s: its energy stays, implicitfast at 2 ms."""
    model, data = scene(
        box("b", 0.0, 1.0, ".05 .1 .2") + "</worldbody>",
        'gravity="0 0 0" integrator="implicitfast"',
    )
    data.qvel[3:] = 0.1, 5.0, 0.1
    mujoco.mj_forward(model, data)
    inertia = np.array(model.body_inertia[1])
    frame = np.zeros(9)
    mujoco.mju_quat2Mat(frame, model.body_iquat[1])
    spin = data.qvel[3:] @ frame.reshape(3, 3)
    before = float(inertia @ spin**2)
    stepped(model, data, 2.0)
    spin = data.qvel[3:] @ frame.reshape(3, 3)
    return 100.0 * (float(inertia @ spin**2) / before - 1.0)


def touch_distance_mm() -> float:
    """Two balls with a margin of 10 mm each repel at this distance; releases mean other things by a margin."""
    ball = '<body pos="{} 0 1"><joint type="slide" axis="1 0 0"/><geom size=".05" margin=".01"/></body>'
    model, data = scene(
        ball.format(0) + ball.format(0.2) + "</worldbody>", 'gravity="0 0 0"'
    )
    for distance_mm in np.arange(30.0, 0.0, -0.5):
        data.qpos[1] = -0.1 + 1e-3 * distance_mm
        mujoco.mj_forward(model, data)
        if data.nefc:
            return float(distance_mm)
    return 0.0


CHECKS = {
    check.__name__: check
    for check in (
        stack_weight,
        drawer_m,
        grip_slip_mm,
        pad_depth_mm,
        edge_depth_mm,
        deep_ball_mm,
        plate_depth_mm,
        mesh_tilt_deg,
        thin_shelf_contacts,
        servo_error_mrad,
        spin_energy_percent,
        touch_distance_mm,
    )
}


def main() -> None:
    """Print the number of each check."""
    found: dict[str, Any] = {}
    for name, check in CHECKS.items():
        try:
            found[name] = check()
        except (ValueError, AttributeError, mujoco.FatalError) as error:
            found[name] = " ".join(str(error).split())
    print(json.dumps(found))


if __name__ == "__main__":
    main()
