"""Search for a policy that a simulator pays more than the law of a control task allows.

CMA-ES varies the law's own policy in many worlds at once and maximizes `info["limit"].ratio`. Needs `pip install cma`.

    cd studies/law_search
    python law_search.py Carry-Limit-wood --engine rapier --set '{"preset": "out_of_box"}' --episodes 1000
    python law_search.py Carry-Limit-wood --replay found.json --engine mujoco

The first writes a JSON line with the largest ratio and reward and the numbers that gave them. The second replays them.
What varies, 26 to 48 numbers (12 for Throw):

- Carry, Push: the action of each frame, along and across the way to the goal, about those of the law's policy.
- Pendulum: the torque, in pieces of two frames, about those of the law's policy.
- SlopeSlider, Turntable: the share of the limit, and what is added to the action in each of 30 frames at the limit.
- Throw: for each impact, place of the ball on the plate, the plate's speed along x, height of the impact, and delay.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gauge_envs.tools.control.carry import CarryLimit
from gauge_envs.tools.control.env import ControlEnv
from gauge_envs.tools.control.friction import HOLD_FRAMES, FrictionLimit
from gauge_envs.tools.control.least_time import LeastTimeLimit
from gauge_envs.tools.control.limit import Ending
from gauge_envs.tools.control.pendulum import PendulumLimit
from gauge_envs.tools.control.slope_slider import SlopeSliderLimit
from gauge_envs.tools.control.stage import FRAME_S, acceleration_to_rest
from gauge_envs.tools.control.throw import SPEED_M_PER_S, STROKE_M, ThrowLimit
from gauge_envs.tools.control.vector import ControlWorlds

FloatArray = NDArray[np.float64]
Act = Callable[[ControlEnv, int, FloatArray], FloatArray]

WORLDS = 16
"""Worlds at a time, which is the population."""

SEED = 0
"""Seed of the goals, so that each episode has the same goal."""

PIECE = 2
"""Frames of a piece of the pendulum's torque."""

RAMP_FRAMES = 32
"""Frames of the tilt to the limit: full acceleration, then full braking."""


def base_actions(task: str, options: dict[str, Any]) -> FloatArray:
    """Return the actions of the law's policy with the largest of some shares that succeeds, shape [frames, size]."""
    worlds = ControlWorlds(task, [{}], **options)
    env = worlds.envs[0]
    for fraction in (0.99, 0.97, 0.94, 0.9, 0.8, 0.6, 0.4):
        worlds.begin({0: SEED})
        actions, over = [], False
        while not over:
            actions.append(env.law_action(fraction).astype(float))
            _, _, terminated, truncated, _ = worlds.step({0: actions[-1]})[0]
            over = terminated or truncated
        if env.report().ending is Ending.REACHED:
            break
    worlds.close()
    return np.array(actions)


def turned(env: LeastTimeLimit, along: float, across: float) -> FloatArray:
    """Return an action from its parts along and across the way to the goal."""
    way = env.goal_m / np.linalg.norm(env.goal_m)
    return along * way + across * np.array([-way[1], way[0]])


def sequence(env: ControlEnv, base: FloatArray) -> tuple[Act, FloatArray, float, int]:
    """Return a policy of one action for each frame, its first numbers, their scatter, and the frames of an episode."""
    if isinstance(env, PendulumLimit):
        count = math.ceil(len(base) / PIECE) * PIECE
        padded = np.concatenate([base[:, 0], np.zeros(count - len(base))])
        start = padded.reshape(-1, PIECE).mean(axis=1)

        def swing(_: ControlEnv, frame: int, numbers: FloatArray) -> FloatArray:
            piece = frame // PIECE
            return numbers[piece : piece + 1] if piece < len(numbers) else np.zeros(1)

        return swing, start, 0.05, count + 12
    assert isinstance(env, LeastTimeLimit)
    way = env.goal_m / np.linalg.norm(env.goal_m)
    start = np.column_stack([base @ way, base @ np.array([-way[1], way[0]])]).ravel()

    def move(one: ControlEnv, frame: int, numbers: FloatArray) -> FloatArray:
        assert isinstance(one, LeastTimeLimit)
        if 2 * frame < len(numbers):
            return turned(one, *numbers[2 * frame : 2 * frame + 2])
        return one.law_action(0.9).astype(float)

    return move, start, 0.03 if isinstance(env, CarryLimit) else 0.06, len(base) + 6


