"""The target's own model: its robot, what is known of it, and a copy with changes as a user would paste them."""

import copy
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from gauge_envs.backends.mujoco.model import (
    CONES,
    DISABLE_FLAGS,
    ENABLE_FLAGS,
    INTEGRATORS,
    SAME_NAME_OPTIONS,
    SOLVERS,
)
from gauge_envs.backends.mujoco.model_settings import ContactPairs
from gauge_envs.errors import TargetError
from gauge_envs.scene import Vector
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.sanity.model import Settings
from gauge_envs.tools.sanity.robot.mujoco_feet import (
    Standing,
    first_moving_body,
    ground_rows,
    stance_of,
)

GEOM_FIELDS = {
    "contact_solref": "solref",
    "contact_solimp": "solimp",
    "contact_margin_m": "margin",
    "contact_gap_m": "gap",
    "condim": "condim",
}
"""Attributes of a geom by the names of settings."""

OPTIONS = {"integrator": INTEGRATORS, "cone": CONES, "solver": SOLVERS}

ELEMENT = re.compile(r"(\w+)\[(\d+)\]")
"""Name of a change of one row of an array of the model, as `geom_condim[3]`."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Robot:
    """A compiled model.

    Attributes:
        model: The model.
        pairs: All pairs of geoms that can collide.
        up: Unit vector away from the ground, shape [3].
        standing: The robot that stands on the ground; None when there is none.
        spec: The model before it was compiled; None when only the compiled one is known.
        pair: Names of two geoms whose constants count; None for all on the ground.
        action_rad: Angle by which an action of 1 moves the target of a servo [rad]; None when the task states none.
        delay_s: Longest delay between an observation and the torque that answers it [s]; None when not stated.
    """

    model: mujoco.MjModel
    pairs: ContactPairs
    up: Vector
    standing: Standing | None = None
    spec: mujoco.MjSpec | None = None
    pair: tuple[str, str] | None = None
    action_rad: float | None = None
    delay_s: float | None = None

    @cached_property
    def bodies(self) -> list[int]:
        """Bodies of the robot that stands; without one, all bodies that move."""
        roots = [
            first_moving_body(self.model, body) for body in range(self.model.nbody)
        ]
        if self.standing is not None:
            return [
                body for body, root in enumerate(roots) if root == self.standing.body
            ]
        return [
            body
            for body in range(1, self.model.nbody)
            if self.model.body_dofnum[roots[body]]
        ]

    @cached_property
    def foot_rows(self) -> list[int]:
        """Rows of `pairs` in which a foot meets the ground."""
        feet = (
            set()
            if self.standing is None
            else {geom for geoms in self.standing.feet.values() for geom in geoms}
        )
        return [
            int(row)
            for row in ground_rows(self.pairs)
            if feet & set(self.pairs.geoms[row].tolist())
        ]

    @property
    def is_floating(self) -> bool:
        """Whether the robot stands and its first joint is free."""
        if self.standing is None:
            return False
        joint = int(self.model.body_jntadr[self.standing.body])
        return int(self.model.jnt_type[joint]) == int(mujoco.mjtJoint.mjJNT_FREE)

    @cached_property
    def plane_normal(self) -> FloatArray | None:
        """Normal of the vertical plane in which the robot moves, shape [3]; None when it moves in space."""
        model, bodies = self.model, set(self.bodies)
        joints = [
            joint
            for joint in range(model.njnt)
            if int(model.jnt_bodyid[joint]) in bodies
        ]
        axes = stance_of(model, np.asarray(self.up)).joint_axes
        turning = [
            axes[j]
            for j in joints
            if int(model.jnt_type[j]) == int(mujoco.mjtJoint.mjJNT_HINGE)
        ]
        sliding = [
            axes[j]
            for j in joints
            if int(model.jnt_type[j]) == int(mujoco.mjtJoint.mjJNT_SLIDE)
        ]
        if not turning or len(turning) + len(sliding) < len(joints):
            return None
        normal = np.asarray(turning[0])
        is_planar = (
            all(abs(axis @ normal) > 0.999 for axis in turning)
            and abs(normal[2]) < 1e-3
        )
        return (
            normal
            if is_planar and all(abs(axis @ normal) < 1e-3 for axis in sliding)
            else None
        )

    def reached_by_default(self, name: str) -> list[int]:
        """Return geoms that take an attribute from the model's default class.

        Without a spec, these are the geoms with the most frequent value.
        """
        field = GEOM_FIELDS[name]
        if self.spec is None:
            values = getattr(self.model, f"geom_{field}").reshape(self.model.ngeom, -1)
            _, several, counts = np.unique(
                values, axis=0, return_inverse=True, return_counts=True
            )
            return [
                int(geom) for geom in np.flatnonzero(several.ravel() == counts.argmax())
            ]
        default = np.atleast_1d(getattr(self.spec.default.geom, field))
        return [
            geom.id
            for geom in self.spec.geoms
            if geom.id >= 0
            and np.array_equal(np.atleast_1d(getattr(geom, field)), default)
            and np.array_equal(
                np.atleast_1d(getattr(geom.classname.geom, field)), default
            )
        ]

    @cached_property
    def grounded(self) -> set[int]:
        """Geoms that can touch the ground, those of the ground, and those of a hand and of what it can hold."""
        rows = [
            *ground_rows(self.pairs),
            *np.flatnonzero(grasp_kinds(self.model, self.pairs)),
        ]
        return set(np.unique(self.pairs.geoms[rows]).tolist())

    def needs_default(self, name: str, value: Any) -> bool:
        """Return whether a default changes a geom on the ground."""
        array = getattr(self.model, f"geom_{GEOM_FIELDS[name]}")
        return any(
            not np.array_equal(array[g], value)
            for g in self.reached_by_default(name)
            if g in self.grounded
        )

    def changed(self, changes: Settings) -> tuple[mujoco.MjModel, dict[str, list[int]]]:
        """Return a copy of the model with changes, and the geoms on the ground that state attributes of their own.

        Options are set; attributes of geoms reach those that take them from the default class, and each geom on the
        ground that states its own is changed too. A name such as `geom_condim[3]` changes a row of an array.
        """
        model, stating = self._colliding(changes), {}
        for name, value in changes.items():
            if name in GEOM_FIELDS:
                array = getattr(model, f"geom_{GEOM_FIELDS[name]}")
                reached = self.reached_by_default(name)
                others = self.grounded - set(reached)
                stating[name] = sorted(
                    geom for geom in others if not np.array_equal(array[geom], value)
                )
                # The margins and gaps of two geoms add up.
                array[[*reached, *stating[name]]] = (
                    value
                    if name not in ("contact_margin_m", "contact_gap_m")
                    else value / 2
                )
            elif found := ELEMENT.fullmatch(name):
                getattr(model, found[1])[int(found[2])] = value
            else:
                _set_option(model, name, value)
        try:
            mujoco.mj_setConst(model, mujoco.MjData(model))
        except mujoco.FatalError as error:
            raise TargetError(f"the change needs the model's file: {error}") from None
        return model, {name: geoms for name, geoms in stating.items() if geoms}

    def _colliding(self, changes: Settings) -> mujoco.MjModel:
        """Return a copy of the model, compiled again where geoms are to collide that were not compiled for it."""
        found = {
            name: ELEMENT.fullmatch(name)
            for name in changes
            if name.startswith("geom_con")
        }
        if self.spec is None or not found:
            return copy.copy(self.model)
        spec = self.spec.copy()
        for geom, original in zip(spec.geoms, self.spec.geoms, strict=True):
            for name, match in found.items():
                if (
                    match is not None
                    and int(match[2]) == original.id
                    and match[1] != "geom_condim"
                ):
                    setattr(geom, match[1].removeprefix("geom_"), changes[name])
        return spec.compile()


def _set_option(model: mujoco.MjModel, name: str, value: Any) -> None:
    """Set an option or a flag of a model by the name of this package's setting; others do not belong to models."""
    option = model.opt
    if name == "timestep_s":
        option.timestep = value
    elif name == "gravity":
        option.gravity[:] = value
    elif name in OPTIONS:
        setattr(option, name, int(OPTIONS[name][value]))
    elif name in SAME_NAME_OPTIONS:
        setattr(option, name, value)
    elif name in DISABLE_FLAGS:
        bit = int(DISABLE_FLAGS[name])
        option.disableflags = (
            option.disableflags & ~bit if value else option.disableflags | bit
        )
    elif name in ENABLE_FLAGS:
        bit = int(ENABLE_FLAGS[name])
        option.enableflags = (
            option.enableflags | bit if value else option.enableflags & ~bit
        )
    elif name == "o_friction" and value is None:
        option.enableflags &= ~int(mujoco.mjtEnableBit.mjENBL_OVERRIDE)


