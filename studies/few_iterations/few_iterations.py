"""What too few solver iterations do to sliding friction in MuJoCo, MJX and mujoco_warp.

    cd studies/few_iterations
    python few_iterations.py cases                 table of sliding bodies, C MuJoCo
    python few_iterations.py cases --engine warp   the same on mujoco_warp (`warp`) or MJX (`mjx`)
    python few_iterations.py map                   where it holds: loads, speeds, masses, frictions, steps
    python few_iterations.py cause                 interventions on the solver
    python few_iterations.py randomized            what randomizing friction does

It builds plain MJCF and uses nothing of gauge-envs. A body rests on level ground for 0.3 s with a converged solver, and
is then pushed. The bodies of the map cannot rotate, so that none tips. The CSV files of
this folder hold the tables. MJX is not a dependency of gauge-envs: `pip install mujoco-mjx` in an environment of its
own.
"""

from __future__ import annotations

import argparse
import itertools
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import mujoco
import numpy as np
from sliding_bodies import (
    UPRIGHT,
    Body,
    FloatArray,
    G,
    Options,
    at_rest,
    cube,
    feet,
    model_of,
    rest,
    sphere,
)

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


LOADS, SPEEDS = (1.25, 1.5, 2.0, 3.0), (0.0, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0)
PUSHES = tuple(itertools.starmap(Push, itertools.product(LOADS, SPEEDS)))
DIAGONAL = tuple(replace(push, direction=np.radians(45.0)) for push in PUSHES)
MAPPED = {
    "sphere": partial(sphere, joints=UPRIGHT),
    "cube": partial(cube, joints=UPRIGHT),
}
MAPPED |= {"four feet": partial(feet, joints=UPRIGHT)}
BRAKED = (0.3, 1.0, 3.0)


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


VARIED: dict[str, list[tuple[str, Options, dict[str, float]]]] = {
    "iterations": [
        (str(n), Options(iterations=n), {}) for n in (1, 2, 3, 4, 5, 6, 8, 10, 100)
    ],
    "ls_iterations": [
        (str(n), Options(ls_iterations=n), {}) for n in (1, 5, 10, 20, 50)
    ],
    "step": [
        (f"{1e3 * dt:g} ms", Options(timestep=dt), {})
        for dt in (0.001, 0.002, 0.004, 0.01)
    ],
    "mass": [
        (f"{mass:g} kg", Options(), {"mass": mass}) for mass in (0.1, 1.0, 12.0, 50.0)
    ],
    "friction": [
        (f"{mu:g}", Options(), {"friction": mu}) for mu in (0.1, 0.3, 0.6, 1.0, 1.5)
    ],
    "solref": [
        (value, Options(solref=value), {})
        for value in ("0.005 1", "0.01 1", "0.02 1", "0.04 1")
    ],
    "solimp": [
        (value, Options(solimp=value), {})
        for value in (
            "0.9 0.95 0.001 0.5 2",
            "0.9 0.95 0.023 0.5 2",
            "0.9 0.95 0.036 0.5 2",
            "0 0.8 0.01 0.5 2",
        )
    ],
    "impratio": [
        (f"{value:g}", Options(impratio=value), {}) for value in (1.0, 10.0, 100.0)
    ],
    "integrator": [
        (value, Options(integrator=value), {}) for value in ("Euler", "implicitfast")
    ],
    "implicitfast, iterations": [
        (str(n), Options(integrator="implicitfast", iterations=n), {})
        for n in (2, 3, 4, 100)
    ],
    "warm start": [
        (text, Options(warmstart=text == "on"), {}) for text in ("on", "off")
    ],
    "solver": [(value, Options(solver=value), {}) for value in ("Newton", "CG", "PGS")],
    "cone": [(value, Options(cone=value), {}) for value in ("pyramidal", "elliptic")],
    "elliptic, iterations": [
        (str(n), Options(cone="elliptic", iterations=n), {}) for n in (1, 2, 3, 4)
    ],
    "elliptic, warm start off": [
        (str(n), Options(cone="elliptic", iterations=n, warmstart=False), {})
        for n in (1, 2, 3, 4)
    ],
    "elliptic, 1 iteration, impratio": [
        (f"{value:g}", Options(cone="elliptic", impratio=value), {})
        for value in (1.0, 10.0, 100.0)
    ],
}
"""What is varied, one thing at a time, about the options of Go1 and Spot."""


def spread(shares: Sequence[float]) -> list[str]:
    """Return what a row of the map states about many shares: bodies that stick, that slide, and quantiles."""
    values = np.array(shares)
    low, middle, high = np.quantile(values, (0.05, 0.5, 0.95))
    return [
        f"{np.mean(values < STICKS):.0%}",
        f"{np.mean(values > SLIDES):.0%}",
        f"{low:.2f}",
        f"{middle:.2f}",
        f"{high:.2f}",
    ]


