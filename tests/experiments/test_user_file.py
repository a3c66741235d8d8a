"""Experiments from somebody else's USD and a TOML file: run, scored, read back, refused where something is missing."""

import hashlib
import json
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from dataclasses import asdict
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from places import ROOT
from pxr import Gf, Sdf, Usd, UsdGeom, Vt
from texts import changed_text

from gauge_envs import load_experiment, load_experiment_file
from gauge_envs.errors import (
    AssetError,
    ParameterError,
    ReferenceFileError,
    ShapeError,
    TaskFileError,
)
from gauge_envs.experiments.resolve import resolve_experiment
from gauge_envs.references.band import Band
from gauge_envs.rendering.camera import experiment_view
from gauge_envs.runs.batch import run_many
from gauge_envs.runs.episodes import run_episode
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result_file import (
    load_result,
    recorded_experiment,
    result_file_name,
    write_result,
)
from gauge_envs.runs.score_file import score_file
from gauge_envs.scene import ContactMode
from gauge_envs.scoring.reference import reference_band
from gauge_envs.tools.assets.build import assets_folder
from gauge_envs.tools.compare.comparison import compare
from gauge_envs.tools.compare.experiment_figure import save_figures
from gauge_envs.tools.usd.experiment_file import experiment_record
from gauge_envs.tools.usd.reader import read_points

EXAMPLE = ROOT / "examples" / "usd_experiment"
CRATE = EXAMPLE / "crate.toml"
GUIDE = ROOT / "docs" / "assets.md"

G, TILT, FRICTION = 9.80665, np.radians(25.0), 0.3
ACCELERATION = G * (np.sin(TILT) - FRICTION * np.cos(TILT))


@pytest.fixture
def changed(tmp_path):
    """Writes a copy of the example with texts of a file replaced: changed((old, new), ..., file="crate.toml")."""

    def make(*replacements, file="crate.toml"):
        folder = tmp_path / "example"
        if not folder.exists():
            shutil.copytree(EXAMPLE, folder)
        changed_text(folder / file, *replacements, count=-1)
        return folder / "crate.toml"

    return make


# --- the example -----------------------------------------------------------------------------------------------------


def test_the_band_of_the_example_is_the_closed_form():
    band = reference_band(load_experiment_file(str(CRATE)))
    times_s = np.arange(31) / 30.0
    start = np.array([np.cos(TILT), -np.sin(TILT)]) @ crate_start_m()
    np.testing.assert_allclose(
        band.mean[:, 0], 1e3 * (start + 0.5 * ACCELERATION * times_s**2), atol=1e-5
    )
    sigma = np.hypot(1.0, 1e3 * 0.5 * G * np.cos(TILT) * 0.01 * times_s**2)
    np.testing.assert_allclose(band.sigma[:, 0], sigma, atol=1e-5)


def crate_start_m():
    """Along x and up, from USD's own composition of the layer, which is in centimetres."""
    stage = Usd.Stage.Open(str(EXAMPLE / "crate.usda"))
    place = UsdGeom.XformCache().GetLocalToWorldTransform(
        stage.GetPrimAtPath("/Yard/Incline/Crate")
    )
    x, y, _ = place.ExtractTranslation()
    return 1e-2 * np.array([x, y])


def test_the_example_is_read_into_si_units_and_z_up():
    found = load_experiment_file(str(CRATE))
    assert found.id == "GAUGE/Asset-crate"
    assert found.recorded == ("Crate",)
    crate = found.scene.body("Crate")
    x, y, z = crate.pose.position_m
    np.testing.assert_allclose([x, z], crate_start_m(), atol=1e-12)
    assert (y, crate.mass_kg) == (0.0, pytest.approx(500 * 0.2**3))
    assert found.scene.contacts[0].friction == pytest.approx(FRICTION)
    assert found.scene.gravity_m_per_s2 == pytest.approx(G)


CAMERA = "[camera]\ntarget_m = [0.1, 0.2, 0.3]\ndistance_m = 1.5\nazimuth_deg = 90.0\nelevation_deg = -20.0\n\n"


