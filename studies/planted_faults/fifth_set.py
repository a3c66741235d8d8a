"""Fifth set: faults of physics engines, half from public trackers, planted in the backend of MuJoCo.

They were written after the rules of causes, with the words that name them, and run once.
"""

from dataclasses import replace
from threading import current_thread, main_thread
from typing import ClassVar

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs.backends import LoopedSimulation
from gauge_envs.scene import (
    ConvexUnion,
    Cylinder,
    Hinge,
    Motion,
    Sphere,
    Tether,
)
from studies.planted_faults.contract_faults import changed_model, scaled_bodies
from studies.planted_faults.third_set import (
    NEVER,
    DeepContacts,
    bodies_of_pair,
    dofs,
    entry,
    free,
)
from tests.faults import Fault, Planted, change_bodies, change_contacts

Geom = mujoco.mjtGeom

# --- from public trackers ---


def _hull_offset(model, simulation):
    """Shift the contact shape of convex solids along x by 2 mm and up by 1 mm."""
    for body in simulation.given.bodies:
        if isinstance(body.shape, ConvexUnion):
            row = model.body(body.name)
            for geom in range(row.geomadr[0], row.geomadr[0] + row.geomnum[0]):
                model.geom_pos[geom] += [0.002, 0.0, 0.001]
                model.geom_sameframe[geom] = 0


def _uneven_friction(model, _):
    """Scale the second direction of friction by 0.6."""
    model.pair_friction[:, 1] *= 0.6


def _hinged_sphere(model, simulation):
    """Give hinged bodies the inertia of a sphere."""
    for name in simulation.given.hinges:
        row = model.body(name).id
        model.body_inertia[row] = 3.0 * model.body_inertia[row].max()


class _RollersHop(Planted):
    """Kick rolling bodies in contact upward by 3 mm/s a call, as an impact that sees the spin."""

    def advance(self, seconds):
        super().advance(seconds)
        if not self.data.ncon:
            return
        for body in free(self.given):
            rows = dofs(self.model, body.name)
            spin = self.data.qvel[rows][3:]
            if isinstance(body.shape, Sphere | Cylinder) and np.hypot(*spin[:2]) > 3.0:
                self.data.qvel[rows.start + 2] += 3e-3


class _NoVelocityOfDriven(Planted):
    """Contacts do not see the velocity of driven bodies, which move and report rightly."""

    def reset(self, starts=None, seed=0):
        super().reset(starts, seed)
        self._targets, self._since = {}, {}

    def drive(self, body, targets):
        self.__dict__.setdefault("_targets", {})[body] = np.array(targets)
        self.__dict__.setdefault("_since", {})[body] = 0.0
        targets = np.array(targets)
        targets[:, 7:10] = 0.0
        targets[:, 13:16] = 0.0
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
                speed, gain = target[:, 7:10], target[:, 13:16]
                moved = speed * time + 0.5 * gain * time**2
                states[:, row, :3] = target[:, :3] + moved
                states[:, row, 7:10] = speed + gain * time
        return states


def _stacks_sink(model, simulation):
    """Let free bodies overlap by 1 mm in pairs of free bodies."""
    moving = {body.name for body in simulation.given.dynamic_bodies}
    for index in range(model.npair):
        if set(bodies_of_pair(model, index)) <= moving:
            model.pair_margin[index] -= 1e-3


class _FastPass(DeepContacts):
    """Bodies faster than 5 m/s have no contacts."""

    def depth_m(self, body, velocities):
        return -NEVER if np.linalg.norm(velocities[:3]) > 5.0 else 0.0


class _FirstRunDiffers(Planted):
    """The first run after the build is without gravity for one call."""

    def advance(self, seconds):
        gravity = self.model.opt.gravity.copy()
        if not getattr(self, "_has_run", False):
            self.model.opt.gravity[:] = 0.0
        super().advance(seconds)
        self.model.opt.gravity[:] = gravity
        self._has_run = True


class _AllAdvance(Planted):
    """A call of advance also advances the simulation that was built before."""

    last: ClassVar[list] = []

    def reset(self, starts=None, seed=0):
        super().reset(starts, seed)
        if self not in _AllAdvance.last:
            _AllAdvance.last[:] = [*_AllAdvance.last[-1:], self]

    def advance(self, seconds):
        super().advance(seconds)
        others = _AllAdvance.last
        # Two threads may not advance one simulation.
        if current_thread() is not main_thread():
            others = []
        for other in others:
            if other is not self and not other.__dict__.get("_closed"):
                super(_AllAdvance, other).advance(seconds)

    def close(self):
        self._closed = True
        if self in _AllAdvance.last:
            _AllAdvance.last.remove(self)
        super().close()


class _Deflected(Planted):
    """Push sliding bodies to the right of their way by 0.5 m/s2."""

    def advance(self, seconds):
        super().advance(seconds)
        if not self.data.ncon:
            return
        for body in free(self.given):
            rows = dofs(self.model, body.name)
            x, y = self.data.qvel[rows][:2]
            speed = np.hypot(x, y)
            if speed > 0.05 and not isinstance(body.shape, Sphere | Cylinder):
                right = np.array([y, -x]) / speed
                self.data.qvel[rows.start : rows.start + 2] += 0.5 * seconds * right


