"""Deformable bodies that touch: on fixed, driven and free bodies, and at rest on their surface."""

import math
from dataclasses import asdict, replace

import numpy as np

from gauge_envs.evaluation.estimators import acceleration_m_per_s2
from gauge_envs.runs.rollout import Rollout
from gauge_envs.scene import (
    GRAVITY_M_PER_S2 as G,
    Box,
    Cloth,
    Deformable,
    Pose,
    RigidBody,
    Rod,
    Rope,
    Scene,
    SoftBody,
)
from gauge_envs.scene.geometry import vector
from gauge_envs.tools.bench.parts import (
    box,
    contact,
    driven_box,
    driver,
    fixed_box,
    ramp,
)
from gauge_envs.tools.conformance.lab import LIGHT_FABRIC, Lab
from gauge_envs.tools.conformance.model import Check, Measurement, rollout_of

SLAB_M = (0.2, 0.2, 0.04)
MOTIONS = ("fixed", "driven", "free")
APART_M, LEVEL_M = 0.5, 1.0
THICKNESS_M, SHEET_M = LIGHT_FABRIC.thickness_m, 0.1
LINE_RADIUS_M = 0.005
FOAM_M = 0.04


def _supports() -> tuple[list[RigidBody], Scene]:
    """Return a fixed slab, a driven one and a free one on a fixed base, and the scene of them alone."""
    places = [(APART_M * index, 0.0, LEVEL_M) for index in range(3)]
    under = (places[2][0], 0.0, LEVEL_M - SLAB_M[2])
    slabs = [
        fixed_box("fixed", places[0], SLAB_M),
        driven_box("driven", places[1], SLAB_M),
        box("free", places[2], SLAB_M, mass_kg=1.0),
    ]
    stay = ramp(0.0, start_s=0.0, duration_s=0.1, ramp_s=0.03)
    scene = Scene(
        bodies=(*slabs, fixed_box("base", under, SLAB_M)),
        contacts=(contact("free", "base", friction=0.5),),
        drivers=(driver("driven", "translate", (1.0, 0.0, 0.0), stay),),
        duration_s=0.4,
    )
    return slabs, scene


def _resting(name: str, height_m: float) -> Scene:
    """Return a deformable body of a kind on each slab, its middle at a height over the surface."""
    slabs, scene = _supports()
    bodies, contacts = [], []
    for slab in slabs:
        place = np.add(slab.pose.position_m, (0.0, 0.0, 0.5 * SLAB_M[2] + height_m))
        one = _deformable(name, vector(place))
        bodies.append(replace(one, name=f"{name} on {slab.name}"))
        contacts.append(contact(f"{name} on {slab.name}", slab.name, friction=0.4))
    # Foam takes many short steps; what has no contact falls by 28 mm within 75 ms.
    seconds = 0.1 if name == "foam" else scene.duration_s
    return replace(
        scene,
        deformables=tuple(bodies),
        contacts=(*scene.contacts, *contacts),
        duration_s=seconds,
    )


def _deformable(name: str, place: tuple[float, float, float]) -> Deformable:
    pose = Pose(position_m=place)
    if name == "cloth":
        mass_kg = LIGHT_FABRIC.areal_density_kg_per_m2 * SHEET_M**2
        return Cloth(
            name=name,
            pose=pose,
            size_m=(SHEET_M, SHEET_M),
            mass_kg=mass_kg,
            **asdict(LIGHT_FABRIC),
        )
    if name == "foam":
        return SoftBody(
            name=name,
            shape=Box(size_m=(FOAM_M, FOAM_M, FOAM_M)),
            pose=pose,
            mass_kg=100.0 * FOAM_M**3,
            young_modulus_pa=2e4,
            poisson_ratio=0.3,
        )
    if name == "rope":
        return Rope(
            name=name,
            pose=pose,
            length_m=SHEET_M,
            radius_m=LINE_RADIUS_M,
            mass_kg=0.01,
            young_modulus_pa=1e6,
        )
    return Rod(
        name=name,
        pose=Pose.from_euler_deg(place, (0.0, 90.0, 0.0)),
        length_m=SHEET_M,
        radius_m=LINE_RADIUS_M,
        mass_kg=0.01,
        young_modulus_pa=1e6,
        poisson_ratio=0.3,
    )


def _rests_check(name: str, below_m: float) -> None:
    """Register the check that a kind of body rests on all slabs: its lowest node is at a height over the surface."""

    @Check(f"{name}-rests-on")
    def measure(lab: Lab) -> Measurement:
        middle_m = 0.5 * FOAM_M if name == "foam" else below_m
        rollout = lab.rollout(_resting(name, middle_m + 1e-4))
        late = rollout.between(0.75 * rollout.scene.duration_s, math.inf)
        errors = {}
        for motion in MOTIONS:
            lowest = rollout.nodes_m[f"{name} on {motion}"][late, :, 2].min(axis=1)
            top = rollout.position(motion)[late, 2] + 0.5 * SLAB_M[2]
            errors[motion] = 1e3 * float((lowest - top).mean() - below_m)
        worst = max(errors, key=lambda one: abs(errors[one]))
        text = ", ".join(f"{one} {error:.3g} mm" for one, error in errors.items())
        through = [one for one, error in errors.items() if error < -10.0]
        hint = f"off its height on each slab: {text}"
        if through:
            hint += f"; it falls through the {' and the '.join(through)} slab: the pair has no contact"
        return Measurement(measured=errors[worst], hint=hint)


_rests_check("cloth", 0.5 * THICKNESS_M)
_rests_check("foam", 0.0)
_rests_check("rope", LINE_RADIUS_M)
_rests_check("rod", LINE_RADIUS_M)

CARRY_FRICTION, CARRY_S = 0.3, 0.3


def _carried() -> Scene:
    slab = driven_box("slab", (0.0, 0.0, LEVEL_M), (1.0, 0.4, 0.02))
    cloth = _deformable("cloth", (0.0, 0.0, LEVEL_M + 0.01 + 0.5 * THICKNESS_M))
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
def _cloth_carry_slip(rollout: Rollout) -> Measurement:
    part = rollout.between(0.05, CARRY_S)
    mean = rollout.nodes_m["cloth"][part, :, 0].mean(axis=1)
    measured = acceleration_m_per_s2(rollout.times_s[part], mean) / G
    hint = f"the cloth is carried as if its friction were {measured:.3g} instead of {CARRY_FRICTION:g}"
    return Measurement(measured=measured, expected=CARRY_FRICTION, hint=hint)
