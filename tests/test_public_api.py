"""The public names of the package: each resolves, and the import loads no engine."""

from __future__ import annotations

import ast
import copy
import pickle
import subprocess
import sys
from pathlib import Path

import pytest

import gauge_envs

SOURCE = ast.parse(Path(gauge_envs.__file__).read_text(encoding="utf-8"))


def imported(statements: list[ast.stmt]) -> dict[str, str]:
    """Module of each name in `from module import name`."""
    return {
        alias.name: statement.module or ""
        for statement in statements
        if isinstance(statement, ast.ImportFrom)
        for alias in statement.names
    }


def type_checking_imports() -> dict[str, str]:
    (block,) = [
        node
        for node in SOURCE.body
        if isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"
    ]
    return imported(block.body)


@pytest.mark.parametrize("name", gauge_envs.__all__)
def test_every_public_name_resolves_and_is_listed(name: str) -> None:
    assert getattr(gauge_envs, name) is not None
    assert name in dir(gauge_envs)


def test_type_checkers_see_the_lazy_names() -> None:
    assert type_checking_imports() == gauge_envs._LAZY


def test_all_is_what_is_defined_lazily_or_at_once() -> None:
    at_once = {*imported(SOURCE.body), *(node.name for node in SOURCE.body if isinstance(node, ast.FunctionDef))}
    assert set(gauge_envs.__all__) - set(gauge_envs._LAZY) <= at_once
    assert set(gauge_envs._LAZY) < set(gauge_envs.__all__)
    assert gauge_envs.__all__ == sorted(gauge_envs.__all__)


def test_lazy_names_are_the_objects_of_their_modules() -> None:
    for name, module in gauge_envs._LAZY.items():
        assert getattr(gauge_envs, name) is getattr(sys.modules[module], name)


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="'gauge_envs' has no attribute 'GaugeEnvs'"):
        _ = gauge_envs.GaugeEnvs


def test_a_star_import_gives_all_names() -> None:
    scope: dict[str, object] = {}
    exec("from gauge_envs import *", scope)
    assert set(gauge_envs.__all__) <= set(scope)


@pytest.mark.parametrize("name", ["GaugeEnv", "Jitter", "load_experiment"])
def test_lazy_names_pickle(name: str) -> None:
    value = getattr(gauge_envs, name)
    assert pickle.loads(pickle.dumps(value)) is copy.copy(value) is value


def test_the_import_loads_neither_an_engine_nor_scipy_nor_pydantic() -> None:
    heavy = ("scipy", "mujoco", "pydantic", "newton", "warp", "matplotlib")
    code = f"import sys, gauge_envs; print([name for name in {heavy!r} if name in sys.modules])"
    run = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert run.stdout.strip() == "[]"
