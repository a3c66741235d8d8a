"""What is read from a training configuration: a model's contacts as MuJoCo itself makes them, and its options."""

import re

import gymnasium
import mujoco
import numpy as np
import pytest
from places import ROOT
from sanity_cases import read_text

from gauge_envs import load_experiment
from gauge_envs.backends import backend
from gauge_envs.backends.mujoco.settings import PRESETS, SettingsMuJoCo
from gauge_envs.errors import ParameterError, TargetError
from gauge_envs.tools.bench.model_settings import COLUMNS, contact_pairs
from gauge_envs.tools.sanity.robot.mujoco_model import mujoco_configuration
from gauge_envs.tools.sanity.stacks import configuration

# Every rule by which MuJoCo lets geoms collide or mixes their constants; all of it lies in one heap.
HEAP = """
<mujoco model="heap">
  <option {option}><flag {flag}/></option>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 .1" solref=".01 1.2" margin=".002"/>
    <geom name="step" type="box" size=".5 .5 .1" friction="1.5 .02 .003"/>
    <body name="a"><freejoint/>
      <geom name="a1" size=".2" solmix="3" solref=".04 .7" solimp=".5 .8 .01 .4 3" gap=".003"/>
      <geom name="a2" size=".2" priority="2" condim="4" friction=".3 .05 .01" margin=".01"/>
      <body name="a_child" pos=".01 0 0"><joint axis="0 1 0"/>
        <geom name="child" size=".2" condim="6"/>
        <body name="grandchild" pos="0 .01 0"><joint axis="1 0 0"/><geom name="grandchild" size=".2" condim="1"/></body>
      </body>
      <body name="a_welded" pos="0 0 .01"><geom name="welded" size=".2" solref="-500 -20"/></body>
    </body>
    <body name="b"><freejoint/><geom name="b" size=".2" priority="2" solref="-300 -40" friction="0 0 0"/></body>
    <body name="c"><freejoint/><geom name="c" size=".2" solmix="0" solref=".03 1"/></body>
    <body name="d"><freejoint/><geom name="d" size=".2" solmix="0" solref=".05 1" contype="2" conaffinity="1"/></body>
    <body name="e"><freejoint/><geom name="e" size=".2" contype="0" conaffinity="0"/></body>
    <body name="hand" mocap="true"><geom name="hand" size=".2"/></body>
    <body name="post"><joint axis="0 0 1"/><geom name="post" size=".2"/></body>
  </worldbody>
  <contact>
    <exclude body1="a" body2="c"/>
    <pair geom1="e" geom2="c" condim="3" friction=".7 .8 .01 .002 .003" solref=".015 .9" solreffriction=".03 1.1"
      solimp=".6 .7 .02 .3 4" margin=".004" gap=".001"/>
    <pair geom1="b" geom2="a1" condim="4"/>
  </contact>
</mujoco>
"""


def built(experiment, settings=None, engine="mujoco"):
    """Return the simulation of an experiment with settings."""
    return backend(engine).build(load_experiment(experiment).scene, settings)


def heap(*, option="", flag=""):
    return mujoco.MjModel.from_xml_string(HEAP.format(option=option, flag=flag))


def found_contacts(model, data):
    """Constants of the contacts that MuJoCo makes now, by the geoms; those in which nothing can move left out."""
    contacts = {}
    for contact in data.contact:
        if contact.exclude != 3:
            constants = (
                contact.friction,
                contact.solref,
                contact.solreffriction,
                contact.solimp,
            )
            contacts[tuple(sorted(contact.geom.tolist()))] = np.hstack(
                [contact.dim, *constants, contact.includemargin]
            )
    return contacts


def read_contacts(model):
    pairs = contact_pairs(model)
    without_gap = pairs.constants[:, : COLUMNS["gap"].start]
    return {
        tuple(geoms): row
        for geoms, row in zip(pairs.geoms.tolist(), without_gap, strict=True)
    }


