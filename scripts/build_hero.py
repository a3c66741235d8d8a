"""Draw the picture at the top of the README: real drops of a rubber ball beside engines with their own defaults.

The engines have the measured constants, so what differs is the engine and its settings. The first frame is the result.
"""

from __future__ import annotations

import io
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from PIL import Image

from gauge_envs import load_experiment, reference_band
from gauge_envs.runs.episodes import run_episode
from gauge_envs.runs.request import RunRequest
from gauge_envs.scene import Sphere
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scoring.answers import Answer
from gauge_envs.scoring.metrics import interpolated
from scripts.generated import ROOT

FILE = ROOT / "docs" / "images" / "bouncing_ball.webp"
NAME = "BouncingBall-rubber"
ENGINES = {
    "physx": "PhysX",
    "rapier": "Rapier",
    "pybullet": "PyBullet",
    "mujoco": "MuJoCo",
}
WRONG, REAL, RIGHT, INK = "#D55E00", "#4A5568", "#0072B2", "#1F2328"
RADIUS_MM = 30.0
PICTURE_S = 1.0 / 30.0
FIRST_S, LAST_S = 2.5, 1.5
"""Times for which the result and the last picture stand [s]."""


@dataclass(frozen=True, kw_only=True)
class Drop:
    """Heights of the lowest point of the ball at the frames of the trials [mm], shape [T], and the words below."""

    title: str
    heights_mm: FloatArray
    text: str
    color: str


def drops() -> list[Drop]:
    """Return the mean real drop, and the drop in each engine with its own defaults, shifted as in its score."""
    experiment = load_experiment(NAME, "measured")
    band = reference_band(experiment)
    assert band is not None and band.trials is not None
    ball, ground = (experiment.scene.body(name) for name in ("ball", "ground"))
    assert isinstance(ball.shape, Sphere)
    lowest_mm = 1e3 * (ground.pose.position_m[2] + ball.shape.radius_m)
    real = Drop(
        title="Reality",
        heights_mm=band.mean[:, 0] - lowest_mm,
        text=f"{len(band.trials)} drops",
        color=REAL,
    )
    found = [real]
    frames_s = np.arange(len(band.mean)) / 30.0
    for engine, title in ENGINES.items():
        request = RunRequest(
            NAME,
            backend=engine,
            parameters="measured",
            settings={"preset": "out_of_box"},
        )
        result = run_episode(request)
        assert result.trajectory is not None, result.error
        times_s, samples = result.trajectory.arrays()
        score = result.score
        queries_s = frames_s - (score.time_offset_s or 0.0)
        heights = interpolated(queries_s, times_s, band.project(samples))[:, 0]
        is_like = score.like_reality is Answer.YES
        found.append(
            Drop(
                title=title,
                heights_mm=heights - lowest_mm,
                text=f"{score.distance:.0f} mm off",
                color=RIGHT if is_like else WRONG,
            )
        )
    return found


def picture(shown: list[Drop], frame: int) -> Image.Image:
    """Return the picture at a frame, with the earlier places of each ball."""
    figure = Figure(figsize=(9.0, 3.6), dpi=100, facecolor="white")
    axes = figure.subplots(1, len(shown))
    figure.suptitle(
        "A rubber ball falls: engines with their own defaults and the measured restitution",
        color=INK,
        fontsize=13,
        x=0.02,
        ha="left",
    )
    for axis, drop in zip(axes, shown, strict=True):
        _draw(axis, drop, shown[0].heights_mm, frame)
    figure.subplots_adjust(left=0.02, right=0.98, top=0.80, bottom=0.16, wspace=0.08)
    stream = io.BytesIO()
    figure.savefig(stream, format="png")
    return Image.open(stream).convert("RGB")


def _draw(axis: Axes, drop: Drop, real_mm: FloatArray, frame: int) -> None:
    """Draw a ball at a frame, its earlier places, and the real ball as a ring."""
    places = np.linspace(0.0, 300.0, len(real_mm))
    axis.set_title(drop.title, color=INK, fontsize=13, loc="left")
    axis.axhline(0.0, color=INK, lw=2)
    for index in range(frame + 1):
        alpha = 1.0 if index == frame else 0.25
        centre = places[index], drop.heights_mm[index] + RADIUS_MM
        axis.plot(*centre, "o", ms=13, color=drop.color, alpha=alpha)
        if drop.color != REAL:
            ring = places[index], real_mm[index] + RADIUS_MM
            axis.plot(*ring, "o", ms=13, mfc="none", mec=REAL, alpha=alpha)
    axis.set_xlim(-30.0, 330.0)
    axis.set_ylim(-6.0, float(real_mm.max()) + 3.0 * RADIUS_MM)
    axis.axis("off")
    axis.text(
        0.0,
        -0.12,
        drop.text,
        color=drop.color,
        fontsize=19,
        fontweight="bold",
        transform=axis.transAxes,
        va="top",
    )


def draw() -> None:
    """Write the animated picture."""
    shown = drops()
    last = len(shown[0].heights_mm) - 1
    frames = [last, *range(last + 1)]
    pictures = [picture(shown, frame) for frame in frames]
    seconds = [FIRST_S, *[2.0 * PICTURE_S] * last, LAST_S]
    pictures[0].save(
        FILE,
        save_all=True,
        append_images=pictures[1:],
        duration=[round(1e3 * second) for second in seconds],
        loop=0,
        quality=80,
        method=6,
    )
    print(FILE.relative_to(ROOT), f"{FILE.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    draw()
