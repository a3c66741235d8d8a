"""Check that solutions of the same equations agree: layouts of matrices, iterations, threads, worlds.

A heap is built through the contract, with the settings that an engine has for effort.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import closing
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs.backends import Backend
from gauge_envs.backends.shared.resampled import in_intervals
from gauge_envs.scene import GRAVITY_M_PER_S2, Box, Scene
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.timing import SAMPLE_INTERVAL_S
from gauge_envs.tools.bench.parts import box, contact, ground
from gauge_envs.tools.bench.recording import DeclinedError
from gauge_envs.tools.conformance.lab import Lab
from gauge_envs.tools.conformance.model import Check, Measurement

NAMES = tuple(f"box-{index}" for index in range(8))
HEAP_BOX_M = (0.1, 0.08, 0.05)
STATES, BETWEEN_S = 6, 0.1
"""Number of the states of the motion that are compared, and the time from one to the next [s]."""

FAR_M = 2.0
"""Distance that no box of the heap reaches within 0.6 s [m]."""

MORE = 10
"""Multiple of the iterations that must not matter."""

LIMITS = ("iterations", "pgs_iterations", "solver_iterations")
"""Settings that limit the iterations of a solver, and change nothing else."""


def _heap() -> Scene:
    boxes = tuple(
        box(
            name,
            (0.03 * index, 0.015 * (index % 2), 0.03 + 0.055 * index),
            HEAP_BOX_M,
            euler_deg=(0.0, 0.0, 20.0 * index),
            mass_kg=0.3,
        )
        for index, name in enumerate(NAMES)
    )
    contacts = tuple(contact(NAMES, other, friction=0.4) for other in (NAMES, "ground"))
    return Scene(bodies=(*boxes, ground()), contacts=contacts, duration_s=1.0)


def _visited(lab: Lab) -> tuple[FloatArray, Mapping[str, Any]]:
    """Return states of the motion, shape [STATES, body_count, 13], and the settings in force."""
    scene, states = _heap(), []
    with lab.running(scene) as simulation:
        for _ in range(STATES):
            simulation.advance(BETWEEN_S)
            states.append(np.array(simulation.body_states([*NAMES, "ground"])[0]))
        return np.array(states), dict(simulation.settings)


def _after(lab: Lab, starts: FloatArray, **changes: Any) -> FloatArray:
    """Return the states 1/180 s after each start, shape [start_count, 8, 13]."""
    found = []
    with closing(lab.build(_heap(), **changes)) as simulation:
        for start in starts:
            simulation.reset(start[None], 0)
            simulation.advance(SAMPLE_INTERVAL_S)
            found.append(np.array(simulation.body_states(NAMES)[0]))
    return np.array(found)


def _together(lab: Lab, starts: FloatArray) -> FloatArray:
    """Return the same of all starts as worlds of one batch."""
    scene = _heap()
    worlds = lab.backend.build_worlds(scene, len(starts), lab.settings)
    with closing(in_intervals(worlds, scene)) as simulation:
        simulation.reset(starts, 0)
        simulation.advance(SAMPLE_INTERVAL_S)
        return np.array(simulation.body_states(NAMES))


def _others(
    lab: Lab, starts: FloatArray, settings: Mapping[str, Any]
) -> Iterator[tuple[str, FloatArray]]:
    """Yield what is changed, and the states after it, of all that an engine lets choose."""
    # The substeps of TGS are its iterations: more of them are another time integration.
    for name in LIMITS:
        if name in settings:
            count = int(settings[name])
            more = _after(lab, starts, **{name: MORE * count})
            yield f"{count} and {MORE * count} {name}", more
            break
    if settings.get("threads") == 1:
        yield "one thread and two", _after(lab, starts, threads=2)
    if settings.get("jacobian") == "auto":
        layouts = [_after(lab, starts, jacobian=one) for one in ("dense", "sparse")]
        yield "sparse and dense", layouts[0]
        yield "dense and sparse", layouts[1]
    if type(lab.backend).build_worlds is not Backend.build_worlds:
        yield f"one world and {len(starts)}", _together(lab, starts)


def _corner_speed(states: FloatArray) -> float:
    """Return the largest speed with which a corner on or in the ground goes down [m/s]: the residual of its contact."""
    largest = 0.0
    for row in states.reshape(-1, 13):
        turned = Rotation.from_quat(row[3:7], scalar_first=True)
        corners_m = turned.apply(Box(size_m=HEAP_BOX_M).corners_m)
        velocity = row[7:10] + np.cross(row[10:], corners_m)
        touches = row[2] + corners_m[:, 2] <= 0.0
        largest = max(largest, float(np.max(-velocity[touches, 2], initial=0.0)))
    return largest


@Check("solver-heap")
def _solutions_of_a_heap(lab: Lab) -> Measurement:
    starts, settings = _visited(lab)
    before = starts[:, : len(NAMES)]
    if np.abs(before[:, :, :3]).max() > FAR_M:
        return Measurement(measured=float("inf"), hint="the heap flies apart")
    given = _after(lab, starts)
    parts, largest = [], 0.0
    for words, other in _others(lab, starts, settings):
        changes = [
            (after - before)[:, :, 7:].reshape(STATES, -1) / SAMPLE_INTERVAL_S
            for after in (given, other)
        ]
        sizes = np.linalg.norm(changes, axis=2).max(axis=0)
        # At rest the accelerations are 0: gravity remains.
        sizes = np.maximum(sizes, GRAVITY_M_PER_S2 * np.sqrt(len(NAMES)))
        apart = np.linalg.norm(changes[0] - changes[1], axis=1) / sizes
        worst = float(apart.max())
        speeds = [1e3 * _corner_speed(after) for after in (given, other)]
        parts.append(
            f"{words} part by {worst:.2g}; corners enter the ground with {speeds[0]:.2g} and {speeds[1]:.2g} mm/s"
        )
        largest = max(largest, worst)
    if not parts:
        raise DeclinedError(
            (
                "no iterations, threads or layouts of its solver can be chosen without another time integration",
            )
        )
    return Measurement(measured=largest, hint="; ".join(parts))
