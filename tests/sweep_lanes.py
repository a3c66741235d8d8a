"""Lanes of sweeps in the process of the tests."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result import Result
from gauge_envs.runs.result_file import load_result
from gauge_envs.tools.sweep.lanes import run_request
from gauge_envs.tools.sweep.store import update_store

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


def stored(folder: Path, sql: str, notify: Callable[[str], None] = lambda text: None) -> list[tuple[Any, ...]]:
    """What a statement returns of the store of a folder, which is brought up to date."""
    with closing(sqlite3.connect(update_store(folder, notify))) as connection:
        return connection.execute(sql).fetchall()
