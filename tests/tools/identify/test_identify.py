"""Identification of joints against logs from SciPy's integration of their equations, and from a closed form."""

import json
from dataclasses import replace

import approval
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import lfilter

from gauge_envs.backends import backend
from gauge_envs.errors import AssetError, ParameterError, UnsupportedSceneError
from gauge_envs.runs.rollout import DivergedError
from gauge_envs.scene import (
    BodyHinge,
    Box,
    Hinge,
    JointDynamics,
    Motion,
    Pose,
    RigidBody,
    Scene,
)
from gauge_envs.scene.motors import Servo
from gauge_envs.scene.profiles import SampledProfile
from gauge_envs.tools.identify import Identified, Log, identify, one_joint, read_log
from gauge_envs.tools.identify.noise import lasting_noise
from gauge_envs.tools.identify.rig import posed
from gauge_envs.tools.identify.stages import parts_of
from gauge_envs.tools.identify.words import KV_NOTE, identified_document
from gauge_envs.tools.usd.writer import to_usd

MASS_KG, LENGTH_M, INERTIA_KG_M2 = 0.5, 0.2, 1e-3
G = 9.80665
STEP = {"timestep_s": 1 / 540}
NOISE_RAD = 1e-3
VISCOUS = "viscous_friction_n_m_s_per_rad"
DRY = "dry_friction_n_m"
ARMATURE = "armature_kg_m2"
MODULES = {"drake": "pydrake", "physx": "sapien", "rapier": "rapier3d"}


def swing(*, dry, viscous, armature, zero_rad=0.0):
    """A noisy log of 3 s of a pendulum whose equation SciPy integrates, from 0.5 rad at rest."""
    inertia = INERTIA_KG_M2 + MASS_KG * LENGTH_M**2 + armature

    def slopes(_, state):
        angle, rate = state
        # A steep slope in place of the jump of dry friction; the swing does not stop within the log.
        friction = dry * np.tanh(rate / 1e-3) + viscous * rate
        return [rate, -(MASS_KG * G * LENGTH_M * np.sin(angle) + friction) / inertia]

    times_s = np.arange(0.0, 3.0, 0.02)
    angles = solve_ivp(
        slopes,
        (0.0, 3.0),
        [0.5, 0.0],
        t_eval=times_s,
        rtol=1e-9,
        atol=1e-10,
        method="LSODA",
    ).y[0]
    noise = NOISE_RAD * np.random.default_rng(1).standard_normal(times_s.size)
    return Log("swing", times_s, (angles + zero_rad + noise)[:, None])


def found_in(log, *names, engine="mujoco"):
    scene = one_joint(MASS_KG, LENGTH_M, INERTIA_KG_M2)
    return identify(backend(engine), scene, [log], names, settings=STEP)


@pytest.mark.slow
@pytest.mark.parametrize(("dry", "viscous"), [(0.01, 0.005), (0.02, 0.0), (0.0, 0.01)])
def test_friction_of_a_free_swing_is_told_apart(dry, viscous):
    found = found_in(
        swing(dry=dry, viscous=viscous, armature=0.004, zero_rad=0.1),
        DRY,
        VISCOUS,
        ARMATURE,
    )
    truth = {DRY: dry, VISCOUS: viscous, ARMATURE: 0.004}
    scale = {DRY: 0.001, VISCOUS: 0.0005, ARMATURE: 0.0001}
    for one in found.settings:
        assert abs(one.value - truth[one.name]) < scale[one.name], one
        assert (
            one.low - 0.3 * scale[one.name]
            <= truth[one.name]
            <= one.high + 0.3 * scale[one.name]
        ), one
        assert bool(one.unknown) == (truth[one.name] == 0.0), one
    (error,) = found.error_rad["swing"]
    assert error == pytest.approx(NOISE_RAD, rel=0.2)


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["newton", "pybullet", "physx", "rapier", "drake"])
def test_friction_is_found_on_each_engine(engine):
    """One interval in twenty misses the truth, so each may be off by one and a half of its half width."""
    pytest.importorskip(MODULES.get(engine, engine))
    truth = {DRY: 0.01, VISCOUS: 0.005} | (
        {} if engine == "pybullet" else {ARMATURE: 0.004}
    )
    log = swing(
        dry=0.01, viscous=0.005, armature=truth.get(ARMATURE, 0.0), zero_rad=0.1
    )
    for one in found_in(log, *truth, engine=engine).settings:
        middle, half = 0.5 * (one.low + one.high), 0.5 * (one.high - one.low)
        assert abs(truth[one.name] - middle) < 1.5 * half, one
        assert half < 0.15 * truth[one.name], one


