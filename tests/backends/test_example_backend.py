"""The example engine and the guide on adding an engine: found by an entry point, and right."""

import dataclasses
import json
import re
import shlex
import subprocess
import sys
from importlib import metadata

import gymnasium
import numpy as np
import pytest
from faults import FAULTS
from places import ROOT
from programs import printed
from texts import fenced

import gauge_envs
from gauge_envs.backends import backend
from gauge_envs.errors import ParameterError
from gauge_envs.scene import (
    Motion,
    Plane,
    Pose,
    Scene,
)
from gauge_envs.scene.drivers import Driver, DriverMotion
from gauge_envs.scene.states import nominal_states
from gauge_envs.scene.timing import SAMPLE_INTERVAL_S
from gauge_envs.tools.bench.parts import ball, body, contact, driven_box
from gauge_envs.tools.conformance import run_checks

PACKAGE = ROOT / "examples" / "point_engine"
GUIDE = ROOT / "docs" / "adding_an_engine.md"

G = 9.80665
RADIUS_M = 0.03
GROUND_M = np.array([0.1, 0.2, 0.3])


@pytest.fixture(autouse=True)
def example(tmp_path_factory, monkeypatch):
    """Make the example's package found as if it were installed."""
    folder = tmp_path_factory.mktemp("installed")
    info = folder / "point_engine-1.0.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: point-engine\nVersion: 1.0.0\n"
    )
    (info / "entry_points.txt").write_text(
        "[gauge_envs.backends]\npoint = point_engine:BackendPoint\n"
    )
    for place in (folder, PACKAGE):
        monkeypatch.syspath_prepend(str(place))
    backend.cache_clear()
    yield
    backend.cache_clear()


@pytest.mark.slow
def test_pip_installs_the_example(tmp_path):
    options = [
        "--quiet",
        "--no-deps",
        "--no-build-isolation",
        "--no-index",
        "--target",
        str(tmp_path),
    ]
    subprocess.run(
        [sys.executable, "-m", "pip", "install", *options, str(PACKAGE)],
        check=True,
        capture_output=True,
    )
    (found,) = metadata.distributions(name="point-engine", path=[str(tmp_path)])
    assert found.version == "1.0.0"
    (point,) = found.entry_points
    assert (point.name, point.value) == ("point", "point_engine:BackendPoint")
    code = "import point_engine; print(point_engine.BackendPoint().versions())"
    assert printed("-c", code, cwd=tmp_path).strip() == "{'point-engine': '1.0.0'}"


# --- closed forms ----------------------------------------------------------------------------------------------------


def bouncing_height(times_s, drop_m, restitution, *, gravity=G):
    """Height above the lowest point of a ball dropped from `drop_m`; 0 after infinitely many bounces."""
    heights = []
    for time in np.asarray(times_s, dtype=float):
        # A flight that starts upward from 0 at `begin`; the drop is the second half of one.
        speed = np.sqrt(2 * gravity * drop_m)
        begin = -speed / gravity
        while time >= begin + 2 * speed / gravity and speed > 1e-9:
            begin, speed = begin + 2 * speed / gravity, speed * restitution
        since = time - begin
        heights.append(max(speed * since - 0.5 * gravity * since**2, 0.0))
    return np.array(heights)


# --- scenes ----------------------------------------------------------------------------------------------------------


def ball_on_plane(
    *,
    drop_m=0.0,
    tilt_deg=0.0,
    friction=0.5,
    restitution=0.0,
    motion=Motion.FIXED,
    drivers=(),
):
    """A ball over a plane that leans about y, so that down the slope is (cos, 0, -sin); None rests, without impact."""
    lean = Pose.from_euler_deg(tuple(GROUND_M.tolist()), (0.0, tilt_deg, 0.0))
    x, y, z = lean.to_world(np.array([0.0, 0.0, RADIUS_M])).tolist()
    touch = contact("ball", "ground", friction=friction, restitution=restitution)
    return Scene(
        bodies=(
            body("ground", Plane(), lean, motion=motion, mass_kg=0.0),
            ball("ball", (x, y, z + drop_m), radius_m=RADIUS_M),
        ),
        contacts=(touch,),
        drivers=drivers,
        duration_s=1.0,
    )


