"""Speed of Newton's batch on a device, and whether the result of a world depends on the batch.

    python benchmarks/newton_batch.py --device cuda:0 --worlds 1 64 1024

It also runs on `cpu`, where the results are equal to the last bit. On a GPU, single precision in another order moves
them apart. Each world has another initial velocity; the first and the last world are compared with single worlds.
"""

from __future__ import annotations

import argparse
import time
from contextlib import closing

import numpy as np

from gauge_envs import load_experiment
from gauge_envs.backends import backend
from gauge_envs.scene import Scene
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.states import nominal_states, row_of
from gauge_envs.scene.timing import SAMPLE_INTERVAL_S, SAMPLES_PER_FRAME

FRAMES = 10


def motion(scene: Scene, numbers: np.ndarray, device: str) -> tuple[FloatArray, float]:
    """Return the states of worlds at each frame, shape [FRAMES, N, body_count, 13], and the time of the steps [s].

    Args:
        scene: The scene.
        numbers: Number of each world, which its initial velocity depends on, shape [N].
        device: Warp device.
    """
    names = [body.name for body in scene.dynamic_bodies]
    states = np.repeat(nominal_states(scene)[None], len(numbers), axis=0)
    states[:, row_of(scene, names[0]), 7] += 1e-3 * (numbers % 100)
    build = backend("newton").build_worlds
    with closing(build(scene, len(numbers), {"device": device})) as simulation:
        simulation.reset(states)
        # The first step compiles the kernels.
        simulation.advance(SAMPLE_INTERVAL_S)
        simulation.reset(states)
        rows, start = [], time.perf_counter()
        for _ in range(FRAMES):
            for _ in range(SAMPLES_PER_FRAME):
                simulation.advance(SAMPLE_INTERVAL_S)
            rows.append(simulation.body_states(names))
        return np.array(rows), time.perf_counter() - start


def main() -> None:
    """Print the speed of each batch, and the largest difference of its outer worlds from single worlds."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--worlds", type=int, nargs="+", default=[1, 16, 64])
    parser.add_argument("--id", default="SlopeSlider-2-wood")
    given = parser.parse_args()
    scene = load_experiment(given.id).scene
    for count in given.worlds:
        states, wall_s = motion(scene, np.arange(count), given.device)
        outer = [0, count - 1]
        singles = [motion(scene, np.array([n]), given.device)[0][:, 0] for n in outer]
        apart = np.abs(states[:, outer] - np.stack(singles, axis=1)).max()
        print(
            f"{count:6d} worlds: {count * FRAMES / wall_s:9.0f} frames/s, difference {apart:.1e}"
        )


if __name__ == "__main__":
    main()
