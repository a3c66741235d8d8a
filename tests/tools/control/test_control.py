"""Control tasks: their optimum is the law's limit, and engines that obey the law let a policy have just that."""

import csv
import math

import approval
import gymnasium
import mujoco
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from opengl import needs_opengl
from places import ROOT
from programs import printed
from scipy.integrate import solve_ivp

from gauge_envs import load_experiment, variants
from gauge_envs.backends import backend
from gauge_envs.backends.mujoco.simulation import SimulationMuJoCo
from gauge_envs.backends.simulation import Simulation
from gauge_envs.errors import BackendError, GaugeError, ParameterError
from gauge_envs.files import data_folder
from gauge_envs.references.uncertainties import friction_std
from gauge_envs.scene import GRAVITY_M_PER_S2, Motion
from gauge_envs.scene.geometry import rotation_matrices
from gauge_envs.tools.control.env import ControlEnv
from gauge_envs.tools.control.friction import HOLD_S, SLIP_SPEED_M_PER_S
from gauge_envs.tools.control.limit import Ending, Limit, LimitReport
from gauge_envs.tools.control.pendulum import PendulumLimit
from gauge_envs.tools.control.play import engine_limit, play, play_paid
from gauge_envs.tools.control.slope_slider import SlopeSliderLimit
from gauge_envs.tools.control.tasks import control_tasks, find_control_task
from gauge_envs.tools.control.turntable import TurntableLimit

NAMES = tuple(task.name for task in control_tasks())
STEADY = tuple(
    name
    for name in NAMES
    if name.partition("-")[0] in ("Turntable", "SlopeSlider", "Pendulum")
)
MATERIALS = ("wood", "plastic", "metal")
GOOD = (Ending.HELD, Ending.REACHED)
FAST = {"timestep_s": 1 / 1080}
"""The longest step that the default contacts allow, where the accuracy of the engine is not what is tested."""


def make(name, **options):
    env = gymnasium.make(f"GAUGE/{name}", **options).unwrapped
    assert isinstance(env, ControlEnv)
    return env


def by_law(env, fraction):
    return play(env, lambda _: env.law_action(fraction))


def rewards(env, policy):
    observation, _ = env.reset(seed=0)
    paid, over = [], False
    while not over:
        observation, reward, terminated, truncated, info = env.step(policy(observation))
        paid.append(reward)
        over = terminated or truncated
    return paid, info


# --- registration and interface ---


def test_ids_are_extra_to_the_experiments():
    assert len(NAMES) == 15
    assert {f"GAUGE/{name}" for name in NAMES} <= set(gymnasium.registry)
    assert not {variant.name for variant in variants()} & set(NAMES)


def test_a_spec_builds_the_same_run():
    env = gymnasium.make(
        "GAUGE/SlopeSlider-Limit-metal", parameters={"cube.friction": 0.2}
    )
    again = gymnasium.make(EnvSpec.from_json(env.spec.to_json()))
    assert again.unwrapped.limit == env.unwrapped.limit
    assert again.unwrapped.limit.value == 0.2


def reset(env):
    env.reset(seed=0)
    return env


def test_wrong_calls_are_refused(approved):
    turntable = make("Turntable-Limit-wood")
    calls = {
        "unknown task": lambda: find_control_task("Turntable-Limit-wod"),
        "step before reset": lambda: make("Turntable-Limit-wood").step([0.0]),
        "report before the end": lambda: reset(turntable).report(),
        "jitter": lambda: turntable.reset(options={"jitterr": True}),
        "two actions": lambda: reset(turntable).step([0.0, 0.0]),
        "a large action": lambda: reset(turntable).step([1.1]),
        "no number": lambda: reset(turntable).step([math.nan]),
        "a word": lambda: reset(turntable).step("fast"),
    }
    approved("control/refused", approval.refused_calls(GaugeError, calls))


@needs_opengl
def test_picture_shows_the_board_tilting():
    env = make("SlopeSlider-Limit-wood", render_mode="rgb_array", width=160, height=120)
    env.reset(seed=0)
    level = env.render()
    for _ in range(20):
        env.step(np.ones(1))
    assert (np.abs(env.render().astype(int) - level).max(axis=2) > 40).sum() > 50
    env.close()


