"""Layers for Isaac Sim state the scene in NVIDIA's published schemas, and the example plays and records them.

Isaac Sim itself runs in no test. `isaac_stub` stands in for it with prescribed motion.
"""

import importlib.util
import sys
import tomllib
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from isaac_stub import StubIsaacSim
from places import ROOT
from pxr import Gf, Sdf, Tf, Usd, UsdShade
from scipy.spatial.transform import Rotation
from usd_rules import usd_faults

from gauge_envs import load_experiment, load_experiment_from_asset
from gauge_envs.backends.mujoco import BackendMuJoCo
from gauge_envs.envs.rollout import LATER_FRAMES
from gauge_envs.errors import AssetError, ParameterError
from gauge_envs.experiments.variants import variants
from gauge_envs.observables.observer import MARKER_REACH_M, observe_markers
from gauge_envs.runs.episodes import run_episode
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.score_file import score_file
from gauge_envs.tools.assets.build import assets_folder
from gauge_envs.tools.assets.isaac_sim import (
    isaac_sim_stage,
    steps_per_second,
    write_isaac_sim_layer,
)

SCHEMAS = tomllib.loads(
    (Path(__file__).parent / "omni_physics_schemas.toml").read_text()
)
PREFIXES = ("omniphysics:", "physx")
VARIABILITY = (Sdf.VariabilityVarying, Sdf.VariabilityUniform)

SUPPORTED = tuple(
    v.name for v in variants() if v.family not in ("RopeWinding", "StickStack")
)
QUICK = (
    "SlopeSlider-3-wood",
    "TableclothPulling-wood",
    "CantileverBeam-soft",
    "FoamTwisting-hard",
)
"""One of each kind of scene; the others are slow."""

EACH = [
    pytest.param(name, marks=() if name in QUICK else pytest.mark.slow)
    for name in SUPPORTED
]


def runner_module():
    """The example, which is a script outside the package."""
    spec = importlib.util.spec_from_file_location(
        "run_layer", ROOT / "examples" / "isaac_sim" / "run_layer.py"
    )
    module = importlib.util.module_from_spec(spec)
    sys.modules["run_layer"] = module
    spec.loader.exec_module(module)
    return module


RUN_LAYER = runner_module()


@cache
def layer_text(name):
    stage = isaac_sim_stage(load_experiment(name))
    return stage.GetRootLayer().ExportToString()


def layer_of(name):
    """A fresh stage with the layer of an experiment."""
    stage = Usd.Stage.CreateInMemory()
    stage.GetRootLayer().ImportFromString(layer_text(name))
    return stage


# --- schemas ---------------------------------------------------------------------------------------------------------


def with_builtins(names):
    for name in names:
        if name in SCHEMAS:
            yield SCHEMAS[name]
            yield from with_builtins(SCHEMAS[name].get("builtin", []))


def schema_faults(stage):
    """What a layer states about PhysX that the published schemas do not have, or have otherwise."""
    return [fault for prim in stage.Traverse() for fault in prim_faults(prim)]


def prim_faults(prim):
    kind = str(prim.GetTypeName())
    names = [kind, *map(str, prim.GetPrimTypeInfo().GetAppliedAPISchemas())]
    for name in names:
        if name.startswith(("OmniPhysics", "Physx")) and name not in SCHEMAS:
            yield f"{prim.GetPath()}: no schema {name}"
    schemas = [*with_builtins(names)]
    for schema in schemas:
        if schema.get("prim_type", kind) != kind:
            yield f"{prim.GetPath()}: a {kind} has a schema of {schema['prim_type']}"
    for one in prim.GetAuthoredProperties():
        name = one.GetName()
        if not name.startswith(PREFIXES):
            continue
        if isinstance(one, Usd.Relationship):
            known = [name for s in schemas if name in s.get("relationships", [])]
            stated = name
        else:
            stated = str(one.GetTypeName()), one.GetVariability(), one.IsCustom()
            known = [
                (
                    s["attributes"][name],
                    VARIABILITY[name in s.get("uniform", [])],
                    False,
                )
                for s in schemas
                if name in s.get("attributes", {})
            ]
        if stated not in known:
            yield f"{one.GetPath()}: {stated}, no applied schema has it: {known}"
        tokens = [s["tokens"][name] for s in schemas if name in s.get("tokens", {})]
        if any(one.Get() not in allowed for allowed in tokens):
            yield f"{one.GetPath()}: {one.Get()} is not allowed"


