"""Measure what popular training configurations do to physics, and write the summary in `docs/sanity_popular.md`.

Gymnasium is read as it is installed. Tasks of other packages are read from probe files, such as
`FOLDER/playground/WalkerWalk.gaugeprobe.json`, which `gauge_probe.py` writes in the Python of the package; a
package without files keeps its rows. Tasks with equal settings share a row, which is measured once for a version of the
package and of the engine. `scoring/popular_configurations.json` is written after each row, so that the script can be
stopped at any time.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from gauge_envs.errors import GaugeError, first_names
from gauge_envs.files import json_ready, write_whole
from gauge_envs.tools.sanity import (
    Report,
    TrainingConfiguration,
    Verdict,
    check,
    configuration,
)
from gauge_envs.tools.sanity.comparison import slide_friction
from gauge_envs.tools.sanity.gauge_probe import SUFFIX
from gauge_envs.tools.sanity.phenomena import phenomena
from scripts.generated import (
    ROOT,
    SCORING,
    Request,
    markdown_table,
    page_part,
    stale_note,
)

DATA = SCORING / "popular_configurations.json"
PAGE = ROOT / "docs" / "sanity_popular.md"
SCRIPT = f"scripts/{Path(__file__).name}"

PHENOMENA = (
    "gravity",
    "creep-wood",
    "rest-height",
    "slide-wood",
    "slide-turned",
    "rebound*",
    "foot-creep",
    "foot-slide",
)
"""Measured rows of the sanity check, as patterns."""

HELD_SHARE = 0.05
"""Acceleration, over that of the real cube, below which a cube counts as held."""

MOST_TARGETS = 4
"""Most tasks of a row that are listed by name."""

GYMNASIUM = (
    "Ant",
    "HalfCheetah",
    "Hopper",
    "Humanoid",
    "HumanoidStandup",
    "InvertedDoublePendulum",
    "InvertedPendulum",
    "Pusher",
    "Reacher",
    "Swimmer",
    "Walker2d",
)


def isaac_lab_files() -> Sequence[str]:
    """Return configurations that training runs of Isaac Lab write, from this repository's examples."""
    return [str(file) for file in sorted((ROOT / "examples" / "sanity").glob("*.yaml"))]


@dataclass(frozen=True)
class Package:
    """A package whose configurations are measured.

    Attributes:
        distribution: Name under which it is installed, and name of the folder of its probe files.
        targets: Function that returns its targets of a sanity check; None for a package that is read from probe files.
    """

    distribution: str
    targets: Callable[[], Sequence[str]] | None = None


PACKAGES = {
    "Gymnasium": Package("gymnasium", lambda: [f"{name}-v5" for name in GYMNASIUM]),
    "dm_control": Package("dm_control"),
    "MuJoCo Playground": Package("playground"),
    "mjlab": Package("mjlab"),
    "ManiSkill": Package("mani_skill"),
    "Isaac Lab": Package("isaaclab", isaac_lab_files),
}


# --- measuring -------------------------------------------------------------------------------------------------------


def targets_of(
    package: Package, probes: Path | None
) -> tuple[str | None, Sequence[str]]:
    """Return the version of a package and its targets; None and no target where it is not here.

    Args:
        package: The package.
        probes: Folder that holds a folder of probe files for each package; None when there is none.
    """
    if package.targets is None:
        files = (
            []
            if probes is None
            else sorted((probes / package.distribution).glob(f"*{SUFFIX}"))
        )
        if not files:
            return None, ()
        versions = json.loads(files[0].read_text(encoding="utf-8"))["versions"]
        return versions[package.distribution], [str(file) for file in files]
    try:
        return version(package.distribution), package.targets()
    except PackageNotFoundError:
        return None, ()


def key_of(read: TrainingConfiguration) -> str:
    """Return a text that is equal for configurations with equal settings and with feet that carry the same."""
    needs = {need.value: reason for need, reason in read.inapplicable.items()}
    foot = read.foot_geometry
    carried = (
        None
        if foot is None
        else (foot.geoms, f"{foot.load_kg:.3g}", f"{foot.softening or math.nan:.3g}")
    )
    parts = (
        read.backend,
        list(read.contact_sets.values()),
        read.gravity_m_per_s2,
        read.up,
        needs,
        friction_of(read),
    )
    return json.dumps(json_ready((*parts, carried)), sort_keys=True)


def friction_of(read: TrainingConfiguration, geoms: str = "") -> float | None:
    """Return the sliding friction that a target states for contacts on the ground; None when it states none.

    Args:
        read: The configuration.
        geoms: Geoms whose contacts are meant, among those on the ground; the most frequent ones when empty.
    """
    if read.foot_contact is not None:
        return float(read.foot_contact.mean_friction)
    used = [group for group in read.contact_groups if group.is_used]
    chosen = [group for group in used if group.geoms == geoms] or used
    return float(chosen[0].constants["friction"][0]) if chosen else None


def share_of_friction(phenomenon: str, acceleration: float | None) -> float | None:
    """Return the friction with which a cube slides, over its own; None when nothing was measured."""
    if acceleration is None:
        return None
    return slide_friction(acceleration) / slide_friction(real_value(phenomenon))


