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

OBJECTS = {
    "body": "body",
    "jnt": "joint",
    "geom": "geom",
    "site": "site",
    "tendon": "tendon",
    "eq": "equality",
    "flex": "flex",
    "actuator": "actuator",
    "pair": "pair",
}
"""MuJoCo's type of the objects that have names, by the prefix of their arrays."""

ARRAYS: Mapping[ChangeKind, tuple[str, ...]] = {
    ChangeKind.CONSTANT: (
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
    ),
    # `read_model` also writes them to the scene, where the poses of fixed bodies are structure.
    ChangeKind.START: ("body_pos", "body_quat", "key_qvel"),
    ChangeKind.SETTING: (
        "geom_solref",
        "geom_solimp",
        "geom_solmix",
        "pair_solref",
        "pair_solimp",
        "pair_solreffriction",
        "eq_solref",
        "eq_solimp",
        "flex_solref",
        "flex_solimp",
    ),
    ChangeKind.STRUCTURE: (
        "body_ipos",
        "body_iquat",
        "body_gravcomp",
        "jnt_type",
        "jnt_pos",
        "jnt_axis",
        "jnt_stiffness",
        "jnt_range",
        "jnt_margin",
        "jnt_solref",
        "jnt_solimp",
        "geom_type",
        "geom_size",
        "geom_pos",
        "geom_quat",
        "geom_contype",
        "geom_conaffinity",
        "geom_surfacevel",
        # A gap ends a contact, and a margin makes it act from afar.
        "geom_margin",
        "geom_gap",
        "pair_margin",
        "pair_gap",
        "flex_margin",
        "flex_gap",
        "site_pos",
        "tendon_range",
        "tendon_limited",
        "tendon_solref_lim",
        "tendon_solimp_lim",
        "tendon_lengthspring",
        "eq_data",
        "eq_active0",
        "flex_radius",
        "flex_contype",
        "flex_conaffinity",
        "flex_selfcollide",
        "actuator_trnid",
        "actuator_gear",
        "actuator_gaintype",
        "actuator_gainprm",
        "actuator_biastype",
        "actuator_biasprm",
        "actuator_dyntype",
        "actuator_ctrlrange",
        "actuator_forcerange",
        "mesh_vert",
        "flex_vert",
        "dof_damping",
        "dof_armature",
        "dof_frictionloss",
    ),
}
"""Arrays that a file defines, by what they hold."""

KINDS = {name: kind for kind, names in ARRAYS.items() for name in names}

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
"""Arrays whose changes are reported as a whole; the others have a row for each named object."""

OPTION = "option"
"""Title of the changes of options."""

SETTINGS = (
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
)
"""Options that are numerical settings; gravity, medium and flags are structure."""

DERIVED = (
    "actuator_acc0",
    "actuator_length",
    "body_invweight0",
    "body_sameframe",
    "body_simple",
    "body_subtreemass",
    "bvh_",
    "dof_M0",
    "dof_invweight0",
    "dof_simplenum",
    "flex_size",
    "flex_vert0",
    "flexedge_",
    "geom_aabb",
    "geom_rbound",
    "geom_sameframe",
    "mesh_",
    "oct_",
    "qpos",
    "site_sameframe",
    "tendon_invweight0",
    "tendon_length0",
)
"""Beginnings of the names of arrays that the compiler computes from those of `ARRAYS`."""

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
    for prefix in OBJECTS:
        changes += _object_changes(model, built, prefix)
    changes += _array_changes(model, built, TABLES)
    if any(change.kind is ChangeKind.STRUCTURE for change in changes):
        # Addresses and counts of objects follow from another structure.
        return changes
    others = [name for name in _physical_arrays(built) if name not in KINDS]
    given = [name for name in others if not name.startswith(DERIVED)]
    changes += _array_changes(model, built, given)
    return changes or [*_array_changes(model, built, others)]


def _numbers(value: Any) -> float | tuple[float, ...]:
    """Return the numbers of an option or of a row of an array; a single one without a tuple."""
    numbers = tuple(map(float, np.ravel(value)))
    return numbers[0] if len(numbers) == 1 else numbers


def _change(entry: str, name: str, before: Any, after: Any, others: int = 0) -> Change:
    """Return the change of an option or an array; one that is not listed is structure."""
    is_setting = entry == OPTION and name in SETTINGS
    known = ChangeKind.SETTING if is_setting else KINDS.get(name)
    return Change(
        kind=known or ChangeKind.STRUCTURE,
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
                yield _change(OPTION, name, expected, value)


def _object_changes(
    model: mujoco.MjModel, built: mujoco.MjModel, prefix: str
) -> Iterator[Change]:
    """Yield the added, removed and changed objects whose arrays have a prefix."""
    rows, built_rows = rows_by_name(model, prefix), rows_by_name(built, prefix)
    structure = ChangeKind.STRUCTURE
    for name in rows:
        if name not in built_rows:
            yield Change(kind=structure, entry=name, after=prefix)
    for name in built_rows:
        if name not in rows:
            yield Change(kind=structure, entry=name, before=prefix)
    shared = [name for name in built_rows if name in rows]
    for array in _arrays_of(prefix):
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


def _arrays_of(prefix: str) -> list[str]:
    """Return the arrays with a row for each object whose arrays have a prefix."""
    begin = f"{prefix}_"
    return [name for name in KINDS if name.startswith(begin) and name not in TABLES]


def rows_by_name(model: mujoco.MjModel, prefix: str) -> dict[str, int]:
    """Return the index of each object by its name; a pair has the names of its geoms."""
    if prefix == "pair":
        pairs = zip(model.pair_geom1.tolist(), model.pair_geom2.tolist(), strict=True)
        names = [
            f"contact {model.geom(first).name}/{model.geom(second).name}"
            for first, second in pairs
        ]
    else:
        count = len(getattr(model, _arrays_of(prefix)[0]))
        number = mujoco.mju_str2Type(OBJECTS[prefix])
        names = [
            mujoco.mj_id2name(model, number, index) or f"{prefix} {index}"
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
