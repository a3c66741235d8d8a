"""Apply cures of `gauge sanity` to robots of makers: `python -m studies.robots.cures LIST.csv 'robot-*'`.

It writes the rows of these models into cures.csv, each as soon as it is known; others stay. LIST.csv is that of
`makers.py`; without patterns all rows are checked. Models before and after are
run by MuJoCo alone: held for 2 s at their keyframe, one servo after the other with a step of its command, and with a
push. A robot that floats makes its steps in the air, as the ground holds its feet. Motors without a servo get one here,
the same before and after.
"""

import csv
import sys
import time
from collections.abc import Iterable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import mujoco
import numpy as np

from gauge_envs.errors import TargetError
from gauge_envs.tools.sanity import check
from gauge_envs.tools.sanity.mended import write_mended

TABLE = Path(__file__).parent / "cures.csv"

COLUMNS = (
    *(
        "source",
        "version",
        "model",
        "rows",
        "cpu_s",
        "flags",
        "cure",
        "left",
        "refused",
    ),
    *("pose_mrad", "pose_after", "step_ms", "step_after", "push_mm", "push_after"),
)

HOLD_S, STEP_S, PUSH_S = 2.0, 1.0, 0.5
"""Time for which a pose is held, a step is awaited, and a push lasts [s]."""

STEP_RAD = 0.1
"""Step of a command [rad]."""

MOST_REASONS = 6
"""Most lines on what was tried in vain, the last of which say why each row has no cure."""

PUSH_SHARE = 0.1
"""Push, over the weight of the robot."""

FULL_TORQUE_RAD, DAMPING_S = 0.3, 0.03
"""Servo of a motor that has none: error at which it gives its largest torque [rad], and its kd over kp [s]."""


class Held:
    """A robot that servos hold in its keyframe, or in its initial pose.

    Attributes:
        model: The model.
        data: Its state.
        actuators: Actuators on hinges.
    """

    def __init__(self, path: Path) -> None:
        self.model = mujoco.MjModel.from_xml_path(str(path))
        self.data = mujoco.MjData(self.model)
        hinges = self.model.jnt_type == int(mujoco.mjtJoint.mjJNT_HINGE)
        on_joint = self.model.actuator_trntype == int(mujoco.mjtTrn.mjTRN_JOINT)
        joints = self.model.actuator_trnid[:, 0]
        self.actuators = np.flatnonzero(on_joint & hinges[joints])
        joints = joints[self.actuators]
        self._places = self.model.jnt_qposadr[joints]
        self._dofs = self.model.jnt_dofadr[joints]
        self._has_servo = self.model.actuator_biasprm[self.actuators, 1] < 0.0
        gears = self.model.actuator_gear[self.actuators, 0]
        forces = np.abs(self.model.actuator_forcerange[self.actuators]).max(axis=1)
        controls = np.abs(self.model.actuator_ctrlrange[self.actuators]).max(axis=1)
        limits = np.where(forces > 0.0, forces, controls)
        limits = np.where(limits > 0.0, limits, 1.0)
        self._kp = limits / FULL_TORQUE_RAD
        self._gears = np.where(gears == 0.0, 1.0, gears)
        self.reset()

    def reset(self) -> None:
        """Start in the keyframe, with commands that hold it."""
        mujoco.mj_resetData(self.model, self.data)
        if self.model.nkey:
            mujoco.mj_resetDataKeyframe(self.model, self.data, 0)
        self.data.time = 0.0
        mujoco.mj_forward(self.model, self.data)
        self.start = self.data.qpos[self._places].copy()
        self.goal = self.start.copy()

    def run(self, seconds: float) -> None:
        """Run with the commands."""
        for _ in range(round(seconds / self.model.opt.timestep)):
            self.step()

    def step(self) -> None:
        """Run one step."""
        error = self.goal - self.data.qpos[self._places]
        torque = self._kp * (error - DAMPING_S * self.data.qvel[self._dofs])
        command = np.where(self._has_servo, self.goal, torque) * self._gears
        self.data.ctrl[self.actuators] = command
        mujoco.mj_step(self.model, self.data)

    def pose_error_rad(self) -> float:
        """Return the largest angle of a driven hinge from the pose after 2 s [rad]."""
        self.reset()
        self.run(HOLD_S)
        return float(np.abs(self.data.qpos[self._places] - self.start).max(initial=0.0))

    def push_m(self) -> float:
        """Return how far a push on the body that the last motor moves displaces it, after 2 s [m]."""
        body = int(
            self.model.jnt_bodyid[self.model.actuator_trnid[self.actuators[-1], 0]]
        )
        root = int(self.model.body_rootid[body])
        weight_n = 9.81 * float(self.model.body_subtreemass[root])
        before = self.data.xipos[body].copy()
        self.data.xfrc_applied[body, 0] = PUSH_SHARE * weight_n
        self.run(PUSH_S)
        self.data.xfrc_applied[:] = 0.0
        return float(np.linalg.norm(self.data.xipos[body] - before))

    def half_step_s(self) -> float:
        """Return the time in which the slowest servo covers half of a step [s], among those that have room for it."""
        slowest = 0.0
        if (self.model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE)).any():
            in_air = mujoco.mjtDisableBit.mjDSBL_CONTACT
            in_air |= mujoco.mjtDisableBit.mjDSBL_GRAVITY
            self.model.opt.disableflags |= int(in_air)
        for number, actuator in enumerate(self.actuators):
            joint = int(self.model.actuator_trnid[actuator, 0])
            high = self.model.jnt_range[joint, 1]
            self.reset()
            sign = 1.0
            if self.model.jnt_limited[joint] and self.start[number] + STEP_RAD > high:
                sign = -1.0
            self.goal[number] += sign * STEP_RAD
            while self.data.time < STEP_S:
                self.step()
                moved = sign * (
                    self.data.qpos[self._places[number]] - self.start[number]
                )
                if moved >= 0.5 * STEP_RAD:
                    break
            slowest = max(slowest, float(self.data.time))
        return slowest


