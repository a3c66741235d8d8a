"""The `gauge` command. Heavy imports are inside the commands, so that help and completion stay quick."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from enum import StrEnum
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
import typer.core
from rich.console import Console

from gauge_envs.driver import DriverSource
from gauge_envs.errors import GaugeError, ParameterError, ResultFileError, UnknownNameError
from gauge_envs.experiment import Parameters
from gauge_envs.jitter import Jitter
from gauge_envs.task import find_variant, variants
from gauge_envs.task_format import Variant

if TYPE_CHECKING:
    from gauge_envs.result import Result

__all__ = ["app", "main"]

EXIT_FAILED = 1
"""An episode failed, diverged, or was asked for by name and declined."""
EXIT_USAGE = 2
"""What was asked for cannot be done."""
EXIT_INTERRUPTED = 130

PIPE_WIDTH = 140
"""Width of tables where there is no terminal [characters]; rich would take 80, and cut them."""

GLOB_CHARACTERS = "*?["


class FailOn(StrEnum):
    """From which verdict on a sanity check fails."""

    WRONG = "wrong"
    VISIBLE = "visible"
    NEVER = "never"


class _Group(typer.core.TyperGroup):
    """Prints errors of gauge-envs without a traceback; the only place that catches them."""

    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except GaugeError as error:
            _stderr().print(f"[red]error:[/] {_plain(str(error))}", soft_wrap=True)
            raise typer.Exit(EXIT_USAGE) from None
        except KeyboardInterrupt:
            _stderr().print("interrupted")
            raise typer.Exit(EXIT_INTERRUPTED) from None


app = typer.Typer(
    cls=_Group,
    name="gauge",
    help="Measure how far a physics engine is from real motion-capture trials (GAUGE benchmark).",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
backend_app = typer.Typer(help="Installed physics engines.", no_args_is_help=True)
app.add_typer(backend_app, name="backend")
assets_app = typer.Typer(help="Scenes as USD, MJCF and OBJ for other tools.", no_args_is_help=True)
app.add_typer(assets_app, name="assets")

data_app = typer.Typer(help="The dataset of real trials: bands and drivers from motion capture.", no_args_is_help=True)
app.add_typer(data_app, name="data")

Json = Annotated[bool, typer.Option("--json", help="JSON on stdout, one object a line.")]
AssetOption = Annotated[
    Path | None,
    typer.Option(
        "--asset", help="File that the scene is from, instead of the task file: a USD layer, or MJCF for mujoco."
    ),
]
ParametersOption = Annotated[
    str | None,
    typer.Option("--parameters", help="calibrated, effective, ..., or overrides: cube.friction=0.3,cube.mass_kg=0.1"),
]


def main() -> None:
    """Entry point of the `gauge` command."""
    app()


# --- commands --------------------------------------------------------------------------------------------------------


@app.command("list")
def list_(
    pattern: Annotated[str, typer.Argument(help="Id or pattern such as 'SlopeSlider-*'.")] = "*",
    json_lines: Json = False,
) -> None:
    """List experiments: what they observe, how good their reference is, and which backends can run them."""
    from gauge_envs.report import control_summary, list_rows, list_table

    rows = list_rows(_matching(pattern))
    if json_lines:
        _print_lines(rows)
        return
    families = len({row["family"] for row in rows})
    console = _stdout()
    console.print(list_table(rows))
    if pattern == "*":
        console.print(control_summary(), soft_wrap=True)
    console.print(f"{_count(len(rows), 'id')} in {families} {'family' if families == 1 else 'families'}")


@app.command()
def show(
    name: Annotated[str, typer.Argument(metavar="ID", help="Id, with or without GAUGE/; or an experiment file.")],
    asset: AssetOption = None,
    json_lines: Json = False,
) -> None:
    """Show one experiment: scene, constants and where each number is from, reference, published scores.

    Of a control task: its law, limit and reward.
    """
    from gauge_envs.control import control_tasks, find_control_task
    from gauge_envs.experiment import experiment
    from gauge_envs.report import control_description, control_view, description, description_view

    if name.removeprefix("GAUGE/") in {task.name for task in control_tasks()}:
        values = control_description(find_control_task(name))
        view = control_view(values)
    else:
        values = description(experiment(name, asset=asset))
        view = description_view(values)
    if json_lines:
        _print_lines([values])
    else:
        _stdout().print(view)


@app.command()
def run(
    ids: Annotated[
        list[str] | None,
        typer.Argument(metavar="[ID or pattern]...", help="As 'SlopeSlider-*'; or experiment files, as crate.toml."),
    ] = None,
    every: Annotated[bool, typer.Option("--all", help="All experiments that the backend can run.")] = False,
    backends: Annotated[list[str] | None, typer.Option("--backend", help="Repeatable; mujoco by default.")] = None,
    parameters: ParametersOption = None,
    asset: AssetOption = None,
    changes: Annotated[
        list[str] | None, typer.Option("--set", help="Numerical setting of the backend, as timestep_s=0.0005.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0)] = 0,
    marker_proxy: Annotated[
        str,
        typer.Option(help="What stands for a marker on a deformable body: node, the nearest, or material, its own."),
    ] = "node",
    repeats: Annotated[
        int, typer.Option(min=1, help="Runs of each, at once, from starts that scatter as real ones do.")
    ] = 1,
    jitter_mm: Annotated[
        float | None, typer.Option(min=0.0, help="Standard deviation of start positions [mm]; 1.0 with --repeats.")
    ] = None,
    jitter_deg: Annotated[
        float | None, typer.Option(min=0.0, help="Standard deviation of start angles [deg]; 0.5 with --repeats.")
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder for the result files.")] = Path("results"),
    resume: Annotated[bool, typer.Option(help="Keep results that are there already.")] = False,
    json_lines: Json = False,
) -> None:
    """Run experiments, score them against reality, and write a result file each.

    Exit code 1 when an episode failed or diverged, or one that was asked for by its id was declined; those that a
    pattern or --all adds may be declined.
    """
    from gauge_envs.benchmark import check_request, run_many
    from gauge_envs.experiment import experiment
    from gauge_envs.observer import checked_proxy
    from gauge_envs.report import summary_view
    from gauge_envs.result import Outcome

    if not ids and not every:
        raise ParameterError("nothing to run: give ids, patterns or --all; gauge list shows them")
    patterns = ["*"] if every else ids or []
    chosen = list(dict.fromkeys(subject for pattern in patterns for subject in _subjects(pattern)))
    named = dict.fromkeys(subject for pattern in ids or [] if not _is_glob(pattern) for subject in _subjects(pattern))
    engines = list(dict.fromkeys(backends or ["mujoco"]))
    values, settings = _parameters(parameters) or "calibrated", _settings(changes or [])
    check_request(chosen, backends=engines, parameters=values, settings=settings, asset=asset)
    by_name = {experiment(subject, asset=asset).id for subject in named}

    stderr = _stderr()
    results: list[Result] = []
    episodes = run_many(
        chosen,
        backends=engines,
        parameters=values,
        settings=settings,
        marker_proxy=checked_proxy(marker_proxy).value,
        asset=asset,
        seed=seed,
        repeats=repeats,
        jitter=_jitter(jitter_mm, jitter_deg),
        out=out,
        resume=resume,
        notify=lambda text: stderr.print(f"[yellow]note:[/] {_plain(text)}", soft_wrap=True),
    )
    try:
        with _progress(stderr) as progress:
            bar = progress.add_task("episodes", total=len(chosen) * len(engines) * repeats)
            for result in episodes:
                results.append(result)
                progress.update(bar, advance=1, description=result.id.removeprefix("GAUGE/"))
                if json_lines:
                    _print_lines([result.to_dict(trajectory=False)])
    except KeyboardInterrupt:
        kept = sum(result.error is None for result in results)
        stderr.print(f"interrupted: {_count(kept, 'result')} kept in {out}; --resume goes on from there")
        raise typer.Exit(EXIT_INTERRUPTED) from None
    (stderr if json_lines else _stdout()).print(summary_view(results))
    stderr.print(_totals(results, out))
    bad = (Outcome.FAILED, Outcome.DIVERGED)
    if any(r.outcome in bad or (r.outcome is Outcome.DECLINED and r.id in by_name) for r in results):
        raise typer.Exit(EXIT_FAILED)


@app.command()
def score(
    file: Annotated[Path, typer.Argument(help="CSV, NPZ or JSON; also a result file.")],
    name: Annotated[
        str | None, typer.Option("--id", help="Experiment, or experiment file; a JSON file may state it itself.")
    ] = None,
    parameters: ParametersOption = None,
    use_withheld: Annotated[
        bool, typer.Option("--use-withheld", help="Score on a band that is withheld; gauge show tells why it is.")
    ] = False,
    json_lines: Json = False,
) -> None:
    """Score a trajectory from your own simulator: g(t) in the observable's unit (mm for positions), no engine needed.

    Columns are the coordinates that `gauge show ID` lists. Without a `time_s` column, rows are 30 Hz frames.
    """
    from gauge_envs.benchmark import score_file
    from gauge_envs.report import summary_view

    result, interpolated = score_file(file, variant=name, parameters=_parameters(parameters), use_withheld=use_withheld)
    if interpolated:
        _stderr().print(f"[yellow]note:[/] {_count(interpolated, 'frame')} lay between samples: interpolated linearly")
    if json_lines:
        _print_lines([result.to_dict(trajectory=False)])
    else:
        _stdout().print(summary_view([result]))


@app.command()
def plot(
    sources: Annotated[
        list[Path] | None, typer.Argument(metavar="[DIR or FILE]...", help="Result files; results/ by default.")
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder for the pictures.")] = Path("plots"),
) -> None:
    """Plot results over the real band, one PNG an experiment; several results of one experiment share it."""
    from gauge_envs.figures import save_figures

    results, skipped = _loaded(sources)
    for path in save_figures(results, out):
        typer.echo(path)
    if skipped:
        raise typer.Exit(EXIT_FAILED)


@app.command()
def compare(
    sources: Annotated[
        list[Path] | None, typer.Argument(metavar="[DIR or FILE]...", help="Result files; results/ by default.")
    ] = None,
    json_lines: Json = False,
    markdown: Annotated[bool, typer.Option("--markdown", help="Tables as GitHub Markdown.")] = False,
    out: Annotated[Path | None, typer.Option(help="Folder for pictures; none are drawn without it.")] = None,
    metrics: Annotated[
        list[str] | None,
        typer.Option("--metric", help="Repeatable: rmse, dtw, rmse_aligned, lsd, mte, pd, el; all by default."),
    ] = None,
) -> None:
    """Compare engines, parameters and settings: scores side by side, and where they disagree without a reference.

    Results that differ in their seed alone are repeats: mean and scatter. Exit code 1 when a damaged file was skipped.
    """
    from gauge_envs.comparison import check_metrics
    from gauge_envs.comparison import compare as compare_results
    from gauge_envs.report import comparison_markdown, comparison_rows, comparison_view

    _check_one_format(json_lines, markdown)
    chosen = check_metrics(metrics or [])
    results, skipped = _loaded(sources)
    comparison = compare_results(results)
    if json_lines:
        _print_lines(comparison_rows(comparison, chosen))
    elif markdown:
        typer.echo(comparison_markdown(comparison, chosen), nl=False)
    else:
        _stdout().print(comparison_view(comparison, chosen))
    if out is not None:
        from gauge_envs.figures import save_comparison

        for path in save_comparison(results, out, metric=chosen[0]):
            _stderr().print(_plain(str(path)), soft_wrap=True)
    if skipped:
        raise typer.Exit(EXIT_FAILED)


@app.command()
def diagnose(
    sources: Annotated[
        list[Path] | None, typer.Argument(metavar="[DIR or FILE]...", help="Result files; results/ by default.")
    ] = None,
    name: Annotated[
        str | None, typer.Option("--id", help="Files are trajectories of this experiment, as for gauge score.")
    ] = None,
    order: Annotated[
        str, typer.Option(help="Parts in the order in which they are added to the fit.")
    ] = "release,offset,rate",
    measured_only: Annotated[bool, typer.Option("--measured-only", help="Leave out extrapolated frames.")] = False,
    use_withheld: Annotated[
        bool, typer.Option("--use-withheld", help="Also on a band that is withheld; gauge show tells why it is.")
    ] = False,
    out: Annotated[Path | None, typer.Option(help="Folder for a picture; none is drawn without it.")] = None,
    json_lines: Json = False,
) -> None:
    """Split the error of episodes: release time, constant offset, rate or scale of the motion, and the rest.

    Results without a reference, or that did not run to their end, are told and left out; exit code 2 where none is
    left, 1 when a damaged file was skipped.
    """
    from gauge_envs.benchmark import score_file
    from gauge_envs.diagnosis import Diagnosis, DiagnosisError, stage_order
    from gauge_envs.diagnosis import diagnose as diagnose_result
    from gauge_envs.report import diagnosis_rows, diagnosis_view

    stages = stage_order(part.strip() for part in order.split(","))
    if name is None:
        results, skipped = _loaded(sources)
    else:
        if not sources:
            raise ParameterError("--id says what trajectory files are of: give the files")
        results, skipped = [score_file(file, variant=name, use_withheld=use_withheld)[0] for file in sources], 0
    pairs: list[tuple[Result, Diagnosis]] = []
    reasons: list[str] = []
    for result in results:
        try:
            diagnosis = diagnose_result(result, order=stages, measured_only=measured_only, use_withheld=use_withheld)
            pairs.append((result, diagnosis))
        except DiagnosisError as error:
            reasons.append(str(error))
    if results and not pairs:
        raise DiagnosisError("; ".join(dict.fromkeys(reasons)))
    for reason in dict.fromkeys(reasons):
        _stderr().print(f"[yellow]left out:[/] {_plain(reason)}", soft_wrap=True)
    if json_lines:
        _print_lines(diagnosis_rows(pairs))
    else:
        _stdout().print(diagnosis_view(pairs))
    if out is not None:
        from gauge_envs.figures import save_diagnoses

        _stderr().print(_plain(str(save_diagnoses(pairs, out))), soft_wrap=True)
    if skipped:
        raise typer.Exit(EXIT_FAILED)


@app.command()
def sanity(
    target: Annotated[
        str,
        typer.Argument(
            help="What a policy is trained with: a Gymnasium id with a MuJoCo model (HalfCheetah-v5), a model file "
            "(robot.xml), a settings file (.toml, .json), or a backend and a preset (mujoco:out_of_box, newton)."
        ),
    ],
    pair: Annotated[
        str | None,
        typer.Option(
            metavar="GEOM1,GEOM2", help="Contact whose constants are used, instead of the most frequent on ground."
        ),
    ] = None,
    only: Annotated[
        list[str] | None, typer.Option("--only", help="Id or pattern of phenomena, as 'creep-*'; repeatable.")
    ] = None,
    every: Annotated[bool, typer.Option("--all", help="Deformable bodies too, which take longer.")] = False,
    fail_on: Annotated[FailOn, typer.Option(help="Exit code 1 when a phenomenon is at least as bad as this.")] = (
        FailOn.NEVER
    ),
    html: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Page with pictures, in one file; none is written without it.")
    ] = None,
    markdown: Annotated[bool, typer.Option("--markdown", help="The table as GitHub Markdown.")] = False,
    json_lines: Json = False,
) -> None:
    """Tell what physics a training configuration gets wrong, and which of its settings are responsible.

    Runs measured objects with the numerical settings of the target and of its backend's default, and compares both
    with real trials. Exit code 1 also when nothing could be measured.
    """
    from gauge_envs.report.sanity import sanity_markdown, sanity_rows, sanity_view
    from gauge_envs.report.sanity_page import check_can_draw, save_sanity_page
    from gauge_envs.sanity import Row, Verdict, check, configuration
    from gauge_envs.sanity.phenomena import phenomena

    _check_one_format(json_lines, markdown)
    if html is not None:
        check_can_draw()
    checked = configuration(target, pair=_geom_pair(pair))
    patterns = only or []
    with _progress(_stderr()) as progress:
        bar = progress.add_task("phenomena", total=len(phenomena(patterns, include_deformables=every)))

        def notify(row: Row) -> None:
            progress.update(bar, advance=1, description=row.phenomenon)

        report = check(checked, only=patterns, include_deformables=every, notify=notify)
    if json_lines:
        _print_lines(sanity_rows(report))
    elif markdown:
        typer.echo(sanity_markdown(report), nl=False)
    else:
        _stdout().print(sanity_view(report))
    if html is not None:
        _stderr().print(_plain(str(save_sanity_page(report, html))), soft_wrap=True)
    bad = {FailOn.WRONG: (Verdict.WRONG,), FailOn.VISIBLE: (Verdict.WRONG, Verdict.VISIBLE), FailOn.NEVER: ()}
    if report.worst in (*bad[fail_on], Verdict.DECLINED):
        raise typer.Exit(EXIT_FAILED)


@app.command()
def materials(json_lines: Json = False) -> None:
    """Show the six fabrics in every engine's constants, what comes back from them, and what is lost."""
    from gauge_envs.materials import fabrics
    from gauge_envs.report import material_values, material_view

    if json_lines:
        _print_lines([material_values(fabrics())])
    else:
        _stdout().print(material_view(fabrics()))


