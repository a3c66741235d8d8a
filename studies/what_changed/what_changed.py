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
    ReleaseError,
    made_environment,
    released_versions,
    version_key,
)
from studies.what_changed import engine_releases
from studies.what_changed.engine_releases import is_same, ranges, rows_of

HERE = Path(__file__).parent

GYMNASIUM = Path(gymnasium.__file__).parent / "envs" / "mujoco" / "assets"


def cases(only: str = "") -> Iterator[dict[str, str]]:
    """Yield the rows of `cases.csv`, of one model or of all."""
    for row in rows_of(HERE / "cases.csv"):
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

SMALL = {"mesh_tilt_deg": 0.05, "spin_energy_percent": 0.01, "grip_slip_mm": 0.02}
"""Size below which a number of a check is 0."""


def measure(*versions: str) -> None:
    """Run the checks in releases of MuJoCo that `checks.csv` lacks; all that the package index has by default.

    The file is written after each release, so that the command goes on where it was stopped.
    """
    wanted = [version for version in versions if version != "--pre"]
    if not wanted:
        here = Path(sys.executable)
        has_candidates = "--pre" in versions
        wanted = released_versions("mujoco", here, has_candidates=has_candidates)
    rows = results()
    for version in wanted:
        if version in rows or version_key(version) < (2, 3, 7):
            continue
        try:
            python = made_environment(f"mujoco=={version}")
        except ReleaseError as error:
            print(error)
            continue
        command = [str(python), "-I", "-B", str(HERE / "checks.py")]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            print(f"{version}: the checks end with code {done.returncode}")
            continue
        rows[version] = {
            name: f"{value:.6g}" if isinstance(value, float) else value
            for name, value in json.loads(done.stdout).items()
        }
        write_results(rows)


def results() -> dict[str, dict[str, str]]:
    """Return the stored number of each check, or why it has none, by release, the oldest first."""
    rows = rows_of(RESULTS) if RESULTS.is_file() else []
    return {row.pop("release"): row for row in rows}


def write_results(rows: dict[str, dict[str, str]]) -> None:
    """Write the number of each check, a line for each release."""
    names = list(next(iter(rows.values())))
    with RESULTS.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(["release", *names])
        for version in sorted(rows, key=version_key):
            writer.writerow([version, *(rows[version][name] for name in names)])


def truths() -> list[dict[str, str]]:
    """Return the checks with their truths, in the order of the table."""
    return rows_of(HERE / "truths.csv")


def has_truth(row: dict[str, str]) -> bool:
    """Return whether the truth of a check is a number."""
    return row["truth"].replace(".", "").isdigit()


def badge() -> dict[str, int | str]:
    """Return the badge of the newest release, as shields.io reads it: how many checks give their truth."""
    release, values = list(results().items())[-1]
    met = []
    for row in filter(has_truth, truths()):
        name = row["check"]
        met.append(is_same(values[name], row["truth"], SMALL.get(name, 0.0)))
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


def table() -> str:
    """Return the checks by release as a table of a page: a range of releases for each number."""
    lines = ["| check | truth | found, by release | changelog |", "|---|---|---|---|"]
    for row in truths():
        cells = []
        name = row["check"]
        small = SMALL.get(name, 0.0)
        numbers = [(version, found[name]) for version, found in results().items()]
        for first, last, value in ranges(numbers, small):
            if is_same(value, "0", small):
                value = "0"
            elif value[-1].isdigit():
                value = f"{float(value):.3g}"
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
