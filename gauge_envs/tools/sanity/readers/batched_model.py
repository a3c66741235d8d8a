"""Read models for GPUs in this process: `mujoco.mjx.Model`, and `mujoco_warp.Model` with its `Data`.

Their arrays have MuJoCo's names, in single precision, and some have one row for each world. A model for MuJoCo is built
from the first world: its bodies, geoms, contact constants and options. Bodies are spheres of its own, which do not
matter, since only constants are read.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from gauge_envs.errors import TargetError
from gauge_envs.tools.sanity.contact_capacity import CapacityLimits, ContactCapacity, ContactNeed
from gauge_envs.tools.sanity.model import TrainingConfiguration
from gauge_envs.tools.sanity.readers.mujoco_model import read_model
from gauge_envs.tools.sanity.readers.reader import GeomPair, Reader

OPTIONS = (
    *("integrator", "cone", "solver", "iterations", "ls_iterations", "ccd_iterations"),
    *("disableflags", "enableflags"),
)
"""Options that are whole numbers; one that an engine does not have keeps MuJoCo's default."""

REAL_OPTIONS = ("timestep", "impratio", "tolerance", "ls_tolerance")
"""Options that are numbers; those of a model for GPUs are in single precision."""

DIGITS = 6
"""Digits that a number in single precision states."""

GEOM_WIDTHS = {
    "contype": 1,
    "conaffinity": 1,
    "condim": 1,
    "priority": 1,
    "solmix": 1,
    "friction": 3,
    "solref": 2,
    "solimp": 5,
    "margin": 1,
    "gap": 1,
}
"""Attributes of a geom by name, with their number of columns."""

PAIR_WIDTHS = {"friction": 5, "solref": 2, "solreffriction": 2, "solimp": 5, "margin": 1, "gap": 1}
"""Attributes of an explicit pair."""

GROUND = {int(kind) for kind in (mujoco.mjtGeom.mjGEOM_PLANE, mujoco.mjtGeom.mjGEOM_HFIELD)}

MODULES = {"mjx": "mujoco.mjx", "mujoco_warp": "mujoco_warp"}
"""Modules that define the models, by name of the engine."""


def _is_model(target: Any, engine: str) -> bool:
    return type(target).__name__ == "Model" and type(target).__module__.startswith(MODULES[engine])


def _is_warp(target: Any) -> bool:
    model = target[0] if isinstance(target, tuple) and len(target) == 2 else target
    return _is_model(model, "mujoco_warp")


def _read_mjx(target: Any, pair: GeomPair | None) -> TrainingConfiguration:
    note = "trains with MJX, in single precision; the rows run MuJoCo's C engine"
    return _read(target, pair, "mjx.Model", note)


def _read_warp(target: Any, pair: GeomPair | None) -> TrainingConfiguration:
    model, data = target if isinstance(target, tuple) else (target, None)
    note = "trains on mujoco_warp, in single precision; the rows run MuJoCo's C engine"
    read = _read(model, pair, "mujoco_warp.Model", note)
    return read if data is None else replace(read, capacity=_capacity(data))


def _read(target: Any, pair: GeomPair | None, name: str, note: str) -> TrainingConfiguration:
    model = _built(target)
    read = read_model(model, name=name, source=f"{name} in this process, world 0", pair=pair)
    unread = "friction loss, limits and actuators do not matter for the rows and are not read"
    return replace(read, notes=(note, unread, *read.notes), foot_geometry=None)


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
    return ContactCapacity(limits=CapacityLimits(njmax=njmax, naconmax=naconmax, worlds=worlds), need=need)


# --- model -----------------------------------------------------------------------------------------------------------


def _built(target: Any) -> mujoco.MjModel:
    """Return a model for MuJoCo with the bodies, geoms, contact constants and options of world 0."""
    spec = mujoco.MjSpec()
    try:
        names = _names(target)
        bodies = _add_bodies(spec, target)
        _add_geoms(bodies, target, names)
        _add_pairs(spec, target, names)
        _set_options(spec, target.opt)
        return spec.compile()
    except (AttributeError, IndexError, TypeError, ValueError) as error:
        raise TargetError(
            f"{type(target).__module__}.Model cannot be read: {' '.join(str(error).split())}; give the mujoco.MjModel "
            "that it is made from"
        ) from None


def _names(target: Any) -> list[str]:
    """Return a unique name for each geom: its own, or its number."""
    count = len(_column(target, "geom_bodyid", 1))
    texts, addresses = getattr(target, "names", b""), getattr(target, "name_geomadr", ())
    own = [bytes(texts)[int(start) :].split(b"\0", 1)[0].decode() for start in addresses]
    return [own[geom] if geom < len(own) and own[geom] else f"geom {geom}" for geom in range(count)]


