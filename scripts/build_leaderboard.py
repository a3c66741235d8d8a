"""Run this suite's own submissions of `leaderboard/`: each engine by its default preset and out of the box.

    python scripts/build_leaderboard.py                   runs what has no result of the installed versions, states it
    python scripts/build_leaderboard.py --engine genesis  one engine, in an environment that has it
    python scripts/build_leaderboard.py --diagnoses       runs nothing; writes what results imply anew, after an
                                                          estimator changed

A result that exists is kept if it is of the same episode and versions. Afterwards `gauge leaderboard check leaderboard`
checks everything, and `gauge leaderboard table leaderboard --out leaderboard` writes the page.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import tarfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

from generated import ROOT

from gauge_envs.backends.registry import uninstalled_backend
from gauge_envs.runs.batch import run_many
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result_file import load_result, recorded_experiment, write_result
from gauge_envs.tools.leaderboard.archive import ARCHIVE
from gauge_envs.tools.leaderboard.submission import (
    RESULTS_FOLDER,
    STATEMENT_FILE,
    board_experiments,
    installed_package,
)
from gauge_envs.tools.leaderboard.trajectory import rescored

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


def renew_diagnoses(board: Path) -> None:
    """Write the implied constants of all results anew, from their trajectories; scores and trajectories stay."""
    for archive in sorted(board.glob(f"*/*/*/{ARCHIVE}")):
        with unpacked(archive.parent) as results:
            for file in sorted(results.glob("*.json")):
                renew_diagnosis(file)


def renew_diagnosis(file: Path) -> None:
    """Write the implied constants of one result anew."""
    result = load_result(file)
    implied = rescored(result, recorded_experiment(result)).score.implied
    if implied != result.score.implied:
        score = replace(result.score, implied=implied)
        write_result(replace(result, score=score), file)
        print(f"{file.name}: implied constants renewed")


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the submissions; return the exit status."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--engine",
        choices=PACKAGES,
        action="append",
        help="only this engine; repeatable",
    )
    parser.add_argument(
        "--board", type=Path, default=BOARD, help="folder of the leaderboard"
    )
    parser.add_argument(
        "--diagnoses", action="store_true", help="only write what results imply anew"
    )
    options = parser.parse_args(arguments)
    if options.diagnoses:
        renew_diagnoses(options.board)
        return 0
    for engine in options.engine or PACKAGES:
        for configuration, settings in configurations(engine):
            folder = options.board / engine / version(PACKAGES[engine]) / configuration
            submit(engine, folder, configuration, settings)
    return 0


if __name__ == "__main__":
    sys.exit(main())
