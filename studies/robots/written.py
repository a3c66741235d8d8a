"""Cure the mistakes written into the tests' own robots: `python -m studies.robots.written` writes written.csv.

Each mistake of `tests/tools/sanity/more_faults.py` is checked by the rows of the robot, its cure is applied, and the
robots before, after and without the mistake are run by MuJoCo alone, as in `cures.py`.
"""

import csv
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from studies.robots.cures import COLUMNS, applied, plain

TABLE = Path(__file__).parent / "written.csv"
TESTS = Path(__file__).parents[2] / "tests/tools/sanity"

RIGHT = ("right_pose_mrad", "right_step_ms", "right_push_mm")
"""Plain numbers of the robot without the mistake."""


def main() -> None:
    """Write the table of all mistakes."""
    sys.path.insert(0, str(TESTS))
    from more_faults import GOOD, LATER, MISTAKES

    with TemporaryDirectory() as folder, TABLE.open("w", newline="") as stream:
        file = Path(folder, "robot.xml")
        columns = ["mistake", "row", *COLUMNS[5:], *RIGHT]
        writer = csv.DictWriter(
            stream, columns, extrasaction="ignore", lineterminator="\n"
        )
        writer.writeheader()
        for name, (change, row) in (MISTAKES | LATER).items():
            good = GOOD[name.partition(",")[0]]()
            file.write_text(good)
            right = dict(zip(RIGHT, plain(file), strict=True))
            file.write_text(change(good))
            found = applied(file, ["robot-*"])
            writer.writerow({"mistake": name, "row": row} | found | right)
            stream.flush()


if __name__ == "__main__":
    main()
