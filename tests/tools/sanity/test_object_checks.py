"""Checks of measured objects: realities, readings against closed forms, rollouts at a configuration's own step."""

import mujoco
import numpy as np
import pytest
from rigid import recording_of

from gauge_envs.backends import backend
from gauge_envs.backends.mujoco.simulation import SimulationMuJoCo
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.fixtures.recording import DivergedError, UnsupportedError
from gauge_envs.scene import GRAVITY_M_PER_S2 as G
from gauge_envs.tools.sanity.object_checks import OBJECT_CHECKS, object_check
from gauge_envs.tools.sanity.object_checks.check import Scenario, run_scenario
from gauge_envs.tools.sanity.object_checks.measure import (
    Measurements,
    judged,
)
from gauge_envs.tools.sanity.verdict import Reality, SanityVerdict

MUJOCO = backend("mujoco")
ALONG, UP = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])

CHEETAH = {
    "timestep_s": 0.01,
    "integrator": "Euler",
    "cone": "pyramidal",
    "impratio": 1.0,
    "contact_solref": (0.02, 1.0),
    "contact_solimp": (0.0, 0.8, 0.01, 0.5, 2.0),
}
"""Numerical settings of Gymnasium's HalfCheetah, feet on ground."""

REALITIES = """
creep-wood         0         1.4111
creep-plastic      0         2.5323
creep-metal        0         1.7037
rest-height        0         0.5
slide-wood         2.7194    0.082014
slide-plastic      2.8979    0.16123
slide-metal        2.6029    0.17345
slide-turned       2.7194    0.082014
"""
"""Id, value and half-width of the interval of each check.

The creep bound is sqrt(24 * 0.01 mm * E_RMSE) in 8 frames of 1/30 s, with E_RMSE = 0.59 mm for wood (paper, Table 5).
"""


def test_the_values_of_reality_and_their_intervals_stay():
    table = [line.split() for line in REALITIES.strip().splitlines()]
    expected = {name: pytest.approx([float(v), float(w)], 1e-4) for name, v, w in table}
    checks = [object_check(name) for name in OBJECT_CHECKS]
    assert {
        check.id: [check.reality.value, check.reality.tolerance] for check in checks
    } == expected


def read(name, times, **displacements_m):
    """Outcome of a check for given displacements [m]."""
    check = object_check(name)
    return judged(check, recording_of(check.scenario.scene, times, **displacements_m))


def on_board(name, axis):
    """Return an axis of the board's frame in the world."""
    return object_check(name).scenario.scene.body("board").pose.rotation.apply(axis)


# --- rollouts --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("step", "interval"), [(0.01, 0.01), (0.0007, 0.0014)])
def test_a_scene_runs_at_the_step_of_the_configuration(step, interval):
    scene = load_experiment("BouncingBall-rubber").scene
    scenario = Scenario("drop", "BouncingBall-rubber", 0.2, scene)
    settings = {"timestep_s": step, "integrator": "Euler"}
    rollout = run_scenario(MUJOCO, scenario, settings)
    steps = np.round(rollout.times_s / step)
    fall = -rollout.displacement("ball")[:, 2]
    assert rollout.interval_s == pytest.approx(interval)
    assert rollout.times_s[-1] == pytest.approx(0.2, abs=step)
    # A semi-implicit step falls by g h^2 (1 + 2 + ... + n).
    np.testing.assert_allclose(fall, 0.5 * G * step**2 * steps * (steps + 1), atol=1e-9)


def test_rejected_settings_and_divergence_are_outcomes():
    check = object_check("creep-wood")
    with pytest.raises(UnsupportedError, match="unknown setting"):
        run_scenario(MUJOCO, check.scenario, {"colour": "red"})
    with pytest.raises(
        UnsupportedError, match="a step of 2 s is too long for a scene of"
    ):
        run_scenario(MUJOCO, check.scenario, {"timestep_s": 2.0})
    loose = CHEETAH | {"contact_solref": (0.002, 1.0), "refsafe": False}
    with pytest.raises(DivergedError, match="m/s"):
        run_scenario(MUJOCO, check.scenario, loose)
    measured = Measurements(MUJOCO).measure(check, loose)
    assert (measured.verdict, measured.value) == (SanityVerdict.FAILED, None)
    assert measured.remark.startswith("diverged")


