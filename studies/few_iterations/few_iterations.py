"""What too few solver iterations do to sliding friction in MuJoCo, MJX and mujoco_warp.

    python -m studies.few_iterations.few_iterations cases                 sliding bodies, C MuJoCo
    python -m studies.few_iterations.few_iterations cases --engine warp   the same on mujoco_warp, or MJX (`mjx`)
    python -m studies.few_iterations.few_iterations cause                 interventions on the solver

It builds plain MJCF and uses nothing of gauge-envs. A body rests on level ground for 0.3 s with a converged solver, and
is then pushed. The bodies of the map cannot rotate, so that none tips. The CSV files of
this folder hold the tables. MJX is not a dependency of gauge-envs: `pip install mujoco-mjx` in an environment of its
own.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial

import mujoco
import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

G = 9.81
SETTLE_S = 0.3
"""Time in which a body comes to rest with a converged solver [s]."""

CONVERGED_ITERATIONS, CONVERGED_LS = 100, 50


@dataclass(frozen=True)
class Options:
    """Options of MuJoCo, with the values of MuJoCo Playground's Go1 and Spot as defaults."""

    timestep: float = 0.004
    iterations: int = 1
    ls_iterations: int = 5
    cone: str = "pyramidal"
    impratio: float = 1.0
    solver: str = "Newton"
    integrator: str = "Euler"
    warmstart: bool = True
    eulerdamp: bool = False
    solref: str = "0.02 1"
    solimp: str = "0.9 0.95 0.001 0.5 2"

    @property
    def converged(self) -> Options:
        """The same options with enough iterations."""
        return replace(
            self, iterations=CONVERGED_ITERATIONS, ls_iterations=CONVERGED_LS
        )


FREE = "<freejoint/>"


@dataclass(frozen=True)
class Body:
    """A body on the ground: geoms, mass [kg], height of the centre [m], sliding friction, and degrees of freedom."""

    geoms: str
    mass: float
    height: float
    friction: float
    joints: str = FREE


UPRIGHT = "".join(
    f'<joint type="slide" axis="{axis}"/>' for axis in ("1 0 0", "0 1 0", "0 0 1")
)
FEET = "".join(
    f'<geom type="sphere" size="0.023" pos="{x} {y} -0.247" mass="0"/>'
    for x in (-0.19, 0.19)
    for y in (-0.13, 0.13)
)


def cube(mass: float = 0.1, friction: float = 0.6, joints: str = FREE) -> Body:
    """Return a cube of 5 cm, which has four contacts."""
    return Body(
        f'<geom type="box" size="0.025 0.025 0.025" mass="{mass}"/>',
        mass,
        0.025,
        friction,
        joints,
    )


def sphere(mass: float = 0.1, friction: float = 0.6, joints: str = UPRIGHT) -> Body:
    """Return a sphere, which has one contact."""
    return Body(
        f'<geom type="sphere" size="0.025" mass="{mass}"/>',
        mass,
        0.025,
        friction,
        joints,
    )


def feet(mass: float = 12.0, friction: float = 0.6, joints: str = FREE) -> Body:
    """Return a trunk on four rigid spherical feet of the size of Go1's."""
    trunk = f'<geom type="box" size="0.18 0.05 0.05" mass="{mass}" contype="0" conaffinity="0"/>'
    return Body(trunk + FEET, mass, 0.27, friction, joints)


@lru_cache
def model_of(body: Body, options: Options) -> mujoco.MjModel:
    """Return a body on a plane."""
    o = options
    warmstart, eulerdamp = (
        "enable" if flag else "disable" for flag in (o.warmstart, o.eulerdamp)
    )
    return mujoco.MjModel.from_xml_string(f"""
    <mujoco>
      <option timestep="{o.timestep}" iterations="{o.iterations}" ls_iterations="{o.ls_iterations}" cone="{o.cone}"
              impratio="{o.impratio}" solver="{o.solver}" integrator="{o.integrator}">
        <flag warmstart="{warmstart}" eulerdamp="{eulerdamp}"/>
      </option>
      <default>
        <geom friction="{body.friction} 0 0" solref="{o.solref}" solimp="{o.solimp}" condim="3"/>
      </default>
      <worldbody>
        <geom type="plane" size="50 50 1"/>
        <body pos="0 0 {body.height}">{body.joints}{body.geoms}</body>
      </worldbody>
    </mujoco>""")


