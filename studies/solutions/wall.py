"""Solve WallBreaking by four families of engines: how far the wall's bricks move on average.

    python studies/solutions/wall.py [FOLDER]

Single bricks are chaotic after the blow, but their mean is not: for 0.17 s it follows the momentum that the ball has
given. Each engine runs with a quarter of its step. u is the standard deviation between engines. The solution ends
where u exceeds a fifth of the motion. Newton and Genesis are left out, as they solve contacts as MuJoCo does.
"""

import sys
import warnings
from pathlib import Path

import gymnasium
import numpy as np
from numpy.typing import NDArray
from store import store_solution

from gauge_envs import load_experiment
from gauge_envs.files import data_folder
from gauge_envs.scene.timing import FRAME_RATE_HZ

VARIANT = "WallBreaking-wood"
STEPS_S = {
    "mujoco": 1 / 3600,
    "pybullet": 1 / 7200,
    "rapier": 1 / 7200,
    "physx": 1 / 3600,
}
FRAMES = 24
LARGEST_SHARE = 0.2
"""Largest u over the motion."""

Array = NDArray[np.float64]


def bricks_mm(engine: str, timestep_s: float) -> Array:
    """Return the positions of the bricks on one engine [mm], shape [T, 354]."""
    env = gymnasium.make(
        f"GAUGE/{VARIANT}",
        backend=engine,
        settings={"timestep_s": timestep_s},
        disable_env_checker=True,
    ).unwrapped
    observation, _ = env.reset(seed=0)
    frames = [observation["observable"]]
    for _ in range(FRAMES):
        observation, *_ = env.step(0)
        frames.append(observation["observable"])
    env.close()
    return np.array(frames, dtype=float)


def main(folder: Path) -> None:
    """Write the reference."""
    warnings.simplefilter("ignore")
    coordinates = 3
    count = load_experiment(VARIANT).frame_count
    motions = [bricks_mm(engine, step_s) for engine, step_s in STEPS_S.items()]
    bricks = motions[0].shape[1] // coordinates
    projection = np.tile(np.eye(coordinates), bricks) / bricks
    walls_mm = np.array([motion @ projection.T for motion in motions])
    for engine, wall_mm in zip(STEPS_S, walls_mm, strict=True):
        moved_mm = (wall_mm - wall_mm[0])[8::2, 0]
        print(f"{engine:9}", *(f"{value:6.2f}" for value in moved_mm))
    mean_mm = walls_mm.mean(axis=0)
    # At the start all engines hold the scene's own positions.
    uncertainty_mm = walls_mm.std(axis=0, ddof=1)
    moved_mm = np.linalg.norm(mean_mm - mean_mm[0], axis=1)
    length_mm = np.linalg.norm(uncertainty_mm, axis=1)
    is_moving = moved_mm > 1.0
    too_uncertain = is_moving & (length_mm > LARGEST_SHARE * moved_mm)
    end = int(np.argmax(too_uncertain)) if too_uncertain.any() else len(mean_mm)
    print(f"ends at {end / FRAME_RATE_HZ:.3f} s")
    mean = np.full((count, coordinates), np.nan)
    uncertainty = np.full((count, coordinates), np.nan)
    mean[:end] = mean_mm[:end]
    uncertainty[:end] = uncertainty_mm[:end]
    store_solution(
        folder / VARIANT,
        kind="numerical",
        coordinates=["wall-x", "wall-y", "wall-z"],
        source=(
            "mean of the bricks on MuJoCo, PyBullet, Rapier and PhysX with a quarter of their steps, until the "
            "standard deviation between them, which is u, exceeds a fifth of the motion"
        ),
        mean=mean,
        uncertainty=uncertainty,
        projection=projection,
    )


if __name__ == "__main__":
    main(Path(sys.argv[1]) if sys.argv[1:] else data_folder("scoring") / "bands")
