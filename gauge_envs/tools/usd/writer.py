"""Writer of scenes as USD layers: standard UsdPhysics attributes with exact `gauge:` doubles beside them.

UsdPhysics has single precision, one material per body instead of constants per pair, and no deformable bodies yet. The
layer therefore also contains every number of the scene as a custom double under its name in `gauge_envs.scene`
(`gauge:mass_kg`), and the pairs in `/World/Contacts`. Deformable bodies have the attributes of the proposed schema
under Omniverse's names (`omniphysics:`).

A number that is stored twice can be edited in either place. The custom data of the double contains the written value of
the standard attribute, from which the reader detects the edited one. A derived attribute that cannot be inverted, such
as the mesh of a cloth, contains its written value and the names of the attributes to edit instead.
"""

import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict, fields
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Gf, Sdf, Tf, Usd, UsdGeom, UsdPhysics, UsdShade, Vt

from gauge_envs.errors import ParameterError, ResultFileError, UnsupportedSceneError
from gauge_envs.scene.bodies import (
    Attachment,
    BodyHinge,
    Cloth,
    Contact,
    Deformable,
    Hinge,
    Markers,
    Motion,
    RigidBody,
    Rod,
    Rope,
    SoftBody,
    Tether,
)
from gauge_envs.scene.drivers import Driver
from gauge_envs.scene.fabrics import Fabric
from gauge_envs.scene.geometry import (
    Box,
    Compound,
    ConvexUnion,
    Cylinder,
    FloatArray,
    IntArray,
    Pose,
    Shape,
    Sphere,
    vector,
)
from gauge_envs.scene.meshes import TOUCHING_M, grid, hull_faces, nodes_in, tetrahedra
from gauge_envs.scene.motors import Servo
from gauge_envs.scene.scene import Scene
from gauge_envs.scene.timing import FRAME_RATE_HZ
from gauge_envs.tools.usd.isaac_fabric import surface_constants
from gauge_envs.tools.usd.layer import (
    AIR_KINDS,
    ARMS,
    DRIVE,
    DYNAMICS,
    KINDS,
    MARKER_INDICES,
    OMNI_MATERIAL,
    PHYSX_ARMATURE,
    TEXT,
    digest,
    hinge_axis,
    hinge_frame,
    motions_digest,
    motions_to_json,
    names_digest,
    record_follower,
    record_written,
    samples_digest,
    wxyz,
)
from gauge_envs.tools.usd.velocities import write_velocities

SUFFIXES = (".usda", ".usdc", ".usd")

GROUPS = ("PhysicsScene", "Contacts", "Materials", "Joints", "Attachments", "Markers")
"""Names of the groups beside the bodies below the world prim."""

LINE_SPACING_M = 0.01
"""Distance between the points of ropes and rods [m]."""

PLANE_EXTENT_M = 2.0
"""Edge length of the visible square of a plane [m]; the collider is infinite."""

MARKER_WIDTH_M = 0.005
"""Visible width of markers [m]."""

