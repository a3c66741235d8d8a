"""The example engine and the guide on adding an engine: installed as a package of its own, found by name, and right.

What the engine does runs in processes of its own, whose path has the installed package; its numbers come back as JSON.
"""

import dataclasses
import json
import os
import re
import shlex
import subprocess
import sys
import tempfile
import tomllib
import traceback
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from places import ROOT
from programs import printed
from texts import fenced
from typer.testing import CliRunner

import gauge_envs
from gauge_envs.backends import backend
from gauge_envs.cli.app import app
from gauge_envs.errors import ParameterError
from gauge_envs.scene import (
    Motion,
    Plane,
    Pose,
    Scene,
)
from gauge_envs.scene.drivers import Driver, DriverMotion
from gauge_envs.scene.timing import SAMPLE_INTERVAL_S
from gauge_envs.tools.bench.parts import ball, body, contact, driven_box
from gauge_envs.tools.conformance import run_checks

PACKAGE = ROOT / "examples" / "point_engine"
GUIDE = ROOT / "docs" / "adding_an_engine.md"

G = 9.80665
RADIUS_M = 0.03
GROUND_M = np.array([0.1, 0.2, 0.3])


# --- running with the package installed ------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def environment(tmp_path_factory):
    """Environment variables of a process that finds the example as if it were installed, and this module."""
    target = tmp_path_factory.mktemp("installed")
    project = tomllib.loads((PACKAGE / "pyproject.toml").read_text())["project"]
    facts = (
        target / f"{project['name'].replace('-', '_')}-{project['version']}.dist-info"
    )
    facts.mkdir()
    (facts / "METADATA").write_text(
        f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n"
    )
    lines = [
        line
        for group, points in project["entry-points"].items()
        for line in (
            f"[{group}]",
            *(f"{name} = {value}" for name, value in points.items()),
        )
    ]
    (facts / "entry_points.txt").write_text("\n".join(lines))
    return process_environment(target, PACKAGE)


def process_environment(*folders):
    places = [
        *map(str, folders),
        str(Path(__file__).parent),
        str(ROOT / "tests"),
        os.environ.get("PYTHONPATH", ""),
    ]
    return os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, places))}


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
    code = "from gauge_envs.backends import backend; print(backend('point').versions(), backend.__module__)"
    assert "{'point-engine': '1.0.0'}" in printed(
        "-c", code, cwd=tmp_path, env=process_environment(tmp_path)
    )


@pytest.fixture(scope="module")
def measured(environment):
    """What each `measure_*` function of this module returns in a process that has the example installed, by name."""
    return json.loads(
        printed(
            *("-c", f"import {Path(__file__).stem} as m; m.print_measured()"),
            env=environment,
        )
    )


def print_measured():
    """Print the results of all `measure_*` functions as JSON."""
    prefix = "measure_"
    found = {
        name.removeprefix(prefix): f()
        for name, f in globals().items()
        if name.startswith(prefix)
    }
    print(json.dumps(found))


def gauge(environment, arguments, cwd):
    command = [str(Path(sys.executable).parent / "gauge"), *arguments]
    return subprocess.run(
        command, env=environment, cwd=cwd, capture_output=True, text=True
    )


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
    """States of the ball every 1/180 s, the start first, shape [sample_count, 13].

    With an acceleration [m/s^2], shape [3], the ground is driven with it from rest.
    """
    simulation = backend("point").build(scene, {"timestep_s": 1 / 1800})
    simulation.reset(seed=0)
    states = [simulation.body_states(["ball"])[0]]
    for sample in range(round(seconds / SAMPLE_INTERVAL_S)):
        if acceleration is not None:
            drive = np.concatenate([acceleration, np.zeros(3)])
            time_s = sample * SAMPLE_INTERVAL_S
            place = Pose(position_m=tuple(GROUND_M + 0.5 * drive[:3] * time_s**2))
            simulation.drive("ground", place, drive * time_s, drive)
        simulation.advance(SAMPLE_INTERVAL_S)
        states.append(simulation.body_states(["ball"])[0])
    return np.array(states)


