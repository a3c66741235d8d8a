"""Name the release of MuJoCo with which each published change came, and compare releases between which none did.

    python -m studies.what_changed.what_changed models
    python -m studies.what_changed.what_changed run thin_shelf

`models` lists the cases and compiles their models. `run` needs a package index: it runs `gauge backend versions` on the
cases of a model, or on all, and prints what `cases.csv` has of them.
"""

import csv
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import mujoco

HERE = Path(__file__).parent


def cases(only: str = "") -> Iterator[dict[str, str]]:
    """Yield the rows of `cases.csv`, of one model or of all."""
    with (HERE / "cases.csv").open(encoding="utf-8", newline="") as stream:
        for row in csv.DictReader(stream):
            if only in ("", row["model"]):
                yield row


def show_models() -> None:
    """Print the cases with the degrees of freedom of their models."""
    for row in cases():
        model = mujoco.MjModel.from_xml_path(str(HERE / f"{row['model']}.xml"))
        print(row["model"], model.nv, row["first"], row["last"], row["named"] or "same")


def run(only: str = "") -> None:
    """Run the command on the cases, and print what it names, beside what is stored."""
    for row in cases(only):
        ends = (row["first"], row["last"])
        words = [f"mujoco=={'..'.join(ends)}", "--bisect"]
        if not row["published"]:
            words = [f"mujoco=={end}" for end in ends]
        command = ["gauge", "backend", "versions", str(HERE / f"{row['model']}.xml")]
        command += [*words, "--steps", row["steps"], "--json", "--quiet"]
        done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False)
        line = json.loads(done.stdout)
        is_different = line["verdict"] == "different"
        named = line["after"].partition("==")[2] if is_different else ""
        first = (line["first"] or {}).get("detail", "")
        print(
            f"{row['model']}: {named or 'same'} (stored: {row['named'] or 'same'}) {first}"
        )


if __name__ == "__main__":
    if sys.argv[1:] == ["models"]:
        show_models()
    else:
        run(*sys.argv[2:])
