"""Applied wrenches, contact forces, absolute inertia, and the centre and inertia of a solid of several pieces."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs.scene import (
    GRAVITY_M_PER_S2 as G,
    Box,
    Compound,
    ConvexUnion,
    Cylinder,
    Hinge,
    Part,
    Pose,
    RigidBody,
    Scene,
    Shape,
    Sphere,
)
from gauge_envs.scene.geometry import FloatArray, length_of, vector
from gauge_envs.scene.meshes import mass_properties
from gauge_envs.scene.timing import DRIVE_INTERVAL_S, SAMPLE_INTERVAL_S
from gauge_envs.scoring.estimators import mean_period_s, pendulum_period_s
from gauge_envs.tools.bench.parts import (
    body,
    box,
    box_inertia_kg_m2,
    contact,
    corners,
    fixed_box,
)
from gauge_envs.tools.bench.recording import DeclinedError
from gauge_envs.tools.conformance.lab import Lab, push
from gauge_envs.tools.conformance.laws import worst_ratio
from gauge_envs.tools.conformance.model import (
    Check,
    Measurement,
    Recorded,
    Tolerance,
    recorded,
)
from gauge_envs.tools.conformance.rich import thrown

LOPSIDED = ConvexUnion(
    pieces_m=(
        corners((0.0, 0.0, 0.0), (0.09, 0.03, 0.02)),
        corners((0.0, 0.03, 0.0), (0.02, 0.08, 0.02)),
        corners((0.0, 0.0, 0.02), (0.03, 0.03, 0.04)),
        ((0.09, 0.0, 0.0), (0.09, 0.03, 0.0), (0.09, 0.0, 0.02), (0.12, 0.0, 0.0)),
    )
)
"""Four pieces of different volume about a corner, with the body origin at that corner."""

COMPOUND = Compound(
    parts=(
        Part(
            shape=Box(size_m=(0.09, 0.03, 0.02)),
            pose=Pose.from_euler_deg((0.05, 0.0, 0.0), (0.0, 20.0, 30.0)),
        ),
        Part(
            shape=Cylinder(radius_m=0.015, length_m=0.05),
            pose=Pose.from_euler_deg((0.0, 0.04, 0.0), (70.0, 0.0, 0.0)),
        ),
        Part(shape=Sphere(radius_m=0.02), pose=Pose(position_m=(0.0, 0.0, 0.05))),
    )
)
"""Three solids apart from each other, with the body origin outside of their centre of mass."""

WRONG_UNIONS = {
    "the convex hull of all pieces": ConvexUnion(
        pieces_m=(tuple(vector(corner) for corner in LOPSIDED.corners_m),)
    ),
    "the first of its pieces": ConvexUnion(pieces_m=LOPSIDED.pieces_m[:1]),
}
WRONG_CENTRES_M = {
    "at the body origin": np.zeros(3),
    "at the mean of the vertices": LOPSIDED.corners_m.mean(axis=0),
    "at the mean of the pieces' centres": np.mean(
        [
            mass_properties(ConvexUnion(pieces_m=(piece,)), 1.0)[0]
            for piece in LOPSIDED.pieces_m
        ],
        axis=0,
    ),
}
"""Solids and places of the centre of mass that engines take instead of the union's."""

SHAPES: dict[str, Shape] = {
    "box": Box(size_m=(0.1, 0.06, 0.03)),
    "sphere": Sphere(radius_m=0.03),
    "cylinder": Cylinder(radius_m=0.02, length_m=0.09),
    "union": LOPSIDED,
    "compound": COMPOUND,
}
MASS_KG = 0.4
EULER_DEG = (50.0, -20.0, 70.0)
TURNED = Rotation.from_euler("xyz", EULER_DEG, degrees=True)
PUSH_S = 0.1
SECONDS = round(PUSH_S / SAMPLE_INTERVAL_S) * SAMPLE_INTERVAL_S
LEAST_GAIN = 0.01
"""Share of an acceleration that counts."""
TURN_RAD = 0.01
"""Rotation about the axis of a torque within `PUSH_S`; the inertia in the world changes by about as much."""


