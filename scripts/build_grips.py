"""Solve the loads of rods and grips that hold a cloth or a foam, and write `scoring/grips.json`.

- A cloth that moves alike across its width: the undamped sheet (`scripts/sheet.py`) with finer cells, and MuJoCo.
- A cloth in a frame that a rod pushes: a membrane at rest by finite elements (`scripts/membrane.py`), and MuJoCo.
- A bar along which its grips pull: E A e, with the clamps by finite elements of an own (`scripts/bar.py`).
- Other scenes: MuJoCo alone, with finer cells and a finer step.

A load is the mean over a window of frames, since waves run through an undamped cloth. The windows were set before any
power was known: seconds of a swing, a few parts of a short motion. u has two or more parts:

- the change by refinement,
- the part of the distance to MuJoCo that MuJoCo's own refinement does not explain,
- of a foam, half the strain, by which elastic laws of the same modulus differ,
- of a pushed cloth, the friction and the edge of the tip.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gauge_envs.backends.registry import backend_for
from gauge_envs.envs.episode import Episode
from gauge_envs.evaluation.verification import load_length
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.experiments.variants import variants
from gauge_envs.files import write_whole
from gauge_envs.observables.observer import MarkerProxy
from gauge_envs.references.grips import COMPONENTS
from gauge_envs.scene import SoftBody
from gauge_envs.scene.scene import GRAVITY_M_PER_S2
from gauge_envs.scene.timing import FRAME_RATE_HZ, SAMPLES_PER_FRAME
from scripts.bar import axial_factor
from scripts.generated import SCORING, Request
from scripts.membrane import probe_forces_n
from scripts.sheet import sheet_of, solve_sheet

FloatArray = NDArray[np.float64]

LEAST_SHARE = 0.005
"""Least u of a load over its size: what a mean of samples at 180 Hz leaves open."""

SAFETY = 1.25
"""Factor on the change by refinement (Roache)."""

SWING = ((1, 30), (31, 60))
FALL = ((1, 6), (7, 15), (16, 30), (31, 45))
PUSH = ((16, 30), (46, 60))
STRAIN = ((1, 10), (11, 20), (21, 29))


@dataclass(frozen=True, kw_only=True)
class Load:
    """What is compared.

    Attributes:
        quantity: What it is, in words.
        unit: Its unit.
        bodies: Weight of each body.
        components: Entries of the wrench.
        windows: First and last frame of each window.
        is_along_bar: Whether the load is that of a bar along which grips pull.
    """

    quantity: str
    unit: str = "N"
    bodies: dict[str, float]
    components: tuple[str, ...]
    windows: tuple[tuple[int, int], ...]
    is_along_bar: bool = False

    def of(self, holders: tuple[str, ...], wrenches: FloatArray) -> FloatArray:
        """Return the load, shape [W, C]; wrenches have shape [frame_count, holder_count, 6]."""
        weights = np.array([self.bodies.get(name, 0.0) for name in holders])
        total = np.einsum("b,fbc->fc", weights, wrenches)
        columns = [COMPONENTS.index(name) for name in self.components]
        return np.array(
            [
                total[first : last + 1, columns].mean(axis=0)
                for first, last in self.windows
            ]
        )


BASES = {"base-1": 1.0, "base-2": 1.0}
HALF_APART = {"base-1": -0.5, "base-2": 0.5}
AXIAL = (
    Load(
        quantity="pull of the grips",
        bodies=HALF_APART,
        components=("z",),
        windows=STRAIN,
        is_along_bar=True,
    ),
    Load(
        quantity="weight in the grips",
        bodies=BASES,
        components=("z",),
        windows=((1, 29),),
        is_along_bar=True,
    ),
)
LOADS: dict[str, tuple[Load, ...]] = {
    "TextileFlinging-*": (
        Load(
            quantity="force of the rod",
            bodies={"rod": 1.0},
            components=("y", "z"),
            windows=SWING,
        ),
    ),
    "TextileBending-*": (
        Load(
            quantity="pull of the rods",
            bodies={"rod_move": -0.5, "rod_fixed": 0.5},
            components=("x",),
            windows=FALL,
        ),
        Load(
            quantity="weight on the rods",
            bodies={"rod_move": 1.0, "rod_fixed": 1.0},
            components=("z",),
            windows=FALL,
        ),
    ),
    "TextileStretching-*": (
        Load(
            quantity="force across the frame",
            bodies={"frame": 1.0},
            components=("x",),
            windows=PUSH,
        ),
        Load(
            quantity="weight in the frame",
            bodies={"frame": 1.0},
            components=("z",),
            windows=PUSH,
        ),
    ),
    "FoamStretching-*": AXIAL,
    "FoamCompressing-*": AXIAL,
    "FoamShearing-*": (
        Load(
            quantity="force across the grips",
            bodies=HALF_APART,
            components=("y",),
            windows=((1, 12), (13, 24), (25, 36)),
        ),
        Load(
            quantity="weight in the grips",
            bodies=BASES,
            components=("z",),
            windows=((1, 36),),
        ),
    ),
    # No weight: that which MuJoCo states of a twisted foam is off by a tenth, in the first order of its step.
    "FoamTwisting-*": (
        Load(
            quantity="torque of the grips",
            unit="N m",
            bodies=HALF_APART,
            components=("torque z",),
            windows=((1, 21), (22, 42), (43, 64)),
        ),
    ),
}
"""Loads of the variants."""


def loads_of(name: str) -> tuple[Load, ...]:
    """Return the loads of a variant; none for most."""
    return next(
        (loads for pattern, loads in LOADS.items() if fnmatchcase(name, pattern)), ()
    )


def simulated(
    experiment: Experiment, last_frame: int, settings: dict[str, Any], folder: Path
) -> FloatArray:
    """Return the wrenches of MuJoCo in the mean over each frame, shape [frame_count, holder_count, 6]."""
    names = [f"{key}-{value:.4g}" for key, value in settings.items()]
    file = folder / experiment.name / ("-".join(["grips", *names]) + ".npy")
    if file.is_file():
        return np.load(file)
    scene = experiment.scene
    simulation = backend_for("mujoco", None).build(scene, settings or None)
    episode = Episode(
        experiment, simulation, band=None, marker_proxy=MarkerProxy.MATERIAL
    )
    samples: list[FloatArray] = []

    def read(_: int) -> None:
        found = simulation.grip_wrenches(scene.holders)
        assert found is not None
        samples.append(found)

    episode.begin()
    while episode.frame != last_frame:
        episode.advance(episode.no_rates, after_sample=read)
        assert episode.end_frame() is None, f"{experiment.name}: {episode.fault}"
    rows = np.array(samples).reshape(
        last_frame, SAMPLES_PER_FRAME, len(scene.holders), 6
    )
    whole = np.concatenate([np.full_like(rows[:1, 0], np.nan), rows.mean(axis=1)])
    file.parent.mkdir(parents=True, exist_ok=True)
    np.save(file, whole)
    return whole


def refined_settings(experiment: Experiment) -> list[dict[str, Any]]:
    """Return the settings of the runs of MuJoCo: default, half the step, and cells of two thirds."""
    default = backend_for("mujoco", None).resolved_settings(experiment.scene, None)
    assert default is not None
    (body,) = experiment.scene.deformables
    # A bar has cells of its size; two thirds of a quarter of its length are a sixth.
    cell_m = default.get("cell_m")
    if isinstance(body, SoftBody):
        cell_m = body.shape.size_m[0] / 2.0
    return [
        {},
        {"timestep_s": 0.5 * default["timestep_s"]},
        {"cell_m": 2.0 / 3.0 * cell_m},
    ]


def sheet_wrenches(
    experiment: Experiment, frames: int, *, cells: int
) -> FloatArray | None:
    """Return the wrenches of the undamped sheet, shape [frames, holder_count, 6]; None for another scene."""
    sheet = sheet_of(experiment.scene)
    if sheet is None:
        return None
    _, _, held = solve_sheet(sheet, cells=cells, frames=frames)
    holders = experiment.scene.holders
    width_m = sheet.cloth.size_m[1]
    found = np.zeros((frames, len(holders), 6))
    for attachment in experiment.scene.attachments:
        side = attachment.region.side
        found[:, holders.index(attachment.to), :3] += width_m * held[side]
    return found


def probe_wrenches(
    experiment: Experiment, frames: int
) -> tuple[FloatArray, list[FloatArray]] | None:
    """Return the wrench of the frame of a cloth that a rod pushes, and what is open of it; None for another scene.

    Arrays have shape [frames, 1, 6], with the force along the push and upward alone.
    """
    times_s = np.arange(1, (frames - 1) * SAMPLES_PER_FRAME + 1) / (
        SAMPLES_PER_FRAME * FRAME_RATE_HZ
    )
    found = probe_forces_n(experiment.scene, times_s)
    if found is None:
        return None

    def wrenches(forces_n: FloatArray) -> FloatArray:
        rows = np.full((frames, 1, 6), np.nan)
        rows[1:, 0, [0, 2]] = forces_n.reshape(-1, SAMPLES_PER_FRAME, 2).mean(axis=1)
        return rows

    return wrenches(found[0]), [wrenches(part) for part in found[1]]


def rows_of(name: str, folder: Path) -> list[dict[str, Any]]:
    """Return the rows of a variant."""
    experiment = load_experiment(name)
    loads, holders = loads_of(name), experiment.scene.holders
    last_frame = max(last for load in loads for _, last in load.windows)
    is_bar = any(load.is_along_bar for load in loads)
    settings = refined_settings(experiment)
    runs = [simulated(experiment, last_frame, one, folder) for one in settings]
    sheets = [
        sheet_wrenches(experiment, last_frame + 1, cells=cells) for cells in (80, 160)
    ]
    probed = probe_wrenches(experiment, last_frame + 1)
    rows = []
    for load in loads:
        base, step, cell = (load.of(holders, run) for run in runs)
        finest = base + (step - base) + (cell - base)
        changed = np.hypot(step - base, cell - base)
        if sheets[0] is not None and sheets[1] is not None:
            coarse, mean = (load.of(holders, one) for one in sheets if one is not None)
            parts = [SAFETY * (mean - coarse), unexplained(mean - finest, changed)]
            source = "an undamped one-dimensional sheet, checked with MuJoCo"
        elif probed is not None:
            mean = load.of(holders, probed[0])
            parts = [load.of(holders, part) for part in probed[1]]
            parts.append(unexplained(mean - finest, changed))
            source = "a membrane at rest by finite elements, checked with MuJoCo"
        elif is_bar:
            mean, share, law = bar_load(experiment, load)
            parts = [share * mean, law * mean, unexplained(mean - finest, changed)]
            source = "E A e of a linear bar, with clamps by finite elements, checked with MuJoCo"
        else:
            mean, parts = finest, [3.0 * changed]
            source = "MuJoCo alone, refined in step and cells"
        size = load_length(mean)
        squares = sum(np.square(part) for part in parts)
        uncertainty = np.sqrt(squares + (LEAST_SHARE * size) ** 2)
        rows.append(
            {
                "quantity": load.quantity,
                "unit": load.unit,
                "bodies": load.bodies,
                "components": load.components,
                "windows": load.windows,
                "mean": rounded(mean),
                "uncertainty": rounded(uncertainty),
                "source": source,
            }
        )
        print(
            f"{name}, {load.quantity}: {size:.4g} {load.unit}, u {load_length(uncertainty):.2g}, "
            f"MuJoCo {load_length(base - mean):.2g}, refined {load_length(finest - mean):.2g}",
            flush=True,
        )
    return rows


def unexplained(distance: FloatArray, changed: FloatArray) -> FloatArray:
    """Return the part of a distance to MuJoCo that the change by its refinement does not explain."""
    return np.maximum(np.abs(distance) - changed, 0.0)


def bar_load(experiment: Experiment, load: Load) -> tuple[FloatArray, float, float]:
    """Return the load of a bar, and shares of it: what the mesh of the clamps and the law of elasticity leave open."""
    scene = experiment.scene
    (bar,), (driver,) = scene.deformables, scene.drivers
    assert isinstance(bar, SoftBody)
    if load.bodies == BASES:
        return np.array([[bar.mass_kg * GRAVITY_M_PER_S2]]), 0.0, 0.0
    width_m, _, height_m = bar.shape.size_m
    free_m = height_m - sum(one.region.depth_m for one in scene.attachments)
    start = scene.body(driver.body).pose
    count = load.windows[-1][1] * SAMPLES_PER_FRAME + 1
    strains = (
        np.array(
            [
                driver.state(start, sample / SAMPLES_PER_FRAME / FRAME_RATE_HZ)[
                    0
                ].position_m[2]
                - start.position_m[2]
                for sample in range(count)
            ]
        )
        / free_m
    )
    fine, coarse = (
        axial_factor(width_m, free_m, bar.poisson_ratio, cells_across=cells)
        for cells in (8, 4)
    )
    # Second order in the cells, less at the corners of the clamps.
    factor = fine + (fine - coarse) / 3.0
    pull_n = bar.young_modulus_pa * width_m**2 * factor * strains
    mean = np.array(
        [
            [
                pull_n[
                    (first - 1) * SAMPLES_PER_FRAME + 1 : last * SAMPLES_PER_FRAME + 1
                ].mean()
            ]
            for first, last in load.windows
        ]
    )
    return mean, abs(fine - factor), 0.5 * float(np.abs(strains).max())


def rounded(values: FloatArray) -> list[list[float]]:
    """Return four significant digits."""
    return [[float(f"{value:.4g}") for value in row] for row in values]


def measure(request: Request) -> None:
    """Solve the wanted variants, and write their rows."""
    file = SCORING / "grips.json"
    table = json.loads(file.read_text(encoding="utf-8")) if file.is_file() else {}
    for variant in variants():
        name = variant.name
        if loads_of(name) and any(fnmatchcase(name, one) for one in request.ids):
            table[name] = rows_of(name, request.results)
            content = json.dumps(table, indent=1, sort_keys=True) + "\n"
            write_whole(file, content.encode())
