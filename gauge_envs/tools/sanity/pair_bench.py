"""Measure two geoms of a model alone: one is fixed, and the other moves on it without turning, as it stands there.

The bench has the options of the model and the effective constants of the pair. The moving geom has the mass that loads
the contact, and both have the inverse weights of their links, which soften contacts in MuJoCo. After each step it
returns to its place on the fixed geom with its velocity, as on a treadmill, so that small geoms are wide enough.
"""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs.backends.mujoco.contact_table import COLUMNS, can_move
from gauge_envs.backends.mujoco.options import option_settings, set_option
from gauge_envs.errors import TargetError
from gauge_envs.scene import GRAVITY_M_PER_S2 as G
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.sanity.model_checks.runs import has_diverged, rest
from gauge_envs.tools.sanity.robot.robot import Robot, mesh_vertices_m, once
from gauge_envs.tools.sanity.verdict import Settings

SETTLE_S, CREEP_S = 0.5, 1.0
"""Simulated time until a geom rests, and until the creep on a soft contact, which lifts it, is steady [s]."""

FAST_M_PER_S, IMPACT_M_PER_S, PHASES = 4.0, 1.0, 4
"""Speed of the fast slide, speed of impacts along the normal [m/s], and number of their phases within a step."""

SHARES, STEEP, HALF = (0.5, 0.9, 0.99), 1.5, 0.5
"""Loads of creep, and of a slide, over the limit of friction; share of the load that a slide must keep."""

DIVERGED = 1e9
"""Height [m] and velocity [m/s] of a state that diverges: no law allows them."""

PAIR_FIELDS = {
    "contact_solref": "solref",
    "contact_solimp": "solimp",
    "contact_solreffriction": "solreffriction",
    "condim": "dim",
    "contact_margin_m": "margin",
    "contact_gap_m": "gap",
}
"""Fields of an explicit pair by the names of settings."""

PLANE, HFIELD = mujoco.mjtGeom.mjGEOM_PLANE, mujoco.mjtGeom.mjGEOM_HFIELD


class Value(NamedTuple):
    """A measured value with its law.

    Attributes:
        name: What is measured.
        value: The value, in `unit`.
        unit: Its unit; empty for a ratio.
        law: Value of the law; None where the target gives none.
        width: Difference from the law that counts.
    """

    name: str
    value: float
    unit: str
    law: float | None
    width: float

    @property
    def deviation(self) -> float:
        """Distance from the law, in widths; 0 without a law, or where nothing was measured."""
        if self.law is None or math.isnan(self.value):
            return 0.0
        return abs(self.value - self.law) / self.width


@dataclass(frozen=True)
class Touch:
    """How two geoms touch in a run of their model.

    Attributes:
        fixed: The geom that is fixed on the bench.
        moving: The geom that moves there.
        mass_kg: Mass that moves with it [kg].
        load_n: Normal force between them [N].
        pull_n: Tangential force between them in a run [N].
        fixed_pose: Rotation of the fixed geom, in a frame whose z axis is the normal.
        moving_pose: Rotation of the other one there.
        offset_m: Place of the moving geom from the fixed one there [m], shape [3].
    """

    fixed: int
    moving: int
    mass_kg: float
    load_n: float
    pull_n: float
    fixed_pose: Rotation
    moving_pose: Rotation
    offset_m: FloatArray


@once
def touching(robot: Robot) -> dict[tuple[int, int], FloatArray]:
    """Return normal and tangential force [N] of each pair that touches at the end of the run at rest, shape [2]."""
    if not robot.model.nv or np.isfinite((run := rest(robot)).diverged_s):
        return {}
    force, sums = np.zeros(6), dict[tuple[int, int], FloatArray]()
    for index, contact in enumerate(run.data.contact):
        mujoco.mj_contactForce(run.model, run.data, index, force)
        pair = min(contact.geom), max(contact.geom)
        if force[0] > 0.0:
            # The normal force, and the tangential force as a vector [N].
            along = contact.frame.reshape(3, 3)[1:].T @ force[1:3]
            added = [force[0], *along]
            sums[pair] = np.add(sums.get(pair, 0.0), added)
    return {
        pair: np.array([total[0], np.linalg.norm(total[1:])])
        for pair, total in sums.items()
    }