class _Push(NamedTuple):
    """Floating bodies of one shape, each under one wrench.

    Attributes:
        inertia: Inertia about the centre of mass in the world [kg m^2], shape [3, 3].
        centre_m: Centre of mass in the body frame [m], shape [3].
        wrenches: Wrench of each body, shape [6, 6]: forces along x, y, z, then torques about them.
        twists: Velocities of the centre of mass and angular velocities after `PUSH_S`, shape [6, 6].
        gains: What the forces add in each interval to the velocity along them, over the law, shape [T, 3].
    """

    inertia: FloatArray
    centre_m: FloatArray
    wrenches: FloatArray
    twists: FloatArray
    gains: FloatArray


def _pushed_scene(shape: Shape) -> Scene:
    bodies = tuple(
        body(
            f"body-{index}",
            shape,
            Pose.from_euler_deg((0.5 * index, 0.1, 1.0), EULER_DEG),
            mass_kg=MASS_KG,
        )
        for index in range(6)
    )
    return Scene(bodies=bodies, duration_s=1.0, gravity_m_per_s2=0.0)


def _push(lab: Lab, shape: Shape) -> _Push:
    """Push floating bodies by three forces and three torques, and read their velocities."""
    scene = _pushed_scene(shape)
    names = [one.name for one in scene.bodies]
    centre_m, inertia = mass_properties(shape, MASS_KG)
    turned = scene.bodies[0].pose.matrix
    inertia = turned @ inertia @ turned.T
    torque = 2.0 * TURN_RAD / PUSH_S**2 * float(np.linalg.eigvalsh(inertia)[0])
    wrenches = np.diag([MASS_KG] * 3 + [torque] * 3)
    pushed = dict(zip(names, wrenches, strict=True))
    rollout = lab.rollout(scene, 2.0 * PUSH_S, wrenches=pushed)
    last = rollout.sample_at(PUSH_S)
    states = np.array([rollout.states[name][last] for name in names])
    speeds = [rollout.velocity(names[axis])[:, axis] for axis in range(3)]
    twists = states[:, 7:].copy()
    # The reported velocity is that of the body origin.
    arm = Rotation.from_quat(states[:, 3:7], scalar_first=True).apply(centre_m)
    twists[:, :3] += np.cross(twists[:, 3:], arm)
    gains = np.diff(speeds).T / SAMPLE_INTERVAL_S
    return _Push(inertia, centre_m, wrenches, twists, gains)


def _pushes(shapes: str, shape: Shape) -> Recorded[_Push]:
    scene = f"six floating turned {shapes} of 0.4 kg, each under a constant force or torque along one world axis"
    return Recorded(scene, lambda lab: _push(lab, shape))


PUSHES = {
    kind: _pushes(
        {"box": "boxes", "union": "lopsided unions"}.get(kind, f"{kind}s"), shape
    )
    for kind, shape in SHAPES.items()
}


@PUSHES["box"].check("wrench-frame")
def _wrench_frame(found: _Push) -> Measurement:
    along = np.diag(found.twists[:3, :3])
    across = found.twists[:3, :3] - np.diag(along)
    forces, torques = found.twists[:3], found.twists[3:]
    swapped = np.abs(forces[:, :3]).max() < np.abs(torques[:, :3]).max()
    hint = "force and torque are swapped" if swapped else ""
    scale = max(float(np.abs(along).mean()), 1e-12)
    return Measurement(measured=100.0 * float(np.abs(across).max()) / scale, hint=hint)


@PUSHES["box"].check("wrench-force")
def _wrench_force(found: _Push) -> Measurement:
    measured = float(np.diag(found.twists[:3, :3]).mean() / SECONDS)
    return Measurement(measured=measured, expected=1.0, hint=_force_hint(found))


