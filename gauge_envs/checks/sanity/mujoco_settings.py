"""A MuJoCo model as settings of the MuJoCo backend: its options, and the constants of the contacts that it trains on.

A model has a set of constants for each pair of geoms, and the experiments have one: that of moving geoms on the
ground, which feet, wheels and fingers push against. MuJoCo's rules of which geoms collide and what the constants of a
pair are (documentation, "Collision detection" and "Contact parameters") are applied here to all pairs at once, since
only those that happen to touch show up in `mjData.contact`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from gauge_envs.backends.mujoco.contact_pairs import COLUMNS, ContactPairs, PairKind, can_move, contact_pairs
from gauge_envs.backends.mujoco.model import CONES, DISABLE_FLAGS, ENABLE_FLAGS, INTEGRATORS, SAME_NAME_OPTIONS, SOLVERS
from gauge_envs.backends.mujoco.settings import PRESETS
from gauge_envs.checks.sanity.model import ContactGroup
from gauge_envs.errors import TargetError
from gauge_envs.scene import GRAVITY_M_PER_S2

__all__ = [
    "ModelSettings",
    "model_settings",
]


SAME_GRAVITY = 0.01
"""Gravity that differs from the standard one by less than this ratio is not worth a note."""

MOST_GEOMS = 4
"""Geoms that are named one by one; of more, the rest is counted."""

MOST_DIFFERENCES = 4
"""Groups with other constants that are told one by one."""


NOT_CARRIED = {
    "constraint": mujoco.mjtDisableBit.mjDSBL_CONSTRAINT,
    "contact": mujoco.mjtDisableBit.mjDSBL_CONTACT,
    "limit": mujoco.mjtDisableBit.mjDSBL_LIMIT,
}
"""Parts of physics that a model may switch off; the experiments need them."""


@dataclass(frozen=True, kw_only=True)
class ModelSettings:
    """What is read from a model.

    Attributes:
        settings: Settings of the MuJoCo backend.
        origins: Where each is from.
        groups: Pairs of geoms by their constants, ground first, then by number.
        notes: What could not be carried over, or deserves a look.
    """

    settings: Mapping[str, Any]
    origins: Mapping[str, str]
    groups: tuple[ContactGroup, ...]
    notes: tuple[str, ...]


def model_settings(model: mujoco.MjModel, *, pair: tuple[str, str] | None = None) -> ModelSettings:
    """Settings of the MuJoCo backend that simulate as a model does.

    Args:
        model: The compiled model.
        pair: Names of the two geoms whose constants the experiments get, instead of the most frequent on ground.

    Raises:
        TargetError: There is no such geom, or the two cannot collide.
    """
    options = _options(model)
    pairs = contact_pairs(model)
    used = None if not len(pairs.geoms) and pair is None else _used_row(model, pairs, pair)
    groups = _groups(model, pairs, used)
    contact = _default_contact() if used is None else _contact_settings(model, used)
    origin = next((group.geoms for group in groups if group.is_used), "MuJoCo's defaults: nothing collides")
    if model.opt.enableflags & mujoco.mjtEnableBit.mjENBL_OVERRIDE:
        origin = "option, flag override"
    notes = (*_contact_notes(groups, used), *_option_notes(model))
    return ModelSettings(
        settings=options | contact,
        origins=dict.fromkeys(options, "option") | dict.fromkeys(contact, origin),
        groups=groups,
        notes=notes,
    )


# --- options ---------------------------------------------------------------------------------------------------------


def _options(model: mujoco.MjModel) -> dict[str, Any]:
    option = model.opt
    values: dict[str, Any] = {
        "timestep_s": float(option.timestep),
        "integrator": _name(INTEGRATORS, option.integrator),
        "cone": _name(CONES, option.cone),
        "solver": _name(SOLVERS, option.solver),
    }
    values |= {name: getattr(option, name) for name in SAME_NAME_OPTIONS}
    values |= {name: not option.disableflags & bit for name, bit in DISABLE_FLAGS.items()}
    return values | {name: bool(option.enableflags & bit) for name, bit in ENABLE_FLAGS.items()}


def _name(known: Mapping[str, Any], value: int) -> str:
    return next(name for name, constant in known.items() if constant == value)


def _option_notes(model: mujoco.MjModel) -> list[str]:
    option = model.opt
    notes = []
    down = 0.0 - float(option.gravity[2])
    if option.disableflags & mujoco.mjtDisableBit.mjDSBL_GRAVITY:
        notes.append("the model switches gravity off; the experiments have it")
    elif np.abs(option.gravity - np.array([0.0, 0.0, -GRAVITY_M_PER_S2])).max() > SAME_GRAVITY * GRAVITY_M_PER_S2:
        told = (
            f"{down:g} m/s^2"
            if not option.gravity[:2].any()
            else f"({', '.join(f'{g:g}' for g in option.gravity)}) m/s^2"
        )
        notes.append(f"gravity of the model is {told}; the experiments have {GRAVITY_M_PER_S2:g} m/s^2")
    off = [name for name, bit in NOT_CARRIED.items() if option.disableflags & bit]
    if off:
        notes.append(f"the model switches off {', '.join(off)}; the experiments need it")
    if option.density or option.viscosity or option.wind.any():
        notes.append("the model's medium (density, viscosity, wind) is not carried over; the experiments have none")
    for flag, told in ((model.flg_adhesion, "adhesion"), (model.flg_surfacevel, "surface velocity")):
        if flag:
            notes.append(f"{told} of geoms is not carried over")
    if model.nflex:
        notes.append("deformable bodies of the model are not read")
    return notes


# --- which constants count -------------------------------------------------------------------------------------------


def _carried(model: mujoco.MjModel, constants: NDArray[np.float64]) -> NDArray[np.float64]:
    """Constants without those that have no effect and, unless it is overridden, sliding friction, of any shape."""
    carried = constants.copy()
    dimension = carried[..., 0]
    friction = carried[..., COLUMNS["friction"]]
    if not model.opt.enableflags & mujoco.mjtEnableBit.mjENBL_OVERRIDE:
        friction[..., :2] = 0.0
    friction[..., 2][dimension < 4] = 0.0
    friction[..., 3:][dimension < 6] = 0.0
    if model.opt.cone != mujoco.mjtCone.mjCONE_ELLIPTIC:
        carried[..., COLUMNS["solreffriction"]] = 0.0
    return carried


def _used_row(model: mujoco.MjModel, pairs: ContactPairs, pair: tuple[str, str] | None) -> NDArray[np.float64]:
    """Constants of the pair that was asked for, or the most frequent ones of the kind that counts most, shape [17]."""
    if pair is not None:
        wanted = sorted(_geom_id(model, name) for name in pair)
        rows = np.flatnonzero((pairs.geoms == wanted).all(axis=1))
        if not len(rows):
            raise TargetError(f"geoms {pair[0]!r} and {pair[1]!r} cannot collide in this model: choose two that can")
        row: NDArray[np.float64] = pairs.constants[rows[0]]
        return row
    rows = np.flatnonzero(pairs.kinds == pairs.kinds.min())
    _, first, counts = np.unique(_carried(model, pairs.constants[rows]), axis=0, return_index=True, return_counts=True)
    most: NDArray[np.float64] = pairs.constants[rows[first[counts.argmax()]]]
    return most


def _default_contact() -> dict[str, Any]:
    """MuJoCo's constants of geoms that state nothing."""
    default = PRESETS["out_of_box"].model_dump(mode="json")
    return {name: default[name] for name in ("contact_solref", "contact_solimp")}


