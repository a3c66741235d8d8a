"""What the sanity check measures: readings against closed forms, rollouts at a configuration's own step, verdicts."""

from dataclasses import replace
from itertools import pairwise

import mujoco
import numpy as np
import pytest
from sanity_cases import CHEETAH, moved
from scipy.spatial.transform import Rotation
from wobbling import WobblingBackend, told

from gauge_envs.backends import backend
from gauge_envs.scene import GRAVITY_M_PER_S2 as G
from gauge_envs.scene.prescribed_motion import prescribed_motions
from gauge_envs.scoring.metrics import trajectory_dtw, trajectory_rmse
from gauge_envs.tools.bench.recording import DeclinedError, DivergedError
from gauge_envs.tools.sanity.measure import Measurements, judged
from gauge_envs.tools.sanity.model import Reality, Verdict
from gauge_envs.tools.sanity.phenomena import phenomena
from gauge_envs.tools.sanity.phenomena.friction import PRINTED_MM, creep_bound_mm_per_s
from gauge_envs.tools.sanity.scenario import run_scenario

MUJOCO = backend("mujoco")


def one(name):
    (found,) = phenomena([name])
    return found


def value(name, settings):
    measured = Measurements(MUJOCO).measure(one(name), settings)
    assert measured.value is not None, measured.remark
    return measured.value


LONG = ("period", "energy", "wall-sag", "wall-drift")
"""Phenomena whose scenes are long or have many bodies."""
NEEDS_TWO_LINES = ("foot-lag",)


def test_numbers_of_all_phenomena_are_the_approved_ones(approved):
    """Of an engine whose bodies move as stated functions of the time, so that no physics and no rounding matters."""
    lines = []
    for one in phenomena(include_deformables=True):
        lines.append(f"{one.id}: {told(one.reality)}")
        lines.append(f"  {told(one.needs)} {one.is_impact}")
        if one.id in (*LONG, *NEEDS_TWO_LINES):
            continue
        rollout = run_scenario(WobblingBackend(), one.scenario, {})
        lines.append(f"  {told(replace(judged(one, rollout), rollout=None))}")
    approved("sanity/phenomena", "\n".join(dict.fromkeys(lines)))


# --- rollouts --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("step", "interval"),
    [(0.01, 0.01), (0.003, 0.003), (0.0007, 0.0014), (1 / 9000, 0.002)],
)
def test_runs_at_its_own_step(step, interval):
    scenario = replace(one("rebound").scenario, seconds=0.2)
    rollout = run_scenario(
        MUJOCO, scenario, {"timestep_s": step, "integrator": "Euler"}
    )
    steps = np.round(rollout.times_s / step)
    fall = rollout.position("ball-2")[0, 2] - rollout.position("ball-2")[:, 2]
    assert rollout.interval_s == pytest.approx(interval)
    assert rollout.times_s[-1] == pytest.approx(0.2, abs=step)
    # A semi-implicit step falls by g h^2 (1 + 2 + ... + n).
    np.testing.assert_allclose(fall, 0.5 * G * step**2 * steps * (steps + 1), atol=1e-9)


@pytest.mark.parametrize("interval", [0.01, 0.003, 1 / 600])
def test_driver_intervals_join(interval):
    scene = one("carry-wood").scenario.scene
    (driver,) = scene.drivers
    (motion,) = prescribed_motions(scene, 200 * interval, interval_s=interval)
    start = scene.body("plate").pose
    targets = motion.targets(0, np.zeros((1, motion.motion_count)), 200)[:, 0]
    for sample, (now, after) in enumerate(pairwise(targets)):
        pose = driver.pose(start, sample * interval)
        np.testing.assert_allclose(now[:3], pose.position_m, atol=1e-12)
        np.testing.assert_allclose(now[3:7], pose.quaternion, atol=1e-12)
        before, end = Rotation.from_quat([now[3:7], after[3:7]], scalar_first=True)
        turn = (end * before.inv()).as_rotvec()
        np.testing.assert_allclose(
            now[10:13] * interval + 0.5 * now[16:] * interval**2, turn, atol=1e-9
        )


@pytest.mark.parametrize("step", [0.01, 0.003])
def test_driven_plate_is_where_its_driver_says(step):
    scenario = replace(one("carry-wood").scenario, seconds=1.0)
    rollout = run_scenario(MUJOCO, scenario, {"timestep_s": step})
    (driver,) = scenario.scene.drivers
    end = driver.pose(scenario.scene.body("plate").pose, float(rollout.times_s[-1]))
    turn = end.rotation.inv() * type(end.rotation).from_quat(
        rollout.states["plate"][-1, 3:7], scalar_first=True
    )
    assert np.degrees(turn.magnitude()) < 0.01