def test_a_file_may_state_its_camera(changed):
    path = changed(("[provenance]", f"{CAMERA}[provenance]"))
    found = load_experiment_file(str(path))
    view = experiment_view(found)
    assert (view.target_m, view.distance_m, view.azimuth_deg, view.elevation_deg) == (
        (0.1, 0.2, 0.3),
        1.5,
        90.0,
        -20.0,
    )
    assert experiment_record(found)["definition"]["camera"]["distance_m"] == 1.5
    plain = load_experiment_file(str(CRATE))
    assert (
        plain.camera is None and "camera" not in experiment_record(plain)["definition"]
    )


def test_the_crate_slides_as_the_law_says():
    result = run_episode(RunRequest(str(CRATE)))
    times_s, samples = result.trajectory.arrays()
    way = 1e-3 * samples @ [np.cos(TILT), 0.0, -np.sin(TILT)]
    course = 0.5 * times_s**2
    assert course @ (way - way[0]) / (course @ course) == pytest.approx(
        ACCELERATION, rel=1e-3
    )
    assert result.score.kind == "analytic"
    assert result.score.refused is None
    assert result.score.rmse == pytest.approx(0.0, abs=0.1)


def test_gymnasium_makes_it_as_an_id():
    env = gymnasium.make("GAUGE/Asset", asset=CRATE)
    assert env.unwrapped.experiment.id == "GAUGE/Asset-crate"
    env.reset(seed=0)
    _, reward, *_, info = env.step(0)
    assert info["reference"] == "analytic"
    assert -0.1 < reward < 0.0
    with pytest.raises(ParameterError, match="names its own USD layer"):
        resolve_experiment(str(CRATE), asset=EXAMPLE / "crate.usda")
    with pytest.raises(
        ParameterError, match=r"with crate\.toml: the file states the constants"
    ):
        resolve_experiment(str(CRATE), {"Crate.friction": 0.1})


# --- results ---------------------------------------------------------------------------------------------------------


def test_a_result_needs_no_other_file(changed, tmp_path):
    path = changed()
    result = run_episode(RunRequest(str(path)))
    file = tmp_path / result_file_name(result)
    assert file.name == "Asset-crate.mujoco.calibrated.json"
    write_result(result, file)
    original = load_experiment_file(str(path))
    shutil.rmtree(path.parent)
    again = load_result(file)
    assert again == result
    assert str(path.parent) not in file.read_text()
    found = recorded_experiment(again)
    assert found.scene == original.scene
    assert (found.id, found.title, found.score, found.recorded) == (
        original.id,
        original.title,
        original.score,
        original.recorded,
    )
    assert score_file(file)[0].score.rmse == result.score.rmse
    (picture,) = save_figures([again], tmp_path / "plots")
    assert picture.name == "Asset-crate.png"


def test_a_band_survives_json():
    band = reference_band(load_experiment("SlopeSlider-2-wood"))
    again = Band.from_dict(json.loads(json.dumps(band.to_dict(), allow_nan=False)))
    for name, value in asdict(band).items():
        np.testing.assert_array_equal(getattr(again, name), value)


def test_a_damaged_record_is_an_error(tmp_path):
    values = run_episode(RunRequest(str(CRATE))).to_dict()
    del values["asset"]["experiment"]["definition"]
    file = tmp_path / "a.json"
    file.write_text(json.dumps(values))
    with pytest.raises(Exception, match="the asset in the result is damaged"):
        recorded_experiment(load_result(file))


def test_compare_tells_versions_of_an_experiment_file_apart(changed):
    first = run_episode(RunRequest(str(changed())))
    second = run_episode(
        RunRequest(
            str(changed(("-1122.618262", "-1122.618263"), file="crate.csv")), seed=1
        )
    )
    assert first.task_sha256 != second.task_sha256
    notes = compare(
        [first, second, run_episode(RunRequest("SlopeSlider-2-wood"))]
    ).notes
    assert notes == (
        "Asset-crate: made from different versions of its experiment file",
    )


def test_a_mixed_run_goes_on(tmp_path):
    requests = [RunRequest("SlopeSlider-2-wood"), RunRequest(str(CRATE))]
    ran = [result.id for result in run_many(requests, out=tmp_path)]
    assert ran == ["GAUGE/SlopeSlider-2-wood", "GAUGE/Asset-crate"]
    created = [
        result.created for result in run_many(requests, out=tmp_path, resume=True)
    ]
    assert created == [
        load_result(file).created
        for file in sorted(tmp_path.glob("*.json"), reverse=True)
    ]


# --- what the file adds ----------------------------------------------------------------------------------------------


