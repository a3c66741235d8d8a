"""What is read from a training configuration: a model's contacts as MuJoCo itself makes them, and its options."""

import warnings

import gymnasium
import mujoco
import numpy as np
import pytest
from heap import heap
from places import ROOT
from quadruped import quadruped_xml

from gauge_envs import load_experiment
from gauge_envs.backends import backend
from gauge_envs.backends.mujoco.contact_table import contact_pairs
from gauge_envs.errors import TargetError
from gauge_envs.tools.sanity.model_checks.runs import start_data
from gauge_envs.tools.sanity.readers import configuration
from gauge_envs.tools.sanity.target_checks import TARGET_CHECKS
from gauge_envs.tools.sanity.verdict import Need


def built(experiment, settings):
    """Return MuJoCo's simulation of an experiment with settings."""
    return backend("mujoco").build(load_experiment(experiment).scene, settings)


def test_half_cheetah():
    read = configuration("HalfCheetah-v5")
    assert read.settings["contact_solimp"] == [0.0, 0.8, 0.01, 0.5, 2.0]
    assert read.settings["timestep_s"] == 0.01
    assert read.backend == "mujoco"


def test_every_option_of_a_model_reaches_the_built_model():
    model = heap(
        option="timestep='.003' integrator='implicit' cone='elliptic' impratio='7' solver='CG' iterations='33' "
        "tolerance='1e-5' ls_iterations='11' ls_tolerance='.02' noslip_iterations='3' noslip_tolerance='1e-4' "
        "ccd_iterations='20' ccd_tolerance='1e-4' sleep_tolerance='.002'",
        flag="warmstart='disable' refsafe='disable' eulerdamp='disable' nativeccd='disable' multiccd='disable' "
        "island='disable' diagexact='enable' sleep='enable' speculative='enable'",
    )
    settings = dict(configuration(model).settings)
    interval = {"drive_interval_s": settings["timestep_s"]}
    simulation = built("SlopeSlider-1-wood", settings | interval)
    for name in dir(model.opt):
        given = getattr(model.opt, name)
        if not name.startswith("_") and name != "gravity" and not callable(given):
            np.testing.assert_array_equal(
                getattr(simulation.model.opt, name), given, err_msg=name
            )


def test_contact_constants_of_a_model_reach_every_contact():
    model = mujoco.MjModel.from_xml_string("""<mujoco><option cone="elliptic"/><worldbody>
      <geom name="floor" type="plane" size="1 1 1"/><body><freejoint/><geom name="foot" size=".1"/></body></worldbody>
      <contact><pair geom1="floor" geom2="foot" condim="6" friction=".7 .7 .01 .002 .002" solref=".015 .9"
        solreffriction=".03 1.1" solimp=".6 .7 .02 .3 4" margin=".004" gap=".001"/></contact></mujoco>""")
    settings = configuration(model).settings | {"drive_interval_s": 0.002}
    reached = built("WallBreaking-wood", settings).model
    for field in ("solref", "solreffriction", "solimp", "margin", "gap", "dim"):
        given, got = (getattr(m, f"pair_{field}") for m in (model, reached))
        np.testing.assert_array_equal(got, np.broadcast_to(given, got.shape))
    # What slides is a real object: only the other coefficients are the model's.
    others = np.tile([0.01, 0.002, 0.002], (reached.npair, 1))
    np.testing.assert_allclose(reached.pair_friction[:, 2:], others)


def test_contact_groups_are_read_and_a_pair_is_chosen():
    model = heap()
    groups = configuration(model).contact_groups
    assert sum(group.pair_count for group in groups) == len(contact_pairs(model).geoms)
    picked = configuration(model, pair=("c", "e"))
    assert picked.settings["contact_solimp"] == [0.6, 0.7, 0.02, 0.3, 4.0]
    with pytest.raises(TargetError, match=r"no geom 'nose'; it has floor, step"):
        configuration(model, pair=("floor", "nose"))
    with pytest.raises(TargetError, match="'a1' and 'c' cannot collide"):
        configuration(model, pair=("a1", "c"))
    model = heap(option="o_friction='.1 .2 .3 .4 .5'", flag="override='enable'")
    assert configuration(model).settings["o_friction"] == [0.1, 0.2, 0.3, 0.4, 0.5]


