"""`gauge diagnose`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gauge_envs.cli.arguments import Json, Wide, WithheldOption
from gauge_envs.cli.output import EXIT_FAILED, plain_text, print_document, stderr_console
from gauge_envs.cli.results import loaded_results
from gauge_envs.errors import ParameterError

if TYPE_CHECKING:
    from gauge_envs.runs.result import Result
    from gauge_envs.tools.diagnose.model import Diagnosis


def diagnose(
    sources: Annotated[
        list[Path] | None,
        typer.Argument(metavar="[DIR or FILE]...", help="Result files, or folders of them; results/ by default."),
    ] = None,
    name: Annotated[
        str | None, typer.Option("--id", help="Experiment of trajectory files, as for gauge score.")
    ] = None,
    order: Annotated[
        str, typer.Option(help="Parts in the order in which they are added to the fit.")
    ] = "release,offset,rate",
    measured_only: Annotated[bool, typer.Option("--measured-only", help="Leave out extrapolated frames.")] = False,
    use_withheld: WithheldOption = False,
    out: Annotated[Path | None, typer.Option(help="Draw a picture into this folder.")] = None,
    json_lines: Json = False,
    wide: Wide = False,
) -> None:
    """Split the error of episodes: release time, constant offset, rate or scale of the motion, and the rest.

    Results without a reference, or that did not run to their end, are reported and left out. Exit code 2 when no
    result is left, 1 when a damaged file was skipped.
    """
    from gauge_envs.runs.score_file import score_file
    from gauge_envs.tools.diagnose.error_budget import DiagnosisError, stage_order
    from gauge_envs.tools.diagnose.error_budget import diagnose as diagnose_result
    from gauge_envs.tools.diagnose.words import diagnosis_document

    stages = stage_order(part.strip() for part in order.split(","))
    if name is None:
        results, skipped = loaded_results(sources, with_scene=True)
    else:
        if not sources:
            raise ParameterError("--id needs trajectory files: give one or more")
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
        stderr_console().print(f"[yellow]left out:[/] {plain_text(reason)}", soft_wrap=True)
    print_document(diagnosis_document(pairs), json_lines=json_lines, wide=wide)
    if out is not None:
        from gauge_envs.pages.figures import save_png
        from gauge_envs.tools.diagnose.figure import draw_diagnoses

        picture = save_png(draw_diagnoses(pairs), out / "diagnosis.png")
        stderr_console().print(plain_text(str(picture)), soft_wrap=True)
    if skipped:
        raise typer.Exit(EXIT_FAILED)
