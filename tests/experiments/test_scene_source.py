"""USD layers as the source of a scene: shipped layers change nothing, edits count, misfits are reported."""

import hashlib
import json
from dataclasses import replace

import gymnasium
import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdUtils, Vt

from gauge_envs import load_experiment, load_experiment_from_asset
from gauge_envs.errors import AssetError, ParameterError, UnsupportedSceneError
from gauge_envs.experiments.variants import variants
from gauge_envs.runs.batch import run_many
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
from gauge_envs.tools.compare.report import comparison_rows

ALL = tuple(variant.name for variant in variants())
SLIDE = "SlopeSlider-2-wood"
TILTED = "SlopeSlider-3-wood"
QUICK = (
    "BouncingBall-rubber",
    "NonsmoothContact-2-wood",
    "Pendulum-metal",
    "Turntable-2-plastic",
    "StickStack-soft",
)
"""Of each kind one id; `test_usd_scenes.py` reads the layers of all."""
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


def setting(**values):
    """An edit that sets attributes, by prim path and name with `__` for the colon of the one or the other."""

    def change(stage):
        for place, value in values.items():
            prim, _, name = place.partition("__")
            attribute = stage.GetPrimAtPath(
                f"/World/{prim.replace('_at_', '/')}"
            ).GetAttribute(name.replace("__", ":"))
            assert attribute, place
            attribute.Set(value)

    return change


# --- the shipped layers ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=() if name in QUICK else pytest.mark.slow)
        for name in ALL
    ],
)
def test_the_shipped_layer_is_the_task_files_scene(name):
    found = load_experiment_from_asset(name, shipped(name))
    assert found.scene == load_experiment(name).scene
    assert (found.asset.edited, found.asset.changes) == (False, ())
    assert found.asset.sha256 == hashlib.sha256(shipped(name).read_bytes()).hexdigest()


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=() if name in QUICK[:4] else pytest.mark.slow)
        for name in QUICK
    ],
)
def test_the_shipped_layer_gives_the_same_trajectory_bit_for_bit(name, rollout):
    """One id of each kind: the scenes of all layers equal those of the task files."""
    _, task, _ = rollout(name, frames=60)
    env, usd, info = rollout(name, asset=shipped(name), frames=60)
    np.testing.assert_array_equal(usd.samples, task.samples)
    assert not env.experiment.edited
    assert "edited" not in info


# --- edits reach the simulation --------------------------------------------------------------------------------------


def downhill_acceleration(trajectory):
    """Acceleration of a slide from rest down 30 degrees [m/s^2], while the whole cube is on the board."""
    on_board = trajectory.times_s < 0.4
    way = 1e-3 * trajectory.samples[on_board] @ [np.sqrt(0.75), 0.0, -0.5]
    course = 0.5 * trajectory.times_s[on_board] ** 2
    return float(course @ (way - way[0]) / (course @ course))


@pytest.mark.parametrize(
    "attributes",
    [
        {"Contacts_at_contact_0__gauge__friction": 0.5},
        {
            "Materials_at_contact_0__physics__staticFriction": 0.5,
            "Materials_at_contact_0__physics__dynamicFriction": 0.5,
        },
    ],
    ids=["gauge double", "standard attribute"],
)
def test_half_the_friction_changes_the_slide_as_the_law_says(
    attributes, edited, rollout
):
    friction = load_experiment(SLIDE).scene.contacts[0].friction
    path = edited(
        SLIDE,
        setting(**{place: share * friction for place, share in attributes.items()}),
    )
    _, before, _ = rollout(SLIDE)
    env, after, info = rollout(SLIDE, asset=path)
    law = G * np.sqrt(0.75) * 0.5 * friction
    assert downhill_acceleration(after) - downhill_acceleration(
        before
    ) == pytest.approx(law, rel=5e-3)
    assert info["edited"]
    (change,) = env.experiment.asset.changes
    assert change.startswith("contact cube/board: friction 0.273673 -> 0.1368")


def test_an_edited_mass_reaches_the_simulation(edited):
    path = edited("Pendulum-metal", setting(ball__gauge__mass_kg=0.5))
    env = gymnasium.make("GAUGE/Pendulum-metal", asset=path)
    assert env.unwrapped.rollout.simulation.model.body("ball").mass[0] == 0.5
    assert len(env.unwrapped.experiment.asset.changes) == 1
    assert env.unwrapped.experiment.asset.changes[0].startswith("ball: mass_kg ")
    assert env.unwrapped.experiment.asset.changes[0].endswith(" -> 0.5")


def test_an_edited_pose_moves_the_start(edited, rollout):
    start = load_experiment("BouncingBall-rubber").scene.body("ball").pose.position_m
    higher = (start[0], start[1], start[2] + 0.1)
    path = edited(
        "BouncingBall-rubber", setting(ball__xformOp__translate=Gf.Vec3d(*higher))
    )
    _, trajectory, _ = rollout("BouncingBall-rubber", asset=path)
    np.testing.assert_allclose(trajectory.samples[0], 1e3 * np.array(higher), atol=1e-9)


