"""Scenes in which a contact is measured on any engine: drop, slide, hop, creep and rest.

A plate of 120 mm rests, creeps and slides, and balls of 30 mm radius drop, all of the requested mass. One plate slides
without turning, others may tip, hop and spin. The scenes go through the contract of backends alone.
"""

import math
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, Self

import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs.backends.base import Backend, scene_support
from gauge_envs.errors import UnsupportedSceneError
from gauge_envs.scene import (
    GRAVITY_M_PER_S2 as G,
    Box,
    Contact,
    ContactMode,
    Motion,
    Plane,
    Pose,
    RigidBody,
    Scene,
)
from gauge_envs.scene.geometry import FloatArray, vector
from gauge_envs.scoring.estimators import steady_speed_m_per_s
from gauge_envs.tools.bench.drop import RADIUS_M, balls_above_ground, bounce_of, fall_s
from gauge_envs.tools.bench.parts import thrown
from gauge_envs.tools.bench.recording import Recording, record
from gauge_envs.tools.bench.slope import creep_m_per_s, friction_of_slide, moved_m
from gauge_envs.tools.bench.turning import INERTIA_SHARES, ROLL, SPIN, turning_arm_m

PLATE_M = (0.12, 0.12, 0.03)
"""Edges of the plate [m]. It tips only where friction exceeds 4."""

PLATE_CONTACTS = 4
"""Corners on which the plate rests."""

DROP_M = 0.2
"""Height of the drop [m], which gives 2 m/s."""

BALL_COUNT = 8
"""Balls that drop from slightly different heights, so that steps meet their impacts in different phases."""

BALL_DISTANCE_M = 0.2
"""Distance of neighbouring balls [m]."""

SLIDE_BEYOND_DEG = 10.0
"""Slope of the slide beyond the friction angle [degrees]."""

CREEP_SHARE = 0.5
"""Slope of the creep over the coefficient of friction: half of what friction holds."""

TURN_DEG = 30.0
"""Turn of the edges of a plate against the slope [degrees]: then one corner carries most, and engines that choose the
tangents of contacts by the axes of the world have no axis along the slope."""

HOP_TURNS_DEG = (0.0, 15.0, 30.0, 45.0)
"""Turns of the edges of plates that can hop [degrees]."""

HOP_TIPS_RAD = np.outer((-1e-3, 1e-3), (1.0, 2.0, 0.0)) / math.sqrt(5.0)
"""Their tips at the start, as rotation vectors along no edge or diagonal [rad]: if level, rounding decides on hops."""

FAST_M_PER_S = (1.0, 2.0, 4.0)
"""Speeds of plates that slide on level ground [m/s]: of a push, of a foot that slips, and of a throw."""

PLATE_DISTANCE_M = 0.3
"""Distance of neighbouring plates [m]."""

GYRATION_M = 100.0
"""Radius of gyration of a plate that cannot turn [m]: a friction of 2 turns it by 0.0002 degrees in a slide."""

SLIDE_S, CREEP_S, REST_S = 0.5, 1.0, 2.0
"""Simulated times [s]."""

SLIDE_FROM_S, CREEP_FROM_S, REST_FROM_S = 0.1, 0.5, 1.8
"""Start of the part that is measured [s]."""

SAMPLE_S = 1e-3
"""Desired time between samples [s]; a step that is longer is the time between samples."""


@dataclass(frozen=True, kw_only=True)
class Build:
    """A contact through the contract of backends.

    Attributes:
        friction: Coefficient of friction in the scene.
        restitution: Coefficient of restitution in the scene.
        turning: Torsional and rolling friction in the scene [m], by name.
        mode: Kind of contact in the scene.
        settings: Settings of the backend, without the drive interval.
    """

    friction: float
    restitution: float
    turning: Mapping[str, float]
    mode: ContactMode
    settings: Mapping[str, Any]


@dataclass(frozen=True, kw_only=True)
class Spread:
    """Mean, smallest and largest of the values that one quantity has in different starts."""

    mean: float
    low: float
    high: float

    @classmethod
    def of(cls, values: Sequence[float]) -> Self:
        """Return the spread of some values."""
        return cls(mean=float(np.mean(values)), low=min(values), high=max(values))


@dataclass(frozen=True, kw_only=True)
class Rest:
    """A plate at rest on level ground.

    Attributes:
        penetration_m: Depth in the ground [m]; negative above it.
        drift_m_s: Speed at which the depth still changes [m/s].
        time_constant_s: Twice the inverse of the damping per mass of the approach [s]; None where it is not resolved.
    """

    penetration_m: float
    drift_m_s: float
    time_constant_s: float | None


