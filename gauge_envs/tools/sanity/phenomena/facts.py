"""Read numbers about real objects: published scatter, facts of the trials, measurements in the recordings."""

from __future__ import annotations

from functools import cache
from typing import Any

from gauge_envs.files import MOST_TOML_BYTES, data_folder, read_regular, toml_document
from gauge_envs.references.published import published_baselines
from gauge_envs.tools.sanity.model import Reality

RECORDINGS = "scoring/facts/recordings/recordings.toml"
"""File that `recorded` reads; sources name it."""

PUBLISHED_TRIALS = 20
"""Real trials of each experiment whose scores are published (paper, section on data)."""


@cache
def facts(name: str) -> dict[str, Any]:
    """Return the table of `scoring/facts/<name>.toml`."""
    return toml_document(read_regular(data_folder("scoring") / "facts" / f"{name}.toml", MOST_TOML_BYTES))


def recorded(recording: str, fact: str) -> dict[str, Any]:
    """Return a measurement in a published recording: `value` and `sigma`, or `low` and `high`."""
    table: dict[str, Any] = facts("recordings/recordings")[recording]["facts"][fact]
    return table


def recorded_reality(recording: str, fact: str, *, trial: str = "one recorded trial", more: str = "") -> Reality:
    """Return the reality of a measurement in a published recording.

    Args:
        recording: Name of the recording.
        fact: Name of the measurement.
        trial: What was recorded, for the source.
        more: End of the source.
    """
    found = recorded(recording, fact)
    source = f"{trial} ({RECORDINGS}){more}"
    return Reality.measured(found["value"], scatter=found["sigma"], trial_count=1, source=source)


def position_scatter_mm(variant: str) -> float:
    """Return the standard deviation of a recorded position along one axis [mm], from the published E_RMSE.

    mean(R)^2 + std(R)^2 is the mean square distance of a trial from the mean trial, over three axes (scoring/README).
    """
    baseline = published_baselines(variant)["rmse"]
    assert baseline.std is not None, "every RMSE is published with its standard deviation"
    return float(((baseline.mean**2 + baseline.std**2) / 3.0) ** 0.5)


def rigid_law(source: str, millimetres: float, of: str) -> Reality:
    """Return the law that something does not move, of which the eye sees a deviation.

    Args:
        source: The law.
        millimetres: Tolerance [mm].
        of: Length that shows how small the tolerance is.
    """
    rationale = f"the eye sees {millimetres:g} mm on {of}"
    return Reality.law(0.0, tolerance=millimetres, source=source, rationale=rationale)
