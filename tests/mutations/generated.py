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
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cache
from typing import Any

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs.backends import Simulation
from gauge_envs.errors import GaugeError
from gauge_envs.scene import (
    Attachment,
    BodyHinge,
    Box,
    Contact,
    Hinge,
    Motion,
    Scene,
    Tether,
)
from gauge_envs.scene.drivers import Driver
from gauge_envs.scene.geometry import vector
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


def is_held_out(quantity: str, kind: str) -> bool:
    """Return whether a class is held out: its digest is odd."""
    return hashlib.sha256(f"{quantity}:{kind}".encode()).digest()[-1] % 2 == 1


# --- edits of scenes -------------------------------------------------------------------------------------------------

Edit = Callable[[Any, Any, Any, int, Scene], Any]
"""Value, part, all values of the field, number of the value, scene -> new value."""
SKIPPED = (Driver,)


def _leaves(part: Any, owner: str, field: str) -> Iterator[tuple[Any, Any]]:
    """Yield each part of a type in a tree, with its value of a field."""
    if isinstance(part, SKIPPED):
        return
    if is_dataclass(part):
        if type(part).__name__ == owner and getattr(part, field) is not None:
            yield part, getattr(part, field)
        for one in fields(part):
            if one.init:
                yield from _leaves(getattr(part, one.name), owner, field)
    elif isinstance(part, tuple):
        for one in part:
            yield from _leaves(one, owner, field)


def _rewritten(
    part: Any, owner: str, field: str, change: Callable[[Any, Any], Any]
) -> Any:
    if isinstance(part, SKIPPED):
        return part
    if is_dataclass(part):
        changes = {}
        for one in fields(part):
            if one.init:
                old = getattr(part, one.name)
                new = _rewritten(old, owner, field, change)
                if new is not old:
                    changes[one.name] = new
        if type(part).__name__ == owner and getattr(part, field) is not None:
            changes[field] = change(part, getattr(part, field))
        return replace(part, **changes) if changes else part
    if isinstance(part, tuple):
        made = tuple(_rewritten(one, owner, field, change) for one in part)
        return part if all(a is b for a, b in zip(made, part, strict=True)) else made
    return part


def scene_edit(owner: str, field: str, edit: Edit) -> Callable[[Scene], Scene]:
    """Return a change of a field of all parts of a type; a scene that it would make invalid stays as it is."""

    def changed(scene: Scene) -> Scene:
        values = [value for _, value in _leaves(scene, owner, field)]
        numbers = iter(range(len(values)))
        try:
            return _rewritten(
                scene,
                owner,
                field,
                lambda part, value: edit(value, part, values, next(numbers), scene),
            )
        except (GaugeError, ValueError, KeyError, IndexError):
            return scene

    return changed


def _unit(values: np.ndarray) -> tuple[float, ...]:
    return tuple((values / np.linalg.norm(values)).tolist())


def _is_direction(field: str) -> bool:
    return field == "axis"


def _mapped(value: Any, function: Callable[[np.ndarray], Any]) -> Any:
    """Return a number, a vector, or a tree of vectors with a function applied to each."""
    if isinstance(value, tuple) and value and isinstance(value[0], tuple):
        return tuple(_mapped(one, function) for one in value)
    if isinstance(value, tuple):
        return tuple(
            np.asarray(function(np.array(value, dtype=float)), dtype=float).tolist()
        )
    return float(function(np.array(value, dtype=float)))


OFFSETS = {
    "_m": (2e-3, 1e-2),
    "_kg": (0.02, 0.1),
    "_m_per_s": (0.02, 0.2),
    "_rad_per_s": (0.05, 0.5),
    "_m_per_s2": (0.02, 0.2),
    "_s": (0.01, 0.05),
    "_rad": (0.002, 0.01),
}
"""Small and large additions to a field, by the end of its name."""


def _offset(field: str, value: Any, large: bool) -> float:
    for end in sorted(OFFSETS, key=len, reverse=True):
        if field.endswith(end) and "_per_" not in field.removesuffix(end):
            return OFFSETS[end][large]
    largest = (
        float(np.abs(np.array(value, dtype=float)).max())
        if not isinstance(value, tuple)
        else 1.0
    )
    return (0.05, 0.2)[large] * (largest or 1.0)


def _tilted(value: np.ndarray, degrees: float) -> np.ndarray:
    across = np.cross(value, [0.3, -0.5, 0.8])
    return Rotation.from_rotvec(
        np.radians(degrees) * across / np.linalg.norm(across)
    ).apply(value)


def _turned_quaternion(value: Any, turn: Rotation) -> tuple[float, ...]:
    return tuple(
        (turn * Rotation.from_quat(value, scalar_first=True))
        .as_quat(scalar_first=True)
        .tolist()
    )


LEAN = Rotation.from_rotvec(np.radians(5.0) * np.array([0.6, 0.0, 0.8]))


