"""MJCF files of scenes: read in place of a scene, and written for other tools."""

from typing import TYPE_CHECKING

from gauge_envs.registry import door

if TYPE_CHECKING:
    from gauge_envs.tools.mjcf.reader import (
        DRIVER_PREFIX as DRIVER_PREFIX,
        PROBE as PROBE,
        driver_rows as driver_rows,
    )
    from gauge_envs.tools.mjcf.writer import (
        NUMBER as NUMBER,
        add_grips as add_grips,
        add_stiffness_tables as add_stiffness_tables,
        described_xml as described_xml,
        expanded as expanded,
        replay_note as replay_note,
        start_notes as start_notes,
        without_rest as without_rest,
    )
else:
    __getattr__, __all__ = door(__name__)
