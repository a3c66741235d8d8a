"""Distributions over random starts of motions that part by chaos, as `starts.csv`, and the rule that judges by them.

python -m studies.steps.starts run FOLDER Funnel-satin 1001-1016    # a file for each episode, if there is none yet
python -m studies.steps.starts table FOLDER > studies/steps/starts.csv
"""

from __future__ import annotations

import csv
import math
import sys
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, fields
from functools import cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter

from gauge_envs.envs.env import GaugeEnv

FILE = Path(__file__).with_name("starts.csv")

STANDARD_ERRORS = 2.0
"""Half the width of the intervals on which the rule decides [standard errors]."""

HALVES = 200
"""Random divisions of the episodes of one setting into halves."""

Verdict = Literal["allowed", "refused", "undecided"]


@dataclass(frozen=True)
class Setting:
    """What differs from a preset: the step, and the cap of the solver's iterations where it is not the preset's."""

    preset: str
    steps_per_s: int
    iterations: int | None = None

    def __str__(self) -> str:
        cap = "" if self.iterations is None else f" {self.iterations} iterations"
        return f"{self.preset} 1/{self.steps_per_s} s{cap}"

    def values(self) -> dict[str, Any]:
        """Return the settings of MuJoCo."""
        values: dict[str, Any] = {"timestep_s": 1.0 / self.steps_per_s}
        if self.preset == "training":
            values["preset"] = self.preset
        if self.iterations is not None:
            values["iterations"] = self.iterations
        return values


DRAPE = (
    Setting("default", 1800),
    Setting("default", 900),
    Setting("default", 540),
    Setting("default", 540, 25),
    Setting("training", 1080),
    Setting("training", 540),
    Setting("training", 360),
    Setting("training", 180),
)
SETTINGS = {
    "Funnel": DRAPE,
    "RotatingBall": DRAPE,
    "WallBreaking": tuple(Setting("default", n) for n in (1800, 900, 540, 360)),
    "RopeWinding": tuple(Setting("default", n) for n in (18000, 9000, 4500, 1800)),
    "StickStack": tuple(Setting("default", n) for n in (3600, 1800, 900)),
}
"""Settings by family. The first of each preset is the finest, to which the others are compared.

For the wall and the sticks `training` has another step alone, and for the rope nothing, so that they have one list.
"""


@dataclass(frozen=True, kw_only=True)
class StartsError:
    """How the motions of one setting differ from those of the finest, over the same random starts.

    Attributes:
        id: Experiment.
        setting: The setting that is judged.
        finest: The setting that it is compared with.
        starts: Number of starts.
        scatter: Standard deviation of g(t) over starts with the finest setting, rms over the frames.
        unit: Unit of `scatter`.
        change: Squared change of the mean motion over the squared scatter, less what noise adds to it; may be below 0.
        change_error: Its standard error.
        halves: 95th percentile of the same of halves of the episodes of the finest setting.
        log_spread: Logarithm of the scatter with the setting over that with the finest.
        log_spread_error: Its standard error.
        moved: Distance of two motions from the same start, rms over frames and starts, over the scatter.
        cpu_s: CPU time of an episode, mean [s].
        finest_cpu_s: The same of the finest setting [s].
    """

    id: str
    setting: str
    finest: str
    starts: int
    scatter: float
    unit: str
    change: float
    change_error: float
    halves: float
    log_spread: float
    log_spread_error: float
    moved: float
    cpu_s: float
    finest_cpu_s: float


def read_rows() -> list[StartsError]:
    """Read the table."""
    with FILE.open(newline="", encoding="utf-8") as lines:
        return TypeAdapter(list[StartsError]).validate_python([*csv.DictReader(lines)])


