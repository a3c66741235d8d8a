"""Build the tables of sensitivities in `scoring/sensitivities/` by simulation.

    python scripts/build_sensitivities.py                          all engines, all variants that are scored by default
    python scripts/build_sensitivities.py --backend mujoco --ids "SlopeSlider-*"

A table states how the trajectory changes with each uncertain input (`gauge_envs.runs.sensitivity`). The intervals of
scores use it. It belongs to the default preset of the engine.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from fnmatch import fnmatchcase
from pathlib import Path

from generated import SCORING

from gauge_envs import load_experiment, reference_band, variants
from gauge_envs.references.grades import BandGrade
from gauge_envs.references.sensitivities import sensitivities_text
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.sensitivity import measure_sensitivities

ENGINES = ("mujoco", "drake", "genesis", "newton", "physx", "pybullet", "rapier")


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the tables; return the exit status."""
    parser = argparse.ArgumentParser(
        description="Build the tables of sensitivities by simulation."
    )
    parser.add_argument(
        "--backend", action="append", choices=ENGINES, help="engine; default: all"
    )
    parser.add_argument("--ids", default="*", help="pattern of variants")
    parser.add_argument("--out", type=Path, default=SCORING / "sensitivities")
    options = parser.parse_args(arguments)
    for engine in options.backend or ENGINES:
        for variant in variants():
            band = reference_band(load_experiment(variant.name))
            is_scored = (
                band is not None
                and band.grade is not BandGrade.MODEL
                and band.normalized_by_baseline
            )
            if not (is_scored and fnmatchcase(variant.name, options.ids)):
                continue
            file = options.out / engine / f"{variant.name}.json"
            file.parent.mkdir(parents=True, exist_ok=True)
            table = measure_sensitivities(RunRequest(variant.name, backend=engine))
            file.write_text(sensitivities_text(table), encoding="utf-8", newline="\n")
            print(
                f"{engine} {variant.name}: {len(table.inputs)} inputs",
                *table.left_out,
                sep="; ",
                flush=True,
            )
    return 0


if __name__ == "__main__":
    sys.exit(main())
