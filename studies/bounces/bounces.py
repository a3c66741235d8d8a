"""Fit flights of `scoring/facts/table_tennis.npz` at their bounce, and write `scoring/single_shot/ObliqueBounce-*`.

python studies/bounces/bounces.py flights    # drag and lift times spin, from the whole flight before the bounce
python studies/bounces/bounces.py states     # velocities at the bounce, restitution and ratio of impulses
python studies/bounces/bounces.py write      # the files of the trials
"""

import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_simpson

from gauge_envs.files import data_folder

FloatArray = NDArray[np.float64]

RADIUS_M, MASS_KG, AIR_KG_PER_M3 = 0.02, 0.0027, 1.18
"""As stated by the authors of the recordings."""

GRAVITY = np.array([0.0, 0.0, -9.80665])
AIR_PER_M = 0.5 * AIR_KG_PER_M3 * np.pi * RADIUS_M**2 / MASS_KG
"""Acceleration over a squared speed, for a coefficient of 1 [1/m]."""

WINDOW_S = 0.12
"""Time on each side of the bounce whose samples give the velocity at the bounce."""

BEFORE_S = 0.05
"""Time from the start of a trial to the bounce: the bounce is between frames 1 and 2."""

FRAMES = 8
MIN_SAMPLES = 5
"""Fewest samples after the bounce of a trial."""

POSITION_UNIT_M = 1e-5


SIDECAR = """# Data, written by studies/bounces/bounces.py; README.md says how.
body = "ball"
trial_count = {count}
rate_hz = 30.0
position_unit_m = 1e-05
fit = "even"
source = "flights {setting} of a table-tennis ball, \
intelligent-soft-robots/ball_prediction, commit 6532302f, without air on both sides of the bounce"
source_facts = "facts/table_tennis.toml"
licence = "ObliqueBounce.LICENSE"
exact_law = "ideal-rebounds"
copies = []

[nuisances]
length_scale = 1.0
height_offset_m = 0.0

[[events]]
name = "restitution"
unit = "1"
source = "vertical speed after the bounce over that before it, from the fitted flights"
"""


IMPULSE_RATIO = """
[[events]]
name = "impulse_ratio"
unit = "1"
source = "loss of the speed along the table over the change of the vertical speed, from the fitted flights"
"""
"""The second event. A ball that rolls before and after a bounce has none: its friction does not show."""


class Setting(NamedTuple):
    """A setting of the launcher.

    Attributes:
        source: Its name in the source.
        drag: Drag coefficient before the bounce, and
        lift: lift coefficient times spin [rad/s], both from `flights`, then lift after the bounce.
        spin_rad_per_s: Spin at the bounce and
        spin_std_rad_per_s: its standard uncertainty; `README.md` says what gave it.
    """

    source: str
    drag: float
    lift: tuple[float, float]
    spin_rad_per_s: float
    spin_std_rad_per_s: float


SETTINGS = {
    "nospin": Setting("no_spin", 0.40, (37.0, 42.0), 25.0, 6.0),
    "topspin": Setting("topspin", 0.53, (65.0, 65.0), 207.0, 12.0),
    "backspin": Setting("backspin", 0.54, (-86.0, 20.0), -363.0, 20.0),
    "robot": Setting("robot", 0.33, (-4.0, 33.0), -3.0, 6.0),
}
DRAG_STD, LIFT_STD_RAD_PER_S = 0.1, 15.0


class Flight(NamedTuple):
    """A recorded flight: its number in the source, times [s] and positions [m]."""

    number: int
    times_s: FloatArray
    positions_m: FloatArray


def flights(source: str) -> Iterator[Flight]:
    """Yield the flights of a setting."""
    with np.load(data_folder("scoring") / "facts" / "table_tennis.npz") as facts:
        data = dict(facts)
    for index in np.flatnonzero(data["setting"] == source):
        rows = slice(*data["first"][index : index + 2])
        times_s, positions_m = 1e-5 * data["time"][rows], 1e-4 * data["position"][rows]
        yield Flight(int(data["number"][index]), times_s, positions_m)


def air_acceleration(velocity: FloatArray, drag: float, lift: float) -> FloatArray:
    """Return drag, and Magnus force of a spin about y, over the mass [m/s^2]; `lift` is coefficient times spin."""
    magnus = RADIUS_M * lift * np.array([velocity[2], 0.0, -velocity[0]])
    return AIR_PER_M * (magnus - drag * np.linalg.norm(velocity) * velocity)


