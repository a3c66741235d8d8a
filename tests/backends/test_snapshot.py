"""A state that is restored into another engine version, other settings or another scene is an error that names both."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest

import gauge_envs
from gauge_envs import GaugeEnv, load_experiment
from gauge_envs.backends import backend
from gauge_envs.backends.base import Simulation
from gauge_envs.errors import BackendError
from gauge_envs.scene import Scene


def scene(name: str = "SlopeSlider-2-wood") -> Scene:
    return load_experiment(name).scene


@pytest.fixture(params=["mujoco", "newton"])
def engine(request: pytest.FixtureRequest) -> str:
    if request.param == "newton":
        pytest.importorskip("newton")
    return str(request.param)


def refusal(simulation: Simulation, state: object) -> str:
    """Message of the error, after which the simulation is as it was."""
    before = simulation.body_states(["cube"])
    with pytest.raises(BackendError) as caught:
        simulation.restore(state)
    assert np.array_equal(before, simulation.body_states(["cube"]))
    return str(caught.value)


def test_a_state_of_another_origin_is_refused_with_both_origins(engine: str) -> None:
    build = backend(engine).build
    here, other_step = build(scene()), build(scene(), {"timestep_s": 1.0 / 360.0})
    text = refusal(here, other_step.state())
    steps = [float(one.settings["timestep_s"]) for one in (other_step, here)]
    assert f"timestep_s = {steps[0]}" in text.split("this one")[0]
    assert f"timestep_s = {steps[1]}" in text.split("this one")[1]
    assert "with scene" in refusal(here, build(scene("SlopeSlider-2-metal")).state())
    state = here.state()
    assert f"with {engine} 0.1, this one has {engine}" in refusal(
        here, replace(state, engine=f"{engine} 0.1")
    )
    assert "restore got a ndarray" in refusal(here, np.zeros(10))
    build(scene()).restore(pickle.loads(pickle.dumps(state)))


def test_engines_do_not_take_each_others_states() -> None:
    pytest.importorskip("newton")
    first, second = (backend(name).build(scene()) for name in ("mujoco", "newton"))
    assert "with newton" in refusal(first, second.state())
    assert "with mujoco" in refusal(second, first.state())


def test_a_pickle_under_other_settings_in_force_is_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A new version of gauge-envs may have other defaults."""
    env = GaugeEnv("SlopeSlider-2-wood")
    env.reset(seed=0)
    packed = pickle.dumps(env)
    pickle.loads(packed).close()
    engine = type(backend("mujoco"))
    build = engine.build
    monkeypatch.setattr(
        engine,
        "build",
        lambda self, one, settings=None: build(self, one, {"impratio": 5.0}),
    )
    with pytest.raises(
        BackendError, match=r"impratio = 10\.0, this one has impratio = 5\.0"
    ) as caught:
        pickle.loads(packed)
    assert "SlopeSlider-2-wood" in str(caught.value)


def test_mass_properties_are_public() -> None:
    cube = scene().body("cube")
    centre_m, inertia = gauge_envs.scene.mass_properties(cube.shape, cube.mass_kg)
    assert centre_m == pytest.approx(np.zeros(3))
    assert inertia == pytest.approx(np.eye(3) * cube.mass_kg * 0.05**2 / 6.0)
