"""Writer of scenes as USD layers: standard UsdPhysics attributes with exact `gauge:` doubles beside them.

UsdPhysics has single precision, one material per body instead of constants per pair, and no deformable bodies yet. The
layer therefore also contains every number of the scene as a custom double under its name in `gauge_envs.scene`
(`gauge:mass_kg`), and the pairs in `/World/Contacts`. Deformable bodies have the attributes of the proposed schema
under Omniverse's names (`omniphysics:`).

A number that is stored twice can be edited in either place. The custom data of the double contains the written value of
the standard attribute, from which the reader detects the edited one. A derived attribute that cannot be inverted, such
as the mesh of a cloth, contains its written value and the names of the attributes to edit instead.
"""

from dataclasses import asdict
from itertools import combinations
from pathlib import Path

import numpy as np
from pxr import Gf, Sdf, Tf, Usd, UsdGeom, UsdPhysics, UsdShade, Vt

from gauge_envs.errors import ParameterError, ResultFileError
from gauge_envs.scene.bodies import (
    Contact,
    Hinge,
    Markers,
    Motion,
    RigidBody,
    Rod,
    Rope,
    Tether,
)
from gauge_envs.scene.drivers import Driver
from gauge_envs.scene.geometry import (
    Box,
    Compound,
    ConvexUnion,
    Cylinder,
    FloatArray,
    Shape,
    Sphere,
    vector,
)
from gauge_envs.scene.meshes import hull_faces
from gauge_envs.scene.scene import Scene
from gauge_envs.scene.timing import FRAME_RATE_HZ
from gauge_envs.tools.usd.deformable_writer import DeformableWriter, material_path
from gauge_envs.tools.usd.layer import (
    AIR_KINDS,
    ARMS,
    MARKER_INDICES,
    TEXT,
    digest,
    hinge_axis,
    hinge_frame,
    motions_digest,
    motions_to_json,
    names_digest,
    record_written,
    samples_digest,
    wxyz,
)
from gauge_envs.tools.usd.target import (
    Target,
    quatd,
    single_points,
    write_extent,
    write_friction,
    write_gauge,
)
from gauge_envs.tools.usd.velocities import write_velocities

SUFFIXES = (".usda", ".usdc", ".usd")

PLANE_EXTENT_M = 2.0
"""Edge length of the visible square of a plane [m]; the collider is infinite."""

MARKER_WIDTH_M = 0.005
"""Visible width of markers [m]."""


def to_usd(scene: Scene, path: str | Path) -> None:
    """Write a scene as a self-contained USD layer.

    Args:
        scene: A scene with unique body names and at most one driver per body.
        path: File to write; its suffix determines the format, text (`.usda`) or binary (`.usdc`, `.usd`).
    """
    export_stage(scene_stage(scene), Path(path))


def export_stage(stage: Usd.Stage, path: Path) -> None:
    """Write the root layer of a stage to a file; errors as in `to_usd`."""
    if path.suffix not in SUFFIXES:
        raise ParameterError(f"{path}: a USD layer ends in {', '.join(SUFFIXES)}")
    try:
        stage.GetRootLayer().Export(str(path))
    except Tf.ErrorException as error:
        raise ResultFileError(f"{path}: cannot be written: {error}") from error


def scene_stage(
    scene: Scene, *, samples_per_frame: int = 1, later_frames: int = 0
) -> Usd.Stage:
    """Return a scene as a USD stage in memory.

    Args:
        scene: A scene with unique body names and at most one driver per body.
        samples_per_frame: Time samples of driven bodies per 30 Hz frame.
        later_frames: Frames after the last one for which driven bodies have time samples.
    """
    stage = Usd.Stage.CreateInMemory("scene.usda")
    _Writer(stage, scene, samples_per_frame, later_frames).write()
    return stage