@pytest.mark.usefixtures("rigid_only")
@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("turntable", "Turntable-Limit-wood"),
        ("pendulum-wide", "GAUGE/Pendulum-Limit-metal --format wide"),
        ("throw-json", "Throw-Limit-rubber --json"),
    ],
)
def test_what_is_shown_is_the_approved_text(gauge, approved, name, words):
    result = gauge("show", *words.split())
    approved(f"control/{name}", approval.readable(result))


# --- limits and their uncertainty ---


def test_ratio_and_z():
    limit = Limit(
        quantity="q", unit="1", value=0.25, sigma=0.05, law="", sigma_source=""
    )
    report = LimitReport(limit=limit, reached=0.3, ending=Ending.HELD, time_s=1.0)
    assert report.ratio == pytest.approx(1.2)
    assert report.z == pytest.approx(1.0)


@pytest.mark.parametrize("material", MATERIALS)
def test_uncertainty_of_friction_is_how_far_single_trials_are_from_it(material):
    path = data_folder("scoring") / "facts" / "slope_slider_30deg.csv"
    rows = [line for line in path.read_text().splitlines() if not line.startswith("#")]
    trials = {}
    for row in csv.DictReader(rows):
        if row["material"] == material:
            trials.setdefault(row["trial"], []).append(
                (int(row["frame"]) / 30.0, 1e-3 * float(row["downhill_mm"]))
            )
    angle = math.radians(30.0)
    accelerations = [
        2.0 * np.polyfit(*zip(*trial, strict=True), 2)[0] for trial in trials.values()
    ]
    friction = math.tan(angle) - np.array(accelerations) / (
        GRAVITY_M_PER_S2 * math.cos(angle)
    )
    calibrated = load_experiment(f"SlopeSlider-2-{material}").scene.contacts[0].friction
    expected = float(np.sqrt(np.mean((friction - calibrated) ** 2))) / calibrated
    assert friction_std(1.0, material) == pytest.approx(expected, rel=0.02)


def test_slope_and_turntable_have_the_calibrated_friction():
    assert SlopeSliderLimit("metal").limit.value == 0.262758
    # The recording of SlopeSlider-3-metal has a kinetic friction of 0.251 +- 0.010.
    assert (
        abs(0.251 - SlopeSliderLimit("metal").limit.value)
        < SlopeSliderLimit("metal").limit.sigma
    )
    turntable = TurntableLimit("plastic")
    assert turntable.limit.sigma == pytest.approx(friction_std(0.322256, "plastic"))
    # An override changes what holds in the scene, not how well the real coefficient is known.
    assert (
        TurntableLimit("plastic", parameters={"cube.friction": 0.2}).limit.sigma
        == turntable.limit.sigma
    )


# --- laws and engines ---


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(
            name,
            marks=()
            if name.endswith(("wood", "Pendulum-Limit-metal"))
            else pytest.mark.slow,
        )
        for name in STEADY
    ],
)
def test_law_holds_at_98_percent_and_not_at_102(name):
    env = make(name)
    below = by_law(env, 0.98)
    assert below.ending in GOOD
    assert below.ratio == pytest.approx(0.98, abs=0.005)
    above = by_law(env, 1.02)
    assert above.ending not in GOOD


@pytest.mark.slow
@pytest.mark.parametrize("name", STEADY)
def test_default_engine_pays_the_law(name):
    assert engine_limit(make(name), bounds=(0.95, 1.05)) == pytest.approx(
        1.0, abs=0.006
    )


def test_contacts_hold_no_more_than_friction_where_the_solver_converges():
    """A solver that stops early leaves a force in excess, which Euler's method takes: 1.5 % with 1e-8."""
    converged, stopped_early = (
        engine_limit(
            make(
                "Turntable-Limit-wood",
                settings={"preset": "training"} | tolerance,
            ),
            bounds=(0.95, 1.05),
        )
        for tolerance in ({}, {"tolerance": 1e-8})
    )
    assert 0.99 < converged < 1.0
    assert stopped_early > 1.01


