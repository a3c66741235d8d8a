"""Conversion of a scene to a PhysX scene: bodies, shapes and joints; and the one engine of a process."""

from __future__ import annotations

import gc
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from weakref import WeakValueDictionary

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from gauge_envs.backends.physx.contacts import groups_of_bodies
from gauge_envs.backends.physx.settings import SettingsPhysX
from gauge_envs.backends.shared.rigid import (
    centre_velocity,
    hinge_frame,
    principal_axes,
)
from gauge_envs.errors import BackendError, UnsupportedSceneError
from gauge_envs.scene import (
    Box,
    Capsule,
    Compound,
    ConvexUnion,
    Cylinder,
    Ellipsoid,
    Hinge,
    Motion,
    Plane,
    Pose,
    RigidBody,
    Scene,
    Shape,
    Sphere,
    Tether,
)
from gauge_envs.scene.geometry import FloatArray, vector
from gauge_envs.scene.meshes import body_mass_properties, prism

with warnings.catch_warnings():
    # SAPIEN warns that no Vulkan driver is installed. Only its renderer needs one, which this package never starts.
    warnings.simplefilter("ignore")
    from sapien import physx, pysapien

ROOT_MASS_KG = 1.0
"""Mass of the fixed base of a hinge, which has no effect."""

HINGE_SPAN_M = 1.0
"""Distance [m] of the two points that hold a hinge; so far apart, the second one hardly bears the weight of a body."""

PRISM_SHARE = 0.995
"""Radius of the prism in a cylinder that rolls on a capsule, over the cylinder's radius. An edge that comes down at
angular speed w stays off the ground if (w h)^2 / 2 is less than the rest: up to 180 rad/s with a step of 1/1800 s. A
cylinder as long as its diameter leans on one point, and yaws into the edges if they are closer than 0.3 %."""

HULL_SIZE_M = 10.0
"""Edges of the box in which PhysX makes the mesh of a convex piece; the mesh is then scaled to the piece. In metres,
PhysX leaves out vertices within 0.7 mm of a plane through other vertices."""

LOST_M = 2e-4
"""Largest distance of a vertex from PhysX's mesh [m]: a fifth of the scatter of real initial states. PhysX cuts off
corners of pieces with tens of vertices by up to 0.2 mm. The pieces of the experiments keep their corners."""

ROUNDING_M = 1e-9
"""Half length below which the straight part of a capsule is empty [m]."""

AXIS_Z = [0.5**0.5, 0.0, -(0.5**0.5), 0.0]
"""Quaternion w, x, y, z that turns PhysX's capsules, whose axis is x, to the z axis of cylinders."""

PLANE_TURN = Rotation.from_euler("y", -90, degrees=True)
"""Rotation of the z axis of this package's planes onto the x axis of PhysX's."""


def physx_version() -> str:
    """Return the version of the PhysX that SAPIEN contains."""
    return str(physx.version())


_ENGINES: WeakValueDictionary[tuple[float, float], physx.PhysxEngine] = (
    WeakValueDictionary()
)
"""The engine of the process while a simulation exists, by its tolerances of length [m] and speed [m/s]."""


def engine_of(settings: SettingsPhysX) -> physx.PhysxEngine:
    """Return the engine of the process, whose tolerances are fixed while a simulation exists.

    Raises:
        BackendError: A simulation exists that needs other tolerances.
    """
    asked = (settings.tolerance_length_m, settings.tolerance_speed_m_per_s)
    if asked in _ENGINES:
        return _ENGINES[asked]
    if _ENGINES:
        # A cycle of references may still keep an unused simulation.
        gc.collect()
    for tolerances in list(_ENGINES):
        raise BackendError(
            f"PhysX has one engine per process, and a simulation with tolerances of {tolerances} (m, m/s) exists. A "
            f"simulation with {asked} cannot start at the same time. Close the other simulation first, set "
            "tolerance_length_m and tolerance_speed_m_per_s to the same values, or use another process."
        )
    engine = physx.PhysxEngine(*asked)
    _ENGINES[asked] = engine
    return engine


