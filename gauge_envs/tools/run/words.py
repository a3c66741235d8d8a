"""Results of episodes beside the published scores: what the numbers mean, and what was not run and why."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import Any

from gauge_envs.pages.document import Document, Paragraph, Tone
from gauge_envs.pages.results import (
    ALIGNED,
    ANOTHER_SCENE,
    SCORE_METRICS,
    VERIFICATION_NOTE,
    discretization_text,
    normalized_score,
    percentile_text,
    raw_score,
    reality_lines,
    result_label,
    score_interval,
)
from gauge_envs.pages.table import Column, Place, Table
from gauge_envs.pages.text import (
    NORMALIZED_NOTE,
    QUESTIONS,
    interval_text,
    reality_notes,
    reality_of,
    score_text,
    short_id,
    shortened,
    with_unit,
)
from gauge_envs.references.convergence import convergence_rows
from gauge_envs.references.kind import Kind
from gauge_envs.references.metrics import METRICS
from gauge_envs.references.published import PUBLISHED_ENGINES, published_baselines
from gauge_envs.runs.result import Outcome, Result
from gauge_envs.scoring.score import Score

DEFORMATION_NOTE = (
    "Strain, volume or area ratio, and non-affine residual [mm] of the markers, at the last frame whose real value is "
    "known. +-: 1-sigma uncertainty of one recording, or scatter over several trials. z: simulated minus real, over +-."
)

FEW_TRIALS = 10
"""Number of trials from which on raw intervals hold with late releases (`studies/coverage`)."""

FEW_TRIALS_NOTE = (
    "If releases were late, the interval of E_RMSE is too short: with 5 simulated trials it held the truth in 86 to "
    "98 %, in place of 95."
)

TONES = {
    Outcome.DIVERGED: Tone.ERROR,
    Outcome.FAILED: Tone.ERROR,
    Outcome.DECLINED: Tone.WARNING,
}
"""Outcomes whose reasons are reported."""

EXPERIMENT = Column("id", "experiment", short_id, place=Place.HEADING)

LABEL = Column("label", "", place=Place.HEADING)


def summary_document(results: Sequence[Result]) -> Document:
    """Return scores of results beside the published ones, what the numbers mean, and what was not run and why."""
    ran = [result for result in results if result.error is None]
    tables = []
    verified = [one for one in ran if one.score.verification is not None]
    if rows := [row for result in ran for row in _score_rows(result)]:
        title = QUESTIONS["validation"] if verified else ""
        tables.append(_score_table(rows, title=title))
    if verified:
        tables.append(verification_table(verified))
    if any(result.deformation is not None for result in ran):
        tables.append(_deformation_table(ran))
    lines = (Paragraph(line) for result in ran for line in _remarks(result))
    return Document(parts=[*tables, *lines, *_outcomes(results)])


def _score_table(rows: Sequence[dict[str, Any]], *, title: str) -> Table:
    return Table(
        title=title,
        columns=(
            EXPERIMENT,
            Column("grade", "grade", reality_of, place=Place.HEADING),
            LABEL,
            Column("metric", "metric"),
            Column("percentile", "real trials closer", is_number=True),
            Column(
                "score",
                "score",
                is_number=True,
                style=lambda text: "red" if text == Outcome.DIVERGED else "",
            ),
            Column("normalized", "over real trials", is_number=True),
            *(
                Column(f"engines.{key}", title, score_text, is_number=True)
                for key, title in PUBLISHED_ENGINES.items()
            ),
            Column(
                "extrapolated",
                "extrapolated",
                lambda x: f"{100.0 * x:.0f} %",
                is_number=True,
                wide_only=True,
            ),
            Column("z", "|z|", score_text, is_number=True, wide_only=True),
            Column("convergence", "discretization", place=Place.BELOW),
            Column(
                "shift",
                "shift",
                lambda shift_s: f"{shift_s:+.3f} s",
                is_number=True,
                wide_only=True,
            ),
        ),
        rows=rows,
        notes=(
            "",
            NORMALIZED_NOTE,
            "Real trials closer: to the mean of the others than the simulation is to the mean. Aligned: after the best "
            "time shift. In brackets: 95 % intervals. --format wide shows more columns.",
            *reality_notes(row["grade"] for row in rows),
        ),
    )


def _score_rows(result: Result) -> list[dict[str, Any]]:
    """Return a row for each metric that the result or the paper has, the primary one first."""
    driver = ", nominal driver" if "nominal" in (result.driver_provenance or "") else ""
    common = {
        "id": result.id,
        "grade": result.score.grade,
        "label": result_label(result) + driver,
    }
    if result.diverged:
        return [common | {"score": Outcome.DIVERGED.value}]
    score, baselines = result.score, published_baselines(short_id(result.id))
    # A distance to a law or a solved model says nothing of reality. Events are compared with real ones at any grade.
    is_real = not Kind(score.grade).is_solution
    rows: list[dict[str, Any]] = []
    # The aligned score comes first where the experiment starts with a release, else after the raw one.
    order = ("rmse", ALIGNED.key) if score.primary == "rmse" else (ALIGNED.key, "rmse")
    for key in dict.fromkeys((*order, *METRICS)):
        metric, line = SCORE_METRICS[key], baselines.get(key)
        raw, normalized = raw_score(score, key), normalized_score(score, key)
        if (normalized if metric is ALIGNED else raw) is None and line is None:
            continue
        if not is_real and not metric.is_event:
            continue
        is_partial = metric.is_normalized and raw is not None and normalized is None
        row: dict[str, Any] = common | {
            "metric": metric.title,
            "percentile": percentile_text(score, key),
            "score": None
            if raw is None
            else with_unit(
                interval_text(raw, getattr(score.validation, f"{key}_95", None)),
                metric.unit_of(score.unit),
            ),
            "normalized": None
            if normalized is None
            else interval_text(normalized, score_interval(score, key)),
            # Published scores are of the whole motion and of reality. Some laws hold for its first frames alone.
            "engines": None if line is None or is_partial else line.engines,
        }
        if key == "rmse":
            row["z"] = None if score.validation is None else score.validation.mean_abs_z
            row["extrapolated"] = score.extrapolated_share
            row["convergence"] = discretization_text(
                result, convergence_rows(result.backend, result.id)
            )
        elif metric is ALIGNED:
            row["shift"] = score.release_offset_s
        rows.append(row)
    return rows or ([common] if is_real else [])


def verification_table(results: Sequence[Result]) -> Table:
    """Return how well engines solve the scenes of laws and solved models."""
    rows = []
    for result in results:
        for one in result.score.verifications:
            rows.append(
                {
                    "id": result.id,
                    "grade": one.grade,
                    "label": result_label(result),
                    "quantity": one.quantity,
                    "distance": with_unit(score_text(one.distance), one.unit),
                    "in_u": None
                    if not one.uncertainty
                    else interval_text(one.scaled, one.scaled_95),
                    "frozen": with_unit(score_text(one.frozen), one.unit),
                    "verdict": ANOTHER_SCENE
                    if result.is_another_scene
                    else one.verdict,
                    "convergence": discretization_text(
                        result, convergence_rows(result.backend, result.id)
                    )
                    if one is result.score.verification
                    else None,
                }
            )
    return Table(
        title=QUESTIONS["verification"],
        columns=(
            EXPERIMENT,
            Column("grade", "reference", place=Place.HEADING),
            LABEL,
            Column("quantity", "compared"),
            Column("distance", "distance", is_number=True),
            Column("in_u", "over u", is_number=True),
            Column("frozen", "frozen", is_number=True),
            Column("verdict", "verdict"),
            Column("convergence", "discretization", place=Place.BELOW),
        ),
        rows=rows,
        notes=(VERIFICATION_NOTE,),
    )


def _deformation_table(results: Sequence[Result]) -> Table:
    """Return the statistics of deformation of results beside the real ones."""
    found = [
        (result, result.deformation)
        for result in results
        if result.deformation is not None
    ]
    numbers = {"simulated": "simulated", "real": "real", "uncertainty": "+-"}
    return Table(
        title="Validation by deformation, grade statistics (no part of the score)",
        columns=(
            EXPERIMENT,
            LABEL,
            Column("name", "statistic"),
            Column("unit", "unit", wide_only=True),
            Column("frame", "frame", str, is_number=True),
            # Adding 0.0 makes a rounded -0.0000 plain zero.
            *(
                Column(
                    key,
                    title,
                    lambda value: f"{round(value, 4) + 0.0:.4f}",
                    is_number=True,
                )
                for key, title in numbers.items()
            ),
            Column(
                "difference_95",
                "simulated - real, 95 %",
                lambda ends: (
                    "" if ends is None else f"{ends[0]:+.4f} to {ends[1]:+.4f}"
                ),
            ),
            Column("z", "z", score_text, is_number=True),
            Column("z_rms", "z rms", score_text, is_number=True),
        ),
        rows=[
            {"id": result.id, "label": result_label(result), **asdict(statistic)}
            for result, deformation in found
            for statistic in deformation.statistics
        ],
        notes=(
            DEFORMATION_NOTE,
            *sorted(
                {
                    f"{short_id(result.id)}: {one.note}."
                    for result, one in found
                    if one.note
                }
            ),
        ),
    )


def _remarks(result: Result) -> Iterator[str]:
    """Yield what the table does not say of a result."""
    name = short_id(result.id)
    if result.score.verification is None:
        yield from reality_lines(
            name, result.score, is_another_scene=result.is_another_scene
        )
    if (found := result.score.validation) is not None:
        yield from (f"{name}: no interval of {reason}." for reason in found.refused)
        count = found.trial_count
        if count and count < FEW_TRIALS and found.rmse_95 is not None:
            yield f"{name}: {count} trials. {FEW_TRIALS_NOTE}"
    if result.score.implied:
        yield _implied_line(name, result.score)
    if result.score.withheld:
        yield f"{name} is scored on a band that is withheld: {result.score.withheld}."
    yield from estimator_lines(name, result.score)
    if result.is_edited:
        yield f"{name}, {result.asset['file']}: {shortened(result.asset['changes'])}."


def _implied_line(name: str, score: Score) -> str:
    """Return the parameters that a result implies beside those of the real trials."""
    parts = []
    for one in score.implied:
        parameter, spread = one.parameter.replace("_", " "), ""
        if one.real_uncertainty is not None:
            spread = f" +- {one.real_uncertainty:.2g}"
        if one.parameter == "release_time":
            parts.append(f"real release {one.real:+.3f}{spread} s")
        else:
            real = "" if one.real is None else f" (real {_rounded(one.real)}{spread})"
            parts.append(
                with_unit(f"{parameter} {_rounded(one.value)}{real}", one.unit)
            )
    return f"{name} implies {', '.join(parts)}."


def _rounded(value: float) -> str:
    # A pendulum without friction decays by rounding errors.
    return f"{value:.4g}" if abs(value) > 1e-9 else "0"


def estimator_lines(name: str, score: Score) -> Iterator[str]:
    """Yield what the choice of an estimator does, and when the events of a swing happen."""
    if score.lsd_s is not None:
        first, last = score.lsd_dropped_rests_s or (0.0, 0.0)
        yield (
            f"{name}: LSD limits the speed of the height from frame to frame: "
            f"{_duration(score.lsd_s, score.lsd_normalized)}. With central differences it is "
            f"{_duration(score.lsd_central_s, score.lsd_central_normalized)}, with the speed in space "
            f"{_duration(score.lsd_speed_3d_s, score.lsd_speed_3d_normalized)}. Rests that touch the first frame "
            f"({first:.3f} s) or the last ({last:.3f} s) do not count."
        )
    if score.pd_s is not None:
        yield (
            f"{name}: PD is the peak of the windowed spectrum between the bins: "
            f"{_duration(score.pd_s, score.pd_normalized)}. The strongest bin of the plain spectrum gives "
            f"{_duration(score.pd_fft_s, score.pd_fft_normalized)}."
        )
    events = score.events or ()
    for quantity in dict.fromkeys(event.quantity for event in events):
        of_kind = [event for event in events if event.quantity == quantity]
        pairs = ", ".join(
            f"{'-' if event.simulated_s is None else f'{event.simulated_s:.2f}'} / {event.recorded_s:.2f}"
            for event in of_kind
        )
        yield f"{name}: last ball {quantity} [s], simulated / recorded (+- {of_kind[0].sigma_s:.2f}): {pairs}."


def _duration(value_s: float | None, normalized: float | None) -> str:
    """Return a duration, with its share of the published mean in brackets."""
    share = "" if normalized is None else f" ({normalized:.2f})"
    return "-" if value_s is None else f"{value_s:.3f} s{share}"


def _outcomes(results: Sequence[Result]) -> Iterator[Paragraph]:
    """Yield a line for each reason: a backend declines many experiments for the same one."""
    for outcome, tone in TONES.items():
        reasons: dict[str, list[str]] = {}
        for result in results:
            if result.outcome is outcome:
                name = short_id(result.id)
                reason = (result.error or result.diverged_reason or "").replace(
                    f"{result.id}: ", ""
                )
                reasons.setdefault(reason.removeprefix(f"{name} "), []).append(name)
        yield from (
            Paragraph(f"{outcome.value}: {shortened(ids)}: {text}", tone)
            for text, ids in reasons.items()
        )
