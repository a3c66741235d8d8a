"""`gauge transfer` and `gauge transfer envelope`."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from pydantic import NonNegativeInt, PositiveInt

from gauge_envs.cli import arguments
from gauge_envs.cli.output import (
    Format,
    Progress,
    message,
    plain_text,
    print_document,
    stderr_console,
)
from gauge_envs.errors import MissingExtraError, ParameterError

if TYPE_CHECKING:
    from gauge_envs.tools.transfer.envelope import Envelope

DEFAULT_ENGINES = ("mujoco", "newton")

TrustOption = Annotated[
    bool,
    typer.Option(
        "--trust", help="Let loading run code of the policy's file or module."
    ),
]


def transfer(
    words: Annotated[
        list[str],
        typer.Argument(
            metavar="POLICY... [NAME=VALUE]...",
            help="Stable-Baselines3 (.zip), ONNX (.onnx) or module:function; several are training seeds.",
        ),
    ],
    task: Annotated[
        str,
        typer.Option(
            "--id", metavar="ID", help="Control task, as GAUGE/Turntable-Limit-wood."
        ),
    ],
    engine: Annotated[
        str, typer.Option("--backend", help="Engine of the training.")
    ] = "mujoco",
    changes: arguments.Settings = None,
    parameters: arguments.Parameters = None,
    normalization: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="FILE", help="Statistics of VecNormalize, for all policies or each."
        ),
    ] = None,
    trust: TrustOption = False,
    to: Annotated[
        list[str] | None,
        typer.Option(
            metavar="ENGINE[:NAME=VALUE,...]",
            help="Engine to replay in; repeatable; mujoco, newton.",
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Picture to write, .png.")
    ] = None,
    form: arguments.Form = Format.TEXT,
) -> bool:
    """Replay trained policies in other engines: how much of their reward do they keep?

    Details: sigmas=1, changes of each constant in standard uncertainties, as 1,2, or 0 for none; starts=3 in
    each world, within the start's uncertainty; seed=0 of the starts; fail_below=90, in percent: exit code 1 when less
    is kept.
    """
    from gauge_envs.pages.figures import save_png
    from gauge_envs.tools.transfer.policies.load import load_policies
    from gauge_envs.tools.transfer.policy_replays import (
        make_control_env,
        other_worlds,
        replay,
        training_world,
    )
    from gauge_envs.tools.transfer.transfer import transfer_report
    from gauge_envs.tools.transfer.words import draw_transfer, transfer_document

    policies, details = arguments.split_details(
        words,
        sigmas=_numbers,
        starts=PositiveInt,
        seed=NonNegativeInt,
        fail_below=float,
    )
    files = _picture_files(out)
    constants = arguments.parsed_parameters(parameters) or "calibrated"
    training = training_world(engine, arguments.parsed_settings(changes), constants)
    with closing(make_control_env(task)) as env:
        loaded = load_policies(
            policies, env, normalization=normalization or [], trust=trust
        )
    others = list(
        other_worlds(
            task, training, engines=_engines(to), sigmas=details.pop("sigmas", [1.0])
        )
    )
    least = details.pop("fail_below", 0.0)
    details = {"starts": 3, "seed": 0} | details
    with stderr_console().status("replaying") as status:
        replays = replay(
            task, loaded, training, others, **details,
            notify=lambda name: status.update(f"replaying: {plain_text(name)}"),
        )  # fmt: skip
    report = transfer_report(replays)
    if form is not Format.JSON:
        for name, reason in report.left_out.items():
            message(f"{name}: {reason}", "left out")
    writers = {".png": lambda file: save_png(draw_transfer(report), file)}
    print_document(transfer_document(report), form, files=files, writers=writers)
    return 100.0 * report.kept.value < least


def _numbers(text: str) -> list[float]:
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        raise ParameterError(
            f"sigmas={text}: expected numbers with commas, as 1,2"
        ) from None
    return [] if numbers == [0.0] else numbers


def _engines(texts: Sequence[str] | None) -> list[tuple[str, dict[str, Any]]]:
    """Return engines with their settings; without texts, those of the default engines that are installed."""
    from gauge_envs.backends.registry import backend

    found: list[tuple[str, dict[str, Any]]] = []
    for text in texts or DEFAULT_ENGINES:
        name, _, settings = text.partition(":")
        try:
            if not texts:
                backend(name)
            found.append(
                (
                    name,
                    arguments.parsed_settings(
                        arguments.split_list(settings) if settings else []
                    )
                    or {},
                )
            )
        except MissingExtraError:
            continue
    return found


def _picture_files(out: Path | None) -> dict[str, Path]:
    """Return the file of `--out`; a missing matplotlib is an error before anything runs, not after."""
    from gauge_envs.pages.figures import new_figure

    if out is None:
        return {}
    files = arguments.by_suffix([out], ".png")
    new_figure(1.0, 1.0)
    return files


def transfer_envelope(
    words: Annotated[
        list[str],
        typer.Argument(
            metavar="ID [NAME=VALUE]...", help="Control task or experiment."
        ),
    ],
    policy: Annotated[
        str,
        typer.Option(
            metavar="POLICY",
            help="Policy of a control task, as in gauge transfer; or that of its law.",
        ),
    ] = "law",
    normalization: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Statistics that VecNormalize saved beside the policy."
        ),
    ] = None,
    trust: TrustOption = False,
    engine: Annotated[str, typer.Option("--backend", help="Engine.")] = "mujoco",
    changes: arguments.Settings = None,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Picture to write, .png.")
    ] = None,
    form: arguments.Form = Format.TEXT,
) -> None:
    """Show what uncertain constants and starts do to a reward or a score.

    Details: samples=256, number of points, a power of 2, and their seed=0; batch=256, worlds that run at a time.
    --policy law:fraction=0.95,informed=false states the law's share of the limit, and whether it knows the constants of
    each world.
    """
    from gauge_envs.pages.figures import save_png
    from gauge_envs.tools.control import control_tasks
    from gauge_envs.tools.transfer.envelope import envelope_report, experiment_envelope
    from gauge_envs.tools.transfer.words import draw_envelope, envelope_document

    subject, details = arguments.split_subject(
        words, samples=PositiveInt, batch=PositiveInt, seed=NonNegativeInt
    )
    files = _picture_files(out)
    common = {"samples": 256, "batch": 256, "seed": 0} | details
    with Progress("samples", common["samples"]) as progress:
        common |= {"backend": engine, "settings": arguments.parsed_settings(changes)}
        common["notify"] = lambda done: progress.show("samples", done)
        if subject.removeprefix("GAUGE/") in {task.name for task in control_tasks()}:
            found = _control(subject, policy, normalization, trust, **common)
        elif policy != "law":
            raise ParameterError(
                f"{subject} is an experiment: only control tasks have policies"
            )
        else:
            found = experiment_envelope(subject, **common)
    report = envelope_report(found)

    writers = {".png": lambda file: save_png(draw_envelope(found, report), file)}
    print_document(envelope_document(report), form, files=files, writers=writers)


def _control(
    task: str, policy: str, normalization: Path | None, trust: bool, **options: Any
) -> Envelope:
    from dataclasses import replace

    from gauge_envs.tools.transfer.envelope import LawPolicy, control_envelope
    from gauge_envs.tools.transfer.policies.load import load_policy
    from gauge_envs.tools.transfer.policy_replays import make_control_env

    name, _, text = policy.partition(":")
    if name == "law":
        others, details = arguments.split_details(
            text.split(",") if text else [], fraction=float, informed=bool
        )
        if others:
            raise ParameterError(
                f"--policy {policy}: expected law:fraction=0.95,informed=true"
            )
        return control_envelope(task, policy=LawPolicy(**details), **options)
    with closing(make_control_env(task)) as env:
        loaded = load_policy(policy, env, normalization=normalization, trust=trust)
    return replace(control_envelope(task, policy=loaded, **options), policy=policy)
