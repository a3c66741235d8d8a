"""Commands for the dataset of real trials and for assets."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from gauge_envs.cli.arguments import Json, Wide
from gauge_envs.cli.output import (
    EXIT_FAILED,
    counted,
    echo,
    plain_text,
    print_json_lines,
    print_table,
    progress_bar,
    stderr_console,
    stdout_console,
)
from gauge_envs.experiments.patterns import matching_variants

__all__ = [
    "assets_app",
    "assets_build",
    "assets_isaac_sim",
    "assets_list",
    "data_app",
    "data_download",
    "data_import",
    "data_status",
]


data_app = typer.Typer(help="The dataset of real trials: bands and drivers from motion capture.", no_args_is_help=True)


@data_app.command("download")
def data_download(
    patterns: Annotated[
        list[str] | None,
        typer.Option("--pattern", help="Files in the dataset, as 'data/rigid/slope slider/*'; repeatable; all trials."),
    ] = None,
    revision: Annotated[
        str | None, typer.Option(help="Commit, branch or tag; by default the one of the bundled data.")
    ] = None,
    folder: Annotated[Path | None, typer.Option("--to", help="Folder; by default below the user's data.")] = None,
) -> None:
    """Download the GAUGE dataset (10 GB in all); an interrupted download resumes."""
    from gauge_envs.dataset.download import DATASET, PINNED_REVISION, TRIAL_FILES, download_dataset, resolved_revision

    commit = resolved_revision(revision or PINNED_REVISION)
    stderr_console().print(f"{DATASET}, revision {revision or PINNED_REVISION} is {commit}", soft_wrap=True)
    path, _ = download_dataset(folder, patterns=patterns or [TRIAL_FILES], revision=commit)
    echo(path)
    stderr_console().print(plain_text(f"gauge data import '{path}' makes bands and drivers from it"), soft_wrap=True)


@data_app.command("import")
def data_import(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of the dataset, which holds 'data'.")],
    only: Annotated[
        list[str] | None, typer.Option("--only", help="Id or pattern of the experiments; repeatable; all by default.")
    ] = None,
    json_lines: Json = False,
) -> None:
    """Make bands and drivers of real trials, beside the published baselines; offline.

    A damaged file is reported and left out. Exit code 1 when any file was left out.
    """
    from gauge_envs.dataset.importer import import_trials
    from gauge_envs.dataset.layout import find_trials
    from gauge_envs.report.dataset import import_view

    layout = find_trials(folder, only=only or ["*"])
    stderr = stderr_console()
    imports, findings = [], list(layout.findings)
    with progress_bar(stderr) as progress:
        bar = progress.add_task("trials", total=layout.count)

        def advance(path: Path) -> None:
            progress.update(bar, advance=1, description=plain_text(layout.relative(path)))

        for one in import_trials(layout, advance=advance):
            imports.append(one)
            findings += one.findings
            if json_lines:
                print_json_lines([one.to_dict()])
    for finding in findings:
        label = "[red]left out:[/]" if finding.left_out else "[yellow]note:[/]"
        stderr.print(f"{label} {plain_text(str(finding))}", soft_wrap=True)
    if json_lines:
        print_json_lines([{"finding": asdict(finding)} for finding in findings])
    else:
        stdout_console().print(import_view(imports))
    trials = sum(one.used for one in imports)
    kept = sum(one.record is not None for one in imports)
    stderr.print(f"{counted(trials, 'trial')} of {counted(kept, 'experiment')} imported")
    if kept:
        stderr.print("Use them with `gauge run ID --drivers imported --reference imported`; the default stays bundled.")
    if any(finding.left_out for finding in findings):
        raise typer.Exit(EXIT_FAILED)


@data_app.command("status")
def data_status(
    pattern: Annotated[str, typer.Argument(help="Id or pattern such as 'SlopeSlider-*'.")] = "*",
    json_lines: Json = False,
    wide: Wide = False,
) -> None:
    """Show the reference and the drivers of each experiment, with imported and published baselines."""
    from gauge_envs.dataset.status import status_rows
    from gauge_envs.report.dataset import status_table

    print_table(status_table(status_rows(matching_variants(pattern))), json_lines=json_lines, wide=wide)


assets_app = typer.Typer(help="Scenes as USD, MJCF and OBJ for other tools.", no_args_is_help=True)


@assets_app.command("build")
def assets_build(
    out: Annotated[Path | None, typer.Option(help="Folder; the checked-in assets/ by default.")] = None,
    check: Annotated[bool, typer.Option("--check", help="Write nothing; exit code 1 if a file is stale.")] = False,
) -> None:
    """Build every scene as USD and MJCF, and every solid as OBJ, from the task files."""
    from gauge_envs.experiments.export.assets import assets_folder, build_assets, stale_asset

    folder = out or assets_folder()
    if not check:
        echo(f"{counted(len(build_assets(folder)), 'file')} in {folder}")
    elif stale := stale_asset(folder):
        stderr_console().print(f"[red]stale:[/] {plain_text(str(stale))}; gauge assets build renews it", soft_wrap=True)
        raise typer.Exit(EXIT_FAILED)
    else:
        echo(f"{folder} is current")


@assets_app.command("list")
def assets_list(json_lines: Json = False) -> None:
    """List the built assets and their experiments."""
    from gauge_envs.experiments.export.assets import asset_rows, assets_folder
    from gauge_envs.report.table import Column, Table

    columns = (
        Column("file", "file"),
        Column("bytes", "KiB", lambda size: f"{size / 1024:.1f}", is_number=True),
        Column("of", "of", _owners_text),
    )
    print_table(Table(columns=columns, rows=asset_rows(assets_folder())), json_lines=json_lines)


@assets_app.command("isaac-sim")
def assets_isaac_sim(
    pattern: Annotated[str, typer.Argument(metavar="ID", help="Id or pattern, as 'TextileBending-*'.")],
    out: Annotated[Path, typer.Option(help="Folder for the layers.")] = Path("isaac_sim"),
) -> None:
    """Write experiments as USD layers that Isaac Sim simulates with examples/isaac_sim/run_layer.py."""
    from gauge_envs.experiments.export.isaac_sim import unsupported_reason, write_isaac_sim_layer
    from gauge_envs.experiments.resolve import load_experiment

    experiments = [load_experiment(variant) for variant in matching_variants(pattern)]
    reasons = [unsupported_reason(experiment.scene) for experiment in experiments]
    supported = [experiment for experiment, reason in zip(experiments, reasons, strict=True) if reason is None]
    # If all are unsupported, the first one raises its reason.
    for experiment in supported or experiments[:1]:
        path = out / f"{experiment.name}.usda"
        write_isaac_sim_layer(experiment, path)
        echo(path)
    for experiment, reason in zip(experiments, reasons, strict=True):
        if reason is not None:
            stderr_console().print(plain_text(f"{experiment.id} is left out: {reason}"), soft_wrap=True)


def _owners_text(names: str) -> str:
    first, *others = names.split(", ")
    return f"{first} and {len(others)} more" if others else first
