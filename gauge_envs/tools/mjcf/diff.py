"""Differences between two compiled MuJoCo models that affect the physics."""

from collections.abc import Iterator, Mapping
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

SAME_DOUBLE = 1e-9
"""Relative difference below which double-precision numbers count as equal: machines differ in their last digits."""

SAME_SINGLE = 3e-7
"""Relative difference below which single-precision numbers, such as mesh vertices, count as equal."""

OBJECTS: Mapping[str, tuple[mujoco.mjtObj | None, tuple[str, ...]]] = {
    "body": (
        mujoco.mjtObj.mjOBJ_BODY,
        ("mass", "inertia", "ipos", "iquat", "pos", "quat", "gravcomp"),
    ),
    "jnt": (
        mujoco.mjtObj.mjOBJ_JOINT,
        ("type", "pos", "axis", "stiffness", "range", "margin", "solref", "solimp"),
    ),
    "geom": (
        mujoco.mjtObj.mjOBJ_GEOM,
        (
            *(
                "type",
                "size",
                "pos",
                "quat",
                "friction",
                "condim",
                "contype",
                "conaffinity",
                "priority",
            ),
            *("margin", "gap", "solref", "solimp", "solmix", "surfacevel"),
        ),
    ),
    "site": (mujoco.mjtObj.mjOBJ_SITE, ("pos",)),
    "tendon": (
        mujoco.mjtObj.mjOBJ_TENDON,
        (
            "range",
            "limited",
            "solref_lim",
            "solimp_lim",
            "stiffness",
            "damping",
            "lengthspring",
        ),
    ),
    "eq": (mujoco.mjtObj.mjOBJ_EQUALITY, ("data", "solref", "solimp", "active0")),
    "flex": (
        mujoco.mjtObj.mjOBJ_FLEX,
        (
            *(
                "radius",
                "damping",
                "friction",
                "condim",
                "contype",
                "conaffinity",
                "selfcollide",
                "margin",
                "gap",
            ),
            *("solref", "solimp"),
        ),
    ),
    "actuator": (
        mujoco.mjtObj.mjOBJ_ACTUATOR,
        (
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
    ),
    "pair": (
        None,
        ("dim", "friction", "margin", "gap", "solref", "solreffriction", "solimp"),
    ),
}
"""Arrays of a compiled model that a file defines, by kind of object; a change is reported with the object's name.

A pair of geoms has none, and is reported with theirs.
"""

TABLES = (
    "mesh_vert",
    "flex_vert",
    "flex_stiffness",
    "flex_bending",
    "dof_damping",
    "dof_armature",
    "dof_frictionloss",
)
"""Arrays whose changes are reported as a whole."""

WITHOUT_EFFECT = (
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

MOST_ROWS = 4
"""Largest number of changed objects that are listed one by one."""


def is_same(values: Any, expected: Any) -> bool:
    """Return whether values equal the expected ones up to rounding."""
    return bool(np.allclose(values, expected, rtol=SAME_DOUBLE, atol=1e-12))


def same_or(value: float, expected: float) -> float:
    """Return the expected value if the value equals it up to rounding, otherwise the value."""
    return expected if is_same(value, expected) else value


def model_changes(model: mujoco.MjModel, built: mujoco.MjModel) -> Iterator[str]:
    """Yield one line for each physical difference of a model from the model that the backend builds."""
    lines = [*_option_changes(model, built)]
    for kind in OBJECTS:
        lines += _row_changes(model, built, kind)
    for name in TABLES:
        lines += _array_change(
            name, np.asarray(getattr(model, name)), np.asarray(getattr(built, name))
        )
    if not lines:
        # Derived arrays are compared only if nothing else differs.
        for name in _arrays(built):
            lines += _array_change(
                name, np.asarray(getattr(model, name)), np.asarray(getattr(built, name))
            )
    yield from lines


def _arrays(model: mujoco.MjModel) -> Iterator[str]:
    for name in dir(model):
        if name.startswith(("_", *WITHOUT_EFFECT)) or name.endswith(
            WITHOUT_EFFECT_ENDS
        ):
            continue
        if isinstance(getattr(model, name), np.ndarray):
            yield name


def _option_changes(model: mujoco.MjModel, built: mujoco.MjModel) -> Iterator[str]:
    for name in dir(built.opt):
        if name.startswith("_"):
            continue
        value, expected = getattr(model.opt, name), getattr(built.opt, name)
        if not is_same(value, expected):
            yield f"option: {name} {format_value(expected)} -> {format_value(value)}"


def _titles(model: mujoco.MjModel, kind: str) -> list[str]:
    objects, fields = OBJECTS[kind]
    if objects is None:
        pairs = zip(model.pair_geom1.tolist(), model.pair_geom2.tolist(), strict=True)
        return [
            f"contact {model.geom(first).name}/{model.geom(second).name}"
            for first, second in pairs
        ]
    names = [
        mujoco.mj_id2name(model, objects, i)
        for i in range(len(getattr(model, f"{kind}_{fields[0]}")))
    ]
    return [name or f"{kind} {index}" for index, name in enumerate(names)]


def _row_changes(
    model: mujoco.MjModel, built: mujoco.MjModel, kind: str
) -> Iterator[str]:
    titles, expected_titles = (_titles(one, kind) for one in (model, built))
    yield from (f"{title}: added" for title in titles if title not in expected_titles)
    yield from (f"{title}: removed" for title in expected_titles if title not in titles)
    places = {title: index for index, title in enumerate(titles)}
    shared = [
        (title, places[title], index)
        for index, title in enumerate(expected_titles)
        if title in places
    ]
    for name in OBJECTS[kind][1]:
        values, expected = (
            getattr(model, f"{kind}_{name}"),
            getattr(built, f"{kind}_{name}"),
        )
        rows = [
            (title, values[i], expected[k])
            for title, i, k in shared
            if not is_same(values[i], expected[k])
        ]
        if len(rows) > MOST_ROWS:
            (title, now, before), more = rows[0], len(rows) - 1
            yield f"{title} and {more} more: {kind}_{name} {format_value(before)} -> {format_value(now)}, ..."
        else:
            yield from (
                f"{title}: {kind}_{name} {format_value(before)} -> {format_value(now)}"
                for title, now, before in rows
            )


def _array_change(
    name: str, values: NDArray[Any], expected: NDArray[Any]
) -> Iterator[str]:
    if values.shape != expected.shape:
        yield f"{name}: shape {list(expected.shape)} -> {list(values.shape)}"
        return
    if values.size == 0 or values.dtype.kind not in "fiub":
        return
    tolerance = SAME_SINGLE if values.dtype == np.float32 else SAME_DOUBLE
    apart = np.abs(values.astype(np.float64) - expected)
    apart[apart <= tolerance * np.abs(expected).max(initial=0.0)] = 0.0
    if apart.any():
        yield f"{name}: {np.count_nonzero(apart)} of {values.size} numbers differ, by up to {apart.max():.3g}"


def format_value(value: Any) -> str:
    """Return a number or an array as text with ten significant digits."""
    return " ".join(f"{number:.10g}" for number in np.atleast_1d(value).tolist())
