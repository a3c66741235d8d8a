"""Questions to the store of a sweep, in SQL, on a connection that can only read the store."""

from __future__ import annotations

import sqlite3
import sys
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

from gauge_envs.errors import ParameterError, ResultFileError
from gauge_envs.files import MEGABYTE
from gauge_envs.tools.sweep.folder import SweepFolder
from gauge_envs.tools.sweep.store import COLUMNS, SweepStore, read_only

TIME_LIMIT_S = 60.0
"""Time limit of a statement [s]."""

MOST_VALUE_BYTES = 10 * MEGABYTE
"""Largest size of a value; a row of the store has less than a tenth."""

MOST_ANSWER_BYTES = 500 * MEGABYTE
"""Largest memory of the values of an answer."""

STEPS_PER_LOOK = 100_000
"""Instructions of SQLite between two looks at the clock and at Ctrl-C, about a millisecond."""

ALLOWED = (sqlite3.SQLITE_SELECT, sqlite3.SQLITE_READ, sqlite3.SQLITE_FUNCTION, sqlite3.SQLITE_RECURSIVE)
"""What a statement may do: neither write, nor attach a file, nor set a PRAGMA."""


def query_sweep(
    path: Path,
    sql: str,
    *,
    notify: Callable[[str], None] = lambda text: None,
    time_limit_s: float = TIME_LIMIT_S,
    most_bytes: int = MOST_ANSWER_BYTES,
) -> tuple[list[str], list[tuple[Any, ...]]]:
    """Return the columns and rows of a query on the results of a folder.

    The store is brought up to date first, unless a sweep is running there.

    Args:
        path: Folder of a sweep, or of `gauge run`.
        sql: One SELECT statement; the table is `results`.
        notify: Receives a sentence for a damaged store, for each damaged file, and for a store that is not up to date.
        time_limit_s: Time limit of the statement [s].
        most_bytes: Largest memory of the values of the answer.
    """
    folder = SweepFolder(path)
    if next(folder.files(), None) is None:
        raise ResultFileError(f"{path}: no result files there; gauge sweep and gauge run write them")
    try:
        with folder.lock(), SweepStore(folder, notify) as store:
            store.synchronise()
    except (ResultFileError, OSError) as error:
        # A sweep holds the folder, or it cannot be written.
        if not folder.store_path.exists():
            raise
        notify(f"the answer is of what the store has, which is not brought up to date: {error}")
    with closing(read_only(folder.store_path)) as connection:
        return _answer(connection, sql, time_limit_s, most_bytes)


def _answer(
    connection: sqlite3.Connection, sql: str, time_limit_s: float, most_bytes: int
) -> tuple[list[str], list[tuple[Any, ...]]]:
    """Return the columns and rows of a statement."""
    end_s = time.monotonic() + time_limit_s
    connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MOST_VALUE_BYTES)
    connection.set_authorizer(lambda action, *_: sqlite3.SQLITE_OK if action in ALLOWED else sqlite3.SQLITE_DENY)
    connection.set_progress_handler(lambda: time.monotonic() > end_s, STEPS_PER_LOOK)
    rows: list[tuple[Any, ...]] = []
    size = 0
    try:
        cursor = connection.execute(sql)
        if cursor.description is None:
            raise ParameterError("the statement returns no rows; give a SELECT statement")
        for row in cursor:
            rows.append(row)
            size += sum(map(sys.getsizeof, row))
            if size > most_bytes:
                raise ParameterError(
                    f"after {len(rows)} rows the answer has {most_bytes / MEGABYTE:g} MB, the limit: add a LIMIT, or "
                    "name fewer columns"
                )
    except (sqlite3.Error, sqlite3.Warning, UnicodeEncodeError) as error:
        if time.monotonic() > end_s:
            raise ParameterError(f"the statement took more than {time_limit_s:g} s, the limit") from error
        if "not authorized" in str(error) or "prohibited" in str(error):
            raise ParameterError(f"{error}: a query reads the table results, and does nothing else") from error
        raise ParameterError(f"{error}; the table is results, its columns: {', '.join(COLUMNS)}") from error
    return [column[0] for column in cursor.description], rows
