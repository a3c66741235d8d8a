"""Conformance checks: how they run, what their command prints, and the closed forms with which they compare."""

import json
from dataclasses import replace

import numpy as np
import pytest
from faults import FAULTS, Fault, Faulty, Passed
from scipy.integrate import quad
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner
from wobbling import WobblingBackend, told

from gauge_envs.backends import Repeatability, Support, backend, registry
from gauge_envs.cli.app import app
from gauge_envs.errors import ParameterError, UnknownNameError
from gauge_envs.pages.markdown import as_markdown
from gauge_envs.scene import Box, Scene
from gauge_envs.scoring.estimators import hann_mean, pendulum_period_s
from gauge_envs.tools.bench.recording import DeclinedError, Recording
from gauge_envs.tools.conformance import CheckResult, Status, checks, run_checks
from gauge_envs.tools.conformance.forces import EULER_DEG, _frame_hint
from gauge_envs.tools.conformance.lab import DisturbedLab, Lab
from gauge_envs.tools.conformance.laws import torque_free_orientation, worst_ratio
from gauge_envs.tools.conformance.rigid import _hinge_radius, _pendulum_energy
from gauge_envs.tools.conformance.words import findings_document

SOUND = Fault()


class Changed(Faulty):
    """MuJoCo with a fault, which is none by default."""

    def __init__(self, fault=SOUND):
        super().__init__(backend("mujoco"), fault)


def simulated_by(simulation):
    return Changed(Fault(simulation=simulation))


@pytest.mark.parametrize(
    ("words", "wrong"),
    [
        ("along the axes of the world", lambda right: Rotation.identity()),
        ("from the world to the body", lambda right: right.inv()),
        (
            "x, y, z, w was read as w, x, y, z",
            lambda right: Rotation.from_quat(right.as_quat(), scalar_first=True),
        ),
        ("", lambda right: right * Rotation.from_rotvec([0.0, 0.0, 0.3])),
    ],
)
def test_the_wrong_frame_of_an_inertia_is_named(words, wrong):
    own = np.diag([1.5e-4, 3.6e-4, 4.5e-4])
    frame = wrong(Rotation.from_euler("xyz", EULER_DEG, degrees=True)).as_matrix()
    found = _frame_hint(frame @ own @ frame.T, own)
    assert words in found and bool(words) == bool(found)


@pytest.mark.slow
def test_deformable_laws_read_the_same_at_any_damping():
    """MuJoCo's integrator damps in proportion to its step, here by a factor of ten."""
    laws = ["cloth-stretch", "cloth-shear", "cloth-bending", "rod-bending"]
    damped, swinging = (
        {
            one.check: one.measured
            for one in run_checks("mujoco", settings={"timestep_s": step}, only=laws)
        }
        for step in (1 / 180, 1 / 1800)
    )
    assert damped == pytest.approx(swinging, rel=0.01)


class Declines(Changed):
    def supports(self, scene):
        return Support(("it knows no cloth",) if scene.deformables else ())


class KnowsBallsOnly(Changed):
    def supports(self, scene):
        return Support(
            tuple(
                f"{one.name!r} is a box"
                for one in scene.bodies
                if isinstance(one.shape, Box)
            )
        )


class CannotBuild(Changed):
    def build(self, scene, settings=None):
        if scene.deformables:
            raise KeyError("mesh")
        return super().build(scene, settings)


class NotFinite(Passed):
    def body_states(self, names):
        return np.full((1, len(names), 13), np.nan)


class RaisesInAdvance(Passed):
    def advance(self, seconds):
        raise KeyError("brick")


def test_an_error_of_the_engine_has_its_place():
    (finding,) = run_checks(simulated_by(RaisesInAdvance), only=["free-fall"])
    assert finding.status is Status.ERROR
    assert "KeyError: 'brick' (advance, test_conformance.py, line" in finding.diagnosis


