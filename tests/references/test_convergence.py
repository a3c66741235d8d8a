"""Convergence tables: what was measured is read as written, damage is named, and reports show it."""

import json

import numpy as np
import pytest
from texts import changed_text

from gauge_envs.errors import ReferenceFileError
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.experiments.variants import variants
from gauge_envs.files import data_folder
from gauge_envs.pages.results import convergence_text
from gauge_envs.references.convergence import Convergence, convergence_of
from gauge_envs.references.published import published_baselines
from scripts import build_convergence
from scripts.build_convergence import ConvergenceTable
from scripts.generated import Request

ROW = Convergence(
    variant="SlopeSlider-2-wood",
    setting="timestep_s",
    default=1e-4,
    refined=5e-5,
    unit="mm",
    rms=0.062,
    max=0.18,
    share=0.0034,
    points_rms_mm=0.062,
    points_max_mm=0.18,
)
DIVERGED = Convergence(
    variant="Funnel-satin", setting="cell_m", default=0.02, refined=0.01, unit="mm"
)
NOTES = {"engine": "mujoco 4.0.0", "date": "2026-01-31"}
TEXT = ConvergenceTable(NOTES, {}).with_rows([ROW]).text()
LINE = TEXT.splitlines()[3]


def bundled(engine):
    return ConvergenceTable.read(
        data_folder("scoring") / "convergence" / f"{engine}.csv"
    )


@pytest.mark.parametrize("engine", ["mujoco", "newton"])
def test_bundled_rows_are_of_known_variants_and_agree_with_themselves(engine):
    table = bundled(engine)
    assert {"engine", "date"} <= table.notes.keys()
    assert table.notes["engine"].startswith(engine)
    known = {variant.name for variant in variants()}
    assert table.rows
    for (name, setting), row in table.rows.items():
        assert name in known
        assert setting == "training" or row.refined == pytest.approx(
            0.5 * row.default, rel=1e-3
        )
        experiment = load_experiment(name)
        assert row.unit == experiment.score.observable.unit
        assert setting != "cell_m" or experiment.scene.deformables
        baseline = published_baselines(name).get("rmse")
        if row.rms is None:
            continue
        assert row.max is not None and row.rms <= row.max
        assert (row.share is None) == (baseline is None)
        if baseline is not None:
            assert row.share == pytest.approx(row.rms / baseline.mean, rel=2e-3)


def test_mujoco_has_half_the_step_of_every_scored_experiment():
    names = {
        name for name, setting in bundled("mujoco").rows if setting == "timestep_s"
    }
    assert {"BouncingBall-rubber", "SlopeSlider-3-metal", "Turntable-3-metal"} <= names
    assert {
        f"{family}-{m}"
        for family in ("SlopeSlider-2", "Turntable-1")
        for m in ("wood", "plastic", "metal")
    } <= names


def test_a_table_is_read_as_it_was_written(tmp_path):
    table = ConvergenceTable(NOTES, {}).with_rows([ROW, DIVERGED])
    file = tmp_path / "mujoco.csv"
    file.write_text(table.text())
    found = ConvergenceTable.read(file)
    assert found == table
    assert found.of("SlopeSlider-2-wood") == {"timestep_s": ROW}
    assert found.of("Funnel-satin")["cell_m"].rms is None
    assert found.of("SlopeSlider-2-metal") == {}


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("variant,setting", "id,setting", "line 3: columns are .*expected variant,"),
        ("timestep_s", "iterations", "line 4: setting"),
        (",0.062,", ",-0.062,", "line 4: rms"),
        (",0.062,0.18\n", ",0.062\n", "line 4: 9 fields, expected 10"),
        (f"{LINE}\n", f"{LINE}\n{LINE}\n", "line 5: .* has a row above"),
    ],
)
def test_damage_is_named(old, new, message, tmp_path):
    file = tmp_path / "mujoco.csv"
    file.write_text(TEXT)
    with pytest.raises(ReferenceFileError, match=f"mujoco.csv: {message}"):
        ConvergenceTable.read(changed_text(file, (old, new)))


def test_an_engine_without_a_table_was_not_measured():
    assert convergence_of("another", "SlopeSlider-2-wood") == {}
    assert (
        convergence_text({}, has_cells=True)
        == "half step: not measured; half cell: not measured"
    )
    assert convergence_text({}, has_cells=False) == "half step: not measured"
    unscored = ROW.model_copy(update={"share": None}).model_dump()
    expected = "half step moves the trajectory by 0.062 mm (rms of the observed points)"
    assert convergence_text({"timestep_s": unscored}, has_cells=False) == expected
    assert convergence_text({"cell_m": DIVERGED.model_dump()}, has_cells=True).endswith(
        "half cell: diverged"
    )


def test_commands_show_what_was_measured(gauge):
    share = bundled("mujoco").of("SlopeSlider-2-wood")["timestep_s"].share
    expected = (
        f"half step moves the trajectory by {100 * share:.2g} % of the real scatter"
    )
    for words in (
        ("show", "SlopeSlider-2-wood", "--format", "wide"),
        ("run", "SlopeSlider-2-wood"),
    ):
        assert expected in " ".join(gauge(*words).output.split())
    values = json.loads(gauge("show", "SlopeSlider-2-wood", "--json").output)
    (row,) = (row for row in values["engines"] if row["engine"] == "mujoco")
    assert row["convergence"]["timestep_s"]["share"] == share
    other = gauge("run", "SlopeSlider-2-wood", "--set", "impratio=1.0")
    assert "half step" not in other.output


# --- the script ------------------------------------------------------------------------------------------------------


def test_a_row_is_measured_as_stored_and_not_again(tmp_path, capsys):
    request = Request(results=tmp_path, engines=("mujoco",), ids=("BouncingBall-*",))
    build_convergence.measure(request, tmp_path)
    file = tmp_path / "convergence" / "mujoco.csv"
    row, training = ConvergenceTable.read(file).rows.values()
    assert (row.variant, row.setting, training.setting) == (
        "BouncingBall-rubber",
        "timestep_s",
        "training",
    )
    # Eight times the step; the ball falls 0.5 m.
    assert training.points_max_mm is not None and 0.0 < training.points_max_mm < 5.0
    assert training.refined > 2.0 * training.default
    kept = bundled("mujoco").of("BouncingBall-rubber")["timestep_s"]
    assert row.rms == pytest.approx(kept.rms, rel=0.05)
    capsys.readouterr()
    build_convergence.measure(request, tmp_path)
    assert capsys.readouterr().out == ""


def test_rms_is_the_distance_of_the_paper():
    frames = np.zeros((4, 3))
    moved = frames.copy()
    moved[3] = (3.0, 0.0, 4.0)
    runs = [
        build_convergence.Run(
            frames=one,
            points_m=1e-3 * one[:, None],
            settings={},
            nodes_m={},
            steps_per_s=1.0,
        )
        for one in (frames, moved)
    ]
    row = build_convergence.compare(
        "SlopeSlider-2-wood", "timestep_s", *runs, (1e-4, 5e-5)
    )
    assert (row.rms, row.max, row.points_max_mm) == pytest.approx((2.5, 5.0, 5.0))
    assert row.share == pytest.approx(2.5 / 18.0)
