"""The path of an author of an engine: the guide, the example engine, and what the package provides.

The example is found by its entry point and follows the law of bounces; parts for authors follow closed forms.
"""

import dataclasses
import re
import shlex
from threading import get_ident
from typing import ClassVar

import numpy as np
import pytest
from faults import FAULTS
from places import ROOT
from rigid import solid
from scipy.spatial.transform import Rotation
from texts import fenced

import gauge_envs
from gauge_envs.backends import (
    Backend,
    LoopedSimulation,
    Simulation,
    Support,
    backend,
    backend_names,
    registry,
)
from gauge_envs.backends.registry import backend_class
from gauge_envs.backends.shared.rigid import TetherSpring, later_targets, motion_steps
from gauge_envs.errors import (
    BackendError,
    MissingExtraError,
    ParameterError,
    UnknownNameError,
)
from gauge_envs.experiments.variants import find_variant
from gauge_envs.fixtures.parts import ball, contact, ground
from gauge_envs.runs import workers
from gauge_envs.scene import ConvexUnion, Motion, Pose, Scene, Tether
from gauge_envs.scene.drivers import Driver, DriverMotion
from gauge_envs.tools.catalog import listing
from gauge_envs.tools.conformance import run_checks

# --- the example and the guide ---------------------------------------------------------------------------------------

PACKAGE = ROOT / "examples" / "point_engine"
GUIDE = ROOT / "docs" / "adding_an_engine.md"
G, RADIUS_M = 9.80665, 0.03


@pytest.fixture
def example(tmp_path, monkeypatch):
    """Make the example's package found as if it were installed."""
    info = tmp_path / "point_engine-1.0.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: point-engine\nVersion: 1.0.0\n"
    )
    (info / "entry_points.txt").write_text(
        "[gauge_envs.backends]\npoint = point_engine:BackendPoint\n"
    )
    for place in (tmp_path, PACKAGE):
        monkeypatch.syspath_prepend(str(place))
    backend.cache_clear()
    yield
    backend.cache_clear()


def bouncing_height_m(times_s, drop_m, restitution):
    """Return the height above the ground of the lowest point of a ball that drops and bounces."""
    heights_m = []
    for time_s in times_s:
        # A flight that starts upward from 0 at `begin_s`; the drop is the second half of one.
        speed = np.sqrt(2 * G * drop_m)
        begin_s = -speed / G
        while time_s >= begin_s + 2 * speed / G and speed > 1e-9:
            begin_s += 2 * speed / G
            speed *= restitution
        since_s = time_s - begin_s
        heights_m.append(max(speed * since_s - 0.5 * G * since_s**2, 0.0))
    return np.array(heights_m)


@pytest.mark.usefixtures("example")
def test_the_example_follows_the_law_of_bounces(rollout):
    env, trajectory, info = rollout("BouncingBall-rubber", backend="point")
    scene = gauge_envs.load_experiment("BouncingBall-rubber").scene
    (x, y, z), touch = scene.body("ball").pose.position_m, scene.contacts[0]
    lowest = scene.body("ground").pose.position_m[2] + RADIUS_M
    drop_m = z - lowest
    height = lowest + bouncing_height_m(trajectory.times_s, drop_m, touch.restitution)
    expected = np.array([np.full_like(height, x), np.full_like(height, y), height])
    np.testing.assert_allclose(trajectory.samples.T / 1e3, expected, atol=1e-10)
    # MuJoCo, whose rebound is within 0.0025 of the coefficient, has this score.
    assert info["score"].rmse_normalized == pytest.approx(14.11, abs=0.02)
    assert env.versions == {"point-engine": "1.0.0"}


def ball_on_plane(*, drop_m=0.0, motion=Motion.FIXED, drivers=()):
    plane = dataclasses.replace(ground(), motion=motion)
    return Scene(
        bodies=(plane, ball("ball", (0.0, 0.0, RADIUS_M + drop_m))),
        contacts=(contact("ball", "ground", friction=0.5, restitution=0.0),),
        drivers=drivers,
        duration_s=1.0,
    )


