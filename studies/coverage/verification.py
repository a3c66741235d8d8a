"""Measure how often the 95 % interval of verification holds true distances of 0, 0.5, 1, 2 and 5 u.

    python -m studies.coverage.verification    1 minute

Errors of a solution have the stated u of each frame and coordinate. They are alike over few, some or all frames, and
in all coordinates or in each alone. An engine is off at a constant rate, in a direction of its own.
"""

from __future__ import annotations

import csv
import itertools
import sys
from pathlib import Path

import numpy as np

from gauge_envs.evaluation.reference import reference_band
from gauge_envs.evaluation.verification import (
    compared_points,
    solution_uncertainty,
    stated_uncertainty,
    verification_band,
    verify,
)
from gauge_envs.experiments.resolve import load_experiment
from studies.coverage.levels import LEVELS

VARIANTS = (
    "Turntable-2-wood",
    "SlopeSlider-3-plastic",
    "StickStack-soft",
    "TextileBending-satin",
)
"""Solutions that `tests/evaluation/test_verification.py` does not use."""

CORRELATIONS_FRAMES = (0.1, 10.0, 1e4)
WORLDS = 200
SEED = 71


def held(name: str, correlation_frames: float, *, shared: bool) -> list[float]:
    """Return the share of intervals that hold each true distance."""
    band = reference_band(load_experiment(name))
    compared = verification_band(band)
    u = None if band is None else solution_uncertainty(band)
    assert band is not None and compared is not None and u is not None
    known = np.isfinite(compared.mean).any(axis=1)
    spread = np.nan_to_num(stated_uncertainty(compared)[known])
    count, width = spread.shape
    apart = np.subtract.outer(np.arange(count), np.arange(count)) / correlation_frames
    root = np.linalg.cholesky(np.exp(-0.5 * apart**2) + 1e-6 * np.eye(count))
    norm = np.sqrt(count * compared_points(compared))
    used = np.isfinite(compared.mean[known])
    random = np.random.default_rng(
        [SEED, *name.encode(), int(correlation_frames), shared]
    )
    shares = []
    for level in LEVELS:
        inside = 0
        for _ in range(WORLDS):
            drawn = random.standard_normal((count, 1 if shared else width))
            error = spread * (root @ drawn)
            rates = random.standard_normal(width)
            offset = used * np.outer(np.linspace(0.0, 1.0, count), rates)
            offset *= level * u * norm / np.linalg.norm(offset)
            motion = np.nan_to_num(compared.mean)
            motion[known] += offset - error
            markers_m = 1e-3 * motion.reshape(-1, width // 3, 3)
            found = verify(
                band,
                frames=motion,
                markers_m=None if band.points is None else markers_m,
            )
            assert found is not None and found.distance_95 is not None
            low, high = found.distance_95
            inside += low <= level * u <= high
        shares.append(inside / WORLDS)
    return shares


def main() -> None:
    """Write the table beside this file."""
    file = Path(__file__).with_suffix(".csv")
    with file.open("w", newline="", encoding="utf-8") as text:
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(["variant", "alike_frames", "alike_coordinates", *LEVELS])
        for name, frames, shared in itertools.product(
            VARIANTS, CORRELATIONS_FRAMES, (True, False)
        ):
            shares = held(name, frames, shared=shared)
            writer.writerow([name, frames, "all" if shared else "each", *shares])
            print(name, frames, shared, *shares, file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
