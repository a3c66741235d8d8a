"""What the names of motors and sensors say of the joints that they act on."""

import re
from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from gauge_envs.tools.sanity.robot.robot import acts_on_joints


def swapped_motors(model: mujoco.MjModel) -> tuple[dict[int, int], bool]:
    """Return the joint on which a motor should act, by the motor, where it acts on another one, and how it is known.

    Names fit by the share of their words. Where they say no joints, the order says them: makers list motors in that of
    the joints, so that two alone out of order are swapped.

    Returns:
        The joints, and whether the names of all motors say of which joint each is.
    """
    motors = np.flatnonzero(acts_on_joints(model)).tolist()
    joints = model.actuator_trnid[motors, 0].tolist()
    said = [model.actuator(motor).name for motor in motors]
    known = [model.joint(joint).name for joint in joints]
    named = _fitting(said, known)
    best = np.argsort(joints) if named is None else named
    moved = _moved(best)
    if named is None:
        # A joint with two motors has two places in the order.
        is_shared = len(joints) > len(set(joints))
        if len(joints) < FEW_MOTORS or is_shared or len(moved) != 2:
            return {}, False
        words, of_joints = _distinct(said), _distinct(known)
        for place, to in moved.items():
            here, there = (words[place] & of_joints[at] for at in (place, to))
            if len(here) > len(there):
                return {}, False
    return {motors[place]: joints[to] for place, to in moved.items()}, named is not None


def misread_joints(
    sensors: Sequence[str], read: Sequence[str], joints: Sequence[str]
) -> dict[int, str]:
    """Return the joint that the name of a sensor says, by the place of each that reads another one; of most none.

    Args:
        sensors: Names of the sensors.
        read: Name of the joint that each reads.
        joints: Names of all joints.
    """
    best = _fitting(sensors, joints)
    if best is None:
        return {}
    meant = [joints[to] for to in best]
    misread = {at: name for at, name in enumerate(meant) if name != read[at]}
    return {} if 2 * len(misread) > len(sensors) else misread


def _fitting(names: Sequence[str], others: Sequence[str]) -> NDArray[np.int_] | None:
    """Return the place of the other name that shares most words with each name; None where words do not say it."""
    if len(names) > len(others):
        return None
    said, known = _distinct(names), _distinct(others)
    fits = 1e-6 * np.eye(len(names), len(others))
    for place in np.ndindex(fits.shape):
        one, other = said[place[0]], known[place[1]]
        fits[place] += len(one & other) / max(len(one | other), 1)
    _, best = linear_sum_assignment(fits, maximize=True)
    several = zip(said, (known[place] for place in best), strict=True)
    fit = [one and other and (one <= other or other <= one) for one, other in several]
    return best if all(fit) else None


def _moved(best: NDArray[np.int_]) -> dict[int, int]:
    """Return the places that are not their own best one, with the best one; none where these are more than half."""
    moved = np.flatnonzero(best != np.arange(len(best))).tolist()
    return {} if 2 * len(moved) > len(best) else {one: int(best[one]) for one in moved}


FEW_MOTORS = 4
"""Motors from which on two out of the order of their joints are an exception."""


def _distinct(names: Sequence[str]) -> list[set[str]]:
    """Return the words and numbers of each name that not all of them have."""
    words = [set(re.findall("[a-z]+|[0-9]+", name.lower())) for name in names]
    common = set.intersection(*words) if len(words) > 1 else set()
    return [one - common for one in words]
