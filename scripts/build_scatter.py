"""Put MuJoCo against the published scatter of real trials, and measure what the test tells.

For each variant, runs with half, once and twice the assumed spread of starts are tested against the published numbers,
as `gauge run ID repeats=40` does. Then simulated realities are tested: groups of runs with other seeds, without a fault
and with one. A reality starts with the assumed spread, and its release has the spread that fits the real one.

- friction, rebound: every friction, or every restitution, is 20 % lower.
- place: the first body that starts free is 2 mm off, in one direction of its plane.
- release: a further delay of |N(0, 40 ms)|. The test fits the release, so it should not tell this one.

Cloth and foam that grips hold have no start of their own: driven bodies are misplaced and late, and markers have noise.
What misplacements add to g(t) is measured in each coordinate alone, and added.

- frozen: nothing moves. stiffness, density: those of the cloth or foam are 20 % lower.
- place: the driven body is `FAR` off. late: as release.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from gauge_envs.evaluation.scatter import (
    LEVEL,
    TOLD_SHARE,
    differs,
    is_held,
    published_numbers,
    scatter_test,
)
from gauge_envs.evaluation.scatter_groups import (
    HELD_FRAMES,
    HELD_LATE_S,
    SPREADS,
    TRIAL_COUNT,
    GroupModel,
    delayed,
    drawn_noises,
    experiment_models,
    group_models,
    group_scores,
    marker_noise,
)
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.references.published import published_variants
from gauge_envs.references.scatter import (
    ASSUMPTIONS,
    HELD_COLUMNS,
    NUMBERS,
    SCATTER_COLUMNS,
    held_file,
    scatter_file,
)
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.scatter import scattered_runs
from gauge_envs.scene import Scene
from gauge_envs.scene.geometry import FloatArray, length_of
from gauge_envs.scene.jitter import Jitter, jittered, misplaced
from scripts.build_power import LOW, _with_contacts, motion
from scripts.generated import Request, append_rows, read_rows

RUN_COUNT = 40
REALITY_RUNS = 100
REALITIES = 200
OFFSET_M = 2e-3
LATE_S = 0.04
FACTORS = (1.25, 1.5, 2.0, 3.0, 4.0)
FACTOR_REALITIES = 50
HELD_REALITIES = 100
KNOT = 1.5
SMALL_SHARE = 0.25
NOISE_MM = 0.1
FAR = np.array([[2.0, 2.0, 2.0, 0.0, 0.0, 0.0]]) / np.sqrt(3.0)
"""A place that is 2 mm off, over the standard deviations of the jitter, shape [1, 6]."""


def measure(request: Request) -> None:
    """Measure the variants that the tables lack; a stopped run goes on."""
    for name in published_variants():
        experiment = load_experiment(name)
        is_known = published_numbers(experiment.baselines) is not None
        if not (request.wants(name) and is_known) or experiment.impossible_scores:
            continue
        if is_held(experiment):
            add_row(held_file(), HELD_COLUMNS, name, held_row)
        else:
            add_row(scatter_file(), SCATTER_COLUMNS, name, row_of)


def add_row(
    file: Path,
    columns: Sequence[str],
    name: str,
    made: Callable[[str], Mapping[str, Any]],
) -> None:
    """Add the row of a variant to a table that lacks it."""
    if all(row["variant"] != name for row in read_rows(file)):
        append_rows(file, columns, [made(name)])


def row_of(name: str) -> dict[str, Any]:
    """Return the row of a variant."""
    experiment, asked = load_experiment(name), RunRequest(name)

    def runs(scene: Scene, share: float, first: int, count: int) -> FloatArray:
        seeds = range(first, first + count)
        changed = replace(experiment, scene=scene)
        return np.array(scattered_runs(asked, changed, share=share, seeds=seeds))

    samples = {share: runs(experiment.scene, share, 0, RUN_COUNT) for share in SPREADS}
    scatter = scatter_test(experiment, samples)
    middle = scatter.spreads[SPREADS.index(1.0)]
    row: dict[str, Any] = {
        "variant": name,
        "unit": scatter.unit,
        "runs": RUN_COUNT,
        "release_s": f"{middle.release_s:.4f}",
    }
    for key, real, simulated in zip(
        NUMBERS, scatter.real, middle.simulated, strict=True
    ):
        row[f"real.{key}"] = f"{real:g}"
        row[f"simulated.{key}"] = f"{simulated:.3g}"
    for key, one in zip(ASSUMPTIONS, scatter.spreads, strict=True):
        row[f"p.{key}"] = f"{one.p_value:.3f}"
    models = group_models(samples, experiment.baselines["rmse"].frames)
    scenes = {"none": experiment.scene, **dict(faulty_scenes(experiment))}
    for number, (fault, scene) in enumerate(scenes.items()):
        trials = runs(scene, 1.0, 1000 * (number + 1), REALITY_RUNS)
        found = realities(fault, trials, experiment, middle.release_s)
        row |= told(fault, found, models)
        if fault == "none":
            row["factor"] = told_factor(found, models)
            late = realities("release", trials, experiment, middle.release_s)
            row |= told("release", late, models)
    return row


def faulty_scenes(experiment: Experiment) -> Iterator[tuple[str, Scene]]:
    """Yield scenes with one fault."""
    scene = experiment.scene
    for fault, constant in (("friction", "friction"), ("rebound", "restitution")):
        if any(getattr(contact, constant) for contact in scene.contacts):
            yield fault, _with_contacts(scene, constant, LOW)
    # The same random direction for every variant, along the faces that the body touches.
    far = Jitter(position_m=1.0, angle_rad=0.0)
    moved = {body.name: body for body in jittered(scene, far, seed=0).bodies}
    bodies = []
    for body in scene.bodies:
        shift = np.subtract(moved[body.name].pose.position_m, body.pose.position_m)
        size = length_of(shift)
        if size > 0.0:
            place = np.add(body.pose.position_m, OFFSET_M / size * shift)
            pose = replace(body.pose, position_m=tuple(place.tolist()))
            body = replace(body, pose=pose)
        bodies.append(body)
    yield "place", replace(scene, bodies=tuple(bodies))


def realities(
    fault: str, runs: FloatArray, experiment: Experiment, release_s: float
) -> FloatArray:
    """Return the four numbers of groups of trials with a fault, shape [group_count, 4]."""
    random = np.random.default_rng([*fault.encode()])
    chosen = np.array(
        [random.choice(len(runs), TRIAL_COUNT, replace=False) for _ in range(REALITIES)]
    )
    delays_s = release_s * np.abs(random.standard_normal(chosen.shape))
    if fault == "release":
        delays_s += LATE_S * np.abs(random.standard_normal(chosen.shape))
    frames = experiment.baselines["rmse"].frames
    return group_scores(delayed(runs, chosen, delays_s, frames))


def told(
    fault: str, found: FloatArray, models: dict[str, GroupModel]
) -> dict[str, str]:
    """Return the shares of realities that the test refuses: with the assumed starts, and with all."""
    p_values = [
        [model.answer(one, starts).p_value for starts, model in models.items()]
        for one in found
    ]
    once = [one[SPREADS.index(1.0)] < LEVEL for one in p_values]
    always = [differs(one) is True for one in p_values]
    return {
        f"refused.{fault}": f"{np.mean(once):.3f}",
        f"told.{fault}": f"{np.mean(always):.3f}",
    }


def told_factor(found: FloatArray, models: dict[str, GroupModel]) -> str:
    """Return the smallest factor of E_DTW that is told in most realities; empty without one."""
    for factor in FACTORS:
        larger = found[:FACTOR_REALITIES] * np.array([1.0, 1.0, factor, factor])
        if float(told("", larger, models)["told."]) >= TOLD_SHARE:
            return f"{factor:g}"
    return ""


# --- held cloth and foam ---


def held_row(name: str) -> dict[str, Any]:
    """Return the row of a variant whose bodies are held."""
    whole = load_experiment(name)
    frame_count = min(whole.frame_count, HELD_FRAMES)
    experiment = replace(whole, frame_count=frame_count)
    drawn = np.random.default_rng(0).standard_normal((RUN_COUNT + REALITY_RUNS, 6))
    scene = experiment.scene
    nominal, markers_m = played(experiment, scene)
    moved = displacements(experiment, nominal, drawn)
    samples, trials = np.split(nominal + moved, [RUN_COUNT])
    models = experiment_models(experiment, {1.0: samples}, markers_m=markers_m)
    noise = marker_noise(experiment, markers_m)
    real = np.array(published_numbers(experiment.baselines))
    spreads = [model.answer(real, starts) for starts, model in models.items()]
    middle = spreads[SPREADS.index(1.0)]
    row: dict[str, Any] = {
        "variant": name,
        "unit": experiment.baselines["rmse"].unit,
        "noise_mm": f"{middle.noise_mm:.3g}",
    }
    still = np.broadcast_to(nominal, trials.shape)
    alone = {
        "place": held_groups("place", trials, noise, late_s=0.0, noise_mm=0.0),
        "late": held_groups("late", still, noise, late_s=HELD_LATE_S, noise_mm=0.0),
        "noise": held_groups("noise", still, noise, late_s=0.0, noise_mm=NOISE_MM),
    }
    numbers = {cause: np.exp(np.log(one).mean(axis=0)) for cause, one in alone.items()}
    for cause, values in {"real": real, **numbers}.items():
        row |= {
            f"{cause}.{key}": f"{value:.3g}"
            for key, value in zip(NUMBERS, values, strict=True)
        }
    for key, one in zip(ASSUMPTIONS, spreads, strict=True):
        row[f"p.{key}"] = f"{one.p_value:.3f}"
    bases = {"none": nominal, "frozen": np.broadcast_to(nominal[:1], nominal.shape)}
    for fault, changed in held_faults(scene):
        bases[fault] = played(experiment, changed)[0]
    for fault, base in bases.items():
        # Misplacements act on the faulty scene as on the right one, and on a frozen one not at all.
        runs = base + (0.0 if fault == "frozen" else 1.0) * (trials - nominal)
        found = held_groups(fault, runs, noise, noise_mm=middle.noise_mm)
        row |= told(fault, found, models)
    far = nominal + displacements(experiment, nominal, FAR)
    found = held_groups("far", trials + far - nominal, noise, noise_mm=middle.noise_mm)
    row |= told("place", found, models)
    found = held_groups(
        "later", trials, noise, noise_mm=middle.noise_mm, later_s=LATE_S
    )
    return row | told("late", found, models)


def played(experiment: Experiment, scene: Scene) -> tuple[FloatArray, FloatArray]:
    """Return g(t) of a run of MuJoCo, shape [sample_count, coordinate_count], and its markers at the frames [m]."""
    episode = motion(experiment, scene, last_frame=experiment.frame_count - 1)
    trajectory = episode.trajectory()
    return trajectory.dense[1], trajectory.markers_m


def displacements(
    experiment: Experiment, nominal: FloatArray, drawn: FloatArray
) -> FloatArray:
    """Return what misplacements of the driven body add to g(t), the sum over its coordinates.

    Each is linear between runs with none and with +- `KNOT` standard deviations.

    Args:
        experiment: The experiment.
        nominal: g(t) without, shape [sample_count, coordinate_count].
        drawn: Coordinates over their standard deviations, shape [count, 6].

    Returns:
        Shape [count, sample_count, coordinate_count].
    """
    changes = responses(experiment.name)
    moved = np.zeros((len(drawn), *nominal.shape))
    for column, (low, high) in changes.items():
        shares = drawn[:, column] / KNOT
        moved += np.maximum(shares, 0.0)[:, None, None] * high
        moved += np.maximum(-shares, 0.0)[:, None, None] * low
    return moved


@lru_cache(maxsize=1)
def responses(name: str) -> dict[int, tuple[FloatArray, FloatArray]]:
    """Return the changes of g(t) by each coordinate at minus and plus `KNOT`, without those that change nothing."""
    whole = load_experiment(name)
    experiment = replace(whole, frame_count=min(whole.frame_count, HELD_FRAMES))
    scene = experiment.scene
    nominal = played(experiment, scene)[0]
    (driver,) = scene.drivers

    def changed(column: int, place: float) -> FloatArray | None:
        moved = misplaced(scene, Jitter(), {driver.body: place * np.eye(6)[column]})
        if moved == scene:
            return None
        return played(experiment, moved)[0] - nominal

    highs = {column: changed(column, KNOT) for column in range(6)}
    known = {column: high for column, high in highs.items() if high is not None}
    largest = max(length_of(high) for high in known.values())
    found = {}
    for column, high in known.items():
        low: FloatArray | None = -high
        # A rod that touches, or a sheet that wrinkles, answers otherwise in the other direction; a grip does not.
        if scene.contacts and np.linalg.norm(high) > SMALL_SHARE * largest:
            low = changed(column, -KNOT)
        assert low is not None, "both directions move the body"
        found[column] = (low, high)
    return found


def held_faults(scene: Scene) -> Iterator[tuple[str, Scene]]:
    """Yield scenes with one wrong constant."""
    constants = ("stretch_stiffness_n_per_m", "young_modulus_pa")
    heavy = ("mass_kg", "areal_density_kg_per_m2")
    for fault, fields in (("stiffness", constants), ("density", heavy)):
        bodies = []
        for body in scene.deformables:
            known = [field for field in fields if hasattr(body, field)]
            lower = {field: LOW * getattr(body, field) for field in known}
            bodies.append(replace(body, **lower))
        yield fault, replace(scene, deformables=tuple(bodies))
    if any(contact.friction for contact in scene.contacts):
        yield "friction", _with_contacts(scene, "friction", LOW)


def held_groups(
    fault: str,
    runs: FloatArray,
    noise: FloatArray,
    *,
    noise_mm: float,
    late_s: float = HELD_LATE_S,
    later_s: float = 0.0,
) -> FloatArray:
    """Return the four numbers of groups of trials, shape [group_count, 4].

    Args:
        fault: Name that draws the groups.
        runs: g(t), shape [run_count, sample_count, coordinate_count].
        noise: Response to the noise of markers.
        noise_mm: Noise of the markers [mm].
        late_s: Spread of the start of the drive [s].
        later_s: Spread of a further delay [s].
    """
    random = np.random.default_rng([*fault.encode()])
    shape = (HELD_REALITIES, TRIAL_COUNT)
    chosen = random.permuted(
        np.tile(np.arange(len(runs)), (HELD_REALITIES, 1)), axis=1
    )[:, :TRIAL_COUNT]
    delays_s = late_s * np.abs(random.standard_normal(shape))
    delays_s += later_s * np.abs(random.standard_normal(shape))
    trials = delayed(runs, chosen, delays_s, noise.shape[1])
    trials += noise_mm * noise[drawn_noises(random, noise, HELD_REALITIES)]
    return group_scores(trials)
