"""Deformable bodies that touch or pull: at rest on fixed, driven and free bodies, struck by free ones, and towed.

Momentum is conserved whatever the contact and the material do, so that it shows the masses of what exchanges it.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from gauge_envs.scene import (
    GRAVITY_M_PER_S2 as G,
    Attachment,
    Box,
    Cloth,
    Deformable,
    Pose,
    Region,
    Rod,
    Rope,
    Scene,
    SoftBody,
)
from gauge_envs.scene.geometry import FloatArray, vector
from gauge_envs.scoring.estimators import acceleration_m_per_s2
from gauge_envs.tools.bench.parts import (
    box,
    contact,
    driven_box,
    driver,
    fixed_box,
    ramp,
)
from gauge_envs.tools.bench.recording import Recording
from gauge_envs.tools.conformance.cloth import node_shares
from gauge_envs.tools.conformance.lab import (
    FRAME,
    LIGHT_FABRIC,
    Lab,
    clamped,
    fabric,
    sheet,
)
from gauge_envs.tools.conformance.laws import (
    PLACE_TOLERANCE_M,
    worst_ratio,
)
from gauge_envs.tools.conformance.model import (
    Check,
    Measurement,
    Recorded,
    recorded,
    rollout_of,
)
from gauge_envs.tools.conformance.soft import line_shares

ORIGIN = Pose(position_m=(0.0, 0.0, 0.0))
SLAB_M = (0.2, 0.2, 0.04)
MOTIONS = ("fixed", "driven", "free")
APART_M, LEVEL_M = 0.5, 1.0
SHEET_M, FOAM_M = 0.1, 0.04


def _sheets() -> list[Cloth]:
    """Return three sheets of different fabrics and thicknesses at the origin."""
    sheets = []
    for number, (density, stretch, thickness_m) in enumerate(
        ((0.2, 110.0, 2e-3), (0.4, 80.0, 6e-3), (0.1, 150.0, 1.2e-2))
    ):
        made_of = replace(fabric(density, stretch, 1e-4), thickness_m=thickness_m)
        one = sheet(made_of, ORIGIN, (SHEET_M, SHEET_M))
        sheets.append(replace(one, name=f"cloth {number}"))
    return sheets


def _cubes() -> list[SoftBody]:
    """Return three cubes of different foams at the origin."""
    return [
        SoftBody(
            name=f"foam {number}",
            shape=Box(size_m=(FOAM_M, FOAM_M, FOAM_M)),
            pose=ORIGIN,
            mass_kg=density * FOAM_M**3,
            young_modulus_pa=young_pa,
            poisson_ratio=poisson,
        )
        for number, (density, young_pa, poisson) in enumerate(
            ((100.0, 2e4, 0.3), (150.0, 4e4, 0.2), (60.0, 1e4, 0.4))
        )
    ]


LINES = ((0.1, 0.004, 0.01), (0.15, 0.006, 0.03), (0.08, 0.01, 0.008))
"""Length [m], radius [m] and mass [kg] of three lines."""


def _ropes() -> list[Rope]:
    """Return three ropes along x, at the origin."""
    return [
        Rope(
            name=f"rope {number}",
            pose=ORIGIN,
            length_m=length_m,
            radius_m=radius_m,
            mass_kg=mass_kg,
            young_modulus_pa=1e6,
        )
        for number, (length_m, radius_m, mass_kg) in enumerate(LINES)
    ]


def _rods() -> list[Rod]:
    """Return three rods along x, at the origin."""
    level = Pose.from_euler_deg((0.0, 0.0, 0.0), (0.0, 90.0, 0.0))
    return [
        Rod(
            name=f"rod {number}",
            pose=level,
            length_m=length_m,
            radius_m=radius_m,
            mass_kg=mass_kg,
            young_modulus_pa=young_pa,
            poisson_ratio=0.3,
        )
        for number, ((length_m, radius_m, mass_kg), young_pa) in enumerate(
            zip(LINES, (1e7, 2e7, 5e6), strict=True)
        )
    ]


KINDS: dict[str, Callable[[], Sequence[Deformable]]] = {
    "cloth": _sheets,
    "foam": _cubes,
    "rope": _ropes,
    "rod": _rods,
}


def half_fixed(kind: str) -> Scene:
    """Return the first body of a kind, held at one side."""
    axis: Literal["x", "z"] = "z" if kind in ("foam", "rod") else "x"
    region = Region(axis=axis, side="high")
    return clamped(KINDS[kind]()[0], region, duration_s=0.3)


def _half_height_m(one: Deformable) -> float:
    """Return the distance from the middle of a body to its surface below [m]."""
    if isinstance(one, Cloth):
        return 0.5 * one.thickness_m
    return 0.5 * FOAM_M if isinstance(one, SoftBody) else one.radius_m


def _at(one: Deformable, place: Any) -> Deformable:
    return replace(one, pose=replace(one.pose, position_m=vector(place)))


def _resting(kind: str) -> Scene:
    """Return three bodies of a kind: on a fixed slab, a driven one, and a free one that stands on a fixed base."""
    places = [(APART_M * index, 0.0, LEVEL_M) for index in range(3)]
    under = (places[2][0], 0.0, LEVEL_M - SLAB_M[2])
    slabs = [
        fixed_box("fixed", places[0], SLAB_M),
        driven_box("driven", places[1], SLAB_M),
        box("free", places[2], SLAB_M, mass_kg=1.0),
    ]
    bodies = []
    for one, slab in zip(KINDS[kind](), slabs, strict=True):
        height_m = 0.5 * SLAB_M[2] + _half_height_m(one) + 1e-4
        bodies.append(_at(one, np.add(slab.pose.position_m, (0.0, 0.0, height_m))))
    soft = tuple(one.name for one in bodies)
    stay = ramp(0.0, start_s=0.0, duration_s=0.1, ramp_s=0.03)
    return Scene(
        bodies=(*slabs, fixed_box("base", under, SLAB_M)),
        deformables=tuple(bodies),
        contacts=(
            contact("free", "base", friction=0.5),
            contact(soft, MOTIONS, friction=0.4),
        ),
        drivers=(driver("driven", "translate", (1.0, 0.0, 0.0), stay),),
        # Foam takes many short steps; what has no contact falls by 28 mm within 75 ms.
        duration_s={"foam": 0.1, "rope": 1.3}.get(kind, 2.3),
    )


def _on_slabs(kind: str) -> Recorded[Recording]:
    return rollout_of(
        f"three bodies of a kind and of different sizes and materials ({kind}), one on a fixed slab, one on a driven "
        "slab that stands still, and one on a free slab",
        _resting(kind),
    )


def _rests(kind: str) -> Callable[[Recording], Measurement]:
    """Return the measurement of the height of three bodies of a kind over the slabs on which they rest [mm]."""

    def measure(rollout: Recording) -> Measurement:
        late = rollout.between(0.75 * rollout.scene.duration_s, math.inf)
        errors = {}
        for one, motion in zip(rollout.scene.deformables, MOTIONS, strict=True):
            lowest = rollout.nodes_m[one.name][late, :, 2].min(axis=1)
            if not isinstance(one, SoftBody):
                lowest = lowest - _half_height_m(one)
            top = rollout.position(motion)[late, 2] + 0.5 * SLAB_M[2]
            errors[motion] = 1e3 * float((lowest - top).mean())
        worst = max(errors, key=lambda one: abs(errors[one]))
        text = ", ".join(f"{one} {error:.3g} mm" for one, error in errors.items())
        through = [one for one, error in errors.items() if error < -13.0]
        cause = ""
        if through:
            cause = f"it falls through the {' and the '.join(through)} slab: the pair has no contact"
        hint = f"off its height on each slab: {text}"
        return Measurement(measured=errors[worst], hint=hint, cause=cause)

    return measure


# --- bodies that a free block strikes: momentum ----------------------------------------------------------------------

STRIKES = ((1.0, 0.3), (-2.5, 0.6), (0.3, 0.4))
"""Velocity of the block [m/s], and its mass over that of the body."""
GAP_M, BLOCK_M = 1e-3, 0.03


def _struck(kind: str) -> Scene:
    """Return three bodies of a kind, each with a free block that flies towards it across, without gravity."""
    bodies, blocks = [], []
    for number, (one, (speed, share)) in enumerate(
        zip(KINDS[kind](), STRIKES, strict=True)
    ):
        place = np.array([0.0, APART_M * number, LEVEL_M])
        bodies.append(_at(one, place))
        length_m = one.length_m if isinstance(one, Rope | Rod) else max(FOAM_M, SHEET_M)
        below_m = _half_height_m(one) + 0.5 * BLOCK_M + GAP_M
        block = box(
            f"block {number}",
            vector(place - [0.0, 0.0, math.copysign(below_m, speed)]),
            (length_m + 0.02, 0.12, BLOCK_M),
            mass_kg=share * one.mass_kg,
        )
        blocks.append(replace(block, linear_velocity_m_per_s=(0.0, 0.0, speed)))
    soft = tuple(one.name for one in bodies)
    return Scene(
        bodies=tuple(blocks),
        deformables=tuple(bodies),
        contacts=(contact(soft, tuple(one.name for one in blocks), friction=0.3),),
        duration_s=0.2 if kind == "foam" else 2.3,
        gravity_m_per_s2=0.0,
    )


def node_masses_kg(one: Deformable, nodes_m: FloatArray) -> FloatArray:
    """Return the mass at each node of a uniform body, from its nodes at the start [m], shape [node_count, 3]."""
    local = one.pose.to_body(nodes_m)
    if isinstance(one, Cloth):
        return one.mass_kg * node_shares(local, one.size_m)
    if isinstance(one, SoftBody):
        # A node on a face, an edge or a corner of a regular grid has a half, a quarter or an eighth of a cell.
        on_face = np.abs(local) > 0.5 * np.array(one.shape.size_m) - PLACE_TOLERANCE_M
        shares = 0.5 ** on_face.sum(axis=1)
        return np.asarray(one.mass_kg * shares / shares.sum())
    along = local[:, 0 if isinstance(one, Rope) else 2]
    order = np.argsort(along)
    shares = np.empty(len(along))
    shares[order] = line_shares(along[order])
    return one.mass_kg * shares


def mass_moment_kg_m(rollout: Recording, soft: str, rigid: str) -> FloatArray:
    """Return the displacement of a deformable and a rigid body times their masses [kg m], shape [sample_count, 3]."""
    nodes = rollout.nodes_m[soft]
    (one,) = (body for body in rollout.scene.deformables if body.name == soft)
    moved = np.einsum("n,tni->ti", node_masses_kg(one, nodes[0]), nodes - nodes[0])
    mass_kg = rollout.scene.body(rigid).mass_kg
    return np.asarray(moved + mass_kg * rollout.displacement(rigid))


WINDOWS_S = ((0.05, 0.9), (0.9, 1.9), (2.05, 2.3))
"""Times between which a momentum is measured [s]."""


def _strikes(kind: str) -> Callable[[Lab], Measurement]:
    """Return the measurement of the momentum of three bodies of a kind and of the blocks that strike them."""

    def measure(lab: Lab) -> Measurement:
        rollout = lab.rollout(_struck(kind))
        ratios = {}
        for one, block in zip(
            rollout.scene.deformables, rollout.scene.bodies, strict=True
        ):
            moment = mass_moment_kg_m(rollout, one.name, block.name)[:, 2]
            start = block.mass_kg * block.linear_velocity_m_per_s[2]
            for start_s, end_s in WINDOWS_S:
                first, last = rollout.sample_at(start_s), rollout.sample_at(end_s)
                if last > first:
                    seconds = rollout.times_s[last] - rollout.times_s[first]
                    label = f"{one.name} from {start_s:g} to {end_s:g} s"
                    ratios[label] = float((moment[last] - moment[first]) / seconds)
                    ratios[label] /= start
            if rollout.displacement(block.name)[-1, 2] > 0.95 * (
                block.linear_velocity_m_per_s[2] * rollout.times_s[-1]
            ) * np.sign(start):
                return Measurement(
                    measured=math.nan,
                    expected=1.0,
                    hint=f"the block passes through {one.name}: the pair has no contact",
                )
        return worst_ratio(ratios, "the momentum is")

    return measure


# --- lines that are pulled -------------------------------------------------------------------------------------------

PULL_M_PER_S2, BOB_M, PULL_S = 7.0, 0.03, 2.3
BOBS_KG = (0.01, 0.04, 0.02)


def _towed() -> Scene:
    """Return three ropes, each attached to a free bob at its end, without gravity."""
    bobs, lines, attachments = [], [], []
    for number, (one, mass_kg) in enumerate(zip(_ropes(), BOBS_KG, strict=True)):
        place = np.array([0.0, APART_M * number, LEVEL_M])
        end = np.add(place, (0.5 * one.length_m, 0.0, 0.0))
        bobs.append(
            box(f"bob {number}", vector(end), (BOB_M, BOB_M, BOB_M), mass_kg=mass_kg)
        )
        lines.append(_at(one, place))
        region = Region(axis="x", side="high")
        attachments.append(
            Attachment(deformable=one.name, region=region, to=f"bob {number}")
        )
    return Scene(
        bodies=tuple(bobs),
        deformables=tuple(lines),
        attachments=tuple(attachments),
        duration_s=PULL_S,
        gravity_m_per_s2=0.0,
    )


@recorded(
    "three ropes without gravity, each attached to a free block that a force pulls ahead, up to 16 m/s"
)
def _pulled(lab: Lab) -> Recording:
    scene = _towed()
    ahead = PULL_M_PER_S2 * np.eye(6)[0]
    pairs = zip(scene.bodies, scene.deformables, strict=True)
    return lab.rollout(
        scene,
        wrenches={
            bob.name: (bob.mass_kg + line.mass_kg) * ahead for bob, line in pairs
        },
    )


@_pulled.check("rope-mass")
def _pulled_mass(rollout: Recording) -> Measurement:
    ratios = {}
    for line, bob in zip(rollout.scene.deformables, rollout.scene.bodies, strict=True):
        total_kg = line.mass_kg + bob.mass_kg
        moved = mass_moment_kg_m(rollout, line.name, bob.name)[:, 0] / total_kg
        for start_s, end_s in ((0.0, 0.9), (1.0, 1.9), (2.0, PULL_S)):
            part = rollout.between(start_s, end_s)
            found = acceleration_m_per_s2(rollout.times_s[part], moved[part])
            label = f"{line.name} from {start_s:g} to {end_s:g} s"
            ratios[label] = PULL_M_PER_S2 / found if found > 0.0 else math.inf
    return worst_ratio(ratios, "the mass that the force moves is")


@_pulled.check("rope-pulled-length")
def _pulled_length(rollout: Recording) -> Measurement:
    ratios = {}
    for line in rollout.scene.deformables:
        assert isinstance(line, Rope), "the scene has ropes alone"
        nodes = rollout.nodes_m[line.name]
        order = np.argsort(nodes[0, :, 0])
        chord = np.linalg.norm(nodes[:, order[-1]] - nodes[:, order[0]], axis=1)
        furthest = chord[np.abs(chord - line.length_m).argmax()]
        ratios[line.name] = float(furthest / line.length_m)
    return worst_ratio(ratios, "the length is")


for _kind in KINDS:
    _on_slabs(_kind).check(f"{_kind}-rests-on")(_rests(_kind))
    Check(f"{_kind}-strike")(_strikes(_kind))

CARRY_FRICTION, CARRY_S = 0.3, 0.3


def _carried() -> Scene:
    slab = driven_box("slab", (0.0, 0.0, LEVEL_M), (1.0, 0.4, 0.02))
    above_m = 0.01 + 0.5 * LIGHT_FABRIC.thickness_m
    pose = Pose(position_m=(0.0, 0.0, LEVEL_M + above_m))
    cloth = sheet(LIGHT_FABRIC, pose, (SHEET_M, SHEET_M))
    pull = ramp(0.9, start_s=0.0, duration_s=0.6, ramp_s=0.3)
    return Scene(
        bodies=(slab,),
        deformables=(cloth,),
        contacts=(contact("slab", "cloth", friction=CARRY_FRICTION),),
        drivers=(driver("slab", "translate", (1.0, 0.0, 0.0), pull),),
        duration_s=CARRY_S,
    )


@rollout_of(
    "a sheet of cloth on a slab that is driven by 10 m/s^2; friction 0.3, the slab listed first",
    _carried(),
).check("cloth-carry-slip")
def _cloth_carry_slip(rollout: Recording) -> Measurement:
    part = rollout.between(0.05, CARRY_S)
    mean = rollout.nodes_m["cloth"][part, :, 0].mean(axis=1)
    measured = acceleration_m_per_s2(rollout.times_s[part], mean) / G
    hint = f"the cloth is carried as if its friction were {measured:.3g} instead of {CARRY_FRICTION:g}"
    return Measurement(measured=measured, expected=CARRY_FRICTION, hint=hint)


# --- cloth that touches itself ---------------------------------------------------------------------------------------

HALF_M, FOLD_S, FOLDED_S = 0.15, 0.6, 1.0
EDGE_M = (-0.135, 0.01)
"""Where the rod lays the strip's end: along the strip from the fold, and over the held half [m]."""

