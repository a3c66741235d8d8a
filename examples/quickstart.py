"""Run one experiment, read how far the engine is from reality, and draw it over the real trials.

Needs matplotlib: pip install "./gauge-envs[plot]".
"""

import gymnasium as gym

from gauge_envs.runs.episodes import episode_result
from gauge_envs.tools.compare.experiment_figure import draw_experiment

env = gym.make("GAUGE/SlopeSlider-2-wood", backend="mujoco", parameters="published")
env.reset(seed=0)
terminated = truncated = False
while not (terminated or truncated):
    *_, terminated, truncated, info = env.step(0)  # No body is driven, so 0 is the only action.
print(info["score"].summary())
draw_experiment([episode_result(env, info)]).savefig("slope_slider.png")