def touch_of(
    robot: Robot,
    pair: tuple[int, int],
    forces_n: FloatArray | None = None,
) -> Touch:
    """Return how two geoms touch, at the end of the run or as it starts; they are moved together.

    Args:
        robot: The model.
        pair: The geoms.
        forces_n: Normal and tangential force in the first pose [N], shape [2]; None for those at the end of the run,
            or for the weight of the moving tree of bodies where the geoms do not touch then.
    """
    model, data = robot.model, mujoco.MjData(robot.model)
    data.qpos[:] = robot.stance.qpos
    if forces_n is None and (forces_n := touching(robot).get(pair)) is not None:
        data.qpos[:] = rest(robot).data.qpos
    mujoco.mj_forward(model, data)
    trees = model.body_rootid[model.geom_bodyid[list(pair)]]
    masses = np.where(
        can_move(model)[list(pair)], model.body_subtreemass[trees], np.inf
    )
    fixed, moving = (pair[place] for place in np.argsort(-masses, kind="stable"))
    mass_kg = float(masses.min())
    load_n, pull_n = (mass_kg * G, 0.0) if forces_n is None else forces_n.tolist()
    if forces_n is not None:
        # The other feet of a body carry the rest of it; a grip presses more than the weight.
        mass_kg = min(mass_kg, load_n / G)
    normal, distance_m = _gap(model, data, fixed, moving)
    frame = Rotation.align_vectors([[0.0, 0.0, 1.0]], [normal])[0]
    fixed_pose, moving_pose = (
        frame * Rotation.from_matrix(data.geom_xmat[geom].reshape(3, 3))
        for geom in (fixed, moving)
    )
    return Touch(
        fixed,
        moving,
        mass_kg,
        load_n,
        pull_n,
        fixed_pose,
        moving_pose,
        frame.apply(data.geom_xpos[moving] - data.geom_xpos[fixed])
        - [0.0, 0.0, distance_m],
    )


def _gap(
    model: mujoco.MjModel, data: mujoco.MjData, fixed: int, moving: int
) -> tuple[FloatArray, float]:
    """Return the unit vector from one geom to the other where they touch or are nearest, and their distance [m].

    The distance from a plane or a height field is unknown: 0.
    """
    if model.geom_type[fixed] in (PLANE, HFIELD):
        return np.array(data.geom_xmat[fixed].reshape(3, 3)[:, 2]), 0.0
    for contact in data.contact:
        if {*contact.geom.tolist()} == {fixed, moving}:
            sign = 1.0 if contact.geom[0] == fixed else -1.0
            return sign * contact.frame[:3], float(contact.dist)
    ends = np.zeros(6)
    distance_m = mujoco.mj_geomDistance(model, data, fixed, moving, 1e3, ends)
    along = (ends[3:] - ends[:3]) * np.sign(distance_m)
    if not along.any():
        along = data.geom_xpos[moving] - data.geom_xpos[fixed]
    return along / max(float(np.linalg.norm(along)), 1e-12), float(distance_m)


