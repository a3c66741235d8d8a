"""Third set: 30 faults of physics engines from public trackers, planted in the backend of MuJoCo.

They were written before their author read a check. The order of
`FAULTS3` was drawn; checks were mended on the first 15.
"""

import random
from dataclasses import dataclass, replace
from functools import partial

import mujoco
import numpy as np

from gauge_envs.backends import LoopedSimulation
from gauge_envs.backends.shared.rigid import MeanForces
from gauge_envs.scene import (
    Box,
    Compound,
    Cylinder,
    Hinge,
    Motion,
    body_mass_properties,
)
from gauge_envs.scene.states import nominal_states
from tests.faults import Fault, Faulty, Planted, change_contacts

NEVER = -10.0  # margin [m] below which no contact is found


@dataclass(frozen=True)
class Entry:
    """A thread of a tracker, what it says, what is planted, its cause in a sentence, and the fault."""

    thread: str
    tracker: str
    planted: str
    cause: str
    fault: Fault


def entry(thread, says, cause, fault):
    """Return an entry whose tracker says what is planted."""
    return Entry(thread, says, says, cause, fault)


# --- helpers ---


def edited(edit):
    """Engine whose compiled model is edited after the build."""

    class Edited(Faulty):
        def build(self, scene, settings=None):
            simulation = super().build(scene, settings)
            edit(simulation)
            return simulation

    return Edited


def with_settings(**extra):
    """Return an engine with other settings."""

    class WithSettings(Faulty):
        def build(self, scene, settings=None):
            return super().build(scene, {**(settings or {}), **extra})

    return WithSettings


def bodies_of_pair(model, index):
    """Return the names of the bodies of a pair of geoms."""
    geoms = model.pair_geom1[index], model.pair_geom2[index]
    return [model.body(model.geom_bodyid[geom]).name for geom in geoms]


def free(given):
    """Return the dynamic bodies of a scene without a hinge."""
    return [body for body in given.dynamic_bodies if body.name not in given.hinges]


def dofs(model, name):
    """Return the places of the velocity and spin of a free body."""
    first = int(model.joint(name).dofadr[0])
    return slice(first, first + 6)


def matrix(data, model, name):
    """Return the rotation of a free body from its frame to the world."""
    first = int(model.joint(name).qposadr[0])
    out = np.empty(9)
    mujoco.mju_quat2Mat(out, data.qpos[first + 3 : first + 7])
    return out.reshape(3, 3)


class DeepContacts(Planted):
    """Pairs of some balls or bodies overlap, or never touch."""

    def depth_m(self, body, velocities):
        """Return by how much a free body overlaps others [m], from its velocity and spin."""
        raise NotImplementedError

    def advance(self, seconds):
        """Set the depths, and advance."""
        model = self.model
        if not hasattr(self, "_margins"):
            self._margins = model.pair_margin.copy()
            self._pairs = [set(bodies_of_pair(model, i)) for i in range(model.npair)]
        depths = {
            body.name: self.depth_m(body, self.data.qvel[dofs(model, body.name)])
            for body in free(self.given)
        }
        for index, pair in enumerate(self._pairs):
            deepest = max(depths.get(name, 0.0) for name in pair)
            model.pair_margin[index] = self._margins[index] - deepest
        super().advance(seconds)


class Stepped(Planted):
    """Own loop over steps, as in the healthy engine, with a call before each."""

    def _step_worlds(self, thread, count):
        for world in range(thread, self.world_count, self._thread_count):
            self._step(world, count)

    def _step(self, world, count):
        readers = self._force_readers[world]
        for reader in readers:
            reader.clear()
        data = self.datas[world]
        for _ in range(count):
            for air in self._air:
                air.apply()
            self.before(data)
            mujoco.mj_step(self.model, data)
            for reader in readers:
                reader.add()


# --- faults ---


