"""Colours of bodies in pictures, by the name of their material.

The colours are chosen by eye, after recordings of the real experiments where these show a material: pale wood, black
printed plastic, polished metal, black rubber and cream foam. The recordings show fabrics in terracotta and in black and
do not say which they are; the colours of the six fabrics only tell them apart. No colour is a measurement.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from gauge_envs.rendering.overlay import Color
from gauge_envs.scene import Deformable, Motion, RigidBody, Rod, SoftBody


@dataclass(frozen=True, kw_only=True)
class Look:
    """How a material looks.

    Attributes:
        color: Red, green, blue and opacity from 0 to 1.
        specular: Brightness of highlights, from 0 to 1.
        shininess: Sharpness of highlights, from 0 to 1.
        has_grain: Whether the surface has a wood grain.
    """

    color: Color
    specular: float = 0.08
    shininess: float = 0.2
    has_grain: bool = False


LOOKS: Mapping[str, Look] = {
    "wood": Look(color=(0.96, 0.79, 0.57, 1.0), has_grain=True),
    "plastic": Look(color=(0.17, 0.18, 0.20, 1.0), specular=0.35, shininess=0.45),
    "metal": Look(color=(0.70, 0.73, 0.77, 1.0), specular=0.9, shininess=0.8),
    "rubber": Look(color=(0.22, 0.21, 0.21, 1.0), specular=0.12, shininess=0.25),
    "acrylic": Look(color=(0.30, 0.52, 0.72, 1.0), specular=0.7, shininess=0.7),
    "blocks": Look(color=(0.80, 0.34, 0.22, 1.0), specular=0.25, shininess=0.4),
    "silicone": Look(color=(0.58, 0.76, 0.80, 1.0), specular=0.3, shininess=0.35),
    "foam": Look(color=(1.0, 0.94, 0.78, 1.0), specular=0.0),
    "hard foam": Look(color=(0.84, 0.90, 0.80, 1.0), specular=0.0),
    "satin": Look(color=(0.87, 0.43, 0.29, 1.0), specular=0.35, shininess=0.3),
    "rayon": Look(color=(0.32, 0.50, 0.66, 1.0), specular=0.12, shininess=0.2),
    "uniform": Look(color=(0.32, 0.37, 0.47, 1.0), specular=0.03),
    "nylon": Look(color=(0.20, 0.46, 0.42, 1.0), specular=0.25, shininess=0.3),
    "oxford": Look(color=(0.62, 0.48, 0.68, 1.0), specular=0.06),
    "leather": Look(color=(0.56, 0.35, 0.22, 1.0), specular=0.3, shininess=0.35),
}
"""Looks by the name of a material."""

STRING_RADIUS_M = 0.0015
"""Radius of a string in the scenes of the site [m]."""

STRING = Look(color=(0.25, 0.25, 0.25, 1.0), specular=0.0)
"""Look of strings, and of the light rods of pendulums."""

USUAL: Mapping[Motion, Look] = {
    Motion.DYNAMIC: Look(color=(0.90, 0.52, 0.17, 1.0)),
    Motion.KINEMATIC: Look(color=(0.30, 0.50, 0.75, 1.0)),
    Motion.FIXED: Look(color=(0.72, 0.66, 0.56, 1.0)),
}
"""Looks of bodies whose material is not known, by how they move."""

GRADES = {"soft": "foam", "hard": "hard foam"}
"""Materials of soft bodies that are named by their stiffness."""


def look_of(body: RigidBody | Deformable, material: str | None) -> Look:
    """Return the look of a body.

    Args:
        body: The body.
        material: Name of its material; None or an unknown one gives the usual look of bodies that move alike.
    """
    if isinstance(body, SoftBody):
        material = GRADES.get(material or "", material)
    elif isinstance(body, Rod) and material in GRADES:
        material = "rubber"
    motion = body.motion if isinstance(body, RigidBody) else Motion.DYNAMIC
    return LOOKS.get(material or "", USUAL[motion])
