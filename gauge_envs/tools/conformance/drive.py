"""Driven bodies: velocity, path, slow motion, and what they carry, leave behind and push."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs.scene import (
    GRAVITY_M_PER_S2 as G,
    Box,
    Cylinder,
    Pose,
    Scene,
    Vector,
)
from gauge_envs.scene.drivers import Driver, DriverMotion
from gauge_envs.scene.geometry import FloatArray, length_of, vector
from gauge_envs.scene.profiles import TrapezoidProfile
from gauge_envs.scoring.estimators import acceleration_m_per_s2
from gauge_envs.tools.bench.parts import (
    ball,
    box,
    contact,
    driven_box,
    driver,
    ramp,
)
from gauge_envs.tools.bench.recording import Recording
from gauge_envs.tools.conformance.lab import Lab, largest_mm, worst_ratio
from gauge_envs.tools.conformance.model import Measurement, Tolerance, check

BLOCK_M = (0.5, 0.3, 0.1)
LINE, AXIS = (0.6, 0.0, 0.8), (0.48, 0.64, -0.6)
BLOCKS: dict[str, tuple[Vector, float, Vector, float, Vector]] = {
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
        turn = DriverMotion(
            kind="rotate",
            axis=axis,
            profiles=_strokes(angle),
            point_m=vector(place + BESIDE_M),
        )
        move = DriverMotion(kind="translate", axis=line, profiles=_strokes(path_m))
        blocks.append(driven_box(name, vector(place), BLOCK_M, euler_deg=euler_deg))
        drivers.append(Driver(body=name, motions=(turn, move), provenance="nominal"))
    return lab.rollout(
        Scene(bodies=tuple(blocks), drivers=tuple(drivers), duration_s=2.6)
    )


def _asked(rollout: Recording, name: str) -> FloatArray:
    """Return poses and rates that the scene prescribes for a driven body, shape [sample_count, 13]."""
    motion = next(one for one in rollout.scene.drivers if one.body == name)
    return motion.path(rollout.scene.body(name).pose, rollout.times_s)


@check(
    "driven-velocity",
    title="driven body has its driver's velocity",
    law="v = prescribed v, omega = prescribed omega",
    source="contract (Simulation.drive)",
    unit="%",
    tolerance=Tolerance(
        "a velocity that is 0.1 % high moves what a turntable carries by the scatter of real trials, 1 mm",
        absolute=0.05,
    ),
    cause="drive() must give the body its velocity, which body_states returns",
)
def driven_velocity(lab: Lab) -> Measurement:
    """Two driven blocks: one slides at 0.86 m/s along a leaning line, one turns at 2.3 rad/s about a leaning axis.

    Error of the reported linear or angular velocity over the prescribed one, mean of 0.15 to 0.35 s; the larger one.
    """
    rollout = lab.once(_blocks)
    cruise = rollout.between(0.15, 0.35)
    errors, hints = [], []
    for name, rates in (
        ("sliding block", slice(7, 10)),
        ("turning block", slice(10, 13)),
    ):
        states = rollout.states[name]
        asked = _asked(rollout, name)[cruise, rates].mean(axis=0)
        found = states[cruise, rates].mean(axis=0)
        ratio = found @ asked / (asked @ asked)
        errors.append(100.0 * length_of(found - asked) / length_of(asked))
        hint = f"the {name} reports {ratio:.4g} times its velocity"
        if np.ptp(states[:, :7], axis=0).max() < 1e-6:
            hint = f"the {name} stands still: drive() has no effect"
        elif not found.any():
            hint = f"the {name} reports no velocity: a body that is set from pose to pose carries nothing"
        elif length_of(found - ratio * asked) > 0.3 * length_of(found - asked):
            hint = f"the velocity of the {name} has another direction; its frame is the world's"
        hints.append(hint)
    worst = int(np.argmax(errors))
    return Measurement(measured=errors[worst], hint=hints[worst])


def _off_path(rollout: Recording, name: str) -> tuple[float, str]:
    """Return the largest distance [mm] of a corner of a block from its path, and what explains it."""
    corners_m = Box(size_m=BLOCK_M).corners_m
    asked, found = _asked(rollout, name), rollout.states[name]

    def placed(states: FloatArray, seconds: float = 0.0) -> FloatArray:
        turns = Rotation.from_quat(states[:, 3:7], scalar_first=True)
        turns = Rotation.from_rotvec(seconds * states[:, 10:]) * turns
        centres = states[:, :3] + seconds * states[:, 7:10]
        return centres[:, None] + corners_m @ turns.as_matrix().transpose(0, 2, 1)

    places, path = placed(found), placed(asked)
    error = largest_mm(places - path)
    steps, asked_steps = places[1:] - path[:-1], np.diff(path, axis=0)
    share = float((steps * asked_steps).sum() / np.square(asked_steps).sum())
    guesses = {
        "comes one interval late, or drive() moves it without velocity": steps,
        "comes one interval early": places[:-1] - path[1:],
        "moves as if the acceleration that drive() gives were 0": (
            places[1:] - placed(asked, rollout.interval_s)[:-1]
        ),
        f"moves {share:.4g} times as far in an interval as prescribed; angles are in rad": (
            steps - share * asked_steps
        ),
    }
    for text, left in guesses.items():
        if largest_mm(left) < 0.2 * error:
            return error, text
    at = np.linalg.norm(places - path, axis=-1).max(axis=1).argmax()
    centre_mm = largest_mm(found[:, :3] - asked[:, :3])
    return (
        error,
        f"is off its path at {rollout.times_s[at]:.3g} s, its centre by up to {centre_mm:.3g} mm",
    )


@check(
    "driven-path",
    title="driven bodies follow their drivers",
    law="pose = prescribed pose",
    source="contract (Simulation.drive)",
    unit="mm",
    tolerance=Tolerance("a tenth of the real trials' scatter", absolute=0.1),
    cause="each call of drive() gives the pose at the start of the interval, and rates in the world frame",
)
def driven_path(lab: Lab) -> Measurement:
    """Five driven blocks without contacts: one slides, one turns, three slide and turn about leaning axes beside them.

    Largest distance of a corner from its prescribed place, in strokes of 0.4 s from 0 and 2.1 s; the worst block.
    """
    rollout = lab.once(_blocks)
    errors = {name: _off_path(rollout, name) for name in BLOCKS}
    # The simplest block that is wrong says most.
    wrong = [
        f"the {name} {text}" for name, (mm, text) in errors.items() if not mm < 0.1
    ]
    measured = max(mm for mm, _ in errors.values())
    return Measurement(measured=measured, hint=wrong[0] if wrong else "")


PLATE_M, CUBE_M, DISC_RADIUS_M = (0.4, 0.3, 0.02), 0.05, 0.15
SLOW_M_PER_S, LATE_S = 2e-3, 2.1
LEVEL_LINE, UP = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)


def _move(
    amount: float, duration_s: float, ramp_s: float, start_s: float = 0.0
) -> TrapezoidProfile:
    return ramp(amount, start_s=start_s, duration_s=duration_s, ramp_s=ramp_s)


PLATES = {
    # Motion, place of the axis of a turn and of the cube along x from the centre of the plate [m], and friction.
    "plate": (_move(0.3, 1.1, 0.4), None, 0.0, 0.4),
    "early plate": (_move(0.32, 0.8, 0.4), None, 0.0, 0.05),
    "disc": (_move(3.0, 2.5, 0.5), 0.0, 0.1, 0.4),
    "late plate": (_move(0.32, 0.8, 0.4, LATE_S), None, 0.0, 0.1),
    "slow plate": (_move(SLOW_M_PER_S, 1.0, 0.01), None, 0.0, 0.4),
    "slow turning plate": (_move(10.0 * SLOW_M_PER_S, 1.0, 0.01), -0.1, 0.0, 0.4),
}


def _record_plates(lab: Lab, names: Sequence[str], seconds: float) -> Recording:
    """Record some plates with their cubes; the disc is a cylinder where the engine drives one."""
    plates, cubes, contacts, drivers = [], [], [], []
    for number, name in enumerate(names):
        profile, axis_m, cube_m, friction = PLATES[name]
        x_m, cube = float(number), f"cube on {name}"
        plates.append(driven_box(name, (x_m, 0.0, 0.5), PLATE_M))
        cubes.append(box(cube, (x_m + cube_m, 0.0, 0.535), (CUBE_M,) * 3))
        # Either body of a pair may come first.
        pair = (cube, name) if number else (name, cube)
        contacts.append(contact(*pair, friction=friction))
        if axis_m is None:
            drivers.append(driver(name, "translate", LEVEL_LINE, profile))
        else:
            point_m = (x_m + axis_m, 0.0, 0.0)
            drivers.append(driver(name, "rotate", UP, profile, point_m=point_m))
    disc = Cylinder(radius_m=DISC_RADIUS_M, length_m=PLATE_M[2])
    scene = Scene(
        bodies=(
            *(
                replace(one, shape=disc) if one.name == "disc" else one
                for one in plates
            ),
            *cubes,
        ),
        contacts=tuple(contacts),
        drivers=tuple(drivers),
        duration_s=seconds,
    )
    if not lab.supports(scene):
        scene = replace(scene, bodies=(*plates, *cubes))
    return lab.rollout(scene)


def _early_plates(lab: Lab) -> Recording:
    return _record_plates(lab, ("plate", "early plate"), 1.2)


def _late_plate(lab: Lab) -> Recording:
    return _record_plates(lab, ("late plate",), 2.4)


def _disc(lab: Lab) -> Recording:
    return _record_plates(lab, ("disc",), 2.4)


def _off_plate(rollout: Recording, name: str) -> str:
    """Return what is wrong where the cube does not stay at its height over a plate at first; empty where it does."""
    height_mm = 1e3 * rollout.displacement(f"cube on {name}")[:36, 2]
    if height_mm.min() < -100.0:
        return f"the cube falls through the {name}: the pair has no contact"
    if np.abs(height_mm).max() > 1.0:
        return f"the cube on the {name} rises or sinks by {np.abs(height_mm).max():.3g} mm: a box has another size"
    return ""


def worst_friction(
    ratios: Mapping[str, float], frictions: Mapping[str, float]
) -> Measurement:
    """Return the friction over that of the pair that is furthest from 1, and whether it is a product of two values."""
    ratio, hint = worst_ratio(ratios, "the friction")
    if all(abs(ratios[name] / frictions[name] - 1.0) < 0.05 for name in ratios):
        hint = "the friction is squared: the engine multiplies the values of two bodies, and it is the pair's"
    return Measurement(measured=ratio, expected=1.0, hint=hint)


@check(
    "carry-slip",
    title="plates slip under cubes",
    law="a = mu g",
    source="Coulomb",
    tolerance=Tolerance(
        "1 % as for a slide, and 1 % since the plate's speed changes within an interval",
        absolute=0.02,
    ),
    cause="friction on a driven body is not the pair's, or acts on another velocity than the prescribed one",
)
def carry_slip(lab: Lab) -> Measurement:
    """Two driven plates under cubes that accelerate by 2 m/s^2, at once and after 2.1 s at rest; friction 0.05 and 0.1.

    Acceleration of a cube over mu g, quadratic fit over 0.3 s; the worst of both.
    """
    ratios, off = {}, ""
    for name, scene, start_s in (
        ("early plate", _early_plates, 0.0),
        ("late plate", _late_plate, LATE_S),
    ):
        rollout = lab.once(scene)
        part = rollout.cut(start_s, start_s + 0.3)
        path_m = part.displacement(f"cube on {name}") @ LEVEL_LINE
        rate = acceleration_m_per_s2(part.times_s, path_m)
        ratios[name] = rate / (PLATES[name][-1] * G)
        off = off or _off_plate(part, name)
    early, late = ratios.values()
    if not off and abs(early - 1.0) < 0.02 and abs(late) < 0.02:
        off = "the cube stays behind after 2.1 s at rest: it sleeps, and the driven plate does not wake it"
    found = worst_friction(ratios, {name: PLATES[name][-1] for name in ratios})
    return replace(found, hint=off or found.hint)


@check(
    "carry-turn",
    title="plates carry cubes",
    law="0 if the acceleration is below mu g",
    source="Coulomb",
    unit="mm",
    tolerance=Tolerance("the real trials' scatter is about 1 mm", absolute=1.0),
    cause="a driven body must have its velocity in every step, without jolts between calls of drive()",
)
def carry_turn(lab: Lab) -> Measurement:
    """A plate that moves by 0.3 m and brakes, and a disc that turns at up to 1.5 rad/s, driven, with a cube on each.

    Largest displacement of a cube in its plate's prescribed frame within 1.2 and 2.4 s, at a quarter of mu g.
    """
    slips, hints = [], []
    for name, scene in (("plate", _early_plates), ("disc", _disc)):
        rollout = lab.once(scene)
        path = zip(
            _asked(rollout, name), rollout.position(f"cube on {name}"), strict=True
        )
        places = np.array([Pose.of_state(row).to_body(cube) for row, cube in path])
        slips.append(largest_mm(places - places[0]))
        moved_mm = largest_mm(rollout.displacement(f"cube on {name}"))
        hint = f"on the {name} the cube slips by {slips[-1]:.3g} mm and moves by {moved_mm:.3g} mm"
        hint += ": friction creeps, or the velocity of the plate jolts"
        hints.append(_off_plate(rollout, name) or hint)
    worst = int(np.argmax(slips))
    return Measurement(measured=slips[worst], hint=hints[worst])


@check(
    "driven-slow",
    title="slow plates move, and carry",
    law="displacement = prescribed displacement",
    source="contract (Simulation.drive); Coulomb",
    tolerance=Tolerance("2 % is 0.04 mm, small beside real scatter", absolute=0.02),
    cause="slow bodies are treated as resting ones",
)
def driven_slow(lab: Lab) -> Measurement:
    """Two plates, driven at 2 mm/s along a line and at 0.02 rad/s about an axis 0.1 m beside, with a cube on each.

    Displacement along the prescribed one, over it, after 0.9 s; the worst of the plates and cubes.
    """
    plates = ("slow plate", "slow turning plate")
    rollout = _record_plates(lab, plates, 0.9)
    ratios, hint = {}, ""
    for name in plates:
        asked = _asked(rollout, name)[-1, :3] - rollout.position(name)[0]
        for one in (name, f"cube on {name}"):
            moved = rollout.displacement(one)[-1]
            ratios[one] = float(moved @ asked / (asked @ asked))
        if abs(ratios[name]) < 0.01:
            hint = hint or f"the {name} stands still at {1e3 * SLOW_M_PER_S:g} mm/s"
        hint = hint or _off_plate(rollout, name)
    measured, text = worst_ratio(ratios, "the displacement")
    return Measurement(measured=measured, expected=1.0, hint=hint or text)


PUSH_M_PER_S, PUSHED_S = 0.5, 0.42
"""Largest speed of the plate, and time at which the ball flies freely [s]."""


@check(
    "pushed-ball",
    title="driven plate pushes",
    law="v = largest speed of the plate",
    source="no restitution, no friction",
    unit="m/s",
    tolerance=Tolerance(
        "a stiff contact may release energy; 2 % is 1 cm/s", relative=0.02
    ),
    cause="the driven body moves without velocity, or the contact sticks or rebounds",
)
def pushed_ball(lab: Lab) -> Measurement:
    """A driven plate that pushes a ball of 0.1 kg by 0.1 m, at up to 0.5 m/s, then brakes; no gravity.

    Speed of the ball after the plate has braked.
    """
    plate = driven_box("plate", (-0.03, 0.0, 1.0), (0.02, 0.1, 0.1))
    stroke = ramp(0.1, start_s=0.0, duration_s=0.3, ramp_s=0.1)
    rollout = lab.rollout(
        Scene(
            bodies=(ball("ball", (0.0, 0.0, 1.0), radius_m=0.02), plate),
            contacts=(contact("ball", "plate", friction=0.0),),
            drivers=(driver("plate", "translate", (1.0, 0.0, 0.0), stroke),),
            duration_s=0.5,
            gravity_m_per_s2=0.0,
        )
    )
    measured = float(rollout.velocity("ball")[rollout.sample_at(PUSHED_S), 0])
    is_missed = abs(measured) < 1e-3
    hint = "the plate passes through the ball: the pair has no contact"
    return Measurement(
        measured=measured, expected=PUSH_M_PER_S, hint=hint if is_missed else ""
    )
