"""Measure a contact on any engine in scenes: drop, slide, creep, rest and turning.

A plate of 120 mm rests, creeps and slides without turning, and balls of 30 mm radius drop, all of the requested mass.
The scenes use only the contract of backends.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs.fixtures.drop import RADIUS_M, balls_above_ground, bounce_of, fall_s
from gauge_envs.fixtures.parts import ball, body, contact, ground, thrown
from gauge_envs.fixtures.recording import Recording, record
from gauge_envs.fixtures.slope import creep_m_per_s, friction_of_slide
from gauge_envs.fixtures.turning import INERTIA_SHARES, ROLL, SPIN, turning_arm_m
from gauge_envs.scene import GRAVITY_M_PER_S2 as G, Box, Pose, RigidBody, Scene
from gauge_envs.scene.geometry import FloatArray, vector
from gauge_envs.tools.conformance import Lab
from gauge_envs.tools.recipes.engines.base import ContactSettings

PLATE_M = (0.12, 0.12, 0.03)
"""Edges of the plate [m]. It tips only if the friction exceeds 4."""

DROP_M = 0.2
"""Height of the drop [m]; the impact speed is 2 m/s."""

BALL_COUNT = 8
"""Number of balls. Their heights differ slightly, so that impacts have different phases within a step."""

BALL_DISTANCE_M = 0.2
"""Distance of neighbouring balls [m]."""

SLIDE_BEYOND_DEG = 10.0
"""Slope of the slide minus the friction angle [degrees]."""

CREEP_SHARE = 0.5
"""Slope of the creep, divided by the coefficient of friction."""

TURN_DEG = 30.0
"""Rotation of the edges of a plate from the slope [degrees].

