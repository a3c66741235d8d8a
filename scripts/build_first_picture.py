"""Draw the moving picture of the README: 22 real drops of a ball, two engines out of the box, and the growing error.

The real drops are those of the package, one picture for each of their frames; nothing is interpolated.
"""

from __future__ import annotations

import sys
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from gauge_envs import load_experiment, reference_band
from gauge_envs.backends.registry import backend_title
from gauge_envs.pages.figures import OURS, REAL, new_figure, tidy_axis
from gauge_envs.runs.batch import run_many
from gauge_envs.runs.episodes import planned_results
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result_file import load_result, result_file_name
from gauge_envs.scene.timing import FRAME_RATE_HZ, SAMPLES_PER_FRAME
from scripts.build_leaderboard import OUT_OF_BOX, configurations
from scripts.generated import ROOT, Request

OUT = ROOT / "docs" / "images" / "bouncing_ball.gif"
NAME = "BouncingBall-rubber"
ENGINES = ("physx", "mujoco")
FRAME_MS, LAST_MS = 170, 2500
"""Time that a picture and the last one are shown [ms]; a frame of the trials is 33 ms."""

SIZE_IN, DPI = (8.0, 4.5), 100
TRIAL_WIDTH_MM = 130.0
"""Width over which the real drops are spread, so that each is seen [mm]."""


def heights_mm(engine: str, folder: Path) -> NDArray[np.float64]:
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
    real: NDArray[np.float64],
    simulated: dict[str, NDArray[np.float64]],
    radius_mm: float,
) -> Image.Image:
    """Return the picture of one frame.

    Args:
        frame: Number of the frame.
        real: Heights of the real drops [mm], shape [trial_count, frame_count].
        simulated: Heights in each engine [mm], shape [frame_count].
        radius_mm: Radius of the ball [mm].
    """
    figure = new_figure(*SIZE_IN)
    # Every picture has the same places.
    figure.set_layout_engine("none")
    drops, errors = (
        figure.add_axes((0.0, 0.1, 0.52, 0.9)),
        figure.add_axes((0.6, 0.16, 0.37, 0.74)),
    )
    mean = real.mean(axis=0)
    for number, trial in enumerate(real):
        x_mm = TRIAL_WIDTH_MM * (number / (len(real) - 1) - 0.5)
        ball(drops, x_mm, trial[frame], radius_mm, color=REAL, alpha=0.12)
    ball(drops, 0.0, mean[frame], radius_mm, edgecolor=REAL, fill=False, lw=2)
    for column, (engine, heights) in enumerate(simulated.items(), start=1):
        for earlier in range(frame):
            ball(
                drops,
                220.0 * column,
                heights[earlier],
                radius_mm,
                color=OURS[column - 1],
                alpha=0.08,
            )
        ball(drops, 220.0 * column, heights[frame], radius_mm, color=OURS[column - 1])
        ball(
            drops,
            220.0 * column,
            mean[frame],
            radius_mm,
            edgecolor=REAL,
            fill=False,
            lw=2,
        )
        error = np.abs(heights - mean)[: frame + 1]
        errors.plot(
            np.arange(frame + 1) / FRAME_RATE_HZ, error, color=OURS[column - 1], lw=4
        )
        errors.plot(
            frame / FRAME_RATE_HZ, error[-1], "o", color=OURS[column - 1], ms=10
        )
        rms_mm = float(np.sqrt(np.mean(np.square(error))))
        errors.text(0.03, 1.0 - 0.12 * column, f"{backend_title(engine)}: {rms_mm:.0f} mm RMS",
            transform=errors.transAxes, color=OURS[column - 1], fontsize=17, weight="bold")  # fmt: skip
    drops.axhline(0.0, color="#808080", lw=3)
    drops.set(xlim=(-110, 550), ylim=(-15, 530), aspect="equal", yticks=[])
    drops.set_xticks(
        [0.0, 220.0, 440.0],
        [f"{len(real)} real", *(backend_title(engine) for engine in simulated)],
    )
    drops.tick_params(length=0, labelsize=19)
    drops.spines[:].set_visible(False)
    tidy_axis(errors)
    errors.set(
        xlim=(0, len(mean) / FRAME_RATE_HZ), ylim=(0, 330), yticks=[0, 100, 200, 300]
    )
    errors.set_title("mm from the real mean", fontsize=17)
    errors.set_xlabel(f"{frame / FRAME_RATE_HZ:.2f} s", fontsize=19)
    errors.tick_params(labelsize=14)
    stream = BytesIO()
    figure.savefig(stream, dpi=DPI)
    return Image.open(stream).convert("RGB")


def ball(axis: Any, x_mm: float, z_mm: float, radius_mm: float, **style: Any) -> None:
    """Add a circle."""
    from matplotlib.patches import Circle

    axis.add_patch(Circle((x_mm, z_mm), radius_mm, **style))


def measure(request: Request) -> None:
    """Run both engines into the folder, or take what it has, and write the picture."""
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
