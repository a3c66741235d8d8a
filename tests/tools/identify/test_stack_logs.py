"""Logs and scenes that the libraries of other programs write, against what was written."""

import json
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from pxr import Usd, UsdGeom, UsdPhysics
from ros_bags import ANGLES, COMMANDS, COUNT, TIMES_S, bag_of

from gauge_envs.backends import backend
from gauge_envs.errors import AssetError, ParameterError
from gauge_envs.tools.identify import Identified, Log, identify, read_log
from gauge_envs.tools.identify.bag_child import JOINT_STATE, TRAJECTORY
from gauge_envs.tools.identify.command import _scene
from gauge_envs.tools.identify.fit import machine_of
from gauge_envs.tools.identify.intervals import SCALE
from gauge_envs.tools.identify.mended import mended_urdf, write_files
from gauge_envs.tools.identify.rig import DYNAMICS
from gauge_envs.tools.identify.stack_logs import read_logs
from gauge_envs.tools.usd import read_usd

MODEL = """<mujoco><worldbody><body><joint name="a" axis="0 1 0"/><geom size=".1"/><body><joint name="b" axis="0 1 0"/>
<geom size=".1"/></body></body></worldbody><actuator><position name="to b" joint="b" kp="5"/>
<position name="to a" joint="a" kp="5"/></actuator><sensor><jointvel name="rate a" joint="a"/>
<jointpos name="at a" joint="a"/><jointpos name="at b" joint="b"/>
<jointvel name="rate b" joint="b"/></sensor></mujoco>"""


def same(log, *, joints=("a", "b"), tolerance=1e-12):
    assert log.joints == joints
    assert log.times_s - log.times_s[0] == pytest.approx(TIMES_S, abs=1e-6)
    assert log.position_rad == pytest.approx(ANGLES, abs=tolerance)
    assert log.command_rad == pytest.approx(COMMANDS, abs=tolerance)


# --- mujoco.sysid ---


def test_a_trajectory_of_sysid_is_read(tmp_path):
    """Columns go to joints by the sensors and actuators of the model, whose orders differ."""
    # The package names its classes only where all of its own optional packages are there.
    trajectory = pytest.importorskip("mujoco.sysid._src.trajectory")
    series = trajectory.timeseries.TimeSeries
    spec = mujoco.MjSpec.from_string(MODEL)
    model = spec.compile()
    rates = 2.0 * ANGLES
    sensed = np.stack([rates[:, 0], ANGLES[:, 0], ANGLES[:, 1], rates[:, 1]], axis=1)
    path = tmp_path / "run.npz"
    trajectory.SystemTrajectory(
        model=model,
        control=series.from_control_names(
            TIMES_S, COMMANDS[:, ::-1], model, ["to b", "to a"]
        ),
        sensordata=series.from_names(
            TIMES_S, sensed, model, ["rate a", "at a", "at b", "rate b"]
        ),
        initial_state=np.zeros(4),
        state=None,
    ).save_to_disk(path)
    (log,) = read_logs(path, spec)
    same(log)
    assert np.array_equal(log.rate_rad_per_s, rates)
    assert np.array_equal(log.only(["b"]).position_rad[:, 0], ANGLES[:, 1])
    with pytest.raises(AssetError, match="give its MJCF"):
        read_logs(path)
    motors = spec.copy()
    motors.actuator("to a").biasprm[:] = 0.0
    with pytest.raises(AssetError, match="servos and motors"):
        read_logs(path, motors)


FOUND = Identified(engine="mujoco", settings=(), joints=(), error_rad={})


