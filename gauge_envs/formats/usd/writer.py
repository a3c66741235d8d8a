"""Writer of scenes as USD layers: standard UsdPhysics attributes and exact `gauge:` doubles.

UsdPhysics has single precision, one material per body instead of constants per pair, and no deformable bodies yet. The
layer therefore also contains every number of the scene as a custom double under its name in `gauge_envs.scene`
(`gauge:mass_kg`), and the pairs in `/World/Contacts`. Deformable bodies have the attributes of the proposed schema
under Omniverse's names (`omniphysics:`).

A number that is stored twice can be edited in either place. The custom data of the double contains the written value of
the standard attribute, from which the reader detects the edited value. Some derived attributes cannot be
inverted, such as the mesh of a cloth. They contain their written value and the names of the attributes to edit instead.
"""

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
from pxr import Gf, Sdf, Tf, Usd, UsdGeom, UsdPhysics, UsdShade

from gauge_envs.errors import ParameterError, ResultFileError
from gauge_envs.formats import USD_SUFFIXES
from gauge_envs.formats.usd.deformable_writer import write_attachment, write_deformable
from gauge_envs.formats.usd.layer import (
    AIR_KINDS,
    ARMS,
    MARKER_INDICES,
    TEXT,
    VELOCITIES,
    WRITTEN,
    as_array,
    body_velocities,
    digest,
    hinge_axis,
    hinge_frame,
    motions_digest,
    samples_digest,
)
from gauge_envs.formats.usd.target import Target, write, write_extent, write_friction
from gauge_envs.scene import (
    Box,
    Compound,
    Contact,
    ConvexUnion,
    Cylinder,
    Hinge,
    Markers,
    Motion,
    RigidBody,
    Scene,
    Shape,
    Sphere,
    Tether,
)
from gauge_envs.scene.drivers import Driver
from gauge_envs.scene.geometry import FloatArray, vector
from gauge_envs.scene.meshes import hull_faces
from gauge_envs.scene.timing import FRAME_RATE_HZ

PLANE_EXTENT_M = 2.0
"""Edge length of the visible square of a plane [m]; the collider is infinite."""

MARKER_WIDTH_M = 0.005
"""Visible width of markers [m]."""


def to_usd(scene: Scene, path: str | Path) -> None:
    """Write a scene as a self-contained USD layer.

    Args:
        scene: A scene with unique body names and at most one driver per body.
        path: File to write; its suffix determines the format, text (`.usda`) or binary (`.usdc`, `.usd`).

    Raises:
        ParameterError: The suffix is unknown, or a body is a compound.
        ResultFileError: The file cannot be written.
    """
    if Path(path).suffix not in USD_SUFFIXES:
        raise ParameterError(f"{path}: a USD layer ends in {', '.join(USD_SUFFIXES)}")
    stage = scene_stage(scene)
    try:
        stage.GetRootLayer().Export(str(path))
    except Tf.ErrorException as error:
        raise ResultFileError(f"{path}: cannot be written: {error}") from error


def scene_stage(scene: Scene, *, samples_per_frame: int = 1) -> Usd.Stage:
    """Return a scene as a USD stage in memory.

    Args:
        scene: A scene with unique body names and at most one driver per body.
        samples_per_frame: Time samples of driven bodies per 30 Hz frame.
    """
    stage = Usd.Stage.CreateInMemory("scene.usda")
    target = Target(stage, scene)
    last_frame = round(scene.duration_s * FRAME_RATE_HZ)
    _write_physics(target, last_frame)
    for index, contact in enumerate(scene.contacts):
        _write_contact(target, index, contact)
    for body in scene.bodies:
        _write_body(target, body)
    sample_count = last_frame * samples_per_frame + 1
    codes = np.arange(sample_count) / samples_per_frame
    times_s = np.arange(sample_count) / (FRAME_RATE_HZ * samples_per_frame)
    for index, driver in enumerate(scene.drivers):
        _write_driver(target, index, driver, codes, times_s)
    for deformable in scene.deformables:
        write_deformable(target, deformable)
    _filter_pairs(target)
    for index, joint in enumerate(scene.joints):
        _write_joint(target, f"{target.group('Joints')}/joint_{index}", joint)
    for index, attachment in enumerate(scene.attachments):
        write_attachment(target, index, attachment)
    if scene.markers is not None:
        _write_markers(target, scene.markers)
    return stage