@lru_cache
def rest(
    body: Body, options: Options, slope: float = 0.0
) -> tuple[FloatArray, FloatArray]:
    """Return positions and accelerations of a body at rest on level ground, with the normal load of a slope [rad]."""
    model = model_of(body, options.converged)
    model.opt.gravity[:] = 0.0, 0.0, -G * np.cos(slope)
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, nstep=round(SETTLE_S / options.timestep))
    return data.qpos.copy(), data.qacc_warmstart.copy()


def at_rest(body: Body, options: Options) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Return a model and its state at rest."""
    model = model_of(body, options)
    model.opt.gravity[:] = 0.0, 0.0, -G
    data = mujoco.MjData(model)
    data.qpos[:], data.qacc_warmstart[:] = rest(body, options)
    return model, data


SLIDE_S, CASE_S = 0.4, 0.5
"""Time of a push in the map, and time over which the acceleration of a case is the mean [s]."""

STICKS, SLIDES = 0.2, 0.8
"""Shares of the speed that Coulomb's law gives: below the first a body sticks, above the second it slides."""

# --- cases -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Case:
    """A body on a slope [rad], pushed along it besides by a multiple of its weight."""

    title: str
    body: Body
    slope: float = 0.0
    push: float = 0.0

    @property
    def gravity(self) -> FloatArray:
        """Weight and push per mass in the frame of the slope [m/s^2], shape [3]."""
        return G * np.array([np.sin(self.slope) + self.push, 0.0, -np.cos(self.slope)])

    @property
    def law(self) -> float:
        """Acceleration of a body that slides [m/s^2]."""
        along, _, into = self.gravity
        return float(max(0.0, along + self.body.friction * into))


CASES = (
    Case(
        "cube of 5 cm, mu 0.274, 30 degrees",
        cube(friction=0.274),
        slope=np.radians(30.0),
    ),
    Case("12 kg on four feet, mu 0.6, 35 degrees", feet(), slope=np.radians(35.0)),
    Case("12 kg on four feet, mu 0.6, 40 degrees", feet(), slope=np.radians(40.0)),
    Case(
        "12 kg on four feet, mu 0.3, level, pushed with 1.5 mu m g",
        feet(friction=0.3),
        push=0.45,
    ),
)
PYRAMIDAL = {
    "1 / 5, 4 ms": Options(),
    "2 / 5, 2.5 ms": Options(iterations=2, timestep=0.0025),
    "3 / 5, 2 ms": Options(iterations=3, timestep=0.002),
    "4 / 8, 10 ms": Options(iterations=4, ls_iterations=8, timestep=0.01),
    "10 / 20, 5 ms": Options(iterations=10, ls_iterations=20, timestep=0.005),
    "100 / 50, 4 ms": Options().converged,
}
ELLIPTIC = {
    f"{name}, elliptic": replace(PYRAMIDAL[name], cone="elliptic")
    for name in ("1 / 5, 4 ms", "100 / 50, 4 ms")
}
COLUMNS = PYRAMIDAL | ELLIPTIC


def acceleration(case: Case, options: Options) -> float:
    """Return the mean acceleration of a case along the slope in C MuJoCo [m/s^2]."""
    model, data = case_start(case, options)
    mujoco.mj_step(model, data, nstep=round(CASE_S / options.timestep))
    return float(data.qvel[0]) / CASE_S


