"""Training stacks: the targets of a check and their readers."""

from pathlib import Path

from gauge_envs.backends.mujoco.messages import mujoco_warnings
from gauge_envs.errors import TargetError
from gauge_envs.reading import faults_of, reading
from gauge_envs.text import toml_document
from gauge_envs.tools.sanity.readers import probe, settings
from gauge_envs.tools.sanity.readers.gymnasium_env import (
    SUITE,
    Target,
    read_id,
    read_object,
    read_task,
    suite_file,
)
from gauge_envs.tools.sanity.readers.mjcf import GeomPair, read_model_file
from gauge_envs.tools.sanity.verdict import TrainingConfiguration


def _read_toml(path: Path, pair: GeomPair | None) -> TrainingConfiguration:
    """Return the configuration of a settings file or a task file."""
    with reading(path, TargetError) as content:
        values = toml_document(content)
    if "family" in values:
        return read_task(path)
    return settings.read_settings(path, values)


READERS = {
    **dict.fromkeys((".xml", ".mjcf", ".urdf"), read_model_file),
    ".toml": _read_toml,
    ".json": probe.read_file,
}
"""Function that reads a file, by its suffix."""


@mujoco_warnings()
def configuration(
    target: Target | TrainingConfiguration, *, pair: GeomPair | None = None
) -> TrainingConfiguration:
    """Return the training configuration of a target.

    Args:
        target: One of
            a Gymnasium id (`HalfCheetah-v5`) whose environment has a `mujoco.MjModel` as `unwrapped.model`;
            an id of this suite, with its own settings;
            a task of dm_control (`dm_control:walker-walk`);
            a model file that MuJoCo reads;
            a task file of an experiment;
            a settings file: `backend`, optionally `preset`, and a table `settings`;
            a backend, with or without a preset (`mujoco:out_of_box`, `newton`);
            a file that the probe writes in the Python of another stack (`NAME.gaugeprobe.json`);
            a `mujoco.MjModel`, a pair of it and its `mujoco.MjData`, in whose pose checks of the model start, or a
            `gymnasium.Env`;
            a configuration, which is returned unchanged.
        pair: Names of two geoms of a model whose contact constants the experiments get, instead of all sets of moving
            geoms on the ground.

    Raises:
        TargetError: The target cannot be read, or has no such pair of geoms.
        UnknownNameError: There is no such backend or preset.
        ParameterError: A setting does not exist or has an impossible value.
        MissingExtraError: The backend's engine is not installed.
    """
    if isinstance(target, TrainingConfiguration):
        return target
    is_text = isinstance(target, str | Path)
    read = _read_text(target, pair) if is_text else read_object(target, pair)
    if pair is not None and read.robot is None:
        raise TargetError(
            f"{target}: a pair of geoms needs a MuJoCo model, which the target has not"
        )
    return read


def _read_text(target: Target, pair: GeomPair | None) -> TrainingConfiguration:
    """Return the configuration of a file, a folder of a run, a backend or a Gymnasium id."""
    path = Path(str(target))
    if str(target).startswith(SUITE):
        path = suite_file(str(target))
    if reader := READERS.get(path.suffix.lower()):
        with faults_of(path, TargetError):
            return reader(path, pair)
    if backend := settings.read_backend(str(target)):
        return backend
    return read_id(str(target), pair)
