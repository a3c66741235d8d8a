"""Conventions of a log that the model contradicts: units, signs, order of joints, axes of the base."""

from collections.abc import Callable, Iterator
from itertools import combinations

import mujoco
import numpy as np

from gauge_envs.errors import GaugeError
from gauge_envs.tools.replay.log import (
    AXES,
    OWN_AXES,
    FloatArray,
    Log,
    LogMap,
    with_joints,
)
from gauge_envs.tools.replay.model import Replayer, build_setup

HORIZON_S = 0.1
PIECES = 16
MIN_SAMPLES = 3
"""Length of the predictions that judge a convention, and their number."""
MIN_GAIN = 1.0
"""Decrease of the sum of the logarithms of errors over noise [nat] that a convention must bring; a mistake of one joint
changes one term, and a physical cause is not a convention."""
MAX_MISFIT = -0.5
"""Largest misfit [nat], after the change, of a degree of freedom that gains: the model then predicts it."""
EQUAL = 0.3
"""Difference of these sums below which two conventions predict a log as well."""
MAX_ANGLE = np.pi
"""Angle [rad] beyond which angles may have another unit."""
MOVES = 0.05
"""Motion of a base that is not fixed [m], or of its quaternion."""

Reader = Callable[[LogMap], Log]


def find_conventions(
    read: Reader, model: mujoco.MjModel, mapped: LogMap
) -> tuple[LogMap, list[str]]:
    """Return the map by which the model predicts a log far better, and what it corrects.

    Each convention is judged by short predictions: its error over that of constant velocity, which has the same unit.

    Args:
        read: Returns the log by a map.
        model: The compiled model.
        mapped: The map that the user gave.
    """
    texts: list[str] = []
    log = read(mapped)
    if not log.is_usable:
        return mapped, texts
    best, gain = misfits(log, model)
    for _ in range(1 + len(log.joints)):
        found = []
        for text, changed in _conventions(log, model, mapped, gain):
            try:
                trial, _ = misfits(read(changed), model)
            except GaugeError:
                continue
            less = best - trial
            if trial[less >= min(MIN_GAIN, less.max())].min() < MAX_MISFIT:
                found.append((trial.sum(), text, changed))
        least = min((total for total, *_ in found), default=np.inf)
        if best.sum() - least < MIN_GAIN:
            break
        # Of equal ones the first is the usual one.
        _, text, mapped = next(row for row in found if row[0] < least + EQUAL)
        texts.append(text)
        best, gain = misfits(read(mapped), model)
    return mapped, texts


def misfits(log: Log, model: mujoco.MjModel) -> tuple[FloatArray, FloatArray]:
    """Return the misfit of short predictions, and how much of it is above 1.5 times the noise, shape [D]."""
    replayer = Replayer(log, model)
    setup = build_setup(model, log)
    horizon_s = max(HORIZON_S, MIN_SAMPLES * log.interval_s)
    pieces = replayer.pieces(horizon_s, PIECES, MIN_SAMPLES)
    misfit = replayer.misfit(setup, pieces)
    least = np.log(1.5 * replayer.spread(pieces) / replayer.baseline(pieces))
    return misfit, np.maximum(misfit - least, 0.0)


def _conventions(
    log: Log, model: mujoco.MjModel, mapped: LogMap, gain: FloatArray
) -> Iterator[tuple[str, LogMap]]:
    """Yield what each convention that may gain enough corrects, and its map."""
    if gain.sum() < MIN_GAIN:
        return
    joints = {name: model.joint(name) for name in log.joints}
    is_far = np.abs(log.position).max() > MAX_ANGLE
    slide = mujoco.mjtJoint.mjJNT_SLIDE.value
    radians, metres, percent = {}, {}, {}
    for name, joint in joints.items():
        low, high = joint.range.tolist()
        percent[name] = {
            "scale": (high - low) / 200.0,
            "offset_rad": (low + high) / 2.0,
        }
        if joint.type[0] == slide:
            metres[name] = {"scale": 1e-3}
        else:
            radians[name] = {"scale": float(np.deg2rad(1.0))}
    if mapped.unit == "rad" and is_far:
        degrees = mapped.model_copy(update={"unit": "deg"})
        yield (
            "angles are in degrees",
            with_joints(mapped, radians) if metres else degrees,
        )
    if is_far and all(each["scale"] > 0.0 for each in percent.values()):
        yield "positions are -100 to 100 of each range", with_joints(mapped, percent)
    if metres:
        yield f"lengths of {', '.join(metres)} are in mm", with_joints(mapped, metres)
    if len(gain) > len(joints) and gain[:6].sum() > MIN_GAIN:
        yield from _base_conventions(mapped)
    for name in joints:
        sign = -mapped.joint(name).sign
        yield (
            f"the sign of {name} is reversed",
            with_joints(mapped, {name: {"sign": sign}}),
        )
    for first, second in combinations(joints, 2):
        titles = [mapped.joint(name).log or name for name in (first, second)]
        exchanged = {first: {"log": titles[1]}, second: {"log": titles[0]}}
        yield f"{first} and {second} are exchanged", with_joints(mapped, exchanged)


def _base_conventions(mapped: LogMap) -> Iterator[tuple[str, LogMap]]:
    """Yield another order of quaternions, and other axes of the base or of its position alone."""
    if not mapped.quaternion:
        other = mapped.model_copy(update={"quaternion": "xyzw"})
        yield "base_quat is x y z w", other
    if (mapped.axes, mapped.position_axes) != (OWN_AXES, OWN_AXES):
        return
    for key, part in (("axes", "base"), ("position_axes", "position of the base")):
        for axes in AXES:
            text = (
                f"the {part} has other axes: x y z of the model are {axes} of the log"
            )
            if axes != OWN_AXES:
                yield text, mapped.model_copy(update={key: axes})


def check_fixed_base(log: Log, model: mujoco.MjModel) -> None:
    """Name the motion of a base that is fixed in the model."""
    is_free = (model.jnt_type == mujoco.mjtJoint.mjJNT_FREE.value).any()
    moved = np.ptp(log.base_pose, axis=0).max(initial=0.0)
    if not is_free and moved > MOVES:
        log.is_usable = False
        log.mistakes.append(
            f"its base moves by {moved:.2g} m, but the base of the model is fixed: add a free joint to the model"
        )
