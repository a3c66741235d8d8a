"""A reference in words: the number of its trials."""

from gauge_envs.references.kind import Kind
from gauge_envs.rendering.reference_path import reference_words


def test_a_mean_is_named_by_the_number_of_its_trials():
    one, many, some = (reference_words(Kind.TRIALS, n) for n in (1, 20, None))
    assert "one" in one and "20 " in many
    assert some == many.replace("20 ", "the ") != one
