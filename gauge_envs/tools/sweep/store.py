"""The folder of a sweep: a file for each episode, those without a result apart, a lock, and a store made of the files.

DIR/SlopeSlider-2-wood.mujoco.e8ec72ec30333307.json     the episode ran; `diverged` counts
DIR/failed/...json                                      an error or the end of its process prevented it
DIR/declined/...json                                    the engine or the experiment cannot do it
DIR/sweep.sqlite                                        a row for each of these files

The store is SQLite. Its table `results` has the scalar fields of a result and of its score as columns. Mappings, as
`settings`, are JSON texts: `json_extract(settings, '$.iterations')` reads one entry.
"""

from __future__ import annotations

import json
import math
import os
import sqlite3
from collections.abc import Callable, Container, Iterable, Iterator, Mapping
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, fields
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from gauge_envs.errors import ResultFileError
from gauge_envs.evaluation.score import Score
from gauge_envs.files import locked
from gauge_envs.runs.batch import check_writable, move_aside
from gauge_envs.runs.result import Outcome, Result
from gauge_envs.runs.result_file import load_result, write_result
from gauge_envs.tools.sweep.plan import KEY_LENGTH, SweepTask

Notify = Callable[[str], None]

STORE_NAME = "sweep.sqlite"

SUBFOLDERS = {Outcome.FAILED: "failed", Outcome.DECLINED: "declined"}

BUSY_LIMIT_S = 60.0
"""Longest wait for another process that holds the store [s]."""

SQL_TYPES = {"float": "REAL", "int": "INTEGER", "bool": "INTEGER", "str": "TEXT"}

JSON_COLUMNS = ("parameters", "jitter", "settings", "settings_given", "versions")
"""Columns of mappings; `parameters` is the plain name of a parameter set, or a JSON text."""


def _score_columns() -> dict[str, str]:
    """Return the columns of a score: each number and text, and both ends of each interval."""
    columns = {}
    for field in fields(Score):
        # PRIMARY is a word of SQL, and `score` is what it names.
        if field.name == "primary":
            continue
        kind = str(field.type).removesuffix(" | None")
        if kind in SQL_TYPES:
            columns[field.name] = SQL_TYPES[kind]
        elif kind == "tuple[float, float]":
            columns |= {f"{field.name}_low": "REAL", f"{field.name}_high": "REAL"}
    return columns


SCORE_COLUMNS = _score_columns()

COLUMNS = {
    "file": "TEXT PRIMARY KEY",
    "key": "TEXT",
    "outcome": "TEXT",
    "id": "TEXT",
    "backend": "TEXT",
    "preset": "TEXT",
    "timestep_s": "REAL",
    "seed": "INTEGER",
    "score": "REAL",
    "score_low": "REAL",
    "score_high": "REAL",
    "wall_s": "REAL",
    "sim_s": "REAL",
    "frames": "INTEGER",
    "error": "TEXT",
    "diverged_reason": "TEXT",
    "marker_proxy": "TEXT",
    "task_sha256": "TEXT",
    "created": "TEXT",
    **dict.fromkeys(JSON_COLUMNS, "TEXT"),
    **SCORE_COLUMNS,
    "file_bytes": "INTEGER",
    "file_mtime_ns": "INTEGER",
}
"""Columns of the table `results` and their types. `score` is the normalized score that reports show first."""


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


def read_only(path: Path) -> sqlite3.Connection:
    """Return a connection to a store that cannot write."""
    _check_regular(path)
    try:
        return sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True, timeout=BUSY_LIMIT_S)
    except sqlite3.Error as error:
        raise ResultFileError(f"{path}: cannot be opened: {error}") from error


def _check_regular(path: Path) -> None:
    """Check that SQLite would open a file: it would wait for ever for the other end of a FIFO."""
    if path.exists() and not path.is_file():
        raise ResultFileError(f"{path}: cannot be opened: it is not a regular file")


def update_store(path: Path, notify: Notify = lambda text: None) -> Path:
    """Bring the store of a folder up to date, and return its path.

    While a sweep runs there, or where the folder cannot be written, the store stays as it is.

    Args:
        path: Folder of a sweep, or of `gauge run`.
        notify: Receives a sentence for a damaged store, for each damaged file, and for a store that stays as it is.
    """
    folder = SweepFolder(path)
    if next(folder.files(), None) is None:
        raise ResultFileError(f"{path}: no result files there; gauge sweep and gauge run write them")
    try:
        with folder.lock(), SweepStore(folder, notify) as store:
            store.synchronise()
    except (ResultFileError, OSError) as error:
        try:
            with closing(read_only(folder.store_path)) as connection:
                connection.execute("SELECT file FROM results LIMIT 1").fetchone()
        except (ResultFileError, sqlite3.Error):
            raise error from None
        notify(f"the store is not brought up to date: {error}")
    return folder.store_path


