"""Questions to the store of a sweep, in SQL, on a connection that cannot write."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable
from pathlib import Path
from typing import Any

from gauge_envs.errors import ParameterError, ResultFileError
from gauge_envs.runs.sweep.folder import SweepFolder
from gauge_envs.runs.sweep.store import COLUMNS, SweepStore

__all__ = ["query_sweep"]


def query_sweep(
    path: Path, sql: str, *, notify: Callable[[str], None] = lambda text: None
) -> tuple[list[str], list[tuple[Any, ...]]]:
    """Return the columns and rows of a query on the results of a folder.

    The store is brought up to date first, unless a sweep is running there.

    Args:
        path: Folder of a sweep, or of `gauge run`.
        sql: One SELECT statement; the table is `results`.
        notify: Receives a sentence for a damaged store and for each damaged file.

    Raises:
        ResultFileError: The folder does not exist or holds no results.
        ParameterError: The statement is wrong, or would write.
    """
    folder = SweepFolder(path)
    if next(folder.files(), None) is None:
        raise ResultFileError(f"{path}: no result files there; gauge sweep and gauge run write them")
    try:
        with folder.lock(), SweepStore(folder, notify) as store:
            store.synchronise()
    except (ResultFileError, OSError):
        # A sweep holds the folder, or it cannot be written: what the store has is shown.
        if not folder.store_path.exists():
            raise
    connection = sqlite3.connect(f"{folder.store_path.resolve().as_uri()}?mode=ro", uri=True, timeout=60.0)
    try:
        connection.setlimit(sqlite3.SQLITE_LIMIT_ATTACHED, 0)
        cursor = connection.execute(sql)
        if cursor.description is None:
            raise ParameterError("the statement returns no rows; give a SELECT statement")
        return [column[0] for column in cursor.description], cursor.fetchall()
    except (sqlite3.Error, sqlite3.Warning) as error:
        raise ParameterError(f"{error}; the table is results, its columns: {', '.join(COLUMNS)}") from error
    finally:
        connection.close()
