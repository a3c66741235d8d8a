"""Copies among recorded tosses are no independent trials."""

import gymnasium

from gauge_envs import load_experiment, reference_band
from gauge_envs.experiments.resolve import with_trial
from gauge_envs.references.single_shot import single_shots

CUBE = "CubeToss-acrylic"


def test_trials_of_a_half_are_independent():
    shots = single_shots(CUBE)
    fit, judge = set(shots.trials("fit")), set(shots.trials("judge"))
    assert (len(shots), len(shots.trials()), len(fit), len(judge)) == (
        499,
        474,
        238,
        236,
    )
    assert fit | judge == set(shots.trials()) == set(range(499)) - set(shots.copies)
    assert {trial % 2 for trial in fit} == {0}
    # Parts of a half keep their tosses, less the copies.
    # Numbers and recordings of the data set stay, those of the copies too.
    assert (shots.shot(49).source_number, shots.shot(123).source_number) == (56, 140)


def test_seeds_select_independent_trials_and_a_copy_says_so():
    shots = single_shots(CUBE)
    env = gymnasium.make(f"GAUGE/{CUBE}")
    assert [env.reset(seed=seed)[1]["trial"] for seed in (122, 123, 473, 474)] == [
        122,
        124,
        498,
        0,
    ]
    assert env.reset(options={"trial": 123})[1]["trial"] == 123
    env.close()
    experiment = load_experiment(CUBE)
    sources = [
        getattr(reference_band(with_trial(experiment, trial)), "source", "")
        for trial in (49, 123)
    ]
    assert sources[0].startswith(f"trial 49 of {shots.stated['source']}")
    assert sources[1].startswith("trial 123 (the same recording as trial 49) of ")
