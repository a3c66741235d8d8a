"""Fourth set: 20 faults of physics engines from public trackers, planted in the backend of MuJoCo.

They were written, and drawn from 24, before their author read the checks and the code of causes.
"""

import random
from dataclasses import replace

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs.backends import LoopedSimulation
from gauge_envs.scene import (
    Box,
    Capsule,
    Cloth,
    ConvexUnion,
    Motion,
    body_mass_properties,
)
from gauge_envs.scene.states import nominal_states
from studies.planted_faults.third_set import (
    Entry,
    Stepped,
    bodies_of_pair,
    dofs,
    edited,
    free,
    matrix,
)
from tests.faults import Fault, Faulty, Planted, change_bodies, change_contacts

Geom = mujoco.mjtGeom


class _Damped(Planted):
    def advance(self, seconds):
        super().advance(seconds)
        for data in self.datas:
            for body in free(self.given):
                rows = dofs(self.model, body.name)
                data.qvel[rows.start : rows.start + 3] *= 0.96**seconds
                data.qvel[rows.start + 3 : rows.stop] *= 0.9**seconds


def _friction_of_mass(simulation):
    model = simulation.model
    masses = {body.name: body.mass_kg for body in simulation.given.dynamic_bodies}
    for index in range(model.npair):
        own = [masses[name] for name in bodies_of_pair(model, index) if name in masses]
        if own:
            model.pair_friction[index, :2] *= np.clip(min(own), 0.1, 5.0)


class _FastLoses(Faulty):
    """Impacts faster than 3 m/s rebound with 0.8 of the restitution."""

    def build(self, scene, settings=None):
        simulation = super().build(scene, settings)
        less = change_contacts(lambda c: replace(c, restitution=0.8 * c.restitution))(
            scene
        )
        simulation.less = self.healthy.build(less, settings).model.pair_solref.copy()
        return simulation


class _FastLosesStep(Stepped):
    def before(self, data):
        model = self.model
        if not hasattr(self, "less"):
            return
        if not hasattr(self, "_solref"):
            self._solref = model.pair_solref.copy()
            self._names = [bodies_of_pair(model, index) for index in range(model.npair)]
            self._until = {}
            self._free = [body.name for body in free(self.given)]
        fast = {}
        for name in self._free:
            if np.linalg.norm(data.qvel[dofs(model, name)][:3]) > 3.0:
                self._until[name] = data.time + 0.02
            if data.time > self._until.get(name, -1.0) + 1.0:
                self._until.pop(name, None)
            fast[name] = data.time < self._until.get(name, -1.0)
        for index, names in enumerate(self._names):
            slow = not any(fast.get(name, False) for name in names)
            model.pair_solref[index] = (self._solref if slow else self.less)[index]


class _HalfForces(Planted):
    def contact_forces(self, pairs):
        read = super().contact_forces(pairs)
        return lambda: 0.5 * read()


class _FirstSubstep(Stepped):
    """A wrench acts in the first step of a call."""

    def apply_wrench(self, body, wrenches):
        super().apply_wrench(body, wrenches)
        self.__dict__.setdefault("_pushed", {})[body] = np.array(wrenches)

    def reset(self, starts=None, seed=0):
        super().reset(starts, seed)
        self._pushed = {}

    def _step(self, world, count):
        pushed = self.__dict__.setdefault("_pushed", {})
        data = self.datas[world]
        readers = self._force_readers[world]
        for reader in readers:
            reader.clear()
        for step in range(count):
            for body, wrenches in pushed.items():
                row = self.model.body(body).id
                data.xfrc_applied[row] = wrenches[world] if step == 0 else 0.0
            for air in self._air:
                air.apply()
            mujoco.mj_step(self.model, data)
            for reader in readers:
                reader.add()


class _ForceAtOrigin(Planted):
    def apply_wrench(self, body, wrenches):
        wrenches = np.array(wrenches)
        if body not in self.given.hinges:
            centre = body_mass_properties(self.given.body(body))[0]
            for row, data in enumerate(self.datas):
                arm = -(matrix(data, self.model, body) @ centre)
                wrenches[row, 3:] += np.cross(arm, wrenches[row, :3])
        super().apply_wrench(body, wrenches)


def _axes(model, row):
    axes = np.empty(9)
    mujoco.mju_quat2Mat(axes, model.body_iquat[row])
    return axes.reshape(3, 3)