def creep_slope_rad(friction: float) -> float:
    """Return the slope of the creep [rad]."""
    return math.atan(CREEP_SHARE * friction)


LEVEL = Rotation.identity()


def _lean(slope_rad: float, turn_deg: float = 0.0) -> Rotation:
    """Return the rotation of a plane that falls along x, and whose axes are turned about its normal."""
    return Rotation.from_euler("zy", [math.radians(turn_deg), slope_rad])


@dataclass(frozen=True, kw_only=True)
class Probe:
    """Measures contacts on one engine.

    Attributes:
        backend: The engine.
        mass_kg: Mass of plate and balls [kg].
        timestep_s: Time step [s].
    """

    backend: Backend
    mass_kg: float
    timestep_s: float

    def slide(self, build: Build, friction: float) -> Spread:
        """Return the friction of plates that cannot turn, that of their contacts; the expected one gives the slope."""
        slope = math.atan(friction) + math.radians(SLIDE_BEYOND_DEG)
        leans = (_lean(slope, turn_deg) for turn_deg in (0.0, TURN_DEG))
        found = [
            self._frictions(build, [self._plate(lean, gyration_m=GYRATION_M)], lean)[0]
            for lean in leans
        ]
        return Spread.of([one for one, _ in found])

    def hop(self, build: Build, friction: float) -> tuple[Spread, float]:
        """Return the same of plates that can tip, hop and spin, and how far they hop [m].

        Their contacts slide in different directions, and parts of the friction cancel.
        """
        lean = _lean(math.atan(friction) + math.radians(SLIDE_BEYOND_DEG))
        plates = [
            self._plate(
                lean,
                turn=Rotation.from_rotvec(tip) * Rotation.from_euler("z", turn),
                place=place,
            )
            for place, (turn, tip) in enumerate(
                product(np.radians(HOP_TURNS_DEG), HOP_TIPS_RAD), start=-4
            )
        ]
        found, lifts_m = zip(*self._frictions(build, plates, lean), strict=True)
        return Spread.of(found), max(lifts_m)

    def fast_hop_m(self, build: Build) -> float:
        """Return how far plates hop that slide fast on level ground [m]; contacts that stop a body in a step lift it.

        A hop of (mu v)^2 / (2 g) is that of a contact which takes the sliding speed v in one step.
        """
        plates = [
            thrown(self._plate(LEVEL, place=place), (speed_m_per_s, 0.0, 0.0))
            for place, speed_m_per_s in enumerate(FAST_M_PER_S)
        ]
        return max(lift_m for _, lift_m in self._frictions(build, plates, LEVEL))

    def creep(self, build: Build, friction: float) -> float:
        """Return the speed [m/s] of a plate on a slope that friction holds."""
        lean = _lean(creep_slope_rad(friction), TURN_DEG)
        plate = self._plate(lean)
        rollout = self._rollout([plate], lean, build, CREEP_S)
        return creep_m_per_s(rollout, plate.name, "ground", start_s=CREEP_FROM_S)

    def rest(self, build: Build) -> Rest:
        """Return depth and approach of a plate that is let go just where it touches level ground."""
        plate = self._plate(LEVEL)
        rollout = self._rollout([plate], LEVEL, build, REST_S)
        depth_m = 0.5 * PLATE_M[2] - rollout.position(plate.name)[:, 2]
        settled = rollout.times_s >= REST_FROM_S
        drift_m_s = steady_speed_m_per_s(rollout.times_s[settled], depth_m[settled])
        return Rest(
            penetration_m=float(depth_m[settled].mean()),
            drift_m_s=drift_m_s,
            time_constant_s=_time_constant_s(depth_m, rollout.interval_s),
        )

    def drop(self, build: Build) -> Spread:
        """Return the restitution of balls that drop."""
        falls_s = fall_s(DROP_M, G)
        # Each ball falls on for another part of a step.
        step_m = G * falls_s * self.timestep_s
        drops_m = {
            f"ball{index}": DROP_M + step_m * index / BALL_COUNT
            for index in range(BALL_COUNT)
        }
        balls = balls_above_ground(
            drops_m, spacing_m=BALL_DISTANCE_M, mass_kg=self.mass_kg
        )
        rollout = self._rollout(balls, LEVEL, build, 2.6 * falls_s)
        bounces = [bounce_of(rollout, ball.name) for ball in balls]
        return Spread.of(
            [math.nan if bounce is None else bounce.restitution for bounce in bounces]
        )

    def turning(self, build: Build, name: str) -> float:
        """Return `torsion_m` or `rolling_m` from the spin that a ball loses, which the law stops after 0.5 s [m]."""
        axis = SPIN if name == "torsion_m" else ROLL
        # Torque over the normal force, for a loss of spin of 1 rad/s^2.
        arm_m = INERTIA_SHARES[axis] * RADIUS_M**2 / G
        spin_rad_per_s = SLIDE_S * build.turning[name] / arm_m * np.array(axis)
        ball = replace(
            balls_above_ground({"ball": 0.0}, spacing_m=0.0, mass_kg=self.mass_kg)[0],
            linear_velocity_m_per_s=(RADIUS_M * float(spin_rad_per_s[1]), 0.0, 0.0),
            angular_velocity_rad_per_s=vector(spin_rad_per_s),
        )
        return turning_arm_m(
            self._rollout([ball], LEVEL, build, 0.8 * SLIDE_S),
            axis,
            start_s=SLIDE_FROM_S,
        )

    def _frictions(
        self, build: Build, plates: Sequence[RigidBody], lean: Rotation
    ) -> list[tuple[float, float]]:
        """Return the friction of each plate that slides down a plane, and how far its centre leaves the plane [m]."""
        rollout = self._rollout(plates, lean, build, SLIDE_S)
        found = []
        for plate in plates:
            lift_m = moved_m(rollout, plate.name, "ground")[:, 2]
            friction = friction_of_slide(
                rollout, plate.name, "ground", start_s=SLIDE_FROM_S
            )
            found.append((friction, float(lift_m.max())))
        return found

    def _plate(
        self,
        lean: Rotation,
        *,
        turn: Rotation = LEVEL,
        place: int = 0,
        gyration_m: float = 0.0,
    ) -> RigidBody:
        """Return a turned plate that touches a leaning plane, of uniform density unless a gyration [m] is given."""
        height_m = 0.5 * float(np.abs(turn.as_matrix()[2]) @ PLATE_M)
        return RigidBody(
            name=f"plate{place:+d}",
            shape=Box(size_m=PLATE_M),
            motion=Motion.DYNAMIC,
            pose=Pose.from_rotation(
                vector(lean.apply([0.0, place * PLATE_DISTANCE_M, height_m])),
                lean * turn,
            ),
            mass_kg=self.mass_kg,
            inertia_kg_m2=self.mass_kg * gyration_m**2 or None,
        )

    def _rollout(
        self, bodies: Sequence[RigidBody], lean: Rotation, build: Build, seconds: float
    ) -> Recording:
        """Record bodies on a leaning plane."""
        interval_s = self.timestep_s * max(1, round(SAMPLE_S / self.timestep_s))
        pose = Pose.from_rotation((0.0, 0.0, 0.0), lean)
        ground = RigidBody(
            name="ground", shape=Plane(), motion=Motion.FIXED, pose=pose, mass_kg=0.0
        )
        contact = Contact(
            first=tuple(body.name for body in bodies),
            second=("ground",),
            friction=build.friction,
            restitution=build.restitution,
            mode=build.mode,
            **build.turning,
        )
        scene = Scene(bodies=(*bodies, ground), contacts=(contact,), duration_s=seconds)
        if missing := scene_support(self.backend, scene).missing:
            raise UnsupportedSceneError(
                f"{self.backend.name} cannot simulate the recipe: {'; '.join(missing)}"
            )
        given = {
            **build.settings,
            "timestep_s": self.timestep_s,
            "drive_interval_s": interval_s,
        }
        with closing(self.backend.build(scene, given)) as simulation:
            simulation.reset(None, 0)
            limit = scene.speed_limit_m_per_s + G * seconds
            return record(
                simulation,
                scene,
                seconds,
                interval_s=interval_s,
                speed_limit_m_per_s=limit,
            )


MOST_NOISE = 0.01
"""Largest misfit of the approach to rest, over its size, with which its time constant is read."""


def _time_constant_s(depth_m: FloatArray, interval_s: float) -> float | None:
    """Return the time constant of a damped approach to rest, fitted as a linear recurrence of second order."""
    left = depth_m - depth_m[-1]
    moving = np.flatnonzero(np.abs(left) > 0.02 * np.abs(left).max())
    if len(moving) < 8 or moving[-1] > len(left) - 3:
        return None
    part = left[: moving[-1] + 2]
    table = np.column_stack([part[1:-1], part[:-2]])
    solution = np.linalg.lstsq(table, part[2:], rcond=None)[0]
    misfit = np.abs(table @ solution - part[2:]).max() / np.abs(part).max()
    product = -float(solution[1])
    if misfit > MOST_NOISE or not 0.0 < product < 1.0:
        return None
    # The product of the two roots is exp(-2 t / time constant).
    return -2.0 * interval_s / math.log(product)
