"""Solve BiasStretching: a strip cut at 45 degrees to the warp that stretches under its weight, which a hoist varies.

    python studies/solutions/bias.py solve [FOLDER]
    python studies/solutions/bias.py engines ENGINE [FABRIC]

Along the strip, its stiffness E per width is 1 / E = 1 / (2 K_s) + 1 / (4 K_sh) (Jones, Mechanics of composite
materials, equation 2.97, without Poisson effect). With K_s much larger it is the rule of the FAST-3 test.

The extension v of a strip with density rho, whose hoist has the acceleration a, follows rho v_tt = E v_ss + rho (g + a)
with v = 0 at the clamp and v_s = 0 at the free end. For a = -g cos(W t) from rest, each mode has a closed form.

u is what this leaves out: the second order of the strain, 3/2 of its square in a St. Venant-Kirchhoff law, and the
free vibration, which a real fabric damps.

`engines` prints the distance of an engine from the closed form, and the mean ratio of its extension to that.
"""

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from store import store_solution

from gauge_envs import load_experiment
from gauge_envs.experiments.task_files import fabrics
from gauge_envs.files import data_folder
from gauge_envs.runs.episodes import run_episode
from gauge_envs.runs.request import RunRequest
from gauge_envs.scene import Cloth, Scene
from gauge_envs.scene.profiles import CosineProfile
from gauge_envs.scene.timing import FRAME_RATE_HZ

Array = NDArray[np.float64]

MODES = 400
"""Modes of the strip; the last adds a ten millionth of the extension."""

PLACES = 401
"""Places along the strip at which the second order of the strain is summed."""

FAMILY = "BiasStretching"


def bias_stiffness_n_per_m(cloth: Cloth) -> float:
    """Return force per width over strain at 45 degrees to the warp [N/m]."""
    stretch, shear = cloth.stretch_stiffness_n_per_m, cloth.shear_stiffness_n_per_m
    return 1.0 / (0.5 / stretch + 0.25 / shear)


def extensions_m(
    scene: Scene, times_s: Array, places_m: Array
) -> tuple[Array, Array, Array]:
    """Return extension and strain, and the free vibration in the extension [m], each of shape [T, P].

    Args:
        scene: The scene.
        times_s: Times [s], shape [T].
        places_m: Distances from the clamp [m], shape [P].
    """
    (strip,), (held,) = scene.deformables, scene.attachments
    assert isinstance(strip, Cloth)
    length_m = strip.size_m[0] - held.region.depth_m
    profile = scene.drivers[0].motions[0].profiles[0]
    assert isinstance(profile, CosineProfile)
    drive_rad_per_s = np.pi / profile.duration_s
    gravity = scene.gravity_m_per_s2
    first_m_per_s2 = 0.5 * profile.amount * drive_rad_per_s**2
    assert abs(first_m_per_s2 + gravity) < 1e-6, "the hoist does not start in free fall"

    odd = 2.0 * np.arange(MODES) + 1.0
    waves = 0.5 * np.pi * odd / length_m
    speed_m_per_s = np.sqrt(
        bias_stiffness_n_per_m(strip) / strip.areal_density_kg_per_m2
    )
    rates = speed_m_per_s * waves
    # The weight g (1 - cos W t) has the share 4 / (pi odd) of each mode.
    loads = 4.0 * gravity / (np.pi * odd)
    steady = loads / rates**2
    driven = loads / (rates**2 - drive_rad_per_s**2)
    free = (driven - steady) * np.cos(np.outer(times_s, rates))
    drive = np.cos(drive_rad_per_s * times_s)[:, None]
    modes = steady - driven * drive + free
    shapes = np.sin(np.outer(waves, places_m))
    slopes = waves[:, None] * np.cos(np.outer(waves, places_m))
    return modes @ shapes, modes @ slopes, free @ shapes


def motion_m(scene: Scene, frame_count: int) -> tuple[Array, Array]:
    """Return heights of the markers relative to the first, and what they leave out [m], shape [T, M - 1]."""
    times_s = np.arange(frame_count) / FRAME_RATE_HZ
    (strip,), (held,) = scene.deformables, scene.attachments
    top_m = strip.pose.position_m[2] + 0.5 * strip.size_m[0] - held.region.depth_m
    starts_m = np.array(scene.markers.positions_m)[:, 2]
    markers_m = top_m - starts_m
    places_m = np.linspace(0.0, markers_m[-1], PLACES)
    extension_m, strain, free_m = extensions_m(scene, times_s, places_m)
    second_m = 1.5 * np.square(strain).cumsum(axis=1) * places_m[1]
    rows = np.rint(markers_m / places_m[1]).astype(int)
    assert np.allclose(places_m[rows], markers_m, atol=1e-9), "a marker is no place"

    def since_first(along_m: Array) -> Array:
        return along_m[:, rows[1:]] - along_m[:, rows[:1]]

    heights_m = starts_m[1:] - starts_m[0] - since_first(extension_m)
    left_out_m = np.hypot(since_first(second_m), since_first(free_m))
    return heights_m, left_out_m


def projection(marker_count: int) -> Array:
    """Return the map from x, y, z of the markers to heights relative to the first, shape [M - 1, 3 M]."""
    heights = np.zeros((marker_count - 1, marker_count, 3))
    heights[:, 0, 2] = -1.0
    heights[range(marker_count - 1), range(1, marker_count), 2] = 1.0
    return heights.reshape(marker_count - 1, -1)


def solve(folder: Path) -> None:
    """Write the references of all fabrics."""
    for material in fabrics(FAMILY):
        variant = f"{FAMILY}-{material}"
        experiment = load_experiment(variant)
        mean_m, uncertainty_m = motion_m(experiment.scene, experiment.frame_count)
        count = mean_m.shape[1]
        store_solution(
            folder,
            variant,
            kind="analytic",
            coordinates=[f"height-{number}" for number in range(1, count + 1)],
            source="linear elastic strip at 45 degrees under a weight that varies; heights are relative to the highest "
            "marker; u is the second order of the strain and the free vibration",
            mean=1e3 * mean_m,
            uncertainty=1e3 * uncertainty_m,
            projection=projection(count + 1),
        )


def engines(backend: str, only: str) -> None:
    """Print the distance of an engine from the closed form, by fabric."""
    for material in fabrics(FAMILY):
        if only not in material:
            continue
        variant = f"{FAMILY}-{material}"
        experiment = load_experiment(variant)
        result = run_episode(RunRequest(variant, backend=backend))
        assert result.trajectory is not None, result.error
        markers_m = result.trajectory.markers_m()
        assert markers_m is not None
        mean_m, _ = motion_m(experiment.scene, len(markers_m))
        measured_m = markers_m[:, 1:, 2] - markers_m[:, :1, 2]
        asked_m, moved_m = mean_m - mean_m[0], measured_m - mean_m[0]
        share = np.linalg.norm(moved_m - asked_m) / np.linalg.norm(asked_m)
        ratio = np.vdot(moved_m, asked_m) / np.vdot(asked_m, asked_m)
        print(f"{backend}, {material}: {share:.2%} off, extension x {ratio:.4f}")


if __name__ == "__main__":
    if sys.argv[1] == "solve":
        solve(Path(sys.argv[2]) if sys.argv[2:] else data_folder("scoring") / "bands")
    else:
        engines(sys.argv[2], sys.argv[3] if sys.argv[3:] else "")
