"""Environment steps a second of the slope slider by the number of worlds, on engines side by side in one run.

    python benchmarks/worlds.py --worlds 1 16 256 1024 --engines newton mujoco
    python benchmarks/worlds.py --engine-stub --worlds 256 4096 16384
    python benchmarks/worlds.py --device cuda:0 --on-device --engines newton --worlds 1024 4096 16384

An episode is stepped to its end and scored in one pass over all worlds (`score_arrays=True`, or `mode="device"` with
`--on-device`). Times are for one environment step, which is one frame of one world:

- `engine`: in the engine, up to the last frame; on a device, in starting its work;
- `host`: reading, judging, rewards, observations and infos; on a device all but the engine;
- `run on`: in the engine after the last frame, for the release alignment; on a device it is part of `host`;
- `scoring`: the scores of all worlds; on a device they are part of `host`;
- `copies`: copies between host and GPU in a frame of all worlds, counted by Warp; `-` on a CPU.

`--engine-stub` replaces the engine by stored states that cost nothing, on the host and on a device that NumPy
pretends, so that the rest is left. `--cpu-time` counts processor time, for a CPU that other programs share; it is no
measure of a GPU. The ratio is that of the steps a second to those of the first row with as many worlds.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import product
from typing import Any

import gymnasium
import numpy as np
from gauge_envs.backends.device import HostArrays

import gauge_envs  # noqa: F401  registers the ids
from gauge_envs.backends import ArrayWorlds, DeviceWorlds, Simulation, Worlds
from gauge_envs.backends.mujoco import BackendMuJoCo
from gauge_envs.scene import Scene

NAME = "SlopeSlider-2-wood"

clock = time.perf_counter


@dataclass
class Row:
    """Times of one engine with a number of worlds, medians over the repeats, for one environment step [us]."""

    engine: str
    worlds: int
    make_s: float
    engine_us: float
    host_us: float
    run_on_us: float
    scoring_us: float
    steps_per_s: float
    copies: float | None


def measured(
    engine: str,
    worlds: int,
    settings: dict[str, Any],
    repeats: int,
    name: str = NAME,
    *,
    on_device: bool = False,
) -> Row:
    """Return the times of an engine."""
    start = clock()
    envs = gymnasium.make_vec(
        f"GAUGE/{name}",
        num_envs=worlds,
        backend=engine,
        settings=settings,
        **({"mode": "device"} if on_device else {"score_arrays": True}),
    )
    make_s = clock() - start
    frames = envs.unwrapped.experiment.frame_count - 1
    measure = _stepped_on_device if on_device else _stepped
    # The first episode loads kernels.
    parts = [measure(envs) for _ in range(repeats + on_device)][int(on_device) :]
    copies = None
    if str(settings.get("device")).startswith("cuda"):
        copies = _copies(envs, frames)
    envs.close()
    medians = (
        1e6 * statistics.median(part) / (frames * worlds)
        for part in zip(*parts, strict=True)
    )
    engine_us, host_us, run_on_us, scoring_us = medians
    return Row(
        engine=engine,
        worlds=worlds,
        make_s=round(make_s, 2),
        engine_us=engine_us,
        host_us=host_us,
        run_on_us=run_on_us,
        scoring_us=scoring_us,
        steps_per_s=1e6 / (engine_us + host_us + run_on_us + scoring_us),
        copies=copies,
    )


def _copies(envs: Any, frames: int) -> float:
    """Return the copies between host and GPU in a frame."""
    import warp as wp

    envs.reset(seed=0)
    actions = np.zeros(envs.action_space.shape, dtype=envs.action_space.dtype)
    wp.timing_begin(cuda_filter=wp.TIMING_MEMCPY)
    for _ in range(frames):
        envs.unwrapped.step(actions)
    return sum("DtoD" not in one.name for one in wp.timing_end()) / frames


def _stepped(envs: Any) -> tuple[float, float, float, float]:
    """Return the seconds of an episode in the engine, on the host, running on and scoring."""
    envs.reset(seed=0)
    inner = envs.unwrapped
    actions = np.zeros(envs.action_space.shape, dtype=envs.action_space.dtype)
    spent = _timed_engine(inner)
    stepping_s, over = 0.0, False
    while not over:
        start = clock()
        # The wrapper scores in the last step; stepping below it keeps the two apart.
        *_, terminations, truncations, _ = inner.step(actions)
        stepping_s += clock() - start
        over = bool((terminations | truncations).all())
    engine_s = spent[0]
    start = clock()
    inner.score_arrays()
    run_on_s = spent[0] - engine_s
    return engine_s, stepping_s - engine_s, run_on_s, clock() - start - run_on_s


def _stepped_on_device(envs: Any) -> tuple[float, float, float, float]:
    """Return the seconds of an episode in starting the engine's work, and in all else, up to its scores."""
    envs.reset(seed=0)
    inner = envs.unwrapped
    device = inner.worlds_on_device
    spent, depth = [0.0], [0]
    device.advance = _counted(type(device).advance.__get__(device), spent, depth)
    actions = np.zeros(envs.action_space.shape, dtype=envs.action_space.dtype)
    start = clock()
    infos: dict[str, Any] = {}
    while "rmse" not in infos:
        *_, infos = inner.step(actions)
    # The only copy waits for the device.
    device.copied(infos["rmse"])
    return spent[0], clock() - start - spent[0], 0.0, 0.0


