"""Every id passes the checker of Gymnasium, starts as in its task file, replays its drivers, and has golden numbers.

The default run takes the rigid ids whole, two frames of the others, and one id of each kind for the checker; the slow
set takes all. `golden.json` has the numbers of version 0.3.0. Of the 17 newer references (`scoring/PROVENANCE.md`),
TextileStretching, FoamBending and CantileverBeam have scores here. No tumbling body is compared on other engines: a
start that is 1e-7 m elsewhere moves it by millimetres. Tolerances exceed what rounding noise in each step, and NumPy
on an older processor, move.
"""

import csv
import warnings

import gymnasium
import pytest
from gymnasium.utils.env_checker import check_env
from places import RIGID, first_of_each_kind

import gauge_envs
from gauge_envs import load_experiment, variants
from gauge_envs.backends import backend
from gauge_envs.errors import MissingExtraError, NoRewardWarning
from gauge_envs.files import data_folder
from gauge_envs.tools.control import names
from tests.golden import golden

STORED = golden.read()
IDS = [variant.name for variant in variants()]
CONTROL = names()
SOFT = [name for name in IDS if name not in RIGID]
LONG = ("NewtonsCradle", "Pendulum")

RIGID_MM = 1e-6
SOFT_LIMITS = {"mm": 1e-3, "mm^2": 2e-2, "rad": 1e-5}
"""Largest difference of g(t) of cloth, foam and rods, by unit: a face has edges of 20 mm, a cell of cloth of 30 mm."""

SENSITIVE = {
    "SlopeSlider-3": (1e-3, 1e-5),
    "StickStack": (5e-2, 1e-4),
    "TableclothPulling": (1e-3, 3e-2),
    "TextileStretching": (2e-4, 1e-2),
}
"""Absolute and relative limits of ids with settling contacts and taut cloth."""

SCORE_MM = {"TableclothPulling": 0.15}
"""Limit of a score: a start that is 1e-9 m elsewhere moves the mean of the last frames by 0.05 mm. u is 4 to 8 mm."""

CHAOTIC_MM = {
    "Funnel": (0.2, 3.0),
    "RopeWinding": (1e-3, 1.0),
    "RotatingBall": (1e-3, 3.0),
    "WallBreaking": (0.2, 1.5),
}
"""Limit at the first frame of chaotic motions, and its growth per frame."""


def limits(name, engine="mujoco"):
    """Return the largest absolute and relative difference of an episode, by key.

    A score is a distance from a mean and has the limit of g(t), and a relative one where it is divided by a scale.
    """
    experiment = load_experiment(name)
    family = golden.family_of(name)
    near, relative = RIGID_MM, 1e-6
    if experiment.scene.deformables:
        near, relative = SOFT_LIMITS[experiment.score.observable.unit], 1e-4
    for beginning, wider in SENSITIVE.items():
        if name.startswith(beginning):
            near, relative = wider
    if engine != "mujoco":
        # Single precision, and kernels that are compiled for the processor.
        near, relative = max(near, 1e-2), 1e-3
    of_frames = (near, 0.0)
    if family in CHAOTIC_MM:
        first, growth = CHAOTIC_MM[family]
        of_frames = {str(n): (first * growth ** (n - 1), 0.0) for n in range(1, 11)}
    return {
        "start": (1e-9, 0.0),
        "g": of_frames,
        "markers": (5e-5 if family == "TextileStretching" else 1e-6, 0.0),
        "reward": (near, relative),
        "score": (SCORE_MM.get(family, near), relative),
    }


def test_the_documented_answers_are_those_of_the_episodes():
    """Chaotic episodes have only ten frames here, and no answers."""
    with (data_folder("scoring") / "answers.csv").open(encoding="utf-8") as stream:
        documented = {row["id"]: row for row in csv.DictReader(stream)}
    assert list(documented) == IDS
    absent = {"solves": "no solution", "like_reality": "-"}
    for name, entry in STORED["episodes"].items():
        if golden.family_of(name) in golden.CHAOTIC:
            continue
        answers = entry.get("answers", [None, None])
        for field, answer in zip(("solves", "like_reality"), answers, strict=True):
            assert documented[name][field] == (answer or absent[field]), name


