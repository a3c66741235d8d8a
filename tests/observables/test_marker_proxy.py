"""The default marker proxy scores the material, the node of the paper scores the mesh."""

import json
from dataclasses import replace

import numpy as np
import pytest

from gauge_envs.envs.arguments import EnvArguments
from gauge_envs.observables.observer import MarkerProxy
from gauge_envs.pages.results import configuration_labels
from gauge_envs.runs.configuration import RunConfiguration
from gauge_envs.runs.episodes import run_episode
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result import Result
from gauge_envs.runs.result_file import load_result, result_file_name, write_result


@pytest.mark.slow
@pytest.mark.parametrize("name", ["FoamShearing-soft", "FoamTwisting-soft"])
def test_the_node_scores_the_mesh(name):
    """The faces of the recordings have 208.33 mm^2 at rest; those of the nearest nodes are a third larger or more."""
    node, material = (
        run_episode(RunRequest(name, marker_proxy=proxy))
        for proxy in ("node", "material")
    )
    assert node.score.rmse > 5.0 * material.score.rmse
    areas = [np.array(one.trajectory.samples)[0] for one in (material, node)]
    assert areas[0] == pytest.approx(625.0 / 3.0, abs=0.01)
    assert areas[1].min() > 1.3 * 625.0 / 3.0


def test_material_points_are_the_default_of_environments_runs_and_results():
    assert EnvArguments("FoamStretching-soft").proxy is MarkerProxy.MATERIAL
    assert RunRequest("FoamStretching-soft") == RunRequest(
        "FoamStretching-soft", marker_proxy="material"
    )
    assert {
        one.__dataclass_fields__["marker_proxy"].default
        for one in (Result, RunConfiguration)
    } == {"material"}


def test_an_old_result_without_the_key_is_by_node(tmp_path):
    result = run_episode(RunRequest("BouncingBall-rubber"))
    file = tmp_path / result_file_name(result)
    write_result(result, file)
    assert file.name == "BouncingBall-rubber.mujoco.calibrated.json"
    assert load_result(file).marker_proxy == "material"
    content = json.loads(file.read_text())
    del content["marker_proxy"], content["asset"]
    file.write_text(json.dumps(content))
    old = load_result(file)
    assert old == replace(result, marker_proxy="node")
    assert result_file_name(old) == "BouncingBall-rubber.mujoco.calibrated.node.json"
    (label,) = configuration_labels([RunConfiguration.of(old)])
    assert "markers by node" in label
