"""Guide to add a check: the file works, its commands run, and the check finds the planted fault."""

import ast
import importlib
import importlib.util
import re
import shlex
import sys
from pathlib import Path

import faults
import pytest
from places import ROOT
from texts import fenced
from typer.testing import CliRunner

from gauge_envs.backends import backend
from gauge_envs.cli.app import app
from gauge_envs.tools.conformance import Status, catalog, run_checks

RUNNER = CliRunner()


def blocks(page, language):
    return fenced(ROOT / "docs" / page, language)


@pytest.fixture
def parts(request, tmp_path, monkeypatch):
    """Import the file of a guide under its name in the package."""
    named = {
        "".join(re.findall(r"\A# (\S+\.py)\n", block)): block
        for block in blocks(request.param, "python")
    }
    (path,) = (name for name in named if name.startswith("gauge_envs/"))
    name = path.removesuffix(".py").replace("/", ".")
    assert not (ROOT / path).exists()
    file = tmp_path / Path(path).name
    file.write_text(named.pop(path))
    monkeypatch.chdir(tmp_path)
    spec = importlib.util.spec_from_file_location(name, file)
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, name, module)
    spec.loader.exec_module(module)
    return module, named


def guide(page):
    return pytest.mark.parametrize("parts", [page], indirect=True)


def outputs(page, start):
    """Run the commands of a guide with a prefix, and return their outputs."""
    lines = [
        line
        for block in blocks(page, "sh")
        for line in block.splitlines()
        if line.startswith(start)
    ]
    assert lines
    results = [RUNNER.invoke(app, shlex.split(line)[1:]) for line in lines]
    assert [result.output for result in results if result.exit_code] == []
    return [result.stdout for result in results]


def value_of(code, names):
    """Return the value of the only expression of a block."""
    (statement,) = ast.parse(code).body
    assert isinstance(statement, ast.Expr)
    return eval(compile(ast.Expression(statement.value), "guide", "eval"), names)


@pytest.mark.parametrize("page", ["adding_a_check.md"])
def test_the_tests_that_a_guide_runs_exist(page):
    lines = [
        line
        for block in blocks(page, "sh")
        for line in block.splitlines()
        if line.startswith("python ")
    ]
    files = [word for line in lines for word in line.split() if word.endswith(".py")]
    assert files
    assert [file for file in files if not (ROOT / file).is_file()] == []


# --- a check ---------------------------------------------------------------------------------------------------------


@guide("adding_a_check.md")
def test_the_check_passes_and_is_the_only_one_that_its_fault_fails(parts, monkeypatch):
    module, names = parts
    monkeypatch.setattr(catalog, "MODULES", [*catalog.MODULES, module])
    listed, ran = (
        outputs("adding_a_check.md", "gauge list"),
        outputs("adding_a_check.md", "gauge backend check mujoco "),
    )
    assert "fast-flight" in listed[0]
    assert "pass" in ran[0]
    entry = "{" + names["tests/faults.py"] + "}"
    ((name, fault),) = value_of(entry, vars(faults)).items()
    assert name not in faults.FAULTS
    mutant = faults.Faulty(backend("mujoco"), fault)
    results = run_checks(
        mutant,
        only=["free-*", "start-*", "spin-m*", "slide", "rebound-0*", "fast-flight"],
    )
    (failed,) = [result for result in results if result.status is not Status.PASS]
    assert failed.check == fault.caught_by
    assert fault.says in failed.diagnosis