def test_declined_and_diverged_are_outcomes():
    scenario = one("creep-wood").scenario
    with pytest.raises(DeclinedError, match="unknown setting"):
        run_scenario(MUJOCO, scenario, {"colour": "red"})
    loose = {
        "timestep_s": 0.01,
        "contact_solref": (0.002, 1.0),
        "refsafe": False,
        "contact_solimp": CHEETAH["contact_solimp"],
    }
    with pytest.raises(DivergedError, match="m/s"):
        run_scenario(MUJOCO, scenario, loose)
    measured = Measurements(MUJOCO).measure(one("creep-wood"), loose)
    assert (measured.verdict, measured.value) == (Verdict.WRONG, None)
    assert measured.remark.startswith("diverged")


# --- readings of motions that are known ------------------------------------------------------------------------------


def test_creep_counts_after_settling():
    creep = one("creep-wood")
    times = np.linspace(0.0, 1.0, 401)
    downhill = creep.scenario.scene.body("board").pose.rotation.apply([1.0, 0.0, 0.0])
    settling = 0.002 * (1.0 - np.exp(-times / 0.02))
    rollout = moved(
        creep.scenario, times, cube=(settling + 0.007 * times)[:, None] * downhill
    )
    assert creep.value(rollout) == pytest.approx(7.0, abs=1e-3)


def test_resting_height_is_along_the_normal():
    rest = one("rest-height")
    times = np.linspace(0.0, 1.0, 101)
    normal = rest.scenario.scene.body("board").pose.rotation.apply([0.0, 0.0, 1.0])
    sunk = moved(
        rest.scenario, times, cube=np.outer(np.where(times > 0.0, -0.0012, 0.0), normal)
    )
    flat = moved(rest.scenario, times)
    assert rest.value(flat) == pytest.approx(0.0, abs=2e-3)
    assert rest.value(sunk) - rest.value(flat) == pytest.approx(-1.2, abs=1e-9)


@pytest.mark.parametrize("material", ["wood", "plastic", "metal"])
def test_slide_reads_acceleration_from_rest(material):
    slide = one(f"slide-{material}")
    times = np.linspace(0.0, 0.5, 126)
    downhill = slide.scenario.scene.body("board").pose.rotation.apply([1.0, 0.0, 0.0])
    law = slide.reality.value
    rollout = moved(
        slide.scenario, times, cube=(0.5 * law * times**2)[:, None] * downhill
    )
    assert slide.value(rollout) == pytest.approx(law)
    # What moves the cube before it has settled does not count: a speed that it then has is no acceleration.
    pushed = moved(
        slide.scenario,
        times,
        cube=(0.06 * times + 0.5 * law * times**2)[:, None] * downhill,
    )
    assert slide.value(pushed) == pytest.approx(law)
    late = moved(slide.scenario, times, cube=(0.6 * law * times**2)[:, None] * downhill)
    assert slide.value(late) == pytest.approx(1.2 * law)
    # Real slides show a friction of their own, and the cube has it.
    friction = next(
        c.friction for c in slide.scenario.scene.contacts if "board" in c.second
    )
    assert friction == pytest.approx(
        {"wood": 0.257145, "plastic": 0.236133, "metal": 0.270867}[material]
    )
    assert law == pytest.approx(G * (0.5 - friction * np.sqrt(0.75)), rel=2e-3)


@pytest.mark.parametrize("restitution", [0.2, 0.577, 0.9])
@pytest.mark.parametrize("interval", [0.002, 0.01])
def test_rebound_of_an_ideal_ball(restitution, interval):
    rebound = one("rebound")
    times = np.arange(0.0, 0.85, interval)
    displacements = {}
    for ball in rebound.scenario.scene.dynamic_bodies:
        drop = (
            ball.pose.position_m[2]
            - rebound.scenario.scene.body("ground").pose.position_m[2]
            - 0.03
        )
        height = _bounces_m(times, drop, restitution) - drop
        displacements[ball.name.replace("-", "_")] = np.outer(height, [0.0, 0.0, 1.0])
    assert rebound.value(
        moved(rebound.scenario, times, **displacements)
    ) == pytest.approx(restitution, rel=2e-3)


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
    rebound = one("rebound")
    reading = judged(rebound, moved(rebound.scenario, np.linspace(0.0, 0.85, 400)))
    assert (reading.value, reading.remark) == (
        0.0,
        "5 of 5 drops do not leave the ground again",
    )


def test_only_the_last_ball_may_leave():
    momentum = one("momentum")
    times = np.linspace(0.0, 0.55, 276)
    after = np.clip(times - 0.25, 0.0, None)
    swing = np.outer(0.1 * np.sin(np.pi * after / 0.3) ** 2, [0.0, 0.0, 1.0])
    fallen = np.outer(np.where(times > 0.2, -0.138251, 0.0), [0.0, 0.0, 1.0])
    good = judged(
        momentum, moved(momentum.scenario, times, ball_1=fallen, ball_5=swing)
    )
    assert good.value == pytest.approx(np.sqrt(0.1 / 0.138251), rel=1e-4)
    assert good.remark == ""
    bad = judged(
        momentum,
        moved(
            momentum.scenario, times, ball_1=fallen, ball_4=0.5 * swing, ball_5=swing
        ),
    )
    assert bad.remark.startswith("2 of 5 balls swing out")
    # The momentum alone would be as in reality.
    assert (bad.value, bad.verdict) == (good.value, Verdict.WRONG)


