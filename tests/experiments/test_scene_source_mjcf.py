"""MJCF files in the place of a scene: they replay the backend bit for bit, edits count or are refused."""

import re
from functools import partial

import gymnasium
import mujoco
import numpy as np
import pytest
from texts import changed_text

from gauge_envs import load_experiment, load_experiment_from_asset
from gauge_envs.backends import backend, backend_for
from gauge_envs.errors import AssetError, ParameterError
from gauge_envs.experiments.variants import variants
from gauge_envs.runs.episodes import run_episode, run_episodes
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result_file import recorded_experiment
from gauge_envs.tools.assets.build import assets_folder
from gauge_envs.tools.assets.export import write_mjcf
from gauge_envs.tools.mjcf.diff import model_changes
from gauge_envs.tools.mjcf.reader import read_model

ALL = tuple(variant.name for variant in variants())
SLIDE = "SlopeSlider-2-wood"
TILTED = "SlopeSlider-3-wood"
CLOTH = "TextileStretching-rayon"
QUICK = (
    SLIDE,
    TILTED,
    "NonsmoothContact-1-wood",
    "Turntable-1-wood",
    "BouncingBall-rubber",
    "NewtonsCradle-metal",
    "WallBreaking-wood",
    "Pendulum-metal",
    "RopeWinding-rubber",
    CLOTH,
    "StickStack-soft",
)
"""Of each kind of body, joint and driver one id; `build_assets.py --check` compares the files of all."""


def shipped(name):
    return assets_folder() / "mjcf" / f"{name}.xml"


@pytest.fixture
def edited(tmp_path):
    """Writes a copy of a shipped file with texts replaced: edited(name, (old, new), ...)."""
    return lambda name, *replacements: changed_text(
        shipped(name), *replacements, to=tmp_path / f"{name}.xml", count=-1
    )


# --- the shipped files -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=() if name in QUICK else pytest.mark.slow)
        for name in ALL
    ],
)
def test_the_shipped_file_is_the_scenes(name):
    found = load_experiment_from_asset(name, shipped(name))
    assert found.asset.changes == ()
    assert found.scene == load_experiment(name).scene


def test_the_shipped_file_states_the_settings_in_force():
    for name in ("Pendulum-metal", CLOTH):
        file, task = (
            gymnasium.make(
                f"GAUGE/{name}", asset=asset
            ).unwrapped.rollout.simulation.settings
            for asset in (shipped(name), None)
        )
        shared = set(file) & set(task)
        assert {"timestep_s", "integrator", "cone", "solver", "iterations"} <= shared
        assert {key: file[key] for key in shared} == {key: task[key] for key in shared}
        assert file["model_file"] == f"{name}.xml"


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(
            name,
            marks=()
            if name in (TILTED, "NonsmoothContact-1-wood", CLOTH)
            else pytest.mark.slow,
        )
        for name in ALL
    ],
)
def test_a_file_gives_the_same_trajectory_bit_for_bit(name, tmp_path, rollout):
    """It is written here: the last digits of tables of stiffness, which a file holds, depend on the processor."""
    write_mjcf(load_experiment(name), tmp_path / f"{name}.xml")
    _, task, _ = rollout(name, frames=10)
    env, mjcf, _ = rollout(name, frames=10, asset=tmp_path / f"{name}.xml")
    np.testing.assert_array_equal(mjcf.samples, task.samples)
    assert not env.experiment.edited


# --- edits -----------------------------------------------------------------------------------------------------------


def test_an_edited_mass_pose_and_friction_reach_scene_and_model(edited):
    pair = 'friction="{0} {0} 0 0 0" solref="0.002"'
    path = edited(
        SLIDE,
        ('mass="0.0903"', 'mass="0.2"'),
        ('name="cube" pos="0.097247', 'name="cube" pos="0.098247'),
        (pair.format("0.273673"), pair.format("0.1368365")),
    )
    env = gymnasium.make(f"GAUGE/{SLIDE}", asset=path)
    experiment, model = env.unwrapped.experiment, env.unwrapped.rollout.simulation.model
    cube = experiment.scene.body("cube")
    assert (cube.mass_kg, cube.pose.position_m[0]) == (0.2, 0.098247)
    observation, _ = env.reset(seed=0)
    assert observation["observable"][0] == pytest.approx(98.247)
    assert model.body("cube").mass[0] == 0.2
    assert 0.1368365 in model.pair_friction[:, 0]
    changes = [
        line.partition(": ")[2].split(" ")[0] for line in experiment.asset.changes
    ]
    assert changes == ["body_mass", "body_inertia", "body_pos", "pair_friction"]
    assert experiment.edited


def test_a_longer_step_is_the_files(edited):
    path = edited(
        SLIDE, ('timestep="0.00011111111111111112"', f'timestep="{1 / 1800!r}"')
    )
    result = run_episode(RunRequest(SLIDE, asset=path))
    assert result.settings["timestep_s"] == 1 / 1800
    assert result.asset["changes"] == [
        "option: timestep 0.0001111111111 -> 0.0005555555556"
    ]
    assert recorded_experiment(result).scene == load_experiment(SLIDE).scene


