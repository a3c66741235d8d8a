"""Conversion of a scene to a PhysX scene: bodies, shapes and joints; and the one engine of a process."""

from __future__ import annotations

import gc
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from weakref import WeakSet

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from gauge_envs.backends.physx.contacts import Constants, Groups, groups_of_bodies
from gauge_envs.backends.physx.settings import SettingsPhysX
from gauge_envs.backends.settings import check_kept, put
from gauge_envs.backends.shared.joints import (
    drive_of,
    has_terms,
    joint_rate_rad_per_s,
    linked_hinges,
    stops_rad,
)
from gauge_envs.backends.shared.rigid import (
    centre_velocity,
    guide_frame,
    hinge_frame,
    world_hinges,
)
from gauge_envs.errors import BackendError, UnsupportedSceneError
from gauge_envs.scene import (
    BallJoint,
    BodyHinge,
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
    Slider,
    Sphere,
    Tether,
)
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.hinged import other_end
from gauge_envs.scene.meshes import body_mass_properties, prism

with warnings.catch_warnings():
    # SAPIEN warns that no Vulkan driver is installed. Only its renderer needs one, which this package never starts.
    warnings.simplefilter("ignore")
    from sapien import physx, pysapien

LARGEST_TORQUE_N_M = 3.4e38
"""Largest torque of drives without a limit, in single precision."""

ROOT_MASS_KG = 1.0
"""Mass of the fixed base of a hinge, which has no effect."""

PRISM_SHARE = 0.995
"""Radius of the prism in a cylinder that rolls on a capsule, over the cylinder's radius. An edge that comes down at
angular speed w stays off the ground if (w h)^2 / 2 is less than the rest: up to 180 rad/s with a step of 1/1800 s. A
cylinder as long as its diameter leans on one point, and yaws into the edges if they are closer than 0.3 %."""

HULL_SIZE_M = 10.0
"""Edges of the box in which PhysX makes the mesh of a convex piece; the mesh is then scaled to the piece. In metres,
PhysX leaves out vertices within 0.7 mm of a plane of others."""

LOST_M = 2e-4
"""Largest distance of a vertex from PhysX's mesh [m]: a fifth of the scatter of real starts. PhysX cuts off corners of
pieces with tens of vertices by up to 0.2 mm; those of the experiments keep theirs."""

ROUNDING_M = 1e-9
"""Half length below which the straight part of a capsule is empty [m]."""

AXIS_Z = [0.5**0.5, 0.0, -(0.5**0.5), 0.0]
"""Quaternion w, x, y, z that turns PhysX's capsules, whose axis is x, to the z axis of cylinders."""

PLANE_TURN = Rotation.from_euler("y", -90, degrees=True)
"""Rotation of the z axis of this package's planes onto the x axis of PhysX's."""


def physx_version() -> str:
    """Return the version of the PhysX that SAPIEN contains."""
    return str(physx.version())


class EngineLease:
    """A claim on the engine of the process, whose tolerances are fixed while a simulation exists.

    Args:
        settings: Settings with the tolerances.

    Raises:
        BackendError: Another simulation exists that needs other tolerances.
    """

    def __init__(self, settings: SettingsPhysX) -> None:
        self.tolerances = (
            settings.tolerance_length_m,
            settings.tolerance_speed_m_per_s,
        )
        if any(lease.tolerances != self.tolerances for lease in _LEASES):
            # A cycle of references may still hold a simulation that nothing uses.
            gc.collect()
        for lease in _LEASES:
            if lease.tolerances != self.tolerances:
                raise BackendError(
                    "PhysX has one engine per process, and a simulation with tolerances of "
                    f"{lease.tolerances} (m, m/s) exists. A simulation with {self.tolerances} cannot start beside it. "
                    "Close the other one first, set tolerance_length_m and tolerance_speed_m_per_s to the same values, "
                    "or use another process."
                )
        self._engine = physx.PhysxEngine(*self.tolerances)
        _LEASES.add(self)


_LEASES: WeakSet[EngineLease] = WeakSet()


def new_system(
    settings: SettingsPhysX, gravity_m_per_s2: float
) -> physx.PhysxCpuSystem:
    """Return an empty PhysX scene. The defaults of other users of SAPIEN in this process do not change."""
    before = physx.get_scene_config()
    asked = {
        "bounce_threshold": settings.bounce_threshold_m_per_s,
        "enable_pcm": settings.persistent_manifolds,
        "enable_tgs": settings.solver == "TGS",
        "enable_ccd": settings.continuous_detection,
        "enable_enhanced_determinism": settings.enhanced_determinism,
        "enable_friction_every_iteration": settings.friction_every_iteration,
    }
    physx.set_scene_config(
        gravity=[0.0, 0.0, -gravity_m_per_s2], cpu_workers=0, **asked
    )
    try:
        system = physx.PhysxCpuSystem()
    finally:
        physx.set_scene_config(before)
    check_kept("PhysX", asked, system.config)
    put("PhysX", system, timestep=settings.timestep_s)
    return system


