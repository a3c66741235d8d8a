"""`gauge transfer` and `gauge transfer envelope`."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gauge_envs.cli.arguments import (
    FormatOption,
    ParametersOption,
    SettingsOption,
    boolean,
    by_suffix,
    parsed_parameters,
    parsed_settings,
    split_details,
    split_list,
    whole,
)
from gauge_envs.cli.output import Format, Progress, message, plain_text, print_document, stderr_console
from gauge_envs.errors import ParameterError

if TYPE_CHECKING:
    from gauge_envs.tools.transfer.envelope import Envelope

DEFAULT_ENGINES = ("mujoco", "newton")

LAW = "law"
"""Name of the policy that the law of a task gives."""

TrustOption = Annotated[bool, typer.Option("--trust", help="Let loading run code of the policy's file or module.")]


def _numbers(text: str) -> list[float]:
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        raise ParameterError(f"sigmas={text}: expected numbers with commas, as 1,2") from None
    return [] if numbers == [0.0] else numbers


def transfer(
    words: Annotated[
        list[str],
        typer.Argument(
            metavar="POLICY... [NAME=VALUE]...",
            help="Stable-Baselines3 file (.zip), ONNX file (.onnx) or module:function; several are training seeds. "
            "Details: sigmas=1, changes of each constant in standard uncertainties, as 1,2, or 0 for none; starts=3 in "
            "each world, within the start's uncertainty; seed=0 of the starts.",
        ),
    ],
    task: Annotated[str, typer.Option("--id", metavar="ID", help="Control task, as GAUGE/Turntable-Limit-wood.")],
    engine: Annotated[str, typer.Option("--backend", help="Engine of the training.")] = "mujoco",
    changes: SettingsOption = None,
    parameters: ParametersOption = None,
    normalization: Annotated[
        list[Path] | None,
        typer.Option(metavar="FILE", help="Statistics that VecNormalize saved; one for all policies, or one for each."),
    ] = None,
    trust: TrustOption = False,
    to: Annotated[
        list[str] | None,
        typer.Option(
            metavar="ENGINE[:NAME=VALUE,...]",
            help="Engine to replay in, with settings; repeatable. Default: mujoco, newton.",
        ),
    ] = None,
    out: Annotated[Path | None, typer.Option(metavar="FILE", help="Picture to write, .png.")] = None,
    fail_below: Annotated[
        float | None, typer.Option(metavar="PERCENT", help="Exit code 1 when less of the promise is kept.")
    ] = None,
    form: FormatOption = Format.TEXT,
) -> bool:
    """Replay trained policies in other engines: how much of their reward do they keep?

    Worlds differ in their engine, its settings, and constants within their uncertainty. Exit
    code 1 when they keep less than --fail-below states.
    """
    from gauge_envs.tools.transfer.policies.load import load_policies
    from gauge_envs.tools.transfer.policy_replays import make_control_env, other_worlds, replay, training_world
    from gauge_envs.tools.transfer.transfer import transfer_report
    from gauge_envs.tools.transfer.words import transfer_document

    policies, details = split_details(words, {"sigmas": _numbers, "starts": whole(1), "seed": whole(0)})
    files = _picture_files([out] if out else [])
    training = training_world(engine, parsed_settings(changes), parsed_parameters(parameters) or "calibrated")
    with closing(make_control_env(task)) as env:
        loaded = load_policies(policies, env, normalization=normalization or [], trust=trust)
    engines = [_engine(text) for text in to] if to else _installed(DEFAULT_ENGINES)
    others = list(other_worlds(task, training, engines=engines, sigmas=details.pop("sigmas", [1.0])))
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

    def save(file: Path) -> Path:
        from gauge_envs.pages.figures import save_png
        from gauge_envs.tools.transfer.figure import draw_transfer

        return save_png(draw_transfer(report), file)

    print_document(transfer_document(report), form, files=files, writers={".png": save})
    return fail_below is not None and 100.0 * report.kept.value < fail_below


def transfer_envelope(
    words: Annotated[
        list[str],
        typer.Argument(
            metavar="ID [NAME=VALUE]...",
            help="Control task or experiment. Details: samples=256, number of points, a power of 2, and their seed=0; "
            "batch=256, worlds that run at a time; width=2, half width of the ranges of --out in standard "
            "uncertainties.",
        ),
    ],
    policy: Annotated[
        str,
        typer.Option(
            metavar="POLICY",
            help="Policy of a control task, as in gauge transfer. By default that of the law: "
            "law:fraction=0.95,informed=false has its share of the limit, and whether it knows the constants of each "
            "world.",
        ),
    ] = LAW,
    normalization: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Statistics that VecNormalize saved beside the policy.")
    ] = None,
    trust: TrustOption = False,
    engine: Annotated[str, typer.Option("--backend", help="Engine.")] = "mujoco",
    changes: SettingsOption = None,
    out: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="PATH",
            help="Picture (.png), or folder for the ranges as code of four stacks; repeatable.",
        ),
    ] = None,
    form: FormatOption = Format.TEXT,
) -> None:
    """Show what uncertain constants and starts do to a reward or a score.

    With --out DIR it writes the same uncertainty as ranges of domain randomization.
    """
    from gauge_envs.tools.transfer.envelope import experiment_envelope
    from gauge_envs.tools.transfer.envelope_statistics import envelope_report
    from gauge_envs.tools.transfer.envelope_words import envelope_document
    from gauge_envs.tools.transfer.randomization import write_randomization

    subjects, details = split_details(words, {"samples": whole(1), "batch": whole(1), "seed": whole(0), "width": float})
    if len(subjects) != 1:
        raise ParameterError(f"{' and '.join(subjects) or 'nothing'}: expected one control task or experiment")
    (subject,) = subjects
    files = _picture_files(out or [], "")
    width = details.pop("width", 2.0)
    common = {"samples": 256, "batch": 256, "seed": 0} | details
    common |= {"backend": engine, "settings": parsed_settings(changes)}
    with Progress("samples", common["samples"]) as progress:
        common["notify"] = lambda done: progress.show("samples", done)
        if _is_control(subject):
            found = _control(subject, policy, normalization, trust, **common)
        elif policy != LAW:
            raise ParameterError(f"{subject} is an experiment: only control tasks have policies")
        else:
            found = experiment_envelope(subject, **common)
    report = envelope_report(found)

    def save(file: Path) -> Path:
        from gauge_envs.pages.figures import save_png
        from gauge_envs.tools.transfer.envelope_figure import draw_envelope

        return save_png(draw_envelope(found, report), file)

    def save_ranges(folder: Path) -> str:
        return "\n".join(map(str, write_randomization(folder, found.id, found.scene, found.parameters, width)))

    print_document(envelope_document(report), form, files=files, writers={".png": save, "": save_ranges})


def _picture_files(out: list[Path], *others: str) -> dict[str, Path]:
    """Return the files of `--out`; a missing matplotlib is an error before anything runs, not after."""
    from gauge_envs.pages.figures import new_figure

    files = by_suffix(out, ".png", *others)
    if ".png" in files:
        new_figure(1.0, 1.0)
    return files


def _is_control(subject: str) -> bool:
    from gauge_envs.envs.control.tasks import control_tasks

    return subject.removeprefix("GAUGE/") in {task.name for task in control_tasks()}


def _control(task: str, policy: str, normalization: Path | None, trust: bool, **options: Any) -> Envelope:
    from dataclasses import replace

    from gauge_envs.tools.transfer.envelope import LawPolicy, control_envelope
    from gauge_envs.tools.transfer.policies.load import load_policy
    from gauge_envs.tools.transfer.policy_replays import make_control_env

    name, _, text = policy.partition(":")
    if name == LAW:
        others, details = split_details(text.split(",") if text else [], {"fraction": float, "informed": boolean})
        if others:
            raise ParameterError(f"--policy {policy}: expected law:fraction=0.95,informed=true")
        return control_envelope(task, policy=LawPolicy(**details), **options)
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