@pytest.mark.slow
@pytest.mark.parametrize("name", STEADY)
def test_newton_agrees(name):
    pytest.importorskip("newton")
    theirs, ours = make(name, backend="newton"), make(name)
    assert theirs.limit == ours.limit
    below = by_law(theirs, 0.98)
    assert below.ending in GOOD
    # The cube creeps faster on Newton's turntable, behind which the law's policy lags.
    assert below.ratio == pytest.approx(by_law(ours, 0.98).ratio, abs=0.005)
    assert by_law(theirs, 1.02).ending not in GOOD


def test_engine_limit_of_soft_contacts():
    """A cube that is carried round creeps with half the contacts' time constant, 0.02 s, times omega^2 r."""
    settings = {
        "timestep_s": 1 / 540,
        "contact_solref": (0.02, 1.0),
        "integrator": "Euler",
        "impratio": 1.0,
    }
    env = make("Turntable-Limit-wood", settings=settings)
    share = engine_limit(env, bounds=(0.2, 1.5), resolution=0.02)
    creeps = SLIP_SPEED_M_PER_S / (0.5 * 0.02) / (env.limit.value * GRAVITY_M_PER_S2)
    assert share == pytest.approx(creeps, rel=0.2)
    with pytest.raises(ParameterError, match=r"fails with 0\.9"):
        engine_limit(env, bounds=(0.9, 1.1))


@pytest.mark.parametrize("task", [TurntableLimit, SlopeSliderLimit])
def test_friction_used_is_that_of_the_contact_forces(task):
    """The engine's contact forces on the cube, tangential over normal, are what the kinematics ask for."""
    # The force at one instant scatters by 1 % with the slope's own step, 1/1800 s.
    env = task("wood", settings={"timestep_s": 1 / 9000})
    env.reset()
    checked = 0
    for step in range(30):
        # Strongly accelerated all the time, both ways, so that the sign of each term matters.
        observation = env.step(np.array([0.4 if step < 20 else -0.8]))[0]
        data, model = env.simulation.data, env.simulation.model
        total, wrench = np.zeros(3), np.zeros(6)
        for index, contact in enumerate(data.contact):
            mujoco.mj_contactForce(model, data, index, wrench)
            total += contact.frame.reshape(3, 3).T @ wrench[:3]
        normal = rotation_matrices(env._stage.state[3:7])[:, 2]
        used = np.linalg.norm(total - normal * (total @ normal)) / abs(total @ normal)
        if step % 20 > 5:
            # The observation is the mean over the frame, the forces are those at its end.
            change = abs(observation[2] - env.trajectory()[-2][2])
            assert used == pytest.approx(observation[2], abs=change + 2e-3)
            assert env._friction_used()[-1] == pytest.approx(used, rel=0.01, abs=1e-3)
            checked += 1
    assert checked > 15


@pytest.mark.parametrize("name", ["Turntable-Limit-metal", "SlopeSlider-Limit-metal"])
def test_reward_is_the_friction_used_and_slipping_takes_it_back(name):
    env = make(name, settings=FAST)
    paid, _ = rewards(env, lambda _: env.law_action(0.95))
    assert sum(paid) == pytest.approx(env.trajectory()[1:, 2].sum())
    assert paid[-1] == pytest.approx(0.95 * env.limit.value, rel=0.01)
    held = sum(paid)
    paid, info = rewards(env, lambda _: env.law_action(1.05))
    assert "diverged" not in info
    assert env.report().ending is Ending.SLIPPED
    assert paid[-1] == pytest.approx(-sum(paid[:-1][-round(HOLD_S * 30) :]))
    assert sum(paid) < 0.5 * held
    closer, _ = rewards(env, lambda _: env.law_action(0.99))
    assert held < sum(closer) < env.limit.value * len(closer)


