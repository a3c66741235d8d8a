"""The error of an episode split into release time, offset, rate and the rest."""

from typing import TYPE_CHECKING

from gauge_envs.tools import door

if TYPE_CHECKING:
    from gauge_envs.tools.diagnose.error_budget import diagnose
    from gauge_envs.tools.diagnose.model import Diagnosis
    from gauge_envs.tools.diagnose.words import findings

__all__ = ["Diagnosis", "diagnose", "findings"]

if not TYPE_CHECKING:  # With it, a type checker would accept any name.
    __getattr__ = door(__name__, "model", "error_budget", "words")