@backend_app.command("list")
def backend_list(json_lines: Json = False) -> None:
    """List installed backends and the versions of their engines."""
    from gauge_envs.report import backend_rows, backend_table

    rows = backend_rows()
    if json_lines:
        _print_lines(rows)
    else:
        _stdout().print(backend_table(rows))


@backend_app.command("check")
def backend_check(
    names: Annotated[list[str], typer.Argument(metavar="NAME...", help="Backends; one column of the table each.")],
    only: Annotated[list[str] | None, typer.Option("--only", help="Id or pattern of checks; repeatable.")] = None,
    changes: Annotated[
        list[str] | None, typer.Option("--set", help="Numerical setting of the backends, as timestep_s=0.0005.")
    ] = None,
    json_lines: Json = False,
    markdown: Annotated[bool, typer.Option("--markdown", help="The table in Markdown, for a README.")] = False,
) -> None:
    """Check backends against closed forms: small scenes that show where an engine is wrong, and why.

    Exit code 1 when a check failed or raised an error; what a backend declines is no failure.
    """
    from gauge_envs.conformance import checks, run_checks
    from gauge_envs.conformance.table import findings_markdown, findings_view

    engines = list(dict.fromkeys(names))
    patterns, settings = only or [], _settings(changes or [])
    runs = [run_checks(name, settings=settings, only=patterns) for name in engines]
    findings = []
    stderr = _stderr()
    with _progress(stderr) as progress:
        bar = progress.add_task("checks", total=len(checks(patterns)) * len(engines))
        for run in runs:
            for finding in run:
                findings.append(finding)
                progress.update(bar, advance=1, description=f"{finding.backend}: {finding.check}")
                if json_lines:
                    _print_lines([finding.to_dict()])
    if markdown:
        typer.echo(findings_markdown(findings))
    elif not json_lines:
        _stdout().print(findings_view(findings))
    bad = sum(finding.is_bad for finding in findings)
    stderr.print(f"{_count(len(findings), 'check')}, {bad} failed")
    if bad:
        raise typer.Exit(EXIT_FAILED)


