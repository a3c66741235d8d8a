"""The notebooks run from the first to the last cell in a plain process, and get the results in their text."""

from __future__ import annotations

import json
import re
import tomllib

import matplotlib
import pytest
from opengl import needs_opengl
from places import ROOT

NOTEBOOKS = sorted((ROOT / "examples" / "notebooks").glob("*.ipynb"))


def cells(notebook):
    cells = json.loads(notebook.read_text())["cells"]
    return cells


def run(notebook):
    """Run the code of a notebook in one namespace, and return it; the first cell installs."""
    code = [
        "".join(cell["source"])
        for cell in cells(notebook)
        if cell["cell_type"] == "code"
    ]
    namespace = {"__name__": "__main__"}
    for number, text in enumerate(code[1:], start=2):
        exec(compile(text, f"{notebook.name}, code {number}", "exec"), namespace)
    return namespace


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda file: file.stem)
def test_a_notebook_first_installs_its_packages_and_has_no_output(
    notebook,
):
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"][
        "optional-dependencies"
    ]
    code = [cell for cell in cells(notebook) if cell["cell_type"] == "code"]
    installed = re.fullmatch(
        r'# [\w ]+\.\n%pip install -q "../..\[([\w,]+)\]"', "".join(code[0]["source"])
    )
    assert installed is not None
    assert set(installed[1].split(",")) <= set(extras)
    assert all(
        cell["outputs"] == [] and cell["execution_count"] is None for cell in code
    )


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    matplotlib.use("Agg")


def test_how_wrong():
    names = run(ROOT / "examples" / "notebooks" / "how_wrong.ipynb")
    mine, bouncy = names["mine"].score, names["bouncy"].score
    tuned, engine = names["tuned"].score, names["engine"].score
    # MuJoCo's 35.0 mm and the 6.9 mm with the real restitution are on the README; ten lines have the same constants.
    assert tuned.rmse_aligned == pytest.approx(35.0, abs=0.05)
    assert mine.rmse_aligned == pytest.approx(35.0, abs=0.5)
    assert bouncy.rmse_aligned == pytest.approx(6.9, abs=0.3)
    # The text says that the stated constant is to blame, and that MuJoCo as installed is worse.
    assert engine.rmse_aligned > 2.0 * tuned.rmse_aligned


@needs_opengl
@pytest.mark.slow
def test_real_scatter(tmp_path):
    pytest.importorskip("stable_baselines3", reason="extra 'rl' is not installed")
    names = run(ROOT / "examples" / "notebooks" / "real_scatter.ipynb")["found"]
    assert (tmp_path / "before_and_after.gif").stat().st_size > 10_000
    mean = {name: sum(values) / len(values) for name, values in names.items()}
    assert mean["law, 95 %"] == pytest.approx(0.95, abs=0.005)
    # The law holds, and both trainings improve.
    assert max(max(values) for values in names.values()) <= 1.0
    assert mean["one start"] > mean["before"]
    assert mean["scattered starts"] > mean["before"]


def test_training_setup():
    names = run(ROOT / "examples" / "notebooks" / "training_setup.ipynb")
    before = {result.id: result.verdict.value for result in names["before"].checks}
    assert before["creep-wood"] == before["rest-height"] == "failed"
    assert before["foot-creep"] == "warning"
    assert {result.verdict.value for result in names["after"].checks} == {"passed"}


def test_trials_to_settings():
    names = run(ROOT / "examples" / "notebooks" / "trials_to_settings.ipynb")
    # 0.2571 is the mean of all twenty in scoring/facts/slope_slider_30deg_summary.toml, made by another program.
    assert names["friction"] == pytest.approx(0.2571, abs=3 * names["error"])
    apart = {
        name: abs(value - names["real"].mean())
        for name, value in names["accelerations"].items()
    }
    assert apart["yours"] < apart["published"]
    assert names["recipe"].reached["friction"] == pytest.approx(
        names["aim"].friction, abs=0.002
    )