def _off(field: str, value: Any, strength: float) -> Any:
    """Return a value that is wrong in a way that suits it: scaled, tilted or turned."""
    if field == "quaternion":
        return _turned_quaternion(
            value,
            Rotation.from_rotvec(
                LEAN.as_rotvec() * (2.0 if strength in (0.5, 1.6) else 1.0)
            ),
        )
    if _is_direction(field):
        return vector(
            _tilted(np.array(value), 4.0 if strength in (0.8, 1.25) else 15.0)
        )
    if field == "poisson_ratio":
        return min(strength * value, 0.45)
    return _mapped(value, lambda x: strength * x)


def _frame_of(part: Any, scene: Scene) -> Rotation:
    """Return the orientation of the body that a part belongs to."""
    name = (
        getattr(part, "name", None)
        or getattr(part, "body", None)
        or getattr(part, "first", None)
    )
    pose = next(
        (one.pose for one in (*scene.bodies, *scene.deformables) if one.name == name),
        None,
    )
    return pose.rotation if pose is not None else Rotation.identity()


def _field_variants(  # noqa: C901  # one branch for each kind of fault
    owner: str, field: str, example: Any
) -> Iterator[tuple[str, str, Edit, str]]:
    """Yield kind, variant, edit and condition of the faults of a field."""
    is_vector = isinstance(example, tuple) and not isinstance(example[0], tuple)
    is_tree = isinstance(example, tuple) and not is_vector
    is_turn = field == "quaternion"
    for strength in (0.5, 0.8, 1.25, 1.6):
        if not is_turn and not _is_direction(field):
            yield (
                "scale",
                f"{strength:g}",
                lambda v, p, a, n, s, k=strength: _off(field, v, k),
                "",
            )
        elif strength in (0.5, 0.8):
            yield (
                "offset",
                f"{strength:g}",
                lambda v, p, a, n, s, k=strength: _off(field, v, k),
                "",
            )
    for large in (False, True):
        if is_vector and not is_turn and not _is_direction(field):
            for axis in range(len(example)):
                yield (
                    "offset",
                    f"{axis}-{large}",
                    lambda v, p, a, n, s, x=axis, big=large: tuple(
                        one + (_offset(field, v, big) if i == x else 0.0)
                        for i, one in enumerate(v)
                    ),
                    "",
                )
        elif not is_vector and not is_tree:
            yield (
                "offset",
                f"{large}",
                lambda v, p, a, n, s, big=large: v + _offset(field, v, big),
                "",
            )
    if is_tree:
        yield (
            "offset",
            "x",
            lambda v, p, a, n, s: _mapped(v, lambda x: [x[0] + 3e-3, *x[1:]]),
            "",
        )
        yield "drop", "last", lambda v, p, a, n, s: v[:-1] or v, ""
        yield "drop", "but-first", lambda v, p, a, n, s: v[:1], ""
        yield (
            "swap",
            "x-y",
            lambda v, p, a, n, s: tuple(
                tuple((y, x, z) for x, y, z in piece) for piece in v
            ),
            "",
        )
    if is_vector and not is_turn:
        for one, other in ((0, 1), (1, 2), (0, 2)):
            if other < len(example):
                yield (
                    "swap",
                    f"{one}-{other}",
                    lambda v, p, a, n, s, i=one, j=other: tuple(
                        v[j] if k == i else v[i] if k == j else v[k]
                        for k in range(len(v))
                    ),
                    "",
                )
    if is_turn:
        yield "swap", "xyzw", lambda v, p, a, n, s: (v[3], *v[:3]), ""
        yield "frame", "inverse", lambda v, p, a, n, s: (v[0], -v[1], -v[2], -v[3]), ""
        yield "drop", "identity", lambda v, p, a, n, s: (1.0, 0.0, 0.0, 0.0), ""
    if not is_vector and not is_tree:
        yield (
            "swap",
            "first-last",
            lambda v, p, a, n, s: a[-1] if n == 0 else a[0] if n == len(a) - 1 else v,
            "",
        )
        yield (
            "drop",
            "none",
            lambda v, p, a, n, s: (
                None if field in ("inertia_kg_m2", "torque_limit_n_m") else 1e-3 * v
            ),
            "",
        )
        yield (
            "saturate",
            "most",
            lambda v, p, a, n, s: min(v, _typical(owner, field)),
            "",
        )
        yield (
            "saturate",
            "least",
            lambda v, p, a, n, s: max(v, _typical(owner, field)) if v else v,
            "",
        )
    elif is_vector and not is_turn and not _is_direction(field):
        yield (
            "drop",
            "zero",
            lambda v, p, a, n, s: tuple(
                0.0 if "size" not in field and "radii" not in field else 0.05 for _ in v
            ),
            "",
        )
        cap = {"_m_per_s": 0.5, "_rad_per_s": 2.5}.get(
            next((e for e in ("_rad_per_s", "_m_per_s") if field.endswith(e)), ""), 0.08
        )
        yield (
            "saturate",
            "most",
            lambda v, p, a, n, s: tuple(float(np.clip(one, -cap, cap)) for one in v),
            "",
        )
    if is_vector and not is_turn and "size" not in field and "radii" not in field:
        yield (
            "frame",
            "body",
            lambda v, p, a, n, s: vector(_frame_of(p, s).apply(v)),
            "",
        )
        yield (
            "frame",
            "world",
            lambda v, p, a, n, s: vector(_frame_of(p, s).apply(v, inverse=True)),
            "",
        )
    yield "stale", "first-for-all", lambda v, p, a, n, s: a[0], ""
    if not is_turn and not _is_direction(field):
        for bits in (2, 4):
            yield (
                "rounded",
                f"{bits}-bits",
                lambda v, p, a, n, s, b=bits: _mapped(v, lambda x: _rounded(x, b)),
                "",
            )
    if not is_tree and not is_turn:
        yield "mixed", "half", lambda v, p, a, n, s: _mixed(field, v, a), ""
    for count in (2, 4):
        for strength in (0.5, 1.25):
            yield (
                "crowd",
                f"above-{count}-bodies-{strength:g}",
                lambda v, p, a, n, s, m=count, k=strength: (
                    _off(field, v, k) if len(s.bodies) > m else v
                ),
                "",
            )
    for number, name in ((0, "first"), (1, "second"), (2, "third"), (-1, "last")):
        for strength in (0.5, 1.25):
            yield (
                "kth",
                f"{name}-{strength:g}",
                lambda v, p, a, n, s, m=number, k=strength: (
                    _off(field, v, k)
                    if n == (m if m >= 0 else len(a) - 1) and len(a) > 1
                    else v
                ),
                "",
            )
    for condition in (
        "after-1s",
        "after-2s",
        "above-3m/s",
        "above-8m/s",
        "above-12m/s",
        "below-0.1m/s",
        "above-30rad/s",
    ):
        if field not in (
            "quaternion",
            "linear_velocity_m_per_s",
            "angular_velocity_rad_per_s",
        ):
            yield (
                "threshold",
                condition,
                lambda v, p, a, n, s: _off(field, v, 0.5),
                condition,
            )
    sides: dict[str, Callable[[Any, Any, Scene], bool]] = {}
    if owner in (
        "Box",
        "Sphere",
        "Cylinder",
        "ConvexUnion",
        "Compound",
        "Capsule",
        "Ellipsoid",
    ):
        for motion in Motion:
            sides[motion.value] = lambda v, p, s, m=motion: _motion_of_shape(p, s) is m
    elif owner == "Contact":
        sides["fixed-first"] = lambda v, p, s: (
            _motion(p.first, s) in (Motion.FIXED, Motion.KINEMATIC)
        )
        sides["dynamic-pair"] = lambda v, p, s: (
            {_motion(p.first, s), _motion(p.second, s)} == {Motion.DYNAMIC}
        )
        sides["driven"] = lambda v, p, s: (
            Motion.KINEMATIC in (_motion(p.first, s), _motion(p.second, s))
        )
        sides["deformable"] = lambda v, p, s: (
            None in (_motion(p.first, s), _motion(p.second, s))
        )
    elif is_vector and not is_turn:
        sides["negative"] = lambda v, p, s: min(v) < 0.0
        sides["positive"] = lambda v, p, s: max(v) > 0.0 and min(v) >= 0.0
    elif owner == "RigidBody":
        sides["hinged"] = lambda v, p, s: (
            p.name in {*s.hung, *(h.second for h in s.body_hinges)}
        )
        sides["free"] = lambda v, p, s: (
            p.name not in {*s.hung, *(h.second for h in s.body_hinges)}
        )
    for name, holds in sides.items():
        for strength in (0.5, 0.8):
            yield (
                "side",
                f"{name}-{strength:g}",
                lambda v, p, a, n, s, is_side=holds, k=strength: (
                    _off(field, v, k) if is_side(v, p, s) else v
                ),
                "",
            )