@pytest.mark.parametrize("name", ["Turntable-Limit-wood", "SlopeSlider-Limit-wood"])
@pytest.mark.parametrize("seed", range(3))
def test_no_policy_earns_more_than_the_law(name, seed):
    """Dithering about the limit: what exceeds it in one frame is lost in the next."""
    env = make(name, settings=FAST)
    random = np.random.default_rng(seed)
    # From 0.97 of the limit on, at random up to 6 % past it, frame by frame.
    report = play(
        env,
        lambda _: env.law_action(
            0.97 if env.time_s < 3.0 else random.uniform(0.92, 1.06)
        ),
    )
    most = env.limit.value + SLIP_SPEED_M_PER_S / (
        math.cos(0.27) * GRAVITY_M_PER_S2 * HOLD_S
    )
    assert 0.0 < report.reached <= most


def test_slipping_is_turning_on_the_spot_too():
    """A cube on the axis is carried by next to no force, but a plate as slippery turns away under it."""
    plate = load_experiment("Turntable-1-wood").scene.body("plate").pose.position_m
    place = {
        "cube.position_m": (plate[0], plate[1], plate[2] + 0.035),
        "cube.friction": 0.001,
    }
    env = make("Turntable-Limit-wood", settings=FAST, parameters=place)
    assert play(env, lambda _: np.ones(1)).ending is Ending.SLIPPED
    used = env.trajectory()[:, 2]
    assert used.max() < 0.2 * 0.001
    # Of the plate's 6 rad/s^2 friction gives the cube 0.8 at most, where all its weight is on the corners.
    corner_m = 0.05 / math.sqrt(2.0)
    spun = 6.0 - 0.001 * GRAVITY_M_PER_S2 * corner_m / (0.05**2 / 6.0)
    assert env.time_s == pytest.approx(
        SLIP_SPEED_M_PER_S / (spun * corner_m), abs=1.0 / 30.0
    )


def test_policy_of_the_calibrated_law_slips_at_the_edge_of_what_is_known():
    calibrated = make("SlopeSlider-Limit-metal")
    edge = calibrated.limit.value - 2.0 * calibrated.limit.sigma
    env = make("SlopeSlider-Limit-metal", parameters={"cube.friction": edge})
    assert by_law(env, 0.98 * calibrated.limit.value / edge).ending is Ending.SLIPPED


# --- pendulum ---


def test_pendulum_returns_at_most_one():
    env = make("Pendulum-Limit-metal")
    for fraction in (0.9, 0.98):
        paid, _ = play_paid(env, lambda _, fraction=fraction: env.law_action(fraction))
        # At the target x = 1, and the work is 1 / fraction.
        assert paid == pytest.approx(2.0 - 1.0 / fraction, abs=2e-3)
    assert env.report().limit.value == pytest.approx(1.0 / (0.3175 * GRAVITY_M_PER_S2))
    paid, report = play_paid(env, lambda _: env.law_action(1.02))
    assert report.ending is Ending.MISSED
    assert report.reached == 0.0
    assert paid == pytest.approx(1.0 / 1.02, abs=2e-3)


def test_pendulum_braking_is_not_paid_back():
    env = make("Pendulum-Limit-metal")
    env.reset()
    observation = env.step(np.ones(1))[0]
    for _ in range(3):
        spent = observation[3]
        observation = env.step(np.array([-0.5]))[0]
        assert observation[1] < 0.0 or observation[3] == spent


@pytest.mark.parametrize(
    "engine", ["mujoco", pytest.param("newton", marks=pytest.mark.slow)]
)
def test_applied_torque_swings_the_pendulum(engine):
    if engine == "newton":
        pytest.importorskip("newton")
    scene = PendulumLimit("metal").experiment.scene
    ball, hinge, torque = scene.body("ball"), scene.joints[0], 0.2
    length = math.dist(ball.pose.position_m, hinge.anchor_m)
    inertia = ball.mass_kg * (length**2 + 0.4 * ball.shape.radius_m**2)
    weight = ball.mass_kg * GRAVITY_M_PER_S2 * length
    swing = solve_ivp(
        lambda _, y: [y[1], (torque - weight * math.sin(y[0])) / inertia],
        (0.0, 0.5),
        (0.0, 0.0),
        rtol=1e-9,
        atol=1e-12,
    ).y[:, -1]
    simulation = backend(engine).build(scene)
    simulation.reset(seed=0)
    simulation.apply_wrench(
        "ball", np.array([[0.0, 0.0, 0.0, *(torque * np.asarray(hinge.axis))]])
    )
    simulation.advance(0.5)
    state = simulation.body_states(["ball"])[0, 0]
    arm = state[:3] - hinge.anchor_m
    assert math.atan2(-arm[0], -arm[2]) == pytest.approx(swing[0], rel=1e-5)
    assert state[11] == pytest.approx(swing[1], rel=1e-4)
    # A reset ends it.
    simulation.reset(seed=0)
    simulation.advance(0.5)
    assert simulation.body_states(["ball"])[0, 0, :3] == pytest.approx(
        ball.pose.position_m, abs=1e-7
    )


