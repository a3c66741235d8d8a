"""Task files: every variant resolves, and a wrong file gets an error that names file, key and reason."""

import re
import tomllib

import numpy as np
import pytest
from texts import changed_text

from gauge_envs import load_experiment
from gauge_envs.errors import TaskFileError
from gauge_envs.experiments.task_files import load_task, task_spec
from gauge_envs.experiments.task_format import TaskSpec
from gauge_envs.experiments.variants import (
    INDEX_FILE,
    Collection,
    task_files,
    task_path,
    variants,
    variants_of_file,
)
from gauge_envs.files import data_folder
from gauge_envs.scene import Scene

ORDER = list(TaskSpec.model_fields)


def test_75_variants_resolve_to_a_scene():
    scenes = {variant.name: load_experiment(variant).scene for variant in variants()}
    assert len(scenes) == 75
    assert all(isinstance(scene, Scene) for scene in scenes.values())
    assert all(scene.bodies for scene in scenes.values())
    for scene in scenes.values():
        assert 0.5 < scene.speed_limit_m_per_s < 40.0
        assert scene.floor_height_m > -1.0


@pytest.mark.parametrize("path", task_files(), ids=lambda path: path.stem)
def test_every_file_has_the_same_order(path):
    keys = list(tomllib.loads(path.read_text()))
    assert keys == sorted(keys, key=ORDER.index)


@pytest.mark.parametrize("path", task_files(), ids=lambda path: path.stem)
def test_file_name_is_the_family_in_snake_case(path):
    family = load_task(path).family
    assert path.stem == re.sub(r"(?<!^)(?=[A-Z])", "_", family).lower()
    assert task_path(family) == path


@pytest.mark.parametrize("path", task_files(), ids=lambda path: path.stem)
def test_every_named_parameter_set_resolves(path):
    spec = load_task(path)
    for name in spec.parameters:
        for variant in spec.variants():
            assert load_experiment(variant, name).parameters == name


def test_provenance_prefers_the_longest_match():
    spec = task_spec("SlopeSlider")
    assert spec.provenance_of("initial.all.ground.position_m").startswith("video")
    assert spec.provenance_of("subtasks.2.initial.wood.cube.position_m").startswith(
        "metadata"
    )
    assert spec.provenance_of("constants.cube.wood.friction").startswith("metadata")