def test_a_pair_is_overridden_by_path_or_name(changed):
    constants = 'friction = 0.1\nrestitution = 0.5\nmode = "impact"\n'
    path = changed(
        (
            "[score]",
            f'[[contacts]]\nbodies = ["/Yard/Incline/Crate", "Deck"]\n{constants}[score]',
        )
    )
    (contact,) = load_experiment_file(str(path)).scene.contacts
    assert (contact.friction, contact.restitution, contact.mode) == (
        0.1,
        0.5,
        ContactMode.IMPACT,
    )


def test_scores_are_normalized_by_the_files_baseline(changed):
    """Where the band is of real trials: a law has no real scatter."""
    baseline = ("[provenance]", "[baseline.rmse]\nmean = 2.0\n[provenance]")
    solution = run_episode(RunRequest(str(changed(baseline)))).score
    assert solution.rmse_normalized is None
    trials = ('kind = "analytic"', 'kind = "trials"\ntrial_count = 3')
    score = run_episode(RunRequest(str(changed(trials)))).score
    assert score.rmse_normalized == score.rmse / 2.0
    assert score.dtw_normalized is None


def test_a_file_drives_kinematic_bodies(changed):
    deck = 'def Xform "Ramp"\n'
    changed(
        (
            deck,
            f'{deck[:-1]} (\n prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsMassAPI"]\n)\n',
        ),
        file="crate.usda",
    )
    changed(
        (
            '            def Cube "Deck" (',
            '            bool physics:kinematicEnabled = 1\n            def Cube "Deck" (',
        ),
        file="crate.usda",
    )
    motion = 'kind = "translate"\naxis = [0.0, 1.0, 0.0]\nresidual_rate_m_per_s = 0.1\n'
    profile = '[[drivers.motions.profile]]\nkind = "cosine"\nstart_s = 0.0\nduration_s = 1.0\namount_m = 0.05\n'
    body = 'body = "/Yard/Incline/Ramp"\nprovenance = "nominal"\nnote = "a shove"\n'
    driver = f"[[drivers]]\n{body}[[drivers.motions]]\n{motion}{profile}"
    path = changed(("[score]", f"{driver}[score]"))
    env = gymnasium.make("GAUGE/Asset", asset=path)
    assert env.action_space.shape == (1,)
    observation, _ = env.reset(seed=0)
    start = observation["driver"][0, 1]
    for _ in range(30):
        observation, *_ = env.step(np.zeros(1))
    assert observation["driver"][0, 1] - start == pytest.approx(0.05, abs=1e-6)


def test_our_own_layers_with_markers_can_be_experiments(tmp_path):
    name = "TextileStretching-rayon"
    shutil.copy(assets_folder() / "usd" / f"{name}.usda", tmp_path)
    text = f'name = "cloth"\ntitle = "Cloth"\nusd = "{name}.usda"\nframes = 4\n[score]\nobservable = "curvature"\n'
    (tmp_path / "cloth.toml").write_text(f'{text}[provenance]\nscene = "metadata"\n')
    result = run_episode(RunRequest(str(tmp_path / "cloth.toml")))
    assert result.trajectory.unit == "rad"
    assert result.score.kind == "none"
    short, full = (
        load_experiment_file(str(tmp_path / "cloth.toml")),
        load_experiment(name),
    )
    assert short.scene.bodies == full.scene.bodies
    assert short.scene.duration_s == 0.1


# --- markers of a prim -----------------------------------------------------------------------------------------------

FLUNG = "TextileFlinging-rayon"
EVERY_FOURTH = [9 * row + column for row in (0, 3, 6) for column in (0, 4, 8)]
"""Every fourth marker along a row of the published nine, every third along a column of seven."""


@pytest.fixture
def flung(tmp_path):
    """Writes an experiment on a copy of a shipped layer: flung(change, markers="prim = ...")."""

    def make(change=lambda stage: None, markers=""):
        stage = Usd.Stage.Open(str(assets_folder() / "usd" / f"{FLUNG}.usda"))
        change(stage)
        stage.GetRootLayer().Export(str(tmp_path / f"{FLUNG}.usda"))
        stage.Reload()
        table = (
            f'[markers]\nbodies = ["/World/textile"]\n{markers}\n' if markers else ""
        )
        text = f'name = "cloth"\ntitle = "Cloth"\nusd = "{FLUNG}.usda"\nframes = 4\n{table}'
        path = tmp_path / "cloth.toml"
        path.write_text(
            f'{text}[score]\nobservable = "marker_position"\n[provenance]\nscene = "metadata"\n',
        )
        return path

    return make


