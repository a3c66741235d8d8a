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
from pxr import Gf, Sdf, Tf, Usd, UsdGeom, UsdShade, Vt
from scipy.spatial.transform import Rotation
from usd_rules import usd_faults

from gauge_envs import load_experiment, load_experiment_from_asset
from gauge_envs.backends.mujoco import BackendMuJoCo
from gauge_envs.envs.rollout import LATER_FRAMES
from gauge_envs.errors import AssetError, ParameterError, ResultFileError
from gauge_envs.experiments.variants import variants
from gauge_envs.observables.observer import MARKER_REACH_M, observe_markers
from gauge_envs.runs.episodes import run_episode
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.score_file import score_file
from gauge_envs.scene import Cloth, SoftBody
from gauge_envs.scene.fabrics import Fabric
from gauge_envs.scene.prescribed_motion import prescribed_motions
from gauge_envs.tools.assets.build import assets_folder
from gauge_envs.tools.assets.isaac_sim import (
    isaac_sim_stage,
    steps_per_second,
    unsupported_reason,
    write_isaac_sim_layer,
)
from gauge_envs.tools.usd.isaac_fabric import surface_constants

SCHEMAS = tomllib.loads(
    (Path(__file__).parent / "omni_physics_schemas.toml").read_text()
)
CYLINDERS = "/physics/collisionApproximateCylinders"
PREFIXES = ("omniphysics:", "physx")

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


def path_of(body):
    return f"/World/{Tf.MakeValidIdentifier(body)}"


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
            yield name
            yield from with_builtins(SCHEMAS[name].get("builtin", []))


def schema_faults(stage):
    """What a layer states about PhysX that the published schemas do not have, or have otherwise."""
    faults = []
    for prim in stage.Traverse():
        applied = [str(name) for name in prim.GetPrimTypeInfo().GetAppliedAPISchemas()]
        kind = str(prim.GetTypeName())
        names = applied + ([kind] if kind.startswith("OmniPhysics") else [])
        unknown = [
            name
            for name in names
            if name.startswith(("OmniPhysics", "Physx")) and name not in SCHEMAS
        ]
        faults += [f"{prim.GetPath()}: no schema {name}" for name in unknown]
        schemas = [SCHEMAS[name] for name in with_builtins(names)]
        faults += [
            f"{prim.GetPath()}: a {kind} has a schema of {schema['prim_type']}"
            for schema in schemas
            if schema.get("prim_type", kind) != kind
        ]
        types = {
            name: value
            for schema in schemas
            for name, value in schema.get("attributes", {}).items()
        }
        uniform = {name for schema in schemas for name in schema.get("uniform", [])}
        tokens = {
            name: allowed
            for schema in schemas
            for name, allowed in schema.get("tokens", {}).items()
        }
        relationships = {
            name for schema in schemas for name in schema.get("relationships", [])
        }
        for one in prim.GetAuthoredProperties():
            name = one.GetName()
            if not name.startswith(PREFIXES):
                continue
            place = one.GetPath()
            if isinstance(one, Usd.Relationship):
                faults += (
                    []
                    if name in relationships
                    else [f"{place}: no applied schema has it"]
                )
            elif name not in types:
                faults.append(f"{place}: no applied schema has it")
            else:
                if str(one.GetTypeName()) != types[name]:
                    faults.append(
                        f"{place}: {one.GetTypeName()} instead of {types[name]}"
                    )
                if (one.GetVariability() == Sdf.VariabilityUniform) != (
                    name in uniform
                ):
                    faults.append(f"{place}: the variability differs")
                if one.IsCustom():
                    faults.append(f"{place}: is custom")
                if name in tokens and one.Get() not in tokens[name]:
                    faults.append(f"{place}: {one.Get()} is not allowed")
    return faults


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


