"""Impacts: rebounds of all speeds, momentum, friction in impacts, energy, and edges."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs.fixtures.drop import (
    RADIUS_M,
    balls_above_ground,
    bounce_of,
    drop_scene,
    fall_s,
)
from gauge_envs.fixtures.parts import (
    ball,
    body,
    box,
    box_inertia_kg_m2,
    contact,
    fixed_box,
    ground,
    thrown,
)
from gauge_envs.fixtures.recording import Recording
from gauge_envs.scene import (
    GRAVITY_M_PER_S2 as G,
    Box,
    Contact,
    Pose,
    RigidBody,
    Scene,
    Shape,
    Sphere,
    Vector,
)
from gauge_envs.scene.geometry import FloatArray, vector
from gauge_envs.tools.conformance.lab import Lab, Measurement, largest, ratio
from gauge_envs.tools.conformance.model import COUNT, Checks, Level, Tolerance

check = Checks(Level.CONTACT)


REBOUND = Tolerance(
    "the real ball's ratio scatters by 0.0022 over 22 trials; this is twice as much",
    absolute=0.005,
)

# --- drops -----------------------------------------------------------------------------------------------------------

DROP_M = 0.4
MIN_HOP_SHARE = 0.01
"""Height of a hop, over the height of the drop, below which a contact settles."""
SUSTAINED = "a pair of the mode SUSTAINED"


@check(
    "rebound-0.5",
    title="rebound of balls",
    law="v' = -e v; v' = 0 in the mode SUSTAINED",
    tolerance=REBOUND,
    cause="check how Contact.restitution enters: as a coefficient or as damping, and whether two values are combined",
)
def rebound_of_balls(lab: Lab) -> Measurement:
    """Balls dropped by 0.4 m on a plane, with restitutions of 0.2, 0.5, 0.75 and 0.95; by 50 mm in a sustained pair.

    Outgoing over incoming speed, from the heights of its flights, of the ball that is furthest from the law.

    Source: Newton's law of restitution; contract (scene.ContactMode).
    """
    values = {f"e = {value:g}": value for value in (0.5, 0.95, 0.2, 0.75)}
    contacts = [
        contact(*(name, "ground")[:: 1 - 2 * (index % 2)], friction=0.5, restitution=e)
        for index, (name, e) in enumerate(values.items())
    ]
    contacts.append(
        Contact(first=(SUSTAINED,), second=("ground",), friction=0.5, restitution=0.8)
    )
    drops_m = dict.fromkeys(values, DROP_M) | {SUSTAINED: 0.05}
    values[SUSTAINED] = 0.0
    balls = balls_above_ground(drops_m, spacing_m=0.3)
    seconds = 2.1 * fall_s(DROP_M, G)
    scene = drop_scene(balls, tuple(contacts), seconds=seconds, gravity=G)
    rollout = lab.rollout(scene)
    ratios = {}
    for name in values:
        bounce = bounce_of(rollout, name)
        e = bounce.restitution if bounce else math.inf
        ratios[name] = e if e**2 > MIN_HOP_SHARE else 0.0
    worst = max(values, key=lambda name: abs(ratios[name] - values[name]))
    hint, cause = f"the rebound is wrong for {worst}", ""
    if worst == SUSTAINED:
        cause = "restitution has no effect there"
    if not any(ratios.values()):
        hint, cause = "no ball leaves the ground again", "restitution has no effect"
    return Measurement(
        measured=ratios[worst], expected=values[worst], hint=hint, cause=cause
    )


# --- bodies that fly against walls and other bodies ------------------------------------------------------------------


SHOT_KG, GAP_M, BALL = 0.1, 0.02, Sphere(radius_m=0.06)


@dataclass(frozen=True)
class _Shot:
    """A body that flies along x against a wall, or against a row of others with gaps of 20 mm, without gravity.

    Attributes:
        speed_m_per_s: Its speed.
        restitution: Restitution of the pairs.
        at_s: Time of the first impact [s].
        order: -1 if the contact lists the target first.
        row: Number of bodies that it hits; 0 for the wall.
        target_kg: Mass of each target.
        target_m_per_s: Their speed before the impact.
        shape: Shape of all of them.
        reach_m: Distance from their middle to the contact point.
        euler_deg: Turn about x, z and x. Targets are turned by 55 degrees about x.
    """

    speed_m_per_s: float
    restitution: float
    at_s: float
    order: int = 1
    row: int = 0
    target_kg: float = 0.1
    target_m_per_s: float = 0.0
    shape: Shape = BALL
    reach_m: float = 0.06
    euler_deg: Vector = (0.0, 0.0, 0.0)

    def names(self, name: str) -> list[str]:
        """Return the names of the body and of its targets."""
        return [name, *(f"{name} {index}" for index in range(1, self.row + 1))]


AFTER_S = 0.1
"""Time from an impact to the speeds after it [s]."""


def _weightless(
    lab: Lab, bodies: Sequence[RigidBody], contacts: Sequence[Contact], seconds: float
) -> Recording:
    """Return the recording of bodies without gravity."""
    return lab.rollout(
        Scene(
            bodies=tuple(bodies),
            contacts=tuple(contacts),
            duration_s=seconds,
            gravity_m_per_s2=0.0,
        )
    )


def _fly(lab: Lab, shots: Mapping[str, _Shot]) -> Recording:
    """Return the recording of shots side by side."""
    width = 0.4 * len(shots) + 1.0
    bodies = [fixed_box("wall", (0.2, 0.5 * width - 0.7, 1.0), (0.4, width, 0.6))]
    contacts = []
    for index, (name, shot) in enumerate(shots.items()):
        rotation = Rotation.from_euler("xzx", shot.euler_deg, degrees=True)
        x, speed, mass_kg = -shot.reach_m, shot.speed_m_per_s, SHOT_KG
        names = shot.names(name)
        for label in names:
            place = (x - speed * shot.at_s, 0.4 * index, 1.0)
            pose = Pose.from_rotation(place, rotation)
            part = body(label, shot.shape, pose, mass_kg=mass_kg)
            bodies.append(thrown(part, (speed, 0.0, 0.0)))
            width_m = 2.0 * shot.reach_m
            # The targets have gaps, and the body starts on its way to the first.
            if label != name:
                width_m += GAP_M
            x += width_m
            rotation = Rotation.from_euler("x", 55.0, degrees=True) * rotation
            speed, mass_kg = shot.target_m_per_s, shot.target_kg
        for pair in zip(names, names[1:] or ["wall"], strict=False):
            touch = contact(
                *pair[:: shot.order], friction=0.3, restitution=shot.restitution
            )
            contacts.append(touch)
    last_s = max(shot.at_s for shot in shots.values())
    return _weightless(lab, bodies, contacts, last_s + AFTER_S)


def _rebounds(rollout: Recording, shots: Mapping[str, _Shot]) -> dict[str, float]:
    """Return the speed of separation of the last two bodies of each shot, over the expected speed."""
    rebounds = {}
    for name, shot in shots.items():
        after = rollout.sample_at(shot.at_s + AFTER_S)
        speeds = [
            float(rollout.velocity(label)[after, 0]) for label in shot.names(name)
        ]
        *_, last, target = speeds if shot.row else (*speeds, 0.0)
        # Each ball of a row hits the next equal one with (1 + e) / 2 times its speed.
        passed = (0.5 + 0.5 * shot.restitution) ** max(shot.row - 1, 0)
        closing = (shot.speed_m_per_s - shot.target_m_per_s) * passed
        rebounds[name] = (target - last) / closing / shot.restitution
    return rebounds


def _worst(rebounds: Mapping[str, float]) -> Measurement:
    """Measure the worst rebound."""
    through = [name for name, rebound in rebounds.items() if rebound < -1.0]
    if through:
        return Measurement(
            measured=rebounds[through[0]],
            expected=1.0,
            hint=f"it passes through at {', '.join(through)}",
            cause="no contact",
        )
    return ratio(rebounds, "the rebound")


@check(
    "rebound-flat",
    title="rebound of a box on its face",
    law="v' = -e v",
    tolerance=REBOUND,
    cause="restitution depends on the number of contact points, which add up or are solved in turn",
)
def rebound_flat(lab: Lab) -> Measurement:
    """A box of 0.1 m by 0.08 m by 0.06 m dropped by 0.4 m on a plane, flat; restitution 0.5.

    Outgoing over incoming speed, from the heights of its flights.

    Source: Newton's law of restitution.
    """
    flat = box("box", (0.0, 0.0, RADIUS_M + DROP_M), (0.1, 0.08, 2.0 * RADIUS_M))
    touch = contact("box", "ground", friction=0.5, restitution=0.5)
    scene = drop_scene([flat], (touch,), seconds=2.1 * fall_s(DROP_M, G), gravity=G)
    bounce = bounce_of(lab.rollout(scene), "box")
    measured = bounce.restitution if bounce else math.inf
    return Measurement(measured=measured, expected=0.5)


BOUNCES, ROW_M = 9, 0.6
GAINS = "bounces gain energy: an impact starts late in a step, inside the other body"
LOSES = "restitution is limited below 1, or bounces lose energy with the place of the step in which they fall"


@check(
    "bounce-row",
    title="nine bounces keep their height at a restitution of 1",
    law="h = const",
    tolerance=Tolerance(
        "the real ball's ratio scatters by 0.0022, the mean of nine bounces by a third; this is twice as much",
        absolute=0.0015,
    ),
    cause=GAINS,
)
def bounce_row(lab: Lab) -> Measurement:
    """Balls dropped by 0.6 m on a plane with restitution 1, alone and twice as heavy.

    Mean ratio of speeds of a bounce, from the median of the mechanical energy after the ninth; the worse of both.

    Source: Newton's law of restitution; energy.
    """
    balls = balls_above_ground({"ball": ROW_M}, spacing_m=0.5)
    balls += [ball("heavy ball", (1.0, 0.0, RADIUS_M + 0.8 * ROW_M), mass_kg=1.0)]
    touch = contact(("ball", "heavy ball"), "ground", friction=0.5, restitution=1.0)
    half_s = fall_s(ROW_M, G)
    seconds = 2.0 * BOUNCES * half_s
    rollout = lab.rollout(drop_scene(balls, (touch,), seconds=seconds, gravity=G))
    late = rollout.between(seconds - 0.5 * half_s, seconds)
    ratios = {}
    for each in balls:
        start_m = each.pose.position_m[2] - RADIUS_M
        above_m = rollout.position(each.name)[late, 2] - RADIUS_M
        squares = np.square(rollout.velocity(each.name)[late, 2])
        share = float(np.median(above_m + squares / (2.0 * G))) / start_m
        ratios[each.name] = max(share, 0.0) ** (0.5 / BOUNCES)
    worst = ratio(ratios, "the mean rebound")
    cause = LOSES if worst.measured < 1.0 else GAINS
    return replace(worst, cause=cause)


EDGES = {
    "an edge across an edge": _Shot(
        0.6,
        0.5,
        0.1,
        order=-1,
        row=1,
        shape=Box(size_m=(0.3, 0.04, 0.04)),
        reach_m=math.sqrt(2.0) * 0.02,
        euler_deg=(45.0, 90.0, 20.0),
    )
}


@check(
    "crossed-edges",
    title="rebound of edges that cross",
    law="v'/v = e",
    tolerance=Tolerance("as for a drop: 1 % of the speed", absolute=0.02),
    cause="edge against edge has no contact, or its normal is that of a face",
)
def crossed_edges(lab: Lab) -> Measurement:
    """A bar that meets a free bar at 0.6 m/s, edge across edge, without gravity; restitution 0.5.

    Speed of separation over that of approach, over the restitution.

    Source: Newton's law of restitution; contract (scene.Contact): boxes have edges.
    """
    return _worst(_rebounds(_fly(lab, EDGES), EDGES))


VOLLEY = {
    "2 m/s on a wall": _Shot(2.0, 0.6, 0.2),
    "2 m/s on a wall, which is listed first": _Shot(2.0, 0.6, 0.2, -1),
    "2 m/s on a ball of twice the mass": _Shot(2.0, 0.7, 0.2, 1, 1, 0.2),
    "2 m/s on a ball, which is listed first": _Shot(2.0, 0.7, 0.2, -1, 1, 0.2),
    "two balls that meet, the lighter listed last": _Shot(
        1.0, 0.8, 0.3, -1, 1, 0.5, -1.0
    ),
    "a row of three balls": _Shot(1.0, 0.9, 0.2, row=3),
    "7 m/s": _Shot(7.0, 0.5, 0.1),
    "11 m/s": _Shot(11.0, 0.5, 0.1, -1),
    "16 m/s": _Shot(16.0, 0.8, 0.1),
}
LATE = {
    "0.5 m/s after 1.4 s": _Shot(0.5, 0.6, 1.4),
    "0.5 m/s after 2.3 s": _Shot(0.5, 0.6, 2.3, -1),
}


def _volley(lab: Lab) -> Recording:
    return _fly(lab, VOLLEY)


@check(
    "volley",
    title="impacts in both orders, fast, slow and late",
    law="v'/v = e; v_n = v ((1 + e) / 2)^n in a row of n equal balls",
    tolerance=Tolerance("as for a drop: 1 % of the speed", absolute=0.012),
    cause="an impact depends on the order of the pair, on which bodies move, on speed or on time",
)
def volley(lab: Lab) -> Measurement:
    """Balls of 0.1 kg that hit a wall, a free ball or a row of three with 0.5 to 16 m/s, early and late.

    Speed of separation over that of approach, over the restitution, for the last pair of a row; the worst of eleven.

    Source: Newton's law of restitution.
    """
    early, late = _rebounds(lab.once(_volley), VOLLEY), _rebounds(_fly(lab, LATE), LATE)
    return _worst(early | late)


@check(
    "momentum",
    title="impacts of free bodies keep momentum",
    law="m1 v1 + m2 v2 = const",
    tolerance=Tolerance("impulses of a pair are opposite and equal", absolute=1e-3),
    cause="a body has another mass in impacts, or the impulses of a pair are not opposite",
)
def momentum(lab: Lab) -> Measurement:
    """Balls of 0.1 kg that hit free balls of 0.1, 0.2 and 0.5 kg, which rest or fly towards them.

    Momentum after the impacts over that before them; the worst of four.

    Source: Newton.
    """
    rollout = lab.once(_volley)
    ratios = {}
    for name, shot in VOLLEY.items():
        if shot.row:
            first, *other_speeds = [
                rollout.velocity(label)[:, 0] for label in shot.names(name)
            ]
            along = SHOT_KG * first + shot.target_kg * np.sum(other_speeds, axis=0)
            ratios[name] = float(along[-1] / along[0])
    return ratio(ratios, "the momentum")


BAR_M, BAR_KG, STRIKE_M_PER_S = (0.04, 0.3, 0.05), 0.3, 1.0
STRIKES = {
    # Distance of the point of impact from the middle of the bar [m], and restitution.
    "60 mm off the middle, e = 1": (0.06, 1.0),
    "130 mm off the middle, e = 0.5": (-0.13, 0.5),
    "130 mm off the middle, e = 0.2": (0.13, 0.2),
}


@check(
    "strike-aside",
    title="impact beside the centre of mass",
    law="J = (1 + e) v / (1/m1 + 1/m2 + b^2 / I)",
    tolerance=Tolerance("as for a drop: 1 % of the speed", absolute=0.012),
    cause="the impulse acts beside the point of contact, or the inertia does not enter it",
)
def strike_aside(lab: Lab) -> Measurement:
    """Balls of 0.1 kg that hit free bars of 0.3 kg at 1 m/s, 60 and 130 mm from the middle, without friction.

    Difference from the law of a speed of ball or bar, or of the bar's spin times its length, over 1 m/s; plus 1.

    Source: Newton's law of restitution; Euler.
    """
    bodies, contacts, laws = [], [], {}
    for at, (name, (aside_m, e)) in enumerate(STRIKES.items()):
        bar = box(f"bar {name}", (0.0, 1.0 * at, 1.0), BAR_M, mass_kg=BAR_KG)
        place = (-0.1 - 0.5 * BAR_M[0] - RADIUS_M, at + aside_m, 1.0)
        bodies += [bar, thrown(ball(name, place), (STRIKE_M_PER_S, 0.0, 0.0))]
        contacts.append(contact(name, bar.name, friction=0.0, restitution=e))
        moment = box_inertia_kg_m2(bar)[2]
        masses = 1.0 / SHOT_KG + 1.0 / BAR_KG + aside_m**2 / moment
        gains = (-1.0 / SHOT_KG, 1.0 / BAR_KG, -aside_m / moment * BAR_M[1])
        laws[name] = (1.0 + e) / masses * np.array(gains) + (1.0, 0.0, 0.0)
    rollout = _weightless(lab, bodies, contacts, 0.15)
    ratios = {}
    for name, law in laws.items():
        speed, bar_speed = (
            rollout.velocity(each)[-1, 0] for each in (name, f"bar {name}")
        )
        end = rollout.angular_velocity(f"bar {name}")[-1, 2] * BAR_M[1]
        seen = np.array((speed, bar_speed, end)) / STRIKE_M_PER_S
        parts = ("speed of the ball", "speed of the bar", "spin of the bar")
        for part, off in zip(parts, seen - law, strict=True):
            ratios[f"the {part}, {name}"] = 1.0 + float(off)
    return ratio(ratios, "motion after the impact")


SLOW = {
    f"{speed:g} mm/s": _Shot(1e-3 * speed, 0.5, 0.15, -1 if speed == 60.0 else 1)
    for speed in (300.0, 100.0, 60.0, 30.0)
}


@check(
    "rebound-slow",
    title="slow rebound",
    law="v' = -e v at any speed",
    unit="mm/s",
    tolerance=Tolerance(
        "2 % of the fastest; a threshold takes 15 or more", absolute=3.0
    ),
    cause="bodies do not rebound below a threshold speed: set it to 0",
)
def rebound_slow(lab: Lab) -> Measurement:
    """Balls that fly against a wall with 300, 100, 60 and 30 mm/s; restitution 0.5, no gravity.

    Speed after the impact that is furthest from the law.

    Source: Newton's law of restitution.
    """
    rollout = _fly(lab, SLOW)
    ratios = _rebounds(rollout, SLOW)
    expected = {name: 500.0 * shot.speed_m_per_s for name, shot in SLOW.items()}
    worst = max(SLOW, key=lambda name: expected[name] * abs(ratios[name] - 1.0))
    before = rollout.sample_at(0.1)
    asleep = [
        name
        for name, shot in SLOW.items()
        if rollout.velocity(name)[before, 0] < 0.9 * shot.speed_m_per_s
    ]
    dead = [name for name, rebound in ratios.items() if abs(rebound) < 0.2]
    hint, cause = f"the rebound of {worst} is wrong", ""
    if asleep:
        hint = f"balls of {', '.join(asleep)} stop before the wall"
        cause = "the engine puts slow bodies to sleep"
    elif dead:
        hint = f"impacts of {', '.join(dead)} do not rebound"
        cause = "a threshold speed of restitution"
    return Measurement(
        measured=expected[worst] * ratios[worst],
        expected=expected[worst],
        hint=hint,
        cause=cause,
    )


THIN_M, BULLET_M_PER_S = 0.002, 6.0
BULLETS: dict[str, Shape] = {
    "ball of 10 mm": Sphere(radius_m=0.005),
    "ball of 20 mm": Sphere(radius_m=0.01),
    "box of 10 mm": Box(size_m=(0.01, 0.01, 0.01)),
    "box of 30 mm": Box(size_m=(0.03, 0.03, 0.03)),
}


@check(
    "thin-wall",
    title="fast bodies do not pass thin walls",
    law="x < place of the wall",
    tolerance=COUNT,
    cause="an impact is missed: the step is long for the speed and the wall, and contacts are not continuous",
)
def thin_wall(lab: Lab) -> Measurement:
    """Balls and boxes of 10 to 30 mm that fly with 6 m/s against a fixed wall of 2 mm; restitution 0.5, no gravity.

    Number of bodies behind the wall within 0.1 s.

    Source: solids do not overlap.
    """
    bodies = [fixed_box("wall", (0.2, 0.5, 0.0), (THIN_M, 2.0, 0.4))]
    for at, (name, shape) in enumerate(BULLETS.items()):
        start = Pose(position_m=(0.003 * at, 0.3 * at, 0.0))
        shot = body(name, shape, start, mass_kg=0.01)
        bodies.append(thrown(shot, (BULLET_M_PER_S, 0.0, 0.0)))
    touch = contact(tuple(BULLETS), "wall", friction=0.3, restitution=0.5)
    rollout = _weightless(lab, bodies, [touch], 0.1)
    passed = [name for name in BULLETS if rollout.position(name)[-1, 0] > 0.2]
    return Measurement(measured=len(passed), hint=f"passed: {', '.join(passed)}")


# --- oblique impacts -------------------------------------------------------------------------------------------------

OBLIQUE_E, DOWN_M_PER_S = 0.6, 2.0
OBLIQUE = {
    "grip": (0.6, 1.0, 0.0, 1),
    "grip at 140 degrees": (0.6, 1.0, 140.0, -1),
    "slip": (0.1, 3.0, 0.0, 1),
    "slip at 250 degrees": (0.1, 3.0, 250.0, -1),
    "grip at 3 m/s": (0.6, 3.0, 0.0, 1),
    "grip at 3 m/s and 140 degrees": (0.6, 3.0, 140.0, -1),
}
"""Friction, speed along the plane [m/s], its direction [deg] of balls, and -1 if the contact lists the plane first."""
OBLIQUE_WIDTH = Tolerance(
    "as for a slide: the error must be well below the scatter of friction",
    absolute=0.01,
)


def _oblique(lab: Lab) -> dict[str, FloatArray]:
    """Return the speed along the plane, the speed up, and the rolling speed of each ball after its impact [m/s]."""
    balls, contacts = [], []
    turns = {}
    for index, (name, (friction, along, degrees, order)) in enumerate(OBLIQUE.items()):
        turns[name] = Rotation.from_euler("z", degrees, degrees=True)
        place = (0.0, 1.5 * index, RADIUS_M + 0.1 * DOWN_M_PER_S)
        velocity = turns[name].apply((along, 0.0, -DOWN_M_PER_S))
        balls.append(thrown(ball(name, place, radius_m=RADIUS_M), velocity))
        pair = (name, "ground")[::order]
        contacts.append(contact(*pair, friction=friction, restitution=OBLIQUE_E))
    rollout = _weightless(lab, [*balls, ground()], contacts, 0.2)
    speeds = {}
    for name, rotation in turns.items():
        velocity = rotation.apply(rollout.velocity(name)[-1], inverse=True)
        spin = rotation.apply(rollout.angular_velocity(name)[-1], inverse=True)
        speeds[name] = np.array([velocity[0], velocity[2], RADIUS_M * spin[1]])
    return speeds


@check(
    "oblique-grip",
    title="oblique impact that stops to slip",
    law="v' = 5/7 v, omega' = 5/7 v / r",
    tolerance=OBLIQUE_WIDTH,
    cause="friction acts not at all in pairs of the mode IMPACT, or not on the whole impulse, or its moment is wrong",
)
def oblique_grip(lab: Lab) -> Measurement:
    """Balls thrown at a plane with 2 m/s down and 1 m/s along, with friction 0.6 and restitution 0.6; no gravity.

    Speed along the plane and spin after the impact, over those of a ball that rolls; the worst of two directions.

    Source: Routh, Rigid Dynamics; Brach, J. Appl. Mech. 51 (1984).
    """
    return _grips(lab, slice(2))


def _grips(lab: Lab, some: slice) -> Measurement:
    """Measure speed and spin of some balls after the impact over those of balls that roll."""
    ratios = {}
    for name, (along, _, rolling) in list(lab.once(_oblique).items())[some]:
        rolls = 5.0 / 7.0 * OBLIQUE[name][1]
        ratios[f"the speed of {name}"] = along / rolls
        ratios[f"the spin of {name}"] = rolling / rolls
    return ratio(ratios, "motion after the impact")


@check(
    "oblique-fast",
    title="fast oblique impact that stops to slip",
    law="v' = 5/7 v, omega' = 5/7 v / r",
    tolerance=OBLIQUE_WIDTH,
    cause="friction acts in a part of the impact, so that it cannot stop a fast slip",
)
def oblique_fast(lab: Lab) -> Measurement:
    """The balls of oblique-grip with 3 m/s along the plane, which friction 0.6 stops: it needs 2/7 v / (1.6 u) = 0.27.

    Speed along the plane and spin after the impact, over those of a ball that rolls; the worst of two directions.

    Source: Routh, Rigid Dynamics.
    """
    return _grips(lab, slice(4, None))


@check(
    "oblique-slip",
    title="oblique impact that slips",
    law="(v - v') / (u + u') = mu, u' = e u",
    tolerance=OBLIQUE_WIDTH,
    cause="friction misses the impulse of rebound, or slip adds to the rebound, as convex models of contact do",
)
def oblique_slip(lab: Lab) -> Measurement:
    """Balls thrown at a plane with 2 m/s down and 3 m/s along, with friction 0.1 and restitution 0.6; no gravity.

    Impulse along the plane over that normal to it, over friction; speed up over that of the law; the worst of both.

    Source: Routh, Rigid Dynamics; Brach, J. Appl. Mech. 51 (1984).
    """
    ratios = {}
    for name, (along, up, _) in list(lab.once(_oblique).items())[2:4]:
        friction, before, *_ = OBLIQUE[name]
        impulses = (before - along) / (up + DOWN_M_PER_S)
        ratios[f"the friction of {name}"] = impulses / friction
        ratios[f"the rebound of {name}"] = up / DOWN_M_PER_S / OBLIQUE_E
    return ratio(ratios, "motion after the impact")


# --- energy ----------------------------------------------------------------------------------------------------------

FALL_M = 0.5
FLAT = (0.0, 0.0, 0.0)
LOWER, UPPER = "lower", "upper"
CUBES: dict[str, tuple[Vector, Vector, str]] = {
    "off its centre on a post": ((-0.975, 0.025, 0.0), FLAT, "post"),
    "on a corner": ((0.0, 0.0, 0.0), (44.0, 34.0, 10.0), "ground"),
    "on an edge": ((1.0, 0.0, 0.0), (44.0, 0.0, 20.0), "ground"),
    LOWER: ((2.0, 0.0, 0.0), FLAT, "ground"),
    UPPER: ((2.03, 0.02, 0.11), FLAT, LOWER),
}
"""Shift of each cube [m], its turn about x, y and z [deg], and the body that it hits."""


@check(
    "drop-energy",
    title="bodies that tumble gain no energy",
    law="T + V <= initial T + V",
    unit="%",
    tolerance=Tolerance(
        "energies are read once a step, and a step of 1/600 s at the speed of impact is 1 % of the fall",
        absolute=1.0,
    ),
    cause="the engine makes energy: contacts too stiff for the step, few iterations, or restitution point by point",
)
def drop_energy(lab: Lab) -> Measurement:
    """Cubes of 0.1 m that drop by 0.5 m; restitution 1, friction 0.2.

    One lands 35 mm off its centre on a narrow post, one on a corner, one on an edge, and two, 10 mm apart, one on the
    other.

    Largest gain of kinetic and potential energy over the energy of the fall within 0.7 s, of the worst drop.

    Source: contacts are passive: a restitution of 1 keeps the energy, less loses some.
    """
    post = fixed_box("post", (-1.0, 0.0, -0.5), (0.04, 0.04, 1.0))
    bodies, contacts = [post, ground()], []
    for name, (shift_m, euler_deg, target) in CUBES.items():
        rotation = Rotation.from_euler("xyz", euler_deg, degrees=True)
        lowest_m = 0.05 * np.abs(rotation.as_matrix()[2]).sum()
        place = np.add(shift_m, (0.0, 0.0, FALL_M + lowest_m))
        bodies.append(box(name, vector(place), (0.1, 0.1, 0.1), euler_deg=euler_deg))
        contacts.append(contact(name, target, friction=0.2, restitution=1.0))
    rollout = lab.rollout(
        Scene(bodies=tuple(bodies), contacts=tuple(contacts), duration_s=0.7)
    )
    gains = {name: _energy_gain_m(rollout, name) for name in CUBES}
    gains["two cubes"] = 0.5 * (gains.pop(LOWER) + gains.pop(UPPER))
    percent = {
        f"the energy of {name}": 100.0 * float(gain.max() / FALL_M)
        for name, gain in gains.items()
    }
    return largest(percent, "%")


def _energy_gain_m(rollout: Recording, name: str) -> FloatArray:
    """Return the energy of a cube over its weight, less that at the start [m], shape [sample_count]."""
    cube = rollout.scene.body(name)
    spin = rollout.rotation(name).apply(rollout.angular_velocity(name), inverse=True)
    squares = np.square(rollout.velocity(name)).sum(axis=1)
    squares += spin**2 @ box_inertia_kg_m2(cube) / cube.mass_kg
    return squares / (2.0 * G) + rollout.displacement(name)[:, 2]
