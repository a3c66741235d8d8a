"""Read and check one task file. `tests/experiments/test_task_files.py` has the rules for bundled task files."""

from pathlib import Path

from pydantic import ValidationError

from gauge_envs.errors import TaskFileError
from gauge_envs.experiments.scene_builder import SceneBuilder
from gauge_envs.experiments.task_format import TaskSpec
from gauge_envs.text import toml_document
from gauge_envs.validation import first_fault


def load_task(path: Path) -> TaskSpec:
    """Read one task file, and build the scene of each of its variants.

    Raises:
        TaskFileError: The file is not TOML, or has an unknown key, a value out of range or an undefined name. Or a
            variant lacks a placement, a constant or a number of frames.
    """
    spec = read_task(path)
    for variant in spec.variants():
        try:
            SceneBuilder(spec, variant, {}).build()
        except ValueError as error:
            raise TaskFileError(path, None, str(error)) from error
    return spec


def read_task(path: Path) -> TaskSpec:
    """Read one task file without building its scenes."""
    try:
        return TaskSpec.model_validate(toml_document(path.read_bytes()))
    except OSError as error:
        reason = f"cannot be read: {error.strerror or error}"
        raise TaskFileError(path, None, reason) from error
    except ValidationError as error:
        raise TaskFileError(path, *first_fault(error)) from error
    except ValueError as error:
        raise TaskFileError(path, None, str(error)) from error