def _write_physics(target: Target, last_frame: int) -> None:
    """Write the units and rates of the stage, and the scene prim with gravity, air and duration."""
    stage, scene = target.stage, target.scene
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdPhysics.SetStageKilogramsPerUnit(stage, 1.0)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    stage.SetTimeCodesPerSecond(FRAME_RATE_HZ)
    stage.SetFramesPerSecond(FRAME_RATE_HZ)
    stage.SetStartTimeCode(0)
    stage.SetEndTimeCode(last_frame)
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/World").GetPrim())
    physics = UsdPhysics.Scene.Define(stage, "/World/PhysicsScene")
    physics.CreateGravityDirectionAttr((0.0, 0.0, -1.0))
    gravity = scene.gravity_m_per_s2
    magnitude = physics.CreateGravityMagnitudeAttr(gravity).Get()
    write(physics, "gauge:gravity_m_per_s2", gravity, written=magnitude)
    for name, value in (asdict(scene.air) if scene.air else {}).items():
        write(physics, f"gauge:air:{name}", value, AIR_KINDS.get(name, "double"))
    frames_s = last_frame / FRAME_RATE_HZ
    write(physics, "gauge:duration_s", scene.duration_s, written=frames_s)


# --- contacts --------------------------------------------------------------------------------------------------------


def _write_contact(target: Target, index: int, contact: Contact) -> None:
    """Write the exact contact below `/World/Contacts`, and a material with its constants."""
    path = f"{target.group('Contacts')}/contact_{index}"
    prim = UsdGeom.Scope.Define(target.stage, path).GetPrim()
    target.relate(prim, "gauge:first", contact.first)
    target.relate(prim, "gauge:second", contact.second)
    material = UsdShade.Material.Define(
        target.stage, f"{target.group('Materials')}/contact_{index}"
    )
    constants = write_friction(material.GetPrim(), contact)
    for name, single in (
        ("friction", constants.GetDynamicFrictionAttr().Get()),
        ("restitution", constants.GetRestitutionAttr().Get()),
    ):
        write(prim, f"gauge:{name}", getattr(contact, name), written=single)
    for name in ARMS:
        if arm_m := getattr(contact, name):
            write(prim, f"gauge:{name}", arm_m)
    write(prim, "gauge:mode", contact.mode.value, "token")
    deformable = [
        target.material_path(body.name)
        for body in target.scene.deformables
        if target.first_contact(body.name) == index
    ]
    materials = prim.CreateRelationship("gauge:materials", custom=True)
    materials.SetTargets([material.GetPath(), *deformable])


def _filter_pairs(target: Target) -> None:
    """Filter all pairs without a contact, since UsdPhysics lets all collide."""
    scene = target.scene
    allowed = {
        frozenset(pair)
        for contact in scene.contacts
        for pair in scene.colliding_pairs(contact)
    }
    moving = {body.name for body in (*scene.dynamic_bodies, *scene.deformables)}
    colliding = [name for name in target.paths if name in target.collides]
    for index, name in enumerate(colliding):
        filtered = [
            target.paths[partner]
            for partner in colliding[index + 1 :]
            if moving & {name, partner} and frozenset((name, partner)) not in allowed
        ]
        if filtered:
            prim = target.stage.GetPrimAtPath(target.paths[name])
            api = UsdPhysics.FilteredPairsAPI.Apply(prim)
            api.CreateFilteredPairsRel().SetTargets(filtered)


# --- rigid bodies ----------------------------------------------------------------------------------------------------