@pytest.mark.parametrize(
    ("fault", "found"),
    [
        (
            lambda prim: prim.CreateAttribute(
                "omniphysics:weight", Sdf.ValueTypeNames.Float, False
            ),
            "no applied schema",
        ),
        (
            lambda prim: prim.CreateAttribute(
                "omniphysics:startsAsleep", Sdf.ValueTypeNames.Bool, False
            ),
            "variability",
        ),
        (
            lambda prim: prim.CreateAttribute(
                "physxDeformableBody:sleepThreshold", Sdf.ValueTypeNames.Double
            ),
            "instead",
        ),
        (
            lambda prim: prim.CreateAttribute(
                "physxScene:bounceThreshold", Sdf.ValueTypeNames.Float
            ),
            "no applied",
        ),
        (lambda prim: prim.AddAppliedSchema("PhysxSurfaceDeformableAPI"), "no schema"),
        (
            lambda prim: prim.AddAppliedSchema("OmniPhysicsVolumeDeformableSimAPI"),
            "a Mesh has a schema of TetMesh",
        ),
        (
            lambda prim: prim.RemoveAppliedSchema("OmniPhysicsDeformableBodyAPI"),
            "no applied schema",
        ),
        (
            lambda prim: (
                prim.GetStage()
                .GetAttributeAtPath("/World/PhysicsScene.physxScene:broadphaseType")
                .Set("CPU")
            ),
            "not allowed",
        ),
    ],
)
def test_faults_of_a_layer_are_found(fault, found):
    stage = layer_of("TableclothPulling-wood")
    assert schema_faults(stage) == []
    fault(stage.GetPrimAtPath("/World/textile"))
    assert found in " ".join(schema_faults(stage))


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
    assert (plan.steps_per_second, plan.step_count) == (
        rate,
        (plan.frame_count - 1) * rate // 30,
    )
    assert plan.coordinates == experiment.coordinates
    assert plan.frame_count == experiment.frame_count + LATER_FRAMES


def material_of(stage, name):
    prim = stage.GetPrimAtPath(f"/World/{name}")
    return (
        UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial("physics")[0].GetPrim()
    )


@pytest.mark.parametrize("name", ["TextileBending-satin", "TableclothPulling-wood"])
def test_cloth_has_the_mapped_constants(name):
    experiment = load_experiment(name)
    (cloth,) = experiment.scene.deformables
    assert isinstance(cloth, Cloth)
    stage = layer_of(experiment.name)
    material, prim = (
        material_of(stage, "textile"),
        stage.GetPrimAtPath("/World/textile"),
    )
    thickness, hinge = cloth.thickness_m, cloth.bend_stiffness_n_m_per_rad
    stated = {
        "youngsModulus": cloth.stretch_stiffness_n_per_m / thickness,
        "poissonsRatio": surface_constants(Fabric.of(cloth)).constants[
            "poissons_ratio"
        ],
        "surfaceBendStiffness": hinge / (4.0 * thickness**3),
        "surfaceThickness": thickness,
    }
    for attribute, expected in stated.items():
        assert material.GetAttribute(f"omniphysics:{attribute}").Get() == pytest.approx(
            expected, rel=1e-6
        )
    assert prim.GetAttribute("physxCollision:restOffset").Get() == pytest.approx(
        0.5 * thickness, rel=1e-6
    )
    touches_itself = any(
        {"textile"} <= set(c.first) & set(c.second) for c in experiment.scene.contacts
    )
    assert touches_itself is (name == "TextileBending-satin")
    assert (
        prim.GetAttribute("physxDeformableBody:selfCollision").Get() is touches_itself
    )


@pytest.mark.parametrize(
    "name",
    [
        *EACH,
        pytest.param("WallBreaking-wood", id="WallBreaking"),
        pytest.param("Turntable-1-metal", id="Turntable"),
    ],
)
def test_the_average_of_two_materials_is_the_constant_of_the_pair(name):
    scene = load_experiment(name).scene
    stage = layer_of(name)
    pairs = [
        (contact, pair)
        for contact in scene.contacts
        for pair in scene.colliding_pairs(contact)
    ]
    for contact, pair in pairs:
        own = [material_of(stage, Tf.MakeValidIdentifier(body)) for body in pair]
        for attribute, expected in (
            ("physics:staticFriction", contact.friction),
            ("physics:dynamicFriction", contact.friction),
            ("physics:restitution", contact.restitution),
        ):
            found = 0.5 * sum(
                material.GetAttribute(attribute).Get() for material in own
            )
            assert found == pytest.approx(expected, abs=1e-7), (pair, attribute)
        for material in own:
            if material.HasAttribute("omniphysics:dynamicFriction"):
                friction = material.GetAttribute("physics:dynamicFriction").Get()
                assert (
                    material.GetAttribute("omniphysics:dynamicFriction").Get()
                    == friction
                )


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


def test_an_edit_of_a_pair_counts(tmp_path):
    stage = layer_of("TableclothPulling-wood")
    stage.GetPrimAtPath("/World/Contacts/contact_2").GetAttribute("gauge:friction").Set(
        0.2
    )
    stage.GetRootLayer().Export(str(tmp_path / "edited.usda"))
    read = load_experiment_from_asset(
        "TableclothPulling-wood", tmp_path / "edited.usda"
    )
    assert read.asset.changes == ("contact textile/table: friction 0.1 -> 0.2",)


