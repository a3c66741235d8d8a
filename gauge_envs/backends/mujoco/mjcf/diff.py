"""Differences between two compiled MuJoCo models that affect the physics."""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import mujoco
import numpy as np

from gauge_envs.scene.diff import Change, ChangeKind

DOUBLE_TOLERANCE = 1e-9
"""Relative difference below which double-precision numbers are equal: machines differ in their last digits."""

SINGLE_TOLERANCE = 3e-7
"""Relative difference below which single-precision numbers, such as mesh vertices, are equal."""

OBJECT_TYPES = {"jnt": "joint", "eq": "equality"}
"""MuJoCo's type of the named objects, by the prefix of their arrays, if it differs from the prefix."""

OBJECT_ARRAYS: Mapping[str, tuple[str, ...]] = {
    "body": ("mass", "inertia", "ipos", "iquat", "pos", "quat", "gravcomp"),
    "jnt": ("type", "pos", "axis", "stiffness", "range", "margin", "solref", "solimp"),
    "geom": (
        "type",
        "size",
        "pos",
        "quat",
        "friction",
        "condim",
        "contype",
        "conaffinity",
        "priority",
        "margin",
        "gap",
        "solref",
        "solimp",
        "solmix",
        "surfacevel",
    ),
    "site": ("pos",),
    "tendon": (
        "range",
        "limited",
        "solref_lim",
        "solimp_lim",
        "stiffness",
        "damping",
        "lengthspring",
    ),
    "eq": ("data", "solref", "solimp", "active0"),
    "flex": (
        "radius",
        "damping",
        "friction",
        "condim",
        "contype",
        "conaffinity",
        "selfcollide",
        "margin",
        "gap",
        "solref",
        "solimp",
    ),
    "actuator": (
        "trnid",
        "gear",
        "gaintype",
        "gainprm",
        "biastype",
        "biasprm",
        "dyntype",
        "ctrlrange",
        "forcerange",
    ),
    "pair": ("dim", "friction", "margin", "gap", "solref", "solreffriction", "solimp"),
}
"""Arrays that a file defines, by the prefix of their names. Changes are reported with the name of the object."""

TABLES = (
    "mesh_vert",
    "flex_vert",
    "flex_stiffness",
    "flex_bending",
    "dof_damping",
    "dof_armature",
    "dof_frictionloss",
    "key_qvel",
)
"""Arrays whose changes are reported as a whole."""

CONSTANTS = frozenset(
    {
        "body_mass",
        "body_inertia",
        "geom_friction",
        "geom_condim",
        "geom_priority",
        "pair_dim",
        "pair_friction",
        "tendon_stiffness",
        "tendon_damping",
        "flex_friction",
        "flex_condim",
        "flex_damping",
        "flex_stiffness",
        "flex_bending",
    }
)
"""Arrays of constants of materials, contacts and masses."""

STARTS = frozenset({"body_pos", "body_quat", "key_qvel"})
"""Arrays of initial states; `read_model` also writes them to the scene, whose fixed bodies may not move."""

CONTACT_SETTINGS = ("solref", "solimp", "solmix", "solreffriction", "margin", "gap")
"""Numerical settings of contacts and constraints, without the prefix of the object."""

SETTINGS = frozenset(
    {
        "timestep",
        "integrator",
        "cone",
        "jacobian",
        "solver",
        "impratio",
        "tolerance",
        "ls_tolerance",
        "noslip_tolerance",
        "ccd_tolerance",
        "iterations",
        "ls_iterations",
        "noslip_iterations",
        "ccd_iterations",
        "sdf_iterations",
        "sdf_initpoints",
    }
    | {
        f"{kind}_{name}"
        for kind in ("geom", "pair", "eq", "flex")
        for name in CONTACT_SETTINGS
    }
)
"""Options and arrays of numerical settings."""

WITHOUT_EFFECT = (
    "_",
    "names",
    "name_",
    "numeric",
    "text",
    "tex_",
    "mat_",
    "cam_",
    "light_",
    "sensor",
    "skin_",
    "key_",
)
"""Prefixes of the names of arrays that do not affect the motion."""

WITHOUT_EFFECT_ENDS = ("_rgba", "_matid", "_group", "_user", "_castshadow")
"""Suffixes of the names of arrays that do not affect the motion."""


def is_same(values: Any, expected: Any) -> bool:
    """Return whether all numbers equal the expected ones up to rounding."""
    return np.allclose(values, expected, rtol=DOUBLE_TOLERANCE, atol=1e-12)