@assets_app.command("build")
def assets_build(
    out: Annotated[Path | None, typer.Option(help="Folder; the checked-in assets/ by default.")] = None,
    check: Annotated[bool, typer.Option("--check", help="Write nothing; exit code 1 if a file is stale.")] = False,
) -> None:
    """Build every scene as USD, every rigid one as MJCF, and every solid as OBJ, from the task files."""
    from gauge_envs.assets import assets_folder, build_assets, stale_asset

    folder = out or assets_folder()
    if not check:
        typer.echo(f"{_count(len(build_assets(folder)), 'file')} in {folder}")
    elif stale := stale_asset(folder):
        _stderr().print(f"[red]stale:[/] {_plain(str(stale))}; gauge assets build renews it", soft_wrap=True)
        raise typer.Exit(EXIT_FAILED)
    else:
        typer.echo(f"{folder} is current")


@assets_app.command("list")
def assets_list(json_lines: Json = False) -> None:
    """List the built assets, and what each shows."""
    from rich.table import Table

    from gauge_envs.assets import asset_rows, assets_folder

    rows = asset_rows(assets_folder())
    if json_lines:
        _print_lines(rows)
        return
    table = Table("file", "KiB", "of", box=None)
    for row in rows:
        table.add_row(row["file"], f"{row['bytes'] / 1024:.1f}", row["of"])
    _stdout().print(table)


