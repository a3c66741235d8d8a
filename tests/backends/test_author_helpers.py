"""What the package provides to authors of backends: looped worlds, constants of bodies, driven motion."""

import sys
from contextlib import closing
from dataclasses import replace
from threading import get_ident
from typing import ClassVar

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gauge_envs import load_experiment
from gauge_envs.backends import LoopedSimulation, Simulation, backend
from gauge_envs.backends.shared.pair_values import Combination, body_values, pair_values
from gauge_envs.backends.shared.rigid import (
    TetherSpring,
    later_targets,
    motion_steps,
)
from gauge_envs.errors import BackendError, ParameterError, UnsupportedSceneError
from gauge_envs.scene import ConvexUnion, Pose, Scene, Tether
from gauge_envs.scene.meshes import body_mass_properties
from gauge_envs.tools.bench.parts import body, contact

# --- worlds in a loop ---


class Counter(Simulation):
    """One world, whose body has counted the seconds since its start, on x."""

    settings: ClassVar = {}

    def __init__(self, *, reason=""):
        self.reason = reason
        self.closed = 0
        self.thread = None
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
        self.closed += 1


def test_looped_simulations_are_the_worlds_of_one():
    worlds = [Counter(), Counter(reason="gave up"), Counter()]
    looped = LoopedSimulation(worlds)
    assert looped.world_count == 3
    starts = np.arange(39.0).reshape(3, 1, 13)
    looped.reset(starts, 5)
    looped.advance(0.5)
    states = looped.body_states(["body"])
    expected = starts.copy()
    expected[..., 0] += 0.5
    np.testing.assert_array_equal(states, expected)
    np.testing.assert_array_equal(looped.nodes("cloth"), expected[..., :3])
    assert [one.seed for one in worlds] == [5, 5, 5]
    assert looped.diverged() == {1: "gave up"}
    looped.drive("body", np.arange(57.0).reshape(3, 19))
    looped.apply_wrench("body", np.full((3, 6), [[1.0], [2.0], [3.0]]))
    pushed = np.arange(57.0).reshape(3, 19)[:, 7:10] + [[1.0], [2.0], [3.0]]
    read = looped.contact_forces([("body", "ground")])
    np.testing.assert_array_equal(read()[:, 0], pushed)
    assert looped.track("cloth", np.zeros((1, 3))) is None
    looped.close()
    looped.close()
    assert [one.closed for one in worlds] == [2, 2, 2]


def test_worlds_that_free_python_advance_in_threads(monkeypatch):
    monkeypatch.setattr(Counter, "releases_gil", True)
    monkeypatch.setattr("gauge_envs.backends.simulation.processors", lambda: 2)
    worlds = [Counter(), Counter()]
    with closing(LoopedSimulation(worlds)) as looped:
        looped.advance(0.5)
        assert looped.body_states(["body"])[:, 0, 0].tolist() == [0.5, 0.5]
        assert get_ident() not in {one.thread for one in worlds}
        worlds[1].advance = failing
        with pytest.raises(ZeroDivisionError):
            looped.advance(0.5)


def failing(seconds):
    raise ZeroDivisionError


# --- engines of the contract of 0.3 ---

OLD = """
from gauge_envs.backends import Backend, Simulation, Support

class Old(Simulation):
    def reset(self, seed): ...
    def advance(self, seconds): ...
    def body_states(self, names): ...
    def close(self): ...
"""


@pytest.mark.parametrize(
    ("source", "words"),
    [
        (OLD, r"Old\.reset has no parameter 'starts'.*reset\(starts, seed\)"),
        (
            OLD.replace("(self, seed)", "(self, starts=None, seed=0)")
            + "    def drive(self, body, pose, velocity, acceleration): ...",
            r"Old\.drive has no parameter 'targets'.*drive\(body, targets\)",
        ),
        *(
            (
                f"from gauge_envs.backends import {name}",
                rf"backends\.{name} belongs to the engine contract of gauge-envs 0\.3",
            )
            for name in ("World", "ArrayWorlds", "ReplayedSimulation", "DeviceWorlds")
        ),
    ],
)
def test_an_engine_of_0_3_is_told_what_to_change(monkeypatch, tmp_path, source, words):
    (tmp_path / "old_engine.py").write_text(source)
    info = tmp_path / "old_engine-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Name: old-engine\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(
        "[gauge_envs.backends]\nold = old_engine:BackendOld\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "old_engine", raising=False)
    with pytest.raises(BackendError, match=words) as caught:
        backend("old")
    assert "CHANGELOG.md lists the changes" in str(caught.value)


