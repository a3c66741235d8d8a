"""Compare engines, the closed form and the mean of the even trials with the odd trials of ObliqueBounce, without air.

python studies/bounces/engines.py mujoco pybullet rapier physx newton
"""

import sys

import gymnasium
import numpy as np

from gauge_envs import GaugeEnv, load_experiment
from gauge_envs.experiments.resolve import with_trial
from gauge_envs.references.single_shot import SingleShots, single_shots
from gauge_envs.scoring.exact import exact_motion
from studies.bounces.bounces import BEFORE_S, FRAMES, GRAVITY, SETTINGS, FloatArray

AFTER_S = 0.2
LAST_S = (FRAMES - 1) / 30.0 - BEFORE_S


def outcome(path_m: FloatArray) -> FloatArray:
    """Return the place 0.2 s after the bounce [m] and the velocity at the bounce [m/s], shape [6]."""
    middle = 15.0 * (path_m[-1] - path_m[-3])
    velocity = middle - (LAST_S - 1.0 / 30.0) * GRAVITY
    more_s = AFTER_S - LAST_S
    last = velocity + LAST_S * GRAVITY
    return np.concatenate(
        [path_m[-1] + more_s * last + 0.5 * more_s**2 * GRAVITY, velocity]
    )


def of_engine(name: str, engine: str, parameters: str, trial: int) -> FloatArray:
    """Return the outcome of a trial on an engine."""
    env = gymnasium.make(f"GAUGE/{name}", backend=engine, parameters=parameters)
    assert isinstance(env.unwrapped, GaugeEnv)
    observation, _ = env.reset(seed=0, options={"trial": trial})
    path = [observation["observable"]]
    for _ in range(FRAMES - 1):
        observation, *_ = env.step(np.zeros(env.action_space.shape, np.float32))
        path.append(observation["observable"])
    env.close()
    return outcome(1e-3 * np.array(path))


def of_law(name: str, parameters: str, trial: int) -> FloatArray:
    """Return the outcome of a trial by the closed form."""
    experiment = with_trial(load_experiment(name, parameters), trial)
    motion = exact_motion(experiment, np.arange(FRAMES) / 30.0)
    assert motion is not None
    return outcome(1e-3 * motion)


def report(label: str, real: FloatArray, found: FloatArray) -> None:
    """Print mean errors over trials: distance [mm], speed [m/s], and signed ones along x and z [m/s]."""
    error = found - real
    millimetres = 1e3 * np.linalg.norm(error[:, :3], axis=1).mean()
    speed = np.linalg.norm(error[:, 3:], axis=1).mean()
    along, up = error[:, 3].mean(), error[:, 5].mean()
    print(
        f"{label:32s} {millimetres:7.1f} mm {speed:6.3f} m/s   x {along:+.3f}  z {up:+.3f}",
        flush=True,
    )


def recorded(shots: SingleShots, trial: int) -> FloatArray:
    """Return the outcome of the record of a trial."""
    return outcome(shots.shot(trial).positions_m)


def main(engines: list[str]) -> None:
    """Print the table."""
    for setting in SETTINGS:
        name = f"ObliqueBounce-{setting}"
        shots = single_shots(name)
        assert shots is not None
        judged = shots.trials("judge")
        real = np.array([recorded(shots, trial) for trial in judged])
        print(
            f"{name}, {len(judged)} trials, after the bounce: {real[:, 3:].mean(axis=0).round(3)} m/s"
        )
        for parameters in ("published", "measured"):
            law = np.array([of_law(name, parameters, trial) for trial in judged])
            report(f"closed form, {parameters}", real, law)
        mean = np.mean(
            [recorded(shots, trial) for trial in shots.trials("fit")], axis=0
        )
        report("mean of the even trials", real, np.tile(mean, (len(real), 1)))
        for engine in engines:
            found = np.array(
                [of_engine(name, engine, "measured", trial) for trial in judged]
            )
            report(f"{engine}, measured", real, found)


if __name__ == "__main__":
    main(sys.argv[1:])
