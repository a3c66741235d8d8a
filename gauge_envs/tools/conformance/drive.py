"""Driven bodies: velocity, path, slow motion, and what they carry and leave behind."""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs.fixtures.parts import box, contact, driven_box, driver, ramp
from gauge_envs.fixtures.recording import Recording
from gauge_envs.fixtures.slope import moved_m, slope_of
from gauge_envs.scene import GRAVITY_M_PER_S2 as G, Box, Cylinder, Scene
from gauge_envs.scene.drivers import Driver, DriverMotion
from gauge_envs.scene.geometry import FloatArray, length_of, vector
from gauge_envs.scene.profiles import TrapezoidProfile
from gauge_envs.scoring.estimators import acceleration_m_per_s2
from gauge_envs.tools.conformance.lab import (
    Lab,
    Measurement,
    largest,
    largest_mm,
    ratio,
)
from gauge_envs.tools.conformance.model import Checks, Level, Tolerance

check = Checks(Level.CONTACT)


BLOCK_M = (0.5, 0.3, 0.1)
LINE, AXIS = (0.6, 0.0, 0.8), (0.48, 0.64, -0.6)
BLOCKS = {
    "sliding block": ((0.0, 0.0, 40.0), 0.3, LINE, 0.0, AXIS),
    "turning block": ((30.0, -20.0, 0.0), 0.0, LINE, 0.8, AXIS),
    "first block": ((-70.0, 35.0, 20.0), -0.6, (0.0, -0.6, 0.8), 1.5, LINE),
    "second block": ((25.0, -15.0, 80.0), -0.5, (0.8, 0.6, 0.0), -1.3, AXIS),
    "third block": ((0.0, 50.0, -130.0), -0.4, (0.6, 0.0, -0.8), 1.1, (0.0, -0.8, 0.6)),
}
"""Orientation [deg], path [m] along a line, and angle [rad] about an axis in each stroke; from simple to compound."""

BESIDE_M = (-0.2, 0.3, -0.2)
"""Place of the axis of a block, from its centre [m]."""


def _strokes(amount: float) -> tuple[TrapezoidProfile, ...]:
    return tuple(
        ramp(amount, start_s=start_s, duration_s=0.4, ramp_s=0.05)
        for start_s in (0.0, 2.1)
    )


def _blocks(lab: Lab) -> Recording:
    """Record five driven blocks without contacts that move in two strokes; up to 86 rad/s^2 and 34 m/s^2."""
    blocks, drivers = [], []
    for number, (name, (euler_deg, path_m, line, angle, axis)) in enumerate(
        BLOCKS.items()
    ):
        place = np.array([0.3 + number, -0.2, 1.0])
        rotation = DriverMotion(
            kind="rotate",
            axis=axis,
            profiles=_strokes(angle),
            point_m=vector(place + BESIDE_M),
        )
        move = DriverMotion(kind="translate", axis=line, profiles=_strokes(path_m))
        blocks.append(driven_box(name, vector(place), BLOCK_M, euler_deg=euler_deg))
        drivers.append(
            Driver(body=name, motions=(rotation, move), provenance="nominal")
        )
    return lab.run(blocks, (), 2.6, drivers=tuple(drivers))


def _asked(rollout: Recording, name: str) -> FloatArray:
    """Return poses and rates that the scene prescribes for a driven body, shape [sample_count, 13]."""
    motion = next(driven for driven in rollout.scene.drivers if driven.body == name)
    return motion.path(rollout.scene.body(name).pose, rollout.times_s)


