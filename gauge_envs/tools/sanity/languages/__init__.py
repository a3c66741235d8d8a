"""Languages in which targets state their settings, one file each; a new one is a class in `LANGUAGES`."""

from __future__ import annotations

from gauge_envs.tools.sanity.languages.base import Language
from gauge_envs.tools.sanity.languages.genesis import GenesisPython
from gauge_envs.tools.sanity.languages.isaac_gym import IsaacGym
from gauge_envs.tools.sanity.languages.isaac_lab import IsaacLab, IsaacLab3
from gauge_envs.tools.sanity.languages.maniskill import ManiSkill
from gauge_envs.tools.sanity.languages.mjcf import Mjcf
from gauge_envs.tools.sanity.languages.mjlab import Mjlab
from gauge_envs.tools.sanity.languages.newton import Newton
from gauge_envs.tools.sanity.languages.playground import Playground
from gauge_envs.tools.sanity.languages.toml import Toml

__all__ = ["LANGUAGES", "Language", "language"]

LANGUAGES: dict[str, Language] = {
    one.name: one
    for one in (
        Toml(),
        Mjcf(),
        GenesisPython(),
        Playground(),
        Mjlab(),
        IsaacLab(),
        IsaacLab3(),
        IsaacGym(),
        ManiSkill(),
        Newton(),
    )
}
"""All languages by name."""


def language(name: str) -> Language:
    """Return a language by the name that a `TrainingConfiguration` states."""
    return LANGUAGES[name]
