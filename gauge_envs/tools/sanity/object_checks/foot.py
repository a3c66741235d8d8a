"""Foot of a robot on the measured boards: creep, slip, slide and landing.

The foot has the solids and the load of the configuration. It rests with the configuration's friction, and slides with
the friction of the measured wooden cube. The values are laws; measurements of wooden cubes say how far a real body may
differ from them. Without a configuration, the checks have the foot of a small quadruped.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs.fixtures.parts import body, contact, ground
from gauge_envs.fixtures.recording import Recording
from gauge_envs.scene import GRAVITY_M_PER_S2 as G, Pose, Scene
from gauge_envs.scene.geometry import vector
from gauge_envs.tools.sanity.object_checks.check import (
    ObjectCheck,
    Scenario,
    acceleration,
    lowest_m,
)
from gauge_envs.tools.sanity.object_checks.friction import (
    CALM_INTERVAL_S,
    HOLD_S,
    SLIDE_S,
    creeping,
    downhill,
    real_friction,
    slide,
)
from gauge_envs.tools.sanity.robot.foot import FootGeometry
from gauge_envs.tools.sanity.training import Need
from gauge_envs.tools.sanity.verdict import COVERAGE, Reality

FOOT = "foot"

MATERIAL = "wood"

SOFTENED_BY_INVERSE_WEIGHT = ("mujoco", "mujoco_warp")
"""Backends that build MuJoCo's own model, whose contacts are softened by the inverse weight of a link."""

HOLD_DEG, HOLD_PUSH = 10.0, 0.7
"""Slope of the measured board on which a foot rests [degrees], and its largest push.

A foot with a small friction rests on a slope where gravity pushes with 0.7 of the friction limit.
"""

PUSH, SLIDE_DEG = 1.2, 30.0
"""Push of gravity along a slope over mu times the normal force, with which a foot just slides, and slope of the
measured board [degrees]."""

DROP_M, LANDING_S = 0.05, 0.6
"""Height of the drop, as of a step, and simulated time with the fall of 0.1 s."""

DEPTH_MM = 9.0
"""Compression of a rubber ball of 20 mm radius and a modulus of 2 MPa that lands with 3 kg, by Hertz's law [mm]."""

HOP = 0.2
"""Ratio of speeds at which a foot that was dropped from 50 mm hops by 2 mm."""

STANCE_S = 0.2
"""Time that a foot of a trotting quadruped is on the ground [s]."""

STILL_S = 0.05
"""Time at the end in which a landed foot must be at rest [s]."""

STAYS = "a foot that steps stays on the ground"

AT_REST_M_PER_S = 0.01
"""Speed below which a landed foot is at rest [m/s]."""


# --- scenes ----------------------------------------------------------------------------------------------------------


def foot_scene(
    foot: FootGeometry,
    *,
    friction: float,
    slope_deg: float = 0.0,
    lift_m: float = 0.0,
    seconds: float = 1.0,
) -> Scene:
    """Return four copies of a foot in one rigid body, on an even ground that slopes along x.

    Args:
        foot: The foot.
        friction: Coulomb coefficient of the soles.
        slope_deg: Slope of the ground [degrees].
        lift_m: Height of the soles above the ground at the start [m].
        seconds: Duration of the experiment [s].
    """
    slope = Rotation.from_euler("y", slope_deg, degrees=True)
    start = Pose.from_rotation(vector(slope.apply([0.0, 0.0, lift_m])), slope)
    level = Pose.from_rotation((0.0, 0.0, 0.0), slope)
    return Scene(
        bodies=(
            body(FOOT, foot.shape, start, mass_kg=foot.mass_kg),
            replace(ground(), pose=level),
        ),
        contacts=(contact(FOOT, "ground", friction=friction),),
        duration_s=seconds,
    )


def _scenario(
    kind: str, foot: FootGeometry, seconds: float, **placed: float
) -> Scenario:
    scene = foot_scene(foot, friction=_friction(foot), seconds=seconds, **placed)
    softer = {} if foot.softening is None else {"inverse_weight_scale": foot.softening}
    is_calm = kind == "hold"
    return Scenario(
        f"foot-{kind}-{foot.digest}",
        f"SlopeSlider-{1 if is_calm else 2}-{MATERIAL}",
        seconds,
        scene,
        CALM_INTERVAL_S if is_calm else Scenario.interval_s,
        released=() if "lift_m" in placed else (FOOT,),
        engine_settings=dict.fromkeys(SOFTENED_BY_INVERSE_WEIGHT, softer),
    )


