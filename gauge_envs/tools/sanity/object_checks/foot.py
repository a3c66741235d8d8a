"""Foot of a robot on the measured boards: creep, slip and slide.

The foot has the solids and the load of the configuration. It rests with the configuration's friction, and slides with
the friction of the measured wooden cube. The values are laws; measurements of wooden cubes say how far a real body may
differ from them. Without a configuration, the checks have the foot of a small quadruped.
"""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs.fixtures.parts import body, contact, ground
from gauge_envs.scene import GRAVITY_M_PER_S2 as G, Pose, Scene
from gauge_envs.tools.sanity.object_checks.check import (
    ObjectCheck,
    Scenario,
    acceleration,
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


# --- scenes ----------------------------------------------------------------------------------------------------------


def _scenario(
    kind: str, foot: FootGeometry, seconds: float, slope_deg: float
) -> Scenario:
    """Return four copies of a foot in one rigid body, on an even ground that slopes along x."""
    slope = Rotation.from_euler("y", slope_deg, degrees=True)
    level = Pose.from_rotation((0.0, 0.0, 0.0), slope)
    feet = body(FOOT, foot.shape, level, mass_kg=foot.mass_kg)
    scene = Scene(
        bodies=(feet, replace(ground(), pose=level)),
        contacts=(contact(FOOT, "ground", friction=_friction(foot)),),
        duration_s=seconds,
    )
    softer = {} if foot.softening is None else {"inverse_weight_scale": foot.softening}
    is_calm = kind == "hold"
    return Scenario(
        f"foot-{kind}-{foot.digest}",
        f"SlopeSlider-{1 if is_calm else 2}-{MATERIAL}",
        seconds,
        scene,
        CALM_INTERVAL_S if is_calm else Scenario.interval_s,
        released=(FOOT,),
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
