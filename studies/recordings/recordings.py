"""Published recordings compared with an engine: scores, areas of the foams, slip on the turntable, lag of the cloth.

    python studies/recordings/recordings.py [--backend mujoco] [--marker-proxy node]

Each recording is one trial. It does not show whether its foam is soft or hard, so both variants run.
"""

from __future__ import annotations

import argparse
import math
import sys
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import gymnasium
import numpy as np
from numpy.typing import NDArray

import gauge_envs
from gauge_envs.envs.env import GaugeEnv
from gauge_envs.evaluation.score import Score
from gauge_envs.scene import Pose
from gauge_envs.scene.timing import FRAME_RATE_HZ, SAMPLE_INTERVAL_S

sys.path.insert(0, str(Path(__file__).parents[2] / "scripts"))
from scripts.build_recordings import read_table

FOAMS = (
    "FoamStretching",
    "FoamCompressing",
    "FoamShearing",
    "FoamTwisting",
    "FoamBending",
)
FACTS = Path(__file__).parents[2] / "scoring" / "facts" / "recordings"
LEAST_FACES = 9
"""Number of faces, of twelve, that the frame of the area change must show at least."""
TURNTABLE_ZERO_S = 0.638
FLING_ZERO_S = 1.14
FLING_FRAMES = 85
"""Number of frames in the clip."""
TURNTABLE_WINDOWS = {"start": (1.0, 2.28), "first stop": (2.6, 3.76)}
"""Intervals between the speed changes, in seconds of the clip."""

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Rollout:
    """One episode with zero actions: environment, 180 Hz samples of g(t), 30 Hz frames, and score."""

    env: GaugeEnv
    times_s: FloatArray
    samples: FloatArray
    frames: FloatArray
    score: Score


def rollout(name: str, *, backend: str, marker_proxy: str = "material") -> Rollout:
    """Run a variant, and score it against its recording, also if that is withheld."""
    made = gymnasium.make(
        f"GAUGE/{name}",
        backend=backend,
        marker_proxy=marker_proxy,
        use_withheld=True,
        drivers="bundled",
    )
    env = made.unwrapped
    assert isinstance(env, GaugeEnv)
    made.reset(seed=0)
    zero = np.zeros(env.action_space.shape) if env.action_space.shape else 0
    while True:
        *_, terminated, truncated, info = made.step(zero)
        if terminated or truncated:
            break
    trajectory = env.trajectory()
    made.close()
    return Rollout(
        env, trajectory.times_s, trajectory.samples, trajectory.frames, info["score"]
    )


def rest_areas(family: str) -> FloatArray:
    """Return the areas of the twelve faces before the motion [mm^2], mean over the pictures, shape [12]."""
    name = f"foam_{family.removeprefix('Foam').lower()}"
    start_s = tomllib.loads((FACTS / "recordings.toml").read_text(encoding="utf-8"))[
        name
    ]["frame_zero_s"]
    table = read_table(FACTS / f"{name}.csv")
    rest = table["time_s"] < start_s
    return np.array([table[f"face_{face}_mm2"][rest].mean() for face in range(12)])


def print_fling(backend: str) -> None:
    """Print lag and swings of the cloth relative to the rod for all fabrics; the recorded fabric is not known."""
    recorded = read_table(FACTS / "textile_flinging_chord.csv")
    print(
        "\nTextileFlinging: chord from the rod to the lower edge, from hanging, positive towards +y [deg]\n"
    )
    print("| fabric | lags by | swings past to | swings back to |\n|---|---|---|---|")
    print(
        fling_row(
            "recorded, +- 3.4", recorded["time_s"] - FLING_ZERO_S, recorded["angle_deg"]
        )
    )
    for variant in gauge_envs.variants():
        if variant.family != "TextileFlinging":
            continue
        made = gymnasium.make(
            f"GAUGE/{variant.name}",
            backend=backend,
            marker_proxy="material",
            drivers="bundled",
        )
        env = made.unwrapped
        assert isinstance(env, GaugeEnv)
        observation, _ = made.reset(seed=0)
        edge = observation["markers"][:, 2] < observation["markers"][:, 2].min() + 1e-3
        angles = []
        for _ in range(FLING_FRAMES):
            chord = (
                observation["markers"][edge].mean(axis=0) - observation["driver"][0, :3]
            )
            angles.append(math.degrees(math.atan2(chord[1], -chord[2])))
            observation, *_ = made.step(np.zeros(env.action_space.shape or 0))
        made.close()
        print(
            fling_row(
                variant.material,
                np.arange(FLING_FRAMES) / FRAME_RATE_HZ,
                np.array(angles),
            )
        )


