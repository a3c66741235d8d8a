"""PyBullet's dynamics of two bodies, and parameters of its world."""

from __future__ import annotations

from typing import ClassVar, Literal, Self

from pydantic import Field

from gauge_envs.scene import GRAVITY_M_PER_S2, ContactMode
from gauge_envs.tools.recipes.aim import Aim
from gauge_envs.tools.recipes.engines.base import ContactSettings
from gauge_envs.tools.recipes.probes import Build

THRESHOLD_STEPS = 4.0
"""Threshold of rebounds over the speed that a resting body gains in a step."""


class PyBulletSettings(ContactSettings):
    """Settings of the body and of the world. The ground has friction 1 and restitution 1, as Bullet multiplies.

    Attributes:
        lateralFriction: Coefficient of friction of the body.
        restitution: Coefficient of restitution of the body.
        contactProcessingThreshold: Distance below which contacts act [m]: 0, or Bullet's default, which brakes bodies
            shortly before they touch.
        useMaximalCoordinates: Whether free bodies have maximal coordinates; by default they have reduced ones.
        numSolverIterations: Iterations of the solver.
        restitutionVelocityThreshold: Speed of approach below which nothing rebounds [m/s].
        contactERP: Share of a penetration that one step corrects.
        useSplitImpulse: Whether penetrations are corrected without a change of velocity.
        contactSlop: Penetration that is not corrected [m].
    """

    engine: ClassVar[str] = "pybullet"
    is_soft: ClassVar[bool] = False
    aims: ClassVar[tuple[float, float]] = (0.0, 1.2)

    lateralFriction: float = Field(default=0.5, ge=0.0)  # noqa: N815
    restitution: float = Field(default=0.0, ge=0.0)
    contactProcessingThreshold: Literal["default", 0] = "default"  # noqa: N815
    useMaximalCoordinates: bool = False  # noqa: N815
    numSolverIterations: int = Field(default=50, ge=1)  # noqa: N815
    restitutionVelocityThreshold: float = Field(default=0.2, ge=0.0)  # noqa: N815
    contactERP: float = Field(default=0.08, ge=0.0, le=1.0)  # noqa: N815
    useSplitImpulse: bool = True  # noqa: N815
    contactSlop: float = Field(default=1e-5, ge=0.0)  # noqa: N815

    @classmethod
    def aimed(cls, aim: Aim) -> Self:
        """Return the coefficients themselves, with contacts that act when bodies touch."""
        return cls(
            timestep_s=aim.timestep_s,
            lateralFriction=aim.friction,
            restitution=aim.rebound or 0.0,
            contactProcessingThreshold=0 if aim.rebound else "default",
            useMaximalCoordinates=True,
            restitutionVelocityThreshold=THRESHOLD_STEPS * GRAVITY_M_PER_S2 * aim.timestep_s,
            contactERP=0.2,
        )

    @property
    def sliding_friction(self) -> float:
        """Coefficient of friction of the pair."""
        return self.lateralFriction

    def build(self, mass_kg: float) -> Build:
        """Return a world in metres with these settings, without damping and sleep."""
        given = {
            "preset": "contact",
            "units_per_m": 1.0,
            "solver_iterations": self.numSolverIterations,
            "contact_erp": self.contactERP,
            "split_impulse": "all" if self.useSplitImpulse else "none",
            "rebound_threshold": self.restitutionVelocityThreshold,
            "contact_slop": self.contactSlop,
            "late_impacts": self.contactProcessingThreshold == 0,
            "reduced_coordinates": not self.useMaximalCoordinates,
        }
        return Build(
            friction=self.lateralFriction, restitution=self.restitution, mode=ContactMode.IMPACT, settings=given
        )

    def snippet(self, mass_kg: float) -> str:
        """Return Python for a body `foot` on a body `floor`, as that of plane.urdf."""
        threshold = ", contactProcessingThreshold=0" if self.contactProcessingThreshold == 0 else ""
        damping = "linearDamping=0, angularDamping=0"
        split = ", splitImpulsePenetrationThreshold=0" if self.useSplitImpulse else ""
        return (
            "import pybullet\n\n"
            f"COORDINATES = dict(useMaximalCoordinates={int(self.useMaximalCoordinates)})  # of createMultiBody\n\n"
            "def set_contact(foot, floor, client=0):\n"
            "    pybullet.setPhysicsEngineParameter(\n"
            f"        fixedTimeStep={self.timestep_s:.9g}, numSolverIterations={self.numSolverIterations}, "
            "solverResidualThreshold=0,\n"
            f"        contactERP={self.contactERP:g}, useSplitImpulse={int(self.useSplitImpulse)}{split},\n"
            f"        restitutionVelocityThreshold={self.restitutionVelocityThreshold:g}, "
            f"contactSlop={self.contactSlop:g}, enableSAT=1,\n"
            "        enableConeFriction=1, warmStartingFactor=1, minimumSolverIslandSize=1, physicsClientId=client,\n"
            "    )\n"
            "    # Bullet multiplies the coefficients of the two bodies.\n"
            f"    pybullet.changeDynamics(floor, -1, lateralFriction=1, restitution=1{threshold}, "
            "physicsClientId=client)\n"
            f"    pybullet.changeDynamics(foot, -1, lateralFriction={self.lateralFriction:g}, "
            f"restitution={self.restitution:g}{threshold},\n"
            f"                            {damping}, physicsClientId=client)\n"
        )

    def other_body(self) -> tuple[str, Self] | None:
        """Return the settings of a body in reduced coordinates, as links of robots are."""
        if not self.useMaximalCoordinates:
            return None
        text = "With useMaximalCoordinates=0, PyBullet's default and the only choice for links of a robot,"
        return text, self.model_copy(update={"useMaximalCoordinates": False})

    @classmethod
    def limits(cls, quantity: str) -> str:
        """Return what these settings of PyBullet limit."""
        return {
            "penetration_m": "contacts of this recipe are rigid; PyBullet's contactStiffness is not among the settings "
            "that this package measures",
            "restitution": "Bullet takes the speed of approach at the start of a step, and multiplies the coefficients "
            "of the two bodies",
        }.get(quantity, "")
