"""A USD layer in place of a task file: shipped layers change nothing, edits follow physics, and misfits raise errors.

The slide of a cube follows Coulomb's law; hashes are SHA-256 of the bytes of files.
"""

import hashlib
import json
from dataclasses import replace

import gymnasium
import numpy as np
import pytest
from places import first_of_each_kind
from pxr import Gf, Sdf, Usd, UsdUtils, Vt

from gauge_envs import load_experiment
from gauge_envs.errors import AssetError, ParameterError
from gauge_envs.experiments.variants import variants
from gauge_envs.runs.episodes import run_episode, run_episodes
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result_file import (
    load_result,
    recorded_experiment,
    result_file_name,
    write_result,
)
from gauge_envs.runs.score_file import score_file
from gauge_envs.scene import Motion
from gauge_envs.scene.diff import scene_changes
from gauge_envs.scoring.reference import reference_band
from gauge_envs.tools.assets.build import assets_folder
from gauge_envs.tools.compare.comparison import compare

SLIDE, TILTED, BALL = "SlopeSlider-2-wood", "SlopeSlider-3-wood", "BouncingBall-rubber"
G = 9.80665


def shipped(name):
    return assets_folder() / "usd" / f"{name}.usda"


@pytest.fixture
def edited(tmp_path):
    """Writes a changed copy of a shipped layer: edited(name, change)."""

    def make(name, change):
        stage = Usd.Stage.Open(str(shipped(name)))
        change(stage)
        path = tmp_path / f"{name}.usda"
        stage.GetRootLayer().Export(str(path))
        stage.Reload()
        return path

    return make


def setting(prim, **values):
    """Return an edit that sets attributes of a prim; `__` in a name stands for a colon."""

    def change(stage):
        for name, value in values.items():
            attribute = stage.GetPrimAtPath(f"/World/{prim}").GetAttribute(
                name.replace("__", ":")
            )
            assert attribute, name
            attribute.Set(value)

    return change


@pytest.fixture
def slippery(edited):
    return edited(SLIDE, setting("Contacts/contact_0", gauge__friction=0.1))


@pytest.mark.parametrize(
    "name",
    first_of_each_kind(
        (variant.name for variant in variants()), lambda name: name.split("-")[0]
    ),
)
def test_the_shipped_layer_is_the_scene_of_the_task_file(name):
    layer = load_experiment(name, asset=shipped(name))
    assert layer.scene == load_experiment(name).scene
    assert (layer.asset.edited, layer.asset.changes) == (False, ())
    assert layer.asset.sha256 == hashlib.sha256(shipped(name).read_bytes()).hexdigest()


# --- edits reach the simulation ---


def downhill_acceleration(trajectory):
    """Return the acceleration of a slide from rest down 30 degrees [m/s^2], while the whole cube is on the board."""
    on_board = trajectory.times_s < 0.4
    path_m = 1e-3 * trajectory.samples[on_board] @ [np.sqrt(0.75), 0.0, -0.5]
    course = 0.5 * trajectory.times_s[on_board] ** 2
    return float(course @ (path_m - path_m[0]) / (course @ course))


def test_half_the_friction_changes_the_slide_as_coulomb_says(edited, rollout):
    friction = load_experiment(SLIDE).scene.contacts[0].friction
    names = "physics__staticFriction", "physics__dynamicFriction"
    half = setting("Materials/contact_0", **dict.fromkeys(names, 0.5 * friction))
    path = edited(SLIDE, half)
    _, before, _ = rollout(SLIDE)
    env, after, info = rollout(SLIDE, asset=path)
    faster = downhill_acceleration(after) - downhill_acceleration(before)
    assert faster == pytest.approx(G * np.sqrt(0.75) * 0.5 * friction, rel=5e-3)
    assert info["edited"]
    (change,) = env.experiment.asset.changes
    assert str(change).startswith("contact cube/board: friction 0.273673 -> 0.1368")


def test_an_edited_pose_reaches_the_simulation_and_the_reference_stays(edited):
    x, y, z = load_experiment(BALL).scene.body("ball").pose.position_m
    higher = Gf.Vec3d(x, y, z + 0.1)
    path = edited(BALL, setting("ball", xformOp__translate=higher))
    observation, _ = gymnasium.make(f"GAUGE/{BALL}", asset=path).reset(seed=0)
    assert observation["observable"] == pytest.approx(1e3 * np.array(higher), abs=1e-9)
    # The reference stays the same.
    bands = [
        reference_band(load_experiment(BALL, asset=asset)) for asset in (path, None)
    ]
    np.testing.assert_array_equal(bands[0].mean, bands[1].mean)


