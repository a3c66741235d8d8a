"""Restitution of the hinged blocks from the first impact of each real toss.

    python elbow_rebound.py ENGINE OUT [--every 1] [--friction 0.2] [--restitution 0 0.125 0.25 0.375 0.5]

The rebound is the normal speed of the striking corner after over before its impact, from poses. It is no restitution
itself: frames are 7 ms apart and noisy, other corners may strike meanwhile, and a corner that turns changes its normal
speed. So the same rebound is read from tosses of an engine with the same starts and the same noise, at several
restitutions. Engines do not return the restitution of a scene exactly where bodies hang together, so the one that a
corner has is read from the engine's own velocities. The estimate is the median of it at which the median rebounds of
engine and recording agree. Even tosses.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from elbow_toss import NAME, WORLDS, records, shots
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from tosses import write

from gauge_envs.backends import backend_for
from gauge_envs.experiments.resolve import load_experiment, with_trial
from gauge_envs.scene.scene import GRAVITY_M_PER_S2

FloatArray = NDArray[np.float64]

FINE_S, PARTS = 1.0 / 900.0, 6
"""Interval at which an engine's velocities are read, and number of them in a sample."""

INTERVAL_S = PARTS * FINE_S
"""Interval of simulated samples, a multiple of all time steps; recorded frames are 1/148 s apart."""

TOUCH_M, JUMP_M_PER_S, LEAST_GAIN_M_PER_S = 0.004, 0.15, 0.05
"""Height and gain of normal speed in a fine interval from which on a corner is in an impact, and gain at its end.

The last is 45 m/s^2, above the acceleration of a corner that turns freely with 20 rad/s."""

DURATION_S = 0.4
"""Time within which a first impact is looked for [s]."""

NEAR_M = 0.015
"""Height below which a corner can strike: recorded heights scatter by several millimetres."""

GAP = 2
"""Samples before and after an impact at which speeds are read."""

LEAST_APPROACH_M_PER_S = 0.8
"""Least normal speed of a corner that strikes. The noise of a recorded speed is 0.05 m/s."""

DRAWS = 2000


def rebound(
    heights_m: FloatArray, interval_s: float
) -> tuple[int, float, float] | None:
    """Return corner, speed of approach [m/s], and rebound of the first impact, or None without one.

    Args:
        heights_m: Heights of all corners, shape [T, V].
        interval_s: Interval of the samples.
    """
    normal = np.diff(heights_m, axis=0) / interval_s
    fall = GRAVITY_M_PER_S2 * (GAP + 0.5) * interval_s
    for at in range(GAP + 1, len(normal) - GAP):
        approach = fall - normal[at - GAP - 1]
        stops = (
            (heights_m[at] < NEAR_M)
            & (normal[at - 1] < 0.0)
            & (normal[at] > 0.25 * normal[at - 1])
        )
        if stops.any():
            corner = int(np.argmax(np.where(stops, approach, 0.0)))
            speed = float(approach[corner])
            after = float(normal[at : at + GAP + 1, corner].max())
            return (
                None
                if speed < LEAST_APPROACH_M_PER_S
                else (corner, speed, after / speed)
            )
    return None


def heights(
    positions_m: Sequence[FloatArray], rotations: Sequence[Rotation]
) -> FloatArray:
    """Return the heights of the corners of both blocks, shape [T, 16]."""
    corners_m = load_experiment(NAME).scene.body(shots().sidecar.body).shape.corners_m
    found = [
        place[:, 2, None] + np.einsum("ti,vi->tv", turned.as_matrix()[:, 2], corners_m)
        for place, turned in zip(positions_m, rotations, strict=True)
    ]
    return np.concatenate(found, axis=1)


def recorded(trial: int) -> tuple[int, float, float] | None:
    """Return the first impact of a recorded toss."""
    both = records(trial)
    return rebound(
        heights([s.positions_m for s in both], [s.rotations for s in both]),
        1.0 / shots().sidecar.rate_hz,
    )


def noisy(states: FloatArray, draw: np.random.Generator) -> FloatArray:
    """Return the heights of the corners in simulated states, shape [T, 2, 13], with the noise of the recording."""
    errors = shots().sidecar.nuisances
    shift = draw.normal(0.0, errors.position_noise_m, (len(states), 3))
    turn = Rotation.from_rotvec(
        np.radians(draw.normal(0.0, errors.rotation_noise_deg, (len(states), 3)))
    )
    opened = np.radians(draw.normal(0.0, errors.angle_noise_deg or 0.0, len(states)))
    own = [
        Rotation.from_quat(states[:, place, 3:7], scalar_first=True) for place in (0, 1)
    ]
    # Noise moves both blocks together about the first one, and the second one about the hinge.
    hung = shots().sidecar.hung[0]
    first = own[0] * turn
    second = (
        first
        * (own[0].inv() * own[1])
        * Rotation.from_rotvec(np.outer(opened, hung.axis))
    )
    origin = states[:, 0, :3] + shift
    return heights(
        [origin, origin + first.apply(hung.anchor_on_m) - second.apply(hung.anchor_m)],
        [first, second],
    )


