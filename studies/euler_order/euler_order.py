"""What another order of the published rotations would change, for each experiment that has more than one.

    python -m studies.euler_order.euler_order     prints the table of the study

The metadata give angles about x, y and z, and no order. The package rotates about the fixed x, then y, then z axis.
With one angle of zero, the twelve orders about fixed or own axes are only two rotations.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import permutations

import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs import load_experiment, reference_band
from gauge_envs.evaluation.laws import free_flight
from gauge_envs.evaluation.metrics.trajectory import trajectory_rmse
from gauge_envs.experiments.experiment import TaskExperiment
from gauge_envs.experiments.task_format import Placement
from gauge_envs.experiments.variants import variants
from gauge_envs.pages.text import markdown_row
from gauge_envs.references.published import published_baselines
from gauge_envs.runs.episodes import run_episode
from gauge_envs.runs.request import RunRequest

ASSUMED = "xyz"
"""Order of the package: about the fixed axes, as SciPy writes it."""

COLUMNS = (
    "id",
    "angles [deg]",
    "rotation between the orders [deg]",
    "largest displacement of a corner [mm]",
    "first contact [s]",
    "RMSE between the two simulations [mm]",
    "over the published baseline",
    "RMSE to the law [mm]",
)


@dataclass(frozen=True, kw_only=True)
class OtherOrder:
    """The start of one body in the assumed order and in the other one.

    Attributes:
        variant: Name of the variant.
        body: Name of the body.
        euler_deg: Published angles [deg].
        other_deg: Angles that give the other rotation in the assumed order [deg].
        apart_deg: Angle between the two rotations [deg].
        corner_mm: Largest distance between the two places of a corner [mm].
    """

    variant: str
    body: str
    euler_deg: tuple[float, ...]
    other_deg: tuple[float, float, float]
    apart_deg: float
    corner_mm: float


def published_angles(
    experiment: TaskExperiment,
) -> dict[str, tuple[float, float, float]]:
    """Return the published angles [deg] of each body for which the order of rotations matters."""
    spec = experiment.spec
    tables = [spec.initial]
    if experiment.variant.subtask:
        tables.append(spec.subtasks[experiment.variant.subtask].initial)
    starts: dict[str, Placement] = {}
    for table in tables:
        for material in ("all", experiment.variant.material):
            starts |= table.get(material, {})
    derived = {
        key.split(".")[-2]
        for key, origin in spec.provenance.items()
        if key.endswith(".euler_deg") and origin.startswith("derived")
    }
    return {
        name: start.euler_deg
        for name, start in starts.items()
        if name not in derived and sum(angle != 0.0 for angle in start.euler_deg) > 1
    }


def other_orders() -> Iterator[OtherOrder]:
    """Yield each published start whose order of rotations matters.

    Raises:
        ValueError: More than two rotations are possible, which the table has no rows for.
    """
    for variant in variants():
        experiment = load_experiment(variant)
        for body, angles in published_angles(experiment).items():
            assumed = Rotation.from_euler(ASSUMED, angles, degrees=True)
            orders = ["".join(order) for order in permutations("xyz")]
            by_axis = dict(zip("xyz", angles, strict=True))
            rotations = [
                Rotation.from_euler(
                    order.upper() if own else order,
                    [by_axis[axis] for axis in order],
                    degrees=True,
                )
                for order in orders
                for own in (False, True)
            ]
            apart = np.array(
                [(assumed.inv() * rotation).magnitude() for rotation in rotations]
            )
            different = [
                rotation
                for rotation, angle in zip(rotations, apart, strict=True)
                if angle > 1e-9
            ]
            if len({round(float(angle), 9) for angle in apart if angle > 1e-9}) != 1:
                raise ValueError(
                    f"{variant.name}: {body} has more than two possible rotations"
                )
            other = different[0]
            corners = experiment.scene.body(body).shape.corners_m
            x, y, z = other.as_euler(ASSUMED, degrees=True).tolist()
            yield OtherOrder(
                variant=variant.name,
                body=body,
                euler_deg=angles,
                other_deg=(x, y, z),
                apart_deg=math.degrees(float(apart.max())),
                corner_mm=1e3
                * float(
                    np.linalg.norm(
                        assumed.apply(corners) - other.apply(corners), axis=1
                    ).max()
                ),
            )


def row(order: OtherOrder) -> list[str]:
    """Return the cells of one start, simulated in both orders with the default engine."""
    changed = {f"{order.body}.euler_deg": order.other_deg}
    flights = [
        free_flight(load_experiment(order.variant, parameters).scene, order.body)
        for parameters in ("calibrated", changed)
    ]
    results = [
        run_episode(RunRequest(order.variant, parameters=chosen))
        for chosen in ("calibrated", changed)
    ]
    frames = [
        result.trajectory.arrays()[1][::6]
        for result in results
        if result.trajectory is not None
    ]
    between = trajectory_rmse(frames[0], frames[1])
    baseline = published_baselines(order.variant)["rmse"].mean
    band = reference_band(load_experiment(order.variant))
    assert band is not None
    return [
        order.variant,
        " / ".join(f"{angle:g}" for angle in order.euler_deg),
        f"{order.apart_deg:.2f}",
        f"{order.corner_mm:.2f}",
        " / ".join(f"{flight.end_s:.4f}" for flight in flights),
        f"{between:.2f}",
        f"{between / baseline:.2f}",
        " / ".join(f"{result.score.rmse:.3f}" for result in results),
    ]


def main() -> None:
    """Print the table."""
    print(markdown_row(COLUMNS))
    print(markdown_row(["---"] * len(COLUMNS)))
    for order in other_orders():
        print(markdown_row(row(order)))


if __name__ == "__main__":
    main()
