"""Write variants as USD layers that Isaac Sim simulates: PhysX's schemas, drivers at its rate, and what to record.

The layer is that of `usd_layer` with additions, so it reads back as the same scene. The names and types of the added
attributes are those of NVIDIA's published schemas. usd-core has none of them. A setting that is not part of the scene
stays unset, and Isaac Sim's default applies, as in the paper.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pxr import Gf, Sdf, Usd, UsdPhysics, UsdShade, Vt

from gauge_envs.backends.shared.pair_values import Combination, body_values, pair_values
from gauge_envs.errors import ParameterError, ResultFileError
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.files import os_errors
from gauge_envs.observables.observer import material_points
from gauge_envs.scene import (
    Cloth,
    Deformable,
    Rod,
    Rope,
    Scene,
    SoftBody,
)
from gauge_envs.scene.timing import FRAME_RATE_HZ
from gauge_envs.tools.assets.export import experiment_stage
from gauge_envs.tools.usd import export_stage, record_follower

RIGID_AND_CLOTH_HZ = 180
"""Steps per second of rigid bodies and cloth (paper, section on physics engines)."""

VOLUME_HZ = 900
"""Steps per second of scenes with volumetric deformable bodies (paper, section on physics engines)."""

LATER_FRAMES = 10
"""Frames that are recorded after the last one; the release alignment of scores uses them."""

COEFFICIENTS: tuple[Literal["friction", "restitution"], ...] = (
    "friction",
    "restitution",
)
"""Contact constants of a pair."""

UNSUPPORTED = {Rope: "rope", Rod: "rod"}
"""Bodies that PhysX cannot simulate: it has no deformable curves."""


def steps_per_second(scene: Scene) -> int:
    """Return the rate at which the paper steps a scene in Isaac Sim [1/s]."""
    return VOLUME_HZ if scene.has(SoftBody) else RIGID_AND_CLOTH_HZ


def unsupported_reason(scene: Scene) -> str | None:
    """Return why Isaac Sim cannot simulate a scene, or None if it can."""
    for body in scene.deformables:
        if (kind := UNSUPPORTED.get(type(body))) is not None:
            return f"body {body.name!r} is a {kind}, and PhysX does not simulate deformable curves"
    return None


def write_isaac_sim_layer(experiment: Experiment, path: Path) -> None:
    """Write a variant as a self-contained layer for Isaac Sim.

    Args:
        experiment: Variant with its parameters.
        path: File to write; the suffix selects text (`.usda`) or binary (`.usdc`, `.usd`). Its folder is created.
    """
    stage = isaac_sim_stage(experiment)
    with os_errors(
        lambda cause: ResultFileError(f"{path.parent}: cannot be created: {cause}")
    ):
        path.parent.mkdir(parents=True, exist_ok=True)
    export_stage(stage, path)


def isaac_sim_stage(experiment: Experiment) -> Usd.Stage:
    """Return a variant as a stage for Isaac Sim, in memory."""
    scene = experiment.scene
    if (reason := unsupported_reason(scene)) is not None:
        raise ParameterError(
            f"{experiment.id}: {reason}. Choose an experiment without it, or another engine: gauge list backends"
        )
    if scene.air is not None:
        raise ParameterError(
            f"{experiment.id}: Isaac Sim applies no air to cloth: export it without the air"
        )
    rate = steps_per_second(scene)
    stage = experiment_stage(
        experiment,
        samples_per_frame=round(rate / FRAME_RATE_HZ),
        later_frames=LATER_FRAMES,
    )
    paths = {
        prim.GetAttribute("gauge:name").Get(): prim
        for prim in stage.Traverse()
        if prim.HasAttribute("gauge:name")
    }
    _write_solver(
        stage.GetPrimAtPath("/World/PhysicsScene"),
        rate,
        has_deformables=bool(scene.deformables),
    )
    for body in scene.deformables:
        _write_deformable(paths, scene, body)
    _write_body_constants(stage, scene, paths)
    if scene.markers is not None:
        _write_material_points(stage, scene, paths)
    layer = stage.GetRootLayer()
    gauge = dict(layer.customLayerData["gauge"])
    gauge["isaac_sim"] = {
        "steps_per_second": rate,
        "frame_count": experiment.frame_count + LATER_FRAMES,
        "observable": experiment.score.observable.value,
        "unit": experiment.score.observable.unit,
        "coordinates": Vt.StringArray(experiment.coordinates),
        "recorded": Vt.StringArray(
            [str(paths[name].GetPath()) for name in experiment.recorded]
        ),
    }
    layer.customLayerData = layer.customLayerData | {"gauge": gauge}
    return stage


def _write_solver(prim: Usd.Prim, rate: int, *, has_deformables: bool) -> None:
    """Write the step of PhysX, and that deformable bodies need the GPU."""
    prim.AddAppliedSchema("PhysxSceneAPI")
    _write(prim, "physxScene:timeStepsPerSecond", Sdf.ValueTypeNames.UInt, rate)
    if has_deformables:
        _write(prim, "physxScene:enableGPUDynamics", Sdf.ValueTypeNames.Bool, True)
        _write(
            prim,
            "physxScene:broadphaseType",
            Sdf.ValueTypeNames.Token,
            "GPU",
            Sdf.VariabilityUniform,
        )


def _write_deformable(
    paths: dict[str, Usd.Prim], scene: Scene, body: Deformable
) -> None:
    """Write PhysX's attributes of a cloth or a soft body.

    Without a rest offset, PhysX holds deformable bodies 20 mm off what they touch. Here contact begins at the
    surface: at half the thickness of a cloth, and at the mesh of a soft body. PhysX needs a collider on every body,
    so one that touches nothing has its pairs filtered instead.
    """
    prim = paths[body.name]
    prim.AddAppliedSchema(
        "PhysxSurfaceDeformableBodyAPI"
        if isinstance(body, Cloth)
        else "PhysxBaseDeformableBodyAPI"
    )
    touches_itself = any(
        body.name in contact.first and body.name in contact.second
        for contact in scene.contacts
    )
    _write(
        prim,
        "physxDeformableBody:selfCollision",
        Sdf.ValueTypeNames.Bool,
        touches_itself,
    )
    prim.AddAppliedSchema("PhysxCollisionAPI")
    rest_offset_m = 0.5 * body.thickness_m if isinstance(body, Cloth) else 0.0
    _write(prim, "physxCollision:restOffset", Sdf.ValueTypeNames.Float, rest_offset_m)
    collider = UsdPhysics.CollisionAPI(prim).GetCollisionEnabledAttr()
    if not collider.Get():
        collider.Set(True)
        others = [other.GetPath() for name, other in paths.items() if name != body.name]
        UsdPhysics.FilteredPairsAPI.Apply(prim).CreateFilteredPairsRel().SetTargets(
            others
        )


def _write_body_constants(
    stage: Usd.Stage, scene: Scene, paths: dict[str, Usd.Prim]
) -> None:
    """Write constants of bodies whose averages are the constants of the pairs, where those of the layer are not.

    A layer binds each body to the material of its first contact. PhysX averages the materials of two bodies.
    """
    pairs = {name: pair_values(scene, name) for name in COEFFICIENTS}
    first = {
        name: contact
        for contact in reversed(scene.contacts)
        for name in (*contact.first, *contact.second)
    }
    if all(
        math.isclose(
            0.5 * (getattr(first[one], name) + getattr(first[other], name)), value
        )
        for name, values in pairs.items()
        for (one, other), value in values.items()
    ):
        return
    found = {
        name: body_values(values, Combination.MEAN) for name, values in pairs.items()
    }
    deformable = {body.name for body in scene.deformables}
    materials: dict[tuple[float, ...], UsdShade.Material] = {}
    for body in found["friction"]:
        # Differences in the last digits are those of the solution.
        values = tuple(round(found[name][body], 9) for name in COEFFICIENTS)
        binding = UsdShade.MaterialBindingAPI(paths[body])
        if body in deformable:
            material = binding.ComputeBoundMaterial("physics")[0]
        else:
            if values not in materials:
                materials[values] = UsdShade.Material.Define(
                    stage, f"/World/Materials/isaac_{len(materials)}"
                )
            material = materials[values]
            binding.Bind(material, UsdShade.Tokens.weakerThanDescendants, "physics")
        _write_coefficients(
            material.GetPrim(), *values, is_deformable=body in deformable
        )
        # The material's constants follow from those of the contacts of the body.
        for index, contact in enumerate(scene.contacts):
            if body in (*contact.first, *contact.second):
                prim = stage.GetPrimAtPath(f"/World/Contacts/contact_{index}")
                prim.GetRelationship("gauge:materials").RemoveTarget(material.GetPath())
                prim.CreateRelationship(
                    "gauge:derived_materials", custom=True
                ).AddTarget(material.GetPath())


def _write_coefficients(
    prim: Usd.Prim, friction: float, restitution: float, *, is_deformable: bool
) -> None:
    """Write contact constants of a body, which follow from those of its pairs."""
    physics = UsdPhysics.MaterialAPI.Apply(prim)
    attributes = [(physics.CreateRestitutionAttr(), restitution)]
    attributes += [
        (one, friction)
        for one in (
            physics.CreateStaticFrictionAttr(),
            physics.CreateDynamicFrictionAttr(),
        )
    ]
    if is_deformable:
        names = ("omniphysics:staticFriction", "omniphysics:dynamicFriction")
        attributes += [(prim.GetAttribute(name), friction) for name in names]
    for attribute, value in attributes:
        attribute.Set(value)
        record_follower(attribute, "the constants in /World/Contacts")


def _write_material_points(
    stage: Usd.Stage, scene: Scene, paths: dict[str, Usd.Prim]
) -> None:
    """Write the mesh vertices and weights that interpolate each marker.

    The vertices are numbered over the meshes of `gauge:bodies`, in that order.
    """
    assert scene.markers is not None
    bodies = {body.name: body for body in scene.deformables}
    nodes = {
        name: bodies[name].pose.to_world(
            np.asarray(paths[name].GetAttribute("points").Get(), dtype=np.float64)
        )
        for name in scene.markers.bodies
    }
    indices, weights = material_points(
        np.asarray(scene.markers.positions_m), nodes, bodies
    )
    prim = stage.GetPrimAtPath("/World/Markers")
    _write(
        prim,
        "gauge:isaac:nodes",
        Sdf.ValueTypeNames.Int4Array,
        [Gf.Vec4i(*row) for row in indices.tolist()],
    )
    _write(
        prim,
        "gauge:isaac:weights",
        Sdf.ValueTypeNames.Double4Array,
        [Gf.Vec4d(*row) for row in weights.tolist()],
    )


def _write(
    prim: Usd.Prim,
    name: str,
    kind: Sdf.ValueTypeName,
    value: Any,
    variability: Sdf.Variability = Sdf.VariabilityVarying,
) -> None:
    prim.CreateAttribute(name, kind, name.startswith("gauge:"), variability).Set(value)
