"""Write the page of units and bounds of observations, and measure the largest value of each in an episode.

Episodes have zero actions. With deformable bodies on MuJoCo they end after a second, where cloth and foam are slow.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces

from gauge_envs import GaugeEnv
from gauge_envs.backends.base import scene_support
from gauge_envs.backends.registry import backend_title, uninstalled_backend
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.experiments.variants import variants
from gauge_envs.pages.text import quantity_text
from gauge_envs.scene.timing import FRAME_RATE_HZ
from gauge_envs.tools.catalog.spaces import observation_rows
from scripts.generated import (
    ROOT,
    SCORING,
    Request,
    append_rows,
    markdown_table,
    page_part,
    read_rows,
)

SCRIPT = f"scripts/{Path(__file__).name}"
PAGE = ROOT / "docs" / "spaces.md"
SEEN = ROOT / "docs" / "spaces.csv"
COLUMNS = ("engine", "variant", "end_s", "entry", "unit", "largest")
ENGINES = ("mujoco", "pybullet", "rapier")
DEFORMABLE_S = 1.0
"""Time of an episode with deformable bodies [s]."""

PLACES = {
    "place [m]": ("bodies[:, 0:3]", "markers"),
    "speed [m/s]": ("bodies[:, 7:10]",),
    "turning [rad/s]": ("bodies[:, 10:13]",),
    "driver's place [m]": ("driver[:, 0:3]",),
    "its speed [m/s]": ("driver[:, 7:10]",),
    "its turning [rad/s]": ("driver[:, 10:13]",),
}
"""Columns of the table: the rows of `gauge show` that they hold."""


def value_of(observation: Mapping[str, Any], name: str) -> Any:
    """Return the part of an observation that a row of `gauge show` names, as `bodies[:, 0:3]`."""
    entry, _, columns = name.partition("[:, ")
    if not columns:
        return observation[entry]
    first, last = columns.rstrip("]").split(":")
    return observation[entry][:, int(first) : int(last)]


def seen_in(name: str, engine: str) -> Iterator[dict[str, Any]]:
    """Run an episode with zero actions and yield a row for each part of the observation.

    Raises:
        ValueError: The episode diverges or an observation lies outside its space.
    """
    env, experiment = GaugeEnv(name, backend=engine), load_experiment(name)
    rows = observation_rows(experiment)
    largest = dict.fromkeys((row["name"] for row in rows), 0.0)
    last = experiment.frame_count - 1
    if experiment.scene.deformables:
        last = min(last, round(DEFORMABLE_S * FRAME_RATE_HZ))
    observation, info = env.reset(seed=0)
    space = env.action_space
    still = 0 if isinstance(space, spaces.Discrete) else np.zeros_like(space.sample())
    for frame in range(last + 1):
        if frame:
            observation, *_, info = env.step(still)
        if "diverged" in info:
            raise ValueError(f"{name} on {engine}: {info['diverged']}")
        if not env.observation_space.contains(observation):
            raise ValueError(f"{name} on {engine}: frame {frame} is outside the space")
        for part, known in largest.items():
            values = np.abs(value_of(observation, part))
            largest[part] = max(known, float(values.max(initial=0.0)))
    env.close()
    for row in rows:
        yield {
            "engine": engine,
            "variant": name,
            "end_s": f"{last / FRAME_RATE_HZ:.3f}",
            "entry": row["name"],
            "unit": row["unit"],
            "largest": f"{largest[row['name']]:.4g}",
        }


def measure(request: Request) -> None:
    """Measure the variants that the table lacks; a stopped run goes on."""
    done = {(row["engine"], row["variant"]) for row in read_rows(SEEN)}
    for engine in request.engines or ENGINES:
        for variant in variants():
            if not request.wants(variant.name) or (engine, variant.name) in done:
                continue
            experiment = load_experiment(variant)
            if scene_support(uninstalled_backend(engine), experiment.scene).missing:
                continue
            append_rows(SEEN, COLUMNS, list(seen_in(variant.name, engine)))


def contents(scoring: Path = SCORING) -> dict[Path, str]:
    """Return the page with its text."""
    return page_part(PAGE, "table", SCRIPT, "\n".join(table(read_rows(SEEN))))


def table(rows: Sequence[Mapping[str, str]]) -> Iterator[str]:
    """Yield the lines of the table: the largest value seen, and the bound, of each part of the observation."""
    found = {
        (row["variant"], row["entry"]): row for row in rows if row["engine"] == "mujoco"
    }
    lines = []
    for variant in variants():
        name = variant.name
        bounds = {row["name"]: row for row in observation_rows(load_experiment(name))}
        end = found.get((name, "time"))
        g = bounds["observable"]
        cells = [f"`{name}`", end["end_s"] if end else "-"]
        cells.append(f"{_cell(g, found.get((name, 'observable')))} {g['unit']}")
        for parts in PLACES.values():
            present = [part for part in parts if part in bounds]
            cells += [_cell(bounds[part], found.get((name, part))) for part in present]
            cells += [] if present else [""]
        lines.append(cells)
    yield from markdown_table(("id", "until [s]", "g(t)", *PLACES), lines)
    yield ""
    counts = {
        engine: len({row["variant"] for row in rows if row["engine"] == engine})
        for engine in ENGINES
    }
    texts = [f"{count} ids on {backend_title(name)}" for name, count in counts.items()]
    yield f"No value left its bounds: {', '.join(texts)}."


def _cell(bound: Mapping[str, Any], measured: Mapping[str, str] | None) -> str:
    largest = max(abs(bound["low"]), abs(bound["high"]))
    seen_text = quantity_text(float(measured["largest"])) if measured else "-"
    return f"{seen_text} / {quantity_text(largest)}"
