"""`gauge replay`."""

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from gauge_envs.cli import arguments
from gauge_envs.cli.output import Format, Progress, echo, print_document
from gauge_envs.errors import ParameterError

scene = partial(arguments.option, arguments.SCENE)


def replay(
    log: Annotated[
        list[Path],
        typer.Argument(
            metavar="LOG...",
            help="Logs of a robot or simulator: CSV, NPZ, Parquet, HDF5, MCAP, or the folder of a bag or of a LeRobot "
            "data set; several with --fit or several models.",
        ),
    ],
    model: Annotated[
        list[Path],
        scene(
            "The robot: MJCF or URDF. Others, or YAML of mujoco.sysid, are compared with the first.",
            "--model",
            "-m",
            metavar="FILE",
        ),
    ],
    against: Annotated[
        Path | None,
        scene(
            "Second log, which is explained; the first says how well the model predicts where it should.",
            metavar="LOG",
        ),
    ] = None,
    map_: Annotated[
        Path | None,
        scene(
            "Names, signs, units and gains that differ (TOML).",
            "--map",
            metavar="FILE",
        ),
    ] = None,
    policy_file: Annotated[
        Path | None,
        scene(
            "The policy that drove the robot: ONNX or TorchScript.",
            metavar="FILE",
        ),
    ] = None,
    fit: Annotated[
        str,
        scene(
            "Constants to fit, as armature,frictionloss,damping,kp,kd,delay.",
            metavar="NAMES",
        ),
    ] = "",
    joint: Annotated[
        str,
        scene("Joints whose constants are fitted.", metavar="NAMES"),
    ] = "",
    test: Annotated[
        list[Path] | None,
        scene(
            "Log that judges the fit without being fitted.",
            metavar="LOG",
        ),
    ] = None,
    write: Annotated[
        Path | None,
        arguments.option(
            arguments.OUTPUT,
            "MJCF of the model with the fitted constants, or YAML for mujoco.sysid.",
            metavar="FILE",
        ),
    ] = None,
    out: Annotated[
        list[Path] | None,
        arguments.target("The same as .md or .json."),
    ] = None,
    form: arguments.Form = Format.TEXT,
) -> bool:
    """Name the cause that makes a robot, or another simulator, move unlike your model.

    The model predicts the log from its own recorded states. Each cause of a list is fitted alone, and then in pairs;
    its share of the error counts on pieces of the log that the fit has not seen. Exit code 1 when the model does not
    predict the log within its noise, or the map lacks a line.

    With several models, their predictions are compared with those of the first one. With --fit, constants of all
    joints are fitted together. Both end with exit code 0.
    """
    from gauge_envs.tools.replay import ReplayVerdict, read_map, replay as explain
    from gauge_envs.tools.replay.constants import constants_document, fit_logs
    from gauge_envs.tools.replay.judge import judge_document, judge_models
    from gauge_envs.tools.replay.report import replay_document

    files = arguments.by_suffix(out, ".md", ".json")
    mapped, differs = read_map(map_), False
    paste: Mapping[str, str] = {}
    if fit:
        names, joints = (
            [part.strip() for part in text.split(",") if part] for text in (fit, joint)
        )
        found = fit_logs(log, model[0], test or (), names, joints, mapped, write)
        document, paste = constants_document(found), found.paste
    elif len(model) > 1:
        document = judge_document(judge_models(log, model, mapped))
    else:
        if len(log) > 1:
            raise ParameterError("several logs need --fit, or a second --model")
        with Progress("causes", None) as progress:
            line = explain(
                log[0], model[0], against, mapped, progress.advance, policy_file
            ).line
        document, paste = replay_document(line), line.paste
        differs = line.verdict is not ReplayVerdict.NOISE or bool(line.paste)
    print_document(document, form, files=files)
    if form is not Format.JSON:
        for stack, text in paste.items():
            # A terminal's width must not wrap what is to be pasted.
            echo(f"\n{stack}\n{text}")
    return differs
