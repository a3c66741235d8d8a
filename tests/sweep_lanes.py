"""Lanes of sweeps in the process of the tests."""

from __future__ import annotations

import json
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import pytest

from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result import Result
from gauge_envs.runs.result_file import load_result
from gauge_envs.tools.sweep.lanes import run_request

needs_rapier = pytest.mark.skipif(find_spec("rapier3d") is None, reason="extra 'rapier' is absent")
"""For tests of an engine whose repeats share worlds, or that declines deformable bodies."""


class HereLane:
    """A lane in this process, which counts what it runs."""

    def __init__(self) -> None:
        self.requests: list[RunRequest] = []

    def run(self, request: RunRequest) -> list[Result]:
        self.requests.append(request)
        return run_request(request)

    def close(self) -> None:
        pass


def plain(result: Result) -> str:
    """A result without the times of its making, to the last bit."""
    return json.dumps(replace(result, wall_s=None, cpu_s=None, created="").to_dict())


def contents(folder: Path) -> dict[str, str]:
    """The results of a folder by file name; each must be complete."""
    return {file.name: plain(load_result(file)) for file in folder.glob("*.json")}
