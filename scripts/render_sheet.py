"""Draw the contact sheets of the documentation: first, middle and last picture of each episode.

python scripts/render_sheet.py rigid
python scripts/render_sheet.py flinging --backend genesis --out docs/images/genesis_fling.png
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import gymnasium
import matplotlib.pyplot as plt
import numpy as np

import gauge_envs  # noqa: F401  registers the ids

SHEETS = {
    "rigid": {
        "SlopeContact-wood": 0.3,
        "NonsmoothContact-1-wood": 0.3,
        "SlopeSlider-3-metal": 1.9,
        "Turntable-2-wood": 0.6,
        "BouncingBall-rubber": 0.5,
        "NewtonsCradle-metal": 0.5,
        "WallBreaking-wood": 1.5,
        "Pendulum-metal": 0.9,
    },
    "deformable": {
        "RopeWinding-rubber": 2.0,
        "TextileStretching-satin": 3.0,
        "TextileBending-oxford": 4.8,
        "TextileFlinging-satin": 1.8,
        "Funnel-satin": 3.0,
        "RotatingBall-uniform": 3.0,
        "TableclothPulling-metal": 3.0,
        "FoamStretching-soft": 1.0,
        "FoamCompressing-soft": 1.0,
        "FoamShearing-soft": 1.2,
        "FoamTwisting-soft": 2.1,
        "FoamBending-soft": 1.1,
        "StickStack-soft": 4.0,
        "CantileverBeam-soft": 0.5,
    },
    "flinging": {
        "TextileFlinging-satin": 1.8,
        "TextileFlinging-rayon": 1.8,
        "TextileFlinging-uniform": 1.8,
        "TextileFlinging-nylon": 1.8,
        "TextileFlinging-oxford": 1.8,
        "TextileFlinging-leather": 1.8,
    },
}
"""Variants, and the time of the last picture [s]."""


def frames(name: str, seconds: float, backend: str) -> list[np.ndarray]:
    """Return the first, middle and last picture of the first seconds of an episode."""
    env = gymnasium.make(f"GAUGE/{name}", backend=backend, render_mode="rgb_array", width=480, height=360)
    env.reset(seed=0)
    zero = 0 if isinstance(env.action_space, gymnasium.spaces.Discrete) else np.zeros(env.action_space.shape)
    last = min(env.unwrapped.experiment.frame_count - 1, round(30 * seconds))
    pictures = [env.render()]
    for frame in range(1, last + 1):
        env.step(zero)
        if frame in (last // 2, last):
            pictures.append(env.render())
    env.close()
    return pictures


def main(arguments: Sequence[str] | None = None) -> int:
    """Draw and write a sheet; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sheet", choices=SHEETS)
    parser.add_argument("--backend", default="mujoco", help="engine")
    parser.add_argument("--out", type=Path, help="picture; default: docs/images/SHEET.png")
    options = parser.parse_args(arguments)
    episodes = SHEETS[options.sheet]
    rows = len(episodes) // 2
    figure, axes = plt.subplots(rows, 6, figsize=(12, 1.65 * rows), layout="constrained")
    for index, (name, seconds) in enumerate(episodes.items()):
        row, column = divmod(index, 2)
        for offset, picture in enumerate(frames(name, seconds, options.backend)):
            axis = axes[row, 3 * column + offset]
            axis.imshow(picture)
            axis.set_axis_off()
        axes[row, 3 * column].set_title(name, loc="left", fontsize=9)
    figure.savefig(options.out or Path("docs/images") / f"{options.sheet}.png", dpi=80)
    return 0


if __name__ == "__main__":
    sys.exit(main())
