"""`gauge reference`."""

from __future__ import annotations

from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gauge_envs.cli import arguments
from gauge_envs.cli.output import Progress, echo, message
from gauge_envs.errors import ParameterError

if TYPE_CHECKING:
    from gauge_envs.experiments.names import Variant
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

    The finest run has a quarter of the step, half the softness of contacts and half the cells. Coarser ones give the
    order of convergence, and the standard uncertainty as Roache's grid convergence index. `gauge run` and
    `gauge compare` score against a reference beside the task file.
    """
    from gauge_envs.runs.request import RunRequest
    from gauge_envs.tools.reference import solution as solving

    request = RunRequest(
        name, backend=backend, settings=arguments.parsed_settings(settings)
    )
    experiment = request.experiment()
    file = _file(experiment.variant, out)
    coarse = solving.finished(request)
    scene = experiment.scene
    given, levels = solving.given_level(coarse), solving.refinements(coarse, scene)
    motions = {given: solving.motion(coarse)}
    runs = dict.fromkeys(chain.from_iterable(levels.values()))
    runs.pop(given, None)
    minutes = solving.minutes(coarse, scene, runs)
    took = f"{given} took {coarse.cpu_s or 0.0:.2f} s of a processor"
    message(f"{took}; about {minutes:.1f} min for {'; '.join(map(str, runs))}")
    other = None
    with Progress("runs", len(runs) + bool(against)) as progress:
        if against:
            second = replace(request, backend=against, settings=None)
            other = solving.motion(solving.finished(second))
            progress.advance(against)
        for level in runs:
            refined = solving.settings_of(level, coarse, scene)
            finer = solving.finished(replace(request, settings=refined))
            motions[level] = solving.motion(finer)
            progress.advance(str(level))
    found = {name: [motions[level] for level in of] for name, of in levels.items()}
    solved = solving.solution(found, len(experiment.coordinates), other)
    is_soft = bool(scene.contacts) and solving.SOFTNESS not in levels
    left_out = _left_out(against, is_soft)
    compared = f", compared with {against}" if against else ""
    version = coarse.versions.get(backend, "")
    *_, (*_, finest) = levels.values()
    source = f"{backend} {version} with {finest}{compared}; {left_out}"
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


def _summary(solved: Solution, unit: str) -> str:
    """Return the uncertainty, its share of the motion, and the orders of convergence.

    Args:
        solved: The solution.
        unit: Unit of g(t); with markers, the uncertainty is in mm.
    """
    unit = "mm" if solved.mean.shape[1] > solved.width else unit
    share = f", {100 * solved.u / solved.moved:.2g} %" if solved.moved else ""
    text = (
        f"u = {solved.u:.3g} {unit}{share} of the motion of {solved.moved:.4g} {unit}"
    )
    orders = [
        f"no order in the {name}"
        if order is None
        else f"order {order:.2f} in the {name}"
        for name, order in solved.orders.items()
    ]
    return "; ".join([text, *orders])


def _left_out(against: str | None, is_soft: bool) -> str:
    """Return what the uncertainty leaves out.

    Args:
        against: Second engine, if any.
        is_soft: Whether bodies touch and the engine declares no softness of contacts.
    """
    parts = [] if against else ["a second engine (--against)"]
    parts += ["softness of contacts"] if is_soft else []
    return f"u leaves out: {', '.join([*parts, 'tolerance of the solver'])}"
