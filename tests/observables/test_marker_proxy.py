"""The default marker proxy scores the material, the node of the paper scores the mesh."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from gauge_envs.envs.arguments import EnvArguments
from gauge_envs.observables.observer import MarkerProxy
from gauge_envs.pages.results import result_label
from gauge_envs.runs.configuration import RunConfiguration
from gauge_envs.runs.episodes import run_episode
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result import Result
from gauge_envs.runs.result_file import load_result, result_file_name, write_result


def foam(name: str, **options: str) -> Result:
    return run_episode(RunRequest(name, use_withheld=True, **options))


@pytest.mark.parametrize(
    ("name", "by_node", "by_material"),
    [
        pytest.param("FoamStretching-soft", 75.32, 7.021, marks=pytest.mark.slow),
        pytest.param("FoamShearing-soft", 116.8, 10.05, marks=pytest.mark.slow),
        pytest.param("FoamBending-soft", 63.14, 8.883, marks=pytest.mark.slow),
        pytest.param("FoamTwisting-soft", 53.30, 4.739, marks=pytest.mark.slow),
    ],
)
def test_the_node_scores_the_mesh(
    name: str, by_node: float, by_material: float
) -> None:
    """Normalized RMSE against the withheld bands; the faces of the recordings have 208 mm^2 at rest."""
    node, material = foam(name, marker_proxy="node"), foam(name)
    assert node.score.rmse_normalized == pytest.approx(by_node, rel=1e-3)
    assert material.score.rmse_normalized == pytest.approx(by_material, rel=1e-3)
    assert material.trajectory is not None and node.trajectory is not None
    areas = (
        np.array(material.trajectory.samples)[0],
        np.array(node.trajectory.samples)[0],
    )
    assert areas[0] == pytest.approx(208.33, abs=0.01)
    assert (areas[1].min(), areas[1].max()) == pytest.approx((272.3, 408.5), abs=0.1)


def test_material_points_are_the_default_of_environments_runs_and_results() -> None:
    assert EnvArguments("FoamStretching-soft").proxy is MarkerProxy.MATERIAL
    assert RunRequest("FoamStretching-soft") == RunRequest(
        "FoamStretching-soft", marker_proxy="material"
    )
    assert {
        one.__dataclass_fields__["marker_proxy"].default
        for one in (Result, RunConfiguration)
    } == {"material"}


def test_an_old_result_without_the_key_is_by_node(tmp_path: Path) -> None:
    result = run_episode(RunRequest("BouncingBall-rubber"))
    file = tmp_path / result_file_name(result)
    write_result(result, file)
    assert file.name == "BouncingBall-rubber.mujoco.calibrated.json"
    assert load_result(file).marker_proxy == "material"
    content = json.loads(file.read_text(encoding="utf-8"))
    del content["marker_proxy"]
    file.write_text(json.dumps(content), encoding="utf-8")
    old = load_result(file)
    assert old.marker_proxy == "node"
    assert result_file_name(old) == "BouncingBall-rubber.mujoco.calibrated.node.json"
    assert "markers by node" in result_label(old)