def test_contacts_of_a_free_ball_are_not_used_for_resting_objects():
    body = '<body pos="0 0 1"><freejoint/><geom type="{}" size=".1 .1 .1" solref="{} 1"/></body>'
    floor = '<geom type="plane" size="1 1 1"/>'
    bodies = floor + body.format("box", 0.02) + body.format("sphere", 0.5)
    model = mujoco.MjModel.from_xml_string(
        f"<mujoco><worldbody>{bodies}</worldbody></mujoco>"
    )
    (settings,) = configuration(model).contact_sets.values()
    assert settings["contact_solref"] == [0.02, 1.0]


# --- kinds of targets ------------------------------------------------------------------------------------------------


def test_files_backends_and_objects(tmp_path):
    path = tmp_path / "robot.xml"
    (tmp_path / "part.xml").write_text(
        "<mujoco><worldbody><body><freejoint/><geom size='.1'/></body></worldbody></mujoco>"
    )
    path.write_text(
        """<mujoco><option timestep=".004"/><include file="part.xml"/>
      <worldbody><geom type="plane" size="1 1 1"/></worldbody></mujoco>""",
        encoding="utf-8-sig",
    )
    read = configuration(path)
    assert (read.name, read.settings["timestep_s"]) == ("robot.xml", 0.004)
    model = mujoco.MjModel.from_xml_path(str(path))
    assert configuration(model).settings == read.settings
    env = gymnasium.make("HalfCheetah-v5")
    assert configuration(env) == configuration("HalfCheetah-v5")
    assert configuration(read) is read
    assert configuration("mujoco:out_of_box").settings == {"preset": "out_of_box"}
    assert configuration("mujoco").settings == {}
    crate = ROOT / "examples" / "own_experiment" / "crate.toml"
    assert configuration(crate).settings["preset"] == "contact"
    pendulum = configuration("GAUGE/Pendulum-Limit-metal")
    assert Need.CONTACT in pendulum.inapplicable
    assert not configuration("CubeToss-acrylic").inapplicable


def test_checks_of_a_model_start_in_the_state_of_its_data():
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body><freejoint/><geom size='.1'/></body></worldbody></mujoco>"
    )
    data = mujoco.MjData(model)
    data.qpos[2], data.qvel[0] = 0.7, 0.2
    started = start_data(configuration((model, data)).robot.model)
    assert (started.qpos[2], started.qvel[0]) == (0.7, 0.2)
    assert start_data(configuration(model).robot.model).qpos[2] == 0.0


@pytest.mark.parametrize(
    ("name", "text", "encoding"),
    [
        (
            "a.toml",
            'backend = "mujoco"\npreset = "stack"\n[settings]\nimpratio = 5.0',
            "utf-8-sig",
        ),
        (
            "a.json",
            '{"backend": "mujoco", "preset": "stack", "settings": {"impratio": 5}}',
            "utf-16",
        ),
    ],
)
def test_settings_files(tmp_path, name, text, encoding):
    (tmp_path / name).write_text(text, encoding)
    read = configuration(str(tmp_path / name))
    assert read.settings == {"impratio": 5.0, "preset": "stack"}


