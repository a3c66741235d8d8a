"""Count the contacts and constraint rows that a model needs, and compare them with limits that a training states.

Engines on a GPU reserve memory for contacts before they run. What finds no place in it is left out: bodies sink into
the ground or pass through each other.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

DROP_COUNT = 12
"""Number of motions in which contacts are counted."""

DROP_S = 1.0
"""Simulated time of each motion [s]."""

CONTROL_S = 0.1
"""Time between changes of random controls [s]."""

DROP_HEIGHT_M = 0.05
"""Height above the start from which a floating body is dropped [m]."""

SEED = 0


@dataclass(frozen=True, kw_only=True)
class CapacityLimits:
    """Limits of an engine's memory for contacts.

    Attributes:
        njmax: Most constraint rows of a world; None when the engine chooses it.
        naconmax: Most contacts of all worlds together; None when the engine chooses it.
        worlds: Number of worlds that share `naconmax`; None when unknown.
    """

    njmax: int | None = None
    naconmax: int | None = None
    worlds: int | None = None


@dataclass(frozen=True, kw_only=True)
class ContactNeed:
    """Contacts and constraint rows that a model needs, counted in MuJoCo's C engine.

    Attributes:
        rows: Most constraint rows of a world at one time.
        contacts: Most contacts of a world at one time.
        mean_contacts: Largest mean number of contacts of all motions at the same time.
        situation: Motion in which most rows are needed.
    """

    rows: int
    contacts: int
    mean_contacts: float
    situation: str


@dataclass(frozen=True, kw_only=True)
class ContactCapacity:
    """Limits of a target, and what its own model needs.

    Attributes:
        limits: The limits.
        need: What its model needs; None when it cannot be counted.
        reason: Why it cannot be counted; empty when it can.
    """

    limits: CapacityLimits
    need: ContactNeed | None = None
    reason: str = ""

    @property
    def missing_rows(self) -> int:
        """Constraint rows of a world for which there is no place."""
        if self.need is None or self.limits.njmax is None:
            return 0
        return max(0, self.need.rows - self.limits.njmax)

    @property
    def missing_contacts(self) -> float:
        """Contacts of a world, in the mean of all worlds, for which there is no place."""
        limits = self.limits
        if self.need is None or limits.naconmax is None or limits.worlds is None:
            return 0.0
        return max(0.0, self.need.mean_contacts - limits.naconmax / limits.worlds)


@dataclass(frozen=True, kw_only=True)
class _Motion:
    """A start of a model and the controls that follow.

    Attributes:
        name: What it is, in words.
        qpos: Start, shape [nq].
        ctrl: Controls that hold it, shape [nu].
        is_random: Whether random controls drive it instead.
    """

    name: str
    qpos: NDArray[np.float64]
    ctrl: NDArray[np.float64]
    is_random: bool


def contact_capacity(
    model: mujoco.MjModel, limits: CapacityLimits, *, unknown: Sequence[int] = (), reason: str = ""
) -> ContactCapacity:
    """Return limits of a target and what its model needs.

    Args:
        model: The model.
        limits: The limits.
        unknown: Numbers of colliding geoms whose shape is not known.
        reason: Why the model's contacts cannot be counted; empty when they can.
    """
    if reason:
        return ContactCapacity(limits=limits, reason=reason)
    if limits.njmax is None and limits.naconmax is None:
        return ContactCapacity(limits=limits, reason="the engine chooses the limits")
    if len(unknown):
        return ContactCapacity(limits=limits, reason=f"the shape of {len(unknown)} colliding geoms is not known here")
    if model.nhfield:
        return ContactCapacity(
            limits=limits,
            reason="engines find different numbers of contacts on a height field; --backend mujoco_warp counts",
        )
    return ContactCapacity(limits=limits, need=contact_need(model))


def contact_need(model: mujoco.MjModel) -> ContactNeed:
    """Return the contacts and constraint rows that a model needs when it falls, lies and flails.

    The model is dropped from its keyframes, or from its initial pose when it has none, in several orientations when it
    floats, at rest and with random controls, as an untrained policy gives them. Each motion takes a second.
    """
    generator = np.random.default_rng(SEED)
    steps = max(1, round(DROP_S / model.opt.timestep))
    rows, contacts = np.zeros((DROP_COUNT, steps)), np.zeros((DROP_COUNT, steps))
    names = []
    for number, motion in enumerate(_motions(model, generator)):
        names.append(motion.name)
        for step, data in enumerate(_steps(model, motion, steps, generator)):
            rows[number, step], contacts[number, step] = data.nefc, data.ncon
    most = int(rows.max(axis=1).argmax())
    return ContactNeed(
        rows=int(rows.max()),
        contacts=int(contacts.max()),
        mean_contacts=float(contacts.mean(axis=0).max()),
        situation=names[most],
    )


def most_needed_data(model: mujoco.MjModel) -> mujoco.MjData:
    """Return the state of the motions of `contact_need` that needs most constraint rows, the first of equal ones."""
    generator = np.random.default_rng(SEED)
    steps = max(1, round(DROP_S / model.opt.timestep))
    best, most = mujoco.MjData(model), -1
    for motion in _motions(model, generator):
        for data in _steps(model, motion, steps, generator):
            if data.nefc > most:
                most = data.nefc
                mujoco.mj_copyData(best, model, data)
    return best


def _motions(model: mujoco.MjModel, generator: np.random.Generator) -> Iterator[_Motion]:
    floating = [
        int(model.jnt_qposadr[joint])
        for joint in range(model.njnt)
        if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE and model.body_parentid[model.jnt_bodyid[joint]] == 0
    ]
    starts = [
        (f"keyframe {model.key(number).name or number}", model.key_qpos[number], model.key_ctrl[number])
        for number in range(model.nkey)
    ] or [("the initial pose", model.qpos0, np.zeros(model.nu))]
    for number in range(DROP_COUNT):
        name, qpos, ctrl = starts[number // 2 % len(starts)]
        start = np.array(qpos, dtype=np.float64)
        turned = bool(floating) and number % 2 == 1
        for address in floating:
            start[address + 2] += DROP_HEIGHT_M
            if turned:
                quaternion = generator.normal(size=4)
                start[address + 3 : address + 7] = quaternion / np.linalg.norm(quaternion)
        is_random = number >= DROP_COUNT // 2
        words = ["turned at random"] * turned + ["with random controls"] * is_random
        yield _Motion(
            name=", ".join([f"a motion from {name}", *words]), qpos=start, ctrl=np.array(ctrl), is_random=is_random
        )


def _steps(
    model: mujoco.MjModel, motion: _Motion, steps: int, generator: np.random.Generator
) -> Iterator[mujoco.MjData]:
    """Yield the data after each step of a motion; a motion that diverges ends."""
    data = mujoco.MjData(model)
    data.qpos[:], data.ctrl[:] = motion.qpos, motion.ctrl
    low, high = np.where(model.actuator_ctrllimited, model.actuator_ctrlrange.T, np.array([[-1.0], [1.0]]))
    every = max(1, round(CONTROL_S / model.opt.timestep))
    for step in range(steps):
        if motion.is_random and step % every == 0:
            data.ctrl[:] = generator.uniform(low, high)
        mujoco.mj_step(model, data)
        if data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number:
            return
        yield data
