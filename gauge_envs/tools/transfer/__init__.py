"""Replay policies elsewhere, and which ranges of constants data justify."""

from typing import TYPE_CHECKING

from gauge_envs.registry import door

if TYPE_CHECKING:
    from gauge_envs.tools.transfer.estimates import Estimate as Estimate
    from gauge_envs.tools.transfer.ranges import (
        Justified as Justified,
        JustifiedRange as JustifiedRange,
        LeftOut as LeftOut,
        friction_of_materials as friction_of_materials,
        justified_ranges as justified_ranges,
        slides_of_one_pair as slides_of_one_pair,
    )
    from gauge_envs.tools.transfer.stack_files import (
        stack_file as stack_file,
        subject_ranges as subject_ranges,
    )
    from gauge_envs.tools.transfer.transfer import (
        estimate as estimate,
        success_share as success_share,
    )
else:
    __getattr__, __all__ = door(__name__)
