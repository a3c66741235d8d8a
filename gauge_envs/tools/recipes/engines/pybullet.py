"""Contact settings of PyBullet: dynamics of two bodies, and parameters of the world."""

from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from gauge_envs.scene import GRAVITY_M_PER_S2
from gauge_envs.tools.recipes.aim import Aim
from gauge_envs.tools.recipes.engines.base import ContactSettings, NonNegative

THRESHOLD_STEPS = 4.0
"""Threshold of rebounds, divided by the speed that a resting body gains in a step."""


Zero = Annotated[float, Field(ge=0.0, le=0.0)]


class PyBulletSettings(ContactSettings):
    """Settings of the body and of the world. Bullet multiplies coefficients: friction and restitution of ground are 1.

    Attributes:
        lateralFriction: Coefficient of friction of the body.
        restitution: Coefficient of restitution of the body.
        contactProcessingThreshold: Distance below which contacts act [m]: 0, or Bullet's default, which brakes bodies
            shortly before contact.
        useMaximalCoordinates: Whether free bodies have maximal coordinates instead of reduced coordinates.
        useSplitImpulse: Whether penetrations are corrected without a change of velocity.
    """

    engine = "pybullet"
    is_soft = False
    restitution_range = (0.0, 1.2)
    friction_field = "lateralFriction"
    preset = "contact"
    natives: ClassVar = {
        "numSolverIterations": "solver_iterations",
        "restitutionVelocityThreshold": "rebound_threshold",
        "contactERP": "contact_erp",
        "contactSlop": "contact_slop",
    }
    limits: ClassVar = {
        "penetration_m": "Contacts of this recipe are rigid: PyBullet's contactStiffness is not supported",
        "restitution": "Bullet uses the speed of approach at the start of a step, and multiplies the coefficients of "
        "the two bodies",
    }

    lateralFriction: NonNegative = 0.5  # noqa: N815
    restitution: NonNegative = 0.0
    contactProcessingThreshold: Literal["default"] | Zero = "default"  # noqa: N815
    useMaximalCoordinates: bool = False  # noqa: N815
    numSolverIterations: int = 50  # noqa: N815
    restitutionVelocityThreshold: float = 0.2  # noqa: N815
    contactERP: float = 0.08  # noqa: N815
    useSplitImpulse: bool = True  # noqa: N815
    contactSlop: float = 1e-5  # noqa: N815

    @classmethod
    def constants(cls, aim: Aim) -> dict[str, Any]:
        """Return the requested restitution, with contacts that act only on touching bodies."""
        threshold_m_per_s = THRESHOLD_STEPS * GRAVITY_M_PER_S2 * aim.timestep_s
        return {
            "restitution": aim.rebound or 0.0,
            "contactProcessingThreshold": 0 if aim.rebound else "default",
            "useMaximalCoordinates": True,
            "restitutionVelocityThreshold": threshold_m_per_s,
            "contactERP": 0.2,
        }

    def backend_settings(self, mass_kg: float) -> dict[str, Any]:
        """Return the settings of a world in metres, without damping and sleep."""
        return {
            **super().backend_settings(mass_kg),
            "units_per_m": 1.0,
            "split_impulse": "all" if self.useSplitImpulse else "none",
            "late_impacts": self.contactProcessingThreshold == 0,
            "reduced_coordinates": not self.useMaximalCoordinates,
        }

    def snippet(self) -> str:
        """Return Python for a world and two bodies. Without rolling friction, Bullet ignores torsional friction."""
        lateral, slop = f"{self.lateralFriction:g}", f"{self.contactSlop:g}"
        rolling_m = max(self.rolling_m, 1e-6 * self.torsion_m)
        split = ", splitImpulsePenetrationThreshold=0" if self.useSplitImpulse else ""
        threshold = ""
        if self.contactProcessingThreshold == 0:
            threshold = ", contactProcessingThreshold=0"
        return f"""\
import pybullet

# For createMultiBody. Bodies rebound differently with 0, PyBullet's default and the only choice for links of a robot.
COORDINATES = dict(useMaximalCoordinates={self.useMaximalCoordinates:d})

def set_contact(foot, floor, client=0):
    pybullet.setPhysicsEngineParameter(
        fixedTimeStep={self.timestep_s:.9g}, numSolverIterations={self.numSolverIterations}, solverResidualThreshold=0,
        contactERP={self.contactERP:g}, useSplitImpulse={self.useSplitImpulse:d}{split},
        restitutionVelocityThreshold={self.restitutionVelocityThreshold:g}, contactSlop={slop}, enableSAT=1,
        enableConeFriction=1, warmStartingFactor=1, minimumSolverIslandSize=1, physicsClientId=client,
    )
    # Bullet multiplies the coefficients of the two bodies.
    pybullet.changeDynamics(floor, -1, lateralFriction=1, restitution=1{threshold}, physicsClientId=client)
    pybullet.changeDynamics(foot, -1, lateralFriction={lateral}, restitution={self.restitution:g}{threshold},
                            spinningFriction={self.torsion_m:g}, rollingFriction={rolling_m:.4g},
                            linearDamping=0, angularDamping=0, physicsClientId=client)
"""
