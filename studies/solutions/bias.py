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


def motion_percent(scene: Scene, frame_count: int) -> tuple[Array, Array]:
    """Return lengths from the first marker to the others over those at rest, and u [%], each of shape [T, M - 1]."""
    times_s = np.arange(frame_count) / FRAME_RATE_HZ
    (strip,), (held,) = scene.deformables, scene.attachments
    top_m = strip.pose.position_m[2] + 0.5 * strip.size_m[0] - held.region.depth_m
    markers_m = top_m - np.array(scene.markers.positions_m)[:, 2]
    places_m = np.linspace(0.0, markers_m[-1], PLACES)
    extension_m, strain, free_m = extensions_m(scene, times_s, places_m)
    second_m = 1.5 * np.square(strain).cumsum(axis=1) * places_m[1]
    rows = np.rint(markers_m / places_m[1]).astype(int)
    assert np.allclose(places_m[rows], markers_m, atol=1e-9), "a marker is no place"

    def percent(along_m: Array) -> Array:
        since_first_m = along_m[:, rows[1:]] - along_m[:, rows[:1]]
        return 100.0 * since_first_m / (markers_m[1:] - markers_m[0])

    left_out = np.hypot(percent(second_m), percent(free_m))
    return 100.0 + percent(extension_m), left_out


def projection(scene: Scene) -> Array:
    """Return the map from x, y, z of the markers [mm] to the lengths of `motion_percent`, shape [M - 1, 3 M]."""
    heights_mm = 1e3 * np.array(scene.markers.positions_m)[:, 2]
    shares = 100.0 / (heights_mm[0] - heights_mm[1:])
    count = len(shares)
    lengths = np.zeros((count, count + 1, 3))
    lengths[:, 0, 2] = shares
    lengths[range(count), range(1, count + 1), 2] = -shares
    return lengths.reshape(count, -1)


def solve(folder: Path) -> None:
    """Write the references of all fabrics."""
    for material in fabrics(FAMILY):
        variant = f"{FAMILY}-{material}"
        experiment = load_experiment(variant)
        scene = experiment.scene
        mean, uncertainty = motion_percent(scene, experiment.frame_count)
        numbers = range(1, mean.shape[1] + 1)
        store_solution(
            folder / variant,
            kind="analytic",
            coordinates=[f"length-{number}" for number in numbers],
            source="linear elastic strip at 45 degrees under a weight that varies; lengths from the highest marker to "
            "the others are shares of those at rest; u is the second order of the strain and the free vibration",
            mean=mean,
            uncertainty=uncertainty,
            projection=projection(scene),
            unit="%",
        )


def engines(backend: str, only: str) -> None:
    """Print the distance of an engine from the closed form, by fabric."""
    for material in fabrics(FAMILY):
        if only not in material:
            continue
        variant = f"{FAMILY}-{material}"
        scene = load_experiment(variant).scene
        result = run_episode(RunRequest(variant, backend=backend))
        assert result.trajectory is not None, result.error
        measured = result.trajectory.markers_mm @ projection(scene).T
        mean, _ = motion_percent(scene, len(measured))
        asked, stretched = mean - mean[0], measured - mean[0]
        share = np.linalg.norm(stretched - asked) / np.linalg.norm(asked)
        ratio = np.vdot(stretched, asked) / np.vdot(asked, asked)
        print(f"{backend}, {material}: {share:.2%} off, extension x {ratio:.4f}")


if __name__ == "__main__":
    if sys.argv[1] == "solve":
        solve(Path(sys.argv[2]) if sys.argv[2:] else data_folder("scoring") / "bands")
    else:
        engines(sys.argv[2], sys.argv[3] if sys.argv[3:] else "")
