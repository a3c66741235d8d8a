"""Run this suite's own submissions of `leaderboard/`, by default preset and out of the box, and write its page."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

from gauge_envs.backends.registry import uninstalled_backend
from gauge_envs.pages.document import as_markdown
from gauge_envs.tools.leaderboard import check_leaderboard
from gauge_envs.tools.leaderboard.submission import STATEMENT_FILE
from gauge_envs.tools.leaderboard.words import leaderboard_document
from scripts import board_hashes
from scripts.generated import ROOT, Request

BOARD = ROOT / "leaderboard"
PACKAGES = {
    "mujoco": "mujoco",
    "newton": "newton",
    "physx": "sapien",
    "pybullet": "pybullet",
    "rapier": "rapier3d",
    "drake": "drake",
    "genesis": "genesis-world",
}
"""Package of each engine whose version names its folder."""

OUT_OF_BOX = "out_of_box"


def configurations(engine: str) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield the configurations of an engine with their settings."""
    yield "default", {}
    declared = uninstalled_backend(engine).configurations
    yield OUT_OF_BOX, declared.get(OUT_OF_BOX, {"preset": OUT_OF_BOX})


def statement(engine: str, configuration: str, settings: Mapping[str, Any]) -> str:
    """Return the text of a `submission.toml`."""
    package = PACKAGES[engine]
    values = {
        "engine": engine,
        "package": package,
        "version": version(package),
        "configuration": configuration,
        "submitter": "gauge-envs",
        "standing": "shown" if configuration == OUT_OF_BOX else "ranked",
    }
    lines = [
        "format = 1",
        *(f"{key} = {json.dumps(text)}" for key, text in values.items()),
        "",
        "[settings]",
        *(f"{key} = {json.dumps(value)}" for key, value in settings.items()),
    ]
    return "\n".join(lines) + "\n"


def submit(folder: Path, text: str) -> None:
    """Write a submission, and run the experiments of the leaderboard."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / STATEMENT_FILE).write_text(text, encoding="utf-8")
    (one,) = check_leaderboard(folder, run=True)
    print(f"{folder}: {len(one.results)} results", file=sys.stderr)
    for fault in one.faults:
        print(fault, file=sys.stderr)


def measure(request: Request) -> None:
    """Write and run the submissions of engines, and write the page of all."""
    for engine in request.engines or PACKAGES:
        for configuration, settings in configurations(engine):
            folder = BOARD / engine / version(PACKAGES[engine]) / configuration
            submit(folder, statement(engine, configuration, settings))
    board_hashes.write()
    page = as_markdown(leaderboard_document(check_leaderboard(BOARD)))
    (BOARD / "leaderboard.md").write_text(page, encoding="utf-8")