@pytest.mark.parametrize(
    ("option", "flag"),
    [
        ("", ""),
        ("", "filterparent='disable'"),
        (
            "o_margin='.03' o_solref='.007 1.3' o_solimp='.1 .2 .3 .4 5' o_friction='.1 .2 .3 .4 .5'",
            "override='enable'",
        ),
    ],
)
def test_pairs_are_those_that_mujoco_makes_of_a_heap(option, flag):
    model = heap(option=option, flag=flag)
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data)
    made, read = found_contacts(model, data), read_contacts(model)
    assert len(made) > 20
    assert made.keys() == read.keys()
    for geoms, constants in made.items():
        np.testing.assert_allclose(
            read[geoms], constants, rtol=1e-12, err_msg=str(geoms)
        )


def test_a_gap_is_the_sum_of_both():
    # `includemargin` leaves the gap out; it shows in how far apart a contact is found.
    xml = """<mujoco><worldbody><geom type="plane" size="1 1 1" gap=".03"/><body pos="0 0 {height}"><freejoint/>
      <geom size=".1" gap=".02"/></body></worldbody></mujoco>"""
    for height, count in ((0.149, 1), (0.151, 0)):
        model = mujoco.MjModel.from_xml_string(xml.format(height=height))
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        assert data.ncon == count
        assert contact_pairs(model).constants[
            0, COLUMNS["gap"]
        ].item() == pytest.approx(0.05)


def test_half_cheetah(approved):
    approved("sanity/read_half_cheetah", read_text(configuration("HalfCheetah-v5")))


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
    settings = configuration(model).settings
    assert settings["torsional_friction_m"] == 0.01
    for variant in ("SlopeSlider-1-wood", "BouncingBall-rubber", "WallBreaking-wood"):
        scene = load_experiment(variant).scene
        model_of = built(variant, settings | {"drive_interval_s": 0.002}).model
        assert model_of.npair == sum(
            len(list(scene.colliding_pairs(contact))) for contact in scene.contacts
        )
        for field in ("solref", "solreffriction", "solimp", "margin", "gap", "dim"):
            expected = np.broadcast_to(
                getattr(model, f"pair_{field}"),
                getattr(model_of, f"pair_{field}").shape,
            )
            np.testing.assert_array_equal(getattr(model_of, f"pair_{field}"), expected)
        # What slides is a real object: only the other coefficients are the model's.
        np.testing.assert_allclose(
            model_of.pair_friction[:, 2:],
            np.tile([0.01, 0.002, 0.002], (model_of.npair, 1)),
        )
        assert set(model_of.pair_friction[:, 0]) == {
            contact.friction for contact in scene.contacts
        }


def test_a_wall_of_bricks_has_the_constants_in_its_broad_phase_too():
    settings = {
        "contact_solref": (0.01, 0.8),
        "contact_margin_m": 0.004,
        "contact_gap_m": 0.002,
        "condim": 4,
    }
    simulation = built("WallBreaking-wood", settings)
    simulation.advance(1 / 180)
    bricks = {simulation.model.geom(name).id for name in ("brick-1", "brick-2")}
    assert bricks <= set(np.unique(simulation.data.contact.geom))
    free = simulation.data.contact.geom.min(axis=1) >= min(bricks)
    assert free.sum() > 100
    for values, expected in (
        (simulation.data.contact.includemargin, 0.004),
        (simulation.data.contact.dim, 4),
    ):
        np.testing.assert_allclose(values[free], expected)
    np.testing.assert_allclose(
        simulation.data.contact.solref[free], np.tile([0.01, 0.8], (free.sum(), 1))
    )


def test_friction_settings():
    real, scaled, given = (
        built("SlopeSlider-1-wood", settings).model.pair_friction
        for settings in (
            {},
            {"friction_scale": 0.5},
            {"o_friction": [0.1, 0.2, 0.3, 0.4, 0.5]},
        )
    )
    np.testing.assert_allclose(scaled[:, :2], 0.5 * real[:, :2])
    np.testing.assert_allclose(
        given, np.tile([0.1, 0.2, 0.3, 0.4, 0.5], (len(real), 1))
    )


def test_restitution_ends_where_contacts_are_given():
    recipe, given = (
        built("BouncingBall-rubber", settings).model
        for settings in ({}, {"contact_solref": [0.02, 1.0]})
    )
    assert (recipe.pair_solref[:, 1] < -1.0).all()
    assert given.pair_solref.tolist() == [[0.02, 1.0]]
    assert not given.pair_solreffriction.any()


