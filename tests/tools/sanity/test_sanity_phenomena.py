"""Rows on measured objects: readings against closed forms, rollouts at a configuration's own step, verdicts."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from sanity_cases import CHEETAH, moved
from wobbling import WobblingBackend, told

from gauge_envs.backends import backend
from gauge_envs.backends.mujoco.simulation import SimulationMuJoCo
from gauge_envs.scene import GRAVITY_M_PER_S2 as G
from gauge_envs.scoring.metrics import trajectory_dtw, trajectory_rmse
from gauge_envs.tools.bench.recording import DeclinedError, DivergedError
from gauge_envs.tools.sanity.measure import Measurements, judged
from gauge_envs.tools.sanity.model import Reality, Verdict
from gauge_envs.tools.sanity.phenomena import RIGID, phenomena, phenomenon
from gauge_envs.tools.sanity.phenomena.friction import PRINTED_MM, creep_bound_mm_per_s
from gauge_envs.tools.sanity.scenario import run_scenario

MUJOCO = backend("mujoco")
ALONG, UP = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])


def value(name, settings):
    measured = Measurements(MUJOCO).measure(phenomenon(name), settings)
    assert measured.value is not None, measured.remark
    return measured.value


def read(name, times, **ways_m):
    """Outcome of a row for displacements [m]."""
    row = phenomenon(name)
    return judged(row, moved(row.scenario, times, **ways_m))


def of_board(name, axis):
    """An axis of the board's frame in the world."""
    return phenomenon(name).scenario.scene.body("board").pose.rotation.apply(axis)


LONG = ("period", "energy", "wall-sag", "wall-drift", "foot-lag")
"""Phenomena whose scenes are long, or have many bodies or several markers."""


def test_numbers_of_all_phenomena_are_the_approved_ones(approved):
    """Of an engine whose bodies move as stated functions of the time, so that no physics and no rounding matters."""
    lines = []
    for row in phenomena(include_deformables=True):
        lines.append(f"{row.id}: {told(row.reality)}")
        lines.append(f"  {told(row.needs)} {row.is_impact}")
        if row.id not in LONG:
            rollout = run_scenario(WobblingBackend(), row.scenario, {})
            lines.append(f"  {told(replace(judged(row, rollout), rollout=None))}")
    approved("sanity/phenomena", "\n".join(dict.fromkeys(lines)))


# --- rollouts --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("step", "interval"),
    [(0.01, 0.01), (0.003, 0.003), (0.0007, 0.0014), (1 / 9000, 0.002)],
)
def test_runs_at_its_own_step(step, interval):
    scenario = replace(phenomenon("rebound").scenario, seconds=0.2)
    settings = {"timestep_s": step, "integrator": "Euler"}
    rollout = run_scenario(MUJOCO, scenario, settings)
    steps = np.round(rollout.times_s / step)
    fall = -rollout.displacement("ball-2")[:, 2]
    assert rollout.interval_s == pytest.approx(interval)
    assert rollout.times_s[-1] == pytest.approx(0.2, abs=step)
    # A semi-implicit step falls by g h^2 (1 + 2 + ... + n).
    np.testing.assert_allclose(fall, 0.5 * G * step**2 * steps * (steps + 1), atol=1e-9)


def test_declined_and_diverged_are_outcomes():
    row = phenomenon("creep-wood")
    with pytest.raises(DeclinedError, match="unknown setting"):
        run_scenario(MUJOCO, row.scenario, {"colour": "red"})
    with pytest.raises(DeclinedError, match="a step of 2 s is too long for a scene of"):
        run_scenario(MUJOCO, row.scenario, {"timestep_s": 2.0})
    loose = CHEETAH | {"contact_solref": (0.002, 1.0), "refsafe": False}
    with pytest.raises(DivergedError, match="m/s"):
        run_scenario(MUJOCO, row.scenario, loose)
    measured = Measurements(MUJOCO).measure(row, loose)
    assert (measured.verdict, measured.value) == (Verdict.WRONG, None)
    assert measured.remark.startswith("diverged")


def test_an_engine_that_raises_is_wrong(monkeypatch):
    def give_up(simulation, names):
        raise MemoryError("full")

    monkeypatch.setattr(SimulationMuJoCo, "body_states", give_up)
    measured = Measurements(MUJOCO).measure(phenomenon("rebound"), {})
    assert (measured.verdict, measured.value) == (Verdict.WRONG, None)
    assert measured.remark.startswith("the engine raised MemoryError: full")


