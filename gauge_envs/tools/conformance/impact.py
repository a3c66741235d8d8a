"""Impacts of bodies that fly without gravity: speeds, orders, momentum, edges, and thin walls."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs.fixtures.drop import RADIUS_M
from gauge_envs.fixtures.parts import (
    ball,
    body,
    box,
    box_inertia_kg_m2,
    contact,
    fixed_box,
    thrown,
)
from gauge_envs.fixtures.recording import Recording
from gauge_envs.scene import Box, Pose, Shape, Sphere, Vector
from gauge_envs.tools.conformance.lab import Lab, Measurement, ratio
from gauge_envs.tools.conformance.model import COUNT, Checks, Level, Tolerance

check = Checks(Level.CONTACT)


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


WEIGHTLESS = {"gravity_m_per_s2": 0.0}

AFTER_S = 0.1
"""Time from an impact to the speeds after it [s]."""


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
    return lab.run(bodies, contacts, last_s + AFTER_S, **WEIGHTLESS)


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
    cause="bodies do not rebound below a threshold speed: set it to 0; or slow bodies fall asleep",
)
def rebound_slow(lab: Lab) -> Measurement:
    """Balls that fly against a wall with 300, 100, 60 and 30 mm/s; restitution 0.5, no gravity.

    Speed after the impact that is furthest from the law.

    Source: Newton's law of restitution.
    """
    ratios = _rebounds(_fly(lab, SLOW), SLOW)
    expected = {name: 500.0 * shot.speed_m_per_s for name, shot in SLOW.items()}
    worst = max(SLOW, key=lambda name: expected[name] * abs(ratios[name] - 1.0))
    return Measurement(
        measured=expected[worst] * ratios[worst],
        expected=expected[worst],
        hint=f"the rebound of {worst} is wrong",
    )


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
    cause="an impact depends on the order of the pair, on which bodies move, on speed or on time, or is missed",
)
def volley(lab: Lab) -> Measurement:
    """Balls of 0.1 kg that hit a wall, a free ball or a row of three with 0.5 to 16 m/s, early and late.

    Speed of separation over that of approach, over the restitution, for the last pair of a row; the worst of eleven.

    Source: Newton's law of restitution.
    """
    early, late = _rebounds(lab.once(_volley), VOLLEY), _rebounds(_fly(lab, LATE), LATE)
    return ratio(early | late, "the rebound")


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
    return ratio(_rebounds(_fly(lab, EDGES), EDGES), "the rebound")


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
    rollout = lab.run(bodies, contacts, 0.15, **WEIGHTLESS)
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
    rollout = lab.run(bodies, [touch], 0.1, **WEIGHTLESS)
    passed = [name for name in BULLETS if rollout.position(name)[-1, 0] > 0.2]
    return Measurement(measured=len(passed), hint=f"passed: {', '.join(passed)}")