def verdict(row: StartsError, share: float) -> Verdict:
    """Return what the rule says of a setting; `undecided` leaves the step that a preset has.

    Args:
        row: Its differences from the finest setting.
        share: Largest change of the mean motion, and of the scatter, over the scatter; one of `steps.SHARES`.
    """
    change_half = STANDARD_ERRORS * row.change_error
    spread_half = STANDARD_ERRORS * row.log_spread_error
    least, most = math.log(1.0 - share), math.log(1.0 + share)
    if row.change - change_half > share**2:
        return "refused"
    if row.log_spread - spread_half > most or row.log_spread + spread_half < least:
        return "refused"
    is_small = row.change + change_half <= share**2
    agrees = (
        row.log_spread - spread_half >= least and row.log_spread + spread_half <= most
    )
    return "allowed" if is_small and agrees else "undecided"


def mean_change(differences: NDArray[np.float64]) -> tuple[float, float]:
    """Return the squared length of the mean of random vectors, unbiased, and its standard error.

    It is the mean of the products of two different vectors. Its variance is 2 tr(S^2) / (n (n - 1)) from noise alone,
    S their covariance, and 4 m S m / n with a mean m (Chen and Qin, Annals of Statistics 38, 2010).

    Args:
        differences: Vectors of independent starts, shape [n, width].
    """
    count = len(differences)
    mean = differences.mean(axis=0)
    centred = differences - mean
    products = centred @ centred.T
    trace = float(np.trace(products)) / (count - 1)
    # The plain estimate of tr(S^2) has tr(S)^2 / n of noise (Bai and Saranadasa, Statistica Sinica 6, 1996).
    plain = float((products**2).sum()) / (count - 1) ** 2
    factor = (count - 1) ** 2 / ((count - 2) * (count + 1))
    trace_of_square = factor * max(plain - trace**2 / (count - 1), 0.0)
    along = float(((centred @ mean) ** 2).sum()) / (count - 1)
    variance = 2.0 * trace_of_square / (count * (count - 1)) + 4.0 * along / count
    return float(mean @ mean) - trace / count, math.sqrt(variance)


def squared_scatter(motions: NDArray[np.float64]) -> float:
    """Return the variance over starts of motions of shape [n, width], summed over the width."""
    return float(motions.var(axis=0, ddof=1).sum())


def log_spread(
    coarse: NDArray[np.float64], fine: NDArray[np.float64]
) -> tuple[float, float]:
    """Return the logarithm of the ratio of two scatters, and its standard error by the jackknife over starts."""
    count = len(coarse)

    def ratio(kept: NDArray[np.bool_]) -> float:
        return 0.5 * math.log(
            squared_scatter(coarse[kept]) / squared_scatter(fine[kept])
        )

    without = [ratio(np.arange(count) != index) for index in range(count)]
    error = math.sqrt((count - 1) * float(np.var(without)))
    return ratio(np.ones(count, dtype=bool)), error


def halves_change(motions: NDArray[np.float64]) -> float:
    """Return the 95th percentile of the change of the mean between halves of one setting, over its variance.

    Starts of the halves differ, and each has half of them. NaN for fewer than six starts, as noise needs three in each.
    """
    if len(motions) < 6:
        return math.nan
    random = np.random.default_rng(0)
    size = len(motions) // 2
    changes = []
    for _ in range(HALVES):
        order = random.permutation(len(motions))
        pairs = motions[order[:size]] - motions[order[size : 2 * size]]
        changes.append(mean_change(pairs)[0])
    return float(np.quantile(changes, 0.95)) / squared_scatter(motions)


@cache
def environment(name: str, setting: Setting) -> GaugeEnv:
    """Return the environment of a setting, built once."""
    return GaugeEnv(name, settings=setting.values(), marker_proxy="material")