@data_app.command("download")
def data_download(
    patterns: Annotated[
        list[str] | None,
        typer.Option("--pattern", help="Files in the dataset, as 'data/rigid/slope slider/*'; repeatable; all trials."),
    ] = None,
    revision: Annotated[
        str | None, typer.Option(help="Commit, branch or tag; by default the one that the bundled facts are from.")
    ] = None,
    folder: Annotated[Path | None, typer.Option("--to", help="Folder; by default below the user's data.")] = None,
) -> None:
    """Download the GAUGE dataset (10 GB in all); an interrupted download goes on where it stopped."""
    from gauge_envs.dataset.download import DATASET, PINNED_REVISION, TRIAL_FILES, download_dataset, resolved_revision

    commit = resolved_revision(revision or PINNED_REVISION)
    _stderr().print(f"{DATASET}, revision {revision or PINNED_REVISION} is {commit}", soft_wrap=True)
    path, _ = download_dataset(folder, patterns=patterns or [TRIAL_FILES], revision=commit)
    typer.echo(path)
    _stderr().print(_plain(f"gauge data import '{path}' makes bands and drivers of it"), soft_wrap=True)


@data_app.command("import")
def data_import(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of the dataset, which holds 'data'.")],
    only: Annotated[
        list[str] | None, typer.Option("--only", help="Id or pattern of the experiments; repeatable; all by default.")
    ] = None,
    json_lines: Json = False,
) -> None:
    """Make bands and drivers of real trials, beside the published baselines; offline.

    A damaged file is reported and left out, the others are used. Exit code 1 when any was left out.
    """
    from gauge_envs.dataset.importer import import_trials
    from gauge_envs.dataset.layout import find_trials
    from gauge_envs.dataset.views import import_view

    layout = find_trials(folder, only=only or ["*"])
    stderr = _stderr()
    imports, findings = [], list(layout.findings)
    with _progress(stderr) as progress:
        bar = progress.add_task("trials", total=layout.count)

        def advance(path: Path) -> None:
            progress.update(bar, advance=1, description=_plain(layout.relative(path)))

        for one in import_trials(layout, advance=advance):
            imports.append(one)
            findings += one.findings
            if json_lines:
                _print_lines([one.to_dict()])
    for finding in findings:
        label = "[red]left out:[/]" if finding.left_out else "[yellow]note:[/]"
        stderr.print(f"{label} {_plain(str(finding))}", soft_wrap=True)
    if json_lines:
        _print_lines([{"finding": asdict(finding)} for finding in findings])
    else:
        _stdout().print(import_view(imports))
    trials = sum(one.used for one in imports)
    kept = sum(one.record is not None for one in imports)
    stderr.print(f"{_count(trials, 'trial')} of {_count(kept, 'experiment')} imported")
    if any(finding.left_out for finding in findings):
        raise typer.Exit(EXIT_FAILED)


