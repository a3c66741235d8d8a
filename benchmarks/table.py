"""All costs that users wait for, each as a ratio of times in one run, with its limit. Takes about two minutes.

    python benchmarks/table.py [--only PART ...]

It exits with 1 and names the rows whose ratio is beyond its limit. Times are processor times, so that other programs
matter little. Times of threads are wall times and need an idle machine; a busy machine leaves them out.

Limits with a reason:

- steps in training: MuJoCo takes 20 to 900 us for a frame there, as long as 60 calls of NumPy. In a single
  world of a control task, these calls take longer than MuJoCo.
- dynamic time warping: dtaidistance is a loop in C. Here it is NumPy.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import dtw
import episode_cost
import gymnasium
import numpy as np

from gauge_envs.processors import processor_count
from gauge_envs.scoring.metrics import trajectory_dtw

BUSY = 0.3
"""Load of the machine above which wall times are not measured."""

STEPS = {
    "SlopeSlider-3-wood": (0, 64),
    "BouncingBall-rubber": (64,),
    "Turntable-Limit-wood": (0, 64),
    "Throw-Limit-rubber": (0, 64),
    "Push-Limit-wood": (0, 64),
    "Fling-Limit-satin": (0,),
    "TextileStretching-satin": (0,),
    "TextileFlinging-satin": (0,),
    "FoamShearing-soft": (0,),
}
"""Numbers of worlds by id, 0 for a single environment."""

SINGLE_LIMIT, BATCH_LIMIT, CONTROL_LIMIT, DEFAULT_LIMIT = 1.6, 1.3, 2.5, 1.15
"""Limits of a step over the time within `mj_step`: training in one world, in 64, control tasks in 64, and the default
preset."""

WARPING_LIMIT = 6.0
"""Limit of dynamic time warping over compiled libraries."""

RESULT_COUNT = 1_000
"""Number of results that `gauge compare` reads."""


@dataclass(frozen=True)
class Row:
    """One cost.

    Attributes:
        what: Description of the ratio.
        ratio: The ratio; None if it was not measured.
        limit: Its limit.
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

    def __str__(self) -> str:
        """Return the row of the table."""
        ratio = "not measured" if self.ratio is None else f"{self.ratio:.2f}"
        bound = f"{'at least' if self.is_least else 'at most'} {self.limit:g}"
        return f"{self.what:54} {ratio:>13} {bound:>14}{'  BEYOND' if self.is_beyond else ''}"


