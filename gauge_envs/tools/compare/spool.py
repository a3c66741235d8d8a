"""Trajectories in a temporary file: those of 1,000 results would take 300 MB of memory."""

from __future__ import annotations

import pickle
from dataclasses import replace
from tempfile import TemporaryFile
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gauge_envs.runs.result import Result


SHARED = ("settings", "settings_given", "versions", "dataset")
"""Fields that most results have in common."""


class TrajectorySpool:
    """Trajectories of results in a temporary file, which is deleted with the spool."""

    def __init__(self) -> None:
        self._file = TemporaryFile()  # noqa: SIM115  # open as long as the spool
        self._places: dict[int, int] = {}
        self._known: dict[str, Any] = {}

    def put(self, result: Result) -> Result:
        """Write the trajectory of a result, and return the result without it."""
        shared = {
            name: self._known.setdefault(repr(value := getattr(result, name)), value)
            for name in SHARED
        }
        kept = replace(result, trajectory=None, **shared)
        self._places[id(kept)] = self._file.tell()
        pickle.dump(result.trajectory, self._file)
        return kept

    def read(self, kept: Result) -> Result:
        """Return a result of `put` with its trajectory."""
        self._file.seek(self._places[id(kept)])
        return replace(kept, trajectory=pickle.load(self._file))