# --- own ---


def _rubbing_hinges(model, simulation):
    for name in simulation.given.hinges:
        model.dof_frictionloss[model.body_dofadr[model.body(name).id]] = 2e-3


class _LightFloat(Planted):
    """Gravity does not act on bodies below 1 g."""

    def advance(self, seconds):
        for body in free(self.given):
            if body.mass_kg < 1e-3:
                first = dofs(self.model, body.name).start
                gain = body.mass_kg * self.given.gravity_m_per_s2
                self.data.qfrc_applied[first + 2] = gain
        super().advance(seconds)


class _WrenchesAdd(Planted):
    def reset(self, starts=None, seed=0):
        super().reset(starts, seed)
        self._sums = {}

    def apply_wrench(self, body, wrenches):
        sums = self.__dict__.setdefault("_sums", {})
        sums[body] = sums.get(body, 0.0) + np.array(wrenches)
        super().apply_wrench(body, sums[body])


class _ShiftedWorlds(LoopedSimulation):
    def reset(self, starts=None, seed=0):
        super().reset(None if starts is None else np.roll(starts, 1, axis=0), seed)


class _ForceInContactFrame(Planted):
    """contact_forces have the normal along x."""

    def contact_forces(self, pairs):
        read = super().contact_forces(pairs)
        return lambda: read()[..., [2, 0, 1]]


def _tall_boxes(model, simulation):
    """Make contact boxes of free bodies 0.6 mm higher."""
    for body in free(simulation.given):
        row = model.body(body.name)
        for geom in range(row.geomadr[0], row.geomadr[0] + row.geomnum[0]):
            if model.geom_type[geom] == Geom.mjGEOM_BOX:
                model.geom_size[geom, 2] += 3e-4


def _taut_strings(scene):
    """Make strings as long as their distance at the start."""
    joints = []
    for joint in scene.joints:
        if isinstance(joint, Tether):
            anchor = np.array(joint.anchor_m)
            place = np.array(scene.body(joint.body).pose.position_m)
            joint = replace(joint, length_m=float(np.linalg.norm(place - anchor)))
        joints.append(joint)
    return replace(scene, joints=tuple(joints))


def _cylinder_as_box(model, simulation):
    for body in free(simulation.given):
        if isinstance(body.shape, Cylinder):
            row = model.body(body.name).id
            side = (2.0 * body.shape.radius_m) ** 2
            high = body.shape.length_m**2
            moments = np.array([side + high, side + high, 2.0 * side])
            model.body_inertia[row] = body.mass_kg / 12.0 * moments
            model.body_iquat[row] = [1.0, 0.0, 0.0, 0.0]


class _AirDrag(Planted):
    """Quadratic drag of the air on free bodies, 0.05/m."""

    def advance(self, seconds):
        super().advance(seconds)
        for data in self.datas:
            for body in free(self.given):
                rows = dofs(self.model, body.name)
                speed = np.linalg.norm(data.qvel[rows][:3])
                data.qvel[rows.start : rows.start + 3] /= 1.0 + 0.05 * speed * seconds


def _last_contact_wins(scene):
    """Every contact has the friction of the last one of the scene."""
    if not scene.contacts:
        return scene
    friction = scene.contacts[-1].friction
    contacts = [replace(contact, friction=friction) for contact in scene.contacts]
    return replace(scene, contacts=tuple(contacts))


def _first_hinge(scene):
    """Every hinge has the axis of the first one."""
    hinges = [joint for joint in scene.joints if isinstance(joint, Hinge)]
    joints = tuple(
        replace(joint, axis=hinges[0].axis) if isinstance(joint, Hinge) else joint
        for joint in scene.joints
    )
    return replace(scene, joints=joints)


def _radius(body):
    if not isinstance(body.shape, Sphere) or body.motion is not Motion.DYNAMIC:
        return body
    return replace(body, shape=Sphere(radius_m=0.99 * body.shape.radius_m))


class _SpinOfStartInBody(Planted):
    """reset takes the spin of the start in the frame of the body."""

    def reset(self, starts=None, seed=0):
        super().reset(starts, seed)
        for data in self.datas:
            for body in free(self.given):
                rows = dofs(self.model, body.name)
                first = int(self.model.joint(body.name).qposadr[0])
                turn = Rotation.from_quat(
                    data.qpos[first + 3 : first + 7], scalar_first=True
                )
                spin = data.qvel[rows.start + 3 : rows.stop]
                data.qvel[rows.start + 3 : rows.stop] = turn.apply(spin, inverse=True)