def run(
    folder: Path, name: str, seeds: range, preset: str = "", limit_s: float = math.inf
) -> None:
    """Write the episodes that a folder lacks, all settings of a start before the next start.

    Args:
        folder: Folder of the files, one for each episode.
        name: Experiment.
        seeds: Seeds of the starts, `jitter` in a reset.
        preset: Preset whose settings alone are run; empty for all.
        limit_s: No episode begins after so much wall time [s].
    """
    begin_s = time.monotonic()
    for seed in seeds:
        for setting in SETTINGS[name.partition("-")[0]]:
            file = folder / name / f"{str(setting).replace('/', '_')}.{seed}.npz"
            if file.is_file() or not setting.preset.startswith(preset):
                continue
            if time.monotonic() - begin_s > limit_s:
                return
            env = environment(name, setting)
            start_s = time.process_time()
            env.reset(seed=seed, options={"jitter": True})
            env.episode.play()
            cpu_s = time.process_time() - start_s
            frames = env.trajectory().frames[: env.experiment.frame_count]
            file.parent.mkdir(parents=True, exist_ok=True)
            np.savez_compressed(file, frames=frames.astype(np.float32), cpu_s=cpu_s)
            print(f"{name}, {setting}, start {seed}: {cpu_s:.1f} CPU s", flush=True)


def table(folder: Path) -> Iterator[StartsError]:
    """Yield the rows of all experiments of a folder, of the starts that all settings of a preset have."""
    for place in sorted(folder.iterdir()):
        name = place.name
        known = SETTINGS[name.partition("-")[0]]
        for preset in dict.fromkeys(setting.preset for setting in known):
            finest, *others = [one for one in known if one.preset == preset]
            for setting in others:
                yield from _row(place, finest, setting)


def _row(place: Path, finest: Setting, setting: Setting) -> Iterator[StartsError]:
    fine, coarse = _episodes(place, finest), _episodes(place, setting)
    seeds = sorted(fine.keys() & coarse.keys())
    if len(seeds) < 4:
        return
    fines = np.stack([fine[seed][0] for seed in seeds])
    coarses = np.stack([coarse[seed][0] for seed in seeds])
    variance = squared_scatter(fines)
    change, change_error = mean_change(coarses - fines)
    spread, spread_error = log_spread(coarses, fines)
    yield StartsError(
        id=place.name,
        setting=str(setting),
        finest=str(finest),
        starts=len(seeds),
        scatter=math.sqrt(variance),
        unit=GaugeEnv(place.name).experiment.score.observable.unit,
        change=change / variance,
        change_error=change_error / variance,
        halves=halves_change(fines),
        log_spread=spread,
        log_spread_error=spread_error,
        moved=math.sqrt(float(((coarses - fines) ** 2).sum()) / len(seeds) / variance),
        cpu_s=float(np.mean([coarse[seed][1] for seed in seeds])),
        finest_cpu_s=float(np.mean([fine[seed][1] for seed in seeds])),
    )


def _episodes(
    place: Path, setting: Setting
) -> dict[int, tuple[NDArray[np.float64], float]]:
    """Return motion and CPU time [s] by seed; the square of a motion's length is the mean over its frames."""
    found = {}
    for file in place.glob(f"{str(setting).replace('/', '_')}.*.npz"):
        with np.load(file) as content:
            frames = content["frames"].astype(np.float64)
            motion = frames.ravel() / math.sqrt(len(frames))
            found[int(file.name.split(".")[-2])] = (motion, float(content["cpu_s"]))
    return found


def main(command: str, folder: str, *arguments: str) -> None:
    """Run episodes, or print the table."""
    if command == "run":
        name, seeds, preset, limit_s = [*arguments, *("", "inf")[len(arguments) - 2 :]]
        first, last = map(int, seeds.split("-"))
        run(Path(folder), name, range(first, last + 1), preset, float(limit_s))
        return
    writer = csv.DictWriter(sys.stdout, [field.name for field in fields(StartsError)])
    writer.writeheader()
    for row in table(Path(folder)):
        numbers = {
            key: f"{value:.4g}" if isinstance(value, float) else value
            for key, value in asdict(row).items()
        }
        writer.writerow(numbers)


if __name__ == "__main__":
    main(*sys.argv[1:])