def plain(path: Path) -> tuple[str, str, str]:
    """Return error of the pose [mrad], slowest half of a step [ms] and push [mm] of a model, by MuJoCo alone."""
    robot = Held(path)
    if not len(robot.actuators):
        return ("", "", "")
    pose_rad = robot.pose_error_rad()
    push_m = robot.push_m()
    values = (1e3 * pose_rad, 1e3 * robot.half_step_s(), 1e3 * push_m)
    pose, step, push = (f"{value:.3g}" for value in values)
    return pose, step, push


def applied(path: Path, only: list[str]) -> dict[str, str]:
    """Return what the cure of a model mends in some rows, and plain numbers before and after."""
    begin_s = time.process_time()
    report = check(str(path), only=only)
    cpu_s = time.process_time() - begin_s
    flags = report.flags
    row = {"rows": " ".join(only) or "all", "cpu_s": f"{cpu_s:.3g}"}
    row["flags"] = " ".join(flags)
    row["refused"] = str(len(report.tried))
    if not flags:
        return row
    if report.cure is None:
        row["cure"] = "none: " + "; ".join(report.tried[-MOST_REASONS:])
        return row
    row["cure"] = report.cure.line.rpartition(": ")[0]
    with TemporaryDirectory() as folder:
        file = Path(folder, "mended.xml")
        try:
            write_mended(report, file)
        except TargetError as error:
            row["left"] = f"not written: {error}"
            return row
        after = check(str(file), only=only, explain=False)
        row["left"] = " ".join(after.flags)
        keys = ("pose", "step", "push")
        units = ("mrad", "ms", "mm")
        for key, unit, was, now in zip(
            keys, units, plain(path), plain(file), strict=True
        ):
            row[f"{key}_{unit}"] = was
            row[f"{key}_after"] = now
    return row


def renew(table: Path, columns: Sequence[str], fresh: Iterable[dict[str, str]]) -> None:
    """Write rows into a table as they come, each in the place of the one with the same first columns; others stay."""
    keys = columns[: columns.index("rows" if "rows" in columns else "row")]
    with table.open(encoding="utf-8") as stream:
        rows = {tuple(map(row.get, keys)): row for row in csv.DictReader(stream)}
    for row in fresh:
        rows[tuple(map(row.get, keys))] = row
        with table.open("w", encoding="utf-8", newline="") as stream:
            writer = csv.DictWriter(
                stream, columns, extrasaction="ignore", lineterminator="\n"
            )
            writer.writeheader()
            writer.writerows(rows.values())


def main(listing: Path, only: list[str]) -> None:
    """Write the rows of all models of a list."""
    with listing.open(encoding="utf-8") as stream:
        models = list(csv.DictReader(stream))
    renew(TABLE, COLUMNS, (one | applied(Path(one["path"]), only) for one in models))


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])