def test_what_is_declined_is_no_failure_and_has_its_reasons():
    findings = {
        one.check: one
        for one in run_checks(Declines(), only=["cloth-stretch", "free-fall"])
    }
    assert findings["free-fall"].status is Status.PASS
    declined = findings["cloth-stretch"]
    assert (declined.status, declined.missing, declined.is_bad) == (
        Status.DECLINED,
        ("it knows no cloth",),
        False,
    )
    assert declined.measured is None


def test_repeatability_is_checked_on_an_engine_that_knows_little():
    findings = list(
        run_checks(
            KnowsBallsOnly(),
            only=["reset-[!c]*", "determinism", "contact-*", "rebound-0.5"],
        )
    )
    assert {one.status for one in findings} == {Status.PASS}
    (reset,) = run_checks(KnowsBallsOnly(FAULTS["no-reset"]), only=["reset-start"])
    assert reset.status is Status.FAIL


class AddsInAnyOrder(Passed):
    """Its steps end in random last digits, as those of kernels that add in any order."""

    noise_m_per_s = 1e-9
    random = np.random.default_rng(0)

    def advance(self, seconds):
        super().advance(seconds)
        velocities = self.inner.data.qvel
        velocities += self.noise_m_per_s * self.random.standard_normal(len(velocities))


class AddsMuch(AddsInAnyOrder):
    noise_m_per_s = 1e-4


@pytest.mark.parametrize(
    ("simulation", "kind", "failed"),
    [
        (Passed, "statistical", set()),
        (AddsInAnyOrder, "bits", {"reset-course", "determinism"}),
        (AddsInAnyOrder, "run", {"reset-course"}),
        (AddsInAnyOrder, "statistical", set()),
        (AddsMuch, "statistical", {"reset-course", "determinism"}),
    ],
)
def test_runs_may_part_as_an_engine_declares(simulation, kind, failed):
    engine = simulated_by(simulation)
    start_error = 0.0 if kind == "bits" else 1e-6
    declared = Repeatability(kind=kind, start_error=start_error)
    engine.repeatability = lambda settings=None: declared
    only = ["reset-start", "reset-course", "determinism"]
    findings = run_checks(engine, only=only)
    assert {one.check for one in findings if one.status is Status.FAIL} == failed


def test_an_engine_that_fails_in_disturbed_runs_costs_one_check(monkeypatch):
    engine = simulated_by(AddsInAnyOrder)
    declared = Repeatability(kind="statistical", start_error=1e-6)
    engine.repeatability = lambda settings=None: declared
    monkeypatch.setattr(DisturbedLab, "build", RaisesInAdvance.advance)
    found = list(run_checks(engine, only=["determinism", "free-fall"]))
    assert {one.check: one.status for one in found} == {
        "determinism": Status.ERROR,
        "free-fall": Status.PASS,
    }


@pytest.mark.parametrize(
    ("kind", "start_error"), [("bits", 1e-6), ("statistical", 0.0), ("run", 1e-3)]
)
def test_a_repeatability_that_says_nothing_is_refused(kind, start_error):
    with pytest.raises(ParameterError, match=f"start_error of repeatability '{kind}'"):
        Repeatability(kind=kind, start_error=start_error)


class PanicException(BaseException):
    """What engines in Rust raise."""


class Panics(Passed):
    def advance(self, seconds):
        raise PanicException("assertion failed: radius.is_sign_positive()")


def test_a_panic_of_the_engine_is_a_finding_and_ctrl_c_ends_the_run(monkeypatch):
    findings = list(run_checks(simulated_by(Panics), only=["free-fall", "slide"]))
    assert [one.status for one in findings] == [Status.ERROR] * 2
    assert "PanicException: assertion failed: radius" in findings[0].diagnosis
    monkeypatch.setattr(
        Panics, "advance", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt)
    )
    with pytest.raises(KeyboardInterrupt):
        list(run_checks(simulated_by(Panics), only=["free-fall"]))