def at_the_limit(env: FrictionLimit) -> tuple[Act, FloatArray, float, int]:
    """Return a policy that goes to a share of the limit and is free for as long as the friction used is averaged."""
    is_slope = isinstance(env, SlopeSliderLimit)
    ramp = RAMP_FRAMES if is_slope else RAMP_FRAMES + 6

    def act(one: ControlEnv, frame: int, numbers: FloatArray) -> FloatArray:
        assert isinstance(one, FrictionLimit)
        share = 0.97 + 0.1 * float(numbers[0])
        added = (
            float(numbers[1 + frame - ramp])
            if ramp <= frame < ramp + HOLD_FRAMES
            else 0.0
        )
        if not is_slope:
            return one.law_action(share).astype(float) + added
        half_s = 0.5 * ramp * FRAME_S
        tilt = (
            math.atan(share * one.limit.value) / half_s**2 / one.ACCELERATION_RAD_PER_S2
        )
        return np.array(
            [(tilt if 2 * frame < ramp else -tilt if frame < ramp else 0.0) + added]
        )

    return act, np.zeros(1 + HOLD_FRAMES), 0.05, ramp + HOLD_FRAMES + 3


def bounce(env: ControlEnv, _: int, numbers: FloatArray) -> FloatArray:
    """Return the law's action with other places, speeds and times of the impacts."""
    (
        ball_x_m,
        height_m,
        ball_x_rate,
        ball_z_rate,
        plate_m,
        rate_x,
        rate_z,
        impacts,
        _,
    ) = env.trajectory()[-1].tolist()
    aside, speed_x, place, delay = numbers.reshape(3, 4)[min(int(impacts), 2)].tolist()
    place_m = min(max(0.8 * STROKE_M + 0.05 * place, -STROKE_M), STROKE_M)
    gravity, most = (
        env.experiment.scene.gravity_m_per_s2,
        ThrowLimit.ACCELERATION_M_PER_S2,
    )
    meets_s = (
        ball_z_rate
        + math.sqrt(max(ball_z_rate**2 + 2.0 * gravity * (height_m - place_m), 0.0))
    ) / gravity
    velocity_x = min(max(speed_x, -SPEED_M_PER_S), SPEED_M_PER_S)
    across_m = ball_x_m + ball_x_rate * meets_s + 0.1 * aside - velocity_x * meets_s
    across = acceleration_to_rest(across_m, rate_x - velocity_x, 0.5 * most)
    if place_m - SPEED_M_PER_S * (meets_s - (0.5 + delay) * FRAME_S) >= plate_m:
        up = (SPEED_M_PER_S - rate_z) / FRAME_S
    else:
        up = acceleration_to_rest(-STROKE_M + 0.005 - plate_m, rate_z, 0.5 * most)
    return np.array([across, up]) / most


def searched(task: str, options: dict[str, Any]) -> tuple[Act, FloatArray, float, int]:
    """Return the policy that varies, its first numbers, their scatter, and the frames of an episode."""
    worlds = ControlWorlds(task, [{}], **options)
    worlds.begin({0: SEED})
    env = worlds.envs[0]
    worlds.close()
    if isinstance(env, ThrowLimit):
        return bounce, np.zeros(12), 0.2, env.frame_count - 1
    if isinstance(env, FrictionLimit):
        return at_the_limit(env)
    return sequence(env, base_actions(task, options))


