"""Read the two sides and the subject of a comparison: a model file, id, USD layer, or function."""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence
from contextlib import redirect_stdout
from pathlib import Path

import mujoco

from gauge_envs.backends.mujoco.mjcf import scene_mjcf_text
from gauge_envs.cli import arguments
from gauge_envs.errors import ParameterError, UnknownNameError
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.experiments.variants import (
    find_variant,
)
from gauge_envs.registry import engine_points
from gauge_envs.tools.versions.environments import (
    released_versions,
    version_key,
)
from gauge_envs.tools.versions.schema import Side
from gauge_envs.tools.versions.worker import made

PACKAGES = {
    "mujoco": "mujoco",
    "newton": "newton",
    "genesis": "genesis-world",
    "rapier": "rapier3d",
    "physx": "sapien",
    "pybullet": "pybullet",
}
"""Package of each engine with releases that can be compared."""

RELEASES = re.compile(r"([\w-]+)==(\d[\w.]*?)(?:\.\.(\d[\w.]*))?")

SETTING = re.compile(r"(\w+)=(?!=)")

FORMS = (
    "mujoco==3.3.0, mujoco==3.1.0..4.0.0, mujoco for the installed version, another engine of this package or its "
    "release, or settings as iterations=4; settings may follow a side, as mujoco==4.0.0:jacobian=dense"
)

MODEL_FILES = (".xml", ".mjcf", ".urdf")


# --- sides -----------------------------------------------------------------------------------------------------------


def read_sides(text: str) -> list[Side]:
    """Return the side named by a text, or both ends of a range of releases.

    Args:
        text: Text in one of the `FORMS`.

    Raises:
        ParameterError: The text names no side.
    """
    engines = [point.name for point in engine_points()]
    head, _, changes = text.partition(":")
    setting = SETTING.match(head)
    if setting and setting[1] not in engines:
        # Settings without an engine apply to the installed MuJoCo.
        head, changes = "mujoco", text
    values = arguments.split_values(changes) if changes else []
    settings = arguments.parsed_settings(values) or {}
    if head in engines:
        return [Side(title=text, engine=head, settings=settings)]
    release = RELEASES.fullmatch(head)
    if release is None or release[1] not in PACKAGES:
        raise ParameterError(
            f"unknown version {text!r}: expected {FORMS}; engines: {', '.join(engines)}"
        )
    engine, *versions = release.groups()
    return [
        Side(
            title=f"{engine}=={version}{text[len(head) :]}",
            requirement=f"{PACKAGES[engine]}=={version}",
            engine="" if engine == "mujoco" else engine,
            settings=settings,
        )
        for version in filter(None, versions)
    ]


def is_suite_id(subject: str) -> bool:
    """Return whether a subject is an id or a task file of an experiment.

    Raises:
        TaskFileError: The task file is wrong.
        ParameterError: The task file has several experiments.
    """
    try:
        find_variant(subject)
    except UnknownNameError:
        return False
    return True


def compares_motions(subject: str, sides: Sequence[Side]) -> bool:
    """Return whether to compare whole motions, because a side cannot compute a step of a MuJoCo model.

    Raises:
        ParameterError: One side needs whole motions, which the other side or the subject cannot give.
    """
    needs_motion = [
        side.title
        for side in sides
        if side.engine not in ("", "mujoco")
        or not all(hasattr(mujoco.MjOption, name) for name in side.settings)
    ]
    releases = [side.title for side in sides if not side.engine]
    is_suite = is_suite_id(subject)
    if needs_motion and (releases or not is_suite):
        raise ParameterError(
            f"{subject} and {needs_motion[0]}: compare other engines and their settings with each other on an "
            "experiment, as SlopeSlider-2-wood or a task file; compare releases of MuJoCo with each other and with "
            "mujoco and its options, as iterations=4"
        )
    if needs_motion or releases or not is_suite:
        return bool(needs_motion)
    scene = load_experiment(subject).scene
    return bool(scene.deformables or scene.drivers)


def releases_between(sides: Sequence[Side]) -> list[Side]:
    """Return the releases of the package index from one version of MuJoCo to another, both included.

    Raises:
        ParameterError: The range has fewer than two releases.
        VersionsError: The index does not answer.
    """
    first, last = sides
    lowest, highest = (
        version_key(side.requirement.partition("mujoco==")[2]) for side in sides
    )
    if not lowest or not highest:
        raise ParameterError(
            "--bisect needs a range of releases, for example mujoco==3.1.0..4.0.0"
        )
    versions = released_versions(first.requirement)
    settings = first.title[len(first.requirement) :]
    releases = [
        side
        for version in versions
        if lowest <= version_key(version) <= highest
        for side in read_sides(f"mujoco=={version}{settings}")
    ]
    if len(releases) < 2:
        raise ParameterError(
            f"{first.title} to {last.title}: expected a range from an older to a newer release; the newest are "
            f"{', '.join(versions[-8:])}"
        )
    return releases


# --- models ----------------------------------------------------------------------------------------------------------


def read_subject(text: str, folder: Path) -> Path:
    """Return the model file of a subject.

    Args:
        text: Model file, task file, id of this suite or of Gymnasium, or `module:function` that returns an environment
            with a model file, or an `MjSpec`.
        folder: Folder of written files.

    Raises:
        ParameterError: The text does not name a model.
    """
    file = folder / "subject.xml"
    path = Path(text)
    if path.suffix.lower() in MODEL_FILES:
        if not path.is_file():
            raise ParameterError(f"{text}: no such file")
        return path
    if is_suite_id(text):
        scene = load_experiment(text).scene
        if scene.deformables or scene.drivers:
            raise ParameterError(
                f"{text}: releases of MuJoCo are not compared on deformable or driven bodies; "
                "give engines or settings of mujoco"
            )
        file.write_text(scene_mjcf_text(scene, text, frame_count=1))
        return file
    try:
        # Keep prints of the user's code out of the output of the command.
        with redirect_stdout(sys.stderr):
            returned = made(text)
    except (Exception, SystemExit) as error:  # The user's code raises any kind.
        raise ParameterError(
            f"{text!r} is not a file, an id of this suite, an environment of Gymnasium, or module:function: "
            f"{type(error).__name__}: {error}"
        ) from error
    if isinstance(returned, mujoco.MjSpec):
        file.write_text(returned.to_xml())
        return file
    env = getattr(returned, "unwrapped", returned)
    if not hasattr(env, "fullpath"):
        raise ParameterError(
            f"{text} is {type(env).__qualname__} without a model file: give the file, or a function that "
            "returns an MjSpec"
        )
    return Path(env.fullpath)
