"""Build the tables of sensitivities in `scoring/sensitivities/` by simulation.

A table states how the trajectory changes with each uncertain input (`gauge_envs.runs.sensitivity`). The intervals of
scores use it. It belongs to the default preset of the engine.
"""

from __future__ import annotations

from gauge_envs import load_experiment, reference_band, variants
from gauge_envs.backends.registry import support_of
from gauge_envs.references.grades import BandGrade
from gauge_envs.references.sensitivities import sensitivities_text
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.sensitivity import measure_sensitivities
from scripts.generated import SCORING, Request

ENGINES = ("mujoco", "drake", "genesis", "newton", "physx", "pybullet", "rapier")


def measure(request: Request) -> None:
    """Write the tables of all variants that are scored by default, of each engine that simulates them."""
    for engine in request.engines or ENGINES:
        for variant in variants():
            experiment = load_experiment(variant.name)
            band = reference_band(experiment)
            is_scored = (
                band is not None
                and band.grade is not BandGrade.MODEL
                and band.normalized_by_baseline
            )
            is_simulated = support_of(engine, experiment.scene)
            if not (is_scored and is_simulated and request.wants(variant.name)):
                continue
            file = SCORING / "sensitivities" / engine / f"{variant.name}.json"
            file.parent.mkdir(parents=True, exist_ok=True)
            table = measure_sensitivities(RunRequest(variant.name, backend=engine))
            file.write_text(sensitivities_text(table), encoding="utf-8", newline="\n")
            print(
                f"{engine} {variant.name}: {len(table.inputs)} inputs",
                *table.left_out,
                sep="; ",
                flush=True,
            )