def shares_of(
    options: Options, constants: dict[str, float], pushes: Sequence[Push] = PUSHES
) -> list[float]:
    """Return the shares of speed of all bodies under all pushes."""
    return [
        speed_share(build(**constants), options, push)
        for build in MAPPED.values()
        for push in pushes
    ]


def varied() -> Iterable[list[str]]:
    """Yield the rows of the map that varies one thing at a time."""
    yield ["varied", "value", "stick", "slide", "5 %", "median", "95 %"]
    for name, values in VARIED.items():
        for text, options, constants in values:
            yield [name, text, *spread(shares_of(options, constants))]
    for iterations in (1, 2, 3, 4, 100):
        shares = shares_of(Options(iterations=iterations), {}, DIAGONAL)
        yield ["iterations, pushed diagonally", str(iterations), *spread(shares)]


def crossed() -> Iterable[list[str]]:
    """Yield the shares of cases that stick and slide over all combinations of masses, frictions and steps."""
    yield ["iterations", "cases", "stick", "slide", "5 %", "median", "95 %"]
    grid = list(
        itertools.product(
            (0.1, 12.0, 50.0), (0.1, 0.3, 0.6, 1.0, 1.5), (0.001, 0.002, 0.004, 0.01)
        )
    )
    for iterations in (1, 2, 3, 4, 10):
        shares = []
        for mass, friction, step in grid:
            options = Options(iterations=iterations, timestep=step)
            shares += shares_of(options, {"mass": mass, "friction": friction})
        yield [str(iterations), str(len(shares)), *spread(shares)]


def by_load_and_speed(iterations: int) -> Iterable[list[str]]:
    """Yield the smallest and largest share of speed over bodies, for loads by initial speeds."""
    yield [f"{iterations} iterations", *(f"{speed:g} m/s" for speed in SPEEDS)]
    for load in LOADS:
        row = [f"{load:g} mu m g"]
        for speed in SPEEDS:
            options = Options(iterations=iterations)
            shares = [
                speed_share(build(), options, Push(load, speed))
                for build in MAPPED.values()
            ]
            row.append(f"{min(shares):.2f} to {max(shares):.2f}")
        yield row


def braking() -> Iterable[list[str]]:
    """Yield the distances in which bodies stop without a push, over those of Coulomb's law."""
    yield ["body", "initial speed", *PYRAMIDAL, *ELLIPTIC]
    for (name, build), speed in itertools.product(MAPPED.items(), BRAKED):
        yield [
            name,
            f"{speed:g} m/s",
            *(f"{braking_share(build(), one, speed):.2f}" for one in COLUMNS.values()),
        ]


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


# --- randomized friction ---------------------------------------------------------------------------------------------

RANDOM_COUNT = 500
FRICTION_RANGE = (0.4, 1.0)
"""Range of the ground's friction in Playground's randomization of Go1."""


def randomized() -> Iterable[list[str]]:
    """Yield the spread of accelerations over random frictions of the ground, for three pushes in multiples of m g."""
    yield [
        "push",
        "options",
        "mean",
        "standard deviation",
        "5 %",
        "95 %",
        "correlation with mu",
    ]
    frictions = np.random.default_rng(0).uniform(*FRICTION_RANGE, RANDOM_COUNT)
    for push in (0.5, 0.7, 1.2):
        law = np.maximum(0.0, push - frictions) * G
        yield [f"{push:g} m g", "Coulomb's law", *statistics(law, frictions)]
        for name in (
            "1 / 5, 4 ms",
            "3 / 5, 2 ms",
            "100 / 50, 4 ms",
            "1 / 5, 4 ms, elliptic",
            "100 / 50, 4 ms, elliptic",
        ):
            found = [
                push_body(
                    feet(friction=mu, joints=UPRIGHT),
                    COLUMNS[name],
                    Push(push / mu, 0.0),
                )[0]
                / SLIDE_S
                for mu in frictions
            ]
            yield [f"{push:g} m g", name, *statistics(np.array(found), frictions)]


def statistics(values: FloatArray, frictions: FloatArray) -> list[str]:
    """Return mean, standard deviation, quantiles, and correlation with friction, as texts."""
    low, high = np.quantile(values, (0.05, 0.95))
    numbers = [f"{value:.2f}" for value in (values.mean(), values.std(), low, high)]
    return [*numbers, f"{np.corrcoef(values, frictions)[0, 1]:.2f}"]


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
    parser.add_argument("part", choices=("cases", "map", "cause", "randomized"))
    parser.add_argument(
        "--engine", choices=tuple(ENGINES), default="c", help="engine of `cases`"
    )
    options = parser.parse_args(arguments)
    if options.part == "cases":
        show(cases(options.engine))
    elif options.part == "map":
        for rows in (
            *map(by_load_and_speed, (1, 2, 3, 4)),
            braking(),
            varied(),
            crossed(),
        ):
            show(rows)
    else:
        show(cause() if options.part == "cause" else randomized())
    return 0


if __name__ == "__main__":
    sys.exit(main())
