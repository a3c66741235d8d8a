"""Names and origin of an experiment."""

from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property


class Collection(StrEnum):
    """Origin of an experiment."""

    GAUGE = "gauge"
    """The GAUGE benchmark."""
    BEYOND = "beyond"
    """Real measurements of other authors; counts and averages of the benchmark exclude them."""


@dataclass(frozen=True, order=True)
class Variant:
    """Family, subtask and material; the subtask is None for a family with one experiment."""

    family: str
    subtask: str | None
    material: str

    @property
    def name(self) -> str:
        """Name, as `SlopeSlider-2-wood`."""
        return "-".join(
            part for part in (self.family, self.subtask, self.material) if part
        )

    @cached_property
    def id(self) -> str:
        """Gymnasium id, as `GAUGE/SlopeSlider-2-wood`."""
        return f"GAUGE/{self.name}"
