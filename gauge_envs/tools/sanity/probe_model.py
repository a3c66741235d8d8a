"""Build a MuJoCo model from the data of a probe file.

The model has the bodies with their mass, the joints, the geoms, the contact constants and the options of the original.
What actuators act on is marked, without their gains. It has no tendons, equality constraints, sensors and deformable
bodies. Nothing of the file is executed: arrays have declared shapes and ranges, and MuJoCo compiles them as numbers.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

import mujoco
import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from gauge_envs.errors import TargetError

MOST_OBJECTS = 2000
"""Most geoms, bodies or joints; pairs of geoms are counted by their square."""

MOST_VERTICES = 100_000
"""Most vertices of all hulls."""

LONGEST_NAME = 200

Text = Annotated[str, Field(max_length=LONGEST_NAME)]
Texts = Annotated[list[Text], Field(max_length=MOST_OBJECTS)]
Numbers = list[float]

WIDTHS: Mapping[str, Mapping[str, int]] = {
    "body": {"parentid": 1, "pos": 3, "quat": 4, "mass": 1, "ipos": 3, "iquat": 4, "inertia": 3, "mocapid": 1}
    | {"driven": 1},
    "jnt": {"type": 1, "bodyid": 1, "pos": 3, "axis": 3, "limited": 1, "range": 2, "ref": 1, "armature": 1}
    | {"damping": 1, "driven": 1},
    "geom": dict.fromkeys(("bodyid", "contype", "conaffinity", "condim", "priority", "solmix", "margin", "gap"), 1)
    | {"friction": 3, "solref": 2, "solimp": 5, "size": 3, "pos": 3, "quat": 4, "rbound": 1},
    "pair": {"dim": 1, "geom1": 1, "geom2": 1, "friction": 5, "solref": 2, "solreffriction": 2, "solimp": 5}
    | {"margin": 1, "gap": 1},
    "exclude": {"signature": 1},
}
"""Columns of each array, by kind of object."""

INTEGERS = (
    *(
        "body_parentid",
        "body_mocapid",
        "body_driven",
        "jnt_driven",
        "jnt_type",
        "jnt_bodyid",
        "jnt_limited",
        "geom_bodyid",
        "geom_contype",
    ),
    *("geom_conaffinity", "geom_condim", "geom_priority", "pair_dim", "pair_geom1", "pair_geom2", "exclude_signature"),
)

GEOM_FIELDS = (
    "contype",
    "conaffinity",
    "condim",
    "priority",
    "solmix",
    "friction",
    "solref",
    "solimp",
    "margin",
    "gap",
)
PAIR_FIELDS = ("friction", "solref", "solreffriction", "solimp", "margin", "gap")

NAMED_OPTIONS = {"integrator": "mjtIntegrator", "cone": "mjtCone", "solver": "mjtSolver", "jacobian": "mjtJacobian"}
FLAGS = {"disableflags": "mjtDisableBit", "enableflags": "mjtEnableBit"}
MESHES = ("mjGEOM_MESH", "mjGEOM_SDF")


class ModelData(BaseModel):
    """Data of a probe file of the kind `mujoco-model`."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    implementation: Literal["c", "mjx", "mujoco_warp"]
    options: dict[Text, float | Numbers | Text | Texts]
    known_flags: dict[Text, Texts]
    counts: dict[Text, int]
    arrays: dict[Text, Numbers]
    geom_types: Texts
    geom_hulls: Annotated[list[int], Field(max_length=MOST_OBJECTS)]
    geom_names: Texts
    body_names: Texts
    hulls: dict[Text, Numbers]
    keyframes: dict[Literal["home", "stand", "standing"], Numbers]
    limits: dict[Literal["njmax", "nconmax", "naconmax"], int]
    frame_skip: int | None


