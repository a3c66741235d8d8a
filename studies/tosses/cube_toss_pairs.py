"""How far nearly equal real tosses of a cube part, against engines that toss both cubes of the same pairs.

    python cube_toss_pairs.py [--pairs 270] [--engine mujoco]

Tosses are compared at their first contact, up to a turn about the vertical, a mirror in a vertical plane, a shift along
the table, and the 48 symmetries of a cube. Until then a cube flies on a parabola with a constant spin, as all its
moments of inertia are equal. Tosses that repeat an earlier one are left out.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from cube_toss import HALF_WIDTH_M, shots, toss
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation, Slerp
from toss_errors import VERTICES, bootstrap_interval, perturbed_start

from gauge_envs.experiments.resolve import load_experiment, with_trial
from gauge_envs.scene.scene import GRAVITY_M_PER_S2

FloatArray = NDArray[np.float64]
LEVER_M = np.sqrt(2.0) * HALF_WIDTH_M
"""Root mean square displacement of the corners for a small turn, per radian [m]."""

FLIGHT_S = 0.1
"""Time by which differences of velocity count as displacements [s], about that between two impacts."""

MIRROR = np.diag([1.0, -1.0, 1.0])
BINS = ((0, 30), (30, 90), (90, 270))
"""Pairs that are summarized together, closest first."""

CUBE = Rotation.create_group("O").as_matrix()
LATER_S = (0.05, 0.1, 0.2, 0.3)


@dataclass(frozen=True)
class Contact:
    """A cube at its first contact: time [s], rotation [3, 3], velocity [m/s] and angular velocity [rad/s]."""

    time_s: float
    rotation: FloatArray
    velocity: FloatArray
    spin: FloatArray
    height_m: float


def first_contact(
    position_m: FloatArray, rotation: Rotation, velocity: FloatArray, spin: FloatArray
) -> Contact | None:
    """Return the first contact of a cube that flies from a start, or None if it starts in contact."""

    def clearance(time_s: float) -> float:
        turned = Rotation.from_rotvec(spin * time_s) * rotation
        fall = velocity[2] * time_s - 0.5 * GRAVITY_M_PER_S2 * time_s**2
        return float(
            position_m[2] + fall + turned.apply(HALF_WIDTH_M * VERTICES)[:, 2].min()
        )

    times = np.linspace(0.0, 0.4, 201)
    below = np.flatnonzero([clearance(time_s) < 0.0 for time_s in times])
    if not len(below) or below[0] == 0:
        return None
    time_s = float(brentq(clearance, times[below[0] - 1], times[below[0]]))
    now = velocity - np.array([0.0, 0.0, GRAVITY_M_PER_S2 * time_s])
    height_m = float(
        position_m[2] + velocity[2] * time_s - 0.5 * GRAVITY_M_PER_S2 * time_s**2
    )
    return Contact(
        time_s,
        (Rotation.from_rotvec(spin * time_s) * rotation).as_matrix(),
        now,
        spin,
        height_m,
    )


def yaw_matrix(angles: FloatArray) -> FloatArray:
    """Return turns about the vertical, shape [..., 3, 3]."""
    zero, one = np.zeros_like(angles), np.ones_like(angles)
    rows = [
        [np.cos(angles), -np.sin(angles), zero],
        [np.sin(angles), np.cos(angles), zero],
        [zero, zero, one],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


@dataclass(frozen=True)
class Pair:
    """Two tosses with nearly equal first contacts: distance [m], and how the second one is laid over the first."""

    first: int
    second: int
    distance_m: float
    world: FloatArray
    body: FloatArray


def closest(contacts: dict[int, Contact], count: int) -> list[Pair]:
    """Return the pairs of tosses with the smallest distances, closest first."""
    trials = sorted(contacts)
    rotations, velocities, spins, heights = (
        np.array([getattr(contacts[trial], name) for trial in trials])
        for name in ("rotation", "velocity", "spin", "height_m")
    )
    found: list[Pair] = []
    for place, trial in enumerate(trials[:-1]):
        later = slice(place + 1, None)
        for mirror in (np.eye(3), MIRROR):
            sign = np.linalg.det(mirror)
            turned = np.einsum(
                "ab,nbc,cd,gde->ngae", mirror, rotations[later], mirror, CUBE
            )
            speed, spin = velocities[later] @ mirror, sign * spins[later] @ mirror
            # The turn that minimizes the sum of squared chords; squares of differences weigh as in the distance.
            own = rotations[place]
            chord = 0.5 * LEVER_M**2
            plane = chord * np.einsum("ai,ngbi->ngab", own[:2], turned[..., :2, :])
            plane += (
                FLIGHT_S**2
                * np.einsum("a,nb->nab", velocities[place, :2], speed[:, :2])[:, None]
            )
            plane += (LEVER_M * FLIGHT_S) ** 2 * np.einsum(
                "a,nb->nab", spins[place, :2], spin[:, :2]
            )[:, None]
            angle = np.arctan2(
                plane[..., 1, 0] - plane[..., 0, 1], plane[..., 0, 0] + plane[..., 1, 1]
            )
            yaw = yaw_matrix(angle)
            trace = np.einsum("ai,ngab,ngbi->ng", own, yaw, turned)
            turn = np.arccos(np.clip(0.5 * (trace - 1.0), -1.0, 1.0))
            moved = np.einsum("ngab,nb->nga", yaw, speed) - velocities[place]
            spun = np.einsum("ngab,nb->nga", yaw, spin) - spins[place]
            square = (LEVER_M * turn) ** 2 + ((heights[later] - heights[place]) ** 2)[
                :, None
            ]
            square += FLIGHT_S**2 * np.sum(moved**2, axis=-1) + (
                LEVER_M * FLIGHT_S
            ) ** 2 * np.sum(spun**2, axis=-1)
            best = np.argmin(square, axis=1)
            for other, group in enumerate(best):
                distance = float(np.sqrt(square[other, group]))
                world = yaw[other, group] @ mirror
                found.append(
                    Pair(
                        trial,
                        trials[place + 1 + other],
                        distance,
                        world,
                        mirror @ CUBE[group],
                    )
                )
    best_of: dict[tuple[int, int], Pair] = {}
    for pair in sorted(found, key=lambda pair: pair.distance_m):
        best_of.setdefault((pair.first, pair.second), pair)
    return list(best_of.values())[:count]


Path = tuple[FloatArray, FloatArray, Rotation]


def parted(
    pair: Pair, contacts: dict[int, Contact], paths: dict[int, Path]
) -> FloatArray:
    """Return how far the tosses of a pair are apart at times after their contacts [mm, degrees], [time_count, 2]."""
    shifts, turns = [], []
    for trial in (pair.first, pair.second):
        times_s, positions_m, rotations = paths[trial]
        later = contacts[trial].time_s + np.array([0.0, *LATER_S])
        later = np.clip(later, times_s[0], times_s[-1])
        place = CubicSpline(times_s, positions_m)(later)
        shifts.append((place - place[0] * [1.0, 1.0, 0.0])[1:])
        turns.append(Slerp(times_s, rotations)(later)[1:].as_matrix())
    shift = shifts[1] @ pair.world.T - shifts[0]
    other = np.einsum("ab,nbc,cd->nad", pair.world, turns[1], pair.body)
    angle = (
        Rotation.from_matrix(other) * Rotation.from_matrix(turns[0]).inv()
    ).magnitude()
    return np.stack([1e3 * np.linalg.norm(shift, axis=1), np.degrees(angle)], axis=1)


def _starts(trials: Sequence[int], *, perturbed: bool = False) -> dict[int, Contact]:
    data, found = shots(), {}
    experiment = load_experiment("CubeToss-acrylic")
    for trial in trials:
        body = with_trial(experiment, trial).scene.body("cube")
        if perturbed:
            body = perturbed_start(body, data.sidecar.nuisances, seed=trial)
        velocity, spin = (
            np.array(body.linear_velocity_m_per_s),
            np.array(body.angular_velocity_rad_per_s),
        )
        contact = first_contact(
            np.array(body.pose.position_m), body.pose.rotation, velocity, spin
        )
        if contact is not None:
            found[trial] = contact
    return found


def _distance_m(one: Contact, other: Contact) -> float:
    turn = Rotation.from_matrix(other.rotation @ one.rotation.T).magnitude()
    speed, spin = (
        np.linalg.norm(other.velocity - one.velocity),
        np.linalg.norm(other.spin - one.spin),
    )
    terms = [
        LEVER_M * turn,
        other.height_m - one.height_m,
        FLIGHT_S * speed,
        LEVER_M * FLIGHT_S * spin,
    ]
    return float(np.linalg.norm(terms))


def _cell(values: FloatArray) -> str:
    low, high = bootstrap_interval(values.tolist())
    return f"{np.median(values):.1f} [{low:.1f}, {high:.1f}]"


def main() -> None:
    """Print how far pairs part."""
    parser = argparse.ArgumentParser(
        description="How far nearly equal real tosses of a cube part."
    )
    parser.add_argument("--pairs", type=int, default=270)
    parser.add_argument("--engine", default="mujoco")
    options = parser.parse_args()
    data = shots()
    contacts = _starts(data.trials())
    moved = _starts(data.trials(), perturbed=True)
    noise = [
        _distance_m(contacts[trial], moved[trial])
        for trial in contacts
        if trial in moved
    ]
    print(
        f"{len(contacts)} tosses start in flight; the uncertainty of a start is {1e3 * np.median(noise):.2f} mm"
    )
    pairs = closest(contacts, options.pairs)
    used = sorted({trial for pair in pairs for trial in (pair.first, pair.second)})
    real: dict[int, Path] = {}
    for trial in used:
        shot = data.shot(trial)
        real[trial] = (
            shot.times_s,
            shot.positions_m,
            Rotation.from_quat(shot.quaternions, scalar_first=True),
        )
    engine = {
        trial: (times, places, turns)
        for trial, times, places, turns in toss(options.engine, used)
    }
    print(
        "| pairs | distance at contact, mm | after | recorded, mm | engine, mm | recorded, degrees | engine, degrees |"
    )
    print("|---|---|---|---|---|---|---|")
    for first, last in BINS:
        some = pairs[first:last]
        if not some:
            continue
        distances = 1e3 * np.array([pair.distance_m for pair in some])
        found = np.array([parted(pair, contacts, real) for pair in some])
        simulated = np.array([parted(pair, contacts, engine) for pair in some])
        for number, later in enumerate(LATER_S):
            cells = [
                _cell(values[:, number, column])
                for column in (0, 1)
                for values in (found, simulated)
            ]
            print(
                f"| {len(some)} | {distances[0]:.1f} to {distances[-1]:.1f} | {later} s | {' | '.join(cells)} |"
            )


if __name__ == "__main__":
    main()