def differences(computed, stored, limit=(1e-9, 1e-9), path=""):
    """Yield values that differ by more than an absolute plus a relative limit; limits may be given by key."""
    if isinstance(stored, dict | list) and isinstance(computed, type(stored)):
        if isinstance(stored, list):
            computed, stored = dict(enumerate(computed)), dict(enumerate(stored))
        for key in sorted({*computed} | {*stored}, key=str):
            computed_value, stored_value = (
                computed.get(key, "missing"),
                stored.get(key, "missing"),
            )
            inner = limit.get(key, (0.0, 0.0)) if isinstance(limit, dict) else limit
            yield from differences(computed_value, stored_value, inner, f"{path}/{key}")
    elif isinstance(stored, float) and isinstance(computed, float | int):
        absolute, relative = limit
        if not abs(computed - stored) <= absolute + relative * abs(stored):
            yield f"{path}: {computed!r} instead of {stored!r}"
    elif computed != stored:
        yield f"{path}: {computed!r} instead of {stored!r}"


def check_golden(part, name, limit=(1e-9, 1e-9)):
    computed = golden.plain(golden.PARTS[part](name))
    assert list(differences(computed, STORED[part][name], limit)) == []


def slow_where(names, is_slow):
    """Return parameters, some of them marked slow."""
    slow = pytest.mark.slow
    return [pytest.param(name, marks=slow if is_slow(name) else ()) for name in names]


def skip_without(engine):
    try:
        backend(engine)
    except MissingExtraError as error:
        pytest.skip(str(error))


def kind_of(name):
    """Return the facts of an id that determine its spaces."""
    if name in CONTROL:
        return name.partition("-")[0]
    experiment = load_experiment(name)
    return experiment.score.observable, bool(experiment.scene.drivers)


def test_75_ids_in_22_families_are_registered():
    beyond = {variant.id for variant in gauge_envs.beyond_variants()}
    extra = {*(f"GAUGE/{name}" for name in CONTROL), *beyond}
    registered = {key for key in gymnasium.registry if key.startswith("GAUGE/")}
    assert extra < registered
    assert registered - extra == {variant.id for variant in variants()}
    assert len(IDS) == 75
    assert len({variant.family for variant in variants()}) == 22
    assert list(STORED["episodes"]) == IDS


@pytest.mark.parametrize("name", first_of_each_kind([*IDS, *CONTROL], kind_of))
def test_gymnasiums_checker_passes_without_a_warning(name):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # A reference that ends before the episode is no fault of the environment.
        warnings.simplefilter("ignore", NoRewardWarning)
        env = gymnasium.make(f"GAUGE/{name}", disable_env_checker=True)
        check_env(env.unwrapped, skip_render_check=True)


@pytest.mark.parametrize("name", slow_where(IDS, lambda name: name in SOFT))
def test_an_episode_and_its_score_have_golden_numbers(name):
    check_golden("episodes", name, limits(name))


@pytest.mark.parametrize("name", SOFT)
def test_two_frames_of_cloth_and_foam_have_golden_numbers(name):
    computed = golden.plain(golden.episode(name, last_frame=2))
    stored = STORED["episodes"][name]
    first = {"start": stored["start"]}
    for key in computed.keys() - first.keys():
        first[key] = {frame: stored[key][frame] for frame in ("1", "2")}
    assert list(differences(computed, first, limits(name))) == []


@pytest.mark.parametrize(
    "name", slow_where(STORED["jitter"], lambda name: golden.family_of(name) in LONG)
)
def test_an_episode_from_a_start_with_noise_has_golden_numbers(name):
    check_golden("jitter", name, limits(name))


@pytest.mark.parametrize("name", STORED["trial"])
def test_an_episode_of_a_bundled_trial_has_golden_numbers(name):
    check_golden("trial", name, limits(name.split("/")[0]))


@pytest.mark.slow
@pytest.mark.parametrize("name", STORED["engines"])
def test_an_episode_on_another_engine_has_golden_numbers(name):
    engine, variant = name.split("/")
    skip_without(engine)
    check_golden("engines", name, limits(variant, engine))