@pytest.mark.usefixtures("example")
def test_the_example_gives_reasons_for_unsupported_scenes():
    def missing(name):
        return backend("point").supports(gauge_envs.load_experiment(name).scene).missing

    assert missing("BouncingBall-rubber") == ()
    assert "'cube' is a Box" in missing("SlopeSlider-2-wood")[0]
    assert "'textile' is a Cloth" in missing("TextileFlinging-rayon")[0]
    assert "'ball-1' (and 4 more) hangs on a Hinge" in missing("NewtonsCradle-metal")[0]
    point = backend("point")
    (sunk,) = point.supports(ball_on_plane(drop_m=-0.002)).missing
    assert sunk == "'ball' and 'ground' overlap by 2 mm at the start"
    turning = DriverMotion(kind="rotate", axis=(0.0, 0.0, 1.0), profiles=())
    driver = Driver(body="ground", motions=(turning,), provenance="nominal")
    scene = ball_on_plane(motion=Motion.KINEMATIC, drivers=(driver,))
    (turned,) = point.supports(scene).missing
    assert turned.endswith("shifted, not turned")
    with pytest.raises(ParameterError, match=r"'substeps'.*unknown setting"):
        point.build(ball_on_plane(), {"substeps": 3})


SHORT = (
    "order-*",
    "start*",
    "worlds-shapes",
    "rebound-*",
    "oblique-*",
    "rest-*",
)


@pytest.mark.usefixtures("example")
@pytest.mark.parametrize(
    "only", [SHORT, pytest.param((), marks=pytest.mark.slow)], ids=["short", "all"]
)
def test_no_check_finds_a_fault_of_the_example(only):
    statuses = [result.status.value for result in run_checks("point", only=only)]
    assert set(statuses) == {"pass", "unsupported"}
    assert statuses.count("pass") > 8


def test_the_engine_of_the_guide_passes_all_supported_checks():
    (block,) = fenced(GUIDE, "python")
    names = {"__name__": "guide"}
    exec(block, names)
    results = list(run_checks(names["BackendFlying"]()))
    assert [result.check for result in results if result.is_bad] == []
    passed = {result.check for result in results if not result.missing}
    assert passed >= {"free-fall", "time", "driven-path", "worlds-single"}


def test_the_table_of_mistakes_has_the_messages_of_the_checks():
    rows = re.findall(
        r"^\| (.+?) \| `(.+?)` \|$", GUIDE.read_text(), flags=re.MULTILINE
    )
    messages = {mistake: message for mistake, message in rows if mistake in FAULTS}
    assert len(messages) > 10
    # The test of each fault finds its words in the message of its check.
    for mistake, message in messages.items():
        assert FAULTS[mistake].says.startswith(message)


@pytest.mark.usefixtures("example")
def test_toml_of_the_guide_equals_the_example():
    assert fenced(GUIDE, "toml")[0] in (PACKAGE / "pyproject.toml").read_text()


@pytest.mark.slow
@pytest.mark.usefixtures("example")
def test_gauge_commands_of_the_guide_run(gauge):
    lines = [line for block in fenced(GUIDE, "sh") for line in block.splitlines()]
    commands = [line for line in lines if line.startswith("gauge ")]
    # The steps of the guide call the reader's engine `mine`.
    steps = re.findall(r"^\d\. `(gauge [^`]*)`", GUIDE.read_text(), flags=re.MULTILINE)
    commands += [step.replace("mine", "point") for step in steps]
    assert len(commands) > 2
    for command in commands:
        run = gauge(*shlex.split(command)[1:])
        assert run.exit_code == 0, f"{command}: {run.output}"


# --- finding engines -------------------------------------------------------------------------------------------------


class BackendNothing(Backend):
    name = "nothing"
    title = "Nothing at all"
    color = "#123456"

    def versions(self):
        return {"nothing": "1.0"}

    def supports(self, scene):
        return Support(("it does nothing",))

    def build(self, scene, settings=None):
        raise AssertionError("supports declines every scene")


@dataclasses.dataclass
class EntryPoint:
    """Stands for an installed package's entry point."""

    name: str
    error: Exception | None = None
    value: str = "somebody:Backend"

    def load(self):
        if self.error is not None:
            raise self.error
        return BackendNothing


@pytest.fixture
def installed_engines(monkeypatch):
    """Install a working engine, an engine that cannot be imported, and an engine whose extra is missing."""
    lacking = ModuleNotFoundError(name="other_engine")
    points = [
        EntryPoint("nothing"),
        EntryPoint("broken", OSError("libengine.so: cannot open shared object file")),
        EntryPoint(
            "other",
            MissingExtraError("backend 'other'", "fast", lacking, package="somebody"),
        ),
    ]
    monkeypatch.setattr("gauge_envs.registry.entry_points", lambda group: points)
    backend.cache_clear()
    yield
    backend.cache_clear()


