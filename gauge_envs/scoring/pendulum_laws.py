"""Closed forms of rigid pendulums, with what they leave out: a swing from rest, and a swing that a row passes on."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation
from scipy.special import ellipj, ellipk

from gauge_envs.errors import ShapeError
from gauge_envs.references.published import Baseline, ChainLaw, SwingLaw
from gauge_envs.scene import Hinge, Scene, Sphere
from gauge_envs.scene.contact_faces import TOUCHING_M
from gauge_envs.scene.geometry import FloatArray, length_of
from gauge_envs.scene.meshes import body_mass_properties
from gauge_envs.scene.timing import FRAME_RATE_HZ


def pendulum_period_s(
    *, length_m: float, gyration_m: float, amplitude_rad: float, gravity_m_per_s2: float
) -> float:
    """Return the exact period [s] of a physical pendulum at a finite amplitude, by the complete elliptic integral.

    Args:
        length_m: Distance of the centre of mass from the axis [m].
        gyration_m: Radius of gyration about the centre of mass [m].
        amplitude_rad: Largest angle from the vertical [rad].
        gravity_m_per_s2: Gravity [m/s^2].
    """
    small = math.sqrt((length_m**2 + gyration_m**2) / (gravity_m_per_s2 * length_m))
    return float(4.0 * small * ellipk(math.sin(0.5 * amplitude_rad) ** 2))


@dataclass(frozen=True)
class Pendulum:
    """A rigid body on a frictionless hinge, of any shape, without damping.

    With the angle phi from where it hangs and the amplitude phi0, energy gives sin(phi / 2) = k sn(u | k^2) with
    k = sin(phi0 / 2) and du/dt = rate (Jacobi's elliptic sine). It is lowest at u = 0 and turns at u = K(k^2).

    Attributes:
        anchor_m: A point of the axis [m], shape [3].
        axis: Unit vector of the axis, shape [3].
        hanging_m: Vector from the anchor to the body's origin where the body hangs [m], shape [3].
        start_rad: Angle about the axis from there to the start [rad].
        rate_per_s: Angular frequency of small swings [rad/s]: the root of gravity across the axis over the effective
            length I / (m l), where I is the moment of inertia about the axis and l the distance of the mass centre.
    """

    anchor_m: FloatArray
    axis: FloatArray
    hanging_m: FloatArray
    start_rad: float
    rate_per_s: float

    @classmethod
    def of(
        cls, scene: Scene, name: str, *, longer_m: float = 0.0, turned_rad: float = 0.0
    ) -> Pendulum:
        """Return the pendulum that a body of a scene is.

        Args:
            scene: The scene.
            name: Name of the body, which starts at rest on a hinge.
            longer_m: Change of the distance from the axis [m].
            turned_rad: Change of the start angle, outwards [rad].
        """
        body = scene.body(name)
        hinge = next(
            (
                one
                for one in scene.joints
                if isinstance(one, Hinge) and one.body == name
            ),
            None,
        )
        if hinge is None or not body.starts_at_rest:
            raise ShapeError(
                f"{name} does not start at rest on a hinge: it is no pendulum that this law describes"
            )
        anchor, axis = (
            np.array(hinge.anchor_m),
            np.array(hinge.axis) / np.linalg.norm(hinge.axis),
        )
        centre, inertia = body_mass_properties(body)
        arm = body.pose.to_world(centre) - anchor
        across = arm - (arm @ axis) * axis
        distance = length_of(across)
        own_axis = body.pose.rotation.inv().apply(axis)
        radius_of_gyration_squared = float(own_axis @ inertia @ own_axis) / body.mass_kg
        down = np.array([0.0, 0.0, -1.0]) + axis[2] * axis
        start = math.atan2(float(np.cross(down, across) @ axis), float(down @ across))
        longer = distance + longer_m
        origin = np.array(body.pose.position_m) - anchor + longer_m / distance * across
        gravity = scene.gravity_m_per_s2 * length_of(down)
        return cls(
            anchor_m=anchor,
            axis=axis,
            hanging_m=Rotation.from_rotvec(-start * axis).apply(origin),
            start_rad=start + math.copysign(turned_rad, start),
            rate_per_s=math.sqrt(
                gravity / (longer + radius_of_gyration_squared / longer)
            ),
        )

    @property
    def quarter_s(self) -> float:
        """Time from the release to the lowest place [s]."""
        return float(ellipk(math.sin(0.5 * self.start_rad) ** 2)) / self.rate_per_s

    def released_rad(
        self, times_s: FloatArray, damping_per_s: float = 0.0
    ) -> FloatArray:
        """Return the angle after the release, shape [time_count].

        With damping the amplitude is multiplied by exp(-damping_per_s t), and the phase follows the period of each
        amplitude. That is the first order of a damping that is slow against the period.
        """
        parameter = np.sin(0.5 * self.start_rad * np.exp(-damping_per_s * times_s)) ** 2
        quarter = ellipk(parameter)
        # Share of a quarter swing, which advances by the period of the amplitude at each time.
        rates = self.rate_per_s / quarter
        shares = np.concatenate(
            [[0.0], np.cumsum(0.5 * (rates[1:] + rates[:-1]) * np.diff(times_s))]
        )
        sine = ellipj((1.0 - shares) * quarter, parameter)[0]
        return np.asarray(
            math.copysign(2.0, self.start_rad) * np.arcsin(np.sqrt(parameter) * sine)
        )

    def struck_rad(self, times_s: FloatArray, modulus: float) -> FloatArray:
        """Return the angle after a blow where it hangs, against the side of `start_rad`, shape [time_count].

        Args:
            times_s: Times since the blow [s]; it hangs before, and again after the return.
            modulus: sin(amplitude / 2), which is proportional to the speed of the blow.
        """
        phase = np.clip(self.rate_per_s * times_s, 0.0, 2.0 * ellipk(modulus**2))
        return np.asarray(2.0 * np.arcsin(modulus * ellipj(phase, modulus**2)[0]))

    def positions_mm(self, angles_rad: ArrayLike) -> FloatArray:
        """Return the positions of the body's origin [mm] at angles, shape [time_count, 3]."""
        turns = Rotation.from_rotvec(np.asarray(angles_rad)[:, None] * self.axis)
        return np.asarray(1e3 * (self.anchor_m + turns.apply(self.hanging_m)))


def swing_motion(
    law: SwingLaw, scene: Scene, frame_count: int
) -> tuple[FloatArray, FloatArray]:
    """Return the undamped swing of a body and its uncertainty, until the phase is not known any more.

    The uncertainty is that of length and angle at the start, and the whole effect of the damping that is left out. The
    law ends where it reaches the root mean square distance of the swing from its middle. From there on it says no more
    than that the body is somewhere on its arc.

    Returns:
        Positions [mm], shape [frame_count, 3], NaN from the end on; and their standard uncertainty [mm], same shape.
    """
    times_s = np.arange(frame_count) / FRAME_RATE_HZ

    def positions(
        longer_m: float = 0.0, turned_rad: float = 0.0, damping_per_s: float = 0.0
    ) -> FloatArray:
        pendulum = Pendulum.of(
            scene, law.body, longer_m=longer_m, turned_rad=turned_rad
        )
        return pendulum.positions_mm(pendulum.released_rad(times_s, damping_per_s))

    damped = positions(damping_per_s=law.damping_per_s)
    motion, uncertainty = _with_uncertainty(law, positions, [damped])
    middle = motion - motion.mean(axis=0)
    unknown = np.square(uncertainty).sum(axis=1) >= np.square(middle).sum(axis=1).mean()
    motion[np.maximum.accumulate(unknown)] = np.nan
    return motion, uncertainty


def chain_motion(
    law: ChainLaw, scene: Scene, frame_count: int, transfer: Baseline
) -> tuple[FloatArray, FloatArray]:
    """Return the rest and the first swing of the last ball of a row, and its uncertainty.

    The first ball swings down and hits the row after a quarter of its period. The last one leaves at once, with the
    published share of the speed, so that sin(amplitude / 2) has that share. The law ends when it returns to the row:
    the row has moved by then, and how it passes on a second blow depends on its gaps.

    Args:
        law: The law.
        scene: The scene.
        frame_count: Number of frames.
        transfer: Published momentum transfer efficiency of the first impact, a ratio.

    Returns:
        Positions [mm], shape [frame_count, 3], NaN from the return on; and their standard uncertainty [mm], same shape.
    """
    _check_row(scene)
    times_s = np.arange(frame_count) / FRAME_RATE_HZ

    def positions(
        longer_m: float = 0.0, turned_rad: float = 0.0, more: float = 0.0
    ) -> FloatArray:
        first = Pendulum.of(scene, law.first, longer_m=longer_m, turned_rad=turned_rad)
        last = Pendulum.of(scene, law.body, longer_m=longer_m)
        modulus = (transfer.mean + more) * math.sin(-0.5 * first.start_rad)
        # Published is where the balls hang. A longer string has a higher pivot.
        raised_mm = 1e3 * longer_m * last.hanging_m / np.linalg.norm(last.hanging_m)
        return (
            last.positions_mm(last.struck_rad(times_s - first.quarter_s, modulus))
            - raised_mm
        )

    std = transfer.std or 0.0
    blows = [positions(more=std), positions(more=-std)]
    motion, uncertainty = _with_uncertainty(law, positions, blows)
    motion[times_s >= chain_end_s(law, scene, transfer)] = np.nan
    return motion, uncertainty


def chain_end_s(law: ChainLaw, scene: Scene, transfer: Baseline) -> float:
    """Return the time at which the last ball returns to the row [s]."""
    first, last = Pendulum.of(scene, law.first), Pendulum.of(scene, law.body)
    modulus = transfer.mean * math.sin(0.5 * first.start_rad)
    return first.quarter_s + 2.0 * float(ellipk(modulus**2)) / last.rate_per_s


def _check_row(scene: Scene) -> None:
    """Raise unless the balls of a scene touch where they hang."""
    radii, places = [], []
    for body in scene.dynamic_bodies:
        pendulum = Pendulum.of(scene, body.name)
        if isinstance(body.shape, Sphere):
            radii.append(body.shape.radius_m)
            places.append(pendulum.anchor_m + pendulum.hanging_m)
    gaps = np.linalg.norm(np.diff(np.array(places), axis=0), axis=1) - np.add(
        radii[1:], radii[:-1]
    )
    if np.abs(gaps).max() > TOUCHING_M:
        raise ShapeError(
            f"the balls hang {1e3 * np.abs(gaps).max():.3f} mm apart: the last one does not leave at once"
        )


def _with_uncertainty(
    law: SwingLaw | ChainLaw,
    positions: Callable[..., FloatArray],
    changed: Sequence[FloatArray],
) -> tuple[FloatArray, FloatArray]:
    """Return positions and the root sum of squares of the effects of several errors on each, which never falls.

    A swing with another period meets the nominal one again and again, and is no better known there.

    Args:
        law: The law, which states the uncertainties of length and angle.
        positions: Positions by changes of the length [m] and the angle [rad], shape [frame_count, 3].
        changed: Positions with a third error; two of them are those of both signs.
    """
    motion = positions()
    length_m = 1e-3 * law.length_sigma_mm
    angle_rad = math.radians(law.angle_sigma_deg)
    pairs = [
        [positions(longer_m=sign * length_m) for sign in (1.0, -1.0)],
        [positions(turned_rad=sign * angle_rad) for sign in (1.0, -1.0)],
        changed,
    ]
    effects = [
        np.mean([np.square(one - motion) for one in pair], axis=0) for pair in pairs
    ]
    sizes = np.sqrt(np.sum(effects, axis=0))
    return motion, np.asarray(np.maximum.accumulate(sizes, axis=0))
