"""Plant causes, pairs of causes and what no cause is, and count what `gauge replay` names first.

Usage: `python studies/replay/planted.py {singles,pairs,outside,twins} FIRST LAST [ROBOT...]`, with seeds FIRST to
LAST - 1. Robots are MJCF files, which get a servo at each joint; without any, chains of one to three links are drawn.
"""

from __future__ import annotations

import copy
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from gauge_envs.tools.replay import ReplayVerdict, replay

INTERVAL_S = 0.02
DURATION_S = 12.0
NOISE, RATE_NOISE = 5e-4, 1e-2
MIN_CHANGE = 2e-3
"""Standard deviation of what a planted cause changes [rad]."""
Model = mujoco.MjModel


@dataclass
class Robot:
    """A servo robot whose log is simulated by a loop of its own; a cause changes it.

    Attributes:
        model: What moves.
        delay_s: Delay of the commands.
        scale, offset, order: Change of the commands.
        every: Only each so-manieth command is taken.
        disturb: Changes the commands, the forces or the model at each physics step, as no cause does.
    """

    model: Model
    delay_s: float = 0.0
    scale: float = 1.0
    offset: float = 0.0
    order: tuple[int, ...] = ()
    every: int = 1
    disturb: Callable[[mujoco.MjData], None] = lambda _: None


def chain(rng: np.random.Generator) -> mujoco.MjSpec:
    """Return a chain of one to three links of random size."""
    spec = mujoco.MjSpec()
    parent, end = spec.worldbody, [0.0, 0.0, 1.0]
    for index in range(rng.integers(1, 4)):
        length, mass = rng.uniform(0.15, 0.4), rng.uniform(0.2, 1.5)
        body = parent.add_body(name=f"link{index}", pos=end)
        axis = [0.0, 1.0, 0.0] if rng.random() < 0.7 else [1.0, 0.0, 0.0]
        body.add_joint(name=f"joint{index}", axis=axis)
        end = [0.0, 0.0, -length]
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_CAPSULE,
            fromto=[0.0, 0.0, 0.0, *end],
            size=[0.02, 0.0, 0.0],
            mass=mass,
        )
        parent = body
    return spec


def with_servos(spec: mujoco.MjSpec, rng: np.random.Generator) -> mujoco.MjSpec:
    """Return a robot with a servo at each joint, and without contacts."""
    for actuator in list(spec.actuators):
        spec.delete(actuator)
    for key in list(spec.keys):
        spec.delete(key)
    for geom in spec.geoms:
        geom.contype = geom.conaffinity = 0
    spec.option.timestep = 0.002
    inertia = spec.compile().dof_M0.copy()
    for index, joint in enumerate(spec.joints):
        joint.limited = mujoco.mjtLimited.mjLIMITED_FALSE
        joint.armature = 0.2 * inertia[index]
        total, rate = 1.2 * inertia[index], rng.uniform(12.0, 25.0)
        joint.damping[0] = 0.2 * total * rate
        drive = spec.add_actuator(name=f"drive{index}", target=joint.name)
        drive.trntype = mujoco.mjtTrn.mjTRN_JOINT
        drive.set_to_position(kp=total * rate**2, kv=total * rate)
    return spec