def test_depth_of_a_point_in_the_recess():
    point = one("point")
    scene = point.scenario.scene
    tip = scene.body("pyramid").pose.to_world(np.array([0.0, 0.0, -0.075]))
    floor = scene.body("squarebase").pose.position_m[2] - 0.0125
    times = np.array([0.0, 0.1])
    displacement = np.outer([0.0, 1.0], [0.0, 0.0, floor - tip[2] - 0.0031])
    assert point.value(
        moved(point.scenario, times, pyramid=displacement)
    ) == pytest.approx(3.1)


def test_lag_of_a_cube_behind_the_rod():
    (carry,) = phenomena(["cloth-carry"], include_deformables=True)
    times = np.linspace(0.0, 2.0, 101)
    speeds = {"rod": -0.037, "cube": -0.035}
    displacements = {
        name: np.outer(speed * times, [1.0, 0.0, 0.0]) for name, speed in speeds.items()
    }
    rollout = moved(carry.scenario, times, **displacements)
    assert carry.value(rollout) == pytest.approx(4.0)


# --- reality ---------------------------------------------------------------------------------------------------------


def test_scores_of_creeping_cubes_differ_by_the_formula():
    place, displacement = 0.59, 0.3
    frames = np.column_stack(
        [
            place + displacement * (np.linspace(0.0, 1.0, 301) - 0.5),
            np.zeros(301),
            np.zeros(301),
        ]
    )
    mean = np.zeros_like(frames)
    assert trajectory_rmse(frames, mean) - trajectory_dtw(
        frames, mean
    ) == pytest.approx(displacement**2 / (24.0 * place), rel=0.03)


@pytest.mark.parametrize(
    ("material", "printed"), [("wood", 0.59), ("plastic", 1.90), ("metal", 0.86)]
)
def test_creep_bound_is_the_displacement_that_one_digit_hides(material, printed):
    displacement = creep_bound_mm_per_s(f"SlopeSlider-1-{material}") * 8 / 30
    assert displacement**2 / (24.0 * printed) == pytest.approx(PRINTED_MM)


def test_interval_covers_further_trials():
    random = np.random.default_rng(0)
    trials = random.normal(5.0, 0.3, (8_000, 8))
    hits = 0
    for row in trials:
        known = Reality.measured(
            float(row[:7].mean()),
            scatter=float(row[:7].std(ddof=1)),
            trial_count=7,
            source="normal",
        )
        low, high = known.value - known.tolerance, known.value + known.tolerance
        hits += low <= row[7] <= high
    assert hits / len(trials) == pytest.approx(0.95, abs=0.006)


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
    "creep-plastic": 0.696,
    "creep-metal": 0.725,
    "rest-height": -0.00308,
    "slide-wood": 2.72,
    "slide-plastic": 2.9,
    "slide-metal": 2.6,
    "slide-turned": 3.35,
    "rebound": 0.0,
    "rebound-slow": 0.0,
    "momentum": 0.237,
    "carry-wood": 1.87,
    "carry-plastic": 1.83,
    "carry-metal": 1.84,
    "seam": 5.79,
    "point": 5.6,
}
"""Numbers of MuJoCo's documented defaults, in the unit of each row."""


@pytest.mark.parametrize("name", OUT_OF_BOX)
def test_numbers_of_mujoco_out_of_the_box(name):
    found = value(name, {"preset": "out_of_box"})
    assert found == pytest.approx(OUT_OF_BOX[name], rel=0.01, abs=1e-4)


def test_three_per_cent_of_a_slide_are_visible():
    slide = one("slide-wood")
    assert 0.9 < 0.03 * slide.reality.value / slide.reality.tolerance < 2.5
    measured = Measurements(MUJOCO).measure(slide, {"friction_scale": 0.96})
    assert measured.value == pytest.approx(
        slide.reality.value + 0.04 * 0.257145 * G * np.sqrt(0.75), rel=0.002
    )
    assert measured.verdict is Verdict.VISIBLE


QUICK = "creep-*,rest-height,slide*,carry-wood,rebound*,momentum,seam,point"


@pytest.mark.parametrize(
    ("name", "patterns"),
    [
        ("mujoco", QUICK.split(",")),
        pytest.param("mujoco", (), marks=pytest.mark.slow),
        pytest.param("newton", (), marks=pytest.mark.slow),
    ],
)
def test_the_default_of_a_backend_raises_no_flag(name, patterns):
    pytest.importorskip(name)
    measurements = Measurements(backend(name))
    found = {p.id: measurements.measure(p, {}) for p in phenomena(patterns)}
    assert {
        name for name, one in found.items() if one.verdict is not Verdict.INSIDE
    } == set()