def _no_products(simulation):
    model = simulation.model
    for body in free(simulation.given):
        row = model.body(body.name).id
        axes = _axes(model, row)
        model.body_inertia[row] = np.diag(
            axes @ np.diag(model.body_inertia[row]) @ axes.T
        )
        model.body_iquat[row] = [1.0, 0.0, 0.0, 0.0]
    mujoco.mj_setConst(model, simulation.data)
    simulation.reset()


def _bounding_inertia(simulation):
    model = simulation.model
    convex = [
        b for b in simulation.given.dynamic_bodies if isinstance(b.shape, ConvexUnion)
    ]
    for body in convex:
        row = model.body(body.name).id
        points = np.concatenate([np.array(piece) for piece in body.shape.pieces_m])
        edges = np.ptp(points, axis=0) ** 2
        model.body_inertia[row] = body.mass_kg / 12.0 * (edges.sum() - edges)
        model.body_iquat[row] = [1.0, 0.0, 0.0, 0.0]
    if convex:
        mujoco.mj_setConst(model, simulation.data)
        simulation.reset()


def _cylinder_on_plane(simulation):
    model = simulation.model
    for index in range(model.npair):
        geoms = model.pair_geom1[index], model.pair_geom2[index]
        if {Geom(model.geom_type[g]) for g in geoms} == {
            Geom.mjGEOM_CYLINDER,
            Geom.mjGEOM_PLANE,
        }:
            model.pair_margin[index] += 1e-3


class _NoSpinOfDriven(Planted):
    """The contact of a driven body knows its velocity and not its spin; reports are right."""

    def reset(self, starts=None, seed=0):
        super().reset(starts, seed)
        self._targets, self._since = {}, {}

    def drive(self, body, targets):
        self.__dict__.setdefault("_targets", {})[body] = np.array(targets)
        self.__dict__.setdefault("_since", {})[body] = 0.0
        targets = np.array(targets)
        targets[:, 10:13] = 0.0
        targets[:, 16:19] = 0.0
        super().drive(body, targets)

    def advance(self, seconds):
        super().advance(seconds)
        for name in self.__dict__.setdefault("_since", {}):
            self._since[name] += seconds

    def body_states(self, names):
        states = super().body_states(names)
        for row, name in enumerate(names):
            target = self.__dict__.get("_targets", {}).get(name)
            if target is not None:
                time = self._since[name]
                for world in range(len(states)):
                    spin, rise = target[world, 10:13], target[world, 16:19]
                    turn = Rotation.from_rotvec(spin * time + 0.5 * rise * time**2)
                    w, x, y, z = target[world, 3:7]
                    x, y, z, w = (turn * Rotation.from_quat([x, y, z, w])).as_quat()
                    states[world, row, 3:7] = [w, x, y, z]
                    states[world, row, 10:13] = spin + rise * time
        return states


class _RestingAbsorbs(Stepped):
    """No rebound where one of two dynamic bodies is at rest before the impact."""

    def before(self, data):
        model = self.model
        if not hasattr(self, "_solref"):
            self._solref = model.pair_solref.copy()
            moving = {body.name for body in free(self.given)}
            self._rows = []
            for index in range(model.npair):
                names = bodies_of_pair(model, index)
                if self._solref[index, 1] < 0.0 and set(names) <= moving:
                    self._rows.append((index, [dofs(model, name) for name in names]))
            self._last = {}
        for index, rows in self._rows:
            if any(np.linalg.norm(data.qvel[row][:3]) < 1e-3 for row in rows):
                self._last[index] = data.time
            rest = 0.0 <= data.time - self._last.get(index, -1.0) < 0.02
            damping = -1.0 / self.timestep_s if rest else self._solref[index, 1]
            model.pair_solref[index, 1] = damping


def _bounce_at_zero(scene):
    moving = {body.name for body in scene.dynamic_bodies}
    contacts = []
    for contact in scene.contacts:
        for first, second in scene.colliding_pairs(contact):
            pair = replace(contact, first=(first,), second=(second,))
            if {first, second} <= moving and contact.restitution == 0.0:
                pair = replace(pair, restitution=0.4)
            contacts.append(pair)
    return replace(scene, contacts=tuple(contacts))


