"""Bounces of a spinning ball: the record against its facts, the closed form against an impact that is integrated."""

from dataclasses import replace

import gymnasium
import numpy as np
import pytest

from gauge_envs import load_experiment
from gauge_envs.experiments.resolve import with_trial
from gauge_envs.files import data_folder
from gauge_envs.references.single_shot import single_shots
from gauge_envs.scene import Pose
from gauge_envs.scoring.exact import exact_motion, ideal_rebounds
from gauge_envs.scoring.reference import reference_band
from gauge_envs.scoring.trajectory import score_trajectory

SETTINGS = {
    "nospin": "no_spin",
    "topspin": "topspin",
    "backspin": "backspin",
    "robot": "robot",
}
GRAVITY, RADIUS_M, BOUNCE_S = 9.80665, 0.02, 0.05
TIMES_S = np.arange(8) / 30.0


def name_of(setting):
    return f"ObliqueBounce-{setting}"


def trials():
    return [
        (setting, trial)
        for setting in SETTINGS
        for trial in single_shots(name_of(setting)).trials()
    ]


def state_at_bounce(shot):
    """Return the recorded velocity before and after the bounce [m/s] by the parabola of the frames."""
    before = shot.start[7:10] - [0.0, 0.0, GRAVITY * BOUNCE_S]
    fall_m = 0.5 * GRAVITY * (TIMES_S - BOUNCE_S) ** 2
    place_m = shot.positions_m + np.outer(fall_m, [0.0, 0.0, 1.0])
    after = np.polyfit(TIMES_S[2:] - BOUNCE_S, place_m[2:], 1)[0]
    return before, after


def test_a_trial_starts_on_the_parabola_that_meets_the_table_at_the_bounce():
    assert len(trials()) == 57
    for setting, trial in trials():
        shot = single_shots(name_of(setting)).shot(trial)
        place_m = shot.positions_m[0] + BOUNCE_S * shot.start[7:10]
        place_m[2] -= 0.5 * GRAVITY * BOUNCE_S**2
        assert place_m == pytest.approx([0.0, 0.0, RADIUS_M], abs=2e-5)


def free_parabolas(times_s, positions_m):
    """Return the velocity before and after the bounce of the raw samples; air bends both parabolas."""
    lowest = int(positions_m[:, 2].argmin())
    since_s = times_s - times_s[lowest]
    chosen = [
        (since_s < -2e-3) & (since_s > -0.15),
        (since_s > 2e-3) & (since_s < 0.15),
    ]
    fits = [
        [
            np.polynomial.Polynomial.fit(since_s[rows], values, 2)
            for values in positions_m[rows].T
        ]
        for rows in chosen
    ]
    roots = (fits[0][2].convert() - fits[1][2].convert()).roots().real
    bounce_s = roots[np.abs(roots).argmin()]
    return [np.array([line.deriv()(bounce_s) for line in lines]) for lines in fits]


@pytest.mark.parametrize("setting", ["nospin", "robot"])
def test_the_recorded_states_are_those_of_the_raw_flights(setting):
    facts = np.load(data_folder("scoring") / "facts" / "table_tennis.npz")
    shots = single_shots(name_of(setting))
    differences = []
    for trial in shots.trials():
        shot = shots.shot(trial)
        is_flight = (facts["setting"] == SETTINGS[setting]) & (
            facts["number"] == shots.arrays["source_number"][trial]
        )
        rows = slice(*facts["first"][int(is_flight.argmax()) :][:2])
        raw = free_parabolas(1e-5 * facts["time"][rows], 1e-4 * facts["position"][rows])
        differences.append(np.subtract(raw, state_at_bounce(shot)))
    # A free parabola over 0.15 s has a noise of 0.05 m/s, and air adds as much.
    assert np.abs(np.mean(differences, axis=0)).max() < 0.06


