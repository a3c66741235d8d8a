"""Solve StripBending: the heavy elastica of a strip whose clamp turns slowly, and compare engines with it.

    python studies/solutions/strip.py solve [FOLDER]
    python studies/solutions/strip.py engines ENGINE [CASE]

At the angle theta above the level, a strip with bending stiffness B and weight per area w has B theta'' = w (L - s) cos
theta, with the angle of the clamp at s = 0 and no moment at its end (Peirce 1930). For small angles the end droops by
w L^4 / 8 B. u is what this leaves out: the inertia of the turning strip, in first order of its acceleration, and its
stretch.

`engines` prints the distance of an engine from the elastica by fabric, length and size of cells, and with 0.8 and 1.2
of the bending stiffness.
"""

import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_bvp
from store import store_solution

from gauge_envs import load_experiment
from gauge_envs.experiments.task_files import fabrics
from gauge_envs.experiments.variants import (
    Variant,
    find_variant,
    matching_variants,
    task_path,
)
from gauge_envs.files import data_folder
from gauge_envs.runs.episodes import run_episode
from gauge_envs.runs.request import RunRequest
from gauge_envs.scene import GRAVITY_M_PER_S2, Scene
from gauge_envs.scene.fabrics import Fabric, bending_length_m
from gauge_envs.scene.timing import FRAME_RATE_HZ

Array = NDArray[np.float64]

Load = Callable[[Array], Array]
"""Force per weight, x and z, at places along the strip [m], shape [2, N]."""

POINTS = 121
"""Places along the strip at which its motion is known."""


def weight(places_m: Array) -> Array:
    """Return the force of gravity per weight, shape [2, N]."""
    return np.stack([np.zeros_like(places_m), -np.ones_like(places_m)])


def elastica(
    length_m: float, bending_length: float, clamp_rad: float, load: Load = weight
) -> Array:
    """Return x and z of a strip from its clamp [m], at `POINTS` even places, shape [POINTS, 2].

    Args:
        length_m: Free length L.
        bending_length: (B / w)^(1/3) [m].
        clamp_rad: Angle of the clamp above the level.
        load: Force per weight.
    """
    places_m = np.linspace(0.0, length_m, POINTS)
    step_m = places_m[1]

    def beyond(at_m: Array) -> Array:
        """Return the force on the strip beyond some places, per weight and length."""
        force = load(places_m)
        parts = 0.5 * step_m * (force[:, 1:] + force[:, :-1])
        total = np.concatenate([np.zeros((2, 1)), parts.cumsum(axis=1)], axis=1)
        rest = total[:, -1:] - total
        return np.stack([np.interp(at_m, places_m, row) for row in rest])

    def slopes(at_m: Array, state: Array) -> Array:
        along, up = beyond(at_m)
        turning = along * np.sin(state[0]) - up * np.cos(state[0])
        return np.stack([state[1], turning / bending_length**3])

    def ends(low: Array, high: Array) -> Array:
        return np.array([low[0] - clamp_rad, high[1]])

    guess = np.zeros((2, POINTS))
    down = np.exp(-places_m / bending_length)
    guess[0] = -0.5 * np.pi + (clamp_rad + 0.5 * np.pi) * down
    solution = solve_bvp(slopes, ends, places_m, guess, tol=1e-8, max_nodes=20_000)
    assert solution.success, solution.message
    fine = np.linspace(0.0, length_m, 20 * (POINTS - 1) + 1)
    angle = solution.sol(fine)[0]
    headings = np.column_stack([np.cos(angle), np.sin(angle)])
    middles = 0.5 * (headings[1:] + headings[:-1]) * fine[1]
    return np.concatenate([np.zeros((1, 2)), middles.cumsum(axis=0)])[::20]


def motion_m(scene: Scene, frame_count: int) -> tuple[Array, Array]:
    """Return the markers of the elastica and what it leaves out [m], each of shape [T, M, 3]."""
    clamp, (strip,) = scene.body("clamp"), scene.deformables
    (held,) = scene.attachments
    times_s = np.arange(frame_count) / FRAME_RATE_HZ
    (turning,) = scene.drivers[0].motions
    clamp_rad = -0.5 * np.pi - np.array([turning.value(time) for time in times_s])
    middle_m = np.array(clamp.pose.position_m)
    depth_m = held.region.depth_m
    length_m = strip.size_m[0] - depth_m
    fabric = Fabric.of(strip)
    bending_length = bending_length_m(fabric)

    def strips(loads: list[Load]) -> Array:
        cases = zip(clamp_rad, loads, strict=True)
        found = [elastica(length_m, bending_length, *case) for case in cases]
        edges = np.column_stack([np.cos(clamp_rad), np.sin(clamp_rad)])
        return np.array(found) + 0.5 * depth_m * edges[:, None]

    still_m = strips([weight] * frame_count)
    rate = np.gradient(np.gradient(still_m, times_s, axis=0), times_s, axis=0)
    loads = [
        lambda _, own=-own.T / GRAVITY_M_PER_S2: weight(own[0]) + own for own in rate
    ]
    moved_m = np.abs(strips(loads) - still_m)
    places_m = np.linspace(0.0, length_m, POINTS)
    pull_n_per_m = fabric.areal_density_kg_per_m2 * GRAVITY_M_PER_S2 * length_m
    # At most the stretch of a hanging strip.
    along_m = places_m * (1.0 - 0.5 * places_m / length_m)
    stretch_m = pull_n_per_m / fabric.stretch_stiffness_n_per_m * along_m
    left_out_m = np.hypot(moved_m, stretch_m[:, None] * np.sqrt(0.5))
    start_m = middle_m[2] - np.array(scene.markers.positions_m)[:, 2] - 0.5 * depth_m
    rows = np.rint(start_m / places_m[1]).astype(int)
    assert np.allclose(places_m[rows], start_m, atol=1e-9), "a marker is no point"
    shape = (frame_count, len(rows), 3)
    mean_m, uncertainty_m = np.tile(middle_m, (*shape[:2], 1)), np.zeros(shape)
    mean_m[..., [0, 2]] += still_m[:, rows]
    uncertainty_m[..., [0, 2]] = left_out_m[:, rows]
    return mean_m, uncertainty_m