def before(flight: Flight) -> FloatArray:
    """Return drag coefficient, lift coefficient times spin [rad/s], and RMS [m] of the whole flight before the bounce.

    The velocity of a cubic through the flight gives the directions of drag and Magnus force. Their integrals, start
    place and start velocity are fitted by linear least squares.
    """
    lowest = int(flight.positions_m[:, 2].argmin())
    times_s, positions_m = (
        flight.times_s[: lowest - 1],
        flight.positions_m[: lowest - 1],
    )
    times_s = times_s - times_s[0]
    cubic = np.polynomial.Polynomial.fit
    velocity = np.stack(
        [cubic(times_s, values, 3).deriv()(times_s) for values in positions_m.T], axis=1
    )
    forces = [
        np.array([air_acceleration(speed, *kind) for speed in velocity])
        for kind in ((1.0, 0.0), (0.0, 1.0))
    ]
    columns = [(_twice_integrated(force, times_s)).ravel() for force in forces]
    for axis in np.eye(3):
        columns += [np.tile(axis, len(times_s)), np.outer(times_s, axis).ravel()]
    target = (positions_m - 0.5 * np.outer(times_s**2, GRAVITY)).ravel()
    design = np.stack(columns, axis=1)
    solution = np.linalg.lstsq(design, target, rcond=None)[0]
    return np.array(
        [*solution[:2], np.sqrt(np.mean((design @ solution - target) ** 2))]
    )


def _twice_integrated(values: FloatArray, times_s: FloatArray) -> FloatArray:
    once = cumulative_simpson(values, x=times_s, axis=0, initial=0.0)
    return cumulative_simpson(once, x=times_s, axis=0, initial=0.0)


class Bounce(NamedTuple):
    """Fit of a flight on both sides of its bounce.

    Attributes:
        number: Number in the source.
        before, after: Velocity at the bounce [m/s], shape [3].
        before_std, after_std: Standard uncertainty of both.
        gap_m: End of the flight before it minus start of the flight after it, shape [3].
        noise_m: RMS of the samples after it, shape [3].
    """

    number: int
    before: FloatArray
    after: FloatArray
    before_std: FloatArray
    after_std: FloatArray
    gap_m: FloatArray
    noise_m: FloatArray


class _Side(NamedTuple):
    place_m: FloatArray
    velocity: FloatArray
    std: FloatArray
    noise_m: FloatArray


def _side(
    times_s: FloatArray,
    positions_m: FloatArray,
    velocity: FloatArray,
    setting: Setting,
    lift: float,
) -> _Side:
    """Return place and velocity at time 0 of a parabola with gravity and air, and their uncertainty."""
    middle_s = float(times_s.mean())
    middle = velocity + middle_s * GRAVITY
    air = air_acceleration(middle, setting.drag, lift)
    straight = positions_m - 0.5 * times_s[:, None] ** 2 * (GRAVITY + air)
    design = np.stack([np.ones_like(times_s), times_s], axis=1)
    place_m, slope = np.linalg.lstsq(design, straight, rcond=None)[0]
    noise_m = np.sqrt(
        ((straight - design @ [place_m, slope]) ** 2).sum(axis=0) / (len(times_s) - 2)
    )
    of_noise = noise_m * np.sqrt(np.linalg.inv(design.T @ design)[1, 1])
    more = air_acceleration(middle, setting.drag + DRAG_STD, lift) - air
    spun = air_acceleration(middle, setting.drag, lift + LIFT_STD_RAD_PER_S) - air
    of_air = 0.5 * np.ptp(times_s) * np.hypot(more, spun)
    return _Side(place_m, slope, np.hypot(of_noise, of_air), noise_m)


def bounce(flight: Flight, setting: Setting) -> Bounce | None:
    """Return the bounce of a flight; None with too few samples after it."""
    lowest = int(flight.positions_m[:, 2].argmin())
    bounce_s = flight.times_s[lowest]
    speeds = [np.array([3.8, 0.0, -2.8]), np.array([2.4, 0.0, 2.8])]
    for _ in range(6):
        times_s = flight.times_s - bounce_s
        is_before = (times_s < -1e-3) & (times_s > -WINDOW_S)
        is_after = (times_s > 1e-3) & (times_s < WINDOW_S)
        if is_after.sum() < MIN_SAMPLES:
            return None
        sides = [
            _side(times_s[chosen], flight.positions_m[chosen], speed, setting, lift)
            for chosen, speed, lift in zip(
                (is_before, is_after), speeds, setting.lift, strict=True
            )
        ]
        falls, rises = sides
        speeds = [falls.velocity, rises.velocity]
        gap_m = falls.place_m - rises.place_m
        bounce_s += gap_m[2] / (rises.velocity - falls.velocity)[2]
    return Bounce(
        flight.number,
        falls.velocity,
        rises.velocity,
        falls.std,
        rises.std,
        gap_m,
        rises.noise_m,
    )


def events(item: Bounce, setting: Setting) -> dict[str, tuple[float, float]]:
    """Return restitution and tangential over normal impulse of a bounce, each with its standard uncertainty."""
    fall, rise = -item.before[2], item.after[2]
    restitution = rise / fall
    restitution_std = restitution * math.hypot(
        item.before_std[2] / fall, item.after_std[2] / rise
    )
    normal = fall + rise
    ratio = (item.before - item.after)[0] / normal
    lost_std = math.hypot(item.before_std[0], item.after_std[0])
    normal_std = math.hypot(item.before_std[2], item.after_std[2])
    # A simulation starts with the spin of the setting. It changes the impulse of a ball that grips.
    slip = item.before[0] - RADIUS_M * setting.spin_rad_per_s
    grips = abs(ratio) * normal > 0.2 * abs(slip)
    spin_std = 0.4 * RADIUS_M * setting.spin_std_rad_per_s if grips else 0.0
    ratio_std = math.hypot(lost_std, ratio * normal_std, spin_std) / normal
    return {
        "restitution": (restitution, restitution_std),
        "impulse_ratio": (ratio, ratio_std),
    }