def _capsule_box(simulation):
    model = simulation.model
    kinds = {mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_BOX}
    for index in range(model.npair):
        geoms = model.pair_geom1[index], model.pair_geom2[index]
        if {mujoco.mjtGeom(model.geom_type[geom]) for geom in geoms} == kinds:
            model.pair_margin[index] = NEVER


def _first_part_collides(simulation):
    model = simulation.model
    compounds = {
        b.name for b in simulation.given.bodies if isinstance(b.shape, Compound)
    }
    for index in range(model.npair):
        for geom in (model.pair_geom1[index], model.pair_geom2[index]):
            body = model.body(model.geom_bodyid[geom]).name
            part = model.geom(geom).name.removeprefix(f"{body}/").split("/")[0]
            if body in compounds and part != "0":
                model.pair_margin[index] = NEVER


def _without_pairs(scene, drops):
    contacts = []
    for contact in scene.contacts:
        for first, second in scene.colliding_pairs(contact):
            if not drops(first, second):
                contacts.append(replace(contact, first=(first,), second=(second,)))
    return replace(scene, contacts=tuple(contacts))


def _hinged_pass_world(scene):
    fixed = {body.name for body in scene.bodies if body.motion is Motion.FIXED}
    hinged = set(scene.hinges)
    return _without_pairs(
        scene, lambda a, b: bool({a, b} & hinged) and bool({a, b} & fixed)
    )


class _FrictionOfWeight(Planted):
    def _base(self):
        if not hasattr(self, "_friction"):
            self._friction = self.model.pair_friction.copy()
        return self._friction

    def reset(self, starts=None, seed=0):
        super().reset(starts, seed)
        self.model.pair_friction[:] = self._base()

    def apply_wrench(self, body, wrenches):
        super().apply_wrench(body, wrenches)
        weight = self.given.body(body).mass_kg * self.given.gravity_m_per_s2
        press = max(-float(np.asarray(wrenches)[0, 2]), 0.0)
        base = self._base()
        for index in range(self.model.npair):
            if weight and body in bodies_of_pair(self.model, index):
                factor = weight / (weight + press)
                self.model.pair_friction[index] = factor * base[index]


def _small_hover(simulation):
    model = simulation.model
    for index in range(model.npair):
        radii = [
            model.geom_rbound[g]
            for g in (model.pair_geom1[index], model.pair_geom2[index])
        ]
        if any(0.0 < radius <= 0.0125 for radius in radii):
            model.pair_margin[index] += 3e-4


class _StickyStart(Planted):
    def advance(self, seconds):
        model, data = self.model, self.data
        if not hasattr(self, "_friction"):
            self._friction = model.pair_friction.copy()
            self._pairs = [bodies_of_pair(model, i) for i in range(model.npair)]
        still = {
            body.name
            for body in free(self.given)
            if np.linalg.norm(data.qvel[dofs(model, body.name)][:3]) < 1e-3
        }
        for index, pair in enumerate(self._pairs):
            factor = 1.3 if still & set(pair) else 1.0
            model.pair_friction[index, :2] = factor * self._friction[index, :2]
        super().advance(seconds)


class _GyroDrift(Stepped):
    """Explicit gyroscopic step at the rate of calls, scaled to the old angular momentum."""

    def _turning(self, data):
        for body in free(self.given):
            row = self.model.body(body.name).id
            if np.abs(self.model.body_ipos[row]).max() < 1e-9:
                axes = np.empty(9)
                mujoco.mju_quat2Mat(axes, self.model.body_iquat[row])
                axes = axes.reshape(3, 3)
                inertia = axes @ np.diag(self.model.body_inertia[row]) @ axes.T
                yield dofs(self.model, body.name), inertia

    def before(self, data):
        for rows, inertia in self._turning(data):
            spin = data.qvel[rows][3:]
            data.qfrc_applied[rows.start + 3 : rows.stop] = np.cross(
                spin, inertia @ spin
            )

    def advance(self, seconds):
        super().advance(seconds)
        for data in self.datas:
            for rows, inertia in self._turning(data):
                spin = data.qvel[rows][3:]
                old = inertia @ spin
                changed = spin - seconds * np.linalg.solve(inertia, np.cross(spin, old))
                size = np.linalg.norm(inertia @ changed)
                if size > 0.0:
                    changed *= np.linalg.norm(old) / size
                data.qvel[rows.start + 3 : rows.stop] = changed


