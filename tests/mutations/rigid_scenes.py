"""Faults of a backend that builds rigid bodies, joints or contacts other than those of the scene."""

from dataclasses import replace

import numpy as np

from gauge_envs.scene import (
    Box,
    Contact,
    ContactMode,
    ConvexUnion,
    Cylinder,
    Motion,
    Plane,
    Pose,
    Sphere,
)
from gauge_envs.scene.geometry import vector
from gauge_envs.scene.meshes import mass_properties
from mutations.mutant import Passed, fault
from mutations.scenes import (
    change_bodies,
    change_contacts,
    change_shapes,
)


def _gravity(change):
    return lambda scene: replace(scene, gravity_m_per_s2=change(scene.gravity_m_per_s2))


MARGIN_M = 1e-3


def _margin(one):
    """Return a fixed or driven body whose surface is 1 mm further out."""
    if one.motion is Motion.DYNAMIC:
        return one
    if isinstance(one.shape, Plane):
        normal = one.pose.rotation.apply([0.0, 0.0, MARGIN_M])
        return replace(
            one, pose=replace(one.pose, position_m=vector(one.pose.position_m + normal))
        )
    return replace(one, shape=_grown(one.shape, MARGIN_M))


def _grown(shape, margin_m):
    """Return a shape whose faces are further out; a convex union keeps its lower and lateral faces."""
    if isinstance(shape, Box):
        x, y, z = (size + 2.0 * margin_m for size in shape.size_m)
        return Box(size_m=(x, y, z))
    if isinstance(shape, Sphere):
        return Sphere(radius_m=shape.radius_m + margin_m)
    if isinstance(shape, Cylinder):
        return Cylinder(
            radius_m=shape.radius_m + margin_m, length_m=shape.length_m + 2.0 * margin_m
        )
    if isinstance(shape, ConvexUnion):
        top = shape.corners_m[:, 2].max()
        return ConvexUnion(
            pieces_m=tuple(
                tuple(
                    (x, y, z + margin_m if z > top - 1e-9 else z) for x, y, z in piece
                )
                for piece in shape.pieces_m
            )
        )
    return shape


def _level(one):
    if not isinstance(one.shape, Plane):
        return one
    return replace(one, pose=Pose(position_m=one.pose.position_m))


def _plane_at_origin(one):
    if not isinstance(one.shape, Plane):
        return one
    return replace(one, pose=replace(one.pose, position_m=(0.0, 0.0, 0.0)))


def _half_as_long(shape):
    if not isinstance(shape, Cylinder):
        return shape
    return replace(shape, length_m=0.5 * shape.length_m)


def _hull(shape):
    if not isinstance(shape, ConvexUnion):
        return shape
    return ConvexUnion(pieces_m=(tuple(vector(corner) for corner in shape.corners_m),))


SLOW_LIMIT_M_PER_S = 0.6


def _first_piece(shape):
    return (
        ConvexUnion(pieces_m=shape.pieces_m[:1])
        if isinstance(shape, ConvexUnion)
        else shape
    )


def _no_slow_rebound(scene):
    if scene.speed_limit_m_per_s > SLOW_LIMIT_M_PER_S:
        return scene
    return change_contacts(restitution=lambda e: 0.0)(scene)


def _all_collide(scene):
    listed = {
        frozenset(pair)
        for contact in scene.contacts
        for pair in scene.colliding_pairs(contact)
    }
    names = [one.name for one in scene.bodies]
    more = [
        Contact(first=(first,), second=(second,), friction=0.5, restitution=0.0)
        for index, first in enumerate(names)
        for second in names[:index]
        if frozenset((first, second)) not in listed
    ]
    return replace(scene, contacts=(*scene.contacts, *more))


def _one_friction(scene):
    if not scene.contacts:
        return scene
    return change_contacts(friction=lambda mu: scene.contacts[-1].friction)(scene)


def _per_point(scene):
    boxes = {one.name for one in scene.dynamic_bodies if isinstance(one.shape, Box)}
    contacts = (
        replace(one, restitution=0.5 * one.restitution)
        if boxes.intersection((*one.first, *one.second))
        else one
        for one in scene.contacts
    )
    return replace(scene, contacts=tuple(contacts))