def real_value(phenomenon: str) -> float:
    """Return the value of real objects."""
    return phenomena([phenomenon])[0].reality.value


def row_of(
    report: Report, package: str, key: str, targets: Sequence[str], packages: str
) -> dict[str, Any]:
    """Return the row of one set of settings, JSON-ready."""
    read = report.configuration
    by_id = {row.phenomenon: row for row in report.rows}
    flags = report.flags.values()
    return {
        "package": package,
        "version": packages,
        "targets": list(targets),
        "key": key,
        "measured": date.today().isoformat(),
        "engine": read.backend,
        "engine_version": report.versions.get(read.backend, ""),
        "step_s": read.settings.get("timestep_s"),
        "friction": friction_of(read, by_id["slide-wood"].geoms),
        "geoms": {row.phenomenon: row.geoms for row in report.rows if row.geoms},
        "values": {
            name: row.configured
            for name, row in by_id.items()
            if row.verdict is not Verdict.DECLINED
        },
        "verdicts": {name: row.verdict.value for name, row in by_id.items()},
        "advisory": [name for name, row in by_id.items() if row.advisory],
        "remarks": sorted({row.remark for row in report.rows if row.remark}),
        "flag_count": len(flags),
        "wrong_count": sum(row.verdict is Verdict.WRONG for row in flags),
        "cure": "" if report.cure is None else report.cure.line,
    }


def groups_of(
    targets: Sequence[str],
) -> tuple[dict[str, list[str]], dict[str, TrainingConfiguration], dict[str, str]]:
    """Return targets by key, one configuration for each key, and what cannot be read with the reason."""
    by_key: dict[str, list[str]] = {}
    read: dict[str, TrainingConfiguration] = {}
    unreadable = {}
    for target in targets:
        try:
            found = configuration(target)
        except GaugeError as error:
            unreadable[target] = str(error)
            continue
        key = key_of(found)
        by_key.setdefault(key, []).append(shown_name(target))
        read.setdefault(key, found)
    return by_key, read, unreadable


def shown_name(target: str) -> str:
    """Return the name of a target without folders and without the suffix of probe files."""
    return Path(target).name.removesuffix(SUFFIX)


def measure_package(
    name: str, data: dict[str, Any], file: Path, probes: Path | None = None
) -> None:
    """Measure the rows of a package that the data lack; write the data after each row."""
    found, package_targets = targets_of(PACKAGES[name], probes)
    if found is None:
        print(f"{name} is not here: its rows stay as they are")
        return
    by_key, read, unreadable = groups_of(package_targets)
    known = {
        row["key"]: row
        for row in data["rows"]
        if row["package"] == name and row["version"] == found
    }
    others = [row for row in data["rows"] if row["package"] != name]
    data["unreadable"][name] = {
        shown_name(target): reason for target, reason in unreadable.items()
    }
    rows = []
    for key, targets in by_key.items():
        row = known.get(key)
        if row is None:
            report = check(read[key], only=PHENOMENA, explain=False)
            row = row_of(report, name, key, targets, found)
            # On a CPU, mujoco_warp takes minutes to try changes for a set.
            if row["wrong_count"] >= MANY_WRONG and not read[key].trains_on:
                row = row_of(
                    check(read[key], only=PHENOMENA), name, key, targets, found
                )
            print(
                f"{name}: {', '.join(targets)}: {row['wrong_count']} wrong, {report.wall_s:.0f} s",
                flush=True,
            )
        rows.append({**row, "targets": targets})
        # Rows of tasks that come later are kept until they are measured.
        later = [known[one] for one in list(by_key)[len(rows) :] if one in known]
        data["rows"] = [*others, *rows, *later]
        write_data(data, file)
    data["rows"] = [*others, *rows]
    write_data(data, file)


def write_data(data: Mapping[str, Any], file: Path) -> None:
    """Write the data, with rows in the order of packages and tasks."""
    order = list(PACKAGES)
    rows = sorted(
        data["rows"], key=lambda row: (order.index(row["package"]), row["targets"])
    )
    write_whole(
        file,
        (json.dumps({**data, "rows": rows}, indent=1, sort_keys=True) + "\n").encode(),
    )


# --- page ------------------------------------------------------------------------------------------------------------

WORST_COLUMNS = (
    "task",
    "met, straight",
    "met, turned",
    "creep [mm/s]",
    "own foot creeps [mm/s]",
    "what to change first",
)


SUMMARY = (
    "package",
    "measured",
    "tasks",
    "sets",
    "wrong or visible",
    "met, straight",
    "met, turned",
    "creep [mm/s]",
    "gap [mm]",
    "own foot creeps [mm/s]",
    "own foot meets",
)

MANY_WRONG = 3
"""Wrong values from which on the page names a set of settings."""


