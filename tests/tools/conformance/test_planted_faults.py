"""Each planted fault fails a check whose diagnosis names it."""

import numpy as np
import pytest
from faults import FAULTS, Fault, Faulty, Passed

from gauge_envs.backends import backend
from gauge_envs.scene import Scene
from gauge_envs.tools.bench.parts import ball
from gauge_envs.tools.bench.recording import Recording
from gauge_envs.tools.conformance import Status, run_checks, solver
from gauge_envs.tools.conformance.differences import cause_of
from gauge_envs.tools.conformance.facts import facts

MUJOCO = backend("mujoco")


@pytest.mark.parametrize("name", FAULTS)
def test_a_check_names_the_fault(name):
    planted = FAULTS[name]
    (result,) = run_checks(Faulty(MUJOCO, planted), only=[planted.caught_by])
    assert result.status is Status.FAIL
    assert planted.says in result.diagnosis


@pytest.mark.parametrize(
    ("off_m", "is_late"), [(0.0, True), (1e-6, True), (0.004, False)]
)
def test_a_reading_is_late_where_rounding_alone_is_left(off_m, is_late):
    """A ball passes 1 m in an interval; what is late by all but 4 mm of it starts elsewhere."""
    law = np.zeros((42, 3, 13))
    law[:, 0, 0] = np.arange(42)
    read = np.concatenate([law[:1], law[:-1]])
    read[:, 0, 0] += off_m
    cause = cause_of(read, law, {}, np.zeros_like(law))
    assert ("the reading is late" in cause) == is_late
    assert "advance()" not in cause


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ((0.001, 0.0, 0.0, 0.0), "position of the ball at the start is off by (1,"),
        ((0.0, 0.0, 0.0, 0.01), "orientation of the ball at the start is off by 1.15"),
        ((0.0004, 0.0, 0.0, 0.004), ""),
    ],
)
def test_a_start_elsewhere_is_a_fact_from_half_a_millimetre_and_degree_on(change, says):
    one = ball("ball", (0.1, 0.2, 0.3))
    states = np.zeros((3, 13))
    # A turn about x by twice the last value [rad].
    states[:, :5] = [*np.add(one.pose.position_m, change[:3]), 1.0, change[3]]
    scene = Scene(bodies=(one,), duration_s=0.1, gravity_m_per_s2=0.0)
    found = facts(
        Recording(scene=scene, times_s=np.arange(3.0), states={"ball": states})
    )
    assert bool(found) == bool(says)
    assert says in found


def test_iterations_that_end_before_the_solution_are_named():
    given, ended = (
        next(iter(run_checks("mujoco", only=["solver-heap"], settings=settings)))
        for settings in (None, {"iterations": 2})
    )
    assert given.status is Status.PASS
    assert given.measured < 1e-6
    assert ended.status is Status.FAIL
    assert "2 and 20 iterations part by" in ended.diagnosis


def test_a_batch_whose_worlds_take_one_start_is_named(monkeypatch):
    """MuJoCo builds worlds together: planted, all start as the first."""
    together = solver._together
    monkeypatch.setattr(
        solver,
        "_together",
        lambda lab, starts: together(lab, np.repeat(starts[:1], len(starts), axis=0)),
    )
    (found,) = run_checks("mujoco", only=["solver-heap"])
    assert found.measured > 0.9
    assert "one world and 6 part by" in found.diagnosis


class OtherSign(Passed):
    """Reports each quaternion with the other sign at every second reading, which is the same rotation."""

    count = 0

    def body_states(self, names):
        states = super().body_states(names)
        self.count += 1
        states[..., 3:7] *= (-1.0) ** self.count
        return states


def test_the_sign_of_a_quaternion_is_no_fault():
    healthy = Faulty(MUJOCO, Fault(simulation=OtherSign))
    rigid = [
        "order-of-names",
        "start-*",
        "reset-*",
        "determinism",
        "starts-*",
        "worlds-single",
        "two-at-once",
    ]
    assert {one.status for one in run_checks(healthy, only=rigid)} == {Status.PASS}


def test_not_finite_states_are_reported_once_and_first():
    results = list(
        run_checks(
            Faulty(MUJOCO, FAULTS["nan-mass"]),
            only=["finite", "free-fall*", "reset-*", "slide*"],
        )
    )
    own = [one.check for one in results if one.is_bad and not one.reported_by]
    assert own == ["finite"]
    assert {one.reported_by for one in results if one.is_bad} == {"", "finite"}
    assert "'brick' is not finite" in results[0].diagnosis