def test_an_edited_mesh_changes_the_shape(edited):
    name = "NonsmoothContact-1-wood"

    def taller(stage):
        prim = stage.GetPrimAtPath("/World/pyramid/collision_0")
        points = prim.GetAttribute("points")
        stretched = [Gf.Vec3f(x, y, 1.25 * z) for x, y, z in points.Get()]
        points.Set(Vt.Vec3fArray(stretched))

    before = load_experiment(name).scene.body("pyramid").shape
    layer = load_experiment(name, asset=edited(name, taller))
    after = layer.scene.body("pyramid").shape
    assert after.volume_m3 > 1.001 * before.volume_m3
    assert "numbers differ, by up to" in str(layer.asset.changes[0])


def test_edited_samples_drive_the_body(edited, rollout):
    def higher(stage):
        prim = stage.GetPrimAtPath("/World/board")
        translate = prim.GetAttribute("xformOp:translate")
        for frame in translate.GetTimeSamples()[1:]:
            rise = Gf.Vec3d(0.0, 0.0, 1e-3 * min(frame, 20))
            translate.Set(translate.Get(frame) + rise, frame)

    path = edited(TILTED, higher)
    places = []
    for asset in (None, path):
        env, _, _ = rollout(TILTED, asset=asset, frames=30)
        places.append(env.rollout.simulation.body_states(["board"])[0, 0, :3])
    np.testing.assert_allclose(places[1] - places[0], [0.0, 0.0, 0.02], atol=1e-6)


def test_changes_name_the_changed_values():
    scene = load_experiment("SlopeSlider-3-wood").scene
    cube = replace(scene.body("cube"), mass_kg=0.2, motion=Motion.FIXED)
    contact = replace(scene.contacts[1], restitution=0.5)
    after = replace(
        scene,
        bodies=(cube, *(body for body in scene.bodies[1:] if body.name != "ground")),
        contacts=(scene.contacts[0], contact),
        gravity_m_per_s2=1.62,
    )
    assert [*map(str, scene_changes(scene, after))] == [
        "ground: removed",
        "cube: motion dynamic -> fixed",
        "cube: mass_kg 0.0903 -> 0.2",
        "contact cube/ground: restitution 0.223583 -> 0.5",
        "scene: gravity_m_per_s2 9.80665 -> 1.62",
    ]
    assert not list(scene_changes(scene, scene))


# --- results ---


def test_a_result_of_an_edited_scene_is_read_back(slippery, tmp_path):
    result, second = run_episodes(RunRequest(SLIDE, asset=slippery, repeats=2))
    first_m, second_m = (run.trajectory.samples[0] for run in (result, second))
    assert 0.0 < np.abs(np.subtract(first_m, second_m)).max() < 10.0
    file = tmp_path / result_file_name(result)
    assert f".asset-{result.asset['sha256'][:8]}." in file.name
    write_result(result, file)
    again = load_result(file)
    assert again == result
    assert again.is_edited
    assert str(tmp_path) not in file.read_text()
    experiment = recorded_experiment(again)
    assert experiment.scene == load_experiment(SLIDE, asset=slippery).scene
    assert score_file(file)[0].score.rmse == pytest.approx(result.score.rmse)


def test_an_edited_scene_is_another_configuration_and_a_shipped_layer_is_not(slippery):
    task, same, edited = (
        run_episode(RunRequest(SLIDE, asset=asset))
        for asset in (None, shipped(SLIDE), slippery)
    )
    assert result_file_name(task) == result_file_name(same) != result_file_name(edited)
    comparison = compare([task, same, edited])
    assert [
        bool(configuration.asset) for configuration in comparison.configurations
    ] == [False, True]


