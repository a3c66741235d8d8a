"""Conformance checks name planted mistakes of engines; errors and unsupported scenes affect only their checks."""

import json
from dataclasses import replace

import numpy as np
import pytest
from faults import FAULTS, Fault, Faulty, Planted

from gauge_envs.backends import Repeatability, Support, backend
from gauge_envs.errors import BackendError, UnknownNameError
from gauge_envs.tools.conformance import Status, checks, run_checks
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


@pytest.mark.parametrize("name", FAULTS)
def test_a_check_names_the_mistake(name):
    fault = FAULTS[name]
    (result,) = run_checks(planted(name), only=[fault.caught_by])
    assert result.is_bad
    assert fault.says in f"{result.of.title}: {result.diagnosis}"


@pytest.mark.slow
@pytest.mark.parametrize("name", FAULTS)
def test_no_earlier_check_fails(name):
    ids = [check.id for check in checks()]
    earlier = ids[: ids.index(FAULTS[name].caught_by)]
    if earlier:
        assert [
            result.check
            for result in run_checks(planted(name), only=earlier)
            if result.is_bad
        ] == []


class OtherSign(Planted):
    """Reports each quaternion with the other sign at every second reading, which is the same rotation."""

    count = 0

    def body_states(self, names):
        states = super().body_states(names)
        self.count += 1
        states[..., 3:7] *= (-1.0) ** self.count
        return states


def test_the_sign_of_a_quaternion_is_not_a_fault():
    ids = ("start-orientation", "glide-reports", "determinism", "worlds-single")
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


# --- errors and unsupported scenes of engines ------------------------------------------------------------------------


class KnowsNoCloth(Faulty):
    def supports(self, scene):
        return Support(("it knows no cloth",) if scene.deformables else ())


class CannotBuildCloth(Faulty):
    def build(self, scene, settings=None):
        if scene.deformables:
            raise KeyError("mesh")
        return super().build(scene, settings)


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
    monkeypatch.setattr(Panics, "error", KeyboardInterrupt())
    with pytest.raises(KeyboardInterrupt):
        list(run_checks(simulated_by(Panics), only=["free-fall"]))


# --- checks and results ----------------------------------------------------------------------------------------------


def test_a_result_is_json_and_has_its_numbers():
    """Coulomb: a tolerance of 1 %, and a friction that is 20 % low."""
    (result,) = run_checks(planted("friction 20 % low"), only=["slide"])
    values = json.loads(json.dumps(result.to_dict(), allow_nan=False))
    assert values["status"] == "fail"
    assert abs(values["measured"] - values["expected"]) > values["width"]
    assert values["versions"] == MUJOCO.versions()
    assert values["settings"]["preset"] == "contact"


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
