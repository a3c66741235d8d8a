"""Conversion of a scene to a MuJoCo model."""

from itertools import chain, product

import mujoco
import numpy as np
from numpy.typing import NDArray

from gauge_envs.backends.mujoco.contacts import contact_constants
from gauge_envs.backends.mujoco.deformables import (
    Geoms,
    add_deformables,
    add_flex_contact,
)
from gauge_envs.backends.mujoco.flex import STIFF_SOLIMP, FlexPart
from gauge_envs.backends.mujoco.options import set_option
from gauge_envs.backends.mujoco.settings import SettingsMuJoCo
from gauge_envs.errors import ParameterError
from gauge_envs.scene import (
    Box,
    Capsule,
    Compound,
    Contact,
    ConvexUnion,
    Cylinder,
    Ellipsoid,
    Hinge,
    Motion,
    RigidBody,
    Scene,
    Shape,
    Sphere,
    Tether,
)
from gauge_envs.scene.meshes import body_mass_properties, prism

START_KEY = "start"
"""Name of the keyframe whose `qvel` holds the start velocities; a scene at rest has no keyframe."""

EXPLICIT_PAIR_LIMIT = 1000
"""Largest number of explicit geom pairs of a contact; contacts with more use MuJoCo's broad phase."""

ROUND = {
    Cylinder: mujoco.mjtGeom.mjGEOM_CYLINDER,
    Capsule: mujoco.mjtGeom.mjGEOM_CAPSULE,
}
"""MuJoCo's types of shapes with an axis."""


def add_geoms(
    spec: mujoco.MjSpec,
    body: mujoco.MjsBody,
    name: str,
    shape: Shape | Capsule | Ellipsoid,
) -> list[mujoco.MjsGeom]:
    """Add a shape to a body as geoms without contacts; a concave solid becomes one mesh per convex piece."""
    geoms = []
    if isinstance(shape, Compound):
        for number, part in enumerate(shape.parts):
            for geom in add_geoms(spec, body, f"{name}/{number}", part.shape):
                geom.pos, geom.quat = part.pose.position_m, part.pose.quaternion
                geoms.append(geom)
    elif isinstance(shape, ConvexUnion):
        for index, piece in enumerate(shape.pieces_m):
            # The volume integral gives the exact inertia of a convex piece.
            points = np.asarray(piece)
            mesh = spec.add_mesh(name=f"{name}/{index}", uservert=points.ravel())
            mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_EXACT
            geoms.append(
                body.add_geom(
                    type=mujoco.mjtGeom.mjGEOM_MESH,
                    meshname=mesh.name,
                    name=f"{name}/{index}",
                )
            )
    else:
        kind, size = _primitive(shape)
        geoms.append(body.add_geom(type=kind, size=size, name=name))
    for geom in geoms:
        geom.contype = 0
        geom.conaffinity = 0
    return geoms


def _primitive(
    shape: Shape | Capsule | Ellipsoid,
) -> tuple[mujoco.mjtGeom, list[float]]:
    """Return MuJoCo's type and size of a simple shape."""
    if isinstance(shape, Box):
        return mujoco.mjtGeom.mjGEOM_BOX, [0.5 * edge for edge in shape.size_m]
    if isinstance(shape, Sphere):
        return mujoco.mjtGeom.mjGEOM_SPHERE, [shape.radius_m, 0.0, 0.0]
    if isinstance(shape, Cylinder | Capsule):
        return ROUND[type(shape)], [shape.radius_m, 0.5 * shape.length_m, 0.0]
    if isinstance(shape, Ellipsoid):
        return mujoco.mjtGeom.mjGEOM_ELLIPSOID, list(shape.radii_m)
    return mujoco.mjtGeom.mjGEOM_PLANE, [0.0, 0.0, 0.05]


def build_model(
    scene: Scene, settings: SettingsMuJoCo
) -> tuple[mujoco.MjSpec, mujoco.MjModel, dict[str, FlexPart]]:
    """Compile a scene.

    Bodies keep their names; a dynamic or driven body has a hinge or a free joint of the same name. A driven body is a
    free body of very large mass without weight, whose pose and velocity are written before each interval. Unlike a
    mocap body it has a velocity, so it moves the bodies that rest on it.

    Returns:
        The editable model, the compiled model, and the parts of the deformable bodies by name.
    """
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    _set_options(spec, settings)
    spec.option.gravity = [0.0, 0.0, -scene.gravity_m_per_s2]

    geoms = {}
    for body in scene.bodies:
        geoms[body.name] = _add_body(spec, body, scene.hinges.get(body.name), settings)
    for joint in scene.joints:
        if isinstance(joint, Tether):
            _add_tether(spec, joint, settings)
    parts = add_deformables(spec, scene, settings)
    for index, contact in enumerate(scene.contacts):
        if parts.keys() & {*contact.first, *contact.second}:
            add_flex_contact(scene, contact, parts, geoms, settings, bit=1 << index)
        else:
            _add_contact(spec, scene, contact, geoms, settings, bit=1 << index)
    key = None
    if not all(body.starts_at_rest for body in scene.dynamic_bodies):
        key = spec.add_key(name=START_KEY)
    model = _compiled(spec)
    if key is not None:
        # The compiled model defines the order of the velocities.
        model.key_qvel[0] = key.qvel = start_velocities(scene, model)
    for part in dict.fromkeys(parts.values()):
        part.complete(model)
    if settings.inverse_weight_scale != 1.0:
        dynamic = [model.body(body.name).id for body in scene.dynamic_bodies]
        model.body_invweight0[dynamic] *= settings.inverse_weight_scale
    return spec, model, parts