ISAAC_ATTRIBUTES = {
    "youngs_modulus": "youngsModulus",
    "poissons_ratio": "poissonsRatio",
    "surfaceBendStiffness": "surfaceBendStiffness",
}
"""Attributes of Omniverse's deformable material, by the names of `isaac_fabric.surface_constants`."""


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
        self.samples_per_frame = samples_per_frame
        self.later_frames = later_frames
        self.frame_count = round(scene.duration_s * FRAME_RATE_HZ) + 1
        names = [body.name for body in (*scene.bodies, *scene.deformables)]
        for kind, listed in (
            ("name", names),
            ("driver", [driver.body for driver in scene.drivers]),
        ):
            twice = next((name for name in listed if listed.count(name) > 1), None)
            if twice is not None:
                raise ParameterError(f"body {twice!r} has more than one {kind}")
        self.paths = _paths(names)
        self.deformables = {body.name: body for body in self.scene.deformables}
        self.collides = {
            name
            for contact in self.scene.contacts
            for name in (*contact.first, *contact.second)
        }
        self.points: dict[str, FloatArray] = {}

    def write(self) -> None:
        scene, physics = self.scene, self._physics()
        materials = [
            self._contact_material(index, contact)
            for index, contact in enumerate(scene.contacts)
        ]
        for body in scene.bodies:
            self._body(body)
            if (index := self._first_contact(body.name)) is not None:
                self._bind(self.paths[body.name], materials[index])
        for index, driver in enumerate(scene.drivers):
            self._drive(index, driver)
        for deformable in scene.deformables:
            self._deformable(deformable)
        _custom(physics, "colliding_pairs", self._filtered_pairs(), "string")
        for index, joint in enumerate(scene.joints):
            self._joint(f"{self._group('Joints')}/joint_{index}", joint)
        for index, hinge in enumerate(scene.body_hinges):
            self._body_hinge(f"{self._group('Joints')}/body_hinge_{index}", hinge)
        for index, attachment in enumerate(scene.attachments):
            self._attachment(index, attachment)
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
        _custom(
            physics,
            "gravity_m_per_s2",
            self.scene.gravity_m_per_s2,
            written=magnitude.Get(),
        )
        for name, value in (asdict(self.scene.air) if self.scene.air else {}).items():
            _custom(physics, f"air:{name}", value, AIR_KINDS.get(name, "double"))
        _custom(
            physics,
            "duration_s",
            self.scene.duration_s,
            written=(self.frame_count - 1) / FRAME_RATE_HZ,
        )
        return physics

    def _group(self, name: str) -> str:
        """Return the path of a group below the world, which is created if it does not exist."""
        path = f"/World/{name}"
        UsdGeom.Scope.Define(self.stage, path)
        return path

    # --- contacts ---

    def _contact_material(self, index: int, contact: Contact) -> UsdShade.Material:
        """Write the exact contact below `/World/Contacts`, and return a material with its constants."""
        prim = UsdGeom.Scope.Define(
            self.stage, f"{self._group('Contacts')}/contact_{index}"
        ).GetPrim()
        for side, names in (("first", contact.first), ("second", contact.second)):
            prim.CreateRelationship(f"gauge:{side}", custom=True).SetTargets(
                [self.paths[name] for name in names]
            )
        friction = _custom(prim, "friction", contact.friction)
        restitution = _custom(prim, "restitution", contact.restitution)
        for name in ARMS:
            if arm := getattr(contact, name):
                _custom(prim, name, arm)
        _custom(prim, "mode", contact.mode.value, "token")
        material = UsdShade.Material.Define(
            self.stage, f"{self._group('Materials')}/contact_{index}"
        )
        constants = _friction(material.GetPrim(), contact)
        record_written(friction, constants.GetDynamicFrictionAttr().Get())
        record_written(restitution, constants.GetRestitutionAttr().Get())
        deformable = [
            name for name in self.deformables if self._first_contact(name) == index
        ]
        targets = [material.GetPath(), *map(self._deformable_material_path, deformable)]
        prim.CreateRelationship("gauge:materials", custom=True).SetTargets(targets)
        return material

    def _first_contact(self, name: str) -> int | None:
        """Return the index of the first contact of a body: UsdPhysics has materials per body and not per pair."""
        return next(
            (
                i
                for i, c in enumerate(self.scene.contacts)
                if name in c.first or name in c.second
            ),
            None,
        )

    def _bind(self, path: str, material: UsdShade.Material) -> None:
        binding = UsdShade.MaterialBindingAPI.Apply(self.stage.GetPrimAtPath(path))
        binding.Bind(material, UsdShade.Tokens.weakerThanDescendants, "physics")

    def _filtered_pairs(self) -> str:
        """Filter all pairs without a contact, since UsdPhysics lets all collide; return a hash of the other pairs."""
        allowed = {
            frozenset((a, b))
            for contact in self.scene.contacts
            for a in contact.first
            for b in contact.second
        }
        moves = {body.name for body in self.scene.dynamic_bodies} | set(
            self.deformables
        )
        filtered: dict[str, list[str]] = {}
        for one, other in combinations(
            [name for name in self.paths if name in self.collides], 2
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
        self._place(xform, body.name, body.pose)
        _custom(prim, "motion", body.motion.value, "token", written=body.motion.value)
        mass = _custom(prim, "mass_kg", body.mass_kg)
        if body.motion is not Motion.FIXED:
            rigid = UsdPhysics.RigidBodyAPI.Apply(prim)
            rigid.CreateKinematicEnabledAttr(body.motion is Motion.KINEMATIC)
            api = UsdPhysics.MassAPI.Apply(prim)
            record_written(mass, api.CreateMassAttr(body.mass_kg).Get())
            if body.inertia_kg_m2 is not None:
                _custom(prim, "inertia_kg_m2", body.inertia_kg_m2)
                api.CreateDiagonalInertiaAttr(Gf.Vec3f(body.inertia_kg_m2))
            if not body.starts_at_rest:
                write_velocities(rigid, body)
        for geometry in self._geometry(prim.GetPath(), body.shape):
            collision = UsdPhysics.CollisionAPI.Apply(geometry.GetPrim())
            collision.CreateCollisionEnabledAttr(body.name in self.collides)

    def _place(self, xform: UsdGeom.Xformable, name: str, pose: Pose) -> None:
        precision = UsdGeom.XformOp.PrecisionDouble
        xform.AddTranslateOp(precision).Set(Gf.Vec3d(*pose.position_m))
        xform.AddOrientOp(precision).Set(_quatd(pose.quaternion))
        _custom(xform, "name", name, "string")

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
                orient.Set(_quatd(last.tolist()), code)
        _custom(xform, "driver_provenance", driver.provenance, "string")
        text = motions_to_json(driver.motions, index)
        attribute = _custom(xform, "driver", text, "string")
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
        _extent(geometry)
        return [geometry]

    def _piece(self, path: str, points_m: FloatArray) -> UsdGeom.Mesh:
        mesh = self._mesh(path, points_m, hull_faces(points_m))
        written = digest(mesh.GetPointsAttr().Get())
        _custom(
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

    def _mesh(
        self, path: str, points_m: FloatArray, faces: Sequence[Sequence[int]]
    ) -> UsdGeom.Mesh:
        mesh = UsdGeom.Mesh.Define(self.stage, path)
        mesh.CreatePointsAttr(_points(points_m))
        mesh.CreateFaceVertexCountsAttr([len(face) for face in faces])
        mesh.CreateFaceVertexIndicesAttr([index for face in faces for index in face])
        mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
        _extent(mesh)
        return mesh

    # --- deformable bodies ---

    def _deformable(self, body: Deformable) -> None:
        path = self.paths[body.name]
        if isinstance(body, Cloth):
            geometry, api = (
                self._cloth(path, body),
                "OmniPhysicsSurfaceDeformableSimAPI",
            )
        elif isinstance(body, SoftBody):
            geometry, api = (
                self._soft_body(path, body),
                "OmniPhysicsVolumeDeformableSimAPI",
            )
        else:
            geometry, api = self._line(path, body), None
        prim = geometry.GetPrim()
        self._place(geometry, body.name, body.pose)
        _custom(prim, "kind", KINDS[type(body)], "token")
        for field in fields(body):
            if isinstance(value := getattr(body, field.name), float):
                _custom(prim, field.name, value)
        # usd-core does not have these schemas; Omniverse recognizes their names.
        prim.AddAppliedSchema("OmniPhysicsBodyAPI")
        prim.AddAppliedSchema("OmniPhysicsDeformableBodyAPI")
        _omni(prim, "deformableBodyEnabled", "bool", True)
        record_written(
            prim.GetAttribute("gauge:mass_kg"),
            _omni(prim, "mass", "float", body.mass_kg).Get(),
        )
        size = f"gauge:{'length_m' if api is None else 'size_m'}"
        points = UsdGeom.PointBased(prim).GetPointsAttr()
        record_follower(points, size)
        if api is not None:
            prim.AddAppliedSchema(api)
            record_follower(
                _omni(prim, "restShapePoints", "point3f[]", points.Get()), size
            )
            collision = UsdPhysics.CollisionAPI.Apply(prim)
            collision.CreateCollisionEnabledAttr(body.name in self.collides)
        self._bind(path, self._deformable_material(body))

    def _cloth(self, path: str, cloth: Cloth) -> UsdGeom.Mesh:
        nodes, shape = grid((*cloth.size_m, 0.0))
        corner = np.arange(len(nodes)).reshape(shape)[:, :, 0]
        a, b, c, d = corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]
        triangles = np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3)
        self.points[cloth.name] = nodes
        mesh = self._mesh(path, nodes, triangles.tolist())
        record_follower(mesh.GetFaceVertexIndicesAttr(), "gauge:size_m")
        record_follower(
            _omni(mesh, "restTriVtxIndices", "int3[]", _integers(triangles)),
            "gauge:size_m",
        )
        _custom(mesh, "size_m", cloth.size_m, "double2")
        return mesh

    def _soft_body(self, path: str, body: SoftBody) -> UsdGeom.TetMesh:
        nodes, shape = grid(body.shape.size_m)
        indices = _integers(tetrahedra(shape))
        self.points[body.name] = nodes
        mesh = UsdGeom.TetMesh.Define(self.stage, path)
        mesh.CreatePointsAttr(_points(nodes))
        mesh.CreateTetVertexIndicesAttr(indices)
        mesh.CreateSurfaceFaceVertexIndicesAttr(
            UsdGeom.TetMesh.ComputeSurfaceFaces(mesh)
        )
        _extent(mesh)
        record_follower(mesh.GetTetVertexIndicesAttr(), "gauge:size_m")
        record_follower(
            _omni(mesh, "restTetVtxIndices", "int4[]", indices), "gauge:size_m"
        )
        _custom(mesh, "size_m", body.shape.size_m, "double3")
        return mesh

    def _line(self, path: str, body: Rope | Rod) -> UsdGeom.BasisCurves:
        count = round(body.length_m / LINE_SPACING_M) + 1
        nodes = np.zeros((count, 3))
        nodes[:, 0 if isinstance(body, Rope) else 2] = np.linspace(
            -0.5 * body.length_m, 0.5 * body.length_m, count
        )
        self.points[body.name] = nodes
        curves = UsdGeom.BasisCurves.Define(self.stage, path)
        curves.CreateTypeAttr(UsdGeom.Tokens.linear)
        curves.CreateWrapAttr(UsdGeom.Tokens.nonperiodic)
        curves.CreateCurveVertexCountsAttr([count])
        curves.CreatePointsAttr(_points(nodes))
        curves.CreateWidthsAttr([2.0 * body.radius_m])
        curves.SetWidthsInterpolation(UsdGeom.Tokens.constant)
        _extent(curves)
        return curves

    def _deformable_material_path(self, name: str) -> str:
        return f"/World/Materials/body_{self.paths[name].rpartition('/')[2]}"

    def _deformable_material(self, body: Deformable) -> UsdShade.Material:
        self._group("Materials")
        material = UsdShade.Material.Define(
            self.stage, self._deformable_material_path(body.name)
        )
        prim, gauge = (
            material.GetPrim(),
            self.stage.GetPrimAtPath(self.paths[body.name]),
        )
        prim.AddAppliedSchema("OmniPhysicsBaseMaterialAPI")
        prim.AddAppliedSchema("OmniPhysicsDeformableMaterialAPI")
        if (index := self._first_contact(body.name)) is not None:
            contact = self.scene.contacts[index]
            _friction(prim, contact)
            _omni(prim, "staticFriction", "float", contact.friction)
            _omni(prim, "dynamicFriction", "float", contact.friction)
        if isinstance(body, Cloth):
            prim.AddAppliedSchema("OmniPhysicsSurfaceDeformableMaterialAPI")
            density = _omni(
                prim,
                "density",
                "float",
                body.areal_density_kg_per_m2 / body.thickness_m,
            )
            record_follower(density, "gauge:areal_density_kg_per_m2")
        for name, attribute in OMNI_MATERIAL.items():
            if hasattr(body, name):
                written = _omni(prim, attribute, "float", getattr(body, name)).Get()
                record_written(gauge.GetAttribute(f"gauge:{name}"), written)
        if isinstance(body, Cloth):
            isaac = surface_constants(Fabric.of(body))
            for name, attribute in ISAAC_ATTRIBUTES.items():
                value = isaac.constants[name]
                for one in (
                    _omni(prim, attribute, "float", value),
                    _custom(prim, f"isaac:{name}", value),
                ):
                    record_follower(
                        one, "gauge:stretch_, gauge:shear_ and gauge:bend_stiffness_..."
                    )
            _custom(prim, "isaac:notes", [*isaac.fallbacks, *isaac.lost], "string[]")
        if isinstance(body, Rope | Rod):
            (width,) = UsdGeom.BasisCurves(gauge).GetWidthsAttr().Get()
            record_written(gauge.GetAttribute("gauge:radius_m"), 0.5 * width)
        return material

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
                Gf.Quatf(_quatd(pose.quaternion).GetInverse() * Gf.Quatd(rotation))
            )
            record_written(local, local.Get())
            _custom(
                joint,
                "axis",
                stated.axis,
                "double3",
                written=digest(hinge_axis(wxyz(world.Get()))),
            )
            _joint_terms(joint.GetPrim(), stated)
        else:
            joint = UsdPhysics.DistanceJoint.Define(self.stage, path)
            longest = joint.CreateMaxDistanceAttr(stated.length_m)
            _custom(joint, "length_m", stated.length_m, written=longest.Get())
        joint.CreateBody1Rel().SetTargets([self.paths[stated.body]])
        world = joint.CreateLocalPos0Attr(Gf.Vec3f(*anchor_m))
        local = joint.CreateLocalPos1Attr(Gf.Vec3f(*local_m))
        record_written(local, local.Get())
        _custom(joint, "anchor_m", anchor_m, "double3", written=world.Get())

    def _body_hinge(self, path: str, hinge: BodyHinge) -> None:
        """Write a joint of two bodies, with its frame in each, and the exact anchor and axis in the world."""
        joint = UsdPhysics.RevoluteJoint.Define(self.stage, path)
        joint.CreateAxisAttr(UsdPhysics.Tokens.x)
        rotation = Gf.Quatd(hinge_frame(hinge.axis))
        sides = (
            (
                hinge.first,
                joint.CreateBody0Rel,
                joint.CreateLocalPos0Attr,
                joint.CreateLocalRot0Attr,
            ),
            (
                hinge.second,
                joint.CreateBody1Rel,
                joint.CreateLocalPos1Attr,
                joint.CreateLocalRot1Attr,
            ),
        )
        for name, relate, place, turn in sides:
            pose = self.scene.body(name).pose
            relate().SetTargets([self.paths[name]])
            at = place(Gf.Vec3f(*pose.to_body(np.asarray(hinge.anchor_m)).tolist()))
            along = turn(Gf.Quatf(_quatd(pose.quaternion).GetInverse() * rotation))
            for one in (at, along):
                record_written(one, one.Get())
        _custom(joint, "anchor_m", hinge.anchor_m, "double3")
        _custom(joint, "axis", hinge.axis, "double3")
        _joint_terms(joint.GetPrim(), hinge)

    # --- attachments and markers ---

    def _attachment(self, index: int, attachment: Attachment) -> None:
        """Write an attachment, for Omniverse with the attached vertices of the mesh in this file."""
        body = self.deformables[attachment.deformable]
        nodes = self.points[attachment.deformable]
        attached = nodes_in(nodes, attachment.region)
        other = self.deformables.get(attachment.to)
        kind = (
            "OmniPhysicsVtxXformAttachment"
            if other is None
            else "OmniPhysicsVtxVtxAttachment"
        )
        prim = self.stage.DefinePrim(
            f"{self._group('Attachments')}/attachment_{index}", kind
        )
        pose = self.scene.body(attachment.to).pose if other is None else other.pose
        local = pose.to_body(body.pose.to_world(nodes[attached]))
        if other is None:
            follows = [_omni(prim, "localPositionsSrc1", "point3f[]", _points(local))]
        else:
            partners = self.points[attachment.to]
            distance = np.linalg.norm(local[:, None] - partners[None], axis=-1)
            touching = distance.min(axis=1) < TOUCHING_M
            attached = attached[touching]
            nearest = distance.argmin(axis=1)[touching]
            follows = [_omni(prim, "vtxIndicesSrc1", "int[]", nearest.tolist())]
        follows.append(_omni(prim, "vtxIndicesSrc0", "int[]", attached.tolist()))
        for one in follows:
            record_follower(
                one, "gauge:region_axis, gauge:region_side and gauge:region_depth_m"
            )
        _omni(prim, "attachmentEnabled", "bool", True)
        for name, target in (("src0", attachment.deformable), ("src1", attachment.to)):
            prim.CreateRelationship(f"omniphysics:{name}", custom=False).SetTargets(
                [self.paths[target]]
            )
        _custom(prim, "region_axis", attachment.region.axis, "token")
        _custom(prim, "region_side", attachment.region.side, "token")
        _custom(prim, "region_depth_m", attachment.region.depth_m)

    def _markers(self, markers: Markers) -> None:
        positions = np.asarray(markers.positions_m)
        points = UsdGeom.Points.Define(self.stage, "/World/Markers")
        points.CreatePointsAttr(_points(positions))
        points.CreateIdsAttr(list(range(len(positions))))
        points.CreatePurposeAttr(UsdGeom.Tokens.guide)
        points.CreateWidthsAttr([MARKER_WIDTH_M] * len(positions))
        _extent(points)
        prim = points.GetPrim()
        bodies = prim.CreateRelationship("gauge:bodies", custom=True)
        bodies.SetTargets([self.paths[name] for name in markers.bodies])
        written = digest(points.GetPointsAttr().Get())
        _custom(
            prim,
            "positions_m",
            Vt.Vec3dArray.FromNumpy(positions),
            "double3[]",
            written=written,
        )
        for name, kind in MARKER_INDICES.items():
            _custom(prim, name, list(getattr(markers, name)), kind)