class _Writer:
    """Writes one scene into an empty stage."""

    def __init__(
        self, stage: Usd.Stage, scene: Scene, samples_per_frame: int, later_frames: int
    ) -> None:
        self.stage = stage
        self.scene = scene
        self.target = Target(stage, scene)
        self.paths = self.target.paths
        self.soft = DeformableWriter(self.target)
        self.samples_per_frame = samples_per_frame
        self.later_frames = later_frames
        self.frame_count = round(scene.duration_s * FRAME_RATE_HZ) + 1

    def write(self) -> None:
        scene, physics = self.scene, self._physics()
        materials = [
            self._contact_material(index, contact)
            for index, contact in enumerate(scene.contacts)
        ]
        for body in scene.bodies:
            self._body(body)
            if (index := self.target.first_contact(body.name)) is not None:
                self.target.bind(self.paths[body.name], materials[index])
        for index, driver in enumerate(scene.drivers):
            self._drive(index, driver)
        for deformable in scene.deformables:
            self.soft.write(deformable)
        write_gauge(physics, "colliding_pairs", self._filtered_pairs(), "string")
        for index, joint in enumerate(scene.joints):
            self._joint(f"{self.target.group('Joints')}/joint_{index}", joint)
        for index, attachment in enumerate(scene.attachments):
            self.soft.attach(index, attachment)
        if scene.markers is not None:
            self._markers(scene.markers)

    # --- stage ---

    def _physics(self) -> UsdPhysics.Scene:
        """Write the units and rates of the stage, and the scene prim with gravity, air and duration."""
        UsdGeom.SetStageMetersPerUnit(self.stage, 1.0)
        UsdPhysics.SetStageKilogramsPerUnit(self.stage, 1.0)
        UsdGeom.SetStageUpAxis(self.stage, UsdGeom.Tokens.z)
        self.stage.SetTimeCodesPerSecond(FRAME_RATE_HZ)
        self.stage.SetFramesPerSecond(FRAME_RATE_HZ)
        self.stage.SetStartTimeCode(0)
        self.stage.SetEndTimeCode(self.frame_count - 1)
        self.stage.SetDefaultPrim(UsdGeom.Xform.Define(self.stage, "/World").GetPrim())
        physics = UsdPhysics.Scene.Define(self.stage, "/World/PhysicsScene")
        physics.CreateGravityDirectionAttr(Gf.Vec3f(0.0, 0.0, -1.0))
        magnitude = physics.CreateGravityMagnitudeAttr(self.scene.gravity_m_per_s2)
        write_gauge(
            physics,
            "gravity_m_per_s2",
            self.scene.gravity_m_per_s2,
            written=magnitude.Get(),
        )
        for name, value in (asdict(self.scene.air) if self.scene.air else {}).items():
            write_gauge(physics, f"air:{name}", value, AIR_KINDS.get(name, "double"))
        write_gauge(
            physics,
            "duration_s",
            self.scene.duration_s,
            written=(self.frame_count - 1) / FRAME_RATE_HZ,
        )
        return physics

    # --- contacts ---

    def _contact_material(self, index: int, contact: Contact) -> UsdShade.Material:
        """Write the exact contact below `/World/Contacts`, and return a material with its constants."""
        prim = UsdGeom.Scope.Define(
            self.stage, f"{self.target.group('Contacts')}/contact_{index}"
        ).GetPrim()
        for side, names in (("first", contact.first), ("second", contact.second)):
            prim.CreateRelationship(f"gauge:{side}", custom=True).SetTargets(
                [self.paths[name] for name in names]
            )
        friction = write_gauge(prim, "friction", contact.friction)
        restitution = write_gauge(prim, "restitution", contact.restitution)
        for name in ARMS:
            if arm := getattr(contact, name):
                write_gauge(prim, name, arm)
        write_gauge(prim, "mode", contact.mode.value, "token")
        material = UsdShade.Material.Define(
            self.stage, f"{self.target.group('Materials')}/contact_{index}"
        )
        constants = write_friction(material.GetPrim(), contact)
        record_written(friction, constants.GetDynamicFrictionAttr().Get())
        record_written(restitution, constants.GetRestitutionAttr().Get())
        deformable = [
            name
            for name in self.soft.deformables
            if self.target.first_contact(name) == index
        ]
        targets = [
            material.GetPath(),
            *(material_path(self.target, name) for name in deformable),
        ]
        prim.CreateRelationship("gauge:materials", custom=True).SetTargets(targets)
        return material

    def _filtered_pairs(self) -> str:
        """Filter all pairs without a contact, since UsdPhysics lets all collide; return a hash of the other pairs."""
        allowed = {
            frozenset((a, b))
            for contact in self.scene.contacts
            for a in contact.first
            for b in contact.second
        }
        moves = {body.name for body in self.scene.dynamic_bodies} | set(
            self.soft.deformables
        )
        filtered: dict[str, list[str]] = {}
        for one, other in combinations(
            [name for name in self.paths if name in self.target.collides], 2
        ):
            if frozenset((one, other)) not in allowed and (
                one in moves or other in moves
            ):
                filtered.setdefault(one, []).append(self.paths[other])
        for name, targets in filtered.items():
            pairs = UsdPhysics.FilteredPairsAPI.Apply(
                self.stage.GetPrimAtPath(self.paths[name])
            )
            pairs.CreateFilteredPairsRel().SetTargets(targets)
        lines = {
            body.name for body in self.scene.deformables if isinstance(body, Rope | Rod)
        }
        return names_digest(
            {
                pair
                for pair in allowed
                if len(pair) == 2 and pair & moves and not pair & lines
            }
        )

    # --- rigid bodies ---

    def _body(self, body: RigidBody) -> None:
        xform = UsdGeom.Xform.Define(self.stage, self.paths[body.name])
        prim = xform.GetPrim()
        self.target.place(xform, body.name, body.pose)
        write_gauge(
            prim, "motion", body.motion.value, "token", written=body.motion.value
        )
        mass = write_gauge(prim, "mass_kg", body.mass_kg)
        if body.motion is not Motion.FIXED:
            rigid = UsdPhysics.RigidBodyAPI.Apply(prim)
            rigid.CreateKinematicEnabledAttr(body.motion is Motion.KINEMATIC)
            api = UsdPhysics.MassAPI.Apply(prim)
            record_written(mass, api.CreateMassAttr(body.mass_kg).Get())
            if body.inertia_kg_m2 is not None:
                write_gauge(prim, "inertia_kg_m2", body.inertia_kg_m2)
                api.CreateDiagonalInertiaAttr(Gf.Vec3f(body.inertia_kg_m2))
            if not body.starts_at_rest:
                write_velocities(rigid, body)
        for geometry in self._geometry(prim.GetPath(), body.shape):
            collision = UsdPhysics.CollisionAPI.Apply(geometry.GetPrim())
            collision.CreateCollisionEnabledAttr(body.name in self.target.collides)

    def _drive(self, index: int, driver: Driver) -> None:
        """Write the exact motion and its time samples; a constant position or rotation has a single value."""
        body, xform = (
            self.scene.body(driver.body),
            UsdGeom.Xform(self.stage.GetPrimAtPath(self.paths[driver.body])),
        )
        translate, orient = xform.GetOrderedXformOps()
        sample_count = (
            self.frame_count - 1 + self.later_frames
        ) * self.samples_per_frame + 1
        codes = np.arange(sample_count) / self.samples_per_frame
        times_s = np.arange(sample_count) / (FRAME_RATE_HZ * self.samples_per_frame)
        poses = [driver.pose(body.pose, time_s) for time_s in times_s.tolist()]
        translates = any(pose.position_m != body.pose.position_m for pose in poses)
        rotates = any(pose.quaternion != body.pose.quaternion for pose in poses)
        if translates:
            for code, pose in zip(codes.tolist(), poses, strict=True):
                translate.Set(Gf.Vec3d(*pose.position_m), code)
        if rotates:
            last = np.asarray(body.pose.quaternion)
            for code, pose in zip(codes.tolist(), poses, strict=True):
                # Take the closer of the two quaternions of a rotation, so that interpolation takes the short path.
                last = np.asarray(pose.quaternion) * (
                    1.0 if last @ pose.quaternion >= 0.0 else -1.0
                )
                orient.Set(quatd(last.tolist()), code)
        write_gauge(xform, "driver_provenance", driver.provenance, "string")
        text = motions_to_json(driver.motions, index)
        attribute = write_gauge(xform, "driver", text, "string")
        attribute.SetCustomDataByKey(TEXT, motions_digest(text))
        if translates or rotates:
            positions = np.array([pose.position_m for pose in poses])
            quaternions = np.array([pose.quaternion for pose in poses])
            record_written(attribute, samples_digest(times_s, positions, quaternions))

    def _geometry(self, parent: Sdf.Path, shape: Shape) -> list[UsdGeom.Gprim]:
        path = parent.AppendChild("collision")
        if isinstance(shape, Compound):
            raise ParameterError(
                f"{parent.name!r} is a compound of solids, which USD layers of this suite do not have"
            )
        if isinstance(shape, ConvexUnion):
            return [
                self._piece(f"{path}_{index}", np.array(piece))
                for index, piece in enumerate(shape.pieces_m)
            ]
        if isinstance(shape, Box):
            geometry = UsdGeom.Cube.Define(self.stage, path)
            geometry.CreateSizeAttr(1.0)
            geometry.AddScaleOp(UsdGeom.XformOp.PrecisionDouble).Set(
                Gf.Vec3d(*shape.size_m)
            )
        elif isinstance(shape, Sphere):
            geometry = UsdGeom.Sphere.Define(self.stage, path)
            geometry.CreateRadiusAttr(shape.radius_m)
        elif isinstance(shape, Cylinder):
            geometry = UsdGeom.Cylinder.Define(self.stage, path)
            geometry.CreateAxisAttr(UsdGeom.Tokens.z)
            geometry.CreateRadiusAttr(shape.radius_m)
            geometry.CreateHeightAttr(shape.length_m)
        else:
            geometry = UsdGeom.Plane.Define(self.stage, path)
            geometry.CreateAxisAttr(UsdGeom.Tokens.z)
            geometry.CreateWidthAttr(PLANE_EXTENT_M)
            geometry.CreateLengthAttr(PLANE_EXTENT_M)
        write_extent(geometry)
        return [geometry]

    def _piece(self, path: str, points_m: FloatArray) -> UsdGeom.Mesh:
        mesh = self.target.mesh(path, points_m, hull_faces(points_m))
        written = digest(mesh.GetPointsAttr().Get())
        write_gauge(
            mesh,
            "points_m",
            Vt.Vec3dArray.FromNumpy(points_m),
            "double3[]",
            written=written,
        )
        UsdPhysics.MeshCollisionAPI.Apply(mesh.GetPrim()).CreateApproximationAttr(
            UsdPhysics.Tokens.convexHull
        )
        return mesh

    # --- deformable bodies ---

    # --- joints ---

    def _joint(self, path: str, stated: Hinge | Tether) -> None:
        """Write a joint of a body and the world; a joint without a first body is one to the world."""
        pose, anchor_m = self.scene.body(stated.body).pose, stated.anchor_m
        local_m = (0.0, 0.0, 0.0)
        joint: UsdPhysics.Joint
        if isinstance(stated, Hinge):
            local_m = vector(pose.to_body(np.asarray(anchor_m)))
            joint = UsdPhysics.RevoluteJoint.Define(self.stage, path)
            joint.CreateAxisAttr(UsdPhysics.Tokens.x)
            rotation = hinge_frame(stated.axis)
            world = joint.CreateLocalRot0Attr(rotation)
            local = joint.CreateLocalRot1Attr(
                Gf.Quatf(quatd(pose.quaternion).GetInverse() * Gf.Quatd(rotation))
            )
            record_written(local, local.Get())
            write_gauge(
                joint,
                "axis",
                stated.axis,
                "double3",
                written=digest(hinge_axis(wxyz(world.Get()))),
            )
        else:
            joint = UsdPhysics.DistanceJoint.Define(self.stage, path)
            longest = joint.CreateMaxDistanceAttr(stated.length_m)
            write_gauge(joint, "length_m", stated.length_m, written=longest.Get())
        joint.CreateBody1Rel().SetTargets([self.paths[stated.body]])
        world = joint.CreateLocalPos0Attr(Gf.Vec3f(*anchor_m))
        local = joint.CreateLocalPos1Attr(Gf.Vec3f(*local_m))
        record_written(local, local.Get())
        write_gauge(joint, "anchor_m", anchor_m, "double3", written=world.Get())

    # --- attachments and markers ---

    def _markers(self, markers: Markers) -> None:
        positions = np.asarray(markers.positions_m)
        points = UsdGeom.Points.Define(self.stage, "/World/Markers")
        points.CreatePointsAttr(single_points(positions))
        points.CreateIdsAttr(list(range(len(positions))))
        points.CreatePurposeAttr(UsdGeom.Tokens.guide)
        points.CreateWidthsAttr([MARKER_WIDTH_M] * len(positions))
        write_extent(points)
        prim = points.GetPrim()
        bodies = prim.CreateRelationship("gauge:bodies", custom=True)
        bodies.SetTargets([self.paths[name] for name in markers.bodies])
        written = digest(points.GetPointsAttr().Get())
        write_gauge(
            prim,
            "positions_m",
            Vt.Vec3dArray.FromNumpy(positions),
            "double3[]",
            written=written,
        )
        for name, kind in MARKER_INDICES.items():
            write_gauge(prim, name, list(getattr(markers, name)), kind)