def child_s(*command: str) -> float:
    """Return the processor time of a fresh process, the minimum of five [s]."""
    times = []
    for _ in range(5):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run([sys.executable, *command], check=True, capture_output=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        times.append(
            after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        )
    return min(times)


def memory_kb(code: str) -> float:
    """Return the peak resident memory of a fresh process [kB]."""
    report = (
        "import resource; print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)"
    )
    command = [sys.executable, "-c", f"{code}; {report}"]
    child = subprocess.run(command, check=True, capture_output=True, text=True)
    return float(child.stdout)


def startup() -> Iterator[Row]:
    """Yield the costs of an import, of a first environment, and of commands."""
    gymnasium_s = child_s("-c", "import gymnasium")
    import_s = child_s("-c", "import gauge_envs")
    yield Row("import gauge_envs / import gymnasium", import_s / gymnasium_s, 1.3)
    list_s = child_s("-m", "gauge_envs", "list")
    yield Row("gauge list / import gymnasium", list_s / gymnasium_s, 2.0)
    cheetah, slide = (
        f"import gymnasium, gauge_envs; gymnasium.make({name!r})"
        for name in ("HalfCheetah-v5", "GAUGE/SlopeSlider-2-wood")
    )
    cheetah_s = child_s("-c", cheetah)
    what = "SlopeSlider-2-wood / HalfCheetah-v5"
    yield Row(f"first make, {what}", child_s("-c", slide) / cheetah_s, 2.0)
    memory = memory_kb(slide) / memory_kb(cheetah)
    yield Row(f"memory, {what}", memory, 1.5)
    with tempfile.TemporaryDirectory() as folder:
        run = ("-m", "gauge_envs", "run", "SlopeSlider-2-wood", "--out", folder)
        run_s = child_s(*run)
        yield Row("gauge run SlopeSlider-2-wood / HalfCheetah-v5", run_s / cheetah_s, 3)
        (file,) = Path(folder).rglob("*.json")
        yield _comparing(json.loads(file.read_text(encoding="utf-8")))


def _comparing(result: dict[str, object]) -> Row:
    """Return the cost of a comparison of many results, over reading them as JSON."""
    with tempfile.TemporaryDirectory() as folder:
        files = [Path(folder) / f"{seed}.json" for seed in range(RESULT_COUNT)]
        for seed, file in enumerate(files):
            file.write_text(json.dumps(result | {"seed": seed}), encoding="utf-8")
        read_s = episode_cost.process_s(
            lambda: [json.loads(f.read_bytes()) for f in files]
        )
        compare_s = child_s("-m", "gauge_envs", "compare", folder)
    return Row(f"gauge compare, {RESULT_COUNT} results / json", compare_s / read_s, 10)


def steps() -> Iterator[Row]:
    """Yield the cost of a step over the time within `mj_step`."""
    for name, counts in STEPS.items():
        for count in counts:
            limit = BATCH_LIMIT if count else SINGLE_LIMIT
            if count and "Limit" in name:
                limit = CONTROL_LIMIT
            yield _step(name, "training", count, limit)
    for name in ("SlopeSlider-3-wood", "TextileStretching-satin"):
        yield _step(name, "default", 0, DEFAULT_LIMIT)


def _step(name: str, preset: str, count: int, limit: float) -> Row:
    total_s, engine_s = episode_cost.step_cost(name, preset, count, budget_s=2.0)
    what = f"step / mj_step, {preset}, {name}, {count or 'single'}"
    print(f"{what}: {1e6 * total_s:.0f} us, {1.0 / total_s:.0f} steps a second")
    return Row(what, total_s / engine_s, limit)


def warping() -> Iterator[Row]:
    """Yield the cost of dynamic time warping over the cost of other libraries."""
    first, second = dtw.inputs()
    calls = {"ours": lambda: trajectory_dtw(first, second)}
    medians = dtw.cpu_medians_ms(calls | dtw.competitors(first, second), 11)
    ours = medians.pop("ours")
    for name, theirs in medians.items():
        yield Row(f"trajectory_dtw / {name}", ours / theirs, WARPING_LIMIT)


def threads() -> Iterator[Row]:
    """Yield the speed of make_vec in threads over the speed in one thread."""
    count = processor_count()
    is_busy = os.getloadavg()[0] > BUSY * count or count < 2
    for name, number, share in (
        ("SlopeSlider-2-wood", 16, 0.9),
        ("TextileBending-satin", 2, 0.8),
    ):
        ratio = None
        if not is_busy:
            ratio = _step_s(name, number, "1") / _step_s(name, number, str(count))
        what = f"make_vec, {count} threads / one, {name}"
        yield Row(what, ratio, share * min(count, number), is_least=True)


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


PARTS: dict[str, Callable[[], Iterator[Row]]] = {
    "startup": startup,
    "steps": steps,
    "threads": threads,
    "warping": warping,
}


def main() -> int:
    """Print the table, and return 1 if a ratio is beyond its limit."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", nargs="+", choices=PARTS, default=[*PARTS])
    warnings.simplefilter("ignore")
    beyond = []
    for part in parser.parse_args().only:
        for row in PARTS[part]():
            print(row, flush=True)
            if row.is_beyond:
                beyond.append(row.what)
    if beyond:
        print(f"beyond the limit: {'; '.join(beyond)}")
    return int(bool(beyond))


if __name__ == "__main__":
    sys.exit(main())