@dataclass(frozen=True, eq=False)
class Part:
    """A body in PhysX.

    Attributes:
        component: SAPIEN's component; its pose is that of the body frame.
        centre_m: Centre of mass in the body frame [m], shape [3].
    """

    component: physx.PhysxRigidBaseComponent
    centre_m: FloatArray


@dataclass(frozen=True, eq=False)
class Model:
    """A scene in PhysX.

    Attributes:
        lease: Claim on the engine.
        system: PhysX's scene.
        world: SAPIEN's scene, which keeps all bodies alive.
        parts: Bodies by name.
        rows: Link and place in its articulation of each joint with friction or a motor, by name of its body.
    """

    lease: EngineLease
    system: physx.PhysxCpuSystem
    world: pysapien.Scene
    parts: dict[str, Part]
    rows: dict[str, tuple[physx.PhysxArticulationLinkComponent, int]]


def physx_pose(pose: Pose) -> pysapien.Pose:
    """Return a pose in SAPIEN's type, in single precision."""
    return pysapien.Pose(pose.position_m, pose.quaternion)


def build_model(scene: Scene, settings: SettingsPhysX) -> Model:
    """Build a scene at its start."""
    lease = EngineLease(settings)
    system = new_system(settings, scene.gravity_m_per_s2)
    world = pysapien.Scene([system])
    groups = groups_of_bodies(
        scene, sustained_restitution=settings.sustained_restitution
    )
    materials = {
        c: physx.PhysxMaterial(c.friction, c.friction, c.restitution)
        for each in groups.values()
        for c in each
    }
    hinges = world_hinges(scene)
    linked = linked_hinges(scene, settings.hinges == "articulation")
    below = [name for name, joined in linked.items() if isinstance(joined, BodyHinge)]
    sliders = {one.body: one for one in scene.guides if isinstance(one, Slider)}
    joined = {**linked, **sliders}
    parts: dict[str, Part] = {}
    for body in (
        *(one for one in scene.bodies if one.name not in below),
        *map(scene.body, below),
    ):
        hinge = hinges.get(body.name)
        component = (
            _link(world, scene, body, joined[body.name], parts)
            if body.name in joined
            else _component(body)
        )
        for shape in _shapes(body.shape, groups.get(body.name, {}), materials):
            put(
                "PhysX",
                shape,
                contact_offset=settings.contact_offset_m,
                rest_offset=settings.rest_offset_m,
            )
            put(
                "PhysX",
                shape,
                patch_radius=settings.patch_radius_m,
                min_patch_radius=settings.min_patch_radius_m,
            )
            component.attach(shape)
        centre_m, inertia = body_mass_properties(body)
        parts[body.name] = Part(component, centre_m)
        if body.motion is not Motion.FIXED:
            _set_mass(component, body.mass_kg, centre_m, inertia)
            _set_limits(component, settings)
        _add(
            world,
            component,
            _turned(body.pose) if isinstance(body.shape, Plane) else body.pose,
        )
        if isinstance(component, physx.PhysxArticulationLinkComponent):
            _set_solver(component.articulation, settings)
        elif hinge is not None:
            _add_hinge(component, body, hinge)
        if body.motion is Motion.DYNAMIC and not body.starts_at_rest:
            _set_velocity(component, scene, body, centre_m, joined.get(body.name))
    return Model(lease, system, world, parts, _add_joints(scene, parts, linked))


def _add_joints(
    scene: Scene,
    parts: Mapping[str, Part],
    linked: Mapping[str, Hinge | BodyHinge | None],
) -> dict[str, tuple[physx.PhysxArticulationLinkComponent, int]]:
    """Add strings, hinges that are constraints, and the drives of links; return `Model.rows`."""
    for joint in scene.joints:
        if isinstance(joint, Tether):
            _add_tether(parts[joint.body].component, joint)
    for guide in scene.guides:
        if isinstance(guide, BallJoint):
            body, component = scene.body(guide.body), parts[guide.body].component
            frame = guide_frame(scene, guide)
            joint = _point_joint(component, frame, frame.relative_to(body.pose))
            component.entity.add_component(joint)
    for joined in scene.body_hinges:
        if joined not in linked.values():
            _add_body_hinge(parts, scene, joined)
    rows = {}
    for name, hinge in linked.items():
        if hinge is not None and has_terms(hinge):
            link, terms = parts[name].component, hinge.dynamics
            rows[name] = link, row_of(link)
            link.joint.armature = np.array([terms.armature_kg_m2])
            kp, kv, limit = drive_of(hinge)
            if not kp and not kv:
                kv = terms.viscous_friction_n_m_s_per_rad
            link.joint.set_drive_properties(kp, kv, min(limit, LARGEST_TORQUE_N_M))
    return rows


