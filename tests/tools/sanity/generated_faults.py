"""Mistakes drawn by chance: a class of mistakes, a robot, and the joint, link, geom or servo that has it.

The classes were written before the rows that name them: units, signs, frames, ranges, default classes, masses, inertia,
gains, limits, friction, couplings, delays and steps. Digests of names draw, so that the cases stay the same.
"""

import csv
import hashlib
import math
import random
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from more_faults import GOOD

from gauge_envs.tools.sanity import configuration
from gauge_envs.tools.sanity.phenomena import ROBOT_IDS
from gauge_envs.tools.sanity.robot.finding import limits_of
from gauge_envs.tools.sanity.robot.joints import (
    driven_dofs,
    joint_inertias,
    servo_gains,
    servos,
    stiffness,
)
from gauge_envs.tools.sanity.robot.mass_rows import size_m
from gauge_envs.tools.sanity.robot.motions import PUSH_SHARES, hold_pose, pushed_m
from gauge_envs.tools.sanity.robot.robot import Robot
from gauge_envs.tools.sanity.target_checks import robot_row

EVERY = ("arm", "quadruped", "biped", "hand")
LEGGED = ("quadruped", "biped")
FOOTED = ("quadruped", "biped", "hand")
HAND = ("hand",)


@dataclass(frozen=True)
class Fault:
    """A class of mistakes.

    Attributes:
        rows: Rows of which at least one names it.
        robots: Robots that can have it.
        plant: Plants it in a spec, at a place that a generator draws.
    """

    rows: tuple[str, ...]
    robots: tuple[str, ...]
    plant: Callable[[mujoco.MjSpec, random.Random], None]


def servo(change, *, scale=1.0):
    """Return a function that changes a servo."""
    return lambda spec, chance: change(chance.choice(list(spec.actuators)), scale)


def kp(actuator, scale):
    """Scale the stiffness of a servo."""
    actuator.gainprm[0] *= scale
    actuator.biasprm[1] *= scale


def kv(actuator, scale):
    """Scale the damping of a servo."""
    actuator.biasprm[2] *= scale


def torque(actuator, scale):
    """Scale the largest torque of a servo."""
    actuator.forcerange = actuator.forcerange * scale


def turned(actuator, scale):
    """Turn the gear of a servo."""
    actuator.gear[0] = -scale


def narrow(actuator, scale):
    """Give a servo commands of a tenth of a radian."""
    actuator.ctrllimited, actuator.ctrlrange = 1, [-0.1 * scale, 0.1 * scale]


def half(spec, chance):
    """Let the commands of a servo reach half of the range of its joint."""
    actuator = chance.choice(list(spec.actuators))
    unit = math.radians(1.0) if spec.compiler.degree else 1.0
    actuator.ctrllimited = 1
    actuator.ctrlrange = 0.5 * unit * spec.joint(actuator.target).range


def of_speed(actuator, scale):
    """Give a servo a speed to hold."""
    actuator.biasprm[1], actuator.biasprm[2] = 0.0, -scale * actuator.gainprm[0]


def pushing(actuator, _):
    """Let a servo push its joint away."""
    actuator.biasprm[1] *= -1.0


def geared(actuator, _):
    """State the ratio of the gear beside a torque of the joint."""
    actuator.gear[0] *= 100.0


def swapped(spec, chance):
    """Let two motors act on the joints of each other."""
    for one in spec.actuators:
        one.name = one.target
    first, second = chance.sample(list(spec.actuators), 2)
    first.target, second.target = second.target, first.target


def filtered(actuator, scale):
    """Give a servo a filter of half a second."""
    actuator.dyntype = mujoco.mjtDyn.mjDYN_FILTER
    actuator.dynprm[0] = 0.5 * scale


def unlimited(spec, _):
    """Take the largest torques away."""
    for actuator in spec.actuators:
        actuator.forcelimited, actuator.forcerange = 0, [0.0, 0.0]


def joint(change):
    """Return a function that changes a driven joint."""

    def plant(spec, chance):
        targets = {actuator.target for actuator in spec.actuators}
        change(chance.choice([one for one in spec.joints if one.name in targets]), spec)

    return plant


def attribute(name, value):
    """Return a function that gives a joint a value, by its old one."""

    def change(one, _):
        old = np.array(getattr(one, name), dtype=float)
        new = value(old)
        setattr(one, name, float(new) if np.ndim(new) == 0 else new)

    return joint(change)


def elsewhere(one, spec):
    """Give a joint a range without its pose."""
    one.range = [57.0, 115.0] if spec.compiler.degree else [1.0, 2.0]


def soft_stop(one, _):
    """Make the stop of a joint soft."""
    one.solref_limit, one.solimp_limit = [0.4, 1.0], [0.5, 0.6, 0.01, 0.5, 2.0]


