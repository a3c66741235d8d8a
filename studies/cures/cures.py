"""Apply the change that `gauge sanity` states to targets of packages, and check them again.

python studies/cures/cures.py [TARGET ...]    prints the rows of cures.csv: of Gymnasium, or of any targets
"""

from __future__ import annotations

import sys
import time
import warnings

from gauge_envs.tools.sanity import Report, check, configuration
from gauge_envs.tools.sanity.cure import applied

TARGETS = ("HalfCheetah-v5", "Walker2d-v5")
"""`cures.csv` also has tasks of Playground, dm_control and ManiSkill, each of which was read with its own models."""


def flags(report: Report) -> str:
    return " ".join(row.phenomenon for row in report.rows if row.is_flag)


def main() -> None:
    warnings.simplefilter("ignore")
    for target in sys.argv[1:] or TARGETS:
        started = time.process_time()
        read = configuration(target)
        report = check(read)
        seconds = time.process_time() - started
        after = (
            ""
            if report.cure is None
            else flags(check(applied(read, report.cure.changes)[0], explain=False))
        )
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


if __name__ == "__main__":
    main()