def row_of(link: physx.PhysxArticulationLinkComponent) -> int:
    """Return the place of a link's joint among those of its articulation."""
    return [joint.child_link for joint in link.articulation.active_joints].index(link)


def _turned(pose: Pose) -> Pose:
    return Pose.from_rotation(pose.position_m, pose.rotation * PLANE_TURN)


def _add(
    world: pysapien.Scene, component: physx.PhysxRigidBaseComponent, pose: Pose
) -> None:
    entity = pysapien.Entity()
    entity.add_component(component)
    entity.set_pose(physx_pose(pose))
    world.add_entity(entity)


def _component(body: RigidBody) -> physx.PhysxRigidBaseComponent:
    """Return a static, dynamic or driven body without shapes."""
    if body.motion is Motion.FIXED:
        return physx.PhysxRigidStaticComponent()
    component = physx.PhysxRigidDynamicComponent()
    component.kinematic = body.motion is Motion.KINEMATIC
    return component


def _link(
    world: pysapien.Scene,
    scene: Scene,
    body: RigidBody,
    hinge: Hinge | BodyHinge | Slider | None,
    parts: Mapping[str, Part],
) -> physx.PhysxArticulationLinkComponent:
    """Return a link without shapes, which a joint connects to a fixed base or to its parent, unless it is a root."""
    if hinge is None:
        return physx.PhysxArticulationLinkComponent()
    if isinstance(hinge, Slider):
        frame = guide_frame(scene, hinge)
        limits = hinge.limits_m or (-np.inf, np.inf)
    else:
        frame = hinge_frame(hinge)
        limits = stops_rad(hinge)
    in_parent = pysapien.Pose()
    if isinstance(hinge, BodyHinge):
        parent = other_end(hinge, body.name)
        base, in_parent = (
            parts[parent].component,
            physx_pose(frame.relative_to(scene.body(parent).pose)),
        )
    else:
        base = physx.PhysxArticulationLinkComponent()
        base.mass, base.inertia = ROOT_MASS_KG, np.ones(3)
        _add(world, base, frame)
    link = physx.PhysxArticulationLinkComponent(base)
    if not isinstance(hinge, BodyHinge):
        base.joint.type = "fixed"
    is_slider = isinstance(hinge, Slider)
    link.joint.type = "prismatic" if is_slider else "revolute_unwrapped"
    link.joint.pose_in_parent = in_parent
    link.joint.pose_in_child = physx_pose(frame.relative_to(body.pose))
    link.joint.limit = np.array([limits])
    link.joint.friction = 0.0
    link.joint.set_drive_properties(0.0, 0.0)
    return link


def _shapes(
    shape: Shape,
    groups: dict[Constants, Groups],
    materials: dict[Constants, physx.PhysxMaterial],
) -> Iterator[physx.PhysxCollisionShape]:
    """Yield the copies of a shape, one for each pair of contact constants."""
    for constants, group in groups.items():
        for copy in _solids(shape, materials[constants]):
            copy.set_collision_groups(group.words)
            yield copy


def _solids(
    shape: Shape | Capsule, material: physx.PhysxMaterial
) -> Iterator[physx.PhysxCollisionShape]:
    if isinstance(shape, Compound):
        yield from _parts(shape, material)
    elif isinstance(shape, Capsule):
        yield _capsule(shape.radius_m, 0.5 * shape.length_m, material)
    elif isinstance(shape, Box):
        yield physx.PhysxCollisionShapeBox(
            half_size=0.5 * np.asarray(shape.size_m), material=material
        )
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
        assert not isinstance(part.shape, Ellipsoid), "declined by unsupported_features"
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

    A prism alone brakes with each side on which it comes down: on 20 degrees it lacks 5 % of the law's acceleration. A
    cylinder that is shorter than its diameter has no room for a ball, and is a prism.
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