class _SpinLost(Planted):
    def reset(self, starts=None, seed=0):
        if starts is None:
            starts = np.repeat(
                nominal_states(self.given)[None], self.world_count, axis=0
            )
        starts = np.array(starts)
        for row, body in enumerate(self.given.bodies):
            if body.motion is Motion.DYNAMIC and body.name not in self.given.hinges:
                starts[:, row, 10:13] = 0.0
        super().reset(starts, seed)


class _Sinks(Planted):
    """A capsule sinks into a plane by 1 mm/s."""

    def advance(self, seconds):
        model = self.model
        if not hasattr(self, "_margin"):
            self._margin = model.pair_margin.copy()
            kinds = {Geom.mjGEOM_CAPSULE, Geom.mjGEOM_PLANE}
            self._rows = [
                i
                for i in range(model.npair)
                if {
                    Geom(model.geom_type[g])
                    for g in (model.pair_geom1[i], model.pair_geom2[i])
                }
                == kinds
            ]
        for index in self._rows:
            model.pair_margin[index] = self._margin[index] - 1e-3 * self.data.time
        super().advance(seconds)


class _Broadcast(LoopedSimulation):
    def apply_wrench(self, body, wrenches):
        super().apply_wrench(body, np.repeat(wrenches[:1], self.world_count, axis=0))


class _StaleForces(Planted):
    """contact_forces keep their last value after bodies part."""

    def contact_forces(self, pairs):
        read = super().contact_forces(pairs)
        kept = {}

        def stale():
            values = np.array(read())
            old = kept.get("values", np.zeros_like(values))
            apart = np.all(values == 0.0, axis=-1, keepdims=True)
            kept["values"] = np.where(apart, old, values)
            return kept["values"].copy()

        return stale


def _short_capsule(body):
    if not isinstance(body.shape, Capsule):
        return body
    length = max(body.shape.length_m - 2.0 * body.shape.radius_m, 1e-4)
    return replace(body, shape=Capsule(radius_m=body.shape.radius_m, length_m=length))


def _cylinder_axis(simulation):
    model = simulation.model
    half = np.array([np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0])
    for geom in range(model.ngeom):
        if model.geom_type[geom] == Geom.mjGEOM_CYLINDER:
            turned = np.empty(4)
            mujoco.mju_mulQuat(turned, model.geom_quat[geom], half)
            model.geom_quat[geom] = turned
            model.geom_sameframe[geom] = 0


class _HingeDamped(Planted):
    def advance(self, seconds):
        super().advance(seconds)
        model = self.model
        for name in self.given.hinges:
            row = int(model.jnt_dofadr[model.body_jntadr[model.body(name).id]])
            for data in self.datas:
                data.qvel[row] *= 0.96**seconds


def _stiff_bending(scene):
    def change(body):
        if not isinstance(body, Cloth):
            return body
        return replace(
            body, bend_stiffness_n_m_per_rad=3.0 * body.bend_stiffness_n_m_per_rad
        )

    return replace(scene, deformables=tuple(change(body) for body in scene.deformables))


def _friction_is_restitution(contact):
    return (
        replace(contact, friction=contact.restitution)
        if contact.restitution
        else contact
    )


class _NoWake(Planted):
    """A body at rest for 0.5 s sleeps; a wrench or a moving free body wakes it, a driven one does not."""

    def reset(self, starts=None, seed=0):
        super().reset(starts, seed)
        self._quiet = {}

    def apply_wrench(self, body, wrenches):
        super().apply_wrench(body, wrenches)
        if np.any(wrenches):
            self.__dict__.setdefault("_quiet", {}).pop(body, None)

    def advance(self, seconds):
        data, model = self.data, self.model
        quiet = self.__dict__.setdefault("_quiet", {})
        bodies = free(self.given)
        moving = any(
            np.linalg.norm(data.qvel[dofs(model, b.name)]) > 0.02 for b in bodies
        )
        poses = data.qpos.copy()
        super().advance(seconds)
        for body in bodies:
            rows = dofs(model, body.name)
            asleep = quiet.get(body.name, 0.0) > 0.5 and not moving
            slow = np.abs(data.qvel[rows]).max() < 5e-3 and data.ncon > 0
            if asleep:
                first = int(model.joint(body.name).qposadr[0])
                data.qpos[first : first + 7] = poses[first : first + 7]
                data.qvel[rows] = 0.0
            elif slow:
                quiet[body.name] = quiet.get(body.name, 0.0) + seconds
            else:
                quiet[body.name] = 0.0


