"""A reference in words."""

from gauge_envs.evaluation.reference_path import reference_words
from gauge_envs.references.grades import BandGrade


def test_a_mean_is_named_by_the_number_of_its_trials():
    one, many, some = (reference_words(BandGrade.TRIALS, n) for n in (1, 20, None))
    assert "one" in one and "20 " in many
    assert some == many.replace("20 ", "the ") != one
