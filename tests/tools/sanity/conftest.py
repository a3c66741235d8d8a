"""Fixtures of the sanity check."""

import pytest

from gauge_envs.backends import backend
from gauge_envs.tools.sanity import run
from gauge_envs.tools.sanity.fixes import harm
from gauge_envs.tools.sanity.object_checks.measure import Measurements


@pytest.fixture(autouse=True)
def _short_blocks_of_speed(monkeypatch):
    """The speed of a change is measured in shorter blocks: no test reads it."""
    monkeypatch.setattr(harm, "BLOCK_S", 0.01)


@pytest.fixture(scope="session")
def _session_measurements():
    return Measurements(backend("mujoco"))


@pytest.fixture
def shared_measurements(_session_measurements, monkeypatch):
    """Rollouts of presets are the same for all models, so that they run once."""
    monkeypatch.setattr(run, "Measurements", lambda *_, **__: _session_measurements)
