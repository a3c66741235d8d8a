"""`gauge reference`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

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
    levels = solving.refinements(coarse, scene)
    given = {**coarse.settings_given, "timestep_s": coarse.settings["timestep_s"]}
    runs = [given]
    for values in chain.from_iterable(levels.values()):
        if values not in runs:
            runs.append(values)
    softness = {
        word: solving.softened(coarse, scene, halvings=halvings)
        for word, halvings in (("half", 1), ("twice", -1))
    }
    names = [_refined(values, softness) for values in runs]
    minutes = solving.minutes(coarse, scene, runs[1:])
    message(_plan(names, coarse.cpu_s or 0.0, minutes))
    requests = [replace(request, settings=values) for values in runs[1:]]
    if against:
        requests.insert(0, replace(request, backend=against, settings=None))
    labels = [*([against] if against else []), *names[1:]]
    results = []
    with Progress("runs", len(requests)) as progress:
        for each, label in zip(requests, labels, strict=True):
            results.append(solving.finished(each))
            progress.advance(label)
    other = solving.motion(results.pop(0)) if against else None
    motions = [solving.motion(result) for result in (coarse, *results)]
    found = {
        name: [motions[runs.index(values)] for values in refined]
        for name, refined in levels.items()
    }
    solved = solving.solution(found, len(experiment.coordinates), other)
    is_soft = bool(scene.contacts) and solving.SOFTNESS not in levels
    left_out = _left_out(against, is_soft)
    compared = f", compared with {against}" if against else ""
    version = coarse.versions.get(backend, "")
    *_, (*_, finest) = levels.values()
    source = (
        f"{backend} {version} with {_refined(finest, softness)}{compared}; {left_out}"
    )
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


def _refined(
    settings: Mapping[str, Any], softness: Mapping[str, Mapping[str, Any]]
) -> str:
    """Return the step, the cells and the contacts of a run, as `timestep_s=1/9000`.

    Args:
        settings: Settings of the run.
        softness: Settings of stiffer and softer contacts by their factor in words.
    """
    text = f"timestep_s=1/{1.0 / settings['timestep_s']:.6g}"
    if cell_m := settings.get("cell_m"):
        text += f",cell_m={cell_m:.4g}"
    for factor, contacts in softness.items():
        if contacts and contacts.items() <= settings.items():
            text += f",{factor} the softness of contacts"
    return text


def _plan(names: Sequence[str], cpu_s: float, minutes: float) -> str:
    """Return the runs that follow the first one, and their estimated minutes.

    Args:
        names: Names of the runs.
        cpu_s: Processor time of the first one [s].
        minutes: Processor time of the others [min].
    """
    took = f"{names[0]} took {cpu_s:.2f} s of a processor"
    return f"{took}; about {minutes:.1f} min for {'; '.join(names[1:])}"


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