def _friction(foot: FootGeometry) -> float:
    return real_friction(MATERIAL) if foot.friction is None else foot.friction


def _source(law: str, foot: FootGeometry) -> str:
    of = f"of the cube of {MATERIAL}" if foot.friction is None else "of the target"
    return f"{law}, with mu = {_friction(foot):.3g} {of}"


# --- on a slope ------------------------------------------------------------------------------------------------------


def creep(foot: FootGeometry) -> ObjectCheck:
    """Return the creep of a foot at rest on a slope."""
    steepest = float(np.degrees(np.arctan(HOLD_PUSH * _friction(foot))))
    slope = min(HOLD_DEG, steepest)
    check = creeping(
        f"creep of the foot on {slope:.3g} degrees",
        _scenario("hold", foot, HOLD_S, slope_deg=slope),
        _source(f"law: Coulomb, tan {slope:.3g} deg < mu", foot),
        f"measured: the published trials of the {MATERIAL} cube allow no faster creep (paper, Table 5)",
    )
    return replace(check, needs=(Need.FRICTION, Need.FOOT))


def push(foot: FootGeometry) -> ObjectCheck:
    """Return the acceleration of a foot that gravity just moves."""
    friction = real_friction(MATERIAL)
    slope_deg = float(np.degrees(np.arctan(PUSH * friction)))
    return _sliding("push", f"pushed with {PUSH:g} mu N", slope_deg, foot)


def steep_slide(foot: FootGeometry) -> ObjectCheck:
    """Return the acceleration of a foot on the measured board."""
    return _sliding("slide", f"on {SLIDE_DEG:.0f} degrees", SLIDE_DEG, foot)


def _sliding(
    kind: str, where: str, slope_deg: float, foot: FootGeometry
) -> ObjectCheck:
    """Return the acceleration of a foot with the cube's friction on a slope."""
    foot = replace(foot, friction=None)
    friction, slope = _friction(foot), np.radians(slope_deg)
    real = Reality(
        G * float(np.sin(slope) - friction * np.cos(slope)),
        slide(MATERIAL).reality.tolerance,
        _source(f"law: g (sin a - mu cos a) on {slope_deg:.3g} deg", foot),
        f"measured: covers {COVERAGE:.0%} of real slides of the {MATERIAL} cube on {SLIDE_DEG:.0f} degrees",
    )
    scenario = _scenario(kind, foot, SLIDE_S, slope_deg=slope_deg)
    title = f"acceleration of the foot {where}"
    check = downhill(title, scenario, "m/s^2", real, acceleration)
    return replace(check, needs=(Need.FRICTION, Need.FOOT))


# --- landing ---------------------------------------------------------------------------------------------------------


def _landed(
    foot: FootGeometry,
    title: str,
    unit: str,
    law: str,
    tolerance: float,
    rationale: str,
    value: Callable[[Recording], float],
    **attributes: Any,
) -> ObjectCheck:
    """Return the check of a foot that lands, whose value is 0 by a law."""
    source = _source(law, foot)
    return ObjectCheck(
        title,
        _scenario("landing", foot, LANDING_S, lift_m=DROP_M),
        unit,
        Reality(0.0, tolerance, source, rationale),
        value,
        needs=(Need.FOOT,),
        **attributes,
    )


def depth(foot: FootGeometry) -> ObjectCheck:
    """Return the depth of a foot in the ground after a drop."""
    return _landed(
        foot,
        f"depth of the foot after a drop of {1e3 * DROP_M:.0f} mm",
        "mm",
        "rigid bodies do not overlap",
        DEPTH_MM,
        "a rubber ball of 20 mm radius (2 MPa) that lands with 3 kg is compressed as much (Hertz)",
        lambda rollout: -1e3 * float(lowest_m(rollout, FOOT, foot.soles_m).min()),
    )
