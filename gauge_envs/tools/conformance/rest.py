"""Bodies at rest: pairs that collide, heights, towers, walls, and long rest."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product, repeat
from typing import NamedTuple

import numpy as np

from gauge_envs.fixtures.parts import (
    body,
    box,
    contact,
    corners,
    driver,
    fixed_box,
    ground,
    ramp,
)
from gauge_envs.fixtures.recording import Recording
from gauge_envs.scene import (
    GRAVITY_M_PER_S2 as G,
    Box,
    Capsule,
    Compound,
    ConvexUnion,
    Cylinder,
    Ellipsoid,
    Hinge,
    Motion,
    Part,
    Plane,
    Pose,
    RigidBody,
    Scene,
    Shape,
    Sphere,
    Vector,
)
from gauge_envs.scene.geometry import vector
from gauge_envs.tools.conformance.lab import Lab, Measurement, largest, largest_mm
from gauge_envs.tools.conformance.model import COUNT, Checks, Level, Tolerance

check = Checks(Level.CONTACT)


SCATTER_MM = 0.5
SCATTER = Tolerance("half the scatter of the real trials", absolute=SCATTER_MM)

# --- pairs of shapes -------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Solid:
    """A shape in an orientation in which it stands.

    Attributes:
        shape: The shape.
        half_m: Half of its height.
        euler_deg: Its Euler angles.
        centre_m: Its middle, relative to its origin.
    """

    shape: Shape
    half_m: float
    euler_deg: Vector = (0.0, 0.0, 0.0)
    centre_m: Vector = (0.0, 0.0, 0.0)

    def on(self, name: str, place_m: Vector, mass_kg: float) -> RigidBody:
        """Return a dynamic body that stands on a place."""
        middle_m = np.add(place_m, (0.0, 0.0, self.half_m))
        pose = Pose.from_euler_deg(vector(middle_m - self.centre_m), self.euler_deg)
        # Bodies share no shape object, as in a scene that is read from a file.
        return body(name, replace(self.shape), pose, mass_kg=mass_kg)


PRISM = ConvexUnion(
    pieces_m=(
        corners((-0.02, -0.025, -0.01), (0.03, 0.02, 0.02)),
        corners((-0.02, -0.025, 0.02), (0.03, 0.02, 0.025)),
    )
)
SOLIDS = {
    "box": _Solid(Box(size_m=(0.06, 0.05, 0.04)), 0.02),
    "sphere": _Solid(Sphere(radius_m=0.02), 0.02),
    "cylinder": _Solid(Cylinder(radius_m=0.025, length_m=0.05), 0.025),
    "lying cylinder": _Solid(
        Cylinder(radius_m=0.025, length_m=0.08), 0.025, (90.0, 0.0, 0.0)
    ),
    "convex solid": _Solid(PRISM, 0.0175, centre_m=(0.005, -0.0025, 0.0075)),
}
SUPPORTS = {
    "plane": _Solid(Plane(), 0.0),
    "block": _Solid(Box(size_m=(0.15, 0.15, 0.05)), 0.025),
    "box": _Solid(Box(size_m=(0.12, 0.12, 0.06)), 0.03),
    "turned box": _Solid(Box(size_m=(0.14, 0.07, 0.12)), 0.035, (90.0, 0.0, 35.0)),
    "sphere": _Solid(Sphere(radius_m=0.06), 0.06),
    "cylinder": _Solid(Cylinder(radius_m=0.06, length_m=0.08), 0.04),
    "lying cylinder": _Solid(
        Cylinder(radius_m=0.05, length_m=0.12), 0.05, (0.0, 90.0, 0.0)
    ),
    "convex solid": SOLIDS["convex solid"],
    "turned solid": _Solid(PRISM, 0.0175, (180.0, 0.0, 0.0), (0.005, 0.0025, -0.0075)),
}
REST_S, SHIFT_MM = 0.2, 0.2
FALL_M = 0.5 * G * REST_S**2


class _Pair(NamedTuple):
    """A body on a support: keys of `SOLIDS` and `SUPPORTS`, and the motion of the support."""

    solid: str
    support: str
    motion: Motion

    @property
    def top(self) -> str:
        """Name of the body."""
        return f"{self.solid} on {self.motion.value} {self.support}"

    @property
    def carrier(self) -> str:
        """Name of its support, unless it is the plane."""
        return f"{self.motion.value} {self.support} under {self.solid}"

    @property
    def other(self) -> str:
        """Name of the body above them, which has no contact."""
        return f"{self.solid} over {self.motion.value} {self.support}"


def _pairs() -> list[_Pair]:
    """Return all pairs; the plane is fixed, the block is free, the other supports are fixed and driven in turn."""
    pairs = []
    for (i, solid), (j, support) in product(enumerate(SOLIDS), enumerate(SUPPORTS)):
        motion = (Motion.FIXED, Motion.KINEMATIC)[(i + j) % 2]
        motion = {"plane": Motion.FIXED, "block": Motion.DYNAMIC}.get(support, motion)
        pairs.append(_Pair(solid, support, motion))
    return pairs


def _heights(pairs: Sequence[_Pair], has_others: bool = False) -> Scene:
    """Return bodies on supports, each pair in a separate column, with or without bodies without contacts above them."""
    bodies, drivers = [ground()], []
    groups: list[tuple[list[str], list[str]]] = [([], ["ground"]), ([], ["ground"])]
    stay = ramp(0.0, start_s=0.0, duration_s=0.1, ramp_s=0.03)
    for index, pair in enumerate(pairs):
        x, y, z = 0.4 * (index % 8), 0.4 * (index // 8), 0.0
        tops, carriers = groups[index // 2 % 2]
        support = SUPPORTS[pair.support]
        if pair.support != "plane":
            z = 0.0 if pair.motion is Motion.DYNAMIC else 0.5
            carrier = support.on(pair.carrier, (x, y, z), 1.0)
            bodies.append(replace(carrier, motion=pair.motion))
            carriers.append(pair.carrier)
            z += 2.0 * support.half_m
            if pair.motion is Motion.DYNAMIC:
                tops.append(pair.carrier)
            if pair.motion is Motion.KINEMATIC:
                drivers.append(driver(pair.carrier, "translate", (1.0, 0.0, 0.0), stay))
        tops.append(pair.top)
        bodies.append(SOLIDS[pair.solid].on(pair.top, (x, y, z), 0.2))
        if has_others:
            other = SOLIDS[pair.solid].on(pair.other, (x, y, z + 0.1), 0.2)
            bodies.append(other)
    touching = [tuple(map(tuple, group)) for group in groups if group[0]]
    return Scene(
        bodies=tuple(bodies),
        contacts=tuple(
            contact(*names[:: 1 - 2 * index], friction=0.5)
            for index, names in enumerate(touching)
        ),
        drivers=tuple(drivers),
        duration_s=REST_S,
    )


def _rest(lab: Lab) -> list[tuple[Sequence[_Pair], Recording]]:
    """Return recordings of all pairs, which are at rest, and of some pairs below bodies without contacts."""
    pairs = lab.buildable(_pairs(), _heights)
    even, odd, some = pairs[::2], pairs[1::2], pairs[::7]
    return [
        (even, lab.rollout(_heights(even))),
        (odd, lab.rollout(_heights(odd))),
        (some, lab.rollout(_heights(some, has_others=True))),
    ]


@check(
    "contact-listed",
    title="listed pairs collide, others pass",
    law="height = const for a listed pair, height = -g t^2 / 2 for others",
    tolerance=COUNT,
    cause="the collision filter does not follow Scene.contacts: see colliding_pairs",
)
def contact_listed(lab: Lab) -> Measurement:
    """Five shapes on nine supports: fixed ones, driven ones that stand still, and free blocks on a plane.

    Half of the contacts list the supports first. Above some pairs is a body without any contact.

    Number of listed pairs that fall by more than half of a free fall within 0.2 s, and of unlisted bodies that fall by
    less than nine tenths of it.

    Source: contract (scene.Contact).
    """
    missing = set()
    extra = set()
    for pairs, rollout in lab.once(_rest):
        others = {pair.other for pair in pairs}
        for solid in rollout.scene.dynamic_bodies:
            fall = -float(rollout.displacement(solid.name)[-1, 2]) / FALL_M
            if solid.name in others and fall < 0.9:
                extra.add(solid.name)
            if solid.name not in others and fall > 0.5:
                missing.add(solid.name)
    texts = {
        "listed pairs have no contact, the bodies fall through": missing,
        "bodies without a contact are stopped": extra,
    }
    causes = [
        f"{len(names)} {text}: {', '.join(sorted(names)[:4])}"
        for text, names in texts.items()
        if names
    ]
    return Measurement(measured=len(missing) + len(extra), cause="; ".join(causes))


@check(
    "rest-heights",
    title="every shape rests at its height",
    law="height = const",
    unit="mm",
    tolerance=Tolerance(
        "a fifth of the real trials' scatter; margins of collision shapes are 0.5 to 40 mm",
        absolute=SHIFT_MM,
    ),
    cause="a size differs: check half sizes, the cylinder's axis, orientations, collision margins and contact offsets",
)
def rest_heights(lab: Lab) -> Measurement:
    """Five bodies of 0.2 kg, each on nine supports, which are fixed, free, or driven and stand still.

    Bodies: box, sphere, upright and lying cylinder, convex solid. Supports: these, a plane, a free block, a turned box
    and a turned convex solid.

    Mean displacement upward 0.14 to 0.2 s after the start, the worst of all pairs that the engine builds.

    Source: sizes of both shapes (scene.Shape).
    """
    up_mm: dict[str, float] = {}
    for pairs, rollout in lab.once(_rest):
        up_mm |= _up_mm(rollout, [pair.top for pair in pairs])
    return _off_heights(up_mm, SHIFT_MM)


def _up_mm(rollout: Recording, names: Iterable[str]) -> dict[str, float]:
    """Return mean displacements upward 0.14 to 0.2 s after the start [mm]."""
    last = rollout.between(0.14, REST_S)
    return {
        name: 1e3 * float(rollout.displacement(name)[last, 2].mean()) for name in names
    }


def _off_heights(up_mm: Mapping[str, float], within_mm: float) -> Measurement:
    """Measure the largest displacement upward of a body on its support."""
    order = sorted(up_mm, key=lambda name: -abs(up_mm[name]))
    wrong = [name for name in order if not abs(up_mm[name]) < within_mm]
    worst = ", ".join(f"{name} {up_mm[name]:.3g} mm" for name in wrong[:4])
    hint = f"{len(wrong)} of {len(order)} are off their heights, {worst}"
    falls = up_mm[order[0]] < -250.0 * G * REST_S**2
    cause = "the pair has no contact" if falls else ""
    return Measurement(measured=up_mm[order[0]], hint=hint, cause=cause)


FLAT = ("plane", "block", "box", "turned box")


@check(
    "rest-still",
    title="bodies at rest on flat supports report no velocity",
    law="v = 0, omega = 0",
    unit="mm/s",
    tolerance=Tolerance(
        "in a second it is a fifth of the real trials' scatter", absolute=0.2
    ),
    cause="contacts appear and disappear, so that bodies rock or roll, or each step leaves a velocity",
)
def rest_still(lab: Lab) -> Measurement:
    """The bodies of rest-heights on the plane, free blocks, boxes and turned boxes.

    Largest reported speed of a body, or of a point 50 mm from its origin by its spin, 0.14 to 0.2 s after the start.

    Source: statics.
    """
    speeds_mm = {}
    for pairs, rollout in lab.once(_rest):
        late = rollout.cut(0.14, REST_S)
        for pair in pairs:
            rates = late.states[pair.top][:, 7:].reshape(-1, 2, 3)
            if pair.support in FLAT:
                speeds_mm[pair.top] = largest_mm(rates * [[1.0], [0.05]])
    return largest(speeds_mm, "mm/s")


COMPOUND = Compound(
    parts=(
        Part(
            shape=Box(size_m=(0.06, 0.05, 0.02)), pose=Pose(position_m=(0.0, 0.0, 0.02))
        ),
        Part(
            shape=Box(size_m=(0.03, 0.04, 0.03)),
            pose=Pose(position_m=(0.0, 0.0, -0.005)),
        ),
    )
)


def _alone(shape: Capsule | Ellipsoid) -> Compound:
    """Return a solid that scenes have only as a part of a compound."""
    return Compound(parts=(Part(shape=shape, pose=Pose(position_m=(0.0, 0.0, 0.0))),))


FURTHER = SOLIDS | {
    "capsule": _Solid(
        _alone(Capsule(radius_m=0.02, length_m=0.06)), 0.02, (90.0, 0.0, 30.0)
    ),
    "ellipsoid": _Solid(_alone(Ellipsoid(radii_m=(0.03, 0.04, 0.02))), 0.02),
    "compound on its second part": _Solid(COMPOUND, 0.025, centre_m=(0.0, 0.0, 0.005)),
    "box of 2 mm": _Solid(Box(size_m=(0.002, 0.002, 0.002)), 0.001),
    "box of 5 mm": _Solid(Box(size_m=(0.005, 0.005, 0.005)), 0.0025),
    "cylinder of 3 mm": _Solid(Cylinder(radius_m=0.002, length_m=0.003), 0.0015),
    "ball of 4 mm": _Solid(Sphere(radius_m=0.002), 0.002),
}
UNDER = SUPPORTS | {
    "solid on its side": _Solid(
        PRISM, 0.0225, (90.0, 0.0, 0.0), (0.005, -0.0075, -0.0025)
    ),
    "box on its side": _Solid(Box(size_m=(0.06, 0.14, 0.12)), 0.03, (0.0, 90.0, 35.0)),
    "capsule": _Solid(
        _alone(Capsule(radius_m=0.05, length_m=0.1)), 0.05, (90.0, 0.0, 20.0)
    ),
    "ellipsoid": _Solid(_alone(Ellipsoid(radii_m=(0.06, 0.08, 0.05))), 0.05),
    "compound": _Solid(COMPOUND, 0.025, centre_m=(0.0, 0.0, 0.005)),
}
HINGED = ("hinged bar", "shelf")
ODD = [
    ("capsule", "plane"),
    ("capsule", "box on its side"),
    ("ellipsoid", "plane"),
    ("ellipsoid", "solid on its side"),
    ("compound on its second part", "solid on its side"),
    ("compound on its second part", "plane"),
    ("box", "solid on its side"),
    ("box", "capsule"),
    ("sphere", "capsule"),
    ("lying cylinder", "capsule"),
    ("convex solid", "capsule"),
    ("capsule", "solid on its side"),
    ("capsule", "lying cylinder"),
    ("capsule", "sphere"),
    ("ellipsoid", "box on its side"),
    ("box", "ellipsoid"),
    ("sphere", "ellipsoid"),
    ("convex solid", "compound"),
    HINGED,
]
SMALL = [
    ("box of 2 mm", "plane"),
    ("box of 2 mm", "solid on its side"),
    ("box of 5 mm", "box on its side"),
    ("cylinder of 3 mm", "box"),
    ("ball of 4 mm", "turned solid"),
    HINGED,
]


def _on_supports(pairs: Sequence[tuple[str, str]]) -> Scene:
    """Return bodies that rest on fixed supports; one is a bar on a hinge, whose end lies on a shelf."""
    bodies: list[RigidBody] = [ground()]
    groups: dict[str, list[str]] = {"ground": []}
    joints: tuple[Hinge, ...] = ()
    for at, (solid, support) in enumerate(pairs):
        name, x = f"{solid} on {support}", 0.3 * at
        if (solid, support) == HINGED:
            bodies.append(fixed_box(support, (0.15, 1.0, 0.45), (0.05, 0.1, 0.1)))
            bodies.append(box(name, (0.0, 1.0, 0.51), (0.4, 0.03, 0.02)))
            groups[support] = [name]
            anchor_m, axis = (-0.2, 1.0, 0.51), (0.0, 1.0, 0.0)
            joints = (Hinge(body=name, anchor_m=anchor_m, axis=axis),)
            continue
        under = UNDER[support]
        target = "ground"
        if support != "plane":
            target = f"{support} {at}"
            fixed = replace(under.on(target, (x, 0.0, 0.5), 1.0), motion=Motion.FIXED)
            bodies.append(fixed)
        height = 0.0 if support == "plane" else 0.5 + 2.0 * under.half_m
        bodies.append(FURTHER[solid].on(name, (x, 0.0, height), 0.02))
        groups.setdefault(target, []).append(name)
    contacts = (
        contact(tuple(names), target, friction=0.5)
        for target, names in groups.items()
        if names
    )
    return Scene(
        bodies=tuple(bodies),
        joints=joints,
        contacts=tuple(contacts),
        duration_s=REST_S,
    )


def _further_heights(
    lab: Lab, pairs: Sequence[tuple[str, str]], within_mm: float
) -> Measurement:
    """Measure the largest mean displacement upward of a body on its support."""
    rollout = lab.rollout(_on_supports(lab.buildable(pairs, _on_supports)))
    names = [each.name for each in rollout.scene.dynamic_bodies]
    return _off_heights(_up_mm(rollout, names), within_mm)


@check(
    "rest-shapes",
    title="capsules, ellipsoids, compounds, hinged bars and solids on their sides rest",
    law="height = const",
    unit="mm",
    tolerance=Tolerance("as for rest-heights", absolute=SHIFT_MM),
    cause="a size, part or orientation is another: check each part of a compound, and that turned fixed solids are not "
    "turned back",
    revision=2,
)
def rest_shapes(lab: Lab) -> Measurement:
    """Capsules, ellipsoids, compounds and boxes on fixed supports; and a bar on a hinge whose end lies on a shelf.

    Supports: a plane, a capsule, a compound, and a box and a convex solid on their sides.

    Mean displacement upward 0.14 to 0.2 s after the start, the worst of all pairs that the engine builds.

    Source: sizes of both shapes (scene.Shape).
    """
    return _further_heights(lab, ODD, SHIFT_MM)


@check(
    "rest-small",
    title="bodies of 2 to 5 mm rest at their heights",
    law="height = const",
    unit="mm",
    tolerance=Tolerance(
        "ISO 286 makes parts of 3 mm to 0.04 mm (IT 10); an engine must not add to it",
        absolute=0.04,
    ),
    cause="margins, offsets or allowed depths of contacts are lengths for large bodies",
)
def rest_small(lab: Lab) -> Measurement:
    """Boxes of 2 and 5 mm, a cylinder of 3 mm and a ball of 4 mm on fixed supports.

    Mean displacement upward 0.14 to 0.2 s after the start, the worst of all pairs that the engine builds.

    Source: sizes of both shapes (scene.Shape).
    """
    return _further_heights(lab, SMALL, 0.04)


# --- many bodies -----------------------------------------------------------------------------------------------------

BOX_M = (0.1, 0.1, 0.05)


def _boxes_at(
    lab: Lab,
    places_m: Iterable[Vector],
    seconds: float,
    size_m: Vector = BOX_M,
    masses_kg: Iterable[float] = repeat(0.3),
) -> Recording:
    """Return the recording of boxes over a plane, which touch it and each other."""
    boxes = [
        box(f"box {index} of {mass_kg:g} kg", place, size_m, mass_kg=mass_kg)
        for index, (place, mass_kg) in enumerate(zip(places_m, masses_kg, strict=False))
    ]
    names = tuple(body.name for body in boxes)
    contacts = [contact(names, other, friction=0.4) for other in (names, "ground")]
    return lab.run((*boxes, ground()), contacts, seconds)


def _stands(
    rollout: Recording, after_s: float = 0.0, axes: slice = slice(3)
) -> Measurement:
    """Measure the largest displacement of a box along some axes after a time, and of a point 50 mm off its middle."""
    moved_mm = {}
    late = rollout.between(after_s, rollout.times_s[-1])
    for solid in rollout.scene.dynamic_bodies:
        turns = rollout.rotation(solid.name)
        turned_mm = 50.0 * float((turns[late] * turns[0].inv()).magnitude().max())
        shifted_mm = largest_mm(rollout.displacement(solid.name)[late, axes])
        moved_mm[solid.name] = max(shifted_mm, turned_mm)
    worst = max(moved_mm, key=moved_mm.__getitem__)
    moving = [name for name, mm in moved_mm.items() if not mm < SCATTER_MM]
    down_mm = -1e3 * rollout.displacement(worst)[-1, 2]
    hint = f"{len(moving)} of {len(moved_mm)} boxes move, {worst} moves by {moved_mm[worst]:.3g} mm"
    hint += f", {down_mm:.3g} mm of it downward"
    return Measurement(measured=moved_mm[worst], hint=hint)


@check(
    "tower-stands",
    title="tower stands",
    law="r = const",
    unit="mm",
    tolerance=SCATTER,
    cause="contacts yield under the weight of many bodies, or a solver ends before the forces of all layers balance",
)
def tower_stands(lab: Lab) -> Measurement:
    """A tower of twenty boxes on a plane, as wide as two of them are high.

    Largest displacement of a box, or of a point 50 mm from its middle by rotation, 0.8 to 1 s after the start.

    Source: statics.
    """
    places = [(0.0, 0.0, BOX_M[2] * (i + 0.5)) for i in range(20)]
    return _stands(_boxes_at(lab, places, 1.0), 0.8)


@check(
    "mass-ratio",
    title="heavy body on a light body",
    law="height = const",
    unit="mm",
    tolerance=SCATTER,
    cause="heavy bodies sink into light ones: contacts are too soft for the weight, or the solver ends too early",
)
def mass_ratio(lab: Lab) -> Measurement:
    """Boxes of 20 kg on boxes of 0.1 kg and of 1 kg, on a plane; the heavy box listed first or last.

    Largest displacement up or down of a box, or of a point 50 mm from its middle by rotation, 0.2 to 0.3 s after the
    start.

    Source: statics: rigid bodies carry any weight.
    """
    boxes: list[tuple[Vector, float]] = []
    for index, light_kg in enumerate((0.1, 0.1, 1.0)):
        x = 0.3 * index
        pair = ((x, 0.0, 0.025), light_kg), ((x, 0.0, 0.075), 20.0)
        boxes += pair[:: -1 if index == 1 else 1]
    places, masses_kg = zip(*boxes, strict=True)
    rollout = _boxes_at(lab, places, 0.3, masses_kg=masses_kg)
    return _stands(rollout, 0.2, axes=slice(2, 3))


BRICK_M = (0.04, 0.02, 0.015)


@check(
    "wall",
    title="wall of many bricks stands",
    law="r = const",
    unit="mm",
    tolerance=SCATTER,
    cause="contacts of many bodies are too soft, or exceed a limit of the engine, which drops the rest",
)
def wall(lab: Lab) -> Measurement:
    """A wall of 45 loose bricks in running bond on a plane, with some 400 points of contact.

    Largest displacement of a brick, or of a point 50 mm from its middle by rotation, within 0.1 s.

    Source: statics.
    """
    length, _, height = BRICK_M
    places = [
        (length * (column + 0.5 * (row % 2)), 0.0, height * (row + 0.5))
        for row in range(6)
        for column in range(8 - row % 2)
    ]
    return _stands(_boxes_at(lab, places, 0.1, BRICK_M))