def solve(folder: Path) -> None:
    """Write the references of all fabrics."""
    for material in fabrics("StripBending"):
        variant = f"StripBending-{material}"
        experiment = load_experiment(variant)
        mean_m, uncertainty_m = motion_m(experiment.scene, experiment.frame_count)
        store_solution(
            folder / variant,
            kind="analytic",
            coordinates=experiment.coordinates,
            source="heavy elastica at rest at each angle of the clamp; u is the inertia and the stretch of the strip",
            mean=1e3 * mean_m.reshape(len(mean_m), -1),
            uncertainty=1e3 * uncertainty_m.reshape(len(mean_m), -1),
        )


# --- engines ----------------------------------------------------------------------------------------------------------


def run(variant: Variant, backend: str, **changes: Any) -> str:
    """Return the distance of an engine from the elastica of the published constants, and its motion."""
    result = run_episode(RunRequest(variant, backend=backend, **changes))
    assert result.trajectory is not None, result.error
    markers_m = result.trajectory.markers_m()
    assert markers_m is not None
    mean_m, _ = motion_m(load_experiment(variant).scene, len(markers_m))
    apart_m = np.sqrt(np.square(markers_m - mean_m).sum(axis=2).mean())
    moved_m = np.sqrt(np.square(mean_m - mean_m[0]).sum(axis=2).mean())
    share = apart_m / moved_m
    return f"{1e3 * apart_m:.3f} mm of {1e3 * moved_m:.2f} mm, {share:.2%}"


def of_size(folder: Path, length_m: float, width_m: float) -> Variant:
    """Return satin of a copy of the task with another overhang and width."""
    text = task_path("StripBending").read_text(encoding="utf-8")
    heights_m = [-0.00125 - length_m * part / 6.0 for part in range(1, 7)]
    markers = ", ".join(f"[0.0, 0.0, {height:.9g}]" for height in heights_m)
    text = re.sub(r"(positions_m = \[)[^a-z]*\n\]", rf"\1{markers}]", text)
    name = f"{1e3 * length_m:.0f}x{1e3 * width_m:.0f}"
    for old, new in (
        ('"StripBending"', f'"StripBending{name}"'),
        ("[0.0325, 0.0025]", f"[{length_m + 0.0025:.9g}, {width_m}]"),
        ("0.0, -0.015]", f"0.0, {-0.5 * length_m:.9g}]"),
    ):
        text = text.replace(old, new)
    file = folder / f"strip{name}.toml"
    file.write_text(text, encoding="utf-8")
    return matching_variants(str(file))[1]


def cases(folder: Path) -> Iterator[tuple[str, Variant, dict[str, Any]]]:
    """Yield label, variant and changes of each run."""
    known = fabrics("StripBending")
    for material in known:
        yield material, find_variant(f"StripBending-{material}"), {}
    satin = find_variant("StripBending-satin")
    for share in (0.8, 1.2):
        stiffness = share * known["satin"].bend_stiffness_n_m_per_rad
        parameters = {"strip.bend_stiffness_n_m_per_rad": stiffness}
        yield f"satin, {share} of bending", satin, {"parameters": parameters}
    for length_m in (0.02, 0.04):
        label = f"satin, {1e3 * length_m:.0f} mm long"
        yield label, of_size(folder, length_m, 0.0025), {}
    wide = of_size(folder, 0.03, 0.005)
    for cell_m in (0.0025, 0.00125, 0.000625):
        label = f"satin, 5 mm wide, cells of {1e3 * cell_m:g} mm"
        yield label, wide, {"settings": {"cell_m": cell_m}}


def engines(backend: str, only: str) -> None:
    """Print distances of an engine by fabric, bending stiffness, length and cells."""
    with TemporaryDirectory() as folder:
        for label, variant, changes in cases(Path(folder)):
            if only in label:
                text = run(variant, backend, **changes)
                print(f"{backend}, {label}: {text}", flush=True)


if __name__ == "__main__":
    if sys.argv[1] == "solve":
        solve(Path(sys.argv[2]) if sys.argv[2:] else data_folder("scoring") / "bands")
    else:
        engines(sys.argv[2], sys.argv[3] if sys.argv[3:] else "")
