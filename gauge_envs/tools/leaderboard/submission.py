"""Files of a submission, read without following links and within limits of size; what it states; and its faults."""

from __future__ import annotations

import hashlib
import os
import re
from base64 import urlsafe_b64encode
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cache, partial
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from stat import S_ISDIR, S_ISLNK, S_ISREG
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from gauge_envs.errors import GaugeError, ResultFileError, first_fault
from gauge_envs.experiments.variants import matching_variants
from gauge_envs.files import (
    MEGABYTE,
    MOST_TOML_BYTES,
    printable,
    read_regular,
    toml_document,
)
from gauge_envs.runs.result_file import MAX_RESULT_BYTES
from gauge_envs.tools.leaderboard.archive import ARCHIVE, archived_files

STATEMENT_FILE = "submission.toml"

NAME_PATTERN = r"^[A-Za-z0-9][A-Za-z0-9._+-]{0,63}$"
"""Names of folders: no separator, and no leading dot, so that no name leads out of the leaderboard."""

RESULTS_FOLDER = "results"
README = "README.md"

GENERATED = ("leaderboard.json", "leaderboard.md")
"""Files at the top that `gauge leaderboard table --out` writes."""

BOARD_FILE = "board.toml"
"""File at the top whose `experiments` lists the ids or patterns that each submission needs; all 75 without it."""

MAX_ENTRIES = 10_000
"""Largest number of files and folders in one folder."""

MAX_TOTAL_BYTES = 256 * MEGABYTE
"""Largest size of all files of a submission; all 75 results of an engine have less than a third of it."""

LEVELS = ("engine", "version", "configuration")

Name = Annotated[str, Field(pattern=NAME_PATTERN)]
Line = Annotated[
    str, Field(min_length=1, max_length=200, pattern=r"^[^\x00-\x1f\x7f]+$")
]
Setting = bool | int | float | Annotated[str, Field(max_length=200)]


@dataclass(frozen=True, kw_only=True)
class Fault:
    """One thing that is wrong in a submission.

    Attributes:
        file: File or folder, relative to the folder that was checked.
        key: Dotted key in the file, as `score.rmse`; empty for the file as a whole.
        reason: What is wrong, and what would be right.
    """

    file: str
    key: str = ""
    reason: str

    def __str__(self) -> str:
        return ": ".join(part for part in (self.file, self.key, self.reason) if part)


class Statement(BaseModel):
    """Content of `submission.toml`.

    Attributes:
        format: Version of this format.
        engine: Name of the backend, equal to the first folder and to `backend` of each result.
        package: Package whose version counts, a key of `versions` in each result.
        version: Its version, equal to the second folder.
        package_sha256: Hash of the installed files of that package, see `installed_package`; empty if it is not stated.
        configuration: Name of the configuration, equal to the third folder.
        submitter: Person or organization.
        url: Page about the submission; empty for none.
        parameters: Parameter set of all results.
        settings: Settings of the engine that replace those of its preset, in all results.
        left_out: Reason for each experiment without a result, by id or pattern.
    """

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True)

    format: Literal[1]
    engine: Name
    package: Name
    version: Name
    package_sha256: Annotated[str, Field(pattern=r"^([0-9a-f]{64})?$")] = ""
    configuration: Name
    submitter: Line
    url: Annotated[
        str, Field(max_length=200, pattern=r"^(https://[^\s\x00-\x1f\x7f]+)?$")
    ] = ""
    parameters: Name = "calibrated"
    settings: dict[str, Setting] = Field(default_factory=dict)
    left_out: dict[Line, Literal["not supported", "error", "too slow", "not run"]] = (
        Field(default_factory=dict)
    )


def read_statement(file: Path, name: str) -> Statement | Fault:
    """Read a `submission.toml`.

    Args:
        file: The file.
        name: Its name in messages.
    """
    try:
        return Statement.model_validate(
            toml_document(read_regular(file, MOST_TOML_BYTES))
        )
    except OSError as error:
        return Fault(file=name, reason=f"cannot be read: {error.strerror or error}")
    except ValidationError as error:
        place, reason = first_fault(error)
        return Fault(file=name, key=place, reason=reason)
    except ValueError as error:
        return Fault(file=name, reason=f"not TOML: {error}")