# --- readings of motions that are known ------------------------------------------------------------------------------


def test_creep_counts_after_settling():
    times = np.linspace(0.0, 1.0, 401)
    way = 0.002 * (1.0 - np.exp(-times / 0.02)) + 0.007 * times
    outcome = read(
        "creep-wood", times, cube=np.outer(way, of_board("creep-wood", ALONG))
    )
    assert outcome.value == pytest.approx(7.0, abs=1e-3)


def test_resting_height_is_along_the_normal():
    times = np.linspace(0.0, 1.0, 101)
    sunk = np.outer(np.where(times > 0.0, -0.0012, 0.0), of_board("rest-height", UP))
    flat = read("rest-height", times).value
    assert flat == pytest.approx(0.0, abs=2e-3)
    assert read("rest-height", times, cube=sunk).value - flat == pytest.approx(-1.2)


@pytest.mark.parametrize(
    ("material", "friction"),
    [("wood", 0.257145), ("plastic", 0.236133), ("metal", 0.270867)],
)
def test_slide_reads_acceleration_and_no_speed(material, friction):
    name = f"slide-{material}"
    times = np.linspace(0.0, 0.5, 126)
    law = phenomenon(name).reality.value
    for share, speed in ((1.0, 0.0), (1.0, 0.06), (1.2, 0.0)):
        way = speed * times + 0.5 * share * law * times**2
        outcome = read(name, times, cube=np.outer(way, of_board(name, ALONG)))
        assert outcome.value == pytest.approx(share * law)
    # Real slides show a friction of their own, and the cube has it.
    assert law == pytest.approx(G * (0.5 - friction * np.sqrt(0.75)), rel=2e-3)


@pytest.mark.parametrize("restitution", [0.2, 0.577, 0.9])
@pytest.mark.parametrize("interval", [0.002, 0.01])
def test_rebound_of_an_ideal_ball(restitution, interval):
    times = np.arange(0.0, 0.85, interval)
    scene = phenomenon("rebound").scenario.scene
    ground_m = scene.body("ground").pose.position_m[2] + 0.03
    ways = {}
    for ball in scene.dynamic_bodies:
        drop = ball.pose.position_m[2] - ground_m
        way = _bounces_m(times, drop, restitution) - drop
        ways[ball.name.replace("-", "_")] = np.outer(way, UP)
    outcome = read("rebound", times, **ways)
    assert outcome.value == pytest.approx(restitution, rel=2e-3)


def _bounces_m(times_s, drop_m, restitution):
    """Height above contact of a ball that loses 1 - e of its speed in an instant."""
    heights = drop_m - 0.5 * G * times_s**2
    start, speed = np.sqrt(2.0 * drop_m / G), restitution * np.sqrt(2.0 * G * drop_m)
    for _ in range(10):
        since = times_s - start
        heights = np.where(since >= 0.0, speed * since - 0.5 * G * since**2, heights)
        start, speed = start + 2.0 * speed / G, restitution * speed
    return heights


def test_a_ball_that_stays_down_is_a_failure():
    reading = read("rebound", np.linspace(0.0, 0.85, 400))
    text = "5 of 5 drops do not leave the ground again"
    assert (reading.value, reading.remark) == (0.0, text)


def test_only_the_last_ball_may_leave():
    times = np.linspace(0.0, 0.55, 276)
    after = np.clip(times - 0.25, 0.0, None)
    swing = np.outer(0.1 * np.sin(np.pi * after / 0.3) ** 2, UP)
    fallen = np.outer(np.where(times > 0.2, -0.138251, 0.0), UP)
    good = read("momentum", times, ball_1=fallen, ball_5=swing)
    assert good.value == pytest.approx(np.sqrt(0.1 / 0.138251), rel=1e-4)
    bad = read("momentum", times, ball_1=fallen, ball_4=0.5 * swing, ball_5=swing)
    assert not good.remark and bad.remark.startswith("2 of 5 balls swing out")
    # The momentum alone would be as in reality.
    assert (bad.value, bad.verdict) == (good.value, Verdict.WRONG)


