"""Folders and files of a leaderboard, read without following links and within limits of size."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from stat import S_ISDIR, S_ISLNK, S_ISREG

from gauge_envs.errors import ResultFileError
from gauge_envs.files import MEGABYTE, printable, read_regular
from gauge_envs.runs.result_file import MOST_RESULT_BYTES
from gauge_envs.tools.leaderboard.faults import Fault
from gauge_envs.tools.leaderboard.statement import NAME_PATTERN, STATEMENT_FILE

RESULTS_FOLDER = "results"
README = "README.md"

GENERATED = ("leaderboard.json", "leaderboard.md")
"""Files at the top that `gauge leaderboard table --out` writes."""

MOST_ENTRIES = 10_000
"""Largest number of files and folders in one folder."""

MOST_TOTAL_BYTES = 256 * MEGABYTE
"""Largest size of all files of a submission; all 75 results of an engine have less than a third of it."""

LEVELS = ("engine", "version", "configuration")


@dataclass
class SubmissionFiles:
    """Files of one submission that are safe to read.

    Attributes:
        statement: The `submission.toml`; None if it is missing or unsafe.
        results: Result files, sorted by name.
        faults: What is missing, unexpected or unsafe.
    """

    statement: Path | None = None
    results: list[Path] = field(default_factory=list)
    faults: list[Fault] = field(default_factory=list)

    def sha256(self, folder: Path) -> str:
        """Return a hash over names and contents of all files, which changes with any of them."""
        digest = hashlib.sha256()
        for file in filter(None, (self.statement, *self.results)):
            content = hashlib.sha256(read_regular(file, MOST_RESULT_BYTES)).hexdigest()
            digest.update(f"{file.relative_to(folder).as_posix()} {content}\n".encode())
        return digest.hexdigest()


def _entries(folder: Path) -> Iterator[tuple[Path, os.stat_result]]:
    """Yield the sorted entries of a folder with their own status, that of a link included."""
    try:
        names = []
        with os.scandir(folder) as found:
            for entry in found:
                names.append(entry.name)
                if len(names) > MOST_ENTRIES:
                    raise ResultFileError(f"{folder}: more than {MOST_ENTRIES} entries")
        for name in sorted(names):
            yield folder / name, (folder / name).lstat()
    except OSError as error:
        if isinstance(error, ResultFileError):
            raise
        raise ResultFileError(f"{folder}: cannot be listed: {error.strerror or error}") from error


def relative_name(path: Path, root: Path) -> str:
    """Return a path relative to the folder that is checked, safe to print."""
    return printable(path.relative_to(root).as_posix())


def find_submissions(root: Path) -> tuple[list[Path], list[Fault]]:
    """Return the folders of all submissions of a leaderboard, and what does not belong there.

    Args:
        root: Folder of the leaderboard, or of one submission.
    """
    if os.path.lexists(root / STATEMENT_FILE):
        return [root], []
    folders, faults = [root], []
    for depth, level in enumerate(LEVELS):
        inner = []
        for folder in folders:
            for path, status in _entries(folder):
                name = relative_name(path, root)
                allowed = (README, *GENERATED) if depth == 0 else ()
                if S_ISLNK(status.st_mode):
                    faults.append(Fault(file=name, reason="is a link: add the folder itself"))
                elif S_ISDIR(status.st_mode):
                    if re.match(NAME_PATTERN, path.name):
                        inner.append(path)
                    else:
                        faults.append(Fault(file=name, reason=f"is no name of a folder of one {level}"))
                elif not (S_ISREG(status.st_mode) and path.name in allowed):
                    faults.append(Fault(file=name, reason=f"is unexpected here; a folder for each {level} is expected"))
        folders = inner
    return folders, faults


def submission_files(folder: Path, root: Path) -> SubmissionFiles:
    """Return the files of a submission; what is unexpected, linked or too large is a fault and is never opened.

    Args:
        folder: Folder of the submission.
        root: Folder that is checked.
    """
    files = SubmissionFiles()
    total = 0
    for path, status in _entries(folder):
        if path.name == RESULTS_FOLDER and S_ISDIR(status.st_mode):
            for file, inner in _entries(path):
                if fault := _file_fault(file, inner, root, suffix=".json"):
                    files.faults.append(fault)
                else:
                    files.results.append(file)
                    total += inner.st_size
        elif fault := _file_fault(path, status, root, names=(STATEMENT_FILE, README)):
            files.faults.append(fault)
        elif path.name == STATEMENT_FILE:
            files.statement = path
    where = relative_name(folder, root)
    if files.statement is None and not any(fault.file.endswith(STATEMENT_FILE) for fault in files.faults):
        files.faults.append(Fault(file=where, reason=f"has no {STATEMENT_FILE}"))
    if total > MOST_TOTAL_BYTES:
        reason = f"its results have {total / MEGABYTE:.0f} MB, the limit is {MOST_TOTAL_BYTES / MEGABYTE:.0f} MB"
        files.faults.append(Fault(file=where, reason=reason))
        files.results = []
    return files


def _file_fault(
    file: Path, status: os.stat_result, root: Path, *, names: tuple[str, ...] = (), suffix: str = ""
) -> Fault | None:
    """Return why an entry must not be read, or None."""
    name = relative_name(file, root)
    if S_ISLNK(status.st_mode):
        return Fault(file=name, reason="is a link: add the file itself")
    if not S_ISREG(status.st_mode):
        return Fault(file=name, reason="is not a regular file")
    if not (file.name in names or (suffix and file.suffix == suffix and not file.name.startswith("."))):
        expected = ", ".join(names) or f"result files *{suffix}"
        return Fault(file=name, reason=f"is unexpected here; expected: {expected}")
    if status.st_size > MOST_RESULT_BYTES:
        size, limit = status.st_size / MEGABYTE, MOST_RESULT_BYTES / MEGABYTE
        return Fault(file=name, reason=f"has {size:.0f} MB, the limit is {limit:.0f} MB")
    return None