@check(
    "driven-velocity",
    title="driven body has its driver's velocity",
    law="v = prescribed v, omega = prescribed omega",
    unit="%",
    tolerance=Tolerance(
        "a velocity that is 0.1 % high moves what a turntable carries by the scatter of real trials, 1 mm",
        absolute=0.05,
    ),
    cause="drive() must give the body its velocity, which body_states returns in the frame of the world",
)
def driven_velocity(lab: Lab) -> Measurement:
    """Two driven blocks: one slides at 0.86 m/s along a leaning line, one turns at 2.3 rad/s about a leaning axis.

    Error of the reported linear or angular velocity over the prescribed one, mean of 0.15 to 0.35 s; the larger one.

    Source: contract (Simulation.drive).
    """
    rollout = lab.once(_blocks)
    cruise = rollout.between(0.15, 0.35)
    errors, mistakes = {}, {}
    for name, rates in (
        ("sliding block", slice(7, 10)),
        ("turning block", slice(10, 13)),
    ):
        states = rollout.states[name]
        asked = _asked(rollout, name)[cruise, rates].mean(axis=0)
        reported = states[cruise, rates].mean(axis=0)
        share = reported @ asked / (asked @ asked)
        percent = 100.0 / length_of(asked)
        moved, beside = np.ptp(states[:, :7], 0), reported - share * asked
        case = f"the velocity of the {name}"
        errors[case] = percent * length_of(reported - asked)
        mistakes[case] = {
            "it stands still, so that drive() has no effect": percent
            * length_of(moved),
            f"it reports {share:.4g} times its velocity": percent * length_of(beside),
        }
    return largest(errors, "%", mistakes)


def _off_path(rollout: Recording, name: str) -> tuple[float, dict[str, float]]:
    """Return the largest distance of a corner of a block from its path, and the rest after known mistakes [mm]."""
    asked = _asked(rollout, name)
    path, places = (
        states[:, None, :3]
        + Box(size_m=BLOCK_M).corners_m
        @ Rotation.from_quat(states[:, 3:7], scalar_first=True).inv().as_matrix()
        for states in (asked, rollout.states[name])
    )
    moved = places[1:] - path[:-1]
    steady = rollout.interval_s * asked[:-1, None, 7:10]
    return largest_mm(places - path), {
        # Ramps begin within an interval, so that a fifth of the error is left.
        "it comes one interval late, or drive() moves it without velocity": 0.15
        * largest_mm(moved),
        "it moves as if the acceleration that drive() gives were 0": largest_mm(
            moved - steady
        ),
    }


@check(
    "driven-path",
    title="driven bodies follow their drivers",
    law="pose = prescribed pose",
    unit="mm",
    tolerance=Tolerance("a tenth of the real trials' scatter", absolute=0.1),
    cause="each call of drive() gives the pose at the start of the interval, and rates in the world frame",
)
def driven_path(lab: Lab) -> Measurement:
    """Five driven blocks without contacts: one slides, one turns, three slide and turn about leaning axes beside them.

    Largest distance of a corner from its prescribed place, in strokes of 0.4 s from 0 and 2.1 s; the first block
    that is off by more than 0.1 mm, or the worst one.

    Source: contract (Simulation.drive).
    """
    rollout = lab.once(_blocks)
    errors, mistakes = {}, {}
    for name in BLOCKS:
        case = f"the {name}"
        errors[case], mistakes[case] = _off_path(rollout, name)
        # The simplest wrong block is the most informative.
        if not errors[case] < 0.1:
            return largest({case: errors[case]}, "mm", mistakes)
    return largest(errors, "mm", mistakes)


CUBE_M = (0.05, 0.05, 0.05)
X, Z = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)
PLATES = {
    # Amount [m or rad] along x or about z, start, duration and ramps [s], axis and cube along x [m], friction.
    "disc": (3.0, Z, 0.0, 2.5, 0.5, 0.0, 0.1, 0.4),
    "early plate": (0.32, X, 0.0, 0.8, 0.4, 0.0, 0.0, 0.05),
    # Single precision moves slow bodies well near the origin alone.
    "plate at 2 mm/s": (2e-3, X, 0.0, 1.0, 0.01, 0.0, 0.0, 0.4),
    "plate at 0.02 rad/s": (0.02, Z, 0.0, 1.0, 0.01, -0.1, 0.0, 0.4),
    "plate": (0.3, X, 0.0, 1.1, 0.4, 0.0, 0.0, 0.4),
    "late plate": (0.32, X, 2.1, 0.8, 0.4, 0.0, 0.0, 0.1),
}