@dataclass(frozen=True)
class Bench:
    """Two geoms alone, one fixed and one on three slides.

    Attributes:
        model: Their model.
        touch: How they touch.
        friction: Coefficient of friction in force.
    """

    model: mujoco.MjModel
    touch: Touch
    friction: float

    def changed(self, changes: Settings) -> Bench:
        """Return the bench with other settings."""
        model = copy.copy(self.model)
        set_pair(model, changes)
        return replace(self, model=model)

    def values(self) -> list[Value]:
        """Return what follows from the contact, each with its law; friction is left out for a contact without."""
        rebound, ratios = self.impacts()
        depth = Value("depth under load", 1e6 * self._rest[0], "um", 0.0, 500.0)
        bounce = Value("rebound", rebound, "", None, 0.05)
        if not self.friction:
            return [depth, bounce]
        own = self.touch.pull_n / (self.friction * self.touch.load_n)
        shares = {f"at {share:g} of the limit": share for share in SHARES}
        shares = {"in the run": min(own, SHARES[0]), **shares}
        creeps = [
            Value(f"creep {name}", self.creep_um_per_s(share), "um/s", 0.0, 100.0)
            for name, share in shares.items()
        ]
        slides = [
            Value(
                f"slide at {angle:g} degrees over Coulomb",
                self._slide(math.radians(angle)),
                "",
                1.0,
                0.03,
            )
            for angle in (0.0, 45.0)
        ]
        hops = [
            Value(f"hop at {speed:g} m/s", self.hop_mm(speed), "mm", 0.0, 5.0)
            for speed in (1.0, FAST_M_PER_S)
        ]
        impacts = [
            Value(f"{name} impact over Coulomb", ratio, "", 1.0, 0.1)
            for name, ratio in ratios.items()
        ]
        return [*creeps, *slides, *hops, depth, bounce, *impacts]

    # --- measurements ------------------------------------------------------------------------------------------------

    @cached_property
    def _start_m(self) -> float:
        """Height of the slide at which the geoms touch [m], by bisection in a range where lower means deeper."""
        data, radii_m = mujoco.MjData(self.model), self.model.geom_rbound
        high = 10.0 if not radii_m.all() else 0.5 * float(radii_m.min())
        low = -high
        for _ in range(50):
            data.qpos[2] = 0.5 * (low + high)
            mujoco.mj_kinematics(self.model, data)
            mujoco.mj_collision(self.model, data)
            is_deep = data.ncon and data.contact.dist.min() < 0.0
            low, high = (data.qpos[2], high) if is_deep else (low, data.qpos[2])
        return float(high)

    @cached_property
    def _pressed_m_per_s2(self) -> float:
        """Acceleration of gravity that presses the mass with the load."""
        return self.touch.load_n / self.touch.mass_kg

    def _run(
        self,
        seconds: float,
        gravity: tuple[float, float, float],
        height_m: float = 0.0,
        velocity: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> FloatArray:
        """Return height [m] and velocity [m/s] at each step, shape [step_count + 1, 4]."""
        model, data = self.model, mujoco.MjData(self.model)
        model.opt.gravity[:] = gravity
        data.qpos[2], data.qvel[:] = self._start_m + height_m, velocity
        rows = [[data.qpos[2], *data.qvel]]
        for _ in range(max(round(seconds / model.opt.timestep), 8)):
            mujoco.mj_step(model, data)
            if has_diverged(data):
                rows.append([DIVERGED] * 4)
                break
            data.qpos[:2] = 0.0
            rows.append([data.qpos[2], *data.qvel])
        table = np.array(rows)
        table[:, 0] -= self._start_m
        return table

    @cached_property
    def _rest(self) -> tuple[float, float]:
        """Depths at rest under the load, and under the weight of the mass [m]."""
        loads = self._pressed_m_per_s2, G
        margin_m = float(self.model.pair_margin[0])
        under, own = (
            -self._run(SETTLE_S, (0.0, 0.0, -load), margin_m)[-1, 0] for load in loads
        )
        return float(under), float(own)

    def creep_um_per_s(self, share: float) -> float:
        """Return the speed under a share of the limit of friction [um/s], late in a run; NaN where the geoms part."""
        pressed = self._pressed_m_per_s2
        pushed = (share * self.friction * pressed, 0.0, -pressed)
        _, along, _, lift = self._run(CREEP_S, pushed, -self._rest[0]).T
        if lift[-1] < -HALF * pressed * CREEP_S:
            return math.nan
        return 1e6 * float(along[-len(along) // 4 :].mean())

    def _slide(self, angle_rad: float) -> float:
        """Return the friction of a slide in a direction, over the friction in force; NaN where the geoms part."""
        pressed = self._pressed_m_per_s2
        pull = STEEP * self.friction * pressed
        along = np.array([math.cos(angle_rad), math.sin(angle_rad)])
        table = self._run(SETTLE_S, (*(pull * along), -pressed), -self._rest[0])
        late = (len(table) - 1) // 2
        seconds = (len(table) - 1 - late) * self.model.opt.timestep
        rates_m_per_s2 = (table[-1] - table[late])[1:] / seconds
        gained, lifted = rates_m_per_s2[:2] @ along, rates_m_per_s2[2]
        if lifted < -HALF * pressed:
            return math.nan
        return float((pull - gained) / (self.friction * (pressed + lifted)))

    def hop_mm(self, speed_m_per_s: float) -> float:
        """Return how high a slide at a speed rises [mm], also one that does not come to rest before."""
        velocity = speed_m_per_s, 0.0, 0.0
        heights_m = self._run(SETTLE_S, (0.0, 0.0, -G), -self._rest[1], velocity)[:, 0]
        margin_m = float(self.model.pair_margin[0])
        return 1e3 * float(heights_m.max() - min(heights_m[0], margin_m))

    def impacts(self) -> tuple[float, dict[str, float]]:
        """Return the rebound, and friction over Coulomb's law in impacts at three angles from the normal.

        A body that does not turn loses the tangential impulse min(mu N, m v). It meets the other one without gravity.
        """
        rebound, _ = self._impact(0.0)
        slip = 2.0 * self.friction * (1.0 + max(rebound, 0.0)) + 0.1
        tangents = 0.5 * self.friction, self.friction, slip
        ratios = [self._impact(tangent)[1] for tangent in tangents]
        return rebound, dict(zip(("steep", "oblique", "grazing"), ratios, strict=True))

    def _impact(self, tangent: float) -> tuple[float, float]:
        """Return rebound and friction over Coulomb's law, the mean over phases, for a tangential over normal speed."""
        step_m = IMPACT_M_PER_S * self.model.opt.timestep
        velocity = (tangent * IMPACT_M_PER_S, 0.0, -IMPACT_M_PER_S)
        rebounds, ratios = [], []
        for phase in range(PHASES):
            height_m = (1.0 + (phase + 0.5) / PHASES) * step_m + float(
                self.model.pair_margin[0]
            )
            last = self._run(SETTLE_S, (0.0, 0.0, 0.0), height_m, velocity)[-1]
            pressed, taken = last[3] + IMPACT_M_PER_S, velocity[0] - last[1]
            rebounds.append(last[3] / IMPACT_M_PER_S)
            allowed = min(self.friction * pressed, velocity[0])
            ratios.append(taken / allowed if allowed else 1.0)
        return float(np.mean(rebounds)), float(np.mean(ratios))


def set_pair(model: mujoco.MjModel, changes: Settings, pair: int | None = 0) -> None:
    """Set options of a model, and the constants of an explicit pair."""
    for name, value in changes.items():
        if name not in PAIR_FIELDS:
            set_option(model.opt, name, value)
        elif value is not None:
            getattr(model, f"pair_{PAIR_FIELDS[name]}")[pair] = value


def bench(robot: Robot, touch: Touch, constants: FloatArray) -> Bench:
    """Return the bench of two geoms.

    Args:
        robot: Their model.
        touch: How they touch.
        constants: Effective constants of the pair, columns as in `COLUMNS`, shape [17].

    Raises:
        TargetError: A geom has a type that the bench cannot have.
    """
    model, spec = robot.model, mujoco.MjSpec()
    if mujoco.mjtGeom.mjGEOM_SDF in model.geom_type[[touch.fixed, touch.moving]]:
        raise TargetError("a geom of type sdf cannot be measured alone")
    body = spec.worldbody.add_body(name="moving", pos=touch.offset_m)
    body.explicitinertial, body.mass, body.inertia = True, touch.mass_kg, np.ones(3)
    for axis in np.eye(3):
        body.add_joint(type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis)
    _add_geom(spec, spec.worldbody, "fixed", model, touch.fixed, touch.fixed_pose)
    _add_geom(spec, body, "moving", model, touch.moving, touch.moving_pose)
    pair = spec.add_pair(
        geomname1="fixed", geomname2="moving", condim=int(constants[0])
    )
    for name in ("friction", "solref", "solreffriction", "solimp"):
        setattr(pair, name, constants[COLUMNS[name]])
    pair.margin, pair.gap = (
        constants[COLUMNS["margin"]][0],
        constants[COLUMNS["gap"]][0],
    )
    small = spec.compile()
    for name, value in option_settings(model).items():
        set_option(small.opt, name, value)
    links = model.geom_bodyid[[touch.fixed, touch.moving]]
    small.body_invweight0[1] = model.body_invweight0[links].sum(axis=0)
    friction = 0.0 if constants[0] < 3 else float(constants[1])
    return Bench(small, touch, friction)


def _add_geom(
    spec: mujoco.MjSpec,
    body: mujoco.MjsBody,
    name: str,
    model: mujoco.MjModel,
    geom: int,
    pose: Rotation,
) -> None:
    """Give a body of the bench a copy of a geom; a height field becomes a plane."""
    kind = mujoco.mjtGeom(int(model.geom_type[geom]))
    quaternion = pose.as_quat(scalar_first=True)
    added = body.add_geom(
        name=name, type=kind, size=model.geom_size[geom], quat=quaternion
    )
    added.contype = added.conaffinity = 0
    if kind in (PLANE, HFIELD):
        added.type, added.size = PLANE, [0.0, 0.0, 1.0]
    elif kind == mujoco.mjtGeom.mjGEOM_MESH:
        vertices = mesh_vertices_m(model, geom)
        mesh = spec.add_mesh(name=name, uservert=vertices.ravel())
        mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
        added.meshname = name