def throwing(one, _):
    """Let the stop of a joint throw it back."""
    one.solref_limit = [0.02, 0.02]


def sprung(one, _):
    """Leave a spring beside the motor of a joint."""
    one.stiffness = np.eye(3)[0] * 2.0 if np.ndim(one.stiffness) else 2.0


def bare(one, _):
    """Take the class of a joint away."""
    one.armature, one.frictionloss, one.damping = 0.0, 0.0, [0.0, 0.0, 0.0]


def link(change, *, suffixes=("",)):
    """Return a function that changes a link with an explicit inertia."""

    def plant(spec, chance):
        names = [body.name for body in spec.bodies if body.name.endswith(suffixes)]
        body = spec.body(chance.choice([name for name in names if name != "world"]))
        model = spec.copy().compile()
        number = model.body(body.name).id
        body.explicitinertial, body.mass = True, float(model.body_mass[number])
        for name in ("ipos", "iquat", "inertia"):
            setattr(body, name, getattr(model, f"body_{name}")[number].copy())
        change(body)

    return plant


def weight(mass, inertia):
    """Return a function that scales the mass and the inertia of a link."""

    def change(body):
        body.mass *= mass
        body.inertia = body.inertia * inertia

    return link(change)


def away(body):
    """Give the centre of mass in another frame."""
    body.ipos = body.ipos + np.array([0.3, 0.4, 0.5])


def at_origins(spec, _):
    """Put all centres of mass at the origins of their links."""
    model = spec.copy().compile()
    for body in spec.bodies[1:]:
        body.explicitinertial, body.ipos = True, [0.0, 0.0, 0.0]
        body.mass = float(model.body(body.name).mass[0])
        body.inertia = model.body(body.name).inertia


def weightless(body):
    """Let a link float."""
    body.gravcomp = 1.0


def crossed(body):
    """Put a limb to the other side."""
    body.pos = body.pos * np.array([1.0, -1.0, 1.0])


def bent(body):
    """Turn a link about y."""
    body.quat = [math.cos(0.4), 0.0, math.sin(0.4), 0.0]


def geom(change, *, suffixes=("",)):
    """Return a function that changes a geom of the robot."""

    def plant(spec, chance):
        several = [
            one
            for one in spec.geoms
            if one.name not in ("floor", "base") and one.name.endswith(suffixes)
        ]
        change(chance.choice(several))

    return plant


def sole(**attributes):
    """Return a function that gives attributes to a geom that touches."""

    def change(one):
        for name, value in attributes.items():
            setattr(one, name, value)

    return geom(change, suffixes=("_foot", "_pad"))


def large(one):
    """State the size of a geom in centimetres."""
    one.size = one.size * 100.0


def drawn(one):
    """Double a geom by a visual one with a mass."""
    copied = ("type", "size", "pos", "quat", "fromto", "mass", "density")
    one.parent.add_geom(
        name=f"{one.name}_visual",
        contype=0,
        conaffinity=0,
        group=2,
        **{name: getattr(one, name) for name in copied},
    )


def coupling(change):
    """Return a function that changes an equality."""
    return lambda spec, chance: change(chance.choice(list(spec.equalities)))


def ratio(one):
    """Give a coupling a ratio per degree."""
    one.data[1] = 57.3


def reverse(one):
    """Turn a coupling round."""
    one.data[1] *= -1.0


def off(one):
    """Switch a coupling off."""
    one.active = 0


def zero(one):
    """Give a coupling another zero."""
    one.data[0] = -0.4


def option(**attributes):
    """Return a function that gives the options values."""

    def plant(spec, _):
        for name, value in attributes.items():
            setattr(spec.option, name, value)

    return plant


def fault(rows, plant, robots=EVERY):
    """Return a class of mistakes; two sides, or the middle one, tell most of them."""
    names = [f"robot-{name}" for name in (*rows.split(), "sides", "alike")]
    return Fault((*names, "gravity"), robots, plant)


DEGREE = math.degrees(1.0)
EULER = mujoco.mjtIntegrator.mjINT_EULER
SLIPPERY, GLUED, STICKY = [0.03, 0.005, 1e-4], [0.8, 0.3, 0.3], [6.0, 0.005, 1e-4]