def fewer(stage):
    """Nine of the markers as somebody may place them: below a prim that is moved, turned and in millimetres."""
    shelf = UsdGeom.Xform.Define(stage, "/World/Shelf")
    shelf.AddTranslateOp().Set(Gf.Vec3d(0.3, -0.2, 0.1))
    shelf.AddRotateZOp().Set(90.0)
    shelf.AddScaleOp().Set(Gf.Vec3f(1e-3))
    points = np.array(
        stage.GetPrimAtPath("/World/Markers").GetAttribute("gauge:positions_m").Get()
    )[EVERY_FOURTH]
    x, y, z = (points - [0.3, -0.2, 0.1]).T
    dots = UsdGeom.Points.Define(stage, "/World/Shelf/Dots")
    dots.CreatePointsAttr(
        Vt.Vec3fArray.FromNumpy((1e3 * np.column_stack([y, -x, z])).astype(np.float32))
    )


def test_a_prim_of_the_layer_has_the_markers(flung, tmp_path):
    every = run_episode(RunRequest(str(flung()), marker_proxy="node"))
    path = flung(fewer, 'prim = "/World/Shelf/Dots"\nfaces = [[0, 1, 4]]')
    some, scene = (
        run_episode(RunRequest(str(path), marker_proxy="node")),
        load_experiment_file(str(path)).scene,
    )
    full = load_experiment(FLUNG).scene.markers
    assert (scene.markers.bodies, scene.markers.faces) == (("textile",), ((0, 1, 4),))
    wanted = np.array(full.positions_m)[EVERY_FOURTH]
    np.testing.assert_allclose(scene.markers.positions_m, wanted, rtol=0.0, atol=1e-7)
    all_63 = np.array(every.trajectory.samples).reshape(-1, 63, 3)
    np.testing.assert_array_equal(
        np.array(some.trajectory.samples).reshape(-1, 9, 3), all_63[:, EVERY_FOURTH]
    )
    write_result(some, tmp_path / "some.json")
    assert recorded_experiment(load_result(tmp_path / "some.json")).scene == scene


def test_the_named_one_of_two_sets_of_markers_counts(flung):
    def twice(stage):
        layer = stage.GetRootLayer()
        assert Sdf.CopySpec(layer, "/World/Markers", layer, "/World/Spare")
        UsdGeom.Xformable(stage.GetPrimAtPath("/World/Spare")).AddTranslateOp().Set(
            Gf.Vec3d(0.0, 0.0, 1e-3)
        )

    with pytest.raises(AssetError, match="/World/Spare: is a second set of markers"):
        load_experiment_file(str(flung(twice)))
    found = load_experiment_file(
        str(flung(twice, 'prim = "/World/Spare"'))
    ).scene.markers
    first = load_experiment(FLUNG).scene.markers
    np.testing.assert_allclose(
        np.subtract(found.positions_m, first.positions_m),
        [[0.0, 0.0, 1e-3]] * 63,
        atol=1e-7,
    )


def test_points_are_read_in_metres_with_z_up(changed):
    layer = changed().parent / "crate.usda"
    stage = Usd.Stage.Open(str(layer))
    mesh = UsdGeom.Mesh.Define(stage, "/Yard/Incline/Crate/Dots")
    mesh.CreatePointsAttr([(1.0, 2.0, 3.0), (-4.0, 5.0, -6.0)])
    place = UsdGeom.XformCache().GetLocalToWorldTransform(mesh.GetPrim())
    wanted = np.array(
        [place.Transform(Gf.Vec3d(*point)) for point in mesh.GetPointsAttr().Get()]
    )
    with pytest.raises(
        AssetError, match=r"crate\.usda is open in this process with edits: save them"
    ):
        read_points(layer, "/Yard/Incline/Crate/Dots")
    stage.Save()
    x, y, z = 1e-2 * wanted.T
    np.testing.assert_allclose(
        read_points(layer, "/Yard/Incline/Crate/Dots"),
        np.column_stack([x, -z, y]),
        atol=1e-12,
    )


