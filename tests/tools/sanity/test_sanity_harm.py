"""The guard against hops: closed forms, and MuJoCo's stiff and soft contacts."""

import math

import pytest

from gauge_envs.backends import backend
from gauge_envs.scene import GRAVITY_M_PER_S2 as G
from gauge_envs.tools.sanity.fixes.harm import FAST_M_PER_S, FRICTION, hop_mm, hops_more
from gauge_envs.tools.sanity.object_checks.measure import Measurements

MUJOCO = Measurements(backend("mujoco"))
DEFAULT = {"preset": "out_of_box"}


@pytest.mark.parametrize(
    ("cone", "impratio"), [("pyramidal", 1.0), ("elliptic", 100.0)]
)
def test_time_constants_of_two_steps_lift_what_slides(cone, impratio):
    settings = DEFAULT | {"cone": cone, "impratio": impratio}
    soft, stiff, short = (
        hop_mm(MUJOCO, settings | {"contact_solref": (time_s, 1.0)})
        for time_s in (0.02, 0.004, 0.002)
    )
    lifted = 1e3 * (FRICTION * FAST_M_PER_S) ** 2 / (2.0 * G)
    assert stiff == pytest.approx(lifted, rel=0.15)
    # MuJoCo raises shorter time constants to two steps.
    assert short == stiff
    assert 1.0 < soft < 0.2 * lifted
    assert hops_more(soft, stiff) and not hops_more(stiff, soft)


def test_the_preset_stays_on_the_ground_and_stops_by_coulombs_law():
    assert 0.0 <= hop_mm(MUJOCO, {}) < 1.0
    assert hop_mm(MUJOCO, {"friction_scale": 0.8}) == math.inf


def test_a_hop_that_is_not_measured_rejects_no_change():
    unmeasured = hop_mm(MUJOCO, {"colour": "red"})
    assert math.isnan(unmeasured) and not hops_more(1.0, unmeasured)
    assert not hops_more(unmeasured, 0.5)
    diverging = {
        "timestep_s": 0.01,
        "refsafe": False,
        "contact_solref": (0.002, 1.0),
    }
    assert hops_more(5.0, hop_mm(MUJOCO, diverging))