def returned(states: FloatArray) -> float | None:
    """Return the normal speed of the first striking corner after over before its impact, from an engine's velocities.

    Args:
        states: States of both blocks at fine intervals, shape [T, 2, 13].
    """
    corners_m = load_experiment(NAME).scene.body(shots().sidecar.body).shape.corners_m
    turned = [
        Rotation.from_quat(states[:, place, 3:7], scalar_first=True) for place in (0, 1)
    ]
    high = heights([states[:, place, :3] for place in (0, 1)], turned)
    speeds = []
    for place in (0, 1):
        arms = np.einsum("tij,vj->tvi", turned[place].as_matrix(), corners_m)
        speeds.append(
            states[:, place, 9, None]
            + np.cross(states[:, place, None, 10:], arms)[:, :, 2]
        )
    normal = np.concatenate(speeds, axis=1)
    lowest = high.argmin(axis=1)
    gained = np.diff(normal, axis=0, append=normal[-1:])
    for at in range(len(states) - 1):
        corner = lowest[at + 1]
        if (
            high[at + 1, corner] < TOUCH_M
            and gained[at, corner] > JUMP_M_PER_S
            and normal[at, corner] < 0.0
        ):
            end = at + 1
            while gained[end, corner] > LEAST_GAIN_M_PER_S:
                end += 1
            return float(-normal[end, corner] / normal[at, corner])
    return None


Hit = tuple[float, float] | None
"""Rebound as in a recording, and what the engine's corner returned of its speed."""


def simulated(
    engine: str, trials: Sequence[int], friction: float, restitution: float
) -> dict[int, Hit]:
    """Return what the first impact of each toss of an engine was."""
    bodies = shots().sidecar.bodies
    constants = {f"{body}.friction": friction for body in bodies}
    constants |= {f"{body}.restitution": restitution for body in bodies}
    experiment = load_experiment(NAME, constants)
    found: dict[int, Hit] = {}
    for begin in range(0, len(trials), WORLDS):
        chunk = trials[begin : begin + WORLDS]
        worlds = backend_for(engine, None).build_worlds(
            [with_trial(experiment, trial).scene for trial in chunk], {}
        )
        worlds.reset(0)
        states = [worlds.body_states(bodies)]
        for _ in range(round(DURATION_S / FINE_S)):
            worlds.advance(FINE_S)
            states.append(worlds.body_states(bodies))
        worlds.close()
        for place, trial in enumerate(chunk):
            fine = np.array(states)[:, place]
            hit, own = (
                rebound(noisy(fine[::PARTS], np.random.default_rng(trial)), INTERVAL_S),
                returned(fine),
            )
            found[trial] = None if hit is None or own is None else (hit[2], own)
    return found


def crossing(
    restitutions: Sequence[float] | FloatArray, medians: FloatArray, wanted: float
) -> float:
    """Return the restitution at which the medians cross a value; the ends where they do not."""
    return float(np.interp(wanted, np.maximum.accumulate(medians), restitutions))


def main() -> None:
    """Print the rebounds and the estimate."""
    parser = argparse.ArgumentParser(
        description="Restitution of the hinged blocks from the first impact of each toss."
    )
    parser.add_argument("engine")
    parser.add_argument("out", type=Path)
    parser.add_argument("--every", type=int, default=1)
    parser.add_argument("--friction", type=float, default=0.2)
    parser.add_argument(
        "--restitution", type=float, nargs="+", default=[0.0, 0.125, 0.25, 0.375, 0.5]
    )
    options = parser.parse_args()
    real = {
        trial: hit
        for trial in shots().trials("fit", every=options.every)
        if (hit := recorded(trial)) is not None
    }
    tossed = [
        simulated(options.engine, list(real), options.friction, value)
        for value in options.restitution
    ]
    used = [trial for trial in real if all(one[trial] is not None for one in tossed)]
    count = len(tossed)
    rows = np.array(
        [
            [real[trial][2], *np.array([one[trial] for one in tossed]).T.ravel()]
            for trial in used
        ]
    )

    def estimate(some: FloatArray) -> float:
        middle = np.median(some, axis=0)
        return crossing(middle[1 + count :], middle[1 : 1 + count], middle[0])

    draws = np.random.default_rng(0).integers(0, len(used), (DRAWS, len(used)))
    medians = np.median(rows, axis=0)
    low, high = np.percentile([estimate(rows[draw]) for draw in draws], [2.5, 97.5])
    write(
        options.out,
        f"rebound-{options.engine}-{options.friction}",
        {"trials": used, "rows": rows.tolist()},
    )
    print(
        f"{len(used)} first impacts; recorded rebound {medians[0]:.3f}, quartiles",
        end=" ",
    )
    print(np.percentile(rows[:, 0], [25, 75]).round(3).tolist())
    for value, median, own in zip(
        options.restitution, medians[1 : 1 + count], medians[1 + count :], strict=True
    ):
        print(
            f"{options.engine}, restitution {value}: corners return {own:.3f}, rebound {median:.3f}"
        )
    print(
        f"{options.engine}, friction {options.friction}: restitution {estimate(rows):.3f} [{low:.3f}, {high:.3f}]"
    )


if __name__ == "__main__":
    main()
