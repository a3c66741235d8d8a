"""An MJCF file in place of a task file: it replays the backend bit for bit, and an edit applies or raises an error.

MuJoCo's own reader loads the file, and plain MuJoCo replays it without this package.
"""

import re

import gymnasium
import mujoco
import numpy as np
import pytest
from places import first_of_each_kind
from texts import changed_text

from gauge_envs import load_experiment, reference_band
from gauge_envs.backends import backend, backend_for
from gauge_envs.backends.mujoco.mjcf.diff import model_changes
from gauge_envs.errors import AssetError, ParameterError, UnsupportedSceneError
from gauge_envs.experiments.variants import variants
from gauge_envs.runs.episodes import run_episodes
from gauge_envs.runs.request import RunRequest
from gauge_envs.scene.diff import ChangeKind
from gauge_envs.scoring.reference import refusal
from gauge_envs.tools.assets.build import assets_folder
from gauge_envs.tools.assets.export import mjcf_text

SLIDE, TILTED, SWING = "SlopeSlider-2-wood", "SlopeSlider-3-wood", "Pendulum-metal"
CLOTH = "TextileStretching-rayon"
IDS = [variant.name for variant in variants()]
TIMESTEP = 'timestep="0.00011111111111111112"'


def shipped(name):
    return assets_folder() / "mjcf" / f"{name}.xml"


@pytest.fixture
def edited(tmp_path):
    """Writes a copy of a shipped file with texts replaced: edited(name, (old, new), ...)."""
    return lambda name, *replacements: changed_text(
        shipped(name), *replacements, to=tmp_path / f"{name}.xml", count=-1
    )


@pytest.mark.parametrize(
    "name", first_of_each_kind(IDS, lambda name: name.split("-")[0])
)
def test_the_shipped_file_is_the_scene_of_the_task_file(name):
    experiment = load_experiment(name, asset=shipped(name))
    assert experiment.asset.changes == ()
    assert experiment.scene == load_experiment(name).scene


@pytest.mark.parametrize(
    "name", [TILTED, pytest.param(CLOTH, marks=pytest.mark.slow), "StickStack-soft"]
)
def test_a_written_file_gives_the_same_trajectory_and_settings(name, tmp_path, rollout):
    """The last digits of tables of stiffness in the shipped file depend on the processor, so it is written here."""
    (tmp_path / f"{name}.xml").write_text(mjcf_text(load_experiment(name)))
    task, expected, _ = rollout(name, frames=3)
    env, mjcf, _ = rollout(name, frames=3, asset=tmp_path / f"{name}.xml")
    np.testing.assert_array_equal(mjcf.samples, expected.samples)
    assert not env.experiment.edited
    file, built = (
        environment.rollout.simulation.settings for environment in (env, task)
    )
    shared = set(file) & set(built)
    assert {"timestep_s", "integrator", "cone", "solver", "iterations"} <= shared
    assert {key: file[key] for key in shared} == {key: built[key] for key in shared}


# --- edits ---


def test_an_edited_mass_pose_and_friction_reach_scene_and_model(edited):
    pair = 'friction="{0} {0} 0 0 0" solref="0.002"'
    path = edited(
        SLIDE,
        ('mass="0.0903"', 'mass="0.2"'),
        ('name="cube" pos="0.097247', 'name="cube" pos="0.098247'),
        (pair.format("0.273673"), pair.format("0.1368365")),
    )
    env = gymnasium.make(f"GAUGE/{SLIDE}", asset=path).unwrapped
    model, scene = env.rollout.simulation.model, env.experiment.scene
    cube = scene.body("cube")
    assert (cube.mass_kg, cube.pose.position_m[0]) == (0.2, 0.098247)
    observation, _ = env.reset(seed=0)
    assert observation["observable"][0] == pytest.approx(98.247)
    assert model.body("cube").mass[0] == 0.2
    assert 0.1368365 in model.pair_friction[:, 0]
    changed = [change.field for change in env.experiment.asset.changes]
    assert changed == [
        ("body_mass",),
        ("body_inertia",),
        ("body_pos",),
        ("pair_friction",),
    ]