def test_an_edited_mesh_changes_the_shape(edited):
    name = "NonsmoothContact-1-wood"

    def taller(stage):
        points = stage.GetPrimAtPath("/World/pyramid/collision_0").GetAttribute(
            "points"
        )
        points.Set(
            Vt.Vec3fArray([Gf.Vec3f(x, y, 1.25 * z) for x, y, z in points.Get()])
        )

    before = load_experiment(name).scene.body("pyramid").shape
    found = load_experiment_from_asset(name, edited(name, taller))
    after = found.scene.body("pyramid").shape
    assert after.volume_m3 > 1.001 * before.volume_m3
    assert "numbers differ, by up to" in found.asset.changes[0]


def test_edited_samples_drive_the_body(edited, rollout):
    def higher(stage):
        translate = stage.GetPrimAtPath("/World/board").GetAttribute(
            "xformOp:translate"
        )
        for frame in translate.GetTimeSamples()[1:]:
            translate.Set(
                translate.Get(frame) + Gf.Vec3d(0.0, 0.0, 1e-3 * min(frame, 20)), frame
            )

    path = edited(TILTED, higher)
    before, _, _ = rollout(TILTED)
    after, _, _ = rollout(TILTED, asset=path)
    driven = [
        env.rollout.simulation.body_states(["board"])[0, 0, :3]
        for env in (before, after)
    ]
    np.testing.assert_allclose(driven[1] - driven[0], [0.0, 0.0, 0.02], atol=1e-6)
    assert after.experiment.asset.edited


def test_jitter_and_repeats_start_from_the_layer(edited):
    path = edited(SLIDE, setting(Contacts_at_contact_0__gauge__friction=0.1))
    results = run_episodes(RunRequest(SLIDE, repeats=2, asset=path))
    assert all(result.is_edited for result in results)
    starts = [
        result.trajectory.samples[0]
        for result in results
        if result.trajectory is not None
    ]
    assert 0.0 < np.abs(np.subtract(*starts)).max() < 10.0


def test_the_reference_stays_that_of_the_calibrated_scene(edited):
    name = "SlopeSlider-1-wood"
    start = load_experiment(name).scene.body("cube").pose.position_m
    moved = Gf.Vec3d(start[0] + 0.01, start[1], start[2])
    found = load_experiment_from_asset(
        name, edited(name, setting(cube__xformOp__translate=moved))
    )
    bands = [reference_band(one) for one in (found, load_experiment(name))]
    np.testing.assert_array_equal(bands[0].mean, bands[1].mean)


# --- what differs, in words ------------------------------------------------------------------------------------------


def test_changes_name_what_was_changed():
    scene = load_experiment("SlopeSlider-3-wood").scene
    cube = replace(scene.body("cube"), mass_kg=0.2, motion=Motion.FIXED)
    contact = replace(scene.contacts[1], restitution=0.5)
    after = replace(
        scene,
        bodies=(cube, *(body for body in scene.bodies[1:] if body.name != "ground")),
        contacts=(scene.contacts[0], contact),
        gravity_m_per_s2=1.62,
    )
    assert list(scene_changes(scene, after)) == [
        "ground: removed",
        "cube: motion dynamic -> fixed",
        "cube: mass_kg 0.0903 -> 0.2",
        "contact cube/ground: restitution 0.223583 -> 0.5",
        "scene: gravity_m_per_s2 9.80665 -> 1.62",
    ]
    assert list(scene_changes(scene, scene)) == []
    assert list(scene_changes(scene, replace(scene, bodies=scene.bodies[::-1]))) == [
        "bodies: in another order"
    ]


@pytest.mark.parametrize("name", ALL[::7])
def test_every_scene_that_differs_has_changes(name):
    scene = load_experiment(name).scene
    for other in (load_experiment(one).scene for one in ALL[::5]):
        assert bool(list(scene_changes(scene, other))) is (scene != other)


# --- results ---------------------------------------------------------------------------------------------------------


@pytest.fixture
def slippery(edited):
    return edited(SLIDE, setting(Contacts_at_contact_0__gauge__friction=0.1))


def test_a_result_says_what_it_ran_and_reads_back(slippery, tmp_path):
    result = run_episode(RunRequest(SLIDE, asset=slippery))
    file = tmp_path / result_file_name(result)
    assert f".asset-{result.asset['sha256'][:8]}." in file.name
    write_result(result, file)
    again = load_result(file)
    assert again == result
    assert str(tmp_path) not in file.read_text()
    found = recorded_experiment(again)
    assert found.scene == load_experiment_from_asset(SLIDE, slippery).scene
    assert found.edited
    scored = score_file(file)[0].score
    assert scored.rmse == result.score.rmse
    assert "scene" not in result.to_dict(trajectory=False)["asset"]


