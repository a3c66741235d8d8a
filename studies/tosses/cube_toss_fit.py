"""Best friction, restitution and contact stiffness of each engine on real tosses of a cube, jointly.

    python cube_toss_fit.py fit ENGINE OUT [--tosses 40] [--first 32] [--second 16] [--set KEY=VALUE ...]
    python cube_toss_fit.py report OUT          the table of the study

Constants are fitted on even tosses that repeat no earlier one. `cube_toss.py run` judges them on odd ones. The first
points fill the box of the constants, the second ones half of it about the minimum of the first.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from cube_toss import loss, shots, toss
from numpy.typing import NDArray
from scipy.interpolate import RBFInterpolator
from scipy.stats import qmc
from toss_errors import shot_error
from tosses import write

FloatArray = NDArray[np.float64]
Changes = tuple[dict[str, float], dict[str, Any]]
SMOOTHINGS = (1e-3, 1e-2, 1e-1, 1.0, 10.0)
"""Candidates for the smoothing of the surrogate; leave-one-out errors choose."""

MASS_KG = 0.37
GRID = 31
"""Values of each constant at which the surrogate is evaluated."""

DRAWS = 1000
WIDE = 10.5
"""Ratio of bounds above which a constant is searched by its logarithm."""

FRICTION, RESTITUTION, FREQUENCY_HZ = (0.08, 0.30), (0.0, 0.6), (15.0, 400.0)
DAMPING_RATIO = (0.15, 1.5)


@dataclass(frozen=True)
class Space:
    """Constants that are fitted for an engine.

    Attributes:
        names: Name of each constant.
        bounds: Bounds of each constant; wide ones are searched by the logarithm.
        changes: Function from values to constants of the scene and settings of the engine.
    """

    names: tuple[str, ...]
    bounds: tuple[tuple[float, float], ...]
    changes: Callable[[Sequence[float]], Changes]

    def values(self, unit: FloatArray) -> list[float]:
        """Return the constants at a point of the unit cube."""
        return [
            low * (high / low) ** float(x)
            if low > 0.0 and high / low > WIDE
            else low + float(x) * (high - low)
            for x, (low, high) in zip(unit, self.bounds, strict=True)
        ]


def _time_constant_s(damping_ratio: float, frequency_hz: float) -> float:
    """Return MuJoCo's time constant of a contact: the inverse of damping ratio times angular frequency."""
    return 1.0 / (2.0 * np.pi * frequency_hz * damping_ratio)


def _mujoco(values: Sequence[float]) -> Changes:
    friction, ratio, frequency_hz = values
    return {"cube.friction": friction}, {
        "contact_solref": (_time_constant_s(ratio, frequency_hz), ratio)
    }


def _newton(values: Sequence[float]) -> Changes:
    constants, settings = _mujoco(values)
    # Impedance as of the impacts of this package, and friction with the time constant of the contact. The solver takes
    # time constants of at least two steps; half the preset's rate is enough for them here.
    more = {
        "contact_solimp": (0.99, 0.99, 0.001, 0.5, 2.0),
        "contact_kf_n_s_per_m": -1.0,
        "timestep_s": 1.0 / 1800.0,
    }
    return constants, settings | more


def _with_restitution(values: Sequence[float]) -> dict[str, float]:
    return {"cube.friction": values[0], "cube.restitution": values[1]}


def _drake(values: Sequence[float]) -> Changes:
    # 3600 steps a second suffice for these frequencies, and the preset's 9000 are slower.
    rate = 2.0 * np.pi * values[2] / 3600.0
    return _with_restitution(values), {"impact_rate": rate, "timestep_s": 1.0 / 3600.0}


def _rapier(values: Sequence[float]) -> Changes:
    springs = {
        "static_contact_damping_ratio": values[1],
        "static_contact_frequency_hz": values[2],
    }
    return {"cube.friction": values[0], "cube.restitution": 0.0}, springs


