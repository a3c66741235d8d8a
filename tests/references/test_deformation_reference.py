"""Real statistics of deformation from the recordings: what was measured and no more; damaged files are named."""

import numpy as np
import pytest

from gauge_envs.errors import ShapeError
from gauge_envs.observables.deformation import STATISTICS
from gauge_envs.references.deformation import DeformationReference, bundled_deformation

FAMILIES = (
    "FoamStretching",
    "FoamCompressing",
    "FoamShearing",
    "FoamTwisting",
    "FoamBending",
    "CantileverBeam",
)
FREE_SPAN_M = 0.1743


def column(reference, name):
    index = reference.statistics.index(name)
    return reference.mean[:, index], reference.sigma[:, index]


@pytest.mark.parametrize("family", FAMILIES)
def test_soft_and_hard_share_a_recording_and_say_so(family):
    soft, hard = (bundled_deformation(f"{family}-{foam}") for foam in ("soft", "hard"))
    assert set(soft.statistics) <= set(STATISTICS)
    assert soft.statistics == hard.statistics and soft.trial_count == 1
    shared = min(len(soft.mean), len(hard.mean))
    np.testing.assert_array_equal(soft.mean[:shared], hard.mean[:shared])
    assert soft.note is not None and "which one is not known" in soft.note
    assert (np.isfinite(soft.mean) == np.isfinite(soft.sigma)).all()
    assert (soft.sigma[np.isfinite(soft.sigma)] > 0).all()


@pytest.mark.parametrize("family", FAMILIES[:-1])
def test_deformation_starts_at_none(family):
    """Within three times the uncertainty. The first known frame of the beam is in its swing."""
    reference = bundled_deformation(f"{family}-soft")
    rest = [
        0.0 if name.startswith(("strain", "non")) else 1.0
        for name in reference.statistics
    ]
    assert (np.abs(reference.mean[0] - rest) < 3 * reference.sigma[0]).all()


def test_lateral_strain_and_volume_go_with_the_axial_strain():
    reference = bundled_deformation("FoamStretching-soft")
    (axial, _), (lateral, lateral_sigma) = (
        column(reference, "strain.zz"),
        column(reference, "strain.lateral"),
    )
    volume, volume_sigma = column(reference, "volume_ratio")
    assert axial[29] > 0.03 and lateral[29] < 0
    assert volume[29] == pytest.approx(
        (1 + axial[29]) * (1 + lateral[29]) ** 2, abs=5e-4
    )
    # The scale of all sections is off by the same share, so that both directions go together.
    assert volume_sigma[29] == pytest.approx(2 * lateral_sigma[29], rel=0.06)


def test_other_variants_have_none():
    assert bundled_deformation("SlopeSlider-2-wood") is None


def test_shapes_must_agree():
    with pytest.raises(ShapeError, match="both must be"):
        DeformationReference(
            statistics=("strain.zz",),
            markers=None,
            mean=np.zeros((3, 1)),
            sigma=np.zeros((3, 2)),
            trial_count=1,
            source="made up",
        )
