"""Collision pipelines that share their kernels."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

import newton
import newton._src.geometry.narrow_phase as narrow_phase

_own: dict[str, Callable[..., Any]] = {
    name: factory for name, factory in vars(narrow_phase).items() if name.startswith("create_narrow_phase_")
}
"""Newton's factories of kernels, which depend on their arguments alone."""

_shared = {name: cache(factory) for name, factory in _own.items()}


def collision_pipeline(model: newton.Model, **options: Any) -> newton.CollisionPipeline:
    """Return Newton's collision pipeline of a model.

    Newton makes the kernels of each pipeline anew, and Warp reads the source of each new kernel to find its binary;
    this takes most of the time in which a rigid scene is built.

    Args:
        model: The finalized model.
        **options: Arguments of the pipeline.
    """
    with _shared_factories():
        return newton.CollisionPipeline(model, **options)


@contextmanager
def _shared_factories() -> Iterator[None]:
    vars(narrow_phase).update(_shared)
    try:
        yield
    finally:
        vars(narrow_phase).update(_own)
