"""The file `submission.toml`: what was run, by whom, and which experiments are left out."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from gauge_envs.errors import first_fault
from gauge_envs.files import MOST_TOML_BYTES, read_regular, toml_document
from gauge_envs.tools.leaderboard.faults import Fault

STATEMENT_FILE = "submission.toml"

NAME_PATTERN = r"^[A-Za-z0-9][A-Za-z0-9._+-]{0,63}$"
"""Names of folders: no separator, and no leading dot, so that no name leads out of the leaderboard."""

Name = Annotated[str, Field(pattern=NAME_PATTERN)]
Line = Annotated[str, Field(min_length=1, max_length=200, pattern=r"^[^\x00-\x1f\x7f]+$")]
Setting = bool | int | float | Annotated[str, Field(max_length=200)]


class Statement(BaseModel):
    """Content of `submission.toml`.

    Attributes:
        format: Version of this format.
        engine: Name of the backend, equal to the first folder and to `backend` of each result.
        package: Package whose version counts, a key of `versions` in each result.
        version: Its version, equal to the second folder.
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
    configuration: Name
    submitter: Line
    url: Annotated[str, Field(max_length=200, pattern=r"^(https://[^\s\x00-\x1f\x7f]+)?$")] = ""
    parameters: Name = "calibrated"
    settings: dict[str, Setting] = Field(default_factory=dict)
    left_out: dict[Line, Line] = Field(default_factory=dict)

    def settings_given(self) -> dict[str, Any]:
        """Return the settings as a result states them."""
        return dict(self.settings)


def read_statement(file: Path, name: str) -> Statement | Fault:
    """Read a `submission.toml`.

    Args:
        file: The file.
        name: Its name in messages.
    """
    try:
        return Statement.model_validate(toml_document(read_regular(file, MOST_TOML_BYTES)))
    except OSError as error:
        return Fault(file=name, reason=f"cannot be read: {error.strerror or error}")
    except ValidationError as error:
        place, reason = first_fault(error)
        return Fault(file=name, key=place, reason=reason)
    except ValueError as error:
        return Fault(file=name, reason=f"not TOML: {error}")