def ball_course(scene, seconds, *, acceleration=None):
    """Return states of the ball every 1/180 s, the start first, shape [sample_count, 13].

    With an acceleration [m/s^2], shape [3], the ground is driven with it from rest.
    """
    simulation = backend("point").build(scene, {"timestep_s": 1 / 1800})
    simulation.reset()
    states = [simulation.body_states(["ball"])[0, 0]]
    for sample in range(round(seconds / SAMPLE_INTERVAL_S)):
        if acceleration is not None:
            time_s = sample * SAMPLE_INTERVAL_S
            pull = np.concatenate([acceleration, np.zeros(3)])
            place_m = GROUND_M + 0.5 * pull[:3] * time_s**2
            pose = [*place_m, 1.0, 0.0, 0.0, 0.0]
            simulation.drive("ground", np.array([[*pose, *(pull * time_s), *pull]]))
        simulation.advance(SAMPLE_INTERVAL_S)
        states.append(simulation.body_states(["ball"])[0, 0])
    return np.array(states)


def driven_plane(kind, **options):
    """A ball over a driven plane."""
    motion = DriverMotion(kind=kind, axis=(0.0, 0.0, 1.0), profiles=())
    driver = Driver(body="ground", motions=(motion,), provenance="nominal")
    return ball_on_plane(motion=Motion.KINEMATIC, drivers=(driver,), **options)


# --- an experiment ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    # Scores of MuJoCo, whose rebound is within 0.0025 of the coefficient.
    ("parameters", "score"),
    [("calibrated", 14.11), ("effective", 12.77)],
)
def test_bouncing_ball_follows_the_law_of_bounces(rollout, parameters, score):
    env, trajectory, info = rollout(
        "BouncingBall-rubber", backend="point", parameters=parameters
    )
    scene = gauge_envs.load_experiment("BouncingBall-rubber", parameters).scene
    (x, y, z), touch = scene.body("ball").pose.position_m, scene.contacts[0]
    lowest = scene.body("ground").pose.position_m[2] + RADIUS_M
    height = lowest + bouncing_height(trajectory.times_s, z - lowest, touch.restitution)
    expected = np.column_stack(
        [np.full_like(height, x), np.full_like(height, y), height]
    )
    assert trajectory.samples / 1e3 == pytest.approx(expected, abs=1e-10)
    assert info["score"].rmse_normalized == pytest.approx(score, abs=0.02)
    assert env.versions == {"point-engine": "1.0.0"}


def test_all_other_experiments_are_declined_with_reasons():
    # Experiments that differ in the material alone have the same shapes and joints.
    names = {
        variant.name.rpartition("-")[0]: variant.name
        for variant in reversed(gauge_envs.variants())
    }
    missing = {
        name: backend("point").supports(gauge_envs.load_experiment(name).scene).missing
        for name in names.values()
    }
    supported = [name for name, reasons in missing.items() if not reasons]
    assert supported == ["BouncingBall-rubber"]
    assert "'cube' is a Box" in missing["SlopeSlider-2-wood"][0]
    assert "'textile' is a Cloth" in missing["TextileFlinging-rayon"][0]
    hinges, touched, pairs = missing["NewtonsCradle-metal"]
    assert "'ball-1' (and 4 more) hangs on a Hinge" in hinges
    assert "'ball-1' (and 4 more) may touch more than one body" in touched
    assert "'ball-1' and 'ball-2' (and 9 more) may touch" in pairs


def test_command_line_knows_the_engine(gauge, tmp_path):
    run = gauge(
        *("run", "BouncingBall-rubber", "--backend", "point"),
        *("--json", "--out", tmp_path / "results"),
    )
    assert run.exit_code == 0, run.stderr
    assert json.loads(run.stdout)["backend"] == "point"


def test_vector_environments_batch_the_worlds():
    options = {"jitter": True}
    envs = gymnasium.make_vec("GAUGE/BouncingBall-rubber", num_envs=3, backend="point")
    envs.reset(seed=4, options=options)
    for _ in range(10):
        together = envs.step(np.zeros(3, dtype=int))[0]["bodies"]
    for world in range(3):
        env = gymnasium.make("GAUGE/BouncingBall-rubber", backend="point")
        env.reset(seed=4 + world, options=options)
        for _ in range(10):
            alone = env.step(0)[0]["bodies"]
        np.testing.assert_allclose(together[world], alone, atol=1e-9)
    assert np.ptp(together[:, 0, 0]) > 1e-4


