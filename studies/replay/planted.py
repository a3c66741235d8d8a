"""Plant causes, pairs of causes and mistakes of logs, and count what `gauge replay` names first.

Usage: `python studies/replay/planted.py {singles,pairs,mistakes,outside} FIRST LAST [ROBOT...]`, with seeds FIRST to
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

from gauge_envs.tools.replay import replay

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
        push: Torque that no cause has, by time.
    """

    model: Model
    delay_s: float = 0.0
    scale: float = 1.0
    offset: float = 0.0
    order: tuple[int, ...] = ()
    every: int = 1
    push: Callable[[float], float] = lambda _: 0.0


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


def with_cause(name: str, robot: Robot, rng: np.random.Generator) -> Robot:
    """Return a robot with a cause that changes its motion by far more than the noise."""
    for _ in range(20):
        changed = copy.deepcopy(robot)
        plant(name, changed, int(rng.integers(robot.model.nu)), rng)
        seed = rng.integers(1000)
        logs = [
            record(each, np.random.default_rng(seed))["q"] for each in (robot, changed)
        ]
        if np.std(logs[1] - logs[0], axis=0).max() > MIN_CHANGE:
            return changed
    raise ValueError(f"{name} changes nothing")


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
            data.qfrc_applied[:] = robot.push(data.time)
            mujoco.mj_step(model, data)
    noise = np.repeat([NOISE, RATE_NOISE], model.nq)
    noisy = np.array(states) + noise * rng.normal(size=(len(times_s), 2 * model.nq))
    position, velocity = np.hsplit(noisy, 2)
    return {"t": times_s, "q": position, "dq": velocity, "target": targets}


ANGLES = ("q", "dq", "target")
MISTAKES = {
    "degrees": "degrees",
    "sign": "sign of",
    "order": "exchanged",
    "rate unit": "velocities are in",
    "rate order": "velocities are exchanged",
    "rate sign": "velocities of",
    "spikes": "spikes",
    "lost": "lost samples",
    "held": "repeat the position",
    "zero": "zero",
}
"""Words of the message by mistake."""


def write_wrongly(  # noqa: C901
    name: str, log: dict, rng: np.random.Generator
) -> None:
    """Change the columns of a log by a mistake."""
    count, joints = log["q"].shape
    joint = int(rng.integers(joints))
    if name == "degrees":
        log.update({key: np.rad2deg(log[key]) for key in ANGLES})
    elif name == "sign":
        for key in ANGLES:
            log[key][:, joint] *= -1.0
    elif name == "order":
        log.update({key: np.roll(log[key], 1, axis=1) for key in ANGLES})
    elif name == "rate unit":
        log["dq"] = log["dq"] * rng.choice([180.0 / np.pi, 30.0 / np.pi, 0.5 / np.pi])
    elif name == "rate order":
        log["dq"] = np.roll(log["dq"], 1, axis=1)
    elif name == "rate sign":
        log["dq"][:, joint] *= -1.0
    elif name == "spikes":
        rows = rng.choice(count, count // 100, replace=False)
        log["q"][rows, joint] += rng.choice([-1.0, 1.0], len(rows))
    elif name == "lost":
        log["q"][rng.choice(count, count // 40, replace=False)] = 0.0
    elif name == "held":
        for row in np.sort(rng.choice(count - 4, count // 60, replace=False)) + 1:
            size = rng.integers(1, 4)
            log["q"][row : row + size] = log["q"][row - 1]
            log["dq"][row : row + size] = log["dq"][row - 1]
    else:
        shift = rng.choice([-0.5, 0.35, 0.6])
        log["q"][:, joint] += shift
        log["target"][:, joint] += shift


def cases(kind: str, seed: int, spec: mujoco.MjSpec, folder: Path) -> Iterator[str]:
    """Write the log of a seed, and yield what is planted."""
    rng = np.random.default_rng([seed, len(kind)])
    with_servos(spec, rng)
    robot = Robot(copy.copy(spec.compile()))
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
            robot = with_cause(name, robot, rng)
    elif kind == "outside":
        size = rng.uniform(0.1, 0.3) * robot.model.actuator_gainprm[0, 0]
        rate = rng.uniform(5.0, 30.0)
        robot.push = [
            lambda time_s: size * np.sign(np.sin(rate * time_s)),
            lambda time_s: size * np.sin(rate * time_s**1.5),
            lambda time_s: size * (np.sin(rate * time_s) > 0.8),
        ][seed % 3]
    log = record(robot, rng)
    if kind == "mistakes":
        name = [*MISTAKES][seed % len(MISTAKES)]
        if joints == 1 and "order" in name:
            name = "degrees"
        write_wrongly(name, log, rng)
        names = [name]
    np.savez(folder / "log.npz", joints=[joint.name for joint in spec.joints], **log)
    yield from names


def same(one: str, other: str) -> bool:
    """Return whether two causes are one law."""
    return one == other or any({one, other} <= law for law in ONE_LAW)


def judge(kind: str, truth: list[str], line: object) -> str:
    """Return `right`, `listed`, `nothing` or `wrong`."""
    if kind == "mistakes":
        words = MISTAKES[truth[0]]
        text = " ".join([*line.mistakes, *(each.cause for each in line.named)])
        if words in text:
            return "right"
        return "wrong" if line.named or line.mistakes else "nothing"
    if kind == "outside":
        return "wrong" if line.named else "right"
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
            truth = list(cases(kind, seed, spec, folder))
            begin_s = time.process_time()
            line = replay(folder / "log.npz", folder / "robot.xml").line
            cost_s = time.process_time() - begin_s
        outcome = judge(kind, truth, line)
        counts[outcome] = counts.get(outcome, 0) + 1
        twins = "; ".join(line.indistinguishable)
        print(seed, outcome, truth, f"{cost_s:.1f} s", line.sentence, f"[{twins}]")
        sys.stdout.flush()
    print(kind, counts)


if __name__ == "__main__":
    main()
