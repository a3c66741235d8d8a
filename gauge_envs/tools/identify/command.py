"""`gauge recipe joint`: settings of joints from logs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gauge_envs.cli import arguments
from gauge_envs.cli.output import Format, Progress, echo, note, print_document
from gauge_envs.errors import ParameterError

if TYPE_CHECKING:
    from gauge_envs.scene import Scene

PASSIVE = ("dry_friction_n_m", "viscous_friction_n_m_s_per_rad", "armature_kg_m2")
SERVO = (
    "dry_friction_n_m",
    "armature_kg_m2",
    "kp_n_m_per_rad",
    "kv_n_m_s_per_rad",
    "delay_s",
)
"""What is identified unless `fit` says otherwise; kv holds the viscous friction of a servo's joint."""


def recipe_joint(
    words: Annotated[
        list[str],
        typer.Argument(metavar="LOG... [NAME=VALUE]...", help="CSV or NPZ files."),
    ],
    engine: Annotated[str, typer.Option("--backend", help="Engine.")] = "mujoco",
    form: arguments.Form = Format.TEXT,
) -> bool:
    """Give friction, armature and gains of joints from logs, with 95 % intervals.

    Logs have columns time_s, position_rad, and command_rad of a servo or torque_n_m of a motor.

    Details: mass_kg= and length_m= of the load, from the axis to its centre, angle 0 hanging; inertia_kg_m2= about the
    centre; or scene=, an id, experiment file or USD layer whose hinges are the joints. fit=NAME,NAME: what is
    identified. test=LOG,LOG: logs to predict. part_s=: longest part that is simulated at once. timestep_s= of the
    engine.

    Exit code 1 when the logs leave a setting open, or the engine does not follow a fitted one.
    """
    from gauge_envs.backends import backend
    from gauge_envs.tools.identify import identify, read_log
    from gauge_envs.tools.identify.words import identified_document, snippet

    numbers = dict.fromkeys(
        ("mass_kg", "length_m", "inertia_kg_m2", "part_s", "timestep_s"), float
    )
    names, details = arguments.split_details(
        words, **numbers, scene=str, fit=str, test=str
    )
    if not names:
        raise ParameterError("no log: name one or more CSV or NPZ files")
    logs, tests = (
        [read_log(Path(name)) for name in some if name]
        for some in (names, details.pop("test", "").split(","))
    )
    for log in (*logs, *tests):
        if (reach_rad := float(abs(log.position_rad).max())) > 6.2832:
            note(
                f"{log.name}: angles reach {reach_rad:.3g} rad, {reach_rad / 6.2832:.2g} turns: are they in degrees?"
            )
    wanted = details.pop(
        "fit", ",".join(SERVO if logs[0].command_rad is not None else PASSIVE)
    ).split(",")
    part_s = details.pop("part_s", None)
    settings = {name: details.pop(name) for name in ("timestep_s",) if name in details}
    with Progress("simulations", None) as bar:
        found = identify(
            backend(engine),
            _scene(**details),
            logs,
            wanted,
            held_out=tests,
            part_s=part_s,
            settings=settings,
            progress=bar.show,
        )
    print_document(identified_document(found), form)
    if form is not Format.JSON:
        echo(f"\npaste\n{snippet(found)}", nl=False)
    for name in found.lost:
        note(
            f"{name}: {engine} does not follow it, do not use these settings: is a column, the load or a unit wrong?"
        )
    return any(one.unknown for one in found.settings) or bool(found.lost)


def _scene(scene: str | None = None, **load: float) -> Scene:
    """Return the scene of an id or a file, or one joint with a load."""
    from gauge_envs.experiments.scene_builder import SceneBuilder
    from gauge_envs.experiments.task_files import task_spec
    from gauge_envs.experiments.variants import (
        find_variant,
        is_experiment_file,
        task_path,
    )
    from gauge_envs.registry import scene_suffixes
    from gauge_envs.tools.identify import one_joint
    from gauge_envs.tools.usd import load_experiment_file, read_usd

    if scene is not None:
        if load:
            raise ParameterError(
                f"scene= states the load: leave {' and '.join(load)} out"
            )
        path = Path(scene)
        if is_experiment_file(path):
            return load_experiment_file(path).scene
        if path.suffix in scene_suffixes():
            return read_usd(path, duration_s=1.0).scene
        if path.suffix:
            raise ParameterError(
                f"scene={scene}: a model file alone states no scene. Name an id, an experiment file (.toml), or a USD "
                "layer, to which importers of other tools convert URDF and MJCF"
            )
        variant = find_variant(scene)
        # An experiment of recorded motions starts at the angles of one.
        return SceneBuilder(
            task_path(variant.family), task_spec(variant.family), variant, {}
        ).build()
    for name in ("mass_kg", "length_m"):
        if name not in load:
            raise ParameterError(
                f"{name}= of the load is missing: without it a log tells only ratios of torques"
            )
    return one_joint(**load)
