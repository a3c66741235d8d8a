"""Measure the rows of `gauge sanity` on robots of makers: `python -m studies.robots.makers LIST.csv` writes robots.csv.

LIST.csv has the columns source, version, model, half and path (of an MJCF file). The half `chosen` chooses limits, and
`judged` judges them. Without a list the table of the note
is printed from robots.csv.
"""

import csv
import sys
from pathlib import Path

from gauge_envs.tools.sanity import configuration
from gauge_envs.tools.sanity.model import Verdict
from gauge_envs.tools.sanity.phenomena import ROBOT_IDS
from gauge_envs.tools.sanity.phenomena.base import facts
from gauge_envs.tools.sanity.target_checks import robot_row

TABLE = Path(__file__).parent / "robots.csv"

HALVES = ("chosen", "judged")


def measured(path: str) -> dict[str, str]:
    """Return the value of each row of a model: `!` marks a wrong one, `?` a visible one, brackets an advisory one."""
    robot, values = configuration(path).robot, {}
    for name in ROBOT_IDS:
        row = robot_row(name, robot)
        if row.verdict is Verdict.DECLINED:
            continue
        mark = {Verdict.WRONG: "!", Verdict.VISIBLE: "?"}.get(row.verdict, "")
        text = "inf" if row.configured is None else f"{row.configured:.3g}"
        values[name] = f"({text}{mark})" if row.advisory and mark else f"{text}{mark}"
    return values


def measure(listing: Path) -> None:
    """Write the table of all models of a list."""
    columns = ["source", "version", "model", "half", *ROBOT_IDS]
    with listing.open(encoding="utf-8") as stream:
        models = list(csv.DictReader(stream))
    with TABLE.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.DictWriter(stream, columns, lineterminator="\n")
        writer.writeheader()
        for model in models:
            values = measured(model.pop("path"))
            writer.writerow(model | values)
            stream.flush()


def table() -> str:
    """Return each row with its limits, the range of values, and the models inside in both halves, as Markdown."""
    with TABLE.open(encoding="utf-8") as stream:
        models = list(csv.DictReader(stream))
    lines = ["|row|limits|values|inside, chosen|inside, judged|wrong|", "|-|-|-|-|-|-|"]
    # Rows that are newer than the table have no values.
    for name in (one for one in ROBOT_IDS if one in models[0]):
        known = facts("robot_rows")[name]
        found = [(model["half"], model[name]) for model in models if model[name]]
        counts = [
            f"{sum(not text.strip('()').endswith(('!', '?')) for text in texts)} of {len(texts)}"
            for half in HALVES
            for texts in [[text for one, text in found if one == half]]
        ]
        values = sorted(float(text.strip("()!?")) for _, text in found)
        span = f"{values[0]:.3g} to {values[-1]:.3g}" if values else ""
        wrong = [model["model"] for model in models if model[name].endswith("!")]
        unit = "" if known["unit"] == "1" else f" {known['unit']}"
        cells = [f"`{name}`", known["limits"] + unit, span, *counts, ", ".join(wrong)]
        lines.append(f"|{'|'.join(cells)}|")
    return "\n".join(lines)


if __name__ == "__main__":
    if len(sys.argv) > 1:
        measure(Path(sys.argv[1]))
    print(table())