def test_an_exception_is_a_finding_and_the_others_go_on():
    findings = {
        one.check: one
        for one in run_checks(CannotBuild(), only=["cloth-s*", "free-fall"])
    }
    assert findings["free-fall"].status is Status.PASS
    for name in ("cloth-start", "cloth-stretch", "cloth-shear"):
        assert findings[name].status is Status.ERROR
        assert (
            "supports() was true, but build() raised KeyError: 'mesh'"
            in findings[name].diagnosis
        )


def test_what_is_not_finite_says_when():
    (finding,) = run_checks(simulated_by(NotFinite), only=["free-fall"])
    assert finding.status is Status.ERROR
    assert "after 0 s 'brick' is not finite" in finding.diagnosis


def test_findings_are_json():
    (finding,) = run_checks(Changed(FAULTS["cloth-stretch"]), only=["cloth-stretch"])
    values = json.loads(json.dumps(finding.to_dict(), allow_nan=False))
    assert values["status"] == "fail"
    assert values["measured"] == pytest.approx(1.3, rel=0.03)
    assert values["versions"] == backend("mujoco").versions()
    assert values["settings"]["preset"] == "cloth"


def test_settings_reach_the_backend():
    (finding,) = run_checks(
        "mujoco", settings={"timestep_s": 1 / 900}, only=["free-fall"]
    )
    assert finding.settings["timestep_s"] == 1 / 900


def test_settings_that_the_backend_refuses_end_the_run():
    with pytest.raises(ParameterError, match="unknown setting"):
        list(run_checks("mujoco", settings={"timestep": 1e-3}, only=["free-fall*"]))


def test_unknown_names_are_refused_before_anything_runs():
    with pytest.raises(UnknownNameError, match="free-fall"):
        run_checks("mujoco", only=["free-fal"])
    with pytest.raises(UnknownNameError, match="backend"):
        run_checks("mujko")


def test_scenes_and_numbers_of_all_checks_are_the_approved_ones(approved):
    """Of an engine whose bodies move as stated functions of the time, so that no physics and no rounding matters."""
    engine, little = WobblingBackend(), WobblingBackend(0.02)
    lab, lab_of_little, lines, first = Lab(engine), Lab(little), [], {}
    for one in checks():
        engine.scenes.clear()
        width = f"{one.tolerance.absolute:g} + {one.tolerance.relative:g}"
        try:
            lines.append(f"{one.id}: {told(one.measure(lab))}, width {width}")
        except DeclinedError as error:
            lines.append(f"{one.id}: declined, {error}")
            continue
        lines.append(f"  of little motion: {told(one.measure(lab_of_little))}")
        for scene in map(told, engine.scenes):
            lines.append(f"  {first.setdefault(scene, scene)}")
            first[scene] = f"the scene of {one.id}"
    approved("conformance/checks", "\n".join(dict.fromkeys(lines)))


def test_every_check_says_what_it_is():
    for check in checks():
        for text in (
            check.title,
            check.scene,
            check.measures,
            check.law,
            check.source,
            check.unit,
            check.diagnosis,
        ):
            assert text
        assert check.tolerance.rationale
        assert check.id == check.id.lower().replace(" ", "-").replace("_", "-")


def test_an_id_is_used_once():
    first = checks()[0]
    from gauge_envs.tools.conformance import check

    with pytest.raises(ParameterError, match=first.id):
        check(first.id)(first.measure)


@pytest.fixture
def gauge(monkeypatch):
    """Runs the command; `faulty` is an installed backend whose friction is 20 % low and which knows no cloth."""
    broken = Declines(FAULTS["friction-low"])
    known = registry.backend
    monkeypatch.setattr(registry, "is_bundled", lambda name: True)
    monkeypatch.setattr(
        "gauge_envs.tools.conformance.run.find_backend",
        lambda name: broken if name == "faulty" else known(name),
    )
    return lambda *arguments: CliRunner(env={"COLUMNS": "160"}).invoke(
        app, ["backend", "check", *arguments]
    )


ONLY = ("--only", "slide", "--only", "cloth-stretch")