def test_an_edited_table_is_a_change(edited):
    text = shipped(CLOTH).read_text()
    numbers = re.search(
        r'name="flex_bending/textile/weight" size="\d+" data="([^ ]*)', text
    )
    old = numbers.group(0)
    path = edited(CLOTH, (old, f"{old[: -len(numbers.group(1))]}7"))
    changes = load_experiment_from_asset(CLOTH, path).asset.changes
    assert len(changes) == 1
    assert changes[0].startswith("flex_bending: ")


def rows_text(change):
    """The driven motion of the tilted board as it stands in its file, and changed."""
    text = shipped(TILTED).read_text()
    match = re.search(r'name="driver/board" size="\d+" data="([^"]*)"', text)
    rows = np.array(match.group(1).split(), dtype=np.float64).reshape(-1, 19)
    change(rows)
    return match.group(1), " ".join(map(repr, rows.ravel().tolist()))


# --- what is refused -------------------------------------------------------------------------------------------------


def faster(rows):
    rows[:, 7:13] *= 2.0


def shifted(rows):
    rows[:, 0] += 0.01


def moved_node():
    text = shipped(CLOTH).read_text()
    node = re.search(r'<body name="textile/\d+" pos="', text).group(0)
    return node, f"{node}1"


@pytest.mark.parametrize(
    ("name", "replacement", "message"),
    [
        (SLIDE, ('mass="0.0903"', 'mas="0.1"'), "MuJoCo cannot load it: "),
        (SLIDE, ("</worldbody>", ""), "MuJoCo cannot load it: "),
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
        *(
            (
                "Pendulum-metal",
                ('<joint name="ball"', f'<joint {term} name="ball"'),
                f"ball: unsupported joint: remove {term.partition('=')[0]}",
            )
            for term in (
                'frictionloss="0.01"',
                'damping="0.01"',
                'armature="0.01"',
                'stiffness="0.01"',
                'limited="true" range="-1 1"',
            )
        ),
        (
            "Pendulum-metal",
            (
                "</mujoco>",
                '<actuator><motor joint="ball" /></actuator></mujoco>',
            ),
            "ball: unsupported joint: remove its motor",
        ),
        (
            TILTED,
            ('<joint name="board" type="free" />', ""),
            "board: it is kinematic and needs a free joint",
        ),
        (
            TILTED,
            ('diaginertia="1000 1000 1000"', 'diaginertia="1 1 1"'),
            "board: its mass and its moments of inertia must be the same",
        ),
        (
            TILTED,
            ('"driver/board"', '"driver/plate"'),
            "driver/board: its rows are not the motion of the scene: .* in USD",
        ),
        (
            SLIDE,
            ('timestep="0.00011111111111111112"', 'timestep="0.001"'),
            "option timestep: is 0.001 s: choose a step .* that divides 1/180 s",
        ),
        (
            CLOTH,
            ('"flex_stiffness/textile/kind"', '"kind"'),
            "flex_stiffness/textile/kinds: does not fit the flexes of the file",
        ),
        (
            CLOTH,
            ('"flex_bending/textile/', '"flex_bending/cloth/'),
            "flex_bending/cloth/weight: does not fit the flexes of the file",
        ),
        (
            TILTED,
            partial(rows_text, faster),
            "driver/board: its rows are not the motion of the scene",
        ),
        (TILTED, partial(rows_text, shifted), "driver/board: its rows are not"),
        (CLOTH, moved_node, "nodes of a deformable body cannot be moved in MJCF"),
    ],
)
def test_what_a_file_lacks_is_reported(name, replacement, message, edited):
    replaced = replacement() if callable(replacement) else replacement
    with pytest.raises(AssetError, match=message) as caught:
        load_experiment_from_asset(name, edited(name, replaced))
    assert str(caught.value).startswith(f"{caught.value.file}: ")


def test_an_mjcf_file_contains_its_own_settings_and_starts_where_it_is_told():
    with pytest.raises(ParameterError, match="an MJCF file contains its own settings"):
        gymnasium.make(
            f"GAUGE/{SLIDE}", asset=shipped(SLIDE), settings={"timestep_s": 1 / 1800}
        )
    starts = [
        [
            one.trajectory.samples[0]
            for one in run_episodes(RunRequest(SLIDE, repeats=2, asset=asset))
        ]
        for asset in (None, shipped(SLIDE))
    ]
    assert starts[1] == pytest.approx(np.array(starts[0]), abs=1e-6)


# --- changes ---


