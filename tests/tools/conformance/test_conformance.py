"""Conformance checks name planted mistakes of engines; errors and unsupported scenes affect only their checks."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from faults import FAULTS, Fault, Faulty, Planted

from gauge_envs.backends import LoopedSimulation, Repeatability, Support, backend
from gauge_envs.errors import BackendError, UnknownNameError
from gauge_envs.tools.conformance import (
    Status,
    checks,
    run_checks,
)
from gauge_envs.tools.conformance.causes import likely_causes, rules
from gauge_envs.tools.conformance.model import Level, Tolerance
from gauge_envs.tools.conformance.report import engine_document
from gauge_envs.tools.conformance.results import levels

MUJOCO = backend("mujoco")


def planted(name):
    fault = FAULTS[name]
    return fault.engine(MUJOCO, fault)


def simulated_by(simulation):
    return Faulty(MUJOCO, Fault(simulation=simulation))


def results_of(engine, *only):
    return {result.check: result for result in run_checks(engine, only=only)}


# --- planted mistakes ------------------------------------------------------------------------------------------------


LONG = (
    "all worlds driven as the first",
    "a pressing force is ignored",
    "sliding boxes turn",
    "lying cylinders rock",
    "the mass of small bodies is ignored",
    "torques in the body frame",
    "contact forces with reversed friction",
    "contact impulses survive a reset",
)
"""Faults whose checks take a second or more."""


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.slow if name in LONG else ())
        for name in FAULTS
    ],
)
def test_a_check_names_the_mistake(name):
    fault = FAULTS[name]
    (result,) = run_checks(planted(name), only=[fault.caught_by])
    assert result.is_bad
    assert fault.says in f"{result.of.title}: {result.diagnosis}"


@cache
def own_failures():
    """Checks that the engine without a fault fails."""
    return {result.check for result in run_checks(MUJOCO) if result.is_bad}


@pytest.mark.slow
@pytest.mark.parametrize("name", FAULTS)
def test_no_earlier_check_fails(name):
    """Checks run in their order, so that the first failure is the cause of those after it."""
    caught_by = FAULTS[name].caught_by
    own = own_failures()
    for result in run_checks(planted(name)):
        if result.is_bad and result.check not in own - {caught_by}:
            assert result.check == caught_by
            return
    pytest.fail("no check fails")


@pytest.fixture
def causes():
    """Return a function: the causes of failures, each with its value over what is expected, and of other results."""
    (result,) = run_checks(MUJOCO, only=["time"])
    passed = {entry.id: replace(result, of=entry) for entry in checks()}

    def named(failed, unfinished=(), unsupported=()):
        changed = {
            name: {"status": Status.FAIL, "expected": 1.0, "measured": factor}
            for name, factor in failed.items()
        }
        for name in (*unfinished, *unsupported):
            stopped = name in unfinished
            status = Status.ERROR if stopped else Status.UNSUPPORTED
            none = {"expected": None, "measured": None, "is_unfinished": stopped}
            changed[name] = {"status": status, **none}
        results = {name: replace(passed[name], **row) for name, row in changed.items()}
        return likely_causes([*(passed | results).values()])

    return named


WRENCH = dict.fromkeys(("inertia", "stated-inertia"), 2.0)
WORLDS = dict.fromkeys(("worlds-single", "worlds-neighbours"), 9.0)
SLIDES = {"pucks-friction": 0.8, "slide": 0.8, "carry-slip": 0.8}


@pytest.mark.parametrize(
    ("failed", "words"),
    [
        (SLIDES, "friction is smaller than Contact.friction, by one factor"),
        (dict.fromkeys(SLIDES, 1.3), "friction is larger than Contact.friction"),
        (SLIDES | {"carry-slip": 0.5}, "each pair has another factor of friction"),
        ({"pucks-friction": 0.7, "slide": 0.7}, "friction depends on the direction"),
        (SLIDES | {"slide-straight": 2.0}, "friction is smaller than Contact.friction"),
        ({"oblique-slip": 3.0}, "friction in impacts has another value"),
        ({"slide-straight": 2.0}, "a cube that slides does not turn"),
    ],
)
def test_the_most_basic_failures_name_the_cause(causes, failed, words):
    (text,) = causes(failed)
    assert text.startswith(words)


@pytest.mark.parametrize("factor", [0.92, 1.92])
def test_another_gravity_is_the_first_cause_whatever_else_fails(causes, factor):
    """A time or a unit of length that is another makes another fall, so these come first."""
    others = [entry.id for entry in checks()]
    failed = dict.fromkeys(others, 1.5) | {"free-fall": factor}
    del failed["time"], failed["start-position"]
    assert causes(failed)[0].startswith("free fall of all solids")
    assert causes({"free-fall": factor, "time": 0.5})[0].startswith("advance simu")


def test_resistance_to_the_motion_is_not_another_gravity(causes):
    assert causes({"free-fall": 0.998, "glide-speed": 0.5})[0].startswith("free bodies")


def test_a_slow_engine_is_judged_by_what_it_finishes(causes):
    slow = ("tower-stands", "wall", "pucks-friction", "contact-listed")
    assert causes({}, unfinished=slow) == []
    low = {"slide": 0.8, "carry-slip": 0.8, "hold": 9.0}
    (text,) = causes(low, unfinished=slow)
    assert text.startswith("friction is smaller than Contact.friction, by one factor")
    assert text.endswith("(fails: slide, carry-slip)")
    (text,) = causes({"rest-heights": 2.0, "rest-small": 2.0}, unfinished=slow)
    assert text.startswith("bodies hover")


FORCES = {"wrench-force": 0.2, "inertia": 1.2, "worlds-wrench": 0.83}


@pytest.mark.parametrize(
    ("failed", "unsupported", "words"),
    [
        (FORCES | {"contact-force": 1.2}, (), "free bodies have another mass than"),
        (FORCES | {"contact-force": 1.7}, (), "apply_wrench applies a multiple"),
        (FORCES, (), "apply_wrench applies a multiple"),
        (FORCES, ("contact-force",), "free bodies have another mass, or apply_wrench"),
    ],
)
def test_another_mass_differs_from_a_factor_of_wrenches(
    causes, failed, unsupported, words
):
    """Contact forces have the mass, and not the factor, by the same share."""
    assert causes(failed, unsupported=unsupported)[0].startswith(words)


def test_a_cause_has_its_proof_and_others_follow(causes):
    assert causes({}) == []
    (wrench,) = causes(WRENCH | WORLDS)
    assert wrench.endswith("(fails: inertia, stated-inertia; passes: wrench-force)")


def test_each_check_is_the_last_to_explain_a_failure():
    alone = {rule["fails"] for rule in rules() if "cause" not in rule}
    assert alone >= {entry.id for entry in checks()}


@pytest.mark.parametrize("expected", [-20.0, 20.0])
def test_a_tolerance_grows_with_the_size_of_the_expected_value(expected):
    assert Tolerance("test", absolute=1.0, relative=0.1).width(expected) == 3.0


def test_a_broken_filter_is_found_before_motion():
    first = [check.id for check in checks()][:5]
    assert (first[0], first[-1]) == ("determinism", "contact-listed")
    assert all(name.startswith(("order-", "start-")) for name in first[1:-1])


class OtherSign(Planted):
    """Reports each quaternion with the other sign at every second reading, which is the same rotation."""

    count = 0

    def body_states(self, names):
        states = super().body_states(names)
        self.count += 1
        states[..., 3:7] *= (-1.0) ** self.count
        return states


def test_the_sign_of_a_quaternion_is_not_a_fault():
    ids = ("start-orientation", "glide-reports", "determinism")
    results = results_of(simulated_by(OtherSign), *ids)
    assert {result.diagnosis for result in results.values()} == {""}


class AddsInAnyOrder(Planted):
    """Its steps end in random last digits, like kernels that add in any order."""

    random = np.random.default_rng(0)

    def advance(self, seconds):
        super().advance(seconds)
        self.data.qvel[:] += 1e-9 * self.random.standard_normal(self.model.nv)


@pytest.mark.parametrize(("kind", "is_bad"), [("bits", True), ("statistical", False)])
def test_runs_may_differ_as_an_engine_declares(kind, is_bad):
    engine = simulated_by(AddsInAnyOrder)
    error = 0.0 if kind == "bits" else 1e-6
    declared = Repeatability(kind=kind, start_error=error)
    engine.repeatability = lambda settings=None: declared
    (result,) = run_checks(engine, only=["determinism"])
    assert result.is_bad == is_bad


class LastWorldRounds(LoopedSimulation):
    """Adds to the last of several worlds in another order."""

    def advance(self, seconds):
        super().advance(seconds)
        self._simulations[-1].data.qvel[0] += 1e-12 * (self.world_count > 1)


@pytest.mark.parametrize(("kind", "is_bad"), [("bits", True), ("statistical", False)])
def test_worlds_that_start_alike_are_equal_as_an_engine_declares(kind, is_bad):
    engine = Faulty(MUJOCO, Fault(worlds=LastWorldRounds))
    declared = Repeatability(kind=kind, start_error=0.0 if kind == "bits" else 1e-6)
    engine.repeatability = lambda settings=None: declared
    (result,) = run_checks(engine, only=["worlds-single"])
    assert result.is_bad == is_bad
    assert ("world 15, which starts and moves as world 0" in result.diagnosis) == is_bad


# --- errors and unsupported scenes of engines ------------------------------------------------------------------------


class KnowsNoCloth(Faulty):
    def supports(self, scene):
        return Support(("it knows no cloth",) if scene.deformables else ())


class CannotBuildCloth(Faulty):
    def build(self, scene, settings=None):
        if scene.deformables:
            raise KeyError("mesh")
        return super().build(scene, settings)


class BuildsNothing(Faulty):
    def build(self, scene, settings=None):
        super().build(scene, settings).close()


class NoSettings(Faulty):
    def build(self, scene, settings=None):
        simulation = super().build(scene, settings)
        simulation.settings = None
        return simulation


class DivergedIsAList(Planted):
    def diverged(self):
        return []


@pytest.mark.parametrize(
    ("engine", "text"),
    [
        (BuildsNothing(MUJOCO, Fault()), "build() returned a NoneType"),
        (NoSettings(MUJOCO, Fault()), "Simulation.settings is a NoneType"),
        (simulated_by(DivergedIsAList), "Simulation.diverged() is a list"),
    ],
)
def test_a_wrong_return_value_is_named_as_the_engine_s(engine, text):
    (result,) = run_checks(engine, only=["free-fall"])
    assert text in result.diagnosis


class VersionOfText(Faulty):
    def versions(self):
        return "1.0"


class PanicException(BaseException):
    """Exception of engines in Rust."""


class Panics(Planted):
    error: BaseException = PanicException("assertion failed")

    def advance(self, seconds):
        raise self.error


def test_an_unsupported_check_is_not_a_failure_and_has_its_reason():
    results = results_of(KnowsNoCloth(MUJOCO, Fault()), "cloth-stretch", "free-fall")
    unsupported = results["cloth-stretch"]
    assert (unsupported.status, unsupported.is_bad) == (Status.UNSUPPORTED, False)
    assert unsupported.missing == ("it knows no cloth",)
    assert results["free-fall"].status is Status.PASS


def test_an_exception_costs_its_checks_and_has_its_place():
    results = results_of(
        CannotBuildCloth(MUJOCO, Fault()), "cloth-stretch", "free-fall"
    )
    assert results["free-fall"].status is Status.PASS
    text = results["cloth-stretch"].diagnosis
    assert "supports() was true, but build() raised KeyError: 'mesh' (build, " in text
    with pytest.raises(BackendError, match=r"versions returned '1.0', expected texts"):
        run_checks(VersionOfText(MUJOCO, Fault()), only=["time"])


def test_a_panic_is_a_result_and_ctrl_c_ends_the_run(monkeypatch):
    (result,) = run_checks(simulated_by(Panics), only=["free-fall"])
    assert result.status is Status.ERROR
    assert "PanicException: assertion failed (advance, test_conf" in result.diagnosis
    assert result.diagnosis.endswith(
        "in the scene of turned box, sphere, turned cylinder and 2 more"
    )
    monkeypatch.setattr(Panics, "error", KeyboardInterrupt())
    with pytest.raises(KeyboardInterrupt):
        list(run_checks(simulated_by(Panics), only=["free-fall"]))


# --- checks and results ----------------------------------------------------------------------------------------------


def test_settings_reach_the_engine_and_an_unknown_one_is_a_reason():
    (result,) = run_checks("mujoco", settings={"timestep_s": 1 / 900}, only=["time"])
    assert result.settings["timestep_s"] == 1 / 900
    (result,) = run_checks("mujoco", settings={"timestep": 1e-3}, only=["time"])
    assert result.status is Status.UNSUPPORTED
    assert "unknown setting" in result.missing[0]


def test_unknown_names_are_rejected_before_anything_runs():
    with pytest.raises(UnknownNameError, match="free-fall"):
        run_checks("mujoco", only=["free-fal"])
    with pytest.raises(UnknownNameError, match="backend"):
        run_checks("mujko")


def test_a_level_passes_where_each_check_passes_that_is_not_optional():
    (result,) = run_checks("mujoco", only=["start-position"])
    assert levels([result]) == {}
    passed = {entry.id: replace(result, of=entry) for entry in checks()}
    assert set(levels([*passed.values()]).values()) == {"pass"}
    for name, status, verdict in (
        ("free-fall", Status.FAIL, "1 of "),
        ("free-fall", Status.UNSUPPORTED, "incomplete, free-fall unsupported"),
        ("torsion", Status.UNSUPPORTED, "pass"),
    ):
        changed = {**passed, name: replace(passed[name], status=status)}
        level = passed[name].of.level
        assert levels([*changed.values()])[level].startswith(verdict)


def test_each_check_has_an_id_of_its_own_and_a_description():
    ids = [check.id for check in checks()]
    assert len(set(ids)) == len(ids)
    assert [check.id for check in checks() if not check.description] == []


def test_a_level_selects_its_checks_and_a_wrong_one_names_the_levels():
    for level in Level:
        chosen = checks([level.value])
        assert chosen
        assert {check.level for check in chosen} == {level}
    assert len(checks(["rigid", "slide"])) == len(checks(["rigid"])) + 1
    with pytest.raises(UnknownNameError, match="did you mean rigid"):
        checks(["rigit"])


def test_texts_do_not_change_a_fingerprint_but_numbers_and_revisions_do():
    (check,) = checks(["slide"])
    prose = {"title": "", "description": "", "law": "", "cause": ""}
    wider = replace(check.tolerance, absolute=0.02)
    reason = replace(check.tolerance, rationale="")
    assert replace(check, tolerance=reason, **prose).fingerprint == check.fingerprint
    for changed in ({"tolerance": wider}, {"unit": "mm"}, {"revision": 2}):
        assert replace(check, **changed).fingerprint != check.fingerprint


class NoContact(Faulty):
    """Leaves the pairs of driven bodies out."""

    def build(self, scene, settings=None):
        driven = {driver.body for driver in scene.drivers}
        kept = [
            contact
            for contact in scene.contacts
            if driven.isdisjoint((*contact.first, *contact.second))
        ]
        return super().build(replace(scene, contacts=tuple(kept)), settings)


def test_a_body_that_falls_has_no_contact():
    """A free fall of 0.9 s is 4 m."""
    (result,) = run_checks(NoContact(MUJOCO, Fault()), only=["driven-slow"])
    hint = "falls through the plate at 2 mm/s: the pair has no contact"
    assert hint in result.diagnosis


def test_a_narrow_pass_has_both_numbers_and_a_wide_one_none():
    (result,) = run_checks(MUJOCO, only=["tower-stands"])
    texts = []
    for measured in (0.46, 0.44):
        document = engine_document([replace(result, measured=measured, width=0.5)])
        texts.append(str(document))
    assert "Narrow pass: tower-stands is 0.46 for 0 +- 0.5 mm" in texts[0]
    assert "Narrow pass" not in texts[1]
