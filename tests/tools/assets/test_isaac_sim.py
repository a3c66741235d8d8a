"""Layers for Isaac Sim state the scene in NVIDIA's published schemas, and the example plays and records them.

Isaac Sim itself runs in no test: the motion of a run of this package stands in for it.
"""

import importlib.util
import sys
import tomllib
from pathlib import Path
from types import SimpleNamespace

import gymnasium
import numpy as np
import pytest
from places import ROOT
from pxr import Gf, Sdf, Tf, Usd, UsdGeom, UsdShade
from scipy.spatial.transform import Rotation

from gauge_envs import load_experiment
from gauge_envs.errors import AssetError
from gauge_envs.experiments.variants import variants
from gauge_envs.observables.kinds import Observable
from gauge_envs.observables.observer import MAX_MARKER_DISTANCE_M, observe_markers
from gauge_envs.runs.score_file import score_file
from gauge_envs.tools.assets.isaac_sim import isaac_sim_stage

SCHEMAS = tomllib.loads(
    (Path(__file__).parent / "omni_physics_schemas.toml").read_text()
)
PREFIXES = ("omniphysics:", "physx")
VARIABILITY = (Sdf.VariabilityVarying, Sdf.VariabilityUniform)

QUICK = (
    "SlopeSlider-3-wood",
    "TableclothPulling-wood",
    "CantileverBeam-soft",
    "FoamTwisting-hard",
)
"""One of each kind of scene; the others are slow."""

EACH = [
    pytest.param(name, marks=() if name in QUICK else pytest.mark.slow)
    for name in (variant.name for variant in variants())
    if not name.startswith(("RopeWinding", "StickStack"))
]


def layer_of(name):
    return isaac_sim_stage(load_experiment(name))


# --- schemas ---------------------------------------------------------------------------------------------------------


def with_builtins(names):
    for name in names:
        if name in SCHEMAS:
            yield SCHEMAS[name]
            yield from with_builtins(SCHEMAS[name].get("builtin", []))


def schema_faults(prim):
    """Return PhysX attributes of a prim that the published schemas lack, or define differently."""
    kind = str(prim.GetTypeName())
    names = [kind, *map(str, prim.GetPrimTypeInfo().GetAppliedAPISchemas())]
    for name in names:
        if name.startswith(("OmniPhysics", "Physx")) and name not in SCHEMAS:
            yield f"{prim.GetPath()}: no schema {name}"
    schemas = [*with_builtins(names)]
    for schema in schemas:
        if schema.get("prim_type", kind) != kind:
            yield f"{prim.GetPath()}: a {kind} has a schema of {schema['prim_type']}"
    for attribute in prim.GetAuthoredProperties():
        name = attribute.GetName()
        if not name.startswith(PREFIXES):
            continue
        if isinstance(attribute, Usd.Relationship):
            assert any(name in schema.get("relationships", []) for schema in schemas)
            continue
        assert not attribute.IsCustom()
        written = str(attribute.GetTypeName()), attribute.GetVariability()
        known = [
            written
            == (
                schema["attributes"][name],
                VARIABILITY[name in schema.get("uniform", [])],
            )
            for schema in schemas
            if name in schema.get("attributes", {})
        ]
        tokens = [
            schema["tokens"][name]
            for schema in schemas
            if name in schema.get("tokens", {})
        ]
        if not any(known) or any(attribute.Get() not in allowed for allowed in tokens):
            yield f"{attribute.GetPath()}: no applied schema has it so"


@pytest.mark.parametrize("name", EACH)
def test_layers_follow_the_published_schemas_and_read_back_as_the_scene(name, tmp_path):
    experiment = load_experiment(name)
    stage = isaac_sim_stage(experiment)
    stage.GetRootLayer().Export(str(tmp_path / "layer.usda"))
    assert [fault for prim in stage.Traverse() for fault in schema_faults(prim)] == []
    read = load_experiment(name, asset=tmp_path / "layer.usda")
    assert read.scene == experiment.scene
    assert read.asset.changes == ()


