"""What separates a wrong foam from a right one: face areas, or strain and volume ratio of the markers.

    python studies/foam_statistics/foam_statistics.py [--backend mujoco]

Each foam runs with its calibrated constants, with twice Young's modulus, and with a Poisson ratio of 0.05. The rollouts
are compared with the published recording, and with synthetic trials of the calibrated foam. In a synthetic trial the
dots are placed 0.8 mm off (1 sigma, the same in all trials of a block), and each sample has 0.1 mm of noise.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass

import gymnasium
import numpy as np
from numpy.typing import NDArray

import gauge_envs
from gauge_envs.envs.env import GaugeEnv
from gauge_envs.evaluation.deformation import DeformationScore, score_deformation
from gauge_envs.evaluation.metrics.trajectory import trajectory_rmse
from gauge_envs.evaluation.score import Score
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.observables.deformation import (
    STATISTICS,
    affine_map,
    marked_solid,
    trial_statistics,
)
from gauge_envs.observables.observer import observe_markers
from gauge_envs.references.deformation import DeformationReference
from gauge_envs.scene import SoftBody

FOAMS = ("FoamStretching", "FoamCompressing", "FoamShearing")
BEAM = "CantileverBeam"
CHANGES = {
    "calibrated": {},
    "2 E": {"young_modulus_pa": 2.0},
    "nu = 0.05": {"poisson_ratio": 0.05},
}
"""Changed constants of the foam blocks: Young's modulus as a factor, the Poisson ratio as a value."""

FOAM_BELOW_PA = 1e6
"""Young's modulus below which a block is foam and not rubber [Pa]."""

SHOWN = ("strain.zz", "strain.lateral", "volume_ratio", "non_affine")
SHOWN_OF_BEAM = ("strain.yy", "strain.yz", "volume_ratio", "non_affine")
PLACEMENT_M = 0.8e-3
NOISE_M = 0.1e-3
TRIAL_COUNT = 10

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Rollout:
    """One episode: experiment, markers at the frames [m], score on the withheld band, statistics of deformation."""

    experiment: Experiment
    markers_m: FloatArray
    score: Score
    deformation: DeformationScore


def rollout(name: str, change: str, *, backend: str) -> Rollout:
    """Run a variant with material points as markers, with the constants of a change."""
    blocks = [
        body
        for body in gauge_envs.load_experiment(name).scene.deformables
        if isinstance(body, SoftBody)
    ]
    overrides = {
        f"{block.name}.{key}": value * block.young_modulus_pa
        if key == "young_modulus_pa"
        else value
        for block in blocks
        if block.young_modulus_pa < FOAM_BELOW_PA
        for key, value in CHANGES[change].items()
    }
    env = gymnasium.make(
        f"GAUGE/{name}",
        backend=backend,
        parameters=overrides or "calibrated",
        marker_proxy="material",
        use_withheld=True,
    )
    inner = env.unwrapped
    assert isinstance(inner, GaugeEnv)
    env.reset(seed=0)
    over, info = False, {}
    while not over:
        *_, terminated, truncated, info = env.step(
            np.zeros(env.action_space.shape) if inner.experiment.scene.drivers else 0
        )
        over = terminated or truncated
    found = Rollout(
        inner.experiment,
        inner.trajectory().markers_m,
        info["score"],
        info["deformation"],
    )
    env.close()
    return found


def synthetic_trials(markers_m: FloatArray, *, seed: int = 0) -> FloatArray:
    """Return markers of trials whose material moves as given, [trial_count, frame_count, marker_count, 3]."""
    random = np.random.default_rng(seed)
    off = PLACEMENT_M * random.normal(size=markers_m.shape[1:])
    placed = markers_m + np.einsum(
        "fij,mj->fmi", affine_map(markers_m[0], markers_m).gradient, off
    )
    return placed + NOISE_M * random.normal(size=(TRIAL_COUNT, *markers_m.shape))


def synthetic_reference(
    experiment: Experiment, trials_m: FloatArray, shown: Sequence[str]
) -> DeformationReference:
    """Return mean and scatter of the statistics of synthetic trials."""
    solid = marked_solid(experiment.scene)
    assert solid is not None
    values = np.stack([trial_statistics(trial, solid) for trial in trials_m])
    columns = [STATISTICS.index(name) for name in shown]
    return DeformationReference(
        statistics=tuple(shown),
        markers=None,
        mean=values.mean(axis=0)[:, columns],
        sigma=values.std(axis=0, ddof=1)[:, columns],
        trial_count=TRIAL_COUNT,
        source="synthetic",
    )


