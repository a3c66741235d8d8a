"""PyBullet's dynamics of two bodies, and parameters of its world."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, Literal, Self

from pydantic import Field

from gauge_envs.backends.pybullet.settings import PRESETS
from gauge_envs.scene import GRAVITY_M_PER_S2
from gauge_envs.tools.recipes.aim import Aim
from gauge_envs.tools.recipes.engines.base import ContactSettings, stated_by

THRESHOLD_STEPS = 4.0
"""Threshold of rebounds over the speed that a resting body gains in a step."""


@stated_by(PRESETS["out_of_box"])
class PyBulletSettings(ContactSettings):
    """Settings of the body and of the world. The ground has friction 1 and restitution 1, as Bullet multiplies.

    Attributes:
        lateralFriction: Coefficient of friction of the body.
        restitution: Coefficient of restitution of the body.
        contactProcessingThreshold: Distance below which contacts act [m]: 0, or Bullet's default, which brakes bodies
            shortly before they touch.
        useMaximalCoordinates: Whether free bodies have maximal coordinates; by default they have reduced ones.
        useSplitImpulse: Whether penetrations are corrected without a change of velocity.
    """

    engine: ClassVar[str] = "pybullet"
    is_soft: ClassVar[bool] = False
    aims: ClassVar[tuple[float, float]] = (0.0, 1.2)
    friction_field: ClassVar[str] = "lateralFriction"
    preset: ClassVar[str] = "contact"
    limits: ClassVar[dict[str, str]] = {
        "penetration_m": "contacts of this recipe are rigid; PyBullet's contactStiffness is not among the settings "
        "that this package measures",
        "restitution": "Bullet takes the speed of approach at the start of a step, and multiplies the coefficients "
        "of the two bodies",
    }
    template: ClassVar[str] = """\
import pybullet

COORDINATES = dict(useMaximalCoordinates={useMaximalCoordinates})  # of createMultiBody

def set_contact(foot, floor, client=0):
    pybullet.setPhysicsEngineParameter(
        fixedTimeStep={timestep_s}, numSolverIterations={numSolverIterations}, solverResidualThreshold=0,
        contactERP={contactERP}, useSplitImpulse={useSplitImpulse}{split},
        restitutionVelocityThreshold={restitutionVelocityThreshold}, contactSlop={contactSlop}, enableSAT=1,
        enableConeFriction=1, warmStartingFactor=1, minimumSolverIslandSize=1, physicsClientId=client,
    )
    # Bullet multiplies the coefficients of the two bodies.
    pybullet.changeDynamics(floor, -1, lateralFriction=1, restitution=1{threshold}, physicsClientId=client)
    pybullet.changeDynamics(foot, -1, lateralFriction={lateralFriction}, restitution={restitution}{threshold},
                            spinningFriction={torsion_m}, rollingFriction={rolling},
                            linearDamping=0, angularDamping=0, physicsClientId=client)
"""

    lateralFriction: float = Field(default=0.5, ge=0.0)  # noqa: N815
    restitution: float = Field(default=0.0, ge=0.0)
    contactProcessingThreshold: Literal["default", 0] = "default"  # noqa: N815
    useMaximalCoordinates: bool = False  # noqa: N815
    numSolverIterations: int  # noqa: N815
    restitutionVelocityThreshold: float  # noqa: N815
    contactERP: float  # noqa: N815
    useSplitImpulse: bool = True  # noqa: N815
    contactSlop: float  # noqa: N815

    @classmethod
    def aimed(cls, aim: Aim) -> Self:
        """Return the coefficients themselves, with contacts that act when bodies touch."""
        return cls.of(
            timestep_s=aim.timestep_s,
            lateralFriction=aim.friction,
            restitution=aim.rebound or 0.0,
            contactProcessingThreshold=0 if aim.rebound else "default",
            useMaximalCoordinates=True,
            restitutionVelocityThreshold=THRESHOLD_STEPS
            * GRAVITY_M_PER_S2
            * aim.timestep_s,
            contactERP=0.2,
        )

    def further(self, mass_kg: float) -> Mapping[str, Any]:
        """Return a world in metres, without damping and sleep."""
        return {
            "units_per_m": 1.0,
            "split_impulse": "all" if self.useSplitImpulse else "none",
            "late_impacts": self.contactProcessingThreshold == 0,
            "reduced_coordinates": not self.useMaximalCoordinates,
        }

    def texts(self) -> dict[str, str]:
        """Return the values of the fields, with what depends on them."""
        return super().texts() | {
            "split": ", splitImpulsePenetrationThreshold=0"
            if self.useSplitImpulse
            else "",
            "threshold": ", contactProcessingThreshold=0"
            if self.contactProcessingThreshold == 0
            else "",
            # Without rolling friction, Bullet ignores torsional friction.
            "rolling": f"{max(self.rolling_m, 1e-6 * self.torsion_m):.4g}",
        }

    def other_body(self) -> tuple[str, Self] | None:
        """Return the settings of a body in reduced coordinates, as links of robots are."""
        if not self.useMaximalCoordinates:
            return None
        text = "With useMaximalCoordinates=0, PyBullet's default and the only choice for links of a robot,"
        return text, self.model_copy(update={"useMaximalCoordinates": False})
