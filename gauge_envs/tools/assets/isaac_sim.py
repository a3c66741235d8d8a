"""Write variants as USD layers that Isaac Sim simulates: PhysX's schemas, drivers at its rate, and what to record.

The layer is that of `usd_layer` with additions, so it reads back as the same scene. The names and types of the added
attributes are those of NVIDIA's published schemas. usd-core has none of them. A setting that is not part of the scene
stays unset, and Isaac Sim's default applies, as in the paper.
"""

from collections.abc import Mapping

import numpy as np
from pxr import Sdf, Usd, UsdPhysics, UsdShade, Vt

from gauge_envs.backends.shared.pair_values import (
    Combination,
    body_values,
    pair_values,
)
from gauge_envs.errors import ParameterError
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.formats.usd import record_follower, write
from gauge_envs.observables.observer import material_points
from gauge_envs.scene import Cloth, Deformable, Rod, Rope, Scene, SoftBody
from gauge_envs.scene.timing import FRAME_RATE_HZ
from gauge_envs.tools.assets.export import experiment_stage

Prims = Mapping[str, Usd.Prim]
"""Prims of the bodies, by the name of the body."""


def steps_per_second(scene: Scene) -> int:
    """Return the rate at which the paper steps a scene in Isaac Sim [1/s] (section on physics engines)."""
    return 900 if scene.has(SoftBody) else 180


def isaac_sim_stage(experiment: Experiment) -> Usd.Stage:
    """Return a variant with its parameters as a stage for Isaac Sim, in memory.

    Raises:
        ParameterError: Isaac Sim cannot simulate the scene.
    """
    scene = experiment.scene
    if scene.air is not None:
        raise ParameterError(
            f"{experiment.id}: it has air, which Isaac Sim does not apply to cloth: choose another engine"
        )
    for body in scene.deformables:
        if isinstance(body, Rope | Rod):
            raise ParameterError(
                f"{experiment.id}: body {body.name!r} is a rope or a rod, and PhysX does not simulate deformable "
                "curves: choose another engine"
            )
    rate_hz = steps_per_second(scene)
    stage = experiment_stage(
        experiment, samples_per_frame=round(rate_hz / FRAME_RATE_HZ)
    )
    prims = {
        prim.GetAttribute("gauge:name").Get(): prim
        for prim in stage.Traverse()
        if prim.HasAttribute("gauge:name")
    }
    _write_solver(stage, rate_hz, has_deformables=bool(scene.deformables))
    for body in scene.deformables:
        _write_deformable(prims, scene, body)
    _write_body_constants(stage, scene, prims)
    if scene.markers is not None:
        _write_material_points(stage, scene, prims)
    layer = stage.GetRootLayer()
    data = dict(layer.customLayerData)
    recorded = [str(prims[name].GetPath()) for name in experiment.recorded]
    data["gauge"]["isaac_sim"] = {
        "steps_per_second": rate_hz,
        "frame_count": experiment.frame_count,
        "observable": experiment.score.observable.value,
        "unit": experiment.score.observable.unit,
        "coordinates": Vt.StringArray(experiment.coordinates),
        "recorded": Vt.StringArray(recorded),
    }
    layer.customLayerData = data
    return stage


def _write_solver(stage: Usd.Stage, rate_hz: int, *, has_deformables: bool) -> None:
    """Write the step of PhysX, and that deformable bodies need the GPU."""
    prim = stage.GetPrimAtPath("/World/PhysicsScene")
    prim.AddAppliedSchema("PhysxSceneAPI")
    write(prim, "physxScene:timeStepsPerSecond", rate_hz, "uint")
    if has_deformables:
        write(prim, "physxScene:enableGPUDynamics", True, "bool")
        broadphase = write(prim, "physxScene:broadphaseType", "GPU", "token")
        broadphase.SetVariability(Sdf.VariabilityUniform)


