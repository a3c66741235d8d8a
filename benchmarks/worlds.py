"""Environment steps a second of the slope slider by the number of worlds, on engines side by side in one run.

    python benchmarks/worlds.py --worlds 1 16 256 1024 --engines newton mujoco
    python benchmarks/worlds.py --device cuda:0 --engines newton --worlds 1024 4096 16384

An episode is stepped to its end and scored in one pass over all worlds (`score_arrays=True`). Times are for one
environment step, which is one frame of one world:

- `engine`: in the engine, up to the last frame;
- `python`: reading, judging, rewards, observations and infos;
- `run on`: in the engine after the last frame, for the release alignment;
- `scoring`: the scores of all worlds.

The ratio is that of the steps a second to those of the first engine with as many worlds.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from dataclasses import asdict, dataclass
from typing import Any

import gymnasium
import numpy as np

import gauge_envs  # noqa: F401  registers the ids
from gauge_envs.backends import Simulation

NAME = "SlopeSlider-2-wood"


@dataclass
class Row:
    """Times of one engine with a number of worlds, medians over the repeats, for one environment step [us]."""

    engine: str
    worlds: int
    make_s: float
    engine_us: float
    python_us: float
    run_on_us: float
    scoring_us: float
    steps_per_s: float


def measured(engine: str, worlds: int, settings: dict[str, Any], repeats: int, name: str = NAME) -> Row:
    """Return the times of an engine."""
    start = time.perf_counter()
    envs = gymnasium.make_vec(f"GAUGE/{name}", num_envs=worlds, backend=engine, settings=settings, score_arrays=True)
    make_s = time.perf_counter() - start
    inner = envs.unwrapped
    actions = np.zeros(worlds, dtype=np.int64)
    parts = []
    for _ in range(repeats):
        envs.reset(seed=0)
        spent = _timed_engine(inner)
        frames, stepping_s, over = 0, 0.0, False
        while not over:
            start = time.perf_counter()
            # The wrapper scores in the last step; stepping below it keeps the two apart.
            *_, terminations, truncations, _ = inner.step(actions)
            stepping_s += time.perf_counter() - start
            frames += 1
            over = bool((terminations | truncations).all())
        engine_s = spent[0]
        start = time.perf_counter()
        inner.score_arrays()
        run_on_s = spent[0] - engine_s
        scoring_s = time.perf_counter() - start - run_on_s
        seconds = (engine_s, stepping_s - engine_s, run_on_s, scoring_s)
        parts.append([1e6 * part / (frames * worlds) for part in seconds])
    envs.close()
    engine_us, python_us, run_on_us, scoring_us = (statistics.median(part) for part in zip(*parts, strict=True))
    return Row(
        engine=engine,
        worlds=worlds,
        make_s=round(make_s, 2),
        engine_us=engine_us,
        python_us=python_us,
        run_on_us=run_on_us,
        scoring_us=scoring_us,
        steps_per_s=1e6 / (engine_us + python_us + run_on_us + scoring_us),
    )


def _timed_engine(envs: Any) -> list[float]:
    """Count the time that the worlds of an environment advance in; returns the seconds in a list of one entry."""
    spent, depth = [0.0], [0]
    separate = isinstance(envs.worlds.worlds[0], Simulation)
    for one in envs.worlds.worlds if separate else [envs.worlds]:
        for call in ("advance", "sample_positions"):
            if hasattr(one, call):
                setattr(one, call, _counted(getattr(type(one), call).__get__(one), spent, depth))
    return spent


def _counted(call: Any, spent: list[float], depth: list[int]) -> Any:
    def timed(*arguments: Any) -> Any:
        depth[0] += 1
        start = time.perf_counter()
        try:
            return call(*arguments)
        finally:
            depth[0] -= 1
            # A method may call the other one, whose time counts once.
            spent[0] += time.perf_counter() - start if depth[0] == 0 else 0.0

    return timed


def main() -> None:
    """Print a row for each engine and number of worlds."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--worlds", type=int, nargs="+", default=[1, 16, 256])
    parser.add_argument("--engines", nargs="+", default=["newton", "mujoco"])
    parser.add_argument("--device", default="cpu", help="Warp device of Newton")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--set", dest="changes", nargs="*", default=[], help="NAME=VALUE, for all engines")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    changes = {key: json.loads(value) for key, value in (text.split("=") for text in options.changes)}
    if not options.json:
        print(f"{NAME}, times for one environment step [us]; Newton on {options.device}")
        titles = ("worlds", "engine", "python", "run on", "scoring", "steps/s", "ratio")
        print(f"{'':8}" + "".join(f"{title:>10}" for title in titles))
    for worlds in options.worlds:
        first = 0.0
        for engine in options.engines:
            settings = {**changes, **({"device": options.device} if engine == "newton" else {})}
            row = measured(engine, worlds, settings, options.repeats)
            first = first or row.steps_per_s
            if options.json:
                print(json.dumps(asdict(row)), flush=True)
                continue
            times = (row.engine_us, row.python_us, row.run_on_us, row.scoring_us)
            texts = [str(worlds), *(f"{part:.1f}" for part in times), f"{row.steps_per_s:.0f}"]
            texts.append(f"{row.steps_per_s / first:.2f}")
            print(f"{engine:8}" + "".join(f"{text:>10}" for text in texts), flush=True)


if __name__ == "__main__":
    main()
