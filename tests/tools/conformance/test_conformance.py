"""Conformance checks: how they run, how they name the mistakes of engines, and the closed forms that they use."""

import json

import numpy as np
import pytest
from faults import FAULTS, Fault, Faulty, Passed

from gauge_envs.backends import Repeatability, Support, backend
from gauge_envs.errors import BackendError, ParameterError, UnknownNameError
from gauge_envs.tools.conformance import Status, checks, run_checks

MUJOCO = backend("mujoco")


def planted(name):
    fault = FAULTS[name]
    return fault.engine(MUJOCO, fault)


@pytest.mark.parametrize("name", FAULTS)
def test_a_check_names_the_mistake(name):
    fault = FAULTS[name]
    (result,) = run_checks(planted(name), only=[fault.caught_by])
    assert result.is_bad
    assert fault.says in f"{result.of.title}: {result.diagnosis}"


@pytest.mark.slow
@pytest.mark.parametrize("name", FAULTS)
def test_the_first_failure_names_the_mistake(name):
    healthy = {one.check for one in run_checks(MUJOCO) if one.is_bad}
    results = run_checks(planted(name))
    first = next(one for one in results if one.is_bad and one.check not in healthy)
    assert first.check == FAULTS[name].caught_by


def test_a_check_has_all_its_texts():
    for one in checks():
        texts = (one.title, one.scene, one.measures, one.law, one.source, one.cause)
        assert all(texts), one.id
        assert one.tolerance.rationale, one.id
        assert one.id == one.id.lower().replace(" ", "-").replace("_", "-")


def test_an_id_is_used_once():
    from gauge_envs.tools.conformance import check

    first = checks()[0]
    again = check(
        first.id,
        title=first.title,
        law=first.law,
        source=first.source,
        tolerance=first.tolerance,
        cause=first.cause,
    )
    with pytest.raises(ParameterError, match=first.id):
        again(first.measure)


# --- what engines raise, decline and repeat --------------------------------------------------------------------------


class Declines(Faulty):
    def supports(self, scene):
        return Support(("it knows no cloth",) if scene.deformables else ())


class CannotBuild(Faulty):
    def build(self, scene, settings=None):
        if scene.deformables:
            raise KeyError("mesh")
        return super().build(scene, settings)


class RaisesInAdvance(Passed):
    def advance(self, seconds):
        raise KeyError("brick")


class PanicException(BaseException):
    """What engines in Rust raise."""


class Panics(Passed):
    def advance(self, seconds):
        raise PanicException("assertion failed: radius.is_sign_positive()")


def results_of(engine, *only):
    return {one.check: one for one in run_checks(engine, only=only)}


def simulated_by(simulation):
    return Faulty(MUJOCO, Fault(simulation=simulation))


def test_an_error_of_the_engine_has_its_place():
    (found,) = run_checks(simulated_by(RaisesInAdvance), only=["free-fall"])
    assert found.status is Status.ERROR
    assert "KeyError: 'brick' (advance, test_conformance.py, line" in found.diagnosis


def test_what_is_declined_is_no_failure_and_has_its_reasons():
    found = results_of(Declines(MUJOCO, Fault()), "cloth-stretch", "free-fall")
    assert found["free-fall"].status is Status.PASS
    declined = found["cloth-stretch"]
    assert (declined.status, declined.is_bad) == (Status.DECLINED, False)
    assert declined.missing == ("it knows no cloth",)


def test_an_exception_costs_its_checks():
    found = results_of(CannotBuild(MUJOCO, Fault()), "cloth-stretch", "free-fall")
    assert found["free-fall"].status is Status.PASS
    text = found["cloth-stretch"].diagnosis
    assert "supports() was true, but build() raised KeyError: 'mesh' (build, " in text


class VersionOfText(Faulty):
    def versions(self):
        return "1.0"


def test_versions_that_are_no_texts_by_package_are_named():
    with pytest.raises(BackendError, match=r"versions returned '1.0', expected texts"):
        run_checks(VersionOfText(MUJOCO, Fault()), only=["time"])


def test_a_panic_is_a_result_and_ctrl_c_ends_the_run(monkeypatch):
    found = results_of(simulated_by(Panics), "free-fall", "slide")
    assert {one.status for one in found.values()} == {Status.ERROR}
    assert "PanicException: assertion failed" in found["free-fall"].diagnosis

    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(Panics, "advance", interrupt)
    with pytest.raises(KeyboardInterrupt):
        results_of(simulated_by(Panics), "free-fall")


class OtherSign(Passed):
    """Reports each quaternion with the other sign at every second reading, which is the same rotation."""

    count = 0

    def body_states(self, names):
        states = super().body_states(names)
        self.count += 1
        states[..., 3:7] *= (-1.0) ** self.count
        return states


def test_the_sign_of_a_quaternion_is_no_fault():
    rigid = [one.id for one in checks() if one.phenomenon in ("contract", "restart")]
    found = results_of(simulated_by(OtherSign), *rigid, "worlds-single")
    assert {one.diagnosis for one in found.values()} == {""}


class AddsInAnyOrder(Passed):
    """Its steps end in random last digits, as those of kernels that add in any order."""

    random = np.random.default_rng(0)

    def advance(self, seconds):
        super().advance(seconds)
        noise = self.random.standard_normal(len(self.inner.data.qvel))
        self.inner.data.qvel[:] += 1e-9 * noise


@pytest.mark.parametrize(("kind", "failed"), [("bits", True), ("statistical", False)])
def test_runs_may_part_as_an_engine_declares(kind, failed):
    engine = simulated_by(AddsInAnyOrder)
    error = 0.0 if kind == "bits" else 1e-6
    declared = Repeatability(kind=kind, start_error=error)
    engine.repeatability = lambda settings=None: declared
    found = results_of(engine, "determinism", "reset-course")
    assert {one.is_bad for one in found.values()} == {failed}


def test_results_are_json():
    (found,) = run_checks(planted("friction 20 % low"), only=["slide"])
    values = json.loads(json.dumps(found.to_dict(), allow_nan=False))
    assert values["status"] == "fail"
    assert values["versions"] == MUJOCO.versions()
    assert values["settings"]["preset"] == "contact"


def test_settings_reach_the_engine_and_a_refusal_is_a_reason():
    (found,) = run_checks("mujoco", settings={"timestep_s": 1 / 900}, only=["time"])
    assert found.settings["timestep_s"] == 1 / 900
    (found,) = run_checks("mujoco", settings={"timestep": 1e-3}, only=["time"])
    assert found.status is Status.DECLINED
    assert "unknown setting" in found.missing[0]


def test_unknown_names_are_refused_before_anything_runs():
    with pytest.raises(UnknownNameError, match="free-fall"):
        run_checks("mujoco", only=["free-fal"])
    with pytest.raises(UnknownNameError, match="backend"):
        run_checks("mujko")