def case_start(case: Case, options: Options) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Return the model of a case, and its state at rest."""
    model = model_of(case.body, options)
    data = mujoco.MjData(model)
    data.qpos[:], data.qacc_warmstart[:] = rest(case.body, options, case.slope)
    model.opt.gravity[:] = case.gravity
    return model, data


def acceleration_warp(case: Case, options: Options) -> float:
    """Return the same for mujoco_warp, on the CPU where there is no GPU."""
    import warp

    warp.config.quiet = True
    import mujoco_warp

    model, data = case_start(case, options)
    device_model, device_data = (
        mujoco_warp.put_model(model),
        mujoco_warp.put_data(model, data, nconmax=16, njmax=64),
    )
    device_model.opt.warn_overflow = 0
    for _ in range(round(CASE_S / options.timestep)):
        mujoco_warp.step(device_model, device_data)
    return float(device_data.qvel.numpy()[0, 0]) / CASE_S


def acceleration_mjx(case: Case, options: Options) -> float:
    """Return the same for MJX in JAX."""
    import jax
    from mujoco import mjx

    model, data = case_start(case, options)
    device_model = mjx.put_model(model, impl="jax")
    step = jax.jit(
        lambda state: jax.lax.fori_loop(
            0, steps, lambda _, one: mjx.step(device_model, one), state
        )
    )
    steps = round(CASE_S / options.timestep)
    return float(step(mjx.put_data(model, data, impl="jax")).qvel[0]) / CASE_S


ENGINES = {"c": acceleration, "warp": acceleration_warp, "mjx": acceleration_mjx}


def cases(engine: str = "c") -> Iterable[list[str]]:
    """Yield the rows of the table of cases."""
    yield ["case", "Coulomb", *COLUMNS]
    for case in CASES:
        yield [
            case.title,
            f"{case.law:.2f}",
            *(f"{ENGINES[engine](case, one):.2f}" for one in COLUMNS.values()),
        ]


# --- map -------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Push:
    """A push along the ground in multiples of mu m g, an initial speed [m/s], and the direction of both [rad]."""

    load: float
    speed: float
    direction: float = 0.0


MAPPED = {
    "sphere": partial(sphere, joints=UPRIGHT),
    "cube": partial(cube, joints=UPRIGHT),
}
MAPPED |= {"four feet": partial(feet, joints=UPRIGHT)}


def push_body(
    body: Body, options: Options, push: Push, seconds: float = SLIDE_S
) -> tuple[float, float]:
    """Return speed [m/s] and displacement [m] of a body in the direction of a push after some time."""
    model, data = at_rest(body, options)
    along = np.array([np.cos(push.direction), np.sin(push.direction), 0.0])
    start = data.qpos[:3].copy()
    data.xfrc_applied[1, :3] = push.load * body.friction * body.mass * G * along
    data.qvel[:3] = push.speed * along
    mujoco.mj_step(model, data, nstep=round(seconds / options.timestep))
    return float(data.qvel[:3] @ along), float((data.qpos[:3] - start) @ along)


def speed_share(body: Body, options: Options, push: Push) -> float:
    """Return the speed of a body that a push accelerates, over the one that Coulomb's law gives."""
    speed, _ = push_body(body, options, push)
    return speed / (push.speed + (push.load - 1.0) * body.friction * G * SLIDE_S)


def braking_share(body: Body, options: Options, speed: float) -> float:
    """Return the distance in which a free body stops, or that it moves in a second, over that of Coulomb's law."""
    slowing = body.friction * G
    seconds = min(1.0, speed / slowing)
    _, distance = push_body(body, options, Push(0.0, speed), seconds)
    return distance / (speed * seconds - 0.5 * slowing * seconds**2)


# --- cause -----------------------------------------------------------------------------------------------------------