def test_foam_has_its_measured_constants_and_a_collider_that_meets_nothing():
    experiment = load_experiment("FoamStretching-soft")
    (foam,) = experiment.scene.deformables
    assert isinstance(foam, SoftBody)
    stage = layer_of(experiment.name)
    material, prim = material_of(stage, "foam"), stage.GetPrimAtPath("/World/foam")
    assert material.GetAttribute("omniphysics:youngsModulus").Get() == pytest.approx(
        foam.young_modulus_pa
    )
    assert material.GetAttribute("omniphysics:poissonsRatio").Get() == pytest.approx(
        foam.poisson_ratio
    )
    assert prim.GetAttribute("physxCollision:restOffset").Get() == 0.0
    assert prim.GetAttribute("physics:collisionEnabled").Get()
    filtered = {
        path.name for path in prim.GetRelationship("physics:filteredPairs").GetTargets()
    }
    assert filtered == {"base_1", "base_2", "ground"}


@pytest.mark.parametrize("name", ["RopeWinding-rubber", "StickStack-soft"])
def test_ropes_and_rods_are_refused(name, tmp_path):
    experiment = load_experiment(name)
    assert "curves" in unsupported_reason(experiment.scene)
    with pytest.raises(
        ParameterError,
        match=r"GAUGE/\w+-\w+: body '(rope|rod)' is a (rope|rod), and PhysX",
    ):
        write_isaac_sim_layer(experiment, tmp_path / "layer.usda")
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_cannot_be_created_is_an_error(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ResultFileError, match="file: cannot be created"):
        write_isaac_sim_layer(
            load_experiment("BouncingBall-rubber"), tmp_path / "file" / "layer.usda"
        )


# --- command ---------------------------------------------------------------------------------------------------------


def test_command_writes_what_it_can_and_names_the_rest(tmp_path, gauge):
    result = gauge("data", "isaac-sim", "R*-r*", "--out", tmp_path)
    assert result.exit_code == 0
    assert [path.name for path in tmp_path.iterdir()] == ["RotatingBall-rayon.usda"]
    assert result.stdout.strip().endswith("RotatingBall-rayon.usda")
    assert (
        "GAUGE/RopeWinding-rubber is left out: body 'rope' is a rope" in result.stderr
    )


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


def at_rest(stage, time_s):
    """Motion of a simulation in which nothing moves."""


def bend(points_m, time_s):
    """Deform points smoothly, in every direction and with curvature."""
    x, y, z = points_m.T
    return np.column_stack(
        [
            x + 0.1 * time_s * y,
            y - 0.2 * time_s * z * x,
            z + time_s * (x**2 - 0.5 * y**2),
        ]
    )


def deformed(name):
    """Motion that deforms the meshes of an experiment in their own frames."""
    rest = {}

    def motion(stage, time_s):
        for body in load_experiment(name).scene.deformables:
            path = path_of(body.name)
            points = UsdGeom.PointBased(stage.GetPrimAtPath(path)).GetPointsAttr()
            rest.setdefault(path, np.array(points.Get(), dtype=np.float64))
            moved = np.ascontiguousarray(bend(rest[path], time_s), dtype=np.float32)
            points.Set(Vt.Vec3fArray.FromNumpy(moved))

    return motion