def _write_deformable(prims: Prims, scene: Scene, body: Deformable) -> None:
    """Write PhysX's attributes of a cloth or a soft body.

    Without a rest offset, PhysX keeps deformable bodies 20 mm off other bodies. Here contact begins at the surface: at
    half the thickness of a cloth, and at the mesh of a soft body. PhysX needs a collider on every body, so the pairs of
    a body without contacts are filtered instead.
    """
    prim, name = prims[body.name], body.name
    kind, rest_offset_m = "Base", 0.0
    if isinstance(body, Cloth):
        kind, rest_offset_m = "Surface", 0.5 * body.thickness_m
    prim.AddAppliedSchema(f"Physx{kind}DeformableBodyAPI")
    touches_itself = any(
        name in contact.first and name in contact.second for contact in scene.contacts
    )
    write(prim, "physxDeformableBody:selfCollision", touches_itself, "bool")
    prim.AddAppliedSchema("PhysxCollisionAPI")
    write(prim, "physxCollision:restOffset", rest_offset_m, "float")
    collider = UsdPhysics.CollisionAPI(prim).GetCollisionEnabledAttr()
    if not collider.Get():
        collider.Set(True)
        paths = [prims[partner].GetPath() for partner in prims if partner != name]
        filtered = UsdPhysics.FilteredPairsAPI.Apply(prim)
        filtered.CreateFilteredPairsRel().SetTargets(paths)


def _write_body_constants(stage: Usd.Stage, scene: Scene, prims: Prims) -> None:
    """Write constants of bodies whose averages are the constants of the pairs.

    A layer binds each body to the material of its first contact. PhysX averages the materials of two bodies.
    """
    friction_of = body_values(pair_values(scene, "friction"), Combination.MEAN)
    restitution_of = body_values(pair_values(scene, "restitution"), Combination.MEAN)
    deformables = [body.name for body in scene.deformables]
    materials: dict[tuple[float, float], str] = {}
    for body, friction in friction_of.items():
        # The solution is not exact in the last digits.
        values = round(friction, 9), round(restitution_of[body], 9)
        binding = UsdShade.MaterialBindingAPI(prims[body])
        if body in deformables:
            material = binding.ComputeBoundMaterial("physics")[0]
        else:
            path = f"/World/Materials/isaac_{len(materials)}"
            path = materials.setdefault(values, path)
            material = UsdShade.Material.Define(stage, path)
            binding.Bind(material, UsdShade.Tokens.weakerThanDescendants, "physics")
        _write_coefficients(material.GetPrim(), *values)
        # The constants of the material follow from the contacts of the body.
        for index, contact in enumerate(scene.contacts):
            if body in (*contact.first, *contact.second):
                prim = stage.GetPrimAtPath(f"/World/Contacts/contact_{index}")
                prim.GetRelationship("gauge:materials").RemoveTarget(material.GetPath())
                derived = prim.CreateRelationship(
                    "gauge:derived_materials", custom=True
                )
                derived.AddTarget(material.GetPath())


def _write_coefficients(prim: Usd.Prim, friction: float, restitution: float) -> None:
    """Write contact constants of a body, which follow from the constants of its pairs."""
    UsdPhysics.MaterialAPI.Apply(prim)
    values = {
        "physics:restitution": restitution,
        "physics:staticFriction": friction,
        "physics:dynamicFriction": friction,
        # Materials of deformable bodies have them.
        "omniphysics:staticFriction": friction,
        "omniphysics:dynamicFriction": friction,
    }
    for name, value in values.items():
        if attribute := prim.GetAttribute(name):
            attribute.Set(value)
            record_follower(attribute, "the constants in /World/Contacts")


def _write_material_points(stage: Usd.Stage, scene: Scene, prims: Prims) -> None:
    """Write the mesh vertices and weights that interpolate each marker.

    The vertices are numbered over the meshes of `gauge:bodies`, in that order.
    """
    assert scene.markers is not None
    bodies = {body.name: body for body in scene.deformables}
    nodes_m = {}
    for name in scene.markers.bodies:
        points_m = np.asarray(prims[name].GetAttribute("points").Get(), np.float64)
        nodes_m[name] = bodies[name].pose.to_world(points_m)
    positions_m = np.asarray(scene.markers.positions_m)
    indices, weights = material_points(positions_m, nodes_m, bodies)
    prim = stage.GetPrimAtPath("/World/Markers")
    write(prim, "gauge:isaac:nodes", indices.tolist(), "int4[]")
    write(prim, "gauge:isaac:weights", weights.tolist(), "double4[]")