@data_app.command("status")
def data_status(
    pattern: Annotated[str, typer.Argument(help="Id or pattern such as 'SlopeSlider-*'.")] = "*",
    json_lines: Json = False,
) -> None:
    """Show what each experiment is scored against and driven by, and its baselines beside the published ones."""
    from gauge_envs.dataset.status import status_rows
    from gauge_envs.dataset.views import status_table

    rows = status_rows(_matching(pattern))
    if json_lines:
        _print_lines(rows)
    else:
        _stdout().print(status_table(rows))


@data_app.command("use")
def data_use(
    drivers: Annotated[
        DriverSource, typer.Option(help="imported: as the real trials show; bundled: as the task files state.")
    ],
) -> None:
    """Choose the motion of driven bodies after an import; results record it, gauge show tells which is in use."""
    from gauge_envs.dataset.store import choose_drivers

    choose_drivers(drivers)
    typer.echo(f"drivers: {drivers.value}")


# --- arguments -------------------------------------------------------------------------------------------------------


def _is_glob(pattern: str) -> bool:
    return any(character in pattern for character in GLOB_CHARACTERS)


def _matching(pattern: str) -> list[Variant]:
    """Variants of an id or a pattern, with or without `GAUGE/`.

    Raises:
        UnknownNameError: There are none; the message offers the nearest.
    """
    if not _is_glob(pattern):
        return [find_variant(pattern)]
    stem = pattern.removeprefix("GAUGE/")
    found = [variant for variant in variants() if fnmatchcase(variant.name, stem)]
    if not found:
        raise UnknownNameError("experiment", pattern, (variant.name for variant in variants()))
    return found