CLASSES = {
    "a link in grams": fault("density", weight(1e3, 1e3)),
    "a link in tonnes": fault("density inertia", weight(1e-3, 1.0)),
    "a link of 20 times its mass": fault("density", weight(20.0, 20.0)),
    "a link of ten times its mass": fault("density", weight(10.0, 10.0)),
    "an inertia in kg mm^2": fault("inertia", weight(1.0, 1e6)),
    "an inertia in t m^2": fault("inertia", weight(1.0, 1e-3)),
    "a centre of mass in the frame of the world": fault("inertia", link(away)),
    "a weightless link": fault("gravcomp", link(weightless)),
    "a limb on the other side": fault(
        "level mirror balance overlap", link(crossed, suffixes=("_thigh",)), LEGGED
    ),
    "a bent shin": fault(
        "level balance mirror", link(bent, suffixes=("_calf", "_shin")), LEGGED
    ),
    "a kp per degree": fault(
        "sag stiffness torque loads lag", servo(kp, scale=1 / DEGREE)
    ),
    "a kp times 57": fault("stiffness servo lag", servo(kp, scale=DEGREE)),
    "a kv times 57": fault("lag servo damping", servo(kv, scale=DEGREE)),
    "a servo without kv": fault("lag servo", servo(kv, scale=0.0)),
    "a torque in N cm": fault(
        "torque saturation loads sag frictionloss", servo(torque, scale=0.01)
    ),
    "a torque in N mm": fault("torque rotor", servo(torque, scale=1e3)),
    "no largest torques": fault("torque", unlimited),
    "a turned command": fault("command", servo(turned)),
    "a narrow command": fault("command", servo(narrow)),
    "a command of half a range": fault("command", half),
    "a servo of speed": fault("command", servo(of_speed)),
    "a servo that pushes": fault("command", servo(pushing)),
    "a gear beside its torque": fault("torque command", servo(geared)),
    "a spring": fault("sag", joint(sprung)),
    "a stop that throws back": fault("stops", joint(throwing)),
    "centres of mass at origins": fault("inertia", at_origins, ("arm", *LEGGED)),
    "two swapped motors": fault("command", swapped),
    "a filter": fault("delay", servo(filtered)),
    "a range of degrees as radians": fault(
        "range mirror", attribute("range", lambda old: DEGREE * old)
    ),
    "a range of radians as degrees": fault(
        "range mirror", attribute("range", lambda old: old / DEGREE)
    ),
    "a range without the pose": fault("range stops mirror", joint(elsewhere)),
    "a soft stop": fault("stops", joint(soft_stop)),
    "a damping per degree": fault(
        "damping lag",
        attribute("damping", lambda old: 60.0 * np.maximum(old, [0.1, 0.0, 0.0])),
    ),
    "a negative damping": fault(
        "damping", attribute("damping", lambda old: -2.0 * old - [0.02, 0.0, 0.0])
    ),
    "an armature in g cm^2": fault(
        "armature", attribute("armature", lambda old: 1e4 * old)
    ),
    "a lost armature": fault(
        "rotor armature dry", attribute("armature", lambda old: 1e-3 * old)
    ),
    "a friction in N cm": fault(
        "frictionloss", attribute("frictionloss", lambda old: 100.0 * old + 1.0)
    ),
    "a joint without its class": fault("rotor dry", joint(bare)),
    "an axis of another frame": fault(
        "mirror range", attribute("axis", lambda old: np.roll(old, 1)), LEGGED
    ),
    "a geom in centimetres": fault("size density", geom(large)),
    "a drawn geom with mass": fault("visual-mass", geom(drawn)),
    "a foot that cannot touch": fault(
        "feet friction", sole(contype=0, conaffinity=0), FOOTED
    ),
    "a foot of condim 1": fault("friction", sole(condim=1, priority=2), FOOTED),
    "a slippery foot": fault("friction", sole(friction=SLIPPERY, priority=2), FOOTED),
    "a glued foot": fault(
        "torsion", sole(condim=6, friction=GLUED, priority=2), FOOTED
    ),
    "a sticky foot": fault("friction", sole(friction=STICKY, priority=2), FOOTED),
    "a coupling per degree": fault("coupling", coupling(ratio), HAND),
    "a turned coupling": fault("coupling", coupling(reverse), HAND),
    "a coupling with another zero": fault("coupling", coupling(zero), HAND),
    "a coupling that is off": fault("coupling", coupling(off), HAND),
    "a step of 30 ms": fault(
        "servo energy lag holds stands", option(timestep=0.03, integrator=EULER)
    ),
    "gravity along y": fault("", option(gravity=[0.0, -9.81, 0.0])),
}
"""Classes of mistakes by name."""


def cases() -> dict[str, tuple[str, str]]:
    """Return the robot and the class of each case, by a name with both."""
    return {
        f"{robot}, {name}": (robot, name)
        for name, one in CLASSES.items()
        for robot in one.robots
    }