# --- attributes ------------------------------------------------------------------------------------------------------


def _paths(names: Sequence[str]) -> dict[str, str]:
    """Return a unique path for each body; invalid or taken names are changed."""
    taken, paths = set(GROUPS), {}
    for name in names:
        identifier = Tf.MakeValidIdentifier(name)
        while identifier in taken:
            identifier += "_"
        taken.add(identifier)
        paths[name] = f"/World/{identifier}"
    return paths


def _custom(
    schema: Any, name: str, value: Any, kind: str = "double", *, written: Any = None
) -> Usd.Attribute:
    """Write a `gauge:` attribute.

    Args:
        schema: Prim or schema.
        name: Name without the prefix.
        value: Its value.
        kind: Name of its type in USD.
        written: Written value of its standard counterpart, if it has one.
    """
    attribute = _set(schema, f"gauge:{name}", kind, value)
    if written is not None:
        record_written(attribute, written)
    return attribute


def _omni(schema: Any, name: str, kind: str, value: Any) -> Usd.Attribute:
    """Write an attribute of the deformable schema, which is not custom for tools with that schema."""
    return _set(schema, f"omniphysics:{name}", kind, value)


def _set(schema: Any, name: str, kind: str, value: Any) -> Usd.Attribute:
    prim = schema if isinstance(schema, Usd.Prim) else schema.GetPrim()
    is_custom = name.startswith("gauge:")
    attribute = prim.CreateAttribute(
        name, Sdf.ValueTypeNames.Find(kind), custom=is_custom
    )
    attribute.Set(value)
    return attribute


