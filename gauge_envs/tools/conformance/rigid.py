"""Single rigid bodies: free fall, pendulum, string; and which pairs of bodies collide."""

from dataclasses import replace

import numpy as np

from gauge_envs.scene import (
    GRAVITY_M_PER_S2 as G,
    Box,
    ConvexUnion,
    Cylinder,
    Hinge,
    Pose,
    Scene,
    Shape,
    Sphere,
    Tether,
)
from gauge_envs.scene.geometry import length_of, vector
from gauge_envs.scene.timing import SAMPLE_INTERVAL_S
from gauge_envs.scoring.estimators import (
    acceleration_m_per_s2,
    mean_period_s,
    pendulum_period_s,
)
from gauge_envs.tools.bench.parts import ball, body, box, contact, ground
from gauge_envs.tools.bench.recording import Recording
from gauge_envs.tools.conformance.lab import Lab
from gauge_envs.tools.conformance.laws import furthest, largest_mm, worst_ratio
from gauge_envs.tools.conformance.model import (
    COUNT,
    Check,
    Measurement,
    Recorded,
    Tolerance,
    recorded,
    rollout_of,
)

# --- free fall -------------------------------------------------------------------------------------------------------


def _falling(gravity: float) -> Scene:
    brick = box(
        "brick", (0.3, -0.2, 3.0), (0.1, 0.06, 0.03), euler_deg=(20.0, 30.0, 40.0)
    )
    return Scene(bodies=(brick,), duration_s=0.5, gravity_m_per_s2=gravity)


_fall = rollout_of(
    "a turned brick of 0.2 kg that falls by 1.2 m, without contacts", _falling(G)
)
_slow_fall = rollout_of("the same brick at a gravity of 1.62 m/s^2", _falling(1.62))


def _gravity_hint(measured: float, expected: float) -> str:
    ratio = measured / expected
    if abs(measured) < 1e-3 * expected:
        return "the body does not fall: gravity is off, or the body is not dynamic or not in the engine's scene"
    # A fall goes with the square of time.
    for share in (0.5, 2.0):
        if abs(ratio / share**2 - 1.0) < 0.02:
            return f"advance() simulates {share:g} times the time it is given: the engine's step is not timestep_s"
    return ""


