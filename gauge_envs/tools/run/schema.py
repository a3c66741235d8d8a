"""JSON lines of `gauge run`, `gauge score` and `gauge sweep`, and the content of a result file."""

from typing import Annotated

from gauge_envs.cli.schemas import Form
from gauge_envs.runs.result import Result

RunLine = Annotated[Result, Form(without=("trajectory",))]
"""A result without its trajectory, and without the scene and the experiment of its asset."""

ResultFile = Result
"""A complete result."""
