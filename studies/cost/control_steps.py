"""Share of the law's limit at which MuJoCo lets a cube slip, against the time step, as `control_steps.csv`.

python studies/cost/control_steps.py > studies/cost/control_steps.csv
"""

from __future__ import annotations

import gymnasium

import gauge_envs  # noqa: F401  registers the ids
from gauge_envs.envs.control.play import engine_limit

STEPS_PER_S = (360, 540, 720, 900, 1080, 1260, 1440, 1800, 2700, 3600, 4500, 9000)


def main() -> None:
    print("id,step_per_s,share_of_law")
    for name in ("SlopeSlider-Limit-wood", "Turntable-Limit-wood"):
        for count in STEPS_PER_S:
            env = gymnasium.make(f"GAUGE/{name}", settings={"timestep_s": 1 / count}).unwrapped
            print(f"{name},{count},{engine_limit(env, bounds=(0.8, 1.2), resolution=0.0005):.4f}", flush=True)


if __name__ == "__main__":
    main()
