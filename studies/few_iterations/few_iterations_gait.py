"""A legged robot under few solver iterations: feet that slip on a slope, and gaits that are searched with them.

    cd studies/few_iterations
    python few_iterations_gait.py standing                              a robot that stands on a slope
    python few_iterations_gait.py gaits [--seeds 3] [--generations 60]  gaits on ground that lets feet slip

A quadruped of primitives has about the masses, lengths, gains and joint friction of Unitree's Go1. A gait is open-loop:
periodic targets of the hips and knees, with diagonal legs in opposite phase. The cross-entropy method searches it for
the distance that it covers. Each gait then runs with each set of options, and with two frictions of the ground.
`standing.csv` and `gaits.csv` hold the tables.
"""

from __future__ import annotations

import argparse
import itertools
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import mujoco
import numpy as np
from mujoco import rollout
from sliding_bodies import FloatArray, G, Options

EPISODE_S, CONTROL_S, SETTLE_S = 3.0, 0.02, 0.4
POPULATION, ELITES, THREADS = 40, 8, 2
EVALUATIONS = 24
"""Episodes of one gait with one set of options and one friction."""

RESAMPLES = 2000
"""Resamples of the bootstrap."""

LEGS = {
    "FL": (0.19, 0.047),
    "FR": (0.19, -0.047),
    "RL": (-0.19, 0.047),
    "RR": (-0.19, -0.047),
}
"""Positions of the abduction joints on the trunk [m]."""

PHASES = {"FL": 0.0, "FR": np.pi, "RL": np.pi, "RR": 0.0}
LINK_M, FOOT_M = 0.213, 0.023
HOME = {"abduction": 0.0, "hip": 0.9, "knee": -1.8}
FEET_START, FOOT_READINGS = 6, 7
"""Index of the first sensor reading of feet, and readings of each foot."""

TOUCH_N = 1.0
"""Normal force above which a foot is in stance [N]."""

FALLEN_HEIGHT_M, FALLEN_UP = 0.15, 0.5
"""Height of the trunk, and cosine of its tilt, below which a robot has fallen."""

OPTIONS = {
    "1 / 5, pyramidal": Options(),
    "100 / 50, pyramidal": Options().converged,
    "100 / 50, elliptic": Options(cone="elliptic").converged,
}
FRICTIONS = (0.6, 0.3)


@dataclass(frozen=True)
class Training:
    """Options of the solver and frictions of the ground under which a gait is searched."""

    options: str
    frictions: tuple[float, float]

    @property
    def title(self) -> str:
        """Short description."""
        low, high = self.frictions
        return f"{self.options}, mu {low:g}" + ("" if low == high else f" to {high:g}")


TRAININGS = (
    Training("1 / 5, pyramidal", (0.6, 0.6)),
    Training("100 / 50, elliptic", (0.6, 0.6)),
    Training("1 / 5, pyramidal", (0.4, 1.0)),
    Training("100 / 50, elliptic", (0.4, 1.0)),
)


def leg(name: str) -> str:
    """Return one leg in MJCF: abduction, hip and knee, with a spherical foot."""
    x, y = LEGS[name]
    side = 0.08 * np.sign(y)
    return f"""
    <body pos="{x} {y} 0">
      <joint name="{name} abduction" class="abduction"/><geom class="mass" size="0.04" mass="0.68"/>
      <body pos="0 {side} 0">
        <joint name="{name} hip" class="hip"/>
        <geom class="mass" type="capsule" fromto="0 0 0 0 0 {-LINK_M}" size="0.02" mass="1.0"/>
        <body pos="0 0 {-LINK_M}">
          <joint name="{name} knee" class="knee"/>
          <geom class="mass" type="capsule" fromto="0 0 0 0 0 {-LINK_M}" size="0.01" mass="0.2"/>
          <geom class="foot" pos="0 0 {-LINK_M}"/>
          <site name="{name}" pos="0 0 {-LINK_M}" size="{1.2 * FOOT_M}"/>
        </body>
      </body>
    </body>"""


