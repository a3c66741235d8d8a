"""Files of recorded tosses: what the scripts that build them share."""

from __future__ import annotations

import argparse
import hashlib
import sys
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from generated import same_arrays, same_text
from numpy.typing import NDArray

__all__ = [
    "QUATERNION_COUNTS",
    "RATE_HZ",
    "REST_FRAMES",
    "median_error",
    "sidecar_head",
    "slope_error",
    "spread",
    "write_or_check",
]

RATE_HZ = 148.0

QUATERNION_COUNTS = 32767.0
"""Counts of a stored quaternion per unit."""

REST_FRAMES = 5
"""Last frames of a toss, which show the bodies at rest."""

FloatArray = NDArray[np.float64]
Arrays = Mapping[str, NDArray[np.generic]]


def spread(values: FloatArray) -> float:
    """Return a standard deviation from quartiles, which outliers do not move; of a normal distribution it is exact."""
    low, high = np.percentile(values, [25, 75])
    return float(high - low) / 1.349


def median_error(values: FloatArray) -> float:
    """Return the standard error of the median over the median."""
    # The standard error of a median of normal values is 1.2533 times that of their mean.
    return float(1.2533 * spread(values) / np.median(values) / np.sqrt(len(values)))


def slope_error(count: int) -> float:
    """Return the standard error [1/s] of the slope of a line through frames of unit noise."""
    times_s = np.arange(count) / RATE_HZ
    return float(1.0 / np.sqrt(np.sum(np.square(times_s - times_s.mean()))))


def sidecar_head(
    source: Path,
    *,
    script: str,
    name: str,
    body: str,
    trial_count: int,
    position_unit_m: float,
    origin: str,
    copies: Mapping[int, int],
) -> list[str]:
    """Return the first lines of a sidecar.

    Args:
        source: The authors' file.
        script: File name of the script.
        name: Name of the experiment.
        body: Body whose pose is recorded.
        trial_count: Number of tosses.
        position_unit_m: Metres of one count of a position.
        origin: Where the source is from, in words.
        copies: Tosses that repeat an earlier one, with the number of that one.
    """
    return [
        f"# Written by scripts/{script}; do not edit.",
        f'body = "{body}"',
        f"trial_count = {trial_count}",
        f"rate_hz = {RATE_HZ}",
        f"position_unit_m = {position_unit_m}",
        'fit = "even"',
        f'source = "{origin}"',
        f'source_sha256 = "{hashlib.sha256(source.read_bytes()).hexdigest()}"',
        f'licence = "{name}.LICENSE"',
        *_copies_lines(copies),
        "",
    ]


def _copies_lines(copies: Mapping[int, int]) -> list[str]:
    if not copies:
        return []
    rows = [
        f"    {{ trial = {trial}, of = {copies[trial]} }}," for trial in sorted(copies)
    ]
    return [
        "# The same recording as an earlier one, laid elsewhere on the table.",
        "copies = [",
        *rows,
        "]",
    ]


def write_or_check(
    generate: Callable[[Path], tuple[Arrays, str]],
    *,
    name: str,
    script: str,
    what: str,
    fitted: float = 1e-6,
) -> int:
    """Run the command line of a script that builds the files of recorded tosses.

    Args:
        generate: Function that returns the arrays and the text of the sidecar for the authors' file.
        name: Name of the experiment.
        script: File name of the script.
        what: Description of the script for its help.
        fitted: Tolerance of fitted numbers in a check.

    Returns:
        Exit status: 1 if a check found a file that is not current.
    """
    parser = argparse.ArgumentParser(description=what)
    parser.add_argument(
        "source", type=Path, help="NumPy archive of the authors' tosses"
    )
    parser.add_argument(
        "--check",
        action="store_true",
        help="write nothing; fail if a file is not current",
    )
    options = parser.parse_args()
    arrays, text = generate(options.source)
    file = Path(__file__).parents[1] / "scoring" / "single_shot" / f"{name}.npz"
    sidecar = file.with_suffix(".toml")
    if not options.check:
        sidecar.write_text(text, encoding="utf-8", newline="\n")
        np.savez_compressed(file, **arrays)
        return 0
    with np.load(file) as stored:
        current = same_arrays(dict(stored), arrays, fitted=fitted)
    described = same_text(sidecar.read_text("utf-8"), text)
    stale = [
        path for path, is_so in ((file, current), (sidecar, described)) if not is_so
    ]
    for path in stale:
        print(
            f"{path} is not current: run python scripts/{script} SOURCE",
            file=sys.stderr,
        )
    return 1 if stale else 0
