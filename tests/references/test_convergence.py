"""Convergence tables: what was measured is read as written, damage is named, and reports show it."""

import json

import pytest

from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.experiments.variants import variants
from gauge_envs.files import data_folder
from gauge_envs.pages.results import convergence_text
from gauge_envs.references.convergence import (
    Convergence,
    convergence_rows,
    read_convergence,
)
from gauge_envs.references.published import published_baselines

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
FOLDER = data_folder("scoring") / "convergence"


def bundled(engine):
    return read_convergence(FOLDER / f"{engine}.csv")


@pytest.mark.parametrize("engine", ["mujoco", "newton"])
def test_bundled_rows_are_of_known_variants_and_agree_with_themselves(engine):
    rows = bundled(engine)
    known = {variant.name for variant in variants()}
    assert rows
    for (name, setting), row in rows.items():
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
    names = {name for name, setting in bundled("mujoco") if setting == "timestep_s"}
    assert {"BouncingBall-rubber", "SlopeSlider-3-metal", "Turntable-3-metal"} <= names
    assert {
        f"{family}-{m}"
        for family in ("SlopeSlider-2", "Turntable-1")
        for m in ("wood", "plastic", "metal")
    } <= names


def test_an_engine_without_a_table_was_not_measured():
    assert convergence_rows("another", "SlopeSlider-2-wood") == {}
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
    share = convergence_rows("mujoco", "SlopeSlider-2-wood")["timestep_s"]["share"]
    expected = (
        f"half step moves the trajectory by {100 * share:.2g} % of the real scatter"
    )
    shown = gauge("show", "SlopeSlider-2-wood", "--format", "wide").output
    assert expected in " ".join(shown.split())
    values = json.loads(gauge("show", "SlopeSlider-2-wood", "--json").output)
    (row,) = (row for row in values["engines"] if row["engine"] == "mujoco")
    assert row["convergence"]["timestep_s"]["share"] == share