def _subjects(pattern: str) -> Sequence[Variant | str]:
    """Variants of an id or a pattern, or the path of an experiment file."""
    from gauge_envs.asset import is_experiment_file

    return [pattern] if is_experiment_file(Path(pattern)) else _matching(pattern)


def _split(text: str) -> list[str]:
    """Split at the commas that are outside brackets."""
    parts, depth = [""], 0
    for character in text:
        depth += (character == "[") - (character == "]")
        if character == "," and depth == 0:
            parts.append("")
        else:
            parts[-1] += character
    return parts


def _assigned(text: str) -> tuple[str, Any]:
    key, equals, value = (part.strip() for part in text.partition("="))
    if not (key and equals and value):
        raise ParameterError(f"{text!r}: expected NAME=VALUE")
    try:
        return key, json.loads(value)
    except ValueError:
        return key, value


def _parameters(text: str | None) -> Parameters | None:
    if text is None or "=" not in text:
        return text
    return dict(_assigned(part) for part in _split(text))


def _geom_pair(text: str | None) -> tuple[str, str] | None:
    if text is None:
        return None
    names = [name.strip() for name in text.split(",")]
    if len(names) != 2 or not all(names):
        raise ParameterError(f"--pair {text!r}: expected the names of two geoms, as floor,foot")
    return names[0], names[1]