def columns(path):
    header, *rows = path.read_text().splitlines()
    return header.split(","), np.array(
        [row.split(",") for row in rows], dtype=np.float64
    )


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
    "name",
    [
        "TextileBending-satin",
        pytest.param("TextileFlinging-oxford", marks=pytest.mark.slow),
        pytest.param("FoamTwisting-hard", marks=pytest.mark.slow),
        pytest.param("CantileverBeam-soft", marks=pytest.mark.slow),
    ],
)
def test_markers_become_the_generalized_trajectory_of_the_package(name, play):
    experiment = load_experiment(name)
    markers = experiment.scene.markers
    motion = deformed(name)
    _, code, out = play(name, motion)
    assert code == 0
    header, table = columns(out)
    unit = experiment.score.observable.unit
    assert header == [
        "time_s",
        *(f"{column} [{unit}]" for column in experiment.coordinates),
    ]
    np.testing.assert_allclose(table[:, 0], np.arange(len(table)) / 30.0, atol=1e-6)
    # The same meshes, interpolated at the markers with the weights of the layer.
    stage = layer_of(experiment.name)
    prim = stage.GetPrimAtPath("/World/Markers")
    nodes = np.array(prim.GetAttribute("gauge:isaac:nodes").Get())
    weights = np.array(prim.GetAttribute("gauge:isaac:weights").Get())
    bodies = {body.name: body for body in experiment.scene.deformables}
    rest = {
        body: np.array(stage.GetPrimAtPath(path_of(body)).GetAttribute("points").Get())
        for body in markers.bodies
    }
    tracked = np.stack(
        [
            np.einsum(
                "mk,mkc->mc",
                weights,
                np.concatenate(
                    [
                        bodies[b].pose.to_world(bend(r.astype(float), k / 30.0))
                        for b, r in rest.items()
                    ]
                )[nodes],
            )
            for k in range(len(table))
        ]
    )
    assert np.abs(tracked[0] - np.asarray(markers.positions_m)).max() < 0.01
    expected = observe_markers(tracked, markers, experiment.score.observable)
    assert np.abs(expected[-1] - expected[0]).max() > 1e-3
    np.testing.assert_allclose(table[:, 1:], expected, rtol=2e-4, atol=2e-4)
    result, interpolated = score_file(out, variant=name)
    assert interpolated == 0
    assert len(result.trajectory.times_s) >= experiment.frame_count


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


@pytest.mark.parametrize(
    "name",
    ["Turntable-3-wood", pytest.param("FoamTwisting-hard", marks=pytest.mark.slow)],
)
def test_driven_bodies_are_placed_before_every_step(name, play):
    experiment = load_experiment(name)
    scene, rate = experiment.scene, steps_per_second(experiment.scene)
    stub, code, _ = play(name, at_rest)
    assert code == 0
    steps = (experiment.frame_count - 1 + LATER_FRAMES) * rate // 30
    np.testing.assert_allclose(
        stub.times_s, [(step / rate, 1.0 / rate) for step in range(steps)]
    )
    (driver,) = scene.drivers
    placed = stub.placed[path_of(driver.body)]
    assert len(placed) == steps
    (motion,) = prescribed_motions(scene, steps / rate, interval_s=1.0 / rate)
    still = np.zeros((1, motion.motion_count))
    for step, matrix in enumerate(placed):
        pose = driver.pose(scene.body(driver.body).pose, (step + 1) / rate)
        np.testing.assert_allclose(
            matrix.ExtractTranslation(), pose.position_m, atol=1e-9
        )
        turned = Rotation.from_matrix(np.array(matrix.ExtractRotationMatrix()).T)
        assert (
            turned * Rotation.from_quat(pose.quaternion, scalar_first=True).inv()
        ).magnitude() < 1e-7
        if step + 1 < steps:
            start_m = motion.targets(step + 1, still)[0, 0, :3]
            np.testing.assert_allclose(matrix.ExtractTranslation(), start_m, atol=1e-9)


@pytest.mark.parametrize(
    ("name", "deformable"),
    [("BouncingBall-rubber", {}), ("FoamStretching-soft", {CYLINDERS: True})],
)
def test_results_are_written_to_the_stage_by_its_settings(name, deformable, play):
    stub, code, _ = play(name, at_rest)
    assert code == 0
    assert stub.settings == {
        "/physics/fabricEnabled": False,
        "/physics/suppressReadback": False,
        "/physics/updateToUsd": True,
        "/physics/updateParticlesToUsd": True,
        **deformable,
    }


def test_a_stage_that_receives_nothing_is_reported(play, capsys):
    _, code, out = play("BouncingBall-rubber", at_rest)
    assert code == 0
    assert "no recorded point moved" in capsys.readouterr().err
    assert out.is_file()


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


BUNDLED = assets_folder() / "usd" / "BouncingBall-rubber.usda"


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (None, "no such file"),
        ("not USD", "cannot open the file"),
        (BUNDLED.read_text(), "not a layer of 'gauge data isaac-sim'"),
    ],
    ids=["none", "no USD", "of another command"],
)
def test_a_file_that_is_no_layer_is_refused(
    content, reason, tmp_path, monkeypatch, capsys
):
    stub = StubIsaacSim(at_rest)
    stub.install(monkeypatch)
    monkeypatch.setattr(sys, "argv", ["run_layer.py"])
    layer = tmp_path / "layer.usda"
    if content is not None:
        layer.write_text(content)
    assert RUN_LAYER.main([str(layer)]) == 2
    assert reason in capsys.readouterr().err
    assert stub.times_s == []
