"""What a policy keeps of its reward elsewhere, and what uncertain constants do to a reward or a score."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gauge_envs.cli.arguments import Json, ParametersOption, Wide, parsed_parameters, parsed_settings, split_list
from gauge_envs.cli.output import (
    EXIT_FAILED,
    plain_text,
    print_document,
    progress_bar,
    stderr_console,
)
from gauge_envs.errors import ParameterError

if TYPE_CHECKING:
    from gauge_envs.tools.transfer.envelope import Envelope


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
    seed: Annotated[int, typer.Option(min=0, help="Seed of the starts.")] = 0,
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

    from gauge_envs.pages.figures import new_figure, save_png
    from gauge_envs.tools.transfer.policies.load import load_policies
    from gauge_envs.tools.transfer.policy_replays import make_control_env, other_worlds, replay, training_world
    from gauge_envs.tools.transfer.transfer import transfer_report
    from gauge_envs.tools.transfer.words import transfer_document

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
    report = transfer_report(replays)
    if not json_lines:
        for name, reason in report.left_out.items():
            stderr.print(f"[yellow]left out:[/] {plain_text(name)}: {plain_text(reason)}", soft_wrap=True)
    print_document(transfer_document(report), json_lines=json_lines, wide=wide)
    if figure is not None:
        from gauge_envs.tools.transfer.figure import draw_transfer

        stderr.print(plain_text(str(save_png(draw_transfer(report), figure))), soft_wrap=True)
    if fail_below is not None and 100.0 * report.kept.value < fail_below:
        raise typer.Exit(EXIT_FAILED)


def envelope(
    subject: Annotated[str, typer.Argument(metavar="ID", help="Control task or experiment.")],
    policy: Annotated[
        str | None,
        typer.Option(metavar="POLICY", help="Policy of a control task, as in gauge transfer; else the law's."),
    ] = None,
    normalization: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Statistics that VecNormalize saved beside the policy.")
    ] = None,
    trust: Annotated[
        bool, typer.Option("--trust", help="Let loading run code of the policy's file or module.")
    ] = False,
    fraction: Annotated[float, typer.Option(min=0.0, help="Share of the limit that the law's policy uses.")] = 0.95,
    informed: Annotated[
        bool, typer.Option("--informed", help="The law's policy knows the constants of each world.")
    ] = False,
    samples: Annotated[int, typer.Option(help="Number of points, a power of 2.")] = 256,
    engine: Annotated[str, typer.Option("--backend", help="Engine.")] = "mujoco",
    changes: Annotated[
        list[str] | None, typer.Option("--set", metavar="NAME=VALUE", help="Setting of the engine; repeatable.")
    ] = None,
    batch: Annotated[int, typer.Option(min=1, help="Worlds that run at a time.")] = 256,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the points.")] = 0,
    figure: Annotated[Path | None, typer.Option(metavar="FILE", help="Picture (PNG) to write.")] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder for the ranges as code for four training stacks.")
    ] = None,
    width: Annotated[float, typer.Option(help="Half width of those ranges, in standard uncertainties.")] = 2.0,
    json_lines: Json = False,
) -> None:
    """Show what the measured uncertainty of constants and start does to a reward or a score.

    With --out it writes the same uncertainty as ranges of domain randomization.
    """
    from gauge_envs.pages.figures import new_figure, save_png
    from gauge_envs.tools.transfer.envelope_statistics import envelope_report
    from gauge_envs.tools.transfer.randomization import write_randomization
    from gauge_envs.tools.transfer.words import envelope_document

    if figure is not None:
        new_figure(1.0, 1.0)
    stderr = stderr_console()
    settings = parsed_settings(changes or [])
    common: dict[str, Any] = {"samples": samples, "backend": engine, "settings": settings, "seed": seed, "batch": batch}
    with progress_bar(stderr) as bar:
        line = bar.add_task("samples", total=samples)
        common["notify"] = lambda done: bar.update(line, completed=done)
        if _is_control(subject):
            law = (fraction, informed)
            found = _control(subject, policy, normalization, trust, law, **common)
        elif policy is not None:
            raise ParameterError(f"{subject} is an experiment: only control tasks have policies")
        else:
            from gauge_envs.tools.transfer.envelope import experiment_envelope

            found = experiment_envelope(subject, **common)
    report = envelope_report(found)
    print_document(envelope_document(report), json_lines=json_lines)
    written = []
    if figure is not None:
        from gauge_envs.tools.transfer.figure import draw_envelope

        written.append(save_png(draw_envelope(found, report), figure))
    if out is not None:
        written += write_randomization(out, found.id, found.scene, found.parameters, width)
    for path in written:
        stderr.print(plain_text(str(path)), soft_wrap=True)


def _is_control(subject: str) -> bool:
    from gauge_envs.envs.control.tasks import control_tasks

    return subject.removeprefix("GAUGE/") in {task.name for task in control_tasks()}


def _control(
    task: str, policy: str | None, normalization: Path | None, trust: bool, law: tuple[float, bool], **options: Any
) -> Envelope:
    from contextlib import closing
    from dataclasses import replace

    from gauge_envs.tools.transfer.envelope import LawPolicy, control_envelope
    from gauge_envs.tools.transfer.policies.load import load_policy
    from gauge_envs.tools.transfer.policy_replays import make_control_env

    if policy is None:
        return control_envelope(task, policy=LawPolicy(fraction=law[0], informed=law[1]), **options)
    with closing(make_control_env(task)) as env:
        loaded = load_policy(policy, env, normalization=normalization, trust=trust)
    return replace(control_envelope(task, policy=loaded, **options), policy=policy)


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