def play(
    worlds: ControlWorlds, act: Act, population: list[FloatArray], frames: int
) -> list[tuple[float, float, str]]:
    """Run an episode of each policy, cut after some frames; return ratio, reward and ending."""
    worlds.begin(dict.fromkeys(range(len(population)), SEED))
    paid, endings, running = (
        np.zeros(len(population)),
        ["cut"] * len(population),
        list(range(len(population))),
    )
    for frame in range(frames):
        actions = {
            one: np.clip(act(worlds.envs[one], frame, population[one]), -1.0, 1.0)
            for one in running
        }
        for one, (_, reward, terminated, truncated, _) in worlds.step(actions).items():
            paid[one] += reward
            if terminated or truncated:
                endings[one] = worlds.envs[one].report().ending.value
                running.remove(one)
        if not running:
            break
    ratios = [
        # An episode that is cut has no report.
        0.0 if ending == "diverged" else env._reached() / env.limit.value  # noqa: SLF001
        for env, ending in zip(worlds.envs, endings, strict=False)
    ]
    return list(zip(ratios, paid.tolist(), endings, strict=True))


def search(
    task: str,
    options: dict[str, Any],
    episodes: int,
    seed: int,
    first: FloatArray | None,
) -> dict[str, Any]:
    """Return the largest ratio and reward that CMA-ES finds."""
    import cma

    act, start, scatter, frames = searched(task, options)
    worlds = ControlWorlds(task, [{}] * WORLDS, **options)
    began = time.process_time()
    strategy = cma.CMAEvolutionStrategy(
        start if first is None else first,
        scatter,
        {"popsize": WORLDS, "seed": seed + 1, "verbose": -9},
    )
    found: dict[str, Any] = {
        "episodes": 0,
        "ratio": -1.0,
        "reward": -math.inf,
        "above": 0,
    }
    population = [start if first is None else first, *strategy.ask()[1:]]
    while found["episodes"] < episodes:
        results = play(worlds, act, population, frames)
        found["episodes"] += len(results)
        for numbers, (ratio, reward, ending) in zip(population, results, strict=True):
            found["above"] += ratio > 1.0
            if ratio > found["ratio"]:
                found |= {
                    "ratio": ratio,
                    "ending": ending,
                    "numbers": np.asarray(numbers).tolist(),
                }
            found["reward"] = max(found["reward"], reward)
        # An episode that reached nothing is worth less than any other, and more with a larger reward.
        strategy.tell(
            population,
            [
                -ratio if ratio > 0.0 else 1.0 - 0.1 * reward
                for ratio, reward, _ in results
            ],
        )
        if strategy.stop():
            strategy = cma.CMAEvolutionStrategy(
                found["numbers"],
                2.0 * scatter,
                {"popsize": WORLDS, "seed": seed + found["episodes"], "verbose": -9},
            )
        population = strategy.ask()
    worlds.close()
    return {
        "task": task,
        **options,
        **found,
        "cpu_s": round(time.process_time() - began, 1),
    }


def numbers_of(path: str) -> FloatArray:
    """Return the numbers that a search found."""
    return np.array(json.loads(Path(path).read_text(encoding="utf-8"))["numbers"])


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("task")
    parser.add_argument("--engine", default="mujoco")
    parser.add_argument("--set", default="{}", help="settings of the engine, JSON")
    parser.add_argument("--episodes", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--start", help="JSON file of an earlier search, to go on from its numbers"
    )
    parser.add_argument(
        "--replay", help="JSON file of a search, whose numbers are replayed"
    )
    given = parser.parse_args()
    options = {"backend": given.engine, "settings": json.loads(given.set) or None}
    if given.replay:
        numbers = numbers_of(given.replay)
        act, _, _, frames = searched(given.task, options)
        worlds = ControlWorlds(given.task, [{}], **options)
        ((ratio, reward, ending),) = play(worlds, act, [numbers], frames)
        print(
            json.dumps(
                {
                    "task": given.task,
                    **options,
                    "ratio": ratio,
                    "reward": reward,
                    "ending": ending,
                }
            )
        )
        return
    first = numbers_of(given.start) if given.start else None
    json.dump(
        search(given.task, options, given.episodes, given.seed, first), sys.stdout
    )
    print()


if __name__ == "__main__":
    main()
