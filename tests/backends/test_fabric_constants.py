"""Fabric constants in each engine's terms: they return what was measured, or say what they lose."""

import json
import math

import mujoco
import numpy as np
import pytest
from hypothesis import given, strategies as st

from gauge_envs import load_experiment
from gauge_envs.backends.genesis.fabrics import pbd_constants
from gauge_envs.backends.mujoco.fabrics import flex_constants
from gauge_envs.backends.newton.fabrics import vbd_constants
from gauge_envs.errors import ParameterError
from gauge_envs.experiments.task_files import fabrics
from gauge_envs.scene import GRAVITY_M_PER_S2
from gauge_envs.scene.fabrics import Fabric, bending_length_m, plate_bending_stiffness
from gauge_envs.tools.recipes.fabrics import fabric_constants
from gauge_envs.tools.usd.isaac_fabric import surface_constants

SIX = fabrics("TextileFlinging")
NAMES = ("rayon", "satin", "uniform", "nylon", "oxford", "leather")
CONSTANTS = {
    "isaac": {"youngs_modulus", "poissons_ratio", "surfaceBendStiffness"},
    "genesis": {"stretch_compliance", "bending_compliance"},
    "newton": {"tri_ke", "tri_ka", "edge_ke_times_mean_edge_length"},
    "mujoco": {
        "young",
        "poisson",
        "thickness",
        "membrane_warp",
        "membrane_weft",
        "membrane_shear",
    },
}


def fabric(**changes):
    values = {
        "stretch_stiffness_n_per_m": 300.0,
        "shear_stiffness_n_per_m": 120.0,
        "bend_stiffness_n_m_per_rad": 6e-6,
        "thickness_m": 2e-4,
        "areal_density_kg_per_m2": 0.15,
    }
    return Fabric(**(values | changes))


positive = st.floats(1e-3, 1e5)
any_fabric = st.builds(
    lambda stretch, ratio, bend, thickness: fabric(
        stretch_stiffness_n_per_m=stretch,
        shear_stiffness_n_per_m=stretch / ratio,
        bend_stiffness_n_m_per_rad=bend,
        thickness_m=thickness,
    ),
    positive,
    st.floats(0.05, 100.0),
    st.floats(1e-8, 1e-2),
    st.floats(1e-5, 1e-2),
)


# --- where the fabrics are from ---


def test_six_fabrics_are_those_of_the_scenes():
    assert tuple(SIX) == NAMES
    for name, expected in SIX.items():
        (cloth,) = load_experiment(f"TextileFlinging-{name}").scene.deformables
        assert Fabric.of(cloth) == expected


@pytest.mark.parametrize(
    "family", ["TextileStretching", "TextileBending", "Funnel", "RotatingBall"]
)
def test_other_families_repeat_the_six(family):
    assert fabrics(family).items() <= SIX.items()


def test_tablecloth_is_another_nylon():
    assert fabrics("TableclothPulling").keys() == {"nylon"}
    assert fabrics("TableclothPulling")["nylon"] != SIX["nylon"]


# --- formulas ---


def test_constants_by_hand():
    given = fabric()
    assert surface_constants(given).constants == pytest.approx(
        {
            "youngs_modulus": 1.5e6,
            "poissons_ratio": 0.25,
            "surfaceBendStiffness": 187500.0,
        }
    )
    assert pbd_constants(given).constants == pytest.approx(
        {"stretch_compliance": 1 / 300, "bending_compliance": 1e6 / 6}
    )
    assert vbd_constants(given).constants == pytest.approx(
        {
            "tri_ke": 120.0,
            "tri_ka": 2 * 120 * 60 / 180,
            "edge_ke_times_mean_edge_length": 6e-6,
        }
    )
    thickness = math.sqrt(12 * 6e-6 / 300)
    assert flex_constants(given).constants == pytest.approx(
        {"young": 300 / thickness, "poisson": 0.0, "thickness": thickness}
        | {"membrane_warp": 300.0, "membrane_weft": 300.0, "membrane_shear": 120.0}
    )


