"""Describe problems of a file or folder of a dataset."""

from dataclasses import dataclass

from gauge_envs.text import printable


@dataclass(frozen=True, kw_only=True)
class ImportFinding:
    """Problem of a file or folder of a dataset.

    Attributes:
        file: Path relative to the folder of the dataset.
        key: Place in the file, for example `foam.17.x`; `(file)` for a whole file, `(folder)` for a folder.
        problem: Description of the problem.
        expected: Expected content.
        left_out: Whether the trial, its prescribed motion or its orientation is left out of the statistics.
    """

    file: str
    key: str
    problem: str
    expected: str
    left_out: bool

    def __str__(self) -> str:
        return f"{self.file}: {self.key}: {self.problem}; {self.expected}"


class TrialError(Exception):
    """A file or folder cannot be used; the importer turns the error into an `ImportFinding`.

    Args:
        key: Place in the file.
        problem: Description of the problem.
        expected: Expected content.
    """

    def finding(self, file: str, *, left_out: bool = True) -> ImportFinding:
        """Return the problem with the name of its file."""
        key, problem, expected = map(printable, self.args)
        return ImportFinding(
            file=printable(file),
            key=key,
            problem=problem,
            expected=expected,
            left_out=left_out,
        )