def driven_plane(kind, **options):
    """A ball over a driven plane."""
    motion = DriverMotion(kind=kind, axis=(0.0, 0.0, 1.0), profiles=())
    driver = Driver(body="ground", motions=(motion,), provenance="nominal")
    return ball_on_plane(motion=Motion.KINEMATIC, drivers=(driver,), **options)


# --- an experiment ---------------------------------------------------------------------------------------------------


def measure_experiment():
    values = {}
    for parameters in ("calibrated", "effective"):
        env = gymnasium.make(
            "GAUGE/BouncingBall-rubber", backend="point", parameters=parameters
        )
        env.reset(seed=0)
        over = False
        while not over:
            *_, terminated, over, info = env.step(0)
            assert not terminated
        trajectory = env.unwrapped.trajectory()
        values[parameters] = {
            "times_s": trajectory.times_s.tolist(),
            "position_m": (trajectory.samples / 1e3).tolist(),
            "rmse_normalized": info["score"].rmse_normalized,
            "versions": env.unwrapped.versions,
        }
    return values


def test_bouncing_ball_follows_the_law_of_bounces(measured):
    for parameters, values in measured["experiment"].items():
        scene = gauge_envs.load_experiment("BouncingBall-rubber", parameters).scene
        (x, y, z), contact = scene.body("ball").pose.position_m, scene.contacts[0]
        lowest = scene.body("ground").pose.position_m[2] + RADIUS_M
        height = lowest + bouncing_height(
            values["times_s"], z - lowest, contact.restitution
        )
        expected = np.column_stack(
            [np.full(len(height), x), np.full(len(height), y), height]
        )
        assert np.asarray(values["position_m"]) == pytest.approx(expected, abs=1e-10)
        # The scores of MuJoCo, whose rebound is within 0.0025 of the coefficient.
        score = {"calibrated": 14.11, "effective": 12.77}[parameters]
        assert values["rmse_normalized"] == pytest.approx(score, abs=0.02)
        assert values["versions"] == {"point-engine": "1.0.0"}


def measure_support():
    """Experiments that differ in the material alone have the same shapes and joints."""
    names = {
        variant.name.rpartition("-")[0]: variant.name
        for variant in reversed(gauge_envs.variants())
    }
    scenes = {name: gauge_envs.load_experiment(name).scene for name in names.values()}
    return {
        name: list(backend("point").supports(scene).missing)
        for name, scene in scenes.items()
    }


def test_all_other_experiments_are_declined_with_reasons(measured):
    missing = measured["support"]
    supported = [name for name, reasons in missing.items() if not reasons]
    assert supported == ["BouncingBall-rubber"]
    assert "'cube' is a Box" in missing["SlopeSlider-2-wood"][0]
    assert "'textile' is a Cloth" in missing["TextileFlinging-rayon"][0]
    hinges, touched, pairs = missing["NewtonsCradle-metal"]
    assert "'ball-1' (and 4 more) hangs on a Hinge" in hinges
    assert "'ball-1' (and 4 more) may touch more than one body" in touched
    assert "'ball-1' and 'ball-2' (and 9 more) may touch" in pairs


def invoked(*arguments):
    """What a `gauge` command of this process printed, and its exit code."""
    run = CliRunner().invoke(app, arguments)
    return {"exit_code": run.exit_code, "stdout": run.stdout, "stderr": run.stderr}


def measure_run():
    with tempfile.TemporaryDirectory() as folder:
        return invoked(
            "run",
            "BouncingBall-rubber",
            "--backend",
            "point",
            "--json",
            "--out",
            folder,
        )


def test_command_line_knows_the_engine(measured):
    run = measured["run"]
    assert run["exit_code"] == 0, run["stderr"]
    assert json.loads(run["stdout"])["backend"] == "point"


# --- physics ---------------------------------------------------------------------------------------------------------