def planted(case: str) -> mujoco.MjSpec:
    """Return a robot with a mistake."""
    robot, name = cases()[case]
    spec = mujoco.MjSpec.from_string(GOOD[robot]())
    chance = random.Random(hashlib.sha256(case.encode()).hexdigest())
    CLASSES[name].plant(spec, chance)
    return mujoco.MjSpec.from_string(spec.to_xml())


POPULATION = Path(__file__).parents[3] / "studies/robots/population.csv"
"""Least and largest value of each number of `numbers` in makers' robots."""


def numbers(robot: Robot) -> Iterator[tuple[str, float]]:
    """Yield the numbers by which rows judge a robot, part by part, and what it does; infinite for one that is flagged.

    A number is a ratio that does not depend on the size of the robot, or a time or an angle. Zeros are left out.
    """
    for name in ROBOT_IDS:
        row = robot_row(name, robot)
        for part in row.parts:
            if row.is_flag and part.verdict.is_off:
                yield name, np.inf
            elif not part.verdict.is_off:
                yield name, part.value
    model = robot.model
    weight_nm = robot.mass_kg * 9.81 * size_m(robot)
    damping = model.dof_damping + servo_gains(model, 2)
    ranges = np.ptp(model.jnt_range[model.dof_jntid], axis=1)
    limbs = joint_inertias(robot) - model.dof_armature
    for dof, limit_nm in driven_dofs(robot).items():
        kp = stiffness(model, dof)
        of_joint = {
            "torque over weight": limit_nm / weight_nm,
            "torque over inertia": limit_nm / joint_inertias(robot)[dof],
            "torque over armature": limit_nm / max(model.dof_armature[dof], 1e-12),
            "kp over torque": kp / limit_nm,
            "kp over weight": kp / weight_nm,
            "kp over inertia": kp / joint_inertias(robot)[dof],
            "damping over kp": damping[dof] / max(kp, 1e-12),
            "damping over torque": damping[dof] / limit_nm,
            "dry friction over torque": model.dof_frictionloss[dof] / limit_nm,
            "armature over limb": model.dof_armature[dof] / max(limbs[dof], 1e-12),
            "range": ranges[dof],
        }
        is_stated = {
            "torque": np.isfinite(limit_nm),
            "kp": kp > 0.0,
            "armature": model.dof_armature[dof] > 0.0,
        }
        for name, value in of_joint.items():
            if all(is_stated.get(word, True) for word in name.split()):
                yield name, float(value)
    motion = hold_pose(robot)
    yield "error of the held pose", motion.pose_error_rad
    yield "height of the held pose", motion.height_ratio
    if servos(model).any():
        for share, moved_m in zip(PUSH_SHARES, pushed_m(robot), strict=True):
            yield f"push of {share:g} weights", float(moved_m) / size_m(robot)


def outside_makers(robot: Robot, right: Robot | None = None) -> tuple[float, str]:
    """Return the largest ratio by which a number of a robot is outside those of makers' robots, and its name.

    Only up to 1 does a mistake in it need a data sheet: in all that rows judge and in what it does it is a usual robot.
    A number of which the robot without the mistake is as far outside does not count.
    """
    usual = {} if right is None else _ratios(right)
    ratios = {
        name: ratio
        for name, ratio in _ratios(robot).items()
        if ratio > max(1.0, usual.get(name, 1.0))
    }
    worst = max(ratios, key=ratios.__getitem__, default="none")
    return ratios.get(worst, 1.0), worst


def _ratios(robot: Robot) -> dict[str, float]:
    """Return the largest ratio by which each number is outside those of makers' robots."""
    with POPULATION.open(encoding="utf-8") as stream:
        known = {row["number"]: row for row in csv.DictReader(stream)}
    ratios: dict[str, float] = {}
    for name, value in numbers(robot):
        ends = known.get(name, {"least": "inf", "largest": "inf"})
        if value and not np.isnan(value):
            ratio = max(float(ends["least"]) / value, value / float(ends["largest"]))
            ratios[name] = max(ratio, ratios.get(name, 0.0))
    return ratios


def write_population(paths: Sequence[str]) -> None:
    """Write the table of makers' robots from their files."""
    several: dict[str, list[float]] = {}
    for path in paths:
        robot = configuration(path).robot
        assert robot is not None
        for name, value in numbers(robot):
            if value and np.isfinite(value):
                several.setdefault(name, []).append(value)
    with POPULATION.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(("number", "least", "largest", "count"))
        for name, values in several.items():
            is_error = name in ROBOT_IDS and limits_of(name)[0] <= 0.0
            least = 0.0 if is_error or name.startswith("error") else min(values)
            ends = (f"{least:.4g}", f"{max(values):.4g}")
            writer.writerow((name, *ends, len(values)))


if __name__ == "__main__":
    write_population(sys.argv[1:])
