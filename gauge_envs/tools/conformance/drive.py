"""Driven bodies: velocity, path, slow motion, and what they carry, leave behind and push."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

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
from gauge_envs.scene.geometry import FloatArray, vector
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
STROKES_S = 0.0, 2.1
"""Times at which the strokes of the blocks and plates start [s]."""

LINE, AXIS = (0.6, 0.0, 0.8), (0.48, 0.64, -0.6)
BLOCKS: dict[str, tuple[Vector, float, Vector, float, Vector]] = {
    "sliding block": ((0.0, 0.0, 40.0), 0.3, LINE, 0.0, AXIS),
    "turning block": ((30.0, -20.0, 0.0), 0.0, LINE, 0.8, AXIS),
    "first block": ((-70.0, 35.0, 20.0), -0.4, (0.0, -0.6, 0.8), 1.5, LINE),
    "second block": ((25.0, -15.0, 80.0), -0.4, (0.8, 0.6, 0.0), -1.3, AXIS),
    "third block": ((0.0, 50.0, -130.0), -0.4, (0.6, 0.0, -0.8), 1.1, (0.0, -0.8, 0.6)),
}
"""Orientation [deg], path [m] along a line, and angle [rad] about an axis in each stroke; from simple to compound."""

BESIDE_M = (-0.2, 0.3, -0.2)
"""Place of the axis of a block that moves and turns, from its centre [m]."""


def _blocks(lab: Lab) -> Recording:
    """Record five driven blocks without contacts that move in two strokes; up to 88 rad/s^2 and 53 m/s^2."""
    blocks, drivers = [], []
    for number, (name, (euler_deg, path_m, line, angle, axis)) in enumerate(
        BLOCKS.items()
    ):
        place = np.array([0.3 + number, -0.2, 1.0])
        beside = BESIDE_M if path_m and angle else (0.0, 0.0, 0.0)
        turns, moves = (
            tuple(
                ramp(amount, start_s=start_s + wait_s, duration_s=long_s, ramp_s=0.05)
                for start_s in STROKES_S
            )
            for amount, wait_s, long_s in (
                (angle, 0.0, 0.4),
                (path_m, *((0.1, 0.2) if angle else (0.0, 0.4))),
            )
        )
        motions = (
            DriverMotion(
                kind="rotate", axis=axis, profiles=turns, point_m=vector(place + beside)
            ),
            DriverMotion(kind="translate", axis=line, profiles=moves),
        )
        blocks.append(driven_box(name, vector(place), BLOCK_M, euler_deg=euler_deg))
        drivers.append(Driver(body=name, motions=motions, provenance="nominal"))
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
    cause="drive() must give the body its velocity, or body_states reports another one",
)
def driven_velocity(lab: Lab) -> Measurement:
    """Two driven blocks: one slides at 0.86 m/s along a leaning line, one turns at 2.3 rad/s about a leaning axis.

    Error of the reported linear or angular velocity over the prescribed one, mean of 0.15 to 0.35 s; the larger one.
    """
    rollout = lab.once(_blocks)
    cruise = rollout.between(0.15, 0.35)
    worst = Measurement(measured=0.0)
    for name, rates in (
        ("sliding block", slice(7, 10)),
        ("turning block", slice(10, 13)),
    ):
        states = rollout.states[name]
        asked = _asked(rollout, name)[cruise, rates].mean(axis=0)
        found = states[cruise, rates].mean(axis=0)
        ratio = float(found @ asked / (asked @ asked))
        error = 100.0 * float(np.linalg.norm(found - asked) / np.linalg.norm(asked))
        hint = f"the {name} reports {ratio:.4g} times its velocity"
        if np.ptp(states[:, :7], axis=0).max() < 1e-6:
            hint = f"the {name} stands still: drive() has no effect"
        elif abs(ratio) < 0.01:
            hint = f"the {name} moves and reports no velocity: a body that is set from pose to pose carries nothing"
        elif abs(ratio - 1.0) < 0.005 * error:
            hint = f"the velocity of the {name} has another direction: check the frame, which is the world's"
        if not error <= worst.measured:
            worst = Measurement(measured=error, hint=hint)
    return worst


def _off_path(rollout: Recording, name: str) -> tuple[float, str]:
    """Return the largest distance [mm] of a corner of a driven box from its path, and what explains it."""
    corners_m = Box(size_m=BLOCK_M).corners_m
    asked = _asked(rollout, name)

    def placed(states: FloatArray, seconds: float = 0.0) -> FloatArray:
        turns = Rotation.from_quat(states[:, 3:7], scalar_first=True)
        turns = Rotation.from_rotvec(seconds * states[:, 10:]) * turns
        centres = states[:, :3] + seconds * states[:, 7:10]
        return centres[:, None] + np.einsum("tij,kj->tki", turns.as_matrix(), corners_m)

    found, path = placed(rollout.states[name]), placed(asked)
    off_mm = 1e3 * np.linalg.norm(found - path, axis=-1).max(axis=1)
    error = float(off_mm.max())
    steps, asked_steps = found[1:] - path[:-1], path[1:] - path[:-1]
    share = float((steps * asked_steps).sum() / np.square(asked_steps).sum())
    guesses = {
        "comes one interval late, or drive() moves it without velocity": steps,
        "comes one interval early": found[:-1] - path[1:],
        "moves as if the acceleration that drive() gives were 0": (
            found[1:] - placed(asked, rollout.interval_s)[:-1]
        ),
        f"moves {share:.4g} times as far in an interval as prescribed; angles are in rad": (
            steps - share * asked_steps
        ),
    }
    hint = (
        f"is off its path by {error:.3g} mm at {rollout.times_s[off_mm.argmax()]:.3g} s"
    )
    for text, left in guesses.items():
        if largest_mm(left) < 0.2 * error:
            return error, text
    return error, hint


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
    measured = max(error for error, _ in errors.values())
    wrong = [name for name, (error, _) in errors.items() if not error < 0.1]
    right = ", ".join(name for name in BLOCKS if name not in wrong)
    hint = f"the {wrong[0]} {errors[wrong[0]][1]}" if wrong else ""
    return Measurement(
        measured=measured, hint=hint + (f"; right: {right}" if right else "")
    )


PLATE_M, CUBE_M, DISC_RADIUS_M = (0.4, 0.3, 0.02), 0.05, 0.15
SLOW_M_PER_S, LATE_S = 2e-3, 2.1
LINE_ON_LEVEL, UP = (0.8, 0.6, 0.0), (0.0, 0.0, 1.0)


@dataclass(frozen=True, kw_only=True)
class _Plate:
    """A driven plate with a cube on it.

    Attributes:
        profiles: Its motion: along `LINE_ON_LEVEL`, or about the vertical if `axis_m` is given.
        axis_m: Place of the axis along x, from its centre.
        friction: Friction of the cube.
        cube_m: Place of the cube along x, from the centre of the plate.
    """

    profiles: tuple[TrapezoidProfile, ...]
    axis_m: float | None = None
    friction: float = 0.4
    cube_m: float = 0.0


def _slow(amount: float) -> tuple[TrapezoidProfile, ...]:
    return (ramp(amount, start_s=0.0, duration_s=1.0, ramp_s=0.01),)


def _start(start_s: float) -> tuple[TrapezoidProfile, ...]:
    """Return a motion that accelerates with 2 m/s^2 for 0.4 s."""
    return (ramp(0.32, start_s=start_s, duration_s=0.8, ramp_s=0.4),)


PLATES = {
    "slow plate": _Plate(profiles=_slow(SLOW_M_PER_S)),
    "slow turning plate": _Plate(profiles=_slow(10.0 * SLOW_M_PER_S), axis_m=-0.1),
    "plate": _Plate(profiles=(ramp(0.3, start_s=0.0, duration_s=1.1, ramp_s=0.4),)),
    "disc": _Plate(
        profiles=(ramp(3.0, start_s=0.0, duration_s=2.5, ramp_s=0.5),),
        axis_m=0.0,
        cube_m=0.1,
    ),
    "early plate": _Plate(profiles=_start(0.0), friction=0.05),
    "late plate": _Plate(profiles=_start(LATE_S), friction=0.1),
}


def _record_plates(lab: Lab, names: Sequence[str], seconds: float) -> Recording:
    """Record some plates with their cubes; the disc is a cylinder where the engine drives one."""
    plates, cubes, contacts, drivers = [], [], [], []
    for number, name in enumerate(names):
        plate, x_m, cube = PLATES[name], float(number), f"cube on {name}"
        plates.append(driven_box(name, (x_m, 0.0, 0.5), PLATE_M))
        place = (x_m + plate.cube_m, 0.0, 0.5 + 0.5 * (PLATE_M[2] + CUBE_M))
        cubes.append(box(cube, place, (CUBE_M,) * 3))
        # Either body of a pair may come first.
        pair = (cube, name) if number % 2 else (name, cube)
        contacts.append(contact(*pair, friction=plate.friction))
        kind: Literal["translate", "rotate"] = "translate"
        axis, point = LINE_ON_LEVEL, (0.0, 0.0, 0.0)
        if plate.axis_m is not None:
            kind, axis, point = "rotate", UP, (x_m + plate.axis_m, 0.0, 0.0)
        drivers.append(driver(name, kind, axis, *plate.profiles, point_m=point))
    disc = Cylinder(radius_m=DISC_RADIUS_M, length_m=PLATE_M[2])
    round_plates = [
        replace(one, shape=disc) if one.name == "disc" else one for one in plates
    ]
    scene = Scene(
        bodies=(*round_plates, *cubes),
        contacts=tuple(contacts),
        drivers=tuple(drivers),
        duration_s=seconds,
    )
    if not lab.supports(scene):
        scene = replace(scene, bodies=(*plates, *cubes))
    return lab.rollout(scene)


def _slow_plates(lab: Lab) -> Recording:
    return _record_plates(lab, ("slow plate", "slow turning plate"), 1.0)


def _early_plates(lab: Lab) -> Recording:
    return _record_plates(lab, ("plate", "early plate"), 1.2)


def _late_plates(lab: Lab) -> Recording:
    return _record_plates(lab, ("disc", "late plate"), 2.4)


@check(
    "driven-slow",
    title="slow plates move, and carry",
    law="displacement = prescribed displacement",
    source="contract (Simulation.drive); Coulomb",
    tolerance=Tolerance("2 % is 0.1 mm, small beside real scatter", absolute=0.02),
    cause="slow bodies are treated as resting ones",
)
def driven_slow(lab: Lab) -> Measurement:
    """Two plates, driven at 2 mm/s along a line and at 0.02 rad/s about an axis 0.1 m beside, with a cube on each.

    Displacement along the prescribed one, over it, after 1 s; the worst of the plates and cubes.
    """
    rollout = lab.once(_slow_plates)
    plates = [one.body for one in rollout.scene.drivers]
    ratios = {}
    for name in plates:
        asked = _asked(rollout, name)[-1, :3] - rollout.position(name)[0]
        for one in (name, f"cube on {name}"):
            moved = rollout.displacement(one)[-1]
            ratios[one] = float(moved @ asked / (asked @ asked))
    measured, hint = worst_ratio(ratios, "the displacement")
    still = [name for name in plates if abs(ratios[name]) < 0.01]
    if still:
        hint = f"the {still[0]} stands still: drive() ignores motion at {1e3 * SLOW_M_PER_S:g} mm/s"
    elif all(abs(ratios[name] - 1.0) < 0.02 for name in plates):
        hint += "; the plates are right: cubes at 2 mm/s sleep, or friction ignores slow motion"
    return Measurement(measured=measured, expected=1.0, hint=hint)


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
    slips, moved_mm = {}, {}
    for name, scene in (("plate", _early_plates), ("disc", _late_plates)):
        rollout = lab.once(scene)
        path = zip(
            _asked(rollout, name), rollout.position(f"cube on {name}"), strict=True
        )
        places = np.array([Pose.of_state(row).to_body(cube) for row, cube in path])
        slips[name] = largest_mm(places - places[0])
        moved_mm[name] = largest_mm(rollout.displacement(f"cube on {name}"))
    worst = max(slips, key=lambda name: slips[name])
    hint = f"on the {worst} the cube slips by {slips[worst]:.3g} mm and moves by {moved_mm[worst]:.3g} mm"
    return Measurement(measured=slips[worst], hint=hint)


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
    ratios = {}
    for name, scene, start_s in (
        ("early plate", _early_plates, 0.0),
        ("late plate", _late_plates, LATE_S),
    ):
        part = lab.once(scene).cut(start_s, start_s + 0.3)
        path_m = part.displacement(f"cube on {name}") @ LINE_ON_LEVEL
        rate = acceleration_m_per_s2(part.times_s, path_m)
        ratios[name] = rate / (PLATES[name].friction * G)
    measured, hint = worst_ratio(ratios, "the friction of the cube")
    early, late = ratios.values()
    if abs(early - 1.0) < 0.02 and abs(late) < 0.02:
        hint = "the cube stays behind after 2.1 s at rest: it sleeps, and the driven plate does not wake it"
    elif abs(measured) < 0.02:
        hint = "the cube stays behind: the driven plate has no velocity, or the pair no contact"
    return Measurement(measured=measured, expected=1.0, hint=hint)


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
    hint = ""
    if rollout.displacement("ball")[-1, 0] < 0.01:
        hint = "the plate passes through the ball: the pair has no contact"
    return Measurement(measured=measured, expected=PUSH_M_PER_S, hint=hint)
