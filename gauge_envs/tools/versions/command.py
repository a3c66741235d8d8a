"""`gauge backend versions`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gauge_envs.cli import arguments
from gauge_envs.cli.output import Format, message, print_document
from gauge_envs.errors import ParameterError

if TYPE_CHECKING:
    from gauge_envs.tools.versions.model import Release, Side


def backend_versions(
    subject: Annotated[
        str,
        typer.Argument(
            metavar="SUBJECT",
            help="Model file (MJCF, URDF, USD), id of this suite or of Gymnasium, module:function that makes an "
            "environment or a model, or demonstrations with their model (.hdf5).",
        ),
    ],
    versions: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="VERSION",
            show_default=False,
            help="Two versions, as mujoco==3.3.0, or a range, as mujoco==3.1.0..4.0.0; mujoco is what is installed "
            "here. Settings of the engine may follow, as mujoco==4.0.0:jacobian=dense.",
        ),
    ] = None,
    python: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="FILE",
            rich_help_panel=arguments.NUMERICS,
            help="Interpreter that has MuJoCo, as one more version: nothing is installed for it.",
        ),
    ] = None,
    states: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            rich_help_panel=arguments.SCENE,
            help="Saved states: .npz with qpos, a row each, and qvel, act, ctrl and time if they are known; or .hdf5 "
            "of LIBERO and robomimic, with :demo_3 behind it for another demonstration than the first.",
        ),
    ] = None,
    steps: Annotated[
        int,
        typer.Option(
            min=1,
            rich_help_panel=arguments.NUMERICS,
            help="Steps of each motion: the start, keyframes, random controls, a push.",
        ),
    ] = 500,
    seed: arguments.Seed = 0,
    bisect: Annotated[
        bool,
        typer.Option(
            "--bisect",
            rich_help_panel=arguments.SELECTION,
            help="Find the release of the range with which the difference came.",
        ),
    ] = False,
    keep: Annotated[
        bool,
        typer.Option(
            "--keep/--clean",
            rich_help_panel=arguments.NUMERICS,
            help="Whether environments stay in the cache for the next time.",
        ),
    ] = True,
    out: Annotated[
        list[Path] | None, arguments.target("The same as .md or .json.")
    ] = None,
    form: arguments.Form = Format.TEXT,
) -> bool:
    """Compare releases of MuJoCo on your model: what changed, and which side is right.

    Each release runs in a Python environment of its own, which is installed into a cache, 160 MB each. Exit code 1 when
    two versions differ by more than the noise of the model.
    """
    from gauge_envs.tools.versions.bisection import bisect as bisected
    from gauge_envs.tools.versions.comparison import bench, compare
    from gauge_envs.tools.versions.environments import remove_environment
    from gauge_envs.tools.versions.model import Verdict
    from gauge_envs.tools.versions.sides import of_interpreter, releases_between
    from gauge_envs.tools.versions.words import comparison_document

    files = arguments.by_suffix(out, ".md", ".json")
    sides = [*_sides(versions or ()), *map(of_interpreter, python or ())]
    if len(sides) != 2:
        raise ParameterError(
            f"two versions are compared, {len(sides)} are given: write as in gauge backend versions {subject} "
            "mujoco==3.3.0 mujoco==4.0.0"
        )
    used = {side.requirement: None for side in sides if side.requirement}
    try:
        with bench(subject, states, steps=steps, seed=seed, say=message) as at:
            tried: list[Release] = []
            if bisect:
                if len(used) != 2:
                    raise ParameterError(
                        "--bisect needs a range of releases, as mujoco==3.1.0..4.0.0"
                    )
                releases = releases_between(sides[0], sides[1], message)
                used |= {side.requirement: None for side in releases}
                neighbours, tried = bisected(at, releases, message)
                sides = list(neighbours or sides)
            found = compare(at, sides[0], sides[1])
    finally:
        for requirement in [] if keep else used:
            remove_environment(requirement)
    print_document(comparison_document(found, tried), form, files=files)
    return found.verdict is Verdict.DIFFERENT


def _sides(texts: Sequence[str]) -> list[Side]:
    """Return the versions that the texts name."""
    from gauge_envs.tools.versions.sides import read_side

    found: list[Side] = []
    for text in texts:
        changes = text.partition(":")[2]
        settings = (
            arguments.assigned(text, arguments.split_list(changes)) if changes else {}
        )
        values = {name: arguments.value_of(value) for name, value in settings.items()}
        found += read_side(text, values)
    return found