def test_an_engine_that_raises_fails(monkeypatch):
    def give_up(simulation, names):
        raise MemoryError("full")

    monkeypatch.setattr(SimulationMuJoCo, "body_states", give_up)
    measured = Measurements(MUJOCO).measure(object_check("slide-wood"), {})
    assert (measured.verdict, measured.value) == (SanityVerdict.FAILED, None)
    assert measured.remark.startswith("the engine raised MemoryError: full")


# --- readings of known motions ---------------------------------------------------------------------------------------


def test_creep_counts_after_settling():
    times = np.linspace(0.0, 1.0, 401)
    path = 0.002 * (1.0 - np.exp(-times / 0.02)) + 0.007 * times
    cube = np.outer(path, on_board("creep-wood", ALONG))
    assert read("creep-wood", times, cube=cube).value == pytest.approx(7.0, abs=1e-3)


def test_resting_height_is_along_the_normal():
    times = np.linspace(0.0, 1.0, 101)
    sunk = np.outer(np.where(times > 0.0, -0.0012, 0.0), on_board("rest-height", UP))
    flat = read("rest-height", times).value
    assert flat == pytest.approx(0.0, abs=2e-3)
    assert read("rest-height", times, cube=sunk).value - flat == pytest.approx(-1.2)


def test_a_slide_is_read_as_acceleration_without_speed():
    times = np.linspace(0.0, 0.5, 126)
    law = object_check("slide-wood").reality.value
    for share, speed in ((1.0, 0.06), (1.2, 0.0)):
        path = speed * times + 0.5 * share * law * times**2
        cube = np.outer(path, on_board("slide-wood", ALONG))
        value = read("slide-wood", times, cube=cube).value
        assert value == pytest.approx(share * law)
    # Real slides show a friction of 0.257, and the cube has it.
    assert law == pytest.approx(G * (0.5 - 0.257145 * np.sqrt(0.75)), rel=2e-3)


# --- reality ---------------------------------------------------------------------------------------------------------


def test_the_interval_covers_95_percent_of_further_trials():
    """Student's t has a quantile of 2.4469 for 6 degrees of freedom and 97.5 %."""
    reality = Reality.measured(5.0, 0.3, 7, "normal")
    assert reality.tolerance == pytest.approx(0.3 * 2.4469 * np.sqrt(8 / 7), 1e-4)


@pytest.mark.parametrize(
    ("deviation", "verdict"),
    [(1.0, "passed"), (1.01, "warning"), (2.5, "warning"), (2.51, "failed")],
)
def test_the_verdict_of_a_deviation(deviation, verdict):
    assert SanityVerdict.of(deviation) == verdict


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
    measured = Measurements(MUJOCO).measure(object_check("creep-wood"), CHEETAH)
    assert measured.value == pytest.approx(plain, rel=0.02)
    assert 50.0 < plain < 65.0


def test_a_friction_that_is_four_percent_too_small_is_a_warning():
    slide = object_check("slide-wood")
    measured = Measurements(MUJOCO).measure(slide, {"friction_scale": 0.96})
    faster = 0.04 * 0.257145 * G * np.sqrt(0.75)
    assert measured.value == pytest.approx(slide.reality.value + faster, rel=0.002)
    assert measured.verdict is SanityVerdict.WARNING


@pytest.mark.parametrize(
    "name", ["mujoco", pytest.param("newton", marks=pytest.mark.slow)]
)
def test_the_preset_of_an_engine_passes(name):
    pytest.importorskip(name)
    measurements = Measurements(backend(name))
    checks = [object_check(name) for name in OBJECT_CHECKS]
    outcomes = {check.id: measurements.measure(check, {}) for check in checks}
    failed = [name for name in outcomes if outcomes[name].verdict.is_off]
    assert failed == []