# --- physics ---------------------------------------------------------------------------------------------------------


def test_slopes_obey_coulomb_and_the_inertia_of_a_solid_sphere():
    """Balls that rest at the start; the checks have those that strike a plane."""
    course = {
        name: ball_course(
            ball_on_plane(tilt_deg=30, friction=mu, restitution=None, drop_m=drop_m),
            seconds,
        )
        for name, mu, drop_m, seconds in (
            ("rolls", 0.5, 0.0, 0.5),
            ("slides", 0.1, 0.0, 0.5),
            ("lands", 0.05, 0.2, 0.25),
        )
    }
    sine, cosine = np.sin(np.pi / 6), np.cos(np.pi / 6)
    down, normal = np.array([cosine, 0.0, -sine]), np.array([sine, 0.0, cosine])

    def along(name, axis):
        return (course[name][:, :3] - course[name][0, :3]) @ axis

    half_square = 0.5 * (np.arange(91) * SAMPLE_INTERVAL_S) ** 2
    rolling, sliding = 5 / 7 * G * sine, G * (sine - 0.1 * cosine)
    assert along("rolls", down) == pytest.approx(rolling * half_square, abs=1e-10)
    assert along("slides", down) == pytest.approx(sliding * half_square, abs=1e-10)
    assert along("rolls", normal) == pytest.approx(0.0, abs=1e-12)
    # Down the slope a ball turns about +y. A rolling one has no slip; a sliding one speeds up with 5/2 mu g cos / r.
    rolls, slides = course["rolls"][-1], course["slides"][-1]
    assert rolls[11] * RADIUS_M == pytest.approx(rolls[7:10] @ down, abs=1e-10)
    spin_up = 2.5 * 0.1 * G * cosine / RADIUS_M
    assert slides[11] == pytest.approx(spin_up * 0.5, abs=1e-8)
    turn = 2 * np.arctan2(slides[5], slides[3])
    missed = turn - spin_up * half_square[-1]
    assert np.sin(0.5 * missed) == pytest.approx(0.0, abs=1e-10)
    # A sustained contact does not rebound; friction then acts on the landing and on the way.
    arrival = np.sqrt(2 * G * 0.2)
    since = 45 * SAMPLE_INTERVAL_S - arrival / G
    landed = (arrival + G * since) * (sine - 0.05 * cosine)
    assert course["lands"][-1, 7:10] == pytest.approx(landed * down, abs=1e-10)


@pytest.mark.parametrize(
    ("acceleration", "travel"),
    [
        # A solid sphere that rolls on an accelerated plate goes with 2/7 of its acceleration.
        ((2.0, 0.0, 0.0), (2 / 7 * 2.0, 0.0, 0.0)),
        ((0.0, 0.0, 3.0), (0.0, 0.0, 3.0)),
        # Down, faster than free fall.
        ((0.0, 0.0, -15.0), (0.0, 0.0, -G)),
    ],
)
def test_driven_planes_carry_and_lift(acceleration, travel):
    scene = driven_plane("translate", restitution=None)
    states = ball_course(scene, 0.4, acceleration=acceleration)
    moved_m = 0.5 * np.array(travel) * 0.4**2
    assert states[-1, :3] - states[0, :3] == pytest.approx(moved_m, abs=1e-9)


def test_a_ball_bounces_in_a_lift_as_under_more_gravity():
    scene = driven_plane("translate", drop_m=0.1, restitution=0.7)
    states = ball_course(scene, 0.4, acceleration=(0.0, 0.0, 4.0))
    times_s = np.arange(73) * SAMPLE_INTERVAL_S
    above_m = states[:, 2] - GROUND_M[2] - RADIUS_M - 0.5 * 4.0 * times_s**2
    expected_m = bouncing_height(times_s, 0.1, 0.7, gravity=G + 4.0)
    assert above_m == pytest.approx(expected_m, abs=1e-9)


# --- contract --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"substeps": 3}, "'substeps'.*unknown setting"),
        ({"timestep_s": 0.0}, "'timestep_s'"),
        ({"timestep_s": 0.004}, "not a whole number"),
    ],
)
def test_impossible_settings_are_named(settings, words):
    with pytest.raises(ParameterError, match=words):
        backend("point").build(ball_on_plane(), settings)


