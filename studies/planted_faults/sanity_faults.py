"""Plant mistakes of people in a quadruped, and check good robots: what `gauge sanity` finds, names and mends.

python studies/planted_faults/sanity_faults.py                 writes sanity.csv
python studies/planted_faults/sanity_faults.py --only gravcomp prints one fault
python studies/planted_faults/sanity_faults.py --good          prints good robots: of Gymnasium, and of named files
"""

from __future__ import annotations

import argparse
import csv
import sys
import tempfile
import time
import warnings
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parents[1] / "tests" / "tools" / "sanity"))

from robot_faults import FAULTS, good_xml  # noqa: E402

from gauge_envs.tools.sanity import Report, check, configuration  # noqa: E402
from gauge_envs.tools.sanity.cure import applied  # noqa: E402

GOOD = (
    "Ant-v5",
    "HalfCheetah-v5",
    "Hopper-v5",
    "Humanoid-v5",
    "Walker2d-v5",
    "Swimmer-v5",
)
"""Robots of Gymnasium. `sanity_good.csv` also has those of dm_control, Playground and mjlab."""

ROBOT = ("robot-*", "floor-tilt", "gravity")
QUICK = (
    *ROBOT,
    "foot-*",
    "creep-wood",
    "rest-height",
    "release",
    "slide-wood",
    "slide-turned",
    "point",
)
"""Rows that are measured: without the slow turntables, pendulum and wall."""


def flags(report: Report) -> list[str]:
    return [row.phenomenon for row in report.rows if row.is_flag]


def planted(name: str) -> dict[str, object]:
    """Return what a check finds of a fault, and what is left after its cure, which is read back and checked again."""
    fault, started = FAULTS[name], time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "robot.xml"
        path.write_text(fault.xml())
        read = configuration(path)
        report = check(read, only=QUICK)
        seconds = time.process_time() - started
        found = flags(report)
        left = (
            found
            if report.cure is None
            else flags(check(applied(read, report.cure.changes)[0], only=QUICK))
        )
    return {
        "fault": name,
        "thread": fault.thread,
        "found": bool(found),
        "named": ", ".join(row for row in fault.rows if row in found),
        "flags": " ".join(found),
        "cure": "" if report.cure is None else report.cure.line.split(": ")[0],
        "left": " ".join(left),
        "cpu_s": f"{seconds:.1f}",
    }


def good(target: str) -> dict[str, object]:
    """Return the flags of a robot of a package on its own model."""
    started = time.process_time()
    report = check(target, only=ROBOT)
    rows = [row for row in report.rows if row.is_flag]
    said = "; ".join(
        f"{r.phenomenon} {r.configured:.3g} ({r.remark})"
        for r in rows
        if r.configured is not None
    )
    measured = sum(row.configured is not None for row in report.rows)
    return {
        "target": target,
        "rows": measured,
        "flags": said,
        "cpu_s": f"{time.process_time() - started:.1f}",
    }


def write(path: Path, rows: list[dict[str, object]]) -> None:
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, fieldnames=list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def main() -> None:
    warnings.simplefilter("ignore")
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", nargs="*", default=[])
    parser.add_argument(
        "--good",
        nargs="*",
        metavar="TARGET",
        help="good robots beside those of Gymnasium",
    )
    options = parser.parse_args()
    rows = []
    if options.good is None and not options.only:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "robot.xml"
            path.write_text(good_xml())
            print("without a fault:", flags(check(path)), flush=True)
    is_good = options.good is not None
    for name in options.only or ((*GOOD, *options.good) if is_good else FAULTS):
        row = good(name) if is_good else planted(name)
        print(row, flush=True)
        rows.append(row)
    if not options.only and not is_good:
        write(HERE / "sanity.csv", rows)


if __name__ == "__main__":
    main()
