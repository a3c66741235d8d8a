"""Small robots, simulated by a loop of its own, whose log has one planted difference to the model."""

from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np

from gauge_envs.tools.replay.log import JointMap, LogMap

ARM = """
<mujoco>
  <compiler angle="radian"/>
  <option timestep="0.002"/>
  <worldbody>
    <body>
      <joint name="shoulder" axis="0 1 0" armature="0.02" damping="0.2"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="1"/>
      <body name="hand" pos="0 0 -0.3">
        <joint name="elbow" axis="0 1 0" armature="0.01" damping="0.1"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.25" size="0.02" mass="0.6"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position joint="shoulder" kp="40" kv="1.5"/>
    <position joint="elbow" kp="20" kv="0.8"/>
  </actuator>
</mujoco>
"""
CART_POLE = """
<mujoco>
  <compiler angle="radian"/>
  <option timestep="0.002"/>
  <worldbody>
    <body>
      <joint name="cart" type="slide" axis="1 0 0" damping="0.5"/>
      <geom type="box" size="0.1 0.1 0.05" mass="1"/>
      <body name="pole">
        <joint name="pole" axis="0 1 0" damping="0.002"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.6" size="0.02" mass="0.1"/>
      </body>
    </body>
  </worldbody>
  <actuator><position joint="cart" kp="60" kv="8"/></actuator>
</mujoco>
"""
"""A toy: a servo drives the cart, and the pole hangs free."""
SERVO = """
<mujoco>
  <compiler angle="radian"/>
  <option timestep="0.002"/>
  <worldbody>
    <body>
      <joint name="joint" axis="0 1 0" armature="0.01" damping="0.3"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.01" mass="0.1"/>
    </body>
  </worldbody>
  <actuator><position joint="joint" kp="8"/></actuator>
</mujoco>
"""
PENDULUM = """
<mujoco>
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody>
    <body>
      <joint name="pivot" axis="0 1 0"/>
      <geom type="sphere" size="0.01" pos="0 0 -0.15" mass="0.15"/>
    </body>
  </worldbody>
</mujoco>
"""
INTERVAL_S = 0.02


def record(
    folder: Path,
    *,
    robot: str = ARM,
    change: Callable[[mujoco.MjModel], None] = lambda _: None,
    delay_s: float = 0.0,
    columns: tuple[int, ...] = (0, 1),
    push: Callable[[float], float] = lambda _: 0.0,
    dead_zone: float = 0.0,
    duration_s: float = 8.0,
) -> tuple[Path, Path]:
    """Return a log of a changed robot, and the model without the change."""
    model = mujoco.MjModel.from_xml_string(robot)
    change(model)
    mujoco.mj_setConst(model, mujoco.MjData(model))
    data = mujoco.MjData(model)
    times_s = np.arange(0.0, duration_s, INTERVAL_S)
    rates = np.array([[1.9, 5.3, 9.1], [2.7, 6.1, 10.3]])[: model.nu]
    targets = 0.25 * np.sin(rates[..., None] * times_s).sum(axis=1).T
    states, steps = [], round(INTERVAL_S / model.opt.timestep)
    for time_s in times_s:
        states.append(np.concatenate([data.qpos, data.qvel]))
        for step in range(steps):
            now_s = time_s + step * model.opt.timestep - delay_s
            row = targets[max(0, int(now_s / INTERVAL_S + 1e-9))]
            data.ctrl = row[list(columns[: model.nu])]
            data.xfrc_applied[-1, 0] = push(now_s)
            slack = np.clip(data.qpos[0] - data.ctrl[0], -dead_zone, dead_zone)
            data.qfrc_applied[0] = model.actuator_gainprm[0, 0] * slack
            mujoco.mj_step(model, data)
    rng = np.random.default_rng(0)
    noise = np.repeat([5e-4, 1e-2], [model.nq, model.nv])
    noisy = np.array(states) + noise * rng.normal(size=(len(times_s), len(noise)))
    position, velocity = np.split(noisy, [model.nq], axis=1)
    names = np.array([model.joint(joint).name for joint in range(model.njnt)])
    base = {}
    if model.nq > model.nv:
        base["base_pos"], base["base_quat"], position = np.split(position, [3, 7], 1)
        base["base_linvel"], base["base_angvel"], velocity = np.split(
            velocity, [3, 6], 1
        )
        names = names[1:]
    log, file = folder / "log.npz", folder / "robot.xml"
    columns = {"q": position, "dq": velocity, "target": targets, "joints": names}
    np.savez(log, t=times_s, **columns, **base)
    file.write_text(robot)
    return log, file


def swing(folder: Path, dry: float, viscous: float) -> tuple[Path, Path]:
    """Return a log of a passive pendulum without velocities, by an integrator of its own, and the model."""
    mass_m, gravity = 0.15 * 0.15, 9.81
    inertia = 0.15 * 0.15**2 + 0.4 * 0.15 * 0.01**2
    angle, speed, step_s = 2.6, 0.0, 1e-4
    angles = []
    for step in range(round(12.0 / step_s)):
        if step % round(INTERVAL_S / step_s) == 0:
            angles.append(angle)
        torque = -mass_m * gravity * np.sin(angle) - viscous * speed
        loss = min(dry, abs(inertia * speed / step_s + torque))
        torque -= loss * np.sign(inertia * speed / step_s + torque)
        speed += step_s * torque / inertia
        angle += step_s * speed
    log, file = folder / "log.npz", folder / "robot.xml"
    noise = 1e-4 * np.random.default_rng(0).normal(size=len(angles))
    times_s = INTERVAL_S * np.arange(len(angles))
    np.savez(log, t=times_s, q_pivot=np.array(angles) + noise)
    file.write_text(PENDULUM)
    return log, file


def written_otherwise(columns: dict, writing: str) -> tuple[dict, LogMap]:
    """Return the columns of the same log, written otherwise, and its map."""
    if writing == "clock":
        return {"t": columns["t"] + 1000.0}, LogMap()
    angles = {key: columns[key] for key in ("q", "dq", "target")}
    if writing == "unit":
        return {key: np.rad2deg(angles[key]) for key in angles}, LogMap(unit="deg")
    if writing == "order":
        turned = {key: angles[key][:, ::-1] for key in angles}
        return turned | {"joints": columns["joints"][::-1]}, LogMap()
    if writing == "mirror":
        entries = {str(name): JointMap(sign=-1) for name in columns["joints"]}
        return {key: -angles[key] for key in angles}, LogMap(joints=entries)
    if writing == "half":
        return {key: columns[key][:200] for key in ("t", *angles)}, LogMap()
    fewer = {key: columns[key][::2] for key in ("t", "q", "dq")}
    return fewer | {"command_t": columns["t"]}, LogMap()


def paste(file: Path, lines: str) -> None:
    """Put lines of MJCF into a model: attributes of the element with this name."""
    tree = ElementTree.parse(file)
    root = tree.getroot()
    for line in lines.splitlines():
        element = ElementTree.fromstring(line)
        if element.tag == "option":
            root.find("option").attrib.update(element.attrib)
        elif element.tag == "joint":
            name = element.get("name")
            root.find(f".//body/joint[@name='{name}']").attrib.update(element.attrib)
        elif element.tag == "body":
            body = root.find(f".//body[@name='{element.get('name')}']")
            body.append(element.find("inertial"))
        else:
            joint = element.get("joint")
            old = root.find(f"./actuator/*[@joint='{joint}']")
            if old.tag == element.tag:
                element.attrib = old.attrib | element.attrib
            actuators = root.find("actuator")
            actuators[list(actuators).index(old)] = element
    tree.write(file)