def test_groups_that_differ_are_reported_and_can_be_picked():
    model = heap()
    read = configuration(model)
    assert read.name == "heap"
    assert read.contact_groups[0].geoms.startswith("floor with")
    assert sum(group.pair_count for group in read.contact_groups) == len(
        contact_pairs(model).geoms
    )
    assert any("solref -500 -20" in note for note in read.notes) or len(read.notes) > 3
    picked = configuration(model, pair=("c", "e"))
    assert picked.settings["contact_solimp"] == [0.6, 0.7, 0.02, 0.3, 4.0]
    assert picked.settings["contact_gap_m"] == 0.001
    used = [group for group in picked.contact_groups if group.is_used]
    assert [group.geoms for group in used] == ["c and e with each other"]
    assert picked.origins["contact_margin_m"] == "c and e with each other"
    with pytest.raises(TargetError, match=r"no geom 'nose'; it has floor, step"):
        configuration(model, pair=("floor", "nose"))
    with pytest.raises(TargetError, match="'a1' and 'c' cannot collide"):
        configuration(model, pair=("a1", "c"))


def test_sliding_friction_alone_makes_no_difference():
    hopper = configuration("Hopper-v5")
    assert [group.is_used for group in hopper.contact_groups] == [
        True,
        True,
        False,
        False,
    ]
    assert {
        group.constants["friction"][0]
        for group in hopper.contact_groups
        if group.is_used
    } == {1.0, 2.0}


def test_override_gives_all_contacts_its_own_constants_friction_included():
    read = configuration(
        heap(
            option="o_friction='.1 .2 .3 .4 .5' o_solref='.007 1.3'",
            flag="override='enable'",
        )
    )
    assert read.settings["o_friction"] == [0.1, 0.2, 0.3, 0.4, 0.5]
    assert read.settings["contact_solref"] == [0.007, 1.3]
    assert read.origins["o_friction"] == "option, flag override"


@pytest.mark.parametrize(
    ("xml", "note"),
    [
        ("<option gravity='0 0 -1.62'/>", "gravity of the model is 1.62 m/s"),
        ("<option gravity='1 0 -9.81'/>", r"gravity of the model is \(1, 0, -9.81\)"),
        ("<option><flag gravity='disable'/></option>", "gravity off"),
        ("<option><flag contact='disable'/></option>", "switches off contact"),
        ("<option density='1000'/>", "medium"),
        ("", "no two geoms can collide"),
    ],
)
def test_what_is_not_carried_over_is_reported(xml, note):
    body = "<worldbody><body><freejoint/><geom size='.1'/></body></worldbody>"
    model = mujoco.MjModel.from_xml_string(f"<mujoco>{xml}{body}</mujoco>")
    notes = mujoco_configuration(model, name="model", source="test").notes
    assert any(re.search(note, line) for line in notes), notes


def test_files_backends_and_objects(tmp_path):
    path = tmp_path / "robot.xml"
    (tmp_path / "part.xml").write_text(
        "<mujoco><worldbody><body><freejoint/><geom size='.1'/></body></worldbody></mujoco>"
    )
    path.write_text("""<mujoco><option timestep=".004"/><include file="part.xml"/>
      <worldbody><geom type="plane" size="1 1 1"/></worldbody></mujoco>""")
    read = configuration(path)
    assert (read.name, read.settings["timestep_s"], read.frame_skip) == (
        "robot.xml",
        0.004,
        None,
    )
    assert (
        configuration(mujoco.MjModel.from_xml_path(str(path))).settings == read.settings
    )
    env = gymnasium.make("HalfCheetah-v5")
    assert configuration(env) == configuration("HalfCheetah-v5")
    assert configuration(read) is read
    assert configuration("mujoco:out_of_box").settings == {"preset": "out_of_box"}
    assert configuration("mujoco").settings == {}
    toml = tmp_path / "mine.toml"
    toml.write_text(
        'backend = "mujoco"\npreset = "stack"\n[settings]\ntimestep_s = 0.003\nimpratio = 5.0\n'
    )
    mine = configuration(str(toml))
    assert mine.settings == {"timestep_s": 0.003, "impratio": 5.0, "preset": "stack"}
    assert mine.origins == dict.fromkeys(mine.settings, "mine.toml")


