"""Genesis's cloth: the stiffness that it has, how it is held and driven, friction, repeatability."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest

from gauge_envs import load_experiment
from gauge_envs.errors import ParameterError, UnsupportedSceneError
from gauge_envs.scene import Attachment, Cloth, Motion, Region

pytest.importorskip("genesis", reason="extra 'genesis' is not installed")

from gauge_envs.backends import backend
from gauge_envs.backends.genesis.deformables import unsupported_deformables
from gauge_envs.backends.genesis.pbd_settings import (
    SettingsPBD,
    cloth_cell_m,
    longest_timestep_s,
    pbd_presets,
    spring_stiffnesses,
)
from gauge_envs.checks.conformance import Status, run_checks

FABRICS = ("rayon", "satin", "uniform", "nylon", "oxford", "leather")


def cloth_of(fabric: str) -> Cloth:
    (cloth,) = load_experiment(f"TextileFlinging-{fabric}").scene.deformables
    assert isinstance(cloth, Cloth)
    return cloth


def measured(*patterns: str, **settings: object) -> dict[str, tuple[Status, float]]:
    """Return status and measured value of some conformance checks, by id."""
    found = run_checks("genesis", settings=settings, only=patterns)
    return {result.check: (result.status, result.measured) for result in found}


@pytest.mark.parametrize("fabric", FABRICS)
def test_springs_of_a_grid_have_the_stiffnesses_of_the_fabric(fabric: str) -> None:
    """The energy of a cell with springs k and s is minimized over the free transverse strain."""
    cloth = cloth_of(fabric)
    along, diagonal = spring_stiffnesses(cloth)
    assert along > 0.0
    # Springs along x, y and both diagonals, strains (x, y, shear): energy per area is e M e / 2.
    directions = np.array([[1, 0, 0], [0, 1, 0], [0.5, 0.5, 0.5], [0.5, 0.5, -0.5]])
    weights = np.array([along, along, 2.0 * diagonal, 2.0 * diagonal])
    compliance = np.linalg.inv(directions.T @ (weights[:, None] * directions))
    assert 1.0 / compliance[0, 0] == pytest.approx(cloth.stretch_stiffness_n_per_m, rel=1e-9)
    assert 1.0 / compliance[2, 2] == pytest.approx(cloth.shear_stiffness_n_per_m, rel=1e-9)


def test_default_cloth_has_its_stretch_shear_and_bending_stiffness() -> None:
    found = measured("cloth-stretch", "cloth-shear", "cloth-bending", "cloth-energy")
    assert {status for status, _ in found.values()} == {Status.PASS}
    assert found["cloth-stretch"][1] == pytest.approx(110.0, rel=2e-3)
    assert found["cloth-shear"][1] == pytest.approx(27.5 / 2.7, rel=0.01)
    assert found["cloth-bending"][1] == pytest.approx(6.2e-3, rel=0.02)


@pytest.mark.slow
def test_the_hinge_of_genesis_does_not_resist_bending() -> None:
    status, value = measured("cloth-bending", exact_hinges=False)["cloth-bending"]
    assert status is Status.FAIL
    assert not value < 1e3


@pytest.mark.slow
def test_nominal_compliances_at_the_rate_of_the_paper_give_a_soft_sheet() -> None:
    status, value = measured("cloth-stretch", preset="paper")["cloth-stretch"]
    assert status is Status.FAIL
    assert value < 1.0


def test_held_edges_slide_and_rest() -> None:
    found = measured("cloth-pinned-edge", "cloth-slide", "cloth-rests")
    assert {status for status, _ in found.values()} == {Status.PASS}
    assert found["cloth-rests"][1] < 0.01


@pytest.mark.slow
def test_cloth_slides_without_friction_where_genesis_has_none() -> None:
    _, value = measured("cloth-slide", body_friction=False)["cloth-slide"]
    assert value == pytest.approx(9.80665 / 2, rel=0.02)


def test_a_state_of_cloth_continues_bit_for_bit_in_another_simulation() -> None:
    scene = load_experiment("TextileFlinging-satin").scene
    genesis = backend("genesis")
    ends = []
    first = genesis.build(scene)
    first.reset(0)
    first.advance(1 / 180)
    kept = pickle.loads(pickle.dumps(first.state()))
    for simulation in (first, genesis.build(scene)):
        simulation.restore(kept)
        for _ in range(3):
            simulation.advance(1 / 180)
        ends.append(simulation.nodes("textile"))
        simulation.close()
    assert np.ptp(ends[0][:, 2]) > 0.4
    assert (ends[0] == ends[1]).all()


def test_a_step_in_which_a_spring_would_close_is_an_error() -> None:
    scene = load_experiment("TextileFlinging-oxford").scene
    with pytest.raises(ParameterError, match="choose a smaller timestep_s"):
        backend("genesis").build(scene, {"timestep_s": 1 / 900})


@pytest.mark.parametrize("fabric", FABRICS)
def test_the_default_step_is_below_the_longest_one(fabric: str) -> None:
    scene = load_experiment(f"TextileFlinging-{fabric}").scene
    settings = pbd_presets(scene)["default"]
    assert settings.timestep_s <= longest_timestep_s(cloth_of(fabric), cell_m=0.025) * (1.0 + 1e-9)
    assert settings.timestep_s <= 1 / 3600 * (1.0 + 1e-9)


def test_cells_are_small_enough_for_narrow_bodies() -> None:
    assert cloth_cell_m(load_experiment("TextileFlinging-satin").scene) == 0.025
    assert cloth_cell_m(load_experiment("TextileStretching-satin").scene) == pytest.approx(1.4 * 0.005)
    assert cloth_cell_m(load_experiment("RotatingBall-satin").scene) == 0.025


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"stretch_iterations": 4}, "nominal"),
        ({"stretch_relaxation": 0.3}, "nominal"),
        ({"mesh": "remeshed"}, "nominal"),
    ],
)
def test_effective_stiffness_needs_one_whole_iteration(changes: dict[str, object], field: str) -> None:
    scene = load_experiment("TextileFlinging-satin").scene
    with pytest.raises(ParameterError, match=field):
        backend("genesis").build(scene, changes)


def test_cloth_that_genesis_cannot_simulate_is_declined() -> None:
    settings = SettingsPBD(preset="default", timestep_s=1 / 3600)
    loaded = tuple(unsupported_deformables(load_experiment("TableclothPulling-wood").scene, settings))
    assert len(loaded) == 1
    assert "'cube' is dynamic and touches cloth" in loaded[0]
    scene = load_experiment("TextileFlinging-satin").scene
    dynamic = replace(scene, bodies=(replace(scene.bodies[0], motion=Motion.DYNAMIC), *scene.bodies[1:]), drivers=())
    assert any("moves under forces" in reason for reason in unsupported_deformables(dynamic, settings))
    face = Attachment(deformable="textile", region=Region(axis="z", side="high"), to="rod")
    with pytest.raises(UnsupportedSceneError, match="by its face"):
        backend("genesis").build(replace(scene, attachments=(face,)))