def _force_hint(found: _Push) -> str:
    acts = np.abs(found.gains).max(axis=1) > LEAST_GAIN
    if not acts.any():
        return (
            "the wrench is ignored: raise BackendError when the engine cannot apply it"
        )
    if not acts[1:].any():
        return "the wrench acts during the first interval only: it acts until another one replaces it"
    if not acts.all():
        first = SAMPLE_INTERVAL_S * int(acts.argmax())
        return f"the force acts from {first:.3g} s on, in {acts.sum()} of {len(acts)} intervals"
    shares = np.median(found.gains, axis=0)
    x, y, z = shares
    text = f"along x, y, z it accelerates {x:.3g}, {y:.3g} and {z:.3g} times as much as it should"
    if np.ptp(shares) < LEAST_GAIN:
        text = (
            f"it accelerates as if its mass were {1.0 / x:.3g} times that of the scene, or the force {x:.3g} times "
            "what is applied"
        )
    return text


@PUSHES["union"].check("wrench-centre")
def _wrench_centre(found: _Push) -> Measurement:
    angle = (
        0.5 * SECONDS * np.degrees(np.linalg.norm(found.twists[:3, 3:], axis=1).max())
    )
    return Measurement(measured=float(angle), hint=_centre_hint(found))


def _centre_hint(found: _Push) -> str:
    """Return the place at which forces would have to act to give these spins, if it is a known wrong one."""
    for text, place_m in WRONG_CENTRES_M.items():
        lever = TURNED.apply(place_m - found.centre_m)
        torque = np.cross(lever, found.wrenches[:3, :3])
        expected = SECONDS * torque @ np.linalg.inv(found.inertia)
        error = np.abs(found.twists[:3, 3:] - expected).max()
        if error < 0.1 * np.abs(expected).max():
            return f"the force acts {text}"
    return ""


def _inertia_check(kind: str) -> None:
    title = {
        "union": "solid of four pieces",
        "compound": "compound of a box, a cylinder and a sphere",
    }.get(kind, kind)

    @PUSHES[kind].check(
        f"inertia-{kind}",
        title=f"inertia of a {title}",
        measures=f"inertia tensor of a {title} from the angular velocities after 0.1 s under three torques, the entry "
        "furthest from that of a uniform solid, as a ratio to its largest moment",
        law="I = integral of density (r^2 1 - r r')",
        source="Euler; uniform density (scene.py)",
        tolerance=Tolerance(
            "1 % is the tolerance of a slide; the bodies rotate by 0.01 rad meanwhile",
            absolute=0.02,
        ),
        diagnosis="the inertia does not follow from shape and mass: check half and full sizes, the centre of mass to "
        "which it refers, rotated principal axes, and armature",
    )
    def measure(found: _Push) -> Measurement:
        rates = found.twists[3:, 3:] / SECONDS
        largest = float(np.linalg.eigvalsh(found.inertia)[-1])
        if not np.abs(rates).max() > 0.0:
            return Measurement(
                measured=float("nan"), hint="the torque is ignored: nothing rotates"
            )
        if np.linalg.matrix_rank(rates) < 3:
            return Measurement(
                measured=float("nan"), hint="a torque does not rotate its body"
            )
        inertia = np.linalg.inv(rates / found.wrenches[3, 3])
        error = inertia - found.inertia
        turned = TURNED.as_matrix()
        in_body = turned.T @ inertia @ turned
        expected = turned.T @ found.inertia @ turned
        x, y, z = np.diag(in_body) / np.diag(expected)
        hint = f"its inertia about body x, y, z is {x:.3g}, {y:.3g} and {z:.3g} times what it should be"
        hint = _frame_hint(inertia, expected) or hint + _size_hint(
            SHAPES[kind], in_body
        )
        worst = float(error.flat[int(np.abs(error).argmax())])
        return Measurement(measured=worst / largest, hint=hint)