One corner then carries most of the load, and no axis of the world, a tangent of contacts in some engines, is along the
slope."""

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
    "restitution",
    "impact_friction",
    "slip_restitution",
    "penetration_m",
    "creep_m_s",
    "hop_m",
)
"""Names of the values of all settings; `friction` is the friction of bodies in sustained contact."""

IMPACT_M_PER_S = 2.0
"""Speed of oblique impacts along the normal [m/s]."""

IMPACT_PHASES = 4
"""Number of balls for each direction of an oblique impact, in different phases within a step."""

GRIPPING = (0.5, 1.0)
"""Tangential over normal speed of impacts that should stop the slip: 27 and 45 degrees from the normal."""

SLIPPING_SHARE = 3.0
"""Tangential speed of the grazing impact, over the largest at which friction would stop the slip."""

IMPACT_DROP_M, IMPACT_S = 0.02, 0.06
"""Height at which a ball is thrown [m], and duration [s]."""

HOP_M_PER_S, HOP_S = (1.0, 4.0), 0.3
"""Speeds of a plate that slides on a level ground [m/s], and duration [s]."""

TURNING = {"torsion_m": SPIN, "rolling_m": ROLL}
"""Rotation axis of a ball for each optional friction."""

LEVEL = Rotation.identity()


def _lean(slope_rad: float, turn_deg: float = 0.0) -> Rotation:
    """Return the rotation of a plane that descends along x, with its axes rotated about its normal."""
    return Rotation.from_euler("zy", [math.radians(turn_deg), slope_rad])


@dataclass(frozen=True, kw_only=True)
class Probe:
    """Measure contact settings on their engine; each scene returns its values by name.

    Attributes:
        settings: The settings.
        mass_kg: Mass of plate and balls [kg].
    """

    settings: ContactSettings
    mass_kg: float

    def slide(self) -> dict[str, float]:
        """Return the friction of plates that cannot turn, on planes steeper than the friction angle."""
        friction_angle_rad = math.atan(self.settings.sliding_friction)
        slope_rad = friction_angle_rad + math.radians(SLIDE_BEYOND_DEG)
        frictions = []
        for turn_deg in (0.0, TURN_DEG):
            lean = _lean(slope_rad, turn_deg)
            inertia_kg_m2 = self.mass_kg * GYRATION_M**2
            plate = replace(self._plate(lean), inertia_kg_m2=inertia_kg_m2)
            rollout = self._rollout([plate], lean, SLIDE_S)
            frictions.append(
                friction_of_slide(rollout, plate.name, "ground", start_s=SLIDE_FROM_S)
            )
        return {"friction": float(np.mean(frictions))}

    def creep(self) -> dict[str, float]:
        """Return the speed [m/s] of a plate on a slope below the friction angle."""
        lean = _lean(math.atan(CREEP_SHARE * self.settings.sliding_friction), TURN_DEG)
        plate = self._plate(lean)
        rollout = self._rollout([plate], lean, CREEP_S)
        speed = creep_m_per_s(rollout, plate.name, "ground", start_s=CREEP_FROM_S)
        return {"creep_m_s": speed}

    def rest(self) -> dict[str, float]:
        """Return the depth [m] of a plate released at the surface of the ground."""
        plate = self._plate(LEVEL)
        rollout = self._rollout([plate], LEVEL, REST_S)
        settled = rollout.between(REST_FROM_S, math.inf)
        depth_m = 0.5 * PLATE_M[2] - rollout.position(plate.name)[settled, 2]
        return {"penetration_m": float(depth_m.mean())}

    def drop(self) -> dict[str, float]:
        """Return the restitution of balls that drop."""
        # Each ball falls for a different part of its last step.
        step_m = G * fall_s(DROP_M, G) * self.settings.timestep_s
        heights_m = DROP_M + step_m * np.arange(BALL_COUNT) / BALL_COUNT
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
        return {"restitution": float(np.mean(restitutions))}

    def impact(self) -> dict[str, float]:
        """Return the friction of the impact that is farthest from Coulomb's, and the rebound of a ball that slips."""
        ratios, rebound = self.impacts()
        worst = max(ratios.ravel().tolist(), key=lambda ratio: abs(ratio - 1.0))
        return {
            "impact_friction": worst * self.settings.sliding_friction,
            "slip_restitution": rebound,
        }

    def impacts(self) -> tuple[FloatArray, float]:
        """Return friction over Coulomb's law in oblique impacts, and the mean rebound of those in which the ball slips.

        The rows are impacts at 27 and 45 degrees, and grazing; the columns are phases within a step.

        With the normal impulse N and the mass m, friction takes the tangential impulse min(mu N, 2/7 m v) from a ball
        that arrives without spin at the tangential speed v. Both impulses follow from the change of momentum.
        """
        friction = self.settings.sliding_friction
        slips_from = 3.5 * friction * (1.0 + getattr(self.settings, "restitution", 0.5))
        shares = [*GRIPPING, SLIPPING_SHARE * slips_from]
        speeds = np.repeat(shares, IMPACT_PHASES) * IMPACT_M_PER_S
        turn_rad = math.radians(TURN_DEG)
        along = np.array([math.cos(turn_rad), math.sin(turn_rad)])
        down = math.sqrt(IMPACT_M_PER_S**2 - 2.0 * G * IMPACT_DROP_M)
        step_m = IMPACT_M_PER_S * self.settings.timestep_s
        balls = []
        for index, speed in enumerate(speeds):
            phase = index % IMPACT_PHASES / IMPACT_PHASES
            height_m = RADIUS_M + IMPACT_DROP_M + phase * step_m
            place_m = (0.0, BALL_DISTANCE_M * index, height_m)
            still = ball(f"ball{index}", place_m, mass_kg=self.mass_kg)
            balls.append(thrown(still, (*(speed * along), -down)))
        rollout = self._rollout(balls, LEVEL, IMPACT_S)
        ratios, rebounds = [], []
        for one, speed in zip(balls, speeds, strict=True):
            velocity = rollout.velocity(one.name)
            taken = (velocity[0, :2] - velocity[-1, :2]) @ along
            pressed = velocity[-1, 2] - velocity[0, 2] + G * rollout.times_s[-1]
            ratios.append(taken / min(friction * pressed, 2.0 / 7.0 * speed))
            rebounds.append(float(velocity[:, 2].max()) / IMPACT_M_PER_S)
        rebound = float(np.mean(rebounds[-IMPACT_PHASES:]))
        return np.reshape(ratios, (-1, IMPACT_PHASES)), rebound

    def hop(self) -> dict[str, float]:
        """Return how high a plate rises that slides on a level ground [m]."""
        heights_m = []
        for speed in HOP_M_PER_S:
            plate = thrown(self._plate(LEVEL), (speed, 0.0, 0.0))
            heights = self._rollout([plate], LEVEL, HOP_S).position(plate.name)[:, 2]
            heights_m.append(float(heights.max() - heights[0]))
        return {"hop_m": max(heights_m)}

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

    def _plate(self, lean: Rotation) -> RigidBody:
        """Return a plate that touches an inclined plane."""
        position_m = lean.apply([0.0, 0.0, 0.5 * PLATE_M[2]])
        pose = Pose.from_rotation(vector(position_m), lean)
        return body("plate", Box(size_m=PLATE_M), pose, mass_kg=self.mass_kg)

    def _rollout(
        self, bodies: Sequence[RigidBody], lean: Rotation, seconds: float
    ) -> Recording:
        """Record bodies on an inclined plane.

        Raises:
            DivergedError: The engine failed, or a body left the scene.
            UnsupportedError: The engine cannot simulate the contact.
        """
        settings = self.settings
        touch = contact(
            tuple(body.name for body in bodies),
            "ground",
            friction=settings.sliding_friction,
            # Engines without a coefficient of restitution rebound by contact constants.
            restitution=getattr(settings, "restitution", None),
        )
        turning = {name: getattr(settings, name) for name in TURNING}
        pair = replace(touch, **turning)
        plane = replace(ground(), pose=Pose.from_rotation((0.0, 0.0, 0.0), lean))
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
        UnsupportedError: The engine cannot simulate the contact.
    """
    probe = Probe(settings=settings, mass_kg=mass_kg)
    return {
        **probe.slide(),
        **probe.drop(),
        **probe.impact(),
        **probe.rest(),
        **probe.creep(),
        **probe.hop(),
        **probe.turning(),
    }