@pytest.mark.parametrize(
    ("ratio", "isaac", "newton"),
    [
        (1.999, ("poissons_ratio", 0.30), True),
        (2.0, None, True),
        (2.999, None, False),
        (3.0, ("poissons_ratio", 0.45), False),
        (3.999, ("poissons_ratio", 0.45), False),
        (4.0, ("poissons_ratio", 0.45), True),
    ],
)
def test_edges_of_the_fallbacks(ratio, isaac, newton):
    given = fabric(
        stretch_stiffness_n_per_m=ratio * 128.0, shear_stiffness_n_per_m=128.0
    )
    mapped = surface_constants(given)
    assert bool(mapped.fallbacks) == (isaac is not None)
    assert mapped.replaced == (("poissons_ratio",) if isaac else ())
    assert mapped.constants["poissons_ratio"] == pytest.approx(
        isaac[1] if isaac else ratio / 2 - 1
    )
    mapped = vbd_constants(given)
    assert bool(mapped.fallbacks) == newton
    assert mapped.replaced == (("tri_ke", "tri_ka") if newton else ())
    assert mapped.constants["tri_ke"] == pytest.approx(
        ratio * 128.0 / 2.7 if newton else 128.0
    )


# --- what comes back ---


@pytest.mark.parametrize("name", NAMES)
def test_shear_stiffness_of_the_six_comes_back_or_is_stated_lost(name):
    measured = SIX[name].shear_stiffness_n_per_m
    for engine, mapped in fabric_constants(SIX[name]).items():
        returned = mapped.shear_stiffness_n_per_m
        if mapped.lost:
            assert engine != "mujoco"
            assert (
                f"{returned:.4g} N/m instead of {measured:.4g} ({returned / measured - 1:+.0%})"
                in mapped.lost[0]
            )
        else:
            assert returned == pytest.approx(measured, rel=1e-12)


def test_a_constant_that_genesis_lacks_is_a_loss_of_any_size():
    # Genesis has no shear constant, even where the measured stiffness happens to be what its springs give.
    assert "(+0%)" in pbd_constants(fabric(shear_stiffness_n_per_m=150.0)).lost[0]


@given(given=any_fabric)
def test_any_fabric(given):
    for engine, mapped in fabric_constants(given).items():
        assert mapped.engine == engine
        assert mapped.constants.keys() == mapped.units.keys() == CONSTANTS[engine]
        assert all(
            math.isfinite(value) and value >= 0.0 for value in mapped.constants.values()
        )
        assert mapped.stretch_stiffness_n_per_m == pytest.approx(
            given.stretch_stiffness_n_per_m, rel=1e-9
        )
        returned = mapped.shear_stiffness_n_per_m == pytest.approx(
            given.shear_stiffness_n_per_m, rel=1e-8
        )
        if engine == "mujoco" or not (mapped.fallbacks or engine == "genesis"):
            assert returned
            assert mapped.lost == ()
    nu = surface_constants(given).constants["poissons_ratio"]
    assert 0.0 <= nu < 0.5
    flex = flex_constants(given).constants
    plate = plate_bending_stiffness(
        hinge_stiffness_n_m_per_rad=given.bend_stiffness_n_m_per_rad
    )
    bent = flex["young"] * flex["thickness"] ** 3 / (12 * (1 - flex["poisson"] ** 2))
    assert bent == pytest.approx(plate, rel=1e-9)


# --- independent checks: energies instead of formulas ---


def membrane(energy, step=1e-4):
    """Uniaxial and shear stiffness from an energy per area of (strain xx, strain yy, engineering shear)."""
    hessian = np.empty((3, 3))
    unit = step * np.eye(3)
    for i in range(3):
        for j in range(3):
            a, b = unit[i], unit[j]
            hessian[i, j] = (
                energy(a + b) - energy(a - b) - energy(b - a) + energy(-a - b)
            ) / (4 * step**2)
    # Free transverse edges: no stress but along x.
    return 1.0 / np.linalg.inv(hessian)[0, 0], hessian[2, 2]


