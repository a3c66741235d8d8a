"""The task files of families. They hold all data of variants; Python files have no such numbers."""

import hashlib
from functools import lru_cache
from pathlib import Path

from gauge_envs.experiments.task_format import ClothConstants, TaskSpec
from gauge_envs.experiments.task_reader import read_task
from gauge_envs.experiments.variants import task_path
from gauge_envs.scene.fabrics import Fabric


@lru_cache(maxsize=64)
def _spec_and_hash(path: Path, modified_ns: int) -> tuple[TaskSpec, str]:
    """Return the content and the hash of a file; the time of the file distinguishes versions in the cache."""
    return read_task(path), hashlib.sha256(path.read_bytes()).hexdigest()


def task_spec(family: str) -> TaskSpec:
    """Return the task file of a family."""
    path = task_path(family)
    return _spec_and_hash(path, path.stat().st_mtime_ns)[0]


def task_sha256(family: str) -> str:
    """Return the hash of the task file of a family."""
    path = task_path(family)
    return _spec_and_hash(path, path.stat().st_mtime_ns)[1]


def fabrics(family: str) -> dict[str, Fabric]:
    """Return the published fabrics of a family, by name."""
    spec = task_spec(family)
    return {
        material: Fabric.of(
            ClothConstants.model_validate(spec.constants_of(cloth, material, None))
        )
        for cloth in spec.cloths
        for material in spec.constants[cloth]
    }
