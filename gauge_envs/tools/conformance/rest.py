"""Bodies at rest: pairs that collide, heights, towers, piles, walls, and long rest."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product, repeat

import numpy as np

from gauge_envs.scene import (
    GRAVITY_M_PER_S2 as G,
    Box,
    ConvexUnion,
    Cylinder,
    Motion,
    Plane,
    Pose,
    RigidBody,
    Scene,
    Shape,
    Sphere,
    Vector,
)
from gauge_envs.tools.bench.parts import (
    body,
    box,
    contact,
    corners,
    driven_box,
    driver,
    fixed_box,
    ground,
    ramp,
)
from gauge_envs.tools.conformance.lab import Lab, largest_mm
from gauge_envs.tools.conformance.model import COUNT, Measurement, Tolerance, check

SCATTER_MM = 0.5
SCATTER = Tolerance("half the scatter of the real trials", absolute=SCATTER_MM)
STAY = ramp(0.0, start_s=0.0, duration_s=0.1, ramp_s=0.03)
"""Motion of a driven body that stands still."""


@dataclass(frozen=True)
class _Solid:
    """A shape in an orientation in which it stands.

    Attributes:
        shape: The shape.
        low_m: Distance from its origin down to its lowest point.
        high_m: Distance from its origin up to its highest point.
        euler_deg: Its Euler angles.
        centre_m: Horizontal place of its centre of mass from its origin.
    """

    shape: Shape
    low_m: float
    high_m: float
    euler_deg: Vector = (0.0, 0.0, 0.0)
    centre_m: tuple[float, float] = (0.0, 0.0)

    def at(self, name: str, x: float, y: float, z: float, mass_kg: float) -> RigidBody:
        """Return a dynamic body with its centre of mass above a place."""
        place = (x - self.centre_m[0], y - self.centre_m[1], z)
        pose = Pose.from_euler_deg(place, self.euler_deg)
        # Bodies share no shape object, as in a scene that is read from a file.
        return body(name, replace(self.shape), pose, mass_kg=mass_kg)


PRISM = ConvexUnion(
    pieces_m=(
        corners((-0.02, -0.025, -0.01), (0.03, 0.02, 0.02)),
        corners((-0.02, -0.025, 0.02), (0.03, 0.02, 0.025)),
    )
)
SOLIDS = {
    "box": _Solid(Box(size_m=(0.06, 0.05, 0.04)), 0.02, 0.02),
    "sphere": _Solid(Sphere(radius_m=0.02), 0.02, 0.02),
    "cylinder": _Solid(Cylinder(radius_m=0.025, length_m=0.05), 0.025, 0.025),
    "lying cylinder": _Solid(
        Cylinder(radius_m=0.025, length_m=0.08), 0.025, 0.025, (90.0, 0.0, 0.0)
    ),
    "convex solid": _Solid(PRISM, 0.01, 0.025, centre_m=(0.005, -0.0025)),
}
SUPPORTS = {
    "plane": _Solid(Plane(), 0.0, 0.0),
    "box": _Solid(Box(size_m=(0.12, 0.12, 0.06)), 0.03, 0.03),
    "turned box": _Solid(
        Box(size_m=(0.14, 0.07, 0.12)), 0.035, 0.035, (90.0, 0.0, 35.0)
    ),
    "sphere": _Solid(Sphere(radius_m=0.06), 0.06, 0.06),
    "cylinder": _Solid(Cylinder(radius_m=0.06, length_m=0.08), 0.04, 0.04),
    "lying cylinder": _Solid(
        Cylinder(radius_m=0.05, length_m=0.12), 0.05, 0.05, (0.0, 90.0, 0.0)
    ),
    "convex solid": SOLIDS["convex solid"],
    "turned solid": _Solid(PRISM, 0.025, 0.01, (180.0, 0.0, 0.0), (0.005, 0.0025)),
}

# --- pairs that collide ----------------------------------------------------------------------------------------------

PAIRS_S = 0.2
FALL_M = 0.5 * G * PAIRS_S**2


def _pairs(kinds: Sequence[str]) -> Scene:
    """Return bodies that rest on carriers, each kind on each, and above them bodies without any contact."""
    size_m, top_m = (1.4, 0.3, 0.1), 0.5
    carriers = (
        ground(),
        fixed_box("fixed box", (0.0, 1.0, top_m - 0.05), size_m),
        driven_box("driven box", (0.0, 2.0, top_m - 0.05), size_m),
        box("free box", (0.0, 3.0, 0.05), size_m, mass_kg=5.0),
    )
    names = tuple(one.name for one in carriers)
    bodies, contacts = [], [contact("free box", "ground", friction=0.5)]
    for k, kind in enumerate(kinds):
        solid, on = SOLIDS[kind], []
        for c, carrier in enumerate(names):
            x, z = 0.2 * k - 0.3, (0.0, top_m, top_m, 0.1)[c] + solid.low_m
            on.append(f"{kind} on {carrier}")
            bodies.append(solid.at(on[-1], x, c, z, 0.2))
            if c == k:
                name = f"{kind} over {carrier}"
                bodies.append(solid.at(name, 0.3 - 0.2 * k, c, z + 0.1, 0.2))
        pair = (tuple(on), names)[:: 1 if k % 2 else -1]
        contacts.append(contact(*pair, friction=0.5))
    return Scene(
        bodies=(*bodies, *carriers),
        contacts=tuple(contacts),
        drivers=(driver("driven box", "translate", (1.0, 0.0, 0.0), STAY),),
        duration_s=PAIRS_S,
    )


@check(
    "contact-listed",
    title="listed pairs collide, others pass",
    law="height = const for a listed pair, height = -g t^2 / 2 for others",
    source="contract (scene.Contact)",
    tolerance=COUNT,
    cause="the collision filter does not follow Scene.contacts: see colliding_pairs",
)
def contact_listed(lab: Lab) -> Measurement:
    """Four shapes on four carriers: a plane, and a fixed, a driven and a free box.

    A box, a sphere, a cylinder and a convex solid rest on each carrier. Half of their contacts list the carriers first.
    Above one of them on each carrier is a body without any contact.

    Number of listed pairs that fall by more than half of a free fall within 0.2 s, and of unlisted bodies that fall by
    less than nine tenths of it.
    """
    kinds = lab.buildable(["box", "sphere", "cylinder", "convex solid"], _pairs)
    rollout = lab.rollout(_pairs(kinds))
    missing, extra = [], []
    for one in rollout.scene.dynamic_bodies:
        fall = -float(rollout.displacement(one.name)[-1, 2]) / FALL_M
        if " over " in one.name and fall < 0.9:
            extra.append(f"{one.name}, after {1e3 * fall * FALL_M:.0f} mm")
        elif " over " not in one.name and fall > 0.5:
            missing.append(one.name)
    texts = []
    if missing:
        texts.append(
            f"{len(missing)} listed pairs have no contact, the bodies fall through: {', '.join(missing[:4])}"
        )
    if extra:
        texts.append(
            f"{len(extra)} bodies without a contact are stopped: {', '.join(extra[:4])}"
        )
    return Measurement(measured=len(missing) + len(extra), hint="; ".join(texts))


# --- heights at rest -------------------------------------------------------------------------------------------------

REST_S, SHIFT_MM = 0.2, 0.2
Case = tuple[str, str]
"""A body, and what it rests on."""


def _cases() -> list[Case]:
    """Return all pairs; the supports are fixed and driven in turn."""
    cases = []
    for (i, kind), (j, support) in product(enumerate(SOLIDS), enumerate(SUPPORTS)):
        is_driven = support != "plane" and (i + j) % 2
        motion = Motion.KINEMATIC if is_driven else Motion.FIXED
        cases.append((kind, f"{motion.value} {support}"))
    return cases


def _heights(cases: Sequence[Case]) -> Scene:
    """Return bodies on supports, each pair in a separate column; all that stand on the plane share it."""
    bodies, drivers = [ground()], []
    groups: list[tuple[list[str], list[str]]] = [([], ["ground"]), ([], ["ground"])]
    for index, (kind, support) in enumerate(cases):
        motion, what = support.split(" ", 1)
        solid, under = SOLIDS[kind], SUPPORTS[what]
        x, y, z = 0.4 * (index % 8), 0.4 * (index // 8), 0.0
        tops, carriers = groups[index // 2 % 2]
        if what != "plane":
            z, carrier = 0.5, f"{support} under {kind}"
            one = replace(under.at(carrier, x, y, z, 1.0), motion=Motion(motion))
            bodies.append(one)
            carriers.append(carrier)
            if one.motion is Motion.KINEMATIC:
                drivers.append(driver(carrier, "translate", (1.0, 0.0, 0.0), STAY))
        name = f"{kind} on {support}"
        bodies.append(solid.at(name, x, y, z + under.high_m + solid.low_m, 0.2))
        tops.append(name)
    pairs = [tuple(map(tuple, group)) for group in groups if group[0]]
    return Scene(
        bodies=tuple(bodies),
        contacts=tuple(
            contact(*pair[:: 1 - 2 * index], friction=0.5)
            for index, pair in enumerate(pairs)
        ),
        drivers=tuple(drivers),
        duration_s=REST_S,
    )


def _height_hint(errors_mm: Mapping[Case, float]) -> str:
    """Return what heights are wrong: all, those of a body or of a support, or of single pairs."""
    wrong = [case for case, mm in errors_mm.items() if not abs(mm) < SHIFT_MM]
    through = [case for case in wrong if errors_mm[case] < -1e3 * 0.3 * FALL_M]
    if through:
        names = ", ".join(f"{kind} on {support}" for kind, support in through[:4])
        return f"{len(through)} bodies fall through: the pairs have no contact: {names}"
    groups = {"every body is off its height": [*errors_mm]}
    for side, verb in enumerate(("on every support", "under every body")):
        for kind in dict.fromkeys(case[side] for case in errors_mm):
            of_kind = [case for case in errors_mm if case[side] == kind]
            groups[f"the {kind} is off its height {verb}"] = of_kind
    for text, cases in groups.items():
        if set(cases) <= set(wrong):
            off = [errors_mm[case] for case in cases]
            return f"{text}, by {min(off):.3g} to {max(off):.3g} mm"
    worst = sorted(wrong, key=lambda case: -abs(errors_mm[case]))[:4]
    return "off their heights: " + ", ".join(
        f"{kind} on {support} {errors_mm[kind, support]:.3g} mm"
        for kind, support in worst
    )


@check(
    "rest-heights",
    title="every shape rests at its height",
    law="height = const",
    source="sizes of both shapes (scene.Shape)",
    unit="mm",
    tolerance=Tolerance(
        "a fifth of the real trials' scatter; margins of collision shapes are 0.5 to 40 mm",
        absolute=SHIFT_MM,
    ),
    cause="a size differs: check half sizes, the cylinder's axis, orientations, collision margins and contact offsets",
)
def rest_heights(lab: Lab) -> Measurement:
    """Five bodies of 0.2 kg, each on eight supports, half of which are driven and stand still.

    Bodies: box, sphere, upright and lying cylinder, convex solid. Supports: these, a plane, a turned box and a turned
    convex solid.

    Mean displacement upward 0.14 to 0.2 s after the start, the worst of all pairs that the engine builds.
    """
    cases = lab.buildable(_cases(), _heights)
    errors_mm = {}
    for some in (cases[::2], cases[1::2]):
        rollout = lab.rollout(_heights(some))
        last = rollout.between(0.14, REST_S)
        for one in rollout.scene.dynamic_bodies:
            kind, _, support = one.name.partition(" on ")
            up_m = rollout.displacement(one.name)[last, 2]
            errors_mm[kind, support] = 1e3 * float(up_m.mean())
    worst = max(errors_mm, key=lambda case: abs(errors_mm[case]))
    return Measurement(measured=errors_mm[worst], hint=_height_hint(errors_mm))


# --- many bodies -----------------------------------------------------------------------------------------------------

BOX_M = (0.1, 0.1, 0.05)


def _boxes_at(
    places_m: Iterable[Vector],
    size_m: Vector = BOX_M,
    seconds: float = 1.0,
    masses_kg: Iterable[float] = repeat(0.3),
) -> Scene:
    """Return boxes over a plane, which touch it and each other."""
    boxes = tuple(
        box(f"box {index}", place, size_m, mass_kg=mass_kg)
        for index, (place, mass_kg) in enumerate(zip(places_m, masses_kg, strict=False))
    )
    names = tuple(one.name for one in boxes)
    contacts = tuple(contact(names, other, friction=0.4) for other in (names, "ground"))
    return Scene(bodies=(*boxes, ground()), contacts=contacts, duration_s=seconds)


@check(
    "tower-stands",
    title="tower stands",
    law="r = const",
    source="statics",
    unit="mm",
    tolerance=SCATTER,
    cause="contacts yield under the weight of many bodies, or a solver ends before the forces of all layers balance",
)
def tower_stands(lab: Lab) -> Measurement:
    """A tower of twenty boxes on a plane, as wide as two of them are high.

    Largest displacement of the highest box, 0.8 to 1 s after the start.
    """
    rollout = lab.rollout(
        _boxes_at((0.0, 0.0, BOX_M[2] * (i + 0.5)) for i in range(20))
    )
    moved_mm = 1e3 * rollout.displacement("box 19")[rollout.between(0.8, 1.0)]
    aside_mm = np.linalg.norm(moved_mm[:, :2], axis=1).max()
    return Measurement(
        measured=float(np.linalg.norm(moved_mm, axis=1).max()),
        hint=f"its top is {-moved_mm[-1, 2]:.3g} mm lower and up to {aside_mm:.3g} mm aside",
    )


@check(
    "pile-sinks",
    title="pile does not sink in",
    law="height >= 0",
    source="bodies are rigid",
    unit="mm",
    tolerance=SCATTER,
    cause="contacts are too soft, or boxes tunnel through the plane",
)
def pile_sinks(lab: Lab) -> Measurement:
    """A slanting stack of six boxes on a plane, which falls over.

    Depth of the deepest corner of a box below the plane, 0.8 to 1 s after the start.
    """
    rollout = lab.rollout(
        _boxes_at((0.025 * i, 0.01 * (i % 2), 0.03 + 0.055 * i) for i in range(6))
    )
    landed = rollout.between(0.8, 1.0)
    lows_m = []
    for one in rollout.scene.dynamic_bodies:
        ups = rollout.rotation(one.name)[landed].as_matrix()[:, 2]
        corners_m = ups @ Box(size_m=BOX_M).corners_m.T
        lows_m.append((rollout.position(one.name)[landed, 2, None] + corners_m).min())
    return Measurement(measured=max(0.0, -1e3 * float(min(lows_m))))


STACKS = {
    "0.1 kg": ((0.0, 0.025, 0.1), (0.0, 0.075, 20.0)),
    "0.1 kg, listed last": ((0.3, 0.075, 20.0), (0.3, 0.025, 0.1)),
    "1 kg": ((0.6, 0.025, 1.0), (0.6, 0.075, 20.0)),
}
"""Places x and z [m] and masses [kg] of two boxes each, by the lower box."""


@check(
    "mass-ratio",
    title="heavy body on a light body",
    law="height = const",
    source="statics: rigid bodies carry any weight",
    unit="mm",
    tolerance=SCATTER,
    cause="contacts of a light body are too soft for the weight on it, or the solver ends before its forces balance",
)
def mass_ratio(lab: Lab) -> Measurement:
    """Boxes of 20 kg on boxes of 0.1 kg and of 1 kg, on a plane; the heavy box listed first or last.

    Lesser displacement upward of two boxes, mean over 0.2 to 0.3 s, the worst of three stacks.
    """
    boxes = [one for stack in STACKS.values() for one in stack]
    places = [(x, 0.0, z) for x, z, _ in boxes]
    scene = _boxes_at(places, seconds=0.3, masses_kg=[kg for *_, kg in boxes])
    rollout = lab.rollout(scene)
    late = rollout.between(0.2, 0.3)
    errors_mm = {}
    for index, name in enumerate(STACKS):
        pair = [rollout.displacement(f"box {2 * index + one}") for one in (0, 1)]
        errors_mm[name] = 1e3 * min(float(one[late, 2].mean()) for one in pair)
    worst = max(errors_mm, key=lambda name: abs(errors_mm[name]))
    text = ", ".join(f"{name} {mm:.3g} mm" for name, mm in errors_mm.items())
    return Measurement(
        measured=errors_mm[worst], hint=f"heavy boxes move on boxes of {text}"
    )


BRICK_M, ROWS, COLUMNS = (0.04, 0.02, 0.015), 6, 8
WALL_S = 0.1


@check(
    "wall",
    title="wall of many bricks stands",
    law="r = const",
    source="statics",
    unit="mm",
    tolerance=SCATTER,
    cause="the contacts exceed a limit of the engine, which drops the rest",
)
def wall(lab: Lab) -> Measurement:
    """A wall of 45 loose bricks in running bond on a plane, with some 400 points of contact.

    Largest displacement of a brick within 0.1 s.
    """
    length, _, height = BRICK_M
    places = [
        (length * (column + 0.5 * (row % 2)), 0.0, height * (row + 0.5))
        for row in range(ROWS)
        for column in range(COLUMNS - row % 2)
    ]
    scene = _boxes_at(places, BRICK_M, WALL_S)
    rollout = lab.rollout(scene)
    moved_mm = {
        one.name: largest_mm(rollout.displacement(one.name))
        for one in scene.dynamic_bodies
    }
    worst = max(moved_mm, key=lambda name: moved_mm[name])
    wrong = [name for name, mm in moved_mm.items() if not mm < SCATTER_MM]
    hint = f"{len(wrong)} of {len(moved_mm)} bricks move, {worst} by {moved_mm[worst]:.3g} mm"
    if moved_mm[worst] > 0.8 * 500.0 * G * WALL_S**2:
        hint += (
            ": they fall, so contacts are missing; an engine drops those beyond a limit"
        )
    return Measurement(measured=moved_mm[worst], hint=hint)


@check(
    "rest-long",
    title="bodies at rest do not creep",
    law="r = const, R = const",
    source="statics",
    unit="mm",
    tolerance=Tolerance("a fifth of the real trials' scatter", absolute=0.2),
    cause="contacts leave a velocity in each step, as a correction of penetration does",
)
def rest_long(lab: Lab) -> Measurement:
    """A box that stands on another box on a plane, 20 mm off its middle.

    Largest displacement within 2.3 s of a point 50 mm from the middle of a box.
    """
    places = ((0.0, 0.0, 0.025), (0.02, 0.0, 0.075))
    rollout = lab.rollout(_boxes_at(places, seconds=2.3))
    moved_mm = {}
    for one in rollout.scene.dynamic_bodies:
        turns = rollout.rotation(one.name)
        turned_mm = 50.0 * float((turns * turns[0].inv()).magnitude().max())
        moved_mm[one.name] = max(turned_mm, largest_mm(rollout.displacement(one.name)))
    return Measurement(measured=max(moved_mm.values()))
