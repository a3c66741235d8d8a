"""A matrix has a column for each configuration, and an engine that fails costs its own cells alone."""

import json
import shlex

import pytest

from gauge_envs.errors import UnknownNameError
from gauge_envs.tools.conformance import Status, checks
from gauge_envs.tools.conformance.matrix import (
    CANONICAL,
    MatrixColumn,
    matrix_columns,
    run_column,
)


def test_canonical_checks_exist_and_are_named_once():
    assert len(set(CANONICAL)) == len(CANONICAL)
    assert [check.id for check in checks(CANONICAL)] != []
    assert {check.id for check in checks(CANONICAL)} == set(CANONICAL)


def test_mujoco_has_a_column_for_each_solver():
    columns = matrix_columns(["mujoco:*"])
    assert [column.name for column in columns] == ["default", "PGS", "CG", "out_of_box"]
    assert [column.name for column in matrix_columns(["mujoco"])] == ["default"]


def test_a_configuration_is_chosen_by_its_name():
    columns = matrix_columns(["mujoco:PGS", "mujoco:out_*", "mujoco:PGS"])
    assert [column.name for column in columns] == ["PGS", "out_of_box"]
    assert "out_of_box" in [column.name for column in matrix_columns(["*:*"])]
    with pytest.raises(
        UnknownNameError, match=r"configuration 'out_of_bocks'; did you mean out_of_box"
    ):
        matrix_columns(["mujoco:out_of_bocks"])


def test_an_unknown_engine_is_an_error():
    with pytest.raises(UnknownNameError):
        matrix_columns(["mujokko:*"])


def test_the_command_of_a_cell_measures_the_same(gauge):
    column = next(
        one for one in matrix_columns(["mujoco:*"]) if one.name == "out_of_box"
    )
    (finding,) = run_column(column, ["free-fall"], None)
    words = shlex.split(column.command("free-fall"))
    result = gauge(*words[1:], "--json")
    assert json.loads(result.stdout)["measured"] == finding.measured
    assert json.loads(result.stdout)["settings"]["preset"] == "out_of_box"


def test_a_refused_scene_costs_one_cell():
    column = MatrixColumn(backend="mujoco", name="PGS", settings={"solver": "PGS"})
    found = list(run_column(column, ["free-fall", "foam-start", "slide-plane"], None))
    assert [one.check for one in found] == ["free-fall", "slide-plane"]
    assert list(column.refused) == ["foam-start"]
    assert column.reason == ""


def test_settings_that_no_scene_takes_are_the_reason_of_a_column():
    column = MatrixColumn(
        backend="mujoco", name="wrong", settings={"no_such_setting": 1}
    )
    assert list(run_column(column, ["free-fall"], None)) == []
    assert "no_such_setting" in column.reason


@pytest.mark.slow
def test_an_engine_that_dies_costs_its_own_cells(installed, tmp_path, gauge):
    installed("contact-crash", "at-import")
    page = tmp_path / "page.html"
    only = [word for name in ("free-fall", "slide-plane") for word in ("--only", name)]
    names = ["contact-crash", "at-import", "mujoco"]
    result = gauge("backend", "check", *names, "--out", page, "--json", *only)
    rows = [json.loads(line) for line in result.stdout.splitlines()]
    assert [(row["backend"], row["check"], row["status"]) for row in rows] == [
        ("contact-crash", "free-fall", Status.PASS),
        ("contact-crash", "slide-plane", Status.ERROR),
        ("mujoco", "free-fall", Status.PASS),
        ("mujoco", "slide-plane", Status.PASS),
    ]
    assert result.exit_code == 1
    text = page.read_text()
    assert "segmentation fault" in text
    assert "at-import" in text
    assert "SystemExit: 3" in text


@pytest.mark.parametrize(
    "options", [["x.json"], ["mujoco:PGS", "--out", "page.txt"], []]
)
def test_a_request_without_engine_or_output_is_refused(options, gauge):
    assert gauge("backend", "check", *options).exit_code == 2
