"""Draw contact sheets: first, middle and last frame of several variants.

`rigid` and `deformable`, those of the README, show one variant of each family in MuJoCo. `genesis_fling` shows the
fabrics of TextileFlinging in Genesis.

Usage: python scripts/render_sheet.py rigid|deformable|genesis_fling [OUT.png]
"""

from __future__ import annotations

import sys
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
    "genesis_fling": {
        f"TextileFlinging-{fabric}": 1.4 for fabric in ("rayon", "satin", "uniform", "nylon", "oxford", "leather")
    },
}
"""Variants, and the time of the last picture [s]."""

BACKENDS = {"genesis_fling": "genesis"}
"""Engine of a sheet; MuJoCo for the others."""


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


def main() -> None:
    """Draw and write a sheet."""
    sheet = sys.argv[1]
    out = Path(sys.argv[2] if len(sys.argv) > 2 else f"docs/images/{sheet}.png")
    rows = len(SHEETS[sheet]) // 2
    figure, axes = plt.subplots(rows, 6, figsize=(12, 1.65 * rows), layout="constrained")
    for index, (name, seconds) in enumerate(SHEETS[sheet].items()):
        row, column = divmod(index, 2)
        for offset, picture in enumerate(frames(name, seconds, BACKENDS.get(sheet, "mujoco"))):
            axis = axes[row, 3 * column + offset]
            axis.imshow(picture)
            axis.set_axis_off()
        axes[row, 3 * column].set_title(name, loc="left", fontsize=9)
    figure.savefig(out, dpi=80)


if __name__ == "__main__":
    main()
