"""Draw the moving picture of the README: 22 real drops of a ball, and three engines out of the box with their error.

The real drops are those of the package, one picture for each of their frames; nothing is interpolated.
"""

from __future__ import annotations

import sys
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from gauge_envs import load_experiment, reference_band
from gauge_envs.backends.registry import backend_title
from gauge_envs.pages.figures import OURS, REAL, new_figure
from gauge_envs.runs.batch import run_many
from gauge_envs.runs.episodes import planned_results
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result_file import load_result, result_file_name
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.timing import SAMPLES_PER_FRAME
from scripts.build_leaderboard import OUT_OF_BOX, configurations
from scripts.generated import ROOT, Request

OUT = ROOT / "docs" / "images" / "bouncing_ball.gif"
NAME = "BouncingBall-rubber"
ENGINES = ("physx", "pybullet", "mujoco")
FRAME_MS, LAST_MS = 170, 2500
"""Time that a picture and the last one are shown [ms]; a frame of the trials is 33 ms."""

SIZE_IN, DPI = (8.0, 5.2), 100
HEIGHT_MM = (-15.0, 540.0)
"""Heights that are shown [mm]."""


def heights_mm(engine: str, folder: Path) -> FloatArray:
    """Return the ball's height at each frame [mm], shape [frame_count]."""
    request = RunRequest(
        NAME, backend=engine, settings=dict(dict(configurations(engine))[OUT_OF_BOX])
    )
    (planned,) = planned_results(request)
    list(run_many([request], out=folder, resume=True))
    trajectory = load_result(folder / result_file_name(planned)).trajectory
    assert trajectory is not None
    return trajectory.arrays()[1][
        ::SAMPLES_PER_FRAME, trajectory.coordinates.index("ball.z")
    ]


def draw(
    frame: int,
    real: FloatArray,
    simulated: dict[str, FloatArray],
    radius_mm: float,
) -> Image.Image:
    """Return the picture of one frame: the real drops above, each engine and its error below.

    Args:
        frame: Number of the frame.
        real: Heights of the real drops [mm], shape [trial_count, frame_count].
        simulated: Heights in each engine [mm], shape [frame_count].
        radius_mm: Radius of the ball [mm].
    """
    figure = new_figure(*SIZE_IN)
    # Every picture has the same places.
    figure.set_layout_engine("none")
    mean = real.mean(axis=0)
    title = {"fontsize": 18, "loc": "left", "weight": "bold", "pad": 4}
    above = _track(figure, (0.02, 0.55, 0.96, 0.38), len(mean))
    above.set_title(f"Reality: {len(real)} drops of a rubber ball", color=REAL, **title)
    for at in range(frame + 1):
        for trial in real:
            ball(above, _place(above, at), trial[at], radius_mm, color=REAL, alpha=0.05)
    width = 0.96 / len(simulated)
    for column, (engine, heights) in enumerate(simulated.items()):
        color = OURS[column]
        place = (0.02 + width * column, 0.12, width - 0.02, 0.31)
        below = _track(figure, place, len(mean))
        below.set_title(backend_title(engine), color=color, **title)
        for at in range(frame + 1):
            x_mm = _place(below, at)
            ball(below, x_mm, heights[at], radius_mm, color=color, alpha=0.75)
            ball(below, x_mm, mean[at], radius_mm, edgecolor=REAL, fill=False)
        error = (heights - mean)[: frame + 1]
        rms_mm = float(np.sqrt(np.mean(np.square(error))))
        text = f"{rms_mm:.0f} mm off"
        below.text(0.0, -0.07, text, transform=below.transAxes, color=color,
            fontsize=22, weight="bold", va="top")  # fmt: skip
    stream = BytesIO()
    figure.savefig(stream, dpi=DPI)
    return Image.open(stream).convert("RGB")


def _track(figure: Any, place: tuple[float, float, float, float], count: int) -> Any:
    """Return axes with the floor, in which circles are round and all frames have room."""
    axis = figure.add_axes(place)
    height_mm = HEIGHT_MM[1] - HEIGHT_MM[0]
    aspect = place[2] * SIZE_IN[0] / (place[3] * SIZE_IN[1])
    axis.set(xlim=(0.0, height_mm * aspect), ylim=HEIGHT_MM, xticks=[], yticks=[])
    axis.axhline(0.0, color="#808080", lw=3)
    axis.spines[:].set_visible(False)
    axis.frame_count = count
    return axis


def _place(axis: Any, frame: int) -> float:
    """Return where the ball of a frame is drawn [mm]: time goes from left to right."""
    return (frame + 0.5) / axis.frame_count * axis.get_xlim()[1]


def ball(axis: Any, x_mm: float, z_mm: float, radius_mm: float, **style: Any) -> None:
    """Add a circle."""
    from matplotlib.patches import Circle

    axis.add_patch(Circle((x_mm, z_mm), radius_mm, clip_on=False, **style))


def measure(request: Request) -> None:
    """Run the engines into the folder, or take what it has, and write the picture."""
    experiment = load_experiment(NAME)
    band = reference_band(experiment)
    assert band is not None and band.trials is not None
    real = band.trials[:, :, 0]
    radius_mm = 1000.0 * experiment.scene.body("ball").shape.radius_m
    simulated = {engine: heights_mm(engine, request.results) for engine in ENGINES}
    pictures = [
        draw(frame, real, simulated, radius_mm) for frame in range(real.shape[1])
    ]
    palette = pictures[-1].quantize(64)
    first, *others = [
        picture.quantize(palette=palette, dither=Image.Dither.NONE)
        for picture in pictures
    ]
    durations = [FRAME_MS] * len(others) + [LAST_MS]
    first.save(
        OUT,
        save_all=True,
        append_images=others,
        duration=durations,
        loop=0,
        optimize=True,
    )
    print(f"{OUT}: {OUT.stat().st_size // 1000} kB", file=sys.stderr)