def _settings(changes: Sequence[str]) -> dict[str, Any] | None:
    return dict(map(_assigned, changes)) or None


def _loaded(sources: Sequence[Path] | None) -> tuple[list[Result], int]:
    """Results of files and folders, each file once, and how many were skipped because they are damaged."""
    from gauge_envs.result import load_result

    files = dict.fromkeys(file.resolve() for source in sources or [Path("results")] for file in _result_files(source))
    results: list[Result] = []
    for file in files:
        try:
            results.append(load_result(file))
        except ResultFileError as error:
            _stderr().print(f"[yellow]skipped:[/] {_plain(str(error))}", soft_wrap=True)
    return results, len(files) - len(results)


def _jitter(position_mm: float | None, angle_deg: float | None) -> Jitter | None:
    if position_mm is None and angle_deg is None:
        return None
    given: dict[str, float] = {}
    if position_mm is not None:
        given["position_m"] = 1e-3 * position_mm
    if angle_deg is not None:
        given["angle_rad"] = math.radians(angle_deg)
    return Jitter(**given)


def _result_files(source: Path) -> list[Path]:
    files = sorted(source.glob("*.json")) if source.is_dir() else [source]
    if not files or not files[0].exists():
        raise ResultFileError(f"{source}: holds no result files; gauge run writes them")
    return files


# --- output ----------------------------------------------------------------------------------------------------------


def _check_one_format(json_lines: bool, markdown: bool) -> None:
    if json_lines and markdown:
        raise ParameterError("--json and --markdown exclude each other")


def _stdout() -> Console:
    return _widened(Console())


def _stderr() -> Console:
    return _widened(Console(stderr=True, highlight=False))


def _widened(console: Console) -> Console:
    """A console that does not cut tables where there is no terminal."""
    if not console.is_terminal and "COLUMNS" not in os.environ:
        console.width = PIPE_WIDTH
    return console


def _plain(text: str) -> str:
    from rich.markup import escape

    return escape(text)


def _progress(console: Console) -> Any:
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TextColumn("{task.description}"))
    return Progress(*columns, console=console, transient=True, disable=not console.is_terminal)


def _print_lines(rows: Sequence[Mapping[str, Any]]) -> None:
    for row in rows:
        typer.echo(json.dumps(row, allow_nan=False))


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"


def _totals(results: Sequence[Result], out: Path) -> str:
    counts: dict[str, int] = {}
    for result in results:
        counts[result.outcome.value] = counts.get(result.outcome.value, 0) + 1
    return f"{', '.join(f'{number} {outcome}' for outcome, number in counts.items())}; results in {out}"