def _contact_settings(model: mujoco.MjModel, row: NDArray[np.float64]) -> dict[str, Any]:
    """Settings of the backend from constants of a pair; what is as in the backend's recipe is left out."""
    values = {name: row[columns].tolist() for name, columns in COLUMNS.items()}
    dimension = int(row[0])
    settings: dict[str, Any] = {"contact_solref": values["solref"], "contact_solimp": values["solimp"]}
    if any(values["solreffriction"]) and model.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC:
        settings["contact_solreffriction"] = values["solreffriction"]
    for name in ("margin", "gap"):
        if any(values[name]):
            settings[f"contact_{name}_m"] = values[name][0]
    if dimension != 3:
        settings["condim"] = dimension
    if model.opt.enableflags & mujoco.mjtEnableBit.mjENBL_OVERRIDE:
        return settings | {"o_friction": values["friction"]}
    if dimension >= 4:
        settings["torsional_friction_m"] = values["friction"][2]
    if dimension == 6:
        settings["rolling_friction_m"] = values["friction"][3]
    return settings


def _groups(model: mujoco.MjModel, pairs: ContactPairs, used: NDArray[np.float64] | None) -> tuple[ContactGroup, ...]:
    if used is None:
        return ()
    keys = np.column_stack([pairs.kinds, pairs.constants])
    _, inverse = np.unique(keys, axis=0, return_inverse=True)
    groups = []
    for number in range(inverse.max() + 1):
        rows = np.flatnonzero(inverse == number)
        constants = pairs.constants[rows[0]]
        kind = PairKind(int(pairs.kinds[rows[0]]))
        group = ContactGroup(
            geoms=_told_geoms(model, pairs.geoms[rows], kind),
            pair_count=len(rows),
            constants={
                name: constants[columns].tolist()
                if columns.stop - columns.start > 1
                else constants[columns.start].item()
                for name, columns in COLUMNS.items()
            }
            | {"condim": int(constants[0])},
            is_used=bool((_carried(model, constants) == _carried(model, used)).all()),
        )
        groups.append((kind, -len(rows), number, group))
    return tuple(entry[-1] for entry in sorted(groups, key=lambda entry: entry[:3]))


