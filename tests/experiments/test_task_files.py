"""Task files: an origin of every number, errors with keys, and overrides that change the scene.

Closed forms check the effect of overridden velocities, gravity and initial states.
"""

import math
import re
import tomllib
from typing import get_args

import numpy as np
import pytest
from places import first_of_each_kind
from texts import changed_text

from gauge_envs import (
    beyond_variants,
    load_experiment,
    load_task,
    variants,
)
from gauge_envs.errors import ParameterError, TaskFileError
from gauge_envs.experiments.scene_builder import SceneBuilder
from gauge_envs.experiments.tables import Provenance
from gauge_envs.experiments.task_files import task_spec
from gauge_envs.experiments.task_format import NO_ORIGIN, TaskSpec
from gauge_envs.experiments.variants import (
    INDEX_FILE,
    Collection,
    task_path,
)
from gauge_envs.files import data_folder

SLIDE = "SlopeSlider-2-wood"
FILES = sorted(data_folder("tasks").glob("*.toml"))
ALL = [variant.name for variant in (*variants(), *beyond_variants())]


# --- the files of the package ---


def number_keys(value, key=""):
    """Yield the dotted keys of the numbers, and of the lists of numbers, of a table."""
    if isinstance(value, dict):
        for name, inner in value.items():
            yield from number_keys(inner, f"{key}.{name}" if key else name)
    elif isinstance(value, list) and any(isinstance(entry, dict) for entry in value):
        for index, inner in enumerate(value):
            yield from number_keys(inner, f"{key}.{index}")
    elif not isinstance(value, str | bool) and not (
        isinstance(value, list) and all(isinstance(entry, str) for entry in value)
    ):
        yield key


def faults_of(path):
    """Yield faults in the order, the names and the origins of numbers of a task file."""
    spec, raw = load_task(path), tomllib.loads(path.read_text())
    if list(raw) != sorted(raw, key=list(TaskSpec.model_fields).index):
        yield "the tables have another order than in docs/adding_an_experiment.md"
    if path.stem != re.sub(r"(?<!^)(?=[A-Z])", "_", spec.family).lower():
        yield "the file is not named after its family"
    for table in (spec, *spec.subtasks.values()):
        for name in {*table.frames, *table.initial} - {"all", *spec.materials}:
            yield f"no material {name!r}"
    for key, origin in spec.provenance.items():
        if origin.partition(":")[0] not in get_args(Provenance):
            yield f"provenance.{key}: {origin!r} is of no known kind"
    numbers = {key: raw[key] for key in raw if key not in ("provenance", "revision")}
    for key in number_keys(numbers):
        if spec.provenance_of(key) == NO_ORIGIN:
            yield f"{key}: a number without an entry in [provenance]"


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_a_bundled_file_has_the_origin_of_every_number(path):
    assert list(faults_of(path)) == []


def test_the_index_has_the_names_and_frames_of_the_task_files():
    rows = ["file,family,subtask,material,collection,frames"]
    specs = {path: load_task(path) for path in FILES}
    for collection in Collection:
        for path, spec in specs.items():
            if spec.collection is collection:
                rows += [
                    f"{path.name},{variant.family},{variant.subtask or ''},{variant.material},"
                    f"{collection},{spec.frame_count(variant)}"
                    for variant in spec.variants()
                ]
    assert (data_folder("tasks") / INDEX_FILE).read_text().splitlines() == rows


def test_the_longest_matching_key_gives_the_provenance():
    spec = task_spec("SlopeSlider")
    assert spec.provenance_of("initial.all.ground.position_m").startswith("video")
    start = spec.provenance_of("subtasks.2.initial.wood.cube.position_m")
    assert start.startswith("metadata")
    assert spec.provenance_of("colour") == NO_ORIGIN


@pytest.mark.parametrize(
    ("family", "old", "new", "message"),
    [
        ("SlopeSlider", "title = ", "titel = ", "titel: unknown key; did you mean title?"),
        ("SlopeSlider", "recorded = true", "recordet = true", "recordet: unkn"),
        ("SlopeSlider", "mass_kg = 0.0903", "mass_kg = -0.0903", "cube.wood.mass_kg: "),
        ("SlopeSlider", "restitution = 0.22", "restitution = 1.2", "restitution: "),
        ("SlopeSlider", "[constants.cube]\nwood", "[constants.cube]\noak", "no mater"),
        ("SlopeSlider", "0.08, 0.12", "0.12, 0.08", "times_s[3]"),
        ("SlopeSlider", '["cube", "board"]', '["cube", "b"]', "'b' is not defined"),
        ("SlopeSlider", '= "kinematic"', '= "dynamic"', "'board' is not kinematic"),
        ("SlopeSlider", "[0.0, 1.0, 0.0]", "[0.0, 1.0, 0.1]", "unit vector"),
        ("SlopeSlider", "{ all = 9 }", "{ all = 1 }", "subtasks.1.frames"),
        ("SlopeSlider", "{ all = 9 }", "{ wood = 9 }", "no frame count for SlopeSli"),
        ("SlopeSlider", "initial.metal]", "initial.steel]", "no start of"),
        ("SlopeSlider", 'constants_of = "cube"', "friction = 0.1", "friction: unknown"),
        ("FoamStretching", "ratio = 0.23", "ratio = 0.5", "Poisson ratio 0.5"),
        ("FoamStretching", "[0, 7, 8]", "[0, 7, 28]", "marker index 28 is out of"),
        ("BouncingBall", "ground = { ", "ground = { velocity_m_per_s = [1, 0, 0], ", "'ground' is fixed and"),
    ],
)  # fmt: skip
def test_the_error_of_a_wrong_file_names_file_key_and_reason(
    family, old, new, message, tmp_path
):
    path = changed_text(task_path(family), (old, new), to=tmp_path / "edited.toml")
    with pytest.raises(TaskFileError, match=re.escape(message)) as caught:
        load_task(path)
    assert str(caught.value).startswith(str(path))


