"""`gauge transfer` and the commands below it."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from gauge_envs.cli import arguments
from gauge_envs.cli.output import (
    Format,
    message,
    plain_text,
    print_document,
    stderr_console,
)
from gauge_envs.errors import MissingExtraError, ParameterError

Stack = Literal["mjlab", "isaaclab", "playground", "maniskill", "mujoco", "gymnasium"]

DEFAULT_ENGINES = ("mujoco", "newton")

TrustOption = Annotated[
    bool,
    arguments.option(
        arguments.SCENE,
        "Let loading run code of the policy's file or module.",
        "--trust",
    ),
]

Policies = Annotated[
    list[str],
    typer.Argument(
        metavar="POLICY",
        help="Stable-Baselines3 (.zip), ONNX (.onnx) or module:function; several are training seeds.",
    ),
]

Statistics = Annotated[
    list[Path] | None,
    arguments.option(
        arguments.SCENE,
        "Statistics of VecNormalize, for all policies or each.",
        metavar="FILE",
    ),
]

FailBelow = Annotated[
    float,
    arguments.measured(
        "--fail-below",
        "%",
        "Exit code 1 when less of the reward is kept.",
        arguments.SELECTION,
        show_default="0",
    ),
]


def transfer(
    policies: Policies,
    task: Annotated[
        str,
        arguments.experiment("Control task, as GAUGE/Turntable-Limit-wood."),
    ],
    engine: Annotated[str, arguments.backend("Engine of the training.")] = "mujoco",
    changes: arguments.Settings = None,
    parameters: arguments.Parameters = None,
    normalization: Statistics = None,
    trust: TrustOption = False,
    to: Annotated[
        list[str] | None,
        arguments.option(
            arguments.NUMERICS,
            "Engines to replay in.",
            metavar=arguments.PER_ENGINE,
            show_default="those of mujoco,newton that are installed",
        ),
    ] = None,
    sigmas: Annotated[
        list[float] | None,
        arguments.option(
            arguments.SCENE,
            "Changes of each constant in standard uncertainties, as 1,2; 0 is none.",
            metavar="number",
            show_default="1",
        ),
    ] = None,
    starts: Annotated[
        int,
        arguments.option(
            arguments.NUMERICS,
            "Starts in each world, within the uncertainty of the start.",
            min=1,
        ),
    ] = 3,
    seed: arguments.Seed = 0,
    fail_below: FailBelow = 0.0,
    out: Annotated[Path | None, arguments.target("Picture to write, .png.")] = None,
    form: arguments.Form = Format.TEXT,
) -> bool:
    """Replay trained policies in other engines: how much of their reward do they keep?

    Exit code 1 when less is kept than --fail-below states.
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

    files = _picture_files(out)
    constants = arguments.parsed_parameters(parameters) or "calibrated"
    training = training_world(engine, arguments.parsed_settings(changes), constants)
    with closing(make_control_env(task)) as env:
        loaded = load_policies(
            policies, env, normalization=normalization or [], trust=trust
        )
    others = list(
        other_worlds(task, training, engines=_engines(to), sigmas=_deviations(sigmas))
    )
    with stderr_console().status("replaying") as status:
        replays = replay(
            task, loaded, training, others, starts=starts, seed=seed,
            notify=lambda name: status.update(f"replaying: {plain_text(name)}"),
        )  # fmt: skip
    report = transfer_report(replays)
    if form is not Format.JSON:
        for name, reason in report.left_out.items():
            message(f"{name}: {reason}", "left out")
    writers = {".png": lambda file: save_png(draw_transfer(report), file)}
    print_document(transfer_document(report), form, files=files, writers=writers)
    return 100.0 * report.kept.value < fail_below


def _deviations(sigmas: Sequence[float] | None) -> list[float]:
    """Return changes of constants; none for 0."""
    return [one for one in sigmas or [1.0] if one != 0.0]


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
                        arguments.split_values(settings, arguments.ASSIGNED)
                        if settings
                        else []
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


