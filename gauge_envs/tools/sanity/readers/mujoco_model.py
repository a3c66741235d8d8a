"""Read a training configuration from a MuJoCo model.

A model has contact constants for each pair of geoms, but a simulation of an experiment has one set of constants. It
runs with each set of moving geoms on the ground, against which feet, wheels and fingers push. All pairs that can
collide are considered: `mjData.contact` lists only those that touch at the moment.
"""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np

from gauge_envs.backends.mujoco.contact_table import (
    COLUMNS,
    ContactPairs,
    can_move,
    contact_pairs,
    contact_settings,
    default_contact_settings,
    effective_constants,
)
from gauge_envs.backends.mujoco.options import option_settings
from gauge_envs.backends.mujoco.versions import sparse_advice
from gauge_envs.errors import TargetError
from gauge_envs.scene import Vector
from gauge_envs.scene.geometry import FloatArray, IntArray, vector
from gauge_envs.tools.sanity.readers.settings import check_settings
from gauge_envs.tools.sanity.robot.robot import (
    Robot,
    free_balls,
    geom_name,
    listed,
    never_touches,
    switched_off,
)
from gauge_envs.tools.sanity.robot.standing import find_standing
from gauge_envs.tools.sanity.training import ContactGroup, Need, TrainingConfiguration


def mujoco_configuration(
    model: mujoco.MjModel,
    *,
    name: str,
    source: str,
    pair: tuple[str, str] | None = None,
    spec: mujoco.MjSpec | None = None,
    file: Path | None = None,
) -> TrainingConfiguration:
    """Return the training configuration of a MuJoCo model, after a trial of its settings.

    Args:
        model: The compiled model.
        name: Name of the configuration.
        source: Description of where the model is from.
        pair: Names of two geoms whose constants the experiments get, instead of all sets on ground.
        spec: The model before it was compiled, with the ids of the compiled one; None when it is unknown.
        file: File of the model; None when it is unknown.
    """
    options, pairs, up = option_settings(model), contact_pairs(model), _up(model)
    groups: tuple[ContactGroup, ...] = ()
    contact = default_contact_settings()
    if len(pairs.geoms) or pair is not None:
        used = _used_constants(model, pairs, pair)
        groups = _groups(model, pairs, used, all_on_ground=pair is None)
        contact = contact_settings(model, used)
    settings = options | contact
    check_settings("mujoco", settings)
    inapplicable = _inapplicable(model, groups)
    robot = Robot(model=model, pairs=pairs, up=up, spec=spec, pair=pair, file=file)
    robot = replace(robot, standing=find_standing(robot))
    if Need.CONTACT not in inapplicable and never_touches(robot):
        inapplicable[Need.CONTACT] = (
            "the robot is fixed to the world and touches nothing in 200 random poses"
        )
    if robot.moves_along_axis:
        inapplicable[Need.SPACE] = (
            "the robot moves in a plane along an axis of the world, where slide-* checks it"
        )
    return TrainingConfiguration(
        name=name,
        source=source,
        backend="mujoco",
        settings=settings,
        contact_groups=groups,
        notes=tuple(filter(None, [sparse_advice(model)])),
        inapplicable=inapplicable,
        up=up,
        robot=robot,
    )


def _inapplicable(
    model: mujoco.MjModel, groups: tuple[ContactGroup, ...]
) -> dict[Need, str]:
    """Return the needs of checks that the model does not meet, with the reason."""
    reasons = {}
    if switched_off(model, "gravity") or not model.opt.gravity.any():
        reasons[Need.GRAVITY] = "the model has no gravity"
    if not groups:
        reasons[Need.CONTACT] = "no two geoms of the model can collide"
    elif switched_off(model, "contact"):
        reasons[Need.CONTACT] = "the model switches contacts off"
    return reasons


def _up(model: mujoco.MjModel) -> Vector:
    """Return the coordinate axis nearest to the normal of the first plane of the world; z without a plane."""
    planes = np.flatnonzero(
        (model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE) & ~can_move(model)
    )
    normal = np.array([0.0, 0.0, 1.0])
    if len(planes):
        mujoco.mju_rotVecQuat(normal, normal.copy(), model.geom_quat[planes[0]])
    nearest = np.abs(normal).argmax()
    return vector(np.eye(3)[nearest] * np.sign(normal[nearest]))


# --- which constants count -------------------------------------------------------------------------------------------


def _used_constants(
    model: mujoco.MjModel, pairs: ContactPairs, pair: tuple[str, str] | None
) -> FloatArray:
    """Return the constants of a pair, or the most frequent ones of the first kind of pairs, shape [17]."""
    if pair is not None:
        names = [geom_name(model, geom) for geom in range(model.ngeom)]
        missing = [name for name in pair if name not in names]
        if missing:
            raise TargetError(
                f"the model has no geom {missing[0]!r}; it has {', '.join(names)}"
            )
        wanted = sorted(map(names.index, pair))
        rows = np.flatnonzero((pairs.geoms == wanted).all(axis=1))
        if not len(rows):
            raise TargetError(
                f"geoms {pair[0]!r} and {pair[1]!r} cannot collide in this model: choose two that can"
            )
        return pairs.constants[rows[0]]
    rows = np.flatnonzero(pairs.kinds == pairs.kinds.min())
    effective = effective_constants(model, pairs.constants[rows])
    _, first, counts = np.unique(
        effective, axis=0, return_index=True, return_counts=True
    )
    return pairs.constants[rows[first[counts.argmax()]]]


def _groups(
    model: mujoco.MjModel,
    pairs: ContactPairs,
    used: FloatArray,
    *,
    all_on_ground: bool,
) -> tuple[ContactGroup, ...]:
    """Return the pairs grouped by kind and constants, sorted by kind and number of pairs.

    Groups with the constants `used` are in use, and with `all_on_ground` all groups of the first kind. Groups of free
    balls alone are not: balls roll and bounce where the objects of the experiments rest and slide.
    """
    keys = np.column_stack([pairs.kinds, pairs.constants])
    _, inverse = np.unique(keys, axis=0, return_inverse=True)
    groups = []
    for number in range(inverse.max() + 1):
        rows = np.flatnonzero(inverse == number)
        constants = pairs.constants[rows[0]]
        kind = pairs.kinds[rows[0]]
        rolls = free_balls(model)[pairs.geoms[rows]].any(axis=1).all()
        same = effective_constants(model, constants) == effective_constants(model, used)
        named = {
            name: constants[columns].squeeze().tolist()
            for name, columns in COLUMNS.items()
        }
        group = ContactGroup(
            geoms=_geoms_text(model, pairs.geoms[rows]),
            pair_count=len(rows),
            constants=named | {"condim": int(constants[0])},
            is_used=bool(
                same.all()
                or (all_on_ground and kind == pairs.kinds.min() and not rolls)
            ),
            settings=contact_settings(model, constants),
        )
        groups.append(((kind, -len(rows), number), group))
    return tuple(group for _, group in sorted(groups))


# --- names -----------------------------------------------------------------------------------------------------------


def _geoms_text(model: mujoco.MjModel, geoms: IntArray) -> str:
    """Return names of pairs of geoms: those that are fixed with those that move, or these with each other."""
    moves = can_move(model)[geoms]
    sides = [
        listed([geom_name(model, geom) for geom in np.unique(side).tolist()])
        for side in (geoms[~moves], geoms[moves])
        if len(side)
    ]
    return f"{sides[0]} with {'each other' if len(sides) == 1 else sides[1]}"