def test_the_hash_covers_every_file_that_the_stage_is_composed_of(tmp_path):
    """A layer over two others of which one refers to a third: an edit of any is another asset; a move of all is not."""
    folder = tmp_path / "here"
    (folder / "parts").mkdir(parents=True)
    (folder / "base.usda").write_bytes(shipped(SLIDE).read_bytes())
    (folder / "parts" / "looks.usda").write_text(
        '#usda 1.0\n(defaultPrim = "Looks")\ndef Scope "Looks" {}\n'
    )
    (folder / "parts" / "note.usda").write_text(
        '#usda 1.0\n(metersPerUnit = 1\nupAxis = "Z")\nover "World"\n{\n def "Looks" (payload = @./looks.usda@) {}\n}\n'
    )
    root = folder / "root.usda"
    root.write_text(
        '#usda 1.0\n(metersPerUnit = 1\nupAxis = "Z"\ntimeCodesPerSecond = 30\nstartTimeCode = 0\nendTimeCode = 18\n'
        "kilogramsPerUnit = 1\nsubLayers = [@./parts/note.usda@, @./base.usda@])\n"
    )

    def digest(path):
        asset = load_experiment_from_asset(SLIDE, path).asset
        assert not asset.changes
        return asset.sha256

    files = [
        root,
        *(
            folder / name
            for name in ("base.usda", "parts/looks.usda", "parts/note.usda")
        ),
    ]
    parts = b"".join(hashlib.sha256(file.read_bytes()).digest() for file in files)
    first = digest(root)
    assert first == hashlib.sha256(parts).hexdigest()
    moved = folder.rename(tmp_path / "there")
    assert digest(moved / "root.usda") == first
    (moved / "unused.usda").write_text("#usda 1.0\n")
    assert digest(moved / "root.usda") == first
    seen = {first}
    for file in files:
        path = moved / file.relative_to(folder)
        path.write_text(path.read_text() + "# edited\n")
        seen.add(digest(moved / "root.usda"))
    assert len(seen) == 1 + len(files)


def test_the_hash_of_a_package_is_that_of_its_bytes(tmp_path):
    path = tmp_path / "slide.usdz"
    assert UsdUtils.CreateNewUsdzPackage(str(shipped(SLIDE)), str(path))
    found = load_experiment_from_asset(SLIDE, path)
    assert found.asset.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()


def test_a_layer_without_changes_is_filed_as_the_task_files(tmp_path):
    results = [
        run_episode(RunRequest(SLIDE, asset=asset)) for asset in (None, shipped(SLIDE))
    ]
    assert len({result_file_name(result) for result in results}) == 1
    assert len(compare(results).configurations) == 1


def test_compare_keeps_edited_scenes_apart(slippery):
    comparison = compare(
        [run_episode(RunRequest(SLIDE)), run_episode(RunRequest(SLIDE, asset=slippery))]
    )
    assert [bool(one.asset) for one in comparison.configurations] == [False, True]
    message = json.dumps(comparison_rows(comparison, ("rmse",)))
    assert f"edited scene {slippery.name}" in message


def test_resume_takes_only_a_result_of_the_same_file(slippery, tmp_path):
    def run(asset, notes):
        return next(
            run_many(
                [RunRequest(SLIDE, asset=asset)],
                out=tmp_path / "out",
                resume=True,
                notify=notes.append,
            )
        )

    first, notes = run(slippery, []), []
    assert run(slippery, notes).created == first.created
    assert not notes
    run(shipped(SLIDE), notes)
    assert len(list((tmp_path / "out").iterdir())) == 2


# --- what does not fit -----------------------------------------------------------------------------------------------


def without(path):
    def change(stage):
        for found in (path, "/World/Contacts", "/World/Materials"):
            stage.RemovePrim(found)
        for prim in stage.Traverse():
            for relationship in prim.GetRelationships():
                relationship.ClearTargets(True)

    return change


def unnamed(name):
    """A layer that names another variant, or none."""

    def change(stage):
        layer = stage.GetRootLayer()
        data = dict(layer.customLayerData)
        data["gauge"] = {
            key: value for key, value in data["gauge"].items() if key != "variant"
        } | ({"variant": name} if name else {})
        layer.customLayerData = data

    return change


def longer(stage):
    stage.GetPrimAtPath("/World/PhysicsScene").GetAttribute("gauge:duration_s").Set(2.0)
    stage.SetEndTimeCode(60)


def fixed(stage):
    stage.GetPrimAtPath("/World/cube").GetAttribute("gauge:motion").Set("kinematic")
    stage.GetPrimAtPath("/World/cube").GetAttribute("physics:kinematicEnabled").Set(
        True
    )


