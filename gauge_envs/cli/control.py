"""Commands on control tasks: what a trained policy keeps of its reward elsewhere."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from gauge_envs.cli.arguments import Json, ParametersOption, Wide, parsed_parameters, parsed_settings, split_list
from gauge_envs.cli.output import EXIT_FAILED, plain_text, print_json_lines, print_table, stderr_console, stdout_console
from gauge_envs.errors import ParameterError

__all__ = ["transfer"]

DEFAULT_ENGINES = ("mujoco", "newton")


def transfer(
    policies: Annotated[
        list[str],
        typer.Argument(
            metavar="POLICY...",
            help="Stable-Baselines3 file (.zip), ONNX file (.onnx) or module:function; several are training seeds.",
        ),
    ],
    task: Annotated[str, typer.Option("--task", help="Control task, as GAUGE/Turntable-Limit-wood.")],
    engine: Annotated[str, typer.Option("--backend", help="Engine of the training.")] = "mujoco",
    changes: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="NAME=VALUE", help="Setting of the engine in the training; repeatable."),
    ] = None,
    parameters: ParametersOption = None,
    normalization: Annotated[
        list[Path] | None,
        typer.Option(metavar="FILE", help="Statistics that VecNormalize saved; one for all policies, or one for each."),
    ] = None,
    trust: Annotated[
        bool, typer.Option("--trust", help="Let loading run code of the policy's file or module.")
    ] = False,
    to: Annotated[
        list[str] | None,
        typer.Option(
            metavar="ENGINE[:NAME=VALUE,...]",
            help="Engine to replay in, with settings; repeatable. Default: mujoco, newton.",
        ),
    ] = None,
    sigmas: Annotated[
        str, typer.Option(help="Changes of each constant, in standard uncertainties, as 1,2; 0 for none.")
    ] = "1",
    starts: Annotated[int, typer.Option(min=1, help="Starts in each world, within the start's uncertainty.")] = 3,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the starts and of the bootstrap.")] = 0,
    figure: Annotated[Path | None, typer.Option(metavar="FILE", help="Picture (PNG) to write.")] = None,
    fail_below: Annotated[
        float | None, typer.Option(metavar="PERCENT", help="Exit code 1 when less of the promise is kept.")
    ] = None,
    json_lines: Json = False,
    wide: Wide = False,
) -> None:
    """Replay trained policies in other engines, settings and constants, and report how much of their reward they keep.

    Exit code 1 when they keep less than --fail-below states.
    """
    from contextlib import closing

    from gauge_envs.analysis.transfer import transfer_report
    from gauge_envs.report.figures.style import new_figure
    from gauge_envs.report.transfer import transfer_json, transfer_table, transfer_verdict
    from gauge_envs.runs.policies.load import load_policies
    from gauge_envs.runs.replays import make_control_env, other_worlds, replay, training_world

    if figure is not None:
        new_figure(1.0, 1.0)  # A missing matplotlib is an error before the replays, not after.
    training = training_world(engine, parsed_settings(changes or []), parsed_parameters(parameters) or "calibrated")
    with closing(make_control_env(task)) as env:
        loaded = load_policies(policies, env, normalization=normalization or [], trust=trust)
    engines = [_engine(text) for text in to] if to else _installed(DEFAULT_ENGINES)
    others = list(other_worlds(task, training, engines=engines, sigmas=_numbers(sigmas)))
    stderr = stderr_console()
    with stderr.status("replaying") as status:
        replays = replay(
            task, loaded, training, others, starts=starts, seed=seed,
            notify=lambda name: status.update(f"replaying: {plain_text(name)}"),
        )  # fmt: skip
    report = transfer_report(replays, seed=seed)
    if json_lines:
        print_json_lines(transfer_json(report))
    else:
        print_table(transfer_table(report), json_lines=False, wide=wide)
        for name, reason in report.left_out.items():
            stderr.print(f"[yellow]left out:[/] {plain_text(name)}: {plain_text(reason)}", soft_wrap=True)
        stdout_console().print(f"\n{plain_text(transfer_verdict(report))}")
    if figure is not None:
        from gauge_envs.report.figures.transfer import save_transfer

        stderr.print(plain_text(str(save_transfer(report, figure))), soft_wrap=True)
    if fail_below is not None and 100.0 * report.kept.value < fail_below:
        raise typer.Exit(EXIT_FAILED)


def _installed(names: tuple[str, ...]) -> list[tuple[str, dict[str, Any]]]:
    """Return those of the default engines that are installed, without settings."""
    from gauge_envs.backends.registry import backend
    from gauge_envs.errors import MissingExtraError

    found: list[tuple[str, dict[str, Any]]] = []
    for name in names:
        try:
            backend(name)
        except MissingExtraError:
            continue
        found.append((name, {}))
    return found


def _engine(text: str) -> tuple[str, dict[str, Any]]:
    name, _, settings = text.partition(":")
    return name, parsed_settings(split_list(settings) if settings else []) or {}


def _numbers(text: str) -> list[float]:
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        raise ParameterError(f"--sigmas {text!r}: expected numbers with commas, as 1,2") from None
    return [] if numbers == [0.0] else numbers