@pytest.mark.usefixtures("installed_engines")
def test_an_engine_that_cannot_be_loaded_is_named_and_affects_no_other_engine(
    monkeypatch,
):
    assert backend_names() == ("broken", "nothing", "other")
    place = r"'broken' \(somebody:Backend\): OSError: libengine\.so"
    with pytest.raises(BackendError, match=place):
        backend("broken")
    with pytest.raises(MissingExtraError, match=r"pip install 'somebody\[fast\]'"):
        backend("other")
    with pytest.raises(UnknownNameError, match="nothing"):
        backend("nothin")
    assert backend_class("nothing").color == "#123456"
    assert backend_class("broken").color == ""
    for module in (workers, listing):
        monkeypatch.setattr(module, "is_bundled", lambda name: True)
    (row,) = listing.list_rows([find_variant("SlopeSlider-2-wood")])
    assert row["backends"]["nothing"] == ["it does nothing"]
    assert "libengine.so" in row["backends"]["broken"][0]


def test_ctrl_c_in_an_import_is_not_an_error_of_the_engine():
    def interrupted_import():
        try:
            raise KeyboardInterrupt
        finally:
            raise RuntimeError("cannot release un-acquired lock")

    with pytest.raises(KeyboardInterrupt), registry._as_backend_error("engine"):
        interrupted_import()


# --- worlds in a loop ------------------------------------------------------------------------------------------------


class Counter(Simulation):
    """One world, whose body has counted the seconds since its start, on x."""

    settings: ClassVar = {}

    def __init__(self, *, reason=""):
        self.reason = reason
        self.thread = None
        self.is_open = True
        self.reset()

    def reset(self, starts=None, seed=0):
        self.states = np.zeros((1, 1, 13)) if starts is None else starts.copy()
        self.seed = seed

    def drive(self, body, targets):
        self.states[0, 0] = targets[0, :13]

    def apply_wrench(self, body, wrenches):
        self.states[0, 0, 7:10] += wrenches[0, :3]

    def advance(self, seconds):
        self.thread = get_ident()
        self.states[0, 0, 0] += seconds

    def body_states(self, names):
        return self.states.copy()

    def nodes(self, name):
        return self.states[:, :, :3].copy()

    def diverged(self):
        return {0: self.reason} if self.reason else {}

    def contact_forces(self, pairs):
        return lambda: self.states[:, :, 7:10].copy()

    def close(self):
        self.is_open = False


def test_a_looped_simulation_gives_each_world_its_row():
    worlds = [Counter(), Counter(reason="gave up"), Counter()]
    looped = LoopedSimulation(worlds)
    assert looped.world_count == 3
    starts = np.arange(39.0).reshape(3, 1, 13)
    looped.reset(starts, 5)
    looped.advance(0.5)
    expected = starts.copy()
    expected[..., 0] += 0.5
    np.testing.assert_array_equal(looped.body_states(["body"]), expected)
    np.testing.assert_array_equal(looped.nodes("cloth"), expected[..., :3])
    assert [world.seed for world in worlds] == [5, 5, 5]
    assert looped.diverged() == {1: "gave up"}
    targets, wrenches = np.arange(57.0).reshape(3, 19), np.arange(18.0).reshape(3, 6)
    looped.drive("body", targets)
    looped.apply_wrench("body", wrenches)
    forces = looped.contact_forces([("body", "ground")])()
    np.testing.assert_array_equal(forces[:, 0], targets[:, 7:10] + wrenches[:, :3])
    assert looped.track("cloth", np.zeros((1, 3))) is None
    looped.close()
    assert not any(world.is_open for world in worlds)


def test_worlds_that_free_python_advance_in_threads(monkeypatch):
    monkeypatch.setattr(Counter, "releases_gil", True)
    monkeypatch.setattr("gauge_envs.backends.simulation.processor_count", lambda: 2)
    worlds = [Counter(), Counter()]
    looped = LoopedSimulation(worlds)
    looped.advance(0.5)
    assert looped.body_states(["body"])[:, 0, 0].tolist() == [0.5, 0.5]
    assert get_ident() not in {world.thread for world in worlds}
    worlds[1].advance = lambda seconds: 1 / 0
    with pytest.raises(ZeroDivisionError):
        looped.advance(0.5)
    looped.close()


