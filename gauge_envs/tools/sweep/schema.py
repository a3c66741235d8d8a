"""What `gauge sweep` prints with `--json`, a line each."""

from typing import Annotated, TypedDict

from gauge_envs.cli.schemas import Form
from gauge_envs.runs.result import Result


class PlanLine(TypedDict):
    """Episodes of an engine and an experiment that a plan has, with `--dry-run`.

    Attributes:
        backend: Name of the engine.
        experiment: Name of the experiment.
        runs: Number of combinations.
        episodes: Number of episodes.
        declined: Number of episodes that the engine cannot run.
        reason: Why it cannot.
        left: Number of episodes that are not done.
        simulated_s: Simulated time of those that are left and not declined [s].
    """

    backend: str
    experiment: str
    runs: int
    episodes: int
    declined: int
    reason: str | None
    left: int
    simulated_s: float


SweepLine = Annotated[Result, Form(without=("trajectory",))] | PlanLine
"""A result, or a line of the plan."""
