"""What versions are compared on: a model file, an id, a USD layer, or what a function makes."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout, suppress
from operator import attrgetter
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import gymnasium
import mujoco
import numpy as np

from gauge_envs.errors import ParameterError, needs_extra
from gauge_envs.files import npz_arrays, os_errors
from gauge_envs.registry import SCENE_SUFFIXES
from gauge_envs.tools.versions.environments import Bench
from gauge_envs.tools.versions.sides import is_suite_id

MODEL_FILES = (".xml", ".mjcf", ".urdf")

MODEL_ATTRIBUTES = ("model", "sim.model._model", "physics.model._model", "mj_model")
"""Attributes of an environment that hold its compiled model."""

COMPARED = ("body_mass", "geom_size", "geom_friction", "dof_damping")
"""Fields by which a file is the model of an environment."""


@contextmanager
def bench(
    subject: str,
    states: Path | None = None,
    *,
    steps: int = 500,
    seed: int = 0,
) -> Iterator[Bench]:
    """Open a bench for a model, whose files are removed at the end.

    Args:
        subject: The model, as `read_subject` reads it.
        states: NPZ of saved states, which replace the motions; or None.
        steps: Steps of each motion.
        seed: Seed of controls and pushes.
    """
    saved = ""
    if states is not None:
        check_states(states)
        saved = str(states.resolve())
    with TemporaryDirectory(prefix="gauge-versions-") as folder:
        model = read_subject(subject, Path(folder)).resolve()
        job = {"model": str(model), "saved": saved, "steps": steps, "seed": seed}
        yield Bench(title=subject, job=job)


def read_subject(text: str, folder: Path) -> Path:
    """Return the model file of a subject.

    Args:
        text: Model file, USD layer, id of this suite or of Gymnasium, or `module:function` of a function that returns
            an environment or a model.
        folder: Folder of files that are written.

    Raises:
        ParameterError: The text names no model.
    """
    suffix = Path(text).suffix.lower()
    if suffix in (*MODEL_FILES, *SCENE_SUFFIXES) and not Path(text).is_file():
        raise ParameterError(f"{text}: there is no such file")
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

            # Only the motion of driven bodies, which is refused below, has a duration.
            scene = read_usd(text, unstated_duration_s=1.0).scene
    if scene.deformables or scene.drivers:
        raise ParameterError(
            f"{text}: releases of MuJoCo are not compared on deformable or driven bodies: "
            "give engines, settings of mujoco, or result files"
        )
    return scene_mjcf_text(scene, text, frame_count=1)


def _made(text: str) -> Any:
    """Return what a function makes, or the environment of an id of Gymnasium."""
    module, _, function = text.partition(":")
    sys.path.insert(0, "")
    try:
        # What it prints is no output of the command.
        with redirect_stdout(sys.stderr):
            if not function:
                return gymnasium.make(text)
            return getattr(importlib.import_module(module), function)()
    except (Exception, SystemExit) as error:  # The user's code raises any kind.
        cause = f"{type(error).__name__}: {' '.join(str(error).split())}"
        raise ParameterError(
            f"{text!r} is no file, no id of this suite, no environment of Gymnasium, and no module:function: {cause}"
        ) from error


def _model_file(title: str, made: Any, file: Path) -> Path:
    """Return the model file of what a function made: that of the environment, or `file`, which is written."""
    if isinstance(made, mujoco.MjSpec):
        file.write_text(made.to_xml(), encoding="utf-8")
        return file
    env = getattr(made, "unwrapped", made)
    model = _compiled_model(env)
    if model is None:
        raise ParameterError(
            f"{title} is {type(env).__qualname__}, which has no MuJoCo model: give its model file"
        )
    path = Path(getattr(env, "fullpath", file))
    if _is_same(path, model):
        return path
    # MuJoCo cannot save each model, and saves the one that it compiled last.
    with suppress(mujoco.FatalError):
        mujoco.mj_saveLastXML(str(file), model)
    if not _is_same(file, model):
        raise ParameterError(
            f"{title}: MuJoCo cannot save the model of the environment: give its model file"
        )
    return file


def _compiled_model(env: Any) -> mujoco.MjModel | None:
    """Return the compiled model that an object is or has; None if it has none."""
    candidates = [env]
    for path in MODEL_ATTRIBUTES:
        with suppress(AttributeError):
            candidates.append(attrgetter(path)(env))
    return next((each for each in candidates if isinstance(each, mujoco.MjModel)), None)


def _is_same(file: Path, model: mujoco.MjModel) -> bool:
    """Return whether a file is a model, but for the six digits that MuJoCo saves."""
    with suppress(ValueError):
        loaded = mujoco.MjModel.from_xml_path(str(file))
        return (loaded.nq, loaded.nu) == (model.nq, model.nu) and all(
            np.allclose(
                getattr(loaded, name), getattr(model, name), rtol=1e-4, atol=1e-9
            )
            for name in COMPARED
        )
    return False


def check_states(path: Path) -> None:
    """Check that a file is an NPZ of states.

    Raises:
        ParameterError: The file cannot be read, has no `qpos`, or another array does not fit it.
    """
    with os_errors(lambda cause: ParameterError(f"{path}: cannot be read: {cause}")):
        content = path.read_bytes()
    try:
        rows = npz_arrays(content)
    except ValueError as error:
        raise ParameterError(f"{path}: not an NPZ of states: {error}") from None
    shape = rows["qpos"].shape if "qpos" in rows else ()
    for name, values in rows.items():
        is_row_each = len(shape) == 2 and len(values) == shape[0] > 0
        if not is_row_each or not np.isfinite(values).all():
            raise ParameterError(
                f"{path}: {name} has the shape {values.shape}; expected qpos with a row for each state, as many rows "
                "of each other array, and finite numbers"
            )