def _contact_notes(groups: tuple[ContactGroup, ...], used: NDArray[np.float64] | None) -> list[str]:
    if used is None:
        return [
            "no two geoms can collide: contacts of the experiments have MuJoCo's defaults and say nothing of training"
        ]
    told = next(group for group in groups if group.is_used).constants
    others = [group for group in groups if not group.is_used]
    notes = []
    for group in others[:MOST_DIFFERENCES]:
        changed = [name for name in COLUMNS if name != "friction" and group.constants[name] != told[name]]
        if group.constants["friction"][2:] != told["friction"][2:] and group.constants["condim"] > 3:
            changed.append("friction")
        differences = ", ".join(f"{name} {_told(group.constants[name])}" for name in changed)
        notes.append(f"not used: {group.geoms} ({group.pair_count} {_pairs(group.pair_count)}) with {differences}")
    if len(others) > MOST_DIFFERENCES:
        notes.append(f"not used: {len(others) - MOST_DIFFERENCES} more groups of contacts with other constants")
    return notes


def _pairs(count: int) -> str:
    return "pair" if count == 1 else "pairs"


def _told(value: Any) -> str:
    return " ".join(f"{number:g}" for number in value) if isinstance(value, list) else f"{value:g}"


# --- names -----------------------------------------------------------------------------------------------------------


def _geom_name(model: mujoco.MjModel, index: int) -> str:
    """Name of a geom; where it has none, its number and its body."""
    name = model.geom(index).name
    return name or f"geom {index} of {model.body(int(model.geom_bodyid[index])).name or 'an unnamed body'}"


def _geom_id(model: mujoco.MjModel, name: str) -> int:
    names = [_geom_name(model, index) for index in range(model.ngeom)]
    if name not in names:
        raise TargetError(f"the model has no geom {name!r}; it has {', '.join(names)}")
    return names.index(name)


def _told_geoms(model: mujoco.MjModel, geoms: NDArray[np.intp], kind: PairKind) -> str:
    if kind is PairKind.MOVING:
        return f"{_listed(model, np.unique(geoms))} with each other"
    static = ~can_move(model)[geoms]
    return f"{_listed(model, np.unique(geoms[static]))} with {_listed(model, np.unique(geoms[~static]))}"


def _listed(model: mujoco.MjModel, indices: NDArray[np.intp]) -> str:
    names = [_geom_name(model, int(index)) for index in indices]
    shown = names if len(names) <= MOST_GEOMS else [*names[: MOST_GEOMS - 1], f"{len(names) - MOST_GEOMS + 1} more"]
    return shown[0] if len(shown) == 1 else f"{', '.join(shown[:-1])} and {shown[-1]}"
