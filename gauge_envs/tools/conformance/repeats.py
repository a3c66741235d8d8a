"""Two runs of one scene that must be equal: their differences, and how far an engine may repeat itself."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from gauge_envs.backends import Simulation
from gauge_envs.fixtures.recording import Recording, record
from gauge_envs.scene import Scene
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.conformance.lab import Lab, Measurement, largest

RUN_S = 0.2
"""Duration of a run [s]."""

BITS = frozenset({"bits"})
BITS_OR_RUN = frozenset({"bits", "run"})
"""Kinds of `Backend.repeatability` with which two simulations, or two runs of one simulation, are equal."""


@dataclass(frozen=True)
class Gap:
    """Largest difference of two runs in one quantity of a body [m, 1, m/s, rad/s].

    Attributes:
        case: The quantity, the body and the second run, in words.
        size: The difference.
        is_velocity: Whether the quantity is a velocity.
    """

    case: str
    size: float
    is_velocity: bool = False


def gaps(states: FloatArray, reference: FloatArray) -> FloatArray:
    """Return differences of states, shape [..., 13]; a quaternion and its negative are the same rotation."""
    turned = np.array(reference)
    products = (states[..., 3:7] * reference[..., 3:7]).sum(axis=-1, keepdims=True)
    turned[..., 3:7] *= np.sign(products)
    return np.abs(states - turned)


def apart(first: Recording, second: Recording, when: str) -> list[Gap]:
    """Return the differences of two recordings.

    Args:
        first: The first run.
        second: The second run.
        when: The second run, in words, as `after a reset`.
    """
    found = []
    for name, states in first.states.items():
        gap = gaps(states, second.states[name])
        pose, velocity = float(gap[:, :7].max()), float(gap[:, 7:].max())
        found.append(Gap(f"the pose of the {name} {when}", pose))
        found.append(Gap(f"the velocity of the {name} {when}", velocity, True))
    for name, nodes_m in first.nodes_m.items():
        size = float(np.abs(nodes_m - second.nodes_m[name]).max())
        found.append(Gap(f"the nodes of the {name} {when}", size))
    return found


def largest_gap(found: Iterable[Gap]) -> Measurement:
    """Measure the largest of some differences."""
    return largest({gap.case: gap.size for gap in found})


def repeated(
    lab: Lab, found: Iterable[Gap], kinds: frozenset[str] = BITS_OR_RUN
) -> Measurement:
    """Measure the largest difference of runs; they must be equal if `Backend.repeatability` is one of the kinds."""
    declared = lab.backend.repeatability(lab.settings)
    if declared.kind in kinds:
        return largest_gap(found)
    places = largest_gap(gap for gap in found if not gap.is_velocity)
    return replace(places, width=1e3 * declared.start_error)


def run_again(simulation: Simulation, scene: Scene, seconds: float) -> Recording:
    """Reset a simulation to the start of its scene, and record it."""
    simulation.reset(None, 0)
    return record(simulation, scene, seconds)