@pytest.mark.parametrize(
    ("engine", "step_s"),
    [
        *(("mujoco", step_s) for step_s in (0.0005, 0.002, 0.005, 0.02)),
        pytest.param("pybullet", 0.005, marks=pytest.mark.slow),
    ],
)
def test_every_step_of_a_training_stack_is_taken(engine, step_s):
    """A small swing decays as the linear oscillator does; steps of 1 to 20 ms are no part of 1/180 s."""
    pytest.importorskip(MODULES.get(engine, engine))
    inertia = INERTIA_KG_M2 + MASS_KG * LENGTH_M**2
    viscous = 0.01
    decay = 0.5 * viscous / inertia
    frequency = np.sqrt(MASS_KG * G * LENGTH_M / inertia - decay**2)
    times_s = np.arange(0.0, 1.5, 0.01)
    angles = 0.05 * np.exp(-decay * times_s) * np.cos(frequency * times_s)
    log = Log("swing", times_s, angles[:, None])
    scene = one_joint(MASS_KG, LENGTH_M, INERTIA_KG_M2)
    found = identify(
        backend(engine), scene, [log], [VISCOUS], settings={"timestep_s": step_s}
    )
    assert found.settings[0].value == pytest.approx(viscous, rel=0.03)


@pytest.mark.slow
def test_a_viscous_joint_does_not_fit_as_a_dry_one():
    (error,) = found_in(
        swing(dry=0.0, viscous=0.02, armature=0.004), DRY, ARMATURE
    ).error_rad["swing"]
    assert error > 5.0 * NOISE_RAD


def servo_log(*, kp, kv, delay_s):
    """A noisy log of the closed form of a servo without gravity: steps of its command, of second order."""
    inertia = INERTIA_KG_M2
    frequency, damping = np.sqrt(kp / inertia), kv / (2.0 * np.sqrt(kp * inertia))
    damped = frequency * np.sqrt(1.0 - damping**2)
    times_s = np.arange(0.0, 2.0, 0.005)
    edges = [(0.1, 0.3), (0.7, -0.5), (1.3, 0.4)]
    angle, command = np.zeros((2, times_s.size))
    for start_s, height in edges:
        t = np.maximum(times_s - start_s - delay_s, 0.0)
        decay = np.exp(-damping * frequency * t)
        angle += height * (
            1.0
            - decay
            * (np.cos(damped * t) + damping * frequency / damped * np.sin(damped * t))
        )
        command += height * (times_s >= start_s)
    noise = NOISE_RAD * np.random.default_rng(2).standard_normal(times_s.size)
    return Log("servo", times_s, (angle + noise)[:, None], command[:, None])


def test_gains_and_delay_of_a_servo_are_found():
    scene = one_joint(MASS_KG, 0.0, INERTIA_KG_M2)
    log = servo_log(kp=0.8, kv=0.02, delay_s=0.05)
    names = ("kp_n_m_per_rad", "kv_n_m_s_per_rad", "delay_s")
    found = identify(
        backend("mujoco"),
        scene,
        [log],
        names,
        settings=STEP,
        held_out=[servo_log(kp=0.8, kv=0.02, delay_s=0.05)],
    )
    kp, kv, delay_s = (one.value for one in found.settings)
    assert found.lost == []
    assert kp == pytest.approx(0.8, rel=0.02)
    assert kv == pytest.approx(0.02, rel=0.04)
    assert delay_s == pytest.approx(0.05, abs=0.0015)
    assert float(found.held_out_rad["servo"][0]) < 4.0 * NOISE_RAD
    assert KV_NOTE in identified_document(found).parts[0].notes
    assert f'kp="{kp:.5g}"' in found.lines
    assert 'delay="0.0' in found.lines


