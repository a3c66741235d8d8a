"""The ride on a pulled cloth: the catenary of its uncertainty, the condition on friction, and a planted fault."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import quad, solve_bvp

from gauge_envs import GaugeEnv, load_experiment
from gauge_envs.errors import ShapeError
from gauge_envs.references.published import PulledLaw, law_for
from gauge_envs.scoring.laws import pulled

GRAVITY = 9.80665
SPEED_M_PER_S = 1 / 27
"""111.111 mm in three seconds."""


def law() -> PulledLaw:
    found = law_for("TableclothPulling-wood")
    assert isinstance(found, PulledLaw)
    return found


def lag_over_u(parameters: str | dict[str, float]) -> float:
    """Return the distance of the cube from the law along the pull over its uncertainty, rms over twenty frames."""
    env = GaugeEnv("TableclothPulling-metal", parameters=parameters)
    scene = load_experiment("TableclothPulling-metal").scene
    positions_mm, uncertainty_mm = pulled(law(), scene, 21)
    env.reset(seed=0)
    x_mm = [env.step(np.zeros(1))[0]["observable"][0] for _ in range(20)]
    lag_mm = np.array(x_mm) - positions_mm[1:, 0]
    return float(np.linalg.norm(lag_mm) / np.linalg.norm(uncertainty_mm[1:, 0]))


@pytest.mark.parametrize("material", ["wood", "plastic", "metal"])
def test_the_cube_moves_with_the_rod(material: str) -> None:
    experiment = load_experiment(f"TableclothPulling-{material}")
    positions, uncertainty = pulled(law(), experiment.scene, 90)
    moved = positions - 1e3 * np.array(experiment.scene.body("cube").pose.position_m)
    assert moved[:, 0] == pytest.approx(
        -1e3 * SPEED_M_PER_S * np.arange(90) / 30, abs=1e-3
    )
    assert moved[:, 1:] == pytest.approx(np.zeros((90, 2)), abs=1e-9)
    assert np.isfinite(uncertainty).all() and (uncertainty[:, 1:] == 0.0).all()
    # The cube stays on the table: it starts 333 mm behind the edge.
    assert positions[-1, 0] > 1e3 * (0.78265 - 0.4) + 25.0


@pytest.mark.parametrize(("material", "kg"), [("wood", 0.0938), ("metal", 0.3422)])
def test_the_sag_is_the_integrated_hanging_cloth(material: str, kg: float) -> None:
    """Weight q per length of arc and level tension T: T y'' = q sqrt(1 + y'^2), solved as a boundary value problem."""
    _, uncertainty = pulled(
        law(), load_experiment(f"TableclothPulling-{material}").scene, 91
    )
    span = 0.78265 - 0.4 - 0.36220 + 3.0 * SPEED_M_PER_S
    weight = 0.096011 / (0.445 * 0.4) * GRAVITY
    tension = 0.1 * GRAVITY * (0.096011 * (1.0 - span / 0.445) + kg) / 0.4
    x = np.linspace(0.0, span, 200)
    shape = solve_bvp(
        lambda _, y: np.array([y[1], weight / tension * np.sqrt(1.0 + y[1] ** 2)]),
        lambda low, high: np.array([low[0], high[0]]),
        x,
        np.zeros((2, 200)),
        tol=1e-9,
    )
    arc, _ = quad(
        lambda at: math.sqrt(1.0 + shape.sol(at)[1] ** 2), 0.0, span, epsabs=1e-12
    )
    sag_mm = 1e3 * (arc - span)
    stretch_mm = 1e3 * tension / 1308.3985 * (0.71605 - 0.36220)
    slip_mm = (
        1e3
        * SPEED_M_PER_S**2
        / (2 * GRAVITY * {"wood": 0.48259, "metal": 0.385805}[material])
    )
    rest_mm = math.hypot(stretch_mm, slip_mm, 2.0 * 3.0)
    assert uncertainty[90, 0] == pytest.approx(math.hypot(sag_mm, rest_mm), rel=2e-3)
    # Limit of a taut cloth: q^2 s^3 / (24 T^2).
    assert sag_mm == pytest.approx(
        1e3 * weight**2 * span**3 / (24.0 * tension**2), rel=0.15
    )


def test_a_cloth_is_needed() -> None:
    scene = load_experiment("TableclothPulling-wood").scene
    with pytest.raises(ShapeError, match="rod no box"):
        pulled(law().model_copy(update={"table": "rod"}), scene, 90)


@pytest.mark.slow
def test_a_cube_without_friction_is_worse_than_the_uncertainty() -> None:
    """A cube of ice stays where it is, 25 mm behind after two thirds of a second; the calibrated one agrees."""
    assert lag_over_u("calibrated") < 1.96
    assert lag_over_u({"cube.friction": 0.001}) > 5.0