def _rounded(values: np.ndarray, bits: int) -> np.ndarray:
    """Return values with some binary digits behind the first."""
    mantissa, exponent = np.frexp(values)
    return np.ldexp(np.round(np.ldexp(mantissa, bits + 1)), exponent - bits - 1)


def _mixed(field: str, value: Any, every: list[Any]) -> Any:
    """Return the mean of a value and of the mean of all values of the field."""
    middle = np.mean(np.array(every, dtype=float), axis=0)
    mixed = 0.5 * (np.array(value, dtype=float) + middle)
    if _is_direction(field):
        return _unit(mixed)
    return tuple(mixed.tolist()) if isinstance(value, tuple) else float(mixed)


def _motion(group: tuple[str, ...], scene: Scene) -> Motion | None:
    """Return how the first body of a group moves; None for a deformable one."""
    return next((one.motion for one in scene.bodies if one.name == group[0]), None)


def _motion_of_shape(shape: Any, scene: Scene) -> Motion | None:
    for one in scene.bodies:
        parts = (part.shape for part in getattr(one.shape, "parts", ()))
        if one.shape is shape or any(part is shape for part in parts):
            return one.motion
    return None


@cache
def _typical(owner: str, field: str) -> float:
    """Return the median of a field in the suite's scenes, or of a plausible value where none has it."""
    from gauge_envs.experiments.resolve import load_experiment
    from gauge_envs.experiments.variants import variants

    values = [
        value
        for variant in variants()
        for _, value in _leaves(load_experiment(variant.name).scene, owner, field)
        if value
    ]
    return float(np.median(values)) if values else 0.02


# --- conditions ------------------------------------------------------------------------------------------------------