def measure_slopes():
    return {
        name: ball_course(
            ball_on_plane(tilt_deg=30, friction=mu, restitution=None, drop_m=drop),
            time,
        ).tolist()
        for name, mu, drop, time in (
            ("rolls", 0.5, 0.0, 0.5),
            ("slides", 0.1, 0.0, 0.5),
            ("lands", 0.05, 0.2, 0.25),
        )
    }


def test_slopes_obey_coulomb_and_the_inertia_of_a_solid_sphere(measured):
    """Balls that rest at the start; the checks have those that strike a plane."""
    course = {name: np.asarray(states) for name, states in measured["slopes"].items()}
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


def measure_driven():
    resting = driven_plane("translate", restitution=None)
    bouncing = driven_plane("translate", drop_m=0.1, restitution=0.7)
    return {
        name: ball_course(scene, 0.4, acceleration=acceleration).tolist()
        for name, scene, acceleration in (
            ("sideways", resting, (2.0, 0.0, 0.0)),
            ("up", resting, (0.0, 0.0, 3.0)),
            ("down faster than free fall", resting, (0.0, 0.0, -15.0)),
            ("lift", bouncing, (0.0, 0.0, 4.0)),
        )
    }


def test_driven_planes_carry_lift_and_hit(measured):
    course = {name: np.asarray(states) for name, states in measured["driven"].items()}
    travel = {name: states[-1, :3] - states[0, :3] for name, states in course.items()}
    # A solid sphere that rolls on an accelerated plate goes with 2/7 of its acceleration.
    assert travel["sideways"] == pytest.approx(
        [2 / 7 * 0.5 * 2.0 * 0.4**2, 0.0, 0.0], abs=1e-9
    )
    assert travel["up"] == pytest.approx([0.0, 0.0, 0.5 * 3.0 * 0.4**2], abs=1e-9)
    assert travel["down faster than free fall"] == pytest.approx(
        [0.0, 0.0, -0.5 * G * 0.4**2], abs=1e-9
    )
    # In the frame of a lift that speeds up, a ball bounces as under gravity and the lift's acceleration together.
    times_s = np.arange(73) * SAMPLE_INTERVAL_S
    above = course["lift"][:, 2] - GROUND_M[2] - RADIUS_M - 0.5 * 4.0 * times_s**2
    assert above == pytest.approx(
        bouncing_height(times_s, 0.1, 0.7, gravity=G + 4.0), abs=1e-9
    )


# --- contract --------------------------------------------------------------------------------------------------------


def measure_refusals():
    engine = backend("point")
    refused = {}
    for settings in ({"substeps": 3}, {"timestep_s": 0.0}, {"timestep_s": 0.004}):
        with pytest.raises(ParameterError) as caught:
            engine.build(ball_on_plane(), settings)
        refused[str(settings)] = str(caught.value)
    plate = driven_box("plate", (1.0, 0.0, 0.0), (0.1, 0.1, 0.1))
    bodies = (*ball_on_plane().bodies, plate)
    scenes = {
        "turned": driven_plane("rotate"),
        "sunk": ball_on_plane(drop_m=-0.002),
        "beside": dataclasses.replace(ball_on_plane(), bodies=bodies),
    }
    for name, scene in scenes.items():
        refused[name] = " ".join(engine.supports(scene).missing)
    return refused


@pytest.mark.parametrize(
    ("case", "words"),
    [
        ("{'substeps': 3}", "'substeps'.*unknown setting"),
        ("{'timestep_s': 0.0}", "'timestep_s'"),
        ("{'timestep_s': 0.004}", "not a whole number"),
        ("turned", "'ball' and 'ground' may touch, and planes .* shifted, not turned$"),
        ("sunk", "'ball' and 'ground' overlap by 2 mm at the start$"),
        ("beside", "^$"),
    ],
)
def test_refusals_name_the_cause(measured, case, words):
    assert re.search(words, measured["refusals"][case])


QUICK = (
    "start-*",
    "rest-*",
    "rebound-0.5",
    "rebound-of-pair",
    "rebound-sustained",
    "oblique-*",
    "roll-*",
    "restore",
    "free-fall*",
    "driven-turned-path",
    "contact-*",
    "wrench-*",
)


