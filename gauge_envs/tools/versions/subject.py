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
from xml.etree import ElementTree

import gymnasium
import mujoco
import numpy as np

from gauge_envs.errors import ParameterError, needs_extra
from gauge_envs.files import npz_arrays, os_errors
from gauge_envs.tools.versions.environments import Bench, Say
from gauge_envs.tools.versions.sides import is_suite_id

MODEL_FILES = (".xml", ".mjcf", ".urdf")
USD_FILES = (".usd", ".usda", ".usdc", ".usdz")

MODEL_ATTRIBUTES = ("model", "sim.model._model", "physics.model._model", "mj_model")
"""Attributes of an environment that hold its compiled model."""

COMPARED = ("body_mass", "body_inertia", "geom_size", "geom_friction", "dof_damping")
"""Fields by which a file is the model of an environment."""


@contextmanager
def bench(
    subject: str,
    states: Path | None = None,
    *,
    steps: int = 500,
    seed: int = 0,
    say: Say = print,
) -> Iterator[Bench]:
    """Open a bench for a model, whose files are removed at the end.

    Args:
        subject: The model, as `read_subject` reads it.
        states: NPZ of saved states, which replace the motions; or None.
        steps: Steps of each motion.
        seed: Seed of controls and pushes.
        say: Prints what is installed.
    """
    saved = ""
    if states is not None:
        check_states(states)
        saved = str(states.resolve())
    with TemporaryDirectory(prefix="gauge-versions-") as name:
        folder = Path(name)
        model, motions = read_subject(subject, folder)
        job = {
            "model": str(model.resolve()),
            "motions": motions,
            "saved": saved,
            "steps": steps,
            "seed": seed,
        }
        yield Bench(title=subject, folder=folder, job=job, say=say)


def read_subject(text: str, folder: Path) -> tuple[Path, dict[str, Any]]:
    """Return the model file of a subject, and the motion of its driven bodies by name, rows of 19 numbers.

    Args:
        text: Model file, USD layer, id of this suite or of Gymnasium, or `module:function` of a function that returns
            an environment, a model, or the path of one.
        folder: Folder of files that are written.

    Raises:
        ParameterError: The text names no model.
    """
    suffix = Path(text).suffix.lower()
    if suffix in (*MODEL_FILES, *USD_FILES) and not Path(text).is_file():
        raise ParameterError(f"{text}: there is no such file")
    if suffix in MODEL_FILES:
        return Path(text), {}
    if suffix in USD_FILES or is_suite_id(text):
        return _scene_file(text, folder, is_usd=suffix in USD_FILES)
    return _model_file(text, _made(text), folder), {}


def _scene_file(
    text: str, folder: Path, *, is_usd: bool
) -> tuple[Path, dict[str, Any]]:
    """Write a scene as MJCF without the motion of its driven bodies, and return both.

    MuJoCo 3.9 and earlier crash on custom numbers of that size.
    """
    from gauge_envs.experiments.resolve import load_experiment
    from gauge_envs.scene.timing import FRAME_RATE_HZ
    from gauge_envs.tools.mjcf import DRIVER_COLUMNS, DRIVER_PREFIX, scene_mjcf_text

    if is_usd:
        with needs_extra("a USD layer", "usd"):
            from gauge_envs.tools.usd import read_usd

            # The duration only bounds the motion of driven bodies.
            scene = read_usd(text, unstated_duration_s=1.0).scene
    else:
        scene = load_experiment(text).scene
    if scene.deformables:
        raise ParameterError(
            f"{text}: scenes with deformable bodies are not compared, as their custom numbers belong to MuJoCo "
            f"{mujoco.__version__}"
        )
    frames = 1 + round(scene.duration_s * FRAME_RATE_HZ)
    root = ElementTree.fromstring(scene_mjcf_text(scene, text, frames))
    motions = {}
    for custom in root.findall("custom"):
        for number in custom.findall("numeric"):
            body = number.get("name", "").removeprefix(DRIVER_PREFIX)
            values = np.array(number.get("data", "").split(), dtype=float)
            motions[body] = values.reshape(-1, DRIVER_COLUMNS).tolist()
        root.remove(custom)
    file = folder / "subject.xml"
    ElementTree.ElementTree(root).write(file)
    return file, motions


def _made(text: str) -> Any:
    """Return what a function makes, or the environment of an id of Gymnasium."""
    module, _, function = text.partition(":")
    if "" not in sys.path:
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


def _model_file(title: str, made: Any, folder: Path) -> Path:
    """Return the model file of what a function made."""
    file = folder / "subject.xml"
    if isinstance(made, mujoco.MjSpec):
        made = made.to_xml()
    if isinstance(made, str | Path):
        if str(made).lstrip().startswith("<"):
            file.write_text(str(made), encoding="utf-8")
            return file
        if not Path(made).is_file():
            raise ParameterError(f"{title} returns {str(made)!r}, which is no file")
        return Path(made)
    env = getattr(made, "unwrapped", made)
    model = _compiled_model(env)
    if model is None:
        raise ParameterError(
            f"{title} is {type(env).__qualname__}, which has no MuJoCo model: give its model file"
        )
    path = getattr(env, "fullpath", None)
    if path and _is_same(Path(path), model):
        return Path(path)
    try:
        mujoco.mj_saveLastXML(str(file), model)
    except mujoco.FatalError as error:
        raise ParameterError(f"{title}: {error}: give its model file") from error
    if not _is_same(file, model):
        raise ParameterError(
            f"{title}: MuJoCo saves another model than the environment has: give its model file"
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
        is_row_each = values.shape[:1] == shape[:1] and len(shape) == 2 and shape[0]
        if not is_row_each or not np.isfinite(values).all():
            raise ParameterError(
                f"{path}: {name} has the shape {values.shape}; expected qpos with a row for each state, as many rows "
                "of each other array, and finite numbers"
            )