def _compiled(spec: mujoco.MjSpec) -> mujoco.MjModel:
    try:
        return spec.compile()
    except ValueError as error:
        reason = str(error).removeprefix("Error: ")
        raise ParameterError(
            f"MuJoCo cannot build the scene with these settings: {reason}"
        ) from error


def start_velocities(scene: Scene, model: mujoco.MjModel) -> NDArray[np.float64]:
    """Return the velocities of a model's joints at the start of a scene, shape [nv].

    A free joint has the linear velocity of the body origin in the world frame [m/s] and the angular velocity in the
    body frame [rad/s].
    """
    velocities = np.zeros(model.nv)
    for body in scene.dynamic_bodies:
        angular = np.array(body.angular_velocity_rad_per_s)
        first = int(model.joint(body.name).dofadr[0])
        if body.name in scene.hinges:
            velocities[first] = angular @ scene.hinges[body.name].axis
        else:
            velocities[first : first + 3] = body.linear_velocity_m_per_s
            velocities[first + 3 : first + 6] = angular @ body.pose.matrix
    return velocities


def _set_options(spec: mujoco.MjSpec, settings: SettingsMuJoCo) -> None:
    for name, value in settings:
        set_option(spec.option, name, value)


def _collision_shape(body: RigidBody) -> Shape:
    """Return the collision shape; a fixed or driven cylinder becomes a prism.

    MuJoCo finds two or three contact points between a cylinder's flat face and a box. Their positions make friction
    5 % wrong; between polyhedra the error is 0.03 %.
    """
    if not isinstance(body.shape, Cylinder) or body.motion is Motion.DYNAMIC:
        return body.shape
    return prism(body.shape)


def _add_body(
    spec: mujoco.MjSpec,
    body: RigidBody,
    hinge: Hinge | None,
    settings: SettingsMuJoCo,
) -> list[mujoco.MjsGeom]:
    frame = spec.worldbody.add_body(
        name=body.name, pos=body.pose.position_m, quat=body.pose.quaternion
    )
    geoms = add_geoms(spec, frame, body.name, _collision_shape(body))
    if body.motion is Motion.FIXED:
        return geoms
    if hinge is not None:
        frame.add_joint(
            type=mujoco.mjtJoint.mjJNT_HINGE,
            name=body.name,
            pos=body.pose.to_body(hinge.anchor_m),
            axis=hinge.axis @ body.pose.matrix,
        )
    else:
        frame.add_freejoint(name=body.name)
    if body.motion is Motion.KINEMATIC:
        frame.gravcomp = 1.0
        frame.explicitinertial = True
        frame.mass = settings.kinematic_mass_kg
        frame.ipos = [0.0, 0.0, 0.0]
        frame.inertia = [settings.kinematic_mass_kg] * 3
        return geoms
    volumes = _volumes_m3(body.shape)
    for geom, volume in zip(geoms, volumes, strict=True):
        geom.mass = body.mass_kg * volume / sum(volumes)
    if body.inertia_kg_m2 is not None:
        frame.explicitinertial = True
        frame.mass = body.mass_kg
        frame.ipos = body_mass_properties(body)[0]
        frame.inertia = [body.inertia_kg_m2] * 3
    return geoms


def _volumes_m3(shape: Shape | Capsule | Ellipsoid) -> list[float]:
    """Return the volume of each geom of a shape [m^3]."""
    if isinstance(shape, Compound):
        volumes = [_volumes_m3(part.shape) for part in shape.parts]
        return [*chain.from_iterable(volumes)]
    if isinstance(shape, ConvexUnion):
        return [ConvexUnion(pieces_m=(piece,)).volume_m3 for piece in shape.pieces_m]
    return [shape.volume_m3]


def _add_tether(spec: mujoco.MjSpec, tether: Tether, settings: SettingsMuJoCo) -> None:
    name = f"{tether.body}/tether"
    spec.worldbody.add_site(name=f"{name}/anchor", pos=tether.anchor_m)
    spec.body(tether.body).add_site(name=f"{name}/end")
    tendon = spec.add_tendon(name=name, limited=True, range=[0.0, tether.length_m])
    # Twice the time step is the stiffest stable limit.
    tendon.solref_limit = [max(2.0 * settings.timestep_s, 1e-3), 1.0]
    tendon.solimp_limit = STIFF_SOLIMP
    tendon.wrap_site(f"{name}/anchor")
    tendon.wrap_site(f"{name}/end")


def _add_contact(
    spec: mujoco.MjSpec,
    scene: Scene,
    contact: Contact,
    geoms: Geoms,
    settings: SettingsMuJoCo,
    *,
    bit: int,
) -> None:
    constants = contact_constants(contact, settings)
    pairs = list(scene.colliding_pairs(contact))
    # One contact bit is equivalent to all pairs, except for `solreffriction`, which geoms do not have.
    if (
        set(contact.first) == set(contact.second)
        and len(pairs) > EXPLICIT_PAIR_LIMIT
        and not any(constants.solreffriction)
    ):
        for name in contact.first:
            for geom in geoms[name]:
                geom.contype |= bit
                geom.conaffinity |= bit
                constants.put_on_geom(geom)
        return
    for first, second in pairs:
        for first_geom, second_geom in product(geoms[first], geoms[second]):
            constants.put_on_pair(
                spec.add_pair(geomname1=first_geom.name, geomname2=second_geom.name)
            )
