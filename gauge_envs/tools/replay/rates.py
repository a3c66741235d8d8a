"""Checks of the velocities of a log, of its joints and of its base, by their positions."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import compress, product

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.signal import savgol_filter
from scipy.spatial.transform import Rotation

from gauge_envs.names import first_names
from gauge_envs.tools.replay.log import (
    AXES,
    MIN_NOISE,
    MIN_RATE_NOISE,
    NOISE_WINDOW,
    BoolArray,
    FloatArray,
    Log,
    best_columns,
    noise_of,
    with_joints,
)

TURN_S = 0.2
"""Time over which a motion is compared with its velocities."""
MAX_MISFIT = 0.3
"""Squared difference of the motion and the integrated velocities, over the squared motion."""
MAX_UNSURE = 0.1
"""Squared error of the integrated velocities, over this difference, beyond which the log cannot judge them."""
CLEARER = 3.0
"""Squared difference of a reading of the base, over that of another one, from which on it is wrong."""
MAX_RATE_RATIO = 1.5
"""Ratio of velocities and slopes from which on the unit or clock is wrong; motion too fast for the log has less."""
ANSWER_S = 0.015
"""Time within which no joint answers a command."""
BASE_ANSWER_S = 0.03
"""Time within which no base answers a command, and no joint swings back."""
SAME_LAW = 0.3
MAX_LEFT = 0.2
"""Relative difference of a ratio and the law of motion, and variance that the law leaves, up to which they agree."""
SAME_RATIO = 0.1
"""Relative difference of the ratios of joints, or of a unit, below which they are one."""
MAX_LATE = 0.4
"""Squared difference of velocities and slopes with velocities of a neighbouring row, over that of their own."""
RATE_UNITS = {
    "deg/s": np.rad2deg(1.0),
    "turns/s": 0.5 / np.pi,
    "rpm": 30.0 / np.pi,
    "rad/s, and positions in deg": np.deg2rad(1.0),
}
"""Units of velocities, over that of the slopes of the positions."""
BASE_READINGS = {
    "quaternion": ("wxyz", "xyzw", "base_quat is x y z w"),
    "angvel_frame": ("body", "world", "base_angvel is in the world frame"),
    "linvel_frame": ("world", "body", "base_linvel is in the body frame"),
}
"""Field of the map by what it says of the base: the usual value, the other one, and what is wrong then."""


def check_velocity(log: Log) -> Iterator[str]:
    """Add noise levels, and velocities where the log has none; compare those that it has with the positions."""
    log.position_noise = np.maximum(noise_of(log.time_s, log.position), MIN_NOISE)
    if log.velocity.shape != log.position.shape:
        half = NOISE_WINDOW // 2
        slope = np.gradient(log.position, log.time_s, axis=0)
        # With equal intervals, polynomials of degree 4 through seven samples have slopes with 0.51 of the noise of a
        # position over the interval, and central differences 0.71.
        rise, run = (
            savgol_filter(each, NOISE_WINDOW, 4, deriv=1, axis=0)
            for each in (log.position, log.time_s[:, None])
        )
        steps = sliding_window_view(np.diff(log.time_s), NOISE_WINDOW - 1)
        is_even = np.pad(steps.max(axis=1) < 1.2 * steps.min(axis=1), half)
        log.velocity = np.where(is_even[:, None], rise / run, slope)
        log.velocity_noise = 0.6 * log.position_noise / log.interval_s
        # A polynomial has no slope at its ends.
        log.keep(np.arange(len(slope))[half:-half])
        log.findings.append(
            "no velocities of all joints: differences of positions are used"
        )
        return
    for check in (_rate_order, _rate_signs, _rate_units, _late_rates):
        yield from check(log)
    # A motion that is fast for the log has other central differences than velocities.
    spline = CubicSpline(log.time_s, log.position)(log.time_s, 1)
    slopes = np.gradient(log.position, log.time_s, axis=0), spline
    gaps = [np.median(np.abs(log.velocity - slope), axis=0) for slope in slopes]
    spread = 1.4826 * np.minimum(*gaps)
    noise = np.hypot(noise_of(log.time_s, log.velocity), 0.2 * spread)
    log.velocity_noise = np.maximum(noise, MIN_RATE_NOISE)


def integral(time_s: FloatArray, rates: FloatArray) -> CubicSpline:
    """Return the integral of rates as a function of time."""
    return CubicSpline(time_s, rates).antiderivative()


@dataclass(frozen=True)
class Increments:
    """Changes of positions over TURN_S, and the same of integrated velocities.

    Attributes:
        moved, turned: Changes of the positions, and integrals of the velocities, shape [W, K].
        unsure: Mean squared error of the integrals: their difference to those of every second sample, shape [K]. It is
            large where the motion is too fast for the log.
    """

    moved: FloatArray
    turned: FloatArray
    unsure: FloatArray

    @property
    def misfit(self) -> FloatArray:
        """Mean squared difference of positions and integrals, shape [K]."""
        return np.mean((self.moved - self.turned) ** 2, axis=0)

    def ratio(self, order: NDArray[np.intp]) -> FloatArray:
        """Return integrals of velocities in an order over changes of positions, shape [K]."""
        product = np.sum(self.moved * self.turned[:, order], axis=0)
        return product / np.maximum(np.sum(self.moved**2, axis=0), 1e-12)

    @property
    def is_sure(self) -> BoolArray:
        """Whether the log can judge the velocities, shape [K]."""
        is_sure: BoolArray = self.unsure < MAX_UNSURE * self.misfit
        return is_sure


def _increments(
    time_s: FloatArray, position: FloatArray, rates: FloatArray
) -> Increments:
    """Return the increments of positions and rates over windows without a gap."""
    # With an odd number of samples, every second one ends at the same time.
    time_s = time_s[: len(time_s) - 1 + len(time_s) % 2]
    interval_s = np.median(np.diff(time_s))
    length = min(1 + round(TURN_S / interval_s), len(time_s) // 2)
    is_whole = time_s[length:] - time_s[:-length] < 1.5 * length * interval_s
    paths = [integral(time_s[::n], rates[: len(time_s) : n])(time_s) for n in (1, 2)]
    moved, turned, rough = (
        (path[length:] - path[:-length])[is_whole]
        for path in (position[: len(time_s)], *paths)
    )
    return Increments(moved, turned, np.mean((turned - rough) ** 2, axis=0))


def _rate_order(log: Log) -> Iterator[str]:
    """Put exchanged velocities back."""
    found = _increments(log.time_s, log.position, log.velocity)
    order, match = best_columns(found.moved, found.turned)
    columns = np.arange(len(log.joints))
    best = np.abs(match[columns, order])
    exchanged = _is_loud(log, found) & found.is_sure & (best > 0.9)
    exchanged &= np.abs(np.diag(match)) < best - 0.2
    exchanged &= _obeys(log, order, found.ratio(order))
    if exchanged.sum() > 1:
        order = np.where(exchanged, order, columns)
        others = {log.joints[k]: log.joints[order[k]] for k in columns[exchanged]}
        pairs = ", ".join(f"{name} has that of {others[name]}" for name in others)
        log.velocity = log.velocity[:, order]
        titles = {name: log.mapped.title(name, "velocity") for name in others.values()}
        changes = {name: {"velocity": titles[other]} for name, other in others.items()}
        log.mapped = with_joints(log.mapped, changes)
        yield f"velocities are exchanged ({pairs}): they are put back"


def _answers_between(log: Log, answer_s: float) -> bool:
    """Return whether each sample has another command, which is answered before the next sample.

    Velocities may then be unlike those between the samples at all of them.

    Args:
        log: The log.
        answer_s: Time within which no part answers a command.
    """
    is_fast = log.command_interval_s < 1.5 * log.interval_s
    return bool(log.command_kind) and is_fast and log.interval_s > answer_s


def _obeys(log: Log, order: NDArray[np.intp], ratio: FloatArray) -> BoolArray:
    """Return whether a linear law of motion agrees with the ratio of velocities and slopes of each joint, shape [J].

    All do if no command is answered between two samples. The law x' = F x + G u over an interval h is
    x[k + 1] = exp(F h) x[k] + ..., by least squares. Its rows of the positions give q' = dq, or the ratio of another
    unit. A velocity that is the slope with the other sign needs no law: no joint moves against its velocity.
    """
    count = len(order)
    if not _answers_between(log, ANSWER_S):
        return np.ones(count, bool)
    state = np.hstack([log.position, log.velocity])
    command = log.held_command()
    given = np.hstack(
        [state[1:-1], command[1:-1], command[:-2], np.ones((len(state) - 2, 1))]
    )
    swings_back = log.interval_s > BASE_ANSWER_S
    is_opposite: BoolArray = (np.abs(ratio + 1.0) < SAME_LAW) & (not swings_back)
    if len(given) < 2 * given.shape[1]:
        return is_opposite
    law = np.linalg.lstsq(given, state[2:], rcond=None)[0]
    left = np.var(state[2:] - given @ law, axis=0) / np.maximum(
        np.var(state, axis=0), 1e-12
    )
    values, vectors = np.linalg.eig(law[: 2 * count].T)
    slopes = (
        (vectors * np.log(values + 1e-12j)) @ np.linalg.pinv(vectors) / log.interval_s
    )
    places = count + order
    slope = slopes.real[range(count), places]
    agrees = (np.abs(slope * ratio - 1.0) < SAME_LAW) & (left[places] < MAX_LEFT)
    # The law of a servo that rings is off by a third: it must differ from q' = dq as clearly as the ratio does.
    is_unlike = np.abs(np.log(np.abs([slope, ratio]) + 1e-12)) > np.log(MAX_RATE_RATIO)
    return is_opposite | (agrees & (is_unlike[0] | ~is_unlike[1]))


def _is_loud(log: Log, found: Increments) -> BoolArray:
    """Return which joints move; noise moves a joint that rests."""
    return np.std(found.moved, axis=0) > 8.0 * log.position_noise


def _ratios(log: Log) -> tuple[FloatArray, BoolArray, BoolArray]:
    """Return velocities over slopes, which joints show that they are one motion, and which of them judge it."""
    found = _increments(log.time_s, log.position, log.velocity)
    own = np.arange(len(log.joints))
    ratio = found.ratio(own)
    moved, turned = np.square([found.moved, found.turned]).sum(axis=1)
    is_clear = _is_loud(log, found) & (ratio**2 * moved > 0.81 * turned)
    is_judged = is_clear & found.is_sure & _obeys(log, own, ratio)
    return ratio, is_clear, is_judged


def _divide_rates(log: Log, factor: FloatArray) -> None:
    """Divide the velocity of each joint, in the map too."""
    log.velocity = log.velocity / factor
    changes = {
        name: {
            "velocity_scale": float(
                f"{log.mapped.joint(name).velocity_scale / number:.4g}"
            )
        }
        for name, number in zip(log.joints, factor.tolist(), strict=True)
        if number != 1.0
    }
    log.mapped = with_joints(log.mapped, changes)


def _rate_signs(log: Log) -> Iterator[str]:
    """Turn velocities that have the opposite sign of the slopes of the positions."""
    ratio, _, is_judged = _ratios(log)
    is_turned = is_judged & (ratio < 0.0)
    if is_turned.any():
        _divide_rates(log, np.where(is_turned, -1.0, 1.0))
        names = first_names([*compress(log.joints, is_turned)])
        yield f"velocities of {names} have the opposite sign of the slope of the positions: it is turned"


def _rate_units(log: Log) -> Iterator[str]:
    """Bring velocities to the unit of the slopes of the positions, for all joints or for single ones."""
    ratio, is_clear, is_judged = _ratios(log)
    ratio = np.maximum(ratio, 1e-12)
    is_unlike = np.abs(np.log(ratio)) > np.log(MAX_RATE_RATIO)
    is_far = is_judged & is_unlike
    if not is_far.any():
        return
    common = np.median(ratio[is_clear])
    # The clock, or another unit, concerns all joints.
    is_one = np.allclose(ratio[is_clear], common, rtol=SAME_RATIO)
    is_common = is_unlike[is_clear].all() and (is_one or not is_judged[is_clear].all())
    if not is_common or 2 * is_clear.sum() <= len(ratio) > 1:
        _divide_rates(log, np.where(is_far, ratio, 1.0))
        for joint, number in compress(zip(log.joints, ratio, strict=True), is_far):
            yield f"velocity of {joint} is {number:.3g} times the slope of its position: it is divided by that"
        return
    for unit, factor in RATE_UNITS.items():
        if np.isclose(common, factor, rtol=SAME_RATIO):
            _divide_rates(log, np.full(len(ratio), factor))
            yield f"velocities are in {unit}, by the slope of the positions: they are converted"
            return
    log.is_usable = False
    yield (
        f"velocities are {common:.3g} times the slope of the positions: another unit, or the clock runs at another rate"
    )


def _late_rates(log: Log) -> Iterator[str]:
    """Bring velocities that are a row late or early to the slopes of the positions."""
    inner = slice(1, -1)
    errors = {
        shift: _increments(
            log.time_s[inner],
            log.position[inner],
            np.roll(log.velocity, -shift, axis=0)[inner],
        ).misfit.mean()
        for shift in (0, -1, 1)
    }
    shift = min(errors, key=lambda row: errors[row])
    if errors[shift] < MAX_LATE * errors[0]:
        log.velocity = np.roll(log.velocity, -shift, axis=0)
        log.keep(np.arange(1, len(log.time_s) - 1))
        yield f"velocities are a row {'late' if shift > 0 else 'early'}: they are put back"


@dataclass(frozen=True)
class BaseReading:
    """A base by another order of quaternions, or other frames of its velocities.

    Attributes:
        fields: Values of the map.
        misfit: Squared difference of linear and of angular velocities to the pose, over its limit.
        pose, twist: In the terms of a log.
        slope: Velocities that the pose shows.
    """

    fields: dict[str, str]
    misfit: FloatArray
    pose: FloatArray
    twist: FloatArray
    slope: FloatArray

    @property
    def turn(self) -> tuple[str, str]:
        """Order of quaternions, and frame of angular velocities."""
        return self.fields["quaternion"], self.fields["angvel_frame"]


def _base_readings(log: Log) -> Iterator[BaseReading]:
    """Yield the readings of the base that the map allows, the usual one first."""
    position, quaternion = np.split(log.base_pose, [3], axis=1)
    # Without velocities, zeros are compared with the pose.
    linear, angular = np.hsplit(np.resize(log.base_twist, (len(position), 6)), 2)
    # A turn has the noise of two quaternions, whose change is half of the angle.
    noise = noise_of(log.time_s, log.base_pose).max() + MIN_NOISE
    choices = [
        (getattr(log.mapped, name),) if getattr(log.mapped, name) else row[:2]
        for name, row in BASE_READINGS.items()
    ]
    for fields in product(*choices):
        order, angular_frame, linear_frame = fields
        shift = int(order == "xyzw")
        pose = np.hstack([position, np.roll(quaternion, shift, axis=1)])
        turn = Rotation.from_quat(pose[:, 3:], scalar_first=True)
        steps = (turn[:-1].inv() * turn[1:]).as_rotvec()
        turned = np.vstack([np.zeros(3), np.cumsum(steps, axis=0)])
        rate = np.vstack([steps, steps[-1:]]) / np.gradient(log.time_s)[:, None]
        in_body = turn.inv().apply(angular) if angular_frame == "world" else angular
        in_world = turn.apply(linear) if linear_frame == "body" else linear
        twist = np.hstack([in_world, in_body])
        found = _increments(log.time_s, np.hstack([position, turned]), twist)
        misfit, unsure, motion = (
            np.mean(np.reshape(each, (2, 3)), axis=1)
            for each in (found.misfit, found.unsure, np.mean(found.moved**2, axis=0))
        )
        limit = MAX_MISFIT * motion + 8.0 * noise**2 + unsure / MAX_UNSURE
        slope = np.hstack([np.gradient(position, log.time_s, axis=0), rate])
        names = dict(zip(BASE_READINGS, fields, strict=True))
        yield BaseReading(names, misfit / limit, pose, twist, slope)


def _clearest(readings: Sequence[BaseReading], kind: int) -> BaseReading:
    """Return the usual reading, or the best one by linear (0) or angular (1) velocities if it is clearly better."""
    usual, best = readings[0], min(readings, key=lambda each: each.misfit[kind])
    is_wrong = usual.misfit[kind] > max(1.0, CLEARER * best.misfit[kind])
    return best if is_wrong else usual


def check_base(log: Log) -> Iterator[str]:
    """Bring the base to quaternions w x y z, angular velocities in its own frame and linear ones in that of the world.

    Velocities that the pose contradicts are replaced by its differences.
    """
    if log.base_pose.shape[1] != 7:
        return
    is_given = log.base_twist.shape[1] == 6
    readings = [*_base_readings(log)]
    angular = _clearest(readings, 1)
    reading = _clearest([each for each in readings if each.turn == angular.turn], 0)
    changes = {
        name: value
        for name, value in reading.fields.items()
        if value == BASE_READINGS[name][1] and not getattr(log.mapped, name)
    }
    log.mapped = log.mapped.model_copy(update=changes)
    log.base_pose, log.base_twist = reading.pose, reading.twist
    for name in changes:
        yield f"{BASE_READINGS[name][2]}: it is turned"
    limit = CLEARER * angular.misfit[1]
    orders = {each.turn[0] for each in readings if each.misfit[1] <= limit}
    if len(orders) > 1:
        log.findings.append(
            "base_angvel does not show the order of base_quat: it is taken as w x y z; "
            'if it is x y z w, add quaternion = "xyzw" to --map'
        )
    is_unlike = (reading.misfit > 1.0).any()
    if not is_given or (is_unlike and not _answers_between(log, BASE_ANSWER_S)):
        log.base_twist = reading.slope
        if is_given:
            yield "base velocities do not fit the pose: its differences are used"
        else:
            log.findings.append("no base velocities: differences of the pose are used")
    _turn_axes(log)


def _turn_axes(log: Log) -> None:
    """Turn the base, or its position alone, to the axes of the model."""
    mapped = log.mapped
    turn = AXES[mapped.axes]
    place = AXES[mapped.position_axes] * turn
    for columns in (log.base_pose[:, :3], log.base_twist[:, :3]):
        columns[:] = place.apply(columns)
    pose = Rotation.from_quat(log.base_pose[:, 3:], scalar_first=True)
    log.base_pose[:, 3:] = (turn * pose * turn.inv()).as_quat(scalar_first=True)
    log.base_twist[:, 3:] = turn.apply(log.base_twist[:, 3:])
