"""`gauge data isaac-sim`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gauge_envs.cli import arguments
from gauge_envs.cli.output import echo, message


def data_isaac_sim(
    pattern: Annotated[
        str, typer.Argument(metavar="ID", help="Id or pattern, as 'TextileBending-*'.")
    ],
    out: Annotated[Path, arguments.folder("Folder for the layers.")] = Path(
        "isaac_sim"
    ),
) -> None:
    """Write experiments as USD layers that Isaac Sim simulates.

    examples/isaac_sim/run_layer.py runs them.
    """
    from gauge_envs.experiments.resolve import load_experiment
    from gauge_envs.experiments.variants import matching_variants
    from gauge_envs.tools.assets.isaac_sim import (
        unsupported_reason,
        write_isaac_sim_layer,
    )

    experiments = [load_experiment(variant) for variant in matching_variants(pattern)]
    reasons = {
        experiment.id: unsupported_reason(experiment.scene)
        for experiment in experiments
    }
    # If all are unsupported, the first one raises its reason.
    for experiment in [
        one for one in experiments if reasons[one.id] is None
    ] or experiments[:1]:
        path = out / f"{experiment.name}.usda"
        write_isaac_sim_layer(experiment, path)
        echo(path)
    for name, reason in reasons.items():
        if reason is not None:
            message(f"{name} is left out: {reason}")
