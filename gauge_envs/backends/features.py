"""Optional features of engines, and which of them a scene needs."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum

from gauge_envs.scene import Hinge, Scene, Slider
from gauge_envs.scene.motors import Servo, TorqueMotor


@dataclass(frozen=True)
class Support:
    """Whether a backend can build a scene, and the unsupported features if it cannot.

    Attributes:
        missing: One sentence for each unsupported feature; empty if the backend can build the scene.
    """

    missing: tuple[str, ...] = ()

    def __bool__(self) -> bool:
        return not self.missing


class Feature(StrEnum):
    """Part of a scene that an engine builds only if it says so."""

    AIR = "air"
    """`Scene.air` around cloth."""
    BODY_HINGES = "body hinges"
    """`Scene.body_hinges`."""
    STATED_INERTIA = "stated inertia"
    """`RigidBody.inertia_kg_m2`."""
    CHAINS = "chains"
    """Bodies that hinges join, of which one has a hinge to the world."""
    DRY_FRICTION = "dry joint friction"
    """`JointDynamics.dry_friction_n_m`."""
    VISCOUS_FRICTION = "viscous joint friction"
    """`JointDynamics.viscous_friction_n_m_s_per_rad`."""
    QUADRATIC_FRICTION = "quadratic joint friction"
    """`JointDynamics.quadratic_friction_n_m_s2_per_rad2`."""
    SERVO_FRICTION = "friction of servo benches"
    """`JointDynamics.servo`."""
    ARMATURE = "armature"
    """`JointDynamics.armature_kg_m2`."""
    BACKLASH = "backlash"
    """`JointDynamics.backlash_rad`."""
    SERVO = "servo"
    """`Servo` on a joint."""
    TORQUE_MOTOR = "torque motor"
    """`TorqueMotor` on a joint."""
    TORSION = "torsional friction"
    """`Contact.torsion_m`."""
    ROLLING = "rolling friction"
    """`Contact.rolling_m`."""
    SLIDERS = "sliders"
    """`Slider` in `Scene.guides`."""
    BALL_JOINTS = "ball joints"
    """`BallJoint` in `Scene.guides`."""
    JOINT_LIMITS = "joint limits"
    """`Hinge.limits_rad`; those of sliders belong to these."""


JOINT_FEATURES = frozenset(
    {
        Feature.CHAINS,
        Feature.DRY_FRICTION,
        Feature.VISCOUS_FRICTION,
        Feature.QUADRATIC_FRICTION,
        Feature.SERVO_FRICTION,
        Feature.ARMATURE,
        Feature.SERVO,
        Feature.TORQUE_MOTOR,
    }
)
"""Features of joints."""

GUIDES = frozenset({Feature.SLIDERS, Feature.BALL_JOINTS, Feature.JOINT_LIMITS})
"""Features of joints that robots need beside hinges."""

RIGID_FEATURES = (
    JOINT_FEATURES
    | GUIDES
    | {Feature.BODY_HINGES, Feature.STATED_INERTIA, Feature.BACKLASH}
)
"""Features of an engine of rigid bodies and joints, without air, torsional and rolling friction."""


def needed_features(scene: Scene) -> Iterator[tuple[Feature, str]]:
    """Yield the optional features that a scene needs, each with the sentence of a backend that lacks it."""
    if scene.air:
        yield (
            Feature.AIR,
            "the scene has air around its cloth, which this backend does not apply",
        )
    for hinge in scene.body_hinges[:1]:
        bodies = f"{hinge.first!r} and {hinge.second!r}"
        yield (
            Feature.BODY_HINGES,
            f"{bodies} are joined by a hinge, which this backend does not build",
        )
    joined = {
        name for hinge in scene.body_hinges for name in (hinge.first, hinge.second)
    }
    for name in joined & {*scene.hung}:
        yield (
            Feature.CHAINS,
            f"a chain of hinges hangs on the world by {name!r}, which this backend does not build",
        )
    yield from _needed_joint_features(scene)
    for contact in scene.contacts:
        bodies = f"{contact.first[0]!r} and {contact.second[0]!r}"
        for feature, length_m in (
            (Feature.TORSION, contact.torsion_m),
            (Feature.ROLLING, contact.rolling_m),
        ):
            if length_m:
                yield (
                    feature,
                    f"{bodies} touch with {feature.value}, which this backend does not build",
                )
    yield from _needed_guides(scene)
    for body in scene.dynamic_bodies:
        if body.inertia_kg_m2 is not None:
            yield (
                Feature.STATED_INERTIA,
                f"{body.name!r} states its inertia, which this backend does not read",
            )


def _needed_guides(scene: Scene) -> Iterator[tuple[Feature, str]]:
    for guide in scene.guides:
        is_slider = isinstance(guide, Slider)
        feature = Feature.SLIDERS if is_slider else Feature.BALL_JOINTS
        noun = "slider" if is_slider else "ball joint"
        yield (
            feature,
            f"{guide.body!r} is on a {noun}, which this backend does not build",
        )
    for joint in scene.joints:
        if isinstance(joint, Hinge) and joint.limits_rad is not None:
            yield (
                Feature.JOINT_LIMITS,
                f"the joint of {joint.body!r} has limits, which this backend does not build",
            )


def _needed_joint_features(scene: Scene) -> Iterator[tuple[Feature, str]]:
    for hinge in scene.hinges:
        name = hinge.body if isinstance(hinge, Hinge) else hinge.second
        terms = {
            Feature.DRY_FRICTION: (hinge.dynamics.dry_friction_n_m, "dry friction"),
            Feature.VISCOUS_FRICTION: (
                hinge.dynamics.viscous_friction_n_m_s_per_rad,
                "viscous friction",
            ),
            Feature.QUADRATIC_FRICTION: (
                hinge.dynamics.quadratic_friction_n_m_s2_per_rad2,
                "quadratic friction",
            ),
            Feature.SERVO_FRICTION: (hinge.dynamics.servo, "friction of servo benches"),
            Feature.ARMATURE: (hinge.dynamics.armature_kg_m2, "armature"),
            Feature.BACKLASH: (hinge.dynamics.backlash_rad, "backlash"),
            Feature.SERVO: (isinstance(hinge.motor, Servo), "a position servo"),
            Feature.TORQUE_MOTOR: (
                isinstance(hinge.motor, TorqueMotor),
                "a torque motor",
            ),
        }
        for feature, (value, noun) in terms.items():
            if value:
                yield (
                    feature,
                    f"the joint of {name!r} has {noun}, which this backend does not build",
                )
