"""`gauge data`."""

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
from gauge_envs.experiments.variants import matching_variants

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
    from gauge_envs.tools.dataset.download import (
        DATASET,
        PINNED_REVISION,
        TRIAL_FILES,
        download_dataset,
        resolved_revision,
    )

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
    from gauge_envs.tools.dataset.importer import import_trials
    from gauge_envs.tools.dataset.layout import find_trials
    from gauge_envs.tools.dataset.words import import_view

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
    from gauge_envs.tools.dataset.status import status_rows
    from gauge_envs.tools.dataset.words import status_table

    print_table(status_table(status_rows(matching_variants(pattern))), json_lines=json_lines, wide=wide)
