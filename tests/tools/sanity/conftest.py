"""Fixtures of the sanity check."""

import pytest

from gauge_envs.backends import backend
from gauge_envs.tools.sanity import run
from gauge_envs.tools.sanity.object_checks.measure import Measurements


@pytest.fixture(scope="module")
def shared_measurements():
    """Rollouts of presets are the same for all models, so that they run once."""
    shared = Measurements(backend("mujoco"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run, "Measurements", lambda *_, **__: shared)
        yield
