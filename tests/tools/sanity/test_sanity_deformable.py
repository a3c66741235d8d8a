"""Checks of deformable bodies: readings against closed forms, outcomes of training settings."""

from dataclasses import replace

import numpy as np
import pytest
from sanity_cases import CHEETAH, moved

from gauge_envs.backends import backend
from gauge_envs.tools.sanity.object_checks import SLOW, object_check
from gauge_envs.tools.sanity.object_checks.measure import Measurements
from gauge_envs.tools.sanity.verdict import SanityVerdict

MUJOCO = backend("mujoco")
TIMES_S = np.linspace(0.0, 1.2, 601)
PULSE = np.sin(np.pi * TIMES_S / 1.2)
X, Y, Z = np.eye(3)


def markers_m(name):
    """Markers at rest [m], shape [marker_count, 3]."""
    return np.asarray(object_check(name).scenario.scene.markers.positions_m)


def read(name, markers, **displacements_m):
    check = object_check(name)
    return float(
        check.value(moved(check.scenario, TIMES_S, markers, **displacements_m))
    )


# --- readings of motions that are known ------------------------------------------------------------------------------


def test_lag_of_a_cube_behind_the_rod():
    displacements = {
        "rod": np.outer(-0.037 * TIMES_S, X),
        "cube": np.outer(-0.035 * TIMES_S, X),
    }
    assert read("cloth-carry", None, **displacements) == pytest.approx(2.4)


def test_sag_is_the_centre_of_the_swing():
    down_m = 1.3e-3 * (1.0 - np.cos(2.0 * np.pi * 16.4 * TIMES_S))
    markers = markers_m("cloth-sag") - down_m[:, None, None] * Z
    assert read("cloth-sag", markers) == pytest.approx(1.3, rel=0.01)


def test_fling_reads_the_angle_of_a_rigid_sheet():
    rest = markers_m("fling-lag")
    rod = object_check("fling-lag").scenario.scene.body("rod").pose.position_m
    angle = np.radians(13.0) * PULSE[:, None]
    arm = rod[2] - rest[:, 2]
    rod_m = np.outer(-0.5 * TIMES_S, Y)
    markers = np.tile(rest, (len(TIMES_S), 1, 1)) + rod_m[:, None]
    markers[..., 1] += rod[1] + arm * np.sin(angle) - rest[:, 1]
    markers[..., 2] = rod[2] - arm * np.cos(angle)
    assert read("fling-lag", markers, rod=rod_m) == pytest.approx(13.0, abs=0.01)


def test_area_of_a_face_that_grows_alike_in_all_directions():
    name = "foam-stretch"
    markers = markers_m(name) * np.linspace(1.0, 1.02, len(TIMES_S))[:, None, None]
    assert read(name, markers) == pytest.approx(100.0 * (1.02**2 - 1.0))


@pytest.mark.parametrize("stretch", [0.01, -0.02])
def test_stretch_of_a_rope(stretch):
    rope = object_check("rope-length")
    length_m = rope.scenario.scene.deformables[0].length_m
    straight = np.outer(np.linspace(0.0, length_m, 21), X)
    nodes = straight * (1.0 + stretch * PULSE)[:, None, None]
    rollout = replace(moved(rope.scenario, TIMES_S), nodes_m={"rope": nodes})
    assert rope.value(rollout) == pytest.approx(1e3 * stretch * length_m)


def test_foot_stays_behind_the_base():
    base = np.outer(0.0173 * TIMES_S, X)
    rest = markers_m("foot-lag")
    markers = rest + base[:, None]
    markers[1:, rest[:, 2].argmin(), 0] -= 2.2e-3
    assert read("foot-lag", markers, base=base) == pytest.approx(2.2)


# --- rollouts --------------------------------------------------------------------------------------------------------


def test_rejected_settings_are_not_measured_for_a_reason():
    settings = CHEETAH | {"integrator": "implicitfast"}
    measured = Measurements(MUJOCO).measure(object_check("foam-stretch"), settings)
    assert (measured.verdict, measured.value) == (SanityVerdict.NOT_MEASURED, None)
    assert "set integrator='discrete'" in measured.remark


@pytest.mark.parametrize(
    ("name", "timestep_s"),
    [("cloth-sag", 0.002), ("foam-stretch", 0.01), ("foot-lag", 0.001)],
)
def test_explicit_elasticity_diverges_and_fails(name, timestep_s):
    """MuJoCo resets a state that diverges, and a body at its start could look right."""
    settings = {"timestep_s": timestep_s, "integrator": "Euler"}
    measured = Measurements(MUJOCO).measure(object_check(name), settings)
    assert (measured.verdict, measured.value) == (SanityVerdict.FAILED, None)
    assert measured.remark.startswith("diverged: after 0.0")


@pytest.mark.slow
def test_the_preset_passes():
    measurements = Measurements(MUJOCO)
    outcomes = [measurements.measure(object_check(name), {}) for name in SLOW]
    assert {outcome.verdict for outcome in outcomes} == {SanityVerdict.PASSED}