@pytest.mark.parametrize("name", EACH)
def test_layers_follow_the_published_schemas_and_rules_of_usd(name):
    stage = layer_of(name)
    assert schema_faults(stage) == []
    assert usd_faults(stage) == []


@pytest.mark.parametrize(
    "path", sorted((assets_folder() / "usd").glob("*.usda")), ids=lambda path: path.stem
)
def test_bundled_layers_follow_the_published_schemas(path):
    assert schema_faults(Usd.Stage.Open(str(path))) == []


def test_a_wrong_type_in_a_layer_is_a_fault_of_the_schemas():
    stage = layer_of("TableclothPulling-wood")
    textile = stage.GetPrimAtPath("/World/textile")
    textile.CreateAttribute("omniphysics:weight", Sdf.ValueTypeNames.Float, False)
    assert "no applied schema" in " ".join(schema_faults(stage))


# --- content of the layer --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", EACH)
def test_layers_read_back_as_the_scene(name, tmp_path):
    experiment = load_experiment(name)
    write_isaac_sim_layer(experiment, tmp_path / "layer.usda")
    read = load_experiment_from_asset(name, tmp_path / "layer.usda")
    assert read.scene == experiment.scene
    assert read.asset.changes == ()


@pytest.mark.parametrize(
    ("name", "rate"),
    [
        ("SlopeSlider-2-wood", 180),
        ("TextileFlinging-oxford", 180),
        ("FoamBending-soft", 900),
    ],
)
def test_the_rate_is_the_papers(name, rate):
    experiment = load_experiment(name)
    stage = layer_of(experiment.name)
    assert steps_per_second(experiment.scene) == rate
    scene = stage.GetPrimAtPath("/World/PhysicsScene")
    assert scene.GetAttribute("physxScene:timeStepsPerSecond").Get() == rate
    on_gpu = scene.GetAttribute("physxScene:enableGPUDynamics").Get()
    assert on_gpu is (True if experiment.scene.deformables else None)
    plan = RUN_LAYER.read_plan(stage)
    assert plan.step_count == (plan.frame_count - 1) * rate // 30
    assert plan.coordinates == experiment.coordinates
    assert plan.frame_count == experiment.frame_count + LATER_FRAMES


def material_of(stage, name):
    prim = stage.GetPrimAtPath(f"/World/{name}")
    return (
        UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial("physics")[0].GetPrim()
    )


def attributes(prim, names):
    return [prim.GetAttribute(name).Get() for name in names.split()]


@pytest.mark.parametrize(
    ("name", "touches_itself"),
    [("TextileBending-satin", True), ("TableclothPulling-wood", False)],
)
def test_cloth_has_the_mapped_constants(name, touches_itself):
    """E = k / t, and the bending stiffness of a hinge over 4 t^3 (paper, textile mapping)."""
    (cloth,) = load_experiment(name).scene.deformables
    stage = layer_of(name)
    thickness_m = cloth.thickness_m
    material, prim = (
        material_of(stage, "textile"),
        stage.GetPrimAtPath("/World/textile"),
    )
    assert attributes(
        material,
        "omniphysics:youngsModulus omniphysics:surfaceBendStiffness omniphysics:surfaceThickness",
    ) == pytest.approx(
        [
            cloth.stretch_stiffness_n_per_m / thickness_m,
            cloth.bend_stiffness_n_m_per_rad / (4.0 * thickness_m**3),
            thickness_m,
        ],
        rel=1e-6,
    )
    assert attributes(
        prim, "physxCollision:restOffset physxDeformableBody:selfCollision"
    ) == [pytest.approx(0.5 * thickness_m, rel=1e-6), touches_itself]


def test_foam_has_its_measured_constants_and_a_collider_that_meets_nothing():
    name = "FoamStretching-soft"
    (foam,) = load_experiment(name).scene.deformables
    stage = layer_of(name)
    material, prim = material_of(stage, "foam"), stage.GetPrimAtPath("/World/foam")
    moduli = attributes(material, "omniphysics:youngsModulus omniphysics:poissonsRatio")
    assert moduli == pytest.approx([foam.young_modulus_pa, foam.poisson_ratio])
    collision = "physxCollision:restOffset physics:collisionEnabled"
    assert attributes(prim, collision) == [0.0, True]
    filtered = prim.GetRelationship("physics:filteredPairs").GetTargets()
    assert {path.name for path in filtered} == {"base_1", "base_2", "ground"}


