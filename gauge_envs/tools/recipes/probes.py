"""Measure a contact on any engine in scenes: drop, slide, hop, creep, rest and turning.

A plate of 120 mm rests, creeps and slides, and balls of 30 mm radius drop, all of the requested mass. One plate slides
without turning; the remaining plates may tip, hop and spin. The scenes use only the contract of backends.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs.scene import (
    GRAVITY_M_PER_S2 as G,
    Box,
    Pose,
    RigidBody,
    Scene,
)
from gauge_envs.scene.geometry import FloatArray, vector
from gauge_envs.scoring.estimators import steady_speed_m_per_s
from gauge_envs.tools.bench.drop import RADIUS_M, balls_above_ground, bounce_of, fall_s
from gauge_envs.tools.bench.parts import ball, body, contact, ground, thrown
from gauge_envs.tools.bench.recording import Recording, record
from gauge_envs.tools.bench.slope import creep_m_per_s, friction_of_slide
from gauge_envs.tools.bench.turning import INERTIA_SHARES, ROLL, SPIN, turning_arm_m
from gauge_envs.tools.conformance import Lab
from gauge_envs.tools.recipes.engines.base import ContactSettings

PLATE_M = (0.12, 0.12, 0.03)
"""Edges of the plate [m]. It tips only if the friction exceeds 4."""

PLATE_CONTACTS = 4
"""Number of corners on which the plate rests."""

DROP_M = 0.2
"""Height of the drop [m]; the impact speed is 2 m/s."""

BALL_COUNT = 8
"""Number of balls. Their heights differ slightly, so that impacts have different phases within a step."""

BALL_DISTANCE_M, PLATE_DISTANCE_M = 0.2, 0.3
"""Distance of neighbouring balls and plates [m]."""

SLIDE_BEYOND_DEG = 10.0
"""Slope of the slide minus the friction angle [degrees]."""

CREEP_SHARE = 0.5
"""Slope of the creep, divided by the coefficient of friction."""

TURN_DEG = 30.0
"""Rotation of the edges of a plate from the slope [degrees].