@cache
def installed_package(
    package: str, *, has_parts: bool = True
) -> tuple[str, tuple[str, ...]]:
    """Return a hash of the installed files of a package, and which of them differ from its release.

    The RECORD of a package lists the files of its release. Packages that it pins to one version belong to it. Metadata
    have no part. The hash is empty without a list: the package is not installed, or its installation is editable.
    """
    try:
        found = distribution(package)
    except (PackageNotFoundError, ValueError):
        return "", ()
    listed = [
        file
        for file in found.files or ()
        if file.hash is not None and ".." not in file.parts
    ]
    if any("editable" in file.name and file.suffix == ".pth" for file in listed):
        return "", ()
    lines: list[str] = []
    changed: list[str] = []
    for requirement in (found.requires or ()) if has_parts else ():
        pinned = re.fullmatch(r"([\w.-]+)==[\w.]+", requirement)
        if pinned is not None:
            part_sha256, part_changed = installed_package(pinned[1], has_parts=False)
            lines.append(f"{pinned[1]} {part_sha256}\n")
            changed += part_changed
    for file in listed:
        if file.parts[0].endswith(".dist-info"):
            continue
        digest = (
            hashlib.sha256(file.read_binary()).digest()
            if Path(file.locate()).exists()
            else b""
        )
        lines.append(f"{file.as_posix()} {digest.hex()}\n")
        assert file.hash is not None
        if file.hash.value != urlsafe_b64encode(digest).rstrip(b"=").decode():
            changed.append(file.as_posix())
    if not lines:
        return "", tuple(changed)
    return hashlib.sha256("".join(sorted(lines)).encode()).hexdigest(), tuple(changed)


@dataclass
class SubmissionFiles:
    """Files of one submission that are safe to read.

    Attributes:
        statement: The `submission.toml`; None if it is missing or unsafe.
        results: How each result file is read, by its name in the submission, sorted by name.
        faults: What is missing, unexpected or unsafe.
    """

    statement: Path | None = None
    results: dict[str, Callable[[], bytes]] = field(default_factory=dict)
    faults: list[Fault] = field(default_factory=list)

    def sha256(self) -> str:
        """Return a hash over names and contents of all files, which changes with any; empty if one cannot be read.

        It is the same before and after the results are put into an archive.
        """
        readers = dict(self.results)
        if self.statement is not None:
            readers = {STATEMENT_FILE: _reader(self.statement)} | readers
        digest = hashlib.sha256()
        for name, read in readers.items():
            try:
                content = hashlib.sha256(read()).hexdigest()
            except OSError:
                return ""
            digest.update(f"{name} {content}\n".encode())
        return digest.hexdigest()


def _reader(file: Path) -> Callable[[], bytes]:
    return partial(read_regular, file, MAX_RESULT_BYTES)


def _entries(folder: Path) -> Iterator[tuple[Path, os.stat_result]]:
    """Yield the sorted entries of a folder with their own status, that of a link included."""
    try:
        names = []
        with os.scandir(folder) as found:
            for entry in found:
                names.append(entry.name)
                if len(names) > MAX_ENTRIES:
                    raise ResultFileError(f"{folder}: more than {MAX_ENTRIES} entries")
        for name in sorted(names):
            yield folder / name, (folder / name).lstat()
    except OSError as error:
        if isinstance(error, ResultFileError):
            raise
        raise ResultFileError(
            f"{folder}: cannot be listed: {error.strerror or error}"
        ) from error


def relative_name(path: Path, root: Path) -> str:
    """Return a path relative to the folder that is checked, safe to print."""
    return printable(path.relative_to(root).as_posix())