def sensors(name: str) -> str:
    """Return the sensors of a foot: normal force [N], velocity [m/s] and angular velocity [rad/s]."""
    kinds = ("framelinvel", "frameangvel")
    frames = "".join(f'<{kind} objtype="site" objname="{name}"/>' for kind in kinds)
    return f'<touch site="{name}"/>{frames}'


@lru_cache
def robot(options: Options, friction: float) -> mujoco.MjModel:
    """Return the quadruped on a plane."""
    o = options
    actuators = "".join(
        f'<position joint="{name} {joint}" class="{joint}"/>'
        for name in LEGS
        for joint in HOME
    )
    return mujoco.MjModel.from_xml_string(f"""
    <mujoco>
      <compiler angle="radian" autolimits="true"/>
      <option timestep="{o.timestep}" iterations="{o.iterations}" ls_iterations="{o.ls_iterations}" cone="{o.cone}"
              gravity="0 0 {-G}">
        <flag eulerdamp="disable"/>
      </option>
      <default>
        <joint armature="0.005" damping="0.5" frictionloss="0.3" axis="0 1 0"/>
        <position kp="35" forcerange="-23.7 23.7"/>
        <default class="abduction"><joint axis="1 0 0" range="-0.86 0.86"/></default>
        <default class="hip"><joint range="-0.69 4.5"/></default>
        <default class="knee">
          <joint range="-2.82 -0.89" frictionloss="1"/><position forcerange="-35.6 35.6"/>
        </default>
        <default class="mass"><geom contype="0" conaffinity="0"/></default>
        <default class="foot">
          <geom size="{FOOT_M}" mass="0.01" contype="0" conaffinity="1"/>
        </default>
      </default>
      <worldbody>
        <geom name="floor" type="plane" size="50 50 1" contype="1" conaffinity="0" priority="1" condim="3"
              friction="{friction}"/>
        <body name="trunk" pos="0 0 0.29">
          <freejoint/>
          <geom class="mass" type="box" size="0.19 0.05 0.055" mass="5.2"/>
          {"".join(map(leg, LEGS))}
        </body>
      </worldbody>
      <actuator>{actuators}</actuator>
      <sensor>
        <framepos objtype="body" objname="trunk"/><framezaxis objtype="body" objname="trunk"/>
        {"".join(map(sensors, LEGS))}
      </sensor>
    </mujoco>""")


def home() -> FloatArray:
    """Return the targets of all joints of a robot that stands [rad], shape [12]."""
    return np.tile(list(HOME.values()), len(LEGS))


# --- standing --------------------------------------------------------------------------------------------------------

STAND_S, SLOPES_DEG = 0.6, (10, 15, 20, 25, 30)
STANDING = OPTIONS | {
    "2 / 5, pyramidal": Options(iterations=2),
    "3 / 5, pyramidal": Options(iterations=3),
    "4 / 8, pyramidal": Options(iterations=4, ls_iterations=8),
    "1 / 5, elliptic": Options(cone="elliptic"),
}


def standing_slip(options: Options, friction: float, slope_deg: float) -> float:
    """Return how far the feet of a robot that holds its pose slip down a slope [m], as the mean of the four.

    The robot settles on level ground with a converged solver. Then gravity tilts, as if the ground were the slope.
    """
    settled = robot(OPTIONS["100 / 50, elliptic"], friction)
    start = mujoco.MjData(settled)
    start.qpos[7:], start.ctrl[:] = home(), home()
    mujoco.mj_step(settled, start, nstep=round(1.0 / settled.opt.timestep))
    model = robot(options, friction)
    data = mujoco.MjData(model)
    data.qpos[:], data.qacc_warmstart[:], data.ctrl[:] = (
        start.qpos,
        start.qacc_warmstart,
        start.ctrl,
    )
    slope, level = np.radians(slope_deg), model.opt.gravity.copy()
    model.opt.gravity[:] = G * np.sin(slope), 0.0, -G * np.cos(slope)
    slip = 0.0
    for _ in range(round(STAND_S / options.timestep)):
        mujoco.mj_step(model, data)
        slip += (
            float(contact_velocity(data.sensordata[FEET_START:])[0].mean())
            * options.timestep
        )
    model.opt.gravity[:] = level
    return slip


