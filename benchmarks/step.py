"""Cost of `env.step` relative to bare MuJoCo stepping of the same model for the same frames, paired in one run.

Bare stepping is one `mj_step` call for each frame with all substeps, the cheapest way; bare bodies are not driven. The
last step of an episode, which scores it, is timed separately. The exit code is 1 if a ratio is above the limit.
"""

from __future__ import annotations

import sys
import time

import gymnasium
import mujoco
import numpy as np

import gauge_envs  # noqa: F401  registers the ids

NAMES = (
    "SlopeContact-wood",
    "NonsmoothContact-1-wood",
    "SlopeSlider-2-wood",
    "Turntable-1-wood",
    "BouncingBall-rubber",
    "NewtonsCradle-metal",
    "WallBreaking-wood",
    "Pendulum-metal",
)
LIMIT = 1.5
"""Largest allowed ratio. In small scenes the Python code of a frame takes up to two fifths of the time of MuJoCo."""
LONGEST_FRAMES = 60
SECONDS_EACH = 2.0


def measured(name: str) -> tuple[float, float, float]:
    """Return medians over paired repeats: bare and full time for each frame [us], and their ratio."""
    env = gymnasium.make(f"GAUGE/{name}")
    env.reset(seed=0)
    simulation = env.unwrapped.rollout.simulation
    frames = min(env.unwrapped.experiment.frame_count - 2, LONGEST_FRAMES)
    steps = round(1 / 30 / simulation.settings["timestep_s"])
    action = (
        0
        if isinstance(env.action_space, gymnasium.spaces.Discrete)
        else np.zeros(env.action_space.shape)
    )
    bare_s, full_s = [], []
    until = time.thread_time() + SECONDS_EACH
    while time.thread_time() < until or len(bare_s) < 5:
        env.reset(seed=0)
        start = time.thread_time()
        for _ in range(frames):
            mujoco.mj_step(simulation.model, simulation.data, nstep=steps)
        bare_s.append(time.thread_time() - start)
        env.reset(seed=0)
        start = time.thread_time()
        for _ in range(frames):
            env.step(action)
        full_s.append(time.thread_time() - start)
    ratio = float(np.median(np.array(full_s) / np.array(bare_s)))
    return (
        1e6 * float(np.median(bare_s)) / frames,
        1e6 * float(np.median(full_s)) / frames,
        ratio,
    )


def scoring_ms(name: str) -> float:
    """Return the median time of the last step of an episode minus the time of the step before [ms]."""
    env = gymnasium.make(f"GAUGE/{name}")
    extra = []
    for _ in range(20):
        env.reset(seed=0)
        durations, over = [], False
        while not over:
            start = time.thread_time()
            *_, terminated, truncated, _ = env.step(0)
            durations.append(time.thread_time() - start)
            over = terminated or truncated
        extra.append(durations[-1] - durations[-2])
    return 1e3 * float(np.median(extra))


def main() -> int:
    """Print the table, and return 1 if a ratio is above the limit."""
    worst = 0.0
    print(f"{'experiment':26} {'bare us':>9} {'step us':>9} {'ratio':>7}")
    for name in NAMES:
        bare, full, ratio = measured(name)
        worst = max(worst, ratio)
        print(f"{name:26} {bare:9.1f} {full:9.1f} {ratio:7.3f}")
    print(
        f"scoring an episode of SlopeSlider-2-wood: {scoring_ms('SlopeSlider-2-wood'):.2f} ms"
    )
    print(f"worst ratio {worst:.3f}, limit {LIMIT}")
    return int(worst > LIMIT)


if __name__ == "__main__":
    sys.exit(main())