def test_command_compares_backends(gauge):
    result = gauge("mujoco", "faulty", *ONLY)
    assert result.exit_code == 1
    words = " ".join(result.stdout.split())
    assert "as if the friction were 0.24 instead of 0.3" in words
    assert "it knows no cloth (cloth-stretch)" in words


@pytest.mark.parametrize(
    ("options", "rows", "code"),
    [
        (("mujoco", "--only", "free-fall"), "mujoco free-fall pass", 0),
        (("faulty", "--only", "cloth-stretch"), "faulty cloth-stretch declined", 1),
        (
            ("mujoco", "faulty", *ONLY),
            "mujoco slide pass, mujoco cloth-stretch pass, faulty slide fail, faulty cloth-stretch declined",
            1,
        ),
    ],
)
def test_command_prints_rows_and_fails_where_one_fails(gauge, options, rows, code):
    result = gauge(*options, "--json")
    found = [json.loads(line) for line in result.stdout.splitlines()]
    names = ("backend", "check", "status")
    lines = [" ".join(row[name] for name in names) for row in found]
    assert (", ".join(lines), result.exit_code) == (rows, code)


def test_wrong_requests_are_named(gauge, approved):
    requests = (
        "nope",
        "mujoco --only nope",
        "--only free-fall",
        "mujoco --only free-fall slide",
    )
    texts = []
    for words in requests:
        result = gauge(*words.split())
        assert (result.exit_code, result.stdout) == (2, ""), words
        texts.append(f"$ gauge backend check {words}\n{result.stderr.strip()}")
    approved("conformance/refused", "\n".join(texts))


def test_checks_are_listed_with_their_scenes():
    result = CliRunner(env={"COLUMNS": "160"}).invoke(app, ["list", "checks", "rest-*"])
    assert result.exit_code == 0
    assert "rest-lying-cylinder" in result.stdout
    assert "fixed plane, box, sphere, cylinder" in " ".join(result.stdout.split())
    rows = [
        json.loads(line)
        for line in CliRunner()
        .invoke(app, ["list", "checks", "--json"])
        .stdout.splitlines()
    ]
    assert [row["id"] for row in rows] == [check.id for check in checks()]
    assert all(row["scene"] and row["measures"] and row["law"] for row in rows)


def test_command_reports_progress_without_a_terminal(gauge, monkeypatch):
    monkeypatch.setattr("gauge_envs.tools.conformance.command.LINE_INTERVAL_S", 0.0)
    result = gauge("mujoco", "--only", "free-fall", "--only", "hold")
    assert "1/2 mujoco: free-fall" in result.stderr
    assert "2/2 mujoco: hold" in result.stderr


def test_checks_that_fail_for_the_same_reason_have_one_line():
    results = list(
        run_checks(Changed(FAULTS["nan-mass"]), only=["finite", "free-fall*", "slide*"])
    )
    text = as_markdown(findings_document(results))
    assert "see the check" not in text
    assert "more are not finite, see finite: free-fall" in text


def test_a_backend_that_cannot_build_has_one_line(monkeypatch):
    def broken(*_):
        raise TypeError("no mass")

    engine = Changed(FAULTS["nan-mass"])
    monkeypatch.setattr(engine, "build", broken)
    text = as_markdown(
        findings_document(list(run_checks(engine, only=["time", "free-fall"])))
    )
    assert text.count("no mass") == 1
    assert ", time, free-fall: " in text


def test_bars_in_laws_do_not_break_the_markdown_table():
    finding = next(run_checks("mujoco", only=["hinge-radius"]))
    assert isinstance(finding, CheckResult)
    assert "\\|r - anchor\\| = l" in as_markdown(findings_document([finding]))


def test_pendulum_period_is_the_integral_over_a_quarter_swing():
    amplitude, length, gyration = np.radians(100.0), 0.3, 0.05
    # Energy gives the angular speed; sin(theta / 2) = sin(amplitude / 2) sin(phi) removes the singularity at the end.
    k = np.sin(0.5 * amplitude)
    quarter, _ = quad(
        lambda phi: 1.0 / np.sqrt(1.0 - (k * np.sin(phi)) ** 2), 0.0, 0.5 * np.pi
    )
    expected = 4.0 * quarter * np.sqrt((length**2 + gyration**2) / (9.8 * length))
    measured = pendulum_period_s(
        length_m=length,
        gyration_m=gyration,
        amplitude_rad=amplitude,
        gravity_m_per_s2=9.8,
    )
    assert measured == pytest.approx(expected, rel=1e-9)


