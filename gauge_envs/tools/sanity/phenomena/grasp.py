"""Grasps: creep, sink-in and torque of a box between two pads; and the resistance of a rolling ball.

Scenes, laws and tolerances of a grasp are those of the conformance checks; the contacts have the target's constants.
"""

import csv
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from gauge_envs.references.tables import read_content, scoring_folder
from gauge_envs.runs.rollout import Rollout
from gauge_envs.scene import GRAVITY_M_PER_S2 as G, Scene
from gauge_envs.tools.conformance import (
    OBJECT,
    WEIGHT_N,
    Measurement,
    ball,
    box_inertia_kg_m2,
    checks,
    contact,
    grasp_creep,
    grasp_scene,
    grasp_sink,
    ground,
    torque_share,
)
from gauge_envs.tools.sanity.model import Reality
from gauge_envs.tools.sanity.phenomena.base import Phenomenon
from gauge_envs.tools.sanity.scenario import Scenario

SPIN_RAD_PER_S, TURN_S = 20.0, 0.15
"""Spin of the box about the axis of the pads at the start, and simulated time [s]; Coulomb's law stops it later."""

ROLL_M_PER_S, RADIUS_M, ROLL_S = 0.3, 0.03, 0.5
"""Speed of a ball at the start, its radius, and simulated time."""


def _replaced(_: Scene, *, scene: Scene) -> Scene:
    return scene


def _scenario(name: str, scene: Scene) -> Scenario:
    change = partial(_replaced, scene=scene)
    return Scenario(name=name, variant="SlopeSlider-1-wood", seconds=scene.duration_s, change=change)


def _checked(id: str, quantity: str, scenario: Scenario, measure: Callable[[Rollout], Measurement]) -> Phenomenon:
    """Return a row with the law and the tolerance of a conformance check."""
    (known,) = checks([id])
    law = 0.0 if id != "grasp-torsion" else torque_share(0.0).expected
    tolerance, source = known.tolerance, f"{known.source}: {known.law}"
    return Phenomenon(
        title=f"grasp: {known.title}",
        quantity=quantity,
        scenario=scenario,
        unit=known.unit,
        reality=Reality.law(law, tolerance=tolerance.width(law), source=source, rationale=tolerance.rationale),
        needs_friction=True,
        value=lambda rollout: measure(rollout).measured,
    )


def held(id: str, quantity: str) -> Phenomenon:
    """Return the creep or the sink-in of a box that its pads hold with twice the friction that it needs."""
    scenario = _scenario("grasp", grasp_scene(2.0 * WEIGHT_N, 1.5))
    return _checked(id, quantity, scenario, {"grasp-creep": grasp_creep, "grasp-sink": grasp_sink}[id])


def turned() -> Phenomenon:
    """Return the torque of pads on a box that spins between them, from its loss of energy."""
    spun = replace(OBJECT, angular_velocity_rad_per_s=(SPIN_RAD_PER_S, 0.0, 0.0))
    scenario = _scenario("grasp-turn", grasp_scene(2.0 * WEIGHT_N, TURN_S, held=spun, gravity=0.0))

    def share(rollout: Rollout) -> Measurement:
        spin = rollout.angular_velocity("object")[:, 0]
        angle = float(np.trapezoid(spin, rollout.times_s))
        return torque_share(0.5 * box_inertia_kg_m2(OBJECT)[0] * float(spin[0] ** 2 - spin[-1] ** 2) / angle)

    return _checked("grasp-torsion", "torque", scenario, share)


def rolling() -> Phenomenon:
    """Return the torque against rolling over the normal force, from a ball's loss of energy on its path."""
    spin = (0.0, ROLL_M_PER_S / RADIUS_M, 0.0)
    start = ball("ball", (0.0, 0.0, RADIUS_M), radius_m=RADIUS_M)
    rolls = replace(start, linear_velocity_m_per_s=(ROLL_M_PER_S, 0.0, 0.0), angular_velocity_rad_per_s=spin)
    scene = Scene(bodies=(rolls, ground()), contacts=(contact("ball", "ground", friction=0.5),), duration_s=ROLL_S)

    def arm_mm(rollout: Rollout) -> float:
        speed, path = rollout.states["ball"][-1, 7], rollout.displacement("ball")[-1, 0]
        return float(700.0 * RADIUS_M * (ROLL_M_PER_S**2 - speed**2) / (G * path))

    table = read_content(scoring_folder("facts") / "friction_tables.csv").decode()
    most = max(csv.DictReader(table.splitlines()), key=lambda row: float(row["rolling_mm"] or 0.0))
    most_mm = float(most["rolling_mm"])
    real = Reality.law(
        0.0,
        tolerance=most_mm,
        source=f"rolling friction of {most['name']}, {most['source']} (gauge list materials)",
        rationale="the largest of the published pairs; a rigid ball has none",
    )
    return Phenomenon(
        title="rolling friction: torque against rolling over the normal force",
        quantity="rolling friction",
        scenario=_scenario("roll", scene),
        unit="mm",
        reality=replace(real, limits=f"at most {most_mm:g}"),
        needs_friction=True,
        value=arm_mm,
    )
