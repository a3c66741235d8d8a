"""`gauge recipe joint`: settings of joints from logs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from gauge_envs.cli import arguments
from gauge_envs.cli.output import Format, Progress, echo, note, print_document
from gauge_envs.errors import ParameterError

if TYPE_CHECKING:
    from mujoco import MjSpec

    from gauge_envs.scene import Scene

Stack = Literal["mjlab", "playground", "isaaclab", "maniskill"]
SERVO = "dry_friction_n_m,armature_kg_m2,kp_n_m_per_rad,kv_n_m_s_per_rad,delay_s"
"""What is identified of a servo unless `fit` says otherwise; kv holds the viscous friction of its joint."""


def recipe_joint(
    logs: Annotated[
        list[Path],
        typer.Argument(
            metavar="LOG",
            help="CSV or NPZ files, LeRobot datasets, ROS 2 bags, trajectories of mujoco.sysid.",
        ),
    ],
    mass_kg: Annotated[
        float | None,
        arguments.measured("--mass", "kg", "Mass of the load.", arguments.SCENE),
    ] = None,
    length_m: Annotated[
        float | None,
        arguments.measured(
            "--length",
            "m",
            "From the axis to the centre of the load; angle 0 is hanging.",
            arguments.SCENE,
        ),
    ] = None,
    inertia_kg_m2: Annotated[
        float | None,
        arguments.measured(
            "--inertia",
            "kg m2",
            "Inertia of the load about its centre.",
            arguments.SCENE,
            show_default="0",
        ),
    ] = None,
    scene: Annotated[
        str | None,
        arguments.option(
            arguments.SCENE,
            "Id, experiment file, MJCF, URDF or USD layer whose hinges are the joints, in place of a load.",
            metavar="ID",
        ),
    ] = None,
    engine: arguments.Backend = "mujoco",
    changes: arguments.Settings = None,
    part_s: Annotated[
        float | None,
        arguments.measured(
            "--part",
            "s",
            "Longest part of a log that is simulated at once.",
            arguments.NUMERICS,
            is_positive=True,
            show_default="20 for servos, else the whole log",
        ),
    ] = None,
    fit: Annotated[
        list[str] | None,
        arguments.option(
            arguments.SELECTION,
            "What is identified.",
            metavar="NAME",
            show_default=f"of a servo {SERVO}; else the law that predicts best",
        ),
    ] = None,
    known: Annotated[
        list[str] | None,
        arguments.option(
            arguments.SELECTION,
            "Number that a bench measured, of all joints or of one as elbow.kp_n_m_per_rad; --source says where.",
            metavar="NAME=VALUE",
        ),
    ] = None,
    source: Annotated[
        str | None,
        arguments.option(
            arguments.SELECTION,
            "Where --known is from, which the lines to paste repeat.",
            metavar="TEXT",
        ),
    ] = None,
    joints: Annotated[
        list[str] | None,
        arguments.option(
            arguments.SELECTION,
            "Joints of the logs that are used.",
            metavar="NAME",
            show_default="all of the logs",
        ),
    ] = None,
    angle_unit: Annotated[
        str | None,
        arguments.option(
            arguments.SELECTION,
            "Unit of the angles: LeRobot states none; others have it to say when they reach beyond a turn.",
            metavar="rad|deg",
            show_default="rad, within a turn",
        ),
    ] = None,
    load_error: Annotated[
        float,
        arguments.option(
            arguments.SCENE,
            "Standard uncertainty of the load, as 0.05; intervals of torques hold it too.",
            metavar="SHARE",
            min=0.0,
        ),
    ] = 0.0,
    test: Annotated[
        list[Path] | None,
        arguments.option(
            arguments.SELECTION,
            "Logs to predict, which the fit does not see.",
            metavar="LOG",
        ),
    ] = None,
    stack: Annotated[
        Stack | None,
        arguments.option(
            arguments.OUTPUT,
            "Training stack whose lines are printed.",
            "--for",
            show_default="the engine",
        ),
    ] = None,
    out: Annotated[
        list[Path] | None,
        arguments.target(
            "The model of --scene with these numbers (.xml, .urdf), and the log for mujoco.sysid (.npz)."
        ),
    ] = None,
    form: arguments.Form = Format.TEXT,
) -> bool:
    """Give friction, armature and gains of joints from logs, with 95 % intervals.

    Without servos, laws of friction are compared: each file predicts the others. Several files give the interval of
    the value that the next file would have.

    Logs have columns time_s, position_rad, and command_rad of a servo or torque_n_m of a motor.

    Exit code 1 when the logs leave a setting open, or the engine does not follow a fitted one.
    """
    from gauge_envs.backends import backend
    from gauge_envs.scene import Scene
    from gauge_envs.tools.identify import identify
    from gauge_envs.tools.identify.mended import check_files, write_files
    from gauge_envs.tools.identify.model_files import has_slider
    from gauge_envs.tools.identify.stack_logs import read_logs
    from gauge_envs.tools.identify.words import identified_document

    files = arguments.by_suffix(out, ".xml", ".urdf", ".npz")
    load = {"mass_kg": mass_kg, "length_m": length_m, "inertia_kg_m2": inertia_kg_m2}
    built = _scene(
        scene, **{name: value for name, value in load.items() if value is not None}
    )
    model = None if isinstance(built, Scene) else built
    check_files(files, model, scene or "")
    read, tests = (
        [log for path in paths for log in read_logs(path, model, angle_unit)]
        for paths in (logs, test or ())
    )
    if joints:
        read, tests = ([log.only(joints) for log in some] for some in (read, tests))
    given = _bench(known, source)
    with Progress("simulations", None) as bar:
        found = identify(
            backend(engine),
            built,
            read,
            fit,
            known=given,
            held_out=tests,
            load_error=load_error,
            part_s=part_s,
            settings=arguments.parsed_settings(changes) or {},
            stack=stack,
            progress=bar.show,
        )
    print_document(identified_document(found), form)
    if form is not Format.JSON:
        echo(f"\npaste\n{found.stack_lines or found.lines}", nl=False)
        for name, value in given.items():
            echo(f"{name} = {value:g} is from {source}")
    for name in found.lost:
        note(
            f"{name}: {engine} does not follow it, do not use these settings: is a column, the load or a unit wrong?"
        )
    for name, joint in found.behind_a_lag:
        note(
            f"{name}, {joint}: a lag without a model follows it better, do not use its settings: "
            "start from other gains, with a scene that states them"
        )
    for name in [one for one in found.names if model and has_slider(model, one)]:
        note(
            f"{name} slides: in its numbers rad means m, N m means N, and kg m^2 means kg"
        )
    if files and model is not None:
        # The numbers are printed before, as a file that cannot be written ends the command.
        write_files(files, model, scene or "", found, read[0])
    is_open = any(one.unknown for one in found.settings)
    return is_open or bool(found.lost) or bool(found.behind_a_lag)


def _bench(known: list[str] | None, source: str | None) -> dict[str, float]:
    """Return the numbers of `--known`, which need a source."""
    given = arguments.parsed_settings(known) or {}
    for name, value in given.items():
        if not isinstance(value, int | float) or value < 0.0:
            raise ParameterError(
                f"--known {name}={value}: a number of 0 or more is needed"
            )
    if bool(given) != bool(source):
        raise ParameterError(
            "--known and --source go together: state where the bench value is from"
        )
    return given


def _scene(scene: str | None = None, **load: float) -> Scene | MjSpec:
    """Return the scene of an id or a file, the model of an MJCF file, or one joint with a load."""
    from gauge_envs.experiments.scene_builder import SceneBuilder
    from gauge_envs.experiments.task_files import task_spec
    from gauge_envs.experiments.variants import (
        find_variant,
        is_experiment_file,
        task_path,
    )
    from gauge_envs.registry import scene_suffixes
    from gauge_envs.tools.identify import one_joint, read_mjcf

    if scene is not None:
        if load:
            raise ParameterError(
                "--scene states the load: leave --mass, --length and --inertia out"
            )
        path = Path(scene)
        if is_experiment_file(path):
            from gauge_envs.tools.usd import load_experiment_file

            return load_experiment_file(path).scene
        if path.suffix in scene_suffixes():
            from gauge_envs.tools.identify.model_files import model_of_sliders
            from gauge_envs.tools.usd import read_usd

            # Joints of a log move freely, and robots often have colliders without a material.
            usd = read_usd(path, duration_s=1.0, contacts=None)
            return model_of_sliders(usd) if usd.sliders else usd.scene
        if path.suffix.lower() in (".xml", ".mjcf", ".urdf"):
            return read_mjcf(path)
        if path.suffix:
            raise ParameterError(
                f"--scene {scene}: name an id, an experiment file (.toml), an MJCF (.xml), a URDF or a USD layer"
            )
        variant = find_variant(scene)
        # An experiment of recorded motions starts at the angles of one.
        return SceneBuilder(
            task_path(variant.family), task_spec(variant.family), variant, {}
        ).build()
    for name in ("mass_kg", "length_m"):
        if name not in load:
            raise ParameterError(
                f"--{name.partition('_')[0]} of the load is missing: without it a log tells only ratios of torques"
            )
    return one_joint(**load)
