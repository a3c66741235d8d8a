"""Run the scenes of `engines.py` in releases of engines other than MuJoCo; write their table and badges."""

import csv
import json
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from gauge_envs.tools.versions.causes import unreached
from gauge_envs.tools.versions.environments import (
    released_versions,
    version_key,
)

HERE = Path(__file__).parent
RESULTS = HERE / "engines.csv"

TITLES = {
    "rapier3d": "Rapier",
    "sapien": "SAPIEN",
    "pybullet": "PyBullet",
    "mujoco-warp": "mujoco-warp",
    "newton": "Newton",
    "drake": "Drake",
    "genesis-world": "Genesis",
}
"""Title of the engine of each package, in the order of the table."""

MOVED = 0.02
"""Difference of a number, over the larger one, that is a move; numbers below `small` in `scenes.csv` are 0."""

NUMPY_2_SINCE = {"drake": (1, 34), "pybullet": (3, 2, 7), "sapien": (3,)}
"""First release of an engine that is run with NumPy 2, which earlier ones crash or refuse with."""

GENESIS_OF_LIBIGL_2_6 = (1, 4, 5)
"""First release of Genesis that is run with libigl 2.6, whose signed distances stop 0.2.1."""

WARP_OF_ITS_TIME = (
    ("newton", (1, 2), "warp-lang<1.13"),
    ("newton", (1, 2, 1), "warp-lang<1.14"),
    ("mujoco-warp", (3, 10, 0, 1), "warp-lang<1.14"),
)
"""Releases of engines before which a later Warp, which their metadata allow, fails; and the Warp that they have."""

FROM_SOURCE = ("--only-binary", ":all:", "--no-binary", "pygltflib")
"""Only wheels are installed, but for a package of Genesis that has none: it is one file of Python."""

PYTHONS = (sys.executable, "python3.9", "python3.8")
"""Interpreters that a release is tried in, in turn: old releases have wheels for old ones alone."""

STATED_BY_SAPIEN = (3,)
"""First release of SAPIEN that states all packages that it imports."""


def beside(requirement: str) -> list[str]:
    """Return the packages that are installed with a release of an engine, which does not state them or their limits."""
    engine, _, version = requirement.partition("==")
    # SAPIEN imports a module that later setuptools lack, and Newton 0.1.3 one that it does not state.
    packages = ["numpy", "setuptools<81", "typing_extensions"]
    if version_key(version) < NUMPY_2_SINCE.get(engine, ()):
        packages[0] = "numpy<2"
    if engine == "sapien" and version_key(version) < STATED_BY_SAPIEN:
        packages += ["scipy", "transforms3d"]
    if engine == "genesis-world":
        packages.append("torch==2.13.0")
        if version_key(version) < GENESIS_OF_LIBIGL_2_6:
            packages.append("libigl<2.6")
    for name, first_of_later, warp in WARP_OF_ITS_TIME:
        if engine == name and version_key(version) < first_of_later:
            packages.append(warp)
            break
    if engine == "mujoco-warp":
        first, second = version.split(".")[:2]
        # Before it had the numbers of MuJoCo it was 0.0, and needed one whose states have `qM`.
        of_its_time = "3.3" if first == "0" else f"{first}.{second}"
        packages.append(f"mujoco=={of_its_time}.*")
    return packages


def indexed_releases(*, newest: bool, has_candidates: bool) -> list[str]:
    """Return the releases of each engine that the package index has, or the newest of each."""
    here = Path(sys.executable)
    found = []
    for engine in TITLES:
        versions = released_versions(engine, here, has_candidates=has_candidates)
        if newest:
            versions = versions[-1:]
        found += [f"{engine}=={version}" for version in versions]
    return found


def measure_engines(*words: str) -> None:
    """Run the scenes in releases that `engines.csv` lacks, as `drake==1.37.0`.

    `--all` stands for all that the package index has, and `--new` for the newest of each engine. The file is written
    after each release, so that the command goes on where it was stopped. A release without a wheel is printed alone.
    """
    requirements = [word for word in words if "==" in word]
    if "--all" in words or "--new" in words:
        requirements += indexed_releases(
            newest="--all" not in words, has_candidates="--pre" in words
        )
    with TemporaryDirectory() as folder:
        for requirement in requirements:
            if requirement in {row["release"] for row in results()}:
                continue
            engine = requirement.partition("==")[0]
            python = installed(requirement, Path(folder) / engine)
            if python is not None:
                store(requirement, scene_numbers(python, engine))


def installed(requirement: str, folder: Path) -> str | None:
    """Return the interpreter of an environment with a release, in the first Python that has its wheels, if any.

    Args:
        requirement: The release.
        folder: Folder of the environments of its engine, one for each Python.
    """
    why = "no interpreter"
    for base in PYTHONS:
        if shutil.which(base) is None:
            continue
        place = folder / Path(base).name
        python = str(place / "bin" / "python")
        make = [base, "-m", "venv", str(place)]
        # A cache would keep half a gigabyte of each release of Drake.
        install = [python, "-m", "pip", "--no-cache-dir", "install", "-q", "--no-input"]
        if uv := shutil.which("uv"):
            make = [uv, "venv", "-q", "--python", base, str(place)]
            install = [uv, "pip", "install", "-q", "--no-cache", "--python", python]
        commands = [[*install, *FROM_SOURCE, requirement, *beside(requirement)]]
        if not place.exists():
            commands.insert(0, make)
        for command in commands:
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            if done.returncode:
                break
        if done.returncode == 0:
            return python
        why = done.stderr.strip().splitlines()[-1]
        if unreached(done.stderr):
            break
    print(f"{requirement}: {why}", flush=True)
    return None


