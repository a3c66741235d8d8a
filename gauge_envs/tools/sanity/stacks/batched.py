"""Models for GPUs in this process: `mujoco.mjx.Model`, and `mujoco_warp.Model` with its `Data`.

Their arrays have MuJoCo's names, in single precision, and some have one row for each world. A model for MuJoCo is built
from the first world: its bodies, geoms, contact constants and options. Bodies are spheres of its own, which do not
matter, since only constants are read.
"""

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from gauge_envs.backends.mujoco.model_settings import GROUND_TYPES
from gauge_envs.errors import TargetError
from gauge_envs.tools.sanity.gauge_probe import is_mjx_model, is_of
from gauge_envs.tools.sanity.model import (
    CapacityLimits,
    ContactCapacity,
    ContactNeed,
    TrainingConfiguration,
)
from gauge_envs.tools.sanity.robot.mujoco_model import mujoco_configuration
from gauge_envs.tools.sanity.robot.saved_model import (
    GEOM_FIELDS,
    PAIR_FIELDS,
    WIDTHS,
    add_pairs,
    write_fields,
)
from gauge_envs.tools.sanity.stacks.dialect import rounded
from gauge_envs.tools.sanity.stacks.reader import GeomPair, Reader

OPTIONS = (
    *("integrator", "cone", "solver", "iterations", "ls_iterations", "ccd_iterations"),
    *("disableflags", "enableflags"),
)
"""Options that are whole numbers; one that an engine does not have keeps MuJoCo's default."""

REAL_OPTIONS = ("timestep", "impratio", "tolerance", "ls_tolerance")
"""Options that are numbers; those of a model for GPUs are in single precision."""

UNREAD = (
    "friction loss, limits and actuators do not matter for the rows and are not read"
)


def _read(
    target: Any, pair: GeomPair | None, name: str, engine: str
) -> TrainingConfiguration:
    read = mujoco_configuration(
        _built(target),
        name=name,
        source=f"{name} in this process, world 0",
        pair=pair,
        has_robot=False,
    )
    note = f"trains {engine}, in single precision; the rows run MuJoCo's C engine"
    return replace(read, notes=(note, UNREAD, *read.notes), foot_geometry=None)


def _read_warp(target: Any, pair: GeomPair | None) -> TrainingConfiguration:
    model, data = target if isinstance(target, tuple) else (target, None)
    read = _read(model, pair, "mujoco_warp.Model", "on mujoco_warp")
    return read if data is None else replace(read, capacity=_capacity(data))