def massless(stage):
    prim = stage.GetPrimAtPath("/World/cube")
    for name in ("gauge:mass_kg", "physics:mass"):
        prim.RemoveProperty(name)


def slider(stage):
    joint = stage.DefinePrim("/World/slider", "PhysicsPrismaticJoint")
    joint.CreateRelationship("physics:body1").SetTargets([Sdf.Path("/World/cube")])


def unmarked(stage):
    stage.RemovePrim("/World/Markers")


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        (
            SLIDE,
            without("/World/cube"),
            "cube: no body of that name, which SlopeSlider-2-wood records; it has: board",
        ),
        (
            SLIDE,
            unnamed("SlopeSlider-2-metal"),
            "it is the scene of SlopeSlider-2-metal, not of SlopeSlider-2-wood",
        ),
        (SLIDE, longer, "it lasts 2 s, but an episode of SlopeSlider-2-wood lasts 0.6"),
        (SLIDE, fixed, "it must move under forces"),
        (SLIDE, massless, "/World/cube.*mass"),
        (SLIDE, slider, "/World/slider"),
        ("TextileStretching-rayon", unmarked, "no markers, which TextileStretching-ra"),
    ],
)
def test_what_does_not_fit_the_id_is_reported(name, change, message, edited):
    with pytest.raises(AssetError, match=message) as caught:
        load_experiment_from_asset(name, edited(name, change))
    assert f"{name}.usda" in str(caught.value)


def test_a_layer_that_names_no_variant_may_stand_for_any_that_it_fits(edited):
    path = edited("SlopeSlider-2-plastic", unnamed(""))
    # Metal has as many frames as wood, plastic two fewer: a layer also says how long it lasts.
    with pytest.raises(AssetError, match="it lasts"):
        load_experiment_from_asset(SLIDE, path)
    found = load_experiment_from_asset(
        SLIDE, edited("SlopeSlider-2-metal", unnamed(""))
    )
    assert "cube: mass_kg 0.0903 -> 0.3397" in found.asset.changes


@pytest.mark.parametrize(
    ("content", "name", "message"),
    [
        (None, "gone.usda", "cannot be read: No such file"),
        (b"", "empty.usda", "empty.usda"),
        (b"PXR-USDC and then nothing", "damaged.usdc", "damaged.usdc"),
        (b"solid", "cube.stl", "suffix '.stl' is neither that of a scene file"),
        (
            b'#usda 1.0\n(\n upAxis = "Z"\n)\ndef Xform "World" {\n',
            "cut.usda",
            "cut.usda",
        ),
        (
            b'#usda 1.0\n(\n upAxis = "Z"\n)\ndef PhysicsScene "P" {}\n',
            "nounits.usda",
            "metersPerUnit",
        ),
        (
            b'#usda 1.0\n(\n metersPerUnit = 1\n)\ndef PhysicsScene "P" {}\n',
            "noup.usda",
            "upAxis",
        ),
    ],
)
def test_a_bad_file_is_an_error_of_one_line(content, name, message, gauge, tmp_path):
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    result = gauge("run", SLIDE, "--asset", path, "--out", tmp_path / "out")
    assert result.exit_code == 2
    assert result.stderr.count("\n") == 1
    assert result.stderr.startswith(f"error: {path}: ")
    assert message in result.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "options", [{"parameters": {"cube.friction": 0.1}}, {"drivers": "imported"}]
)
def test_what_the_file_states_cannot_be_given_too(options):
    with pytest.raises(ParameterError, match=f"{SLIDE}.usda"):
        gymnasium.make(f"GAUGE/{SLIDE}", asset=shipped(SLIDE), **options)
    assert (
        load_experiment(
            SLIDE, "calibrated", drivers="bundled", asset=shipped(SLIDE)
        ).asset
        is not None
    )


def test_a_model_file_is_for_its_engine_alone():
    pytest.importorskip("newton")
    path = assets_folder() / "mjcf" / f"{SLIDE}.xml"
    with pytest.raises(
        UnsupportedSceneError, match=r"model of another engine.*backend='mujoco' can"
    ):
        gymnasium.make(f"GAUGE/{SLIDE}", asset=path, backend="newton")


def test_commands_show_and_mark_an_edited_scene(slippery, gauge, tmp_path):
    shown = gauge("show", SLIDE, "--asset", slippery, "--json")
    assert json.loads(shown.stdout)["asset"]["changes"] == [
        "contact cube/board: friction 0.273673 -> 0.1"
    ]
    run = gauge("run", SLIDE, "--asset", slippery, "--out", tmp_path / "out")
    assert run.exit_code == 0
    assert "calibrated, edited scene" in run.stdout
    assert "friction 0.273673 -> 0.1" in run.stdout
