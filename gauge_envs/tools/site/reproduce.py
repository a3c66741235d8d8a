"""How to reproduce a number: the command that makes its result, with engine, settings, start, seed and versions."""

from __future__ import annotations

import hashlib
import json
import math
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from gauge_envs.experiments.experiment import AssetKind
from gauge_envs.observables.observer import MarkerProxy
from gauge_envs.pages.html import Html, code, element, join, page, table
from gauge_envs.pages.text import short_id
from gauge_envs.references.imported import DataSource
from gauge_envs.runs.result import Result
from gauge_envs.tools.site.model import Site


def run_command(results: Sequence[Result]) -> str | None:
    """Return the `gauge run` command that makes the repeats of one configuration in one experiment.

    Args:
        results: Repeats, which differ in their seed alone.

    Returns:
        The command; None for a trajectory file of a user, which no engine made.
    """
    first = results[0]
    if first.backend is None:
        return None
    kind = first.asset.get("kind")
    subject = first.asset["file"] if kind == AssetKind.EXPERIMENT else short_id(first.id)
    words = ["gauge", "run", subject, "--backend", first.backend]
    if isinstance(first.parameters, str):
        words += [] if first.parameters == "calibrated" else ["--parameters", first.parameters]
    else:
        words += ["--parameters", ",".join(_assignments(first.parameters))]
    for assignment in _assignments(first.settings_given):
        words += ["--set", assignment]
    if first.marker_proxy != MarkerProxy.MATERIAL:
        words.append(f"marker_proxy={first.marker_proxy}")
    used = [f"imported-{key}" for key in ("drivers", "reference") if first.dataset.get(key) == DataSource.IMPORTED]
    if first.score.withheld is not None:
        used.append("withheld")
    if used:
        words += ["--use", ",".join(used)]
    if first.asset and kind != AssetKind.EXPERIMENT:
        words += ["--asset", first.asset["file"]]
    return shlex.join([*words, *_start_words(results)])


def _assignments(values: Mapping[str, Any]) -> list[str]:
    return [
        f"{name}={value if isinstance(value, str) else json.dumps(value, separators=(',', ':'))}"
        for name, value in values.items()
    ]


def _start_words(results: Sequence[Result]) -> list[str]:
    """Return the words for seed, repeats and jitter."""
    seeds = sorted(result.seed or 0 for result in results)
    words = [f"seed={seeds[0]}"] if seeds[0] else []
    # Repeats have consecutive seeds; the range holds also those that are missing here.
    count = seeds[-1] - seeds[0] + 1
    words += [f"repeats={count}"] if count > 1 else []
    jitter = results[0].jitter
    if "position_m" in jitter:
        words.append(f"jitter={_exact(jitter['position_m'], 1e-3)}mm,{_exact_deg(jitter['angle_rad'])}deg")
    return words


def _exact(value: float, factor: float) -> str:
    """Return the shortest number of which the command makes exactly this value."""
    return next(
        (f"{value / factor:.{n}g}" for n in range(1, 18) if factor * float(f"{value / factor:.{n}g}") == value),
        repr(value / factor),
    )


def _exact_deg(value: float) -> str:
    degrees = math.degrees(value)
    texts = (f"{degrees:.{digits}g}" for digits in range(1, 18))
    return next((text for text in texts if math.radians(float(text)) == value), repr(degrees))


def run_commands(site: Site, cells: Sequence[tuple[int, Sequence[Result]]]) -> Html:
    """Return the commands of configurations in one experiment, each with its versions.

    Args:
        site: The site.
        cells: Index of the configuration and its results, one or more.
    """
    parts = []
    for index, results in cells:
        command = run_command(results)
        text = "scored from a trajectory file: gauge score FILE" if command is None else command
        versions = ", ".join(f"{name} {version}" for name, version in results[0].versions.items())
        parts.append(element("div", element("p", site.swatch(index), site.labels[index]), element("pre", code(text))))
        parts.append(element("p", f"Versions: {versions}.", class_="small"))
        settings = element("pre", element("code", "\n".join(_assignments(results[0].settings)) or "none stated"))
        parts.append(element("details", element("summary", "settings in force"), settings))
    return join(parts)


def _hash(digest: str) -> Html:
    """Return the start of a hash, as a line of its own."""
    return element("span", digest[:16], class_="hash")


def _digest(file: Path) -> str:
    """Return the start of the hash of a file; a dash if it is gone."""
    try:
        return hashlib.sha256(file.read_bytes()).hexdigest()[:16]
    except OSError:
        return "-"


def reproduce_page(site: Site, command: str) -> str:
    """Return the page with the origin of every number.

    Args:
        site: The site.
        command: Command that made the site.
    """
    rows: list[list[str | Html]] = []
    for one in site.comparison.experiments:
        for index, cell in enumerate(one.cells):
            if cell is None:
                continue
            for result in cell.results:
                file = site.files.get(id(result))
                line = run_command([result])
                rows.append(
                    [
                        join([site.experiment_link(one), _hash(result.task_sha256)]),
                        site.configuration_link(index),
                        code(line or "trajectory file"),
                        "-" if file is None else join([file.name, _hash(_digest(file))]),
                        result.created.partition(".")[0].replace("T", " ").removesuffix("+00:00"),
                    ]
                )
    titles = ("experiment", "configuration", "command", "result file", "created, UTC")
    steps: tuple[tuple[Html | str, ...], ...] = (
        (code("pip install 'gauge-envs[newton,physx,rapier,drake]'"), " with the versions that each page states."),
        (
            "Run the command of a row. The file it writes into results/ has the same numbers, bit for bit, with the "
            "same versions on the same kind of processor. Wall times differ.",
        ),
        (code("gauge compare results/"), " prints the scores, intervals, ranks and pairs of these pages."),
        (code("gauge diagnose results/"), " prints the error budgets."),
    )
    parts = [
        element("p", "Every number on these pages comes from a result file, and each file from one command."),
        element("ol", *(element("li", *step) for step in steps)),
        element("h2", "This site"),
        element("pre", code(command)),
        element("h2", "Results"),
        element(
            "p", "Below an experiment: SHA-256 of its task file. Below a result file: that of the file.", class_="small"
        ),
        table(titles, rows),
        element("h2", "Software on these pages"),
        element(
            "p",
            "The 3D replays are drawn by three.js, MIT licence: ",
            element("a", "licence", href="assets/three.LICENSE.txt"),
            ". Real data: GAUGE, arXiv 2608.05948.",
        ),
    ]
    return page("How to reproduce each number", parts, here="reproduce.html")
