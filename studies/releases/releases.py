"""Run the rigid conformance checks on releases of an engine, and list when which result changed.

    python studies/releases/releases.py run mujoco 3.2.5 3.2.6 3.17.0 4.0.0 --cache releases
    python studies/releases/releases.py write --cache releases

`run` installs each release into a folder of the cache, ahead of the packages of this environment, and writes its column
there; a release that has a column is not run again. `write` compares each release with the one before, and writes
checks.csv and changes.csv beside this script. It is `gauge backend check --baseline` with a tenth of its tolerances.
"""

from __future__ import annotations

import argparse
import csv
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

from packaging.version import Version

from gauge_envs.tools.conformance import CheckResult, Status, checks
from gauge_envs.tools.conformance.matrix import MatrixColumn, read_columns

HERE = Path(__file__).parent
PACKAGES = {
    "mujoco": "mujoco",
    "physx": "sapien",
    "rapier": "rapier3d",
    "drake": "drake",
}
"""Package whose releases are compared, by name of the backend."""
LEFT_OUT = ("cloth", "air", "soft", "benchmark", "continuation")
"""Families of checks that need deformable bodies, or test the backend more than its engine."""
LIMIT_S = 1800.0
SHARE = 0.1
"""Change of a value that is listed, as a share of the tolerance of its check."""


def rigid_checks() -> list[str]:
    """Return the ids of the checks with rigid bodies alone."""
    modules = {one.id: one.measure.__module__.rpartition(".")[2] for one in checks()}
    return [
        name
        for name, module in modules.items()
        if module not in LEFT_OUT and not name.startswith("cloth")
    ]


def run(engine: str, versions: list[str], cache: Path) -> None:
    """Install releases and run the checks that they lack a column of."""
    for version in versions:
        folder, column = cache / engine / version, cache / f"{engine}-{version}.json"
        if column.exists():
            continue
        pip = [
            sys.executable,
            "-m",
            "pip",
            "install",
            "-q",
            "--no-deps",
            "--only-binary",
            ":all:",
        ]
        requirement = f"{PACKAGES[engine]}=={version}"
        if (
            not folder.exists()
            and subprocess.run(
                [*pip, "--target", str(folder), requirement], check=False
            ).returncode
        ):
            print(f"{requirement} cannot be installed here", flush=True)
            continue
        path = os.pathsep.join(
            [str(folder), *filter(None, [os.environ.get("PYTHONPATH")])]
        )
        command = [
            sys.executable,
            "-c",
            "from gauge_command import main; main()",
            "backend",
            "check",
            engine,
        ]
        command += [word for name in rigid_checks() for word in ("--only", name)]
        environment = os.environ | {"PYTHONPATH": path, "OMP_NUM_THREADS": "1"}
        done = subprocess.run(
            [*command, "--out", str(column)],
            env=environment,
            check=False,
            capture_output=True,
            text=True,
            timeout=LIMIT_S,
        )
        print(f"{requirement}: {done.stderr.strip().splitlines()[-1:]}", flush=True)


def columns(cache: Path) -> Iterator[tuple[str, str, MatrixColumn]]:
    """Yield engine, version and column of each release, in the order of engines and versions."""
    found = [(*file.stem.split("-", 1), file) for file in cache.glob("*-*.json")]
    for engine, version, file in sorted(
        found, key=lambda row: (list(PACKAGES).index(row[0]), Version(row[1]))
    ):
        (column,) = read_columns(file)
        yield engine, version, column


def write(cache: Path) -> None:
    """Write each result, and each change from one release that runs to the next."""
    rows: list[tuple[str, ...]] = []
    moved: list[tuple[str, ...]] = []
    before: MatrixColumn | None = None
    for engine, version, column in columns(cache):
        runs = [
            one for one in column.findings.values() if one.status is not Status.ERROR
        ]
        if not runs:
            print(
                f"{engine} {version}: {column.reason or next(iter(column.findings.values())).diagnosis}"
            )
            continue
        for name, one in column.findings.items():
            rows.append(
                (
                    engine,
                    version,
                    name,
                    one.status.value,
                    number(one.measured),
                    number(one.expected),
                )
            )
        if before is not None and before.backend == column.backend:
            pairs = [
                (before.findings[name], one)
                for name, one in column.findings.items()
                if name in before.findings
            ]
            moved += [
                (engine, version, *change(old, one))
                for old, one in pairs
                if is_changed(old, one)
            ]
        before = column
    save(
        "checks.csv",
        ("engine", "release", "check", "status", "measured", "expected"),
        rows,
    )
    save(
        "changes.csv",
        (
            "engine",
            "release",
            "check",
            "status",
            "before",
            "now",
            "expected",
            "tolerance",
        ),
        moved,
    )


def is_changed(before: CheckResult, now: CheckResult) -> bool:
    """Return whether a check has another outcome, or a value that moved by `SHARE` of its tolerance."""
    if (
        before.status is not now.status
        or before.measured is None
        or now.measured is None
    ):
        return before.status is not now.status
    return abs(now.measured - before.measured) > SHARE * (now.width or 0.0)


def change(before: CheckResult, now: CheckResult) -> tuple[str, ...]:
    """Return the check, both outcomes, both values, the expected value and the tolerance."""
    status = (
        now.status.value
        if now.status is before.status
        else f"{before.status.value} to {now.status.value}"
    )
    values = (before.measured, now.measured, now.expected, now.width)
    return (now.check, status, *(number(one) for one in values))


def number(value: float | None) -> str:
    """Return a number with six digits; empty for none."""
    return "" if value is None else f"{value:.6g}"


def save(name: str, header: tuple[str, ...], rows: list[tuple[str, ...]]) -> None:
    """Write a table beside this script."""
    with (HERE / name).open("w", encoding="utf-8", newline="") as stream:
        csv.writer(stream, lineterminator="\n").writerows([header, *rows])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("do", choices=("run", "write"))
    parser.add_argument("engine", nargs="?", choices=tuple(PACKAGES))
    parser.add_argument("versions", nargs="*")
    parser.add_argument("--cache", type=Path, required=True)
    chosen = parser.parse_args()
    if chosen.do == "run":
        run(chosen.engine, chosen.versions, chosen.cache.resolve())
    else:
        write(chosen.cache.resolve())