def _frame_hint(inertia: FloatArray, expected: FloatArray) -> str:
    """Return the wrong frame in which an engine takes an inertia; empty if it is none of the known ones.

    Args:
        inertia: Inertia in the world, as measured [kg m^2], shape [3, 3].
        expected: Inertia in the body frame, as it should be [kg m^2], shape [3, 3].
    """
    x, y, z, w = TURNED.as_quat()
    frames = {
        "its inertia is taken along the axes of the world instead of the body's": Rotation.identity(),
        "its inertia is rotated from the world to the body instead of back": TURNED.inv(),
        "its inertia is that of a body whose w, x, y, z was read as x, y, z, w": Rotation.from_quat(
            [w, x, y, z]
        ),
        "its inertia is that of a body whose x, y, z, w was read as w, x, y, z": Rotation.from_quat(
            [y, z, w, x]
        ),
    }
    for text, frame in frames.items():
        other = frame.as_matrix() @ expected @ frame.as_matrix().T
        if np.abs(inertia - other).max() < 0.02 * np.abs(other).max():
            return text
    return ""


def _size_hint(shape: Shape, inertia: FloatArray) -> str:
    """Return the solid that has an inertia [kg m^2] in its axes, shape [3, 3]."""
    if isinstance(shape, ConvexUnion):
        for text, wrong in WRONG_UNIONS.items():
            other = mass_properties(wrong, MASS_KG)[1]
            if np.abs(inertia - other).max() < 0.02 * np.abs(other).max():
                return f", as if it were {text}"
        return ""
    shares = np.diag(inertia) / MASS_KG
    sizes: Sequence[float]
    if isinstance(shape, Box):
        what, sizes, squares = (
            "edges",
            shape.size_m,
            6.0 * (shares.sum() - 2.0 * shares),
        )
    elif isinstance(shape, Cylinder):
        what, sizes = "radius and length", (shape.radius_m, shape.length_m)
        squares = np.array([2.0 * shares[2], 12.0 * shares[0] - 6.0 * shares[2]])
    elif isinstance(shape, Sphere):
        what, sizes, squares = "radius", (shape.radius_m,), 2.5 * shares[:1]
    else:
        return ""
    found, expected = (
        ", ".join(f"{1e3 * size:.3g}" for size in values)
        for values in (np.sqrt(np.clip(squares, 0.0, None)), sizes)
    )
    return f", as if its {what} were {found} mm instead of {expected} mm"


def _centre_check(kind: str) -> None:
    @PUSHES[kind].check(f"centre-{kind}")
    def measure(found: _Push) -> Measurement:
        speeds, spins = found.twists[3:, :3], found.twists[3:, 3:]
        # A body turns about its centre of mass, so the expected place of it moves by the error across the axis.
        off_m = np.linalg.norm(speeds, axis=1) / np.linalg.norm(spins, axis=1)
        worst_mm = 1e3 * float(off_m.max())
        hint = f"under a torque it turns about a point {worst_mm:.3g} mm from where its centre of mass should be"
        if kind == "union":
            hint += _pivot_hint(found)
        return Measurement(measured=worst_mm, hint=hint)


def _pivot_hint(found: _Push) -> str:
    """Return the point about which torques turn the union, if it is a known wrong one."""
    crossed = np.vstack([np.cross(spin, np.eye(3)).T for spin in found.twists[3:, 3:]])
    lever = np.linalg.lstsq(crossed, found.twists[3:, :3].ravel(), rcond=None)[0]
    pivot_m = found.centre_m - TURNED.inv().apply(lever)
    for text, place_m in WRONG_CENTRES_M.items():
        if np.linalg.norm(pivot_m - place_m) < 1e-3:
            return f"; the engine's centre of mass is {text}"
    return ""


for _kind in SHAPES:
    _inertia_check(_kind)
for _kind in ("compound", "union"):
    _centre_check(_kind)


