"""Put MuJoCo against the published scatter of real trials, and measure what the test tells.

For each variant, runs with half, once and twice the assumed spread of starts are tested against the published numbers,
as `gauge run ID repeats=40` does. Then simulated realities are tested: groups of runs with other seeds, without a fault
and with one. A reality starts with the assumed spread, and its release has the spread that fits the real one.

- friction, rebound: every friction, or every restitution, is 20 % lower.
- place: the first body that starts free is 2 mm off, in one direction of its plane.
- release: a further delay of |N(0, 40 ms)|. The test fits the release, so it should not tell this one.

Cloth and foam that grips hold have no start of their own. Of one run of each it is found which noise of the markers,
and which late releases, give the real mean E_RMSE, and which noise a body needs that does not move.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from gauge_envs.errors import ParameterError
from gauge_envs.evaluation.scatter import (
    LEVEL,
    SPREADS,
    TRIAL_COUNT,
    GroupModel,
    check_starts,
    delayed,
    differs,
    group_models,
    group_scores,
    published_numbers,
    scatter_test,
)
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.observables.observer import observe_markers
from gauge_envs.references.published import published_variants
from gauge_envs.references.scatter import (
    HELD_COLUMNS,
    NUMBERS,
    SCATTER_COLUMNS,
    held_file,
    scatter_file,
)
from gauge_envs.runs.episodes import run_episode
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.scatter import scattered_runs
from gauge_envs.scene import Scene
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.jitter import Jitter, jittered
from gauge_envs.scene.timing import FRAME_RATE_HZ
from scripts.build_power import LOW, _with_contacts
from scripts.generated import Request

RUN_COUNT = 40
REALITY_RUNS = 100
REALITIES = 200
OFFSET_M = 2e-3
LATE_S = 0.04
FACTORS = (1.25, 1.5, 2.0, 3.0, 4.0)
FACTOR_REALITIES = 50
TOLD_SHARE = 0.8
NOISE_GROUPS = 2
RELEASES_S = np.arange(0.01, 0.31, 0.01)


def measure(request: Request) -> None:
    """Measure the variants that the tables lack; a stopped run goes on."""
    for name in published_variants():
        experiment = load_experiment(name)
        is_wanted = any(fnmatchcase(name, pattern) for pattern in request.ids)
        is_known = published_numbers(experiment.baselines) is not None
        if not (is_wanted and is_known) or experiment.impossible_scores:
            continue
        try:
            check_starts(experiment, Jitter())
        except ParameterError:
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
    is_new = not file.is_file()
    if not is_new:
        with file.open(encoding="utf-8") as text:
            if any(row["variant"] == name for row in csv.DictReader(text)):
                return
    row = made(name)
    with file.open("a", newline="", encoding="utf-8") as text:
        writer = csv.DictWriter(text, columns, lineterminator="\n")
        if is_new:
            writer.writeheader()
        writer.writerow(row)
    print(name, row, flush=True)


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
    for key, one in zip(
        ("half", "once", "twice", "uneven"), scatter.spreads, strict=True
    ):
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
        size = float(np.linalg.norm(shift))
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
    experiment = load_experiment(name)
    numbers = published_numbers(experiment.baselines)
    trajectory = run_episode(RunRequest(name)).trajectory
    markers, known = experiment.scene.markers, None
    if trajectory is not None:
        known = trajectory.markers_m()
    assert numbers is not None and markers is not None and known is not None
    markers_m = known[: experiment.baselines["rmse"].frames]
    observed = partial(
        observe_markers, markers=markers, observable=experiment.score.observable
    )
    motion = observed(markers_m)
    still_m = np.broadcast_to(markers_m[0], markers_m.shape)
    noise_mm, noisy = marker_noise(markers_m, observed, rmse=numbers[0])
    release_s = release_spread(motion, rmse=numbers[0])
    row: dict[str, Any] = {
        "variant": name,
        "unit": experiment.baselines["rmse"].unit,
        "motion": f"{np.sqrt(np.square(motion - motion.mean(axis=0)).sum(axis=1).mean()):.3g}",
        "noise_mm": f"{noise_mm:.3g}",
        "noise_dtw": f"{group_scores(noisy)[:, 2].mean():.3g}",
        "still_mm": f"{marker_noise(still_m, observed, rmse=numbers[0])[0]:.3g}",
        "release_s": "" if release_s is None else f"{release_s:.3g}",
    }
    return row | {
        f"real.{key}": f"{value:g}" for key, value in zip(NUMBERS, numbers, strict=True)
    }


def mean_rmse(trials: FloatArray) -> float:
    """Return E_RMSE of trials against the mean of their group, mean over trials and groups.

    Args:
        trials: g(t), shape [group_count, trial_count, frame_count, coordinate_count].
    """
    squares = np.square(trials - trials.mean(axis=1, keepdims=True)).sum(axis=-1)
    return float(np.sqrt(squares.mean(axis=-1)).mean())


def marker_noise(
    markers_m: FloatArray, observed: Callable[[FloatArray], FloatArray], *, rmse: float
) -> tuple[float, FloatArray]:
    """Return the white noise of markers with which trials of one motion have a given E_RMSE, and g(t) of such trials.

    Args:
        markers_m: Markers of the motion [m], shape [frame_count, marker_count, 3].
        observed: Function that returns g(t) of markers.
        rmse: E_RMSE in the unit of g(t).

    Returns:
        Standard deviation of each coordinate [mm]; g(t), shape [group_count, trial_count, frame_count, width].
    """
    shape = (NOISE_GROUPS, TRIAL_COUNT, *markers_m.shape)
    drawn = np.random.default_rng(0).standard_normal(shape)
    noise_mm = 0.1
    # E_RMSE is nearly proportional to the noise.
    for _ in range(3):
        places_m = (markers_m + 1e-3 * noise_mm * drawn).reshape(-1, *shape[3:])
        trials = observed(places_m).reshape(*shape[:3], -1)
        noise_mm *= rmse / mean_rmse(trials)
    return noise_mm, trials


def release_spread(motion: FloatArray, *, rmse: float) -> float | None:
    """Return the least spread of late releases with which trials of one motion have a given E_RMSE.

    Args:
        motion: g(t), shape [frame_count, width]; it rests until the release.
        rmse: E_RMSE in its unit.

    Returns:
        The spread s of |N(0, s)| [s]; None if no spread of up to 0.3 s is enough.
    """
    shape = (4 * NOISE_GROUPS, TRIAL_COUNT)
    delays = np.abs(np.random.default_rng(0).standard_normal(shape))
    frames = np.arange(len(motion))
    for spread_s in RELEASES_S:
        places = np.maximum(frames - FRAME_RATE_HZ * spread_s * delays[..., None], 0.0)
        before = np.minimum(places.astype(int), len(motion) - 2)
        share = (places - before)[..., None]
        trials = (1.0 - share) * motion[before] + share * motion[before + 1]
        if mean_rmse(trials) >= rmse:
            return float(spread_s)
    return None