One corner then carries most of the load, and no axis of the world, a tangent of contacts in some engines, is along the
slope."""

HOP_TURNS_DEG = (0.0, 15.0, 30.0, 45.0)
"""Rotations of the edges of plates that can hop [degrees]."""

HOP_TIPS_RAD = np.outer((-1e-3, 1e-3), (1.0, 2.0, 0.0)) / math.sqrt(5.0)
"""Initial tips of these plates, as rotation vectors [rad]. On level plates, rounding errors would decide on hops."""

GYRATION_M = 100.0
"""Radius of gyration of a plate that cannot turn [m]: a friction of 2 turns it by 0.0002 degrees in a slide."""

SLIDE_S, CREEP_S, REST_S = 0.5, 1.0, 2.0
"""Simulated times [s]."""

SLIDE_FROM_S, CREEP_FROM_S, REST_FROM_S = 0.1, 0.5, 1.8
"""Start of the measured part [s]."""

SAMPLE_S = 1e-3
"""Time between samples [s], unless the time step is longer."""

NAMES = (
    "friction",
    "friction_hopping",
    "restitution",
    "penetration_m",
    "creep_m_s",
)
"""Names of the values of all settings; `friction` is the friction of bodies in sustained contact."""

TURNING = {"torsion_m": SPIN, "rolling_m": ROLL}
"""Rotation axis of a ball for each optional friction."""

LEVEL = Rotation.identity()


def drop_heights_m(timestep_s: float) -> FloatArray:
    """Return the height of each drop [m]; each ball falls for a different part of its last step."""
    step_m = G * fall_s(DROP_M, G) * timestep_s
    return DROP_M + step_m * np.arange(BALL_COUNT) / BALL_COUNT


def _lean(slope_rad: float, turn_deg: float = 0.0) -> Rotation:
    """Return the rotation of a plane that descends along x, with its axes rotated about its normal."""
    return Rotation.from_euler("zy", [math.radians(turn_deg), slope_rad])


def _spread(name: str, values: Sequence[float]) -> dict[str, float]:
    """Return mean, minimum and maximum of a quantity over different initial states."""
    return {
        name: float(np.mean(values)),
        f"{name}_low": min(values),
        f"{name}_high": max(values),
    }


@dataclass(frozen=True, kw_only=True)
class Probe:
    """Measure contact settings on their engine; each scene returns its values by name.

    Attributes:
        settings: The settings.
        mass_kg: Mass of plate and balls [kg].
    """

    settings: ContactSettings
    mass_kg: float

    def _slide_lean(self, turn_deg: float = 0.0) -> Rotation:
        """Return the rotation of a plane steeper than the friction angle."""
        friction_angle_rad = math.atan(self.settings.sliding_friction)
        slope_rad = friction_angle_rad + math.radians(SLIDE_BEYOND_DEG)
        return _lean(slope_rad, turn_deg)

    def slide(self) -> dict[str, float]:
        """Return the friction of plates that cannot turn, equal to the friction of their contacts."""
        frictions = []
        for turn_deg in (0.0, TURN_DEG):
            lean = self._slide_lean(turn_deg)
            inertia_kg_m2 = self.mass_kg * GYRATION_M**2
            plate = replace(self._plate(lean), inertia_kg_m2=inertia_kg_m2)
            frictions += self._frictions([plate], lean)
        return _spread("friction", frictions)

    def hop(self) -> dict[str, float]:
        """Return the friction of plates that can tip, hop and spin.

        Their contacts slide in different directions, and parts of the friction cancel.
        """
        lean = self._slide_lean()
        rotations = [
            Rotation.from_rotvec(tip) * Rotation.from_euler("z", turn_rad)
            for turn_rad, tip in product(np.radians(HOP_TURNS_DEG), HOP_TIPS_RAD)
        ]
        plates = [
            self._plate(lean, place, rotation)
            for place, rotation in enumerate(rotations, start=-4)
        ]
        return _spread("friction_hopping", self._frictions(plates, lean))

    def creep(self) -> dict[str, float]:
        """Return the speed [m/s] of a plate on a slope below the friction angle."""
        lean = _lean(math.atan(CREEP_SHARE * self.settings.sliding_friction), TURN_DEG)
        plate = self._plate(lean)
        rollout = self._rollout([plate], lean, CREEP_S)
        speed = creep_m_per_s(rollout, plate.name, "ground", start_s=CREEP_FROM_S)
        return {"creep_m_s": speed}

    def rest(self) -> dict[str, float]:
        """Return depth [m] and its drift [m/s] of a plate released at the surface of the ground."""
        plate = self._plate(LEVEL)
        rollout = self._rollout([plate], LEVEL, REST_S)
        settled = rollout.between(REST_FROM_S, math.inf)
        times_s = rollout.times_s[settled]
        depth_m = 0.5 * PLATE_M[2] - rollout.position(plate.name)[settled, 2]
        return {
            "penetration_m": float(depth_m.mean()),
            "drift_m_s": steady_speed_m_per_s(times_s, depth_m),
        }

    def drop(self) -> dict[str, float]:
        """Return the restitution of balls that drop."""
        heights_m = drop_heights_m(self.settings.timestep_s)
        balls = balls_above_ground(
            {f"ball{index}": height_m for index, height_m in enumerate(heights_m)},
            spacing_m=BALL_DISTANCE_M,
            mass_kg=self.mass_kg,
        )
        rollout = self._rollout(balls, LEVEL, 2.6 * fall_s(DROP_M, G))
        bounces = [bounce_of(rollout, ball.name) for ball in balls]
        restitutions = [
            bounce.restitution if bounce else math.nan for bounce in bounces
        ]
        return _spread("restitution", restitutions)

    def turning(self) -> dict[str, float]:
        """Return torsional and rolling friction [m] from the spin loss of a ball, if the settings have them.

        In theory, the ball stops after 0.5 s.
        """
        values = {}
        for name, axis in TURNING.items():
            expected_m = getattr(self.settings, name)
            if not expected_m:
                continue
            # Torque divided by the normal force, for a spin loss of 1 rad/s^2.
            arm_m = INERTIA_SHARES[axis] * RADIUS_M**2 / G
            spin_rad_per_s = SLIDE_S * expected_m / arm_m * np.array(axis)
            velocity_m_per_s = (RADIUS_M * spin_rad_per_s[1], 0.0, 0.0)
            level_ball = ball("ball", (0.0, 0.0, RADIUS_M), mass_kg=self.mass_kg)
            turning_ball = thrown(level_ball, velocity_m_per_s, spin_rad_per_s)
            rollout = self._rollout([turning_ball], LEVEL, 0.8 * SLIDE_S)
            values[name] = turning_arm_m(rollout, axis, start_s=SLIDE_FROM_S)
        return values

    def _frictions(self, plates: Sequence[RigidBody], lean: Rotation) -> list[float]:
        """Return the friction of each plate that slides down a plane."""
        rollout = self._rollout(plates, lean, SLIDE_S)
        return [
            friction_of_slide(rollout, plate.name, "ground", start_s=SLIDE_FROM_S)
            for plate in plates
        ]

    def _plate(
        self, lean: Rotation, place: int = 0, rotation: Rotation = LEVEL
    ) -> RigidBody:
        """Return a rotated plate that touches an inclined plane, at a place across the slope."""
        height_m = 0.5 * float(np.abs(rotation.as_matrix()[2]) @ PLATE_M)
        position_m = lean.apply([0.0, place * PLATE_DISTANCE_M, height_m])
        pose = Pose.from_rotation(vector(position_m), lean * rotation)
        return body(f"plate{place:+d}", Box(size_m=PLATE_M), pose, mass_kg=self.mass_kg)

    def _rollout(
        self, bodies: Sequence[RigidBody], lean: Rotation, seconds: float
    ) -> Recording:
        """Record bodies on an inclined plane.

        Raises:
            DivergedError: The engine failed, or a body left the scene.
            DeclinedError: The engine cannot simulate the contact.
        """
        settings = self.settings
        names = tuple(body.name for body in bodies)
        # Engines without a coefficient of restitution rebound by contact constants.
        restitution = getattr(settings, "restitution", None)
        friction = settings.sliding_friction
        pair = replace(
            contact(names, "ground", friction=friction, restitution=restitution),
            torsion_m=settings.torsion_m,
            rolling_m=settings.rolling_m,
        )
        pose = Pose.from_rotation((0.0, 0.0, 0.0), lean)
        plane = replace(ground(), pose=pose)
        scene = Scene(bodies=(*bodies, plane), contacts=(pair,), duration_s=seconds)
        step_s = settings.timestep_s
        interval_s = step_s * max(1, round(SAMPLE_S / step_s))
        lab = Lab(settings.backend(), settings.backend_settings(self.mass_kg))
        with lab.running(
            scene, timestep_s=step_s, drive_interval_s=interval_s
        ) as simulation:
            return record(
                simulation,
                scene,
                seconds,
                interval_s=interval_s,
                speed_limit_m_per_s=scene.speed_limit_m_per_s + G * seconds,
            )


def measured(settings: ContactSettings, mass_kg: float) -> dict[str, float]:
    """Simulate all scenes, and return their values by name.

    Args:
        settings: The settings.
        mass_kg: Mass of the bodies [kg].

    Raises:
        DivergedError: The engine failed, or a body left the scene.
        DeclinedError: The engine cannot simulate the contact.
    """
    probe = Probe(settings=settings, mass_kg=mass_kg)
    return {
        **probe.slide(),
        **probe.hop(),
        **probe.drop(),
        **probe.rest(),
        **probe.creep(),
        **probe.turning(),
    }
