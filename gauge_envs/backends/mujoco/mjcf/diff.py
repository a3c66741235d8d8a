"""Differences between two compiled MuJoCo models that affect the physics."""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import mujoco
import numpy as np

DOUBLE_TOLERANCE = 1e-9
"""Relative difference below which double-precision numbers are equal: machines differ in their last digits."""

SINGLE_TOLERANCE = 3e-7
"""Relative difference below which single-precision numbers, such as mesh vertices, are equal."""

OBJECT_TYPES = {"jnt": "joint", "eq": "equality"}
"""MuJoCo's type of the named objects, by the prefix of their arrays, if it differs from the prefix."""

FIELDS: Mapping[str, str] = {
    "body": "mass inertia ipos iquat pos quat gravcomp",
    "jnt": "type pos axis stiffness range margin solref solimp",
    "geom": (
        "type size pos quat friction condim contype conaffinity priority "
        "margin gap solref solimp solmix surfacevel"
    ),
    "site": "pos",
    "tendon": "range limited solref_lim solimp_lim stiffness damping lengthspring",
    "eq": "data solref solimp active0",
    "flex": "radius damping friction condim contype conaffinity selfcollide margin gap solref solimp",
    "actuator": "trnid gear gaintype gainprm biastype biasprm dyntype ctrlrange forcerange",
    "pair": "dim friction margin gap solref solreffriction solimp",
}
"""Arrays that a file defines, by the prefix of their names. Changes are reported with the name of the object."""

TABLES = "mesh_vert flex_vert flex_stiffness flex_bending dof_damping dof_armature dof_frictionloss key_qvel"
"""Arrays whose changes are reported as a whole."""

WITHOUT_EFFECT = "names name_ numeric text tex_ mat_ cam_ light_ sensor skin_ key_"
"""Prefixes of the names of arrays that do not affect the motion."""

WITHOUT_EFFECT_ENDS = "_rgba _matid _group _user _castshadow"
"""Suffixes of the names of arrays that do not affect the motion."""


def is_same(values: Any, expected: Any) -> bool:
    """Return whether all numbers equal the expected ones up to rounding."""
    return np.allclose(values, expected, rtol=DOUBLE_TOLERANCE, atol=1e-12)


def format_value(value: Any) -> str:
    """Return a number or an array as text with ten significant digits."""
    return " ".join(f"{number:.10g}" for number in np.atleast_1d(value).tolist())


def model_changes(model: mujoco.MjModel, built: mujoco.MjModel) -> list[str]:
    """Return one line for each physical difference of a model from the model that the backend builds."""
    changes = [*_option_changes(model, built)]
    for kind in FIELDS:
        changes += _object_changes(model, built, kind)
    changes += _array_changes(model, built, TABLES.split())
    # Other arrays follow from these, so they are reported only if nothing else differs.
    return changes or [*_array_changes(model, built, _physical_arrays(built))]


def _option_changes(model: mujoco.MjModel, built: mujoco.MjModel) -> Iterator[str]:
    for name in dir(built.opt):
        if not name.startswith("_"):
            value, expected = getattr(model.opt, name), getattr(built.opt, name)
            if not is_same(value, expected):
                yield f"option: {name} {format_value(expected)} -> {format_value(value)}"


def _object_changes(
    model: mujoco.MjModel, built: mujoco.MjModel, kind: str
) -> Iterator[str]:
    """Yield the added, removed and changed objects of one kind."""
    rows, built_rows = rows_by_name(model, kind), rows_by_name(built, kind)
    yield from (f"{name}: added" for name in rows if name not in built_rows)
    yield from (f"{name}: removed" for name in built_rows if name not in rows)
    shared = [name for name in built_rows if name in rows]
    for field in FIELDS[kind].split():
        array = f"{kind}_{field}"
        values, expected = getattr(model, array), getattr(built, array)
        changed = [
            (name, expected[built_rows[name]], values[rows[name]])
            for name in shared
            if not is_same(values[rows[name]], expected[built_rows[name]])
        ]
        if changed:
            name, old, new = changed[0]
            more = f" and {len(changed) - 1} more" if len(changed) > 1 else ""
            change = f"{format_value(old)} -> {format_value(new)}"
            yield f"{name}{more}: {array} {change}{more and ', ...'}"


def rows_by_name(model: mujoco.MjModel, kind: str) -> dict[str, int]:
    """Return the index of each object of one kind by its name; a pair has the names of its geoms."""
    if kind == "pair":
        pairs = zip(model.pair_geom1.tolist(), model.pair_geom2.tolist(), strict=True)
        names = [
            f"contact {model.geom(first).name}/{model.geom(second).name}"
            for first, second in pairs
        ]
    else:
        count = len(getattr(model, f"{kind}_{FIELDS[kind].split()[0]}"))
        number = mujoco.mju_str2Type(OBJECT_TYPES.get(kind, kind))
        names = [
            mujoco.mj_id2name(model, number, index) or f"{kind} {index}"
            for index in range(count)
        ]
    return {name: index for index, name in enumerate(names)}


def _physical_arrays(model: mujoco.MjModel) -> Iterator[str]:
    prefixes = ("_", *WITHOUT_EFFECT.split())
    suffixes = tuple(WITHOUT_EFFECT_ENDS.split())
    for name in dir(model):
        is_ignored = name.startswith(prefixes) or name.endswith(suffixes)
        if not is_ignored and isinstance(getattr(model, name), np.ndarray):
            yield name


def _array_changes(
    model: mujoco.MjModel, built: mujoco.MjModel, names: Iterable[str]
) -> Iterator[str]:
    """Yield one line for each array that differs."""
    for name in names:
        values, expected = getattr(model, name), getattr(built, name)
        if values.shape != expected.shape:
            yield f"{name}: shape {list(expected.shape)} -> {list(values.shape)}"
        elif values.size:
            is_single = values.dtype == np.float32
            tolerance = SINGLE_TOLERANCE if is_single else DOUBLE_TOLERANCE
            differences = np.abs(values.astype(np.float64) - expected)
            differs = differences > tolerance * np.abs(expected).max()
            if differs.any():
                yield (
                    f"{name}: {np.count_nonzero(differs)} of {values.size} numbers differ, "
                    f"by up to {differences[differs].max():.3g}"
                )
