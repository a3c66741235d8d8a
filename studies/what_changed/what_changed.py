"""Name the release of MuJoCo with which each published change came, and compare releases between which none did.

    python -m studies.what_changed.what_changed models
    python -m studies.what_changed.what_changed run thin_shelf
    python -m studies.what_changed.what_changed checks
    python -m studies.what_changed.what_changed engines sapien==3.0.3

`models` lists the cases and compiles their models. `run` needs a package index: it runs `gauge backend versions` on the
cases of a model, or on all, and prints what `cases.csv` has of them. `checks` runs the scenes of `checks.py` in all
releases of the package index since 2.3.7, with `--pre` in candidates too, and writes table and badge. `engines` runs
those of `engines.py` in releases of other engines that `engines.csv` lacks, with `--new` in the newest of each, and
writes table and badges.
"""

import csv
import json
import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import gymnasium
import mujoco

from gauge_envs.tools.versions.environments import (
    Environment,
    ReleaseError,
    made_environment,
    released_versions,
    version_key,
)
from studies.what_changed import engine_releases

HERE = Path(__file__).parent

GYMNASIUM = Path(gymnasium.__file__).parent / "envs" / "mujoco" / "assets"


def cases(only: str = "") -> Iterator[dict[str, str]]:
    """Yield the rows of `cases.csv`, of one model or of all."""
    with (HERE / "cases.csv").open(encoding="utf-8", newline="") as stream:
        for row in csv.DictReader(stream):
            if only in ("", row["model"]):
                yield row


def subject(name: str) -> str:
    """Return the model of a case: a file here, one of Gymnasium, or an id of the suite."""
    files = [HERE / f"{name}.urdf"]
    files += [folder / f"{name}.xml" for folder in (HERE, GYMNASIUM)]
    return next((str(file) for file in files if file.is_file()), name)


def show_models() -> None:
    """Print the cases with the degrees of freedom of their models."""
    for row in cases():
        found = subject(row["model"])
        size = ""
        if Path(found).is_file():
            size = str(mujoco.MjModel.from_xml_path(found).nv)
        print(row["model"], size, row["first"], row["last"], row["named"] or "same")


