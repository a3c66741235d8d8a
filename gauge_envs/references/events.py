"""Times of events in the published recordings (`scoring/bands/events.toml`), to compare a simulation with."""

from __future__ import annotations

from enum import StrEnum
from functools import cache
from pathlib import Path
from typing import Annotated

from pydantic import Field

from gauge_envs.references.tables import FileModel, read_toml, scoring_folder
from gauge_envs.scene.geometry import Positive


class EventQuantity(StrEnum):
    """What is compared of the swings of a cradle's last ball."""

    LEAVES = "leaves"
    """Time after the release at which the ball leaves the row."""
    RETURNS = "returns"
    """Time after the release at which it returns."""
    RESTS = "rests"
    """Duration of its rest until it leaves again."""


class RecordedEvents(FileModel):
    """Times of one kind of event in the recording of one trial.

    Attributes:
        variant: Variant that the recording shows.
        quantity: What the values are.
        values_s: Value of each swing, from the first one [s].
        sigma_s: 1-sigma uncertainty of each value [s].
        source: Recording and method.
    """

    variant: str
    quantity: EventQuantity
    values_s: Annotated[tuple[Positive, ...], Field(min_length=1)]
    sigma_s: Positive
    source: str


class _Events(FileModel):
    """The file `events.toml`."""

    events: tuple[RecordedEvents, ...]


def recorded_events(variant: str) -> tuple[RecordedEvents, ...]:
    """Return the recorded events of a variant, which may be none."""
    return tuple(events for events in _all_events(scoring_folder("bands")) if events.variant == variant)


@cache
def _all_events(folder: Path) -> tuple[RecordedEvents, ...]:
    return read_toml(folder / "events.toml", _Events).events
