"""Describe a foot of a robot and the rigid body that stands for it in the scenes of a sanity check.

A single ball would roll and a single capsule would fall over. A robot keeps the orientation of its foot with its legs.
In the scenes, four copies of the foot in one rigid body do the same.
"""

import hashlib
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs.scene import Compound, Part, Pose, Sphere, mass_properties
from gauge_envs.scene.geometry import FloatArray, vector

COPIES = 4
"""Number of feet of the rigid body."""

SPREAD = 4.0
"""Half the side of the square of feet, over the larger of the foot's radius and the height of its centre.

Friction at the soles then shifts at most a quarter of mu of the load from the upper to the lower feet.
"""


@dataclass(frozen=True, kw_only=True)
class FootGeometry:
    """Foot of a robot: its solids as they stand, and the mass that it carries.

    Attributes:
        name: Name of the body in the model.
        geoms: Description of its solids, such as `bfoot (capsule)`.
        parts: Solids in a frame with z up, whose origin is the lowest point.
        load_kg: Mass that one foot carries [kg].
        sets: Names of the sets of contact constants that the feet have on the ground.
        softening: Inverse weight of the foot's link in MuJoCo over that of the rigid body of four feet. MuJoCo softens
            contacts by it. None when unknown.
        friction: Smallest coefficient of sliding friction of the foot on the ground, by the engine's rule for pairs;
            None for the friction of the measured wooden cube.
    """

    name: str
    geoms: str
    parts: tuple[Part, ...]
    load_kg: float
    sets: tuple[str, ...] = ()
    softening: float | None = None
    friction: float | None = None

    @property
    def mass_kg(self) -> float:
        """Mass of the rigid body of four feet [kg]."""
        return COPIES * self.load_kg

    @cached_property
    def half_side_m(self) -> float:
        """Half the side of the square at whose corners the feet stand [m]."""
        alone = Compound(parts=self.parts)
        radius_m = float(np.linalg.norm(alone.corners_m[:, :2], axis=1).max())
        return SPREAD * max(radius_m, float(mass_properties(alone, self.load_kg)[0][2]))

    @cached_property
    def soles_m(self) -> FloatArray:
        """Lowest points of the four feet in the frame of the rigid body [m], shape [4, 3]."""
        return self._rotations.apply([self.half_side_m, self.half_side_m, 0.0])

    @property
    def shape(self) -> Compound:
        """Four copies at the corners of a square, each rotated by 90 degrees about the vertical from the previous one.

        The centre of mass is then above the centre of the square for any form of the foot, and the feet carry the same
        load.
        """
        return Compound(
            parts=tuple(
                Part(
                    shape=part.shape,
                    pose=Pose.from_rotation(
                        vector(rotation.apply(part.pose.position_m) + sole),
                        rotation * part.pose.rotation,
                    ),
                )
                for rotation, sole in zip(self._rotations, self.soles_m, strict=True)
                for part in self.parts
            )
        )

    @cached_property
    def digest(self) -> str:
        """Short text that differs for different scenes."""
        return hashlib.sha256(
            repr((self.parts, self.load_kg, self.softening, self.friction)).encode()
        ).hexdigest()[:12]

    @property
    def _rotations(self) -> Rotation:
        return Rotation.from_euler("z", 90.0 * np.arange(COPIES)[:, None], degrees=True)


REFERENCE_FOOT = FootGeometry(
    name="foot",
    geoms="a sphere of 20 mm",
    parts=(Part(shape=Sphere(radius_m=0.02), pose=Pose(position_m=(0.0, 0.0, 0.02))),),
    load_kg=3.0,
)
"""Foot of a quadruped of 12 kg, for the list of checks without a target."""
