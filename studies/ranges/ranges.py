"""Ranges of `gauge transfer randomize` from even trials, judged by odd ones; and 1,000 draws beside the real scatter.

python -m studies.ranges.ranges
"""

import csv
import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gauge_envs.pages.figures import OURS, REAL, new_figure, save_png, tidy_axis
from gauge_envs.references.tables import scoring_folder
from gauge_envs.scene import GRAVITY_M_PER_S2
from gauge_envs.tools.transfer.ranges import (
    covering,
    justified_ranges,
    measured_constants,
)

HERE = Path(__file__).parent
FACTS = scoring_folder("facts")
SLOPE_RAD, FRAME_S, DRAWS = math.radians(30.0), 1.0 / 30.0, 1000


def rows(name: str) -> list[dict[str, str]]:
    """Return the rows of a table of facts."""
    lines = (FACTS / name).read_text(encoding="utf-8").splitlines()
    return list(csv.DictReader(line for line in lines if not line.startswith("#")))


def slides(material: str) -> NDArray[np.float64]:
    """Return the friction of single slides: a = g (sin - mu cos), with a from a parabola, shape [trials]."""
    places: dict[str, list[float]] = {}
    for one in rows("slope_slider_30deg.csv"):
        if one["material"] == material:
            places.setdefault(one["trial"], []).append(1e-3 * float(one["downhill_mm"]))
    found = []
    for path in places.values():
        acceleration = 2.0 * np.polyfit(FRAME_S * np.arange(len(path)), path, 2)[0]
        pull = math.sin(SLOPE_RAD) - acceleration / GRAVITY_M_PER_S2
        found.append(pull / math.cos(SLOPE_RAD))
    return np.array(found)


def main() -> None:
    """Write the table and the picture."""
    drops = [one for one in rows("bouncing_ball.csv") if one["impact"] == "1"]
    rebounds = [
        float(one["speed_out_m_s"]) / float(one["speed_in_m_s"]) for one in drops
    ]
    real = {
        f"friction, {one} on wood": slides(one) for one in ("wood", "plastic", "metal")
    }
    real["friction, pushed cube"] = np.array(
        measured_constants()["light"]["friction"].values
    )
    real["restitution, rubber on wood"] = np.array(rebounds)
    ids = (
        "SlopeSlider-2-wood",
        "SlopeSlider-2-plastic",
        "SlopeSlider-2-metal",
        "CubePush-light",
        "BouncingBall-rubber",
    )
    figure = new_figure(10.5, 5.5)
    random = np.random.default_rng(0)
    table = []
    for place, ((name, values), variant) in enumerate(
        zip(real.items(), ids, strict=True)
    ):
        even, odd = values[::2], values[1::2]
        low, high = covering(float(even.mean()), float(even.std(ddof=1)), len(even))
        inside = int(np.sum((low <= odd) & (odd <= high)))
        constant = name.split(",")[0]
        one = next(
            one for one in justified_ranges(variant).ranges if one.constant == constant
        )
        draws = random.uniform(one.low, one.high, DRAWS)
        table.append([
            name, len(values), f"{values.mean():.4f}", f"{values.std(ddof=1):.4f}", f"{one.low:.4f}", f"{one.high:.4f}",
            f"{draws.std():.4f}", len(odd), inside,
        ])  # fmt: skip
        axis = figure.add_subplot(2, 3, place + 1)
        axis.hist(
            draws, bins=20, density=True, color=OURS[0], alpha=0.5, label="1,000 draws"
        )
        axis.hist(
            values,
            bins=8,
            density=True,
            histtype="step",
            color=REAL,
            label=f"{len(values)} real trials",
        )
        axis.set_title(name, loc="left", fontsize=8)
        axis.legend(fontsize=7, frameon=False)
        tidy_axis(axis)
    for row in table:
        print(*row, sep="  ")
    save_png(figure, HERE / "ranges.png")
    with (HERE / "ranges.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(
            [
                "constant",
                "trials",
                "mean",
                "std",
                "low",
                "high",
                "draws_std",
                "odd",
                "odd_inside",
            ]
        )
        writer.writerows(table)


if __name__ == "__main__":
    main()