@pytest.mark.parametrize(
    "engine",
    [
        pytest.param(name, marks=pytest.mark.slow)
        for name in ("rapier", "physx", "pybullet", "drake", "newton")
    ],
)
def test_a_servo_is_found_on_each_engine_but_for_its_step(engine):
    """An engine that takes the angle at the end of its step has a damping of kp times the step more, and kv is less.

    With the step of the other tests, the engines' error of first order is half of the noise.
    """
    pytest.importorskip(MODULES.get(engine, engine))
    kp, kv = 0.8, 0.02
    step_s = STEP["timestep_s"] / 4
    log, scene = (
        servo_log(kp=kp, kv=kv, delay_s=0.05),
        one_joint(MASS_KG, 0.0, INERTIA_KG_M2),
    )
    names = ("kp_n_m_per_rad", "kv_n_m_s_per_rad", "delay_s")
    found = identify(
        backend(engine), scene, [log], names, settings={"timestep_s": step_s}
    )
    found_kp, found_kv, delay_s = (one.value for one in found.settings)
    assert found_kp == pytest.approx(kp, rel=0.025)
    assert -0.02 * kv - kp * step_s < found_kv - kv < 0.02 * kv
    assert delay_s == pytest.approx(0.05, abs=0.0015)
    assert float(found.error_rad["servo"][0]) == pytest.approx(NOISE_RAD, rel=0.1)


def test_noise_is_found_although_the_unknowns_take_up_some_of_it():
    """White and lasting noise of which six slow waves were taken away: its variance, and that of its mean."""
    random, count, share, planted = np.random.default_rng(3), 400, 0.9, []
    times = np.arange(count) / count
    waves = np.stack(
        [wave(np.pi * k * times) for k in (1, 2, 3) for wave in (np.cos, np.sin)],
        axis=1,
    )
    spanned = np.linalg.qr(waves)[0]
    for _ in range(12):
        shocks = random.standard_normal(count + 100) * np.sqrt(1.0 - share**2)
        noise = lfilter([1.0], [1.0, -share], shocks)[100:] + random.standard_normal(
            count
        )
        left = noise - spanned @ (spanned.T @ noise)
        variance, neighbours, decay = lasting_noise([np.column_stack([spanned, left])])
        planted.append((variance, variance + 2.0 * neighbours / (1.0 - decay)))
    variance, lasting = np.median(planted, axis=0)
    assert variance == pytest.approx(2.0, rel=0.1)
    assert lasting == pytest.approx(2.0 + 2.0 * share / (1.0 - share), rel=0.25)


def test_a_log_that_is_followed_exactly_has_no_noise():
    """The Gram matrix of the unknowns and such a residual has no Cholesky factor."""
    waves = np.linalg.qr(np.vander(np.linspace(0.0, 1.0, 50), 3))[0]
    variance, neighbours, decay = lasting_noise(
        [np.column_stack([waves, np.zeros(50)])]
    )
    assert variance == pytest.approx(0.0, abs=1e-12)
    assert neighbours == pytest.approx(0.0, abs=1e-12) and 0.0 < decay < 1.0


def found_without_weight(name):
    """What a log of a servo gives of its gains and another number."""
    scene = one_joint(MASS_KG, 0.0, INERTIA_KG_M2)
    log = servo_log(kp=0.8, kv=0.02, delay_s=0.0)
    names = ("kp_n_m_per_rad", "kv_n_m_s_per_rad", name)
    return identify(backend("mujoco"), scene, [log], names, settings=STEP)


def test_what_the_log_does_not_tell_apart_is_said():
    found = found_without_weight(VISCOUS)
    assert [bool(one.unknown) for one in found.settings] == [False, True, True]
    assert "kv_n_m_s_per_rad" in found.settings[2].unknown