class SweepStore:
    """The store of a folder, opened to be written. Close it, or use it in a `with` statement.

    A store that is damaged, or has other columns, is moved aside and made again from the files.

    Args:
        folder: The folder.
        notify: Receives a sentence for a damaged store and for each damaged file.
    """

    def __init__(self, folder: SweepFolder, notify: Notify) -> None:
        self._folder = folder
        self._notify = notify
        _check_regular(folder.store_path)
        try:
            self._connection = self._opened()
        except sqlite3.OperationalError as error:
            raise ResultFileError(f"{folder.store_path}: cannot be opened: {error}") from error

    def __enter__(self) -> SweepStore:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the store."""
        self._connection.close()

    @contextmanager
    def _used(self) -> Iterator[None]:
        """Turn an error of SQLite into one that names the store."""
        try:
            with self._connection:
                yield
        except sqlite3.Error as error:
            raise ResultFileError(
                f"{self._folder.store_path}: cannot be used: {error}; it may be deleted, as it is made again from the "
                "result files"
            ) from error

    def add(self, result: Result, file: Path) -> None:
        """Add or replace the row of a result file."""
        row = _row(result, file, self._name(file))
        marks = ", ".join("?" * len(COLUMNS))
        with self._used():
            # An episode has one file: a result takes the place of an earlier failure.
            self._connection.execute("DELETE FROM results WHERE key = ?", [row["key"]])
            self._connection.execute(f"INSERT OR REPLACE INTO results VALUES ({marks})", [row[c] for c in COLUMNS])

    def diverged(self, names: Container[str]) -> dict[str, Outcome]:
        """Return those of some file names whose episodes diverged, with that outcome."""
        with self._used():
            rows = self._connection.execute("SELECT file FROM results WHERE outcome = ?", [Outcome.DIVERGED.value])
            return {name: Outcome.DIVERGED for (name,) in rows if name in names}

    def synchronise(self) -> int:
        """Make the rows those of the files, and return how many files were read.

        A file whose size and time are those of its row is not read again. A damaged file is moved aside.
        """
        with self._used():
            rows = self._connection.execute("SELECT file, file_bytes, file_mtime_ns FROM results")
            known = {name: (size, mtime_ns) for name, size, mtime_ns in rows}
        read = 0
        for entry in list(self._folder.files()):
            file = Path(entry.path)
            try:
                status = entry.stat()
            except OSError:
                # It was removed since, or is a link to nothing.
                continue
            if known.pop(self._name(file), None) == (status.st_size, status.st_mtime_ns):
                continue
            read += 1
            try:
                self.add(self._folder.read(file), file)
            except ResultFileError as error:
                if not file.exists():
                    raise
                self._notify(f"{error}; moved to {move_aside(file).name}")
        with self._used():
            self._connection.executemany("DELETE FROM results WHERE file = ?", [(name,) for name in known])
        return read

    def _name(self, file: Path) -> str:
        return _storable(file.relative_to(self._folder.path).as_posix())

    def _opened(self) -> sqlite3.Connection:
        path = self._folder.store_path
        try:
            return _connected(path)
        except _DamagedError as error:
            aside = move_aside(path)
            path.with_name(f"{path.name}-journal").unlink(missing_ok=True)
            self._notify(f"{path}: {error}; moved to {aside.name}, and made again from the result files")
            return _connected(path)


class _DamagedError(Exception):
    """A file is no store, or one with other columns."""


def _connected(path: Path) -> sqlite3.Connection:
    """Return a connection to a store, which is created if it does not exist."""
    connection = sqlite3.connect(path, timeout=BUSY_LIMIT_S)
    try:
        # The files are written safely, and the store can be made again from them.
        connection.execute("PRAGMA synchronous = OFF")
        columns = ", ".join(f"{name} {kind}" for name, kind in COLUMNS.items())
        connection.execute(f"CREATE TABLE IF NOT EXISTS results ({columns})")
        found = [row[1] for row in connection.execute("PRAGMA table_info(results)")]
        if found != list(COLUMNS):
            raise _DamagedError("the table has the columns of another version")
        # A trigger or a view of a stranger would run statements of its own.
        if connection.execute("SELECT 1 FROM sqlite_master WHERE type IN ('trigger', 'view')").fetchone():
            raise _DamagedError("it has triggers or views, which no sweep makes")
        connection.execute("CREATE INDEX IF NOT EXISTS results_by_key ON results (key)")
        (answer,) = connection.execute("PRAGMA quick_check(1)").fetchone()
        if answer != "ok":
            raise _DamagedError(f"the store is damaged: {answer}")
    except sqlite3.OperationalError:
        connection.close()
        raise
    except sqlite3.DatabaseError as error:
        connection.close()
        raise _DamagedError(f"the store is damaged: {error}") from None
    except _DamagedError:
        connection.close()
        raise
    return connection


def _row(result: Result, file: Path, name: str) -> dict[str, Any]:
    """Return the columns of a result."""
    values = result.to_dict(trajectory=False)
    score = values.pop("score")
    low, high = result.score.primary_95 or (None, None)
    row: dict[str, Any] = dict.fromkeys(COLUMNS)
    row |= {key: values[key] for key in COLUMNS if key in values}
    for key, value in score.items():
        if key in SCORE_COLUMNS:
            row[key] = value
        elif f"{key}_low" in SCORE_COLUMNS and value is not None:
            row[f"{key}_low"], row[f"{key}_high"] = value
    for key in JSON_COLUMNS:
        row[key] = row[key] if isinstance(row[key], str) else json.dumps(row[key], sort_keys=True)
    status = file.stat()
    stem = name.removesuffix(".json").rpartition(".")[2]
    row |= {
        "file": name,
        "key": stem if len(stem) == KEY_LENGTH and set(stem) <= set("0123456789abcdef") else None,
        "preset": result.settings.get("preset") or result.settings_given.get("preset"),
        "timestep_s": result.settings.get("timestep_s") or result.settings_given.get("timestep_s"),
        "score": result.score.primary_normalized,
        "score_low": low,
        "score_high": high,
        "file_bytes": status.st_size,
        "file_mtime_ns": status.st_mtime_ns,
    }
    return {key: _storable(value) for key, value in row.items()}


def _storable(value: Any) -> Any:
    """Return a value as SQLite holds it, which has no lone surrogates, no integers above 64 bits and no lists.

    A file of a stranger may hold them.
    """
    if isinstance(value, str):
        return value.encode(errors="backslashreplace").decode()
    if isinstance(value, int) and value.bit_length() > 63:
        return math.inf if value > 0 else -math.inf
    return value if value is None or isinstance(value, int | float) else json.dumps(value)


# --- the cost of a sweep, estimated from earlier results ---


@dataclass(frozen=True)
class Cost:
    """Estimated cost of episodes.

    Attributes:
        engine_s: Time in the engines of the episodes whose cost is known [s], without their start and building.
        known: Episodes with an estimate.
        unknown: Episodes without one: no earlier result of that engine and experiment exists.
    """

    engine_s: float = 0.0
    known: int = 0
    unknown: int = 0


class EarlierCosts:
    """Costs of the results in the store of a folder.

    The cost of an episode is the median time of earlier episodes of the same engine and experiment with as many time
    steps. Between two numbers of steps it is interpolated, and beyond the largest it grows in proportion. Other
    settings, as iterations, are not considered.

    Args:
        folder: The folder; without a store nothing is known.
    """

    def __init__(self, folder: SweepFolder) -> None:
        times_s: dict[tuple[str, str], dict[float, list[float]]] = {}
        for experiment, backend, wall_s, steps in _measured(folder):
            times_s.setdefault((backend, experiment), {}).setdefault(round(steps), []).append(wall_s)
        self._medians = {
            group: {steps: median(values) for steps, values in sorted(by_steps.items())}
            for group, by_steps in times_s.items()
        }

    def of(self, tasks: Iterable[SweepTask]) -> Cost:
        """Return the estimated cost of tasks."""
        engine_s, known, unknown = 0.0, 0, 0
        for task in tasks:
            medians = self._medians.get(task.run.group)
            if medians is None or task.run.steps is None:
                unknown += len(task.seeds)
            else:
                known += len(task.seeds)
                engine_s += len(task.seeds) * _interpolated(medians, task.run.steps)
        return Cost(engine_s, known, unknown)


def _interpolated(medians: Mapping[float, float], steps: float) -> float:
    """Return the time for a number of steps [s], from times by numbers of steps in ascending order."""
    most = max(medians)
    if steps > most:
        return medians[most] * steps / most
    return float(np.interp(steps, list(medians), list(medians.values())))


def _measured(folder: SweepFolder) -> list[tuple[str, str, float, float]]:
    """Return experiment, engine, wall time [s] and number of steps of earlier results."""
    if not folder.store_path.exists():
        return []
    try:
        with closing(read_only(folder.store_path)) as connection:
            return connection.execute(
                "SELECT replace(id, 'GAUGE/', ''), backend, wall_s, sim_s / timestep_s AS steps FROM results "
                "WHERE outcome = 'finished' AND wall_s > 0 AND steps BETWEEN 1 AND 1e15 "
                "AND typeof(wall_s) = 'real' AND typeof(steps) = 'real'"
            ).fetchall()
    except (sqlite3.DatabaseError, ResultFileError):
        # A damaged store is made again when the sweep runs.
        return []
