"""Variants of a name or of a pattern, as `SlopeSlider-2-*`."""

from __future__ import annotations

from collections.abc import Sequence
from fnmatch import fnmatchcase
from pathlib import Path

from gauge_envs.errors import UnknownNameError
from gauge_envs.experiments.scene_source import is_experiment_file
from gauge_envs.experiments.variants import Variant, beyond_variants, find_variant, variants

GLOB_CHARACTERS = "*?["


def is_glob(pattern: str) -> bool:
    """Return whether a text is a pattern, not an id."""
    return any(character in pattern for character in GLOB_CHARACTERS)


def matching_variants(pattern: str) -> list[Variant]:
    """Return the variants of an id or a pattern, with or without `GAUGE/`.

    A pattern matches the benchmark; only one that matches nothing there matches the variants beyond it.
    """
    if not is_glob(pattern):
        return [find_variant(pattern)]
    stem = pattern.removeprefix("GAUGE/")
    for known in (variants(), beyond_variants()):
        found = [variant for variant in known if fnmatchcase(variant.name, stem)]
        if found:
            return found
    raise UnknownNameError("experiment", pattern, (variant.name for variant in (*variants(), *beyond_variants())))


def matching_subjects(pattern: str) -> Sequence[Variant | str]:
    """Return the variants of an id or a pattern, or the path of an experiment file."""
    return [pattern] if is_experiment_file(Path(pattern)) else matching_variants(pattern)