def build_saved_model(data: ModelData, name: str) -> tuple[mujoco.MjModel, list[str]]:
    """Return the compiled model, and notes on what the installed MuJoCo lacks.

    Args:
        data: Data of the file.
        name: Name of the file, for messages.
    """
    try:
        tables = _tables(data)
        spec = mujoco.MjSpec()
        spec.compiler.degree = False
        spec.compiler.autolimits = False
        spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE
        notes = _set_options(spec, data)
        bodies = _add_bodies(spec, data, tables)
        _add_joints(bodies, tables["jnt"])
        _add_actuators(spec, bodies, tables)
        _add_geoms(spec, bodies, data, tables["geom"])
        _add_pairs(spec, data, tables)
        for key, qpos in data.keyframes.items():
            spec.add_key(name=key, qpos=qpos)
        model = spec.compile()
        for key, qpos in data.keyframes.items():
            if len(qpos) != model.nq:
                raise ValueError(f"keyframes.{key} has {len(qpos)} numbers, expected {model.nq}")
    except (ValueError, IndexError, TypeError) as error:
        raise TargetError(f"{name}: data: {' '.join(str(error).split())}") from None
    for kind, columns in {"geom": ("bodyid", "contype", "condim"), "body": ("parentid",)}.items():
        for column in columns:
            if not np.array_equal(getattr(model, f"{kind}_{column}"), tables[kind][column][:, 0]):
                raise TargetError(
                    f"{name}: data.arrays.{kind}_{column}: the order of its objects is not that of MuJoCo"
                )
    return model, notes


# --- arrays ----------------------------------------------------------------------------------------------------------