def _holds(condition: str, data: mujoco.MjData) -> bool:
    when, value = condition.split("-")
    number = float(re.match(r"[\d.]+", value).group())
    if value.endswith("rad/s"):
        return bool(np.abs(data.qvel).max(initial=0.0) > number)
    if when == "after":
        return data.time > number
    speed = float(np.abs(data.qvel).max(initial=0.0))
    return speed > number if when == "above" else speed < number


def switched(  # noqa: C901
    condition: str, edit: Callable[[Scene], Scene]
) -> Callable[..., Simulation]:
    """Return a simulation of MuJoCo whose constants are those of an edited scene while a condition holds."""

    class Switched(Passed):
        def __init__(self, inner, scene):
            super().__init__(inner, scene)
            changed = edit(scene)
            self._arrays = []
            if changed is scene or changed == scene:
                return
            try:
                faulty = _mujoco().build(changed, _asked(inner.settings)).model
            except (GaugeError, ValueError):
                return
            for name in dir(inner.model):
                if name.startswith("_"):
                    continue
                here, there = getattr(inner.model, name), getattr(faulty, name, None)
                are_arrays = isinstance(here, np.ndarray) and isinstance(
                    there, np.ndarray
                )
                if are_arrays and here.shape == there.shape and (here != there).any():
                    self._arrays.append((here, here.copy(), there.copy()))
            here, there = inner.model.opt.gravity, faulty.opt.gravity
            if not np.array_equal(here, there):
                self._arrays.append((here, here.copy(), there.copy()))

        def advance(self, seconds):
            if self._arrays:
                is_on = _holds(condition, self.inner.data)
                for array, right, wrong in self._arrays:
                    array[...] = wrong if is_on else right
            super().advance(seconds)

    return Switched


def _asked(settings: Mapping[str, Any]) -> dict[str, Any]:
    return {"preset": settings["preset"]}


def _mujoco() -> Any:
    """Return MuJoCo's backend."""
    from gauge_envs.backends import backend

    return backend("mujoco")


# --- pairs and joints ------------------------------------------------------------------------------------------------


def _pairs(scene: Scene) -> list[tuple[Contact, tuple[str, str]]]:
    return [
        (one, pair) for one in scene.contacts for pair in scene.colliding_pairs(one)
    ]


def _without_pairs(
    chosen: Callable[[int, int, Contact, tuple[str, str], Scene], bool],
) -> Callable[[Scene], Scene]:
    def changed(scene: Scene) -> Scene:
        pairs = _pairs(scene)
        left = [
            (contact, pair)
            for number, (contact, pair) in enumerate(pairs)
            if not chosen(number, len(pairs), contact, pair, scene)
        ]
        if len(left) == len(pairs):
            return scene
        contacts = tuple(
            replace(contact, first=(one,), second=(other,))
            for contact, (one, other) in left
        )
        return replace(scene, contacts=contacts)

    return changed


def _kind(name: str, scene: Scene) -> str:
    for one in scene.deformables:
        if one.name == name:
            return type(one).__name__
    return scene.body(name).motion.value


def _crossed(pair: tuple[str, str], scene: Scene) -> bool:
    if any(one in {body.name for body in scene.deformables} for one in pair):
        return False
    bodies = [scene.body(name) for name in pair]
    if not all(isinstance(one.shape, Box) for one in bodies):
        return False
    apart = np.abs(
        (bodies[0].pose.rotation.inv() * bodies[1].pose.rotation).as_matrix()
    )
    return bool(((apart > np.cos(np.radians(2.0))).sum()) <= 1) and bool(
        (apart < np.cos(np.radians(88.0))).sum() < 4
    )


def _pair_faults() -> Iterator[tuple[str, str, str, Callable[[Scene], Scene]]]:  # noqa: C901
    for number, name in ((0, "first"), (1, "second"), (-1, "last")):
        yield (
            "Contact.pair",
            "kth",
            name,
            _without_pairs(
                lambda n, count, c, pair, s, m=number: (
                    count > 1 and n == (m if m >= 0 else count - 1)
                )
            ),
        )
    yield (
        "Contact.pair",
        "drop",
        "all",
        _without_pairs(lambda n, count, c, pair, s: True),
    )
    yield (
        "Contact.pair",
        "frame",
        "crossed-boxes",
        _without_pairs(lambda n, count, c, pair, s: _crossed(pair, s)),
    )
    for soft in ("Cloth", "SoftBody", "Rope", "Rod"):
        for other in ("dynamic", "fixed", "kinematic", soft):
            yield (
                "Contact.pair",
                "side",
                f"deformable-{soft}-{other}",
                _without_pairs(
                    lambda n, count, c, pair, s, one=soft, two=other: (
                        sorted(_kind(x, s) for x in pair) == sorted((one, two))
                    )
                ),
            )
    for one, two in (
        ("dynamic", "dynamic"),
        ("dynamic", "fixed"),
        ("dynamic", "kinematic"),
    ):
        yield (
            "Contact.pair",
            "side",
            f"{one}-{two}",
            _without_pairs(
                lambda n, count, c, pair, s, x=one, y=two: (
                    sorted(_kind(z, s) for z in pair) == sorted((x, y))
                )
            ),
        )
    for side in ("fixed-first", "dynamic-first"):
        yield (
            "Contact.pair",
            "side",
            side,
            _without_pairs(
                lambda n, count, c, pair, s, x=side: (
                    (_kind(pair[0], s) == "dynamic") == (x == "dynamic-first")
                )
            ),
        )
    for name, kind, owner in (
        ("joints", Hinge, "Hinge.joint"),
        ("joints", Tether, "Tether.joint"),
        ("body_hinges", BodyHinge, "BodyHinge.joint"),
        ("attachments", Attachment, "Attachment.pair"),
    ):
        for number, variant, how in (
            (None, "all", "drop"),
            (0, "first", "kth"),
            (-1, "last", "kth"),
        ):

            def changed(scene, name=name, kind=kind, number=number):
                parts = [one for one in getattr(scene, name) if isinstance(one, kind)]
                if not parts or (number is not None and len(parts) < 2):
                    return scene
                gone = parts if number is None else [parts[number]]
                return replace(
                    scene,
                    **{
                        name: tuple(
                            one for one in getattr(scene, name) if one not in gone
                        )
                    },
                )

            yield owner, how, variant, changed
    for motion in ("dynamic", "fixed", "kinematic"):

        def unattached(scene, motion=motion):
            left = tuple(
                one for one in scene.attachments if _kind(one.to, scene) != motion
            )
            return (
                scene
                if len(left) == len(scene.attachments)
                else replace(scene, attachments=left)
            )

        yield "Attachment.pair", "side", motion, unattached


