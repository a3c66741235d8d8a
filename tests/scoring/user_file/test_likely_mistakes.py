"""A trajectory with a wrong unit, axes or start is rejected with a fix; real trials are accepted."""

import re

import numpy as np
import pytest
from slide import NAME, RESOLVED, SLIDE, TIMES

from gauge_envs import (
    beyond_variants,
    load_experiment,
    reference_band,
    score_trajectory,
    variants,
)
from gauge_envs.errors import ShapeError
from gauge_envs.scoring.user_file.likely_mistakes import (
    start_values,
    value_mistake,
)


@pytest.mark.parametrize(
    ("name", "change", "text"),
    [
        (NAME, lambda g: 1e-3 * g, "has cube at (0.09725, 0.4069, 0.3594)"),
        (NAME, lambda g: g + 300.0, "30 mm. Check the id"),
        ("CantileverBeam-soft", lambda g: 1e-3 * g, "metres. Multiply them by 1,000"),
        ("FoamShearing-hard", lambda g: 1e-6 * g, "look like square metres"),
        ("FoamShearing-hard", lambda g: 5.0 * g, "5 times those of the scene"),
        ("TextileFlinging-satin", lambda g: g + 60.0, "look like degrees"),
        (
            "TextileBending-satin",
            lambda g: g + 3.2,
            "the largest possible angle is 3.142",
        ),
    ],
)
def test_a_unit_or_place_is_named(name, change, text):
    experiment = load_experiment(name)
    start = start_values(experiment)[None]
    assert value_mistake(experiment, start) is None
    assert text in value_mistake(experiment, change(start))


def test_limits_of_a_start():
    def is_accepted(name, change):
        experiment = load_experiment(name)
        return value_mistake(experiment, change(start_values(experiment))[None]) is None

    # 30 mm of a position, a factor of 3 of an area, pi of each face at a marker.
    assert is_accepted(NAME, lambda g: np.add(g, [0.0, 18.0, -23.9]))
    assert not is_accepted(NAME, lambda g: np.add(g, [0.0, 18.0, -24.1]))
    for factor in (0.34, 2.9):
        assert is_accepted("FoamShearing-hard", lambda g, by=factor: by * g)
    for factor in (0.32, 3.1):
        assert not is_accepted("FoamShearing-hard", lambda g, by=factor: by * g)
    # A corner of the sheet has one or two faces.
    assert is_accepted("TextileFlinging-satin", lambda g: g + 3.0)
    assert not is_accepted("TextileFlinging-satin", lambda g: g + 6.3)


@pytest.mark.parametrize("factor", [1.0, 1e-3])
@pytest.mark.parametrize("axes", ["x,-z,y", "y,x,z", "-x,-y,z", "z,x,y"])
def test_the_axes_of_the_message_rotate_the_file_into_the_scene(axes, factor):
    places = np.array([start_values(RESOLVED)])

    def written(values, names):
        columns = [values[:, "xyz".index(name[-1])] for name in names]
        signs = [-1.0 if name.startswith("-") else 1.0 for name in names]
        return np.stack(columns, axis=1) * signs

    file_values = factor * written(places, axes.split(","))
    text = value_mistake(RESOLVED, file_values)
    recovered = written(file_values, re.search(r"Write \((.*?)\)", text)[1].split(", "))
    assert recovered / factor == pytest.approx(places, abs=30.0)
    assert ("the unit looks like metres" in text) is (factor != 1.0)


def test_starts_of_real_trials_are_accepted():
    for variant in (*variants(), *beyond_variants()):
        experiment = load_experiment(variant.name)
        band = reference_band(experiment)
        if band is None:
            continue
        start = start_values(experiment)
        trials = np.empty((0, *band.mean.shape)) if band.trials is None else band.trials
        for measured in (band.mean[0], *trials[:, 0]):
            # Directions that were not measured stay as in the scene.
            deviation = np.nan_to_num(measured - band.projection @ start)
            moved = start + np.linalg.pinv(band.projection) @ deviation
            assert value_mistake(experiment, moved[None]) is None, variant.name


def test_score_trajectory_rejects_mistakes_unless_the_values_are_checked():
    band = reference_band(RESOLVED)
    given = {"times_s": TIMES, "values": 1e-3 * SLIDE}
    with pytest.raises(ShapeError, match="look like metres"):
        score_trajectory(RESOLVED, band, **given)
    assert score_trajectory(RESOLVED, band, **given, is_checked=True).rmse > 100.0