class _WarmStart(Planted):
    def reset(self, starts=None, seed=0):
        kept = (
            self.data.qfrc_constraint.copy() if getattr(self, "_ran", False) else None
        )
        super().reset(starts, seed)
        self._kept = kept

    def advance(self, seconds):
        kept = getattr(self, "_kept", None)
        if kept is not None:
            for body in free(self.given):
                rows = dofs(self.model, body.name)
                impulse = kept[rows][:3] / 360.0
                self.data.qvel[rows.start : rows.start + 3] += impulse / body.mass_kg
        self._kept = None
        self._ran = True
        super().advance(seconds)


class _TorqueInBody(Planted):
    def apply_wrench(self, body, wrenches):
        wrenches = np.array(wrenches)
        if body not in self.given.hinges:
            for row, data in enumerate(self.datas):
                turned = matrix(data, self.model, body) @ wrenches[row, 3:]
                wrenches[row, 3:] = turned
        super().apply_wrench(body, wrenches)


def _touches_reversed(model, data):
    wrench = np.empty(6)
    for index in range(data.ncon):
        point = data.contact[index]
        if min(point.geom) < 0:
            continue
        first, second = model.geom_bodyid[point.geom].tolist()
        mujoco.mj_contactForce(model, data, index, wrench)
        wrench[1:3] *= -1.0
        yield first, second, -point.frame.reshape(3, 3).T @ wrench[:3]


class _FrictionSign(Planted):
    def contact_forces(self, pairs):
        model = self.model
        rows = [(model.body(a).id, model.body(b).id) for a, b in pairs]
        readers = [
            MeanForces(rows, partial(_touches_reversed, model, d)) for d in self.datas
        ]
        for known, reader in zip(self._force_readers, readers, strict=True):
            known.append(reader)
        return lambda: np.concatenate([reader.mean() for reader in readers])


def _friction_of_bodies(scene):
    values = {}
    for contact in scene.contacts:
        for name in (*contact.first, *contact.second):
            values.setdefault(name, contact.friction)
    contacts = []
    for contact in scene.contacts:
        for first, second in scene.colliding_pairs(contact):
            friction = max(values[first], values[second])
            pair = {"first": (first,), "second": (second,), "friction": friction}
            contacts.append(replace(contact, **pair))
    return replace(scene, contacts=tuple(contacts))


class _ReboundThreshold(Stepped):
    def before(self, data):
        model = self.model
        if not hasattr(self, "_solref"):
            self._solref = model.pair_solref.copy()
            self._rows = [
                (
                    index,
                    [
                        dofs(model, name)
                        for name in bodies_of_pair(model, index)
                        if name in self._moves()
                    ],
                )
                for index in range(model.npair)
                if self._solref[index, 1] < 0.0
            ]
        for index, rows in self._rows:
            speeds = [data.qvel[row][:3] for row in rows] + [np.zeros(3)] * (
                2 - len(rows)
            )
            slow = np.linalg.norm(speeds[0] - speeds[1]) < 1.0
            damping = -1.0 / self.timestep_s if slow else self._solref[index, 1]
            model.pair_solref[index, 1] = damping

    def _moves(self):
        return {body.name for body in free(self.given)}


def _compound_inertia(simulation):
    model = simulation.model
    compounds = [
        b.name for b in simulation.given.dynamic_bodies if isinstance(b.shape, Compound)
    ]
    for name in compounds:
        row = model.body(name).id
        model.body_inertia[row] = model.body_inertia[row][::-1].copy()
    if compounds:
        mujoco.mj_setConst(model, simulation.data)
        simulation.reset()