def test_a_log_that_tells_only_ratios_of_torques_is_said():
    """Without weight, an armature that is fitted scales with all torques."""
    found = found_without_weight(ARMATURE)
    assert all("only ratios of torques" in one.unknown for one in found.settings)


def test_an_engine_that_diverges_says_which_step_to_use():
    """RK4 needs kv times the step over the inertia below 2.78: at 1/540 s kv would have to be below 0.0150."""
    scene, times_s = one_joint(0.01, 0.0, 1e-5), np.arange(0.0, 0.5, 0.005)
    (hinge,) = scene.joints
    assert isinstance(hinge, Hinge)
    still = SampledProfile(times_s=(0.0, 1.0), values=(0.0, 0.0))
    stated = Servo(command=still, kp_n_m_per_rad=1.0, kv_n_m_s_per_rad=0.01)
    scene, command = (
        replace(scene, joints=(replace(hinge, motor=stated),)),
        # A command stays for 5 ms: in the mean it is as old as half of that.
        0.4 * np.sin(9.0 * (times_s + 0.0025))[:, None],
    )
    # A servo of first order, 0.02 s behind; the inertia is far too small to be seen.
    lag = np.arctan(9.0 * 0.02)
    start = 0.4 * np.cos(lag) * np.sin(lag) * np.exp(-times_s / 0.02)[:, None]
    measured = 0.4 * np.cos(lag) * np.sin(9.0 * times_s - lag)[:, None] + start
    log, engine = Log("stiff", times_s, measured, command), backend("mujoco")
    settings = {"timestep_s": 1 / 540, "preset": "contact_free"}
    with pytest.raises(
        DivergedError,
        match=r"give --set timestep_s=0\.000925926 or less; it is 0\.00185185",
    ):
        identify(engine, scene, [log], ["kv_n_m_s_per_rad"], settings=settings)
    (kv,) = identify(
        engine,
        scene,
        [log],
        ["kv_n_m_s_per_rad"],
        settings=settings | {"timestep_s": 1 / 1080},
    ).settings
    assert kv.value == pytest.approx(0.02, rel=0.02)


URDF = f"""<robot name="arm"><link name="base"/><link name="load"><inertial>
  <origin xyz="0 0 {-LENGTH_M}"/><mass value="{MASS_KG}"/>
  <inertia ixx="{INERTIA_KG_M2}" iyy="{INERTIA_KG_M2}" izz="{INERTIA_KG_M2}" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="joint_0" type="continuous"><parent link="base"/><child link="load"/>
  <axis xyz="0 1 0"/></joint></robot>"""


def test_an_arm_is_read_from_a_layer_and_a_urdf(tmp_path, gauge):
    log = tmp_path / "log.csv"
    log.write_text(
        "time_s,position_rad\n"
        + "".join(f"{0.01 * n},{0.1 * np.cos(0.07 * n)}\n" for n in range(60))
    )
    to_usd(one_joint(MASS_KG, LENGTH_M, INERTIA_KG_M2), tmp_path / "arm.usda")
    (tmp_path / "arm.urdf").write_text(URDF)
    words = ["recipe", "joint", str(log), f"--fit={VISCOUS}", "--json"]
    layer, urdf, load = (
        json.loads(gauge(*words, *load).stdout)["settings"][0]["value"]
        for load in (
            (f"--scene={tmp_path / 'arm.usda'}",),
            (f"--scene={tmp_path / 'arm.urdf'}",),
            (
                f"--mass={MASS_KG}",
                f"--length={LENGTH_M}",
                f"--inertia={INERTIA_KG_M2}",
            ),
        )
    )
    assert layer == pytest.approx(load, rel=1e-4)
    # MuJoCo gives a URDF Euler's step of 2 ms, its own default, and a scene `implicitfast`.
    assert urdf == pytest.approx(load, rel=0.01)
    refused = gauge(*words, "--scene=arm.step")
    assert refused.exit_code == 2
    assert "an MJCF (.xml), a URDF" in " ".join(refused.stderr.split())