def dots(kind, count=0):
    """A prim of a type, at the origin, with points where it has any."""

    def change(stage):
        prim = stage.DefinePrim("/World/Dots", kind)
        if count:
            prim.GetAttribute("points").Set(
                [Gf.Vec3f(float(index)) for index in range(count)]
            )

    return change


@pytest.mark.parametrize(
    ("change", "markers", "error", "message"),
    [
        (
            dots("Points"),
            'prim = "/World/Spots"',
            AssetError,
            f"cloth.toml: markers.prim: /World/Spots of {FLUNG}.usda: there is no such prim",
        ),
        (
            dots("Cube"),
            'prim = "/World/Dots"',
            AssetError,
            f"cloth.toml: markers.prim: /World/Dots of {FLUNG}.usda: is Cube: Points or Mesh is expected",
        ),
        (
            dots("Points"),
            'prim = "/World/Dots"',
            AssetError,
            f"/World/Dots of {FLUNG}.usda: has no points",
        ),
        (
            dots("Mesh"),
            'prim = "/World/Dots"',
            AssetError,
            f"/World/Dots of {FLUNG}.usda: has no points",
        ),
        (
            dots("Points", 2),
            'prim = "/World/Dots"\nlines = [[0, 2]]',
            TaskFileError,
            "markers: lines: marker index 2",
        ),
        (
            dots("Points", 2),
            "faces = []",
            TaskFileError,
            "markers: one of prim and positions_m is expected",
        ),
        (
            dots("Points", 2),
            'prim = "/World/Dots"\npositions_m = [[0.0, 0.0, 0.0]]',
            TaskFileError,
            "markers: one of prim and positions_m is expected",
        ),
        (
            dots("Points", 2),
            'prim = "/World/Dots"\ncolour = 1',
            TaskFileError,
            "markers.colour: unknown key",
        ),
    ],
    ids=[
        "missing",
        "type",
        "no points",
        "empty mesh",
        "index",
        "neither",
        "both",
        "key",
    ],
)
def test_what_is_wrong_with_markers_is_reported(change, markers, error, message, flung):
    with pytest.raises(error) as caught:
        load_experiment_file(str(flung(change, markers)))
    assert message in str(caught.value)


def test_markers_away_from_their_body_are_refused(flung):
    path = flung(dots("Points", 2), 'prim = "/World/Dots"')
    with pytest.raises(ShapeError, match=r"marker 0 is 727.* mm from the material"):
        gymnasium.make("GAUGE/Asset", asset=path)


def test_rigid_bodies_carry_no_markers(changed):
    table = (
        '[markers]\nbodies = ["/Yard/Incline/Crate"]\npositions_m = [[0.0, 0.0, 1.0]]\n'
    )
    path = changed(
        ('recorded = ["/Yard/Incline/Crate"]', ""),
        ('observable = "position"', 'observable = "marker_position"'),
    )
    text = path.read_text()
    path.write_text(
        f"{text[: text.index('[band]')]}{table}{text[text.index('[provenance]') :]}"
    )
    with pytest.raises(
        AssetError,
        match=r"Crate: no deformable body of that name .*rigid bodies have none",
    ):
        load_experiment_file(str(path))


# --- what the hash covers --------------------------------------------------------------------------------------------


def test_the_hash_of_an_experiment_covers_what_its_layer_refers_to(changed):
    path = changed()
    first = load_experiment_file(str(path))
    files = [
        path.parent / name
        for name in ("crate.toml", "crate.usda", "materials.usda", "crate.csv")
    ]
    digests = b"".join(hashlib.sha256(file.read_bytes()).digest() for file in files)
    assert (
        first.asset.sha256 == first.file_sha256 == hashlib.sha256(digests).hexdigest()
    )
    changed(("dynamicFriction = 0.3", "dynamicFriction = 0.31"), file="materials.usda")
    changed(("staticFriction = 0.3", "staticFriction = 0.31"), file="materials.usda")
    second = load_experiment_file(str(path))
    assert second.file_sha256 != first.file_sha256
    assert second.scene != first.scene