def _write_body(target: Target, body: RigidBody) -> None:
    xform = UsdGeom.Xform.Define(target.stage, target.paths[body.name])
    prim = xform.GetPrim()
    target.place(xform, body.name, body.pose)
    motion = body.motion.value
    write(prim, "gauge:motion", motion, "token", written=motion)
    single = None
    if body.motion is not Motion.FIXED:
        rigid = UsdPhysics.RigidBodyAPI.Apply(prim)
        rigid.CreateKinematicEnabledAttr(body.motion is Motion.KINEMATIC)
        mass = UsdPhysics.MassAPI.Apply(prim)
        single = mass.CreateMassAttr(body.mass_kg).Get()
        if body.inertia_kg_m2 is not None:
            write(prim, "gauge:inertia_kg_m2", body.inertia_kg_m2)
            mass.CreateDiagonalInertiaAttr((body.inertia_kg_m2,) * 3)
        if not body.starts_at_rest:
            _write_velocities(rigid, body)
    write(prim, "gauge:mass_kg", body.mass_kg, written=single)
    for geometry in _write_geometry(target, prim.GetPath(), body.shape):
        collision = UsdPhysics.CollisionAPI.Apply(geometry.GetPrim())
        collision.CreateCollisionEnabledAttr(body.name in target.collides)
    if (index := target.first_contact(body.name)) is not None:
        target.bind(body.name, f"/World/Materials/contact_{index}")


def _write_velocities(rigid: UsdPhysics.RigidBodyAPI, body: RigidBody) -> None:
    exact = np.array([getattr(body, name) for name in VELOCITIES])
    linear, angular = body_velocities(body.pose, body.shape, exact)
    written = digest(
        [
            rigid.CreateVelocityAttr(vector(linear)).Get(),
            rigid.CreateAngularVelocityAttr(vector(angular)).Get(),
        ]
    )
    for name in VELOCITIES:
        value = getattr(body, name)
        write(rigid, f"gauge:{name}", value, "double3", written=written)


def _write_geometry(
    target: Target, parent: Sdf.Path, shape: Shape
) -> list[UsdGeom.Gprim]:
    path = parent.AppendChild("collision")
    if isinstance(shape, Compound):
        raise ParameterError(
            f"{parent.name!r} is a compound of solids, which USD layers of this suite do not have"
        )
    if isinstance(shape, ConvexUnion):
        return [
            _write_piece(target, f"{path}_{index}", np.array(piece))
            for index, piece in enumerate(shape.pieces_m)
        ]
    if isinstance(shape, Box):
        geometry = UsdGeom.Cube.Define(target.stage, path)
        geometry.CreateSizeAttr(1.0)
        geometry.AddScaleOp(UsdGeom.XformOp.PrecisionDouble).Set(shape.size_m)
    elif isinstance(shape, Sphere):
        geometry = UsdGeom.Sphere.Define(target.stage, path)
        geometry.CreateRadiusAttr(shape.radius_m)
    elif isinstance(shape, Cylinder):
        geometry = UsdGeom.Cylinder.Define(target.stage, path)
        geometry.CreateAxisAttr(UsdGeom.Tokens.z)
        geometry.CreateRadiusAttr(shape.radius_m)
        geometry.CreateHeightAttr(shape.length_m)
    else:
        geometry = UsdGeom.Plane.Define(target.stage, path)
        geometry.CreateAxisAttr(UsdGeom.Tokens.z)
        geometry.CreateWidthAttr(PLANE_EXTENT_M)
        geometry.CreateLengthAttr(PLANE_EXTENT_M)
    write_extent(geometry)
    return [geometry]


def _write_piece(target: Target, path: str, points_m: FloatArray) -> UsdGeom.Mesh:
    faces = hull_faces(points_m)
    mesh = UsdGeom.Mesh.Define(target.stage, path)
    written = digest(mesh.CreatePointsAttr(points_m).Get())
    mesh.CreateFaceVertexCountsAttr([len(face) for face in faces])
    mesh.CreateFaceVertexIndicesAttr([index for face in faces for index in face])
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    write_extent(mesh)
    write(mesh, "gauge:points_m", points_m, "double3[]", written=written)
    collision = UsdPhysics.MeshCollisionAPI.Apply(mesh.GetPrim())
    collision.CreateApproximationAttr(UsdPhysics.Tokens.convexHull)
    return mesh


