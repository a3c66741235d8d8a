"""Answers to both questions: limits and guard bands, and wrong motions whose distance follows from closed forms.

`test_cause` asks both questions of over 100 wrong motions of scenes with real trials.
"""

import csv
import math

import numpy as np
import pytest
from places import ROOT
from swings import swung_rad

from gauge_envs import load_experiment
from gauge_envs.scoring.answers import (
    Answer,
    mattering_distance,
    solves,
    united,
    within,
)
from gauge_envs.scoring.reference import reference_band
from gauge_envs.scoring.trajectory import score_trajectory

GRAVITY = 9.80665
EFFECTIVE_LENGTH_M = 0.269881
"""I / (m l) of the ball and its rod, from the recorded period (tasks/pendulum.toml)."""

ERRORS = ("right", "late", "shifted", "scaled", "gravity")


def test_an_answer_needs_1_96_standard_uncertainties_on_its_side():
    assert within(1.0, 1.0) is Answer.YES and within(1.01, 1.0) is Answer.NO
    assert within(0.8, 1.0, 0.1) is Answer.YES
    assert within(0.81, 1.0, 0.1) is Answer.CANNOT_TELL
    assert within(1.19, 1.0, 0.1) is Answer.CANNOT_TELL
    assert within(1.2, 1.0, 0.1) is Answer.NO


def test_a_difference_matters_from_2_percent_of_the_motion_or_half_a_real_trial_on():
    assert mattering_distance(200.0, "mm") == pytest.approx(4.0)
    assert mattering_distance(200.0, "mm", of_trials=2.0) == pytest.approx(1.0)
    # Nothing below a tenth of a millimetre matters; an area has no such limit.
    assert mattering_distance(0.0, "mm") == pytest.approx(0.1)
    assert mattering_distance(20.0, "mm^2") == pytest.approx(0.4)


def test_one_no_decides_and_one_doubt_remains():
    assert united([Answer.YES, None, Answer.CANNOT_TELL]) is Answer.CANNOT_TELL
    assert united([Answer.YES, Answer.CANNOT_TELL, Answer.NO]) is Answer.NO
    assert united([Answer.YES, None]) is Answer.YES
    assert united([None]) is None and united([]) is None


def test_coverage_counts_the_solutions_that_are_too_uncertain_for_a_yes():
    """Even the exact motion cannot get a yes where 1.96 u is above the smallest distance that matters."""
    with (ROOT / "scoring" / "answers.csv").open(encoding="utf-8") as stream:
        answers = {row["id"]: row["solves"] for row in csv.DictReader(stream)}
    doubtful = [name for name, answer in answers.items() if answer == "cannot tell"]
    bands = [reference_band(load_experiment(name)) for name in doubtful]
    uncertain = sum(solves(band, 0.0) is Answer.CANNOT_TELL for band in bands)
    text = f'MuJoCo gets {len(doubtful)} "cannot tell" of {len(answers)} ids. In {uncertain} of them'
    assert text in (ROOT / "docs" / "coverage.md").read_text()


def fallen_mm(experiment, times_s, gravity):
    """Return the fall of the recorded body from rest [mm]."""
    start_m = np.array(experiment.scene.body(experiment.recorded[0]).pose.position_m)
    drop_m = 0.5 * gravity * times_s**2
    return 1e3 * (start_m - np.outer(drop_m, [0.0, 0.0, 1.0]))


def swung_mm(experiment, times_s, gravity):
    """Return the swing of the ball of the pendulum from rest [mm], whose small swings have an effective length."""
    (hinge,) = experiment.scene.joints
    ball = experiment.scene.body(experiment.recorded[0])
    arm_m = np.subtract(ball.pose.position_m, hinge.anchor_m)
    start_rad = math.atan2(arm_m[0], -arm_m[2])
    rate = gravity / EFFECTIVE_LENGTH_M
    angles = swung_rad(times_s, start_rad, square_rate=rate)
    length_m = math.hypot(arm_m[0], arm_m[2])
    turned_m = length_m * np.column_stack(
        [np.sin(angles), 0.0 * angles, -np.cos(angles)]
    )
    turned_m[:, 1] = arm_m[1]
    return 1e3 * (np.array(hinge.anchor_m) + turned_m)


