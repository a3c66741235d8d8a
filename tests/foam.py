"""A square bar of foam, for the tests of every engine."""

from __future__ import annotations

from gauge_envs.backends.shared.attachments import RigidAttachment
from gauge_envs.fixtures.parts import driven_box, fixed_box
from gauge_envs.scene import Attachment, Box, Pose, Region, Scene, SoftBody

EDGE_M = 0.05
AREA_M2 = EDGE_M**2
YOUNG_PA = 86410.0
DENSITY_KG_PER_M3 = 13.2
ORIGIN = Pose(position_m=(0.0, 0.0, 0.0))


def block(
    name="foam",
    *,
    length_m=0.2,
    centre_m=(0.0, 0.0, 0.0),
    euler_deg=(0.0, 0.0, 0.0),
    young_pa=YOUNG_PA,
    poisson=0.0,
    density=DENSITY_KG_PER_M3,
):
    """Return a square bar along z of its frame."""
    return SoftBody(
        name=name,
        shape=Box(size_m=(EDGE_M, EDGE_M, length_m)),
        pose=Pose.from_euler_deg(centre_m, euler_deg),
        mass_kg=density * AREA_M2 * length_m,
        young_modulus_pa=young_pa,
        poisson_ratio=poisson,
    )


def attachment_of(side, motion, depth_m=0.0, axis="z", body=""):
    """Attach a side to a plate or another body at the origin; `low` and `high` are names of plates."""
    region = Region(axis=axis, side=side, depth_m=depth_m)
    return RigidAttachment(region=region, body=body or side, motion=motion, pose=ORIGIN)


def gripped(foam, *, depth_m=0.01285):
    """Return a weightless bar along z, clamped by a fixed body `low` and a driven body `high` at the origin."""
    grips = tuple(
        Attachment(
            deformable=foam.name,
            region=Region(axis="z", side=side, depth_m=depth_m),
            to=side,
        )
        for side in ("low", "high")
    )
    return Scene(
        bodies=(
            fixed_box("low", (0.0, 0.0, 0.0), (0.01,) * 3),
            driven_box("high", (0.0, 0.0, 0.0), (0.01,) * 3),
        ),
        deformables=(foam,),
        attachments=grips,
        gravity_m_per_s2=0.0,
        duration_s=1.0,
    )
