"""Apply the change that `gauge sanity` states to targets of packages, and check them again.

python studies/cures/cures.py               writes cures.csv, of the packages that are installed here
"""

from __future__ import annotations

import csv
import sys
import time
import warnings
from pathlib import Path

from gauge_envs.tools.sanity import Report, check, configuration
from gauge_envs.tools.sanity.run import applied

HERE = Path(__file__).resolve().parent
TARGETS = ("playground:Go1JoystickFlatTerrain", "playground:SpotFlatTerrainJoystick", "HalfCheetah-v5", "Walker2d-v5")
TARGETS += ("dm_control:acrobot/swingup", "maniskill:PickCube-v1")


def flags(report: Report) -> str:
    return " ".join(row.phenomenon for row in report.rows if row.is_flag)


def main() -> None:
    warnings.simplefilter("ignore")
    rows = []
    for target in sys.argv[1:] or TARGETS:
        started = time.process_time()
        read = configuration(target)
        report = check(read)
        seconds = time.process_time() - started
        after = "" if report.cure is None else flags(check(applied(read, report.cure.changes)[0], explain=False))
        row = {
            "target": target,
            "engine": read.trains_on or read.backend,
            "rows": sum(row.configured is not None for row in report.rows),
            "flags": flags(report),
            "change": "" if report.cure is None else report.cure.line,
            "flags_after": after,
            "cpu_s": f"{seconds:.0f}",
        }
        print(row, flush=True)
        rows.append(row)
    with (HERE / "cures.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, fieldnames=list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


if __name__ == "__main__":
    main()