# --- what is refused -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("replacement", "error", "message"),
    [
        (
            ('"/Yard/Incline/Crate"', '"/Yard/Crate"'),
            AssetError,
            "crate.toml: recorded: '/Yard/Crate' is no body of crate.usda",
        ),
        (('"/Yard/Incline/Crate"', '"Deck"'), AssetError, "must move under forces"),
        (
            ('recorded = ["/Yard/Incline/Crate"]', ""),
            TaskFileError,
            "recorded: observable 'position' needs recorded bodies",
        ),
        (('usd = "crate.usda"', 'usd = "gone.usda"'), AssetError, "gone.usda"),
        (('name = "crate"', 'name = "a crate/1"'), TaskFileError, "name: "),
        (
            ("frames = 31", "frames = 31\ncolour = 1"),
            TaskFileError,
            "colour: unknown key",
        ),
        (("frames = 31", ""), TaskFileError, "frames: missing key"),
        (
            ("frames = 31", "frames = 30"),
            ReferenceFileError,
            "crate.csv: column frame: 0, 1, ... to at most 29 is expected",
        ),
        (("frames = 31", "frames ="), TaskFileError, "crate.toml: Invalid value"),
        (
            ('file = "crate.csv"', 'file = "gone.csv"'),
            AssetError,
            "gone.csv: cannot be read",
        ),
        (
            ('["downhill"]', '["uphill"]'),
            ReferenceFileError,
            "crate.csv: line 1: expected columns frame,mean.uphill",
        ),
        (
            ('kind = "analytic"', 'kind = "guess"'),
            TaskFileError,
            "band.kind: ",
        ),
        (
            ('kind = "analytic"', 'grade = "law"'),
            TaskFileError,
            "band: grade is now kind: trials, recording or analytic",
        ),
        (
            ("0.0, -0.422618261740699]]", "0.0, -0.4]]\nindices = [3]"),
            ReferenceFileError,
            "g(t) has 3 coordinates: [band] has larger indices",
        ),
        (
            ("0.0, -0.422618261740699]", "-0.422618261740699]"),
            TaskFileError,
            "band: it takes 2 coordinates, g(t) has 3",
        ),
        (
            ("[score]", '[[contacts]]\nbodies = ["Crate", "Crate"]\n[score]'),
            AssetError,
            "do not collide",
        ),
        (
            ("[score]", '[[contacts]]\nbodies = ["Crate", "Floor"]\n[score]'),
            AssetError,
            "contacts.0.bodies: 'Floor' is no body",
        ),
        (("[provenance]\nscene", "[provenances]\nscene"), TaskFileError, "provenance"),
    ],
)
def test_what_is_wrong_in_a_file_is_reported(replacement, error, message, changed):
    path = changed(replacement)
    with pytest.raises(error) as caught:
        load_experiment_file(str(path))
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("replacement", "message"),
    [
        (("\n5,", "\n7,"), "column frame: 0, 1, ... to at most 30 is expected"),
        (("-1121.797086", "fast"), "line 3: mean.downhill: "),
        (("1.001218", "-1.0"), "line 3: sigma.downhill: "),
        (("1.001218", "1.0,2.0"), "line 3: "),
        (("sigma.downhill", "scatter"), "expected columns frame,mean.downhill"),
    ],
)
def test_what_is_wrong_in_a_table_is_reported(replacement, message, changed):
    path = changed(replacement, file="crate.csv")
    with pytest.raises(ReferenceFileError, match=r"crate\.csv") as caught:
        load_experiment_file(str(path))
    assert message in str(caught.value)


def test_uncertainty_counts_as_sigma_without_it_and_indices_pick_coordinates(changed):
    changed(("sigma.downhill", "uncertainty.downhill"), file="crate.csv")
    projection = "projection = [[0.90630778703665, 0.0, -0.422618261740699]]"
    band = reference_band(
        load_experiment_file(str(changed((projection, "indices = [2]"))))
    )
    np.testing.assert_array_equal(band.sigma, band.uncertainty)
    np.testing.assert_array_equal(band.projection, [[0.0, 0.0, 1.0]])
    whole = changed(
        ('coordinates = ["downhill"]', 'coordinates = ["downhill"]\nsigma = 3.0')
    )
    assert (reference_band(load_experiment_file(str(whole))).sigma == 3.0).all()


