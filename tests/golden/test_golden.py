"""The suite computes what it computed before: `golden.json` has the numbers, `golden.py` makes and compares them."""

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


def is_soft(name):
    return bool(load_experiment(name).scene.deformables)


def marked(names, is_slow):
    """Return parameters of which some are slow."""
    slow = pytest.mark.slow
    return [pytest.param(one, marks=slow if is_slow(one) else ()) for one in names]


def agrees(part, name, limit=(1e-9, 1e-9)):
    found = golden.plain(golden.PARTS[part](name))
    assert list(golden.differences(found, STORED[part][name], limit)) == []


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
    agrees("episodes", name, golden.limits(name))


@pytest.mark.slow
@pytest.mark.parametrize("name", STORED["engines"])
def test_episode_on_another_engine(name):
    engine, variant = name.split("/")
    skip_without(engine)
    agrees("engines", name, golden.limits(variant, engine))


@pytest.mark.parametrize("name", [one for one in STORED["episodes"] if is_soft(one)])
def test_first_frames_of_cloth_and_foam(name):
    found = golden.plain(golden.episode(name, last_frame=FIRST_FRAMES))
    stored = STORED["episodes"][name]
    first = {"start": stored["start"]}
    for key in found.keys() - first.keys():
        first[key] = {frame: stored[key][frame] for frame in ("1", "2")}
    assert list(golden.differences(found, first, golden.limits(name))) == []


@pytest.mark.parametrize("name", STORED["jitter"])
def test_jittered_start(name):
    agrees("jitter", name, golden.limits(name))


@pytest.mark.parametrize("name", STORED["trial"])
def test_start_of_a_trial(name):
    agrees("trial", name, golden.limits(name.split("/")[0]))


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
    agrees("sanity", name, (1e-6, 1e-4))


@pytest.mark.parametrize(
    "engine", marked(STORED["conformance"], lambda engine: engine != "mujoco")
)
def test_conformance(engine):
    """A value may move by a share of the tolerance of its check; on other engines as in `golden.limits`."""
    skip_without(engine)
    share = 1e-3 if engine == "mujoco" else 5e-2
    found, stored = (
        golden.plain(golden.conformance(engine)),
        STORED["conformance"][engine],
    )
    moved = []
    for name in found.keys() | stored.keys():
        one, other = found.get(name, "missing"), stored.get(name, "missing")
        near = share * other[2] if other[2] else 1e-9
        moved += golden.differences(one, other, (near, 1e-9), name)
    assert moved == []