@pytest.mark.parametrize(
    "name",
    [*EACH, pytest.param("WallBreaking-wood", id="WallBreaking")],
)
def test_the_average_of_two_materials_is_the_constant_of_the_pair(name):
    scene = load_experiment(name).scene
    stage = layer_of(name)
    for contact in scene.contacts:
        for pair in scene.colliding_pairs(contact):
            materials = [
                material_of(stage, Tf.MakeValidIdentifier(body)) for body in pair
            ]
            for attribute, expected in (
                ("physics:staticFriction", contact.friction),
                ("physics:dynamicFriction", contact.friction),
                ("physics:restitution", contact.restitution),
            ):
                values = [one.GetAttribute(attribute).Get() for one in materials]
                assert np.mean(values) == pytest.approx(expected, abs=1e-7), pair
            for material in materials:
                omni = material.GetAttribute("omniphysics:dynamicFriction")
                physics = material.GetAttribute("physics:dynamicFriction").Get()
                assert not omni or omni.Get() == physics


@pytest.mark.parametrize("material", ["isaac_0", "body_textile"])
def test_an_edit_of_a_derived_constant_is_an_error(material, tmp_path):
    stage = layer_of("TableclothPulling-wood")
    stage.GetPrimAtPath(f"/World/Materials/{material}").GetAttribute(
        "physics:dynamicFriction"
    ).Set(0.7)
    stage.GetRootLayer().Export(str(tmp_path / "edited.usda"))
    with pytest.raises(
        AssetError,
        match=r"was edited, but it follows from the constants in /World/Contacts",
    ):
        load_experiment_from_asset("TableclothPulling-wood", tmp_path / "edited.usda")


@pytest.mark.parametrize("name", ["RopeWinding-rubber", "StickStack-soft"])
def test_ropes_and_rods_are_refused(name, tmp_path):
    experiment = load_experiment(name)
    with pytest.raises(
        ParameterError,
        match=r"GAUGE/\w+-\w+: body '(rope|rod)' is a (rope|rod), and PhysX .* curves",
    ):
        write_isaac_sim_layer(experiment, tmp_path / "layer.usda")
    assert list(tmp_path.iterdir()) == []


# --- command ---------------------------------------------------------------------------------------------------------


def test_command_writes_what_it_can_and_names_the_rest(tmp_path, gauge):
    result = gauge("data", "isaac-sim", "R*-r*", "--out", tmp_path)
    assert result.exit_code == 0
    assert [path.name for path in tmp_path.iterdir()] == ["RotatingBall-rayon.usda"]
    assert result.stdout.strip().endswith("RotatingBall-rayon.usda")
    assert "left out: GAUGE/RopeWinding-rubber: body 'rope' is a rope" in result.stderr


# --- the example, with a stub of Isaac Sim ---------------------------------------------------------------------------


@pytest.fixture
def play(tmp_path, monkeypatch):
    def run(name, motion, *options):
        layer = tmp_path / f"{name}.usda"
        layer.write_text(layer_text(name))
        stub = StubIsaacSim(motion)
        stub.install(monkeypatch)
        arguments = [str(layer), "--out", str(tmp_path / "out.csv"), *options]
        monkeypatch.setattr(sys, "argv", ["run_layer.py", *arguments])
        return stub, RUN_LAYER.main(arguments), tmp_path / "out.csv"

    return run


@pytest.mark.parametrize("record_hz", [30, 180])
def test_a_rigid_trajectory_has_the_score_of_the_run_that_it_repeats(record_hz, play):
    name = "SlopeSlider-2-wood"
    experiment = load_experiment(name)
    expected = run_episode(RunRequest(name))
    samples = experiment.frame_count - 1 + LATER_FRAMES
    simulation = BackendMuJoCo().build(experiment.scene)
    places_m = []
    for _ in range(6 * samples):
        simulation.advance(1.0 / 180.0)
        places_m.append(simulation.body_states(experiment.recorded)[0, 0, :3])

    def motion(stage, time_s):
        (cube,) = experiment.recorded
        here = places_m[round(180.0 * time_s) - 1].tolist()
        stage.GetPrimAtPath(f"/World/{cube}").GetAttribute("xformOp:translate").Set(
            Gf.Vec3d(*here)
        )

    stub, code, out = play(name, motion, "--record-hz", str(record_hz))
    assert code == 0
    assert stub.log == ["app", "open", "attach", "detach", "close"]
    result, interpolated = score_file(out, variant=name)
    assert interpolated == 0
    assert result.score.rmse == pytest.approx(expected.score.rmse, abs=1e-6)
    if record_hz == 180:
        # The alignment shifts by parts of a frame, and interpolates between the samples.
        assert result.score.rmse_aligned == pytest.approx(
            expected.score.rmse_aligned, abs=1e-6
        )