# --- content of the layer --------------------------------------------------------------------------------------------


def material_of(stage, name):
    binding = UsdShade.MaterialBindingAPI(stage.GetPrimAtPath(f"/World/{name}"))
    return binding.ComputeBoundMaterial("physics")[0].GetPrim()


def attributes(prim, names):
    return [prim.GetAttribute(name).Get() for name in names.split()]


@pytest.mark.parametrize(
    ("name", "rate", "on_gpu"),
    [("SlopeSlider-2-wood", 180, None), ("FoamBending-soft", 900, True)],
)
def test_the_rate_is_the_papers(name, rate, on_gpu):
    stage = layer_of(name)
    scene = stage.GetPrimAtPath("/World/PhysicsScene")
    names = "physxScene:timeStepsPerSecond physxScene:enableGPUDynamics"
    assert attributes(scene, names) == [rate, on_gpu]
    plan = RUN_LAYER.read_plan(stage)
    assert plan.step_count == (plan.frame_count - 1) * rate // 30
    assert plan.frame_count == load_experiment(name).frame_count


@pytest.mark.parametrize(
    ("name", "touches_itself"),
    [("TextileBending-satin", True), ("TableclothPulling-wood", False)],
)
def test_cloth_has_the_mapped_constants(name, touches_itself):
    """E = k / t, and the bending stiffness of a hinge over 4 t^3 (paper, textile mapping)."""
    (cloth,) = load_experiment(name).scene.deformables
    stage = layer_of(name)
    thickness_m = cloth.thickness_m
    names = "omniphysics:youngsModulus omniphysics:surfaceBendStiffness omniphysics:surfaceThickness"
    expected = [
        cloth.stretch_stiffness_n_per_m / thickness_m,
        cloth.bend_stiffness_n_m_per_rad / (4.0 * thickness_m**3),
        thickness_m,
    ]
    constants = attributes(material_of(stage, "textile"), names)
    assert constants == pytest.approx(expected, rel=1e-6)
    prim = stage.GetPrimAtPath("/World/textile")
    names = "physxCollision:restOffset physxDeformableBody:selfCollision"
    half_m = pytest.approx(0.5 * thickness_m, rel=1e-6)
    assert attributes(prim, names) == [half_m, touches_itself]


def test_foam_has_its_measured_constants_and_a_collider_that_meets_nothing():
    (foam,) = load_experiment("FoamStretching-soft").scene.deformables
    stage = layer_of("FoamStretching-soft")
    names = "omniphysics:youngsModulus omniphysics:poissonsRatio"
    moduli = attributes(material_of(stage, "foam"), names)
    assert moduli == pytest.approx([foam.young_modulus_pa, foam.poisson_ratio])
    prim = stage.GetPrimAtPath("/World/foam")
    collision = "physxCollision:restOffset physics:collisionEnabled"
    assert attributes(prim, collision) == [0.0, True]
    filtered = prim.GetRelationship("physics:filteredPairs").GetTargets()
    assert {path.name for path in filtered} == {"base_1", "base_2", "ground"}


@pytest.mark.parametrize(
    "name", ["SlopeSlider-3-wood", "TableclothPulling-wood", "WallBreaking-wood"]
)
def test_the_average_of_two_materials_is_the_constant_of_the_pair(name):
    scene = load_experiment(name).scene
    stage = layer_of(name)
    names = "physics:staticFriction physics:dynamicFriction physics:restitution"
    for contact in scene.contacts:
        expected = [contact.friction, contact.friction, contact.restitution]
        for pair in scene.colliding_pairs(contact):
            paths = map(Tf.MakeValidIdentifier, pair)
            values = [attributes(material_of(stage, path), names) for path in paths]
            assert np.mean(values, axis=0) == pytest.approx(expected, abs=1e-7)


