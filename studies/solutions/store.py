"""Write a solution of a scene as a reference: `<id>.npz` with its arrays, and `<id>.toml` with their description."""

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gauge_envs.scoring.answers import mattering_distance

CAPTURE_MM = 1.0
"""Standard uncertainty of motion capture in one coordinate, the smallest scale of a reward [mm]."""

LICENCE = "Apache-2.0 (this project)"


def store_solution(
    stem: Path,
    *,
    kind: str,
    coordinates: Sequence[str],
    source: str,
    mean: NDArray[np.float64],
    uncertainty: NDArray[np.float64],
    projection: NDArray[np.float64] | None = None,
    unit: str = "mm",
) -> None:
    """Write the two files of a solution; events that the description has stay.

    Args:
        stem: Path of the files without their suffix; its name is the id without the namespace.
        kind: `analytic` or `numerical`.
        coordinates: Names of the C coordinates.
        source: Origin of the motion, one sentence.
        mean: Motion, shape [T, C]; NaN after the solution ends.
        uncertainty: Its standard uncertainty, shape [T, C].
        projection: Map from g(t) to the coordinates, shape [C, D]; None is identity.
        unit: Unit of motion and uncertainty.
    """
    known = np.isfinite(mean).all(axis=1)
    # Distances of markers are root mean squares over them.
    count = len(coordinates) // 3 if coordinates[0].startswith("marker-") else 1
    moved = np.sqrt(np.square(mean[known] - mean[0]).sum(axis=1).mean() / count)
    scale = CAPTURE_MM if unit == "mm" else mattering_distance(float(moved), unit)
    arrays = {
        "mean": mean,
        "sigma": np.hypot(uncertainty, scale),
        "uncertainty": uncertainty,
        "measured": known,
    }
    if projection is not None:
        arrays["projection"] = projection
    np.savez_compressed(stem.with_suffix(".npz"), **arrays)
    u = np.sqrt(np.square(uncertainty[known]).sum(axis=1).mean() / count)
    names = ", ".join(f'"{name}"' for name in coordinates)
    lines = [
        f'kind = "{kind}"',
        f'unit = "{unit}"',
        f"coordinates = [{names}]",
        f'source = "{source}"',
        f'licence = "{LICENCE}"',
        f"standard_uncertainty = {u:.6g}  # {unit}",
        f"zero_motion_distance = {moved:.10g}",
    ]
    sidecar = stem.with_suffix(".toml")
    old = sidecar.read_text(encoding="utf-8") if sidecar.is_file() else ""
    events = re.search(r"\n\[\[events\]\].*", old, re.DOTALL)
    text = "\n".join(lines) + "\n" + (events.group() if events else "")
    sidecar.write_text(text, encoding="utf-8")
    print(f"{stem.name:28} u = {u:.3g} of {moved:.4g} {unit}")