def grasp_kinds(model: mujoco.MjModel, pairs: ContactPairs) -> NDArray[np.int_]:
    """Return for each pair 1 where a part whose joints have motors can hold a free body, 2 if at a point, or else 0."""
    roots = model.body_rootid
    motors = model.actuator_trnid[
        model.actuator_trntype == int(mujoco.mjtTrn.mjTRN_JOINT), 0
    ]
    driven = np.isin(roots, roots[model.jnt_bodyid[motors]])
    free = (
        np.isin(
            roots, model.jnt_bodyid[model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE)]
        )
        & ~driven
    )
    bodies = model.geom_bodyid[pairs.geoms]
    round_geoms = np.isin(
        model.geom_type,
        [int(mujoco.mjtGeom.mjGEOM_SPHERE), int(mujoco.mjtGeom.mjGEOM_ELLIPSOID)],
    )
    at_point = (driven[bodies] & round_geoms[pairs.geoms]).any(axis=1)
    kinds: NDArray[np.int_] = (
        driven[bodies].any(axis=1) & free[bodies].any(axis=1)
    ) * (1 + at_point)
    return kinds


def never_touches(robot: Robot, poses: int = 200) -> bool:
    """Return whether no two geoms of a robot that is fixed to the world touch in random poses within joint limits."""
    if (
        robot.standing is not None
        or (robot.model.jnt_type < int(mujoco.mjtJoint.mjJNT_SLIDE)).any()
    ):
        return False
    return not any(data.ncon for data in random_poses(robot.model, poses))


def random_poses(model: mujoco.MjModel, poses: int) -> Iterator[mujoco.MjData]:
    """Yield a model in random poses within its joint limits, at rest; free and ball joints stay."""
    data, generator = mujoco.MjData(model), np.random.default_rng(0)
    for _ in range(poses):
        for joint in np.flatnonzero(model.jnt_type >= int(mujoco.mjtJoint.mjJNT_SLIDE)):
            is_hinge = int(model.jnt_type[joint]) == int(mujoco.mjtJoint.mjJNT_HINGE)
            free = (-np.pi, np.pi) if is_hinge else (-1.0, 1.0)
            low, high = model.jnt_range[joint] if model.jnt_limited[joint] else free
            data.qpos[model.jnt_qposadr[joint]] = generator.uniform(low, high)
        mujoco.mj_forward(model, data)
        yield data
