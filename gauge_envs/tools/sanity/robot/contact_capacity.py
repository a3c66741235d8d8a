"""Count the contacts and constraint rows that a model needs, and compare them with limits that a training states.

Engines on a GPU reserve memory for contacts before they run. What finds no place in it is left out: bodies sink into
the ground or pass through each other.
"""

from collections.abc import Iterator

import mujoco
import numpy as np

from gauge_envs.tools.sanity.model import CapacityLimits, ContactCapacity, ContactNeed
from gauge_envs.tools.sanity.robot.mujoco_feet import joints_of

DROP_COUNT = 12
"""Number of motions in which contacts are counted."""

DROP_S = 1.0
"""Simulated time of each motion [s]."""

CONTROL_S = 0.1
"""Time between changes of random controls [s]."""

DROP_HEIGHT_M = 0.05
"""Height above the start from which a floating body is dropped [m]."""

SEED = 0


def contact_capacity(model: mujoco.MjModel, limits: CapacityLimits) -> ContactCapacity:
    """Return limits of a target and what its model needs.

    Args:
        model: The model.
        limits: The limits.
    """
    if limits.njmax is None and limits.naconmax is None:
        return ContactCapacity(limits=limits, reason="the engine chooses the limits")
    if model.nhfield:
        return ContactCapacity(
            limits=limits,
            reason="engines find different numbers of contacts on a height field",
        )
    return ContactCapacity(limits=limits, need=contact_need(model))


def contact_need(model: mujoco.MjModel) -> ContactNeed:
    """Return the contacts and constraint rows that a model needs when it falls, lies and flails.

    The model is dropped from its keyframes, or from its initial pose when it has none, in several orientations when it
    floats, at rest and with random controls, as an untrained policy gives them. Each motion takes a second.
    """
    rows, contacts = np.zeros((2, DROP_COUNT, _step_count(model)))
    names = []
    for number, (name, states) in enumerate(_motions(model)):
        names.append(name)
        for step, data in enumerate(states):
            rows[number, step], contacts[number, step] = data.nefc, data.ncon
    return ContactNeed(
        rows=int(rows.max()),
        contacts=int(contacts.max()),
        mean_contacts=float(contacts.mean(axis=0).max()),
        situation=names[int(rows.max(axis=1).argmax())],
    )


def _step_count(model: mujoco.MjModel) -> int:
    return max(1, round(DROP_S / model.opt.timestep))


def _motions(model: mujoco.MjModel) -> Iterator[tuple[str, Iterator[mujoco.MjData]]]:
    """Yield motions: the name of each in words, and its data after each step."""
    generator = np.random.default_rng(SEED)
    is_root = model.body_parentid[model.jnt_bodyid] == 0
    floating = model.jnt_qposadr[joints_of(model, "FREE") & is_root].tolist()
    starts = [
        (
            f"keyframe {model.key(number).name or number}",
            model.key_qpos[number],
            model.key_ctrl[number],
        )
        for number in range(model.nkey)
    ] or [("the initial pose", model.qpos0, np.zeros(model.nu))]
    for number in range(DROP_COUNT):
        data = mujoco.MjData(model)
        name, data.qpos[:], data.ctrl[:] = starts[number // 2 % len(starts)]
        turned = bool(floating) and number % 2 == 1
        for address in floating:
            data.qpos[address + 2] += DROP_HEIGHT_M
            if turned:
                quaternion = generator.normal(size=4)
                data.qpos[address + 3 : address + 7] = quaternion / np.linalg.norm(
                    quaternion
                )
        is_random = number >= DROP_COUNT // 2
        words = ["turned at random"] * turned + ["with random controls"] * is_random
        yield (
            ", ".join([f"a motion from {name}", *words]),
            _steps(model, data, generator if is_random else None),
        )


def _steps(
    model: mujoco.MjModel, data: mujoco.MjData, controls: np.random.Generator | None
) -> Iterator[mujoco.MjData]:
    """Yield the data after each step of a motion, which random controls may drive; a motion that diverges ends."""
    low, high = np.where(
        model.actuator_ctrllimited,
        model.actuator_ctrlrange.T,
        np.array([[-1.0], [1.0]]),
    )
    every = max(1, round(CONTROL_S / model.opt.timestep))
    for step in range(_step_count(model)):
        if controls is not None and step % every == 0:
            data.ctrl[:] = controls.uniform(low, high)
        mujoco.mj_step(model, data)
        if data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number:
            return
        yield data