class StillWorlds(ArrayWorlds):
    """Worlds whose states and nodes were stored before; reading them costs nothing."""

    def __init__(self, simulation: Simulation, scene: Scene, count: int) -> None:
        super().__init__(simulation.settings, count)
        self._states = {
            names: np.repeat(simulation.body_states(names)[None], count, axis=0)
            for names in (
                tuple(body.name for body in scene.dynamic_bodies),
                tuple(driver.body for driver in scene.drivers),
                tuple(body.name for body in scene.dynamic_bodies)
                + tuple(driver.body for driver in scene.drivers),
            )
        }
        self._nodes = {
            body.name: np.repeat(simulation.nodes(body.name)[None], count, axis=0)
            for body in scene.deformables
        }

    def reset(self, seed: int) -> None:
        """Do nothing."""

    def advance(self, seconds: float) -> None:
        """Do nothing."""

    def drive(self, body: str, motions: np.ndarray, numbers: np.ndarray) -> None:
        """Do nothing."""

    def body_states(self, names: Sequence[str]) -> np.ndarray:
        """Return the stored states."""
        return self._states[tuple(names)]

    def body_positions(self, names: Sequence[str]) -> np.ndarray:
        """Return the stored positions."""
        return self.body_states(names)[:, :, :3]

    def nodes(self, name: str) -> np.ndarray:
        """Return the stored nodes."""
        return self._nodes[name]

    def on_device(self) -> DeviceWorlds:
        """Return the worlds on a pretended device."""
        return StillDevice(self)

    def close(self) -> None:
        """Do nothing."""


class StillDevice(HostArrays, DeviceWorlds):
    """The same worlds in NumPy, as a device."""

    def __init__(self, worlds: StillWorlds) -> None:
        self.body_states = worlds.body_states  # type: ignore[method-assign]

    def begin(self, states: Any | None) -> None:
        """Do nothing."""

    def drive(self, body: str, motions: Any) -> None:
        """Do nothing."""

    def advance(self, seconds: float) -> None:
        """Do nothing."""

    def body_states(self, names: Sequence[str]) -> Any:
        """Return the stored states."""


def stub_engine() -> None:
    """Replace the worlds of MuJoCo by stored states."""

    def build_worlds(
        self: BackendMuJoCo, scenes: Sequence[Scene], settings: Any = None
    ) -> Worlds:
        return StillWorlds(self.build(scenes[0], settings), scenes[0], len(scenes))

    BackendMuJoCo.build_worlds = build_worlds  # type: ignore[method-assign]