def _tables(data: ModelData) -> dict[str, dict[str, NDArray[Any]]]:
    """Return all arrays with their columns, by kind and name, after a check of sizes and ranges."""
    counts = {"body": len(data.body_names), "geom": len(data.geom_types)}
    tables: dict[str, dict[str, NDArray[Any]]] = {}
    for kind, widths in WIDTHS.items():
        tables[kind] = {}
        for column, width in widths.items():
            name = f"{kind}_{column}"
            if name not in data.arrays:
                raise ValueError(f"arrays.{name} is missing: write the file again with the same version of gauge-envs")
            values: NDArray[Any] = np.array(data.arrays[name], dtype=np.float64)
            count = counts.setdefault(kind, len(values) // width)
            if values.size != count * width or count > MOST_OBJECTS:
                raise ValueError(
                    f"arrays.{name} has {values.size} numbers: expected {width} for each of {count} objects, and at "
                    f"most {MOST_OBJECTS} objects"
                )
            if name in INTEGERS:
                values = _integers(name, values)
            tables[kind][column] = values.reshape(count, width)
    if len(data.geom_names) != counts["geom"] or len(data.geom_hulls) != counts["geom"] or not counts["body"]:
        raise ValueError("geom_names, geom_hulls and geom_types must be of the same length, and body_names not empty")
    for name, kind in {"jnt_bodyid": "body", "geom_bodyid": "body", "pair_geom1": "geom", "pair_geom2": "geom"}.items():
        owner, column = name.split("_")
        _check_ids(name, tables[owner][column], counts[kind])
    excluded = np.array(np.divmod(tables["exclude"]["signature"], 1 << 16))
    _check_ids("exclude_signature", excluded, counts["body"])
    parents = tables["body"]["parentid"][:, 0]
    if parents[0] != 0 or (parents[1:] < 0).any() or (parents[1:] >= np.arange(1, len(parents))).any():
        raise ValueError("arrays.body_parentid: a body must follow its parent")
    return tables


def _integers(name: str, values: NDArray[np.float64]) -> NDArray[np.int64]:
    whole = values.astype(np.int64) if (np.abs(values) < 2.0**40).all() else None
    if whole is None or (whole != values).any():
        raise ValueError(f"arrays.{name} must hold whole numbers")
    if name != "exclude_signature" and (np.abs(whole) >= 2**31).any():
        raise ValueError(f"arrays.{name} must hold numbers of 32 bits")
    return whole


def _check_ids(name: str, ids: NDArray[Any], count: int) -> None:
    if ids.size and (ids.min() < 0 or ids.max() >= count):
        raise ValueError(f"arrays.{name} must hold numbers from 0 to {count - 1}")


# --- options ---------------------------------------------------------------------------------------------------------


def _set_options(spec: mujoco.MjSpec, data: ModelData) -> list[str]:
    """Write the options; return notes on flags that one of the two versions lacks."""
    notes = []
    for name, value in data.options.items():
        if name in FLAGS:
            notes += _set_flags(spec, data, name, value)
            continue
        if name.startswith("_") or not hasattr(spec.option, name):
            notes.append(f"the option {name} is unknown to the installed MuJoCo {mujoco.__version__}")
            continue
        now = getattr(spec.option, name)
        if name in NAMED_OPTIONS:
            constants = getattr(mujoco, NAMED_OPTIONS[name]).__members__
            if value not in constants:
                raise ValueError(f"options.{name}: the installed MuJoCo {mujoco.__version__} has no {str(value)!r}")
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


def _set_flags(spec: mujoco.MjSpec, data: ModelData, name: str, value: Any) -> list[str]:
    bits = {
        bit: int(constant)
        for bit, constant in getattr(mujoco, FLAGS[name]).__members__.items()
        if bit.startswith(("mjDSBL_", "mjENBL_"))
    }
    if not isinstance(value, list) or not all(isinstance(flag, str) for flag in value):
        raise ValueError(f"options.{name}: expected a list of names")
    setattr(spec.option, name, sum(bits[flag] for flag in sorted(set(value)) if flag in bits))
    notes = [
        f"the flag {flag} is unknown to the installed MuJoCo {mujoco.__version__}" for flag in value if flag not in bits
    ]
    absent = sorted(set(bits) - set(data.known_flags.get(name, bits)))
    if absent and name == "disableflags":
        flags = ", ".join(flag.removeprefix("mjDSBL_").lower() for flag in absent)
        notes.append(f"the target's MuJoCo has no flag {flags}; here they are at their defaults")
    return notes


# --- objects ---------------------------------------------------------------------------------------------------------


def _add_bodies(spec: mujoco.MjSpec, data: ModelData, tables: dict[str, dict[str, NDArray[Any]]]) -> list[Any]:
    table = tables["body"]
    # An excluded pair refers to bodies by name.
    named = {int(body) for row in tables["exclude"]["signature"][:, 0] for body in divmod(int(row), 1 << 16)}
    bodies = [spec.worldbody]
    for index in range(1, len(data.body_names)):
        body = bodies[int(table["parentid"][index, 0])].add_body(
            name=data.body_names[index] or (f"body {index}" if index in named else ""),
            pos=table["pos"][index],
            quat=table["quat"][index],
            mocap=bool(table["mocapid"][index, 0] >= 0),
        )
        body.explicitinertial = True
        body.mass = table["mass"][index, 0]
        body.ipos, body.iquat, body.inertia = (table[key][index] for key in ("ipos", "iquat", "inertia"))
        bodies.append(body)
    for row in tables["exclude"]["signature"][:, 0]:
        first, second = (bodies[body].name for body in divmod(int(row), 1 << 16))
        spec.add_exclude(bodyname1=first, bodyname2=second)
    return bodies


def _add_joints(bodies: list[Any], table: dict[str, NDArray[Any]]) -> None:
    for index, body in enumerate(table["bodyid"][:, 0]):
        joint = bodies[int(body)].add_joint(type=mujoco.mjtJoint(int(table["type"][index, 0])))
        joint.pos, joint.axis, joint.range = (table[key][index] for key in ("pos", "axis", "range"))
        is_limited = bool(table["limited"][index, 0])
        joint.limited = mujoco.mjtLimited.mjLIMITED_TRUE if is_limited else mujoco.mjtLimited.mjLIMITED_FALSE
        joint.name = f"joint {index}"
        joint.armature = table["armature"][index, 0]
        # MuJoCo 4 has coefficients of a polynomial in the velocity, earlier versions one number.
        damping = np.zeros(np.shape(joint.damping))
        damping.flat[0] = table["damping"][index, 0]
        joint.damping = damping if damping.ndim else float(damping)
        if joint.type in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE):
            joint.ref = table["ref"][index, 0]


