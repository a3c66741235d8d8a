"""The suite computes what it computed before: `golden.json` has the numbers, and `golden.py` makes them.

Limits are above what two changes move: positions and velocities that are rounded in another way in each step, by 1e-16
of their value, and NumPy, OpenBLAS and the C library with the vector instructions of an older processor.
"""

import math
from pathlib import Path

import pytest

from gauge_envs import load_experiment, variants
from gauge_envs.backends import backend
from gauge_envs.errors import MissingExtraError
from gauge_envs.tools.mjcf import NUMBER, expanded
from tests.golden import golden

STORED = golden.read()

FIRST_FRAMES = 2
"""Frames of cloth and foam in the default run."""


# --- comparison ------------------------------------------------------------------------------------------------------


NEAR_MM = 1e-6
"""Largest difference of rigid motions. Rounding noise in each step moves them by less than 4e-7 mm."""

NEAR_SOFT = {"mm": 1e-3, "mm^2": 2e-2, "rad": 1e-5}
"""The same of cloth, foam and rods by the unit of g(t): a face has edges of 20 mm, a cell of cloth of 30 mm."""

NEAR_SENSITIVE = {
    "SlopeSlider-3": (1e-3, 1e-5),
    "StickStack": (5e-2, 1e-4),
    "TableclothPulling": (1e-3, 3e-2),
    "TextileStretching": (2e-4, 1e-2),
}
"""The same where rounding noise moves more, and the relative one of the score: settling contacts and taut cloth."""

NEAR_MARKERS_M = {"TextileStretching": 5e-5}
"""Largest difference of markers where it is more than 1e-3 mm."""

CHAOTIC_MM = {
    "Funnel": (0.2, 3.0),
    "RopeWinding": (1e-3, 1.0),
    "RotatingBall": (1e-3, 3.0),
    "WallBreaking": (0.2, 1.5),
}
"""The same of the first frame, and its growth a frame, of motions that part by chaos."""

NEAR_ENGINES_MM = 1e-2
"""The same on other engines: single precision, and kernels that are compiled for the processor."""


def limits(name, engine="mujoco"):
    """Return the largest absolute and relative difference of an episode, by key.

    A score has that of g(t), as it is a distance from a mean, and a relative one: it may be divided by a small scale.
    """
    experiment = load_experiment(name)
    if experiment.scene.deformables:
        near, relative = NEAR_SOFT[experiment.score.observable.unit], 1e-4
    else:
        near, relative = NEAR_MM, 1e-6
    for beginning, wider in NEAR_SENSITIVE.items():
        if name.startswith(beginning):
            near, relative = wider
    if engine != "mujoco":
        near, relative = max(near, NEAR_ENGINES_MM), 1e-3
    of_frames = (near, 0.0)
    if golden.family_of(name) in CHAOTIC_MM:
        first, growth = CHAOTIC_MM[golden.family_of(name)]
        of_frames = {
            str(frame): (first * growth ** (frame - 1), 0.0) for frame in range(1, 11)
        }
    return {
        "start": (1e-9, 0.0),
        "g": of_frames,
        "markers": (NEAR_MARKERS_M.get(golden.family_of(name), 1e-6), 0.0),
        "reward": (near, relative),
        "score": (near, relative),
    }


def differences(found, stored, limit=(1e-9, 1e-9), path=""):
    """Yield what differs by more than a limit, absolute and relative, with its place.

    Values are numbers, texts, and lists and dictionaries of them. A limit may be one by key.
    """
    if isinstance(stored, dict | list) and isinstance(found, type(stored)):
        if isinstance(stored, list):
            found, stored = dict(enumerate(found)), dict(enumerate(stored))
        for key in sorted({*found} | {*stored}, key=str):
            one, other = found.get(key, "missing"), stored.get(key, "missing")
            inner = limit.get(key, (0.0, 0.0)) if isinstance(limit, dict) else limit
            yield from differences(one, other, inner, f"{path}/{key}")
    elif isinstance(stored, float) and isinstance(found, float | int):
        absolute, relative = limit
        if not abs(found - stored) <= absolute + relative * abs(stored):
            yield f"{path}: {found!r} instead of {stored!r}"
    elif found != stored:
        yield f"{path}: {found!r} instead of {stored!r}"