def test_an_environment_of_somebody_else(tmp_path, monkeypatch):
    (tmp_path / "robots.py").write_text(
        "import gymnasium, mujoco\nclass Robot(gymnasium.Env):\n"
        "    model = mujoco.MjModel.from_xml_string('<mujoco/>')\n"
        "    action_space = observation_space = gymnasium.spaces.Discrete(1)\n"
        "gymnasium.register('Robot-v0', Robot)\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    read = configuration("robots:Robot-v0")
    assert read.name == "robots:Robot-v0"


# --- what cannot be read ---------------------------------------------------------------------------------------------

ARM = """<mujoco>
<asset>
  <mesh name="base" file="{mesh}"/>
</asset>
<worldbody>
  <body name="arm"><joint/><geom {geom}/></body>
</worldbody>{more}
</mujoco>"""


def arm(mesh="tetra.obj", geom='size=".1"', more=""):
    return ARM.format(mesh=mesh, geom=geom, more=more)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        (
            "a.xml",
            arm("parts/base.stl"),
            r'a\.xml:3: mesh "base" needs .*parts/base\.stl, which is not there: copy it there, or set meshdir',
        ),
        ("a.xml", arm("pointer.stl"), r"a\.xml:3: .*is a pointer of Git LFS"),
        (
            "a.urdf",
            "<robot name='a'><link name='b'><collision><geometry>\n<mesh filename='package://a/b.stl'/></geometry>"
            "</collision></link></robot>",
            "a.urdf:2: <mesh> needs .*without package://",
        ),
        ("a.xml", arm(geom='size=".1'), r"a\.xml:[67]: the XML is not well-formed"),
        ("a.xml", arm(geom='siz=".1"'), "a.xml:6: <geom>: unrecognized .*'siz'"),
        (
            "a.xml",
            arm(more='\n<include file="part.xml"/>'),
            r"part\.xml:3: <geom>: unrecognized attribute: 'hue'",
        ),
        ("a.xml", "", "a.xml: it is empty"),
        (
            "a.urdf",
            "<robot xmlns:xacro='x'><link name='b'><inertial><mass value='${m}'/></inertial></link></robot>",
            r"run xacro a\.urdf > robot\.urdf",
        ),
        (
            "a.toml",
            "backend = 3",
            r"backend: Input should be a valid string \(given: 3",
        ),
        (
            "a.toml",
            'backend = "mujoco"\npreset = 3',
            "preset: .* a valid string .*; keys: backend, preset, settings",
        ),
        ("a.toml", 'backend = "mujoco"\n[settings]\ncone = "round"', "given: 'round'"),
    ],
)
def test_a_file_that_cannot_be_read_names_the_line_and_what_to_do(
    tmp_path, name, text, message
):
    (tmp_path / "tetra.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"
    )
    (tmp_path / "pointer.stl").write_text("version https://git-lfs.github.com/spec/v1")
    (tmp_path / "part.xml").write_text(
        "<mujoco>\n<worldbody>\n<geom hue='1'/></worldbody></mujoco>"
    )
    (tmp_path / name).write_text(text)
    with pytest.raises(TargetError, match=message):
        configuration(tmp_path / name)


@pytest.mark.parametrize(
    ("target", "message"),
    [
        ("Nope-v1", r"'Nope-v1': gymnasium.make fails: .*Nope.*; give a Gymnasium id"),
        ("CartPole-v1", r"CartPole-v1 is .*, which has no MuJoCo model; give"),
        ("a.usda", "gymnasium.make fails: .* give a Gymnasium id"),
        ("nowhere.xml", "nowhere.xml: cannot be read: No such file"),
        (".", "gymnasium.make fails: .* give a Gymnasium id"),
        (3, "int cannot be checked; give a Gymnasium id"),
    ],
)
def test_what_is_no_target_says_why(target, message):
    with pytest.raises(TargetError, match=message):
        configuration(target)


# --- warnings --------------------------------------------------------------------------------------------------------


def test_a_warning_of_mujoco_on_the_users_file_is_a_note(tmp_path, capfd):
    (tmp_path / "a.xml").write_text("<mujoco><compiler settotalmass='2'/></mujoco>")
    with warnings.catch_warnings(action="error"):
        warned = configuration(tmp_path / "a.xml").warnings
        configuration("HalfCheetah-v5")
    if mujoco.mj_version() >= 4_000_000:
        assert warned[0].startswith("compiler attribute 'settotalmass'")
    assert capfd.readouterr().err == ""


# --- numbers of a target ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("gravity", "verdict"),
    [
        ((0.0, 0.0, -9.81), "passed"),
        # A slope of 30 degrees, the Moon, gravity along the ground, and upwards.
        ((4.905, 0.0, -8.4957), "passed"),
        ((0.0, 0.0, -1.62), "warning"),
        ((9.81, 0.0, 0.0), "warning"),
        ((0.0, 0.0, 9.81), "failed"),
    ],
)
def test_gravity_is_that_of_the_earth_and_points_to_the_ground(gravity, verdict):
    read = configuration("HalfCheetah-v5")
    read.robot.model.opt.gravity = gravity
    assert TARGET_CHECKS["gravity"].result(read).verdict == verdict


def test_a_task_of_dm_control_is_read_from_its_installed_file(tmp_path, monkeypatch):
    suite = tmp_path / "dm_control" / "suite"
    suite.mkdir(parents=True)
    (suite / "walker.xml").write_text(quadruped_xml())
    (suite.parent / "__init__.py").write_text("raise ImportError('bindings')")
    monkeypatch.syspath_prepend(tmp_path)
    read = configuration("dm_control:walker-walk")
    assert read.robot.model.nu == 0 and read.name == "walker.xml"
    with pytest.raises(TargetError, match="no domain 'worm'; it has walker"):
        configuration("dm_control:worm-run")
