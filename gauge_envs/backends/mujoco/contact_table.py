"""Contact constants of the pairs of geoms of a compiled MuJoCo model, and the settings that reproduce them.

The rules for colliding pairs of geoms and for their constants follow MuJoCo's documentation ("Collision detection" and
"Contact parameters"). They are applied to all pairs together.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from gauge_envs.backends.mujoco.options import overrides_contacts
from gauge_envs.backends.mujoco.settings import PRESETS
from gauge_envs.scene.geometry import BoolArray, FloatArray, IntArray

COLUMNS: Mapping[str, slice] = {
    "condim": slice(0, 1),
    "friction": slice(1, 6),
    "solref": slice(6, 8),
    "solreffriction": slice(8, 10),
    "solimp": slice(10, 15),
    "margin": slice(15, 16),
    "gap": slice(16, 17),
}
"""Columns of a table of contact constants."""

MIN_FRICTION = 1e-5
"""Smallest coefficient of friction of a contact in MuJoCo (mjMINMU)."""

MIN_SOLMIX = 1e-15
"""MuJoCo treats smaller weights as zero (mjMINVAL)."""

GROUND_TYPES = (mujoco.mjtGeom.mjGEOM_PLANE, mujoco.mjtGeom.mjGEOM_HFIELD)


class PairKind(IntEnum):
    """Kind of a pair of geoms, in order of importance."""

    GROUND = 0
    """A moving geom and a plane or height field of the world."""
    STATIC = 1
    """A moving geom and another geom of the world."""
    MOVING = 2
    """Two moving geoms."""


@dataclass(frozen=True, kw_only=True)
class ContactPairs:
    """All pairs of geoms that can collide.

    Attributes:
        geoms: Ids of the two geoms, the smaller first, shape [pair_count, 2].
        kinds: Kind of each pair (`PairKind`), shape [pair_count].
        constants: Effective constants, columns as in `COLUMNS`, shape [pair_count, 17].
    """

    geoms: IntArray
    kinds: IntArray
    constants: FloatArray


def contact_pairs(model: mujoco.MjModel) -> ContactPairs:
    """Return all pairs of geoms that can collide, explicit ones included, with their constants."""
    moves = can_move(model)
    explicit = np.sort(
        np.column_stack([model.pair_geom1, model.pair_geom2]).astype(np.intp), axis=1
    )
    explicit_rows = np.flatnonzero(moves[explicit].any(axis=1))
    explicit = explicit[explicit_rows]
    # An explicit pair replaces the implicit one.
    explicit_pairs = set(map(tuple, explicit.tolist()))
    implicit = _implicit_pairs(model)
    implicit = implicit[[tuple(row) not in explicit_pairs for row in implicit.tolist()]]

    constants = np.vstack(
        [
            _mixed_constants(model, *implicit.T),
            _explicit_constants(model, explicit_rows),
        ]
    )
    if overrides_contacts(model):
        _override(model, constants)
    friction = constants[:, COLUMNS["friction"]]
    np.maximum(friction, MIN_FRICTION, out=friction)

    geoms = np.vstack([implicit, explicit])
    is_ground = np.isin(model.geom_type, GROUND_TYPES) & ~moves
    kinds = np.full(len(geoms), PairKind.STATIC, dtype=np.intp)
    kinds[is_ground[geoms].any(axis=1)] = PairKind.GROUND
    kinds[moves[geoms].all(axis=1)] = PairKind.MOVING
    return ContactPairs(geoms=geoms, kinds=kinds, constants=constants)


def can_move(model: mujoco.MjModel) -> BoolArray:
    """Return whether each geom is on a body that can move, shape [geom_count]."""
    roots = model.body_weldid[model.geom_bodyid]
    return model.body_dofnum[roots] > 0


def _implicit_pairs(model: mujoco.MjModel) -> IntArray:
    """Return pairs whose bits match and that no rule excludes, shape [pair_count, 2]."""
    first, second = np.triu_indices(model.ngeom, 1)
    offers, accepts = model.geom_contype, model.geom_conaffinity
    keep = (offers[first] & accepts[second] | offers[second] & accepts[first]) != 0
    moves = can_move(model)
    keep &= moves[first] | moves[second]
    bodies = model.geom_bodyid
    roots = model.body_weldid[bodies]
    keep &= roots[first] != roots[second]
    if not model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_FILTERPARENT:
        # The rule does not apply to the world body: a child of the world collides with the floor.
        parents = model.body_weldid[model.body_parentid[roots]]
        related = (parents[first] == roots[second]) | (parents[second] == roots[first])
        keep &= ~(related & (roots[first] != 0) & (roots[second] != 0))
    low, high = (
        np.minimum(bodies[first], bodies[second]),
        np.maximum(bodies[first], bodies[second]),
    )
    keep &= ~np.isin((low.astype(np.int64) << 16) + high, model.exclude_signature)
    ground = np.isin(model.geom_type, GROUND_TYPES)
    keep &= ~(ground[first] & ground[second])
    return np.column_stack([first[keep], second[keep]])


def _mixed_constants(
    model: mujoco.MjModel, first: IntArray, second: IntArray
) -> FloatArray:
    """Return constants of pairs, mixed from the constants of their geoms, shape [pair_count, 17]."""
    table = np.zeros((len(first), 17))
    rank = model.geom_priority[first] - model.geom_priority[second]
    share = _share(model.geom_solmix[first], model.geom_solmix[second])
    share[rank > 0] = 1.0
    share[rank < 0] = 0.0
    share = share[:, None]

    def by_priority(values: NDArray[Any]) -> NDArray[Any]:
        """Return the value of the geom with the higher priority, or the greater value for equal priorities."""
        chosen = np.maximum(values[first], values[second])
        chosen[rank > 0] = values[first[rank > 0]]
        chosen[rank < 0] = values[second[rank < 0]]
        return chosen

    def mixed(values: FloatArray) -> FloatArray:
        return share * values[first] + (1.0 - share) * values[second]

    table[:, 0] = by_priority(model.geom_condim)
    # Sliding, torsional and rolling friction of a geom are two, one and two coefficients of a contact.
    table[:, COLUMNS["friction"]] = by_priority(model.geom_friction)[:, [0, 0, 1, 2, 2]]
    solref = model.geom_solref
    is_standard = (solref[first, 0] > 0.0) & (solref[second, 0] > 0.0) | (rank != 0)
    # The direct format, minus stiffness and damping, is not averaged: the minimum is the stiffer value.
    direct = np.minimum(solref[first], solref[second])
    table[:, COLUMNS["solref"]] = np.where(is_standard[:, None], mixed(solref), direct)
    table[:, COLUMNS["solimp"]] = mixed(model.geom_solimp)
    # Margins and gaps add up for all priorities.
    table[:, COLUMNS["margin"].start] = (
        model.geom_margin[first] + model.geom_margin[second]
    )
    table[:, COLUMNS["gap"].start] = model.geom_gap[first] + model.geom_gap[second]
    return table


def _share(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the weight of the first geom's solref and solimp in the mean, from both geoms' solmix."""
    known = np.where(first >= MIN_SOLMIX, first, 0.0)
    total = known + np.where(second >= MIN_SOLMIX, second, 0.0)
    return np.divide(known, total, out=np.full(len(total), 0.5), where=total > 0.0)