def test_optional_methods_that_an_engine_lacks_say_so():
    class Least(Simulation):
        def reset(self, starts=None, seed=0): ...

        def advance(self, seconds): ...

        def body_states(self, names): ...

        def close(self): ...

    least = Least()
    with pytest.raises(BackendError, match="Least drives no body: implement drive"):
        least.drive("plate", np.zeros((1, 19)))
    with pytest.raises(BackendError, match="'plate': implement apply_wrench"):
        least.apply_wrench("plate", np.zeros((1, 6)))
    assert least.contact_forces([("a", "b")]) is None
    assert least.track("rope", np.zeros((1, 3))) is None
    assert least.diverged() == {}


# --- constants of bodies ---

TRIANGLE = {("a", "b"): 0.2, ("b", "c"): 0.3, ("a", "c"): 0.6}


def combined(values, pair, rule):
    one, other = values[pair[0]], values[pair[1]]
    return {
        Combination.PRODUCT: one * other,
        Combination.MAX: max(one, other),
        Combination.MIN: min(one, other),
        Combination.MEAN: 0.5 * (one + other),
        Combination.GEOMETRIC: float(np.sqrt(one * other)),
    }[rule]


@pytest.mark.parametrize(
    ("rule", "pairs"),
    [
        (Combination.PRODUCT, TRIANGLE),
        (Combination.GEOMETRIC, TRIANGLE),
        (Combination.MEAN, {("a", "b"): 0.2, ("b", "c"): 0.3, ("a", "c"): 0.3}),
        (Combination.MEAN, {("a", "b"): 0.5, ("b", "c"): 0.1}),
        (Combination.MAX, {("a", "b"): 0.2, ("b", "c"): 0.6, ("a", "c"): 0.6}),
        (Combination.MIN, {("a", "b"): 0.2, ("b", "c"): 0.2, ("a", "c"): 0.6}),
        (Combination.PRODUCT, {("a", "b"): 0.0, ("b", "c"): 0.3}),
        (Combination.PRODUCT, {}),
    ],
)
def test_values_of_bodies_give_those_of_pairs(rule, pairs):
    values = body_values(pairs, rule)
    assert all(value >= 0.0 for value in values.values())
    for pair, value in pairs.items():
        assert combined(values, pair, rule) == pytest.approx(value, abs=1e-9)


@pytest.mark.parametrize(
    ("rule", "pairs", "named"),
    [
        ("product", {("a", "b"): 0.0, ("b", "c"): 0.3, ("a", "c"): 0.3}, "'a' and 'b'"),
        ("max", {("a", "b"): 0.9, ("b", "c"): 0.3, ("a", "c"): 0.3}, "'a' and 'b'"),
        ("min", TRIANGLE, "'a' and 'b'"),
        ("mean", {("a", "b"): 0.9, ("b", "c"): 0.1, ("a", "c"): 0.1}, "pair '"),
        (
            "geometric",
            {("a", "b"): 0.2, ("b", "c"): 0.3, ("c", "d"): 0.4, ("d", "a"): 0.5},
            "pair '",
        ),
    ],
)
def test_no_solution_names_a_pair(rule, pairs, named):
    with pytest.raises(UnsupportedSceneError, match=named):
        body_values(pairs, rule)


def test_pairs_of_a_scene():
    scene = load_experiment("SlopeSlider-2-wood").scene
    pairs = pair_values(scene, "friction")
    assert pairs["cube", "board"] == scene.contacts[0].friction
    assert set(body_values(pairs, "product")) == {"cube", "board", "ground"}


# --- pairs in two contacts ---


def test_a_pair_in_two_contacts_is_an_error():
    scene = load_experiment("SlopeSlider-2-wood").scene
    again = contact("board", "cube", friction=0.9)
    with pytest.raises(
        ParameterError, match="two contacts list the pair 'board' and 'cube'"
    ):
        replace(scene, contacts=(*scene.contacts, again))


def test_a_group_with_itself_lists_a_pair_once():
    scene = load_experiment("NewtonsCradle-metal").scene
    names = tuple(one.name for one in scene.dynamic_bodies)
    inner = contact(names, names, friction=0.1, restitution=0.5)
    assert len(list(replace(scene, contacts=(inner,)).colliding_pairs(inner))) == 10


# --- driven motion ---


