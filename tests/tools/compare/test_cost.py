"""Error over cost in compare: its table, its rows and its picture."""

import json

import pytest
from cost_results import STEPS_S, made, sweep, wrong_step

from gauge_envs.errors import ShapeError
from gauge_envs.pages.document import as_markdown, as_rows
from gauge_envs.runs.result_file import result_file_name, write_result
from gauge_envs.tools.compare.cost import cost_curves, cost_document


def curves(results):
    return cost_curves(results, [])


def test_each_setting_has_a_row_with_its_errors_and_cost():
    (curve,) = curves(sweep())
    rows = as_rows(cost_document([curve]))
    steps_s = [row["effort"]["timestep_s"] for row in rows]
    numerical = [row["numerical"] for row in rows]
    assert steps_s == pytest.approx(list(STEPS_S))
    assert numerical[-1] == 0.0 and rows[-1]["is_converged"]
    # A first-order error: the distance to the finest step is in proportion to h - h_finest.
    assert [one / numerical[3] for one in numerical[:-1]] == pytest.approx(
        [15.0, 7.0, 3.0, 1.0], rel=1e-6
    )
    assert rows[0]["resolution"] == pytest.approx(numerical[3])
    assert {row["to_reality"] for row in rows} == {0.5}
    # The recorded motion has 0.6 s.
    assert [row["cost"] for row in rows] == pytest.approx(
        [5e-4 / step_s / 0.6 for step_s in STEPS_S]
    )


def test_the_sufficient_step_is_the_largest_below_the_real_scatter():
    (curve,) = curves(sweep())
    scatter = curve.measure.scatter
    assert scatter is not None
    sufficient = curve.sufficient()
    for setting in curve.main_line:
        is_below = setting.numerical is not None and setting.numerical <= scatter
        assert is_below == (setting.step_s <= sufficient.step_s)


def test_costs_are_relative_to_mujoco_with_its_defaults():
    usual = made(step_s=STEPS_S[1], given={}, cpu_s=0.1)
    slower = sweep(backend="rapier", steps_s=STEPS_S[1:2], cpu_s=0.4)
    document = cost_document(curves([usual, *slower]))
    ratios = {row["engine"]: row["cost_ratio"] for row in as_rows(document)}
    assert ratios == {"mujoco": 1.0, "rapier": pytest.approx(4.0)}
    assert "| mujoco |" in as_markdown(document)


def test_results_that_did_not_run_or_are_jittered_are_named():
    notes = []
    cost_curves(
        [*sweep(), *sweep(jitter={"position_m": 1e-3}), made(wall_s=None)], notes
    )
    assert sum("jittered" in note for note in notes) == len(STEPS_S)
    assert sum("has no time" in note for note in notes) == 1
    with pytest.raises(ShapeError, match="no result"):
        curves([made(wall_s=None)])


def test_the_command_writes_a_picture_a_table_and_all_numbers(tmp_path, gauge):
    pytest.importorskip("matplotlib")
    (tmp_path / "in").mkdir()
    for result in [*sweep(), *sweep(wrong_step, backend="rapier")]:
        write_result(result, tmp_path / "in" / result_file_name(result))
    arguments = ["plot", tmp_path / "in", "--kind", "cost", "--out", tmp_path / "out"]
    done = gauge(*list(map(str, arguments)))
    assert done.exit_code == 0, done.output
    assert (tmp_path / "out" / "pareto.png").stat().st_size > 10_000
    assert len(json.loads((tmp_path / "out" / "pareto.json").read_text())) == 2 * len(
        STEPS_S
    )
    assert (tmp_path / "out" / "pareto.md").read_text().count("SlopeSlider-2-wood") == 2