def test_an_edit_of_a_derived_constant_is_an_error(tmp_path):
    stage = layer_of("TableclothPulling-wood")
    material = stage.GetPrimAtPath("/World/Materials/isaac_0")
    material.GetAttribute("physics:dynamicFriction").Set(0.7)
    stage.GetRootLayer().Export(str(tmp_path / "edited.usda"))
    with pytest.raises(
        AssetError, match="follows from the constants in /World/Contacts"
    ):
        load_experiment("TableclothPulling-wood", asset=tmp_path / "edited.usda")


def test_command_writes_what_it_can_and_names_the_rest(tmp_path, gauge):
    result = gauge("data", "isaac-sim", "R*-r*", "--out", tmp_path)
    assert result.exit_code == 0
    assert [path.name for path in tmp_path.iterdir()] == ["RotatingBall-rayon.usda"]
    assert result.stdout.strip().endswith("RotatingBall-rayon.usda")
    assert "left out: GAUGE/RopeWinding-rubber: body 'rope' is a rope" in result.stderr


# --- the example -----------------------------------------------------------------------------------------------------


def runner_module():
    """The example, which is a script outside the package."""
    path = ROOT / "examples" / "isaac_sim" / "run_layer.py"
    spec = importlib.util.spec_from_file_location("run_layer", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules["run_layer"] = module
    spec.loader.exec_module(module)
    return module


RUN_LAYER = runner_module()


def test_the_example_drives_bodies_and_scores_as_the_run_that_it_repeats(tmp_path):
    name, rate = "Turntable-3-wood", 180
    env = gymnasium.make(f"GAUGE/{name}").unwrapped
    env.reset(seed=0)
    env.rollout.play()
    places_m = env.trajectory().bodies[:, 0, :3].tolist()
    stage = layer_of(name)
    cube, plate = map(stage.GetPrimAtPath, ("/World/cube", "/World/plate"))
    placed = []

    def step(interval_s, time_s):
        frame = min(round(30.0 * (time_s + interval_s)), len(places_m) - 1)
        cube.GetAttribute("xformOp:translate").Set(Gf.Vec3d(*places_m[frame]))
        placed.append(UsdGeom.Xformable(plate).ComputeLocalToWorldTransform(1e6))

    simulation = SimpleNamespace(
        stage=stage, start=lambda: None, step=step, show=lambda: None
    )
    plan = RUN_LAYER.read_plan(stage)
    points_m = RUN_LAYER.record(simulation, plan, 30)
    values = RUN_LAYER.generalized(stage, plan.observable, points_m)
    RUN_LAYER.write_csv(tmp_path / "out.csv", plan, values, 30)
    result, _ = score_file(tmp_path / "out.csv", variant=name)
    assert result.score.rmse == pytest.approx(env.score().rmse, abs=1e-6)
    scene = env.experiment.scene
    assert len(placed) == plan.step_count
    for index, matrix in enumerate(placed):
        pose = scene.drivers[0].pose(scene.body("plate").pose, (index + 1) / rate)
        assert matrix.ExtractTranslation() == pytest.approx(pose.position_m, abs=1e-9)
        rotation = Rotation.from_matrix(np.array(matrix.ExtractRotationMatrix()).T)
        assert (rotation * pose.rotation.inv()).magnitude() < 1e-7


@pytest.mark.parametrize(
    ("name", "observable"),
    [
        ("FoamBending-soft", Observable.FACE_AREA),
        ("TextileBending-satin", Observable.LINE_CURVATURE),
        ("TextileFlinging-satin", Observable.CURVATURE),
    ],
)
def test_markers_and_observables_of_the_example_are_those_of_the_package(
    name, observable
):
    markers = load_experiment(name).scene.markers
    stage = layer_of(name)
    read_m = RUN_LAYER.reader(stage, RUN_LAYER.read_plan(stage))()
    assert np.abs(read_m - np.array(markers.positions_m)).max() < MAX_MARKER_DISTANCE_M
    points_m = read_m + np.random.default_rng(5).normal(scale=0.02, size=read_m.shape)
    values = RUN_LAYER.generalized(stage, observable.value, points_m[None])
    expected = observe_markers(points_m[None], markers, observable)
    np.testing.assert_allclose(values, expected, rtol=1e-12, atol=1e-12)