def carried_mm(experiment, times_s, gravity):
    """Return the circle of a cube that a plate carries [mm]; gravity does not matter."""
    scene = experiment.scene
    (turning,) = scene.drivers[0].motions
    angles = np.array([turning.value(time_s) for time_s in times_s])
    axle_m = np.array(turning.point_m)
    arm_m = np.array(scene.body("cube").pose.position_m) - axle_m
    x = arm_m[0] * np.cos(angles) - arm_m[1] * np.sin(angles)
    y = arm_m[0] * np.sin(angles) + arm_m[1] * np.cos(angles)
    return 1e3 * (axle_m + np.column_stack([x, y, np.full_like(x, arm_m[2])]))


FORMS = {
    "NonsmoothContact-1-wood": fallen_mm,
    "NonsmoothContact-2-plastic": fallen_mm,
    "Pendulum-metal": swung_mm,
    "Turntable-1-metal": carried_mm,
}


class WrongMotion:
    """A closed form with one error."""

    def __init__(self, generator):
        self.name = str(generator.choice([*FORMS]))
        self.error = str(generator.choice(ERRORS))
        self.factor = 1.0 + generator.choice([-1.0, 1.0]) * generator.uniform(0.05, 0.3)
        self.late_s = generator.uniform(0.02, 0.08)
        self.shift_mm = generator.uniform(4.0, 20.0)
        self.experiment = load_experiment(self.name)
        self.times_s = np.arange(self.experiment.frame_count) / 30.0

    def __repr__(self):
        return f"{self.name} {self.error} {self.factor:.2f} {self.late_s:.3f} {self.shift_mm:.1f}"

    def right_mm(self):
        return FORMS[self.name](self.experiment, self.times_s, GRAVITY)

    def wrong_mm(self):
        form, gravity, times_s = FORMS[self.name], GRAVITY, self.times_s
        if self.error == "late":
            times_s = np.maximum(times_s - self.late_s, 1e-9 * np.arange(len(times_s)))
        if self.error == "gravity":
            gravity *= self.factor
        motion = form(self.experiment, times_s, gravity)
        if self.error == "scaled":
            motion = motion[0] + self.factor * (motion - motion[0])
        if self.error == "shifted":
            motion = np.add(motion, [self.shift_mm, 0.0, 0.0])
        return motion

    def expected(self):
        """Return whether the motion solves the scene: within 2 % of the size of the motion while the form holds."""
        known = reference_band(self.experiment).known
        right, wrong = self.right_mm()[known], self.wrong_mm()[known]
        size, distance = (
            np.sqrt(np.square(rows).sum(axis=1).mean())
            for rows in (right - right[0], wrong - right)
        )
        return Answer.YES if distance <= 0.02 * size else Answer.NO


@pytest.mark.parametrize(
    ("seed", "count"),
    [(109, 8), *(pytest.param(s, 20, marks=pytest.mark.slow) for s in (109, 20261130))],
)
def test_wrong_motions_do_not_solve_a_scene_and_right_ones_do(seed, count):
    """The last seed was drawn after the rules were fixed."""
    generator = np.random.default_rng(seed)
    motions = [WrongMotion(generator) for _ in range(count)]
    answers = {}
    for motion in motions:
        score = score_trajectory(
            motion.experiment,
            reference_band(motion.experiment),
            times_s=motion.times_s,
            values=motion.wrong_mm(),
            is_checked=True,
        )
        answers[motion] = (motion.expected(), score.solves)
    wrong = {motion: pair for motion, pair in answers.items() if pair[0] is not pair[1]}
    assert not wrong
    assert {expected for expected, _ in answers.values()} == {Answer.YES, Answer.NO}