def _limit_hint(rollout: Recording) -> str:
    """Return the speed that a falling body does not exceed; empty if it is as fast at the end as gravity makes it."""
    speed = np.linalg.norm(rollout.velocity("brick"), axis=1)
    late = speed[-len(speed) // 10 :]
    return (
        f"it is never faster than {late[-1]:.3g} m/s: a limit of speed acts"
        if np.ptp(late) < 1e-3 * late[-1]
        else ""
    )


FALL_TOLERANCE = Tolerance(
    "a fall has no model error; 0.1 % is 0.4 mm at the ball's first impact, and real drops scatter by 1 mm",
    relative=1e-3,
)


@_slow_fall.check("gravity-of-scene", tolerance=FALL_TOLERANCE)
@_fall.check("free-fall", tolerance=FALL_TOLERANCE)
def _free_fall(rollout: Recording) -> Measurement:
    measured = -acceleration_m_per_s2(rollout.times_s, rollout.position("brick")[:, 2])
    expected = rollout.scene.gravity_m_per_s2
    hint = _gravity_hint(measured, expected) or _limit_hint(rollout)
    return Measurement(measured=measured, expected=expected, hint=hint)


@Check("free-fall-spinning", tolerance=FALL_TOLERANCE)
def _free_fall_spinning(lab: Lab) -> Measurement:
    scene = _falling(G)
    brick = replace(scene.body("brick"), angular_velocity_rad_per_s=(8.0, 8.0, 8.0))
    rollout = lab.rollout(replace(scene, bodies=(brick,)))
    measured = -acceleration_m_per_s2(rollout.times_s, rollout.position("brick")[:, 2])
    hint = f"gravity is {measured / G:.4g} of the scene's while the body spins"
    return Measurement(measured=measured, expected=G, hint=hint)


@_fall.check("free-fall-drift")
def _free_fall_drift(rollout: Recording) -> Measurement:
    return Measurement(
        measured=1e3 * float(np.abs(rollout.displacement("brick")[:, :2]).max())
    )


@_fall.check("free-fall-turn")
def _free_fall_turn(rollout: Recording) -> Measurement:
    rotations = rollout.rotation("brick")
    turned = rotations * rotations[0].inv()
    return Measurement(measured=float(np.degrees(turned.magnitude().max())))


WEDGE_M = ((0.0, 0.0, 0.0), (0.1, 0.0, 0.0), (0.0, 0.06, 0.0), (0.0, 0.0, 0.04))
KINDS: dict[str, Shape] = {
    "box": Box(size_m=(0.05, 0.04, 0.03)),
    "sphere": Sphere(radius_m=0.02),
    "cylinder": Cylinder(radius_m=0.02, length_m=0.05),
    "wedge": ConvexUnion(pieces_m=(WEDGE_M,)),
}


@Check("all-bodies-move", tolerance=COUNT)
def _all_bodies_move(lab: Lab) -> Measurement:
    bodies = tuple(
        body(name, shape, Pose(position_m=(0.2 * index, 0.0, 2.0)))
        for index, (name, shape) in enumerate(KINDS.items())
    )
    rollout = lab.rollout(Scene(bodies=bodies, duration_s=0.3))
    expected = 0.5 * G * 0.3**2
    fallen = {name: 0.0 - float(rollout.displacement(name)[-1, 2]) for name in KINDS}
    wrong = [
        name
        for name, fall in fallen.items()
        if not abs(fall - expected) < 0.02 * expected
    ]
    hint = "; ".join(
        f"the {name} fell {fallen[name]:.3g} m instead of {expected:.3g} m"
        for name in wrong
    )
    return Measurement(measured=len(KINDS) - len(wrong), expected=len(KINDS), hint=hint)


# --- pendulum --------------------------------------------------------------------------------------------------------

PENDULUM_M, BOB_M, AMPLITUDE_RAD = 0.2, 0.05, np.radians(60.0)
PIVOT_M = (0.1, 0.2, 1.0)


def _pendulum_scene(duration_s: float) -> Scene:
    x, z = PENDULUM_M * np.sin(AMPLITUDE_RAD), -PENDULUM_M * np.cos(AMPLITUDE_RAD)
    bob = ball("bob", vector(np.add(PIVOT_M, (x, 0.0, z))), radius_m=BOB_M)
    hinge = Hinge(body="bob", anchor_m=PIVOT_M, axis=(0.0, 1.0, 0.0))
    return Scene(bodies=(bob,), joints=(hinge,), duration_s=duration_s)


SWING = "a sphere of 50 mm radius on a horizontal hinge 0.2 m away, released at 60 degrees from the vertical"
_pendulum = rollout_of(SWING, _pendulum_scene(3.0))
_long_pendulum = Recorded(
    f"{SWING}, for 100 s",
    # Every fourth sample of 18,000 shows the period and the energy.
    lambda lab: lab.rollout(_pendulum_scene(100.0), interval_s=4.0 * SAMPLE_INTERVAL_S),
)


@_long_pendulum.check("pendulum-long-period")
@_pendulum.check("pendulum-period")
def _pendulum_period(rollout: Recording) -> Measurement:
    gyration = float(np.sqrt(0.4) * BOB_M)
    expected = pendulum_period_s(
        length_m=PENDULUM_M,
        gyration_m=gyration,
        amplitude_rad=float(AMPLITUDE_RAD),
        gravity_m_per_s2=G,
    )
    arm = rollout.position("bob") - np.asarray(PIVOT_M)
    measured = mean_period_s(rollout.times_s, np.arctan2(arm[:, 0], -arm[:, 2]))
    hint = (
        ""
        if np.isfinite(measured)
        else "it does not swing: the hinge is missing, or gravity is"
    )
    return Measurement(measured=measured, expected=expected, hint=hint)


@_long_pendulum.check("pendulum-long-energy")
@_pendulum.check("pendulum-energy")
def _pendulum_energy(rollout: Recording) -> Measurement:
    velocity = rollout.velocity("bob")
    spin = rollout.angular_velocity("bob")
    height_m = rollout.position("bob")[:, 2]
    # Energy per mass of a solid sphere: v^2 / 2 + (2/5 r^2) w^2 / 2 + g z.
    kinetic = 0.5 * (np.square(velocity) + 0.4 * BOB_M**2 * np.square(spin)).sum(axis=1)
    energy = kinetic + G * height_m
    lost = energy[0] - energy
    worst = float(lost[np.abs(lost).argmax()])
    released = G * PENDULUM_M * (1.0 - np.cos(AMPLITUDE_RAD))

    fastest_m_per_s = float(np.linalg.norm(velocity, axis=1).max())
    fastest_rad_per_s = np.linalg.norm(spin, axis=1).max()
    ratio = fastest_rad_per_s * PENDULUM_M / max(fastest_m_per_s, 1e-12)
    hint = ""
    if not abs(ratio - 1.0) < 0.05:
        hint = f"its angular velocity is {ratio:.3g} times its speed over the arm"
    if abs(ratio - np.degrees(1.0)) < 1.0:
        hint += ": it is in degrees"
    return Measurement(measured=100.0 * worst / released, hint=hint)


@_pendulum.check("hinge-radius")
def _hinge_radius(rollout: Recording) -> Measurement:
    arm = rollout.position("bob") - np.asarray(PIVOT_M)
    radial, along = (
        np.abs(np.hypot(arm[:, 0], arm[:, 2]) - PENDULUM_M),
        np.abs(arm[:, 1]),
    )
    return Measurement(measured=1e3 * float(np.maximum(radial, along).max()))


# --- string ----------------------------------------------------------------------------------------------------------

STRING_M, SLACK_M = 0.3, 0.1


@recorded(
    "a ball on a slack string of 0.3 m; it falls by 0.1 m until the string is taut"
)
def _tether(lab: Lab) -> Recording:
    bob = ball("bob", (0.0, 0.0, 1.0 - STRING_M + SLACK_M), radius_m=0.01)
    string = Tether(body="bob", anchor_m=(0.0, 0.0, 1.0), length_m=STRING_M)
    return lab.rollout(Scene(bodies=(bob,), joints=(string,), duration_s=1.0))


@_tether.check("tether-slack")
def _tether_slack(rollout: Recording) -> Measurement:
    falling = rollout.between(0.0, 0.13)
    measured = -acceleration_m_per_s2(
        rollout.times_s[falling], rollout.position("bob")[falling, 2]
    )
    fallen_m = -float(rollout.displacement("bob")[rollout.sample_at(0.13), 2])
    early = fallen_m < 0.9 * 0.5 * G * 0.13**2
    hint = (
        f"it fell by {1e3 * fallen_m:.3g} mm before 0.13 s: the string is shorter than its length_m"
        if early
        else ""
    )
    return Measurement(measured=measured, expected=G, hint=hint)


@_tether.check("tether-length")
def _tether_length(rollout: Recording) -> Measurement:
    distance = np.linalg.norm(rollout.position("bob") - [0.0, 0.0, 1.0], axis=1)
    missing = distance.max() > 2.0 * STRING_M
    hint = (
        "the string is missing: the ball falls on"
        if missing
        else f"it is {1e3 * distance.max():.4g} mm long"
    )
    return Measurement(
        measured=1e3 * float(distance.max()), expected=1e3 * STRING_M, hint=hint
    )


STRINGS_M = {
    "first bob": ((0.0, 0.0, 1.0), STRING_M),
    "second bob": ((0.4, -0.1, 1.2), 1.2 * STRING_M),
    "third bob": ((-0.3, 0.5, 0.8), 0.8 * STRING_M),
}
"""Anchor and length of strings on which balls hang at rest."""

LEAST_ASIDE_MM = 1.0
"""Distance from the vertical line through the anchor from which on a ball that hangs shows another anchor."""


@recorded("three balls that hang at rest on taut strings of 0.24, 0.3 and 0.36 m")
def _hanging_bobs(lab: Lab) -> Recording:
    bobs, strings = [], []
    for name, (anchor_m, length_m) in STRINGS_M.items():
        place = (*anchor_m[:2], anchor_m[2] - length_m)
        bobs.append(ball(name, place, radius_m=0.01))
        strings.append(Tether(body=name, anchor_m=anchor_m, length_m=length_m))
    return lab.rollout(Scene(bodies=tuple(bobs), joints=tuple(strings), duration_s=1.0))


@_hanging_bobs.check("tether-rest")
def _tether_rest(rollout: Recording) -> Measurement:
    late = rollout.between(0.8, 1.0)
    shares, aside = {}, []
    for name, (anchor_m, length_m) in STRINGS_M.items():
        arms_m = rollout.position(name)[late] - anchor_m
        shares[name] = float(np.linalg.norm(arms_m, axis=1).mean()) / length_m
        aside_mm = 1e3 * length_of(arms_m[:, :2].mean(axis=0))
        if aside_mm > LEAST_ASIDE_MM:
            aside.append(
                f"; the {name} hangs {aside_mm:.3g} mm beside its anchor: the anchor is elsewhere"
            )
    found = worst_ratio(shares, "the string's length is")
    found = replace(found, hint=found.hint + "".join(aside))
    return replace(
        found, measured=1e3 * STRING_M * found.measured, expected=1e3 * STRING_M
    )


@_hanging_bobs.check("tether-place")
def _tether_place(rollout: Recording) -> Measurement:
    sides = {
        name: largest_mm(rollout.position(name)[:, :2] - anchor_m[:2])
        for name, (anchor_m, _) in STRINGS_M.items()
    }
    return furthest(sides)


# --- pairs that collide ----------------------------------------------------------------------------------------------


@recorded(
    "three balls of radius 30 mm over a plane; only one of them has a contact with it"
)
def _pairs(lab: Lab) -> Recording:
    places = {
        "listed": (-0.1, 0.0, 0.03),
        "unlisted": (0.1, 0.0, 0.03),
        "upper": (-0.1, 0.0, 0.2),
    }
    balls = [ball(name, place) for name, place in places.items()]
    contacts = (contact("listed", "ground", friction=0.5),)
    return lab.rollout(
        Scene(bodies=(*balls, ground()), contacts=contacts, duration_s=0.5)
    )


@_pairs.check("contact-unlisted")
def _contact_unlisted(rollout: Recording) -> Measurement:
    # A fit, since after 0.5 s a semi-implicit step of 1/180 s has fallen by 1.1 % more than the law.
    falls = {
        name: -acceleration_m_per_s2(rollout.times_s, rollout.position(name)[:, 2])
        for name in ("unlisted", "upper")
    }
    slow = min(falls, key=lambda name: falls[name])
    what = {"unlisted": "the plane", "upper": "the plane or the other ball"}[slow]
    hint = f"ball {slow!r} is held by {what}" if falls[slow] < 0.9 * G else ""
    return Measurement(measured=falls[slow], expected=G, hint=hint)


@_pairs.check("contact-listed")
def _contact_listed(rollout: Recording) -> Measurement:
    height_mm = 1e3 * float(rollout.position("listed")[-1, 2] - 0.03)
    hint = ""
    if height_mm > 0.0:
        hint = "it floats on a margin or contact offset of the engine, or its radius is too large"
    elif height_mm < -100.0:
        hint = "the ball falls through the plane"
    return Measurement(measured=height_mm, hint=hint)