def test_unsupported_scenes_have_their_reasons():
    point = backend("point")
    (turned,) = point.supports(driven_plane("rotate")).missing
    assert turned.startswith("'ball' and 'ground' may touch, and planes")
    assert turned.endswith("shifted, not turned")
    (sunk,) = point.supports(ball_on_plane(drop_m=-0.002)).missing
    assert sunk == "'ball' and 'ground' overlap by 2 mm at the start"
    plate = driven_box("plate", (1.0, 0.0, 0.0), (0.1, 0.1, 0.1))
    apart = dataclasses.replace(
        ball_on_plane(), bodies=(*ball_on_plane().bodies, plate)
    )
    assert point.supports(apart)


def test_worlds_start_apart_and_do_not_touch_each_other():
    scene = ball_on_plane(tilt_deg=20, drop_m=0.05, friction=0.2, restitution=0.6)
    starts = np.tile(nominal_states(scene), (4, 1, 1))
    starts[:, 1, 2] += 0.05 * np.arange(4)
    together = backend("point").build_worlds(scene, 4)
    together.reset(starts)
    alone = [backend("point").build(scene) for _ in starts]
    for one, start in zip(alone, starts, strict=True):
        one.reset(start[None])
    for _ in range(60):
        for one in (together, *alone):
            one.advance(SAMPLE_INTERVAL_S)
        found = together.body_states(["ball"])
        single = np.concatenate([one.body_states(["ball"]) for one in alone])
        np.testing.assert_allclose(found, single, atol=1e-12)


QUICK = (
    "start*",
    "rest-heights",
    "rebound-0.5",
    "oblique-*",
    "roll-*",
    "reset-*",
    "free-fall",
    "driven-path",
    "contact-*",
    "wrench-*",
)


@pytest.mark.parametrize(
    "only", [QUICK, pytest.param((), marks=pytest.mark.slow)], ids=["quick", "all"]
)
def test_the_conformance_kit_finds_nothing(only):
    found = [one.status.value for one in run_checks("point", only=only)]
    assert set(found) == {"pass", "declined"}
    assert found.count("pass") > 10


# --- guide -----------------------------------------------------------------------------------------------------------


def test_the_engine_of_the_guide_passes_what_it_does_not_decline():
    (block,) = fenced(GUIDE, "python")
    names = {"__name__": "guide"}
    exec(block, names)
    results = list(run_checks(names["BackendFlying"]()))
    assert [one.check for one in results if one.is_bad] == []
    passed = {one.check for one in results if not one.missing}
    assert passed >= {"free-fall", "time", "driven-path", "worlds-single"}


def test_the_table_of_mistakes_has_the_messages_of_the_checks():
    rows = re.findall(
        r"^\| (.+?) \| `(.+?)` \|$", GUIDE.read_text(), flags=re.MULTILINE
    )
    rows = [(mistake, says) for mistake, says in rows if mistake in FAULTS]
    assert len(rows) > 10
    for mistake, says in rows:
        fault = FAULTS[mistake]
        engine = fault.engine(backend("mujoco"), fault)
        (result,) = run_checks(engine, only=[fault.caught_by])
        assert says in result.diagnosis


def test_toml_of_the_guide_is_that_of_the_example():
    manifest = (PACKAGE / "pyproject.toml").read_text()
    assert fenced(GUIDE, "toml")
    assert fenced(GUIDE, "toml")[0] in manifest


@pytest.mark.slow
def test_gauge_commands_of_the_guide_run(gauge):
    lines = [line for block in fenced(GUIDE, "sh") for line in block.splitlines()]
    commands = [line for line in lines if line.startswith("gauge ")]
    # The steps of the guide call the reader's engine `mine`.
    steps = re.findall(r"^\d\. `(gauge [^`]*)`", GUIDE.read_text(), flags=re.MULTILINE)
    commands += [step.replace("mine", "point") for step in steps]
    words = [shlex.split(command)[1:] for command in commands]
    assert {command[0] for command in words} == {"list", "backend", "run"}
    for command in words:
        run = gauge(*command)
        assert run.exit_code == 0, f"{shlex.join(command)}: {run.output}"
