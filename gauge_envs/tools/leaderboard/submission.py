"""Submissions of a leaderboard: what each states, and the experiments that the leaderboard asks for."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from gauge_envs.errors import GaugeError, ResultFileError, first_fault
from gauge_envs.experiments.variants import matching_variants
from gauge_envs.files import MOST_TOML_BYTES, read_regular, toml_document

STATEMENT_FILE = "submission.toml"

BOARD_FILE = "board.toml"
"""File at the top whose `experiments` lists the ids or patterns that each submission runs; all 75 without it."""

LEVELS = ("engine", "version", "configuration")
"""What the folders of a submission are named by."""

Standing = Literal["ranked", "shown", "reported"]
"""How the table treats a configuration."""

Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._+-]{0,63}$")]
Line = Annotated[
    str, Field(min_length=1, max_length=200, pattern=r"^[^\x00-\x1f\x7f]+$")
]


class Statement(BaseModel):
    """Content of `submission.toml`: one configuration of one version of an engine.

    Attributes:
        format: Version of this format.
        engine: Name of the backend, and of the first folder.
        package: Package of the engine whose version counts.
        version: Its version, and the name of the second folder.
        configuration: Name of the configuration, and of the third folder.
        submitter: Person or organization.
        url: Page about the submission; empty for none.
        parameters: Parameter set of all experiments.
        settings: Settings that replace those of the engine's preset, in all experiments.
        reason: Why these settings; empty for none.
        standing: `ranked` for the one configuration of an engine that counts in ranks, `shown` for others of it, and
            `reported` for one that no workflow can run, whose results the submitter made.
    """

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True)

    format: Literal[1]
    engine: Name
    package: Name
    version: Name
    configuration: Name
    submitter: Line
    url: Annotated[
        str, Field(max_length=200, pattern=r"^(https://[^\s\x00-\x1f\x7f]+)?$")
    ] = ""
    parameters: Name = "calibrated"
    settings: dict[str, Any] = Field(default_factory=dict)
    reason: Line | Literal[""] = ""
    standing: Standing = "ranked"


def read_statement(file: Path) -> Statement:
    """Read a `submission.toml`, whose folders are named by what it states.

    Raises:
        OSError: It cannot be read.
        ValueError: It states something else.
    """
    content = read_regular(file, MOST_TOML_BYTES)
    try:
        statement = Statement.model_validate(toml_document(content))
    except ValidationError as error:
        raise ValueError(": ".join(first_fault(error))) from error
    except ValueError as error:
        raise ValueError(f"not TOML: {error}") from error
    for key, folder in zip(LEVELS, file.resolve().parts[-4:-1], strict=True):
        stated = getattr(statement, key)
        if stated != folder:
            raise ValueError(f"{key}: is {stated!r}, but the folder is {folder!r}")
    return statement


def board_experiments(root: Path) -> tuple[str, ...]:
    """Return the names of the experiments of the leaderboard that a folder is, or that a submission is in."""
    is_submission = (root / STATEMENT_FILE).exists()
    top = root.resolve().parents[len(LEVELS) - 1] if is_submission else root
    file = top / BOARD_FILE
    try:
        patterns = ["*"]
        if file.is_file():
            patterns = toml_document(read_regular(file, MOST_TOML_BYTES))["experiments"]
        found = (one.name for text in patterns for one in matching_variants(text))
        return tuple(dict.fromkeys(found))
    except (OSError, ValueError, LookupError, TypeError, GaugeError) as error:
        raise ResultFileError(
            f"{file}: expected `experiments`, a list of ids or patterns: {error}"
        ) from error


def find_submissions(root: Path) -> list[Path]:
    """Return the folders of all submissions of a leaderboard, or the folder of one submission.

    Raises:
        ResultFileError: There is none.
    """
    if (root / STATEMENT_FILE).exists():
        return [root]
    found = sorted(file.parent for file in root.glob(f"*/*/*/{STATEMENT_FILE}"))
    if not found:
        raise ResultFileError(
            f"{root}: holds no submission, as <engine>/<version>/<configuration>/{STATEMENT_FILE}"
        )
    return found
