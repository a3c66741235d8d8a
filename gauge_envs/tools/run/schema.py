"""JSON lines of `gauge run`, `gauge score` and `gauge sweep`."""

from typing import Annotated, TypedDict

from gauge_envs.cli.schemas import Form
from gauge_envs.runs.result import Result

RunLine = Annotated[Result, Form(without=("trajectory",))]
"""A result without its trajectory, and without the scene and the experiment of its asset."""


class PlanLine(TypedDict):
    """Planned episodes of an engine and an experiment, with `--dry-run`.

    Attributes:
        backend: Name of the engine.
        experiment: Name of the experiment.
        runs: Number of combinations.
        episodes: Number of episodes.
        unsupported: Number of unsupported episodes.
        reason: Why they are unsupported.
        left: Number of remaining episodes.
        simulated_s: Simulated time of the remaining supported episodes [s].
    """

    backend: str
    experiment: str
    runs: int
    episodes: int
    unsupported: int
    reason: str | None
    left: int
    simulated_s: float


SweepLine = RunLine | PlanLine
"""A result, or a line of the plan."""