@Check("wrench-reset")
def _wrench_reset(lab: Lab) -> Measurement:
    with lab.running(_pushed_scene(SHAPES["box"])) as simulation:
        push(simulation, "body-0", [MASS_KG, 0.0, 0.0, 0.0, 0.0, 0.0])
        simulation.advance(SAMPLE_INTERVAL_S)
        simulation.reset(None, 0)
        simulation.advance(PUSH_S)
        return Measurement(
            measured=length_of(simulation.body_states(["body-0"])[0, 0, 7:10])
        )


# --- masses and stated inertia ---------------------------------------------------------------------------------------

MASSES_KG = (1e-4, 1e-3, 0.0123, 1.0, 100.0)


@Check("masses")
def _masses(lab: Lab) -> Measurement:
    balls = tuple(
        body(
            f"ball-{index}",
            Sphere(radius_m=0.06 * mass_kg ** (1.0 / 3.0)),
            Pose(position_m=(float(index), 0.0, 1.0)),
            mass_kg=mass_kg,
        )
        for index, mass_kg in enumerate(MASSES_KG)
    )
    rollout = lab.rollout(
        Scene(bodies=balls, duration_s=PUSH_S, gravity_m_per_s2=0.0),
        wrenches={one.name: one.mass_kg * np.eye(6)[0] for one in balls},
    )
    ratios = {
        f"the ball of {one.mass_kg:g} kg": float(rollout.velocity(one.name)[-1, 0])
        / SECONDS
        for one in balls
    }
    return worst_ratio(ratios, "the acceleration is")


STATED_SHARE = 2.0
"""Stated moment of inertia of a ball over that of uniform density."""


@Check("stated-inertia")
def _stated_inertia(lab: Lab) -> Measurement:
    length_m, radius_m, angle = 0.06, 0.03, np.radians(60.0)
    pivot = np.array([0.1, 0.2, 1.0])
    place = pivot + length_m * np.array([np.sin(angle), 0.0, -np.cos(angle)])
    bob = body(
        "bob",
        Sphere(radius_m=radius_m),
        Pose(position_m=vector(place)),
        mass_kg=MASS_KG,
    )
    bob = replace(bob, inertia_kg_m2=STATED_SHARE * 0.4 * MASS_KG * radius_m**2)
    hinge = Hinge(body="bob", anchor_m=vector(pivot), axis=(0.0, 1.0, 0.0))
    rollout = lab.rollout(Scene(bodies=(bob,), joints=(hinge,), duration_s=3.0))
    arm = rollout.position("bob") - pivot
    measured = mean_period_s(rollout.times_s, np.arctan2(arm[:, 0], -arm[:, 2]))

    expected = pendulum_period_s(
        length_m=length_m,
        gyration_m=float(np.sqrt(STATED_SHARE * 0.4)) * radius_m,
        amplitude_rad=float(angle),
        gravity_m_per_s2=G,
    )
    return Measurement(measured=measured, expected=expected)


# --- hinged bodies ---------------------------------------------------------------------------------------------------

PIVOT_M, AXIS = np.array([0.1, 0.2, 1.0]), np.array([0.6, 0.8, 0.0])
CENTRE_M, TORQUE_N_M = 0.15, 0.03


def _bar(name: str) -> RigidBody:
    """Return a bar that hangs by its end."""
    pose = Pose(position_m=vector(PIVOT_M - [0.0, 0.0, CENTRE_M]))
    return body(name, Box(size_m=(0.03, 0.03, 0.3)), pose, mass_kg=MASS_KG)


