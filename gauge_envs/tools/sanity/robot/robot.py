"""The target's own model: its robot, what is known of it, and a copy with changes as a user would paste them."""

import copy
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property, wraps
from itertools import product
from typing import Any, Concatenate, ParamSpec, TypeVar

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
from gauge_envs.scene.geometry import BoolArray, FloatArray
from gauge_envs.tools.sanity.model import Settings
from gauge_envs.tools.sanity.robot.mujoco_feet import (
    Standing,
    first_moving_body,
    ground_rows,
    joints_of,
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

PAIRED = ("contact_solref", "contact_solimp")
"""Settings that explicit pairs state instead of their geoms, in the same form."""

COMPILER = {
    "compiler_degree": "degree",
    "compiler_boundmass": "boundmass",
    "compiler_boundinertia": "boundinertia",
}
"""Attributes of the compiler by the names of changes; they need the model's file."""

LENGTHS = "compiler_lengths"
"""Name of a change of all lengths of a model by a factor; it needs the model's file."""

LENGTHS_OF = (
    *product(("geoms", "sites"), ("pos", "size", "fromto")),
    *product(("bodies", "frames", "joints", "cameras", "lights"), ("pos",)),
    *(("bodies", "ipos"), ("meshes", "scale"), ("hfields", "size")),
    *product(("tendons",), ("range", "springlength")),
)
"""Attributes of a spec that are lengths, behind the kind of their element."""

CHANGED_ARRAYS = (
    "dof_armature",
    "body_gravcomp",
    *("actuator_gainprm", "actuator_biasprm", "actuator_forcerange"),
)
"""Arrays of the model that a row may change in a copy."""

OPTIONS = {"integrator": INTEGRATORS, "cone": CONES, "solver": SOLVERS}

JOINT_TRANSMISSIONS = (
    int(mujoco.mjtTrn.mjTRN_JOINT),
    int(mujoco.mjtTrn.mjTRN_JOINTINPARENT),
)
"""Transmissions of actuators that act on a joint."""

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
        changes: Changes that the model has and its spec has not, as `changed` takes them.
        known: What was measured of it, by the id of a row, or by function and arguments; see `once`.
    """

    model: mujoco.MjModel
    pairs: ContactPairs
    up: Vector
    standing: Standing | None = None
    spec: mujoco.MjSpec | None = None
    pair: tuple[str, str] | None = None
    action_rad: float | None = None
    delay_s: float | None = None
    changes: Settings = field(default_factory=dict)
    known: dict[Any, Any] = field(default_factory=dict, init=False)

    @cached_property
    def _trial_model(self) -> mujoco.MjModel:
        return copy.copy(self.model)

    def without(self, *features: str) -> mujoco.MjModel:
        """Return a copy of the model with some features switched off, valid until the next call.

        Options and `CHANGED_ARRAYS` of the copy may be changed. There is one copy, as meshes make copies slow.
        """
        model, option = self._trial_model, self._trial_model.opt
        for name in ("gravity", "wind"):
            getattr(option, name)[:] = getattr(self.model.opt, name)
        for name in ("density", "viscosity", "disableflags", "enableflags"):
            setattr(option, name, getattr(self.model.opt, name))
        for feature in features:
            option.disableflags |= disable_bit(feature)
        for name in CHANGED_ARRAYS:
            getattr(model, name)[:] = getattr(self.model, name)
        return model

    @cached_property
    def bodies(self) -> list[int]:
        """Bodies of the robot that stands; without one, those that motors move, and without motors, all that move.

        Trees of bodies without any shape are left out, as motors stand there for joints that the robot lacks. So are
        trees that no motor moves and that touch nothing, as pictures of a second robot.
        """
        model = self.model
        roots = [first_moving_body(model, body) for body in range(model.nbody)]
        if self.standing is not None:
            return [
                body for body, root in enumerate(roots) if root == self.standing.body
            ]
        moving = [b for b in range(1, model.nbody) if model.body_dofnum[roots[b]]]
        driven = model.jnt_bodyid[joints_of_motors(model)]
        arms = np.intersect1d(
            model.body_rootid[driven], model.body_rootid[model.geom_bodyid]
        )
        felt = model.geom_bodyid[np.unique(self.pairs.geoms)]
        real = {roots[body] for body in (*driven, *felt)}
        is_linked = model.neq or model.ntendon
        parts = [b for b in moving if is_linked or roots[b] in real]
        return [b for b in parts if model.body_rootid[b] in arms] or moving

    @cached_property
    def foot_rows(self) -> list[int]:
        """Rows of `pairs` in which a foot meets the ground."""
        if self.standing is None:
            return []
        feet = {geom for geoms in self.standing.feet.values() for geom in geoms}
        return [
            int(row)
            for row in ground_rows(self.pairs)
            if feet & set(self.pairs.geoms[row].tolist())
        ]

    @property
    def mass_kg(self) -> float:
        """Mass of all its links [kg]."""
        return float(self.model.body_mass[self.bodies].sum())

    @property
    def is_floating(self) -> bool:
        """Whether the robot stands and its first joint is free."""
        if self.standing is None:
            return False
        first = self.model.body_jntadr[self.standing.body]
        return bool(joints_of(self.model, "FREE")[first])

    @cached_property
    def plane_normal(self) -> FloatArray | None:
        """Normal of the vertical plane in which the robot moves, shape [3]; None when it moves in space."""
        model = self.model
        is_own = np.isin(model.jnt_bodyid, self.bodies)
        axes = stance_of(model, np.asarray(self.up)).joint_axes
        turning = axes[is_own & joints_of(model, "HINGE")]
        sliding = axes[is_own & joints_of(model, "SLIDE")]
        if not len(turning) or len(turning) + len(sliding) < is_own.sum():
            return None
        normal: FloatArray = turning[0]
        is_planar = (np.abs(turning @ normal) > 0.999).all() and abs(normal[2]) < 1e-3
        return normal if is_planar and (np.abs(sliding @ normal) < 1e-3).all() else None

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
        if LENGTHS in changes:
            scaled = self.scaled(changes[LENGTHS])
            return scaled.changed({k: v for k, v in changes.items() if k != LENGTHS})
        stating: dict[str, list[int]] = {}
        model = self._compiled({**self.changes, **changes})
        if model is None:
            model = copy.copy(self.model)
        else:
            # A compiled model has none of the earlier changes.
            changes = {**self.changes, **changes}
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
                self._change_pairs(model, name, value)
            elif name in COMPILER or name.startswith(GEOM_MASS):
                continue
            elif found := ELEMENT.fullmatch(name):
                getattr(model, found[1])[int(found[2])] = value
            else:
                set_option(model.opt, name, value)
        try:
            mujoco.mj_setConst(model, mujoco.MjData(model))
        except mujoco.FatalError as error:
            raise TargetError(f"the change needs the model's file: {error}") from None
        return model, {name: geoms for name, geoms in stating.items() if geoms}

    def scaled(self, factor: float) -> "Robot":
        """Return the robot with all lengths of its file times a factor; masses, inertias and gains stay as stated.

        Its pose is the one before: read its model again to know how it stands.
        """
        if self.spec is None:
            raise TargetError("the change needs the model's file")
        # The ids of a copy are known once it was compiled.
        spec = self.spec.copy()
        spec.compile()
        for kind, name in LENGTHS_OF:
            for element in getattr(spec, kind):
                setattr(element, name, factor * np.array(getattr(element, name)))
        places, is_slide = self.model.jnt_qposadr, joints_of(self.model, "SLIDE")
        for joint in (one for one in spec.joints if is_slide[one.id]):
            joint.range, joint.ref = factor * joint.range, factor * joint.ref
        free = places[joints_of(self.model, "FREE")]
        lengths = np.concatenate(
            [places[is_slide], *(free + axis for axis in range(3))]
        )
        for key in spec.keys:
            positions = np.array(key.qpos)
            if self._has_unit_of_bodies(positions, factor):
                positions[lengths] *= factor
            key.qpos = positions
        try:
            return replace(self, spec=spec, model=spec.compile(), standing=None)
        except ValueError as error:
            raise TargetError(f"MuJoCo cannot compile the change: {error}") from None

    def spec_after(self, changes: Settings) -> mujoco.MjSpec | None:
        """Return the spec whose lengths are those after changes; other changes are not in it."""
        return self.scaled(changes[LENGTHS]).spec if LENGTHS in changes else self.spec

    def _has_unit_of_bodies(self, qpos: FloatArray, factor: float) -> bool:
        """Return whether the free bodies of a keyframe are as far away as their bodies, and not by a factor nearer."""
        model = self.model
        for joint in np.flatnonzero(joints_of(model, "FREE")).tolist():
            first = int(model.jnt_qposadr[joint])
            stated_m, places_m = model.qpos0[first : first + 3], qpos[first : first + 3]
            lengths = np.linalg.norm([stated_m, places_m], axis=1)
            if lengths.all():
                away = float(np.log(lengths[1] / lengths[0]))
                return abs(away) < abs(away - np.log(factor))
        return True

    @cached_property
    def explicit_ground_pairs(self) -> list[int]:
        """Explicit pairs of geoms, one of which is of the ground."""
        model, ground = self.model, ground_rows(self.pairs)
        pairs = {tuple(sorted(pair)) for pair in self.pairs.geoms[ground].tolist()}
        several = zip(model.pair_geom1.tolist(), model.pair_geom2.tolist(), strict=True)
        return [n for n, pair in enumerate(several) if tuple(sorted(pair)) in pairs]

    def _change_pairs(self, model: mujoco.MjModel, name: str, value: Any) -> None:
        """Give explicit pairs with the ground the constants, which their geoms do not decide."""
        if name in PAIRED:
            array = getattr(model, f"pair_{GEOM_FIELDS[name]}")
            array[self.explicit_ground_pairs] = value

    def _compiled(self, changes: Settings) -> mujoco.MjModel | None:
        """Return the compiled model where the compiler reads changes; None where it reads none of them."""
        found = {
            name: ELEMENT.fullmatch(name)
            for name in changes
            if name.startswith(("geom_con", GEOM_MASS, "jnt_limited"))
        }
        compiler = {
            COMPILER[name]: changes[name] for name in changes if name in COMPILER
        }
        if self.spec is None and compiler:
            raise TargetError("the change needs the model's file")
        if self.spec is None or not (found or compiler):
            return None
        spec = self.spec.copy()
        for attribute, value in compiler.items():
            setattr(spec.compiler, attribute, value)
        for name, match in found.items():
            if match is None or match[1] == "geom_condim":
                continue
            kind, attribute = ("geom", match[1].removeprefix("geom_"))
            if match[1] == "jnt_limited":
                # The compiler reads the range of a joint with limits alone in the unit of its angles.
                kind, attribute = "joint", "limited"
            several = (getattr(one, f"{kind}s") for one in (spec, self.spec))
            for element, original in zip(*several, strict=True):
                if int(match[2]) == original.id:
                    setattr(element, attribute, int(changes[name]))
        try:
            return spec.compile()
        except ValueError as error:
            raise TargetError(f"MuJoCo cannot compile the change: {error}") from None


P = ParamSpec("P")
T = TypeVar("T")


def once(
    function: Callable[Concatenate[Robot, P], T],
) -> Callable[Concatenate[Robot, P], T]:
    """Return a function that measures a robot once, and remembers what it found as long as the robot is there."""

    @wraps(function)
    def remembered(robot: Robot, /, *args: P.args, **kwargs: P.kwargs) -> T:
        key = (function, *args, *kwargs.items())
        if key not in robot.known:
            robot.known[key] = function(robot, *args, **kwargs)
        found: T = robot.known[key]
        return found

    return remembered


GEOM_MASS = "geom_mass["
"""Begin of the name of the mass of a geom, which the compiler adds to that of its body."""

FEATURES = ("constraint", "contact", "frictionloss", "limit")
"""Features that a model may switch off, and that no setting of the engine switches."""


def disable_bit(feature: str) -> int:
    """Return MuJoCo's bit that switches a feature off, as `limit`."""
    return int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{feature.upper()}"))


def switched_off(model: mujoco.MjModel, *features: str) -> list[str]:
    """Return those of some features that a model switches off."""
    return [one for one in features if model.opt.disableflags & disable_bit(one)]


def enabling(features: Iterable[str]) -> str:
    """Return the element of a model that switches features on."""
    flags = " ".join(f'{one}="enable"' for one in features)
    return f"<flag {flags}/>"


def set_option(option: Any, name: str, value: Any) -> None:
    """Set an option or a flag by the name of this package's setting; others do not belong to models.

    Args:
        option: Options of a compiled model, or of its spec.
        name: Name of the setting.
        value: Its new value.
    """
    if name == "timestep_s":
        option.timestep = value
    elif name in ("gravity", "wind"):
        getattr(option, name)[:] = value
    elif name in ("density", "viscosity"):
        setattr(option, name, value)
    elif name in OPTIONS:
        setattr(option, name, int(OPTIONS[name][value]))
    elif name in SAME_NAME_OPTIONS:
        setattr(option, name, value)
    elif name in DISABLE_FLAGS or name in FEATURES:
        bit = disable_bit(name)
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


def acts_on_joints(model: mujoco.MjModel) -> BoolArray:
    """Return which actuators act on a joint, shape [nu]."""
    return np.isin(model.actuator_trntype, JOINT_TRANSMISSIONS)


def joints_of_motors(model: mujoco.MjModel) -> NDArray[np.int_]:
    """Return the joint of each actuator that acts on a joint."""
    joints: NDArray[np.int_] = model.actuator_trnid[acts_on_joints(model), 0]
    return joints


def couplings_of(model: mujoco.MjModel) -> BoolArray:
    """Return which equalities couple joints, shape [neq]."""
    couplings: BoolArray = model.eq_type == int(mujoco.mjtEq.mjEQ_JOINT)
    return couplings


def coupled_pairs(model: mujoco.MjModel) -> NDArray[np.int_]:
    """Return the two joints of each equality that couples joints, the second one -1 without one, shape [count, 2]."""
    ends: NDArray[np.int_] = np.column_stack([model.eq_obj1id, model.eq_obj2id])
    return ends[couplings_of(model)]


def tendon_joints(
    model: mujoco.MjModel, tendon: int
) -> tuple[NDArray[np.int32], FloatArray]:
    """Return the joints and coefficients of a fixed tendon, shape [count]; none of a spatial one."""
    first = int(model.tendon_adr[tendon])
    places = np.arange(first, first + int(model.tendon_num[tendon]))
    is_joint = model.wrap_type[places] == int(mujoco.mjtWrap.mjWRAP_JOINT)
    places = places[is_joint]
    return model.wrap_objid[places], model.wrap_prm[places]


def ends_of(model: mujoco.MjModel, number: int) -> tuple[int, list[str]]:
    """Return the kind of the parts that an equality joins, and their names."""
    is_joint = couplings_of(model)[number]
    kind = mujoco.mjtObj.mjOBJ_JOINT if is_joint else model.eq_objtype[number]
    ends = (model.eq_obj1id[number], model.eq_obj2id[number])
    return int(kind), [
        mujoco.mj_id2name(model, kind, end) or "" for end in ends if end >= 0
    ]


def coupled_joints(model: mujoco.MjModel, joint: int) -> list[int]:
    """Return a joint, those that equalities couple to it, those coupled to these, and so on."""
    pairs = coupled_pairs(model)
    # An equality without a second joint holds its joint at a place.
    pairs = pairs[(pairs >= 0).all(axis=1)]
    moving = np.array([joint])
    for _ in pairs:
        touched = pairs[np.isin(pairs, moving).any(axis=1)]
        moving = np.union1d(moving, touched)
    found: list[int] = moving.tolist()
    return found


def loop_joints(model: mujoco.MjModel, joint: int) -> list[int]:
    """Return the joints of the closed chains of which a joint is part, those of chains that share one, and so on.

    A chain is closed by an equality that holds two bodies, or sites of theirs, at one place.
    """
    closes = np.isin(model.eq_type, [mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD])
    of_sites = model.eq_objtype == int(mujoco.mjtObj.mjOBJ_SITE)
    chains = []
    for one in np.flatnonzero(closes & model.eq_active0.astype(bool)).tolist():
        ends = [int(model.eq_obj1id[one]), int(model.eq_obj2id[one])]
        if of_sites[one]:
            ends = model.site_bodyid[ends].tolist()
        bodies = ancestors(model, ends[0]) ^ ancestors(model, ends[1])
        chains.append(
            {*np.flatnonzero(np.isin(model.jnt_bodyid, list(bodies))).tolist()}
        )
    found: set[int] = set()
    joined = [chain for chain in chains if joint in chain]
    while joined:
        found = found.union(*joined)
        chains = [chain for chain in chains if not chain <= found]
        joined = [chain for chain in chains if chain & found]
    return sorted(found)


def ancestors(model: mujoco.MjModel, body: int) -> set[int]:
    """Return a body and all that carry it, but the world."""
    found = set()
    while body > 0:
        found.add(body)
        body = int(model.body_parentid[body])
    return found


def grasp_kinds(model: mujoco.MjModel, pairs: ContactPairs) -> NDArray[np.int_]:
    """Return for each pair 1 where a part whose joints have motors can hold a free body, 2 if at a point, or else 0."""
    roots = model.body_rootid
    driven = np.isin(roots, roots[model.jnt_bodyid[joints_of_motors(model)]])
    free = np.isin(roots, model.jnt_bodyid[joints_of(model, "FREE")]) & ~driven
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


def never_touches(robot: Robot) -> bool:
    """Return whether no two geoms of a robot that is fixed to the world touch in random poses within joint limits."""
    if robot.standing is not None or joints_of(robot.model, "FREE", "BALL").any():
        return False
    return not any(data.ncon for data in random_poses(robot.model, poses=200))


def random_poses(
    model: mujoco.MjModel, poses: int, *, with_contact: bool = True
) -> Iterator[mujoco.MjData]:
    """Yield a model in random poses within its joint limits, at rest; free and ball joints stay.

    Without contact only places and axes are up to date.
    """
    data, generator = mujoco.MjData(model), np.random.default_rng(0)
    is_hinge = joints_of(model, "HINGE")
    for _ in range(poses):
        for joint in np.flatnonzero(is_hinge | joints_of(model, "SLIDE")):
            free = (-np.pi, np.pi) if is_hinge[joint] else (-1.0, 1.0)
            low, high = model.jnt_range[joint] if model.jnt_limited[joint] else free
            data.qpos[model.jnt_qposadr[joint]] = generator.uniform(low, high)
        if with_contact:
            mujoco.mj_forward(model, data)
        else:
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
        yield data
