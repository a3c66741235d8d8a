"""Define a check of measured objects: its scenario, its number, and the real value, from the facts of trials."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from gauge_envs.files import data_folder
from gauge_envs.fixtures.recording import Recording
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scoring.estimators import acceleration_m_per_s2
from gauge_envs.text import toml_document
from gauge_envs.tools.sanity.object_checks.scenario import Scenario
from gauge_envs.tools.sanity.training import Need
from gauge_envs.tools.sanity.verdict import Reality


@dataclass(frozen=True)
class ObjectCheck:
    """Behaviour of real objects, measured by one number.

    Attributes:
        title: Title of a few words.
        scenario: Scenario that shows the behaviour.
        unit: Unit of the number; `1` for a pure number.
        reality: Value and scatter for real objects.
        value: Function that measures the number in a rollout of the scenario.
        failure: Function that returns a failure that no real trial shows, independent of the number; empty for none.
        needs: What a target must have in addition to gravity, and to contacts if the scene has some.
        is_impact: Whether the number depends on a restitution that the target may not give.
        id: Stable name, which the list of checks gives.
    """

    title: str
    scenario: Scenario
    unit: str
    reality: Reality
    value: Callable[[Recording], float]
    failure: Callable[[Recording], str] = lambda rollout: ""
    needs: tuple[Need, ...] = ()
    is_impact: bool = False
    id: str = ""

    @property
    def touches(self) -> bool:
        """Whether bodies of its scene touch."""
        return bool(self.scenario.scene.contacts)

    @property
    def all_needs(self) -> tuple[Need, ...]:
        """What a target must have for the check to apply."""
        contact = (Need.CONTACT,) if self.touches else ()
        return (Need.GRAVITY, *contact, *self.needs)


RECORDINGS = "scoring/facts/recordings/recordings.toml"
"""File that `recorded` reads; sources name it."""

PUBLISHED_TRIALS = 20
"""Real trials of each experiment whose scores are published (paper, section on data)."""


@cache
def facts(name: str) -> dict[str, Any]:
    """Return the table of `scoring/facts/<name>.toml`."""
    file = data_folder("scoring") / "facts" / f"{name}.toml"
    return toml_document(file.read_bytes())


def recorded(recording: str, fact: str) -> dict[str, Any]:
    """Return a measurement in a published recording: `value` and `sigma`, or `low` and `high`."""
    return facts("recordings/recordings")[recording]["facts"][fact]


def recorded_reality(
    recording: str, fact: str, source: str = "one recorded trial"
) -> Reality:
    """Return the reality of a measurement in a published recording.

    Args:
        recording: Name of the recording.
        fact: Name of the measurement.
        source: What was recorded.
    """
    measured = recorded(recording, fact)
    value, scatter = measured["value"], measured["sigma"]
    return Reality.measured(value, scatter, 1, f"{source} ({RECORDINGS})")


def acceleration(times_s: FloatArray, displacement_mm: FloatArray) -> float:
    """Return the mean acceleration of a displacement [m/s^2]; both have shape [sample_count]."""
    return 1e-3 * acceleration_m_per_s2(times_s, displacement_mm)


def lowest_m(rollout: Recording, body: str, points_m: FloatArray) -> FloatArray:
    """Return the height of the lowest of a body's points [m], shape [sample_count].

    Args:
        rollout: The rollout.
        body: Name of the body.
        points_m: The points in the body's frame [m], shape [point_count, 3].
    """
    rotations = rollout.rotation(body).as_matrix()
    heights_m = np.einsum("ti,pi->tp", rotations[:, 2], points_m)
    return np.asarray(heights_m.min(axis=1) + rollout.position(body)[:, 2])


def rigid_law(source: str, millimetres: float, of: str) -> Reality:
    """Return the law that something does not move, with a tolerance that the eye sees.

    Args:
        source: The law.
        millimetres: Tolerance [mm].
        of: Length that shows how small the tolerance is.
    """
    rationale = f"the eye sees {millimetres:g} mm on {of}"
    return Reality(0.0, millimetres, source, rationale)
