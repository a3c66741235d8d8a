"""Draw the contact sheet of the README: first, middle and last frame of one variant of each rigid family.

Usage: python scripts/render_sheet.py [OUT.png]
"""

from __future__ import annotations

import sys
from pathlib import Path

import gymnasium
import matplotlib.pyplot as plt
import numpy as np

import gauge_envs  # noqa: F401  registers the ids

VARIANTS = (
    "SlopeContact-wood",
    "NonsmoothContact-1-wood",
    "SlopeSlider-3-metal",
    "Turntable-2-wood",
    "BouncingBall-rubber",
    "NewtonsCradle-metal",
    "WallBreaking-wood",
    "Pendulum-metal",
)
LONGEST_S = 1.8
"""Long experiments show this much of their start."""


def frames(name: str) -> list[np.ndarray]:
    """First, middle and last picture of an episode."""
    env = gymnasium.make(f"GAUGE/{name}", render_mode="rgb_array", width=480, height=360)
    env.reset(seed=0)
    zero = 0 if isinstance(env.action_space, gymnasium.spaces.Discrete) else np.zeros(env.action_space.shape)
    last = min(env.unwrapped.experiment.frame_count - 1, round(30 * LONGEST_S))
    pictures = [env.render()]
    for frame in range(1, last + 1):
        env.step(zero)
        if frame in (last // 2, last):
            pictures.append(env.render())
    env.close()
    return pictures


def main() -> None:
    """Write the sheet."""
    out = Path(sys.argv[1] if len(sys.argv) > 1 else "docs/images/rigid.png")
    figure, axes = plt.subplots(4, 6, figsize=(12, 6.6), layout="constrained")
    for index, name in enumerate(VARIANTS):
        row, column = divmod(index, 2)
        for offset, picture in enumerate(frames(name)):
            axis = axes[row, 3 * column + offset]
            axis.imshow(picture)
            axis.set_axis_off()
        axes[row, 3 * column].set_title(name, loc="left", fontsize=9)
    figure.savefig(out, dpi=80)


if __name__ == "__main__":
    main()