def test_a_missing_method_is_named():
    class Minimal(Counter):
        drive = Simulation.drive
        apply_wrench = Simulation.apply_wrench

    with pytest.raises(
        BackendError, match="Minimal does not drive bodies: implement drive"
    ):
        Minimal().drive("plate", np.zeros((1, 19)))
    with pytest.raises(BackendError, match="'plate': implement apply_wrench"):
        Minimal().apply_wrench("plate", np.zeros((1, 6)))


# --- driven motion and strings ---------------------------------------------------------------------------------------


def string_of_a_bar(low_m):
    """Return the spring of a string of 0.3 m at the origin of a thin bar of 0.1 kg along x from `low_m` to +0.12 m."""
    corners = tuple(
        (x, y, z)
        for x in (low_m, low_m + 0.12)
        for y in (-0.001, 0.001)
        for z in (-0.001, 0.001)
    )
    bar = solid("bar", ConvexUnion(pieces_m=(corners,)), (0.0, 0.0, 1.2))
    string = Tether(body="bar", anchor_m=(0.0, 0.0, 1.5), length_m=0.3)
    (spring,) = TetherSpring.of(Scene(bodies=(bar,), joints=(string,), duration_s=0.4))
    return spring


@pytest.mark.parametrize(("low_m", "share"), [(-0.06, 1.0), (0.0, 0.25)])
def test_the_end_of_a_bar_moves_like_a_quarter_of_its_mass(low_m, share):
    """A rod that is pulled across at its end: 1 / m + (L / 2)^2 / (m L^2 / 12) = 4 / m; along itself it is m."""
    spring = string_of_a_bar(low_m)
    turned = Rotation.from_euler("xyz", [20.0, 50.0, -70.0], degrees=True)
    across, along = turned.apply([[0.0, 0.6, 0.8], [1.0, 0.0, 0.0]])
    assert spring.end_mass_kg(turned, across) == pytest.approx(0.1 * share, rel=1e-3)
    assert spring.end_mass_kg(turned, along) == pytest.approx(0.1)


def test_a_string_is_a_critically_damped_spring_that_only_pulls():
    """F = m (w^2 x + 2 w v) for an extension x and its rate v."""
    spring = string_of_a_bar(-0.06)

    def pull(height_m, speed):
        state = [0.0, 0.0, height_m, 1, 0, 0, 0, 0.0, 0.0, speed, 0, 0, 0]
        return spring.pull_n(np.array(state), 100.0)

    expected = 0.1 * (100.0**2 * 0.01 + 2.0 * 100.0 * 0.2)
    assert pull(1.19, -0.2) == pytest.approx([0.0, 0.0, expected], rel=1e-9)
    assert pull(1.21, -0.6) is None
    assert pull(1.19, 0.6) is None


def test_mean_velocities_follow_a_driven_motion_exactly():
    start = Pose.from_euler_deg((0.1, 0.2, 0.3), (20.0, -30.0, 40.0))
    rates = np.array([0.3, -0.1, 0.2, 1.0, 2.0, -1.5])
    acceleration = np.array([2.0, 1.0, -3.0, 40.0, -10.0, 20.0])
    row = np.hstack([start.position_m, start.quaternion, rates, acceleration])
    seconds, count = 1 / 180, 4
    travel = rates * seconds + 0.5 * acceleration * seconds**2
    (later,) = later_targets(row[None], seconds)
    end = Pose.of_state(later)
    turned = Rotation.from_rotvec(travel[3:]) * start.rotation
    assert end.position_m == pytest.approx(start.position_m + travel[:3], abs=1e-15)
    assert (end.rotation * turned.inv()).magnitude() < 1e-14
    assert later[7:13] == pytest.approx(rates + acceleration * seconds)
    position, rotation = np.asarray(start.position_m), start.rotation
    poses, velocities = motion_steps(row, seconds / count, count)
    for pose, velocity in zip(poses, velocities, strict=True):
        assert pose[:3] == pytest.approx(position, abs=1e-15)
        reached = Rotation.from_quat(pose[3:], scalar_first=True)
        assert (reached * rotation.inv()).magnitude() < 1e-14
        position = position + velocity[:3] * seconds / count
        rotation = Rotation.from_rotvec(velocity[3:] * seconds / count) * rotation
    assert position == pytest.approx(end.position_m, abs=1e-15)
    assert (rotation * end.rotation.inv()).magnitude() < 1e-14
