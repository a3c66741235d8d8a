"""Environment steps a second by the number of worlds, on engines side by side in one run.

    python benchmarks/worlds.py --worlds 1 16 256 1024 --engines newton mujoco
    python benchmarks/worlds.py --device cuda:0 --engines newton --worlds 1024 4096 16384

An episode is stepped to its end and scored in one pass over all worlds. Times are for one environment step, which is
one frame of one world:

- `engine`: in the calls of the simulation, up to the last frame;
- `host`: observations, rewards and infos;
- `scoring`: the scores of all worlds, with the time after the last frame that the release alignment needs.

`--cpu-time` counts processor time, for a CPU that other programs share. It does not measure a GPU.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from itertools import product
from typing import Any

import gymnasium
import numpy as np

import gauge_envs  # noqa: F401  registers the ids

NAME = "SlopeSlider-2-wood"
CALLS = ("drive", "advance", "body_states", "nodes", "diverged")
Clock = Callable[[], float]


@dataclass
class Row:
    """Times of one engine with a number of worlds, medians over the repeats, for one environment step [us]."""

    name: str
    engine: str
    worlds: int
    make_s: float
    engine_us: float
    host_us: float
    scoring_us: float
    steps_per_s: float


def measured(
    name: str,
    engine: str,
    worlds: int,
    settings: dict[str, Any],
    *,
    repeats: int = 3,
    clock: Clock = time.perf_counter,
) -> Row:
    """Return the times of an engine."""
    start = clock()
    envs = gymnasium.make_vec(
        f"GAUGE/{name}", num_envs=worlds, backend=engine, settings=settings
    )
    make_s = clock() - start
    frames = envs.unwrapped.experiment.frame_count - 1
    # The first episode loads kernels.
    episodes = [episode_s(envs, clock) for _ in range(repeats + 1)][1:]
    envs.close()
    engine_us, host_us, scoring_us = (
        1e6 * statistics.median(part) / (frames * worlds)
        for part in zip(*episodes, strict=True)
    )
    return Row(
        name=name,
        engine=engine,
        worlds=worlds,
        make_s=make_s,
        engine_us=engine_us,
        host_us=host_us,
        scoring_us=scoring_us,
        steps_per_s=1e6 / (engine_us + host_us + scoring_us),
    )


def episode_s(envs: Any, clock: Clock) -> tuple[float, float, float]:
    """Return the seconds of an episode in the engine, on the host and in scoring."""
    inner = envs.unwrapped
    inner.reset(seed=0)
    simulation = inner.rollout.simulation
    spent_s = [0.0]
    for call in CALLS:
        setattr(simulation, call, timed(getattr(simulation, call), spent_s, clock))
    actions = np.zeros(inner.action_space.shape, inner.action_space.dtype)
    start = clock()
    # The wrapper scores in the last step; stepping below it keeps the two apart.
    while not inner.rollout.is_over.all():
        inner.step(actions)
    stepping_s, engine_s = clock() - start, spent_s[0]
    start = clock()
    inner.score_arrays()
    scoring_s = clock() - start
    # Uncover the methods of the class.
    for call in CALLS:
        delattr(simulation, call)
    return engine_s, stepping_s - engine_s, scoring_s


def timed(call: Any, spent_s: list[float], clock: Clock) -> Any:
    """Return a method that adds its time to a list of one entry."""

    def counted(*arguments: Any) -> Any:
        start = clock()
        try:
            return call(*arguments)
        finally:
            spent_s[0] += clock() - start

    return counted


def main() -> None:
    """Print a row for each id, engine and number of worlds."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--names", nargs="+", default=[NAME], help="ids without GAUGE/")
    parser.add_argument("--worlds", type=int, nargs="+", default=[1, 16, 256])
    parser.add_argument("--engines", nargs="+", default=["newton", "mujoco"])
    parser.add_argument("--device", default="cpu", help="Warp device of Newton")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument(
        "--set", nargs="*", default=[], help="NAME=VALUE, for all engines"
    )
    parser.add_argument("--cpu-time", action="store_true")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    clock = time.process_time if options.cpu_time else time.perf_counter
    changes = {
        key: json.loads(value)
        for key, value in (text.split("=") for text in options.set)
    }
    if not options.json:
        print(f"Times for one environment step [us]; Newton on {options.device}")
        titles = "".join(f"{t:>10}" for t in ("engine", "host", "scoring", "steps/s"))
        print(f"{'id':22}{'engine':10}{'worlds':>8}{titles}")
    for name, worlds, engine in product(options.names, options.worlds, options.engines):
        settings = dict(changes)
        if engine == "newton":
            settings["device"] = options.device
        row = measured(
            name, engine, worlds, settings, repeats=options.repeats, clock=clock
        )
        if options.json:
            print(json.dumps(asdict(row)), flush=True)
            continue
        times = (row.engine_us, row.host_us, row.scoring_us)
        texts = [*(f"{part:.2f}" for part in times), f"{row.steps_per_s:.0f}"]
        numbers = "".join(f"{text:>10}" for text in texts)
        print(f"{name:22}{engine:10}{worlds:>8}{numbers}", flush=True)


if __name__ == "__main__":
    main()
