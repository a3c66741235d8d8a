"""Faults that are generated from the contract: a quantity of a scene or of a call, times a kind of fault.

A quantity is a numeric field of a part of a scene (found by reflection, so that a new field gets faults of its own), or
what a call passes on. A *class* is a quantity and a kind of fault. The words with which a diagnosis names a quantity
are stated here, before any run. A class is held out while checks are written when the SHA-256 digest of its name is
odd (`is_held_out`).
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from mutations.generated_batches import batch_faults
from mutations.generated_calls import (
    buffers,
    call_changes,
    command,
    drive,
    engine,
    engine_changes,
    gravity_of_last,
    kept,
    report,
    settings,
    time_faults,
    wrench,
)
from mutations.generated_fields import field_variants, scene_edit, switched
from mutations.generated_pairs import pair_faults
from mutations.mutant import Fault, Passed

KINDS = (
    "scale",
    "offset",
    "swap",
    "drop",
    "saturate",
    "threshold",
    "frame",
    "stale",
    "kth",
    "side",
    "rounded",
    "mixed",
    "crowd",
    "delay",
    "alternates",
    "power",
    "neighbour",
    "place",
    "names",
)

# Words, as a regular expression, of which a diagnosis that names the quantity has one.
WORDS: Mapping[str, str] = {
    "Scene.gravity_m_per_s2": "gravity",
    "RigidBody.mass_kg": r"\bmass",
    "RigidBody.inertia_kg_m2": "inertia",
    "RigidBody.linear_velocity_m_per_s": r"start velocit|velocity|at rest|speed",
    "RigidBody.angular_velocity_rad_per_s": r"angular velocit|rotation|spin|turns",
    "Box.size_m": r"size|edges|inertia does not follow|shape",
    "Sphere.radius_m": r"radius|size",
    "Cylinder.radius_m": r"radius|size|shape",
    "Cylinder.length_m": r"length|size|shape",
    "Capsule.radius_m": r"radius|size|compound|shape",
    "Capsule.length_m": r"length|size|compound|shape",
    "Ellipsoid.radii_m": r"radii|size|compound|shape",
    "ConvexUnion.pieces_m": r"union|pieces|vertices|shape|size|solid",
    "Compound.parts": r"compound|parts|shape",
    "Pose.position_m": r"position|place|anchor|centre|origin",
    "Pose.quaternion": r"orientation|quaternion|frame|axis|normal|turned|rotat",
    "Contact.friction": r"friction",
    "Contact.restitution": r"restitution|rebound",
    "Contact.torsion_m": r"torsion",
    "Contact.rolling_m": r"rolling",
    "Contact.pair": r"contact|collide|falls through|touch|pair|rebound|no friction",
    "Hinge.anchor_m": r"anchor|hinge",
    "Hinge.axis": r"axis|hinge",
    "Hinge.joint": r"hinge|joint|anchor|falls",
    "BodyHinge.anchor_m": r"anchor|hinge",
    "BodyHinge.axis": r"axis|hinge",
    "BodyHinge.joint": r"hinge|joint|anchor",
    "JointDynamics.dry_friction_n_m": r"dry|friction of the joint|friction at rest|friction",
    "JointDynamics.viscous_friction_n_m_s_per_rad": r"viscous|damp",
    "JointDynamics.armature_kg_m2": r"armature|rotor|inertia",
    "JointDynamics.backlash_rad": r"backlash|play",
    "Servo.kp_n_m_per_rad": r"servo|kp|gain",
    "Servo.kv_n_m_s_per_rad": r"servo|kv|gain|damp",
    "Servo.torque_limit_n_m": r"limit",
    "Servo.delay_s": r"delay|late",
    "TorqueMotor.delay_s": r"delay|late",
    "Hinge.limits_rad": r"limit",
    "Slider.axis": r"axis|slider",
    "Slider.limits_m": r"limit",
    "Slider.joint": r"line|slider",
    "BallJoint.anchor_m": r"anchor|joint",
    "Tether.anchor_m": r"anchor|string",
    "Tether.length_m": r"string|length",
    "Tether.joint": r"string|missing",
    "Cloth.size_m": r"size|edges",
    "Cloth.mass_kg": r"mass|weight|density",
    "Cloth.areal_density_kg_per_m2": r"mass|weight|density",
    "Cloth.thickness_m": r"thick|floats|sinks",
    "Cloth.stretch_stiffness_n_per_m": r"K_s|stretch",
    "Cloth.shear_stiffness_n_per_m": r"K_sh|shear",
    "Cloth.bend_stiffness_n_m_per_rad": r"bend|K_theta",
    "SoftBody.mass_kg": r"mass|weight|density",
    "SoftBody.young_modulus_pa": r"Young|stiff|\bE\b|modul",
    "SoftBody.poisson_ratio": r"Poisson|nu",
    "Rope.length_m": r"length",
    "Rope.radius_m": r"radius|thick",
    "Rope.mass_kg": r"mass|weight",
    "Rope.young_modulus_pa": r"stretch|stiff|long",
    "Rod.length_m": r"length",
    "Rod.radius_m": r"radius|section|bend",
    "Rod.mass_kg": r"mass|weight",
    "Rod.young_modulus_pa": r"Young|stiff|bend|\bE\b",
    "Rod.poisson_ratio": r"Poisson|nu|twist",
    "Region.depth_m": r"depth|clamp",
    "Attachment.pair": r"attach",
    "Air.density_kg_per_m3": r"air|drag|density",
    "Air.normal_coefficient": r"pressure|normal|drag",
    "Air.tangential_coefficient": r"friction|tangential",
    "Air.lift_coefficient": r"lift",
    "Air.wind_m_per_s": r"wind|relative velocity",
    "drive.position": r"driven|plate|drive",
    "drive.orientation": r"driven|plate|drive",
    "drive.velocity": r"driven.*velocity|velocity.*driven|drive|plate",
    "drive.spin": r"angular velocit|drive|turn",
    "drive.acceleration": r"acceleration that drive|drive|jolt",
    "drive.spin_acceleration": r"acceleration that drive|drive|jolt",
    "wrench.force": r"force|wrench",
    "wrench.torque": r"torque|wrench|inertia does not follow",
    "command.value": r"command|motor|servo|torque",
    "report.position": r"position|report",
    "report.orientation": r"orientation|quaternion",
    "report.velocity": r"reported|velocity",
    "report.spin": r"angular velocit|report",
    "report.nodes": r"node",
    "engine.velocity": r"limit of speed|damp|sleep|speed|energy|momentum",
    "engine.spin": r"damp|limits|angular|torsional|rolling|energy|momentum",
    "engine.hinge_rate": r"damp|limit|joint|hinge|energy|friction",
    "time.interval": r"time|step",
    "settings.timestep_s": r"settings|timestep|step",
    "reset.velocity": r"reset|start",
    "reset.wrench": r"reset|wrench",
    "reset.command": r"reset|command",
    "reset.pose": r"reset|start",
    "restore.velocity": r"restor|state",
    "restore.wrench": r"restor|wrench|state",
    "restore.command": r"restor|command|state",
    "restore.pose": r"restor|state",
    "buffer.states": r"buffer|new array|copy|same array",
    "buffer.nodes": r"buffer|new array|copy|same array",
    "batch.RigidBody.mass_kg": r"constants|mass",
    "batch.RigidBody.linear_velocity_m_per_s": r"start|velocity",
    "batch.RigidBody.angular_velocity_rad_per_s": r"start|velocity|spin",
    "batch.Pose.position_m": r"start|position",
    "batch.Contact.friction": r"constants|friction|contact",
    "batch.Contact.restitution": r"constants|restitution|contact",
    "batch.drive": r"driv",
    "batch.command": r"command",
    "batch.wrench": r"wrench|push|force",
    "batch.states": r"read|values of world|reported",
    "batch.restart": r"restart",
    "batch.reset": r"reset",
    "batch.advance": r"advance|time|late|step",
}
DEFORMABLE = re.compile(
    r"^(Cloth|SoftBody|Rope|Rod|Region|Attachment|Air|report\.nodes|buffer\.nodes)\b|deformable"
)
"""Quantities that scenes without deformable bodies do not have."""


@dataclass(frozen=True, kw_only=True)
class Generated:
    """A generated fault.

    Attributes:
        quantity: What is wrong.
        kind: How.
        variant: Which of the faults of this class.
        fault: The fault.
    """

    quantity: str
    kind: str
    variant: str
    fault: Fault

    @property
    def id(self) -> str:
        """Its name."""
        return f"{self.quantity}:{self.kind}:{self.variant}"

    @property
    def is_held_out(self) -> bool:
        """Whether its class is held out while checks are written."""
        return is_held_out(self.quantity, self.kind)

    @property
    def is_deformable(self) -> bool:
        """Whether only scenes with deformable bodies can show it."""
        return bool(DEFORMABLE.search(self.id))

    @property
    def part(self) -> str:
        """What must be there to show it: `rigid` or `deformable` bodies, or `batches` of worlds."""
        if self.fault.worlds is not None:
            return "batches"
        return "deformable" if self.is_deformable else "rigid"


def is_held_out(quantity: str, kind: str) -> bool:
    """Return whether a class is held out: its digest is odd."""
    return hashlib.sha256(f"{quantity}:{kind}".encode()).digest()[-1] % 2 == 1


# --- all of them -----------------------------------------------------------------------------------------------------


VECTORS = (
    *("size_m", "radii_m", "position_m", "anchor_m", "axis"),
    *("linear_velocity_m_per_s", "angular_velocity_rad_per_s", "wind_m_per_s"),
)
EXAMPLES: Mapping[str, Any] = {
    **dict.fromkeys(VECTORS, (0.1, 0.2, 0.3)),
    **dict.fromkeys(("limits_rad", "limits_m"), (-0.1, 0.2)),
    "quaternion": (1.0, 0.0, 0.0, 0.0),
    "pieces_m": (((0.1, 0.2, 0.3),),),
}
"""Values of the fields that are not numbers, but of `Cloth.size_m`."""


def _fields() -> Iterator[tuple[str, str, Any]]:
    """Yield part, field and an example of all fields with words."""
    for name in WORDS:
        owner, _, field = name.partition(".")
        if owner[0].isupper() and field not in ("pair", "joint", "parts"):
            example = EXAMPLES.get(field, 1.0)
            yield owner, field, (0.1, 0.2) if name == "Cloth.size_m" else example


OF_BODIES = ("frame", "kth", "crowd")
"""Kinds of faults that calls without a body do not have."""

CALLS: tuple[tuple[str, Callable[..., type[Passed]], Mapping[str, float]], ...] = (
    (
        "drive",
        drive,
        {
            "position": 0.3,
            "orientation": 0.5,
            "velocity": 0.5,
            "spin": 2.0,
            "acceleration": 1.0,
            "spin_acceleration": 4.0,
        },
    ),
    ("wrench", wrench, {"force": 1.0, "torque": 0.05}),
    ("command", command, {"value": 0.1}),
    (
        "report",
        report,
        {
            "position": 1.0,
            "orientation": 1.0,
            "velocity": 2.0,
            "spin": 5.0,
            "nodes": 1.0,
        },
    ),
)
"""Calls with their faults, and the usual size of each of their parts."""

NOT_LOST = (("reset", "drop", "wrench"), ("reset", "drop", "command"))
LOST = [
    (when, kind, part)
    for part in ("velocity", "wrench", "command", "pose")
    for when in ("reset", "restore")
    for kind in ("stale", "drop")
    if (when, kind, part) not in NOT_LOST
]
"""Parts of the state that a reset or a restore keeps or loses; that a reset loses wrenches and commands is right."""


def generated() -> dict[str, Generated]:
    """Return all generated faults by id."""
    found: dict[str, Generated] = {}
    for quantity, kind, variant, how in _faults():
        one = Generated(
            quantity=quantity,
            kind=kind,
            variant=variant,
            fault=Fault(
                what=f"{quantity}, {kind} {variant}",
                caught_by="",
                says=WORDS[quantity],
                **how,
            ),
        )
        found[one.id] = one
    return found


def _faults() -> Iterator[tuple[str, str, str, dict[str, Any]]]:  # noqa: C901
    """Yield quantity, kind and variant of each fault, and its fields."""
    for owner, field, example in _fields():
        for one in field_variants(owner, field, example):
            change = scene_edit(owner, field, one.edit)
            how: dict[str, Any] = {"scene": change}
            if one.condition:
                how = of_mujoco(switched(one.condition, change))
            yield f"{owner}.{field}", one.kind, one.name, how
    for quantity, kind, variant, change in pair_faults():
        yield quantity, kind, variant, {"scene": change}
    yield from _call_faults()
    for part, unit in {"velocity": 4.0, "spin": 30.0, "hinge_rate": 4.0}.items():
        for kind, variant, rate in engine_changes(unit):
            yield f"engine.{part}", kind, variant, of_mujoco(engine(part, rate))
    for kind, variant, simulation in time_faults():
        yield "time.interval", kind, variant, {"simulation": simulation}
    yield from _lost()
    for quantity, kind, variant, worlds in batch_faults():
        yield quantity, kind, variant, {"worlds": worlds}
    for what in ("states", "nodes"):
        yield f"buffer.{what}", "stale", "reused", {"simulation": buffers(what)}
    for factor in (0.1, 0.5, 2.0):
        how = {"simulation": settings(factor)}
        yield "settings.timestep_s", "scale", f"{factor:g}", how
    how = of_mujoco(gravity_of_last())
    yield "Scene.gravity_m_per_s2", "stale", "last-built", how


def of_mujoco(simulation: type[Passed]) -> dict[str, Any]:
    """Return the fields of a fault that only MuJoCo can have."""
    return {"simulation": simulation, "engine": "mujoco"}


def _lost() -> Iterator[tuple[str, str, str, dict[str, Any]]]:
    for when, kind, part in LOST:
        quantity, how = f"{when}.{part}", f"{when}-{kind}"
        yield quantity, kind, "all", of_mujoco(kept(part, how))
        yield quantity, "kth", f"last-{kind}", of_mujoco(kept(part, how, "last"))


def _call_faults() -> Iterator[tuple[str, str, str, dict[str, Any]]]:
    for call, maker, units in CALLS:
        for part, unit in units.items():
            for kind, variant, change in call_changes(unit):
                if part not in ("value", "nodes") or kind not in OF_BODIES:
                    simulation = maker(part, change)
                    yield f"{call}.{part}", kind, variant, {"simulation": simulation}
