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
    ContactPairs,
    can_move,
    contact_pairs,
    contact_settings,
    default_contact_settings,
)
from gauge_envs.backends.mujoco.options import option_settings
from gauge_envs.backends.mujoco.versions import sparse_advice
from gauge_envs.errors import TargetError
from gauge_envs.names import first_names
from gauge_envs.scene import Vector
from gauge_envs.scene.geometry import BoolArray, IntArray, vector
from gauge_envs.tools.sanity.robot.robot import (
    Robot,
    find_standing,
    free_balls,
    geom_name,
    joints_of,
    random_poses,
    switched_off,
)
from gauge_envs.tools.sanity.verdict import ContactGroup, Need, TrainingConfiguration


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
        groups = _groups(model, pairs, _used(model, pairs, pair))
        contact = dict(next(group.settings for group in groups if group.is_used))
    settings = options | contact
    inapplicable = _inapplicable(model, groups)
    robot = Robot(model=model, pairs=pairs, up=up, spec=spec, pair=pair, file=file)
    robot = replace(robot, standing=find_standing(robot))
    is_fixed = robot.standing is None and not joints_of(model, "FREE", "BALL").any()
    if (
        Need.CONTACT not in inapplicable
        and is_fixed
        and not any(data.ncon for data in random_poses(model, poses=200))
    ):
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
    normal, data = np.array([0.0, 0.0, 1.0]), mujoco.MjData(model)
    if len(planes):
        mujoco.mj_kinematics(model, data)
        normal = data.geom_xmat[planes[0]].reshape(3, 3)[:, 2]
    nearest = np.abs(normal).argmax()
    return vector(np.eye(3)[nearest] * np.sign(normal[nearest]))


# --- which constants count -------------------------------------------------------------------------------------------


def _used(
    model: mujoco.MjModel, pairs: ContactPairs, pair: tuple[str, str] | None
) -> BoolArray:
    """Return which pairs count: a chosen one, or those of the first kind, shape [pair_count].

    Those of free balls count only where there are no others: balls roll where the objects of the experiments rest.
    """
    if pair is None:
        first: BoolArray = pairs.kinds == pairs.kinds.min()
        rests = first & ~free_balls(model)[pairs.geoms].any(axis=1)
        return rests if rests.any() else first
    names = [geom_name(model, geom) for geom in range(model.ngeom)]
    missing = [name for name in pair if name not in names]
    if missing:
        raise TargetError(
            f"the model has no geom {missing[0]!r}; it has {', '.join(names)}"
        )
    chosen: BoolArray = (pairs.geoms == sorted(map(names.index, pair))).all(axis=1)
    if not chosen.any():
        raise TargetError(
            f"geoms {pair[0]!r} and {pair[1]!r} cannot collide in this model: choose two that can"
        )
    return chosen


def _groups(
    model: mujoco.MjModel, pairs: ContactPairs, used: BoolArray
) -> tuple[ContactGroup, ...]:
    """Return the pairs grouped by kind and constants, sorted by kind and number of pairs."""
    keys = np.column_stack([pairs.kinds, pairs.constants])
    _, inverse = np.unique(keys, axis=0, return_inverse=True)
    groups = []
    for number in range(inverse.max() + 1):
        rows = np.flatnonzero(inverse == number)
        group = ContactGroup(
            geoms=_geoms_text(model, pairs.geoms[rows]),
            pair_count=len(rows),
            is_used=bool(used[rows].any()),
            settings=contact_settings(model, pairs.constants[rows[0]]),
        )
        groups.append(((pairs.kinds[rows[0]], -len(rows), number), group))
    return tuple(group for _, group in sorted(groups))


MAX_GEOMS = 4
"""Largest number of geoms that a text lists; further ones are counted."""

# --- names -----------------------------------------------------------------------------------------------------------


def _geoms_text(model: mujoco.MjModel, geoms: IntArray) -> str:
    """Return names of pairs of geoms: those that are fixed with those that move, or these with each other."""
    moves = can_move(model)[geoms]
    sides = [
        first_names([geom_name(model, geom) for geom in np.unique(side)], MAX_GEOMS)
        for side in (geoms[~moves], geoms[moves])
        if len(side)
    ]
    return f"{sides[0]} with {'each other' if len(sides) == 1 else sides[1]}"
