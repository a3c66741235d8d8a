"""All costs that users wait for, each as a ratio in one run, with its limit. Exits 1 if a ratio exceeds its limit.

    python benchmarks/table.py [--only TEXT]

Times are processor times, so that other programs matter little. Times of threads and jobs are wall times, which need an
idle machine; they are left out on a busy machine. Limits with a reason:

- engines: none, as their times are compared and not judged;
- dynamic time warping: tslearn compiles its loop with Numba, which with scikit-learn adds 280 MB to an installation.
  Here it is NumPy. Of light libraries, dtw-python takes twice as long with the same local costs.
"""

from __future__ import annotations

import argparse
import math
import os
import statistics
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import dtw
import gymnasium
import numpy as np
import step
import worlds

from gauge_envs.backends.registry import backend_names
from gauge_envs.errors import GaugeError, MissingExtraError
from gauge_envs.files import processors
from gauge_envs.runs.episodes import run_episode
from gauge_envs.runs.request import RunRequest

BUSY = 0.3
"""Load of the machine above which wall times are not measured."""


@dataclass(frozen=True)
class Row:
    """One cost.

    Attributes:
        what: Description of the ratio.
        ratio: The ratio; None if it was not measured.
        limit: Its limit; infinite without a limit.
        is_least: Whether the limit is the smallest ratio instead of the largest.
    """

    what: str
    ratio: float | None
    limit: float
    is_least: bool = False

    @property
    def is_beyond(self) -> bool:
        """Whether the ratio is beyond its limit."""
        return self.ratio is not None and (
            self.ratio < self.limit if self.is_least else self.ratio > self.limit
        )


def child_s(code: str) -> float:
    """Return the processor time of a fresh interpreter that runs a program, the minimum of five [s]."""
    times = []
    for _ in range(5):
        before = os.times()
        subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)
        after = os.times()
        times.append(
            after.children_user
            + after.children_system
            - before.children_user
            - before.children_system
        )
    return min(times)


def startup() -> Iterator[Row]:
    """Yield the costs of an import and of commands, over an import of Gymnasium."""
    gymnasium_s = child_s("import gymnasium")
    yield Row(
        "import gauge_envs / import gymnasium",
        child_s("import gauge_envs") / gymnasium_s,
        1.3,
    )
    command = "import sys; sys.argv = ['gauge', 'list']; from gauge_envs.__main__ import main; main()"
    yield Row("gauge list / import gymnasium", child_s(command) / gymnasium_s, 3.5)
    makes = [
        f"import gymnasium, gauge_envs; gymnasium.make({name!r})"
        for name in ("HalfCheetah-v5", "GAUGE/SlopeSlider-2-wood")
    ]
    cheetah_s, slide_s = map(child_s, makes)
    yield Row("make SlopeSlider-2-wood / HalfCheetah-v5", slide_s / cheetah_s, 2.0)


def steps() -> Iterator[Row]:
    """Yield the cost of a step over the cost of a bare MuJoCo step."""
    for name in ("SlopeSlider-2-wood", "BouncingBall-rubber", "Pendulum-metal"):
        yield Row(f"env.step / mj_step, {name}", step.measured(name)[2], step.LIMIT)


def warping() -> Iterator[Row]:
    """Yield the cost of dynamic time warping over the cost of other libraries."""
    first, second = dtw.inputs()["one motion, warped and noisy"]
    calls = {"ours": lambda: dtw.dtw_path(first, second)} | dtw.competitors(
        first, second
    )
    medians = dtw.cpu_medians_ms(calls, 31)
    ours = medians.pop("ours")
    for name, theirs in medians.items():
        yield Row(
            f"dtw_path / {name}", ours / theirs, 1.3 if "from_metric" in name else 0.6
        )


def many_worlds() -> Iterator[Row]:
    """Yield the time of an environment step outside MuJoCo, over its limit."""
    for name, limits_us in (
        ("SlopeSlider-2-wood", {64: 5.0, 1024: 1.0}),
        ("Turntable-1-wood", {64: 5.0, 1024: 1.0}),
    ):
        for count, limit_us in limits_us.items():
            row = worlds.measured(
                name, "mujoco", count, {}, repeats=2, clock=time.process_time
            )
            yield Row(
                f"{name}, {count} worlds, host us / {limit_us:g} us",
                row.host_us / limit_us,
                1.0,
            )


def threads() -> Iterator[Row]:
    """Yield the speed of make_vec in threads over the speed in one thread."""
    count = processors()
    is_busy = os.getloadavg()[0] > BUSY * count or count < 2
    for name, number, minimum in (
        ("SlopeSlider-2-wood", 16, 0.9),
        ("TextileBending-satin", 2, 0.8),
    ):
        ratio = None
        if not is_busy:
            ratio = _step_s(name, number, "1") / _step_s(name, number, str(count))
        yield Row(
            f"make_vec, {name}, {count} threads / one",
            ratio,
            minimum * min(count, number),
            is_least=True,
        )


def _step_s(name: str, world_count: int, thread_count: str) -> float:
    """Return the wall time of a step of all worlds [s]."""
    before = dict(os.environ)
    os.environ["OMP_NUM_THREADS"] = thread_count
    envs = gymnasium.make_vec(f"GAUGE/{name}", num_envs=world_count)
    os.environ.clear()
    os.environ.update(before)
    envs.reset(seed=0)
    actions, times_s = np.zeros(envs.action_space.shape, envs.action_space.dtype), []
    for _ in range(10):
        start = time.perf_counter()
        envs.step(actions)
        times_s.append(time.perf_counter() - start)
    return statistics.median(times_s)


def engines() -> Iterator[Row]:
    """Yield the processor time of an episode on each installed engine, over that on MuJoCo."""
    names = ["mujoco", *(name for name in backend_names() if name != "mujoco")]
    for experiment in ("SlopeSlider-2-wood", "BouncingBall-rubber", "Pendulum-metal"):
        times_s: dict[str, float] = {}
        for name in names:
            try:
                times_s[name] = _episode_s(experiment, name)
            except GaugeError:
                continue
            if name != "mujoco":
                ratio = times_s[name] / times_s["mujoco"]
                yield Row(f"{name} / mujoco, {experiment}", ratio, math.inf)


def _episode_s(experiment: str, engine: str) -> float:
    """Return the processor time of reset and steps of an episode, the minimum of three [s]."""
    request = RunRequest(experiment, backend=engine)
    times_s = [run_episode(request).cpu_s for _ in range(3)]
    return min(time_s for time_s in times_s if time_s is not None)


PARTS: dict[str, Callable[[], Iterator[Row]]] = {
    "startup": startup,
    "threads": threads,
    "steps": steps,
    "warping": warping,
    "worlds": many_worlds,
    "engines": engines,
}


def main() -> int:
    """Print the table, and return 1 if a ratio is beyond its limit."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", nargs="+", choices=PARTS, default=[*PARTS])
    warnings.simplefilter("ignore")
    has_failed = False
    for part in parser.parse_args().only:
        try:
            for row in PARTS[part]():
                ratio = "not measured" if row.ratio is None else f"{row.ratio:.2f}"
                bound = f"{'at least' if row.is_least else 'at most'} {row.limit:g}"
                if math.isinf(row.limit):
                    bound = "-"
                print(
                    f"{row.what:62} {ratio:>13} {bound:>14}{'  BEYOND' if row.is_beyond else ''}",
                    flush=True,
                )
                has_failed |= row.is_beyond
        except MissingExtraError as error:
            print(f"{part}: {error}", file=sys.stderr)
            has_failed = True
    return int(has_failed)


if __name__ == "__main__":
    sys.exit(main())