def synthetic_z(
    rollouts: Sequence[Rollout], trials_m: FloatArray
) -> list[dict[str, float]]:
    """Return the normalized RMSE and |z| of the areas, and the z of the statistics, of each rollout."""
    experiment = rollouts[0].experiment
    markers = experiment.scene.markers
    assert markers is not None
    areas = np.stack(
        [
            observe_markers(trial, markers, experiment.score.observable)
            for trial in trials_m
        ]
    )
    mean, sigma = areas.mean(axis=0), areas.std(axis=0, ddof=1)
    baseline = np.mean([trajectory_rmse(trial, mean) for trial in areas])
    reference = synthetic_reference(experiment, trials_m, SHOWN)
    rows = []
    for run in rollouts:
        g = observe_markers(run.markers_m, markers, experiment.score.observable)
        row = {
            "areas, RMSE": trajectory_rmse(g, mean) / baseline,
            "areas, |z|": float(np.abs((g - mean) / sigma).mean()),
        }
        scored = score_deformation(run.experiment, run.markers_m, reference=reference)
        assert scored is not None
        rows.append(row | {name: scored[name].z or 0.0 for name in SHOWN})
    return rows


def synthetic_beam_z(rollouts: Sequence[Rollout]) -> list[dict[str, float]]:
    """Return the root mean square z over the swing of each rollout; nothing prescribes how the beam moves."""
    experiment = rollouts[0].experiment
    reference = synthetic_reference(
        experiment, synthetic_trials(rollouts[0].markers_m), SHOWN_OF_BEAM
    )
    rows = []
    for run in rollouts:
        scored = score_deformation(experiment, run.markers_m, reference=reference)
        assert scored is not None
        rows.append({name: scored[name].z_rms or 0.0 for name in SHOWN_OF_BEAM})
    return rows


def recorded_z(run: Rollout) -> dict[str, float]:
    """Return the same numbers against the published recording."""
    normalized = run.score.rmse_normalized
    row = {
        "areas, RMSE": float("nan") if normalized is None else normalized,
        "areas, |z|": run.score.mean_abs_z or 0.0,
    }
    return row | {name: run.deformation[name].z or 0.0 for name in SHOWN}


def print_table(title: str, rows: dict[tuple[str, str], dict[str, float]]) -> None:
    """Print rows as GitHub Markdown."""
    columns = list(next(iter(rows.values())))
    print(
        f"\n{title}\n\n| variant | constants | {' | '.join(columns).replace('|z|', chr(92) + '|z' + chr(92) + '|')} |"
    )
    print(f"|---|---|{'---:|' * len(columns)}")
    for (name, change), row in rows.items():
        cells = [
            "-" if np.isnan(row[column]) else f"{round(row[column], 1) + 0.0:.1f}"
            for column in columns
        ]
        print(f"| {name} | {change} | {' | '.join(cells)} |")


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--backend", default="mujoco")
    options = parser.parse_args(arguments)
    recorded, synthetic = {}, {}
    for family in FOAMS:
        for foam in ("soft", "hard"):
            name = f"{family}-{foam}"
            rollouts = [
                rollout(name, change, backend=options.backend) for change in CHANGES
            ]
            against = synthetic_z(rollouts, synthetic_trials(rollouts[0].markers_m))
            for change, run, row in zip(CHANGES, rollouts, against, strict=True):
                recorded[name, change], synthetic[name, change] = recorded_z(run), row
    beams = {}
    for foam in ("soft", "hard"):
        rollouts = [
            rollout(f"{BEAM}-{foam}", change, backend=options.backend)
            for change in CHANGES
        ]
        beams |= {
            (f"{BEAM}-{foam}", change): row
            for change, row in zip(CHANGES, synthetic_beam_z(rollouts), strict=True)
        }
    print_table("Against synthetic trials of the calibrated foam:", synthetic)
    print_table(
        "Against synthetic trials of the calibrated beam, root mean square over the swing:",
        beams,
    )
    print_table(
        "Against the published recording, which shows soft or hard foam:", recorded
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
