"""Run this suite's own submissions of `leaderboard/`: each engine by its default preset and out of the box.

A result that exists is kept if it is of the same episode and versions. Afterwards `gauge leaderboard check leaderboard`
checks everything, and `gauge leaderboard table leaderboard --out leaderboard` writes the page.
"""

from __future__ import annotations

import json
import shutil
import sys
import tarfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import Any

from gauge_envs.backends.registry import uninstalled_backend
from gauge_envs.runs.batch import run_many
from gauge_envs.runs.request import RunRequest
from gauge_envs.tools.leaderboard.archive import ARCHIVE
from gauge_envs.tools.leaderboard.submission import (
    RESULTS_FOLDER,
    STATEMENT_FILE,
    board_experiments,
    installed_package,
)
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


def statement(
    engine: str,
    configuration: str,
    settings: Mapping[str, Any],
    left_out: Sequence[str],
) -> str:
    """Return the text of a `submission.toml`."""
    package = PACKAGES[engine]
    values = {
        "engine": engine,
        "package": package,
        "version": version(package),
        "package_sha256": installed_package(package)[0],
        "configuration": configuration,
        "submitter": "gauge-envs",
    }
    lines = [
        "format = 1",
        *(f"{key} = {json.dumps(text)}" for key, text in values.items()),
        "",
        "[settings]",
    ]
    lines += [f"{key} = {json.dumps(value)}" for key, value in settings.items()]
    lines += ["", "[left_out]", *(f'"{name}" = "not supported"' for name in left_out)]
    return "\n".join(lines) + "\n"


@contextmanager
def unpacked(folder: Path) -> Iterator[Path]:
    """Yield the folder with the result files of a submission, which become its archive again."""
    archive, results = folder / ARCHIVE, folder / RESULTS_FOLDER
    if archive.exists():
        with tarfile.open(archive) as stream:
            stream.extractall(folder, filter="data")
    yield results
    with tarfile.open(archive, "w:xz", preset=9) as stream:
        for file in sorted(results.glob("*.json")):
            stream.add(file, f"{RESULTS_FOLDER}/{file.name}", filter=without_owner)
    shutil.rmtree(results)


def without_owner(member: tarfile.TarInfo) -> tarfile.TarInfo:
    """Return a file of an archive without what depends on the machine."""
    return member.replace(
        mtime=0, mode=0o644, uid=0, gid=0, uname="", gname="", deep=False
    )


def submit(
    engine: str, folder: Path, configuration: str, settings: Mapping[str, Any]
) -> None:
    """Run the experiments of the leaderboard in one configuration, and write the submission."""
    requests = [
        RunRequest(name, backend=engine, settings=dict(settings) or None)
        for name in board_experiments(folder.parents[2])
    ]
    declined = []
    with unpacked(folder) as results:
        for result in run_many(requests, out=results, resume=True):
            if result.error is not None:
                print(f"{result.id} on {engine}: {result.error}", file=sys.stderr)
                declined.append(result.id.removeprefix("GAUGE/"))
    (folder / STATEMENT_FILE).write_text(
        statement(engine, configuration, settings, declined), encoding="utf-8"
    )
    print(
        f"{folder}: {len(requests) - len(declined)} of {len(requests)}", file=sys.stderr
    )


def measure(request: Request) -> None:
    """Run what has no result of the installed versions, and write the submissions."""
    for engine in request.engines or PACKAGES:
        for configuration, settings in configurations(engine):
            folder = BOARD / engine / version(PACKAGES[engine]) / configuration
            submit(engine, folder, configuration, settings)