def _capacity(data: Any) -> ContactCapacity:
    """Return the limits of mujoco_warp's data, and what its worlds need in their state.

    The count of constraint rows goes on where the memory ends. That of contacts ends there without a warning; the count
    of pairs of geoms that are near goes on.
    """
    worlds, njmax, naconmax = int(data.nworld), int(data.njmax), int(data.naconmax)
    rows, contacts = int(np.max(_array(data.nefc))), int(np.max(_array(data.nacon)))
    near = int(np.max(_array(data.ncollision))) if hasattr(data, "ncollision") else 0
    if near > naconmax:
        contacts = max(contacts, near)
    need = ContactNeed(
        rows=rows,
        contacts=-(-contacts // worlds),
        mean_contacts=contacts / worlds,
        situation="the state of its data",
    )
    return ContactCapacity(
        limits=CapacityLimits(njmax=njmax, naconmax=naconmax, worlds=worlds), need=need
    )


# --- model -----------------------------------------------------------------------------------------------------------


def _built(target: Any) -> mujoco.MjModel:
    """Return a model for MuJoCo with the bodies, geoms, contact constants and options of world 0."""
    spec = mujoco.MjSpec()
    try:
        _add_bodies(spec, target)
        _set_options(spec, target.opt)
        return spec.compile()
    except (AttributeError, IndexError, TypeError, ValueError) as error:
        raise TargetError(
            f"{type(target).__module__}.Model cannot be read: {' '.join(str(error).split())}; give the mujoco.MjModel "
            "that it is made from"
        ) from None


def _add_bodies(spec: mujoco.MjSpec, target: Any) -> None:
    """Add bodies with a hinge where they move, their geoms, and explicit and excluded pairs."""
    bodies = [spec.worldbody]
    parents, freedoms = (
        _column(target, name)[1:, 0] for name in ("body_parentid", "body_dofnum")
    )
    for number, (parent, freedom) in enumerate(
        zip(parents, freedoms, strict=True), start=1
    ):
        body = bodies[int(parent)].add_body(name=f"body {number}")
        body.explicitinertial, body.mass, body.inertia = True, 1.0, [1.0, 1.0, 1.0]
        if freedom:
            body.add_joint(type=mujoco.mjtJoint.mjJNT_HINGE)
        bodies.append(body)
    arrays = _columns(target, "geom", GEOM_FIELDS)
    owners, kinds = (
        _column(target, name)[:, 0] for name in ("geom_bodyid", "geom_type")
    )
    names = _names(target, len(owners))
    for index, (owner, kind) in enumerate(zip(owners, kinds, strict=True)):
        geom = bodies[int(owner)].add_geom(name=names[index], size=[1.0, 1.0, 1.0])
        is_ground = int(kind) in map(int, GROUND_TYPES)
        geom.type = (
            mujoco.mjtGeom.mjGEOM_PLANE if is_ground else mujoco.mjtGeom.mjGEOM_SPHERE
        )
        write_fields(geom, arrays, "geom", GEOM_FIELDS, index)
    for signature in (
        _column(target, "exclude_signature")[:, 0]
        if hasattr(target, "exclude_signature")
        else ()
    ):
        first, second = (f"body {body}" for body in divmod(int(signature), 1 << 16))
        spec.add_exclude(bodyname1=first, bodyname2=second)
    if hasattr(target, "pair_geom1"):
        add_pairs(
            spec,
            _columns(target, "pair", ("geom1", "geom2", "dim", *PAIR_FIELDS)),
            names,
        )


def _names(target: Any, count: int) -> list[str]:
    """Return a unique name for each geom: its own, or its number."""
    texts, addresses = (
        getattr(target, "names", b""),
        getattr(target, "name_geomadr", ()),
    )
    known = [
        bytes(texts)[int(start) :].split(b"\0", 1)[0].decode() for start in addresses
    ]
    return [
        known[geom] if geom < len(known) and known[geom] else f"geom {geom}"
        for geom in range(count)
    ]


def _set_options(spec: mujoco.MjSpec, option: Any) -> None:
    for name in OPTIONS:
        if hasattr(option, name):
            setattr(spec.option, name, int(_array(getattr(option, name)).flat[0]))
    for name in REAL_OPTIONS:
        value = getattr(option, name, None)
        if value is None and name == "impratio":
            value = _array(option.impratio_invsqrt) ** -2.0
        if value is not None:
            setattr(spec.option, name, rounded(float(_array(value).flat[0])))
    spec.option.gravity = [
        rounded(float(one)) for one in _array(option.gravity).reshape(-1, 3)[0]
    ]


# --- numbers ---------------------------------------------------------------------------------------------------------


def _array(value: Any) -> NDArray[Any]:
    """Return an array of any library as one of numpy."""
    return np.asarray(value.numpy() if hasattr(value, "numpy") else value)


def _column(target: Any, name: str) -> NDArray[np.float64]:
    """Return an array of world 0, shape [object_count, width]."""
    values, width = (
        _array(getattr(target, name)).astype(np.float64),
        WIDTHS.get(name, 1),
    )
    while values.ndim > (1 if width == 1 else 2):
        values = values[0]
    return values.reshape(-1, width)


def _columns(
    target: Any, kind: str, fields: Iterable[str]
) -> dict[str, NDArray[np.float64]]:
    """Return arrays of world 0 with the digits of single precision, by name."""
    names = [f"{kind}_{field}" for field in fields]
    return {
        name: np.vectorize(rounded, otypes=[np.float64])(_column(target, name))
        for name in names
    }


def _is_warp(target: Any) -> bool:
    return is_of(
        target[0] if isinstance(target, tuple) and len(target) == 2 else target,
        "mujoco_warp",
        "Model",
    )


READERS = (
    Reader(
        "a mujoco.mjx.Model",
        is_mjx_model,
        lambda target, pair: _read(target, pair, "mjx.Model", "with MJX"),
    ),
    Reader(
        "a mujoco_warp.Model, alone or with its Data as (model, data)",
        _is_warp,
        _read_warp,
    ),
)