@pytest.mark.parametrize(
    "engine", ["mujoco", pytest.param("newton", marks=pytest.mark.slow)]
)
def test_applied_force_accelerates_a_free_body(engine):
    if engine == "newton":
        pytest.importorskip("newton")
    scene = load_experiment("BouncingBall-rubber").scene
    (ball,) = [body for body in scene.bodies if body.motion is Motion.DYNAMIC]
    force = np.array([[0.1, 0.0, ball.mass_kg * GRAVITY_M_PER_S2, 0.0, 0.0, 0.0]])
    simulation = backend(engine).build(scene)
    simulation.reset(seed=0)
    simulation.apply_wrench(ball.name, force)
    simulation.advance(0.5)
    moved = simulation.body_states([ball.name])[0, 0, :3] - ball.pose.position_m
    assert moved == pytest.approx([0.5 * 0.1 / ball.mass_kg * 0.25, 0.0, 0.0], abs=1e-4)


def test_an_engine_without_applied_forces_says_so():
    class Silent(SimulationMuJoCo):
        apply_wrench = Simulation.apply_wrench

    with pytest.raises(BackendError, match=r"Silent.*'ball'.*apply_wrench"):
        object.__new__(Silent).apply_wrench("ball", np.zeros((1, 6)))


# --- guide and example ---


@pytest.mark.parametrize(
    ("task", "other"), [("Carry", "Turntable"), ("Push", "SlopeSlider")]
)
def test_the_guide_states_a_limit_of_two_tasks_once(task, other):
    for material in ("wood", "plastic", "metal"):
        same, limit = (make(f"{name}-Limit-{material}").limit for name in (task, other))
        assert (same.value, same.sigma) == (limit.value, limit.sigma)


@pytest.mark.slow
def test_example_runs(tmp_path):
    pytest.importorskip("stable_baselines3", reason="extra 'rl' is not installed")
    script = ROOT / "examples" / "rl_sanity.py"
    shown = printed(script, "--steps", 1200, "--out", tmp_path / "run.png")
    assert "MuJoCo, half the step" in shown
    assert "The policy" in shown
    assert (tmp_path / "run.png").stat().st_size > 20_000


def test_a_slip_in_pybullet_is_driven_by_more_than_the_law():
    """The ratio of Carry can exceed 1 there by as much, as docs/control.md says: friction is bounded axis by axis."""
    pytest.importorskip("pybullet")
    found = {}
    for engine in ("pybullet", "mujoco"):
        shares = []
        for angle in (0.0, math.pi / 6, math.pi / 4):
            env = gymnasium.make("GAUGE/Carry-Limit-wood", backend=engine).unwrapped
            env.reset(seed=0)
            # 4.5 m/s^2 is more than friction holds, so the cube slips.
            action = np.array([math.cos(angle), math.sin(angle)], dtype=np.float32)
            speeds = [np.linalg.norm(env.step(action)[0][2:4]) for _ in range(10)]
            law = env.limit.value * env.experiment.scene.gravity_m_per_s2
            shares.append((speeds[-1] - speeds[2]) / (7 / 30) / law)
            env.close()
        found[engine] = shares
    assert max(found["mujoco"]) == pytest.approx(1.0, abs=0.001)
    # A search cannot reach more than the largest share.
    assert 1.02 < max(found["pybullet"]) < 1.05