def new_system(
    settings: SettingsPhysX, gravity_m_per_s2: float
) -> physx.PhysxCpuSystem:
    """Return an empty PhysX scene, without changing SAPIEN's defaults for other code in this process."""
    before = physx.get_scene_config()
    physx.set_scene_config(
        gravity=[0.0, 0.0, -gravity_m_per_s2],
        cpu_workers=0,
        bounce_threshold=settings.bounce_threshold_m_per_s,
        enable_pcm=settings.persistent_manifolds,
        enable_tgs=settings.solver == "TGS",
        enable_ccd=settings.continuous_detection,
        enable_enhanced_determinism=settings.enhanced_determinism,
        enable_friction_every_iteration=settings.friction_every_iteration,
    )
    try:
        system = physx.PhysxCpuSystem()
    finally:
        physx.set_scene_config(before)
    system.timestep = settings.timestep_s
    return system


@dataclass(frozen=True, eq=False)
class BodyPhysX:
    """A body in PhysX.

    Attributes:
        component: SAPIEN's component; its pose is the pose of the body frame.
        centre_m: Centre of mass in the body frame [m], shape [3].
    """

    component: physx.PhysxRigidBaseComponent
    centre_m: FloatArray


def physx_pose(pose: Pose) -> pysapien.Pose:
    """Return a pose in SAPIEN's type, in single precision."""
    return pysapien.Pose(pose.position_m, pose.quaternion)


