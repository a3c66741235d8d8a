"""Write a solution of a scene as a reference: `<id>.npz` with its arrays, and `<id>.toml` with their description."""

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

CAPTURE_MM = 1.0
"""Standard uncertainty of motion capture in one coordinate, the smallest scale of a reward [mm]."""

LICENCE = "Apache-2.0 (this project)"


def store_solution(
    folder: Path,
    variant: str,
    *,
    kind: str,
    coordinates: Sequence[str],
    source: str,
    mean: NDArray[np.float64],
    uncertainty: NDArray[np.float64],
    projection: NDArray[np.float64] | None = None,
) -> None:
    """Write the two files of a solution in millimetres; events that the description has stay.

    Args:
        folder: Folder of the references.
        variant: Id without the namespace.
        kind: `analytic` or `numerical`.
        coordinates: Names of the C coordinates.
        source: Origin of the motion, one sentence.
        mean: Motion [mm], shape [T, C]; NaN after the solution ends.
        uncertainty: Its standard uncertainty [mm], shape [T, C].
        projection: Map from g(t) to the coordinates, shape [C, D]; None is identity.
    """
    known = np.isfinite(mean).all(axis=1)
    arrays = {
        "mean": mean,
        "sigma": np.hypot(uncertainty, CAPTURE_MM),
        "uncertainty": uncertainty,
        "measured": known,
    }
    if projection is not None:
        arrays["projection"] = projection
    np.savez_compressed(folder / f"{variant}.npz", **arrays)
    # Distances of markers are root mean squares over them.
    count = len(coordinates) // 3 if coordinates[0].startswith("marker-") else 1
    u_mm = np.sqrt(np.square(uncertainty[known]).sum(axis=1).mean() / count)
    moved = mean[known] - mean[0]
    moved_mm = np.sqrt(np.square(moved).sum(axis=1).mean() / count)
    names = ", ".join(f'"{name}"' for name in coordinates)
    lines = [
        f'kind = "{kind}"',
        'unit = "mm"',
        f"coordinates = [{names}]",
        f'source = "{source}"',
        f'licence = "{LICENCE}"',
        f"standard_uncertainty = {u_mm:.6g}  # mm",
        f"zero_motion_distance = {moved_mm:.10g}",
    ]
    sidecar = folder / f"{variant}.toml"
    old = sidecar.read_text(encoding="utf-8") if sidecar.is_file() else ""
    events = re.search(r"\n\[\[events\]\].*", old, re.DOTALL)
    text = "\n".join(lines) + "\n" + (events.group() if events else "")
    sidecar.write_text(text, encoding="utf-8")
    print(f"{variant:28} u = {u_mm:.3g} of {moved_mm:.4g} mm")