def neo_hookean(mu, lame):
    """Energy per area of the stable Neo-Hookean membrane in two dimensions (Smith 2018), with mu and lame + mu."""

    def energy(strain):
        F = np.array([[1 + strain[0], strain[2]], [0.0, 1 + strain[1]]])
        J = F[0, 0] * F[1, 1] - F[0, 1] * F[1, 0]
        return (
            0.5 * mu * (np.sum(F * F) - 2)
            - mu * (J - 1)
            + 0.5 * (lame + mu) * (J - 1) ** 2
        )

    return energy


@pytest.mark.parametrize("name", NAMES)
def test_newton_energy_has_the_stated_stiffnesses(name):
    mapped = vbd_constants(SIX[name])
    stretch, shear = membrane(
        neo_hookean(mapped.constants["tri_ke"], mapped.constants["tri_ka"])
    )
    assert stretch == pytest.approx(mapped.stretch_stiffness_n_per_m, rel=1e-5)
    assert stretch == pytest.approx(SIX[name].stretch_stiffness_n_per_m, rel=1e-5)
    assert shear == pytest.approx(mapped.shear_stiffness_n_per_m, rel=1e-5)


def test_genesis_springs_have_the_stated_stiffnesses():
    mapped = pbd_constants(SIX["uniform"])

    def energy(strain):
        edges = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
        stretched = edges @ np.array([[1 + strain[0], 0.0], [strain[2], 1 + strain[1]]])
        extension = np.linalg.norm(stretched, axis=1) - np.linalg.norm(edges, axis=1)
        return 0.5 / mapped.constants["stretch_compliance"] * np.sum(extension**2)

    stretch, shear = membrane(energy)
    assert stretch == pytest.approx(mapped.stretch_stiffness_n_per_m, rel=1e-4)
    assert shear == pytest.approx(mapped.shear_stiffness_n_per_m, rel=1e-4)


def cell_hinges(direction, curvature=1e-3):
    """The hinges of one cell of a unit grid with diagonals: the diagonal, and the lower and left legs.

    Returns turning angles over curvature when the sheet is bent along a direction, edge lengths, heights of triangles.
    """

    def normal(*corners):
        a, b, c = (
            np.array([*xy, 0.5 * curvature * np.dot(direction, xy) ** 2])
            for xy in corners
        )
        n = np.cross(b - a, c - a)
        return n / np.linalg.norm(n)

    lower, upper = normal((0, 0), (1, 0), (1, 1)), normal((0, 0), (1, 1), (0, 1))
    below, left = normal((0, -1), (1, 0), (0, 0)), normal((-1, 0), (0, 0), (0, 1))
    angles = [
        np.linalg.norm(np.cross(a, b))
        for a, b in ((lower, upper), (lower, below), (upper, left))
    ]
    return (
        np.array(angles) / curvature,
        np.array([math.sqrt(2), 1.0, 1.0]),
        np.array([math.sqrt(0.5), 1.0, 1.0]),
    )


@pytest.mark.parametrize(
    ("direction", "expected"),
    [
        ((1, 0), 1.0),
        ((0, 1), 1.0),
        ((math.sqrt(0.5), math.sqrt(0.5)), 2.5),
        ((math.sqrt(0.5), -math.sqrt(0.5)), 0.5),
    ],
)
def test_plate_stiffness_of_a_sheet_of_equal_hinges(direction, expected):
    angles, _, _ = cell_hinges(direction)
    assert np.sum(angles**2) == pytest.approx(expected, abs=1e-5)
    assert plate_bending_stiffness(hinge_stiffness_n_m_per_rad=2.0) == 2.0
    assert (
        plate_bending_stiffness(
            hinge_stiffness_n_m_per_rad=2.0, spacing_over_length=0.5
        )
        == 1.0
    )