def plant(  # noqa: C901
    name: str, robot: Robot, joint: int, rng: np.random.Generator
) -> None:
    """Change a robot by a cause."""
    model = robot.model
    factor = rng.choice([0.6, 1.6])
    kp, body = model.actuator_gainprm[joint, 0], model.jnt_bodyid[joint]
    inertia, last = model.dof_M0[joint], model.nbody - 1
    if name == "armature":
        model.dof_armature[joint] += rng.uniform(0.8, 2.0) * inertia
    elif name == "dry friction":
        model.dof_frictionloss[joint] += rng.uniform(0.04, 0.1) * kp
    elif name == "damping":
        model.dof_damping[joint] += rng.uniform(0.05, 0.15) * kp
    elif name == "kp":
        model.actuator_gainprm[:, 0] *= factor
        model.actuator_biasprm[:, 1] *= factor
    elif name == "kd":
        model.actuator_biasprm[:, 2] *= rng.choice([0.3, 2.5])
    elif name == "effort limit":
        limit = rng.uniform(0.08, 0.15) * kp
        model.actuator_forcelimited[joint] = 1
        model.actuator_forcerange[joint] = -limit, limit
    elif name == "delay":
        robot.delay_s = rng.uniform(0.012, 0.06)
    elif name == "action scale":
        robot.scale = rng.choice([0.7, 1.4])
    elif name == "action offset":
        robot.offset = rng.choice([-0.15, 0.15])
    elif name == "gravity or tilt":
        model.opt.gravity[:] = *rng.uniform(-4.0, 4.0, 2), -8.5
    elif name == "mass or centre of a link":
        ratio = rng.choice([0.4, 2.0])
        model.body_mass[body] *= ratio
        model.body_inertia[body] *= ratio
    elif name == "payload":
        model.body_mass[last] += 0.5 * model.body_mass.sum()
    elif name == "joint limit":
        model.jnt_limited[joint] = 1
        model.jnt_range[joint] = -0.12, 3.0
    elif name == "joint order":
        robot.order = tuple(np.roll(range(model.nu), 1))
    elif name == "step and decimation":
        robot.every = int(rng.integers(2, 5))
    else:
        raise ValueError(name)


def with_cause(
    name: str,
    robot: Robot,
    rng: np.random.Generator,
    least: float = MIN_CHANGE,
    most: float = np.inf,
) -> tuple[Robot, float]:
    """Return a robot with a cause, or with what is none, and the change of its motion [rad]."""
    put = disturb if name in OUTSIDE else plant
    for _ in range(60):
        changed = copy.deepcopy(robot)
        put(name, changed, int(rng.integers(robot.model.nu)), rng)
        seed = rng.integers(1000)
        logs = [
            record(each, np.random.default_rng(seed))["q"] for each in (robot, changed)
        ]
        change = np.std(logs[1] - logs[0], axis=0).max()
        if least < change < most:
            return changed, change
    raise ValueError(f"{name} changes too little or too much")


OUTSIDE = {
    "backlash": ("dry friction",),
    "cable spring": ("joint limit",),
    "hysteresis": ("dry friction",),
    "gain drift": ("kp",),
    "swinging payload": ("payload", "mass or centre of a link"),
    "loose base": ("gravity or tilt",),
    "cogging": ("dry friction",),
    "gear eccentricity": ("action offset",),
    "Stribeck": ("dry friction",),
    "motor lag": ("delay",),
    "voltage limit": ("effort limit",),
    "quantised command": ("action scale",),
    "quadratic drag": ("damping", "kd"),
    "one-sided friction": ("dry friction", "action offset"),
    "dead motor": ("effort limit",),
    "hardening spring": ("kp",),
    "link length": ("mass or centre of a link", "payload"),
    "periodic push": ("action offset",),
    "jittery delay": ("delay",),
    "square push": ("step and decimation",),
}
"""What no cause of the list is, and the causes that resemble it; friction of one side is half friction, half offset."""