@pytest.mark.parametrize(
    ("family", "old", "new", "key", "reason"),
    [
        (
            "SlopeSlider",
            'title = "Slope slider"',
            'titel = "Slope slider"',
            "title",
            "missing key",
        ),
        (
            "SlopeSlider",
            "recorded = true",
            "recorded = true\nrecordet = true",
            "bodies.cube.recordet",
            "unknown key",
        ),
        (
            "SlopeSlider",
            "mass_kg = 0.0903",
            "mass_kg = -0.0903",
            "constants.cube.wood.mass_kg",
            "-0.0903",
        ),
        (
            "SlopeSlider",
            "mass_kg = 0.0903",
            "mass_kg = nan",
            "constants.cube.wood.mass_kg",
            "nan",
        ),
        (
            "SlopeSlider",
            "friction = 0.273673",
            "fricton = 0.273673",
            "constants.cube.wood.fricton",
            "unknown key",
        ),
        (
            "SlopeSlider",
            "restitution = 0.223583",
            "restitution = 1.2",
            "constants.cube.wood.restitution",
            "1.2",
        ),
        (
            "SlopeSlider",
            "[constants.cube]\nwood",
            "[constants.cube]\noak",
            "constants.cube.wood",
            "missing material",
        ),
        (
            "SlopeSlider",
            "[constants.cube]",
            "[constants.cub]",
            "constants.cub",
            "no body",
        ),
        ("SlopeSlider", "0.08, 0.12", "0.12, 0.08", "profile.0", "times_s[3]"),
        (
            "SlopeSlider",
            'bodies = ["cube", "board"]',
            'bodies = ["cube", "bord"]',
            "contacts.0",
            "bord",
        ),
        (
            "SlopeSlider",
            "[subtasks.1.initial.metal]",
            "[subtasks.1.initial.steel]",
            "subtasks.1.initial",
            "steel",
        ),
        (
            "SlopeSlider",
            'body = "board"',
            'body = "bord"',
            "subtasks.3.drivers.0.body",
            "bord",
        ),
        (
            "SlopeSlider",
            "axis = [0.0, 1.0, 0.0]",
            "axis = [0.0, 1.0, 0.1]",
            "axis",
            "unit vector",
        ),
        (
            "SlopeSlider",
            "size_m = [0.05, 0.05, 0.05]",
            "size_m = [0.05, 0.05]",
            "bodies.cube.shape",
            "",
        ),
        (
            "SlopeSlider",
            '"constants" = "metadata"',
            '"constants" = "guess"',
            "provenance.constants",
            "guess",
        ),
        ("SlopeSlider", '"constants" = "metadata"\n', "", "constants", "provenance"),
        (
            "SlopeSlider",
            "frames = { all = 9 }",
            "frames = { all = 1 }",
            "subtasks.1.frames",
            "",
        ),
        (
            "SlopeSlider",
            "frames = { all = 9 }",
            f"frames = {{ all = {10**400} }}",
            "subtasks.1.frames",
            "18000",
        ),
        ("NewtonsCradle", 'kind = "hinge"', 'kind = "hing"', "joints", "hing"),
        (
            "FoamStretching",
            "poisson_ratio = 0.23",
            "poisson_ratio = 0.52",
            "poisson_ratio",
            "Poisson ratio 0.52",
        ),
        (
            "FoamStretching",
            "[0, 7, 8]",
            "[0, 7, 28]",
            "markers",
            "marker index 28 is out of range",
        ),
        (
            "StickStack",
            "used = 0.49",
            "used = 0.62",
            "poisson_ratio",
            "Poisson ratio 0.62",
        ),
        ("FoamStretching", 'to = "base-1"', 'to = "wall"', "attachments", "wall"),
    ],
)
def test_a_wrong_file_names_file_key_and_reason(
    family, old, new, key, reason, tmp_path
):
    path = changed_text(task_path(family), (old, new), to=tmp_path / "edited.toml")
    with pytest.raises(TaskFileError) as caught:
        load_task(path)
    assert caught.value.file == path
    assert key in caught.value.place
    assert reason in caught.value.reason
    assert str(path) in str(caught.value)


def test_flat_piece_encloses_no_volume(tmp_path):
    text = task_path("SlopeContact").read_text()
    flat = "pieces_m = [[[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.1, 0.1, 0.0]]]"
    path = tmp_path / "flat.toml"
    path.write_text(
        re.sub(r"pieces_m = \[\n.*?\n\]", flat, text, count=1, flags=re.DOTALL),
    )
    with pytest.raises(TaskFileError, match="no volume"):
        load_task(path)


def test_plate_with_hole_has_the_area_of_the_ring():
    shape = load_experiment("Funnel-satin").scene.body("board").shape
    hole = np.pi * 0.10**2
    # The hole is a circumscribed polygon of 32 sides, 0.3 % larger than the circle.
    assert shape.volume_m3 == pytest.approx((0.25 - hole) * 0.012, rel=0.001)


def test_the_index_has_the_names_and_frames_of_the_task_files():
    rows = ["file,family,subtask,material,collection,frames"]
    for collection in Collection:
        for path in task_files():
            raw = tomllib.loads(path.read_text())
            if raw.get("collection", "gauge") == collection:
                for entry in variants_of_file(path, collection):
                    variant = entry.variant
                    rows.append(
                        f"{path.name},{variant.family},{variant.subtask or ''},{variant.material},"
                        f"{collection},{entry.frame_count}"
                    )
    index = data_folder("tasks") / INDEX_FILE
    assert index.read_text().splitlines() == rows, "write these rows into the index"


def test_frames_of_a_subtask_take_the_place_of_those_of_its_family(tmp_path):
    path = tmp_path / "puck.toml"
    path.write_text(
        'family = "Puck"\nmaterials = ["steel", "brass"]\nframes.all = 9\n'
        "[subtasks.1]\nframes.steel = 7\n[subtasks.2]\n"
    )
    entries = variants_of_file(path, Collection.BEYOND)
    assert {entry.variant.name: entry.frame_count for entry in entries} == {
        "Puck-1-steel": 7,
        "Puck-1-brass": 9,
        "Puck-2-steel": 9,
        "Puck-2-brass": 9,
    }