def model_changes(model: mujoco.MjModel, built: mujoco.MjModel) -> list[Change]:
    """Return each physical difference of a model from the model that the backend builds."""
    changes = [*_option_changes(model, built)]
    for kind in OBJECT_ARRAYS:
        changes += _object_changes(model, built, kind)
    changes += _array_changes(model, built, TABLES)
    # Other arrays follow from these, so they are reported only if nothing else differs.
    return changes or [*_array_changes(model, built, _physical_arrays(built))]


def _kind(name: str) -> ChangeKind:
    """Return what an option or an array of a model holds."""
    if name in CONSTANTS:
        return ChangeKind.CONSTANT
    if name in STARTS:
        return ChangeKind.START
    return ChangeKind.SETTING if name in SETTINGS else ChangeKind.STRUCTURE


def _numbers(value: Any) -> float | tuple[float, ...]:
    """Return the numbers of an option or of a row of an array; a single one without a tuple."""
    numbers = tuple(map(float, np.ravel(value)))
    return numbers[0] if len(numbers) == 1 else numbers


def _change(entry: str, name: str, before: Any, after: Any, others: int = 0) -> Change:
    return Change(
        kind=_kind(name),
        entry=entry,
        field=(name,),
        before=_numbers(before),
        after=_numbers(after),
        others=others,
    )


def _option_changes(model: mujoco.MjModel, built: mujoco.MjModel) -> Iterator[Change]:
    for name in dir(built.opt):
        if not name.startswith("_"):
            value, expected = getattr(model.opt, name), getattr(built.opt, name)
            if not is_same(value, expected):
                yield _change("option", name, expected, value)


def _object_changes(
    model: mujoco.MjModel, built: mujoco.MjModel, kind: str
) -> Iterator[Change]:
    """Yield the added, removed and changed objects of one kind."""
    rows, built_rows = rows_by_name(model, kind), rows_by_name(built, kind)
    structure = ChangeKind.STRUCTURE
    for name in rows:
        if name not in built_rows:
            yield Change(kind=structure, entry=name, after=kind)
    for name in built_rows:
        if name not in rows:
            yield Change(kind=structure, entry=name, before=kind)
    shared = [name for name in built_rows if name in rows]
    for field in OBJECT_ARRAYS[kind]:
        array = f"{kind}_{field}"
        values, expected = getattr(model, array), getattr(built, array)
        changed = [
            name
            for name in shared
            if not is_same(values[rows[name]], expected[built_rows[name]])
        ]
        if changed:
            first, others = changed[0], len(changed) - 1
            before, after = expected[built_rows[first]], values[rows[first]]
            yield _change(first, array, before, after, others)


def rows_by_name(model: mujoco.MjModel, kind: str) -> dict[str, int]:
    """Return the index of each object of one kind by its name; a pair has the names of its geoms."""
    if kind == "pair":
        pairs = zip(model.pair_geom1.tolist(), model.pair_geom2.tolist(), strict=True)
        names = [
            f"contact {model.geom(first).name}/{model.geom(second).name}"
            for first, second in pairs
        ]
    else:
        count = len(getattr(model, f"{kind}_{OBJECT_ARRAYS[kind][0]}"))
        number = mujoco.mju_str2Type(OBJECT_TYPES.get(kind, kind))
        names = [
            mujoco.mj_id2name(model, number, index) or f"{kind} {index}"
            for index in range(count)
        ]
    return {name: index for index, name in enumerate(names)}


def _physical_arrays(model: mujoco.MjModel) -> Iterator[str]:
    for name in dir(model):
        is_ignored = name.startswith(WITHOUT_EFFECT) or name.endswith(
            WITHOUT_EFFECT_ENDS
        )
        if not is_ignored and isinstance(getattr(model, name), np.ndarray):
            yield name


def _array_changes(
    model: mujoco.MjModel, built: mujoco.MjModel, names: Iterable[str]
) -> Iterator[Change]:
    """Yield each array that differs."""
    for name in names:
        values, expected = getattr(model, name), getattr(built, name)
        if values.shape != expected.shape:
            yield _change("model", name, expected, values)
        elif values.size:
            is_single = values.dtype == np.float32
            tolerance = SINGLE_TOLERANCE if is_single else DOUBLE_TOLERANCE
            differences = np.abs(values.astype(np.float64) - expected)
            if differences.max() > tolerance * np.abs(expected).max():
                yield _change("model", name, expected, values)
