"""Measure which constants of a fabric an experiment sees: change each by 20 % in MuJoCo, and compare the motions.

    python studies/models/sensitivity.py [ID ...]

A row of `sensitivity.csv` has an id, the size of its motion in the coordinates, frames and unit of the reference [mm or
%], and the distance that each change makes [% of the motion]; `-` if nothing in the scene has the constant, or the
step is too long for air. Without a reference the markers count, in all frames. `air` is air of 20 C in place of none;
`noise` is a millionth of the stretch stiffness, which shows what the solver makes of nothing.
"""

import csv
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gauge_envs import GaugeEnv, load_experiment, reference_band
from gauge_envs.errors import ParameterError
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.experiments.task_format import ClothConstants
from gauge_envs.experiments.variants import bundled_rows
from gauge_envs.references.band import Band
from gauge_envs.tools.reference.solution import length

Array = NDArray[np.float64]

TABLE = Path(__file__).with_name("sensitivity.csv")

SHARE = 0.8
"""Factor on a constant."""

CHANGES = {
    "noise": {"stretch_stiffness_n_per_m": 1.0 - 1e-6},
    "stretch": {"stretch_stiffness_n_per_m": SHARE},
    "shear": {"shear_stiffness_n_per_m": SHARE},
    "bend": {"bend_stiffness_n_m_per_rad": SHARE},
    "density": {"areal_density_kg_per_m2": SHARE},
    "friction": {"friction": SHARE},
}
"""Factors on constants of the cloth, by column."""

AIR = {
    "density_kg_per_m3": 1.204,
    "normal_coefficient": 1.17,
    "tangential_coefficient": 0.015,
    "lift_coefficient": 1.26,
}
"""The parameter set `air` of TextileFlinging."""


def overrides(experiment: Experiment) -> dict[str, dict[str, float]]:
    """Return the overrides of each column."""
    spec = experiment.spec
    ((name, cloth),) = spec.cloths.items()
    material = cloth.material or experiment.variant.material
    published = ClothConstants.model_validate(spec.constants_of(name, material, None))
    found = {
        column: {
            f"{name}.{constant}": factor * getattr(published, constant)
            for constant, factor in factors.items()
        }
        for column, factors in CHANGES.items()
    }
    return found | {"air": {f"air.{key}": value for key, value in AIR.items()}}


def motion(
    experiment: Experiment, band: Band | None, parameters: Any = "published"
) -> Array:
    """Return the motion in the coordinates of a reference [mm], else the markers, shape [T, C].

    After the last frame that the reference knows, the motion stops.
    """
    env = GaugeEnv(experiment.name, parameters=parameters)
    observation, _ = env.reset(seed=0)
    is_of_markers = band is None or band.points is not None
    key, scale = ("markers", 1e3) if is_of_markers else ("observable", 1.0)
    count = experiment.frame_count
    last = count - 1 if band is None else int(np.flatnonzero(band.compared.known)[-1])
    frames = [observation[key]]
    for _ in range(last):
        observation, *_ = env.step(np.zeros(env.action_space.shape))
        frames.append(observation[key])
    env.close()
    frames += [frames[-1]] * (count - len(frames))
    found = scale * np.reshape(frames, (count, -1))
    return found if band is None or is_of_markers else found @ band.projection.T


def size(difference: Array, band: Band | None) -> float:
    """Return the root mean square over frames, and over markers if any [mm]."""
    return band.compared.length(difference) if band else length(difference, 0)


def measured(name: str) -> dict[str, str]:
    """Return the row of an id."""
    experiment = load_experiment(name)
    band = reference_band(experiment)
    published = motion(experiment, band)
    moved = size(published - published[0], band)
    row = {"id": name, "motion_mm": f"{moved:.3g}"}
    for column, parameters in overrides(experiment).items():
        try:
            apart = size(motion(experiment, band, parameters) - published, band)
            row[column] = f"{100.0 * apart / moved:.2g}"
        except ParameterError:
            row[column] = "-"
        print(name, column, row[column], flush=True)
    return row


def store(row: dict[str, str]) -> None:
    """Write a row into the table, in place of that of its id."""
    rows = {}
    if TABLE.is_file():
        with TABLE.open(newline="", encoding="utf-8") as stream:
            rows = {old["id"]: old for old in csv.DictReader(stream)}
    rows[row["id"]] = row
    with TABLE.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, row, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows[name] for name in sorted(rows))


def cloth_ids() -> list[str]:
    """Return the ids whose scene has a cloth."""
    names = [row.variant.name for row in bundled_rows()]
    return [name for name in names if load_experiment(name).spec.cloths]


if __name__ == "__main__":
    for id_ in sys.argv[1:] or cloth_ids():
        store(measured(id_))