def test_the_hash_covers_every_file_of_the_stage(tmp_path):
    """A layer uses two others, and one of them a third. An edit of any changes the hash; a move of all does not."""
    folder = tmp_path / "here"
    (folder / "parts").mkdir(parents=True)
    head = '#usda 1.0\n(metersPerUnit = 1\nupAxis = "Z"\n'
    texts = {
        "root.usda": f"{head}timeCodesPerSecond = 30\nendTimeCode = 18\nkilogramsPerUnit = 1\n"
        "subLayers = [@./parts/note.usda@, @./base.usda@])\n",
        "base.usda": shipped(SLIDE).read_text(),
        "parts/looks.usda": '#usda 1.0\n(defaultPrim = "Looks")\ndef Scope "Looks" {}\n',
        "parts/note.usda": f'{head})\nover "World"\n{{\n def "Looks" (payload = @./looks.usda@) {{}}\n}}\n',
    }
    for name, text in texts.items():
        (folder / name).write_text(text)

    def digest(path):
        asset = load_experiment(SLIDE, asset=path).asset
        assert not asset.changes
        return asset.sha256

    hashes = [hashlib.sha256(text.encode()).digest() for text in texts.values()]
    first = digest(folder / "root.usda")
    assert first == hashlib.sha256(b"".join(hashes)).hexdigest()
    moved = folder.rename(tmp_path / "there")
    assert digest(moved / "root.usda") == first
    digests = {first}
    for name, text in texts.items():
        (moved / name).write_text(f"{text}# edited\n")
        digests.add(digest(moved / "root.usda"))
    assert len(digests) == 1 + len(texts)
    package = tmp_path / "slide.usdz"
    assert UsdUtils.CreateNewUsdzPackage(str(shipped(SLIDE)), str(package))
    assert digest(package) == hashlib.sha256(package.read_bytes()).hexdigest()


def test_commands_show_and_mark_an_edited_scene(slippery, gauge, tmp_path):
    shown = gauge("show", SLIDE, "--asset", slippery, "--json")
    change = "contact cube/board: friction 0.273673 -> 0.1"
    assert json.loads(shown.stdout)["asset"]["changes"] == [change]
    run = gauge("run", SLIDE, "--asset", slippery, "--out", tmp_path / "out")
    assert run.exit_code == 0
    assert "published, edited scene" in run.stdout
    assert change.partition(": ")[2] in run.stdout


# --- what does not fit ---


def without_cube(stage):
    for path in ("/World/cube", "/World/Contacts", "/World/Materials"):
        stage.RemovePrim(path)
    for prim in stage.Traverse():
        for relationship in prim.GetRelationships():
            relationship.ClearTargets(True)


def renamed(stage):
    layer = stage.GetRootLayer()
    data = dict(layer.customLayerData)
    data["gauge"] = data["gauge"] | {"variant": "SlopeSlider-2-metal"}
    layer.customLayerData = data


def longer(stage):
    setting("PhysicsScene", gauge__duration_s=2.0)(stage)
    stage.SetEndTimeCode(60)


def slider(stage):
    joint = stage.DefinePrim("/World/slider", "PhysicsPrismaticJoint")
    joint.CreateRelationship("physics:body1").SetTargets([Sdf.Path("/World/cube")])


KINEMATIC = {"gauge__motion": "kinematic", "physics__kinematicEnabled": True}


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        (SLIDE, without_cube, "cube: SlopeSlider-2-wood records this body"),
        (SLIDE, renamed, "it is the scene of SlopeSlider-2-metal"),
        (SLIDE, longer, "it lasts 2 s, but an episode of SlopeSlider-2-wood lasts 0.6"),
        (
            SLIDE,
            setting("cube", **KINEMATIC),
            "it must be dynamic, but it is kinematic",
        ),
        (SLIDE, slider, "/World/slider"),
        (
            "TextileStretching-rayon",
            lambda stage: stage.RemovePrim("/World/Markers"),
            "TextileStretching-rayon records markers, but the file has none",
        ),
    ],
)
def test_a_layer_that_does_not_fit_the_id_raises_an_error(
    name, change, message, edited
):
    with pytest.raises(AssetError, match=message) as caught:
        load_experiment(name, asset=edited(name, change))
    assert f"{name}.usda" in str(caught.value)


@pytest.mark.parametrize(
    ("content", "name", "message"),
    [
        (None, "gone.usda", "cannot be read: No such file"),
        ("PXR-USDC and then nothing", "damaged.usdc", "damaged.usdc"),
        ("solid", "cube.stl", "suffix '.stl' is neither a scene file"),
        ('#usda 1.0\n(upAxis = "Z")\ndef PhysicsScene "P" {}\n', "a.usda", "metersPer"),
    ],
)
def test_a_bad_file_gives_an_error_in_a_line(content, name, message, gauge, tmp_path):
    path = tmp_path / name
    if content is not None:
        path.write_text(content)
    result = gauge("run", SLIDE, "--asset", path, "--out", tmp_path / "out")
    assert result.exit_code == 2
    assert result.stderr.count("\n") == 1
    assert result.stderr.startswith(f"error: {path}: ")
    assert message in result.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "options", [{"parameters": {"cube.friction": 0.1}}, {"drivers": "imported"}]
)
def test_arguments_that_the_file_has_raise_an_error(options):
    with pytest.raises(ParameterError, match=f"{SLIDE}.usda"):
        gymnasium.make(f"GAUGE/{SLIDE}", asset=shipped(SLIDE), **options)