def _plates(lab: Lab) -> Recording:
    """Record driven plates with a cube on each; the disc is a cylinder where the engine drives one."""
    plates, cubes, contacts, drivers = [], [], [], []
    for number, (name, row) in enumerate(PLATES.items()):
        amount, axis, start_s, duration_s, ramp_s, axis_m, cube_m, friction = row
        x_m, cube = number - 2.0, f"cube on {name}"
        plates.append(driven_box(name, (x_m, 0.0, 0.5), (0.4, 0.3, 0.02)))
        cubes.append(box(cube, (x_m + cube_m, 0.0, 0.535), CUBE_M))
        # Either body of a pair may come first.
        pair = (cube, name) if number % 2 else (name, cube)
        contacts.append(contact(*pair, friction=friction))
        kind: Literal["translate", "rotate"] = "rotate" if axis == Z else "translate"
        stroke = ramp(amount, start_s=start_s, duration_s=duration_s, ramp_s=ramp_s)
        point_m = (x_m + axis_m, 0.0, 0.0)
        drivers.append(driver(name, kind, axis, stroke, point_m=point_m))
    boxes = Scene(
        bodies=(*plates, *cubes),
        contacts=tuple(contacts),
        drivers=tuple(drivers),
        duration_s=2.4,
    )
    disc = replace(plates[0], shape=Cylinder(radius_m=0.15, length_m=0.02))
    scene = replace(boxes, bodies=(disc, *plates[1:], *cubes))
    return lab.rollout(scene if lab.supports(scene) else boxes)


def unless_off(
    measurement: Measurement, rollout: Recording, supports: Mapping[str, str]
) -> Measurement:
    """Return a measurement, with another hint and cause if a body does not stay on its support.

    Args:
        measurement: The measurement.
        rollout: A rollout of bodies that move along their supports.
        supports: Support of each body.
    """
    for name, support in supports.items():
        fallen_m = -moved_m(rollout, name, support)[-1, 2]
        cosine = math.cos(slope_of(rollout, support).angle_rad)
        if not fallen_m > 1e-3:
            continue
        hint = f"the {name} leaves the {support}"
        cause = "one of them has another size, place or orientation"
        if fallen_m > 0.45 * G * cosine * rollout.times_s[-1] ** 2:
            hint = f"the {name} falls through the {support}"
            cause = "the pair has no contact"
        return replace(measurement, hint=hint, cause=cause)
    return measurement


ONE_FACTOR = 0.03
"""Largest difference of ratios that are one factor, over the factor."""


def worst_friction(
    rollout: Recording, slides: Mapping[str, tuple[float, float, str]]
) -> Measurement:
    """Measure the worst ratio of friction to the friction of the pair.

    Args:
        rollout: A rollout of slides.
        slides: Measured friction, friction of the pair, and support of each sliding body.
    """
    shares = {name: friction / pair for name, (friction, pair, _) in slides.items()}
    worst = ratio(shares, "the friction")
    if all(abs(shares[name] / slides[name][1] - 1.0) < 0.05 for name in slides):
        cause = "the engine multiplies the values of two bodies, and it is the pair's"
        worst = replace(worst, hint="the friction is squared", cause=cause)
    elif np.abs(worst.measured - np.sqrt([0.5, 2.0])).min() < 0.01:
        worst = replace(worst, cause="friction is a pyramid in place of a cone")
    elif len(shares) > 2 and np.ptp([*shares.values()]) < ONE_FACTOR * worst.measured:
        what = "smaller" if worst.measured < 1.0 else "larger"
        cause = f"friction is {what} than Contact.friction, by one factor in all slides"
        worst = replace(worst, cause=cause)
    supports = {name: support for name, (*_, support) in slides.items()}
    return unless_off(worst, rollout, supports)