def contact_velocity(readings: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the horizontal velocity of the lowest point of each foot [m/s], each of shape [..., 4].

    Args:
        readings: Readings of the sensors of all feet, shape [..., 28].
    """
    feet = readings.reshape(*readings.shape[:-1], len(LEGS), FOOT_READINGS)
    return feet[..., 1] - FOOT_M * feet[..., 5], feet[..., 2] + FOOT_M * feet[..., 4]


def standing() -> None:
    """Print how far the feet slip, for frictions and slopes by options."""
    print("| mu | slope | " + " | ".join(STANDING) + " |")
    print("|" + "---|" * (2 + len(STANDING)))
    for friction, slope in itertools.product(FRICTIONS, SLOPES_DEG):
        slips = [
            f"{1e3 * standing_slip(one, friction, slope):.0f}"
            for one in STANDING.values()
        ]
        print(
            f"| {friction:g} | {slope} degrees | " + " | ".join(slips) + " |",
            flush=True,
        )


# --- gaits -----------------------------------------------------------------------------------------------------------

FREQUENCY_HZ = (1.5, 4.0)
AMPLITUDES_RAD = np.array([0.3, 0.4, 0.4, 0.2, 0.2, 0.3, 0.6, 0.6, 0.3, 0.3])
"""Scales of the parameters of hip and knee: offset, cosine and sine of the phase, and of twice the phase."""

PARAMETER_COUNT = 1 + 2 * len(AMPLITUDES_RAD)
"""Frequency, and the parameters of the front and the rear legs."""


def targets(parameters: FloatArray, step_s: float) -> FloatArray:
    """Return the targets of all joints at each step [rad], shape [step_count, 12]."""
    low, high = FREQUENCY_HZ
    frequency = low + (high - low) / (1.0 + np.exp(-parameters[0]))
    rows = parameters[1:].reshape(2, -1) * AMPLITUDES_RAD
    times = np.floor(np.arange(0.0, EPISODE_S, step_s) / CONTROL_S + 1e-9) * CONTROL_S
    start = np.clip((times - SETTLE_S) / SETTLE_S, 0.0, 1.0)
    wanted = np.tile(home(), (len(times), 1))
    for number, (name, phase) in enumerate(PHASES.items()):
        row = rows[0 if name.startswith("F") else 1]
        angle = 2.0 * np.pi * frequency * times + phase
        waves = np.stack(
            [
                np.ones_like(angle),
                np.cos(angle),
                np.sin(angle),
                np.cos(2 * angle),
                np.sin(2 * angle),
            ]
        )
        wanted[:, 3 * number + 1] += start * (row[:5] @ waves)
        wanted[:, 3 * number + 2] += start * (row[5:] @ waves)
    return wanted


@dataclass(frozen=True)
class Episodes:
    """What some episodes gave, each of shape [episode_count].

    Attributes:
        speed: Mean speed ahead [m/s].
        aside: Displacement to the side at the end [m].
        slip: Mean speed at which the contact points of feet in stance slip [m/s].
        fell: Whether the robot fell.
    """

    speed: FloatArray
    aside: FloatArray
    slip: FloatArray
    fell: FloatArray


def run(
    models: Sequence[mujoco.MjModel],
    gaits: Sequence[FloatArray],
    random: np.random.Generator,
) -> Episodes:
    """Run one episode of each gait on its model, from a random pose near the standing one."""
    first = models[0]
    data = mujoco.MjData(first)
    size = mujoco.mj_stateSize(first, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    states = np.empty((len(gaits), size))
    for state in states:
        mujoco.mj_resetData(first, data)
        data.qpos[7:] = home() + random.uniform(-0.05, 0.05, 12)
        data.qvel[:6] = random.uniform(-0.1, 0.1, 6)
        mujoco.mj_getState(first, data, state, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    control = np.stack([targets(gait, first.opt.timestep) for gait in gaits])
    threads = [mujoco.MjData(first) for _ in range(THREADS)]
    _, found = rollout.rollout(list(models), threads, states, control)
    return episodes(found, first.opt.timestep)


def episodes(found: FloatArray, step_s: float) -> Episodes:
    """Return speed, slip and falls from the sensors, shape [episode_count, step_count, 34]."""
    found = np.nan_to_num(found)
    place, up = found[..., :3], found[..., 5]
    forces = found[..., FEET_START::FOOT_READINGS]
    walking = np.arange(found.shape[1]) * step_s > 2.0 * SETTLE_S
    stance = forces[:, walking] > TOUCH_N
    slips = (np.hypot(*contact_velocity(found[:, walking, FEET_START:])) * stance).sum(
        axis=(1, 2)
    )
    ahead = place[:, -1, 0] - place[:, walking, 0][:, 0]
    fell = ((place[..., 2] < FALLEN_HEIGHT_M) | (up < FALLEN_UP)).any(axis=1)
    return Episodes(
        speed=ahead / (EPISODE_S - 2.0 * SETTLE_S),
        aside=place[:, -1, 1],
        slip=slips / np.maximum(1, stance.sum(axis=(1, 2))),
        fell=fell.astype(np.float64),
    )


def search(training: Training, seed: int, generations: int) -> FloatArray:
    """Return the gait that the cross-entropy method finds.

    Its value is the mean speed ahead less half of the displacement to the side per second; a fall costs 2 m/s.
    """
    random = np.random.default_rng(seed)
    mean, spread = np.zeros(PARAMETER_COUNT), np.ones(PARAMETER_COUNT)
    for _ in range(generations):
        gaits = mean + spread * random.normal(size=(POPULATION, PARAMETER_COUNT))
        frictions = np.round(random.uniform(*training.frictions, POPULATION), 2)
        models = [
            robot(OPTIONS[training.options], float(friction)) for friction in frictions
        ]
        found = run(models, list(gaits), random)
        value = found.speed - 0.5 * np.abs(found.aside) / EPISODE_S - 2.0 * found.fell
        best = gaits[np.argsort(-value)[:ELITES]]
        mean, spread = best.mean(axis=0), np.maximum(best.std(axis=0), 0.05)
    return mean


# --- table -----------------------------------------------------------------------------------------------------------


def interval(groups: Sequence[FloatArray]) -> str:
    """Return the mean over gaits and episodes, with a 95 % interval of the bootstrap over gaits, then episodes."""
    random = np.random.default_rng(0)
    means = []
    for _ in range(RESAMPLES):
        chosen = random.integers(len(groups), size=len(groups))
        means.append(
            np.mean(
                [random.choice(groups[one], len(groups[one])).mean() for one in chosen]
            )
        )
    low, high = np.quantile(means, (0.025, 0.975))
    return f"{np.mean(groups):.2f} ({low:.2f} to {high:.2f})"


def gaits_table(seeds: int, generations: int) -> None:
    """Search the gaits, and print what they do with all options and frictions."""
    print(
        "| searched with | runs with | mu | speed [m/s] | slip in stance [m/s] | falls |",
        flush=True,
    )
    print("|---|---|---|---|---|---|")
    for training in TRAININGS:
        gaits = [search(training, seed, generations) for seed in range(seeds)]
        for name, friction in itertools.product(OPTIONS, FRICTIONS):
            models = [robot(OPTIONS[name], friction)] * EVALUATIONS
            found = [
                run(models, [gait] * EVALUATIONS, np.random.default_rng(100))
                for gait in gaits
            ]
            cells = [
                interval([one.speed for one in found]),
                interval([one.slip for one in found]),
            ]
            fallen = f"{np.mean([one.fell for one in found]):.0%}"
            print(
                "| "
                + " | ".join((training.title, name, f"{friction:g}", *cells, fallen))
                + " |",
                flush=True,
            )


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the chosen table; return the exit status."""
    parser = argparse.ArgumentParser(
        description="A legged robot under few solver iterations."
    )
    parser.add_argument("part", choices=("standing", "gaits"))
    parser.add_argument(
        "--seeds", type=int, default=3, help="gaits that are searched for each row"
    )
    parser.add_argument(
        "--generations", type=int, default=60, help="generations of the search"
    )
    options = parser.parse_args(arguments)
    if options.part == "standing":
        standing()
    else:
        gaits_table(options.seeds, options.generations)
    return 0


if __name__ == "__main__":
    sys.exit(main())