def bounces(setting: Setting) -> list[Bounce]:
    """Return the bounces of a setting, in the order of its trials."""
    found = (bounce(flight, setting) for flight in flights(setting.source))
    return [item for item in found if item is not None]


def rigid_impact(
    velocity: FloatArray, spin: float, friction: float, restitution: float
) -> FloatArray:
    """Return the velocity after the bounce of a hollow sphere that grips or slides."""
    normal = -(1.0 + restitution) * velocity[2]
    slip = velocity[0] - RADIUS_M * spin
    tangential = -np.sign(slip) * min(friction * normal, 0.4 * abs(slip))
    return velocity + np.array([tangential, 0.0, normal])


def write(name: str, setting: Setting, folder: Path) -> None:
    """Write the trials of a setting: parabolas without air on both sides of the bounce, at the 30 Hz frames."""
    found = bounces(setting)
    times_s = np.arange(FRAMES) / 30.0 - BEFORE_S
    since_s = np.maximum(times_s, 0.0)[:, None]
    fall = 0.5 * times_s[:, None] ** 2 * GRAVITY
    contact_m = np.array([0.0, 0.0, RADIUS_M])
    positions, stds = [], []
    # A velocity of the ball along x changes by 0.6 of that before the bounce and 0.4 of that of its surface.
    of_spin = np.array([0.4 * RADIUS_M * setting.spin_std_rad_per_s, 0.0, 0.0])
    for item in found:
        speed = np.where(times_s[:, None] > 0.0, item.after, item.before)
        at_bounce_m = contact_m - np.where(times_s[:, None] > 0.0, item.gap_m, 0.0)
        positions.append(at_bounce_m + times_s[:, None] * speed + fall)
        std = np.sqrt(
            item.after_std**2
            + (np.array([0.6, 0.6, 1.0]) * item.before_std) ** 2
            + of_spin**2
        )
        stds.append(np.hypot(item.noise_m, since_s * std))
    # One more bounce differs by the scatter, which holds the noise of the fits, and not by less than the noise.
    measured = np.array([list(events(item, setting).values()) for item in found])
    measured[:, :, 1] = np.maximum(
        measured[:, :, 1], measured[:, :, 0].std(axis=0, ddof=1)
    )
    np.savez_compressed(
        folder / f"ObliqueBounce-{name}.npz",
        **{
            f"{key}{suffix}": measured[:, column, index]
            for column, key in enumerate(events(found[0], setting))
            for index, suffix in enumerate(("", "_std"))
        },
        source_number=np.array([item.number for item in found], np.int16),
        first=np.arange(len(found) + 1, dtype=np.int32) * FRAMES,
        position=np.round(np.concatenate(positions) / POSITION_UNIT_M).astype(np.int32),
        position_std=np.concatenate(stds).astype(np.float32),
        quaternion=np.tile(
            np.array([32767, 0, 0, 0], np.int16), (len(found) * FRAMES, 1)
        ),
        start_velocity=np.array(
            [item.before - BEFORE_S * GRAVITY for item in found], np.float32
        ),
        start_angular_velocity_body=np.tile(
            np.float32([0.0, setting.spin_rad_per_s, 0.0]), (len(found), 1)
        ),
    )
    (folder / f"ObliqueBounce-{name}.toml").write_text(
        SIDECAR.format(count=len(found), setting=setting.source)
        + (IMPULSE_RATIO if name != "topspin" else "")
    )


def _mean(values: list[FloatArray]) -> str:
    """Return mean and standard deviation of each column."""
    table = np.array(values)
    scatter = table.std(axis=0, ddof=1)
    return "  ".join(
        f"{mean:.3f}+-{std:.3f}"
        for mean, std in zip(table.mean(axis=0), scatter, strict=True)
    )


def main(command: str) -> None:
    """Run a command of the module."""
    for name, setting in SETTINGS.items():
        if command == "flights":
            fits = [before(flight) for flight in flights(setting.source)]
            print(
                name, len(fits), "drag, lift times spin [rad/s], RMS [m]:", _mean(fits)
            )
        elif command == "states":
            found = bounces(setting)
            for half, start in (("even", 0), ("odd", 1)):
                items = found[start::2]
                means = [
                    np.array(
                        [
                            *item.before,
                            *item.after,
                            *(value for value, _ in events(item, setting).values()),
                        ]
                    )
                    for item in items
                ]
                if len(means) > 1:
                    print(name, half, len(items), _mean(means))
                else:
                    print(name, half, means[0].round(3))
        else:
            write(name, setting, data_folder("scoring") / "single_shot")


if __name__ == "__main__":
    main(sys.argv[1])