def _one_restitution(scene):
    largest = max(
        (one.restitution for one in scene.contacts if one.mode is ContactMode.IMPACT),
        default=0.0,
    )
    return change_contacts(restitution=lambda e: largest)(scene)


def _always_impact(scene):
    return replace(
        scene,
        contacts=tuple(replace(one, mode=ContactMode.IMPACT) for one in scene.contacts),
    )


def _random_friction(scene):
    return change_contacts(
        friction=lambda mu: mu * float(1.0 + 1e-9 * np.random.default_rng().random())
    )(scene)


def _loose(one):
    if one.motion is not Motion.FIXED or isinstance(one.shape, Plane):
        return one
    return replace(one, motion=Motion.DYNAMIC)


def _nothing_fixed(scene):
    return scene if scene.deformables else change_bodies(_loose)(scene)


def _scalar_read_last(one):
    x, y, z, w = one.pose.quaternion
    return replace(one, pose=replace(one.pose, quaternion=(w, x, y, z)))


def _thrown(change):
    """Return a change of the bodies that do not start at rest."""
    changed = change_bodies(lambda one: one if one.starts_at_rest else change(one))
    # Another start of one body opens a hinge between two.
    return lambda scene: scene if scene.body_hinges else changed(scene)


def _velocity_of_centre(one):
    """Give the centre of mass the velocity that the scene states for the origin."""
    arm = one.pose.rotation.apply(mass_properties(one.shape, one.mass_kg)[0])
    linear = np.subtract(
        one.linear_velocity_m_per_s, np.cross(one.angular_velocity_rad_per_s, arm)
    )
    return replace(one, linear_velocity_m_per_s=vector(linear))


def _spin_turned(one):
    return replace(
        one,
        angular_velocity_rad_per_s=vector(
            one.pose.rotation.apply(one.angular_velocity_rad_per_s)
        ),
    )


class _WithoutCylinder(Passed):
    """Reports a body that it has left out as if it stood still."""

    def body_states(self, names):
        states = np.zeros((len(names), 13))
        for row, name in zip(states, names, strict=True):
            pose = self.scene.body(name).pose
            row[:7] = [*pose.position_m, *pose.quaternion]
            if name != "cylinder":
                row[:] = super().body_states([name])[0]
        return states


class _AsIs(Passed):
    """Reports fixed bodies where the engine has them."""

    def body_states(self, names):
        return np.array(self.inner.body_states(names))


def _without_products(scene):
    """Return the scene with the diagonals of stated tensors."""
    bodies = [
        replace(one, inertia_kg_m2=(*one.inertia_kg_m2[:3], 0.0, 0.0, 0.0))
        if isinstance(one.inertia_kg_m2, tuple)
        else one
        for one in scene.bodies
    ]
    return replace(scene, bodies=tuple(bodies))


