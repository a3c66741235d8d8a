"""The examples in docstrings are real."""

from __future__ import annotations

import doctest
import importlib

import pytest


@pytest.mark.parametrize(
    "name",
    [
        "gauge_envs.control.wrapper",
        "gauge_envs.dm_control",
        "gauge_envs.env",
        "gauge_envs.sanity",
        "gauge_envs.vector",
        "gauge_envs.wrappers",
    ],
)
def test_examples(name: str) -> None:
    outcome = doctest.testmod(importlib.import_module(name))
    assert outcome.attempted > 0
    assert outcome.failed == 0
