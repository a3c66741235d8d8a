"""Read and check one task file. `tests/experiments/test_task_files.py` has the rules for bundled task files."""

from pathlib import Path

from gauge_envs.errors import TaskFileError
from gauge_envs.experiments.scene_builder import SceneBuilder
from gauge_envs.experiments.task_format import TaskSpec
from gauge_envs.reading import faults_of, reading
from gauge_envs.text import toml_document


def load_task(path: Path) -> TaskSpec:
    """Read one task file, and build the scene of each of its variants.

    Raises:
        TaskFileError: The file is not TOML, or has an unknown key, a value out of range or an undefined name. Or a
            variant lacks a placement, a constant or a number of frames.
    """
    spec = read_task(path)
    with faults_of(path, TaskFileError):
        for variant in spec.variants():
            SceneBuilder(spec, variant, {}).build()
    return spec


def read_task(path: Path) -> TaskSpec:
    """Read one task file without building its scenes."""
    with reading(path, TaskFileError) as content:
        return TaskSpec.model_validate(toml_document(content))