def start_from(
    case: Case, options: Options, *, given_s: float, noise: float = 0.0
) -> float:
    """Return the acceleration [m/s^2] where the solver starts from the converged solution for some time.

    Args:
        case: Body and slope.
        options: Options of the solver under test.
        given_s: Time during which each step starts from the converged accelerations [s].
        noise: Size of a random change of that start, relative to each acceleration.
    """
    model, data = case_start(case, options)
    converged = model_of(case.body, options.converged)
    converged.opt.gravity[:] = case.gravity
    solved, random = mujoco.MjData(converged), np.random.default_rng(0)
    for step in range(round(CASE_S / options.timestep)):
        if step * options.timestep < given_s:
            solved.qpos[:], solved.qvel[:], solved.qacc_warmstart[:] = (
                data.qpos,
                data.qvel,
                data.qacc_warmstart,
            )
            mujoco.mj_forward(converged, solved)
            data.qacc_warmstart[:] = solved.qacc * (
                1.0 + noise * random.uniform(-1.0, 1.0, model.nv)
            )
        mujoco.mj_step(model, data)
    return float(data.qvel[0]) / CASE_S


def force_acceleration(case: Case, options: Options) -> float:
    """Return the mean acceleration that weight and contact forces would give the body [m/s^2]."""
    model, data = case_start(case, options)
    forces = []
    for _ in range(round(CASE_S / options.timestep)):
        mujoco.mj_step(model, data)
        forces.append(data.qfrc_smooth[0] + data.qfrc_constraint[0])
    return float(np.mean(forces)) / case.body.mass


def cause() -> Iterable[list[str]]:
    """Yield the accelerations with interventions on the solver."""
    titles = ("cube, 30 degrees", "four feet, 40 degrees")
    chosen = dict(zip(titles, (CASES[0], CASES[2]), strict=True))
    yield ["intervention", *titles]
    yield ["Coulomb's law", *(f"{case.law:.2f}" for case in chosen.values())]
    settings = {
        "none: 1 iteration, 5 of the line search": Options(),
        "50 iterations of the line search": Options(ls_iterations=50),
        "no warm start": Options(warmstart=False),
        "no warm start, 50 iterations of the line search": Options(
            warmstart=False, ls_iterations=50
        ),
        "2 iterations": Options(iterations=2),
        "3 iterations": Options(iterations=3),
        "4 iterations": Options(iterations=4),
        "integrator implicitfast": Options(integrator="implicitfast"),
        "elliptic cone": Options(cone="elliptic"),
        "elliptic cone, no warm start": Options(cone="elliptic", warmstart=False),
        "elliptic cone, 3 iterations": Options(cone="elliptic", iterations=3),
    }
    for name, options in settings.items():
        yield [
            name,
            *(f"{acceleration(case, options):.2f}" for case in chosen.values()),
        ]
    for name, options in {
        "1 iteration": Options(),
        "100 iterations": Options().converged,
    }.items():
        yield [
            f"{name}, by the contact forces",
            *(f"{force_acceleration(case, options):.2f}" for case in chosen.values()),
        ]
    starts = {"every step starts from the converged solution": (np.inf, 0.0)}
    starts["the same, each acceleration changed by up to 1 %"] = (np.inf, 0.01)
    starts |= {
        f"the first {seconds:g} s start from it": (seconds, 0.0)
        for seconds in (0.02, 0.1)
    }
    for name, (seconds, noise) in starts.items():
        row = [
            start_from(case, Options(), given_s=seconds, noise=noise)
            for case in chosen.values()
        ]
        yield [name, *(f"{value:.2f}" for value in row)]


# --- command line ----------------------------------------------------------------------------------------------------


def show(rows: Iterable[list[str]]) -> None:
    """Print a table in Markdown."""
    for number, row in enumerate(rows):
        print("| " + " | ".join(row) + " |", flush=True)
        if number == 0:
            print("|" + "---|" * len(row))
    print()


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the chosen tables; return the exit status."""
    parser = argparse.ArgumentParser(
        description="What too few solver iterations do to sliding friction."
    )
    parser.add_argument("part", choices=("cases", "cause"))
    parser.add_argument(
        "--engine", choices=tuple(ENGINES), default="c", help="engine of `cases`"
    )
    options = parser.parse_args(arguments)
    show(cases(options.engine) if options.part == "cases" else cause())
    return 0


if __name__ == "__main__":
    sys.exit(main())
