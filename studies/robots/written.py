"""Cure the mistakes written into the tests' own robots: `python -m studies.robots.written [PATTERN]`.

It writes the rows of matching mistakes, as 'arm*', into written.csv, each as soon as it is known; others stay. Each
mistake of `tests/tools/sanity/more_faults.py` is checked by the rows of the robot, its cure is applied, and the robots
before, after and without the mistake are run by MuJoCo alone, as in `cures.py`.
"""

import sys
from collections.abc import Iterator
from fnmatch import fnmatchcase
from pathlib import Path
from tempfile import TemporaryDirectory

from studies.robots.cures import COLUMNS, applied, plain, renew

TABLE = Path(__file__).parent / "written.csv"
TESTS = Path(__file__).parents[2] / "tests/tools/sanity"

RIGHT = ("right_pose_mrad", "right_step_ms", "right_push_mm")
"""Plain numbers of the robot without the mistake."""


def fresh(pattern: str) -> Iterator[dict[str, str]]:
    """Yield the rows of mistakes."""
    sys.path.insert(0, str(TESTS))
    from more_faults import GOOD, LATER, MISTAKES

    with TemporaryDirectory() as folder:
        file = Path(folder, "robot.xml")
        for name, (change, row) in (MISTAKES | LATER).items():
            if not fnmatchcase(name, pattern):
                continue
            good = GOOD[name.partition(",")[0]]()
            file.write_text(good)
            right = dict(zip(RIGHT, plain(file), strict=True))
            file.write_text(change(good))
            found = applied(file, ["robot-*"])
            yield {"mistake": name, "row": row} | found | right


if __name__ == "__main__":
    renew(TABLE, ["mistake", "row", *COLUMNS[5:], *RIGHT], fresh(*sys.argv[1:] or "*"))