def _timed_engine(envs: Any) -> list[float]:
    """Count the time that the worlds of an environment advance in; returns the seconds in a list of one entry."""
    spent, depth = [0.0], [0]
    separate = envs.worlds.are_separate
    for one in envs.worlds.worlds if separate else [envs.worlds]:
        for call in ("advance", "sample_positions"):
            if hasattr(one, call):
                setattr(
                    one,
                    call,
                    _counted(getattr(type(one), call).__get__(one), spent, depth),
                )
    return spent


def _counted(call: Any, spent: list[float], depth: list[int]) -> Any:
    def timed(*arguments: Any) -> Any:
        depth[0] += 1
        start = clock()
        try:
            return call(*arguments)
        finally:
            depth[0] -= 1
            # A method may call the other one, whose time counts once.
            spent[0] += clock() - start if depth[0] == 0 else 0.0

    return timed


def _line(label: str, texts: Sequence[str]) -> str:
    return f"{label:14}{texts[0]:>19}" + "".join(f"{text:>9}" for text in texts[1:])


def main() -> None:
    """Print a row for each engine and number of worlds."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--names", nargs="+", default=[NAME], help="ids without GAUGE/")
    parser.add_argument("--worlds", type=int, nargs="+", default=[1, 16, 256])
    parser.add_argument("--engines", nargs="+", default=["newton", "mujoco"])
    parser.add_argument("--device", default="cpu", help="Warp device of Newton")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument(
        "--set",
        dest="changes",
        nargs="*",
        default=[],
        help="NAME=VALUE, for all engines",
    )
    parser.add_argument(
        "--on-device",
        action="store_true",
        help="keep all arrays on the engine's device",
    )
    parser.add_argument(
        "--engine-stub", action="store_true", help="replace the engine by stored states"
    )
    parser.add_argument(
        "--cpu-time",
        action="store_true",
        help="count processor time in place of wall time",
    )
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    if options.cpu_time:
        global clock
        clock = time.process_time
    changes = {
        key: json.loads(value)
        for key, value in (text.split("=") for text in options.changes)
    }
    ways = [(engine, options.on_device) for engine in options.engines]
    if options.engine_stub:
        stub_engine()
        ways = [("mujoco", False), ("mujoco", True)]
    if not options.json:
        print(f"Times for one environment step [us]; Newton on {options.device}")
        titles = (
            "id",
            "worlds",
            "engine",
            "host",
            "run on",
            "scoring",
            "steps/s",
            "ratio",
            "copies",
        )
        print(
            f"{'':14}"
            + "".join(
                f"{title:>18}" if number == 0 else f"{title:>9}"
                for number, title in enumerate(titles)
            )
        )
    for name, worlds in product(options.names, options.worlds):
        first = 0.0
        for engine, on_device in ways:
            settings = {
                **changes,
                **({"device": options.device} if engine == "newton" else {}),
            }
            row = measured(
                engine, worlds, settings, options.repeats, name, on_device=on_device
            )
            first = first or row.steps_per_s
            if options.json:
                print(
                    json.dumps(
                        {
                            **asdict(row),
                            "on_device": on_device,
                            "stub": options.engine_stub,
                        }
                    ),
                    flush=True,
                )
                continue
            label = f"{'stub' if options.engine_stub else engine} {'device' if on_device else 'host'}"
            times = (row.engine_us, row.host_us, row.run_on_us, row.scoring_us)
            texts = [
                name,
                str(worlds),
                *(f"{part:.2f}" for part in times),
                f"{row.steps_per_s:.0f}",
            ]
            texts.append(f"{row.steps_per_s / first:.2f}")
            texts.append("-" if row.copies is None else f"{row.copies:.1f}")
            print(
                f"{label:14}"
                + "".join(
                    f"{text:>18}" if number == 0 else f"{text:>9}"
                    for number, text in enumerate(texts)
                ),
                flush=True,
            )


if __name__ == "__main__":
    main()