# --- tests -----------------------------------------------------------------------------------------------------------


def is_soft(name):
    return bool(load_experiment(name).scene.deformables)


def marked(names, is_slow):
    """Return parameters of which some are slow."""
    slow = pytest.mark.slow
    return [pytest.param(one, marks=slow if is_slow(one) else ()) for one in names]


def agrees(part, name, limit=(1e-9, 1e-9)):
    found = golden.plain(golden.PARTS[part](name))
    assert list(differences(found, STORED[part][name], limit)) == []


def skip_without(engine):
    try:
        backend(engine)
    except MissingExtraError as error:
        pytest.skip(str(error))


def test_every_experiment_is_stored():
    assert list(STORED) == list(golden.PARTS)
    assert list(STORED["episodes"]) == [one.name for one in variants()]


# --- motions ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", marked(STORED["episodes"], is_soft))
def test_episode(name):
    agrees("episodes", name, limits(name))


@pytest.mark.slow
@pytest.mark.parametrize("name", STORED["engines"])
def test_episode_on_another_engine(name):
    engine, variant = name.split("/")
    skip_without(engine)
    agrees("engines", name, limits(variant, engine))


@pytest.mark.parametrize("name", [one for one in STORED["episodes"] if is_soft(one)])
def test_first_frames_of_cloth_and_foam(name):
    found = golden.plain(golden.episode(name, last_frame=FIRST_FRAMES))
    stored = STORED["episodes"][name]
    first = {"start": stored["start"]}
    for key in found.keys() - first.keys():
        first[key] = {frame: stored[key][frame] for frame in ("1", "2")}
    assert list(differences(found, first, limits(name))) == []


@pytest.mark.parametrize("name", STORED["jitter"])
def test_jittered_start(name):
    agrees("jitter", name, limits(name))


@pytest.mark.parametrize("name", STORED["trial"])
def test_start_of_a_trial(name):
    agrees("trial", name, limits(name.split("/")[0]))


# --- tables and files ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("part", ["assets", "fabrics", "published"])
def test_table(part):
    for name in STORED[part]:
        agrees(part, name)


@pytest.mark.parametrize(
    "name",
    marked(STORED["assets"], lambda name: is_soft(Path(name).stem)),
)
def test_writer_repeats_the_checked_in_file(name):
    """Sines, and tables of compiled cloth, differ in their last digits between processors."""
    checked_in = expanded((golden.ASSETS / name).read_text(encoding="utf-8"))
    written = expanded(golden.asset_text(name))
    assert NUMBER.split(written) == NUMBER.split(checked_in)
    for one, other in zip(
        NUMBER.findall(written), NUMBER.findall(checked_in), strict=True
    ):
        assert one == other or math.isclose(
            float(one), float(other), rel_tol=3e-7, abs_tol=1e-12
        )


@pytest.mark.parametrize("name", STORED["sanity"])
def test_sanity(name):
    """Rounding decides how far a wall of bricks drifts, to a tenth of the value."""
    rows = STORED["sanity"][name]
    shares = {row: 0.2 if row.startswith("wall-") else 1e-2 for row in rows}
    agrees("sanity", name, {row: (1e-6, share) for row, share in shares.items()})


@pytest.mark.parametrize(
    "engine", marked(STORED["conformance"], lambda engine: engine != "mujoco")
)
def test_conformance(engine):
    """A value may move by a tenth of the tolerance of its check: rounding moves that of a slide by a twentieth."""
    skip_without(engine)
    found = golden.plain(golden.conformance(engine))
    moved = []
    for name, stored in STORED["conformance"][engine].items():
        near = 0.1 * stored[2] if stored[2] else 1e-9
        moved += differences(found.get(name), stored, (near, 1e-9), name)
    assert moved == []
