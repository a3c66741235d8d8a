"""Impacts: rebounds of all speeds, momentum, friction in impacts, energy, edges, and copies of a scene."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from gauge_envs.scene import (
    GRAVITY_M_PER_S2 as G,
    Box,
    Contact,
    Hinge,
    Motion,
    Pose,
    RigidBody,
    Scene,
    Shape,
    Sphere,
    Tether,
)
from gauge_envs.scene.geometry import FloatArray, vector
from gauge_envs.tools.bench.drop import (
    RADIUS_M,
    balls_above_ground,
    bounce_of,
    drop_scene,
    fall_s,
)
from gauge_envs.tools.bench.parts import (
    ball,
    body,
    box,
    box_inertia_kg_m2,
    contact,
    driven_box,
    driver,
    fixed_box,
    ground,
    ramp,
    thrown,
)
from gauge_envs.tools.bench.recording import Recording
from gauge_envs.tools.conformance.lab import Lab, largest, ratio
from gauge_envs.tools.conformance.model import Measurement, Tolerance, check

NEWTON = "Newton's law of restitution"
REBOUND = Tolerance(
    "the real ball's ratio scatters by 0.0022 over 22 trials; this is twice as much",
    absolute=0.005,
)

# --- drops -----------------------------------------------------------------------------------------------------------

DROP_M, LOW_DROP_M = 0.4, 0.05
DROPS_S = 2.1 * fall_s(DROP_M, G)
LEAST_HOP = 0.01
"""Height of a hop over that of the drop below which a contact settles and does not rebound."""


def _rebound(rollout: Recording, name: str) -> float:
    """Return outgoing over incoming speed of a body that drops; 0 if it stays down, NaN if it does not land."""
    bounce = bounce_of(rollout, name)
    if bounce is None:
        return math.nan
    return bounce.restitution if bounce.restitution**2 > LEAST_HOP else 0.0


@check(
    "rebound-0.5",
    title="rebound of balls",
    law="v' = -e v",
    source=NEWTON,
    tolerance=REBOUND,
    cause="check how Contact.restitution enters: as a coefficient or as damping, and whether two values are combined",
)
def rebound_of_balls(lab: Lab) -> Measurement:
    """Balls dropped by 0.4 m on a plane, with restitutions of 0.2, 0.5, 0.75 and 0.95 with it.

    Outgoing over incoming speed of each, from the heights of its flights, less e; the worst of four.
    """
    values = (0.5, 0.95, 0.2, 0.75)
    names = {f"e = {value:g}": value for value in values}
    contacts = tuple(
        contact(
            *(name, "ground")[:: 1 if value < 0.6 else -1],
            friction=0.5,
            restitution=value,
        )
        for name, value in names.items()
    )
    balls = balls_above_ground(dict.fromkeys(names, DROP_M), spacing_m=0.3)
    rollout = lab.rollout(drop_scene(balls, contacts, seconds=DROPS_S, gravity=G))
    ratios = {name: _rebound(rollout, name) for name in names}
    if not any(ratios.values()):
        hint = "no ball leaves the ground again: restitution has no effect"
        return Measurement(measured=max(names.values()), hint=hint)
    return largest(
        {
            f"{name}: {ratios[name]:.4g}": {"": abs(ratios[name] - value)}
            for name, value in names.items()
        }
    )


@check(
    "rebound-flat",
    title="rebound of a box on its face",
    law="v' = -e v",
    source=NEWTON,
    tolerance=REBOUND,
    cause="restitution depends on the number of contact points, which add up or are solved in turn",
)
def rebound_flat(lab: Lab) -> Measurement:
    """A box of 0.1 m by 0.08 m by 0.06 m dropped by 0.4 m on a plane, flat; restitution 0.5.

    Outgoing over incoming speed, from the heights of its flights.
    """
    flat = box("box", (0.0, 0.0, RADIUS_M + DROP_M), (0.1, 0.08, 2.0 * RADIUS_M))
    touch = contact("box", "ground", friction=0.5, restitution=0.5)
    rollout = lab.rollout(drop_scene([flat], (touch,), seconds=DROPS_S, gravity=G))
    return Measurement(measured=_rebound(rollout, "box"), expected=0.5)


@check(
    "rebound-sustained",
    title="sustained pair does not rebound",
    law="v' = 0",
    source="contract (scene.ContactMode)",
    tolerance=Tolerance("it then rises by 0.25 % or less of the drop", absolute=0.05),
    cause="restitution has no effect on a pair of the mode SUSTAINED: give the engine 0",
)
def rebound_sustained(lab: Lab) -> Measurement:
    """A ball dropped by 50 mm on a plane, with restitution 0.8 and the mode of sustained contacts.

    Outgoing over incoming speed, from the heights of its flights.
    """
    balls = balls_above_ground({"ball": LOW_DROP_M}, spacing_m=0.0)
    touch = Contact(first=("ball",), second=("ground",), friction=0.5, restitution=0.8)
    rollout = lab.rollout(drop_scene(balls, (touch,), seconds=0.3, gravity=G))
    return Measurement(measured=_rebound(rollout, "ball"))


# --- balls that fly against walls and balls --------------------------------------------------------------------------


@dataclass(frozen=True)
class _Shot:
    """A ball that flies along x against a wall or another ball, without gravity.

    Attributes:
        speed_m_per_s: Its speed.
        restitution: Restitution of the pair.
        at_s: Time of the impact [s].
        is_first: Whether the contact lists it before what it hits.
        target_kg: Mass of the ball that it hits; 0 for the wall.
        target_m_per_s: Speed of that ball before the impact.
    """

    speed_m_per_s: float
    restitution: float
    at_s: float
    is_first: bool = True
    target_kg: float = 0.0
    target_m_per_s: float = 0.0

    @property
    def closing_m_per_s(self) -> float:
        """Speed of approach."""
        return self.speed_m_per_s - self.target_m_per_s


SHOT_KG, SHOT_M = 0.1, 0.06
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


def _fly(lab: Lab, shots: dict[str, _Shot]) -> Recording:
    """Return the recording of shots side by side."""
    bodies: list[RigidBody] = []
    contacts = []
    for index, (name, shot) in enumerate(shots.items()):
        at = np.array([0.0, 0.4 * index, 1.0])
        gap_m = SHOT_M * (2.0 if shot.target_kg else 1.0)
        start = at - [gap_m + shot.speed_m_per_s * shot.at_s, 0.0, 0.0]
        one = ball(name, vector(start), radius_m=SHOT_M, mass_kg=SHOT_KG)
        bodies.append(thrown(one, (shot.speed_m_per_s, 0.0, 0.0)))
        other = "wall"
        if shot.target_kg:
            other = f"target of {name}"
            start = at - [shot.target_m_per_s * shot.at_s, 0.0, 0.0]
            one = ball(other, vector(start), radius_m=SHOT_M, mass_kg=shot.target_kg)
            bodies.append(thrown(one, (shot.target_m_per_s, 0.0, 0.0)))
        pair = (name, other)[:: 1 if shot.is_first else -1]
        contacts.append(contact(*pair, friction=0.3, restitution=shot.restitution))
    width = 0.4 * len(shots) + 1.0
    wall = fixed_box("wall", (0.2, 0.5 * width - 0.7, 1.0), (0.4, width, 0.6))
    last_s = max(shot.at_s for shot in shots.values())
    return _weightless(lab, [*bodies, wall], contacts, last_s + AFTER_S)


def _restitution(rollout: Recording, name: str, shot: _Shot) -> float:
    """Return the speed of separation over that of approach."""
    after = rollout.sample_at(shot.at_s + AFTER_S)
    speed = float(rollout.velocity(name)[after, 0])
    target = f"target of {name}"
    other = float(rollout.velocity(target)[after, 0]) if shot.target_kg else 0.0
    return (other - speed) / shot.closing_m_per_s


VOLLEY = {
    "2 m/s on a wall": _Shot(2.0, 0.6, 0.2),
    "2 m/s on a wall, which is listed first": _Shot(2.0, 0.6, 0.2, False),
    "2 m/s on a ball of twice the mass": _Shot(2.0, 0.7, 0.2, True, 0.2),
    "2 m/s on a ball, which is listed first": _Shot(2.0, 0.7, 0.2, False, 0.2),
    "two balls that meet, the lighter listed last": _Shot(
        1.0, 0.8, 0.3, False, 0.5, -1.0
    ),
    "7 m/s": _Shot(7.0, 0.5, 0.1),
    "11 m/s": _Shot(11.0, 0.5, 0.1, False),
    "16 m/s": _Shot(16.0, 0.8, 0.1),
    "0.5 m/s after 1.4 s": _Shot(0.5, 0.6, 1.4),
    "0.5 m/s after 2.3 s": _Shot(0.5, 0.6, 2.3, False),
}


@check(
    "volley",
    title="impacts in both orders, fast, slow and late",
    law="v'/v = e, m1 v1 + m2 v2 = const",
    source="Newton",
    tolerance=Tolerance("as for a drop: 1 % of the speed", absolute=0.012),
    cause="an impact depends on the order of the pair, on which bodies move, on speed or on time",
)
def volley(lab: Lab) -> Measurement:
    """Balls of 0.1 kg that hit a wall or a free ball with 0.5 to 16 m/s, early and late, listed first or second.

    Speed of separation over that of approach, over the restitution; momentum of two free balls after the impact over
    that before it; the worst of ten impacts.
    """
    rollout = _fly(lab, VOLLEY)
    ratios = {}
    for name, shot in VOLLEY.items():
        rebound = _restitution(rollout, name, shot) / shot.restitution
        ratios[f"the rebound at {name}"] = rebound
        if rebound < -1.0:
            hint = f"no contact: it passes through at {name}"
            return Measurement(measured=rebound, expected=1.0, hint=hint)
        if shot.target_kg:
            states = rollout.states[name], rollout.states[f"target of {name}"]
            momentum = SHOT_KG * states[0][:, 7] + shot.target_kg * states[1][:, 7]
            ratios[f"the momentum at {name}"] = float(momentum[-1] / momentum[0])
    return ratio(ratios, "a quantity after the impact")


SLOW = {
    f"{speed:g} mm/s": _Shot(1e-3 * speed, 0.5, 0.15, speed != 60.0)
    for speed in (300.0, 100.0, 60.0, 30.0)
}


@check(
    "rebound-slow",
    title="slow rebound",
    law="v' = -e v at any speed",
    source=NEWTON,
    unit="mm/s",
    tolerance=Tolerance(
        "2 % of the fastest; a threshold takes 15 or more", absolute=3.0
    ),
    cause="bodies do not rebound below a threshold speed: set it to 0",
)
def rebound_slow(lab: Lab) -> Measurement:
    """Balls that fly against a wall with 300, 100, 60 and 30 mm/s; restitution 0.5, no gravity.

    Speed after the impact that is furthest from the law.
    """
    rollout = _fly(lab, SLOW)
    after, expected = {}, {}
    for name, shot in SLOW.items():
        mm_per_s = 1e3 * shot.speed_m_per_s
        after[name] = mm_per_s * _restitution(rollout, name, shot)
        expected[name] = mm_per_s * shot.restitution
    worst = max(SLOW, key=lambda name: abs(after[name] - expected[name]))
    before = rollout.sample_at(0.1)
    asleep = [
        name
        for name, shot in SLOW.items()
        if rollout.velocity(name)[before, 0] < 0.9 * shot.speed_m_per_s
    ]
    dead = [name for name in SLOW if abs(after[name]) < 0.2 * expected[name]]
    hint = f"the rebound of {worst} is wrong"
    if asleep:
        hint = f"balls of {', '.join(asleep)} stop before the wall: the engine puts slow bodies to sleep"
    elif dead:
        hint = f"impacts of {', '.join(dead)} do not rebound: a threshold speed of restitution"
    return Measurement(measured=after[worst], expected=expected[worst], hint=hint)


@check(
    "chain",
    title="impact that passes through a row of balls",
    law="v_n = v ((1 + e) / 2)^(n - 1)",
    source="Newton's law of restitution, ball by ball",
    tolerance=Tolerance("1 % for each impact", absolute=0.03),
    cause="a ball takes its speed into the next impact too late, or restitution is lost between free balls",
)
def chain(lab: Lab) -> Measurement:
    """A ball that hits the first of three equal balls in a row with gaps of 20 mm at 1 m/s; e = 0.9, no gravity.

    Speed of the last ball after 0.12 s over that of the law.
    """
    names = tuple(f"ball {index}" for index in range(4))
    balls = [ball(name, (0.08 * i, 0.0, 1.0)) for i, name in enumerate(names)]
    balls[0] = thrown(balls[0], (1.0, 0.0, 0.0))
    touch = contact(names, names, friction=0.2, restitution=0.9)
    rollout = _weightless(lab, balls[::-1], [touch], 0.12)
    last = float(rollout.velocity(names[-1])[-1, 0])
    return Measurement(measured=last / 0.95**3, expected=1.0)


# --- oblique impacts -------------------------------------------------------------------------------------------------

OBLIQUE_E, DOWN_M_PER_S = 0.6, 2.0
OBLIQUE = {
    "grip": (0.6, 1.0, 0.0, True),
    "grip at 140 degrees": (0.6, 1.0, 140.0, False),
    "slip": (0.1, 3.0, 0.0, True),
    "slip at 250 degrees": (0.1, 3.0, 250.0, False),
}
"""Friction, speed along the plane [m/s], its direction [deg] of balls, and whether the contact lists the ball first."""
BRACH = "Routh, Rigid Dynamics; Brach, J. Appl. Mech. 51 (1984)"
OBLIQUE_WIDTH = Tolerance(
    "as for a slide: the error must be well below the scatter of friction",
    absolute=0.01,
)


def _ahead(degrees: float) -> FloatArray:
    angle = math.radians(degrees)
    return np.array([math.cos(angle), math.sin(angle), 0.0])


def _oblique(lab: Lab) -> Recording:
    balls, contacts = [], []
    for index, (name, (friction, along, degrees, is_first)) in enumerate(
        OBLIQUE.items()
    ):
        place = (0.0, 1.5 * index, RADIUS_M + 0.1 * DOWN_M_PER_S)
        velocity = along * _ahead(degrees) - [0.0, 0.0, DOWN_M_PER_S]
        balls.append(thrown(ball(name, place, radius_m=RADIUS_M), velocity))
        pair = (name, "ground")[:: 1 if is_first else -1]
        contacts.append(contact(*pair, friction=friction, restitution=OBLIQUE_E))
    return _weightless(lab, [*balls, ground()], contacts, 0.2)


def _after(rollout: Recording, name: str) -> tuple[float, float, float]:
    """Return the speed along the plane, the speed up, and the rolling spin of a ball after its impact."""
    ahead = _ahead(OBLIQUE[name][2])
    velocity = rollout.velocity(name)[-1]
    spin = rollout.angular_velocity(name)[-1] @ np.cross([0.0, 0.0, 1.0], ahead)
    return float(velocity @ ahead), float(velocity[2]), float(spin)


@check(
    "oblique-grip",
    title="oblique impact that stops to slip",
    law="v' = 5/7 v, omega' = 5/7 v / r",
    source=BRACH,
    tolerance=OBLIQUE_WIDTH,
    cause="friction does not act on the whole impulse, or its moment about the centre is wrong",
)
def oblique_grip(lab: Lab) -> Measurement:
    """Balls thrown at a plane with 2 m/s down and 1 m/s along, with friction 0.6 and restitution 0.6; no gravity.

    Speed along the plane and spin after the impact, over those of a ball that rolls; the worst of two directions.
    """
    rollout = lab.once(_oblique)
    ratios = {}
    for name in list(OBLIQUE)[:2]:
        rolls = 5.0 / 7.0 * OBLIQUE[name][1]
        along, _, spin = _after(rollout, name)
        ratios[f"the speed of {name}"] = along / rolls
        ratios[f"the spin of {name}"] = spin * RADIUS_M / rolls
    found = ratio(ratios, "motion after the impact")
    if spin == 0.0:
        hint = (
            "the impact has no friction: friction acts in pairs of the mode IMPACT too"
        )
        found = replace(found, hint=hint)
    return found


@check(
    "oblique-slip",
    title="oblique impact that slips",
    law="(v - v') / (u + u') = mu, u' = e u",
    source=BRACH,
    tolerance=OBLIQUE_WIDTH,
    cause="friction does not act on the whole impulse, or slip adds to the rebound, as convex models of contact do",
)
def oblique_slip(lab: Lab) -> Measurement:
    """Balls thrown at a plane with 2 m/s down and 3 m/s along, with friction 0.1 and restitution 0.6; no gravity.

    Impulse along the plane over that normal to it, over friction; speed up over that of the law; the worst of both.
    """
    rollout = lab.once(_oblique)
    ratios = {}
    for name in list(OBLIQUE)[2:]:
        friction, before, _, _ = OBLIQUE[name]
        along, up, _ = _after(rollout, name)
        ratios[f"the friction of {name}"] = (
            (before - along) / (up + DOWN_M_PER_S) / friction
        )
        ratios[f"the rebound of {name}"] = up / DOWN_M_PER_S / OBLIQUE_E
    found = ratio(ratios, "motion after the impact")
    if abs(found.measured * (1.0 + OBLIQUE_E) - 1.0) < 0.02:
        hint = "friction acts on the impulse without rebound: the engine adds the restitution after friction"
        found = replace(found, hint=hint)
    return found


# --- energy and edges ------------------------------------------------------------------------------------------------


@check(
    "drop-energy",
    title="bodies that tumble gain no energy",
    law="T + V <= initial T + V",
    source="contacts are passive: a restitution of 1 keeps the energy, less loses some",
    unit="%",
    tolerance=Tolerance(
        "a stiff contact may store 1 %, which is 3 mm of the height of fall",
        absolute=1.0,
    ),
    cause="the engine makes energy: contacts too stiff for the step, few iterations, or restitution point by point",
)
def drop_energy(lab: Lab) -> Measurement:
    """A brick that drops on a corner on a plane, e = 0.5; a cube that drops off its centre on a narrow post, e = 1.

    Largest gain of kinetic and potential energy over the energy of the fall, the worse of both, 0.7 s after the start.
    """
    drop_m, size_m = 0.5, 0.1
    brick = box(
        "brick",
        (0.0, 0.0, 0.35),
        (0.1, 0.06, 0.03),
        euler_deg=(25.0, 35.0, 10.0),
        mass_kg=0.4,
    )
    post = fixed_box("post", (1.0, 0.0, 0.5), (0.04, 0.04, 1.0))
    cube = box(
        "cube", (1.03, 0.02, 1.0 + drop_m + 0.5 * size_m), (size_m,) * 3, mass_kg=0.5
    )
    contacts = (
        contact("brick", "ground", friction=0.4, restitution=0.5),
        contact("cube", "post", friction=0.2, restitution=1.0),
    )
    rollout = lab.rollout(
        Scene(bodies=(brick, cube, post, ground()), contacts=contacts, duration_s=0.7)
    )
    cases = {}
    for one, fall_m in ((brick, 0.35), (cube, drop_m)):
        turns, moved_m = rollout.rotation(one.name), rollout.displacement(one.name)
        spin = turns.apply(rollout.angular_velocity(one.name), inverse=True)
        speed = np.linalg.norm(rollout.velocity(one.name), axis=1)
        # Energy per weight, as a height over the start.
        energy_m = (speed**2 + spin**2 @ box_inertia_kg_m2(one) / one.mass_kg) / (2 * G)
        energy_m += moved_m[:, 2]
        at_s = rollout.times_s[energy_m.argmax()]
        gain_percent = 100.0 * float(energy_m.max() / fall_m)
        cases[f"the energy of the {one.name} at {at_s:.3g} s"] = {"": gain_percent}
    return largest(cases, "%")


BAR_M, EDGE_M_PER_S, EDGE_E = (0.3, 0.04, 0.04), 0.6, 0.5


@check(
    "crossed-edges",
    title="edges that cross",
    law="v'/v = e",
    source="contract (scene.Contact): boxes have edges",
    tolerance=Tolerance(
        "as for a drop of a ball, with the place of the contact on both edges",
        absolute=0.02,
    ),
    cause="the normal of edge against edge is that of a face, or its point is not where they cross",
)
def crossed_edges(lab: Lab) -> Measurement:
    """Bars, edge down, that meet the upper edge of a fixed and of a free bar across at 0.6 m/s; e = 0.5, no gravity.

    Speed of separation over that of approach, over the restitution; the worse of both.
    """
    apart_m = math.sqrt(2.0) * BAR_M[1] + 0.02
    bodies, contacts = [], []
    for index, motion in enumerate((Motion.FIXED, Motion.DYNAMIC)):
        pair = []
        for name, up_m, yaw_deg in (("bar", 0.0, 15.0), ("upper bar", apart_m, 70.0)):
            turn = Rotation.from_euler("xz", [45.0, yaw_deg], degrees=True)
            pose = Pose.from_rotation((0.6 * index, 0.0, 1.0 + up_m), turn)
            pair.append(body(f"{name} {index}", Box(size_m=BAR_M), pose))
        bodies += [
            replace(pair[0], motion=motion),
            thrown(pair[1], (0.0, 0.0, -EDGE_M_PER_S)),
        ]
        names = (pair[1].name, pair[0].name)[:: 1 - 2 * index]
        contacts.append(contact(*names, friction=0.3, restitution=EDGE_E))
    rollout = _weightless(lab, bodies, contacts, 0.2)
    ratios = {}
    for index, what in enumerate(("a fixed bar", "a free bar")):
        up = rollout.velocity(f"upper bar {index}") - rollout.velocity(f"bar {index}")
        ratios[what] = float(up[-1, 2] / EDGE_M_PER_S / EDGE_E)
    found = ratio(ratios, "the rebound")
    if found.measured < -1.0:
        hint = "the bars pass through each other: edges have no contact"
        found = replace(found, hint=hint)
    return found


# --- copies of a scene -----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Copy:
    """A copy x' = l M x + c of a scene.

    A reflection M turns the orientation R of a body into M R D, D = diag(1, 1, -1): its shape is symmetric about the
    x-y plane of its frame. Axes of rotation become det(M) M a.

    Attributes:
        matrix: M, shape [3, 3].
        centre_m: c.
        cause: What may set it apart from the others.
        length: l.
        mass: Factor of all masses.
        order: -1 if bodies, pairs, and the signs of axes of hinges and of quaternions are reversed.
    """

    matrix: FloatArray
    centre_m: tuple[float, float, float]
    cause: str
    length: float = 1.0
    mass: float = 1.0
    order: int = 1

    def place(self, point_m: ArrayLike) -> FloatArray:
        """Return the place of a point [m]."""
        return np.asarray(
            self.length * self.matrix @ np.asarray(point_m) + self.centre_m
        )

    def axis(self, axis: ArrayLike) -> FloatArray:
        """Return an axis of rotation, or an angular velocity."""
        return np.asarray(np.linalg.det(self.matrix) * self.matrix @ np.asarray(axis))

    def shape(self, shape: Shape) -> Shape:
        """Return the shape of a body."""
        if isinstance(shape, Box):
            return Box(size_m=vector(self.length * np.array(shape.size_m)))
        assert isinstance(shape, Sphere), "the scene has boxes and spheres alone"
        return Sphere(radius_m=self.length * shape.radius_m)

    def body(self, one: RigidBody, name: str) -> RigidBody:
        """Return a body."""
        inner = np.diag([1.0, 1.0, np.linalg.det(self.matrix)])
        turn = Rotation.from_matrix(self.matrix @ one.pose.rotation.as_matrix() @ inner)
        pose = Pose.from_rotation(vector(self.place(one.pose.position_m)), turn)
        w, x, y, z = self.order * np.array(pose.quaternion)
        return replace(
            thrown(
                one,
                self.length * self.matrix @ one.linear_velocity_m_per_s,
                self.axis(one.angular_velocity_rad_per_s),
            ),
            name=name,
            shape=self.shape(one.shape),
            pose=replace(pose, quaternion=(w, x, y, z)),
            mass_kg=self.mass * one.mass_kg,
        )


MIRROR_NORMAL = np.array([0.48, -0.6, 0.64])
COPIES = {
    "upright": _Copy(np.eye(3), (-1.0, -1.0, 1.0), "what is listed first"),
    "turned": _Copy(
        Rotation.from_euler("xyz", [140.0, 30.0, -70.0], degrees=True).as_matrix(),
        (1.0, -1.0, 1.0),
        "a frame or an axis",
    ),
    "mirrored": _Copy(
        np.eye(3) - 2.0 * np.outer(MIRROR_NORMAL, MIRROR_NORMAL),
        (1.0, 1.0, 1.0),
        "an axis, a sign, or the order of bodies and pairs",
        order=-1,
    ),
    "large": _Copy(
        np.eye(3),
        (-1.0, 1.0, 1.0),
        "a length, a mass, a limit of force, torque or speed, or what is last",
        length=2.0,
        mass=8.0,
    ),
}
PARTS = {
    "brick": "contact with a fixed body",
    "ball": "contact with a driven body",
    "bar": "hinge",
    "bob": "string",
}
"""Dynamic bodies, and what acts on each."""
AXIS, ANCHOR_M = np.array([0.36, 0.48, 0.8]), np.array([0.0, 0.5, 0.1])
STRING_M, STRING_END_M = 0.25, np.array([0.5, 0.0, 0.3])


def _bodies() -> list[RigidBody]:
    """Return the bodies of the scene before they are copied."""
    size_m = (0.12, 0.08, 0.05)
    # The brick meets the slab with one corner, under its centre, and rebounds before another one comes down.
    on_corner, _ = Rotation.align_vectors([[0.0, 0.0, -1.0]], [size_m])
    pose = Pose.from_rotation((-0.1, 0.05, 0.25), on_corner)
    brick = body("brick", Box(size_m=size_m), pose)
    struck = ball("ball", (-0.48, 0.12, 0.34), radius_m=0.04)
    bar = box(
        "bar",
        (0.1, 0.5, 0.1),
        (0.3, 0.04, 0.03),
        euler_deg=(20.0, 0.0, 30.0),
        mass_kg=0.1,
    )
    arm_m = np.array(bar.pose.position_m) - ANCHOR_M
    end_m = vector(STRING_END_M + STRING_M * np.array([0.6, 0.0, -0.8]))
    return [
        fixed_box("slab", (0.0, 0.0, -0.05), (0.6, 0.5, 0.1)),
        thrown(brick, (0.7, -0.4, -1.5), (0.6, -1.0, 0.5)),
        driven_box(
            "paddle", (-0.5, 0.1, 0.2), (0.2, 0.16, 0.04), euler_deg=(15.0, 10.0, 0.0)
        ),
        thrown(struck, (0.0, 0.0, 0.0), (6.0, 4.0, -3.0)),
        thrown(bar, np.cross(3.0 * AXIS, arm_m), 3.0 * AXIS),
        thrown(
            box("bob", end_m, (0.08, 0.04, 0.03)), (0.8, 0.5, 0.6), (1.0, -4.0, 2.0)
        ),
    ]


def _copies(parts: Sequence[str]) -> Scene:
    """Return four copies of some parts."""
    carriers = {"brick": "slab", "ball": "paddle"}
    names = {*parts, *(carriers[part] for part in parts if part in carriers)}
    bodies: list[RigidBody] = []
    contacts, drivers = [], []
    joints: list[Hinge | Tether] = []
    for name, copy in COPIES.items():
        label = f"{name} {{}}".format
        some = [one for one in _bodies() if one.name in names]
        bodies += [copy.body(one, label(one.name)) for one in some[:: copy.order]]
        for part in parts[:: copy.order]:
            if part in carriers:
                pair = (label(part), label(carriers[part]))[:: copy.order]
                contacts.append(contact(*pair, friction=0.15, restitution=0.5))
            if part == "bar":
                place, axis = copy.place(ANCHOR_M), copy.order * copy.axis(AXIS)
                joints.append(
                    Hinge(body=label(part), anchor_m=vector(place), axis=vector(axis))
                )
            if part == "bob":
                place, length_m = copy.place(STRING_END_M), copy.length * STRING_M
                joints.append(
                    Tether(body=label(part), anchor_m=vector(place), length_m=length_m)
                )
            if part == "ball":
                axis = copy.matrix @ [0.0, 0.28, 0.96]
                rise = ramp(0.3 * copy.length, start_s=0.0, duration_s=0.3, ramp_s=0.1)
                paddle = label("paddle")
                drivers.append(driver(paddle, "translate", vector(axis), rise))
    return Scene(
        bodies=tuple(bodies),
        contacts=tuple(contacts),
        joints=tuple(joints),
        drivers=tuple(drivers),
        duration_s=0.5,
        gravity_m_per_s2=0.0,
    )


@check(
    "copies-alike",
    title="turned, mirrored, reordered and large copies of a scene move alike",
    law="x' = l M x + c, for any rotation or reflection M, any order, and any factors of lengths l and of masses",
    source="Galilei, Newton: without gravity, mechanics has no direction, handedness, order or scale",
    unit="%",
    tolerance=Tolerance(
        "collisions enlarge the rounding of single precision; a frame, sign or order gives tens of per cent",
        absolute=1.0,
    ),
    cause="the engine prefers a direction, a handedness, a place in a list, or a scale of length or mass",
)
def copies_alike(lab: Lab) -> Measurement:
    """Four copies of a scene without gravity: upright, turned, mirrored and listed in reverse, twice as large.

    In each a brick hits a slab, a driven paddle hits a ball, a bar turns on a leaning hinge, and a box whirls on a
    string. What the engine does not build is left out.

    Largest distance of a body's displacement or rotation from the median of the copies, over its path or angle.
    """
    parts = lab.buildable([*PARTS], _copies)
    rollout = lab.rollout(_copies(parts))
    cases = {}
    for part in parts:
        places, turns = [], []
        for name, copy in COPIES.items():
            moved_m = rollout.displacement(f"{name} {part}")
            places.append(moved_m @ copy.matrix / copy.length)
            rotations = rollout.rotation(f"{name} {part}")
            steps = (rotations[1:] * rotations[:-1].inv()).as_rotvec() @ copy.matrix
            turns.append(np.linalg.det(copy.matrix) * np.cumsum(steps, axis=0))
        for what, moved in (("place", np.array(places)), ("rotation", np.array(turns))):
            middle = np.median(moved, axis=0)
            off = np.linalg.norm(moved - middle, axis=2).max(axis=1)
            percent = 100.0 * off / np.linalg.norm(middle, axis=1).max()
            for (name, copy), error in zip(COPIES.items(), percent, strict=True):
                case = f"the {what} of the {part} ({PARTS[part]}) of the {name} copy ({copy.cause})"
                cases[case] = {"": float(error)}
    return largest(cases, "%")
