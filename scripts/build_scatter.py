"""Put MuJoCo against the published scatter of real trials, and measure what the test tells.

For each variant, runs with half, once and twice the assumed spread of starts are tested against the published numbers,
as `gauge run ID repeats=40` does. Then simulated realities are tested: groups of runs with other seeds, without a fault
and with one. A reality starts with the assumed spread, and its release has the spread that fits the real one.

- friction, rebound: every friction, or every restitution, is 20 % lower.
- place: the first body that starts free is 2 mm off, in one direction of its plane.
- release: a further delay of |N(0, 40 ms)|. The test fits the release, so it should not tell this one.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator
from dataclasses import replace
from fnmatch import fnmatchcase
from typing import Any

import numpy as np

from gauge_envs.evaluation.scatter import (
    LEVEL,
    SPREADS,
    TRIAL_COUNT,
    GroupModel,
    delayed,
    differs,
    group_models,
    group_scores,
    has_starts,
    published_numbers,
    scatter_test,
)
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.references.published import published_variants
from gauge_envs.references.scatter import NUMBERS, SCATTER_COLUMNS, scatter_file
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.scatter import scattered_runs
from gauge_envs.scene import Scene
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.jitter import Jitter, jittered
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


def measure(request: Request) -> None:
    """Measure the variants that the table lacks; a stopped run goes on."""
    file = scatter_file()
    done = set()
    if file.is_file():
        with file.open(encoding="utf-8") as text:
            done = {row["variant"] for row in csv.DictReader(text)}
    for name in published_variants():
        is_wanted = any(fnmatchcase(name, pattern) for pattern in request.ids)
        if name in done or not is_wanted:
            continue
        experiment = load_experiment(name)
        if published_numbers(experiment.baselines) is None or not has_starts(
            experiment
        ):
            continue
        row = row_of(name)
        is_new = not file.is_file()
        with file.open("a", newline="", encoding="utf-8") as text:
            writer = csv.DictWriter(text, SCATTER_COLUMNS, lineterminator="\n")
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
