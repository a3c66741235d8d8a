"""Effect of air on TextileFlinging with MuJoCo: lag, swings, paths of the markers, curvature, flutter, decay, and cost.

    python studies/air/air.py [--plot studies/air/air_fling.png] [--json FILE]

Each fabric runs with and without air, from the flat start and from a start with small waves. Waves displace each free
vertex of the cloth along its normal: `WAVE_M` times a sine along the rod and along the warp.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

import gauge_envs
from gauge_envs.envs.env import GaugeEnv
from gauge_envs.scene.timing import FRAME_RATE_HZ

sys.path.insert(0, str(Path(__file__).parents[2] / "scripts"))
from scripts.build_recordings import read_table

FACTS = Path(__file__).parents[2] / "scoring" / "facts" / "recordings"
FAMILY = "TextileFlinging"
FLING_ZERO_S = 1.14
FRAMES = 100
"""Frames of a run: 3.3 s, of which the rod moves for 1.35 s."""
WAVY = ("satin", "leather")
"""Fabrics that also start with waves: the lightest and the heaviest."""
ADDED = ("rayon", "satin", "leather")
"""Fabrics that also run with inertia of the air along y."""
WAVE_FRAMES = 45
ROD_STOPS_S = 1.35
WAVE_M, WAVES_ALONG_ROD, WAVES_ALONG_WARP = 1e-3, 2, 3
ADDED_KG_PER_M2 = 0.243
"""Added mass per area of a plate of 0.4 m by 0.5 m in air: 0.642 rho pi/4 0.4 m."""
ROWS = 9
"""Markers of one column, from the lower edge to the rod."""

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Run:
    """One episode with zero actions.

    Attributes:
        times_s: Times of the frames [s], shape [frame_count].
        markers_m: Markers [m], shape [frame_count, marker_count, 3].
        angles_deg: Chord from the rod to the lower edge, from hanging, positive towards +y [deg].
        curvature: Observable of the experiment, shape [frame_count, coordinate_count].
        cpu_s: Processor time of the steps [s].
    """

    times_s: FloatArray
    markers_m: FloatArray
    angles_deg: FloatArray
    curvature: FloatArray
    cpu_s: float


def run(
    fabric: str,
    parameters: Any,
    *,
    waves: bool = False,
    added_mass: bool = False,
    frames: int = FRAMES,
) -> Run:
    """Run a fabric from the flat start or from one with waves; with inertia of the air along y, or without."""
    made = gymnasium.make(
        f"GAUGE/{FAMILY}-{fabric}",
        backend="mujoco",
        parameters=parameters,
        marker_proxy="material",
        drivers="bundled",
    )
    env = made.unwrapped
    assert isinstance(env, GaugeEnv)
    observation, _ = made.reset(seed=0)
    if added_mass:
        _add_mass(env)
    if waves:
        _add_waves(env)
    action = np.zeros(env.action_space.shape or 0)
    edge = observation["markers"][:, 2] < observation["markers"][:, 2].min() + 1e-3
    markers, angles = [], []
    started = time.process_time()
    for _ in range(frames):
        chord = observation["markers"][edge].mean(axis=0) - observation["driver"][0, :3]
        angles.append(math.degrees(math.atan2(chord[1], -chord[2])))
        markers.append(observation["markers"])
        observation, _, terminated, truncated, _ = made.step(action)
        if terminated or truncated:
            break
    cpu_s = time.process_time() - started
    curvature = env.trajectory().frames[: len(markers)]
    made.close()
    return Run(
        np.arange(len(markers)) / FRAME_RATE_HZ,
        np.array(markers),
        np.array(angles),
        curvature,
        cpu_s,
    )


def _add_mass(env: GaugeEnv) -> None:
    """Give the free vertices inertia without weight along y, the direction of the fling.

    It stands for the added mass of a plate that hangs almost upright. It is no model of it: a plate that leans has its
    added mass along its normal.
    """
    simulation: Any = env.simulation
    (part,) = simulation._parts.values()  # noqa: SLF001  no public option adds mass
    areas = part.grid.vertex_areas_m2()[part.points.free]
    # MuJoCo reads the inertia of single slide joints from the compiled table, not from the armature.
    simulation.model.dof_M0[part.points.dofs[:, 1]] += ADDED_KG_PER_M2 * areas


def _add_waves(env: GaugeEnv) -> None:
    """Displace the free vertices along the normal of the flat cloth, before the first step."""
    simulation: Any = env.simulation
    (part,) = simulation._parts.values()  # noqa: SLF001  no public option starts a cloth with waves
    x, z = part.rest_m[:, 0], part.rest_m[:, 2]
    along = (x - x.min()) / np.ptp(x)
    down = (z.max() - z) / np.ptp(z)
    wave = (
        WAVE_M
        * np.sin(2 * np.pi * WAVES_ALONG_ROD * along)
        * np.sin(np.pi * WAVES_ALONG_WARP * down)
    )
    points = part.points
    simulation.data.qpos[points._addresses[:, 1]] += wave[points.free]  # noqa: SLF001


def swings(times_s: FloatArray, angles_deg: FloatArray) -> list[tuple[float, float]]:
    """Return the largest lag, the swing past the rod and the swing back: angle [deg] and time [s] of each."""
    clip = times_s <= 2.9
    angles = angles_deg[clip]
    forward = int(angles.argmin())
    lag, back = int(angles[:forward].argmax()), forward + int(angles[forward:].argmax())
    return [
        (float(angles[index]), float(times_s[index])) for index in (lag, forward, back)
    ]


def decay_per_cycle(one: Run) -> float:
    """Return the squared ratio of two swings, the largest after the rod stops and the next one to the other side.

    They are half a cycle apart, so the square is the decay over a cycle.
    """
    angles, times = one.angles_deg, one.times_s
    sizes = np.abs(angles)
    inner = (
        (sizes[1:-1] > sizes[:-2])
        & (sizes[1:-1] >= sizes[2:])
        & (times[1:-1] > ROD_STOPS_S)
    )
    places = np.flatnonzero(inner) + 1
    first = max(places[:-1], key=lambda place: sizes[place])
    later = [
        place
        for place in places
        if place > first and np.sign(angles[place]) != np.sign(angles[first])
    ]
    return float((sizes[later[0]] / sizes[first]) ** 2)


def deviation_mm(one: Run) -> FloatArray:
    """Return the rms distance of the markers from the mean of their row along the rod [mm], shape [frame_count].

    A sheet that swings flat has none. Coordinates along the rod do not count.
    """
    rows = one.markers_m.reshape(len(one.markers_m), -1, ROWS, 3)[..., 1:]
    return np.asarray(
        1e3
        * np.sqrt(
            np.square(rows - rows.mean(axis=1, keepdims=True))
            .sum(axis=-1)
            .mean(axis=(1, 2))
        )
    )


def summary(fabric: str) -> dict[str, Any]:
    """Return all numbers of one fabric."""
    still, air = run(fabric, "calibrated"), run(fabric, "air")
    heavy = [run(fabric, "air", added_mass=True)] if fabric in ADDED else []
    wavy = [
        run(fabric, one, waves=True, frames=WAVE_FRAMES)
        for one in ("calibrated", "air")
        if fabric in WAVY
    ]
    count = min(len(still.times_s), len(air.times_s))
    apart = np.linalg.norm(still.markers_m[:count] - air.markers_m[:count], axis=2)

    def rms(values: FloatArray) -> float:
        return float(np.sqrt(np.nanmean(np.square(values))))

    return {
        "fabric": fabric,
        "swings": [swings(one.times_s, one.angles_deg) for one in (still, air, *heavy)],
        "path_mm": [
            1e3 * float(np.sqrt(np.square(apart).mean())),
            1e3 * float(apart.max()),
        ],
        "curvature_rms": [rms(one.curvature) for one in (still, air)],
        "curvature_rms_waves": [rms(one.curvature) for one in wavy],
        "flutter_mm": [
            float(np.sqrt(np.square(deviation_mm(one)).mean())) for one in (still, air)
        ],
        "flutter_waves_mm": [
            float(np.sqrt(np.square(deviation_mm(one)).mean())) for one in wavy
        ],
        "decay": [decay_per_cycle(one) for one in (still, air, *heavy)],
        "cpu_per_s": [
            one.cpu_s / (len(one.times_s) / FRAME_RATE_HZ) for one in (still, air)
        ],
        "angles_deg": [one.angles_deg.tolist() for one in (still, air, *heavy)],
        "waves_over_time_mm": [deviation_mm(one).tolist() for one in wavy],
    }


def print_tables(rows: list[dict[str, Any]]) -> None:
    """Print the tables of the study."""
    recorded = read_table(FACTS / "textile_flinging_chord.csv")
    found = swings(recorded["time_s"] - FLING_ZERO_S, recorded["angle_deg"])
    print(
        "| fabric | air | lags by | swings past to | swings back to | decay per cycle |"
    )
    print("|---|---|---|---|---|---|")
    print(
        f"| recorded, +- 3.4 | | {' | '.join(f'{angle:+.1f} at {at:.2f} s' for angle, at in found)} | |"
    )
    for row in rows:
        names = ("no", "yes", "yes, with inertia along y")
        for name, three, ratio in zip(names, row["swings"], row["decay"], strict=False):
            cells = " | ".join(f"{angle:+.1f} at {at:.2f} s" for angle, at in three)
            print(f"| {row['fabric']} | {name} | {cells} | {ratio:.2f} |")
    print(
        "\n| fabric | markers move by, rms (largest) [mm] | curvature, rms [rad] | processor time per second |"
    )
    print("|---|---|---|---|")
    for row in rows:
        still, air = row["cpu_per_s"]
        curvature = " / ".join(f"{value:.3g}" for value in row["curvature_rms"])
        path = f"{row['path_mm'][0]:.0f} ({row['path_mm'][1]:.0f})"
        print(
            f"| {row['fabric']} | {path} | {curvature} | {still:.2f} / {air:.2f}, {100 * (air / still - 1):+.0f} % |"
        )
    print(
        "\n| fabric | deviation from flat rows, flat start [mm] | start with waves | curvature with waves [rad] |"
    )
    print("|---|---|---|---|")
    for row in rows:
        if row["flutter_waves_mm"]:
            keys = ("flutter_mm", "flutter_waves_mm", "curvature_rms_waves")
            print(
                f"| {row['fabric']} | "
                + " | ".join(" / ".join(f"{v:.2g}" for v in row[key]) for key in keys)
                + " |"
            )


def plot(rows: list[dict[str, Any]], path: Path) -> None:
    """Draw the angle of the chord of the lightest and the heaviest fabric, and the recording."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    recorded = read_table(FACTS / "textile_flinging_chord.csv")
    figure, axes = pyplot.subplots(
        1, 2, figsize=(8.0, 3.2), sharey=True, layout="constrained"
    )
    for axis, fabric in zip(axes, ("satin", "leather"), strict=True):
        row = next(one for one in rows if one["fabric"] == fabric)
        labels = ("without air", "with air", "with air and inertia along y")
        for label, angles, colour in zip(
            labels, row["angles_deg"], ("C0", "C1", "C2"), strict=False
        ):
            axis.plot(
                np.arange(len(angles)) / FRAME_RATE_HZ,
                angles,
                colour,
                label=label,
                linewidth=1.2,
            )
        axis.errorbar(
            recorded["time_s"] - FLING_ZERO_S,
            recorded["angle_deg"],
            3.4,
            fmt=".k",
            markersize=3,
            elinewidth=0.5,
            label="recording of an unknown fabric",
        )
        axis.axvline(ROD_STOPS_S, color="0.6", linewidth=0.8, linestyle=":")
        axis.set(title=fabric, xlabel="time [s]", xlim=(0.0, FRAMES / FRAME_RATE_HZ))
    axes[0].set_ylabel("angle of the chord [deg]")
    axes[0].legend(fontsize="x-small", loc="upper right")
    figure.savefig(path, dpi=110)


def main() -> None:
    """Run all fabrics, or read their numbers, and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--plot", type=Path, help="write the figure to this file")
    parser.add_argument(
        "--json",
        type=Path,
        help="keep the numbers in this file; fabrics that it has do not run again",
    )
    arguments = parser.parse_args()
    rows: list[dict[str, Any]] = []
    if arguments.json is not None and arguments.json.exists():
        rows = json.loads(arguments.json.read_text(encoding="utf-8"))
    for variant in gauge_envs.variants():
        if variant.family != FAMILY or any(
            row["fabric"] == variant.material for row in rows
        ):
            continue
        rows.append(summary(variant.material))
        if arguments.json is not None:
            arguments.json.write_text(json.dumps(rows), encoding="utf-8")
    print_tables(rows)
    if arguments.plot is not None:
        plot(rows, arguments.plot)


if __name__ == "__main__":
    main()
