"""`gauge diagnose`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from gauge_envs.cli import arguments
from gauge_envs.cli.output import Format, message, print_document
from gauge_envs.cli.results import loaded_results
from gauge_envs.errors import ParameterError

if TYPE_CHECKING:
    from gauge_envs.runs.result import Result
    from gauge_envs.tools.diagnose.model import Diagnosis


def diagnose(
    sources: arguments.Sources = None,
    name: Annotated[
        str | None,
        arguments.option(
            arguments.SCENE, "Experiment of trajectory files.", "--id", metavar="ID"
        ),
    ] = None,
    use: arguments.Use = None,
    order: arguments.Order = None,
    measured_only: arguments.MeasuredOnly = False,
    form: arguments.Form = Format.TEXT,
) -> bool:
    """Split the error of episodes: release time, constant offset, rate of the motion, rest.

    Results without a reference, or that did not run to their end, are reported and
    left out. Exit code 2 when no result is left, 1 when a damaged file was skipped.
    """
    from gauge_envs.tools.diagnose.words import diagnosis_document

    pairs, skipped = _diagnoses(sources, name, use, order, measured_only)
    print_document(diagnosis_document(pairs), form)
    return bool(skipped)


def draw_diagnose(
    sources: Sequence[str] | None,
    out: Path,
    name: str | None = None,
    use: Sequence[str] | None = None,
    order: Sequence[str] | None = None,
    measured_only: bool = False,
) -> tuple[Sequence[Path], int]:
    """Draw the parts of the error of all results."""
    from gauge_envs.pages.figures import save_png
    from gauge_envs.tools.diagnose.words import draw_diagnoses

    pairs, skipped = _diagnoses(sources, name, use, order, measured_only)
    return [save_png(draw_diagnoses(pairs), out / "diagnosis.png")], skipped


def _diagnoses(
    sources: Sequence[str] | None,
    name: str | None,
    use: Sequence[str] | None,
    order: Sequence[str] | None,
    measured_only: bool,
) -> tuple[list[tuple[Result, Diagnosis]], int]:
    """Return results with their diagnoses, and the number of skipped files; report what is left out."""
    from gauge_envs.pages.results import normalized_score
    from gauge_envs.runs.score_file import score_file
    from gauge_envs.tools.diagnose.error_budget import (
        DiagnosisError,
        diagnose,
        stage_order,
    )

    details: dict[str, Any] = {"measured_only": measured_only}
    if order:
        details["order"] = stage_order(order)
    used = arguments.parsed_use(use, "use_withheld")
    if name is None:
        loaded, skipped = loaded_results(sources, with_scene=True)
        results = list(loaded.values())
    elif not sources:
        raise ParameterError("--id needs trajectory files: give one or more")
    else:
        results, skipped = (
            [score_file(Path(file), variant=name, **used)[0] for file in sources],
            0,
        )
    pairs: list[tuple[Result, Diagnosis]] = []
    reasons: dict[str, None] = {}
    for result in results:
        try:
            pairs.append((result, diagnose(result, **details, **used)))
        except DiagnosisError as error:
            reasons[str(error)] = None
    if results and not pairs:
        raise DiagnosisError("; ".join(reasons))
    # The farthest from the real trials, over their scatter, comes first, then those with another reference.
    pairs.sort(
        key=lambda pair: normalized_score(pair[0].score, "rmse") or 0.0, reverse=True
    )
    for reason in reasons:
        message(reason, "left out")
    return pairs, skipped