def transfer_settings(
    policies: Policies,
    env: Annotated[
        str,
        arguments.option(
            arguments.SCENE,
            "Gymnasium id, as Ant-v5; module:function that returns an environment; or an MJCF file.",
            metavar="ENV",
        ),
    ],
    settings: Annotated[
        list[str],
        arguments.option(
            arguments.NUMERICS,
            "Setting to test: an option, as impratio=10, or KIND:NAMES.attribute, as geom:*foot*.friction=0.6.",
            "--set",
            metavar="NAME=VALUE",
        ),
    ],
    training: Annotated[
        list[str] | None,
        arguments.option(
            arguments.NUMERICS,
            "Setting of the training.",
            metavar="NAME=VALUE",
            show_default="those of the environment",
        ),
    ] = None,
    reward: Annotated[
        str | None,
        arguments.option(
            arguments.SCENE,
            "Reward of an MJCF file, of model and data; may return whether the episode succeeded too.",
            metavar="module:function",
        ),
    ] = None,
    control_s: Annotated[
        float | None,
        arguments.measured(
            "--control", "s", "Time between actions of an MJCF file.", arguments.SCENE
        ),
    ] = None,
    duration_s: Annotated[
        float | None,
        arguments.measured(
            "--duration", "s", "Length of an episode of an MJCF file.", arguments.SCENE
        ),
    ] = None,
    normalization: Statistics = None,
    trust: TrustOption = False,
    seeds: Annotated[
        int,
        arguments.option(
            arguments.NUMERICS, "Seeds, the same with both settings.", min=1
        ),
    ] = 20,
    fail_below: FailBelow = 0.0,
    form: arguments.Form = Format.TEXT,
) -> bool:
    """Replay policies of a MuJoCo environment with other settings of the engine: how much reward survives?

    Exit code 1 when less is kept than --fail-below states.
    """
    from gauge_envs.tools.transfer.policies.load import load_policies
    from gauge_envs.tools.transfer.settings_replay import make_env, replay_settings
    from gauge_envs.tools.transfer.words import settings_document

    def make() -> Any:
        return make_env(
            env, reward=reward, control_s=control_s, duration_s=duration_s, trust=trust
        )

    with closing(make()) as first:
        loaded = load_policies(
            policies, first, normalization=normalization or [], trust=trust
        )
    with stderr_console().status("replaying") as status:
        report = replay_settings(
            env, make, loaded, _assigned(training or []), _assigned(settings), seeds=seeds,
            notify=lambda name: status.update(f"replaying: {name}"),
        )  # fmt: skip
    print_document(settings_document(report), form)
    if report.test.kept is None and fail_below:
        raise ParameterError(
            "--fail-below: the policies earn no positive reward in training, so that no share of it can be kept"
        )
    return report.test.kept is not None and 100.0 * report.test.kept.value < fail_below


def _assigned(texts: Sequence[str]) -> dict[str, str]:
    """Return values by name of `NAME=VALUE`."""
    pairs = [text.partition("=") for text in texts]
    if wrong := ["".join(pair) for pair in pairs if "" in pair]:
        raise ParameterError(f"{wrong[0]}: expected NAME=VALUE, as impratio=10")
    return {name: value for name, _, value in pairs}


def transfer_randomize(
    subject: Annotated[
        str,
        typer.Argument(
            metavar="SUBJECT", help="Id; or a robot as MJCF or URDF, .xml or .urdf."
        ),
    ],
    stack: Annotated[
        Stack | None,
        arguments.option(
            arguments.OUTPUT,
            "Training stack of which a file is written.",
            "--for",
            show_default="none: ranges alone",
        ),
    ] = None,
    like: Annotated[
        list[str] | None,
        arguments.option(
            arguments.SCENE,
            "Id with the same pair of materials or the same servo as the robot, as ServoArm-so101.",
            metavar="ID",
        ),
    ] = None,
    payload: Annotated[
        list[float] | None,
        arguments.option(
            arguments.SCENE,
            "Smallest and largest mass that --body carries, as 0,0.5.",
            show_default="none",
            metavar="kg",
        ),
    ] = None,
    body: Annotated[
        str,
        arguments.option(arguments.SCENE, "Body with the payload.", metavar="NAME"),
    ] = "",
    out: Annotated[
        Path | None,
        arguments.target(
            "File to write, .py.", show_default="randomized_STACK.py with --for"
        ),
    ] = None,
    form: arguments.Form = Format.TEXT,
) -> None:
    """Give ranges for domain randomization that data justify, as a file of a training stack.

    Each range states its source and how often it was measured; what was not measured is left out.
    """
    from gauge_envs.pages.document import save_file
    from gauge_envs.tools.transfer.stack_files import (
        for_stack,
        stack_file,
        subject_ranges,
    )
    from gauge_envs.tools.transfer.words import ranges_document

    if out is not None and stack is None:
        raise ParameterError(f"--out {out} needs the stack: add --for mujoco")
    if body and payload is None:
        raise ParameterError(f"--body {body} needs --payload, as 0,0.5")
    if payload is not None and len(payload) != 2:
        raise ParameterError(
            "--payload takes the smallest and the largest mass, as 0,0.5"
        )
    found = subject_ranges(
        subject,
        like=like or (),
        payload_kg=None if payload is None else (payload[0], payload[1]),
        body=body,
    )
    files: dict[str, Path] = {}
    text = ""
    if stack is not None:
        files = arguments.by_suffix([out or Path(f"randomized_{stack}.py")], ".py")
        text = stack_file(found, stack)
        found = for_stack(found, stack)
    writers = {".py": lambda file: save_file(file, text)}
    print_document(ranges_document(found), form, files=files, writers=writers)
