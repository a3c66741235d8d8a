"""Air on cloth: terminal velocity, pressure, friction and lift of a flat sheet in wind, energy in still air.

Only engines with `Feature.AIR` build these scenes. The law is that of `gauge_envs.scene.air`. A free flat sheet
under a uniform load moves without deforming, so its motion has a closed form. With u the velocity relative to the air,
and k = rho C / (2 mass per area):

- pressure alone, component along the normal: du/dt = -k |u| u, so the sheet has moved by w t - ln(1 + k w t) / k when
  the wind has the component w;
- friction alone: the same for the component in the sheet's plane;
- lift alone: |u| stays, and its angle a to the sheet's plane obeys da/dt = -k |u| sin a cos a, so
  tan a = tan a0 exp(-k |u| t).
"""

import math
from dataclasses import replace
from typing import Any

import numpy as np

from gauge_envs.scene import GRAVITY_M_PER_S2 as G, Air, Pose, Region, Scene
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scoring.estimators import steady_speed_m_per_s
from gauge_envs.tools.bench.recording import Recording
from gauge_envs.tools.conformance.lab import FRAME, Lab, clamped, fabric, sheet
from gauge_envs.tools.conformance.laws import passive_energy_gain, worst_ratio
from gauge_envs.tools.conformance.model import Check, Measurement, Tolerance

DENSITY, COEFFICIENT = 1.2, 1.5
FABRIC = fabric(0.1, 110.0, 1e-4)
RATE_PER_M = 0.5 * DENSITY * COEFFICIENT / FABRIC.areal_density_kg_per_m2
"""k [1/m] of a sheet that moves along its normal: 9."""

TOLERANCE = Tolerance(
    "a tenth of what is known of drag coefficients; explicit steps of 1 ms are off by 0.7 %",
    relative=0.02,
)

SOURCE = "quadratic drag, Newton's law of resistance"


def _free_sheet(
    lab: Lab, pose: Pose, air: Air, seconds: float, gravity: float
) -> Recording:
    cloth = sheet(FABRIC, pose, (0.15, 0.15))
    scene = Scene(
        bodies=(FRAME,),
        deformables=(cloth,),
        duration_s=seconds,
        gravity_m_per_s2=gravity,
        air=air,
    )
    return lab.rollout(scene)


FALL_S, SETTLED_S = 0.8, 0.6


@Check("air-terminal", source=SOURCE, tolerance=TOLERANCE)
def _air_terminal(lab: Lab) -> Measurement:
    air = Air(density_kg_per_m3=DENSITY, normal_coefficient=COEFFICIENT)
    rollout = _free_sheet(lab, Pose(position_m=(0.0, 0.0, 2.0)), air, FALL_S, G)
    window = rollout.between(SETTLED_S, FALL_S)
    heights = rollout.nodes_m["cloth"][window][:, :, 2].mean(axis=1)
    speed = -steady_speed_m_per_s(rollout.times_s[window], heights)
    expected = math.sqrt(G / RATE_PER_M)
    if speed > 0.9 * G * SETTLED_S:
        return Measurement(
            measured=speed,
            expected=expected,
            hint="it falls freely: the air has no effect",
        )
    ratio = (expected / speed) ** 2 if speed > 0.0 else math.inf
    return Measurement(
        measured=speed,
        expected=expected,
        hint=f"the drag is {ratio:.3g} times that of the law",
    )


WIND_M_PER_S, INCIDENCE_DEG = 2.0, 40.0
WIND_WINDOWS_S = ((0.0, 0.25), (0.25, 0.9), (1.05, 1.9), (2.05, 2.3))
ALONG_M_PER_S = WIND_M_PER_S * math.cos(math.radians(INCIDENCE_DEG))
ACROSS_M_PER_S = WIND_M_PER_S * math.sin(math.radians(INCIDENCE_DEG))


