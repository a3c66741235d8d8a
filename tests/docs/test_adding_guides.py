"""Guide to add a check: the file works, its commands run, and the check finds the planted fault."""

import importlib.util
import re
import shlex
import sys

import faults
import pytest
from places import ROOT
from texts import fenced

from gauge_envs.backends import backend
from gauge_envs.tools.conformance import Status, catalog, run_checks

PAGE = ROOT / "docs" / "adding_a_check.md"
CHECK, FAULT = fenced(PAGE, "python")


@pytest.fixture
def module(tmp_path, monkeypatch):
    """Import the file of the guide under its name in the package."""
    (path,) = re.findall(r"\A# (\S+\.py)\n", CHECK)
    assert not (ROOT / path).exists()
    file = tmp_path / "check.py"
    file.write_text(CHECK)
    name = path.removesuffix(".py").replace("/", ".")
    spec = importlib.util.spec_from_file_location(name, file)
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, name, module)
    spec.loader.exec_module(module)
    return module


def test_the_check_passes_and_is_the_only_one_that_its_fault_fails(
    module, monkeypatch, gauge
):
    monkeypatch.setattr(catalog, "MODULES", [*catalog.MODULES, module])
    listed, ran, tested, *_ = "".join(fenced(PAGE, "sh")).splitlines()
    assert "fast-flight" in gauge(*shlex.split(listed)[1:]).stdout
    assert gauge(*shlex.split(ran)[1:]).exit_code == 0
    (file,) = [word for word in tested.split() if word.endswith(".py")]
    assert (ROOT / file).is_file()
    ((name, fault),) = eval("{" + FAULT + "}", vars(faults)).items()
    assert name not in faults.FAULTS
    mutant = faults.Faulty(backend("mujoco"), fault)
    others = ["free-*", "start-*", "spin-m*", "slide", "rebound-0*", "fast-flight"]
    results = run_checks(mutant, only=others)
    (failed,) = [result for result in results if result.status is not Status.PASS]
    assert failed.check == fault.caught_by
    assert fault.says in failed.diagnosis