def test_mean_velocities_follow_the_motion_exactly():
    start = Pose.from_euler_deg((0.1, 0.2, 0.3), (20.0, -30.0, 40.0))
    rates = np.array([0.3, -0.1, 0.2, 1.0, 2.0, -1.5])
    acceleration = np.array([2.0, 1.0, -3.0, 40.0, -10.0, 20.0])
    target = np.hstack([start.position_m, start.quaternion, rates, acceleration])
    step_s = 1 / 720
    poses, velocities = motion_steps(target, step_s, 4)
    position, rotation = np.asarray(start.position_m), start.rotation
    for pose, velocity in zip(poses, velocities, strict=True):
        assert pose[:3] == pytest.approx(position, abs=1e-15)
        turned = Rotation.from_quat(pose[3:], scalar_first=True) * rotation.inv()
        assert turned.magnitude() < 1e-14
        position = position + velocity[:3] * step_s
        rotation = Rotation.from_rotvec(velocity[3:] * step_s) * rotation
    (later,) = later_targets(target[None], 1 / 180)
    end = Pose.of_state(later)
    assert position == pytest.approx(end.position_m, abs=1e-15)
    assert (rotation * end.rotation.inv()).magnitude() < 1e-14
    assert later[7:13] == pytest.approx(rates + acceleration / 180)


# --- strings as springs ---

LENGTH_M, WIDTH_M = 0.12, 0.002


def hung_at(face):
    """A thin bar of 0.1 kg along x, on a string of 0.3 m at its middle (0), or at the middle of its low face (1)."""
    low, high = -0.5 * LENGTH_M + 0.5 * face * LENGTH_M, 0.5 * (1 + face) * LENGTH_M
    half = 0.5 * WIDTH_M
    corners = tuple(
        (x, y, z) for x in (low, high) for y in (-half, half) for z in (-half, half)
    )
    bar = body(
        "bar", ConvexUnion(pieces_m=(corners,)), Pose(position_m=(0.0, 0.0, 1.2))
    )
    string = Tether(body="bar", anchor_m=(0.0, 0.0, 1.5), length_m=0.3)
    return Scene(bodies=(bar,), joints=(string,), duration_s=0.4)


@pytest.mark.parametrize(("face", "share"), [(0, 1.0), (1, 0.25)])
def test_the_end_of_a_bar_moves_like_a_quarter_of_its_mass(face, share):
    """A rod that is pulled across at its end: 1 / m + (L / 2)^2 / (m L^2 / 12) = 4 / m; along itself it is m."""
    (spring,) = TetherSpring.of(hung_at(face))
    turned = Rotation.from_euler("xyz", [20.0, 50.0, -70.0], degrees=True)
    across, along = turned.apply([[0.0, 0.6, 0.8], [1.0, 0.0, 0.0]])
    assert spring.end_mass_kg(turned, across) == pytest.approx(0.1 * share, rel=1e-3)
    assert spring.end_mass_kg(turned, along) == pytest.approx(0.1)


@pytest.mark.parametrize("face", [0, 1])
def test_a_string_as_a_spring_keeps_its_length_beside_the_centre_of_mass(face):
    """The bar falls from level; its motion under the force is integrated here, with steps of 1 ms."""
    scene = hung_at(face)
    (spring,) = TetherSpring.of(scene)
    centre_m, inertia = body_mass_properties(scene.body("bar"))
    step_s, rate = 1e-3, 0.5
    turn, spin = Rotation.identity(), np.zeros(3)
    place, velocity = np.array([0.0, 0.0, 1.2]) + centre_m, np.zeros(3)
    lengths = []
    for _ in range(400):
        arm = turn.apply(-centre_m)
        state = np.concatenate(
            [
                place + arm,
                turn.as_quat(scalar_first=True),
                velocity + np.cross(spin, arm),
                spin,
            ]
        )
        force = spring.pull_n(state, rate / step_s)
        force = np.zeros(3) if force is None else force
        axes = turn.as_matrix()
        in_world = axes @ inertia @ axes.T
        torque = np.cross(arm, force) - np.cross(spin, in_world @ spin)
        velocity = velocity + step_s * (force / 0.1 + [0.0, 0.0, -9.80665])
        spin = spin + step_s * np.linalg.solve(in_world, torque)
        place = place + step_s * velocity
        turn = Rotation.from_rotvec(step_s * spin) * turn
        lengths.append(np.linalg.norm(place + turn.apply(-centre_m) - [0.0, 0.0, 1.5]))
    assert lengths == pytest.approx([0.3] * 400, rel=0.01)
