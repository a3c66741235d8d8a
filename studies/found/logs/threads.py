"""Ten public threads "it works in one simulator and not in the other" as pairs of logs, and what `gauge replay` says.

Usage: `python studies/found/logs/threads.py`. Each function changes one of two equal robots in plain MuJoCo as the
answer of the thread says. The first log is the simulator that works, the second the other one.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import mujoco
import numpy as np

from gauge_envs.tools.replay import read_map, replay

XML = """<mujoco><option timestep="0.002" gravity="0 0 {g}" integrator="implicitfast"/>
<default><geom contype="0" conaffinity="0"/></default><worldbody><body name="trunk" pos="0 0 1">{free}
<geom type="box" size=".15 .08 .05" mass="4"/>
<body pos="0 0 -.05"><joint name="hip" axis="0 1 0" armature=".01" damping=".2"/>
<geom type="capsule" fromto="0 0 0 0 0 -.25" size=".02" mass=".8"/>
<body pos="0 0 -.25"><joint name="knee" axis="0 1 0" armature=".01" damping=".1"/>
<geom type="capsule" fromto="0 0 0 0 0 -.25" size=".02" mass=".4"/></body></body>
<body pos=".15 0 0"><joint name="neck" axis="0 0 1" armature=".005" damping=".05"/>
<geom type="capsule" fromto="0 0 0 .2 0 0" size=".02" mass=".5"/></body></body></worldbody><actuator>
<position joint="hip" kp="30" kv="1"/><position joint="knee" kp="20" kv=".6"/><position joint="neck" kp="6" kv=".25"/>
</actuator></mujoco>"""
HOME = np.array([0.4, -0.8, 0.2])
OTHER_HOME = np.array([0.2, -0.3, 0.1])
SCALE, STEP_S, INTERVAL_S, DURATION_S = 0.3, 0.002, 0.02, 10.0
OBSERVATION = ("base_angvel", "projected_gravity", "joint_pos", "joint_vel")


@dataclass
class Simulator:
    """One of two simulators: a robot, and what its program does with observations and actions."""

    has_base: bool = False
    model: mujoco.MjModel = field(init=False)
    see: Callable[[str, np.ndarray, np.ndarray], np.ndarray] = (
        lambda term, value, turn: value
    )
    target: Callable[[np.ndarray, np.ndarray], np.ndarray] = lambda action, angles: (
        HOME + SCALE * action
    )
    order: tuple[int, ...] = (0, 1, 2)
    gain: float = 1.0
    holds_state: bool = False
    logs_action: bool = False

    def __post_init__(self) -> None:
        free, g = ("<freejoint/>", 0) if self.has_base else ("", -9.81)
        self.text = XML.format(free=free, g=g)
        self.model = mujoco.MjModel.from_xml_string(self.text)

    def observe(self, data: mujoco.MjData) -> np.ndarray:
        """Return what the policy sees."""
        turn = data.body("trunk").xmat.reshape(3, 3)
        terms = {"joint_pos": data.qpos[-3:] - HOME, "joint_vel": data.qvel[-3:].copy()}
        if self.has_base:
            terms["base_angvel"] = data.qvel[3:6].copy()
            terms["projected_gravity"] = -turn[2]
        quaternion = data.body("trunk").xquat
        names = [name for name in OBSERVATION if name in terms]
        return np.hstack([self.see(name, terms[name], quaternion) for name in names])

    def run(self, file: Path, seed: int) -> None:
        """Write the log of a policy: waves, and a feedback of what it sees."""
        rng, model, data = (
            np.random.default_rng(seed),
            self.model,
            mujoco.MjData(self.model),
        )
        mujoco.mj_setConst(model, data)
        data.qpos[-3:] = HOME
        if self.has_base:
            data.qvel[3:6] = 0.8, -0.6, 0.4
        mujoco.mj_forward(model, data)
        feedback = rng.normal(0.0, 0.04, (3, len(self.observe(data))))
        rates, phases = rng.uniform(2.0, 11.0, (3, 3)), rng.uniform(0.0, 6.0, (3, 3))
        rows = []
        for time_s in np.arange(0.0, DURATION_S, INTERVAL_S):
            seen = self.observe(data)
            action = 0.6 * np.sin(rates * time_s + phases).sum(axis=0) + feedback @ seen
            target = self.target(action, data.qpos[-3:].copy())
            row = {
                "t": time_s,
                "q": data.qpos[-3:],
                "dq": data.qvel[-3:],
                "target": target,
                "obs": seen,
            }
            if self.has_base:
                row |= {"base_pos": data.qpos[:3], "base_quat": data.qpos[3:7]}
                row |= {"base_linvel": data.qvel[:3], "base_angvel": data.qvel[3:6]}
            if self.logs_action:
                row["action"] = action
            rows.append({key: np.array(value) for key, value in row.items()})
            # What the drive gets may be another command than the program's.
            held = (HOME + self.gain * (target - HOME))[list(self.order)]
            damping = data.qvel[-3:].copy()
            for _ in range(round(INTERVAL_S / STEP_S)):
                data.ctrl[:] = held
                if self.holds_state:
                    data.qfrc_applied[-3:] = model.actuator_biasprm[:, 2] * (
                        damping - data.qvel[-3:]
                    )
                mujoco.mj_step(model, data)
        log = {key: np.array([row[key] for row in rows]) for key in rows[0]}
        for key, noise in (("q", 5e-4), ("dq", 1e-2)):
            log[key] = log[key] + rng.normal(0.0, noise, log[key].shape)
        np.savez(file, joints=np.array(["hip", "knee", "neck"]), **log)


def turned(quaternion: np.ndarray, vector: np.ndarray, way: int = 1) -> np.ndarray:
    """Return a vector turned by a quaternion w x y z, or against it."""
    result = np.zeros(3)
    mujoco.mju_rotVecQuat(result, vector, quaternion * [1, way, way, way])
    return result


def default_motor(other: Simulator) -> str:
    """Joints have a velocity motor with a limited force until it is switched off."""
    other.model.dof_frictionloss[-3:] = 0.8, 0.5, 0.15
    return "bulletphysics/bullet3#1562"


def damping_not_read(other: Simulator) -> str:
    """The importer does not read the joint damping of MJCF."""
    other.model.dof_damping[-3:] = 0.0
    return "bulletphysics/bullet3#1916"


def armature_not_set(other: Simulator) -> str:
    """The XML has no armature of the motors."""
    other.model.dof_armature[-3:] = 0.06, 0.05, 0.03
    return "unitreerobotics/unitree_ros#130"


def order_of_actions(other: Simulator) -> str:
    """The actions reach the joints in the order of the engine."""
    other.order = (2, 0, 1)
    return "isaac-sim/IsaacLab#1586"


def action_scale(other: Simulator) -> str:
    """The scale of actions is 5 in one configuration, and 10 in the other."""
    other.gain = 0.5
    return "zhaozijie2022/LocoWheeledLegged#2"


def frame(other: Simulator) -> str:
    """The angular velocity of the base is in the world frame."""
    other.see = lambda term, value, turn: (
        turned(turn, value) if term == "base_angvel" else value
    )
    return "strands-labs/robots#1187"


def quaternion(other: Simulator) -> str:
    """Poses x y z w are read as w x y z."""
    down = np.array([0.0, 0.0, -1.0])
    other.see = lambda term, value, turn: (
        turned(np.roll(turn, -1), down, -1) if term == "projected_gravity" else value
    )
    return "isaac-sim/IsaacLab#5754"


def default_pose(other: Simulator) -> str:
    """The default pose of another robot is subtracted."""
    other.see = lambda term, value, turn: (
        value + OTHER_HOME if term == "joint_pos" else value
    )
    return "IsaacZH/himloco_lab#1"


def present_pose(other: Simulator) -> str:
    """The action is added to the present angles, and not to the default pose."""
    other.target = lambda action, angles: angles + SCALE * action
    return "InternRobotics/HoST#2"


def state_held(other: Simulator) -> str:
    """The damping of the drive sees the velocities of the last policy step."""
    other.holds_state = True
    return "NVlabs/HOVER#38"


THREADS = (
    default_motor,
    damping_not_read,
    armature_not_set,
    order_of_actions,
    action_scale,
    frame,
    quaternion,
    default_pose,
    present_pose,
    state_held,
)


def first_lines(folder: Path) -> Iterator[tuple[str, str]]:
    """Yield each thread, and the first sentence of the answer."""
    for change in THREADS:
        has_base = change in (frame, quaternion)
        first, other = (
            Simulator(has_base, logs_action=change is present_pose) for _ in range(2)
        )
        thread = change(other)
        first.run(folder / "works.npz", 1)
        other.run(folder / "fails.npz", 1)
        (folder / "robot.xml").write_text(first.text)
        terms = [name for name in OBSERVATION if has_base or name.startswith("joint")]
        poses = ", ".join(
            f"{name} = {value}"
            for name, value in zip(("hip", "knee", "neck"), HOME, strict=True)
        )
        (folder / "map.toml").write_text(
            f'command = "target"\nobservation = {terms}\n'
            f"[control]\naction_scale = {SCALE}\ndefault_rad = {{ {poses} }}\n"
        )
        result = replay(
            folder / "works.npz",
            folder / "robot.xml",
            folder / "fails.npz",
            read_map(folder / "map.toml"),
        )
        yield thread, result.line.sentence


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as name:
        for thread, sentence in first_lines(Path(name)):
            print(f"{thread}: {sentence}")
            sys.stdout.flush()
