"""Two configurations against each other: what changes between where a policy was trained and where it runs."""

from __future__ import annotations

import json

import mujoco
import pytest
from planted import PLANTED, Planted, model_xml
from typer.testing import CliRunner

from gauge_envs.cli.app import app
from gauge_envs.errors import UnknownNameError
from gauge_envs.scene import GRAVITY_M_PER_S2
from gauge_envs.tools.sanity.comparison import Change, ChangeRow, Comparison, compare

RUNNER = CliRunner()


def model(planted: Planted | None = None) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(model_xml(planted))


def rows(comparison: Comparison) -> dict[str, ChangeRow]:
    return {row.id: row for row in comparison.rows}


def test_nothing_changes_between_equals() -> None:
    comparison = compare(model(), model(), only=["gravity,rest-height,slide-turned"])
    assert {row.change for row in comparison.rows} == {Change.NONE}
    assert comparison.changed == ()


def test_the_friction_of_a_foot_is_the_stated_one_times_what_slides() -> None:
    one = Planted(geom={"friction": "0.6"})
    other = Planted(geom={"friction": "1.2"}, option={"cone": "pyramidal"})
    found = rows(compare(model(one), model(other), only=["slide-wood", "slide-turned"]))
    straight, turned = found["foot-straight"], found["foot-turned"]
    # A real slide resolves 4 % of the friction, the half-width of the interval of the row.
    assert (straight.trained, straight.deployed) == pytest.approx((0.6, 1.2), rel=0.04)
    assert turned.trained == pytest.approx(0.6, rel=0.01)
    # Between the edges of a pyramid, friction is lower by the square root of 2 at most.
    assert turned.deployed == pytest.approx(1.2 / 2**0.5, rel=0.05)
    assert straight.change is turned.change is Change.LARGE
    assert found["slide-wood"].change is Change.NONE
    assert found["slide-turned"].change is Change.LARGE


def test_step_and_gravity_are_compared() -> None:
    fault = Planted(option={"timestep": "0.004", "gravity": "0 0 -9"})
    found = rows(compare(model(), model(fault), only=["gravity"]))
    assert set(found) == {"step", "gravity"}
    assert (found["step"].trained, found["step"].deployed) == (0.002, 0.004)
    assert found["step"].change is Change.VISIBLE
    assert (found["gravity"].trained, found["gravity"].deployed) == (9.81, 9.0)
    assert found["gravity"].change is Change.LARGE


def test_a_tilt_is_a_change_of_gravity() -> None:
    (row,) = (
        r
        for r in compare(
            model(), model(PLANTED["gravity_tilted"]), only=["gravity"]
        ).rows
        if r.id == "gravity"
    )
    assert row.trained == pytest.approx(row.deployed, abs=0.01)
    assert (row.change, row.remark) == (Change.LARGE, "the directions differ")


def test_a_backend_has_the_gravity_and_the_friction_of_the_scenes() -> None:
    found = rows(compare("mujoco", model(), only=["gravity", "slide-wood"]))
    assert found["gravity"].trained == GRAVITY_M_PER_S2
    assert found["gravity"].change is Change.NONE
    assert found["foot-straight"].trained == pytest.approx(1.0, abs=0.01)
    assert found["foot-straight"].title.endswith("over the stated one")


def test_what_is_not_measured_is_unknown() -> None:
    sliding = Planted(geom={"condim": "1"})
    found = rows(compare(model(), model(sliding), only=["creep-wood"]))
    assert found["creep-wood"].change is Change.UNKNOWN
    assert found["creep-wood"].remark.startswith("deployed: condim 1")
    late = compare(model(), model(), only=["creep-wood"], time_limit_s=0.0)
    assert rows(late)["creep-wood"].remark == (
        "trained: not measured within the time limit; deployed: not measured within the time limit"
    )
    with pytest.raises(UnknownNameError):
        compare(model(), model(), only=["colour"])


def test_the_command_compares_two_targets(tmp_path) -> None:
    margin = Planted(geom={"margin": "0.001"})
    for name, planted in {"a": None, "b": margin}.items():
        (tmp_path / f"{name}.xml").write_text(model_xml(planted))
    arguments = [
        "sanity",
        str(tmp_path / "a.xml"),
        "--against",
        str(tmp_path / "b.xml"),
        "--only",
        "rest-height",
    ]
    outcome = RUNNER.invoke(app, arguments)
    assert outcome.exit_code == 0
    assert outcome.stdout.startswith(
        "1 of 2 rows change; most of all resting height: gap between cube and board: from"
    )
    assert "rest-height" in outcome.stdout
    first, _, row = map(
        json.loads, RUNNER.invoke(app, [*arguments, "--json"]).stdout.splitlines()
    )
    assert first["deployed"]["name"] == "b.xml"
    # Margins of both geoms add up.
    assert row["deployed"] - row["trained"] == pytest.approx(2.0, abs=0.05)
    assert RUNNER.invoke(app, [*arguments, "--fail-on", "wrong"]).exit_code == 1
    assert (
        "| rest-height |"
        in RUNNER.invoke(app, [*arguments, "--format", "markdown"]).stdout
    )
    refused = RUNNER.invoke(app, [*arguments, "--out", str(tmp_path / "x.html")])
    assert refused.exit_code == 2
    assert "expected a suffix of .md, .json" in refused.output
