"""`gauge backend versions`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gauge_envs.cli import arguments
from gauge_envs.cli.output import Format, message, print_document
from gauge_envs.errors import ParameterError

if TYPE_CHECKING:
    from gauge_envs.pages.document import Document
    from gauge_envs.tools.versions.model import Release, Side, Verdict


def backend_versions(
    subject: Annotated[
        str,
        typer.Argument(
            metavar="SUBJECT",
            help="Model file (MJCF, URDF, USD), id of this suite or of Gymnasium, module:function that makes an "
            "environment or a model.",
        ),
    ],
    versions: Annotated[
        list[str] | None,
        typer.Argument(
            metavar=arguments.SIDE,
            show_default=False,
            help="Two versions, as mujoco==3.3.0, or a range, as mujoco==3.1.0..4.0.0; mujoco is what is installed "
            "here. Settings may follow, as mujoco==4.0.0:jacobian=dense, or stand alone, as iterations=4. On an id, "
            "engines as newton:preset=training, and result files (.json).",
        ),
    ] = None,
    python: Annotated[
        list[Path] | None,
        arguments.option(
            arguments.NUMERICS,
            "Interpreter that has MuJoCo, as one more version: nothing is installed for it.",
            metavar="FILE",
        ),
    ] = None,
    states: Annotated[
        Path | None,
        arguments.option(
            arguments.SCENE,
            "Saved states: .npz with qpos, a row each, and qvel, act, ctrl and time if they are known.",
            metavar="FILE",
        ),
    ] = None,
    policy: Annotated[
        str | None,
        arguments.option(
            arguments.SCENE,
            "Compare return and success: of the policy that module:function returns, or of actions (.npy).",
            metavar="POLICY",
        ),
    ] = None,
    repeats: arguments.Repeats = 20,
    steps: Annotated[
        int,
        arguments.option(
            arguments.NUMERICS,
            "Steps of each motion: the start, keyframes, random controls, a push.",
            min=1,
        ),
    ] = 500,
    seed: arguments.Seed = 0,
    bisect: Annotated[
        bool,
        arguments.option(
            arguments.SELECTION,
            "Find the release of the range with which the difference came.",
            "--bisect",
        ),
    ] = False,
    keep: Annotated[
        bool,
        arguments.option(
            arguments.NUMERICS,
            "Whether environments stay in the cache for the next time.",
            "--keep/--clean",
        ),
    ] = True,
    out: Annotated[
        list[Path] | None, arguments.target("The same as .md or .json.")
    ] = None,
    form: arguments.Form = Format.TEXT,
) -> bool:
    """Compare releases of MuJoCo on your model, settings or engines: what changed, and which side is right.

    Each release runs in a Python environment of its own, which is installed into a cache, 160 MB each. Exit code 1 when
    two versions differ by more than the noise of the model.
    """
    from gauge_envs.tools.versions.environments import remove_environment
    from gauge_envs.tools.versions.model import Verdict
    from gauge_envs.tools.versions.sides import are_motions, of_interpreter

    files = arguments.by_suffix(out, ".md", ".json")
    sides = [*_sides(versions or ()), *map(of_interpreter, python or ())]
    if len(sides) != 2:
        raise ParameterError(
            f"two versions are compared, {len(sides)} are given: write as in gauge backend versions {subject} "
            "mujoco==3.3.0 mujoco==4.0.0"
        )
    if bisect and not all(side.requirement for side in sides):
        raise ParameterError(
            "--bisect needs a range of releases, as mujoco==3.1.0..4.0.0"
        )
    used = {side.requirement: None for side in sides if side.requirement}
    try:
        if policy is not None:
            found, document = _returns(subject, sides, policy, repeats, seed)
        elif are_motions(subject, sides):
            found, document = _motions(subject, sides, seed)
        else:
            found, document = _steps(
                subject,
                sides,
                used if bisect else None,
                states=states,
                steps=steps,
                seed=seed,
            )
    finally:
        for requirement in [] if keep else used:
            remove_environment(requirement)
    print_document(document, form, files=files)
    return found is Verdict.DIFFERENT


def _returns(
    subject: str, sides: Sequence[Side], policy: str, repeats: int, seed: int
) -> tuple[Verdict, Document]:
    """Compare what a policy reaches."""
    from gauge_envs.tools.versions.returns import compare_returns
    from gauge_envs.tools.versions.words import returns_document

    found = compare_returns(
        subject, *sides, policy=policy, seeds=repeats, seed=seed, say=message
    )
    return found.verdict, returns_document(found)


def _motions(
    subject: str, sides: Sequence[Side], seed: int
) -> tuple[Verdict, Document]:
    """Compare whole motions of an experiment."""
    from gauge_envs.tools.versions.motions import compare_motions
    from gauge_envs.tools.versions.words import motions_document

    found, scores = compare_motions(subject, *sides, seed=seed)
    return found.verdict, motions_document(found, scores)


def _steps(
    subject: str, sides: Sequence[Side], used: dict[str, None] | None, **options: Any
) -> tuple[Verdict, Document]:
    """Compare steps from the same states; with a collection of used releases, of the neighbours that differ."""
    from gauge_envs.tools.versions.bisection import bisect
    from gauge_envs.tools.versions.comparison import compare
    from gauge_envs.tools.versions.processes import bench
    from gauge_envs.tools.versions.sides import releases_between
    from gauge_envs.tools.versions.words import comparison_document

    first, last = sides
    tried: list[Release] = []
    with bench(subject, say=message, **options) as at:
        if used is not None:
            releases = releases_between(first, last, message)
            used |= {side.requirement: None for side in releases}
            neighbours, tried = bisect(at, releases, message)
            first, last = neighbours or (releases[0], releases[-1])
        found = compare(at, first, last)
    return found.verdict, comparison_document(found, tried)


def _sides(texts: Sequence[str]) -> list[Side]:
    """Return the versions that the texts name."""
    from gauge_envs.tools.versions.sides import read_side

    found: list[Side] = []
    for text in texts:
        # Settings alone are those of what is installed here.
        has_settings_alone = (
            "=" in text and "==" not in text.partition(":")[0] and ":" not in text
        )
        changes = text if has_settings_alone else text.partition(":")[2]
        settings = (
            arguments.assigned(text, arguments.split_values(changes)) if changes else {}
        )
        values = {name: arguments.value_of(value) for name, value in settings.items()}
        found += read_side(text, values)
    return found