# --- calls -----------------------------------------------------------------------------------------------------------


def _call_changes(unit: float) -> Iterator[tuple[str, str, Callable[..., Any]]]:
    """Yield kind, variant and change of a vector that a call passes."""
    for factor in (0.5, 0.8, 1.25):
        yield "scale", f"{factor:g}", lambda v, c, k=factor: k * v
    for axis in range(3):
        yield (
            "offset",
            f"{axis}",
            lambda v, c, i=axis: v + 0.05 * unit * np.eye(len(v))[min(i, len(v) - 1)],
        )
    for i, j in ((0, 1), (1, 2)):
        yield (
            "swap",
            f"{i}-{j}",
            lambda v, c, a=i, b=j: (
                v[[b if n == a else a if n == b else n for n in range(len(v))]]
                if len(v) > b
                else v[::-1]
            ),
        )
    yield "drop", "all", lambda v, c: 0.0 * v
    for axis in range(3):
        yield (
            "drop",
            f"axis-{axis}",
            lambda v, c, i=axis: np.where(np.arange(len(v)) == i, 0.0, v),
        )
    for cap in (0.3, 1.0):
        yield (
            "saturate",
            f"{cap:g}",
            lambda v, c, m=cap: np.clip(v, -m * unit, m * unit),
        )
    for cap in (0.3, 1.0, 3.0):
        yield (
            "threshold",
            f"above-{cap:g}",
            lambda v, c, m=cap: 0.5 * v if np.linalg.norm(v) > m * unit else v,
        )
    for time_s in (1.0, 2.0):
        yield (
            "threshold",
            f"after-{time_s:g}",
            lambda v, c, m=time_s: 0.5 * v if c["time"] > m else v,
        )
    yield (
        "frame",
        "body",
        lambda v, c: c["rotation"].apply(v, inverse=True) if len(v) == 3 else v,
    )
    yield "frame", "world", lambda v, c: c["rotation"].apply(v) if len(v) == 3 else v
    yield "stale", "one-call", lambda v, c: c["before"]
    for number, name in ((0, "first"), (1, "second"), (-1, "last")):
        yield (
            "kth",
            name,
            lambda v, c, m=number: (
                0.7 * v
                if c["count"] > 1 and c["number"] == (m if m >= 0 else c["count"] - 1)
                else v
            ),
        )
    yield "side", "negative", lambda v, c: np.where(v < 0.0, 0.5 * v, v)
    yield "side", "positive", lambda v, c: np.where(v > 0.0, 0.5 * v, v)
    yield "rounded", "4-bits", lambda v, c: _rounded(v, 4)
    yield "mixed", "half", lambda v, c: 0.5 * (v + v.mean())
    yield "mixed", "calls", lambda v, c: 0.5 * (v + c["before"])
    yield "crowd", "above-2", lambda v, c: 0.7 * v if c["count"] > 2 else v


class _Calls(Passed):
    """A simulation that counts its time and remembers what was passed before."""

    def __init__(self, inner, scene):
        super().__init__(inner, scene)
        self.time_s, self.before = 0.0, {}

    def reset(self, seed):
        self.time_s, self.before = 0.0, {}
        super().reset(seed)

    def advance(self, seconds):
        super().advance(seconds)
        self.time_s += seconds

    def state(self):
        return super().state(), self.time_s, dict(self.before)

    def restore(self, state):
        super().restore(state[0])
        self.time_s, self.before = state[1], dict(state[2])

    def changed(self, change, key, value, rotation=None, number=0, count=1):
        """Return a changed value of a call."""
        value = np.array(value, dtype=float)
        context = {
            "rotation": rotation or Rotation.identity(),
            "number": number,
            "count": count,
            "time": self.time_s,
        }
        context["before"] = self.before.get(key, value)
        self.before[key] = value
        return np.asarray(change(value, context))


