"""Faults of a submission."""

from __future__ import annotations

from dataclasses import dataclass


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