class ModelPhysX:
    """A scene in PhysX.

    Args:
        scene: The scene.
        bodies: Its rigid bodies in their initial states.
        settings: Numerical settings.

    Attributes:
        system: PhysX's scene.
        parts: Bodies by name.
    """

    def __init__(
        self, scene: Scene, bodies: Sequence[RigidBody], settings: SettingsPhysX
    ) -> None:
        self._settings = settings
        self._engine = engine_of(settings)
        self.system = new_system(settings, scene.gravity_m_per_s2)
        # SAPIEN's scene keeps all bodies alive.
        self._world = pysapien.Scene([self.system])
        self._groups = groups_of_bodies(
            scene, sustained_restitution=settings.sustained_restitution
        )
        self.parts = {
            body.name: self._add_body(body, scene.hinges.get(body.name))
            for body in bodies
        }
        for joint in scene.joints:
            if isinstance(joint, Tether):
                _add_tether(self.parts[joint.body].component, joint)

    def _add_body(self, body: RigidBody, hinge: Hinge | None) -> BodyPhysX:
        is_link = self._settings.hinges == "articulation"
        component = _component(body)
        if hinge is not None and is_link:
            component = self._link(body, hinge)
        self._attach_shapes(component, body)
        centre_m, inertia_kg_m2 = body_mass_properties(body)
        if body.motion is not Motion.FIXED:
            moments, axes = principal_axes(inertia_kg_m2)
            quaternion = Rotation.from_matrix(axes).as_quat(scalar_first=True)
            component.mass = body.mass_kg
            component.inertia = moments
            component.cmass_local_pose = pysapien.Pose(centre_m, quaternion)
            self._set_limits(component)
        pose = body.pose
        if isinstance(body.shape, Plane):
            pose = Pose.from_rotation(pose.position_m, pose.rotation * PLANE_TURN)
        self._add(component, pose)
        spin = np.array(body.angular_velocity_rad_per_s)
        if hinge is not None and is_link:
            self._set_solver(component.articulation)
            component.articulation.set_qvel(np.array([spin @ hinge.axis]))
        elif body.motion is Motion.DYNAMIC:
            component.angular_velocity = spin
            # PhysX's linear velocity refers to the centre of mass.
            component.linear_velocity = centre_velocity(body, centre_m)
            if hinge is not None:
                _add_hinge(component, body, hinge)
        return BodyPhysX(component, centre_m)

    def _add(self, component: physx.PhysxRigidBaseComponent, pose: Pose) -> None:
        entity = pysapien.Entity()
        entity.add_component(component)
        entity.set_pose(physx_pose(pose))
        self._world.add_entity(entity)

    def _link(
        self, body: RigidBody, hinge: Hinge
    ) -> physx.PhysxArticulationLinkComponent:
        """Return a link without shapes, which a joint connects to a fixed base."""
        frame = hinge_frame(hinge)
        base = physx.PhysxArticulationLinkComponent()
        base.mass = ROOT_MASS_KG
        base.inertia = np.ones(3)
        self._add(base, frame)
        link = physx.PhysxArticulationLinkComponent(base)
        base.joint.type = "fixed"
        link.joint.type = "revolute_unwrapped"
        link.joint.pose_in_parent = pysapien.Pose()
        link.joint.pose_in_child = physx_pose(frame.relative_to(body.pose))
        link.joint.limit = np.array([[-np.inf, np.inf]])
        link.joint.friction = 0.0
        link.joint.set_drive_properties(0.0, 0.0)
        return link

    def _attach_shapes(
        self, component: physx.PhysxRigidBaseComponent, body: RigidBody
    ) -> None:
        """Attach a copy of the shape of a body for each pair of its contact constants."""
        settings = self._settings
        for (friction, restitution), words in self._groups[body.name].items():
            material = physx.PhysxMaterial(friction, friction, restitution)
            for shape in _solids(body.shape, material):
                shape.set_collision_groups(words)
                shape.contact_offset = settings.contact_offset_m
                shape.rest_offset = settings.rest_offset_m
                shape.patch_radius = settings.patch_radius_m
                shape.min_patch_radius = settings.min_patch_radius_m
                component.attach(shape)

    def _set_limits(self, component: physx.PhysxRigidBodyComponent) -> None:
        settings = self._settings
        component.linear_damping = settings.linear_damping_per_s
        component.angular_damping = settings.angular_damping_per_s
        component.max_linear_velocity = settings.max_linear_velocity_m_per_s
        component.max_angular_velocity = settings.max_angular_velocity_rad_per_s
        component.max_depenetration_velocity = (
            settings.max_depenetration_velocity_m_per_s
        )
        if isinstance(component, physx.PhysxArticulationLinkComponent):
            component.linear_damping += settings.link_linear_damping_per_s
        else:
            self._set_solver(component)

    def _set_solver(
        self, place: physx.PhysxRigidDynamicComponent | physx.PhysxArticulation
    ) -> None:
        place.solver_position_iterations = self._settings.position_iterations
        place.solver_velocity_iterations = self._settings.velocity_iterations
        place.sleep_threshold = self._settings.sleep_threshold_m2_per_s2


def _component(body: RigidBody) -> physx.PhysxRigidBaseComponent:
    """Return a static, dynamic or driven body without shapes."""
    if body.motion is Motion.FIXED:
        return physx.PhysxRigidStaticComponent()
    component = physx.PhysxRigidDynamicComponent()
    component.kinematic = body.motion is Motion.KINEMATIC
    return component


def _add_hinge(
    component: physx.PhysxRigidDynamicComponent, body: RigidBody, hinge: Hinge
) -> None:
    """Connect a body to the world at two points of the axis, which leave one rotation free.

    SAPIEN stores limits of swing angles, but leaves these angles free.
    """
    frame = hinge_frame(hinge)
    for x_m in (0.0, HINGE_SPAN_M):
        point_m = vector(np.add(hinge.anchor_m, np.multiply(x_m, hinge.axis)))
        point = replace(frame, position_m=point_m)
        joint = physx.PhysxDriveComponent(component)
        joint.pose_in_parent = physx_pose(point)
        joint.pose_in_child = physx_pose(point.relative_to(body.pose))
        if not x_m:
            joint.set_limit_x(0.0, 0.0)
        joint.set_limit_y(0.0, 0.0)
        joint.set_limit_z(0.0, 0.0)
        component.entity.add_component(joint)