class Robot(gymnasium.Env):
    """An environment of somebody else, with a model and nothing more."""

    def __init__(self):
        self.model = mujoco.MjModel.from_xml_string(
            "<mujoco><option timestep='.005'/></mujoco>"
        )


def test_environments_of_somebody_else(tmp_path, monkeypatch):
    read = configuration(Robot())
    assert (read.name, read.frame_skip, read.settings["timestep_s"]) == (
        "Robot",
        None,
        0.005,
    )
    (tmp_path / "robots.py").write_text(
        "import gymnasium, mujoco\nclass Robot(gymnasium.Env):\n    frame_skip = 4\n"
        "    model = mujoco.MjModel.from_xml_string('<mujoco/>')\n"
        "    action_space = observation_space = gymnasium.spaces.Discrete(1)\n"
        "gymnasium.register('Robot-v0', Robot)\ngymnasium.register('Broken-v0', 'nowhere:Robot')\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    read = configuration("robots:Robot-v0")
    assert (read.name, read.frame_skip, read.settings["timestep_s"]) == (
        "robots:Robot-v0",
        4,
        0.002,
    )
    with pytest.raises(
        TargetError, match=r"'robots:Broken-v0': gymnasium.make fails: .*nowhere"
    ):
        configuration("robots:Broken-v0")


@pytest.mark.parametrize(
    "name", ["good", pytest.param("newton", marks=pytest.mark.slow)]
)
def test_examples_are_read(name):
    read = configuration(ROOT / "examples" / "sanity" / f"{name}.toml")
    assert read.settings["timestep_s"] == 0.002


@pytest.mark.parametrize("name", ["GAUGE/SlopeSlider-1-wood", "SlopeSlider-1-wood"])
def test_an_id_of_this_suite_has_its_own_settings(name):
    settings = configuration(name).settings
    assert settings["preset"] == "contact"
    assert settings == {
        k: v
        for k, v in PRESETS["contact"].model_dump(mode="json").items()
        if k != "drive_interval_s"
    }


def test_the_out_of_box_preset_is_what_a_model_has_that_states_nothing():
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><geom size='1'/><body><freejoint/><geom size='1'/></body></worldbody></mujoco>"
    )
    read = configuration(model).settings
    assert (
        SettingsMuJoCo(preset="out_of_box", drive_interval_s=0.002, **read)
        == PRESETS["out_of_box"]
    )


@pytest.mark.parametrize(
    ("target", "message"),
    [
        ("Nope-v1", r"'Nope-v1': gymnasium.make fails: .*Nope"),
        (3, "int cannot be checked"),
    ],
)
def test_what_cannot_be_read_says_why(target, message):
    with pytest.raises(TargetError, match=message):
        configuration(target)


GENESIS = '{"sim": {"dt": %s, "gravity": [0, 0, 9.81]}, "rigid": {"integrator": %s}}'


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        (
            "a.toml",
            'backend = "mujoco"\nsetings = {}',
            "setings: unknown key; keys: backend, preset, settings",
        ),
        ("a.toml", "preset = 'contact'", "backend: missing key"),
        (
            "a.toml",
            'backend = "mujoco"\n[settings]\ncone = "round"',
            "'cone'.*given: 'round'",
        ),
        ("a.toml", "backend = ", r"a\.toml: ."),
        ("a.json", "[1]", "the file: "),
        ("a.json", GENESIS % ("[]", "0"), "sim.dt is a list, and a number is expected"),
        (
            "a.json",
            GENESIS % ("0.01", "[3]"),
            "rigid.integrator is a list, and a number is expected",
        ),
        (
            "a.json",
            GENESIS.replace("9.81", '"down"') % ("0.01", "0"),
            "sim.gravity is 'down', and a number",
        ),
        (
            "a.xml",
            "<mujoco><option speed='3'/></mujoco>",
            "MuJoCo cannot load it: .*speed",
        ),
        (
            "a.urdf",
            "<robot name='a'><link name='b'><collision><geometry><mesh filename='package://a/b.stl'/></geometry>"
            "</collision></link></robot>",
            "MuJoCo cannot load it: .*; state files of package:// relative to this one",
        ),
    ],
)
def test_a_wrong_file_is_named_with_its_key(tmp_path, name, text, message):
    path = tmp_path / name
    path.write_text(text, errors="surrogateescape")
    with pytest.raises(TargetError, match=message):
        configuration(path)