FAULTS5 = {
    "hull offset": entry(
        "stride3d/stride issue 3384; bjornbytes/lovr issue 848",
        "the offset of a convex hull is lost or not turned",
        "Convex solids collide at another place.",
        changed_model(_hull_offset),
    ),
    "uneven friction": entry(
        "dimforge/rapier issue 137",
        "friction has a wrong component along an axis",
        "Friction depends on the direction.",
        changed_model(_uneven_friction),
    ),
    "hinged inertia": entry(
        "dimforge/rapier issue 86",
        "a pendulum with a non-uniform inertia is wrong",
        "Hinged bodies have another inertia.",
        changed_model(_hinged_sphere),
    ),
    "rollers hop": entry(
        "chandlerprall/GoblinPhysics pull 74",
        "a rolling sphere bounces on a flat surface since its spin counts as approach",
        "Rolling bodies hop.",
        Fault(simulation=_RollersHop),
    ),
    "velocity of driven bodies": entry(
        "godot-jolt/godot-jolt pull 463; erincatto/box2d issue 117",
        "kinematic bodies have no velocity in collisions",
        "Friction does not see the velocity of driven bodies.",
        Fault(simulation=_NoVelocityOfDriven),
    ),
    "stacks sink": entry(
        "melonjs/melonJS pull 1692",
        "stacked boxes settle inside each other",
        "Free bodies sink into free bodies.",
        changed_model(_stacks_sink),
    ),
    "fast bodies pass": entry(
        "liabru/matter-js issue 1117",
        "fast bodies penetrate",
        "Fast bodies have no contacts.",
        Fault(simulation=_FastPass),
    ),
    "first run differs": entry(
        "bulletphysics/bullet3 issue 2639",
        "the first reset of an environment behaves differently",
        "The first run differs from later ones.",
        Fault(simulation=_FirstRunDiffers),
    ),
    "simulations share time": entry(
        "StanfordVL/BEHAVIOR-1K pull 699",
        "a step of one environment also steps the others of the process",
        "Simulations are not independent of each other.",
        Fault(simulation=_AllAdvance),
    ),
    "deflected slides": entry(
        "DanielChappuis/reactphysics3d issue 85",
        "boxes slide to the right of their initial velocity",
        "Friction is not against the motion: it deflects.",
        Fault(simulation=_Deflected),
    ),
    "centre of mass mirrored": entry(
        "avianphysics/avian issue 108",
        "the body behaves as if the centre of mass was on the other side",
        "The centre of mass is misplaced.",
        scaled_bodies("body_ipos", -1.0),
    ),
    "rubbing hinges": entry(
        "own",
        "2 mN m of dry friction in hinges",
        "Hinges rub.",
        changed_model(_rubbing_hinges),
    ),
    "light bodies float": entry(
        "own",
        "no gravity below 1 g",
        "Gravity is wrong for some bodies.",
        Fault(simulation=_LightFloat),
    ),
    "root of restitution": entry(
        "own",
        "restitution is its square root",
        "Restitution is too large at every speed.",
        Fault(
            scene=change_contacts(lambda c: replace(c, restitution=c.restitution**0.5))
        ),
    ),
    "root of friction": entry(
        "own",
        "friction is its square root",
        "Friction of each pair has another factor: too large.",
        Fault(scene=change_contacts(lambda c: replace(c, friction=c.friction**0.5))),
    ),
    "wrenches add": entry(
        "own",
        "a wrench adds to that of earlier calls",
        "apply_wrench applies another multiple: earlier calls add.",
        Fault(simulation=_WrenchesAdd),
    ),
    "torsion times friction": entry(
        "own",
        "torsion_m is multiplied by the friction",
        "Torsional friction has another unit.",
        Fault(
            scene=change_contacts(
                lambda c: replace(c, torsion_m=c.torsion_m * c.friction)
            )
        ),
    ),
    "shifted worlds": entry(
        "own",
        "worlds have the start of a neighbour",
        "Worlds have another world's start.",
        Fault(worlds=_ShiftedWorlds),
    ),
    "forces in contact frame": entry(
        "own",
        "contact_forces have the normal first",
        "contact_forces have another frame.",
        Fault(simulation=_ForceInContactFrame),
    ),
    "tall boxes": entry(
        "own",
        "free boxes are 0.6 mm higher in contacts",
        "Boxes have another size in contacts.",
        changed_model(_tall_boxes),
    ),
    "strings taut": entry(
        "own",
        "a string is as long as its start",
        "Strings have another length.",
        Fault(scene=_taut_strings),
    ),
    "cylinder as box": entry(
        "own",
        "cylinders have the inertia of boxes",
        "Cylinders have another inertia.",
        changed_model(_cylinder_as_box),
    ),
    "air drag": entry(
        "own",
        "quadratic drag of 0.05/m",
        "Velocities of free bodies are damped.",
        Fault(simulation=_AirDrag),
    ),
    "last contact wins": entry(
        "own",
        "all contacts have the friction of the last",
        "Friction is not that of the pair.",
        Fault(scene=_last_contact_wins),
    ),
    "small spheres": entry(
        "own",
        "spheres are 1 % smaller",
        "Spheres have another size.",
        Fault(scene=change_bodies(_radius)),
    ),
    "start spin in body frame": entry(
        "own",
        "reset takes the spin in the body frame",
        "The start's spin has another frame.",
        Fault(simulation=_SpinOfStartInBody),
    ),
}
"""Eleven faults of trackers and fifteen own ones."""