def _joint_terms(prim: Usd.Prim, hinge: Hinge | BodyHinge) -> None:
    """Write friction, armature and motor of a hinge."""
    if hinge.dynamics.servo:
        raise UnsupportedSceneError(
            f"{prim.GetName()}: a USD layer has no friction by rate and load: leave it out, or state it in a task file"
        )
    for field, name in DYNAMICS.items():
        if value := getattr(hinge.dynamics, field):
            prim.AddAppliedSchema("MjcJointAPI")
            double = _set(prim, name, "double", value)
            if name == "mjc:armature":
                prim.AddAppliedSchema("PhysxJointAPI")
                record_written(double, _set(prim, PHYSX_ARMATURE, "float", value).Get())
    if (motor := hinge.motor) is None:
        return
    _custom(prim, "motor", motor.kind, "token")
    _custom(
        prim, "command", json.dumps(asdict(motor.command), allow_nan=False), "string"
    )
    if isinstance(motor, Servo):
        target = UsdPhysics.DriveAPI.Apply(prim, "angular").CreateTargetPositionAttr()
        target.Set(math.degrees(motor.command.value(0.0)))
        record_follower(target, "gauge:command")
    for field, value in asdict(motor).items():
        if isinstance(value, float):
            drive = DRIVE.get(field)
            single = (
                drive
                and _set(prim, drive[0], "float", value / drive[1]).Get() * drive[1]
            )
            _custom(prim, field, value, written=single)


def _friction(prim: Usd.Prim, contact: Contact) -> UsdPhysics.MaterialAPI:
    material = UsdPhysics.MaterialAPI.Apply(prim)
    material.CreateStaticFrictionAttr(contact.friction)
    material.CreateDynamicFrictionAttr(contact.friction)
    material.CreateRestitutionAttr(contact.restitution)
    return material


def _extent(geometry: UsdGeom.Boundable) -> None:
    geometry.CreateExtentAttr(
        UsdGeom.Boundable.ComputeExtentFromPlugins(geometry, Usd.TimeCode.Default())
    )


def _quatd(quaternion: Iterable[float]) -> Gf.Quatd:
    w, x, y, z = quaternion
    return Gf.Quatd(w, x, y, z)


def _points(points_m: FloatArray) -> Vt.Vec3fArray:
    return Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(points_m, dtype=np.float32))


def _integers(indices: IntArray) -> Any:
    """Return rows of indices as USD's array of integer vectors."""
    kind = {3: Vt.Vec3iArray, 4: Vt.Vec4iArray}[indices.shape[1]]
    return kind.FromNumpy(np.ascontiguousarray(indices, dtype=np.int32))