SUPPLE_FABRIC = replace(fabric(0.2, 110.0, 1e-6), thickness_m=3e-3)
"""Fabric that sags by 22 mm between the fold and the rod, where nothing is under it."""


def _folded() -> Scene:
    """Return a strip with one half held level; a rod that turns by 180 degrees takes the other end over it."""
    strip = Pose(position_m=(0.0, 0.0, LEVEL_M))
    cloth = sheet(SUPPLE_FABRIC, strip, (2.0 * HALF_M, 0.05))
    middle = (0.5 * (HALF_M + EDGE_M[0]), 0.0, LEVEL_M + 0.5 * EDGE_M[1])
    turn = ramp(-math.pi, start_s=0.0, duration_s=FOLD_S, ramp_s=0.2)
    half = Region(axis="x", side="low", depth_m=HALF_M)
    end = Region(axis="x", side="high")
    return Scene(
        bodies=(FRAME, driven_box("rod", (HALF_M, 0.0, LEVEL_M), (0.01, 0.06, 0.01))),
        deformables=(cloth,),
        attachments=(
            Attachment(deformable="cloth", region=half, to=FRAME.name),
            Attachment(deformable="cloth", region=end, to="rod"),
        ),
        contacts=(contact("cloth", "cloth", friction=0.1),),
        drivers=(driver("rod", "rotate", (0.0, 1.0, 0.0), turn, point_m=middle),),
        duration_s=FOLDED_S,
    )


@rollout_of(
    "a strip of cloth of 0.3 m by 0.05 m, of which one half is held level; a driven rod lays the end of the other half "
    "over it, with slack",
    _folded(),
).check("cloth-touches-itself")
def _cloth_touches_itself(rollout: Recording) -> Measurement:
    nodes = rollout.nodes_m["cloth"]
    late = rollout.between(FOLDED_S - 0.2, math.inf)
    # The held half is level, so that the height over it needs no pairs of nodes.
    free = nodes[late][:, nodes[0, :, 0] > PLACE_TOLERANCE_M].mean(axis=0)
    over = free[free[:, 0] < -PLACE_TOLERANCE_M, 2] - LEVEL_M
    lowest_m = float(over.min(initial=math.inf))
    return Measurement(measured=1e3 * (lowest_m - SUPPLE_FABRIC.thickness_m))
