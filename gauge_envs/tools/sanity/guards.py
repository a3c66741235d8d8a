"""Guard for changes of contact settings: cubes that slide fast must stay on the ground.

A soft contact damps the sliding speed like the normal one. Where it stops a body within a step, friction mu lifts a
body that slides at v with mu v, and the body hops by mu^2 v^2 / (2 g): 54 mm at 4 m/s. At 2 ms, time constants of two
steps hop by 58 mm, MuJoCo's default of ten steps by 5 mm, and this package's preset by 1 mm.
"""

import math
from functools import cache

from gauge_envs.scene import GRAVITY_M_PER_S2 as G, Scene
from gauge_envs.tools.bench.parts import box, contact, ground, thrown
from gauge_envs.tools.bench.recording import Recording
from gauge_envs.tools.sanity.measure import Measurements
from gauge_envs.tools.sanity.model import Settings, Verdict
from gauge_envs.tools.sanity.phenomena.base import (
    Phenomenon,
    lowest_m,
    rigid_law,
)
from gauge_envs.tools.sanity.scenario import Scenario

FRICTION = 0.257
"""Friction of the measured wooden cube (scoring/facts/slope_slider_30deg_summary.toml)."""

CUBES = ((1.0, 0.02, 0.05), (1.0, 0.1, 5.0), (4.0, 0.02, 5.0), (4.0, 0.1, 0.05))
"""Speed [m/s], edge [m] and mass [kg] of cubes. Hops grow with the square of the speed; mass matters to springs of a
fixed stiffness, and height to bodies that tip."""

SLIDE_S = 0.6
"""Simulated time [s]: all hops reach their top in it, and the slower cubes stop after 0.4 s."""

MIN_HOP_MM, HOP_SCATTER = 5.0, 2.0
"""Hop of a quarter of the smaller cube [mm]; and ratio within which hops scatter for one time constant, with either
cone and with `impratio` 1 to 100."""

STOP_TOLERANCE = 0.1
"""Relative tolerance of a stopping distance: the friction of real cubes scatters by up to 8 % (slope_slider_30deg)."""


@cache
def hop() -> Phenomenon:
    """Return the height to which cubes hop while they slide."""
    cubes = {
        thrown(
            box(
                f"{speed} m/s, {edge} m",
                (0.0, speed + 10.0 * edge, 0.5 * edge),
                (edge,) * 3,
                mass_kg=kg,
            ),
            (speed, 0.0, 0.0),
        ): speed
        for speed, edge, kg in CUBES
    }
    names = tuple(cube.name for cube in cubes)
    scene = Scene(
        bodies=(*cubes, ground()),
        contacts=(contact(names, "ground", friction=FRICTION),),
        duration_s=SLIDE_S,
    )

    def highest_mm(rollout: Recording) -> float:
        heights = (lowest_m(rollout, cube.name, cube.shape.corners_m) for cube in cubes)
        return 1e3 * max(float((height - height[0]).max()) for height in heights)

    def wrong_stop(rollout: Recording) -> str:
        """Return which stopping distance is not Coulomb's v^2 / (2 mu g); empty when all are."""
        for cube, speed in cubes.items():
            way_m = rollout.displacement(cube.name)[-1, 0]
            share = 2.0 * FRICTION * G * way_m / speed**2
            if speed < FRICTION * G * SLIDE_S and abs(share - 1.0) > STOP_TOLERANCE:
                return (
                    f"a cube of {speed:g} m/s slides {share:.2f} of Coulomb's distance"
                )
        return ""

    return Phenomenon(
        "height to which a cube hops while it slides at up to 4 m/s",
        Scenario(
            "slide-hop",
            "SlopeSlider-2-wood",
            SLIDE_S,
            given=scene,
            released=names,
        ),
        "mm",
        rigid_law(
            "a rigid body that slides on a plane stays on it",
            MIN_HOP_MM,
            "the edge of 20 mm of a cube",
        ),
        highest_mm,
        wrong_stop,
        needs_friction=True,
    )


def hop_mm(measurements: Measurements, settings: Settings) -> float:
    """Return the largest height that cubes gain while they slide with some settings [mm].

    It is infinite where the simulation diverges or cubes do not stop where they must, and NaN where it is not measured.
    """
    measured = measurements.measure(hop(), settings)
    if measured.verdict is Verdict.DECLINED:
        return math.nan
    return math.inf if measured.remark else float(measured.value or 0.0)


def hops_more(before_mm: float, after_mm: float) -> bool:
    """Return whether sliding bodies hop visibly more after a change; False where a hop was not measured."""
    return after_mm > max(MIN_HOP_MM, HOP_SCATTER * before_mm)