def test_isaac_and_newton_hinges_on_a_square_grid():
    angles, lengths, heights = cell_hinges((1, 0))
    weights = lengths / (heights / 3)
    assert weights.tolist() == pytest.approx([6.0, 3.0, 3.0])
    assert weights.mean() == pytest.approx(4.0)
    assert np.sum(weights / weights.mean() * angles**2) == pytest.approx(0.75, abs=1e-5)
    assert np.sum(lengths / lengths.mean() * angles**2) == pytest.approx(
        3 / (2 + math.sqrt(2)), abs=1e-5
    )


def flex_energy(young, thickness, poisson):
    """MuJoCo's elastic energy [J] of a displacement of an 8 cm square sheet of 1 cm cells, and its rest points [m]."""
    model = mujoco.MjModel.from_xml_string(f"""
        <mujoco><option gravity="0 0 0" integrator="discrete"/><worldbody>
        <flexcomp name="sheet" type="grid" dim="2" count="9 9 1" spacing="0.01 0.01 0.01" mass="1" radius="0.001">
        <elasticity young="{young}" poisson="{poisson}" thickness="{thickness}" elastic2d="both"/>
        </flexcomp></worldbody></mujoco>""")
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    rest = data.flexvert_xpos.copy()

    def energy(displacement):
        data.qpos[:] = displacement.ravel()
        mujoco.mj_forward(model, data)
        return -0.5 * float(data.qfrc_passive @ displacement.ravel())

    return energy, rest


@pytest.mark.parametrize("name", NAMES)
def test_mujoco_stretches_and_bends_as_stated(name):
    flex = flex_constants(SIX[name]).constants
    energy, rest = flex_energy(flex["young"], flex["thickness"], flex["poisson"])
    area = 0.08**2
    along = np.zeros_like(rest)
    along[:, 0] = 1e-6 * rest[:, 0]
    assert 2 * energy(along) / (1e-12 * area) == pytest.approx(
        SIX[name].stretch_stiffness_n_per_m, rel=1e-4
    )
    plate = plate_bending_stiffness(
        hinge_stiffness_n_m_per_rad=SIX[name].bend_stiffness_n_m_per_rad
    )
    for axis in (0, 1):
        bent = np.zeros_like(rest)
        bent[:, 2] = 0.5e-3 * rest[:, axis] ** 2
        # Of eight rows of cells, seven hinge lines are inside.
        assert 2 * energy(bent) / (1e-6 * area) == pytest.approx(
            7 / 8 * plate, rel=1e-3
        )


def test_bending_length_balances_weight_and_bending():
    given = fabric()
    length = bending_length_m(given)
    assert (
        given.areal_density_kg_per_m2 * GRAVITY_M_PER_S2 * length** 3
        == pytest.approx(6e-6)
    )
    # Cantilever tests of clothing fabrics give about 5 to 50 mm: K_theta is plausible as a plate stiffness.
    assert all(0.005 < bending_length_m(each) < 0.05 for each in SIX.values())


# --- errors ---


@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf])
@pytest.mark.parametrize("name", Fabric.__dataclass_fields__)
def test_constants_must_be_positive(name, value):
    with pytest.raises(ParameterError, match=name):
        fabric(**{name: value})


def test_helpers_name_what_is_not_positive():
    with pytest.raises(ParameterError, match="hinge_stiffness_n_m_per_rad"):
        plate_bending_stiffness(hinge_stiffness_n_m_per_rad=0.0)
    with pytest.raises(ParameterError, match="spacing_over_length"):
        plate_bending_stiffness(
            hinge_stiffness_n_m_per_rad=1e-6, spacing_over_length=0.0
        )


# --- gauge materials ---


def test_command_prints_json(gauge):
    result = gauge("recipe", "fabrics", "--json")
    assert result.exit_code == 0
    (line,) = result.stdout.splitlines()
    values = json.loads(line)
    assert tuple(values) == NAMES
    for name, engines in values.items():
        assert {
            engine: set(constants) for engine, constants in engines.items()
        } == CONSTANTS
        for engine, constants in engines.items():
            assert constants == fabric_constants(SIX[name])[engine].constants
