"""MuJoCo with worlds that advance together, as those of an engine with batches do."""

import pytest
from together import Together

from gauge_envs.backends.mujoco import BackendMuJoCo


@pytest.fixture
def together(monkeypatch):
    def build_worlds(self, scenes, settings=None):
        return Together([self.build(scene, settings) for scene in scenes])

    monkeypatch.setattr(BackendMuJoCo, "build_worlds", build_worlds)
