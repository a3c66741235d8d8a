"""The folder of a sweep: a result file for each episode, those without a result in folders of their own, and a lock.

DIR/SlopeSlider-2-wood.mujoco.e8ec72ec30333307.json     the episode ran; `diverged` counts
DIR/failed/...json                                      an error or the end of its process prevented it
DIR/declined/...json                                    the engine or the experiment cannot do it
DIR/sweep.sqlite                                        a row for each of these files (`sweep.store`)
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from gauge_envs.errors import ResultFileError
from gauge_envs.files import locked
from gauge_envs.runs.batch import check_writable
from gauge_envs.runs.result import Outcome, Result
from gauge_envs.runs.result_file import load_result, write_result

STORE_NAME = "sweep.sqlite"

SUBFOLDERS = {Outcome.FAILED: "failed", Outcome.DECLINED: "declined"}


class SweepFolder:
    """The folder of a sweep.

    Args:
        path: The folder; `create` makes it.
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    @property
    def store_path(self) -> Path:
        """Path of the SQLite store."""
        return self.path / STORE_NAME

    def create(self) -> None:
        """Create the folders that do not exist."""
        for name in ("", *SUBFOLDERS.values()):
            check_writable(self.path / name)

    @contextmanager
    def lock(self, *, shared: bool = False) -> Iterator[None]:
        """Hold the folder against other sweeps.

        Args:
            shared: Let parts of a sweep in, which hold the lock in the same way.
        """
        try:
            with locked(self.path, name=".sweep.lock", waits=False, shared=shared):
                yield
        except BlockingIOError:
            raise ResultFileError(
                f"{self.path}: another sweep writes there; wait for its end, or give another folder with --out"
            ) from None

    def files(self, *outcomes: Outcome) -> Iterator[os.DirEntry[str]]:
        """Yield the JSON files of outcomes, by default of all."""
        names = dict.fromkeys(SUBFOLDERS.get(outcome, "") for outcome in outcomes or Outcome)
        for name in names:
            with suppress(FileNotFoundError), os.scandir(self.path / name) as entries:
                yield from (one for one in entries if one.name.endswith(".json") and not one.name.startswith("."))

    def write(self, result: Result, name: str) -> Path:
        """Write a result file and return its path; a file of an earlier failure of the episode is removed."""
        file = self.path / SUBFOLDERS.get(result.outcome, "") / name
        write_result(result, file)
        for folder in SUBFOLDERS.values():
            if (earlier := self.path / folder / name) != file:
                earlier.unlink(missing_ok=True)
        return file

    def read(self, file: Path) -> Result:
        """Read a file of the folder."""
        return load_result(file, needs_trajectory=file.parent == self.path)