class _StartAtCentre(Planted):
    def reset(self, starts=None, seed=0):
        given = self.given
        if starts is None:
            starts = np.repeat(nominal_states(given)[None], self.world_count, axis=0)
        starts = np.array(starts)
        for row, body in enumerate(given.bodies):
            if body.motion is Motion.DYNAMIC and body.name not in given.hinges:
                centre = body_mass_properties(body)[0]
                for state in starts[:, row]:
                    turn = np.empty(9)
                    mujoco.mju_quat2Mat(turn, state[3:7].copy())
                    state[7:10] -= np.cross(state[10:], turn.reshape(3, 3) @ centre)
        super().reset(starts, seed)


class _SpinLimit(Planted):
    LIMIT = 0.25 * np.pi * 60.0

    def advance(self, seconds):
        super().advance(seconds)
        for data in self.datas:
            for body in free(self.given):
                rows = dofs(self.model, body.name)
                size = np.linalg.norm(data.qvel[rows][3:])
                if size > self.LIMIT:
                    data.qvel[rows.start + 3 : rows.stop] *= self.LIMIT / size


class _FallsAsleep(Planted):
    def reset(self, starts=None, seed=0):
        super().reset(starts, seed)
        self._quiet = {}

    def apply_wrench(self, body, wrenches):
        super().apply_wrench(body, wrenches)
        if np.any(wrenches):
            getattr(self, "_quiet", {}).pop(body, None)

    def drive(self, body, targets):
        super().drive(body, targets)
        if np.any(np.asarray(targets)[:, 7:]):
            self._quiet = {}

    def advance(self, seconds):
        data, model = self.data, self.model
        quiet = self.__dict__.setdefault("_quiet", {})
        poses = data.qpos.copy()
        super().advance(seconds)
        for body in free(self.given):
            rows = dofs(model, body.name)
            speed, spin = np.split(data.qvel[rows], 2)
            slow = np.linalg.norm(speed) < 0.4 and np.linalg.norm(spin) < 0.5
            quiet[body.name] = quiet.get(body.name, 0.0) + seconds if slow else 0.0
            if quiet[body.name] > 2.0:
                first = int(model.joint(body.name).qposadr[0])
                data.qpos[first : first + 7] = poses[first : first + 7]
                data.qvel[rows] = 0.0


class _Snags(Planted):
    """A body loses 30 % of its velocity when its leading edge passes the seam of two flush boxes."""

    def _seams(self):
        boxes = [
            body
            for body in self.given.bodies
            if body.motion is Motion.FIXED
            and isinstance(body.shape, Box)
            and abs(body.pose.quaternion[0]) > 0.9999
        ]
        seams = []
        for first in boxes:
            for second in boxes:
                gaps = np.subtract(second.pose.position_m, first.pose.position_m)
                edges = 0.5 * np.add(first.shape.size_m, second.shape.size_m)
                for axis in (0, 1):
                    if abs(gaps[axis] - edges[axis]) < 1e-6:
                        place = (
                            first.pose.position_m[axis] + 0.5 * first.shape.size_m[axis]
                        )
                        seams.append((axis, place))
        return seams

    def reset(self, starts=None, seed=0):
        super().reset(starts, seed)
        self._passed = set()

    def advance(self, seconds):
        super().advance(seconds)
        if not hasattr(self, "_places"):
            self._places = self._seams()
        passed = self.__dict__.setdefault("_passed", set())
        for body in free(self.given):
            rows = dofs(self.model, body.name)
            first = int(self.model.joint(body.name).qposadr[0])
            reach = np.abs(body.shape.corners_m).max(axis=0)
            for axis, place in self._places:
                velocity = self.data.qvel[rows.start + axis]
                edge = self.data.qpos[first + axis] + np.sign(velocity) * reach[axis]
                behind = abs(edge - place) < abs(velocity) * seconds
                if (
                    behind
                    and abs(velocity) > 0.1
                    and (body.name, axis, place) not in passed
                ):
                    passed.add((body.name, axis, place))
                    self.data.qvel[rows.start + axis] *= 0.7


