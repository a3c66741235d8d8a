"""Laws of friction of swings against closed forms, and what several files say about the next one."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from servo_laws import BREAKAWAY, C, numbers_of

from gauge_envs.backends import backend
from gauge_envs.runs.rollout import DivergedError
from gauge_envs.scene.servo_friction import TERMS, holding, rule
from gauge_envs.tools.identify import Identified, Log, identify, one_joint, read_log
from gauge_envs.tools.identify.fit import machine_of
from gauge_envs.tools.identify.identified import Law
from gauge_envs.tools.identify.laws import LAWS, _contains, compare_laws
from gauge_envs.tools.identify.mujoco_joints import ModelJoints
from gauge_envs.tools.identify.rig import DYNAMICS
from gauge_envs.tools.identify.spread import pattern, sensor_noise_rad, spread_of
from gauge_envs.tools.identify.stages import QUADRATIC, Fitter
from gauge_envs.tools.identify.words import identified_document

DRY, VISCOUS, ARMATURE = DYNAMICS[:3]
MASS_KG, LENGTH_M, INERTIA_KG_M2, G = 0.15, 0.15, 1e-4, 9.80665
ABOUT_JOINT = INERTIA_KG_M2 + MASS_KG * LENGTH_M**2
WEIGHT_N_M = MASS_KG * G * LENGTH_M
NOISE_RAD = 2e-4


def tops_rad(angles_rad):
    """Amplitudes of the half swings: parabolas through the extremes."""
    middle = np.abs(angles_rad)
    at = np.flatnonzero((middle[1:-1] > middle[:-2]) & (middle[1:-1] >= middle[2:])) + 1
    before, top, after = middle[at - 1], middle[at], middle[at + 1]
    return top - (after - before) ** 2 / (8.0 * (after - 2.0 * top + before))


def released(terms):
    """Angles of a pendulum in plain MuJoCo, from 0.2 rad at rest, at 1 kHz for 4 s [rad]."""
    times_s = np.arange(0.0, 4.0, 0.001)
    log = Log("", times_s, np.full((times_s.size, 1), 0.2))
    scene = one_joint(MASS_KG, LENGTH_M, INERTIA_KG_M2)
    machine = machine_of(backend("mujoco"), scene, log, list(terms), {})
    start = np.array([0.2]), np.zeros(1)
    return machine.angles(log, [terms], start)[:, 0]


def test_dry_friction_takes_the_same_from_each_half_swing():
    """Of small swings the amplitude falls by 2 dry / weight in each half."""
    dry = 4e-4
    falls = -np.diff(tops_rad(released({DRY: dry})))
    # The sine lessens the weight by A^2 / 8 at 0.2 rad.
    assert falls == pytest.approx(2.0 * dry / WEIGHT_N_M, rel=0.02)


def test_quadratic_friction_adds_the_same_to_each_inverse_amplitude():
    """A half swing of I a'' = -w a - c a' |a'| loses the work 8/3 c w / I A^3 / 2: 1/A grows by 4 c / (3 I)."""
    drag = 1e-4
    grows = np.diff(1.0 / tops_rad(released({QUADRATIC: drag})))
    assert grows == pytest.approx(4.0 * drag / (3.0 * ABOUT_JOINT), rel=0.02)


def test_no_dry_friction_a_tenth_away_follows_a_measured_swing_better():
    """Errors jump where friction stops a swing half a period later; fits of small differences alone end there."""
    log = read_log(Path("examples/joint_swing.csv")).moving()
    half = list(log.pieces(0.5 * log.duration_s + 1e-9))[1]
    names = [DRY, ARMATURE]
    scene = one_joint(0.147585, 0.147755, 1.09119e-4)
    machine = machine_of(backend("mujoco"), scene, half, names, {})
    first = Fitter(machine=machine, known={}).fit(
        [log], LAWS["dry, viscous and quadratic"], tolerance=1e-2
    )
    best = Fitter(machine=machine, known={}).fit([half], names, first=first)
    friction = best.problem.unknowns(best.unknowns)[0][0][DRY]
    for factor in (0.9, 1.1):
        fitter = Fitter(machine=machine, known={DRY: factor * friction})
        assert fitter.fit([half], names, first=best).misfit > best.misfit


@pytest.mark.parametrize("name", ["load_friction", "external_load_friction"])
def test_friction_by_load_takes_a_share_of_the_energy_of_each_half_swing(name):
    """The weight works against l of itself: 1 - cos of the amplitude falls by the factor (1 - l) / (1 + l)."""
    share = 0.1
    energies = 1.0 - np.cos(tops_rad(released({name: share})))
    ratios = energies[1:6] / energies[:5]
    assert ratios == pytest.approx((1.0 - share) / (1.0 + share), rel=0.01)


def breakaway_n_m(numbers, upwards):
    """Torque at which a motor moves a level arm up, or lets it down, from balance at 5 % of the weight a second."""
    times_s = np.arange(0.0, 10.0, 0.01)
    side = 1.0 if upwards else -1.0
    torque = WEIGHT_N_M * (1.0 + side * 0.05 * times_s)[:, None]
    level = np.full((times_s.size, 1), 0.5 * np.pi)
    log = Log("", times_s, level, torque_n_m=torque)
    scene = one_joint(MASS_KG, LENGTH_M, INERTIA_KG_M2)
    machine = machine_of(backend("mujoco"), scene, log, list(numbers), {})
    angles = machine.angles(log, [numbers], (level[0], np.zeros(1)))[:, 0]
    # From here on a degree follows in 0.1 s.
    return torque[np.argmax(side * (angles - level[0, 0]) > 0.002), 0]


@pytest.mark.parametrize("law", ["M4", "M6"])
def test_a_loaded_joint_breaks_away_at_the_torque_of_its_law(law):
    up, down = BREAKAWAY[law]
    numbers = {DRY: C * WEIGHT_N_M} | numbers_of(law, WEIGHT_N_M)
    assert breakaway_n_m(numbers, True) == pytest.approx(up * WEIGHT_N_M, rel=0.01)
    assert breakaway_n_m(numbers, False) == pytest.approx(down * WEIGHT_N_M, rel=0.01)


def test_the_printed_law_holds_what_is_simulated():
    """The text of `rule`, with five digits, beside the function, at rates and loads of all signs."""
    random = np.random.default_rng(0)
    for law, names in list(TERMS.items())[1:]:
        numbers = dict(zip(names, random.uniform(0.05, 0.9, len(names)), strict=True))
        text, held = rule(numbers, 0.3), holding(numbers, 0.3)
        assert held is not None
        for rate, m, e in random.uniform(-1.0, 1.0, (20, 3)):
            place = {"rate": rate, "m": m, "e": e, "exp": np.exp}
            assert held(rate, m, e) == pytest.approx(eval(text, place), rel=1e-3), law


def test_what_several_laws_predict_alike_is_said():
    laws = [
        Law(name=name, fitted_rad=1.0, held_out_rad=1.0, is_as_good=alike)
        for name, alike in (("M4", True), ("M1", False), ("M5", True))
    ]
    found = Identified(engine="", settings=(), joints=(), error_rad={}, laws=tuple(laws))  # fmt: skip
    said = identified_document(found).parts[0].notes
    assert any(line.startswith("M4; M5 are not told apart by these logs") for line in said)  # fmt: skip
    alone = replace(found, laws=tuple(laws[:2]))
    said = identified_document(alone).parts[0].notes
    assert any(
        line.startswith("M4 is used: no other law fits and predicts as well")
        for line in said
    )


def test_a_law_starts_from_the_fit_of_one_that_it_contains():
    """M4 is M5 with equal shares of motor and load, so that M5 starts with the error of M4, and ends below it."""
    log = Log("", 0.01 * np.arange(100), np.linspace(0.3, -0.2, 100)[:, None])
    scene = one_joint(MASS_KG, LENGTH_M, INERTIA_KG_M2)
    names = [DRY, VISCOUS, *TERMS["M4"]]
    machine = machine_of(backend("mujoco"), scene, log, names, {})
    fitter = Fitter(machine=machine, known={})
    first = fitter.fit([log], names, most_steps=1)
    later = fitter.fit([log], [DRY, VISCOUS, *TERMS["M5"]], first=first, most_steps=1)
    assert _contains(later.problem.names, first.problem.names)
    assert not _contains(first.problem.names, later.problem.names)
    assert later.misfit <= 1.001 * first.misfit


@pytest.mark.parametrize(
    ("fitted", "missed", "chosen"),
    [
        # One predicts best by chance, and leaves thrice the rest of the files that it is fitted to.
        ((0.5, 0.5, 1.4), ((23.7, 25.5), (23.5, 25.5), (28.0, 9.8)), "dry and quadratic"),
        # All terms fit best, and predict worse by a factor that is no chance.
        ((0.5, 0.6, 0.7), ((3.0, 2.9), (2.0, 2.1), (1.0, 1.1)), "dry and viscous"),
        # A term that changes nothing is no term.
        ((0.5, 0.5, 0.9), ((1.0, 1.2), (1.0, 1.3), (3.0, 3.9)), "dry and quadratic"),
    ],
)  # fmt: skip
def test_a_law_is_chosen_by_its_predictions_and_fits(fitted, missed, chosen):
    laws = dict(zip(list(LAWS)[:3], zip(fitted, missed, strict=True), strict=True))
    logs = [Log(name, np.zeros(1), np.zeros((1, 1))) for name in "ab"]

    def fit(some, names, **_):
        left, predicted = laws[next(law for law in laws if LAWS[law] == names)]
        problem = SimpleNamespace(residuals=lambda _: np.array([left]))
        errors = dict(zip("ba", predicted, strict=True))
        return SimpleNamespace(
            problem=problem, unknowns=None, misfit=left, predicted=lambda log: np.array([errors[log.name]])
        )  # fmt: skip

    fitter, terms = SimpleNamespace(fit=fit), {law: LAWS[law] for law in laws}
    assert compare_laws(fitter, logs, terms, None, str)[0][0].name == chosen


@pytest.mark.parametrize("diverges", [True, False])
def test_laws_are_compared_by_longer_steps_unless_one_diverges(monkeypatch, diverges):
    """Of a lightly damped wave of 0.05 rad, drag is not chosen: its steps are those of the comparison alone."""
    inner, steps = ModelJoints.angles, set()

    def seen(self, log, terms, start):
        if terms[0].get(QUADRATIC):
            steps.add(self.timestep_s)
            if diverges:
                raise DivergedError("drag")
        return inner(self, log, terms, start)

    monkeypatch.setattr(ModelJoints, "angles", seen)
    times_s = np.arange(0.0, 0.8, 0.01)
    angles = 0.05 * np.exp(-0.5 * times_s) * np.cos(8.0 * times_s)
    log = Log("", times_s, angles[:, None])
    scene = one_joint(MASS_KG, LENGTH_M, INERTIA_KG_M2)
    found = identify(backend("mujoco"), scene, [log], settings={"timestep_s": 0.0005})
    assert QUADRATIC not in LAWS[found.laws[0].name]
    assert steps == ({0.002, 0.0005} if diverges else {0.002})


def swing(name, seed, *, dry, drag, start_rad):
    """A noisy log of the ODE by SciPy: dry and quadratic friction, measured from rest at an angle."""

    def slopes(_, state):
        angle, rate = state
        friction = dry * np.tanh(rate / 1e-3) + drag * rate * abs(rate)
        return [rate, -(WEIGHT_N_M * np.sin(angle) + friction) / ABOUT_JOINT]

    times_s = np.arange(0.0, 5.0, 0.02)
    found = solve_ivp(
        slopes, (0.0, 5.0), [start_rad, 0.0], t_eval=times_s, rtol=1e-8, atol=1e-9, method="LSODA"
    )  # fmt: skip
    noise = NOISE_RAD * np.random.default_rng(seed).standard_normal(times_s.size)
    rates = found.y[1][:, None]
    return Log(name, times_s, (found.y[0] + noise)[:, None], rate_rad_per_s=rates)


DRY_N_M, DRAG = 5e-4, 1.4e-5


@pytest.fixture(scope="module")
def found():
    starts = {"one": 1.2, "two": 0.7, "three": 0.4}
    logs = [
        swing(name, seed, dry=DRY_N_M, drag=DRAG, start_rad=start)
        for seed, (name, start) in enumerate(starts.items())
    ]
    other = swing("other", 9, dry=DRY_N_M, drag=DRAG, start_rad=0.9)
    scene = one_joint(MASS_KG, LENGTH_M, INERTIA_KG_M2)
    return identify(backend("mujoco"), scene, logs, held_out=[other])


@pytest.mark.slow
def test_the_law_that_predicts_the_other_files_is_chosen(found):
    best, *others = found.laws
    assert best.name == "dry and quadratic"
    assert best.fitted_rad == pytest.approx(NOISE_RAD, rel=0.3)
    wrong = {one.name: one.held_out_rad for one in others}
    assert wrong["viscous"] > 3.0 * best.held_out_rad
    assert wrong["dry"] > 3.0 * best.held_out_rad
    values = {one.name: one.value for one in found.settings}
    assert values[DRY] == pytest.approx(DRY_N_M, rel=0.05)
    assert values[QUADRATIC] == pytest.approx(DRAG, rel=0.05)
    assert f'damping="0 {values[QUADRATIC]:.5g}"' in found.lines


@pytest.mark.slow
def test_another_swing_is_predicted_from_its_recorded_start(found):
    assert found.held_out_rad["other"][0] < 10.0 * NOISE_RAD
    assert found.plain_rad["other"]["cosine"][0] > 10.0 * found.held_out_rad["other"][0]
    assert found.noise_rad[0] == pytest.approx(NOISE_RAD, rel=0.2)


@pytest.mark.slow
def test_the_value_of_another_file_is_in_the_interval_of_the_next(found):
    """The files share their law here: the interval holds the truth, and is no narrower than that of one fit."""
    for one in found.settings:
        assert len(one.of_files) == 3
        assert one.next_high - one.next_low > one.high - one.low
    dry = next(one for one in found.settings if one.name == DRY)
    assert dry.next_low < DRY_N_M < dry.next_high


@pytest.mark.parametrize("files", [3, 6])
@pytest.mark.parametrize("between", [0.0, 0.5, 3.0])
def test_the_interval_of_the_next_file_holds_95_percent(files, between):
    """Worlds with a known spread between files, and errors of each that differ."""
    random, inside = np.random.default_rng(5), []
    for _ in range(400):
        stds = random.uniform(0.2, 1.0, files + 1)
        values = 100.0 + between * random.standard_normal(files + 1)
        values += stds * random.standard_normal(files + 1)
        spread = spread_of(values[:-1], stds[:-1])
        inside.append(spread.low <= values[-1] <= spread.high)
    # A chance of 95 % has a standard error of 1.1 % in 400 worlds.
    assert np.mean(inside) > 0.92


def test_an_error_that_all_files_share_is_in_the_interval_if_it_is_stated():
    """Worlds whose load is 5 % off, which no scatter between files shows."""
    random = np.random.default_rng(6)
    inside = {0.0: 0, 0.05: 0}
    stds = np.full(3, 0.05)
    for _ in range(200):
        true = 100.0 + random.standard_normal(4)
        fitted = true[:3] * (1.0 + 0.05 * random.standard_normal())
        for stated in inside:
            spread = spread_of(fitted, stds, stated)
            inside[stated] += spread.low <= true[3] <= spread.high
    assert inside[0.0] < 0.75 * 200
    assert inside[0.05] > 0.91 * 200


def test_what_is_left_has_a_name():
    times_s = np.arange(0.0, 5.0, 0.01)
    angles = np.exp(-0.1 * times_s) * np.cos(6.0 * times_s)
    noise = 1e-4 * np.random.default_rng(1).standard_normal(times_s.size)
    shapes = {
        "offset": np.full_like(times_s, 2e-3),
        "lag": 2e-3 * np.gradient(angles, times_s) / 6.0,
        "drag": 2e-3 * angles * times_s,
    }
    for name, shape in shapes.items():
        assert pattern(times_s, angles, shape + noise).startswith(name)
        assert sensor_noise_rad(shape + noise) == pytest.approx(1e-4, rel=0.1)
    assert pattern(times_s, angles, noise) == ""
