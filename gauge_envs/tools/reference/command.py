"""`gauge reference`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gauge_envs.cli import arguments
from gauge_envs.cli.output import Progress, echo, message
from gauge_envs.errors import ParameterError

if TYPE_CHECKING:
    from gauge_envs.experiments.names import Variant
    from gauge_envs.runs.result import Result
    from gauge_envs.tools.reference.solution import Solution


def reference(
    name: Annotated[
        str,
        typer.Argument(metavar="FILE|ID", help="Id, or task file with one experiment."),
    ],
    backend: Annotated[str, arguments.backend("Engine that is refined.")] = "mujoco",
    against: Annotated[
        str | None,
        arguments.option(
            arguments.NUMERICS,
            "Second engine, whose difference is part of the uncertainty.",
            "--against",
            metavar="ENGINE",
            show_default="none",
        ),
    ] = None,
    settings: arguments.Settings = None,
    out: Annotated[
        Path | None,
        arguments.folder(
            "Folder for the reference.", show_default="that of the task file"
        ),
    ] = None,
) -> None:
    """Solve a scene at refined steps, contacts and cells, and write the solution as its reference.

    The runs have the step, its half and its quarter, then half the softness of contacts, then half the cells; their
    differences give the standard uncertainty. `gauge run` and `gauge compare` score against a reference beside the
    task file.
    """
    from gauge_envs.runs.request import RunRequest
    from gauge_envs.tools.reference import solution as solving

    request = RunRequest(
        name, backend=backend, settings=arguments.parsed_settings(settings)
    )
    experiment = request.experiment()
    file = _file(experiment.variant, out)
    coarse = solving.finished(request)
    stiffer = solving.stiffer_contacts(coarse, experiment.scene)
    finer = solving.finer_settings(coarse, experiment.scene, stiffer)
    minutes = solving.minutes(coarse, experiment.scene, finer)
    names = [_refined(values, stiffer) for values in finer]
    message(_plan(coarse, names, minutes))
    requests = [replace(request, settings=values) for values in finer]
    if against:
        requests.insert(0, replace(request, backend=against, settings=None))
        names.insert(0, against)
    results = []
    with Progress("runs", len(requests)) as progress:
        for each, label in zip(requests, names, strict=True):
            results.append(solving.finished(each))
            progress.advance(label)
    other = solving.motion(results.pop(0)) if against else None
    motions = [solving.motion(result) for result in (coarse, *results)]
    solved = solving.solution(motions, len(experiment.coordinates), other)
    is_soft = bool(experiment.scene.contacts) and not stiffer
    left_out = _left_out(against, is_soft)
    compared = f", compared with {against}" if against else ""
    version = coarse.versions.get(backend, "")
    source = f"{backend} {version} with {names[-1]}{compared}; {left_out}"
    solving.write_solution(file, experiment, solved, source)
    echo(_summary(solved, experiment.score.observable.unit))
    echo(f"{left_out}\n{file}")


def _file(variant: Variant, out: Path | None) -> Path:
    """Return the path of the reference, which must not replace one of real trials or a closed form.

    Args:
        variant: The experiment.
        out: Folder of `--out`.
    """
    from gauge_envs.experiments.variants import task_path, user_variants
    from gauge_envs.scoring.reference import reference_kind
    from gauge_envs.tools.reference.solution import check_replaceable_band

    kind = reference_kind(variant.name)
    if kind.is_real or kind.is_mean_of_trials:
        raise ParameterError(
            f"{variant.id} has real trials as its reference ({kind}): they score it, and a solution would replace them"
        )
    if out is None and variant not in user_variants():
        raise ParameterError(
            f"{variant.id} is an experiment of the package: give --out FOLDER"
        )
    file = (out or task_path(variant.family).parent) / f"{variant.name}.band.toml"
    check_replaceable_band(file)
    return file


def _refined(settings: Mapping[str, Any], stiffer: Mapping[str, Any]) -> str:
    """Return the step, the cells and the contacts of a run, as `timestep_s=1/9000`.

    Args:
        settings: Settings of the run.
        stiffer: Settings of stiffer contacts.
    """
    text = f"timestep_s=1/{1.0 / settings['timestep_s']:.6g}"
    if cell_m := settings.get("cell_m"):
        text += f",cell_m={cell_m:.4g}"
    if stiffer and stiffer.items() <= settings.items():
        text += ",half the softness of contacts"
    return text


def _plan(coarse: Result, finer: Sequence[str], minutes: float) -> str:
    """Return the runs that follow a coarse run, and their estimated minutes."""
    took = f"{_refined(coarse.settings, {})} took {coarse.cpu_s or 0.0:.2f} s of a processor"
    return f"{took}; about {minutes:.1f} min for {'; '.join(finer)}"


def _summary(solved: Solution, unit: str) -> str:
    """Return the uncertainty, its share of the motion, and the order of convergence.

    Args:
        solved: The solution.
        unit: Unit of g(t); with markers, the uncertainty is in mm.
    """
    unit = "mm" if solved.mean.shape[1] > solved.width else unit
    share = f", {100 * solved.u / solved.moved:.2g} %" if solved.moved else ""
    order = f"order {solved.order:.2f} in the step"
    if not solved.converges:
        order = f"the step does not converge: u assumes the order {solved.order:.2g}"
    return f"u = {solved.u:.3g} {unit}{share} of the motion of {solved.moved:.4g} {unit}; {order}"


def _left_out(against: str | None, is_soft: bool) -> str:
    """Return what the uncertainty leaves out.

    Args:
        against: Second engine, if any.
        is_soft: Whether bodies touch and the engine declares no softness of contacts.
    """
    parts = [] if against else ["a second engine (--against)"]
    parts += ["softness of contacts"] if is_soft else []
    return f"u leaves out: {', '.join([*parts, 'tolerance of the solver'])}"
