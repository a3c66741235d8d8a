"""Read the two sides and the subject of a comparison: a model file, id, USD layer, or function."""

from __future__ import annotations

import importlib
import re
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stdout, suppress
from operator import attrgetter
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import gymnasium
import mujoco
import numpy as np

from gauge_envs.cli import arguments
from gauge_envs.errors import ParameterError, needs_extra
from gauge_envs.experiments.variants import (
    beyond_variants,
    find_variant,
    is_task_path,
    variants,
)
from gauge_envs.registry import SCENE_SUFFIXES, engine_points
from gauge_envs.tools.versions.environments import (
    Bench,
    released_versions,
    version_key,
)
from gauge_envs.tools.versions.schema import Side

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

MODEL_ATTRIBUTES = (
    "model",
    "sim.model._model",
    "physics.model._model",
    "mj_model",
)
"""Attributes of an environment that may have its compiled model."""

COMPARED = ("body_mass", "geom_size", "geom_friction", "dof_damping")
"""Fields that identify the model of an environment."""


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
    name, *versions = release.groups() if release else ("",)
    engine = {PACKAGES[engine_name]: engine_name for engine_name in PACKAGES}.get(
        name, name
    )
    if engine not in PACKAGES:
        raise ParameterError(
            f"unknown version {text!r}: expected {FORMS}; engines: {', '.join(engines)}"
        )
    return [
        Side(
            title=f"{name}=={version}{text[len(head) :]}",
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
    if is_task_path(subject):
        return bool(find_variant(subject))
    known = (*variants(), *beyond_variants())
    return any(subject in (variant.name, variant.id) for variant in known)


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
    from gauge_envs.experiments.resolve import load_experiment

    scene = load_experiment(subject).scene
    return bool(scene.deformables or scene.drivers)


def releases_between(sides: Sequence[Side]) -> list[Side]:
    """Return the releases of the package index from one version to another, both included.

    Raises:
        ParameterError: The range has fewer than two releases.
        VersionsError: The index does not answer.
    """
    first, last = sides
    package, _, lowest = first.requirement.partition("==")
    highest = last.requirement.partition("==")[2]
    versions = released_versions(first.requirement)
    settings = first.title[len(first.requirement) :]
    releases = [
        side
        for version in versions
        for side in read_sides(f"{package}=={version}{settings}")
        if version_key(lowest) <= version_key(version) <= version_key(highest)
    ]
    if len(releases) < 2:
        raise ParameterError(
            f"{first.title} to {last.title}: expected a range from an older to a newer release; the newest are "
            f"{', '.join(versions[-8:])}"
        )
    return releases


# --- models ----------------------------------------------------------------------------------------------------------


@contextmanager
def bench(
    subject: str,
    states: Path | None = None,
    *,
    steps: int = 500,
    seed: int = 0,
) -> Iterator[Bench]:
    """Open a bench for a model; its files are removed at the end.

    Args:
        subject: The model, as `read_subject` reads it.
        states: NPZ of saved states that replace the motions, or None.
        steps: Steps of each motion.
        seed: Seed of controls and pushes.
    """
    saved = "" if states is None else str(states.resolve())
    with TemporaryDirectory(prefix="gauge-versions-") as folder:
        model = read_subject(subject, Path(folder)).resolve()
        job = {"model": str(model), "saved": saved, "steps": steps, "seed": seed}
        yield Bench(title=subject, job=job)


def read_subject(text: str, folder: Path) -> Path:
    """Return the model file of a subject.

    Args:
        text: Model file, USD layer, task file, id of this suite or of Gymnasium, or `module:function` that returns an
            environment or a model.
        folder: Folder of written files.

    Raises:
        ParameterError: The text does not name a model.
    """
    suffix = Path(text).suffix.lower()
    if suffix in (*MODEL_FILES, *SCENE_SUFFIXES) and not Path(text).is_file():
        raise ParameterError(f"{text}: no such file")
    if suffix in MODEL_FILES:
        return Path(text)
    file = folder / "subject.xml"
    if suffix in SCENE_SUFFIXES or is_suite_id(text):
        file.write_text(_scene_text(text))
        return file
    return _model_file(text, _made(text), file)


def _scene_text(text: str) -> str:
    """Return a scene as MJCF."""
    from gauge_envs.experiments.resolve import load_experiment
    from gauge_envs.tools.mjcf import scene_mjcf_text

    if is_suite_id(text):
        scene = load_experiment(text).scene
    else:
        with needs_extra("a USD layer", "usd"):
            from gauge_envs.tools.usd import read_usd

            # Only prescribed motions have a duration, and they are rejected below.
            scene = read_usd(text, unstated_duration_s=1.0).scene
    if scene.deformables or scene.drivers:
        raise ParameterError(
            f"{text}: releases of MuJoCo are not compared on deformable or driven bodies; "
            "give engines or settings of mujoco"
        )
    return scene_mjcf_text(scene, text, frame_count=1)


def _made(text: str) -> Any:
    """Return the result of a function, or the environment of an id of Gymnasium."""
    module, _, function = text.partition(":")
    sys.path.insert(0, "")
    try:
        # Keep its prints out of the output of the command.
        with redirect_stdout(sys.stderr):
            if not function:
                return gymnasium.make(text)
            return getattr(importlib.import_module(module), function)()
    except (Exception, SystemExit) as error:  # The user's code raises any kind.
        raise ParameterError(
            f"{text!r} is not a file, an id of this suite, an environment of Gymnasium, or module:function: "
            f"{type(error).__name__}: {error}"
        ) from error


def _model_file(title: str, returned: Any, file: Path) -> Path:
    """Return the model file of an environment; if it has none, write its model to `file`."""
    if isinstance(returned, mujoco.MjSpec):
        returned = mujoco.MjModel.from_xml_string(returned.to_xml())
    env = getattr(returned, "unwrapped", returned)
    candidates = [env]
    for attribute in MODEL_ATTRIBUTES:
        with suppress(AttributeError):
            candidates.append(attrgetter(attribute)(env))
    models = [
        candidate for candidate in candidates if isinstance(candidate, mujoco.MjModel)
    ]
    if not models:
        raise ParameterError(
            f"{title} is {type(env).__qualname__} without a MuJoCo model: give its model file"
        )
    path = Path(getattr(env, "fullpath", file))
    if _is_same(path, models[0]):
        return path
    # MuJoCo saves only the model that it compiled last.
    with suppress(mujoco.FatalError):
        mujoco.mj_saveLastXML(str(file), models[0])
    if not _is_same(file, models[0]):
        raise ParameterError(
            f"{title}: MuJoCo cannot save the model of the environment: give its model file"
        )
    return file


def _is_same(file: Path, model: mujoco.MjModel) -> bool:
    """Return whether a file has a model, up to the six digits that MuJoCo saves."""
    with suppress(ValueError):
        loaded = mujoco.MjModel.from_xml_path(str(file))
        pairs = [(getattr(loaded, name), getattr(model, name)) for name in COMPARED]
        return (loaded.nq, loaded.nu) == (model.nq, model.nu) and all(
            np.allclose(*pair, rtol=1e-4, atol=1e-9) for pair in pairs
        )
    return False
