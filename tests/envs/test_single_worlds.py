"""A world is the single environment to the bit: for every engine, mode, kind of experiment, constant and fault."""

from dataclasses import replace

import gymnasium
import numpy as np
import pytest
from same_worlds import assert_worlds_are_singles

from gauge_envs import Jitter, load_experiment
from gauge_envs.backends import backend
from gauge_envs.backends.base import worlds_of
from gauge_envs.envs.at_once import EpisodesAtOnce

SLIDE, DROP = "SlopeSlider-2-wood", "BouncingBall-rubber"
BRICK = "NonsmoothContact-1-wood"
JITTER = {"options": {"jitter": True}}
FAST = {"jitter": Jitter(velocity_m_per_s=0.05)}
"""Starts with a velocity, for which an engine may build worlds anew; their law stays that of the stated start."""
COARSE = {"settings": {"timestep_s": 1 / 900}}
"""A step for what does not depend on it."""

CUBES = [
    {"cube.friction": 0.20, "cube.restitution": 0.1},
    {"cube.friction": 0.30, "cube.mass_kg": 0.12},
    {"cube.friction": 0.27, "cube.mass_kg": 0.05},
]
BALLS = [
    {"ball.restitution": 0.70},
    {"ball.restitution": 0.80, "ball.mass_kg": 0.2},
    {"ball.restitution": 0.75},
]
SLOW = pytest.mark.slow


def compared(name, *, count=3, constants=None, mode=None, settings=None, **options):
    """Make worlds, and compare them with single environments."""
    made = {"backend": options.pop("engine", "mujoco"), "settings": settings}
    together = {} if constants is None else {"world_parameters": constants}
    envs = gymnasium.make_vec(
        f"GAUGE/{name}", num_envs=count, vectorization_mode=mode, **together, **made
    )
    assert_worlds_are_singles(envs, constants=constants, **made, **options)
    return envs


@pytest.mark.parametrize(
    ("name", "options"),
    [
        (SLIDE, {**JITTER, **COARSE}),
        (SLIDE, {**COARSE, "mode": "sync"}),
        (SLIDE, {**COARSE, "mode": "async"}),
        ("SlopeSlider-3-metal", {**JITTER, **COARSE, "steps": 9}),
        ("Pendulum-metal", {**JITTER, **COARSE, "steps": 9}),
        ("NewtonsCradle-metal", {"options": FAST, "steps": 2}),
        ("Turntable-1-wood", {"constants": CUBES, "options": FAST, "steps": 4}),
        ("StickStack-soft", {"steps": 4, "count": 2}),
        (DROP, {"kicks": {0: 0, 2: 1, 4: 2}, "steps": 5}),
        (DROP, {"constants": BALLS}),
        (SLIDE, {"constants": CUBES, **JITTER}),
    ],
)
def test_separate_simulations(name, options):
    envs = compared(name, **options)
    envs.close()


@pytest.mark.parametrize(
    ("name", "options"),
    [
        (SLIDE, JITTER),
        (BRICK, JITTER),
        ("SlopeSlider-3-metal", {"steps": 4}),
        ("CubePush-light", {"steps": 4}),
        pytest.param("FoamShearing-soft", {"steps": 4}, marks=SLOW),
        ("TextileBending-satin", {"steps": 4, "count": 2}),
        (DROP, {"kicks": {2: 1}}),
    ],
)
def test_simulations_that_advance_together(name, options, together):
    envs = compared(name, **options)
    assert isinstance(envs.unwrapped._lockstep, EpisodesAtOnce)


@pytest.mark.parametrize(
    ("engine", "module", "name", "options"),
    [
        ("rapier", "rapier3d", SLIDE, {"constants": CUBES}),
        ("rapier", "rapier3d", DROP, {"constants": BALLS}),
        pytest.param("newton", "newton", SLIDE, {"constants": CUBES}, marks=SLOW),
        pytest.param("newton", "newton", DROP, {"constants": BALLS}, marks=SLOW),
        pytest.param("newton", "newton", BRICK, {"steps": 6}, marks=SLOW),
        pytest.param(
            "newton", "newton", "TextileFlinging-satin", {"steps": 6}, marks=SLOW
        ),
    ],
)
def test_worlds_of_other_engines(engine, module, name, options):
    pytest.importorskip(module)
    compared(name, engine=engine, **options)


def test_constants_of_a_world_come_on_top_of_those_of_all():
    envs = gymnasium.make_vec(
        f"GAUGE/{SLIDE}",
        num_envs=2,
        parameters={"cube.mass_kg": 0.2},
        world_parameters=[{}, {"cube.friction": 0.2}],
    )
    first, second = (episode.experiment.scene for episode in envs.unwrapped.episodes)
    calibrated = load_experiment(SLIDE).scene
    assert first.body("cube").mass_kg == second.body("cube").mass_kg == 0.2
    assert first.contacts[0] == calibrated.contacts[0]
    assert second.contacts[0].friction == 0.2


def test_an_engine_that_does_not_declare_it_gets_its_worlds_one_by_one():
    """An engine whose batch takes all constants from the first scene would give wrong physics without a warning."""

    class FirstForAll(type(backend("mujoco"))):
        worlds_mix_constants = False

        def build_worlds(self, scenes, settings=None):
            return super().build_worlds(
                [replace(one, contacts=scenes[0].contacts) for one in scenes], settings
            )

    scenes = [load_experiment(SLIDE, parameters).scene for parameters in CUBES[:2]]
    worlds = worlds_of(FirstForAll(), scenes)
    worlds.reset(0)
    for _ in range(60):
        worlds.advance(1 / 180)
    first, second = (world.body_states(("cube",))[0, :3] for world in worlds.worlds)
    assert np.linalg.norm(first - second) > 0.01
