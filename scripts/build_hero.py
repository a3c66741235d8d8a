"""Draw the picture at the top of the README: real drops of a rubber ball beside engines, and a cube that creeps.

The numbers are those of `gauge demo`. The first frame is the result.
"""

from __future__ import annotations

import io

import numpy as np
from matplotlib import patches, transforms
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from PIL import Image

from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.demo import creep, drop, real_drops
from scripts.generated import ROOT

FILE = ROOT / "docs" / "images" / "hero.webp"
ENGINES = ("mujoco", "newton", "physx", "pybullet", "rapier")
WRONG, REAL, INK, NOTE = "#D55E00", "#4A5568", "#1F2328", "#59636E"
CARD, BOARD = "#F6F8FA", "#CDAA78"
WIDTH, HEIGHT, DPI = 900, 380, 100
RADIUS_MM, EDGE_MM, SLOPE_DEG = 30.0, 50.0, 10.0
FRAME_S, FIRST_S, LAST_S = 2.0 / 30.0, 2.5, 1.5
"""Times for which a picture, the result and the last picture stand [s]. The fall is shown at half speed."""


def engine_drops(frames_s: FloatArray) -> FloatArray:
    """Return the heights of the ball in each engine at the frames [mm], shape [engine_count, T]."""
    drops = [drop(backend=engine) for engine in ENGINES]
    return np.array([np.interp(frames_s, d.times_s, d.heights_mm) for d in drops])


def apex_mm(heights_mm: FloatArray) -> float:
    """Return the greatest height at a frame after the impact [mm]."""
    return float(heights_mm[heights_mm.argmin() :].max())


def label(axis: Axes, place: tuple[float, float], text: str, **look: object) -> None:
    """Write a text at a place in pixels from the upper left corner."""
    axis.text(place[0], HEIGHT - place[1], text, **look)


def key(
    axis: Axes, place: tuple[float, float], text: str, marker: str, color: str
) -> None:
    """Write an entry of a legend at a place in pixels."""
    axis.plot(place[0], HEIGHT - place[1] + 6, marker, ms=11, color=color)
    label(axis, (place[0] + 16, place[1]), text, fontsize=13, color=INK)


def number(axis: Axes, right: float, top: float, value: str, below: str) -> None:
    """Write a large number in millimetres, which ends at a place in pixels, and words below it."""
    look = {"color": WRONG, "ha": "right", "fontweight": "bold"}
    label(axis, (right - 52, top), value, fontsize=39, **look)
    label(axis, (right, top), "mm", fontsize=17, **look)
    label(axis, (right, top + 24), below, fontsize=13, color="#B34700", ha="right")


def draw_balls(
    axis: Axes, trials_mm: FloatArray, engines_mm: FloatArray, frame: int
) -> None:
    """Draw the drops up to a frame; places across are times."""
    low, high = trials_mm.min(), trials_mm.max()
    across = np.linspace(46.0, 380.0, trials_mm.shape[1])
    scale = 225.0 / (high - low)

    def up(heights_mm: FloatArray) -> FloatArray:
        return 68.0 + scale * (heights_mm - low)

    axis.plot([24, 446], [44, 44], color=INK, lw=2.5)
    key(axis, (210, 40), f"{len(trials_mm)} real drops", "o", REAL)
    key(axis, (210, 66), f"{len(ENGINES)} engines", "o", WRONG)
    for heights_mm in trials_mm:
        past = slice(0, frame + 1)
        axis.plot(across[past], up(heights_mm[past]), "o", ms=8, color=REAL, alpha=0.18)
    for heights_mm in engines_mm:
        past = slice(0, frame + 1)
        axis.plot(across[past], up(heights_mm[past]), color=WRONG, lw=2)
        axis.plot(
            across[frame], up(heights_mm[frame]), "o", ms=24, color=WRONG, alpha=0.5
        )
    mean_mm = trials_mm.mean(axis=0)
    axis.plot(across[frame], up(mean_mm[frame]), "o", ms=24, color=REAL)
    if frame == len(across) - 1:
        engines, real = np.mean([apex_mm(h) for h in engines_mm]), apex_mm(mean_mm)
        ends = up(np.array([engines, real]))
        axis.plot([412, 412], ends, "_-", color=WRONG, lw=2.5, ms=12, mew=2.5)
        number(axis, 446, 118, f"{real - engines:.0f}", "bounce too low")


def draw_cube(axis: Axes, speed_mm_per_s: float, time_s: float) -> None:
    """Draw the cube that rests and the one that has moved, on the slope."""
    edge, scale = 100.0, 100.0 / EDGE_MM
    moved_mm = speed_mm_per_s * time_s
    turned = transforms.Affine2D().rotate_deg(-SLOPE_DEG).translate(493, 156)
    key(axis, (508, 40), "real cube rests", "s", REAL)
    key(axis, (508, 66), "cube with HalfCheetah's contacts creeps", "s", WRONG)
    shapes = [
        patches.Rectangle((0, -20), 382, 20, color=BOARD),
        patches.Rectangle((34, 0), edge, edge, color=REAL),
        patches.Rectangle(
            (34 + scale * moved_mm, 0), edge, edge, color=WRONG, alpha=0.88
        ),
    ]
    for shape in shapes:
        shape.set_transform(turned + axis.transData)
        axis.add_patch(shape)
    label(
        axis,
        (765, 330),
        f"{SLOPE_DEG:.0f} degrees",
        fontsize=12,
        color=NOTE,
        ha="center",
    )
    number(axis, 870, 128, f"{moved_mm:.0f}", f"in {time_s:.1f} s")


def picture(
    trials_mm: FloatArray, engines_mm: FloatArray, speed: float, frame: int
) -> Image.Image:
    """Return the picture at a frame; the cube creeps for a second until the last one."""
    figure = Figure(figsize=(WIDTH / DPI, HEIGHT / DPI), dpi=DPI, facecolor=CARD)
    axis = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axis.set(xlim=(0, WIDTH), ylim=(0, HEIGHT))
    axis.axis("off")
    axis.plot([470, 470], [28, 352], color="#D0D7DE", lw=1)
    draw_balls(axis, trials_mm, engines_mm, frame)
    draw_cube(axis, speed, frame / (trials_mm.shape[1] - 1))
    stream = io.BytesIO()
    figure.savefig(stream, format="png")
    return Image.open(stream).convert("RGB")


def draw() -> None:
    """Write the animated picture, and print its size and numbers."""
    frames_s, trials_mm = real_drops()
    engines_mm = engine_drops(frames_s)
    speed = creep().configured
    assert speed is not None
    last = len(frames_s) - 1
    pictures = [
        picture(trials_mm, engines_mm, speed, frame)
        for frame in (last, *range(last + 1))
    ]
    seconds = [FIRST_S, *[FRAME_S] * last, LAST_S]
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
    print("apexes of engines [mm]:", [round(apex_mm(h)) for h in engines_mm])


if __name__ == "__main__":
    draw()
