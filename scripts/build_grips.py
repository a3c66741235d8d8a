"""Solve the loads of rods and grips that hold a cloth or a foam, and write `scoring/grips.json`.

- A cloth that moves alike across its width: the undamped sheet (`scripts/sheet.py`) with finer cells, and MuJoCo.
- A cloth in a frame that a rod pushes: a membrane at rest by finite elements (`scripts/membrane.py`), and MuJoCo.
- A foam that grips move: a block at rest by finite elements (`scripts/solid.py`), and MuJoCo.
- A foam that a cube presses: a quarter of a block, refined about the cube's edge (`scripts/pressed.py`), and MuJoCo.

A load is the mean over a window of frames, since waves run through an undamped cloth. The windows were set before any
power was known: seconds of a swing, a few parts of a short motion. u has two or more parts:

- the change by refinement,
- the part of the distance to MuJoCo that MuJoCo's own refinement does not explain,
- of a pushed cloth, the friction and the edge of the tip,
- of a pressed foam, the direction of the force at the edge of the cube.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import PchipInterpolator

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
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.timing import FRAME_RATE_HZ, SAMPLES_PER_FRAME
from scripts.extrapolation import extrapolate
from scripts.generated import SCORING, Request
from scripts.membrane import probe_forces_n
from scripts.pressed import LEVELS, faces_of, pressed_block
from scripts.sheet import sheet_of, solve_sheet
from scripts.solid import held_wrenches, is_pressed_block

LEAST_SHARE = 0.005
"""Least u of a load over its size: what a mean of samples at 180 Hz leaves open."""

SAFETY = 1.25
"""Factor on the change by refinement (Roache)."""

EDGE_SHARE = 0.005
"""u by the edge of the cube over the push on a foam. An edge that presses straight down, and not along the normal of
the surface that it bends, presses 0.9 % less; anything between has this standard deviation."""

BLOCK_CELLS = (3, 2)
"""Cells across a block of the solution and of the coarser one."""

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
    """

    quantity: str
    unit: str = "N"
    bodies: dict[str, float]
    components: tuple[str, ...]
    windows: tuple[tuple[int, int], ...]

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
    ),
    Load(
        quantity="weight in the grips",
        bodies=BASES,
        components=("z",),
        windows=((1, 29),),
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
    # The cube touches the foam in frame 12, and has pressed it to a sixth of its width in frame 17.
    "FoamBending-*": (
        Load(
            quantity="weight and push in the grips",
            bodies=BASES,
            components=("z",),
            windows=((13, 17),),
        ),
        Load(
            quantity="weight in the grips",
            bodies=BASES,
            components=("z",),
            windows=((1, 10),),
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
    whole = frame_means(np.array(samples))
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


def frame_means(samples: FloatArray) -> FloatArray:
    """Return the means over frames of samples, which begin after frame 0, shape [frame_count, ...]; NaN at frame 0."""
    means = samples.reshape(-1, SAMPLES_PER_FRAME, *samples.shape[1:]).mean(axis=1)
    return np.concatenate([np.full_like(means[:1], np.nan), means])


def sample_times_s(last_frame: int) -> FloatArray:
    """Return the times of the samples after frame 0 [s], shape [last_frame SAMPLES_PER_FRAME]."""
    count = last_frame * SAMPLES_PER_FRAME
    return np.arange(1, count + 1) / (SAMPLES_PER_FRAME * FRAME_RATE_HZ)


def sheet_wrenches(
    experiment: Experiment, frames: int, *, cells: int
) -> FloatArray | None:
    """Return the wrenches of the undamped sheet, shape [frames, holder_count, 6]; None for another scene."""
    sheet = sheet_of(experiment.scene)
    if sheet is None:
        return None
    _, _, end_loads_n_per_m = solve_sheet(sheet, cells=cells, frames=frames)
    holders = experiment.scene.holders
    width_m = sheet.cloth.size_m[1]
    found = np.zeros((frames, len(holders), 6))
    for attachment in experiment.scene.attachments:
        side = attachment.region.side
        found[:, holders.index(attachment.to), :3] += width_m * end_loads_n_per_m[side]
    return found


def solution(
    experiment: Experiment, last_frame: int
) -> tuple[FloatArray, list[FloatArray], str]:
    """Return the wrenches of a scene, what its solver leaves open of them, and what the solver is.

    Arrays have shape [last_frame + 1, holder_count, 6], in the mean over each frame.
    """
    coarse, fine = (
        sheet_wrenches(experiment, last_frame + 1, cells=cells) for cells in (80, 160)
    )
    if coarse is not None and fine is not None:
        return fine, [SAFETY * (fine - coarse)], "an undamped one-dimensional sheet"
    times_s = sample_times_s(last_frame)
    probed = probe_forces_n(experiment.scene, times_s)
    if probed is not None:
        mean, *parts = (_of_rim(forces_n) for forces_n in (probed[0], *probed[1]))
        return mean, parts, "a membrane at rest by finite elements"
    blocks = [
        held_wrenches(experiment.scene, times_s, cells=cells) for cells in BLOCK_CELLS
    ]
    fine, coarse = (frame_means(one) for one in blocks if one is not None)
    return fine, [fine - coarse], "a block at rest by finite elements"


def pressed_wrenches(
    experiment: Experiment, last_frame: int, settings: dict[str, Any], file: Path
) -> FloatArray:
    """Return the upward forces of the grips of a pressed foam, from a run of `build_models` where there is one."""
    scene = experiment.scene
    times_s = sample_times_s(last_frame)
    faces_m = faces_of(scene, times_s)
    (foam,) = scene.deformables
    half_m = 0.5 * foam.shape.size_m[1]
    if file.is_file():
        with np.load(file) as run:
            solved_m, pushes_n = run["faces_m"], run["pushes_n"]
    else:
        block = pressed_block(scene, float(times_s[-1]), **settings)
        solved_m, pushes_n = block.faces_m, block.pushes_n
    found_n = PchipInterpolator(-solved_m, pushes_n)(np.maximum(-faces_m, -half_m))
    found_n += foam.mass_kg * scene.gravity_m_per_s2
    wrenches = np.zeros((len(times_s), len(scene.holders), 6))
    for one in scene.attachments:
        wrenches[:, scene.holders.index(one.to), 2] = 0.5 * found_n
    return frame_means(wrenches)


def pressed_load(
    load: Load, experiment: Experiment, last_frame: int, folder: Path
) -> tuple[FloatArray, list[FloatArray]]:
    """Return the extrapolated load of a pressed foam, shape [W, C], and what is open of it."""
    holders = experiment.scene.holders
    found = {
        parameter: {
            factor: load.of(
                holders,
                pressed_wrenches(
                    experiment,
                    last_frame,
                    settings,
                    folder / experiment.name / f"block-{parameter}-{factor:.4g}.npz",
                ),
            )
            for factor, settings in runs
        }
        for parameter, runs in LEVELS.items()
    }
    base = found.pop("base")[1.0]
    mean, parts = base.copy(), []
    for values in found.values():
        factors = sorted([1.0, *values], reverse=True)
        result = extrapolate(
            [base if one == 1.0 else values[one] for one in factors], factors
        )
        mean += result.correction
        parts.append(result.uncertainty)
    (foam,) = experiment.scene.deformables
    weight_n = foam.mass_kg * experiment.scene.gravity_m_per_s2
    return mean, [*parts, EDGE_SHARE * (mean - weight_n)]


def _of_rim(forces_n: FloatArray) -> FloatArray:
    """Return the wrench of a frame in the mean over frames, with the force along the push and upward alone."""
    wrenches = np.full((len(forces_n), 1, 6), np.nan)
    wrenches[:, 0, [0, 2]] = forces_n
    return frame_means(wrenches)


def rows_of(name: str, folder: Path) -> list[dict[str, Any]]:
    """Return the rows of a variant."""
    experiment = load_experiment(name)
    loads, holders = loads_of(name), experiment.scene.holders
    last_frame = max(last for load in loads for _, last in load.windows)
    settings = refined_settings(experiment)
    runs = [simulated(experiment, last_frame, one, folder) for one in settings]
    is_pressed = is_pressed_block(experiment.scene)
    if not is_pressed:
        solved, left_open, source = solution(experiment, last_frame)
    else:
        source = "a block at rest by finite elements"
    rows = []
    for load in loads:
        base, step, cell = (load.of(holders, run) for run in runs)
        finest = base + (step - base) + (cell - base)
        changed = np.hypot(step - base, cell - base)
        if is_pressed:
            mean, parts = pressed_load(load, experiment, last_frame, folder)
        else:
            mean = load.of(holders, solved)
            parts = [load.of(holders, part) for part in left_open]
        # What MuJoCo's own refinement does not explain of the distance to it.
        parts.append(np.maximum(np.abs(mean - finest) - changed, 0.0))
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
                "source": f"{source}, checked with MuJoCo",
            }
        )
        print(
            f"{name}, {load.quantity}: {size:.4g} {load.unit}, u {load_length(uncertainty):.2g}, "
            f"MuJoCo {load_length(base - mean):.2g}, refined {load_length(finest - mean):.2g}",
            flush=True,
        )
    return rows


def rounded(values: FloatArray) -> list[list[float]]:
    """Return four significant digits."""
    return [[float(f"{value:.4g}") for value in row] for row in values]


def measure(request: Request) -> None:
    """Solve the wanted variants, and write their rows."""
    file = SCORING / "grips.json"
    table = json.loads(file.read_text(encoding="utf-8")) if file.is_file() else {}
    for variant in variants():
        name = variant.name
        if loads_of(name) and request.wants(name):
            table[name] = rows_of(name, request.results)
            content = json.dumps(table, indent=1, sort_keys=True) + "\n"
            write_whole(file, content.encode())