def board_experiments(root: Path) -> tuple[str, ...]:
    """Return the names of the experiments of the leaderboard that a folder is, or that a submission is in."""
    above = (
        root.resolve().parents[: len(LEVELS)]
        if (root / STATEMENT_FILE).exists()
        else ()
    )
    file = next(
        (
            folder / BOARD_FILE
            for folder in (root, *above)
            if (folder / BOARD_FILE).is_file()
        ),
        None,
    )
    try:
        patterns = (
            ["*"]
            if file is None
            else toml_document(read_regular(file, MOST_TOML_BYTES))["experiments"]
        )
        return tuple(
            dict.fromkeys(
                variant.name
                for pattern in patterns
                for variant in matching_variants(pattern)
            )
        )
    except (OSError, ValueError, LookupError, TypeError, GaugeError) as error:
        raise ResultFileError(
            f"{file}: expected `experiments`, a list of ids or patterns: {error}"
        ) from error


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
                allowed = (README, BOARD_FILE, *GENERATED) if depth == 0 else ()
                if S_ISLNK(status.st_mode):
                    faults.append(
                        Fault(file=name, reason="is a link: add the folder itself")
                    )
                elif S_ISDIR(status.st_mode):
                    if re.match(NAME_PATTERN, path.name):
                        inner.append(path)
                    else:
                        faults.append(
                            Fault(
                                file=name,
                                reason=f"is no name of a folder of one {level}",
                            )
                        )
                elif not (S_ISREG(status.st_mode) and path.name in allowed):
                    faults.append(
                        Fault(
                            file=name,
                            reason=f"is unexpected here; a folder for each {level} is expected",
                        )
                    )
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
                    files.results[f"{RESULTS_FOLDER}/{file.name}"] = _reader(file)
                    total += inner.st_size
        elif fault := _file_fault(
            path, status, root, names=(STATEMENT_FILE, README, ARCHIVE)
        ):
            files.faults.append(fault)
        elif path.name == STATEMENT_FILE:
            files.statement = path
        elif path.name == ARCHIVE:
            _add_archive(path, root, files)
    where = relative_name(folder, root)
    if files.statement is None and not any(
        fault.file.endswith(STATEMENT_FILE) for fault in files.faults
    ):
        files.faults.append(Fault(file=where, reason=f"has no {STATEMENT_FILE}"))
    if total > MAX_TOTAL_BYTES:
        reason = f"its results have {total / MEGABYTE:.0f} MB, the limit is {MAX_TOTAL_BYTES / MEGABYTE:.0f} MB"
        files.faults.append(Fault(file=where, reason=reason))
        files.results = {}
    return files


def _add_archive(file: Path, root: Path, files: SubmissionFiles) -> None:
    """Add the result files of an archive, or a fault."""
    name = relative_name(file, root)
    if (file.parent / RESULTS_FOLDER).exists():
        reason = f"is beside {RESULTS_FOLDER}: one of the two is expected"
        files.faults.append(Fault(file=name, reason=reason))
        return
    try:
        found = archived_files(read_regular(file, MAX_RESULT_BYTES), MAX_TOTAL_BYTES)
    except (OSError, ValueError) as error:
        files.faults.append(Fault(file=name, reason=str(error)))
        return
    for inner in sorted(found):
        files.results[inner] = partial(found.__getitem__, inner)


def _file_fault(
    file: Path,
    status: os.stat_result,
    root: Path,
    *,
    names: tuple[str, ...] = (),
    suffix: str = "",
) -> Fault | None:
    """Return why an entry must not be read, or None."""
    name = relative_name(file, root)
    if S_ISLNK(status.st_mode):
        return Fault(file=name, reason="is a link: add the file itself")
    if not S_ISREG(status.st_mode):
        return Fault(file=name, reason="is not a regular file")
    if not (
        file.name in names
        or (suffix and file.suffix == suffix and not file.name.startswith("."))
    ):
        expected = ", ".join(names) or f"result files *{suffix}"
        expected += (
            "; gauge report kept poses in it: delete it"
            if file.name.endswith(".replay.npz")
            else ""
        )
        return Fault(file=name, reason=f"is unexpected here; expected: {expected}")
    if status.st_size > MAX_RESULT_BYTES:
        size, limit = status.st_size / MEGABYTE, MAX_RESULT_BYTES / MEGABYTE
        return Fault(
            file=name, reason=f"has {size:.0f} MB, the limit is {limit:.0f} MB"
        )
    return None