def test_a_mended_model_and_its_log_are_read_by_sysid(tmp_path):
    """Written for it, they come back through its own class, and through this package's reader."""
    trajectory = pytest.importorskip("mujoco.sysid._src.trajectory")
    xml = MODEL.replace('<jointpos name="at b" joint="b"/>', "")
    motor = '<motor name="to a" joint="a" gear="2" ctrlrange="0 1"/>'
    xml = xml.replace('<position name="to a" joint="a" kp="5"/>', motor)
    spec = mujoco.MjSpec.from_string(xml)
    log = Log("run", TIMES_S, ANGLES, COMMANDS, joints=("a", "b"))
    numbers = [{"kp_n_m_per_rad": 4.0}, {"kp_n_m_per_rad": 7.0}]
    lines = (
        '<!-- a note -->\n<joint name="b" frictionloss="0.2" armature="0.01"/>\n'
        '<position joint="a" kp="4" kv="0.4"/>\n<position joint="b" kp="7" kv="0.3" forcerange="-2 2"/>\n'
    )
    found = replace(FOUND, joints=numbers, names=("a", "b"), lines=lines)
    files = {".xml": tmp_path / "run.xml", ".npz": tmp_path / "run.npz"}
    write_files(files, spec, "arm.xml", found, log)
    mended = mujoco.MjSpec.from_file(str(files[".xml"]))
    model = mended.compile()
    # What a motor with the gear 2 makes of a kp of 1 is 4 at the joint.
    assert model.actuator("to a").gainprm[0] == 1.0
    assert not model.actuator("to a").ctrllimited[0]
    assert model.actuator("to b").forcerange.tolist() == [-2.0, 2.0]
    assert model.joint("b").frictionloss[0] == 0.2
    assert "a note" in files[".xml"].read_text()
    trajectory.SystemTrajectory.load_from_disk(files[".npz"], model)
    (back,) = read_logs(files[".npz"], mended)
    same(back.only(["a", "b"]))
    free = Log("free", TIMES_S, ANGLES, joints=("a", "b"))
    with pytest.raises(ParameterError, match="free swing"):
        write_files(files, spec, "arm.xml", found, free)


URDF = """<robot name="r"><!-- mine --><link name="base"/><link name="arm"/><joint name="a" type="revolute">
<parent link="base"/><child link="arm"/><limit lower="-1" upper="1" effort="9" velocity="1"/></joint></robot>"""


def test_a_mended_urdf_states_friction_and_effort_and_names_the_rest():
    torques = {"dry_friction_n_m": 0.1, "torque_limit_n_m": 2.0, "armature_kg_m2": 0.02}
    numbers = torques | {"viscous_friction_n_m_s_per_rad": 0.3}
    found = replace(FOUND, joints=[numbers], names=("a",))
    text = mended_urdf(URDF, found)
    assert '<dynamics damping="0.3" friction="0.1" />' in text
    assert 'upper="1" effort="2"' in text
    assert "mine" in text and "armature_kg_m2 = 0.02" in text


MESH = """<mujoco><compiler meshdir="meshes"/><asset><mesh name="m" file="m.obj"/></asset><worldbody><body>
<joint name="a"/><geom type="mesh" mesh="m"/></body></worldbody></mujoco>"""
OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
LINK = '<link name="arm"><visual><geometry><mesh filename="meshes/m.obj"/></geometry></visual></link>'