def test_depth_of_a_point_in_the_recess():
    scene = phenomenon("point").scenario.scene
    tip = scene.body("pyramid").pose.to_world(np.array([0.0, 0.0, -0.075]))
    floor = scene.body("squarebase").pose.position_m[2] - 0.0125
    way = np.outer([0.0, 1.0], (floor - tip[2] - 0.0031) * UP)
    assert read("point", np.array([0.0, 0.1]), pyramid=way).value == pytest.approx(3.1)


# --- reality ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("material", "printed"), [("wood", 0.59), ("plastic", 1.90), ("metal", 0.86)]
)
def test_creep_bound_is_the_displacement_that_one_digit_hides(material, printed):
    way = creep_bound_mm_per_s(f"SlopeSlider-1-{material}") * 8 / 30
    assert way**2 / (24.0 * printed) == pytest.approx(PRINTED_MM)
    frames = np.zeros((301, 3))
    frames[:, 0] = printed + way * np.linspace(-0.5, 0.5, 301)
    mean = np.zeros_like(frames)
    apart = trajectory_rmse(frames, mean) - trajectory_dtw(frames, mean)
    assert apart == pytest.approx(PRINTED_MM, rel=0.15)


def test_interval_covers_further_trials():
    hits = 0
    for *known, further in np.random.default_rng(0).normal(5.0, 0.3, (8_000, 8)):
        mean, scatter = float(np.mean(known)), float(np.std(known, ddof=1))
        reality = Reality.measured(mean, scatter, 7, "normal")
        hits += abs(further - reality.value) <= reality.tolerance
    assert hits / 8_000 == pytest.approx(0.95, abs=0.006)


# --- engines ---------------------------------------------------------------------------------------------------------


def test_creep_of_half_cheetah_is_mujocos():
    """The creep of a plain MJCF model of the same cube, on a plane in tilted gravity."""
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><option timestep="0.01" gravity="{G * np.sin(np.radians(10))} 0 {-G * np.cos(np.radians(10))}"/>
        <default><geom friction="0.273673 0 0" solimp="0 0.8 0.01" solref="0.02 1"/></default>
        <worldbody><geom type="plane" size="1 1 1"/>
        <body pos="0 0 0.025"><freejoint/><geom type="box" size="0.025 0.025 0.025" mass="0.0903"/></body>
        </worldbody></mujoco>"""
    )
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, nstep=50)
    early = float(data.qpos[0])
    mujoco.mj_step(model, data, nstep=50)
    plain = 1e3 * (float(data.qpos[0]) - early) / 0.5
    assert value("creep-wood", CHEETAH) == pytest.approx(plain, rel=0.02)
    assert 50.0 < plain < 65.0


OUT_OF_BOX = {
    "creep-wood": 0.699,
    "creep-metal": 0.725,
    "rest-height": -0.00308,
    "slide-wood": 2.72,
    "slide-turned": 3.35,
    "rebound": 0.0,
    "rebound-slow": 0.0,
    "momentum": 0.237,
    "carry-wood": 1.87,
    "seam": 5.79,
    "point": 5.6,
}
"""Numbers of MuJoCo's documented defaults, in the unit of each row."""


@pytest.mark.parametrize("name", OUT_OF_BOX)
def test_numbers_of_mujoco_out_of_the_box(name):
    number = value(name, {"preset": "out_of_box"})
    assert number == pytest.approx(OUT_OF_BOX[name], rel=0.01, abs=1e-4)


def test_three_per_cent_of_a_slide_are_visible():
    slide = phenomenon("slide-wood")
    measured = Measurements(MUJOCO).measure(slide, {"friction_scale": 0.96})
    faster = 0.04 * 0.257145 * G * np.sqrt(0.75)
    assert measured.value == pytest.approx(slide.reality.value + faster, rel=0.002)
    assert measured.verdict is Verdict.VISIBLE


LONGER = ("energy", "period", "carry-plastic", "carry-metal")


@pytest.mark.parametrize(
    ("name", "skipped"),
    [
        ("mujoco", LONGER),
        pytest.param("mujoco", (), marks=pytest.mark.slow),
        pytest.param("newton", (), marks=pytest.mark.slow),
    ],
)
def test_the_default_of_a_backend_raises_no_flag(name, skipped):
    pytest.importorskip(name)
    measurements = Measurements(backend(name))
    rows = [phenomenon(row) for row in RIGID if row not in skipped]
    off = [row.id for row in rows if measurements.measure(row, {}).verdict.is_off]
    assert len(rows) > 15 and off == []
