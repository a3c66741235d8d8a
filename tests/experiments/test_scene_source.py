"""A USD layer in place of a task file: shipped layers change nothing, edits follow physics, and misfits raise errors.

The slide of a cube follows Coulomb's law; hashes are SHA-256 of the bytes of files.
"""

import hashlib

import gymnasium
import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdUtils

from gauge_envs import load_experiment
from gauge_envs.errors import AssetError, ParameterError
from gauge_envs.runs.episodes import run_episodes
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result_file import (
    load_result,
    recorded_experiment,
    result_file_name,
    write_result,
)
from gauge_envs.runs.score_file import score_file
from gauge_envs.tools.assets.build import assets_folder

SLIDE, TILTED = "SlopeSlider-2-wood", "SlopeSlider-3-wood"
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