def measure_conformance():
    return {one.check: one.status.value for one in run_checks("point", only=QUICK)}


def test_conformance_kit_finds_nothing(measured):
    assert set(measured["conformance"].values()) == {"pass", "declined"}


@pytest.mark.slow
@pytest.mark.parametrize("name", ["point", "marbles"])
def test_the_whole_conformance_kit_finds_nothing(name, environment, tmp_path):
    run = gauge(environment, ["backend", "check", name, "--json"], tmp_path)
    assert run.returncode == 0, run.stdout + run.stderr
    found = {json.loads(line)["status"] for line in run.stdout.splitlines()}
    assert found == {"pass", "declined"}


# --- worlds in arrays ------------------------------------------------------------------------------------------------

CONTACTS = ("rebound-0.5", "rebound-of-pair", "oblique-*", "rest-sphere", "free-fall")


def measure_marbles():
    """Results of checks, and the largest distance of worlds that start and rebound differently from each one alone."""
    engine = backend("marbles")
    results = {
        one.check: one.status.value for one in run_checks("marbles", only=CONTACTS)
    }
    scenes = [
        ball_on_plane(
            tilt_deg=20, drop_m=0.05 * drop, friction=0.1 * drop, restitution=0.2 * drop
        )
        for drop in range(4)
    ]
    worlds = engine.build_worlds(scenes)
    alone = [engine.build(scene) for scene in scenes]
    apart = 0.0
    for _ in range(60):
        for one in (worlds, *alone):
            one.advance(SAMPLE_INTERVAL_S)
        single = np.array([one.body_states(["ball"]) for one in alone])
        apart = max(apart, float(np.abs(worlds.body_states(["ball"]) - single).max()))
    return {"results": results, "apart": apart}


def test_the_engine_in_arrays_obeys_the_laws_and_its_worlds_do_not_touch(measured):
    assert set(measured["marbles"]["results"].values()) == {"pass", "declined"}
    assert list(measured["marbles"]["results"].values()).count("pass") > 6
    assert measured["marbles"]["apart"] == 0.0


# --- guide -----------------------------------------------------------------------------------------------------------


def unquoted():
    """Python blocks of the guide that are not quoted from the example."""
    sources = [
        (PACKAGE / name).read_text() for name in ("point_engine.py", "marbles.py")
    ]
    return [
        block
        for block in fenced(GUIDE, "python")
        if not any(block in source for source in sources)
    ]


def measure_guide():
    """Return the error of the guide's own blocks, or nothing."""
    try:
        exec("\n".join(unquoted()), {})
    except Exception:
        return traceback.format_exc()
    return ""


def test_python_blocks_of_the_guide_run_or_are_quoted_from_the_example(measured):
    count = len(unquoted())
    assert count
    assert len(fenced(GUIDE, "python")) - count > 2
    assert measured["guide"] == ""


def test_toml_of_the_guide_is_that_of_the_example():
    manifest = (PACKAGE / "pyproject.toml").read_text()
    assert fenced(GUIDE, "toml")
    assert all(block in manifest for block in fenced(GUIDE, "toml"))


@pytest.mark.slow
def test_gauge_commands_of_the_guide_run(environment, tmp_path):
    commands = [
        shlex.split(line)
        for block in fenced(GUIDE, "sh")
        for line in block.splitlines()
        if line.startswith("gauge ")
    ]
    # The steps of the guide call the reader's engine `mine`.
    steps = re.findall(r"^\d\. `(gauge [^`]*)`", GUIDE.read_text(), flags=re.MULTILINE)
    commands += [shlex.split(step.replace("mine", "point")) for step in steps]
    assert {command[1] for command in commands} == {"list", "backend", "run"}
    for command in commands:
        run = gauge(environment, command[1:], tmp_path)
        assert run.returncode == 0, f"{shlex.join(command)}: {run.stdout}{run.stderr}"
