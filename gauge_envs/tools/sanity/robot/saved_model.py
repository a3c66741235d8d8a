"""Build a MuJoCo model from arrays with MuJoCo's names: those of a probe file.

The model has the bodies with their mass, the joints, the geoms, the contact constants and the options of the original.
What actuators act on is marked, without their gains. It has no tendons, equality constraints, sensors and deformable
bodies. Nothing of the file is executed: arrays have declared shapes and ranges, and MuJoCo compiles them as numbers.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

import mujoco
import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from gauge_envs.errors import TargetError
from gauge_envs.tools.sanity.gauge_probe import ARRAYS, FLAGS, MESHES, NAMED_OPTIONS

Numbers = list[float]
Arrays = Mapping[str, NDArray[Any]]
"""Arrays by MuJoCo's names, shape [object_count, width]."""

WIDTHS = ARRAYS | dict.fromkeys(
    ("jnt_ref", "jnt_armature", "jnt_damping", "jnt_driven", "body_driven"), 1
)
"""Columns of each array."""

_DEFAULTS = mujoco.MjSpec().compile()
INTEGERS = frozenset(
    {"body_driven", "jnt_driven"}
    | {n for n in ARRAYS if getattr(_DEFAULTS, n).dtype.kind in "biu"}
)
"""Arrays of whole numbers."""

GEOM_FIELDS = (
    *("contype", "conaffinity", "condim", "priority", "solmix"),
    *("friction", "solref", "solimp", "margin", "gap"),
)
PAIR_FIELDS = ("friction", "solref", "solreffriction", "solimp", "margin", "gap")
"""Attributes of a geom and of an explicit pair that contacts depend on."""