def _rapier_rebound(values: Sequence[float]) -> Changes:
    # With a restitution of 0.02 the loss is larger than with none, so each has a space of its own.
    return _with_restitution(values), {"static_contact_frequency_hz": values[2]}


def _pybullet(values: Sequence[float]) -> Changes:
    friction, ratio, frequency_hz = values
    stiffness = MASS_KG * (2.0 * np.pi * frequency_hz) ** 2
    springs = {
        "contact_stiffness_n_per_m": stiffness,
        "contact_damping_n_s_per_m": 2.0 * ratio * float(np.sqrt(stiffness * MASS_KG)),
        "split_impulse": "none",
    }
    return {"cube.friction": friction, "cube.restitution": 0.0}, springs


def _rigid(values: Sequence[float]) -> Changes:
    return _with_restitution(values), {}


SPRINGS = (
    ("friction", "damping_ratio", "frequency_hz"),
    (FRICTION, DAMPING_RATIO, FREQUENCY_HZ),
)
REBOUNDS = (
    ("friction", "restitution", "frequency_hz"),
    (FRICTION, RESTITUTION, FREQUENCY_HZ),
)
SPACES: dict[str, Space] = {
    "mujoco": Space(*SPRINGS, _mujoco),
    "newton": Space(SPRINGS[0], (FRICTION, (0.4, 1.5), (15.0, 90.0)), _newton),
    "drake": Space(REBOUNDS[0], (FRICTION, RESTITUTION, (13.0, 150.0)), _drake),
    "rapier": Space(SPRINGS[0], (FRICTION, (0.3, 12.0), FREQUENCY_HZ), _rapier),
    "rapier-rebound": Space(*REBOUNDS, _rapier_rebound),
    "physx": Space(("friction", "restitution"), (FRICTION, RESTITUTION), _rigid),
    "pybullet": Space(*SPRINGS, _pybullet),
}
"""Constants of each engine, or of one of its kinds of contact.

The frequency is that of the cube on its contact spring: sqrt(stiffness / mass) / 2 pi.
"""


def losses_at(
    engine: str, trials: Sequence[int], changes: Changes, settings: Mapping[str, Any]
) -> list[float]:
    """Return the loss of each toss."""
    constants, own = changes
    found = []
    engine = engine.partition("-")[0]
    for trial, times_s, positions_m, rotations in toss(
        engine, trials, constants=constants, settings={**settings, **own}
    ):
        error = shot_error(shots().shot(trial), times_s, positions_m, rotations)
        found.append(loss({"mean_mm": error.mean_mm, "mean_deg": error.mean_deg}))
    return found


def surrogate(points: FloatArray, values: FloatArray) -> FloatArray:
    """Return weights of the losses at the points, whose sum is the smooth surrogate on the grid, [grid, points].

    Args:
        points: Points in the unit cube, shape [count, dimension].
        values: Mean loss at each, shape [count]; it chooses the smoothing by leave-one-out errors.
    """
    count, dimension = points.shape

    def error(smoothing: float) -> float:
        smooth = RBFInterpolator(points, np.eye(count), smoothing=smoothing)(points)
        return float(
            np.mean(((values - smooth @ values) / (1.0 - np.diag(smooth))) ** 2)
        )

    best = min(SMOOTHINGS, key=error)
    axes = np.meshgrid(*[np.linspace(0.0, 1.0, GRID)] * dimension, indexing="ij")
    grid = np.stack([axis.ravel() for axis in axes], axis=1)
    return np.asarray(RBFInterpolator(points, np.eye(count), smoothing=best)(grid))


def place(index: int, dimension: int) -> FloatArray:
    """Return a point of the grid in the unit cube."""
    return np.array(np.unravel_index(index, (GRID,) * dimension)) / (GRID - 1.0)