def run(only: str = "") -> None:
    """Run the command on the cases, print what it names beside what is stored, and store it.

    Where `cpu_s` [s] is to be that of the command alone, the environments are in the cache before.
    """
    done: list[dict[str, str]] = []
    for row in cases():
        done.append(row if only not in ("", row["model"]) else found(row))
        if done[-1] is not row:
            stored = row["named"] or "same"
            print(row["model"], done[-1]["named"] or "same", f"(stored: {stored})")
            print(" ", done[-1]["printed"], f"{done[-1]['cpu_s']} CPU s", flush=True)
    with (HERE / "cases.csv").open("w", encoding="utf-8", newline="") as stream:
        writer = csv.DictWriter(stream, list(done[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(done)


def found(row: dict[str, str]) -> dict[str, str]:
    """Return a case with what the command names and prints first, and its processor time [s]."""
    ends = (row["first"], row["last"])
    words = [f"mujoco=={'..'.join(ends)}", "--bisect"]
    if not row["published"]:
        words = [f"mujoco=={end}" for end in ends]
    command = ["gauge", "backend", "versions", subject(row["model"])]
    command += [*words, "--steps", row["steps"], "--json", "--quiet"]
    before = os.times()
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False)
    after = os.times()
    cpu_s = after.children_user - before.children_user
    cpu_s += after.children_system - before.children_system
    line = json.loads(done.stdout)
    named = ""
    if line["verdict"] == "different":
        named = line["after"].partition("==")[2]
        first = line["first"]
        printed = f"{first['quantity']}: {first['detail']}"
    else:
        largest = line["largest"]
        printed = f"at most {largest:.2g}" if largest else "bit for bit"
    return row | {"named": named, "printed": printed, "cpu_s": f"{cpu_s:.1f}"}


# --- checks by release -----------------------------------------------------------------------------------------------

COMMITS = "https://github.com/google-deepmind/mujoco/commit/"

RESULTS, BADGE = HERE / "checks.csv", HERE / "badge.json"

MOVED = 0.02
"""Difference of a check, over the larger number, that is a move; numbers below `SMALL` are 0."""

SMALL = {"mesh_tilt_deg": 0.05, "spin_energy_percent": 0.01, "grip_slip_mm": 0.02}


def measure(*versions: str) -> None:
    """Run the checks in releases of MuJoCo that `checks.csv` lacks; all that the package index has by default.

    The file is written after each release, so that the command goes on where it was stopped.
    """
    wanted = [version for version in versions if version != "--pre"]
    if not wanted:
        here = Environment("", Path(sys.executable))
        has_candidates = "--pre" in versions
        wanted = released_versions("mujoco", here, has_candidates=has_candidates)
    rows = results()
    for version in wanted:
        if version in rows or version_key(version) < (2, 3, 7):
            continue
        try:
            python = made_environment(f"mujoco=={version}").python
        except ReleaseError as error:
            print(error)
            continue
        command = [str(python), "-I", "-B", str(HERE / "checks.py")]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            print(f"{version}: the checks end with code {done.returncode}")
            continue
        rows[version] = json.loads(done.stdout)
        write_results(rows)


def results() -> dict[str, dict[str, float | str]]:
    """Return the stored number of each check, or why it has none, by release, the oldest first."""
    found: dict[str, dict[str, float | str]] = {}
    if RESULTS.is_file():
        with RESULTS.open(encoding="utf-8", newline="") as stream:
            for row in csv.DictReader(stream):
                version = row.pop("release")
                found[version] = {
                    name: number_or_text(text) for name, text in row.items()
                }
    return found


def number_or_text(text: str) -> float | str:
    """Return a number, or the text that is none."""
    try:
        return float(text)
    except ValueError:
        return text


def write_results(rows: dict[str, dict[str, float | str]]) -> None:
    """Write the number of each check with six digits, a line for each release."""
    names = list(next(iter(rows.values())))
    with RESULTS.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(["release", *names])
        for version in sorted(rows, key=version_key):
            values = []
            for name in names:
                value = rows[version][name]
                values.append(f"{value:.6g}" if isinstance(value, float) else value)
            writer.writerow([version, *values])


def truths() -> list[dict[str, str]]:
    """Return the checks with their truths, in the order of the table."""
    with (HERE / "truths.csv").open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def badge() -> dict[str, int | str]:
    """Return the badge of the newest release, as shields.io reads it: how many checks give their truth."""
    release, values = list(results().items())[-1]
    met = []
    for row in truths():
        truth = number_or_text(row["truth"])
        if isinstance(truth, float):
            met.append(is_same(row["check"], values[row["check"]], truth))
    return {
        "schemaVersion": 1,
        "label": f"MuJoCo {release}",
        "message": f"{sum(met)} of {len(met)} checks",
        "color": "brightgreen" if all(met) else "orange",
    }


def checks(*words: str) -> None:
    """Run the checks in releases of MuJoCo, and write their table and badge."""
    measure(*words)
    write_page()


def engines(*words: str) -> None:
    """Run the scenes in releases of other engines, and write their table and badges."""
    engine_releases.measure_engines(*words)
    engine_releases.write_page()


def write_page() -> None:
    """Write the table of the note, and the badge."""
    page = HERE / "README.md"
    text = page.read_text(encoding="utf-8")
    old = re.search(r"^\| check \| truth .*?(?=\n\n)", text, re.DOTALL | re.MULTILINE)
    assert old is not None
    page.write_text(text.replace(old[0], table()), encoding="utf-8")
    BADGE.write_text(json.dumps(badge()) + "\n", encoding="utf-8")


def ranges(name: str) -> list[tuple[str, str, float | str]]:
    """Return the releases between which a check does not move: first, last, and the number at the first."""
    found: list[tuple[str, str, float | str]] = []
    for version, values in results().items():
        value = values[name]
        if found and is_same(name, found[-1][2], value):
            found[-1] = (found[-1][0], version, found[-1][2])
        else:
            found.append((version, version, value))
    return found


def is_same(name: str, one: float | str, two: float | str) -> bool:
    """Return whether a check did not move."""
    if isinstance(one, str) or isinstance(two, str):
        return one == two
    largest = max(abs(one), abs(two))
    return largest < SMALL.get(name, 0.0) or abs(one - two) <= MOVED * largest


def table() -> str:
    """Return the checks by release as a table of a page: a range of releases for each number."""
    lines = ["| check | truth | found, by release | changelog |", "|---|---|---|---|"]
    for row in truths():
        cells = []
        for first, last, value in ranges(row["check"]):
            if isinstance(value, float):
                small = abs(value) < SMALL.get(row["check"], 0.0)
                value = "0" if small else f"{value:.3g}"
            releases = first if first == last else f"{first} to {last}"
            cells.append(f"{releases}: {value}")
        changelog = re.sub(r"\((\w{8,9})\)", rf"([\1]({COMMITS}\1))", row["changelog"])
        words = (row["title"], row["truth"], "; ".join(cells), changelog)
        lines.append(f"| {' | '.join(words)} |".replace("|  |", "| |"))
    return "\n".join(lines)


COMMANDS: dict[str, Callable[..., None]] = {
    "models": show_models,
    "run": run,
    "checks": checks,
    "engines": engines,
}
"""What the first argument does with the others."""


if __name__ == "__main__":
    COMMANDS[sys.argv[1]](*sys.argv[2:])