def test_a_chain_is_posed_by_the_angles_of_its_hinges():
    def link(name, height_m):
        pose = Pose(position_m=(0.0, 0.0, height_m))
        return RigidBody(
            name=name,
            shape=Box(size_m=(0.02, 0.02, 0.2)),
            motion=Motion.DYNAMIC,
            pose=pose,
            mass_kg=0.1,
        )

    hinge = Hinge(body="upper", anchor_m=(0.0, 0.0, 0.0), axis=(0.0, 1.0, 0.0))
    elbow = BodyHinge(
        first="lower", second="upper", anchor_m=(0.0, 0.0, -0.2), axis=(0.0, 1.0, 0.0)
    )
    scene = Scene(
        bodies=(link("lower", -0.3), link("upper", -0.1)),
        joints=(hinge,),
        body_hinges=(elbow,),
        duration_s=1.0,
    )
    # A positive angle turns the second body, the upper one, relative to the first: the lower one turns back.
    first, second = 0.3, -0.5
    moved = posed(scene, [first, second], [1.0, 2.0])
    upper, lower = -first, -(first - second)
    ends = (
        np.array([np.sin(upper), 0.0, -np.cos(upper)]),
        np.array([np.sin(lower), 0.0, -np.cos(lower)]),
    )
    assert moved.body("upper").pose.position_m == pytest.approx(0.1 * ends[0])
    assert moved.body("lower").pose.position_m == pytest.approx(
        0.2 * ends[0] + 0.1 * ends[1]
    )
    assert moved.body("lower").angular_velocity_rad_per_s == pytest.approx(
        (0.0, 1.0 - 2.0, 0.0)
    )


HEADER = "time_s,position_rad,command_rad\n"


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (
            "time_s,angle\n0,0\n",
            "position_rad: the column is missing; the file has time_s, angle",
        ),
        ("", "time_s: the column is missing; the file has none"),
        (HEADER + "0,x,0\n", "could not convert string 'x'"),
        (HEADER, "0 samples: 20 or more"),
        (HEADER + "0,0\n1,0,0\n", "cannot be read"),
        (
            "time_s,position_rad,cmd\n" + "".join(f"{n},0,0\n" for n in range(30)),
            "cmd: .* swings freely: rename",
        ),
        (
            "time_s,position_rad.a,position_rad.b,command_rad.a\n0,0,0,0\n",
            "command_rad.b: the column is missing",
        ),
        (HEADER + "".join(f"{n},0,0\n" for n in range(5)), "5 samples: 20 or more"),
        (HEADER + "".join(f"{n % 15},0,0\n" for n in range(30)), "row 16 is not later"),
        (
            HEADER + "".join(f"{n},{'nan' if n == 3 else 0},0\n" for n in range(30)),
            "row 4 is not a finite number",
        ),
        ("time_s,position_rad,command_rad,torque_n_m\n" + "0,0,0,0\n", "not both"),
    ],
)
def test_a_bad_log_is_explained(tmp_path, text, reason):
    path = tmp_path / "log.csv"
    path.write_text(text)
    with pytest.raises(AssetError, match=reason):
        read_log(path)