# --- overrides ---


def built(name, overrides=()):
    experiment = load_experiment(name)
    builder = SceneBuilder(experiment.spec, experiment.variant, dict(overrides))
    return builder, builder.build()


@pytest.mark.parametrize("name", first_of_each_kind(ALL))
def test_each_number_of_a_body_changes_the_scene_or_is_an_error(name):
    builder, published = built(name)
    assert builder.read
    for body, constants in builder.constants.items():
        for constant, value in constants.items():
            key = f"{body}.{constant}"
            override = {key: 0.9 * (value or 0.0) or 0.1}
            if key in builder.read:
                assert built(name, override)[1] != published, key
            elif value is not None:
                with pytest.raises(ParameterError, match="would change nothing") as no:
                    load_experiment(name, override)
                offered = str(no.value).rpartition(": ")[2].split(", ")
                assert set(offered) <= builder.read
    present = {builder.spec.entry(body.name) for body in published.bodies}
    for body in present | {body.name for body in published.deformables}:
        for field in builder.placements[body].model_dump(exclude_none=True):
            value = np.asarray(getattr(builder.placements[body], field))
            moved = {f"{body}.{field}": value + 0.01}
            assert built(name, moved)[1] != published, (body, field)


@pytest.mark.parametrize("name", first_of_each_kind(ALL))
def test_a_parameter_set_equals_its_overrides(name):
    for label in load_experiment(name).spec.parameters:
        named_set = load_experiment(name, label)
        assert named_set.parameters == label
        assert load_experiment(name, dict(named_set.overrides)).scene == named_set.scene


@pytest.mark.parametrize(
    ("name", "parameters", "message"),
    [
        (SLIDE, {"board.friction": 0.2}, "no motion depends on it.*: cube.friction$"),
        ("Funnel-satin", {"air.density": 1.2}, "did you mean density_kg_per_m3"),
        (
            SLIDE,
            {"air.density_kg_per_m3": 1.2, "air.normal_coefficient": 1.0},
            "the scene has air and no cloth",
        ),
        (SLIDE, {"cub.friction": 0.3}, "names no body of the scene.*did you mean cube"),
        (SLIDE, {"cube.frction": 0.3}, "no constant of 'cube'; did you mean friction"),
        (SLIDE, {"cube.friction": "0.3"}, "should be a valid number"),
        (SLIDE, {"cube.friction": math.nan}, "should be a finite number"),
        (SLIDE, {"cube.friction": -0.1}, "greater than or equal to 0"),
        (SLIDE, {"cube.friction": None}, "is None: expected numbers"),
        (SLIDE, {"cube.position_m": (0.0, 0.0)}, "position_m.2: missing number"),
        (SLIDE, {"scene.gravity_m_per_s2": 0.0}, "should be greater than 0"),
        (SLIDE, "mesured", "no parameter set 'mesured'; did you mean measured"),
        (SLIDE, 3, "expected the name of a parameter set, as 'published', or over"),
        (
            "TextileBending-rayon",
            {"textile.velocity_m_per_s": (1.0, 0.0, 0.0)},
            "'textile' is deformable and starts at rest",
        ),
    ],
)
def test_a_wrong_override_raises_an_error(name, parameters, message):
    with pytest.raises(ParameterError, match=message):
        load_experiment(name, parameters)


def test_overrides_and_task_files_set_initial_velocities(tmp_path):
    overrides = {
        "cube.friction": np.float32(0.3),
        "cube.position_m": np.array([0.1, 0.4, 0.36]),
        "cube.velocity_m_per_s": (0.1, 0, 0.2),
    }
    scene = load_experiment(SLIDE, overrides).scene
    assert scene.contacts[0].friction == pytest.approx(0.3, rel=1e-7)
    assert scene.body("cube").pose.position_m == (0.1, 0.4, 0.36)
    assert scene.body("cube").linear_velocity_m_per_s == (0.1, 0.0, 0.2)
    velocity = "velocity_m_per_s = [1, 0, -2], angular_velocity_deg_per_s = [0, 180, 0]"
    path = changed_text(
        task_path("BouncingBall"),
        ('"BouncingBall"', '"Thrown"'),
        ("ball = { position_m", f"ball = {{ {velocity}, position_m"),
        to=tmp_path / "thrown.toml",
    )
    ball = load_experiment(str(path)).scene.body("ball")
    assert ball.linear_velocity_m_per_s == (1.0, 0.0, -2.0)
    assert ball.angular_velocity_rad_per_s == pytest.approx((0.0, np.pi, 0.0))


def test_the_velocity_of_a_pendulum_follows_from_its_angular_velocity():
    override = {"ball.angular_velocity_deg_per_s": (0.0, 90.0, 0.0)}
    scene = load_experiment("Pendulum-metal", override).scene
    ball, hinge = scene.body("ball"), scene.joints[0]
    arm_m = np.subtract(ball.pose.position_m, hinge.anchor_m)
    velocity = np.cross([0.0, 0.5 * math.pi, 0.0], arm_m)
    assert ball.linear_velocity_m_per_s == pytest.approx(velocity)