def disturb(  # noqa: C901
    name: str, robot: Robot, joint: int, rng: np.random.Generator
) -> None:
    """Change a robot by what no cause of the list is."""
    model, size, rate = robot.model, rng.uniform(0.5, 2.0), rng.uniform(5.0, 25.0)
    kp, kd = model.actuator_gainprm[joint, 0], -model.actuator_biasprm[joint, 2]
    torque, spring, start = 0.08 * kp * size, 0.4 * kp * size, rng.uniform(-0.2, 0.2)
    memory: dict[str, float] = {}
    gains = model.actuator_gainprm.copy(), model.actuator_biasprm.copy()
    end_s, limit = rng.uniform(4.0, 8.0), 0.4 * kp * rng.uniform(0.3, 1.0)

    def hysteresis(q: float, v: float, data: mujoco.MjData) -> float:
        force = memory["force"] + 4.0 * kp * v * model.opt.timestep
        memory["force"] = float(np.clip(force, -torque, torque))
        return -memory["force"]

    def voltage(q: float, v: float, data: mujoco.MjData) -> float:
        bound, force = limit * max(0.0, 1.0 - abs(v) / 3.0), data.actuator_force[joint]
        return float(np.clip(force, -bound, bound) - force)

    forces = {
        "backlash": lambda q, v, data: (
            kp * np.clip(q - data.ctrl[joint], -0.03 * size, 0.03 * size)
        ),
        "cable spring": lambda q, v, data: -spring * max(q - start, 0.0),
        "hysteresis": hysteresis,
        "cogging": lambda q, v, data: torque * np.sin(rate * q),
        "gear eccentricity": lambda q, v, data: torque * np.sin(2.0 * q + start),
        "Stribeck": lambda q, v, data: (
            -torque * np.tanh(v / 0.02) * np.exp(-((v / 0.3) ** 2))
        ),
        "voltage limit": voltage,
        "quadratic drag": lambda q, v, data: -0.5 * size * kd * v * abs(v),
        "one-sided friction": lambda q, v, data: -torque * np.tanh(max(v, 0.0) / 0.02),
        "dead motor": lambda q, v, data: (
            -data.actuator_force[joint] * (data.time > end_s)
        ),
        "hardening spring": lambda q, v, data: -10.0 * spring * q**3,
        "periodic push": lambda q, v, data: torque * np.sin(rate * data.time),
        "square push": lambda q, v, data: torque * np.sign(np.sin(rate * data.time)),
    }

    def change(data: mujoco.MjData) -> None:
        if not data.time:
            memory.update(force=0.0, command=0.0, angle=0.0, speed=0.0, last=0.0)
        if name in forces:
            force = forces[name](data.qpos[joint], data.qvel[joint], data)
            data.qfrc_applied[joint] = force
        elif name == "gain drift":
            warm = 1.0 - 0.25 * size * data.time / DURATION_S
            model.actuator_gainprm[:], model.actuator_biasprm[:] = (
                warm * each for each in gains
            )
        elif name == "loose base":
            model.opt.gravity[0] = 2.0 * size * np.sin(rate * data.time)
        elif name == "quantised command":
            data.ctrl[:] = 0.1 * size * np.round(data.ctrl / (0.1 * size))
        elif name == "motor lag":
            share = model.opt.timestep / (0.05 * size)
            memory["command"] += share * (data.ctrl - memory["command"])
            data.ctrl[:] = memory["command"]
        elif name == "jittery delay":
            robot.delay_s = 0.04 * size * (np.sin(rate * np.floor(data.time / 0.1)) > 0)
        elif name == "swinging payload":
            # A pendulum hangs from the last link, and pulls it along x.
            body, velocity = model.nbody - 1, data.cvel[model.nbody - 1, 3]
            swing = (0.4 * rate) ** 2
            memory["speed"] -= swing / 9.81 * (velocity - memory["last"])
            memory["speed"] -= swing * model.opt.timestep * np.sin(memory["angle"])
            memory["angle"] += model.opt.timestep * memory["speed"]
            memory["last"] = velocity
            weight = 0.5 * size * model.body_mass[body] * 9.81
            data.xfrc_applied[body, 0] = weight * np.sin(memory["angle"])

    robot.disturb = change
    if name == "link length":
        model.body_pos[model.nbody - 1] *= 1.0 + 0.5 * size


CAUSES = (
    "armature",
    "dry friction",
    "damping",
    "kp",
    "kd",
    "effort limit",
    "delay",
    "action scale",
    "action offset",
    "gravity or tilt",
    "mass or centre of a link",
    "payload",
    "joint limit",
    "joint order",
    "step and decimation",
)
ONE_LAW = (
    {"kd", "damping"},
    {"payload", "mass or centre of a link"},
)
"""Causes that are one change of the equations of motion, or nearly."""