def fling_row(name: str, times_s: FloatArray, angles_deg: FloatArray) -> str:
    """Return the largest lag, swing past the rod and swing back with their times, as a row of a Markdown table."""
    forward = int(angles_deg.argmin())
    lag, back = (
        int(angles_deg[:forward].argmax()),
        forward + int(angles_deg[forward:].argmax()),
    )
    cells = [
        f"{angles_deg[index]:+.1f} at {times_s[index]:.2f} s"
        for index in (lag, forward, back)
    ]
    return f"| {name} | {' | '.join(cells)} |"


def foam_rows(family: str, *, backend: str, marker_proxy: str) -> list[str]:
    """Return the areas of the twelve faces, recorded and in both simulated foams, as rows of a Markdown table."""
    rows = []
    for hardness in ("soft", "hard"):
        run = rollout(
            f"{family}-{hardness}", backend=backend, marker_proxy=marker_proxy
        )
        band = run.env.band
        assert band is not None and band.uncertainty is not None
        faces = slice(0, 12)
        real, sigma, simulated = (
            band.mean[:, faces],
            band.uncertainty[:, faces],
            run.frames[:, faces],
        )
        known = np.isfinite(real)
        last = int(np.flatnonzero(known.sum(axis=1) >= LEAST_FACES)[-1])
        seen = known[last]
        at_rest = rest_areas(family)
        real_change, change = real - at_rest, simulated - simulated[0]
        inside = (np.abs(simulated - real) <= 2 * sigma)[known].mean()
        difference = math.sqrt(np.square((change - real_change)[known]).mean())
        motion = math.sqrt(np.square(real_change[known]).mean())
        cells = [
            family,
            hardness,
            f"{last / FRAME_RATE_HZ:.2f} s ({seen.sum()})",
            f"{100 * (real[last, seen].sum() / at_rest[seen].sum() - 1):+.1f} %",
            f"{100 * (simulated[last, seen].sum() / simulated[0, seen].sum() - 1):+.1f} %",
            f"{math.sqrt(np.square(at_rest - simulated[0]).mean()):.1f}",
            f"{motion:.1f}",
            f"{difference:.1f}",
            f"{np.median(sigma[known]):.1f}",
            f"{100 * inside:.0f} %",
            "-"
            if run.score.rmse_normalized is None
            else f"{run.score.rmse_normalized:.2f}",
        ]
        rows.append(f"| {' | '.join(cells)} |")
    return rows


def print_foams(backend: str, marker_proxy: str) -> None:
    """Print the table of the foams."""
    titles = (
        "experiment",
        "foam",
        "at (faces)",
        "change of area, recording",
        backend,
        "rest, off the simulated [mm^2]",
        "change of a face, recording [mm^2]",
        "difference of changes [mm^2]",
        "1 sigma of an area [mm^2]",
        "within 2 sigma",
        "normalized RMSE",
    )
    print(
        f"\nAreas of the faces, marker_proxy={marker_proxy}; root mean squares over faces and frames\n"
    )
    print(f"| {' | '.join(titles)} |\n|{'---|' * len(titles)}")
    for family in FOAMS:
        print("\n".join(foam_rows(family, backend=backend, marker_proxy=marker_proxy)))