def _add_actuators(spec: mujoco.MjSpec, bodies: list[Any], tables: dict[str, dict[str, NDArray[Any]]]) -> None:
    """Add an actuator for each joint and body that the original moves, without its gains."""
    for index in np.flatnonzero(tables["jnt"]["driven"][:, 0]):
        spec.add_actuator(trntype=mujoco.mjtTrn.mjTRN_JOINT, target=f"joint {index}")
    for index in np.flatnonzero(tables["body"]["driven"][:, 0]):
        site = bodies[int(index)].add_site(name=f"actuator {index}")
        spec.add_actuator(trntype=mujoco.mjtTrn.mjTRN_SITE, target=site.name)


def _add_geoms(spec: mujoco.MjSpec, bodies: list[Any], data: ModelData, table: dict[str, NDArray[Any]]) -> None:
    if sum(map(len, data.hulls.values())) > 3 * MOST_VERTICES:
        raise ValueError(f"hulls: more than {MOST_VERTICES} vertices")
    for number, vertices in data.hulls.items():
        if len(vertices) % 3:
            raise ValueError(f"hulls.{number}: expected three coordinates for each vertex")
        spec.add_mesh(name=number, uservert=vertices)
    for index, kind in enumerate(data.geom_types):
        geom = bodies[int(table["bodyid"][index, 0])].add_geom(name=_geom_name(data, table, index))
        geom.pos, geom.quat, geom.size = (table[key][index] for key in ("pos", "quat", "size"))
        for field in GEOM_FIELDS:
            values = table[field][index]
            setattr(geom, field, values if len(values) > 1 else values[0])
        if kind in MESHES and data.geom_hulls[index] >= 0:
            geom.type, geom.meshname = mujoco.mjtGeom.mjGEOM_MESH, str(data.geom_hulls[index])
        elif kind in MESHES:
            # A mesh that touches nothing counts by its size alone.
            geom.type, geom.size = mujoco.mjtGeom.mjGEOM_SPHERE, [table["rbound"][index, 0] or 1.0, 0.0, 0.0]
        elif kind == "mjGEOM_HFIELD":
            name = f"field {index}"
            spec.add_hfield(name=name, size=[*table["size"][index, :2], 1.0, 1.0], nrow=2, ncol=2, userdata=[0.0] * 4)
            geom.type, geom.hfieldname = mujoco.mjtGeom.mjGEOM_HFIELD, name
        elif kind in mujoco.mjtGeom.__members__:
            geom.type = getattr(mujoco.mjtGeom, kind)
        else:
            raise ValueError(f"geom_types: the installed MuJoCo {mujoco.__version__} has no {kind!r}")


def _geom_name(data: ModelData, table: dict[str, NDArray[Any]], index: int) -> str:
    """Return the name of a geom; for one without that an explicit pair refers to, that of its number and body."""
    paired = data.arrays["pair_geom1"] + data.arrays["pair_geom2"]
    if data.geom_names[index] or index not in paired:
        return data.geom_names[index]
    return f"geom {index} of {data.body_names[int(table['bodyid'][index, 0])] or 'an unnamed body'}"


def _add_pairs(spec: mujoco.MjSpec, data: ModelData, tables: dict[str, dict[str, NDArray[Any]]]) -> None:
    table = tables["pair"]
    names = [_geom_name(data, tables["geom"], index) for index in range(len(data.geom_types))]
    for index in range(len(table["dim"])):
        first, second = (names[int(table[key][index, 0])] for key in ("geom1", "geom2"))
        pair = spec.add_pair(geomname1=first, geomname2=second, condim=int(table["dim"][index, 0]))
        for field in PAIR_FIELDS:
            values = table[field][index]
            setattr(pair, field, values if len(values) > 1 else values[0])