def _write_driver(
    target: Target, index: int, driver: Driver, codes: FloatArray, times_s: FloatArray
) -> None:
    """Write the exact motion and its time samples; a constant position or rotation has a single value."""
    start = target.scene.body(driver.body).pose
    prim = target.stage.GetPrimAtPath(target.paths[driver.body])
    translate, orient = UsdGeom.Xform(prim).GetOrderedXformOps()
    poses = driver.path(start, times_s)[:, :7]
    positions, quaternions = poses[:, :3], poses[:, 3:]
    motions = [asdict(motion) for motion in driver.motions]
    text = json.dumps({"index": index, "motions": motions}, allow_nan=False)
    attribute = write(prim, "gauge:driver", text, "string")
    attribute.SetCustomDataByKey(TEXT, motions_digest(text))
    write(prim, "gauge:driver_provenance", driver.provenance, "string")
    translates = (positions != start.position_m).any()
    rotates = (quaternions != start.quaternion).any()
    if translates or rotates:
        attribute.SetCustomDataByKey(WRITTEN, samples_digest(times_s, poses))
    last = np.asarray(start.quaternion)
    for code, position, quaternion in zip(
        codes.tolist(), positions.tolist(), quaternions, strict=True
    ):
        if translates:
            translate.Set(Gf.Vec3d(position), code)
        # Take the closer of the two quaternions of a rotation, so that interpolation takes the short path.
        last = quaternion if last @ quaternion >= 0.0 else -quaternion
        if rotates:
            orient.Set(Gf.Quatd(*last.tolist()), code)


# --- joints and markers ----------------------------------------------------------------------------------------------


def _write_joint(target: Target, path: str, scene_joint: Hinge | Tether) -> None:
    """Write a joint of a body and the world; a joint without a first body connects to the world."""
    pose = target.scene.body(scene_joint.body).pose
    local_m = (0.0, 0.0, 0.0)
    joint: UsdPhysics.Joint
    if isinstance(scene_joint, Hinge):
        joint = UsdPhysics.RevoluteJoint.Define(target.stage, path)
        joint.CreateAxisAttr(UsdPhysics.Tokens.x)
        rotation = hinge_frame(scene_joint.axis)
        inverse = Gf.Quatd(*pose.quaternion).GetInverse()
        world = joint.CreateLocalRot0Attr(rotation).Get()
        local = joint.CreateLocalRot1Attr(Gf.Quatf(inverse * Gf.Quatd(rotation)))
        local.SetCustomDataByKey(WRITTEN, local.Get())
        written = digest(hinge_axis(as_array(world)))
        write(joint, "gauge:axis", scene_joint.axis, "double3", written=written)
        local_m = vector(pose.to_body(np.asarray(scene_joint.anchor_m)))
    else:
        joint = UsdPhysics.DistanceJoint.Define(target.stage, path)
        longest = joint.CreateMaxDistanceAttr(scene_joint.length_m).Get()
        write(joint, "gauge:length_m", scene_joint.length_m, written=longest)
    joint.CreateBody1Rel().SetTargets([target.paths[scene_joint.body]])
    world = joint.CreateLocalPos0Attr(scene_joint.anchor_m).Get()
    local = joint.CreateLocalPos1Attr(local_m)
    local.SetCustomDataByKey(WRITTEN, local.Get())
    write(joint, "gauge:anchor_m", scene_joint.anchor_m, "double3", written=world)


def _write_markers(target: Target, markers: Markers) -> None:
    count = len(markers.positions_m)
    points = UsdGeom.Points.Define(target.stage, "/World/Markers")
    written = digest(points.CreatePointsAttr(markers.positions_m).Get())
    points.CreateIdsAttr(list(range(count)))
    points.CreatePurposeAttr(UsdGeom.Tokens.guide)
    points.CreateWidthsAttr([MARKER_WIDTH_M] * count)
    write_extent(points)
    prim = points.GetPrim()
    target.relate(prim, "gauge:bodies", markers.bodies)
    write(prim, "gauge:positions_m", markers.positions_m, "double3[]", written=written)
    for name, (_, *width) in MARKER_INDICES.items():
        kind = f"int{width[0] if width else ''}[]"
        write(prim, f"gauge:{name}", list(getattr(markers, name)), kind)