def test_a_log_of_two_joints_has_two_columns(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(
        "time_s,position_rad.a,position_rad.b\n"
        + "".join(f"{n},1,2\n" for n in range(30))
    )
    log = read_log(path)
    assert log.position_rad.shape == (30, 2)
    with pytest.raises(ParameterError, match="2 joints, and the scene 1 hinges"):
        identify(backend("mujoco"), one_joint(1.0, 0.1), [log], [DRY])
    scene = one_joint(1.0, 0.1)
    play = replace(
        scene.hinges[0], dynamics=JointDynamics(armature_kg_m2=0.01, backlash_rad=0.01)
    )
    with pytest.raises(ParameterError, match="backlash_rad: set it to 0, and fit it"):
        identify(backend("mujoco"), replace(scene, joints=(play,)), [log], [DRY])


@pytest.mark.parametrize("form", ["spreadsheet", "order", "npz"])
def test_a_log_in_another_form_is_the_same(tmp_path, form):
    times_s = np.arange(30) / 50
    angles, commands = (
        np.column_stack([turn(times_s), turn(2 * times_s)]) for turn in (np.sin, np.cos)
    )
    path = tmp_path / f"log.{'npz' if form == 'npz' else 'csv'}"
    if form == "npz":
        np.savez(path, time_s=times_s, position_rad=angles, command_rad=commands)
    else:
        kinds = (
            "position_rad.a",
            "position_rad.b",
            "command_rad.b",
            "command_rad.a",
            "state",
        )
        header = ",".join(("time_s", *kinds))
        rows = [
            f"{t!r},{a!r},{b!r},{d!r},{c!r},on"
            for t, (a, b), (c, d) in zip(
                times_s.tolist(), angles.tolist(), commands.tolist(), strict=True
            )
        ]
        text = "\n".join((header, *rows, ""))
        if form == "spreadsheet":
            text = text.replace(",", ";").replace("\n", "\r\n")
            text = (
                "\ufeff"
                + text.partition("\n")[0]
                + "\n"
                + text.partition("\n")[2].replace(".", ",")
            )
        path.write_bytes(text.encode())
    log = read_log(path)
    assert log.command_rad is not None
    assert np.array_equal(log.times_s, times_s)
    assert np.array_equal(log.position_rad, angles)
    assert np.array_equal(log.command_rad, commands)


@pytest.mark.slow
def test_a_servo_without_its_commands_is_not_followed():
    log = replace(servo_log(kp=0.8, kv=0.02, delay_s=0.05), command_rad=None)
    assert found_in(log, DRY, VISCOUS, ARMATURE).lost == [log.name]


def test_an_error_below_the_encoder_or_a_third_of_the_motion_is_followed():
    errors = {"swing": 0.03, "still": 0.002, "lost": 0.04}
    motion = {"swing": 0.1, "still": 0.002, "lost": 0.1}
    error_rad, motion_rad = (
        {name: np.array([one]) for name, one in some.items()}
        for some in (errors, motion)
    )
    found = Identified(
        engine="mujoco",
        settings=(),
        joints=(),
        error_rad=error_rad,
        motion_rad=motion_rad,
        names=("Elbow",),
        plain_rad={name: {"lag": np.array([0.01])} for name in errors},
    )
    assert found.lost == ["lost"]
    assert found.behind_a_lag == [("swing", "Elbow")]


def test_wrong_requests_are_refused(gauge, approved, tmp_path):
    times = np.arange(200)
    logs = {
        "log.csv": (0.01 * times, 0.1 * np.cos(0.07 * times)),
        "units.csv": (20 * times, 30 * np.cos(0.1 * times)),
    }
    for name, columns in logs.items():
        np.savetxt(
            tmp_path / name,
            np.column_stack(columns),
            delimiter=",",
            header="time_s,position_rad",
            comments="",
        )
    commands = (
        "recipe joint units.csv --mass=1 --length=0.2",
        "recipe joint units.csv --mass=1 --length=0.2 --angle-unit=deg",
        "recipe joint log.csv",
        "recipe joint log.csv --mass=1 --length=0.2 --fit=kp_n_m_per_rad",
        "recipe joint log.csv --mass=1 --length=0.2 --fit=stiffness",
        "recipe joint log.csv --mass=1 --scene=Pendulum-metal",
    )
    approved("identify/refused", approval.refused_commands(gauge, *commands))


def test_an_engine_without_the_term_declines():
    class Plain(type(backend("mujoco"))):
        features = frozenset()

    log = swing(dry=0.01, viscous=0.0, armature=0.0)
    with pytest.raises(UnsupportedSceneError, match="dry friction"):
        identify(Plain(), one_joint(1.0, 0.1), [log], [DRY])


def test_parts_as_long_as_those_of_the_first_stage_are_all_fitted_in_the_second():
    """The first stage takes about 15 s of the logs, the second one everything."""
    times_s = np.arange(0.0, 40.0, 0.02)
    log = Log("long", times_s, np.zeros((2000, 1)), np.zeros((2000, 1)))
    stages = parts_of([log], 5.0, 5.0)
    assert [len(parts) for parts in stages] == [3, 8]