def _set_mass(
    component: physx.PhysxRigidBodyComponent,
    mass_kg: float,
    centre_m: ArrayLike,
    inertia_kg_m2: FloatArray,
) -> None:
    """Write mass, centre of mass and inertia, which PhysX takes along principal axes."""
    moments, axes = np.linalg.eigh(inertia_kg_m2)
    if np.count_nonzero(inertia_kg_m2 - np.diag(np.diagonal(inertia_kg_m2))) == 0:
        moments, axes = np.diagonal(inertia_kg_m2), np.eye(3)
    elif np.linalg.det(axes) < 0.0:
        axes[:, 2] *= -1.0
    x, y, z, w = Rotation.from_matrix(axes).as_quat()
    component.mass = mass_kg
    component.inertia = moments
    component.cmass_local_pose = pysapien.Pose(centre_m, [w, x, y, z])


def _set_limits(
    component: physx.PhysxRigidBodyComponent, settings: SettingsPhysX
) -> None:
    is_link = isinstance(component, physx.PhysxArticulationLinkComponent)
    component.linear_damping = (
        settings.linear_damping_per_s + is_link * settings.link_linear_damping_per_s
    )
    put(
        "PhysX",
        component,
        angular_damping=settings.angular_damping_per_s,
        max_linear_velocity=settings.max_linear_velocity_m_per_s,
        max_angular_velocity=settings.max_angular_velocity_rad_per_s,
        max_depenetration_velocity=settings.max_depenetration_velocity_m_per_s,
    )
    if isinstance(component, physx.PhysxRigidDynamicComponent):
        _set_solver(component, settings)


def _set_solver(
    place: physx.PhysxRigidDynamicComponent | physx.PhysxArticulation,
    settings: SettingsPhysX,
) -> None:
    put(
        "PhysX",
        place,
        solver_position_iterations=settings.position_iterations,
        solver_velocity_iterations=settings.velocity_iterations,
        sleep_threshold=settings.sleep_threshold_m2_per_s2,
    )


def _add_hinge(
    component: physx.PhysxRigidDynamicComponent, body: RigidBody, hinge: Hinge
) -> None:
    """Connect a body to the world with a constraint that leaves one rotation free."""
    frame = hinge_frame(hinge)
    joint = _point_joint(component, frame, frame.relative_to(body.pose))
    joint.set_limit_pyramid(0.0, 0.0, 0.0, 0.0)
    component.entity.add_component(joint)


def _add_body_hinge(parts: Mapping[str, Part], scene: Scene, hinge: BodyHinge) -> None:
    """Connect two bodies at two points of the axis, since PhysX leaves the swing of such a joint free."""
    first, second = scene.body(hinge.first), scene.body(hinge.second)
    component = parts[second.name].component
    reach_m = 0.5 * float(np.linalg.norm(second.shape.corners_m, axis=1).max())
    for side in (-reach_m, reach_m):
        frame = hinge_frame(hinge, side)
        joint = _point_joint(
            component, frame.relative_to(first.pose), frame.relative_to(second.pose)
        )
        joint.parent = parts[first.name].component
        component.entity.add_component(joint)


def _point_joint(
    component: physx.PhysxRigidBodyComponent, in_parent: Pose, in_child: Pose
) -> physx.PhysxDriveComponent:
    """Return a joint of a body, to the world by default, that keeps the origins of two frames together."""
    joint = physx.PhysxDriveComponent(component)
    joint.pose_in_parent, joint.pose_in_child = (
        physx_pose(in_parent),
        physx_pose(in_child),
    )
    joint.set_limit_x(0.0, 0.0)
    joint.set_limit_y(0.0, 0.0)
    joint.set_limit_z(0.0, 0.0)
    return joint


def _add_tether(component: physx.PhysxRigidBodyComponent, tether: Tether) -> None:
    joint = physx.PhysxDistanceJointComponent(component)
    joint.pose_in_parent = pysapien.Pose(tether.anchor_m)
    joint.pose_in_child = pysapien.Pose()
    joint.set_limit(0.0, tether.length_m)
    component.entity.add_component(joint)


def _set_velocity(
    component: physx.PhysxRigidBodyComponent,
    scene: Scene,
    body: RigidBody,
    centre_m: ArrayLike,
    hinge: Hinge | BodyHinge | Slider | None,
) -> None:
    """Write the start velocity; PhysX's linear velocity is that of the centre of mass."""
    angular = np.array(body.angular_velocity_rad_per_s)
    if hinge is not None:
        rates = component.articulation.qvel
        rates[row_of(component)] = (
            np.dot(body.linear_velocity_m_per_s, hinge.axis)
            if isinstance(hinge, Slider)
            else joint_rate_rad_per_s(scene, body.name, hinge)
        )
        component.articulation.set_qvel(rates)
    elif isinstance(component, physx.PhysxArticulationLinkComponent):
        component.articulation.root_angular_velocity = angular
        component.articulation.root_linear_velocity = centre_velocity(body, centre_m)
    else:
        component.angular_velocity = angular
        component.linear_velocity = centre_velocity(body, centre_m)