def test_what_is_off_by_far_is_not_right_beside_what_is_off_by_more():
    ratios = {"stiff": np.inf, "soft": 0.002, "double": 2.0, "good": 1.01}
    hint = worst_ratio(ratios, "K is").hint
    assert hint == "K is inf times what it should be for stiff; right: good"


def test_a_soft_hinge_and_lost_energy_are_measured():
    """A bob leaves its circle by 2 mm along the axis and 0.3 mm along the arm, and loses a tenth of its energy."""
    angles_rad = np.linspace(np.radians(60.0), 0.0, 20)
    grown = np.linspace(0.0, 1e-3, 20)
    arm_m = 0.2 + 0.3 * grown
    states = np.zeros((20, 13))
    states[:, 0] = 0.1 + arm_m * np.sin(angles_rad)
    states[:, 1] = 0.2 + 2.0 * grown
    states[:, 2] = 1.0 - arm_m * np.cos(angles_rad)
    fallen_m = states[0, 2] - states[:, 2]
    kept = 1.0 - 0.1 * (np.arange(20) == 19)
    # Energy of a solid sphere whose centre is 0.2 m away from the axis about which it turns.
    gyration_m = np.sqrt(0.4) * 0.05 / 0.2
    speeds = np.sqrt(2.0 * 9.80665 * fallen_m * kept / (1.0 + gyration_m**2))
    states[:, 7], states[:, 11] = -speeds, speeds / 0.2
    rollout = Recording(
        scene=Scene(bodies=(), duration_s=0.1),
        times_s=np.arange(20) / 180.0,
        states={"bob": states},
    )
    assert _hinge_radius(rollout).measured == pytest.approx(2.0, rel=1e-6)
    lost = _pendulum_energy(rollout)
    released_m = 0.2 * (1.0 - np.cos(np.radians(60.0)))
    assert lost.measured == pytest.approx(10.0 * fallen_m[-1] / released_m, rel=1e-3)
    assert lost.hint == ""
    for factor, words in ((0.5, "0.5 times"), (np.degrees(1.0), "it is in degrees")):
        turned = states.copy()
        turned[:, 11] *= factor
        hint = _pendulum_energy(replace(rollout, states={"bob": turned})).hint
        assert words in hint


def test_torque_free_symmetric_top_precesses_steadily():
    """Closed form: it turns with L / I1 about L, and with (1 - I3 / I1) times its own axial spin about its axis."""
    moments, spin = np.array([2.0, 2.0, 3.0]), np.array([0.7, 0.0, 1.1])
    turned = torque_free_orientation(
        start=Rotation.identity(), spin_rad_per_s=spin, moments=moments, seconds=2.0
    )
    momentum = moments * spin
    about_momentum = Rotation.from_rotvec(2.0 * momentum / moments[0])
    about_axis = Rotation.from_rotvec(
        [0.0, 0.0, 2.0 * (1.0 - moments[2] / moments[0]) * spin[2]]
    )
    assert (turned * (about_momentum * about_axis).inv()).magnitude() < 1e-8


@pytest.mark.parametrize("damping_per_s", [0.0, 1.0, 5.0, 60.0])
@pytest.mark.parametrize("periods", [4.0, 4.3, 6.5])
def test_the_centre_of_an_oscillation_does_not_depend_on_its_damping(
    damping_per_s, periods
):
    times = np.linspace(0.2, 0.8, 109)
    swing = np.exp(-damping_per_s * times) * np.cos(
        2.0 * np.pi * periods / 0.6 * times + 0.4
    )
    assert hann_mean(1.0 - swing) == pytest.approx(1.0, abs=0.01)