def _drive(part: str, change: Any) -> type[Passed]:
    class Drives(_Calls):
        def drive(self, body, pose, velocity, acceleration):
            names = [
                one.name for one in self.scene.bodies if one.motion is Motion.KINEMATIC
            ]
            where = {
                "rotation": pose.rotation,
                "number": names.index(body),
                "count": len(names),
            }
            rates = [np.array(velocity), np.array(acceleration)]
            place, which = {
                "velocity": (0, slice(0, 3)),
                "spin": (0, slice(3, 6)),
                "acceleration": (1, slice(0, 3)),
                "spin_acceleration": (1, slice(3, 6)),
            }.get(part, (None, None))
            if place is not None:
                rates[place][which] = self.changed(
                    change, body, rates[place][which], **where
                )
            elif part == "position":
                start = np.array(self.scene.body(body).pose.position_m)
                moved = self.changed(
                    change, body, np.array(pose.position_m) - start, **where
                )
                pose = replace(pose, position_m=vector(start + moved))
            else:
                start = self.scene.body(body).pose.rotation
                turned = self.changed(
                    change, body, (pose.rotation * start.inv()).as_rotvec(), **where
                )
                pose = type(pose).from_rotation(
                    pose.position_m, Rotation.from_rotvec(turned) * start
                )
            super().drive(body, pose, *rates)

    return Drives


def _wrench(part: str, change: Any) -> type[Passed]:
    class Pushes(_Calls):
        def apply_wrench(self, body, wrench):
            names = [one.name for one in self.scene.dynamic_bodies]
            state = self.inner.body_states([body])[0]
            wrench = np.array(wrench, dtype=float)
            which = slice(0, 3) if part == "force" else slice(3, 6)
            wrench[which] = self.changed(
                change,
                body,
                wrench[which],
                Rotation.from_quat(state[3:7], scalar_first=True),
                names.index(body),
                len(names),
            )
            super().apply_wrench(body, wrench)

    return Pushes


def _command(change: Any) -> type[Passed]:
    class Commands(_Calls):
        def command(self, values):
            super().command(self.changed(change, "command", values))

    return Commands


COLUMNS = {
    "position": slice(0, 3),
    "orientation": slice(3, 7),
    "velocity": slice(7, 10),
    "spin": slice(10, 13),
}


def _report(part: str, change: Any) -> type[Passed]:
    class Reports(_Calls):
        def body_states(self, names):
            states = super().body_states(names)
            every = [one.name for one in self.scene.bodies]
            for row, name in zip(states, names, strict=True):
                turn = Rotation.from_quat(row[3:7], scalar_first=True)
                where = (turn, every.index(name), len(every))
                if part == "orientation":
                    changed = self.changed(change, name, turn.as_rotvec(), *where)
                    row[3:7] = Rotation.from_rotvec(changed).as_quat(scalar_first=True)
                else:
                    row[COLUMNS[part]] = self.changed(
                        change, name, row[COLUMNS[part]], *where
                    )
            return states

        def sample_positions(self, names, count, interval_s):
            return Simulation.sample_positions(self, names, count, interval_s)

    return Reports


def _nodes(change: Any) -> type[Passed]:
    class Nodes(_Calls):
        def nodes(self, name):
            found = super().nodes(name)
            middle = found.mean(axis=0)
            changed = self.changed(
                lambda v, c: np.array(
                    [
                        change(row, c | {"before": old})
                        for row, old in zip(v, c["before"], strict=True)
                    ]
                ),
                name,
                found,
            )
            return changed if changed.shape == found.shape else found + 0.0 * middle

    return Nodes


def _engine(part: str, change: Any) -> type[Passed]:
    """Return a simulation of MuJoCo that changes rates after each interval: of free bodies, or of hinges."""

    class Rates(_Calls):
        def advance(self, seconds):
            super().advance(seconds)
            model, data = self.inner.model, self.inner.data
            bodies = list(self.scene.dynamic_bodies)
            for number, one in enumerate(bodies):
                try:
                    joint = model.joint(one.name)
                except KeyError:
                    continue
                free = joint.type[0] == mujoco.mjtJoint.mjJNT_FREE
                if free == (part == "hinge_rate"):
                    continue
                first = int(joint.dofadr[0])
                rows = (
                    data.qvel[first : first + 1]
                    if not free
                    else data.qvel[first : first + 3]
                    if part == "velocity"
                    else data.qvel[first + 3 : first + 6]
                )
                turn = Rotation.from_quat(
                    data.xquat[model.body(one.name).id], scalar_first=True
                )
                rows[:] = self.changed(
                    change, one.name, rows, turn, number, len(bodies)
                )

    return Rates