def fit(options: argparse.Namespace) -> None:
    """Write the losses of each toss at the points of the design."""
    space = SPACES[options.engine]
    settings = {
        key: json.loads(value)
        for key, value in (text.split("=", 1) for text in options.set)
    }
    even, independent = range(0, len(shots()), 2), set(shots().trials("fit"))
    chosen = [
        even[index]
        for index in np.linspace(0, len(even) - 1, options.tosses).round().astype(int)
    ]
    trials = [trial for trial in chosen if trial in independent]
    dimension, start = len(space.names), time.process_time()
    points = qmc.Sobol(dimension, seed=0).random(options.first)
    losses = [
        losses_at(options.engine, trials, space.changes(space.values(point)), settings)
        for point in points
    ]
    mean = np.mean(losses, axis=1)
    centre = place(int(np.argmin(surrogate(points, mean) @ mean)), dimension)
    low = np.clip(centre - 0.25, 0.0, 0.5)
    more = low + 0.5 * qmc.Sobol(dimension, seed=1).random(options.second)
    losses += [
        losses_at(options.engine, trials, space.changes(space.values(point)), settings)
        for point in more
    ]
    content = {
        "engine": options.engine,
        "settings": settings,
        "trials": trials,
        "points": np.concatenate([points, more]).tolist(),
        "losses": losses,
        "cpu_s": time.process_time() - start,
    }
    name = options.name or f"joint-{options.engine}"
    write(options.out, name, content)
    print(name, best(content))


def best(content: Mapping[str, Any]) -> dict[str, Any]:
    """Return the constants of the least mean loss with 95 % bootstrap intervals over tosses, and the loss there."""
    space, points = SPACES[content["engine"]], np.array(content["points"])
    losses = np.array(content["losses"])
    weights = surrogate(points, losses.mean(axis=1))
    dimension, count = points.shape[1], losses.shape[1]
    resample = (
        np.random.default_rng(0)
        .multinomial(count, np.full(count, 1.0 / count), DRAWS)
        .T
        / count
    )
    at = int(np.argmin(weights @ losses.mean(axis=1)))
    drawn = np.array(
        [
            space.values(place(int(index), dimension))
            for index in np.argmin(weights @ losses @ resample, 0)
        ]
    )
    found: dict[str, Any] = {
        name: [value, *np.percentile(drawn[:, column], [2.5, 97.5]).tolist()]
        for column, (name, value) in enumerate(
            zip(space.names, space.values(place(at, dimension)), strict=True)
        )
    }
    return found | {
        "loss": float((weights @ losses.mean(axis=1))[at]),
        "tosses": count,
        "cpu_s": content["cpu_s"],
    }


def report(options: argparse.Namespace) -> None:
    """Print the best constants of each engine."""
    for file in sorted(options.out.glob("joint-*.json")):
        found = best(json.loads(file.read_text()))
        texts = [
            f"{key} {v[0]:.3g} [{v[1]:.3g}, {v[2]:.3g}]"
            for key, v in found.items()
            if isinstance(v, list)
        ]
        print(
            f"| {file.stem} | {found['tosses']} | {' | '.join(texts)} | {found['loss']:.3f} | {found['cpu_s']:.0f} s |"
        )


def main() -> None:
    """Run one of the commands."""
    parser = argparse.ArgumentParser(
        description="Best contact constants of each engine on real tosses of a cube."
    )
    commands = parser.add_subparsers(required=True)
    for function in (fit, report):
        command = commands.add_parser(function.__name__)
        command.set_defaults(function=function)
        if function is fit:
            command.add_argument("engine", choices=sorted(SPACES))
        command.add_argument("out", type=Path)
        command.add_argument("--tosses", type=int, default=40)
        command.add_argument("--first", type=int, default=32)
        command.add_argument("--second", type=int, default=16)
        command.add_argument("--set", nargs="*", default=[])
        command.add_argument("--name")
    options = parser.parse_args()
    options.function(options)


if __name__ == "__main__":
    main()