@check(
    "carry-slip",
    title="plates slip under cubes",
    law="a = mu g",
    tolerance=Tolerance(
        "1 % as for a slide, and 1 % since the plate's speed changes within an interval",
        absolute=0.02,
    ),
    cause="friction on a driven body is not the pair's; if it is 0 on the late plate alone, the cube sleeps, and the "
    "driven plate does not wake it",
)
def carry_slip(lab: Lab) -> Measurement:
    """Two driven plates under cubes that accelerate by 2 m/s^2, at once and after 2.1 s at rest; friction 0.05 and 0.1.

    Acceleration of a cube over mu g, quadratic fit over 0.3 s; the worst of both.

    Source: Coulomb.
    """
    rollout = lab.once(_plates)
    slides = {}
    for name in ("early plate", "late plate"):
        _, _, start_s, *_, friction = PLATES[name]
        part = rollout.cut(start_s, start_s + 0.3)
        path_m = part.displacement(f"cube on {name}")[:, 0]
        rate = acceleration_m_per_s2(part.times_s, path_m)
        slides[f"cube on {name}"] = (rate / G, friction, name)
    return worst_friction(rollout.cut(0.0, 0.3), slides)


@check(
    "carry-turn",
    title="plates carry cubes",
    law="0 if the acceleration is below mu g",
    unit="mm",
    tolerance=Tolerance("the real trials' scatter is about 1 mm", absolute=1.0),
    cause="friction creeps, or the driven body jolts: it must have its velocity in every step",
)
def carry_turn(lab: Lab) -> Measurement:
    """A plate that moves by 0.3 m and brakes, and a disc that turns at up to 1.5 rad/s, driven, with a cube on each.

    Largest displacement of a cube in its plate's prescribed frame within 2.4 s, at a quarter of mu g.

    Source: Coulomb.
    """
    rollout = lab.once(_plates)
    slips = {}
    supports = {"cube on plate": "plate", "cube on disc": "disc"}
    for cube, plate in supports.items():
        asked = _asked(rollout, plate)
        turns = Rotation.from_quat(asked[:, 3:7], scalar_first=True)
        places = turns.inv().apply(rollout.position(cube) - asked[:, :3])
        slips[f"the {cube}"] = largest_mm(places - places[0])
    worst = largest(slips, "mm")
    if slips["the cube on plate"] < 1.0 < slips["the cube on disc"]:
        worst = replace(worst, cause="friction does not see the spin of driven bodies")
    return unless_off(worst, rollout.cut(0.0, 0.2), supports)


@check(
    "driven-slow",
    title="slow plates move, and carry",
    law="displacement = prescribed displacement",
    tolerance=Tolerance("2 % is 0.04 mm, small beside real scatter", absolute=0.02),
    cause="slow bodies are treated as resting ones",
)
def driven_slow(lab: Lab) -> Measurement:
    """Two plates, driven at 2 mm/s along a line and at 0.02 rad/s about an axis 0.1 m beside, with a cube on each.

    Displacement along the prescribed one, over it, after 0.9 s; the worst of the plates and cubes.

    Source: contract (Simulation.drive); Coulomb.
    """
    rollout = lab.once(_plates).cut(0.0, 0.9)
    shares, supports = {}, {}
    for name in ("plate at 2 mm/s", "plate at 0.02 rad/s"):
        asked = _asked(rollout, name)[-1, :3] - rollout.position(name)[0]
        supports[f"cube on {name}"] = name
        for body_name in (name, f"cube on {name}"):
            moved = rollout.displacement(body_name)[-1]
            shares[body_name] = float(moved @ asked / (asked @ asked))
    return unless_off(ratio(shares, "the displacement"), rollout, supports)
