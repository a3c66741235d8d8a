"""Task files: those of the package follow the rules, and a wrong one is an error that names file, key and reason."""

import re

import numpy as np
import pytest
from experiments.task_file_rules import faults_of
from texts import changed_text

from gauge_envs import load_experiment, load_task
from gauge_envs.errors import TaskFileError
from gauge_envs.experiments.task_files import task_spec
from gauge_envs.experiments.variants import (
    INDEX_FILE,
    Collection,
    task_files,
    task_path,
    variants,
)
from gauge_envs.files import data_folder

FOUR_SUBTASKS = "{ 1 = 0.2, 2 = 0.2, 3 = 0.2, 4 = 0.2 }"


@pytest.mark.parametrize("path", task_files(), ids=lambda path: path.stem)
def test_a_file_of_the_package_follows_the_rules(path):
    assert faults_of(path) == []
    spec = load_task(path)
    for variant in spec.variants():
        for name in ("calibrated", *spec.parameters):
            assert load_experiment(variant, name).parameters == name


@pytest.mark.parametrize(
    ("old", "new", "fault"),
    [
        ('"constants" = "metadata"', '"constants" = "guess"', "'guess' is of no known"),
        ('"constants" = "metadata"\n', "", "a number without an entry"),
        ("[score]", "[initial.steel]\n\n[score]", "no material 'steel'"),
        ('family = "SlopeSlider"', 'family = "Slope"', "not named after its family"),
        ("friction = 0.273673", f"friction = {FOUR_SUBTASKS}", "no subtask '4'"),
    ],
)
def test_the_rules_find_a_fault(old, new, fault, tmp_path):
    path = tmp_path / "slope_slider.toml"
    text = task_path("SlopeSlider").read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    assert any(fault in found for found in faults_of(path))


def test_the_index_has_the_names_and_frames_of_the_task_files():
    rows = ["file,family,subtask,material,collection,frames"]
    specs = {path: load_task(path) for path in task_files()}
    for collection in Collection:
        for path, spec in specs.items():
            if spec.collection is collection:
                rows += [
                    f"{path.name},{one.family},{one.subtask or ''},{one.material},{collection},{spec.frame_count(one)}"
                    for one in spec.variants()
                ]
    index = data_folder("tasks") / INDEX_FILE
    assert index.read_text().splitlines() == rows, "write these rows into the index"
    assert len(variants()) == 75


def test_provenance_prefers_the_longest_match():
    spec = task_spec("SlopeSlider")
    assert spec.provenance_of("initial.all.ground.position_m").startswith("video")
    assert spec.provenance_of("subtasks.2.initial.wood.cube.position_m").startswith(
        "metadata"
    )
    assert spec.provenance_of("constants.cube.wood.friction").startswith("metadata")
    assert spec.provenance_of("colour") == "not stated"


MOVES = "velocity_m_per_s = [1, 0, 0]"
WRONG = [
    ("SlopeSlider", 'title = "Slope slider"', 'titel = "x"', "title: missing key"),
    ("SlopeSlider", "recorded = true", "recordet = true", "bodies.cube.recordet: unkn"),
    ("SlopeSlider", "mass_kg = 0.0903", "mass_kg = -0.0903", "cube.wood.mass_kg: "),
    ("SlopeSlider", "mass_kg = 0.0903", "mass_kg = nan", "constants.cube.wood.mass_kg"),
    ("SlopeSlider", "friction = 0.273673", "fricton = 0.2", "wood.fricton: unknown key"),
    ("SlopeSlider", "restitution = 0.223583", "restitution = 1.2", "restitution: "),
    ("SlopeSlider", "[constants.cube]\nwood", "[constants.cube]\noak", "no material"),
    ("SlopeSlider", "[constants.cube]", "[constants.cub]", "'cub' is not defined"),
    ("SlopeSlider", "0.08, 0.12", "0.12, 0.08", "times_s[3]"),
    ("SlopeSlider", '["cube", "board"]', '["cube", "bord"]', "'bord' is not defined"),
    ("SlopeSlider", 'body = "board"', 'body = "bord"', "'bord' is not kinematic"),
    ("SlopeSlider", "[0.0, 1.0, 0.0]", "[0.0, 1.0, 0.1]", "unit vector"),
    ("SlopeSlider", "[0.05, 0.05, 0.05]", "[0.05, 0.05]", "bodies.cube.shape"),
    ("SlopeSlider", "{ all = 9 }", "{ all = 1 }", "subtasks.1.frames"),
    ("SlopeSlider", "{ all = 9 }", f"{{ all = {10**400} }}", "18000"),
    ("SlopeSlider", "{ all = 9 }", "{ wood = 9 }", "no frame count for SlopeSlider-1"),
    ("SlopeSlider", "initial.metal]", "initial.steel]", "no start of"),
    ("SlopeSlider", 'board = "kinematic"', 'board = "dynamic"', "'board' is not kin"),
    ("SlopeSlider", "values_deg", "values_m", "profile.0: values_deg is missing"),
    ("NewtonsCradle", 'kind = "hinge"', 'kind = "hing"', "joints.0.kind"),
    ("FoamStretching", "ratio = 0.23", "ratio = 0.52", "Poisson ratio 0.52"),
    ("FoamStretching", "[0, 7, 8]", "[0, 7, 28]", "marker index 28 is out of range"),
    ("FoamStretching", 'to = "base-1"', 'to = "wall"', "'wall' is not defined"),
    ("StickStack", "used = 0.49", "used = 0.62", "Poisson ratio 0.62"),
    ("BouncingBall", "ground = { position_m", f"ground = {{ {MOVES}, position_m", "'ground' is fixed and"),
]  # fmt: skip


@pytest.mark.parametrize(("family", "old", "new", "message"), WRONG)
def test_a_wrong_file_names_file_key_and_reason(family, old, new, message, tmp_path):
    path = changed_text(task_path(family), (old, new), to=tmp_path / "edited.toml")
    with pytest.raises(TaskFileError) as caught:
        load_task(path)
    assert str(caught.value).startswith(str(path))
    assert message in str(caught.value)


def test_flat_piece_encloses_no_volume(tmp_path):
    text = task_path("SlopeContact").read_text()
    flat = "pieces_m = [[[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.1, 0.1, 0.0]]]"
    path = tmp_path / "flat.toml"
    path.write_text(
        re.sub(r"pieces_m = \[\n.*?\n\]", flat, text, count=1, flags=re.DOTALL)
    )
    with pytest.raises(TaskFileError, match="no volume"):
        load_task(path)


def test_plate_with_hole_has_the_area_of_the_ring():
    shape = load_experiment("Funnel-satin").scene.body("board").shape
    hole = np.pi * 0.10**2
    # The hole is a circumscribed polygon of 32 sides, 0.3 % larger than the circle.
    assert shape.volume_m3 == pytest.approx((0.25 - hole) * 0.012, rel=0.001)


def test_a_task_file_states_a_velocity(tmp_path):
    velocities = (
        "velocity_m_per_s = [1.0, 0.0, -2.0], angular_velocity_deg_per_s = [0, 180, 0]"
    )
    path = changed_text(
        task_path("BouncingBall"),
        ('"BouncingBall"', '"Thrown"'),
        ("ball = { position_m", f"ball = {{ {velocities}, position_m"),
        to=tmp_path / "thrown.toml",
    )
    ball = load_experiment(str(path)).scene.body("ball")
    assert ball.linear_velocity_m_per_s == (1.0, 0.0, -2.0)
    assert ball.angular_velocity_rad_per_s == pytest.approx((0.0, np.pi, 0.0))
