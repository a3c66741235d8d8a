"""What versions are compared on: a model file, an id, a USD layer, or an environment."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Mapping
from contextlib import redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

import gymnasium
import mujoco
import numpy as np

from gauge_envs.errors import ParameterError, needs_extra
from gauge_envs.experiments.variants import find_variant, variants
from gauge_envs.files import (
    npz_arrays,
    os_errors,
)

if TYPE_CHECKING:
    from gauge_envs.scene import Scene

MODEL_FILES = (".xml", ".mjcf", ".urdf")
USD_FILES = (".usd", ".usda", ".usdc", ".usdz")


MODEL_PLACES = ("", "model", "sim.model._model", "physics.model._model", "mj_model")
"""Attributes of a model or an environment that hold its compiled model."""

COMPARED = ("body_mass", "body_inertia", "geom_size", "geom_friction", "dof_damping")
"""Fields by which a file is the model of an environment."""


@dataclass(frozen=True)
class Subject:
    """A model that versions run.

    Attributes:
        title: As the user named it.
        file: Its MJCF or URDF.
        states: NPZ of its saved states, or None.
        motion: NPZ of the motion of its driven bodies, or None.
    """

    title: str
    file: Path
    states: Path | None = None
    motion: Path | None = None


def read_subject(text: str, folder: Path, states: Path | None = None) -> Subject:
    """Return the model that a text names.

    Args:
        text: Model file, USD layer, id of this suite or of Gymnasium, or `module:function` of a function that returns
            an environment, a model, or the path of one.
        folder: Folder of files that are written.
        states: Saved states, .npz.

    Raises:
        ParameterError: It names no model, or no states.
    """
    if states is not None:
        check_states(states)
    path = Path(text)
    if path.suffix.lower() in (*MODEL_FILES, *USD_FILES) and not path.is_file():
        raise ParameterError(f"{text}: there is no such file")
    if path.suffix.lower() in MODEL_FILES:
        return Subject(text, path, states)
    if path.suffix.lower() in USD_FILES:
        return _of_scene(text, folder, states)
    module, _, function = text.partition(":")
    if function:
        return Subject(
            text, _of_object(text, _called(module, function), folder), states
        )
    if text in {name for one in variants() for name in (one.name, one.id)}:
        return _of_scene(text, folder, states)
    try:
        env = gymnasium.make(text)
    except Exception as error:  # Other environments raise exceptions of any kind.
        cause = " ".join(str(error).split())
        raise ParameterError(
            f"{text!r} is no file, no id of this suite, and no environment of Gymnasium: {cause}"
        ) from error
    try:
        return Subject(text, _of_object(text, env, folder), states)
    finally:
        env.close()


# --- models ----------------------------------------------------------------------------------------------------------


def _scene_of(text: str) -> Scene:
    """Return the scene of an id of this suite, or of a USD layer."""
    if Path(text).suffix.lower() not in USD_FILES:
        from gauge_envs.experiments.resolve import load_experiment

        return load_experiment(find_variant(text).id).scene
    with needs_extra("a USD layer", "usd"):
        from gauge_envs.tools.usd import read_usd

        # A file that states no duration has no driven bodies, for whose motion alone it counts.
        return read_usd(text, unstated_duration_s=1.0).scene


def _of_scene(title: str, folder: Path, states: Path | None) -> Subject:
    """Return a scene as MJCF, with the motion of its driven bodies beside it.

    MuJoCo 3.9 and earlier crash on custom numbers of that size.
    """
    from gauge_envs.scene.timing import FRAME_RATE_HZ
    from gauge_envs.tools.mjcf import (
        DRIVER_COLUMNS,
        DRIVER_PREFIX,
        scene_mjcf_text,
    )

    scene = _scene_of(title)
    frames = 1 + round(scene.duration_s * FRAME_RATE_HZ)
    root = ElementTree.fromstring(scene_mjcf_text(scene, title, frames))
    motions = {}
    for custom in root.findall("custom"):
        for number in custom.findall("numeric"):
            name = number.get("name", "")
            if not name.startswith(DRIVER_PREFIX):
                raise ParameterError(
                    f"{title}: {name} of its deformable bodies belongs to MuJoCo {mujoco.__version__}; such scenes are "
                    "not compared"
                )
            rows = np.array(number.get("data", "").split(), dtype=np.float64)
            body = name.removeprefix(DRIVER_PREFIX)
            motions[body] = rows.reshape(-1, DRIVER_COLUMNS)
        root.remove(custom)
    file = _written(folder, ElementTree.tostring(root, encoding="unicode"))
    if not motions:
        return Subject(title, file, states)
    motion = folder / "motion.npz"
    np.savez(motion, allow_pickle=False, **motions)
    return Subject(title, file, states, motion)


def _called(module: str, function: str) -> Any:
    # As `python -m` does.
    if "" not in sys.path:
        sys.path.insert(0, "")
    try:
        # What it prints is no output of the command.
        with redirect_stdout(sys.stderr):
            return getattr(importlib.import_module(module), function)()
    except (Exception, SystemExit) as error:  # The user's function raises any kind.
        cause = f"{type(error).__name__}: {' '.join(str(error).split())}"
        raise ParameterError(f"{module}:{function}: {cause}") from error


def _of_object(title: str, made: Any, folder: Path) -> Path:
    """Return the model file of what a function made."""
    if isinstance(made, str | Path):
        if str(made).lstrip().startswith("<"):
            return _written(folder, str(made))
        if not Path(made).is_file():
            raise ParameterError(f"{title} returns {str(made)!r}, which is no file")
        return Path(made)
    if isinstance(made, mujoco.MjSpec):
        return _written(folder, made.to_xml())
    inner = getattr(made, "unwrapped", made)
    found = [_attribute(inner, place) for place in MODEL_PLACES]
    models = [one for one in found if isinstance(one, mujoco.MjModel)]
    if not models:
        kind = f"{type(inner).__module__}.{type(inner).__qualname__}"
        raise ParameterError(
            f"{title} is {kind}, which has no MuJoCo model: give its model file"
        )
    model = models[0]
    stated = getattr(inner, "fullpath", None)
    if stated and _is_same(Path(stated), model):
        return Path(stated)
    file = folder / "subject.xml"
    # It writes six digits, and the names of meshes as they stand.
    try:
        mujoco.mj_saveLastXML(str(file), model)
    except mujoco.FatalError as error:
        raise ParameterError(f"{title}: {error}: give its model file") from error
    if not _is_same(file, model):
        raise ParameterError(
            f"{title}: MuJoCo writes another model than it has: give its model file"
        )
    return file


def _attribute(target: Any, place: str) -> Any:
    for name in filter(None, place.split(".")):
        target = getattr(target, name, None)
    return target


def _is_same(file: Path, model: mujoco.MjModel) -> bool:
    try:
        again = mujoco.MjModel.from_xml_path(str(file))
    except ValueError:
        return False
    for name in COMPARED:
        one, two = getattr(again, name), getattr(model, name)
        if one.shape != two.shape or not np.allclose(one, two, rtol=1e-4, atol=1e-9):
            return False
    return bool((again.nq, again.nu) == (model.nq, model.nu))


def _written(folder: Path, text: str) -> Path:
    file = folder / "subject.xml"
    file.write_text(text, encoding="utf-8")
    return file


# --- saved states ----------------------------------------------------------------------------------------------------


def check_states(path: Path) -> None:
    """Check that a file is an NPZ of states.

    Raises:
        ParameterError: There are no states, or too many.
    """
    with os_errors(lambda cause: ParameterError(f"{path}: cannot be read: {cause}")):
        content = path.read_bytes()
    try:
        rows = npz_arrays(content)
    except ValueError as error:
        raise ParameterError(f"{path}: not an NPZ of states: {error}") from None
    _check_rows(path, rows)


def _check_rows(path: Path, rows: Mapping[str, np.ndarray]) -> None:
    """Check that arrays of states have finite numbers, and a row for each state."""
    states = rows.get("qpos")
    if states is None:
        raise ParameterError(
            f"{path} has no qpos, a row for each state; it has {', '.join(rows) or 'nothing'}"
        )
    if states.ndim != 2 or not len(states):
        raise ParameterError(
            f"{path}: qpos has the shape {states.shape}; expected a row for each state"
        )
    for name, values in rows.items():
        if values.shape[:1] != states.shape[:1]:
            raise ParameterError(
                f"{path}: {name} has the shape {values.shape}; expected {len(states)} rows, as of the other arrays"
            )
        if not np.all(np.isfinite(values)):
            raise ParameterError(f"{path}: {name} has numbers that are not finite")