def scene_numbers(python: str, engine: str) -> dict[str, str]:
    """Return the number of each scene in the installed release of an engine, or why it has none."""
    command = [python, str(HERE / "engines.py"), engine]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        lines = done.stderr.splitlines() or ["no message"]
        if done.returncode < 0:
            lines.append(f"it crashes ({signal.Signals(-done.returncode).name})")
        names = [scene["scene"] for scene in scenes()]
        return dict.fromkeys(names, lines[-1][:200])
    found = json.loads(done.stdout.splitlines()[-1])
    return {
        name: f"{value:.4g}" if isinstance(value, float) else value
        for name, value in found.items()
    }


def store(requirement: str, values: dict[str, str]) -> None:
    """Write the numbers of a release beside those of the others, the oldest of an engine first."""
    rows = [*results(), values | {"release": requirement}]
    order = list(TITLES)
    rows.sort(key=lambda row: _key(row["release"], order))
    with RESULTS.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.DictWriter(stream, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def _key(release: str, order: Sequence[str]) -> tuple[int, tuple[int, ...]]:
    engine, _, version = release.partition("==")
    return order.index(engine), version_key(version)


def rows_of(file: Path) -> list[dict[str, str]]:
    """Return the rows of a table, by the names of its columns."""
    with file.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def results() -> list[dict[str, str]]:
    """Return the stored number of each scene by release."""
    return rows_of(RESULTS)


def scenes() -> list[dict[str, str]]:
    """Return the scenes with their titles and truths, in the order of the table."""
    return rows_of(HERE / "scenes.csv")


# --- table and badges ------------------------------------------------------------------------------------------------


def is_same(one: str, two: str, small: float) -> bool:
    """Return whether a number did not move, or a text is the same."""
    try:
        first, second = float(one), float(two)
    except ValueError:
        return one == two
    largest = max(abs(first), abs(second))
    return largest < small or abs(first - second) <= MOVED * largest


def ranges(
    values: Iterable[tuple[str, str]], small: float
) -> list[tuple[str, str, str]]:
    """Return the releases between which a number does not move: first, last, and the number at the last.

    Args:
        values: Release and number, the oldest first.
        small: Size below which a number is 0.
    """
    found: list[tuple[str, str, str]] = []
    for version, value in values:
        first = version
        if found and is_same(found[-1][2], value, small):
            first = found.pop()[0]
        found.append((first, version, value))
    return found


def table() -> str:
    """Return the scenes as a table of a page; a bold release is one with which a number moved."""
    changes = rows_of(HERE / "engine_changes.csv")
    lines = ["| scene | truth | engine | number, by release |", "|---|---|---|---|"]
    for scene in scenes():
        start = f"| {scene['title']} | {scene['truth']} |"
        for engine, title in TITLES.items():
            cells = []
            numbers = []
            for row in results():
                name, _, version = row["release"].partition("==")
                if name == engine:
                    numbers.append((version, row[scene["scene"]]))
            for first, last, value in ranges(numbers, float(scene["small"])):
                releases = first if first == last else f"{first} to {last}"
                mark = f"**{releases}**" if cells else releases
                here = (engine, scene["scene"], first)
                for change in changes:
                    place = (change["engine"], change["scene"], change["release"])
                    if place == here:
                        mark += f" ([{change['fact']}]({change['address']}))"
                cells.append(f"{mark}: {value}")
            if cells:
                lines.append(f"{start} {title} | {'; '.join(cells)} |")
                start = "| | |"
    return "\n".join(lines)


def badges() -> dict[str, dict[str, int | str]]:
    """Return the badge of the newest release of each engine, as shields.io reads it."""
    newest = {row["release"].partition("==")[0]: row for row in results()}
    found: dict[str, dict[str, int | str]] = {}
    for engine, row in newest.items():
        met = []
        for scene in scenes():
            value = row[scene["scene"]]
            if value != "no coefficient":
                met.append(is_same(value, scene["truth"], float(scene["small"])))
        found[engine] = {
            "schemaVersion": 1,
            "label": f"{TITLES[engine]} {row['release'].partition('==')[2]}",
            "message": f"{sum(met)} of {len(met)} scenes",
            "color": "brightgreen" if all(met) else "orange",
        }
    return found


def write_page() -> None:
    """Write the table of the note, and the badges, one for each engine."""
    page = HERE / "README.md"
    text = page.read_text(encoding="utf-8")
    old = re.search(r"^\| scene \| truth .*?(?=\n\n)", text, re.DOTALL | re.MULTILINE)
    assert old is not None
    page.write_text(text.replace(old[0], table()), encoding="utf-8")
    for engine, badge in badges().items():
        file = HERE / f"badge_{engine}.json"
        file.write_text(json.dumps(badge) + "\n", encoding="utf-8")
