"""The SQLite store of a sweep: one row for each result file, made from the files alone.

The table `results` has the scalar fields of a result and of its score as columns. Mappings, as `settings`, are JSON
texts: `json_extract(settings, '$.iterations')` reads one entry.
"""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Callable, Container
from dataclasses import fields
from pathlib import Path
from typing import Any

from gauge_envs.errors import ResultFileError
from gauge_envs.evaluation.score import Score
from gauge_envs.runs.batch import move_aside
from gauge_envs.runs.result import Outcome, Result
from gauge_envs.runs.sweep.folder import SweepFolder
from gauge_envs.runs.sweep.key import KEY_LENGTH

__all__ = ["COLUMNS", "SweepStore"]

Notify = Callable[[str], None]

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


class SweepStore:
    """The store of a folder, opened to be written. Close it, or use it in a `with` statement.

    A store that is damaged, or has other columns, is moved aside and made again from the files.

    Args:
        folder: The folder.
        notify: Receives a sentence for a damaged store and for each damaged file.

    Raises:
        ResultFileError: The store cannot be opened.
    """

    def __init__(self, folder: SweepFolder, notify: Notify) -> None:
        self._folder = folder
        self._notify = notify
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

    def add(self, result: Result, file: Path) -> None:
        """Add or replace the row of a result file.

        Raises:
            ResultFileError: The row cannot be written.
        """
        row = _row(result, file, self._name(file))
        marks = ", ".join("?" * len(COLUMNS))
        try:
            with self._connection:
                # An episode has one file: a result takes the place of an earlier failure.
                self._connection.execute("DELETE FROM results WHERE key = ?", [row["key"]])
                self._connection.execute(f"INSERT OR REPLACE INTO results VALUES ({marks})", [row[c] for c in COLUMNS])
        except sqlite3.Error as error:
            raise ResultFileError(f"{self._folder.store_path}: cannot be written: {error}") from error

    def diverged(self, names: Container[str]) -> dict[str, Outcome]:
        """Return those of some file names whose episodes diverged, with that outcome."""
        rows = self._connection.execute("SELECT file FROM results WHERE outcome = ?", [Outcome.DIVERGED.value])
        return {name: Outcome.DIVERGED for (name,) in rows if name in names}

    def synchronise(self) -> int:
        """Make the rows those of the files, and return how many files were read.

        A file whose size and time are those of its row is not read again. A damaged file is moved aside.

        Raises:
            ResultFileError: A row cannot be written.
        """
        rows = self._connection.execute("SELECT file, file_bytes, file_mtime_ns FROM results")
        known = {name: (size, mtime_ns) for name, size, mtime_ns in rows}
        read = 0
        for entry in list(self._folder.files()):
            file, status = Path(entry.path), entry.stat()
            if known.pop(self._name(file), None) == (status.st_size, status.st_mtime_ns):
                continue
            read += 1
            try:
                self.add(self._folder.read(file), file)
            except ResultFileError as error:
                if not file.exists():
                    raise
                self._notify(f"{error}; moved to {move_aside(file).name}")
        with self._connection:
            self._connection.executemany("DELETE FROM results WHERE file = ?", [(name,) for name in known])
        return read

    def _name(self, file: Path) -> str:
        return file.relative_to(self._folder.path).as_posix()

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
    """Return a connection to a store, which is created if it does not exist.

    Raises:
        _DamagedError: The file is no store, or has other columns.
        sqlite3.OperationalError: It cannot be opened.
    """
    connection = sqlite3.connect(path, timeout=60.0)
    try:
        # The files are written safely, and the store can be made again from them.
        connection.execute("PRAGMA synchronous = OFF")
        columns = ", ".join(f"{name} {kind}" for name, kind in COLUMNS.items())
        connection.execute(f"CREATE TABLE IF NOT EXISTS results ({columns})")
        found = [row[1] for row in connection.execute("PRAGMA table_info(results)")]
        if found != list(COLUMNS):
            raise _DamagedError("the table has the columns of another version")
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
    return row | {
        "file": name,
        "key": stem if _is_key(stem) else None,
        "preset": result.settings.get("preset") or result.settings_given.get("preset"),
        "timestep_s": result.settings.get("timestep_s") or result.settings_given.get("timestep_s"),
        "score": result.score.primary_normalized,
        "score_low": low,
        "score_high": high,
        "file_bytes": status.st_size,
        "file_mtime_ns": status.st_mtime_ns,
    }


def _is_key(text: str) -> bool:
    return len(text) == KEY_LENGTH and set(text) <= set("0123456789abcdef")