def _add_tether(component: physx.PhysxRigidBodyComponent, tether: Tether) -> None:
    joint = physx.PhysxDistanceJointComponent(component)
    joint.pose_in_parent = pysapien.Pose(tether.anchor_m)
    joint.pose_in_child = pysapien.Pose()
    joint.set_limit(0.0, tether.length_m)
    component.entity.add_component(joint)


def _solids(
    shape: Shape | Capsule, material: physx.PhysxMaterial
) -> Iterator[physx.PhysxCollisionShape]:
    """Yield the solids of a shape."""
    if isinstance(shape, Compound):
        yield from _parts(shape, material)
    elif isinstance(shape, Capsule):
        yield _capsule(shape.radius_m, 0.5 * shape.length_m, material)
    elif isinstance(shape, Box):
        half_m = 0.5 * np.asarray(shape.size_m)
        yield physx.PhysxCollisionShapeBox(half_size=half_m, material=material)
    elif isinstance(shape, Sphere):
        yield physx.PhysxCollisionShapeSphere(radius=shape.radius_m, material=material)
    elif isinstance(shape, Plane):
        yield physx.PhysxCollisionShapePlane(material=material)
    elif isinstance(shape, ConvexUnion):
        for piece in shape.pieces_m:
            yield _hull(piece, material)
    elif isinstance(shape, Cylinder):
        yield from _cylinder(shape, material)


def _parts(
    compound: Compound, material: physx.PhysxMaterial
) -> Iterator[physx.PhysxCollisionShape]:
    for part in compound.parts:
        assert not isinstance(part.shape, Ellipsoid), "ellipsoids are unsupported"
        for solid in _solids(part.shape, material):
            solid.local_pose = physx_pose(part.pose) * solid.local_pose
            yield solid


def _capsule(
    radius_m: float, half_m: float, material: physx.PhysxMaterial
) -> physx.PhysxCollisionShape:
    """Return a capsule along z."""
    capsule = physx.PhysxCollisionShapeCapsule(
        radius=radius_m, half_length=half_m, material=material
    )
    capsule.local_pose = pysapien.Pose(q=AXIS_Z)
    return capsule


def _hull(
    points_m: ArrayLike, material: physx.PhysxMaterial
) -> physx.PhysxCollisionShape:
    """Return a convex mesh."""
    corners = np.asarray(points_m, dtype=np.float64)
    scale = np.ptp(corners, axis=0) / HULL_SIZE_M
    vertices = (corners / scale).astype(np.float32)
    shape = physx.PhysxCollisionShapeConvexMesh(
        vertices=vertices, scale=scale, material=material
    )
    planes = ConvexHull(shape.vertices * scale).equations
    lost_m = float((corners @ planes[:, :3].T + planes[:, 3]).max())
    if lost_m > LOST_M:
        raise UnsupportedSceneError(
            f"PhysX simplifies a convex piece of {len(corners)} vertices: the mesh that it makes leaves out "
            f"{1e3 * lost_m:.3g} mm. Divide the piece, or leave out close vertices"
        )
    return shape


def _cylinder(
    shape: Cylinder, material: physx.PhysxMaterial
) -> Iterator[physx.PhysxCollisionShape]:
    """Yield the parts of a cylinder: a prism with its end faces, and a capsule or ball inside, on which it rolls.

    A prism alone brakes at each side that hits the ground: on 20 degrees it lacks 5 % of the theoretical acceleration.
    A cylinder that is shorter than its diameter has no room for a ball, and is a prism.
    """
    straight_m = 0.5 * shape.length_m - shape.radius_m
    if straight_m < -ROUNDING_M:
        yield _hull(prism(shape).pieces_m[0], material)
        return
    # The edges of the prism must not touch before the round part does.
    narrow = Cylinder(radius_m=PRISM_SHARE * shape.radius_m, length_m=shape.length_m)
    yield _hull(prism(narrow).pieces_m[0], material)
    if straight_m > ROUNDING_M:
        yield _capsule(shape.radius_m, straight_m, material)
    else:
        yield physx.PhysxCollisionShapeSphere(radius=shape.radius_m, material=material)
