"""Convergence: the change of a simulation when its step, or the cells of its cloth, are halved.

For one variant of each family with deformable bodies, an episode runs with the preset, with half the step, and for
cloth with half the cell. All are observed at the same material points. The table states for each finer run:

- the change, the root mean square over frames and coordinates of the difference in g(t);
- its share of the motion, the root mean square of g(t) - g(0) over the same frames;
- the distance of the observed points in mm, root mean square over frames and points. It matters for a cloth that stays
  flat or bends one way: its curvature is close to zero, so the share is not meaningful.

Chaotic motion, such as that of a folding cloth, does not converge point by point. The table then states how far two
equally good runs separate.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from dataclasses import dataclass

import gymnasium
import numpy as np
from numpy.typing import NDArray

import gauge_envs  # noqa: F401  registers the ids
from gauge_envs import load_experiment
from gauge_envs.backends.mujoco.settings import settings_for
from gauge_envs.observables.kinds import Observable
from gauge_envs.scene import Cloth
from gauge_envs.scene.timing import FRAME_RATE_HZ

QUICK = (
    "RopeWinding-rubber",
    "StickStack-soft",
    "TextileStretching-rayon",
    "TextileBending-rayon",
    "TextileFlinging-rayon",
    "CantileverBeam-soft",
)
OTHERS = (
    "FoamStretching-soft",
    "FoamShearing-soft",
    "FoamTwisting-soft",
    "FoamBending-soft",
    "FoamCompressing-soft",
    "RotatingBall-rayon",
    "Funnel-rayon",
    "TableclothPulling-wood",
)
UNITS = {
    Observable.POSITION: "mm",
    Observable.MARKER_POSITION: "mm",
    Observable.CURVATURE: "rad",
    Observable.LINE_CURVATURE: "rad",
    Observable.FACE_AREA: "mm^2",
}


@dataclass(frozen=True, kw_only=True)
class Episode:
    """Result of one run.

    Attributes:
        frames: g(t) at the 30 Hz frames, shape [frame_count, coordinate_count].
        points_m: Observed points at the frames, markers or bodies [m], shape [frame_count, point_count, 3].
        cost: Wall time per simulated time [s/s].
    """

    frames: NDArray[np.float64]
    points_m: NDArray[np.float64]
    cost: float

    def first(self, frame_count: int) -> Episode:
        """Return the episode with its first frames only."""
        return Episode(frames=self.frames[:frame_count], points_m=self.points_m[:frame_count], cost=self.cost)


def episode(name: str, frame_count: int, settings: dict[str, float]) -> Episode:
    """Run the first frames of an episode with zero actions.

    Args:
        name: Variant.
        frame_count: Frames at most, the first included.
        settings: Settings that differ from the preset.
    """
    # Material points of a cloth do not depend on its cells. Nodes of other bodies do not change.
    cloth = any(isinstance(body, Cloth) for body in load_experiment(name).scene.deformables)
    env = gymnasium.make(f"GAUGE/{name}", settings=settings, marker_proxy="material" if cloth else "node")
    env.reset(seed=0)
    action = 0 if isinstance(env.action_space, gymnasium.spaces.Discrete) else np.zeros(env.action_space.shape)
    count, over = 1, False
    start = time.perf_counter()
    while count < frame_count and not over:
        *_, terminated, truncated, _ = env.step(action)
        count, over = count + 1, terminated or truncated
    spent_s = time.perf_counter() - start
    trajectory = env.unwrapped.trajectory()
    env.close()
    points_m = trajectory.bodies[..., :3] if trajectory.bodies.size else trajectory.markers_m
    return Episode(frames=trajectory.frames, points_m=points_m, cost=spent_s * FRAME_RATE_HZ / (count - 1))


def rms(values: NDArray[np.float64]) -> float:
    """Return the root mean square over frames and coordinates without undefined values."""
    return float(np.sqrt(np.nanmean(values**2)))


def change(preset: Episode, finer: Episode) -> tuple[float, float, float]:
    """Return the RMS difference of g(t), its share of the RMS of g(t) - g(0), and the RMS distance of points [mm].

    All are NaN if one run diverged.
    """
    if preset.frames.shape != finer.frames.shape:
        return np.nan, np.nan, np.nan
    difference = rms(finer.frames - preset.frames)
    apart_mm = rms(1e3 * np.linalg.norm(finer.points_m - preset.points_m, axis=-1))
    return difference, difference / rms(preset.frames - preset.frames[0]), apart_mm


def columns(finer: Episode | None, preset: Episode) -> str:
    """Return the four columns of a finer run."""
    if finer is None:
        return f"{'-':>6} {'-':>8} {'-':>6} {'-':>7}"
    difference, share, apart_mm = change(preset, finer)
    return f"{finer.cost:6.2f} {difference:8.2g} {100 * share:5.1f}% {apart_mm:7.3f}"


def row(name: str, frame_count: int, fine_frame_count: int) -> str:
    """Return one line of the table.

    Args:
        name: Variant.
        frame_count: Frames at most, the first included.
        fine_frame_count: Frames at most of the run with half the cell; below 2 there is no such run.
    """
    experiment = load_experiment(name)
    settings = settings_for(experiment.scene)
    preset = episode(name, frame_count, {})
    half_step = episode(name, frame_count, {"timestep_s": 0.5 * settings.timestep_s})
    half_cell, compared = None, preset
    if fine_frame_count > 1 and any(isinstance(body, Cloth) for body in experiment.scene.deformables):
        half_cell = episode(name, min(frame_count, fine_frame_count), {"cloth_cell_m": 0.5 * settings.cloth_cell_m})
        compared = preset.first(len(half_cell.frames))
    unit = UNITS[experiment.spec.score.observable]
    count = f"{len(preset.frames)}" + (f"/{len(half_cell.frames)}" if half_cell else "")
    moved = rms(preset.frames - preset.frames[0])
    return (
        f"{name:23} {count:>5} {unit:>4} {moved:8.2g} {preset.cost:6.2f}   "
        f"{columns(half_step, preset)}   {columns(half_cell, compared)}"
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", help="variants; a few quick ones when left out")
    parser.add_argument("--all", action="store_true", help="one variant of every family with deformable bodies")
    parser.add_argument("--frames", type=int, default=60, help="frames of an episode at most (30 a second)")
    parser.add_argument("--fine-frames", type=int, help="frames at most with half the cell; 0 leaves it out")
    options = parser.parse_args(arguments)
    if options.frames < 2:
        parser.error("--frames must be at least 2")
    names = options.names or (QUICK + OTHERS if options.all else QUICK)
    fine = options.frames if options.fine_frames is None else options.fine_frames
    head = f"{'s/s':>6} {'change':>8} {'share':>6} {'mm':>7}"
    print(f"{'':53}{'half the step':<33}half the cell")
    print(f"{'variant':23} {'frames':>5} {'unit':>4} {'moved':>7} {'s/s':>6}   {head}   {head}", flush=True)
    for name in names:
        print(row(name, options.frames, fine), flush=True)


if __name__ == "__main__":
    main()