@pytest.mark.parametrize(
    ("replacements", "message"),
    [
        ([("    metersPerUnit = 0.01\n", "")], "metersPerUnit"),
        ([('    upAxis = "Y"\n', "")], "upAxis"),
        ([("@./materials.usda@", "@./gone.usda@")], "crate.usda"),
        ([('def PhysicsScene "Physics"', 'def Xform "Physics"')], "PhysicsScene"),
        (
            [("gravityDirection = (0, -1, 0)", "gravityDirection = (1, 0, 0)")],
            "/Yard/Physics",
        ),
        ([('def Cube "Box"', 'def Capsule "Box"')], "/Yard/Incline/Crate/Box"),
    ],
)
def test_what_is_wrong_in_the_layer_is_reported(replacements, message, changed):
    path = changed(*replacements, file="crate.usda")
    with pytest.raises(AssetError) as caught:
        load_experiment_file(str(path))
    assert message in str(caught.value)


def test_commands_take_an_experiment_file(gauge, tmp_path):
    shown = json.loads(gauge("show", CRATE, "--json").stdout)
    assert shown["title"] == "Crate on a ramp"
    assert shown["reference"]["kind"] == "analytic"
    assert shown["observable"]["coordinates"] == ["Crate.x", "Crate.y", "Crate.z"]
    assert shown["provenance"] == tomllib.loads(CRATE.read_text())["provenance"]
    run = gauge("run", CRATE, "--out", tmp_path, "--json")
    assert run.exit_code == 0
    (line,) = map(json.loads, run.stdout.splitlines())
    assert line["id"] == "GAUGE/Asset-crate"
    bad = gauge("run", tmp_path / "gone.toml", "--out", tmp_path)
    assert (bad.exit_code, bad.stderr) == (
        2,
        f"error: {tmp_path}/gone.toml: cannot be read: No such file or directory\n",
    )


def test_a_trajectory_of_another_simulator_is_scored(gauge, tmp_path):
    times_s = np.arange(31) / 30.0
    x, z = crate_start_m()
    way = 0.5 * ACCELERATION * times_s**2
    places = np.column_stack(
        [x + np.cos(TILT) * way, np.zeros(31), z - np.sin(TILT) * way]
    )
    np.savetxt(tmp_path / "mine.csv", 1e3 * places, delimiter=",")
    scored = gauge("score", tmp_path / "mine.csv", "--id", CRATE, "--json")
    assert scored.exit_code == 0, scored.stderr
    assert json.loads(scored.stdout)["score"]["rmse"] == pytest.approx(0.0, abs=1e-5)


# --- the guide -------------------------------------------------------------------------------------------------------

BLOCKS = re.findall(
    r"^```(\w+)\n(.*?)^```$",
    GUIDE.read_text(),
    flags=re.MULTILINE | re.DOTALL,
)
TABLES = [text for kind, text in BLOCKS if kind == "toml"]


def test_the_guide_quotes_the_experiment_file():
    quoted, _ = TABLES
    assert CRATE.read_text().endswith(quoted)


def test_the_guide_names_markers_as_they_are_read(flung):
    path = flung(fewer)
    text = path.read_text()
    path.write_text(text.replace("[score]", f"{TABLES[1]}[score]"))
    markers = load_experiment_file(str(path)).scene.markers
    assert (len(markers.positions_m), markers.faces) == (9, ((0, 1, 4),))


def test_the_guide_names_every_key():
    table = GUIDE.read_text().rpartition("| key | what |")[2]
    from gauge_envs.tools.usd.experiment_file import ExperimentFile

    for key in ExperimentFile.model_fields:
        assert re.search(rf"`\[*{key}[\].`]", table), key


def test_the_guide_shows_what_a_run_prints(gauge, tmp_path):
    (expected,) = (text for kind, text in BLOCKS if kind == "text")
    run = gauge("run", CRATE, "--out", tmp_path)
    assert run.exit_code == 0, run.stderr
    assert expected in "".join(f"{line.rstrip()}\n" for line in run.stdout.splitlines())


@pytest.mark.slow
def test_what_the_guide_runs_works_in_order(tmp_path):
    shutil.copytree(EXAMPLE, tmp_path / "examples" / "usd_experiment")
    bin_folder = Path(sys.executable).parent
    for kind, text in BLOCKS:
        commands = [[sys.executable, "-c", text]] if kind == "python" else []
        if kind == "sh":
            lines = map(shlex.split, text.splitlines())
            commands = [[str(bin_folder / line[0]), *line[1:]] for line in lines]
        for command in commands:
            run = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
            assert run.returncode == 0, run.stderr