def _few_pairs(simulation):
    simulation.model.pair_margin[32:] = NEVER


class _FirstBodyPushed(Planted):
    def apply_wrench(self, body, wrenches):
        super().apply_wrench(self.given.dynamic_bodies[0].name, wrenches)


class _WorldsCollide(LoopedSimulation):
    def advance(self, seconds):
        super().advance(seconds)
        first = self._simulations[0]
        names = [body.name for body in free(first.given)]
        for number, other in enumerate(self._simulations[1:], 1):
            for name in names:
                gap = (
                    first.body_states([name])[0, 0, :3]
                    - other.body_states([name])[0, 0, :3]
                )
                if np.linalg.norm(gap) < 0.02:
                    rows = dofs(other.model, name)
                    other.data.qvel[rows.start] += 0.01 * number


def _heavy_sinks(simulation):
    model = simulation.model
    masses = {body.name: body.mass_kg for body in simulation.given.dynamic_bodies}
    for index in range(model.npair):
        pair = bodies_of_pair(model, index)
        if all(name in masses for name in pair):
            light, heavy = sorted(masses[name] for name in pair)
            if heavy >= 100.0 * light:
                model.pair_margin[index] = NEVER


class _CylinderRocks(Planted):
    def advance(self, seconds):
        super().advance(seconds)
        self._sign = -getattr(self, "_sign", 1.0)
        for body in free(self.given):
            if isinstance(body.shape, Cylinder) and self.data.ncon:
                turn = matrix(self.data, self.model, body.name)
                axis = turn[:, 2]
                if abs(axis[2]) < 0.2:
                    rows = dofs(self.model, body.name)
                    across = turn.T @ np.cross(axis, [0.0, 0.0, 1.0])
                    self.data.qvel[rows.start + 3 : rows.stop] += (
                        0.05 * self._sign * across
                    )


class _TurnsAsItSlides(Planted):
    def advance(self, seconds):
        super().advance(seconds)
        for data in self.datas:
            for body in free(self.given):
                rows = dofs(self.model, body.name)
                speed = np.linalg.norm(data.qvel[rows][:2])
                if isinstance(body.shape, Box) and data.ncon and speed > 0.05:
                    up = matrix(data, self.model, body.name)[2]
                    data.qvel[rows.start + 3 : rows.stop] += 0.3 * seconds * up


class _ClothDrifts(Planted):
    def reset(self, starts=None, seed=0):
        super().reset(starts, seed)
        self._time_s = 0.0

    def advance(self, seconds):
        super().advance(seconds)
        self._time_s = getattr(self, "_time_s", 0.0) + seconds

    def nodes(self, name):
        nodes = np.array(super().nodes(name))
        if name in self.given.free_cloths:
            nodes[..., 0] += 0.01 * getattr(self, "_time_s", 0.0) ** 2
        return nodes


def _self_contact_alone(scene):
    folding = {
        name
        for contact in scene.contacts
        for name in set(contact.first) & set(contact.second)
        if name in {body.name for body in scene.deformables}
    }
    return replace(
        scene,
        contacts=tuple(
            contact
            for contact in scene.contacts
            if not folding & {*contact.first, *contact.second}
            or set(contact.first) == set(contact.second)
        ),
    )


def _small_mass(scene):
    def change(body):
        volume = body.shape.volume_m3
        if body.motion is not Motion.DYNAMIC or volume >= 1e-6:
            return body
        return replace(body, mass_kg=1000.0 * volume)

    return replace(scene, bodies=tuple(change(body) for body in scene.bodies))


