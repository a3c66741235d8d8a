"""`gauge plot`."""

from pathlib import Path
from typing import Annotated, Literal

from gauge_envs.cli import arguments
from gauge_envs.cli.output import echo
from gauge_envs.cli.results import loaded_results
from gauge_envs.errors import ParameterError


def plot(
    sources: arguments.Sources = None,
    metric: arguments.Metrics = None,
    corrected: arguments.Corrected = True,
    kind: Annotated[
        Literal["experiments", "compare"],
        arguments.option(arguments.OUTPUT, "What to draw."),
    ] = "experiments",
    out: Annotated[Path, arguments.folder("Folder for the pictures.")] = Path("plots"),
) -> bool:
    """Draw results: experiments over real bands, or a comparison.

    --metric and --corrected need --kind compare. Exit code 1: a damaged file was skipped.
    """
    from gauge_envs.tools.compare.experiment_figure import save_figures
    from gauge_envs.tools.compare.overview_figure import save_comparison
    from gauge_envs.tools.compare.report import check_metrics

    if kind == "experiments" and metric:
        raise ParameterError("--metric needs --kind compare")
    if kind == "experiments" and not corrected:
        raise ParameterError("--no-corrected needs --kind compare")
    names = check_metrics(metric or ())
    if len(names) > 1:
        raise ParameterError(
            f"--metric {','.join(names)}: a picture shows one metric; give one"
        )
    loaded, skipped = loaded_results(sources, with_scene=True, corrected=corrected)
    results = list(loaded.values())
    if kind == "experiments":
        files = save_figures(results, out)
    else:
        files = save_comparison(results, out, metric=next(iter(names), None))
    for file in files:
        echo(file)
    return bool(skipped)
