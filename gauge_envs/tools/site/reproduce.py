"""How to reproduce a number: the command that makes its result, with engine, settings, start, seed and versions."""

import hashlib
import json
import math
import shlex
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from gauge_envs.backends import is_bundled
from gauge_envs.observables.observer import MarkerProxy
from gauge_envs.pages.document import Heading, Paragraph, Part, Tone
from gauge_envs.pages.html import below, element, folded, join
from gauge_envs.pages.table import grid
from gauge_envs.pages.text import short_id
from gauge_envs.references.user_data import DataSource
from gauge_envs.runs.result import Result
from gauge_envs.tools.compare import ExperimentComparison
from gauge_envs.tools.site.model import Site, site_page


def run_command(results: Sequence[Result]) -> str | None:
    """Return the `gauge run` command that makes the repeats of one configuration in one experiment.

    Returns:
        The command; None for a trajectory file of a user, which no engine made.
    """
    first = results[0]
    if first.backend is None:
        return None
    words = ["gauge", "run", short_id(first.id), "--backend", first.backend]
    if isinstance(first.parameters, str):
        words += (
            []
            if first.parameters == "calibrated"
            else ["--parameter", first.parameters]
        )
    else:
        words += ["--parameter", ",".join(_assignments(first.parameters))]
    for assignment in _assignments(first.settings_given):
        words += ["--set", assignment]
    if first.marker_proxy != MarkerProxy.MATERIAL:
        words += ["--marker-proxy", str(first.marker_proxy)]
    used = [
        f"imported-{key}"
        for key in ("drivers", "reference")
        if first.dataset.get(key) == DataSource.IMPORTED
    ]
    if used:
        words += ["--use", ",".join(used)]
    if first.asset:
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
    words = ["--seed", str(seeds[0])] if seeds[0] else []
    # Repeats have consecutive seeds; the range holds also those that are missing here.
    count = seeds[-1] - seeds[0] + 1
    words += ["--repeats", str(count)] if count > 1 else []
    jitter = results[0].jitter
    if "position_m" in jitter:
        position_m, angle_rad = jitter["position_m"], jitter["angle_rad"]
        millimetres = _exact(position_m, position_m / 1e-3, lambda mm: 1e-3 * mm)
        degrees = _exact(angle_rad, math.degrees(angle_rad), math.radians)
        words += ["--jitter", f"{millimetres}mm,{degrees}deg"]
    return words


def _exact(value: float, scaled: float, restored: Callable[[float], float]) -> str:
    """Return the shortest number of which the command makes exactly this value."""
    texts = (f"{scaled:.{digits}g}" for digits in range(1, 18))
    return next(
        (text for text in texts if restored(float(text)) == value), repr(scaled)
    )


def run_commands(site: Site, one: ExperimentComparison) -> list[Part]:
    """Return the commands of all configurations in one experiment, each with its versions."""
    parts: list[Part] = []
    for index, cell in enumerate(one.cells):
        if cell is None:
            continue
        first = cell.results[0]
        command = (
            run_command(cell.results)
            or "scored from a trajectory file: gauge score FILE"
        )
        versions = ", ".join(
            f"{name} {version}" for name, version in first.versions.items()
        )
        settings = "\n".join(_assignments(first.settings)) or "none stated"
        parts += [
            element(
                "div",
                element("p", site.swatch(index), site.labels[index]),
                element("pre", element("code", command)),
            ),
            Paragraph(f"Versions: {versions}.", Tone.NOTE),
            folded("settings in force", element("pre", element("code", settings))),
        ]
    return parts


def _digest(file: Path) -> str:
    """Return the hash of a file; a dash if it is gone."""
    try:
        return hashlib.sha256(file.read_bytes()).hexdigest()
    except OSError:
        return "-"


def reproduce_page(site: Site, command: str) -> str:
    """Return the page with the origin of every number."""
    rows = []
    for one in site.comparison.experiments:
        for index, cell in enumerate(one.cells):
            for result in cell.results if cell else ():
                file = site.files.get(id(result))
                rows.append(
                    (
                        site.experiment_link(one, result.task_sha256[:16]),
                        site.links[index],
                        element("code", run_command([result]) or "trajectory file"),
                        "-"
                        if file is None
                        else join([file.name, below(_digest(file)[:16])]),
                        result.created.partition(".")[0]
                        .replace("T", " ")
                        .removesuffix("+00:00"),
                    )
                )
    extras = ",".join(
        name for name in site.engines if is_bundled(name) and name != "mujoco"
    )
    install = (
        f"pip install 'gauge-envs[{extras}]'" if extras else "pip install gauge-envs"
    )
    steps = (
        join([element("code", install), " with the versions that each page states."]),
        "Run the command of a row. The file it writes into results/ has the same numbers, bit for bit, with the "
        "same versions on the same kind of processor. Wall times differ.",
        join(
            [
                element("code", "gauge compare results/"),
                " prints the scores, intervals and ranks of these pages.",
            ]
        ),
    )
    parts: list[Part] = [
        Paragraph(
            "Every number on these pages comes from a result file, and each file from one command."
        ),
        element("ol", *(element("li", step) for step in steps)),
        Heading("This site"),
        element("pre", element("code", command)),
        Heading("Results"),
        Paragraph(
            "Below an experiment: SHA-256 of its task file. Below a result file: that of the file.",
            Tone.NOTE,
        ),
        grid(
            ("experiment", "configuration", "command", "result file", "created, UTC"),
            rows,
        ),
        Heading("Software on these pages"),
        element(
            "p",
            "The 3D replays are drawn by three.js, MIT licence: ",
            element("a", "licence", href="assets/three.LICENSE.txt"),
            ". Real data: GAUGE, arXiv 2608.05948.",
        ),
    ]
    return site_page("How to reproduce each number", parts, here="reproduce.html")
