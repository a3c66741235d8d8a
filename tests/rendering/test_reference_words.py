"""A reference in words: the number of its trials, and where it ends."""

import numpy as np
import pytest

from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.references.kind import Kind
from gauge_envs.rendering.reference_path import (
    reference_path,
    reference_text,
    reference_words,
)
from gauge_envs.scoring.reference import reference_band


def test_a_mean_is_named_by_the_number_of_its_trials():
    one, many, some = (reference_words(Kind.TRIALS, n) for n in (1, 20, None))
    assert "one" in one and "20 " in many
    assert some == many.replace("20 ", "the ") != one


def test_the_text_says_when_a_reference_ends_before_the_pictures():
    experiment = load_experiment("SlopeContact-wood")
    band = reference_band(experiment)
    path = reference_path(experiment, band)
    assert band is not None and path is not None
    # The law holds while the body slides down the seam: for 5 of 10 frames.
    assert np.isfinite(band.mean).all(axis=1).tolist() == [True] * 5 + [False] * 5
    assert path.last_s == pytest.approx(4 / 30)
    assert reference_text(band, path, end_s=0.3).endswith(", until 0.13 s")
    assert "until" not in reference_text(band, path, end_s=4 / 30)