@pytest.mark.parametrize(
    "kind", ["face_area", "line_curvature", "curvature", "marker_position"]
)
def test_observables_of_the_example_are_those_of_the_package(kind):
    name = {
        "face_area": "FoamBending-soft",
        "line_curvature": "TextileBending-satin",
    }.get(kind, "TextileFlinging-satin")
    experiment = load_experiment(name)
    markers = experiment.scene.markers
    scatter = np.random.default_rng(5).normal(
        scale=0.02, size=(4, len(markers.positions_m), 3)
    )
    points = np.asarray(markers.positions_m) + scatter
    stage = layer_of(experiment.name)
    found = RUN_LAYER.generalized(stage, kind, points)
    observable = next(
        one for one in type(experiment.score.observable) if one.value == kind
    )
    np.testing.assert_allclose(
        found, observe_markers(points, markers, observable), rtol=1e-12, atol=1e-12
    )


@pytest.mark.parametrize(
    "name", ["FoamBending-soft", "TextileFlinging-satin", "TextileStretching-rayon"]
)
def test_markers_are_read_in_the_world_frame(name):
    """The bodies of these experiments are rotated."""
    experiment = load_experiment(name)
    (body,) = experiment.scene.deformables
    assert body.pose.quaternion != (1.0, 0.0, 0.0, 0.0)
    stage = layer_of(name)
    read = RUN_LAYER.reader(stage, RUN_LAYER.read_plan(stage))
    assert (
        np.abs(read() - np.asarray(experiment.scene.markers.positions_m)).max()
        < MARKER_REACH_M
    )


def test_driven_bodies_are_placed_before_every_step(play):
    name = "Turntable-3-wood"
    experiment = load_experiment(name)
    scene, rate = experiment.scene, steps_per_second(experiment.scene)
    stub, code, _ = play(name, lambda stage, time_s: None)
    assert code == 0
    steps = (experiment.frame_count - 1 + LATER_FRAMES) * rate // 30
    expected_s = [(step / rate, 1.0 / rate) for step in range(steps)]
    np.testing.assert_allclose(stub.times_s, expected_s)
    (driver,) = scene.drivers
    placed = stub.placed[f"/World/{driver.body}"]
    assert len(placed) == steps
    for step, matrix in enumerate(placed):
        pose = driver.pose(scene.body(driver.body).pose, (step + 1) / rate)
        np.testing.assert_allclose(
            matrix.ExtractTranslation(), pose.position_m, atol=1e-9
        )
        rotation = Rotation.from_matrix(np.array(matrix.ExtractRotationMatrix()).T)
        assert (rotation * pose.rotation.inv()).magnitude() < 1e-7


def test_a_simulation_that_diverges_writes_no_file(play, capsys):
    def motion(stage, time_s):
        if time_s > 0.1:
            ball = stage.GetPrimAtPath("/World/ball")
            ball.GetAttribute("xformOp:translate").Set(Gf.Vec3d(0.0, 0.0, float("nan")))

    stub, code, out = play("BouncingBall-rubber", motion)
    assert code == 1
    assert "at 0.1333 s a recorded point is not finite" in capsys.readouterr().err
    assert not out.exists()
    assert stub.log[-2:] == ["detach", "close"]


def test_a_file_that_is_no_layer_is_refused(tmp_path, monkeypatch, capsys):
    stub = StubIsaacSim(lambda stage, time_s: None)
    stub.install(monkeypatch)
    monkeypatch.setattr(sys, "argv", ["run_layer.py"])
    bundled = assets_folder() / "usd" / "BouncingBall-rubber.usda"
    for layer, reason in (
        (tmp_path / "none.usda", "no such file"),
        (bundled, "not a layer of 'gauge data isaac-sim'"),
    ):
        assert RUN_LAYER.main([str(layer)]) == 2
        assert reason in capsys.readouterr().err
    assert stub.times_s == []
