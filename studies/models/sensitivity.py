"""Measure which constants of a fabric an experiment sees: change each by 20 % in MuJoCo, and compare the motions.

    python studies/models/sensitivity.py [ID ...]

A row of `sensitivity.csv` has an id, the size of its motion [mm] over the frames of the reference, and the distance
that each change makes [% of the motion]; `-` if nothing in the scene has the constant, or the step is too long for air.
`air` is air of 20 C in place of none; `noise` is a millionth of the stretch stiffness, which shows what the solver
makes of nothing.
"""

import csv
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gauge_envs import GaugeEnv, load_experiment
from gauge_envs.errors import ParameterError
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.experiments.task_format import ClothConstants
from gauge_envs.references.band import load_band

Array = NDArray[np.float64]

TABLE = Path(__file__).with_name("sensitivity.csv")

IDS = (
    "StripBending-satin",
    "StripBending-oxford",
    "TextileBending-satin",
    "TextileBending-oxford",
    "TextileStretching-satin",
    "TextileStretching-oxford",
    "TextileFlinging-satin",
    "TextileFlinging-oxford",
)
"""Of the six fabrics, satin has the least stretch and shear stiffness, and oxford the most."""

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


def motion(name: str, last: int, parameters: Any = "published") -> Array:
    """Return the markers, or else g(t), up to a frame [mm], shape [T, C]."""
    env = GaugeEnv(name, parameters=parameters)
    observation, _ = env.reset(seed=0)
    key, scale = ("markers", 1e3) if "markers" in observation else ("observable", 1.0)
    frames = [observation[key]]
    for _ in range(last):
        observation, *_ = env.step(np.zeros(env.action_space.shape))
        frames.append(observation[key])
    env.close()
    return scale * np.reshape(frames, (len(frames), -1))


def size(difference: Array) -> float:
    """Return the root mean square over frames, and over points of three coordinates [mm]."""
    return float(np.sqrt(3.0 * np.square(difference).mean()))


def measure(name: str) -> None:
    """Append the rows of an id to the table."""
    band = load_band(name)
    assert band is not None
    last = int(np.flatnonzero(np.isfinite(band.compared.mean).all(axis=1))[-1])
    published = motion(name, last)
    moved = size(published - published[0])
    rows = {}
    for column, parameters in overrides(load_experiment(name)).items():
        try:
            apart = size(motion(name, last, parameters) - published)
            rows[column] = f"{100.0 * apart / moved:.2g}"
        except ParameterError:
            rows[column] = "-"
        print(name, column, rows[column], flush=True)
    with TABLE.open("a", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        if not stream.tell():
            writer.writerow(("id", "motion_mm", *rows))
        writer.writerow((name, f"{moved:.3g}", *rows.values()))


if __name__ == "__main__":
    for id_ in sys.argv[1:] or IDS:
        measure(id_)