@pytest.mark.parametrize(
    ("old", "new", "trials_score", "solution_scores"),
    [
        (TIMESTEP, f'timestep="{1 / 1800!r}"', True, True),
        ('impratio="10"', 'impratio="5"', True, True),
        ('solref="0.002"', 'solref="0.004"', True, True),
        ('solref="0.002"', 'solref="0.002" gap="1"', False, False),
        ('solref="0.002"', 'solref="0.002" margin="0.01"', False, False),
        ('mass="0.0903"', 'mass="0.2"', True, False),
        ('friction="0.273673 0.273673', 'friction="0.2 0.2', True, False),
        ('size="0.025 0.025 0.025"', 'size="0.025 0.03 0.025"', False, False),
        ('gravity="0 0 -9.80665"', 'gravity="0 0 -1.62"', False, False),
        ('gravity="0 0 -9.80665"', 'gravity="0.5 0 -9.793895"', False, False),
        ("<option ", '<option density="1.2" viscosity="1" ', False, False),
        (
            ' type="box" contype="0" conaffinity="0" mass',
            ' type="ellipsoid" contype="0" conaffinity="0" mass',
            False,
            False,
        ),
        ('size="0.25 0.075 0.005"', 'size="0.05 0.075 0.005"', False, False),
        # An array that no list names, together with one that the trials allow.
        (
            'mass="0.0903"',
            'mass="0.2" fluidshape="ellipsoid" fluidcoef="1 1 1 1 1"',
            False,
            False,
        ),
    ],
)
def test_a_reference_scores_a_file_with_the_structure_of_its_scene(
    old, new, trials_score, solution_scores, edited
):
    for name, is_scored in ((SLIDE, trials_score), (TILTED, solution_scores)):
        file = load_experiment(name, asset=edited(name, (old, new)))
        assert (refusal(file, reference_band(file)) is None) == is_scored, name


def test_an_edited_table_of_stiffness_is_a_change(edited):
    table = r'name="flex_bending/textile/weight" size="\d+" data="'
    start = re.search(table, shipped(CLOTH).read_text()).group(0)
    path = edited(CLOTH, (start, f"{start}7"))
    (change,) = load_experiment(CLOTH, asset=path).asset.changes
    assert (change.field, change.kind) == (("flex_bending",), ChangeKind.CONSTANT)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("<worldbody>", '<worldbody><geom name="w" size=".1"/>', "w: added"),
        ("<worldbody>", '<option density="1.2"/><worldbody>', "option: density 0 -> 1"),
        ('type="free" />', 'type="free" damping=".1" />', "model: dof_damping "),
        ('<body name="cube"', '<body name="cube" gravcomp="1"', "cube: body_gravcomp"),
        ('<geom name="cube"', '<geom name="cube" rgba="1 0 0 1"', None),
    ],
)
def test_changes_of_a_model_name_every_kind_of_edit_but_colours(old, new, message):
    text = shipped(SLIDE).read_text()
    before, after = (
        mujoco.MjModel.from_xml_string(content)
        for content in (text, text.replace(old, new))
    )
    changes = [*map(str, model_changes(after, before))]
    if message is None:
        assert changes == []
    else:
        assert any(line.startswith(message) for line in changes), changes


# --- start velocities ---

THROWN = {
    "cube.velocity_m_per_s": (0.4, 0.1, 1 / 3),
    "cube.angular_velocity_deg_per_s": (90.0, 50.0, -70.0),
}


def test_a_start_velocity_replays_in_plain_mujoco(tmp_path):
    """Plain MuJoCo resets to the keyframe, as the comment of the file says."""
    path = tmp_path / "thrown.xml"
    experiment = load_experiment(SLIDE, THROWN)
    path.write_text(mjcf_text(experiment))
    model = mujoco.MjModel.from_xml_path(str(path))
    plain = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, plain, model.key("start").id)
    task = backend("mujoco").build(experiment.scene)
    task.advance(0.5)
    mujoco.mj_step(model, plain, nstep=round(0.5 / model.opt.timestep))
    np.testing.assert_array_equal(plain.qpos, task.data.qpos)


@pytest.mark.parametrize(
    ("name", "body", "start"),
    [
        (SLIDE, "cube", THROWN),
        (SWING, "ball", {"ball.angular_velocity_deg_per_s": (0.0, 90.0, 0.0)}),
    ],
)
def test_a_start_velocity_of_a_file_is_read_into_the_scene(name, body, start, tmp_path):
    thrown = load_experiment(name, start)
    (tmp_path / "thrown.xml").write_text(mjcf_text(thrown))
    file = load_experiment(name, asset=tmp_path / "thrown.xml")
    rates = [
        [*thrown_body.linear_velocity_m_per_s, *thrown_body.angular_velocity_rad_per_s]
        for thrown_body in (thrown.scene.body(body), file.scene.body(body))
    ]
    assert rates[1] == pytest.approx(rates[0], abs=1e-9)
    assert np.abs(rates[0]).max() > 0.1
    assert file.asset.changes[0].field == ("key_qvel",)
    simulation = backend_for("mujoco", file.model_file).build(file.scene)
    for _ in range(2):
        state = simulation.body_states([body])[0, 0]
        assert state[7:] == pytest.approx(rates[0], abs=1e-9)
        simulation.advance(0.1)
        simulation.reset()


