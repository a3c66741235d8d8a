"""Trajectories in a temporary file: those of 1,000 results would take 300 MB of memory."""

from __future__ import annotations

import pickle
from dataclasses import replace
from tempfile import TemporaryFile
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gauge_envs.runs.result import Result


class TrajectorySpool:
    """Trajectories of results in a temporary file, which is deleted with the spool."""

    def __init__(self) -> None:
        self._file = TemporaryFile()  # noqa: SIM115  # open as long as the spool
        self._places: dict[int, int] = {}

    def put(self, result: Result) -> Result:
        """Write the trajectory of a result, and return the result without it."""
        kept = replace(result, trajectory=None)
        self._places[id(kept)] = self._file.tell()
        pickle.dump(result.trajectory, self._file)
        return kept

    def read(self, kept: Result) -> Result:
        """Return a result of `put` with its trajectory."""
        self._file.seek(self._places[id(kept)])
        return replace(kept, trajectory=pickle.load(self._file))