def stepped_impact(velocity, spin, friction, restitution, inertia_ratio):
    """Integrate an impact over its normal impulse, as Routh did: friction opposes the slip of each moment."""
    velocity, spin = np.array(velocity), np.array(spin)
    steps = 400
    push = -(1.0 + restitution) * velocity[2] / steps
    for _ in range(steps):
        slip = (velocity + np.cross(spin, [0.0, 0.0, -RADIUS_M]))[:2]
        size = np.linalg.norm(slip)
        drag = min(friction * push, size / (1.0 + 1.0 / inertia_ratio))
        impulse = np.array([*(-drag * slip / max(size, 1e-12)), push])
        velocity = velocity + impulse
        arm = np.array([0.0, 0.0, -RADIUS_M])
        spin = spin + np.cross(arm, impulse) / (inertia_ratio * RADIUS_M**2)
    return velocity, spin


@pytest.mark.parametrize("inertia_ratio", [2.0 / 3.0, 0.4])
@pytest.mark.parametrize("seed", range(12))
def test_the_closed_form_is_two_integrated_impacts(seed, inertia_ratio):
    random = np.random.default_rng(seed)
    friction, restitution = random.uniform(0.02, 0.6), random.uniform(0.5, 1.0)
    velocity = random.uniform([-4, -4, -3], [4, 4, -1])
    spin = random.uniform(-300.0, 300.0, 3)
    constants = {"ball.friction": friction, "ball.restitution": restitution}
    scene = load_experiment("ObliqueBounce-nospin", constants).scene
    is_uniform = inertia_ratio == 0.4
    ball = replace(
        scene.body("ball"),
        pose=Pose(position_m=(0.1, 0.2, 0.1)),
        linear_velocity_m_per_s=tuple(velocity),
        angular_velocity_rad_per_s=tuple(spin),
        inertia_kg_m2=None if is_uniform else 0.0027 * inertia_ratio * RADIUS_M**2,
    )
    speed = np.sqrt(velocity[2] ** 2 + 2.0 * GRAVITY * 0.08)
    bounce_s = (velocity[2] + speed) / GRAVITY
    for _ in range(2):
        velocity[2] = -speed
        velocity, spin = stepped_impact(
            velocity, spin, friction, restitution, inertia_ratio
        )
        speed = velocity[2]
        since_s = speed / GRAVITY
        times_s = np.array([bounce_s, bounce_s + since_s])
        places_m = ideal_rebounds(scene, ball)(times_s)
        shift_m = since_s * velocity - [0.0, 0.0, 0.5 * GRAVITY * since_s**2]
        assert np.diff(places_m, axis=0)[0] == pytest.approx(shift_m, abs=1e-6)
        bounce_s += 2.0 * since_s


@pytest.mark.parametrize("setting", ["nospin", "topspin", "backspin"])
def test_the_closed_form_with_measured_constants_is_like_the_held_out_trials(setting):
    answers = []
    for trial in single_shots(name_of(setting)).trials("judge"):
        experiment = with_trial(load_experiment(name_of(setting), "measured"), trial)
        values = exact_motion(experiment, TIMES_S)
        score = score_trajectory(
            experiment, reference_band(experiment), times_s=TIMES_S, values=values
        )
        answers.append(score.like_reality == "yes")
        assert score.solves == "yes"
    assert np.mean(answers) >= 0.5


def played(name):
    env = gymnasium.make(f"GAUGE/{name}", parameters="measured")
    env.reset(seed=0, options={"trial": 1})
    info = {}
    while "score" not in info:
        *_, info = env.step(np.zeros(env.action_space.shape, np.float32))
    return info["score"]


def test_an_engine_solves_a_gripping_bounce_and_not_one_that_slides_fast():
    # MuJoCo's convex contact lifts a body that slides in an impact: the slip of backspin is 11 m/s.
    grips, slides = played("ObliqueBounce-nospin"), played("ObliqueBounce-backspin")
    assert (grips.solves, slides.solves) == ("yes", "no")
    assert slides.distance > 10.0 * grips.distance