def _explicit_constants(model: mujoco.MjModel, rows: IntArray) -> FloatArray:
    """Return constants of explicit pairs, shape [pair_count, 17]."""
    columns = (
        model.pair_dim,
        model.pair_friction,
        model.pair_solref,
        model.pair_solreffriction,
        model.pair_solimp,
        model.pair_margin,
        model.pair_gap,
    )
    return np.column_stack(columns)[rows].reshape(-1, 17)


def _override(model: mujoco.MjModel, constants: FloatArray) -> None:
    """Replace constants by the constants that the flag `override` gives to all contacts."""
    option = model.opt
    for name, value in (
        ("friction", option.o_friction),
        ("solref", option.o_solref),
        ("solreffriction", option.o_solref),
        ("solimp", option.o_solimp),
        ("margin", option.o_margin),
    ):
        constants[:, COLUMNS[name]] = value


# --- settings ---------------------------------------------------------------------------------------------------------


def contact_settings(model: mujoco.MjModel, constants: FloatArray) -> dict[str, Any]:
    """Return the settings that give every contact a pair's constants; settings at their defaults are left out.

    Args:
        model: The model.
        constants: Constants of the pair in the columns `COLUMNS`, shape [17].
    """
    values = {name: constants[columns].tolist() for name, columns in COLUMNS.items()}
    dimension = int(constants[0])
    settings = {
        "contact_solref": values["solref"],
        "contact_solimp": values["solimp"],
    }
    if (
        any(values["solreffriction"])
        and model.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC
    ):
        settings["contact_solreffriction"] = values["solreffriction"]
    for name in ("margin", "gap"):
        if any(values[name]):
            settings[f"contact_{name}_m"] = values[name][0]
    if dimension != 3:
        settings["condim"] = dimension
    if overrides_contacts(model):
        return settings | {"o_friction": values["friction"]}
    if dimension >= 4:
        settings["torsional_friction_m"] = values["friction"][2]
    if dimension == 6:
        settings["rolling_friction_m"] = values["friction"][3]
    return settings


def default_contact_settings() -> dict[str, Any]:
    """Return the settings that give every contact MuJoCo's defaults."""
    default = PRESETS["out_of_box"].model_dump(mode="json")
    return {name: default[name] for name in ("contact_solref", "contact_solimp")}