# --- what does not fit ---


def driver_rows(columns, factor, offset):
    """Return the driven motion of the tilted board in its file, and a changed one."""
    text = shipped(TILTED).read_text()
    data = re.search(r'name="driver/board" size="\d+" data="([^"]*)"', text).group(1)
    rows = np.array(data.split(), dtype=np.float64).reshape(-1, 19)
    rows[:, columns] = factor * rows[:, columns] + offset
    return data, " ".join(map(repr, rows.ravel().tolist()))


def moved_node():
    node = re.search(r'<body name="textile/\d+" pos="', shipped(CLOTH).read_text())
    return node.group(0), f"{node.group(0)}1"


def keyframe(values):
    return "</mujoco>", f'<keyframe><key name="start" {values}/></keyframe></mujoco>'


@pytest.mark.parametrize(
    ("name", "replacement", "message"),
    [
        (SLIDE, ('mass="0.0903"', 'mas="0.1"'), "not a model that MuJoCo can load: "),
        (
            SLIDE,
            ('<body name="cube"', '<body name="box"'),
            "cube: no body of that name: the file has box, board, ground",
        ),
        (
            SLIDE,
            ('<joint name="cube" type="free" />', ""),
            "cube: it is dynamic and needs a free joint with its name",
        ),
        (SLIDE, (TIMESTEP, 'timestep="0.001"'), "timestep: is 0.001 s: .* 1/180 s"),
        (SLIDE, keyframe('qpos="1 0 1 1 0 0 0"'), "its qpos moves bodies"),
        (
            SWING,
            ('<joint name="ball"', '<joint damping="0.01" name="ball"'),
            "ball: unsupported joint: remove damping",
        ),
        (
            SWING,
            ("</mujoco>", '<actuator><motor joint="ball"/></actuator></mujoco>'),
            "ball: unsupported joint: remove its motor",
        ),
        (
            TILTED,
            ('diaginertia="1000 1000 1000"', 'diaginertia="1 1 1"'),
            "board: its mass and its moments of inertia must be the same",
        ),
        (TILTED, keyframe(f'qvel="{"1 " * 12}"'), "its qvel moves joint 'board'"),
        (TILTED, driver_rows(slice(7, 13), 2.0, 0.0), "board: its rows are not the"),
        (TILTED, driver_rows(0, 1.0, 0.01), "driver/board: its rows are not the mot"),
        (
            CLOTH,
            ('"flex_bending/textile/', '"flex_bending/cloth/'),
            "flex_bending/cloth/weight: does not fit the flexes of the file",
        ),
        (CLOTH, moved_node(), "nodes of a deformable body cannot be moved in MJCF"),
    ],
)
def test_a_missing_part_of_a_file_raises_an_error(name, replacement, message, edited):
    with pytest.raises(AssetError, match=message) as caught:
        load_experiment(name, asset=edited(name, replacement))
    assert str(caught.value).startswith(f"{caught.value.file}: ")


def test_a_model_file_has_its_own_settings_and_engine_and_starts_as_the_task():
    options = {"asset": shipped(SLIDE)}
    with pytest.raises(ParameterError, match="an MJCF file contains its own settings"):
        gymnasium.make(f"GAUGE/{SLIDE}", settings={"timestep_s": 1 / 1800}, **options)
    pytest.importorskip("pybullet")
    with pytest.raises(
        UnsupportedSceneError, match=r"model of another engine.*'mujoco'"
    ):
        gymnasium.make(f"GAUGE/{SLIDE}", backend="pybullet", **options)
    places = [
        [result.trajectory.samples[0] for result in run_episodes(request)]
        for request in (
            RunRequest(SLIDE, repeats=2),
            RunRequest(SLIDE, repeats=2, **options),
        )
    ]
    assert places[1] == pytest.approx(np.array(places[0]), abs=1e-6)