class ModelData(BaseModel):
    """Data of a probe file of the kind `mujoco-model`."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    implementation: Literal["c", "mjx", "mujoco_warp"]
    options: dict[str, float | Numbers | str | list[str]]
    known_flags: dict[str, list[str]]
    counts: dict[str, int]
    arrays: dict[str, Numbers]
    geom_types: list[str]
    geom_hulls: list[int]
    geom_names: list[str]
    body_names: list[str]
    hulls: dict[str, Numbers]
    keyframes: dict[Literal["home", "stand", "standing"], Numbers]
    frame_skip: int | None


def build_saved_model(data: ModelData, name: str) -> tuple[mujoco.MjModel, list[str]]:
    """Return the compiled model, and notes on what the installed MuJoCo lacks.

    Args:
        data: Data of the file.
        name: Name of the file, for messages.
    """
    try:
        arrays = _arrays(data)
        spec = mujoco.MjSpec()
        spec.compiler.degree = False
        spec.compiler.autolimits = False
        spec.compiler.inertiafromgeom = (
            mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE
        )
        notes = _set_options(spec, data)
        bodies = _add_bodies(spec, data, arrays)
        _add_joints(spec, bodies, arrays)
        _add_geoms(spec, bodies, data, arrays)
        for key, qpos in data.keyframes.items():
            spec.add_key(name=key, qpos=qpos)
        model = spec.compile()
        for key, qpos in data.keyframes.items():
            if len(qpos) != model.nq:
                raise ValueError(
                    f"keyframes.{key} has {len(qpos)} numbers, expected {model.nq}"
                )
    except (ValueError, IndexError, TypeError) as error:
        raise TargetError(f"{name}: data: {' '.join(str(error).split())}") from None
    for array in ("geom_bodyid", "geom_contype", "geom_condim", "body_parentid"):
        if not np.array_equal(getattr(model, array), arrays[array][:, 0]):
            raise TargetError(
                f"{name}: data.arrays.{array}: the order of its objects is not that of MuJoCo"
            )
    return model, notes


# --- arrays ----------------------------------------------------------------------------------------------------------


def _arrays(data: ModelData) -> dict[str, NDArray[Any]]:
    """Return all arrays with their columns."""
    arrays: dict[str, NDArray[Any]] = {}
    for name, width in WIDTHS.items():
        if name not in data.arrays:
            raise ValueError(
                f"arrays.{name} is missing: write the file again with the same version of gauge-envs"
            )
        kind = np.int64 if name in INTEGERS else np.float64
        arrays[name] = np.array(data.arrays[name]).astype(kind).reshape(-1, width)
    return arrays


# --- options ---------------------------------------------------------------------------------------------------------


def _set_options(spec: mujoco.MjSpec, data: ModelData) -> list[str]:
    """Write the options; return notes on flags that one of the two versions lacks."""
    notes = []
    for name, value in data.options.items():
        if name in FLAGS:
            notes += _set_flags(spec, data, name, value)
            continue
        if name.startswith("_") or not hasattr(spec.option, name):
            notes.append(
                f"the option {name} is unknown to the installed MuJoCo {mujoco.__version__}"
            )
            continue
        now = getattr(spec.option, name)
        if name in NAMED_OPTIONS:
            constants = getattr(mujoco, NAMED_OPTIONS[name]).__members__
            if value not in constants:
                raise ValueError(
                    f"options.{name}: the installed MuJoCo {mujoco.__version__} has no {str(value)!r}"
                )
            setattr(spec.option, name, constants[str(value)])
        elif isinstance(now, np.ndarray):
            numbers = np.array(value, dtype=np.float64)
            if numbers.shape != now.shape:
                raise ValueError(f"options.{name}: expected {now.size} numbers")
            setattr(spec.option, name, numbers)
        elif isinstance(value, float):
            if isinstance(now, int) and (value != int(value) or abs(value) >= 2**31):
                raise ValueError(f"options.{name}: expected a whole number of 32 bits")
            setattr(spec.option, name, type(now)(value))
        else:
            raise ValueError(f"options.{name}: expected a number")
    return notes


def _set_flags(
    spec: mujoco.MjSpec, data: ModelData, name: str, value: Any
) -> list[str]:
    members = getattr(mujoco, FLAGS[name]).__members__
    bits = {
        bit: int(constant)
        for bit, constant in members.items()
        if bit.startswith(("mjDSBL_", "mjENBL_"))
    }
    if not isinstance(value, list) or not all(isinstance(flag, str) for flag in value):
        raise ValueError(f"options.{name}: expected a list of names")
    setattr(spec.option, name, sum(bits[flag] for flag in set(value) & set(bits)))
    unknown = (flag for flag in value if flag not in bits)
    notes = [
        f"the flag {flag} is unknown to the installed MuJoCo {mujoco.__version__}"
        for flag in unknown
    ]
    absent = sorted(set(bits) - set(data.known_flags.get(name, bits)))
    if absent and name == "disableflags":
        flags = ", ".join(flag.removeprefix("mjDSBL_").lower() for flag in absent)
        notes.append(
            f"the target's MuJoCo has no flag {flags}; here they are at their defaults"
        )
    return notes


# --- objects ---------------------------------------------------------------------------------------------------------


def _add_bodies(spec: mujoco.MjSpec, data: ModelData, arrays: Arrays) -> list[Any]:
    excluded = [
        divmod(int(signature), 1 << 16)
        for signature in arrays["exclude_signature"][:, 0]
    ]
    # An excluded pair refers to bodies by name.
    named = {body for pair in excluded for body in pair}
    bodies = [spec.worldbody]
    for index in range(1, len(data.body_names)):
        body = bodies[int(arrays["body_parentid"][index, 0])].add_body(
            name=data.body_names[index] or (f"body {index}" if index in named else ""),
            mocap=bool(arrays["body_mocapid"][index, 0] >= 0),
        )
        body.explicitinertial = True
        body.mass = arrays["body_mass"][index, 0]
        for field in ("pos", "quat", "ipos", "iquat", "inertia"):
            setattr(body, field, arrays[f"body_{field}"][index])
        bodies.append(body)
    for first, second in excluded:
        spec.add_exclude(bodyname1=bodies[first].name, bodyname2=bodies[second].name)
    return bodies


def _add_joints(spec: mujoco.MjSpec, bodies: list[Any], arrays: Arrays) -> None:
    """Add joints, and an actuator without its gains for each joint and body that the original moves."""
    for index, body in enumerate(arrays["jnt_bodyid"][:, 0]):
        joint = bodies[int(body)].add_joint(
            type=mujoco.mjtJoint(int(arrays["jnt_type"][index, 0]))
        )
        for field in ("pos", "axis", "range"):
            setattr(joint, field, arrays[f"jnt_{field}"][index])
        is_limited = bool(arrays["jnt_limited"][index, 0])
        joint.limited = (
            mujoco.mjtLimited.mjLIMITED_TRUE
            if is_limited
            else mujoco.mjtLimited.mjLIMITED_FALSE
        )
        joint.name = f"joint {index}"
        joint.armature = arrays["jnt_armature"][index, 0]
        # MuJoCo 4 has coefficients of a polynomial in the velocity, earlier versions one number.
        damping = np.zeros(np.shape(joint.damping))
        damping.flat[0] = arrays["jnt_damping"][index, 0]
        joint.damping = damping if damping.ndim else float(damping)
        if joint.type in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE):
            joint.ref = arrays["jnt_ref"][index, 0]
    for driven in np.flatnonzero(arrays["jnt_driven"][:, 0]).tolist():
        spec.add_actuator(trntype=mujoco.mjtTrn.mjTRN_JOINT, target=f"joint {driven}")
    for driven in np.flatnonzero(arrays["body_driven"][:, 0]).tolist():
        site = bodies[driven].add_site(name=f"actuator {driven}")
        spec.add_actuator(trntype=mujoco.mjtTrn.mjTRN_SITE, target=site.name)


def _add_geoms(
    spec: mujoco.MjSpec, bodies: list[Any], data: ModelData, arrays: Arrays
) -> None:
    """Add geoms and explicit pairs of them."""
    for number, vertices in data.hulls.items():
        spec.add_mesh(name=number, uservert=vertices)
    # An explicit pair refers to geoms by name.
    paired = data.arrays["pair_geom1"] + data.arrays["pair_geom2"]
    names = []
    for index, owner in enumerate(arrays["geom_bodyid"][:, 0].tolist()):
        substitute = (
            f"geom {index} of {data.body_names[owner] or 'an unnamed body'}"
            if index in paired
            else ""
        )
        names.append(data.geom_names[index] or substitute)
        geom = bodies[owner].add_geom(name=names[index])
        for field in ("pos", "quat", "size"):
            setattr(geom, field, arrays[f"geom_{field}"][index])
        _write_fields(geom, arrays, "geom", GEOM_FIELDS, index)
        _set_type(spec, geom, data, index, float(arrays["geom_rbound"][index, 0]))
    _add_pairs(spec, arrays, names)


def _set_type(
    spec: mujoco.MjSpec, geom: Any, data: ModelData, index: int, reach_m: float
) -> None:
    """Give a geom its type, with its hull or a level height field."""
    kind = data.geom_types[index]
    if kind in MESHES and data.geom_hulls[index] >= 0:
        geom.type, geom.meshname = (
            mujoco.mjtGeom.mjGEOM_MESH,
            str(data.geom_hulls[index]),
        )
    elif kind in MESHES:
        # A mesh that touches nothing counts by its size alone.
        geom.type, geom.size = mujoco.mjtGeom.mjGEOM_SPHERE, [reach_m or 1.0, 0.0, 0.0]
    elif kind == "mjGEOM_HFIELD":
        name, size = f"field {index}", [*geom.size[:2], 1.0, 1.0]
        spec.add_hfield(name=name, size=size, nrow=2, ncol=2, userdata=[0.0] * 4)
        geom.type, geom.hfieldname = mujoco.mjtGeom.mjGEOM_HFIELD, name
    elif kind in mujoco.mjtGeom.__members__:
        geom.type = getattr(mujoco.mjtGeom, kind)
    else:
        raise ValueError(
            f"geom_types: the installed MuJoCo {mujoco.__version__} has no {kind!r}"
        )


def _add_pairs(spec: mujoco.MjSpec, arrays: Arrays, names: list[str]) -> None:
    """Add explicit pairs of geoms.

    Args:
        spec: The model.
        arrays: Arrays with the names `pair_geom1`, `pair_geom2`, `pair_dim` and those of the constants.
        names: Names of the geoms.
    """
    columns = (arrays[name][:, 0] for name in ("pair_geom1", "pair_geom2", "pair_dim"))
    for index, (first, second, dim) in enumerate(zip(*columns, strict=True)):
        pair = spec.add_pair(
            geomname1=names[int(first)], geomname2=names[int(second)], condim=int(dim)
        )
        _write_fields(pair, arrays, "pair", PAIR_FIELDS, index)


def _write_fields(
    part: Any, arrays: Arrays, kind: str, fields: tuple[str, ...], index: int
) -> None:
    """Set attributes of a geom or pair from a row of each of their arrays."""
    for field in fields:
        values = arrays[f"{kind}_{field}"][index]
        setattr(
            part,
            field,
            values if len(values) > 1 else type(getattr(part, field))(values[0]),
        )
