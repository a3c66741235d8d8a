"""What MuJoCo pays the law's policy of control tasks, against the time step, as `control_steps.csv`.

python -m studies.control_steps.control_steps > studies/cost/control_steps.csv

In tasks with a limit of their own it is the share of the law's limit at which the policy fails, by bisection. In the
others it is what the policy reaches with 0.98 of the limit, mean over goals, and the largest change of a goal from the
finest step.
"""

from __future__ import annotations

import gymnasium
import numpy as np

import gauge_envs  # noqa: F401  registers the ids
from gauge_envs.tools.control.play import engine_limit, play

STEPS_PER_S = (
    18000,
    9000,
    4500,
    3600,
    2700,
    1800,
    1440,
    1260,
    1080,
    900,
    720,
    540,
    360,
)
BISECTED = (
    "Pendulum-metal",
    "SlopeSlider-wood",
    "SlopeSlider-plastic",
    "SlopeSlider-metal",
    "Turntable-wood",
)
REACHING = {"Carry-wood": 8, "Push-wood": 8, "Throw-rubber": 1}
"""Number of goals, which are the first seeds."""


def main() -> None:
    print("id,step_per_s,share_of_law,largest_change")
    for name in (*BISECTED, *REACHING):
        finest = None
        for count in (
            (*STEPS_PER_S, 180)
            if name in REACHING or name.startswith("Pendulum")
            else STEPS_PER_S[1:]
        ):
            task = name.replace("-", "-Limit-")
            env = gymnasium.make(
                f"GAUGE/{task}", settings={"timestep_s": 1 / count}
            ).unwrapped
            if name in BISECTED:
                print(
                    f"{task},{count},{engine_limit(env, bounds=(0.8, 1.2), resolution=0.0005):.4f},",
                    flush=True,
                )
                continue
            goals = [
                play(env, lambda _, env=env: env.law_action(0.98), seed=seed)
                for seed in range(REACHING[name])
            ]
            shares = np.array([report.ratio for report in goals])
            finest = shares if finest is None else finest
            print(
                f"{task},{count},{shares.mean():.4f},{np.abs(shares - finest).max():.4f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
