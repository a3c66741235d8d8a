"""What `gauge run`, `gauge score` and `gauge sweep` print with `--json`, and the content of a result file."""

from typing import Annotated

from gauge_envs.cli.schemas import Form
from gauge_envs.runs.result import Result

RunLine = Annotated[Result, Form(without=("trajectory",))]
"""A result without what is long: the trajectory, and the scene and the experiment of the asset."""

ResultFile = Result
"""All of a result."""