FAULTS = dict(
    (
        fault(
            "tensor-diagonal",
            "products of inertia are left out",
            "stated-tensor",
            "the products of inertia are left out",
            scene=_without_products,
        ),
        fault(
            "margin",
            "collision margin of 1 mm left in",
            "contact-listed",
            "margin",
            scene=change_bodies(_margin),
        ),
        fault(
            "cylinder-support",
            "fixed cylinder with half the length",
            "rest-box",
            "on each support that is wrong: cylinder",
            scene=change_shapes(_half_as_long, Motion.FIXED),
        ),
        fault(
            "plane-level",
            "leaning plane taken as level",
            "roll-ball",
            "leaning plane is level",
            scene=change_bodies(_level),
        ),
        fault(
            "slow-restitution",
            "restitution off below 0.2 m/s",
            "rebound-slow",
            "threshold speed",
            scene=_no_slow_rebound,
        ),
        fault(
            "gravity-upward",
            "gravity upward",
            "free-fall",
            "-1 times the gravity",
            scene=_gravity(lambda g: -g),
        ),
        fault(
            "gravity-own",
            "gravity of the engine",
            "gravity-of-scene",
            "gravity of the scene",
            scene=_gravity(lambda g: 9.81),
        ),
        fault(
            "friction-of-another-pair",
            "friction of the last pair for all pairs",
            "slide-of-pair",
            "own friction",
            scene=_one_friction,
        ),
        fault(
            "friction-mean",
            "friction by the mean instead of the product",
            "slide",
            "how the friction of two surfaces is combined",
            scene=change_contacts(friction=lambda mu: 0.5 * (mu + 1.0)),
        ),
        fault(
            "friction-low",
            "friction 20 % low",
            "slide",
            "friction were 0.24",
            scene=change_contacts(friction=lambda mu: 0.8 * mu),
        ),
        fault(
            "restitution-shared",
            "largest restitution for all pairs",
            "rebound-of-pair",
            "its own restitution",
            scene=_one_restitution,
        ),
        fault(
            "restitution-per-point",
            "half the restitution where a box touches with several points",
            "rebound-flat",
            "number of contact points",
            scene=_per_point,
        ),
        fault(
            "restitution-sustained",
            "restitution of sustained pairs",
            "rebound-sustained",
            "no effect on a pair of the mode SUSTAINED",
            scene=lambda scene: (
                _always_impact(scene)
                if any(one.restitution for one in scene.contacts)
                else scene
            ),
        ),
        fault(
            "union-hull",
            "convex hull of a union",
            "inertia-union",
            "the convex hull of all pieces",
            scene=change_shapes(_hull),
        ),
        fault(
            "union-first-piece",
            "first piece of a union only",
            "inertia-union",
            "the first of its pieces",
            scene=change_shapes(_first_piece),
        ),
        fault(
            "plane-origin",
            "plane through the world origin",
            "rest-box",
            "on each support that is wrong: plane",
            scene=change_bodies(_plane_at_origin),
        ),
        fault(
            "random",
            "random numbers without a seed",
            "determinism",
            "random numbers",
            scene=_random_friction,
        ),
        fault(
            "first-contact",
            "first contact of a scene only",
            "slide",
            "has no contact",
            scene=lambda scene: replace(scene, contacts=scene.contacts[:1]),
        ),
        fault(
            "friction-product",
            "friction of both bodies multiplied",
            "slide",
            "its square",
            scene=change_contacts(friction=lambda mu: mu**2),
        ),
        fault(
            "friction-holds",
            "friction that holds everything",
            "slide",
            "friction were",
            scene=change_contacts(friction=lambda mu: 5.0),
        ),
        fault(
            "gravity-twice",
            "gravity twice",
            "free-fall",
            "2 times the gravity",
            scene=_gravity(lambda g: 2.0 * g),
        ),
        fault(
            "quaternion-inside",
            "quaternion w, x, y, z read as x, y, z, w",
            "start-orientation",
            "scalar first",
            scene=change_bodies(_scalar_read_last),
        ),
        fault(
            "start-velocity-millimetres",
            "start velocity in mm/s",
            "start-velocity",
            "in mm/s",
            scene=_thrown(
                lambda one: replace(
                    one,
                    linear_velocity_m_per_s=vector(
                        1e-3 * np.asarray(one.linear_velocity_m_per_s)
                    ),
                )
            ),
        ),
        fault(
            "start-spin-frame",
            "start spin in the body frame",
            "start-spin",
            "in the body frame",
            scene=_thrown(_spin_turned),
        ),
        fault(
            "start-velocity-centre",
            "start velocity of the centre of mass",
            "start-velocity-of-origin",
            "to the centre of mass",
            scene=_thrown(_velocity_of_centre),
        ),
        fault(
            "cylinder-left-out",
            "a body left out",
            "all-bodies-move",
            "the cylinder fell 0 m",
            scene=lambda scene: replace(
                scene,
                bodies=tuple(one for one in scene.bodies if one.name != "cylinder"),
            ),
            simulation=_WithoutCylinder,
        ),
        fault(
            "all-collide",
            "all bodies collide",
            "contact-unlisted",
            "collision filter",
            scene=_all_collide,
        ),
        fault(
            "nothing-fixed",
            "fixed bodies move",
            "fixed-body-stays",
            "must be static",
            scene=_nothing_fixed,
            simulation=_AsIs,
        ),
        fault(
            "mass-in-grams",
            "masses rounded to grams",
            "masses",
            "rounds or limits masses",
            scene=change_bodies(
                lambda one: replace(one, mass_kg=max(round(one.mass_kg, 3), 1e-3))
            ),
        ),
    )
)
"""Faults by id."""