def _engine_changes(unit: float) -> Iterator[tuple[str, str, Any]]:
    for per_s in (0.05, 0.5):
        yield "scale", f"damped-{per_s:g}", lambda v, c, k=per_s: v * (1.0 - k / 180.0)
    yield "scale", "gains", lambda v, c: v * (1.0 + 0.05 / 180.0)
    yield "offset", "drift", lambda v, c: v + 0.02 * unit / 180.0
    for cap in (0.3, 1.0, 3.0):
        yield (
            "saturate",
            f"{cap:g}",
            lambda v, c, m=cap: (
                v * min(1.0, m * unit / max(float(np.linalg.norm(v)), 1e-12))
            ),
        )
    yield (
        "threshold",
        "slow-frozen-after-2s",
        lambda v, c: (
            0.0 * v if c["time"] > 2.0 and np.linalg.norm(v) < 0.01 * unit else v
        ),
    )
    yield (
        "threshold",
        "slow-frozen",
        lambda v, c: 0.0 * v if np.linalg.norm(v) < 0.003 * unit else v,
    )
    for cap in (1.0, 2.0):
        yield (
            "threshold",
            f"damped-above-{cap:g}",
            lambda v, c, m=cap: 0.995 * v if np.linalg.norm(v) > m * unit else v,
        )
    yield (
        "threshold",
        "damped-after-1s",
        lambda v, c: 0.999 * v if c["time"] > 1.0 else v,
    )
    yield (
        "drop",
        "axis",
        lambda v, c: np.where(np.arange(len(v)) == 1, 0.0, v) if len(v) == 3 else v,
    )
    yield (
        "frame",
        "axis-damped",
        lambda v, c: np.where(np.arange(len(v)) == 0, 0.998 * v, v),
    )
    for number, name in ((0, "first"), (1, "second"), (-1, "last")):
        yield (
            "kth",
            name,
            lambda v, c, m=number: (
                0.998 * v
                if c["count"] > 1 and c["number"] == (m if m >= 0 else c["count"] - 1)
                else v
            ),
        )
    yield "side", "negative", lambda v, c: np.where(v < 0.0, 0.998 * v, v)
    yield "stale", "mean-of-two", lambda v, c: 0.5 * (v + c["before"])


def _advances(change: Any) -> type[Passed]:
    class Advances(_Calls):
        number = 0

        def reset(self, seed):
            self.number = 0
            super().reset(seed)

        def advance(self, seconds):
            step = float(self.settings["timestep_s"])
            asked = change(seconds, self.number, self.time_s, step)
            self.number += 1
            self.time_s += seconds
            if asked > 0.5 * step:
                self.inner.advance(asked)

        def state(self):
            return super().state(), self.number

        def restore(self, state):
            super().restore(state[0])
            self.number = state[1]

    return Advances


def _time_faults() -> Iterator[tuple[str, str, type[Passed]]]:
    for kind, variant, change in (
        ("scale", "0.99", lambda s, n, t, step: 0.99 * s),
        ("drop", "every-60th", lambda s, n, t, step: 0.0 if n % 60 == 59 else s),
        ("drop", "every-200th", lambda s, n, t, step: 0.0 if n % 200 == 199 else s),
        ("threshold", "after-2s", lambda s, n, t, step: s - step if t > 2.0 else s),
        ("threshold", "after-1s", lambda s, n, t, step: s - step if t > 1.0 else s),
        ("offset", "one-step-more", lambda s, n, t, step: s + step),
        ("stale", "first-call-alone", lambda s, n, t, step: s if n else s - step),
    ):
        yield kind, variant, _advances(change)


def _kept(part: str, when: str, only: str = "") -> type[Passed]:
    """Return a simulation of MuJoCo that keeps or loses a part of its state at a reset or a restore."""
    arrays = {
        "velocity": "qvel",
        "wrench": "xfrc_applied",
        "command": "ctrl",
        "pose": "qpos",
    }

    class Kept(Passed):
        def _apply(self, call, argument):
            array = getattr(self.inner.data, arrays[part])
            before = array.copy()
            call(argument)
            rows = slice(None)
            if only == "last":
                rows = slice(-6, None) if part == "velocity" else slice(-1, None)
            if when.endswith("stale"):
                array[rows] = before[rows]
            else:
                array[rows] = 0.0

        def reset(self, seed):
            if when.startswith("reset"):
                self._apply(self.inner.reset, seed)
            else:
                super().reset(seed)

        def restore(self, state):
            if when.startswith("restore"):
                self._apply(self.inner.restore, state)
            else:
                super().restore(state)

    return Kept


def _buffers(what: str) -> type[Passed]:
    class Reused(Passed):
        def __init__(self, inner, scene):
            super().__init__(inner, scene)
            self._given = {}

        def _same(self, key, found):
            if key in self._given and self._given[key].shape == found.shape:
                self._given[key][...] = found
            else:
                self._given[key] = found
            return self._given[key]

        def body_states(self, names):
            found = super().body_states(names)
            return (
                self._same(tuple(names) if what == "states" else object(), found)
                if what == "states"
                else found
            )

        def nodes(self, name):
            found = super().nodes(name)
            return self._same(name, found) if what == "nodes" else found

    return Reused


def _settings(factor: float) -> type[Passed]:
    class Tells(Passed):
        def __init__(self, inner, scene):
            super().__init__(inner, scene)
            self.settings = {
                **inner.settings,
                "timestep_s": factor * float(inner.settings["timestep_s"]),
            }

    return Tells