def plate_angle_rad(env: GaugeEnv, times_s: FloatArray) -> FloatArray:
    """Return the rotation of the plate about z from frame 0 on [rad], unwrapped, shape [sample_count]."""
    scene = env.experiment.scene
    driver, start = scene.drivers[0], scene.body("plate").pose
    poses: list[Pose] = [driver.pose(start, time_s) for time_s in times_s]
    return np.unwrap(
        [2 * math.atan2(pose.quaternion[3], pose.quaternion[0]) for pose in poses]
    )


def print_turntable(backend: str) -> None:
    """Print slip and radius of the cube on the plate between the speed changes."""
    run = rollout("Turntable-3-metal", backend=backend)
    axis_mm = 1e3 * np.asarray(
        run.env.experiment.scene.body("plate").pose.position_m[:2]
    )
    arm = run.samples[:, :2] - axis_mm
    azimuth = np.unwrap(np.arctan2(arm[:, 1], arm[:, 0]))
    turned = plate_angle_rad(run.env, run.times_s)
    slip = np.degrees(azimuth - azimuth[0] - (turned - turned[0]))
    radius = np.linalg.norm(arm, axis=1)
    real = read_table(FACTS / "turntable.csv")
    print("\nTurntable-3-metal, means between the speed changes\n")
    print(
        f"| after | slip, recording [deg] | {backend} [deg] | radius, recording [mm] | {backend} [mm] |"
    )
    print("|---|---|---|---|---|")
    for name, (start_s, end_s) in TURNTABLE_WINDOWS.items():
        seen = (real["time_s"] >= start_s - 1e-6) & (real["time_s"] <= end_s + 1e-6)
        then = (run.times_s >= start_s - TURNTABLE_ZERO_S) & (
            run.times_s <= end_s - TURNTABLE_ZERO_S
        )
        slips = real["slip_deg"][seen]
        print(
            f"| {name} | {slips.mean():.1f} +- {slips.std():.1f} | {slip[then].mean():.1f} | "
            f"{real['radius_mm'][seen].mean():.1f} | {radius[then].mean():.1f} |"
        )
    print(f"\n{score_text(run)}; {SAMPLE_INTERVAL_S * 1e3:.1f} ms a sample")


def score_text(run: Rollout) -> str:
    """Return the score of a run in one line."""
    score = run.score
    parts = [
        f"grade {score.grade}",
        f"RMSE {score.rmse:.1f} {score.unit}",
        f"DTW {score.dtw:.1f} {score.unit}",
    ]
    if score.rmse_normalized is not None:
        parts.append(
            f"normalized {score.rmse_normalized:.2f}, {score.dtw_normalized:.2f}"
        )
    parts.append(
        f"aligned {score.rmse_aligned:.1f} {score.unit} at {score.release_offset_s:+.3f} s"
    )
    signed = ", ".join(f"{error:+.1f}" for error in score.signed_error or ())
    return "; ".join(
        [*parts, f"signed {signed} {score.unit}", f"mean |z| {score.mean_abs_z:.2f}"]
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Print all tables."""
    parser = argparse.ArgumentParser(description="Recordings beside an engine.")
    parser.add_argument("--backend", default="mujoco")
    parser.add_argument(
        "--marker-proxy",
        choices=("material", "node"),
        default="material",
        help="of the foams",
    )
    options = parser.parse_args(arguments)
    print_turntable(options.backend)
    for name in (
        "SlopeSlider-3-metal",
        "SlopeContact-wood",
        "Pendulum-metal",
        "TableclothPulling-metal",
    ):
        print(f"{name}: {score_text(rollout(name, backend=options.backend))}")
    for hardness in ("soft", "hard"):
        name = f"CantileverBeam-{hardness}"
        print(
            f"{name}: {score_text(rollout(name, backend=options.backend, marker_proxy='material'))}"
        )
    print_fling(options.backend)
    print_foams(options.backend, options.marker_proxy)


if __name__ == "__main__":
    main()
