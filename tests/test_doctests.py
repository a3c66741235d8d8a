"""The examples in docstrings run and give their output."""

from __future__ import annotations

import doctest
import importlib

import pytest


@pytest.mark.parametrize(
    "name",
    [
        "gauge_envs.tools.control.env",
        "gauge_envs.envs.dm_env",
        "gauge_envs.envs.env",
        "gauge_envs.tools.sanity",
        "gauge_envs.envs.vector",
        "gauge_envs.envs.wrappers",
    ],
)
def test_examples(name):
    outcome = doctest.testmod(importlib.import_module(name))
    assert outcome.attempted > 0
    assert outcome.failed == 0
