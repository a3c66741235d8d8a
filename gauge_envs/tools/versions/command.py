"""`gauge backend versions`."""

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import typer

from gauge_envs.cli import arguments
from gauge_envs.cli.output import Format, Progress, print_document
from gauge_envs.errors import ParameterError


def backend_versions(
    subject: Annotated[
        str,
        typer.Argument(
            metavar="SUBJECT",
            help="Model file (MJCF, URDF), task file, id of this suite or of Gymnasium, or module:function that "
            "returns an environment with a model file, or an MjSpec.",
        ),
    ],
    versions: Annotated[
        list[str] | None,
        typer.Argument(
            metavar=arguments.SIDE,
            show_default=False,
            help="Two versions, as mujoco==3.3.0, or a range, as mujoco==3.1.0..4.0.0; mujoco is the installed "
            "version. Settings may follow, as mujoco==4.0.0:jacobian=dense, or stand alone, as iterations=4. An id "
            "also takes engines, as newton:preset=training or rapier==0.36.0.",
        ),
    ] = None,
    python: Annotated[
        list[Path] | None,
        arguments.option(
            arguments.NUMERICS,
            "Interpreter with MuJoCo, as a version without installation.",
            metavar="FILE",
        ),
    ] = None,
    states: Annotated[
        Path | None,
        arguments.option(
            arguments.SCENE,
            "Saved states: .npz with a row for each state of qpos, and optionally qvel, act, ctrl and time.",
            metavar="FILE",
        ),
    ] = None,
    policy: Annotated[
        str | None,
        arguments.option(
            arguments.SCENE,
            "Compare the return of a policy (module:function) or of actions (.npy).",
            metavar="POLICY",
        ),
    ] = None,
    repeats: arguments.Repeats = 20,
    steps: Annotated[
        int,
        arguments.option(
            arguments.NUMERICS,
            "Steps of each motion: initial state, keyframes, random controls, push.",
            min=1,
        ),
    ] = 500,
    seed: arguments.Seed = 0,
    bisect: Annotated[
        bool,
        arguments.option(
            arguments.SELECTION,
            "Find the release of the range that introduced the difference.",
            "--bisect",
        ),
    ] = False,
    keep: Annotated[
        bool,
        arguments.option(
            arguments.NUMERICS,
            "Keep environments in the cache.",
            "--keep/--clean",
        ),
    ] = True,
    out: Annotated[
        list[Path] | None, arguments.target("Report as .md or .json.")
    ] = None,
    form: arguments.Form = Format.TEXT,
) -> bool:
    """Compare releases of MuJoCo on your model, settings or engines: what changed, and which side is right.

    Each release runs in a separate Python environment of 160 MB, installed into a cache. Exit code 1: the versions
    differ by more than the noise of the model.
    """
    from gauge_envs.tools.versions import report
    from gauge_envs.tools.versions.comparison import compare, find_change
    from gauge_envs.tools.versions.environments import remove_environment
    from gauge_envs.tools.versions.episodes import compare_motions, compare_returns
    from gauge_envs.tools.versions.schema import Side, VersionsVerdict
    from gauge_envs.tools.versions.subject import (
        compares_motions,
        read_sides,
        read_subject,
        releases_between,
    )

    files = arguments.by_suffix(out, ".md", ".json")
    sides = [side for text in versions or () for side in read_sides(text)]
    # The interpreter of a virtual environment is a link: do not resolve it.
    for path in python or ():
        sides.append(Side(title=str(path), python=str(path.absolute()), settings={}))
    if len(sides) != 2:
        raise ParameterError(
            f"expected two versions, got {len(sides)}: for example gauge backend versions {subject} "
            "mujoco==3.3.0 mujoco==4.0.0"
        )
    releases = releases_between(sides) if bisect else sides
    try:
        with (
            Progress("comparing", None),
            TemporaryDirectory(prefix="gauge-versions-") as folder,
        ):
            if policy is not None:
                returns = compare_returns(
                    subject, *sides, policy=policy, seeds=repeats, seed=seed
                )
                verdict, document = returns.verdict, report.returns_document(returns)
            elif compares_motions(subject, sides):
                motions, scores = compare_motions(subject, *sides, seed=seed)
                verdict = motions.verdict
                document = report.motions_document(motions, scores)
            else:
                job = {
                    "title": subject,
                    "model": str(read_subject(subject, Path(folder)).resolve()),
                    "saved": states and str(states.resolve()),
                    "steps": steps,
                    "seed": seed,
                }
                comparison = (
                    find_change(job, releases) if bisect else compare(job, *sides)
                )
                verdict = comparison.verdict
                document = report.comparison_document(comparison)
    finally:
        for side in () if keep else [*sides, *releases]:
            if side.requirement:
                remove_environment(side.requirement)
    print_document(document, form, files=files)
    return verdict is VersionsVerdict.DIFFERENT