def _add_bodies(spec: mujoco.MjSpec, target: Any) -> list[Any]:
    parents, joints = _column(target, "body_parentid", 1)[:, 0], _column(target, "body_dofnum", 1)[:, 0]
    bodies = [spec.worldbody]
    for number, (parent, freedoms) in enumerate(zip(parents[1:], joints[1:], strict=True), start=1):
        body = bodies[int(parent)].add_body(name=f"body {number}")
        body.explicitinertial, body.mass, body.inertia = True, 1.0, [1.0, 1.0, 1.0]
        if freedoms:
            body.add_joint(type=mujoco.mjtJoint.mjJNT_HINGE)
        bodies.append(body)
    return bodies


def _add_geoms(bodies: list[Any], target: Any, names: list[str]) -> None:
    owners, kinds = _column(target, "geom_bodyid", 1)[:, 0], _column(target, "geom_type", 1)[:, 0]
    tables = {name: _column(target, f"geom_{name}", width) for name, width in GEOM_WIDTHS.items()}
    for index, (owner, kind) in enumerate(zip(owners, kinds, strict=True)):
        geom = bodies[int(owner)].add_geom(name=names[index], size=[1.0, 1.0, 1.0])
        is_ground = int(kind) in GROUND
        geom.type = mujoco.mjtGeom.mjGEOM_PLANE if is_ground else mujoco.mjtGeom.mjGEOM_SPHERE
        _write(geom, tables, index)


def _add_pairs(spec: mujoco.MjSpec, target: Any, names: list[str]) -> None:
    for signature in _column(target, "exclude_signature", 1)[:, 0] if hasattr(target, "exclude_signature") else ():
        first, second = (f"body {body}" for body in divmod(int(signature), 1 << 16))
        spec.add_exclude(bodyname1=first, bodyname2=second)
    if not hasattr(target, "pair_geom1"):
        return
    firsts, seconds = (_column(target, f"pair_geom{number}", 1)[:, 0] for number in (1, 2))
    dims = _column(target, "pair_dim", 1)[:, 0]
    tables = {name: _column(target, f"pair_{name}", width) for name, width in PAIR_WIDTHS.items()}
    for index, (first, second, dim) in enumerate(zip(firsts, seconds, dims, strict=True)):
        pair = spec.add_pair(geomname1=names[int(first)], geomname2=names[int(second)], condim=int(dim))
        _write(pair, tables, index)


def _write(part: Any, tables: Mapping[str, NDArray[np.float64]], index: int) -> None:
    for name, table in tables.items():
        values = [_rounded(one) for one in table[index]]
        was = getattr(part, name)
        setattr(part, name, values if len(values) > 1 else type(was)(values[0]))


def _set_options(spec: mujoco.MjSpec, option: Any) -> None:
    for name in OPTIONS:
        if hasattr(option, name):
            setattr(spec.option, name, int(_array(getattr(option, name)).flat[0]))
    for name in REAL_OPTIONS:
        value = getattr(option, name, None)
        if value is None and name == "impratio":
            value = _array(option.impratio_invsqrt) ** -2.0
        if value is not None:
            setattr(spec.option, name, _rounded(float(_array(value).flat[0])))
    spec.option.gravity = [_rounded(one) for one in _array(option.gravity).reshape(-1, 3)[0]]


# --- numbers ---------------------------------------------------------------------------------------------------------


def _array(value: Any) -> NDArray[Any]:
    """Return an array of any library as one of numpy."""
    return np.asarray(value.numpy() if hasattr(value, "numpy") else value)


def _column(target: Any, name: str, width: int) -> NDArray[np.float64]:
    """Return an array of world 0, shape [object_count, width]."""
    values = _array(getattr(target, name)).astype(np.float64)
    wanted = 1 if width == 1 else 2
    while values.ndim > wanted:
        values = values[0]
    return values.reshape(-1, width)


def _rounded(value: float) -> float:
    """Return a number with the digits that single precision states, as a file would state it."""
    return float(f"{float(value):.{DIGITS}g}")


MJX_MODEL = Reader(
    name="mjx-model",
    accepts="a mujoco.mjx.Model",
    matches=lambda target: _is_model(target, "mjx"),
    read=_read_mjx,
    has_geoms=True,
)
"""Reader of models of MJX."""

MUJOCO_WARP = Reader(
    name="mujoco-warp-model",
    accepts="a mujoco_warp.Model, alone or with its Data as (model, data)",
    matches=_is_warp,
    read=_read_warp,
    has_geoms=True,
)
"""Reader of models of mujoco_warp; with its data, the memory for contacts is judged."""