class _StacksRock(Planted):
    """A box on a dynamic box rocks: a face has three contacts at most."""

    def advance(self, seconds):
        super().advance(seconds)
        self._sign = -getattr(self, "_sign", 1.0)
        boxes = {b.name for b in free(self.given) if isinstance(b.shape, Box)}
        for data in self.datas:
            for index in range(data.ncon):
                pair = [
                    self.model.body(self.model.geom_bodyid[g]).name
                    for g in data.contact[index].geom
                ]
                if set(pair) <= boxes:
                    high = max(pair, key=lambda name: data.body(name).xpos[2])
                    rows = dofs(self.model, high)
                    kick = 0.05 * self._sign * np.array([1.0, 1.0, 0.0])
                    data.qvel[rows.start + 3 : rows.stop] += kick


def _scene(change):
    return Fault(scene=change)


ENTRIES = {
    "default damping": Entry(
        "godotengine/godot issue 46650; bulletphysics/bullet3 issue 4795",
        "default linear and angular damping is added to every body",
        "linear 0.04/s, angular 0.1/s on free bodies",
        "Free bodies are damped: default linear and angular damping.",
        Fault(simulation=_Damped),
    ),
    "friction of mass": Entry(
        "avianphysics/avian pull 52",
        "the friction bound lacks the division by mass",
        "friction of a pair times the mass of the lighter body in kg",
        "Friction scales with the mass of a body.",
        Fault(engine=edited(_friction_of_mass)),
    ),
    "fast impacts lose": Entry(
        "bulletphysics/bullet3 issue 1530",
        "ideal rebound is right from small heights and too low from great ones",
        "restitution x 0.8 above 3 m/s",
        "Fast impacts rebound too slowly: the rebound depends on speed.",
        Fault(engine=_FastLoses, simulation=_FastLosesStep),
    ),
    "half contact forces": Entry(
        "bulletphysics/bullet3 pull 2797",
        "contact force is the impulse of a substep over the whole step",
        "contact_forces x 0.5",
        "contact_forces are scaled (impulse over the wrong time step).",
        Fault(simulation=_HalfForces),
    ),
    "force in first substep": Entry(
        "Genesis-Embodied-AI/genesis-world pull 1290; schteppe/p2.js issue 137",
        "external forces are cleared after the first substep",
        "a wrench acts in the first step of each call of advance",
        "apply_wrench acts in the first substep of a call only.",
        Fault(simulation=_FirstSubstep),
    ),
    "force at origin": Entry(
        "dimforge/rapier issue 216; newton-physics/newton issue 469; godot-jolt/godot-jolt issue 614",
        "a force turns bodies whose centre of mass is off the origin",
        "the force of a wrench acts at the body's origin",
        "apply_wrench's force acts at the origin instead of the centre of mass.",
        Fault(simulation=_ForceAtOrigin),
    ),
    "no products of inertia": Entry(
        "godotengine/godot pull 112367, pull 77938; o3de/o3de issue 7820",
        "off-diagonal values of the inertia are discarded",
        "diagonal of the inertia in the body frame",
        "Products of inertia are dropped: principal axes are those of the body frame.",
        Fault(engine=edited(_no_products)),
    ),
    "inertia of the bounding box": Entry(
        "DanielChappuis/reactphysics3d issue 191",
        "the inertia of a convex mesh is that of its bounding box",
        "the same for ConvexUnion",
        "Convex solids have the inertia of their bounding box.",
        Fault(engine=edited(_bounding_inertia)),
    ),
    "cylinder on plane": Entry(
        "newton-physics/newton issue 826",
        "cylinder-plane contacts have the wrong offset",
        "contacts 1 mm above the plane for cylinders",
        "Cylinders float 1 mm above planes: a wrong contact offset.",
        Fault(engine=edited(_cylinder_on_plane)),
    ),
    "spin of driven bodies": Entry(
        "godotengine/godot pull 47183",
        "angular velocity of kinematic bodies is wrong in contact",
        "the contact does not see the spin of driven bodies; reports are right",
        "Driven bodies that turn do not drag what touches them: their spin is ignored.",
        Fault(simulation=_NoSpinOfDriven),
    ),
    "resting spheres absorb": Entry(
        "jrouwe/JoltPhysics issue 1403",
        "a sphere that hits a resting one sticks to it at restitution 1",
        "no rebound where one of two dynamic bodies is at rest",
        "Impacts on bodies at rest do not rebound.",
        Fault(simulation=_RestingAbsorbs),
    ),
    "bounce at zero": Entry(
        "newton-physics/newton issue 1137",
        "dynamic bodies bounce off each other at zero restitution",
        "restitution 0.4 for pairs of dynamic bodies with 0",
        "Pairs of dynamic bodies rebound although restitution is 0.",
        Fault(scene=_bounce_at_zero),
    ),
    "spin lost at start": Entry(
        "dimforge/rapier issue 587",
        "the angular velocity of the start is zero after a step",
        "reset drops the angular velocity",
        "reset ignores the start's angular velocity.",
        Fault(simulation=_SpinLost),
    ),
    "no rolling friction": Entry(
        "google-deepmind/mujoco_warp issue 507",
        "contact dimensions other than 3 are wrong",
        "rolling_m = 0",
        "Rolling friction is ignored.",
        Fault(scene=change_contacts(lambda c: replace(c, rolling_m=0.0))),
    ),
    "capsules sink": Entry(
        "gazebosim/gz-physics issue 692; dartsim/dart issue 1654",
        "a capsule sinks slowly through a plane",
        "1 mm/s",
        "Capsules sink slowly into planes.",
        Fault(simulation=_Sinks),
    ),
    "wrench of the first world": Entry(
        "mujocolab/mjlab pull 508",
        "a force is broadcast to all environments",
        "all worlds have the wrench of the first",
        "All worlds have the wrench of the first.",
        Fault(worlds=_Broadcast),
    ),
    "stale contact forces": Entry(
        "Genesis-Embodied-AI/genesis-world issue 2008",
        "forces of a pair are not zero when it is far apart",
        "the last force stays after the contact ends",
        "contact_forces keep old values after bodies part.",
        Fault(simulation=_StaleForces),
    ),
    "capsule with caps": Entry(
        "MovingBlocks/Terasology pull 4078 (Bullet)",
        "height with caps is taken for that of the cylinder, or the reverse",
        "capsules are shorter by two radii",
        "The length of capsules is read with the caps: they are too short.",
        Fault(scene=change_bodies(_short_capsule)),
    ),
    "cylinder axis": Entry(
        "s-nakaoka/choreonoid issue 117 (ODE)",
        "cylinders are turned by 90 degrees in collisions; wheels sink",
        "collision cylinders along y; mass and inertia right",
        "Cylinders collide along another axis.",
        Fault(engine=edited(_cylinder_axis)),
    ),
    "hinges damped": Entry(
        "bulletphysics/bullet3 issue 1485",
        "a pole on a frictionless hinge loses velocity",
        "hinge rate decays by 4 % a second",
        "Hinges are damped.",
        Fault(simulation=_HingeDamped),
    ),
    "stiff bending": Entry(
        "newton-physics/newton pull 3229",
        "the bend force of cloth is larger than it should be",
        "bend stiffness x 3",
        "Cloth bends too stiffly.",
        _scene(_stiff_bending),
    ),
    "friction is restitution": Entry(
        "dartsim/dart issue 1676",
        "setRestitutionCoeff sets the friction",
        "friction = restitution where restitution > 0",
        "Friction has the value of restitution.",
        Fault(scene=change_contacts(_friction_is_restitution)),
    ),
    "no wake by driven bodies": Entry(
        "dimforge/rapier.js pull 356",
        "kinematic bodies that start to move do not wake what rests on them",
        "a body at rest for 0.5 s stays until a wrench or a free body moves it",
        "Sleeping bodies are not woken by driven bodies.",
        Fault(simulation=_NoWake),
    ),
    "stacks rock": Entry(
        "dartsim/dart pull 3428",
        "faces have three contacts at most, stacked boxes rock forever",
        "+-0.05 rad/s a contact and call on boxes that rest on free boxes",
        "Stacked boxes rock: too few contacts of a face.",
        Fault(simulation=_StacksRock),
    ),
}

ORDER = sorted(ENTRIES)
random.Random(4114).shuffle(ORDER)
FAULTS4 = {name: ENTRIES[name] for name in ORDER[:20]}
