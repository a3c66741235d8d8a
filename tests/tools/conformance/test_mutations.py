"""Mutants: each planted fault is caught by a check whose diagnosis names it, on the engine itself and on any other."""

from __future__ import annotations

import pytest
from mutation_cases import ALSO
from mutations import FAULTS, Mutant, first_failure

from gauge_envs.backends import backend
from gauge_envs.tools.conformance import Status, checks, run_checks

MUJOCO = backend("mujoco")


@pytest.mark.parametrize("name", FAULTS)
def test_a_mutant_fails_the_check_that_names_its_fault(name: str) -> None:
    fault = FAULTS[name]
    (result,) = run_checks(Mutant(MUJOCO, fault), only=[fault.caught_by])
    assert result.status is Status.FAIL
    assert fault.says in result.diagnosis


@pytest.mark.parametrize(("check", "name"), ALSO.items())
def test_other_checks_catch_mutants_too(check: str, name: str) -> None:
    (result,) = run_checks(Mutant(MUJOCO, FAULTS[name]), only=[check])
    assert result.status is Status.FAIL


def test_mutants_without_a_fault_pass() -> None:
    """The wrapper itself changes nothing."""
    fault = FAULTS["slow-restitution"]
    results = list(run_checks(Mutant(MUJOCO, fault), only=["free-fall*", "slide*", "reset-*", "restore"]))
    assert {one.status for one in results} == {Status.PASS}


def test_not_finite_states_are_reported_once_and_first() -> None:
    results = list(run_checks(Mutant(MUJOCO, FAULTS["nan-mass"]), only=["finite", "free-fall*", "reset-*", "slide*"]))
    own = [one.check for one in results if one.is_bad and not one.reported_by]
    assert own == ["finite"]
    assert {one.reported_by for one in results if one.is_bad} == {"", "finite"}
    assert "'brick' is not finite" in results[0].diagnosis


@pytest.mark.slow
@pytest.mark.parametrize("name", FAULTS)
def test_the_first_failure_of_a_mutant_names_its_fault(name: str) -> None:
    fault = FAULTS[name]
    result = first_failure(Mutant(MUJOCO, fault))
    assert result is not None
    assert result.check == fault.caught_by
    assert fault.says in result.diagnosis


def test_every_check_is_listed_with_its_scene() -> None:
    assert all(one.scene for one in checks())
    assert len(FAULTS) >= 40