def summary(data: Mapping[str, Any]) -> str:
    """Return the generated part of the page: a row for each package, and the sets with many wrong values."""
    rows = [(package_of(data, name), package_cells(data, name)) for name in PACKAGES]
    worst = [
        row
        for row in data["rows"]
        if row["wrong_count"] >= MANY_WRONG and "slide-wood" in row["values"]
    ]
    worst.sort(
        key=lambda one: (-one["wrong_count"], -one["flag_count"], one["targets"])
    )
    lines = [
        *stale_note("popular-configurations-data"),
        *markdown_table(SUMMARY, ([name, *cells] for name, cells in rows if cells)),
        "",
        f"Sets with {MANY_WRONG} or more wrong values:",
        "",
        *markdown_table(WORST_COLUMNS, map(cells, worst)),
    ]
    return "\n".join(lines)


def package_of(data: Mapping[str, Any], name: str) -> str:
    """Return a package with its version and the engine that ran its settings."""
    rows = [row for row in data["rows"] if row["package"] == name]
    engines = sorted({row["engine"] for row in rows})
    return f"{name} {rows[0]['version']}, {' and '.join(engines)}" if rows else name


def package_cells(data: Mapping[str, Any], name: str) -> list[str]:
    """Return the cells of a package: counts, and ranges over its sets of settings; empty without a row."""
    rows = [row for row in data["rows"] if row["package"] == name]
    measured = [row for row in rows if "slide-wood" in row["values"]]
    if not measured:
        return []
    feet = [row for row in measured if "foot-creep" in row["values"]]
    return [
        min(row["measured"] for row in rows),
        str(sum(len(row["targets"]) for row in rows)),
        str(len(measured)),
        str(sum(row["flag_count"] > 0 for row in measured)),
        share_range(measured, "slide-wood"),
        share_range(measured, "slide-turned"),
        value_range(measured, "creep-wood", 1),
        value_range(measured, "rest-height", 2),
        value_range(feet, "foot-creep", 1),
        share_range(feet, "foot-slide"),
    ]


def value_range(rows: Sequence[Mapping[str, Any]], phenomenon: str, digits: int) -> str:
    """Return the least and the greatest value of rows."""
    values = sorted(
        value for row in rows if (value := row["values"].get(phenomenon)) is not None
    )
    return (
        " to ".join(
            dict.fromkeys(number(value, digits) for value in (values[0], values[-1]))
        )
        if values
        else ""
    )


def share_range(rows: Sequence[Mapping[str, Any]], phenomenon: str) -> str:
    """Return the least and the greatest share of its friction that slides, and how many sets hold or fail."""
    texts = [met(row, phenomenon) for row in rows]
    shares = sorted(
        {int(text.removesuffix(" %")) for text in texts if text.endswith("%")}
    )
    range_text = (
        f"{' to '.join(dict.fromkeys(map(str, (shares[0], shares[-1]))))} %"
        if shares
        else ""
    )
    others = [
        f"{texts.count(word)} {word}" for word in ("held", "fails") if word in texts
    ]
    return ", ".join([range_text, *others] if range_text else others)


def cells(row: Mapping[str, Any]) -> list[str]:
    """Return the cells of a row of the page."""
    values, targets = row["values"], row["targets"]
    names = first_names(targets, MOST_TARGETS)
    creep = values.get("foot-creep")
    return [
        names + deciding(row),
        met(row, "slide-wood"),
        met(row, "slide-turned"),
        number(values.get("creep-wood"), 1),
        number(creep, 1) if "foot-creep" in values else "",
        cure(row["cure"]),
    ]


def deciding(row: Mapping[str, Any]) -> str:
    """Return the first geom of the contacts that decide how a cube slides; empty where all contacts are equal."""
    geoms = row["geoms"].get("slide-wood", "")
    first = geoms.rpartition(" with ")[2].split(",")[0].partition(" and ")[0]
    return f" ({first})" if first else ""


def met(row: Mapping[str, Any], phenomenon: str) -> str:
    """Return the share of its own friction that a cube meets, `held` for one that does not slide at all."""
    value = row["values"].get(phenomenon)
    if value is None:
        return (
            ""
            if row.get("verdicts", {}).get(phenomenon) == Verdict.DECLINED
            else "fails"
        )
    if value < HELD_SHARE * real_value(phenomenon):
        return "held"
    share = share_of_friction(phenomenon, value)
    return f"{share:.0%}".replace("%", " %")


def number(value: float | None, digits: int) -> str:
    """Return a number with a fixed number of digits, zero without a sign; `fails` for a run that gave none."""
    return "fails" if value is None else f"{round(value, digits) + 0.0:.{digits}f}"


def cure(line: str) -> str:
    """Return the first change of a cure, and the flags that go."""
    if not line:
        return ""
    change, _, effect = line.partition(": ")
    return f"`{change}`: {effect.partition(';')[0].partition(' (')[0]}"


def stored() -> dict[str, Any]:
    """Return the data of the file."""
    return dict(json.loads(DATA.read_text(encoding="utf-8")))


def contents(scoring: Path = SCORING) -> dict[Path, str]:
    """Return the page with its generated part replaced."""
    return page_part(PAGE, "configurations", SCRIPT, summary(stored()))


def measure(request: Request) -> None:
    """Measure the rows of packages that the data lack; the folder holds probe files."""
    data = stored()
    for name in PACKAGES:
        measure_package(name, data, DATA, request.results)