def record(robot: Robot, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Return the columns of a log."""
    model, data = robot.model, mujoco.MjData(robot.model)
    mujoco.mj_setConst(model, data)
    times_s = np.arange(0.0, DURATION_S, INTERVAL_S)
    rates = rng.uniform(1.0, 12.0, (model.nu, 3))
    phases = rng.uniform(0.0, 6.0, (model.nu, 3))
    waves = np.sin(rates * times_s[:, None, None] + phases)
    targets = 0.25 * waves.sum(axis=2)
    states = []
    order = list(robot.order or range(model.nu))
    for _ in times_s:
        states.append(np.concatenate([data.qpos, data.qvel]))
        for _step in range(round(INTERVAL_S / model.opt.timestep)):
            row = int((data.time - robot.delay_s) / INTERVAL_S + 1e-9)
            row = max(0, row - row % robot.every)
            data.ctrl[:] = robot.scale * targets[row, order] + robot.offset
            robot.disturb(data)
            mujoco.mj_step(model, data)
    noise = np.repeat([NOISE, RATE_NOISE], model.nq)
    noisy = np.array(states) + noise * rng.normal(size=(len(times_s), 2 * model.nq))
    position, velocity = np.hsplit(noisy, 2)
    return {"t": times_s, "q": position, "dq": velocity, "target": targets}


def cases(kind: str, seed: int, spec: mujoco.MjSpec, folder: Path) -> Iterator[str]:
    """Write the log of a seed, and yield what is planted."""
    rng = np.random.default_rng([seed, len(kind)])
    with_servos(spec, rng)
    robot = plain = Robot(copy.copy(spec.compile()))
    (folder / "robot.xml").write_text(spec.to_xml())
    joints = robot.model.nu
    names: list[str] = []
    if kind in ("singles", "pairs"):
        known = CAUSES if joints > 1 else tuple(set(CAUSES) - {"joint order"})
        first = CAUSES[seed % len(CAUSES)]
        names = [first if first in known else "delay"]
        if kind == "pairs":
            others = [name for name in known if not same(name, names[0])]
            names.append(str(rng.choice(others)))
        for name in names:
            robot, _ = with_cause(name, robot, rng)
    elif kind in ("outside", "twins"):
        names = [[*OUTSIDE][seed % len(OUTSIDE)]]
        robot, size = with_cause(names[0], plain, rng, 10.0 * NOISE)
        if kind == "twins":
            names = [OUTSIDE[names[0]][0]]
            robot, _ = with_cause(names[0], plain, rng, 0.4 * size, 2.5 * size)
    log = record(robot, rng)
    np.savez(folder / "log.npz", joints=[joint.name for joint in spec.joints], **log)
    yield from names


def same(one: str, other: str) -> bool:
    """Return whether two causes are one law."""
    return one == other or any({one, other} <= law for law in ONE_LAW)


def judge(kind: str, truth: list[str], line: object) -> str:
    """Return `right`, `listed`, `nothing`, `part` (something else remains) or `wrong`."""
    if line.verdict is ReplayVerdict.PART:
        return "part"
    if kind == "outside":
        named = {each.cause for each in line.named}
        if not named and not line.mistakes:
            return "right"
        return "listed" if named <= {*OUTSIDE[truth[0]]} else "wrong"
    if line.mistakes:
        return "wrong"
    named = [each.cause for each in line.named]
    if not named:
        return "nothing"
    right = all(any(same(name, cause) for cause in named) for name in truth)
    if right and len(named) == len(truth):
        return "right"
    twins = " and ".join(line.indistinguishable)
    if right or all(any(same(t, c) for c in CAUSES if c in twins) for t in truth):
        return "listed"
    return "wrong"


def main() -> None:
    """Run the seeds, and print a line each and the counts."""
    kind, first, last, *files = sys.argv[1:]
    counts: dict[str, int] = {}
    for seed in range(int(first), int(last)):
        spec = chain(np.random.default_rng(seed))
        if files:
            spec = mujoco.MjSpec.from_file(files[seed % len(files)])
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            try:
                truth = list(cases(kind, seed, spec, folder))
            except ValueError as error:
                print(seed, error)
                continue
            begin_s = time.process_time()
            line = replay(folder / "log.npz", folder / "robot.xml").line
            cost_s = time.process_time() - begin_s
        outcome = judge(kind, truth, line)
        counts[outcome] = counts.get(outcome, 0) + 1
        twins = "; ".join(line.indistinguishable)
        joints = spec.joints
        print(seed, outcome, truth, f"{len(joints)} joints, {cost_s:.1f} s", end=" ")
        print(line.sentence, f"[{twins}]")
        sys.stdout.flush()
    print(kind, counts)


if __name__ == "__main__":
    main()