@Check("wrench-hinged")
def _wrench_hinged(lab: Lab) -> Measurement:
    bars = _bar("pushed"), _bar("turned")
    side = np.cross(AXIS, [0.0, 0.0, -1.0])
    wrenches = {
        "pushed": [*(TORQUE_N_M / CENTRE_M * side), 0.0, 0.0, 0.0],
        "turned": [0.0, 0.0, 0.0, *(-TORQUE_N_M * AXIS)],
    }
    seconds = 18 * DRIVE_INTERVAL_S
    hinges = (
        Hinge(body=bar.name, anchor_m=vector(PIVOT_M), axis=vector(AXIS))
        for bar in bars
    )
    scene = Scene(
        bodies=bars, joints=tuple(hinges), duration_s=seconds, gravity_m_per_s2=0.0
    )
    rollout = lab.rollout(scene, wrenches=wrenches)
    about_centre = float(box_inertia_kg_m2(bars[0]) @ AXIS**2)
    scale = (about_centre + MASS_KG * CENTRE_M**2) / (TORQUE_N_M * seconds)
    pushed, turned = (
        scale * float(rollout.angular_velocity(name)[-1] @ AXIS) for name in wrenches
    )
    ratios = {"a force": pushed, "a torque": -turned}
    return worst_ratio(ratios, "the angular acceleration is")


# --- contact forces --------------------------------------------------------------------------------------------------

SLIDE_FRICTION = 0.3
BRICK_KG = 0.2
WEIGHT_N = BRICK_KG * G


@recorded(
    "a brick that rests on two fixed slabs at once, and one that slides on the first with friction 0.3"
)
def _forces(lab: Lab) -> FloatArray:
    """Return the forces on both bricks, and what moves the second one, in 80 intervals, [80, 4, 3]."""
    slab = fixed_box("slab", (0.0, -0.5, -0.05), (4.0, 2.0, 0.1))
    shelf = fixed_box("shelf", (0.0, 1.0, -0.05), (4.0, 1.0, 0.1))
    resting = box("resting", (0.0, 0.5, 0.015), (0.1, 0.08, 0.03))
    sliding = box("sliding", (-1.0, -0.5, 0.015), (0.1, 0.08, 0.03))
    scene = Scene(
        bodies=(slab, shelf, resting, thrown(sliding, (2.4, 0.7, 0.0))),
        contacts=(
            contact(("resting", "sliding"), "slab", friction=SLIDE_FRICTION),
            contact("resting", "shelf", friction=SLIDE_FRICTION),
        ),
        duration_s=0.5,
    )
    pairs = [("resting", "slab"), ("sliding", "slab"), ("resting", "shelf")]
    found = []
    with lab.running(scene) as simulation:
        forces = simulation.contact_forces(pairs)
        if forces is None:
            raise DeclinedError(("contact forces are not read",))
        before = simulation.body_states(["sliding"])[0, 0, 7:10]
        for _ in range(80):
            simulation.advance(SAMPLE_INTERVAL_S)
            after = simulation.body_states(["sliding"])[0, 0, 7:10]
            gained = BRICK_KG * ((after - before) / SAMPLE_INTERVAL_S + [0.0, 0.0, G])
            found.append([*forces()[0], gained])
            before = after
    return np.array(found)


@_forces.check("force-rest")
def _force_rest(found: FloatArray) -> Measurement:
    slab, shelf = found[20:, [0, 2]].mean(axis=0) / WEIGHT_N
    both = slab + shelf
    hint = (
        f"the slab has {slab[2]:.3g} and the other slab {shelf[2]:.3g} of the weight; across it is "
        f"{np.linalg.norm(both[:2]):.3g}"
    )
    return Measurement(measured=float(both[2]), expected=1.0, hint=hint)


@_forces.check("force-slide")
def _force_slide(found: FloatArray) -> Measurement:
    _, force, _, gained = found.mean(axis=0)
    normal, sideways = (
        force[2] / gained[2],
        np.hypot(*force[:2]) / np.hypot(*gained[:2]),
    )
    hint = f"the normal force is {normal:.4g} and the friction {sideways:.4g} of what moves the brick"
    off = np.linalg.norm(found[:, 1] - found[:, 3], axis=1)
    return Measurement(measured=float(off.max()) / WEIGHT_N, hint=hint)