def _in_wind(
    lab: Lab, seconds: float, **coefficients: Any
) -> tuple[Recording, FloatArray]:
    """Record a sheet without gravity in wind along +x, which meets its plane at 40 degrees.

    Args:
        lab: The lab.
        seconds: Time to simulate [s].
        **coefficients: Coefficients of the air, of which the others are 0.

    Returns:
        The rollout, and the displacement of the sheet's mean along its first edge and its normal [m], shape
        [sample_count, 2]. The wind has positive components along both.
    """
    pose = Pose.from_euler_deg((0.0, 0.0, 1.0), (0.0, INCIDENCE_DEG, 0.0))
    air = Air(
        density_kg_per_m3=DENSITY,
        normal_coefficient=0.0,
        wind_m_per_s=(WIND_M_PER_S, 0.0, 0.0),
    )
    rollout = _free_sheet(lab, pose, replace(air, **coefficients), seconds, 0.0)
    means = rollout.nodes_m["cloth"].mean(axis=1)
    moved = pose.rotation.apply(means - means[0], inverse=True)
    return rollout, moved[:, [0, 2]]


def _carried(
    lab: Lab, axis: int, wind_m_per_s: float, **coefficient: float
) -> Measurement:
    """Measure the rate k of a force along one axis over that of the law: 1 / u grows by k t.

    Args:
        lab: The lab.
        axis: Axis of the force.
        wind_m_per_s: Component of the wind along it.
        coefficient: Coefficient of the air.
    """
    rollout, moved_m = _in_wind(lab, WIND_WINDOWS_S[-1][1], **coefficient)
    last = moved_m[-1]
    hint = ""
    if last[axis] < 0.0:
        hint = "it moves against the wind: check the sign"
    elif abs(last[1 - axis]) > 0.1 * abs(last[axis]):
        hint = "the force has a wrong direction"
    if hint:
        return Measurement(measured=0.0, expected=1.0, hint=hint)
    # The first sample is at rest; others are central differences.
    relative = wind_m_per_s - np.gradient(moved_m[:, axis], rollout.times_s)
    relative[0] = wind_m_per_s
    rates = {}
    for start_s, end_s in WIND_WINDOWS_S:
        first = rollout.sample_at(start_s)
        final = min(rollout.sample_at(end_s), len(relative) - 2)
        seconds = rollout.times_s[final] - rollout.times_s[first]
        growth = 1.0 / relative[final] - 1.0 / relative[first]
        rates[f"{start_s:g} to {end_s:g} s"] = float(growth / seconds / RATE_PER_M)
    return worst_ratio(rates, "the force of the air is")


@Check("air-pressure", source=SOURCE, tolerance=TOLERANCE)
def _air_pressure(lab: Lab) -> Measurement:
    return _carried(lab, 1, ACROSS_M_PER_S, normal_coefficient=COEFFICIENT)


@Check("air-friction", source=SOURCE, tolerance=TOLERANCE)
def _air_friction(lab: Lab) -> Measurement:
    return _carried(lab, 0, ALONG_M_PER_S, tangential_coefficient=COEFFICIENT)


@Check("air-lift")
def _air_lift(lab: Lab) -> Measurement:
    rollout, moved = _in_wind(lab, 0.1, lift_coefficient=COEFFICIENT)
    speeds = np.gradient(moved, rollout.times_s, axis=0)
    along, across = np.array([ALONG_M_PER_S, ACROSS_M_PER_S]) - speeds[-2]
    time_s = float(rollout.times_s[-2])
    start = math.tan(math.radians(INCIDENCE_DEG))
    expected = math.degrees(
        math.atan(start * math.exp(-RATE_PER_M * WIND_M_PER_S * time_s))
    )
    lost = 1.0 - math.hypot(along, across) / WIND_M_PER_S
    hint = (
        f"the relative speed changes by {-100.0 * lost:.3g} %: the lift does work"
        if abs(lost) > 0.02
        else ""
    )
    return Measurement(
        measured=math.degrees(math.atan2(across, along)), expected=expected, hint=hint
    )


@Check("air-energy")
def _air_energy(lab: Lab) -> Measurement:
    cloth = sheet(FABRIC, Pose(position_m=(0.0, 0.0, 1.0)), (0.15, 0.075))
    scene = clamped(cloth, Region(axis="x", side="low"), duration_s=0.6)
    air = Air(
        density_kg_per_m3=DENSITY,
        normal_coefficient=COEFFICIENT,
        lift_coefficient=COEFFICIENT,
    )
    rollout = lab.rollout(replace(scene, air=air))
    nodes = rollout.nodes_m["cloth"]
    shares = np.full(nodes.shape[1], 1.0 / nodes.shape[1])
    return passive_energy_gain(nodes, rollout.times_s, shares, G)
