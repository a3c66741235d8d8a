"""Hashes of the results of the leaderboard that its workflow computed, in `leaderboard/computed.sha256`.

python scripts/board_hashes.py check     removes other results: those of a submitter whose run failed after the merge
python scripts/board_hashes.py write     lists those that are there

Results of submissions that are stated as reported are neither listed nor removed.
"""

import sys
import tomllib
from collections.abc import Iterator
from hashlib import sha256
from pathlib import Path

BOARD = Path("leaderboard")
LIST = BOARD / "computed.sha256"


def results() -> Iterator[Path]:
    """Yield the results of all submissions that are not reported."""
    for file in sorted(BOARD.glob("*/*/*/results.tar.xz")):
        try:
            statement = tomllib.loads(file.with_name("submission.toml").read_text())
        except (OSError, ValueError):
            statement = {}
        if statement.get("standing") != "reported":
            yield file


def line(file: Path) -> str:
    """Return the line of a file in the list."""
    return f"{sha256(file.read_bytes()).hexdigest()}  {file.relative_to(BOARD)}"


def check() -> None:
    """Remove results that are not listed, and links, whose targets are not read."""
    listed = LIST.read_text().splitlines() if LIST.is_file() else []
    for file in results():
        if file.is_symlink() or line(file) not in listed:
            print(f"{file} was not computed here")
            file.unlink()


def write() -> None:
    """List the results."""
    LIST.unlink(missing_ok=True)
    LIST.write_text("".join(f"{line(file)}\n" for file in results()))


if __name__ == "__main__":
    {"check": check, "write": write}[sys.argv[1]]()