def _anchor_from_centre(scene):
    joints, bodies = [], {body.name: body for body in scene.bodies}
    for joint in scene.joints:
        if isinstance(joint, Hinge):
            body = bodies[joint.body]
            centre = body.pose.rotation.apply(body_mass_properties(body)[0])
            anchor = tuple((np.array(joint.anchor_m) + centre).tolist())
            joint = replace(joint, anchor_m=anchor)
            spin = np.array(body.angular_velocity_rad_per_s)
            arm = np.subtract(body.pose.position_m, anchor)
            velocity = tuple(np.cross(spin, arm).tolist())
            bodies[body.name] = replace(body, linear_velocity_m_per_s=velocity)
        joints.append(joint)
    return replace(scene, joints=tuple(joints), bodies=tuple(bodies.values()))


def _no_spin_friction(contact):
    return contact if contact.rolling_m else replace(contact, torsion_m=0.0)


def _more_rebound(contact):
    return replace(contact, restitution=1.03 * contact.restitution)


ENTRIES = {
    "capsule falls through a box": Entry(
        "google-deepmind/mujoco_warp issue 163",
        "capsule-box contacts are missing or wrong; capsules sink into box terrain",
        "pairs of a capsule and a box never touch (capsule on plane works)",
        "Capsules do not collide with boxes.",
        Fault(engine=edited(_capsule_box)),
    ),
    "first part of a compound": Entry(
        "playcanvas/engine issue 7036; MADEAPPS/newton-dynamics issue 246",
        "legs and backrest of a compound chair no longer collide",
        "only part 0 of a compound has contacts; its mass is right",
        "Only the first part of a compound collides.",
        Fault(engine=edited(_first_part_collides)),
    ),
    "hinged pass the world": Entry(
        "newton-physics/newton pull 2664, issue 2201; google-deepmind/mujoco issue 2444",
        "the parent-child filter treats the world as the parent of a joint",
        "a hinged body has no contacts with fixed bodies",
        "Hinged bodies pass through fixed bodies: the parent filter counts the world as parent.",
        Fault(scene=_hinged_pass_world),
    ),
    "press ignored by friction": Entry(
        "schteppe/p2.js issue 71",
        "friction is bounded by mass times gravity, not by the normal force",
        "friction of a pushed body scaled by m g / (m g + press)",
        "A pressing force does not raise the friction limit (mu m g is used).",
        Fault(simulation=_FrictionOfWeight),
    ),
    "small bodies hover": Entry(
        "godotengine/godot issue 30861; defold/defold issue 8433",
        "convex margin leaves a visible gap between small objects and the floor",
        "contact margin 0.3 mm for shapes of at most 12.5 mm bounding radius",
        "Small bodies float 0.3 mm above what they rest on: a contact margin.",
        Fault(engine=edited(_small_hover)),
    ),
    "sticky start": Entry(
        "google-deepmind/mujoco issue 1366; liabru/matter-js issue 612 (frictionStatic)",
        "static friction above kinetic friction until a body moves",
        "friction x 1.3 while the body is slower than 1 mm/s",
        "Static friction is larger than mu: a body starts to slide too late.",
        Fault(simulation=_StickyStart),
    ),
    "gyroscopic drift": Entry(
        "avianphysics/avian pull 993, 738; jrouwe/JoltPhysics ApplyGyroscopicForceInternal",
        "explicit gyroscopic step with clamped momentum drives energy to that of the intermediate axis",
        "the same step at 180 Hz",
        "The gyroscopic torque is integrated explicitly: a free spin drifts in energy and direction.",
        Fault(simulation=_GyroDrift),
    ),
    "warm start survives reset": Entry(
        "isaac-sim/IsaacLab issue 5359; dartsim/dart issue 3443",
        "pose writes leave the solver's warm start; a spurious 3 cm/s after each teleport of a settled scene",
        "after a reset the first advance applies 1/360 s of the last contact force",
        "reset keeps the contact impulses of the run before.",
        Fault(simulation=_WarmStart),
    ),
    "torque in link frame": Entry(
        "bulletphysics/bullet3 issue 1949",
        "LINK_FRAME and WORLD_FRAME are inverted in applyExternalTorque; the force is right",
        "the torque of a wrench is rotated by the orientation of the body",
        "apply_wrench takes the torque in the body frame instead of the world frame.",
        Fault(simulation=_TorqueInBody),
    ),
    "reported friction reversed": Entry(
        "RobotLocomotion/drake pull 9256",
        "the sign of the reported friction force is wrong, dynamics are right",
        "tangential part of contact_forces times -1",
        "contact_forces reports friction with the wrong sign.",
        Fault(simulation=_FrictionSign),
    ),
    "friction pyramid": Entry(
        "dartsim/dart issue 841; bulletphysics/bullet3 pull 4539, issue 2590",
        "friction depends on the direction of the push relative to the axes",
        "setting cone = pyramidal",
        "Friction depends on direction: a pyramid stands for the cone.",
        Fault(engine=with_settings(cone="pyramidal")),
    ),
    "friction of bodies, not pairs": Entry(
        "newton-physics/newton issue 3644, 2422",
        "explicit pair parameters are ignored, the maximum of two geoms' friction is used",
        "a body has the friction of the first contact that lists it; a pair has the larger",
        "Friction belongs to bodies instead of pairs, the larger of two wins.",
        Fault(scene=_friction_of_bodies),
    ),
    "restitution threshold": Entry(
        "erincatto/box2d pull 654; DanielChappuis/reactphysics3d issue 96",
        "impacts slower than 1 m/s do not bounce",
        "restitution 0 where two bodies are slower than 1 m/s to each other",
        "A velocity threshold of 1 m/s removes the rebound of slow impacts.",
        Fault(simulation=_ReboundThreshold),
    ),
    "rebound gains energy": Entry(
        "dimforge/rapier issue 97; jrouwe/JoltPhysics pull 1328",
        "a ball with restitution 1 bounces higher and higher",
        "restitution x 1.03",
        "Rebounds are 3 % too fast: impacts add energy.",
        Fault(scene=change_contacts(_more_rebound)),
    ),
    "inertia of a compound": Entry(
        "schteppe/cannon.js issue 92; jrouwe/JoltPhysics pull 402; JulioJerez/newton-dynamics pull 22",
        "the moments of a compound belong to the wrong axes",
        "principal moments of a compound in reversed order",
        "The inertia of a compound is wrong.",
        Fault(engine=edited(_compound_inertia)),
    ),
    "start velocity at the centre": Entry(
        "newton-physics/newton pull 1350, 2206",
        "a start velocity is taken for the centre of mass where the origin is meant",
        "reset sets v at the centre of mass; reports are right",
        "reset takes the start velocity as that of the centre of mass, not of the origin.",
        Fault(simulation=_StartAtCentre),
    ),
    "spin limit": Entry(
        "godotengine/godot issue 120724 (Jolt); bulletphysics/bullet3 issue 1890",
        "angular velocity is clamped at 47 rad/s (Jolt), 100 (Bullet)",
        "|omega| at most 47.1 rad/s",
        "Angular velocity is clamped at 47 rad/s.",
        Fault(simulation=_SpinLimit),
    ),
    "falls asleep in motion": Entry(
        "dimforge/bevy_rapier issue 240",
        "a body with a small velocity stops abruptly after a few seconds (sleep)",
        "slower than 0.4 m/s and 0.5 rad/s for 2 s: it stops until pushed",
        "A slow body falls asleep although it moves.",
        Fault(simulation=_FallsAsleep),
    ),
    "snags at seams": Entry(
        "dimforge/rapier issue 142; jrouwe/JoltPhysics pull 882",
        "a body that slides over flush boxes snags on inner edges",
        "30 % of the velocity is lost at each seam of two flush fixed boxes",
        "Sliding bodies lose speed at seams of flush boxes (ghost collisions).",
        Fault(simulation=_Snags),
    ),
    "contact buffer overflows": Entry(
        "newton-physics/newton pull 3254; google-deepmind/mujoco_warp issue 290",
        "contacts beyond the buffer are dropped",
        "pairs of geoms after the 32nd never touch",
        "Contacts beyond a buffer of 32 are dropped.",
        Fault(engine=edited(_few_pairs)),
    ),
    "wrench of the first body": Entry(
        "bulletphysics/bullet3 pull 698; isaac-sim/IsaacLab issue 475",
        "the link of an external force is read and not used",
        "apply_wrench pushes the first dynamic body whatever its name",
        "apply_wrench pushes another body than the named one.",
        Fault(simulation=_FirstBodyPushed),
    ),
    "worlds collide": Entry(
        "isaac-sim/IsaacLab issue 2548",
        "environments collide with each other on the CPU",
        "a body within 20 mm of its twin in the first world is pushed 10 mm/s a call",
        "Bodies of different worlds collide with each other.",
        Fault(worlds=_WorldsCollide),
    ),
    "heavy sinks through light": Entry(
        "dartsim/dart issue 3442",
        "a heavy box sinks through a light one from a mass ratio of 100",
        "pairs of dynamic bodies with a mass ratio of 100 or more never touch",
        "Heavy bodies sink through light ones.",
        Fault(engine=edited(_heavy_sinks)),
    ),
    "lying cylinder rocks": Entry(
        "google-deepmind/mujoco_warp issue 1555",
        "one contact that alternates between the ends of a lying cylinder; it oscillates",
        "a lying cylinder gets +-0.05 rad/s about the horizontal across its axis at each call",
        "A lying cylinder has one contact that jumps between its ends, so it rocks.",
        Fault(simulation=_CylinderRocks),
    ),
    "spinning friction needs rolling": Entry(
        "bulletphysics/bullet3 pull 4205",
        "spinning friction is not applied without rolling friction",
        "torsion_m = 0 where rolling_m = 0",
        "Torsional friction is missing where there is no rolling friction.",
        Fault(scene=change_contacts(_no_spin_friction)),
    ),
    "turns as it slides": Entry(
        "jrouwe/JoltPhysics issue 983",
        "a box rotates while it slides, friction is applied asymmetrically",
        "a sliding box gets 0.3 rad/s2 about the vertical",
        "A sliding box turns about the vertical: friction acts unevenly on its contacts.",
        Fault(simulation=_TurnsAsItSlides),
    ),
    "cloth drifts in free fall": Entry(
        "newton-physics/newton issue 276",
        "cloth in free fall moves sideways",
        "nodes of an unclamped cloth accelerate by 20 mm/s2 along x",
        "Free cloth gains horizontal momentum.",
        Fault(simulation=_ClothDrifts),
    ),
    "self-contact disables others": Entry(
        "newton-physics/newton issue 351",
        "with self contact enabled, the cloth passes through other meshes",
        "a cloth with self-contact has no other contacts",
        "A cloth that touches itself passes through other bodies.",
        Fault(scene=_self_contact_alone),
    ),
    "mass of small bodies": Entry(
        "newton-physics/newton pull 4160",
        "explicit mass below one cubic centimetre is discarded",
        "bodies below 1 cm3 get the density of water",
        "The given mass of a small body is ignored.",
        Fault(scene=_small_mass),
    ),
    "hinge anchor from the centre": Entry(
        "DanielChappuis/reactphysics3d issue 74; gazebosim/gazebo-classic issue 978",
        "the anchor of a hinge is wrong where the shape is off the body's origin",
        "the anchor is shifted by the offset of the centre of mass",
        "A hinge's anchor is misplaced by the offset of the centre of mass from the origin.",
        Fault(scene=_anchor_from_centre),
    ),
}

ORDER = sorted(ENTRIES)
random.Random(114).shuffle(ORDER)
FAULTS3 = {name: ENTRIES[name] for name in ORDER}