def test_changes_of_a_model_find_every_kind_of_edit():
    text = shipped(SLIDE).read_text()
    built = mujoco.MjModel.from_xml_string(text)
    for old, new, message in (
        (
            "<worldbody>",
            '<worldbody><geom name="wall" type="plane" size="1 1 1"/>',
            "wall: added",
        ),
        (
            "<worldbody>",
            '<option wind="1 0 0" density="1.2"/><worldbody>',
            "option: density 0 -> 1.2",
        ),
        (
            '<geom name="cube"',
            '<geom name="cube" margin="0.001"',
            "cube: geom_margin 0 -> 0.001",
        ),
        (
            'type="free" />',
            'type="free" damping="0.1" />',
            "dof_damping: 6 of 6 numbers differ",
        ),
        (
            '<body name="cube"',
            '<body name="cube" gravcomp="1"',
            "cube: body_gravcomp 0 -> 1",
        ),
    ):
        lines = list(
            model_changes(mujoco.MjModel.from_xml_string(text.replace(old, new)), built)
        )
        assert any(line.startswith(message) for line in lines), (message, lines)
    assert list(model_changes(built, built)) == []
    recoloured = text.replace('<geom name="cube"', '<geom name="cube" rgba="1 0 0 1"')
    assert list(model_changes(mujoco.MjModel.from_xml_string(recoloured), built)) == []


# --- start velocities ------------------------------------------------------------------------------------------------

THROWN = {
    "cube.velocity_m_per_s": (0.4, 0.1, 1 / 3),
    "cube.angular_velocity_deg_per_s": (90.0, 50.0, -70.0),
}


def test_an_exported_start_velocity_replays_bit_for_bit(tmp_path, rollout):
    experiment = load_experiment(SLIDE, THROWN)
    write_mjcf(experiment, tmp_path / "thrown.xml")
    text = (tmp_path / "thrown.xml").read_text()
    assert "mj_resetDataKeyframe" in text
    assert '<key name="start"' in text
    path = tmp_path / "thrown.xml"
    scene, changes = read_model(path, experiment.scene)
    assert changes == ()
    file = backend_for("mujoco", path).build(scene)
    # Plain MuJoCo, as the comment of the file says.
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "thrown.xml"))
    plain = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, plain, model.key("start").id)
    task = backend("mujoco").build(experiment.scene)
    for simulation in (file, task):
        simulation.advance(0.5)
    mujoco.mj_step(model, plain, nstep=round(0.5 / model.opt.timestep))
    np.testing.assert_array_equal(file.data.qpos, task.data.qpos)
    np.testing.assert_array_equal(plain.qpos, task.data.qpos)


@pytest.mark.parametrize(
    ("name", "body", "start"),
    [
        (SLIDE, "cube", THROWN),
        (
            "Pendulum-metal",
            "ball",
            {"ball.angular_velocity_deg_per_s": (0.0, 90.0, 0.0)},
        ),
    ],
)
def test_a_start_velocity_of_a_file_is_the_scenes(name, body, start, tmp_path):
    experiment = load_experiment(name, start)
    write_mjcf(experiment, tmp_path / "thrown.xml")
    found = load_experiment_from_asset(name, tmp_path / "thrown.xml")
    mine, its = (one.scene.body(body) for one in (found, experiment))
    rates = [*its.linear_velocity_m_per_s, *its.angular_velocity_rad_per_s]
    assert [
        *mine.linear_velocity_m_per_s,
        *mine.angular_velocity_rad_per_s,
    ] == pytest.approx(rates, abs=1e-9)
    assert np.abs(rates).max() > 0.1
    assert found.asset.changes[0].startswith(
        f"{body}: linear_velocity_m_per_s 0 0 0 ->"
    )
    simulation = backend_for("mujoco", found.model_file).build(found.scene)
    for _ in range(2):
        now = simulation.body_states([body])[0, 0, 7:]
        assert now == pytest.approx(rates, abs=1e-9)
        simulation.advance(0.1)
        simulation.reset()


@pytest.mark.parametrize(
    ("name", "key", "message"),
    [
        (SLIDE, '<key name="start" qpos="1 0 1 1 0 0 0"/>', "its qpos moves bodies"),
        (TILTED, '<key name="start" qvel="{}"/>', "its qvel moves joint 'board'"),
    ],
)
def test_a_keyframe_that_moves_anything_else_is_refused(name, key, message, edited):
    model = mujoco.MjModel.from_xml_path(str(shipped(name)))
    rates = np.zeros(model.nv)
    if name == TILTED:
        rates[model.joint("board").dofadr[0]] = 1.0
    key = key.format(" ".join(map(str, rates)))
    path = edited(name, ("</mujoco>", f"<keyframe>{key}</keyframe></mujoco>"))
    with pytest.raises(AssetError, match=message):
        load_experiment_from_asset(name, path)


def test_other_keyframes_have_no_effect(edited):
    path = edited(
        SLIDE,
        (
            "</mujoco>",
            '<keyframe><key name="home" qvel="1 0 0 0 0 0"/></keyframe></mujoco>',
        ),
    )
    found = load_experiment_from_asset(SLIDE, path)
    assert found.scene.body("cube").starts_at_rest
    assert (
        not backend_for("mujoco", found.model_file).build(found.scene).data.qvel.any()
    )
