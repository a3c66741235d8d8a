"""Looks of materials in pictures.

Colours follow recordings of the real experiments by eye: pale wood, black printed plastic, polished metal, black rubber
and cream foam. The colours of the six fabrics only distinguish them. No colour is measured.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from gauge_envs.scene import Deformable, RigidBody, Rod, SoftBody

Color = tuple[float, float, float]
"""Red, green and blue from 0 to 1."""


@dataclass(frozen=True)
class Look:
    """How a material looks: its colour, and brightness and sharpness of its highlights from 0 to 1."""

    color: Color
    specular: float = 0.08
    shininess: float = 0.2


LOOKS: Mapping[str, Look] = {
    "wood": Look((0.92, 0.76, 0.55)),
    "plastic": Look((0.17, 0.18, 0.20), 0.35, 0.45),
    "metal": Look((0.70, 0.73, 0.77), 0.9, 0.8),
    "rubber": Look((0.22, 0.21, 0.21), 0.12, 0.25),
    "acrylic": Look((0.30, 0.52, 0.72), 0.7, 0.7),
    "blocks": Look((0.80, 0.34, 0.22), 0.25, 0.4),
    "silicone": Look((0.58, 0.76, 0.80), 0.3, 0.35),
    "foam": Look((1.0, 0.94, 0.78), 0.0),
    "hard foam": Look((0.84, 0.90, 0.80), 0.0),
    "satin": Look((0.87, 0.43, 0.29), 0.35, 0.3),
    "rayon": Look((0.32, 0.50, 0.66), 0.12),
    "uniform": Look((0.32, 0.37, 0.47), 0.03),
    "nylon": Look((0.20, 0.46, 0.42), 0.25, 0.3),
    "oxford": Look((0.62, 0.48, 0.68), 0.06),
    "leather": Look((0.56, 0.35, 0.22), 0.3, 0.35),
    # Bodies of an unknown material, by how they move.
    "dynamic": Look((0.90, 0.52, 0.17)),
    "kinematic": Look((0.30, 0.50, 0.75)),
    "fixed": Look((0.72, 0.66, 0.56)),
}
"""Looks by the name of a material."""

STRING_COLOR = (0.25, 0.25, 0.25)
"""Colour of strings, and of the light rods of pendulums."""
STRING_RADIUS_M = 0.0015
"""Radius of a string in the scenes of reports [m]."""


def material_of(body: RigidBody | Deformable, material: str | None) -> str:
    """Return the name of the look of a body.

    Args:
        body: The body.
        material: Its material in the task file; for foam this is its stiffness, `soft` or `hard`.
    """
    if material in ("soft", "hard"):
        if isinstance(body, SoftBody):
            return "foam" if material == "soft" else "hard foam"
        if isinstance(body, Rod):
            return "rubber"
    if material is not None and material in LOOKS:
        return material
    return body.motion.value if isinstance(body, RigidBody) else "dynamic"