class _LastGravity:
    """The gravity of the scene that was built last acts on all simulations."""

    value = None


def _gravity_of_last() -> type[Passed]:
    class Shared(Passed):
        def __init__(self, inner, scene):
            super().__init__(inner, scene)
            _LastGravity.value = -scene.gravity_m_per_s2

        def advance(self, seconds):
            self.inner.model.opt.gravity[2] = _LastGravity.value
            super().advance(seconds)

    return Shared


# --- all of them -----------------------------------------------------------------------------------------------------


def _fields() -> Iterator[tuple[str, str, Any]]:
    """Yield part, field and an example of all fields with words, from scenes of the suite and of the checks."""
    vector3 = (0.1, 0.2, 0.3)
    for name in WORDS:
        owner, field = name.split(".")
        if not owner[0].isupper() or field in ("pair", "joint", "parts"):
            continue
        example: Any = 1.0
        if field in ("size_m",) and owner == "Cloth":
            example = (0.1, 0.2)
        elif field in (
            "size_m",
            "radii_m",
            "position_m",
            "anchor_m",
            "axis",
            "linear_velocity_m_per_s",
            "angular_velocity_rad_per_s",
            "wind_m_per_s",
        ):
            example = vector3
        elif field == "quaternion":
            example = (1.0, 0.0, 0.0, 0.0)
        elif field == "pieces_m":
            example = ((vector3,),)
        yield owner, field, example


def generated() -> dict[str, Generated]:  # noqa: C901
    """Return all generated faults by id."""
    found: dict[str, Generated] = {}

    def add(quantity: str, kind: str, variant: str, **how: Any) -> None:
        what = f"{quantity}, {kind} {variant}"
        one = Generated(
            quantity=quantity,
            kind=kind,
            variant=variant,
            fault=Fault(what=what, caught_by="", says=WORDS[quantity], **how),
        )
        found[one.id] = one

    for owner, field, example in _fields():
        for kind, variant, edit, condition in _field_variants(owner, field, example):
            change = scene_edit(owner, field, edit)
            if condition:
                add(
                    f"{owner}.{field}",
                    kind,
                    variant,
                    simulation=switched(condition, change),
                    engine="mujoco",
                )
            else:
                add(f"{owner}.{field}", kind, variant, scene=change)
    for quantity, kind, variant, change in _pair_faults():
        add(quantity, kind, variant, scene=change)
    units = {
        "position": 0.3,
        "orientation": 0.5,
        "velocity": 0.5,
        "spin": 2.0,
        "acceleration": 1.0,
        "spin_acceleration": 4.0,
    }
    for part, unit in units.items():
        for kind, variant, change in _call_changes(unit):
            add(f"drive.{part}", kind, variant, simulation=_drive(part, change))
    for part, unit in {"force": 1.0, "torque": 0.05}.items():
        for kind, variant, change in _call_changes(unit):
            add(f"wrench.{part}", kind, variant, simulation=_wrench(part, change))
    for kind, variant, change in _call_changes(0.1):
        if kind not in ("frame", "kth", "crowd"):
            add("command.value", kind, variant, simulation=_command(change))
    for part, unit in {
        "position": 1.0,
        "orientation": 1.0,
        "velocity": 2.0,
        "spin": 5.0,
    }.items():
        for kind, variant, change in _call_changes(unit):
            add(f"report.{part}", kind, variant, simulation=_report(part, change))
    for kind, variant, change in _call_changes(1.0):
        if kind not in ("frame", "kth", "crowd"):
            add("report.nodes", kind, variant, simulation=_nodes(change))
    for part, unit in {"velocity": 4.0, "spin": 30.0, "hinge_rate": 4.0}.items():
        for kind, variant, change in _engine_changes(unit):
            add(
                f"engine.{part}",
                kind,
                variant,
                simulation=_engine(part, change),
                engine="mujoco",
            )
    for kind, variant, simulation in _time_faults():
        add("time.interval", kind, variant, simulation=simulation)
    for part in ("velocity", "wrench", "command", "pose"):
        for when in ("reset", "restore"):
            for kind in ("stale", "drop"):
                if (when, kind, part) != ("reset", "drop", "wrench") and (
                    when,
                    kind,
                    part,
                ) != ("reset", "drop", "command"):
                    add(
                        f"{when}.{part}",
                        kind,
                        "all",
                        simulation=_kept(part, f"{when}-{kind}"),
                        engine="mujoco",
                    )
                    add(
                        f"{when}.{part}",
                        "kth",
                        f"last-{kind}",
                        simulation=_kept(part, f"{when}-{kind}", "last"),
                        engine="mujoco",
                    )
    for what in ("states", "nodes"):
        add(f"buffer.{what}", "stale", "reused", simulation=_buffers(what))
    for factor in (0.1, 0.5, 2.0):
        add("settings.timestep_s", "scale", f"{factor:g}", simulation=_settings(factor))
    add(
        "Scene.gravity_m_per_s2",
        "stale",
        "last-built",
        simulation=_gravity_of_last(),
        engine="mujoco",
    )
    return found


__all__ = ["KINDS", "WORDS", "Generated", "generated", "is_held_out", "scene_edit"]
