"""Scores of single-shot trials: how far one simulated flight is from the one recorded flight with the same start.

For a simulation with positions p(t) and rotations R(t), and a recording with p*(t) and R*(t),

- the position error at t is |p(t) - p*(t)|,
- the rotation error at t is the angle of R(t) R*(t)^-1, from 0 to 180 degrees,
- the error of a hinge between two bodies is the angle of (R1^-1 R2) (R1*^-1 R2*)^-1,
- the face that lies up is the body axis, with its sign, closest to the vertical,
- the energy is m |v|^2 / 2 + w . I w / 2 + m g z, with velocities from central differences of the poses,
- the slip is the speed of the body over the last `SLIP_WINDOW_S`.

A distribution over trials has the median and quartiles, with percentile bootstrap intervals over trials. Errors are
read beside a floor: the error between two simulations, one of which starts with the uncertainty of the measured start.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gauge_envs.errors import ShapeError
from gauge_envs.references.single_shot import ShotNuisances, ShotSidecar, SingleShot
from gauge_envs.scene import Pose, RigidBody, Scene
from gauge_envs.scene.geometry import vector
from gauge_envs.scene.hinged import carried
from gauge_envs.scene.meshes import body_mass_properties
from gauge_envs.scene.scene import GRAVITY_M_PER_S2

FloatArray = NDArray[np.float64]

SLIP_WINDOW_S = 0.1
"""Last part of a trajectory over which the slip is measured [s]."""

CONTACT_M = 0.006
"""Height of a corner below which it can strike [m]; recorded corners dip to -4 mm."""

BESIDE_M = 0.004
"""Height above the lowest corner up to which a corner takes part in an impact [m]."""

CLEAR_S = 0.014
"""Time before and after an impact at which velocities are read [s]: two frames at 148 Hz."""

VERTICES = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T

LEAST_APPROACH_M_PER_S = 0.4
"""Least normal speed of a corner that strikes [m/s]."""


@dataclass(frozen=True)
class ShotError:
    """Errors of one simulated trial.

    Attributes:
        trial: Number of the trial.
        early_mm: Position error at the early time [mm].
        early_deg: Rotation error at the early time [degrees].
        mean_mm: Mean position error over the recorded time [mm].
        mean_deg: Mean rotation error over the recorded time [degrees].
        rest_mm: Position error at the last sample, where the recorded body rests [mm].
        rest_deg: Rotation error at the last sample [degrees].
        same_face: Whether the same face lies up at the last sample.
        slip_mm_per_s: Speed of the simulated body at the end [mm/s].
    """

    trial: int
    early_mm: float
    early_deg: float
    mean_mm: float
    mean_deg: float
    rest_mm: float
    rest_deg: float
    same_face: bool
    slip_mm_per_s: float


def shot_error(
    shot: SingleShot,
    times_s: FloatArray,
    positions_m: FloatArray,
    rotations: Rotation,
    *,
    early_s: float = 0.3,
) -> ShotError:
    """Return the errors of a simulation of a recorded trial.

    Args:
        shot: The recorded trial.
        times_s: Times of the samples from the recorded start on [s], increasing, shape [T].
        positions_m: Simulated positions of the body origin [m], shape [T, 3].
        rotations: Simulated orientations, body to world, T of them.
        early_s: Time of the early errors [s].
    """
    if not len(times_s) == len(positions_m) == len(rotations):
        raise ShapeError(
            f"{len(times_s)} times, {len(positions_m)} positions and {len(rotations)} rotations"
        )
    if times_s[-1] < early_s:
        raise ShapeError(
            f"the samples end at {times_s[-1]:.3f} s, before the early time of {early_s:.3f} s"
        )
    recorded_m, turned = shot.poses_at(times_s)
    distance_mm = 1e3 * np.linalg.norm(positions_m - recorded_m, axis=1)
    angle_deg = np.degrees((rotations * turned.inv()).magnitude())
    seen = times_s <= shot.duration_s
    first = int(np.searchsorted(times_s, times_s[-1] - SLIP_WINDOW_S))
    slip_m = float(np.linalg.norm(positions_m[-1] - positions_m[first]))
    early = int(np.argmin(np.abs(times_s - early_s)))
    return ShotError(
        trial=shot.trial,
        early_mm=float(distance_mm[early]),
        early_deg=float(angle_deg[early]),
        mean_mm=float(distance_mm[seen].mean()),
        mean_deg=float(angle_deg[seen].mean()),
        rest_mm=float(distance_mm[-1]),
        rest_deg=float(angle_deg[-1]),
        same_face=upper_face(rotations[-1]) == upper_face(turned[-1]),
        slip_mm_per_s=1e3 * slip_m / float(times_s[-1] - times_s[first]),
    )


@dataclass(frozen=True)
class AngleError:
    """Errors of the angle of a hinge between two bodies in one simulated trial.

    Attributes:
        trial: Number of the trial.
        early_deg: Error at the early time [degrees].
        mean_deg: Mean error over the recorded time [degrees].
        rest_deg: Error at the last sample, where the recorded bodies rest [degrees].
    """

    trial: int
    early_deg: float
    mean_deg: float
    rest_deg: float


def angle_error(
    shots: tuple[SingleShot, SingleShot],
    times_s: FloatArray,
    rotations: tuple[Rotation, Rotation],
    *,
    early_s: float = 0.3,
) -> AngleError:
    """Return the errors of the angle of a hinge: those of the rotation of one body relative to the other.

    Args:
        shots: The recorded trial of both bodies.
        times_s: Times of the samples from the recorded start on [s], increasing, shape [T].
        rotations: Simulated orientations of both bodies, body to world, T of them each.
        early_s: Time of the early error [s].
    """
    if not len(times_s) == len(rotations[0]) == len(rotations[1]):
        raise ShapeError(
            f"{len(times_s)} times, and {len(rotations[0])} and {len(rotations[1])} rotations"
        )
    if times_s[-1] < early_s:
        raise ShapeError(
            f"the samples end at {times_s[-1]:.3f} s, before the early time of {early_s:.3f} s"
        )
    recorded = [shot.poses_at(times_s)[1] for shot in shots]
    apart = (rotations[0].inv() * rotations[1]) * (
        recorded[0].inv() * recorded[1]
    ).inv()
    angle_deg = np.degrees(apart.magnitude())
    return AngleError(
        trial=shots[0].trial,
        early_deg=float(angle_deg[int(np.argmin(np.abs(times_s - early_s)))]),
        mean_deg=float(angle_deg[times_s <= shots[0].duration_s].mean()),
        rest_deg=float(angle_deg[-1]),
    )


def upper_face(rotation: Rotation) -> str:
    """Return the body axis that points up most, with its sign, as `+x`."""
    up = rotation.as_matrix()[2]
    axis = int(np.argmax(np.abs(up)))
    return f"{'+' if up[axis] > 0 else '-'}{'xyz'[axis]}"


def energies_j(
    body: RigidBody, times_s: FloatArray, positions_m: FloatArray, rotations: Rotation
) -> FloatArray:
    """Return the mechanical energy of a rigid body between neighbouring samples [J], shape [T - 1].

    Args:
        body: The body, with its mass and inertia.
        times_s: Times [s], shape [T].
        positions_m: Positions of its origin, which is its centre of mass [m], shape [T, 3].
        rotations: Orientations, body to world, T of them.
    """
    velocity, rate_body = _rates(times_s, positions_m, rotations)
    inertia = body_mass_properties(body)[1]
    # A chord of a parabola lies below the arc by g dt^2 / 8 at its middle.
    height_m = (
        0.5 * (positions_m[1:, 2] + positions_m[:-1, 2])
        + GRAVITY_M_PER_S2 * np.diff(times_s) ** 2 / 8.0
    )
    moving = 0.5 * body.mass_kg * np.sum(velocity**2, axis=1)
    turning = 0.5 * np.einsum("ti,ij,tj->t", rate_body, inertia, rate_body)
    return np.asarray(moving + turning + body.mass_kg * GRAVITY_M_PER_S2 * height_m)


def _rates(
    times_s: FloatArray, positions_m: FloatArray, rotations: Rotation
) -> tuple[FloatArray, FloatArray]:
    """Return mean velocities [m/s] and body-frame angular velocities [rad/s] between samples, each [T - 1, 3]."""
    steps_s = np.diff(times_s)[:, None]
    return np.diff(positions_m, axis=0) / steps_s, (
        rotations[:-1].inv() * rotations[1:]
    ).as_rotvec() / steps_s


@dataclass(frozen=True)
class Impact:
    """One impact of a cube on a table.

    Attributes:
        kind: `corner`, `edge` or `face`: how many corners touch the table, one, two, or more.
        time_s: Time at which the striking corner stops falling [s].
        approach_m_per_s: Normal speed of the striking corner before.
        restitution: Normal speed of that corner after over before.
        energy_lost: Share of the kinetic energy before the impact that it takes.
    """

    kind: str
    time_s: float
    approach_m_per_s: float
    restitution: float
    energy_lost: float


def impacts(
    body: RigidBody,
    half_width_m: float,
    times_s: FloatArray,
    positions_m: FloatArray,
    rotations: Rotation,
) -> list[Impact]:
    """Return the impacts of a cube on z = 0, in the order of time.

    An impact is where a corner near the table stops falling that approached with `LEAST_APPROACH_M_PER_S` or more. Its
    speed of approach is that between samples `CLEAR_S` before, carried to the impact with gravity; a corner that turns
    about a resting edge falls with 0.7 of it. Its speed after the impact is the largest one between samples within
    `CLEAR_S`, at most 0.03 m/s too low. Impacts within twice that time are one, of the corner that strikes fastest.

    Args:
        body: The cube.
        half_width_m: Half its edge [m].
        times_s: Times [s], evenly spaced, shape [T].
        positions_m: Positions of its centre [m], shape [T, 3].
        rotations: Orientations, body to world, T of them.
    """
    corners_m = positions_m[:, None] + np.einsum(
        "tij,vj->tvi", rotations.as_matrix(), half_width_m * VERTICES
    )
    heights_m = corners_m[:, :, 2]
    step_s = float(times_s[1] - times_s[0])
    normal = np.diff(heights_m, axis=0) / step_s
    velocity, rate_body = _rates(times_s, positions_m, rotations)
    kinetic = 0.5 * body.mass_kg * np.sum(velocity**2, axis=1)
    kinetic = kinetic + 0.5 * np.einsum(
        "ti,ij,tj->t", rate_body, body_mass_properties(body)[1], rate_body
    )
    gap = max(1, round(CLEAR_S / step_s))
    found: list[Impact] = []
    fall = GRAVITY_M_PER_S2 * (gap + 0.5) * step_s
    free_at = gap + 1
    for at in range(gap + 1, len(times_s) - gap - 1):
        if at < free_at:
            continue
        approach = fall - normal[at - gap - 1]
        stops = (
            (heights_m[at] < CONTACT_M)
            & (normal[at - 1] < 0.0)
            & (normal[at] > 0.25 * normal[at - 1])
        )
        stops &= approach > LEAST_APPROACH_M_PER_S
        if not stops.any():
            continue
        corner = int(np.argmax(np.where(stops, approach, 0.0)))
        touching = int(np.sum(heights_m[at] < heights_m[at].min() + BESIDE_M))
        found.append(
            Impact(
                kind={1: "corner", 2: "edge"}.get(touching, "face"),
                time_s=float(times_s[at]),
                approach_m_per_s=float(approach[corner]),
                restitution=float(
                    normal[at : at + gap + 1, corner].max() / approach[corner]
                ),
                energy_lost=float(1.0 - kinetic[at + gap] / kinetic[at - gap - 1]),
            )
        )
        free_at = at + 2 * gap
    return found


def perturbed_start(
    body: RigidBody, nuisances: ShotNuisances, *, seed: int
) -> RigidBody:
    """Return a body with a start that differs by the uncertainty of the measured one.

    Drawn are the height (scatter of the rest height), the orientation (the tilt at rest, per axis its root mean square
    over the square root of 2), and both start velocities (their standard errors, and that of the length scale).

    Args:
        body: The body at its measured start.
        nuisances: Errors of the recording.
        seed: Seed of the draw.
    """
    draw = np.random.default_rng(seed)
    shift = draw.normal(
        0.0,
        [
            nuisances.position_noise_m,
            nuisances.position_noise_m,
            nuisances.rest_height_std_m,
        ],
    )
    turn = Rotation.from_rotvec(
        np.radians(draw.normal(0.0, nuisances.rest_tilt_deg / np.sqrt(2.0), 3))
    )
    stretch = 1.0 + draw.normal(
        0.0, nuisances.length_scale_std_error / nuisances.length_scale
    )
    linear = stretch * np.asarray(body.linear_velocity_m_per_s)
    linear = linear + draw.normal(0.0, nuisances.start_velocity_std_m_per_s, 3)
    angular = np.asarray(body.angular_velocity_rad_per_s)
    angular = angular + draw.normal(
        0.0, nuisances.start_angular_velocity_std_rad_per_s, 3
    )
    return replace(
        body,
        pose=Pose.from_rotation(
            vector(body.pose.position_m + shift), turn * body.pose.rotation
        ),
        linear_velocity_m_per_s=vector(linear),
        angular_velocity_rad_per_s=vector(angular),
    )


def perturbed_scene(scene: Scene, sidecar: ShotSidecar, *, seed: int) -> Scene:
    """Return a scene whose recorded bodies start within the uncertainty of the measured start.

    The body that is recorded by its pose starts as `perturbed_start` gives. Bodies that hang on it move along; the
    angle and the rate of each hinge are drawn as well.

    Args:
        scene: The scene at a measured start.
        sidecar: What is known about the recordings.
        seed: Seed of the draw.
    """
    nuisances, draw = sidecar.nuisances, np.random.default_rng((seed, 1))
    bodies = {body.name: body for body in scene.bodies}
    bodies[sidecar.body] = perturbed_start(bodies[sidecar.body], nuisances, seed=seed)
    for hung in sidecar.hung:
        # As recorded: an angle and a rate about the axis, which is the same in both frames.
        before, old, on = scene.body(hung.on), scene.body(hung.body), bodies[hung.on]
        spin = np.subtract(
            old.angular_velocity_rad_per_s, before.angular_velocity_rad_per_s
        )
        rate = float(before.pose.rotation.apply(spin, inverse=True) @ hung.axis)
        rate += draw.normal(0.0, nuisances.start_angle_rate_std_rad_per_s or 0.0)
        turn_rad = np.radians(draw.normal(0.0, nuisances.angle_noise_deg or 0.0))
        carrier = on.pose.rotation
        rotation = carrier * before.pose.rotation.inv() * old.pose.rotation
        rotation = rotation * Rotation.from_rotvec(turn_rad * np.asarray(hung.axis))
        arm_m, offset_m = carrier.apply(hung.anchor_on_m), rotation.apply(hung.anchor_m)
        carried_rate = np.asarray(on.angular_velocity_rad_per_s)
        angular = carried_rate + rate * carrier.apply(hung.axis)
        linear = (
            on.linear_velocity_m_per_s
            + np.cross(carried_rate, arm_m)
            - np.cross(angular, offset_m)
        )
        bodies[hung.body] = replace(
            old,
            pose=Pose.from_rotation(
                vector(on.pose.position_m + arm_m - offset_m), rotation
            ),
            linear_velocity_m_per_s=vector(linear),
            angular_velocity_rad_per_s=vector(angular),
        )
    hinges = [
        carried(one, scene.body(one.first).pose, bodies[one.first].pose)
        for one in scene.body_hinges
    ]
    return replace(scene, bodies=tuple(bodies.values()), body_hinges=tuple(hinges))


def bootstrap_interval(
    values: Sequence[float],
    statistic: Callable[[FloatArray], float] = np.median,
    *,
    draws: int = 2000,
    seed: int = 0,
) -> tuple[float, float]:
    """Return the 95 % percentile bootstrap interval of a statistic over trials.

    Args:
        values: One value for each trial.
        statistic: Function of an array of values.
        draws: Number of resamples.
        seed: Seed of the resamples.
    """
    sample = np.asarray(values, dtype=np.float64)
    index = np.random.default_rng(seed).integers(0, len(sample), (draws, len(sample)))
    found = [float(statistic(sample[row])) for row in index]
    low, high = np.percentile(found, [2.5, 97.5])
    return float(low), float(high)
