"""The error of an episode split into release time, offset, rate and the rest."""

from typing import TYPE_CHECKING

from gauge_envs.registry import door

if TYPE_CHECKING:
    from gauge_envs.tools.diagnose.error_budget import diagnose as diagnose
    from gauge_envs.tools.diagnose.model import Diagnosis as Diagnosis
    from gauge_envs.tools.diagnose.words import findings as findings
else:
    __getattr__, __all__ = door(__name__)