# --- the step ---------------------------------------------------------------------------------------------------------


def test_a_training_step_runs_with_a_drive_interval_of_its_own():
    settings = {"timestep_s": 0.003, "drive_interval_s": 0.003}
    simulation = built("BouncingBall-rubber", settings)
    for _ in range(50):
        simulation.advance(0.003)
    assert simulation.data.time == pytest.approx(0.15)


@pytest.mark.parametrize(
    "settings",
    [
        {"timestep_s": 0.01},
        {"timestep_s": 0.003},
        {"timestep_s": 0.002, "drive_interval_s": 0.003},
    ],
)
def test_a_step_must_divide_the_drive_interval(settings):
    with pytest.raises(
        ParameterError,
        match=r"'timestep_s': drive_interval_s, 1/\d+\.?\d* s, is .* steps",
    ):
        built("BouncingBall-rubber", settings)


# --- the whole chain --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["HalfCheetah-v5", "Ant-v5", "Humanoid-v5"])
def test_a_cube_moves_as_in_the_model_that_the_settings_are_from(name):
    # The robot's own compiled model, with a real cube on a real board dropped into it far from the robot.
    scene = load_experiment("SlopeSlider-1-wood").scene
    cube, board = scene.body("cube"), scene.body("board")
    friction = scene.contacts[0].friction
    env = gymnasium.make(name)
    model = env.unwrapped.model
    spec = mujoco.MjSpec.from_file(env.unwrapped.fullpath)
    env.close()
    away = np.array([1000.0, 0.0, 0.0])
    names = [model.geom(int(index)).name for index in contact_pairs(model).geoms[0]]
    floor, source = ({geom.name: geom for geom in spec.geoms}[name] for name in names)
    for body, like in ((board, floor), (cube, source)):
        frame = spec.worldbody.add_body(
            name=body.name, pos=away + body.pose.position_m, quat=body.pose.quaternion
        )
        if body is cube:
            frame.add_freejoint()
        frame.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=[0.5 * edge for edge in body.shape.size_m],
            mass=body.mass_kg,
            friction=[friction, 0.0, 0.0],
            contype=4,
            conaffinity=4,
            **{
                key: getattr(like, key)
                for key in ("solref", "solimp", "margin", "gap", "condim", "solmix")
            },
        )
    spec.compiler.settotalmass = -1.0
    model = spec.compile()
    model.opt.gravity[2] = -scene.gravity_m_per_s2
    data = mujoco.MjData(model)
    settings = configuration(name).settings
    step = settings["timestep_s"]
    simulation = backend("mujoco").build(scene, settings | {"drive_interval_s": step})
    address = int(model.jnt_qposadr[model.body("cube").jntadr[0]])
    start = simulation.body_states(["cube"])[0, 0, :3]
    for _ in range(100):
        mujoco.mj_step(model, data)
        simulation.advance(step)
    place = simulation.body_states(["cube"])[0, 0, :3]
    # PGS, Humanoid's solver, stops at a residual that scales with the inertia of the whole model.
    tolerance = 5e-6 if settings["solver"] == "PGS" else 1e-7
    np.testing.assert_allclose(
        place, data.qpos[address : address + 3] - away, atol=tolerance
    )
    assert np.linalg.norm(place - start) > 1e-4


@pytest.mark.parametrize("name", ["robot.xml", "robot.mjcf"])
def test_a_model_file_finds_its_meshes_by_either_name(tmp_path, name):
    corners = [f"v {x} {y} {z}" for x in (0, 1) for y in (0, 1) for z in (0, 1)]
    faces = "f 1 2 3\nf 5 7 6\nf 1 5 2\nf 3 4 7"
    (tmp_path / "box.obj").write_text("\n".join([*corners, faces]))
    (
        tmp_path / name
    ).write_text("""<mujoco><asset><mesh name="box" file="box.obj"/></asset><worldbody><body>
      <joint/><geom type="mesh" mesh="box"/></body></worldbody></mujoco>""")
    assert configuration(tmp_path / name).robot.model.nmesh == 1