def test_a_mended_file_in_another_folder_finds_its_meshes(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for folder in ("robot/meshes", "out/fitted"):
        Path(folder).mkdir(parents=True)
    Path("robot/meshes/m.obj").write_text(OBJ)
    Path("robot/arm.xml").write_text(MESH)
    Path("robot/arm.urdf").write_text(URDF.replace('<link name="arm"/>', LINK))
    found = replace(FOUND, joints=[{"armature_kg_m2": 0.02}], names=("a",))
    log = Log("run", TIMES_S, ANGLES, joints=("a",))
    spec = mujoco.MjSpec.from_file("robot/arm.xml")
    files = {".xml": Path("out/fitted/arm.xml"), ".urdf": Path("out/fitted/arm.urdf")}
    write_files(files, spec, "robot/arm.urdf", found, log)
    assert mujoco.MjSpec.from_file("out/fitted/arm.xml").compile().nmesh == 1
    assert "../../robot/meshes/m.obj" in Path("out/fitted/arm.urdf").read_text()


# --- ROS 2 ---


@pytest.mark.parametrize("storage", ["sqlite3", "mcap"])
@pytest.mark.parametrize("commands", [JOINT_STATE, TRAJECTORY])
def test_a_bag_is_read(tmp_path, commands, storage):
    """Joints have the order of the commands; a command stays until the next one."""
    bag = bag_of(tmp_path / "bag", commands, storage)
    (log,) = read_logs(bag)
    same(log)


def test_a_bag_without_joint_states_is_refused(tmp_path):
    rosbag2 = pytest.importorskip("rosbags.rosbag2")
    from rosbags.typesys import Stores, get_typestore

    with rosbag2.Writer(tmp_path / "bag", version=9) as bag:
        store = get_typestore(Stores.ROS2_HUMBLE)
        bag.add_connection("/command", JOINT_STATE, typestore=store)
    with pytest.raises(AssetError, match="one topic joint_states"):
        read_logs(tmp_path / "bag")


# --- LeRobot ---


def dataset(folder: Path, version="v3.0"):
    """Two episodes in the layout of version 3, whose tables PyArrow writes, in degrees."""
    arrow = pytest.importorskip("pyarrow")
    from pyarrow import parquet

    feature = {"dtype": "float32", "shape": [2], "names": ["a.pos", "b.pos"]}
    features = {"observation.state": feature, "action": feature}
    (folder / "meta").mkdir(parents=True)
    (folder / "meta" / "info.json").write_text(
        json.dumps({"codebase_version": version, "fps": 50, "features": features})
    )
    (folder / "data" / "chunk-000").mkdir(parents=True)
    for number in range(2):
        numbers = np.rad2deg(np.stack([ANGLES, COMMANDS])).astype(np.float32)
        table = {
            "observation.state": list(numbers[0]),
            "action": list(numbers[1]),
            "timestamp": TIMES_S.astype(np.float32),
            "episode_index": np.full(COUNT, number),
        }
        file = folder / "data" / "chunk-000" / f"file-{number:03d}.parquet"
        parquet.write_table(arrow.table(table), file)
    return folder


def test_each_episode_of_a_dataset_is_a_log(tmp_path):
    logs = read_logs(dataset(tmp_path / "set"), unit="deg")
    assert [one.name[-9:] for one in logs] == ["episode 0", "episode 1"]
    for log in logs:
        same(log, tolerance=1e-6)


def test_a_dataset_without_unit_or_of_another_version_is_refused(tmp_path):
    with pytest.raises(AssetError, match="--angle-unit deg or rad"):
        read_logs(dataset(tmp_path / "set"))
    with pytest.raises(AssetError, match="version 3 is read"):
        read_logs(dataset(tmp_path / "old", "v2.1"), unit="rad")
    with pytest.raises(AssetError, match="folder of the dataset"):
        read_logs(tmp_path / "set" / "data" / "chunk-000" / "file-000.parquet")


# --- USD ---


def articulation(path, elbow=UsdPhysics.RevoluteJoint):
    """Write an arm of two joints by usd-core: a fixed base, drives per degree, limits, and no physics material.

    A slider in place of the elbow moves along the upper arm.
    """
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdPhysics.Scene.Define(stage, "/scene").CreateGravityMagnitudeAttr(9.81)
    heights_m = {"base": 1.0, "upper": 0.9, "fore": 0.7}
    for name, height_m in heights_m.items():
        link = UsdGeom.Cube.Define(stage, f"/{name}")
        link.CreateSizeAttr(1.0)
        link.AddTranslateOp().Set((0.0, 0.0, height_m))
        link.AddScaleOp().Set((0.02, 0.02, 0.2))
        UsdPhysics.RigidBodyAPI.Apply(link.GetPrim())
        UsdPhysics.CollisionAPI.Apply(link.GetPrim())
        UsdPhysics.MassAPI.Apply(link.GetPrim()).CreateMassAttr(0.2)
    root = UsdPhysics.FixedJoint.Define(stage, "/root")
    root.CreateBody1Rel().SetTargets(["/base"])
    root.CreateLocalPos0Attr((0.0, 0.0, heights_m["base"]))
    for name, parent, child, place in (
        ("shoulder", "base", "upper", 0.0),
        ("elbow", "upper", "fore", -0.5),
    ):
        kind = UsdPhysics.RevoluteJoint if name == "shoulder" else elbow
        slides = kind is UsdPhysics.PrismaticJoint
        joint = kind.Define(stage, f"/{name}")
        joint.CreateBody0Rel().SetTargets([f"/{parent}"])
        joint.CreateBody1Rel().SetTargets([f"/{child}"])
        joint.CreateAxisAttr("Z" if slides else "Y")
        # In the cube's own units, of which the height is one.
        joint.CreateLocalPos0Attr((0.0, 0.0, place))
        joint.CreateLocalPos1Attr((0.0, 0.0, 0.5))
        joint.CreateLowerLimitAttr(-90.0)
        joint.CreateUpperLimitAttr(90.0)
        drive = UsdPhysics.DriveAPI.Apply(
            joint.GetPrim(), "linear" if slides else "angular"
        )
        unit = 1.0 if slides else np.pi / 180.0
        drive.CreateStiffnessAttr((50.0 if slides else 5.0) * unit)
        drive.CreateDampingAttr((2.0 if slides else 0.3) * unit)
        drive.CreateMaxForceAttr(4.0)
    stage.GetRootLayer().Save()


TWIN = """<mujoco><option timestep="0.002" gravity="0 0 -9.81" integrator="implicitfast"/><worldbody>
  <body pos="0 0 1"><joint name="shoulder" axis="0 1 0"/><geom type="box" size=".01 .01 .1" pos="0 0 -.1" mass=".2"/>
  <body pos="0 0 -.2"><joint name="elbow" axis="0 1 0"/>
  <geom type="box" size=".01 .01 .1" pos="0 0 -.1" mass=".2"/></body>
  </body></worldbody><actuator><position joint="shoulder" kp="5" kv=".3" forcerange="-4 4"/>
  <position joint="elbow" kp="5" kv=".3" forcerange="-4 4"/></actuator></mujoco>"""


SLIDING = (
    TWIN.replace('name="elbow" axis="0 1 0"', 'name="elbow" type="slide" axis="0 0 1"')
    .replace('joint="elbow" kp="5" kv=".3"', 'joint="elbow" kp="50" kv="2"')
)  # fmt: skip


def test_an_arm_with_a_slider_moves_as_the_same_arm_in_mjcf(tmp_path):
    articulation(tmp_path / "arm.usda", UsdPhysics.PrismaticJoint)
    times_s = np.arange(0.0, 1.0, 0.02)
    steps = np.where(times_s < 0.5, 0.3, -0.2)
    command = np.stack([steps, 0.2 * steps], axis=1)
    start = np.zeros(2), np.zeros(2)
    angles = []
    specs = (
        _scene(str(tmp_path / "arm.usda")),
        mujoco.MjSpec.from_string(SLIDING),
    )
    for spec, joints in zip(
        specs, (("upper", "fore"), ("shoulder", "elbow")), strict=True
    ):
        log = Log("", times_s, np.zeros((times_s.size, 2)), command, joints=joints)
        machine = machine_of(backend("mujoco"), spec, log, [], {})
        angles.append(machine.angles(log, [{}, {}], start))
    assert np.ptp(angles[1][:, 1]) > 0.05
    assert angles[0] == pytest.approx(angles[1], abs=1e-4)


def test_friction_of_a_slider_is_found_from_the_closed_form_of_a_mass_that_stops(
    tmp_path,
):
    mass_kg, dry_n, viscous_n_s_per_m = 0.5, 0.6, 0.4
    file = tmp_path / "mass.usda"
    stage = Usd.Stage.CreateNew(str(file))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, 0.01)
    UsdPhysics.Scene.Define(stage, "/scene").CreateGravityMagnitudeAttr(981.0)
    finger = UsdGeom.Cube.Define(stage, "/finger")
    finger.CreateSizeAttr(2.0)
    UsdPhysics.RigidBodyAPI.Apply(finger.GetPrim())
    UsdPhysics.CollisionAPI.Apply(finger.GetPrim())
    UsdPhysics.MassAPI.Apply(finger.GetPrim()).CreateMassAttr(mass_kg)
    joint = UsdPhysics.PrismaticJoint.Define(stage, "/slider")
    joint.CreateBody1Rel().SetTargets(["/finger"])
    joint.CreateAxisAttr("X")
    stage.GetRootLayer().Save()

    # m v' = -(F + b v) until the mass stops.
    speed = 1.5
    decay = viscous_n_s_per_m / mass_kg
    final = dry_n / viscous_n_s_per_m
    stop_s = np.log1p(speed / final) / decay
    times_s = np.arange(0.0, 1.2 * stop_s, 0.01)
    moving_s = np.minimum(times_s, stop_s)
    place_m = (speed + final) / decay * -np.expm1(-decay * moving_s) - final * moving_s
    rate = np.where(
        times_s < stop_s, (speed + final) * np.exp(-decay * times_s) - final, 0.0
    )
    noise_m = 1e-4 * np.random.default_rng(0).standard_normal(times_s.size)
    table = np.stack([times_s, place_m + noise_m, rate], axis=1)
    header = "time_s,position_m.finger,rate_m_per_s.finger"
    np.savetxt(tmp_path / "log.csv", table, delimiter=",", header=header, comments="")

    log = read_log(tmp_path / "log.csv")
    found = identify(backend("mujoco"), _scene(str(file)), [log], DYNAMICS)
    dry, viscous, armature, drag = found.settings
    assert dry.pasted == pytest.approx(dry_n, rel=5e-3)
    assert viscous.pasted == pytest.approx(viscous_n_s_per_m, rel=5e-3)
    assert drag.value < 0.01 * viscous_n_s_per_m
    # No weight tells the scale of the torques.
    assert armature.unknown == SCALE and armature.pasted is None
    with pytest.raises(AssetError, match="unsupported joint: PhysicsPrismaticJoint"):
        read_usd(file, duration_s=1.0)


def test_an_articulation_of_usd_core_moves_as_the_same_arm_in_mjcf(tmp_path):
    articulation(tmp_path / "arm.usda")
    times_s = np.arange(0.0, 1.0, 0.02)
    steps = np.where(times_s < 0.5, 0.3, -0.2)
    command = np.stack([steps, 2.0 * steps], axis=1)
    log = Log("", times_s, np.zeros((times_s.size, 2)), command)
    scene = _scene(str(tmp_path / "arm.usda"))
    machine = machine_of(backend("mujoco"), scene, log, [], {})
    angles = machine.angles(log, [{}, {}], (np.zeros(2), np.zeros(2)))
    named = replace(log, joints=("shoulder", "elbow"))
    spec = mujoco.MjSpec.from_string(TWIN)
    twin = machine_of(backend("mujoco"), spec, named, [], {})
    expected = twin.angles(named, [{}, {}], (np.zeros(2), np.zeros(2)))
    assert np.ptp(expected) > 0.5
    assert angles == pytest.approx(expected, abs=1e-4)
    with pytest.raises(AssetError, match="no limits"):
        read_usd(tmp_path / "arm.usda", duration_s=1.0)
