"""Names of an experiment, and where it is from."""

from dataclasses import dataclass
from enum import StrEnum


class Collection(StrEnum):
    """Where an experiment is from."""

    GAUGE = "gauge"
    """The GAUGE benchmark."""
    BEYOND = "beyond"
    """Real measurements of other authors; no count and no average of the benchmark contains them."""


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

    @property
    def id(self) -> str:
        """Gymnasium id, as `GAUGE/SlopeSlider-2-wood`."""
        return f"GAUGE/{self.name}"
