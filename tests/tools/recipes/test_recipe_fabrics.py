"""Recipes of fabrics: what simulated strips reach, a planted fault, and a snippet in a plain loop of MuJoCo."""

import numpy as np
import pytest

from gauge_envs.backends.mujoco import cloth as mujoco_cloth
from gauge_envs.backends.mujoco.fabrics import flex_constants
from gauge_envs.errors import ParameterError
from gauge_envs.experiments.task_files import fabrics
from gauge_envs.scene.fabrics import plate_bending_stiffness
from gauge_envs.scoring.estimators import hann_mean
from gauge_envs.tools.recipes.fabrics import NOTHING_LOST, fabric_recipe, fabric_snippet

SATIN = fabrics("TextileFlinging")["satin"]
G = 9.80665


def test_strips_of_satin_reach_what_was_measured():
    found = fabric_recipe("satin", SATIN, "mujoco")
    assert found.misses == ()
    assert found.reached["stretch_n_per_m"] == pytest.approx(
        SATIN.stretch_stiffness_n_per_m, rel=0.02
    )
    assert found.reached["bend_n_m"] == pytest.approx(
        SATIN.bend_stiffness_n_m_per_rad, rel=0.2
    )
    assert found.explanation == NOTHING_LOST


def test_a_fabric_of_isaac_is_not_simulated():
    found = fabric_recipe("satin", SATIN, "isaac")
    assert set(found.reached.values()) == {None}
    assert "nothing is simulated" in found.explanation


def test_a_membrane_of_half_the_stiffness_is_found(monkeypatch):
    """A planted fault in the engine."""
    kept = mujoco_cloth._membrane

    def halved(*arguments):
        return 0.5 * kept(*arguments)

    monkeypatch.setattr(mujoco_cloth, "_membrane", halved)
    found = fabric_recipe("satin", SATIN, "mujoco")
    assert found.misses == ("stretch_n_per_m",)
    assert found.reached["stretch_n_per_m"] == pytest.approx(
        0.5 * SATIN.stretch_stiffness_n_per_m, rel=0.02
    )
    assert "0.5" in found.explanation


def sag_over_expected(snippet):
    """Sag of a strip of a plain flex over that of springs in a row, which have the mass of its vertices."""
    import mujoco as mj

    columns, rows, cell = 13, 4, 0.025
    width = (rows - 1) * cell
    mass = SATIN.areal_density_kg_per_m2 * (columns - 1) * cell * width
    model = mj.MjModel.from_xml_string(
        f'<mujoco><option timestep="2e-4" gravity="{G} 0 0"/><worldbody>'
        f'<flexcomp name="cloth" type="grid" dim="2" count="{columns} {rows} 1" spacing="{cell} {cell} {cell}" '
        f'mass="{mass}" radius="1e-4">{snippet}<contact contype="0" conaffinity="0" selfcollide="none"/>'
        f'<pin gridrange="0 0 0 {rows - 1}"/></flexcomp></worldbody></mujoco>'
    )
    data = mj.MjData(model)
    mj.mj_forward(model, data)
    start, ends = data.flexvert_xpos[:, 0].copy(), []
    last = start > start.max() - 1e-6
    for _ in range(2000):
        mj.mj_step(model, data)
        ends.append(float((data.flexvert_xpos[last, 0] - start[last]).mean()))
    # The spring of column i carries the columns below it, each of which has an equal share of the mass.
    load = mass * G * sum(range(1, columns)) / columns
    expected = load * cell / (SATIN.stretch_stiffness_n_per_m * width)
    return float(hann_mean(np.array(ends))) / expected


def test_the_snippet_stretches_in_a_plain_loop_of_mujoco():
    snippet = fabric_snippet(flex_constants(SATIN))
    assert sag_over_expected(snippet) == pytest.approx(1.0, rel=0.02)


def test_a_flex_has_the_bending_stiffness_of_the_fabric():
    """Of a plate: young * thickness^3 / (12 (1 - nu^2)), with the thickness that gives the measured stretch."""
    of = flex_constants(SATIN).constants
    plate = of["young"] * of["thickness"] ** 3 / (12.0 * (1.0 - of["poisson"] ** 2))
    hinge = SATIN.bend_stiffness_n_m_per_rad
    assert plate == pytest.approx(
        plate_bending_stiffness(hinge_stiffness_n_m_per_rad=hinge)
    )
    assert of["young"] * of["thickness"] == pytest.approx(
        SATIN.stretch_stiffness_n_per_m
    )


def test_a_snippet_with_a_wrong_unit_is_noticed():
    """A planted fault: the modulus is a tenth of the right one, as from a conversion between Pa and dyn/cm^2."""
    mapped = flex_constants(SATIN)
    young = mapped.constants["young"]
    wrong = fabric_snippet(mapped).replace(
        f'young="{young:.6g}"', f'young="{0.1 * young:.6g}"'
    )
    assert sag_over_expected(wrong) > 5.0


@pytest.mark.parametrize("engine", ["pybullet", "rapier"])
def test_an_engine_without_cloth_says_which_have_some(engine):
    with pytest.raises(ParameterError, match="choose one of"):
        fabric_recipe("satin", SATIN, engine)
